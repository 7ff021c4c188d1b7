use super::*;
use crate::Needle;

fn model() -> Model {
    let rig = Rig::two_guides(Needle::gauge_18(), 0.06, 0.07);
    Model::uniform(rig, 16e3).expect("valid")
}

fn drive() -> Vec<DriveSample> {
    vec![
        DriveSample { time_s: 0.0, y_m: 0.0, x_m: 0.0 },
        DriveSample { time_s: 1.0, y_m: 1.2e-3, x_m: -0.6e-3 },
    ]
}

#[test]
fn planes_are_multiples_of_one_response() {
    let shape = vec![ShapePoint::new(1.0, 0.09), ShapePoint::new(0.5, 0.09)];
    let lateral = Lateral { depth_m: 0.03, drive: drive(), shape, reversal_m: [0.0; 2], order: 0.0 };
    let channels = predict(&model(), &Experiment::Lateral(lateral)).expect("predicts");
    // 1.2 mm at 16 kPa and 30 mm takes 1.309563697895257 N.
    assert!((channels.force_n.y[1] / 1.309_563_697_895_257 - 1.0).abs() < 1e-10);
    assert_eq!(channels.force_n.x.as_ref().expect("two planes")[1], -0.5 * channels.force_n.y[1]);
    assert!((channels.shape_m.y[1] - 0.5 * channels.shape_m.y[0]).abs() < 1e-18);
}

/// Driven by the force that a displacement takes, the needle does the same.
#[test]
fn force_and_displacement_drive_alike() {
    let shape = vec![ShapePoint::new(0.7, 0.09)];
    let lateral =
        Lateral { depth_m: 0.03, drive: drive(), shape: shape.clone(), reversal_m: [0.0; 2], order: 0.0 };
    let moved = predict(&model(), &Experiment::Lateral(lateral)).expect("predicts");
    let force_x = moved.force_n.x.as_ref().expect("two planes");
    let forces = drive()
        .iter()
        .enumerate()
        .map(|(i, sample)| ForceSample { time_s: sample.time_s, y_n: moved.force_n.y[i], x_n: force_x[i] })
        .collect();
    let forced = LateralForce { depth_m: 0.03, drive: forces, shape };
    let pushed = predict(&model(), &Experiment::LateralForce(forced)).expect("predicts");
    assert!((pushed.displacement_m.y[1] / 1.2e-3 - 1.0).abs() < 1e-12);
    assert!((pushed.shape_m.y[0] / moved.shape_m.y[0] - 1.0).abs() < 1e-12);
}

#[test]
fn shape_without_drive_is_an_error() {
    let shape = vec![ShapePoint::new(1.0, 0.09)];
    let experiment = Experiment::Lateral(Lateral {
        depth_m: 0.03,
        drive: vec![],
        shape,
        reversal_m: [0.0; 2],
        order: 0.0,
    });
    assert_eq!(predict(&model(), &experiment), Err(ModelError::NoDrive));
}
