//! Insertions in which guide 2 is moved and the needle turned: the generator's chain against the forward model.

use super::chain::{STEP_M, node_at};
use super::insertion::{Acting, tip_path};
use super::*;
use mechanics::effects::effect;
use mechanics::{Experiment, Insertion, Model, Profile, TipLaw, predict};
use std::f64::consts::PI;

const DEPTHS_M: [f64; 6] = [0.02, 0.0295, 0.045, 0.058, 0.07, 0.09];
const LOAD_N: [f64; 2] = [0.2, 0.1];
const TURN_M: f64 = 0.05;
const CLEARANCE_M: f64 = 0.15e-3;

/// Vertical: up by 1 mm at 30 mm, down to 0.4 mm at 55 mm. Horizontal: out by 0.8 mm from 20 to 70 mm.
fn commanded() -> [Profile; 2] {
    let y = vec![[0.0, 0.0], [0.03, 0.0], [0.03, 1e-3], [0.055, 1e-3], [0.055, 0.4e-3]];
    let x = vec![[0.0, 0.0], [0.02, 0.0], [0.07, 0.8e-3]];
    [y, x].map(|knots| Profile::new(knots).expect("a profile"))
}

/// Position of the needle in guide 2: of the commanded places, with a clearance on either side that is taken up
/// first.
fn followed(plane: usize, clearance_m: f64, depth_m: f64, leaving: bool) -> f64 {
    match plane {
        0 if is_past(0.055, depth_m, leaving) => 0.4e-3 + clearance_m,
        0 if is_past(0.03, depth_m, leaving) => 1e-3 - clearance_m,
        0 => 0.0,
        _ => (0.8e-3 * ((depth_m - 0.02) / 0.05).clamp(0.0, 1.0) - clearance_m).max(0.0),
    }
}

fn is_past(at_m: f64, depth_m: f64, leaving: bool) -> bool {
    depth_m > at_m + 1e-9 || (leaving && depth_m > at_m - 1e-9)
}

/// Effects, and the clearance among them.
type Case = (&'static [(&'static str, &'static [f64])], f64);

#[test]
fn bent_needles_loose_guides_and_soft_frames_meet_the_forward_model() {
    let cases: [Case; 6] = [
        (&[], 0.0),
        (&[("rig.frame_compliance", &[0.4])], 0.0),
        (&[("rig.backlash", &[0.15])], CLEARANCE_M),
        (&[("needle.prebend", &[0.3, -0.2])], 0.0),
        (&[("needle.prebend", &[0.3, -0.2]), ("rig.clamp_compliance", &[0.5])], 0.0),
        (
            &[
                ("rig.frame_compliance", &[0.3]),
                ("rig.backlash", &[0.15]),
                ("needle.prebend", &[-0.2, 0.3]),
                ("needle.axial_load", &[1.5]),
                ("tissue.shear", &[3.0]),
            ],
            CLEARANCE_M,
        ),
    ];
    let mut plain: Option<[Vec<f64>; 2]> = None;
    for (effects, clearance_m) in cases {
        let rig = Rig::two_guides(Needle::gauge_18(), 0.06, 0.07);
        let of_truth = effects.iter().map(|(id, values)| (*id, values.to_vec())).collect();
        let truth = Truth { k_kpa: 12.0, tip_load_n: LOAD_N[0], effects: of_truth, foreign: None };
        let world = World::new(&truth, &rig);
        let expected = [0, 1].map(|plane| {
            let path = tip_path(&world, plane, 0.1, |step| Acting {
                load_n: bent_turned(step).map(|sign| sign * LOAD_N[plane]),
                bend_per_m: bent_turned(step).map(|sign| sign * world.prebend_per_m[plane]),
                guide2_m: [false, true]
                    .map(|leaving| followed(plane, clearance_m, step as f64 * STEP_M, leaving)),
            });
            DEPTHS_M.map(|depth_m| path[node_at(depth_m)][0]).to_vec()
        });

        let mut model = Model::uniform(rig, 12e3).expect("a model");
        model.tip = TipLaw::load(LOAD_N);
        model.effects =
            effects.iter().map(|(id, values)| (effect(id).expect("an effect"), values.to_vec())).collect();
        let insertion = Insertion {
            depth_m: DEPTHS_M.to_vec(),
            rotation_rad: Profile::new(vec![[TURN_M, 0.0], [TURN_M, PI]]).expect("a profile"),
            guide2_m: Some(commanded()),
            ..Insertion::default()
        };
        let predicted_m = predict(&model, &Experiment::Insertion(insertion)).expect("predicts").tip_m;
        let plane_paths = [predicted_m.y, predicted_m.x.expect("two planes")];
        let size_m = expected.iter().flatten().fold(0.0, |most: f64, m| most.max(m.abs()));
        for (plane_paths, expected) in plane_paths.iter().flatten().zip(expected.iter().flatten()) {
            assert!((plane_paths - expected).abs() < 2e-3 * size_m, "{effects:?}: {plane_paths} {expected}");
        }
        // The comparison uses the effect of the flaw: far beyond the agreement.
        match &plain {
            None => plain = Some(expected),
            Some(plain) => {
                let most_m = plain.iter().flatten().zip(expected.iter().flatten());
                let most_m = most_m.fold(0.0, |most: f64, (a, b)| most.max((a - b).abs()));
                assert!(most_m > 0.02 * size_m, "{effects:?} {most_m}");
            }
        }
    }
}

fn bent_turned(step: usize) -> [f64; 2] {
    [step > node_at(TURN_M), step >= node_at(TURN_M)].map(|is| if is { -1.0 } else { 1.0 })
}
