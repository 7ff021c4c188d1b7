//! Effects of one axis on the other.

use super::{channels, channels_with, lateral, plain};
use crate::Experiment;

const MM: f64 = 1e-3;

/// Guide 2 on an arc moves along x by half a square of its displacement along y: as if it were driven so.
#[test]
fn a_guide_on_an_arc_moves_along_the_other_axis() {
    let experiment = lateral(0.03);
    let on_arc = channels_with("law.guide_x.across.quadratic", &[0.5], &experiment);
    let mut driven = experiment.clone();
    let Experiment::Lateral(motion) = &mut driven else { unreachable!("a lateral run") };
    for sample in &mut motion.drive {
        sample.x_m += 0.5 / MM * sample.y_m.powi(2);
    }
    let driven = channels(&plain(), &driven);
    for (one, other) in [(&on_arc.force_n, &driven.force_n), (&on_arc.shape_m, &driven.shape_m)] {
        assert_eq!(one.y, other.y);
        let pairs = one.x.iter().flatten().zip(other.x.iter().flatten());
        pairs.for_each(|(one, other)| assert!((one - other).abs() < 1e-12, "{one} {other}"));
    }
}

/// Readings of one plane take a part of the other one: the displacement's at the force, the needle's at the shape.
#[test]
fn readings_of_one_plane_take_a_part_of_the_other() {
    let experiment = lateral(0.03);
    let plain = channels(&plain(), &experiment);
    let Experiment::Lateral(motion) = &experiment else { unreachable!("a lateral run") };
    let forced = channels_with("law.force_y.across.absolute", &[0.2], &experiment);
    for ((forced_n, plain_n), sample) in forced.force_n.y.iter().zip(&plain.force_n.y).zip(&motion.drive) {
        assert!((forced_n - plain_n - 0.2 * (sample.x_m / MM).abs()).abs() < 1e-12, "{forced_n} {plain_n}");
    }
    assert_eq!(forced.force_n.x, plain.force_n.x);
    let turned = channels_with("law.shape_y.across.linear", &[-0.1], &experiment);
    let across_m = plain.shape_m.x.iter().flatten();
    for ((turned_m, plain_m), across_m) in turned.shape_m.y.iter().zip(&plain.shape_m.y).zip(across_m) {
        assert!((turned_m - plain_m + 0.1 * across_m).abs() < 1e-12, "{turned_m} {plain_m} {across_m}");
    }
}
