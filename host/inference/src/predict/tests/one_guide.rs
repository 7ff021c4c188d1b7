//! Predictions for a needle in a single guide.

use super::*;

/// One guide whose rear is not stated, stiff in one axis and soft in the other: both are found from tip positions and directions while
/// guide 2 moves at rest, and so is the path.
#[test]
fn a_rear_that_is_not_stated_is_found_in_each_axis() {
    use mechanics::{Experiment, Insertion, Model, Needle, TipLaw, predict as forward};
    let rear = [6.0, 0.6];
    let rig = Rig {
        needle: Needle::gauge_18(),
        guide2_m: 0.0,
        entry_m: 0.028,
        guides: one_guide_with([None; 2]),
        tolerances: mechanics::Tolerances::default(),
    };
    let mut noise = Noise::new(11);
    let insertion = (0..3)
        .map(|number| {
            let known_rear_rig = Rig { guides: one_guide_with(rear.map(Some)), ..rig.clone() };
            let mut model = Model::uniform(known_rear_rig, 14e3).expect("a model");
            model.tip =
                TipLaw { entry_angle_rad: [4e-3 * number as f64, -3e-3], ..TipLaw::load([0.2, 0.03]) };
            let target_m = 1e-3 * (2.0 - number as f64 * 0.5);
            // The step itself is read before and after it.
            let depth_m: Vec<f64> = (0..=100)
                .flat_map(|mm| match mm {
                    30 => vec![0.030, 0.0304, 0.0304],
                    55 => vec![0.055, 0.0552, 0.0552],
                    _ => vec![1e-3 * f64::from(mm)],
                })
                .collect();
            let guide2_m = [guide_steps(target_m), guide_steps(-0.7 * target_m)];
            let held_positions: [Vec<f64>; 2] = guide2_m
                .each_ref()
                .map(|plane| (0..depth_m.len()).map(|i| profile_value(plane, i, &depth_m)).collect());
            // The forward model reads on arriving: after a step is a hair beyond it.
            let read_m = (0..depth_m.len())
                .map(|i| depth_m[i] + if leaves_rest(i, &depth_m) { 1e-8 } else { 0.0 })
                .collect();
            let insertion_done = Insertion {
                depth_m: read_m,
                guide2_m: Some(guide2_m),
                tip_direction: true,
                ..Insertion::default()
            };
            let channels = forward(&model, &Experiment::Insertion(insertion_done)).expect("predicts");
            let [y_m, x_m] = held_positions;
            formats::session::InsertionRun {
                id: format!("i{number}"),
                path: format!("i{number}.csv").into(),
                tip_y_m: noisy(channels.tip_m.y, 0.05e-3, &mut noise),
                tip_x_m: channels.tip_m.x.map(|x| noisy(x, 0.05e-3, &mut noise)),
                tip_direction_y_rad: Some(noisy(channels.tip_direction_rad.y, 1e-3, &mut noise)),
                tip_direction_x_rad: channels.tip_direction_rad.x.map(|x| noisy(x, 1e-3, &mut noise)),
                guide2_y_m: Some(y_m),
                guide2_x_m: Some(x_m),
                depth_m,
                time_s: None,
                rotation_rad: None,
                base_force_y_n: None,
            }
        })
        .collect();
    let (empty, _) = steady();
    let session = Session { rig, insertion, ..empty };
    let prediction = predict(&session, &UNTIL_50).expect("predicts");
    for one in &prediction.insertions {
        let learned = one.learned.as_ref().expect("learned");
        for (prediction, stiffness) in
            [&learned.rear_rotation_y, &learned.rear_rotation_x].into_iter().zip(rear)
        {
            let rear = prediction.as_ref().expect("a rear");
            let [low, high] = rear.ci95_n_m_per_rad;
            assert!(0.8 * low <= stiffness && stiffness <= 1.25 * high, "{rear:?} is not {stiffness}");
        }
        let soft = learned.rear_rotation_x.as_ref().expect("a rear");
        assert_eq!(soft.status, "identified", "{soft:?}");
        assert!(one.mae_mm.expect("measured") < 0.2, "{:?}", one.mae_mm);
        assert!(2 * one.band_held > one.band_readings);
    }
}

fn noisy(values: Vec<f64>, sd: f64, noise: &mut Noise) -> Vec<f64> {
    values.into_iter().map(|value| value + sd * noise.normal()).collect()
}

fn profile_value(profile: &mechanics::Profile, i: usize, depth_m: &[f64]) -> f64 {
    if leaves_rest(i, depth_m) { profile.after(depth_m[i]) } else { profile.before(depth_m[i]) }
}

fn leaves_rest(i: usize, depth_m: &[f64]) -> bool {
    i > 0 && depth_m[i] == depth_m[i - 1]
}

fn guide_steps(to_m: f64) -> mechanics::Profile {
    let knots =
        vec![[0.0, 0.0], [0.0304, 0.0], [0.0304, to_m], [0.0552, to_m], [0.0552, -to_m], [0.1, -to_m]];
    mechanics::Profile::new(knots).expect("a profile")
}

fn one_guide_with(stiffness: [Option<f64>; 2]) -> mechanics::Guides {
    mechanics::Guides::One { rear_rotation_n_m_per_rad: stiffness }
}
