//! Frictions of a lead screw beyond the sign of its motion.

use super::{channels, lateral, noisy, plain, with};

/// In the staircase guide 2 moves at 0.6, 0.6, -1.2 and -1.0 mm/s, in the first half of every level.
#[test]
fn frictions_of_a_lead_screw_depend_on_its_speed_and_its_way() {
    let experiment = lateral(0.03);
    let plain_n = channels(&plain(), &experiment).force_n.y;
    for (id, values, expected_n) in [
        ("law.force.speed.linear", vec![0.2], [0.12, 0.0, -0.24, 0.0, -0.2]),
        ("law.force.speed.absolute", vec![0.2], [0.12, 0.0, 0.24, 0.0, 0.2]),
        (
            "law.force.speed.decay",
            vec![0.2, 0.6],
            [stribeck_decay(0.6), 0.2, -stribeck_decay(1.2), -0.2, -stribeck_decay(1.0)],
        ),
        ("law.force.displacement.bristle", vec![0.2, 0.4], [0.15, 0.2, -0.1, -0.2, -0.2]),
    ] {
        let rubbed_n = channels(&with(id, &values), &experiment).force_n.y;
        for (sample, expected_n) in [25, 35, 65, 75, 85].into_iter().zip(expected_n) {
            let added_n = rubbed_n[sample] - plain_n[sample];
            assert!((added_n - expected_n).abs() < 1e-9, "{id}, sample {sample}: {added_n} N");
        }
    }
}

fn stribeck_decay(speed: f64) -> f64 {
    0.2 * (-speed / 0.6_f64).exp()
}

/// A speed is that of a way beyond noise: in holds there is none.
#[test]
fn noise_of_a_displacement_is_no_speed() {
    let experiment = noisy(5);
    let plain_n = channels(&plain(), &experiment).force_n;
    let rubbed_n = channels(&with("law.force.speed.linear", &[0.2]), &experiment).force_n;
    for sample in [33, 36, 53, 56, 73, 76] {
        let added_n = rubbed_n.y[sample] - plain_n.y[sample];
        assert!(added_n.abs() < 0.02, "sample {sample}: {added_n} N");
    }
    assert_eq!(rubbed_n.x, plain_n.x);
}
