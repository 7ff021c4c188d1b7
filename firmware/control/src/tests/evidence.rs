//! Readings that no motion explains. The crate `sequences` tests how patterns of failing sensors affect the true force.

use super::*;

/// A channel reads the noise of an unloaded cell, always or now and then: no code is repeated, but no motion explains the jumps.
#[test]
fn readings_that_no_motion_explains_are_a_fault_while_moving() {
    for (every, within) in [(1, 2), (2, 4), (3, 6)] {
        let mut bench = Bench::new();
        bench.position_um = [0.0; 2];
        bench.run(&[Step::Move { x_um: 0, y_um: 2_000, speed_um_s: 1_000 }]);
        bench.periods(1_500);
        let push_n = -bench.position_um[1] * 1e-3;
        let mut periods = 0;
        while bench.controller.interlock.latched().is_none() {
            periods += 1;
            bench.push_n[1] = if periods % every == 0 { push_n } else { 0.0 };
            bench.period(None);
            assert!(periods <= within, "one of {every}");
        }
        assert_eq!(bench.controller.interlock.latched(), Some(Fault::ForceSensor));
    }
    // At rest a hand may load the needle at any rate.
    let mut bench = Bench::new();
    bench.run(&[Step::Hold { duration_ms: 1_000 }]);
    bench.push_n = [1.5; 2];
    assert_eq!(bench.finish(), Outcome::Completed);
}
