use super::*;
use crate::effects::effect;
use crate::{Needle, Rig};

fn model(effects: &[(&str, &[f64])]) -> Model {
    let rig = Rig::two_guides(Needle::gauge_18(), 0.06, 0.07);
    let mut model = Model::uniform(rig, 16e3).expect("valid");
    model.effects =
        effects.iter().map(|(id, values)| (effect(id).expect("an effect"), values.to_vec())).collect();
    model
}

fn commanded(steps_mm: &[[f64; 2]]) -> Vec<DriveSample> {
    steps_mm
        .iter()
        .enumerate()
        .map(|(i, [y, x])| DriveSample { time_s: i as f64, y_m: 1e-3 * y, x_m: 1e-3 * x })
        .collect()
}

/// Three frames: two of the same places, one of others.
fn shape() -> Vec<ShapePoint> {
    [
        interpolated(0.5, [0.08, 0.09, 0.1]),
        interpolated(1.0, [0.08, 0.09, 0.1]),
        interpolated(1.5, [0.075, 0.09, 0.1]),
    ]
    .concat()
}

fn interpolated(time_s: f64, all_m: [f64; 3]) -> [ShapePoint; 3] {
    all_m.map(|z_m| ShapePoint::new(time_s, z_m))
}

fn prepared(model: &Model, most_m: f64, planes: usize) -> PreparedNeedle<'_> {
    let plan =
        ObservationPlan { shape: &shape(), most_m: [most_m; 2], planes, reversal_m: [0.0; 2], order: 0.0 };
    PreparedNeedle::new(Cow::Borrowed(model), 0.03, plan, None).expect("solves")
}

#[test]
fn places_measured_again_are_stored_once() {
    let model = model(&[]);
    let shape_places = prepared(&model, 1e-3, 2).places;
    assert_eq!(shape_places.z_m, [0.08, 0.09, 0.1, 0.075, 0.09, 0.1]);
    assert_eq!(shape_places.frames.iter().map(|p| p.places.clone()).collect::<Vec<_>>(), [0..3, 0..3, 3..6]);
}

#[test]
fn points_are_where_the_needle_is_at_their_time() {
    let model = model(&[]);
    let channels =
        prepared(&model, 1e-3, 2).moved(&commanded(&[[0.0, 0.0], [1.0, -0.5], [0.4, 0.0]])).expect("moves");
    let beam = model.beam(0.03).expect("solves");
    // Half way to 1 mm, at it, and half way back to 0.4 mm.
    for (i, (point, at_m)) in shape().iter().zip([0.5e-3, 1e-3, 0.7e-3].map(|m| [m; 3]).concat()).enumerate()
    {
        let expected_m = beam.deflection_m(at_m, point.z_m);
        assert!((channels.shape_m.y[i] / expected_m - 1.0).abs() < 1e-12, "{i}");
    }
    assert_eq!(channels.shape_m.x.as_ref().expect("both planes")[4], -0.5 * channels.shape_m.y[4]);
}

#[test]
fn one_plane_is_the_first_of_two() {
    let (model, commanded) = (model(&[]), commanded(&[[0.0, 0.0], [1.0, 0.3]]));
    let [one_plane, two] =
        [1, 2].map(|planes| prepared(&model, 1e-3, planes).moved(&commanded).expect("moves"));
    assert_eq!((&one_plane.force_n.y, &one_plane.shape_m.y), (&two.force_n.y, &two.shape_m.y));
    assert_eq!((one_plane.force_n.x, two.force_n.x.map(|x| x.len())), (None, Some(2)));
}

/// Crosstalk brings the horizontal force into the vertical one, whether the horizontal plane is measured or not.
#[test]
fn an_effect_gets_both_planes() {
    let crosstalk = effect("sensor.crosstalk").expect("an effect");
    let values: Vec<f64> = crosstalk.parameters().iter().map(|_| 0.1).collect();
    let (model, commanded) = (model(&[("sensor.crosstalk", &values)]), commanded(&[[0.0, 0.0], [1.0, 0.3]]));
    let [one_plane, two] =
        [1, 2].map(|planes| prepared(&model, 1e-3, planes).moved(&commanded).expect("moves"));
    assert_eq!(one_plane, two);
}

/// If the tissue stiffens, the needle is solved for the planned displacement, and again for any larger
/// one.
#[test]
fn a_larger_displacement_than_planned_is_no_extrapolation() {
    let model = model(&[("tissue.stiffening", &[0.5])]);
    let commanded = commanded(&[[0.0, 0.0], [2.0, 0.0]]);
    let [short, long] =
        [0.2e-3, 2e-3].map(|most_m| prepared(&model, most_m, 1).moved(&commanded).expect("moves"));
    assert_eq!(short, long);
    let linear = prepared(&self::model(&[]), 2e-3, 1).moved(&commanded).expect("moves");
    assert!(long.force_n.y[1] > 1.05 * linear.force_n.y[1]);
}
