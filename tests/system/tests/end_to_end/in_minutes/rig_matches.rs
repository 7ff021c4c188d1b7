//! The simulated rig and the firmware are written apart; here their constants are held against each other.

use control::calibration::{Calibration, FORCE_NN_PER_COUNT};
use simulation::rig::SimulatedRig;
use simulation::rig::config::RigConfig;

/// A rig without noise at rest: what the firmware makes of its codes is where the rig is and what acts on it.
#[test]
fn the_nominal_calibration_reads_the_simulated_rig() {
    let mut config = RigConfig::default();
    config.simulation.actuator.potentiometer_noise_codes = 0.0;
    config.simulation.force.noise_n = 0.0;
    config.simulation.force.offset_n = simulation::rig::config::Range { low: 0.0, high: 0.0 };
    let mut rig = SimulatedRig::new(config, 3).unwrap();
    let calibration = Calibration::default();
    for inputs in [[[0.0; 2]; 2], [[0.6, 0.0], [0.0, 0.5]]] {
        for _ in 0..40 {
            rig.step(inputs, 1e-3);
        }
        let codes = rig.step([[0.0; 2]; 2], 1e-3);
        let position_um = calibration.position_um(codes.potentiometer, [0.5; 2]);
        let counts = calibration.force_counts(codes.bridge);
        for axis in [0, 1] {
            let error_um = f64::from(position_um[axis]) - rig.position_m()[axis] * 1e6;
            assert!(error_um.abs() < 6.2, "axis {axis} reads {error_um} um off: more than half a code");
            let error_n =
                f64::from(counts[axis]) * f64::from(FORCE_NN_PER_COUNT) * 1e-9 - rig.force_n()[axis];
            assert!(error_n.abs() < 5e-5, "axis {axis} reads {error_n} N off: more than a count");
        }
    }
}
