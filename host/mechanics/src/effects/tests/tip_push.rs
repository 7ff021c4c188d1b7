//! A lateral force on the tip.

use super::{ENTRY_M, GUIDE2_M, channels, channels_with, lateral, plain, with};
use crate::{Foundation, Model};

const DEPTH_M: f64 = 0.03;
const PUSH_N: f64 = 0.2;

/// Without tissue it is a beam that is clamped at guide 1, propped at guide 2 and loaded at its free end.
#[test]
fn a_push_on_the_tip_of_a_needle_in_air_bends_a_propped_cantilever() {
    let air = |model: Model| Model { foundation: Foundation::none(), ..model };
    let experiment = lateral(DEPTH_M);
    let pushed = channels(&air(with("law.tip_push_y.constant.constant", &[PUSH_N])), &experiment);
    let free = channels(&air(plain()), &experiment);
    let overhang_m = ENTRY_M + DEPTH_M - GUIDE2_M;
    let held_n = -PUSH_N * (1.0 + 1.5 * overhang_m / GUIDE2_M);
    for (pushed_n, free_n) in pushed.force_n.y.iter().zip(&free.force_n.y) {
        assert!(((pushed_n - free_n) / held_n - 1.0).abs() < 1e-9, "{pushed_n} {free_n} {held_n}");
    }
    assert_eq!(pushed.force_n.x, free.force_n.x);
    let stiffness_n_m2 = plain().rig.needle.bending_stiffness_n_m2();
    let slope = PUSH_N * overhang_m * GUIDE2_M / (4.0 * stiffness_n_m2);
    let crate::Experiment::Lateral(run) = &experiment else { unreachable!("a lateral run") };
    for ((pushed_m, free_m), point) in pushed.shape_m.y.iter().zip(&free.shape_m.y).zip(&run.shape) {
        let beyond_m = point.z_m - GUIDE2_M;
        let bent_m = PUSH_N * (overhang_m * beyond_m.powi(2) / 2.0 - beyond_m.powi(3) / 6.0) / stiffness_n_m2;
        let expected_m = slope * beyond_m + bent_m;
        assert!(((pushed_m - free_m) / expected_m - 1.0).abs() < 1e-9, "{pushed_m} {free_m} {expected_m}");
    }
}

/// Betti: the force by which guide 2 holds a needle that is pushed at its tip is that of the tip's deflection where guide 2 moves by one.
#[test]
fn a_push_on_the_tip_is_held_as_the_reciprocal_deflection_says() {
    let experiment = lateral(DEPTH_M);
    let pushed = channels_with("law.tip_push_x.depth.linear", &[0.01], &experiment);
    let free = channels(&plain(), &experiment);
    let beam = plain().problem(DEPTH_M).expect("a problem").solve().expect("a beam");
    let held_n = -0.01 * 1e3 * DEPTH_M * beam.deflection_m(1.0, ENTRY_M + DEPTH_M);
    let pairs = pushed.force_n.x.iter().flatten().zip(free.force_n.x.iter().flatten());
    pairs.for_each(|(pushed_n, free_n)| {
        assert!((pushed_n - free_n - held_n).abs() < 1e-9, "{pushed_n} {free_n} {held_n}");
    });
}
