//! Against dense normal algebra, the forward model, and what the recordings of hands contain.

use super::basis::Candidates;
use super::scales::Scales;
use super::*;
use crate::model::{Cutting, Experiment, Insertion, Model, Needle, Profile, Rig, TipLaw, predict};
use crate::session::InsertionRun;
use std::path::PathBuf;

fn rig() -> Rig {
    Rig::two_guides(Needle::gauge_18(), 0.06, 0.08)
}

/// A recording of columns of equal length: depth, y, x in mm; rotation in degrees; guide 2 in mm.
fn run(rows: &[[f64; 6]]) -> InsertionRun {
    let column = |i: usize, unit: f64| rows.iter().map(|row| unit * row[i]).collect::<Vec<_>>();
    InsertionRun {
        id: "i".to_owned(),
        path: PathBuf::from("i.csv"),
        depth_m: column(0, 1e-3),
        tip_y_m: column(1, 1e-3),
        tip_x_m: Some(column(2, 1e-3)),
        time_s: None,
        rotation_rad: Some(column(3, 1f64.to_radians())),
        guide2_y_m: Some(column(4, 1e-3)),
        guide2_x_m: Some(column(5, 1e-3)),
        base_force_y_n: None,
        tip_direction_y_rad: None,
        tip_direction_x_rad: None,
    }
}

fn tissue(sd_ln: f64) -> Tissue {
    let model = Model::uniform(rig(), 12e3).expect("a model");
    Tissue { model, modulus_sd_ln: sd_ln, gap_m: 0.02, gap_sd_ln: sd_ln }
}

/// The rows of the design, times unknowns, are what the forward model predicts: guide 2 moved, at rest and on the way; needle turned.
#[test]
fn the_design_is_the_forward_model() {
    let rows: Vec<[f64; 6]> = (0..=80)
        .map(|mm| {
            let d = f64::from(mm);
            let turned = if d > 30.0 { 50.0 } else { 0.0 };
            let moved = if d > 40.0 { 1.5 } else { 0.0 };
            [d, 0.0, 0.0, turned, moved, 0.02 * d]
        })
        .collect();
    let path = TipPath::new(&run(&rows)).expect("an insertion");
    assert!(path.is_turned());
    let candidates = Candidates::new(&tissue(0.0), std::slice::from_ref(&path), 0.08).expect("candidates");
    let layout = &candidates.layout;
    assert!(layout.coupled && candidates.list.len() == 1);
    let load = |plane: f64| {
        let knots = layout.knots_m.iter().enumerate();
        Profile::new(knots.map(|(i, m)| [*m, 0.1 * plane + 0.01 * (i as f64 * plane).sin()]).collect())
            .expect("loads")
    };
    let loads = [load(1.0), load(-2.0)];
    let mut unknowns = vec![0.0; layout.unknowns()];
    for (plane, profile) in loads.iter().enumerate() {
        let at = plane * layout.of_plane();
        unknowns[at + 2] = profile.before(0.0);
        for (i, pair) in layout.knots_m.windows(2).enumerate() {
            unknowns[at + 3 + i] = profile.before(pair[1]) - profile.before(pair[0]);
        }
    }
    let mut model = Model::uniform(rig(), 12e3).expect("a model");
    model.tip = TipLaw { cutting: Cutting::Load(loads), ..TipLaw::default() };
    let insertion = Insertion { depth_m: vec![0.0, 0.013, 0.035, 0.041, 0.08], ..path.done.clone() };
    let tip_m = predict(&model, &Experiment::Insertion(insertion.clone())).expect("predicts").tip_m;
    let basis = &candidates.bases[0][0];
    for (i, depth_m) in insertion.depth_m.iter().enumerate() {
        for (plane, expected_m) in
            [tip_m.y[i], tip_m.x.as_ref().expect("two planes")[i]].into_iter().enumerate()
        {
            let row = basis.row(plane, *depth_m, false);
            let tip_m: f64 = row.iter().zip(&unknowns).map(|(row, unknown)| row * unknown).sum();
            let tip_m = tip_m + basis.guide2_m(plane, *depth_m, false);
            assert!((tip_m - expected_m).abs() < 1e-6, "{tip_m} is not {expected_m} at {depth_m}");
        }
    }
}

/// Load at any two knots covaries as a stationary process with exponential memory.
#[test]
fn the_wander_is_stationary() {
    let path =
        TipPath::new(&run(&[0.0, 20.0, 40.0, 60.0, 80.0].map(|d| [d, 0.0, 0.0, 0.0, 0.0, 0.0]))).expect("ok");
    let layout = Layout::new(&[path], 0.08);
    let scales = Scales { load_n: [1.0, 1e-12], ..Scales::typical(0.0) };
    let map = scales.map(&layout);
    let load = |depth_m: f64| map.transpose() * &layout.load_rows(depth_m)[0];
    let variance = 0.5 * scales.memory_m * scales.wander_n[1].powi(2);
    for [a_m, b_m] in [[0.0, 0.0], [0.0, 0.03], [0.02, 0.075], [0.08, 0.08]] {
        let expected = variance * (-f64::abs(a_m - b_m) / scales.memory_m).exp();
        let found = load(a_m).dot(&load(b_m));
        assert!((found / expected - 1.0).abs() < 1e-9, "{found} is not {expected} between {a_m} and {b_m}");
    }
}

#[test]
fn hands_are_understood() {
    // Overshoot and rest at each stop, one misread depth, drawn back at the end.
    let mut rows = Vec::new();
    for stop in 0..=10 {
        let d = 6.0 * f64::from(stop);
        rows.extend([d + 2.0, d, d, d].map(|depth| [depth, 0.02 * d, -0.01 * d, 0.0, 0.0, 0.0]));
    }
    rows[14][0] = 250.0;
    rows.extend((1..20).map(|i| [60.0 - 3.5 * f64::from(i), 0.0, 0.0, 0.0, 0.0, 0.0]));
    let path = TipPath::new(&run(&rows)).expect("an insertion");
    assert_eq!(path.rows_left_out, 20);
    assert!(path.bins.iter().all(|bin| bin.depth_m < 0.063));
    let seen = path.until(0.03).expect("seen");
    assert!(seen.bins.iter().all(|bin| bin.depth_m <= 0.03));
    assert_eq!(seen.done, path.done);
}

#[test]
fn a_turn_and_a_push_at_rest_are_jumps() {
    let turn = |d: f64, angle: f64, guide: f64| [d, 0.0, 0.0, angle, guide, 0.0];
    let mut rows: Vec<[f64; 6]> = (0..=20).map(|mm| turn(f64::from(mm), 0.0, 0.0)).collect();
    // The guide moves at rest, step by step; then the needle is turned and advances.
    rows.extend([turn(20.0, 0.0, 0.4), turn(20.0, 0.0, 0.9), turn(20.0, 0.0, 1.0)]);
    rows.extend((21..=40).map(|mm| turn(f64::from(mm), 180.0, 1.0)));
    let path = TipPath::new(&run(&rows)).expect("an insertion");
    let [guide, _] = path.done.guide2_m.as_ref().expect("guide 2");
    assert_eq!(guide.jumps_m().collect::<Vec<_>>(), [0.02]);
    assert_eq!((guide.before(0.02), guide.after(0.02)), (0.0, 1e-3));
    assert_eq!(path.done.rotation_rad.jumps_m().collect::<Vec<_>>(), [0.02]);
    // Rows in the middle of the push count for nothing.
    assert_eq!(path.rows_left_out, 3, "{:?}", path.bins);
}

#[test]
fn what_is_no_insertion_is_said_to_be_none() {
    let depths = |list: &[f64]| run(&list.iter().map(|d| [*d, 0.0, 0.0, 0.0, 0.0, 0.0]).collect::<Vec<_>>());
    let message = |list: &[f64]| TipPath::new(&depths(list)).expect_err("no insertion").to_string();
    assert!(message(&[10.0]).contains("1 of 1 rows advance into the tissue, expected 5 or more"));
    assert!(message(&[50.0, 40.0, 30.0, 20.0, 10.0, 5.0]).contains("of 6 rows advance"));
    assert!(message(&[10.0; 9]).contains("9 of 9 rows advance into the tissue"));
    assert!(message(&[0.0, 0.01, 0.02, 0.03, 1.04, 2.05]).contains("is this in millimetres?"));
    let path = TipPath::new(&depths(&[0.0, 10.0, 20.0, 60.0, 70.0, 80.0])).expect("an insertion");
    assert_eq!(path.gaps_m.len(), 1);
    assert!(path.until(0.01).expect_err("too little").to_string().contains("2 depths up to 10 mm"));
}

/// Readings one by one lead to the same belief as their bins at once.
#[test]
fn live_and_recorded_agree() {
    let rows: Vec<[f64; 6]> =
        (0..=50).flat_map(|mm| [[f64::from(mm), 0.02 * f64::from(mm), 0.3, 0.0, 0.0, 0.0]; 3]).collect();
    let path = TipPath::new(&run(&rows)).expect("an insertion");
    let paths = [path];
    let candidates = Candidates::new(&tissue(0.5), &paths, 0.1).expect("candidates");
    let learned = learn(&candidates, &paths, &[], 0, 0.05e-3);
    let mut recorded = Belief::new(&candidates, 0, &learned);
    recorded.update_all(&paths[0]);
    let mut live = Live::new(Belief::new(&candidates, 0, &learned));
    rows.iter().for_each(|row| live.push(1e-3 * row[0], [1e-3 * row[1], 1e-3 * row[2]]));
    for (a, b) in recorded.tip_m(&[0.1])[0].iter().zip(&live.belief().tip_m(&[0.1])[0]) {
        assert!((a.mean - b.mean).abs() < 1e-9 && (a.sd - b.sd).abs() < 1e-9);
    }
}
