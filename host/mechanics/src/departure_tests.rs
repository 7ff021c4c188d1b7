//! Laws on reaction and stiffness are what effects with a name are, where there is one.

use crate::effects::effect;
use crate::{Channels, DriveSample, Experiment, Lateral, Model, Needle, Rig, ShapePoint, predict};

fn moved(effects: &[(&str, &[f64])], displacements_m: &[f64]) -> Channels {
    let mut model = Model::uniform(Rig::two_guides(Needle::gauge_18(), 0.06, 0.07), 16e3).expect("valid");
    model.effects =
        effects.iter().map(|(id, values)| (effect(id).expect("an effect"), values.to_vec())).collect();
    let shape = [0.075, 0.09].map(|z_m| ShapePoint::new(1.0, z_m)).to_vec();
    let drive = displacements_m
        .iter()
        .enumerate()
        .map(|(i, y_m)| DriveSample { time_s: i as f64, y_m: *y_m, x_m: 0.5 * y_m })
        .collect();
    let lateral = Lateral { depth_m: 0.03, drive, shape, reversal_m: [0.0; 2], order: 0.0 };
    predict(&model, &Experiment::Lateral(lateral)).expect("predicts")
}

fn same(a: &Channels, b: &Channels, within: f64) {
    let (plain_n, most_m) = (a.force_n.y.iter().fold(0.0, |m: f64, f| m.max(f.abs())), 1e-3);
    let pairs = a.force_n.y.iter().zip(&b.force_n.y);
    assert!(pairs.clone().all(|(a, b)| (a - b).abs() < within * plain_n), "{:?}", pairs.collect::<Vec<_>>());
    let pairs = a.shape_m.y.iter().zip(&b.shape_m.y);
    assert!(pairs.clone().all(|(a, b)| (a - b).abs() < within * most_m), "{:?}", pairs.collect::<Vec<_>>());
}

const WAY_M: [f64; 6] = [0.0, 1e-3, 0.4e-3, -0.7e-3, -1.2e-3, 0.05e-3];

#[test]
fn a_reaction_that_grows_with_the_square_is_stiffening() {
    let law = moved(&[("law.reaction.deflection.quadratic", &[0.64])], &WAY_M);
    same(&law, &moved(&[("tissue.stiffening", &[0.8])], &WAY_M), 1e-3);
    assert!(law.force_n.y[1] > 1.02 * moved(&[], &WAY_M).force_n.y[1]);
}

/// `K u / sqrt(1 + (K u / p)^2)`, with p = 16 N/m and K = 16 kPa: a knee at 1 mm.
#[test]
fn a_reaction_with_a_limit_is_yielding() {
    let law = moved(&[("law.reaction.deflection.knee", &[-1.0, 1.0])], &WAY_M);
    let named = moved(&[("tissue.yield", &[1e3 / 16.0, 1e6])], &WAY_M);
    same(&law, &named, 2e-3);
    assert!(law.force_n.y[1] < 0.995 * moved(&[], &WAY_M).force_n.y[1]);
}

#[test]
fn a_needle_that_is_stiffer_all_along_is_a_stiffer_needle() {
    let law = moved(&[("law.stiffness.to_tip.within", &[-0.3, 190.0])], &WAY_M);
    same(&law, &moved(&[("needle.stiffness", &[-0.3])], &WAY_M), 2e-3);
}

/// Tissue that reacts more to one side: guide 2 takes more force there, and as much less on the other.
#[test]
fn tissue_may_be_stiffer_to_one_side() {
    let guide_path_m = [0.0, 1e-3, -1e-3];
    let (law, plain) =
        (moved(&[("law.reaction.deflection.sign", &[0.4])], &guide_path_m), moved(&[], &guide_path_m));
    assert!(
        force_ratio(1, &law.force_n.y, &plain.force_n.y) > 1.05
            && force_ratio(2, &law.force_n.y, &plain.force_n.y) < 0.95,
        "{} {}",
        force_ratio(1, &law.force_n.y, &plain.force_n.y),
        force_ratio(2, &law.force_n.y, &plain.force_n.y)
    );
    let mirrored = moved(&[("law.reaction.deflection.sign", &[-0.4])], &guide_path_m);
    assert!((mirrored.force_n.y[2] / -law.force_n.y[1] - 1.0).abs() < 1e-3);
}

fn force_ratio(i: usize, y: &[f64], plain_force_n_y: &[f64]) -> f64 {
    y[i] / plain_force_n_y[i]
}
