//! Against dense normal algebra, the forward model, and what the recordings of hands contain.

use super::basis::{Basis, Measured};
use super::candidates::{Candidate, Fineness};
use super::evidence::Evidence;
use super::layout::{ENTRY, LOAD, MODULUS, PROCESS_NOISE};
use super::learned::{Node, Part};
use super::scales::{COUNT, Known};
use super::*;
use formats::session::InsertionRun;
use mechanics::{Cutting, Experiment, Guides, Insertion, Model, Needle, Profile, Rig, TipLaw, predict};
use std::path::PathBuf;
use std::sync::Arc;

fn rig() -> Rig {
    Rig::two_guides(Needle::gauge_18(), 0.06, 0.08)
}

/// A recording of columns of equal length: depth, y, x in mm; rotation in degrees; guide 2 in mm.
fn run(rows: &[[f64; 6]]) -> InsertionRun {
    InsertionRun {
        id: "i".to_owned(),
        path: PathBuf::from("i.csv"),
        depth_m: scaled_column(0, 1e-3, rows),
        tip_y_m: scaled_column(1, 1e-3, rows),
        tip_x_m: Some(scaled_column(2, 1e-3, rows)),
        time_s: None,
        rotation_rad: Some(scaled_column(3, 1f64.to_radians(), rows)),
        guide2_y_m: Some(scaled_column(4, 1e-3, rows)),
        guide2_x_m: Some(scaled_column(5, 1e-3, rows)),
        base_force_y_n: None,
        tip_direction_y_rad: None,
        tip_direction_x_rad: None,
    }
}

fn scaled_column(i: usize, unit: f64, rows: &[[f64; 6]]) -> Vec<f64> {
    rows.iter().map(|row| unit * row[i]).collect::<Vec<_>>()
}

fn tissue(sd_ln: f64) -> Tissue {
    let model = Model::uniform(rig(), 12e3).expect("a model");
    Tissue { model, modulus_sd_ln: sd_ln, gap_m: 0.02, gap_sd_ln: sd_ln, rear: None }
}

fn basis(candidates: &Candidates, candidate: Candidate, load_n: [f64; 2]) -> Basis {
    let responses = candidates.responses(candidate, Fineness::Fine).expect("responses");
    Basis::new(candidates, &responses, candidate, 0, load_n)
}

/// Guide 2 moved, at rest and on the way; needle turned out of its plane.
fn moved() -> TipPath {
    let rows: Vec<[f64; 6]> = (0..=80)
        .map(|mm| {
            let d = f64::from(mm);
            let rotation_deg = if d > 30.0 { 50.0 } else { 0.0 };
            let moved = if d > 40.0 { 1.5 } else { 0.0 };
            [d, 0.0, 0.0, rotation_deg, moved, 0.02 * d]
        })
        .collect();
    TipPath::new(&run(&rows)).expect("an insertion")
}

/// The forward model at another modulus and gap, the tissue beginning later than the depth states.
fn forward_m(
    path: &TipPath,
    loads: [Profile; 2],
    at: Candidate,
    entry_m: f64,
    depths_m: &[f64],
) -> [Vec<f64>; 2] {
    let mut rig = rig();
    rig.entry_m = rig.guide2_m + 0.02 * at.gap_ln.exp() + entry_m;
    let mut model = Model::uniform(rig, 12e3 * at.modulus_ln.exp()).expect("a model");
    model.tip = TipLaw { cutting: Cutting::Load(loads), ..TipLaw::default() };
    let depth_m = depths_m.iter().map(|depth_m| depth_m - entry_m).collect();
    let insertion = Insertion { depth_m, ..path.done.clone() };
    let tip_m = predict(&model, &Experiment::Insertion(insertion)).expect("predicts").tip_m;
    [tip_m.y, tip_m.x.expect("two planes")]
}

const AWAY: Candidate = Candidate { modulus_ln: 0.11, gap_ln: -0.37, rear_share: [0.0; 2] };

/// The rows of the design, times unknowns, are what the forward model predicts, also between the points that are solved.
#[test]
fn the_design_is_the_forward_model() {
    let path = moved();
    assert!(path.is_turned());
    let candidates = Candidates::new(&tissue(0.5), std::slice::from_ref(&path), 0.08).expect("candidates");
    let layout = &candidates.layout;
    assert!(layout.coupled);
    let loads = [load_profile(1.0, &layout.knots_m), load_profile(-2.0, &layout.knots_m)];
    let mut unknowns = vec![0.0; layout.unknowns()];
    for (plane, profile) in loads.iter().enumerate() {
        let first_column = plane * layout.of_plane();
        unknowns[first_column + LOAD] = 0.03;
        for (knot, depth_m) in layout.knots_m.iter().enumerate() {
            unknowns[first_column + PROCESS_NOISE + knot] = profile.before(*depth_m) - 0.03;
        }
    }
    let depths_m = [0.0, 0.013, 0.035, 0.041, 0.08];
    let expected_m = forward_m(&path, loads, AWAY, 0.0, &depths_m);
    let basis = basis(&candidates, AWAY, [0.0; 2]);
    for (plane, expected_m) in expected_m.iter().enumerate() {
        for (depth_m, expected_m) in depths_m.iter().zip(expected_m) {
            let (row, guide2_m) = basis.row(plane, Measured::Position, *depth_m, false);
            let tip_m = guide2_m + row.iter().zip(&unknowns).map(|(row, unknown)| row * unknown).sum::<f64>();
            assert!((tip_m - expected_m).abs() < 2e-6, "{tip_m} is not {expected_m} at {depth_m}");
        }
    }
}

fn load_profile(plane: f64, knots_m: &[f64]) -> Profile {
    let knots = knots_m.iter().enumerate();
    Profile::new(knots.map(|(i, m)| [*m, 0.1 * plane + 0.01 * (i as f64 * plane).sin()]).collect())
        .expect("loads")
}

/// A little more modulus, or tissue that begins a little later, moves the tip as in the forward model.
#[test]
fn differences_of_one_insertion_are_those_of_the_forward_model() {
    let path = moved();
    let candidates = Candidates::new(&tissue(0.5), std::slice::from_ref(&path), 0.08).expect("candidates");
    let load_n = [0.2, -0.1];
    let basis = basis(&candidates, AWAY, load_n);
    // Depths away from the jumps, which a shift of depth moves.
    let depths_m = [0.012, 0.025, 0.055, 0.07];
    let baseline_m = forward_m(&path, constant_loads(load_n), AWAY, 0.0, &depths_m);
    let stiffer = Candidate { modulus_ln: AWAY.modulus_ln + 0.02, ..AWAY };
    let stiffer_m = forward_m(&path, constant_loads(load_n), stiffer, 0.0, &depths_m);
    for plane in 0..2 {
        let (_, first_column) = candidates.layout.place(plane);
        for (i, depth_m) in depths_m.into_iter().enumerate() {
            let (row, _) = basis.row(plane, Measured::Position, depth_m, false);
            let (difference_m, expected_m) =
                (0.02 * row[first_column + MODULUS], stiffer_m[plane][i] - baseline_m[plane][i]);
            assert!(
                (difference_m - expected_m).abs() < 2e-6,
                "{difference_m} is not {expected_m} at {depth_m}"
            );
        }
    }
    // No motion of guide 2 at a depth: what is done at rest would move with the surface in the forward model, and does
    // not for the recorded depth.
    let straight: Vec<[f64; 6]> = (0..=80).map(|mm| [f64::from(mm), 0.0, 0.0, 0.0, 0.0, 0.0]).collect();
    let path = TipPath::new(&run(&straight)).expect("an insertion");
    let candidates = Candidates::new(&tissue(0.5), std::slice::from_ref(&path), 0.08).expect("candidates");
    let basis = self::basis(&candidates, AWAY, load_n);
    let [baseline_m, later_m] =
        [0.0, 0.2e-3].map(|entry_m| forward_m(&path, constant_loads(load_n), AWAY, entry_m, &depths_m));
    for plane in 0..2 {
        let (_, first_column) = candidates.layout.place(plane);
        for (i, depth_m) in depths_m.into_iter().enumerate() {
            let (row, _) = basis.row(plane, Measured::Position, depth_m, false);
            let (difference_m, expected_m) =
                (0.2e-3 * row[first_column + ENTRY], later_m[plane][i] - baseline_m[plane][i]);
            assert!(
                (difference_m - expected_m).abs() < 2e-6,
                "{difference_m} is not {expected_m} at {depth_m}"
            );
        }
    }
}

fn constant_loads(load_n: [f64; 2]) -> [Profile; 2] {
    load_n.map(Profile::constant)
}

/// Load at any two knots covaries as a stationary process with exponential memory.
#[test]
fn the_process_noise_is_stationary() {
    let path =
        TipPath::new(&run(&[0.0, 20.0, 40.0, 60.0, 80.0].map(|d| [d, 0.0, 0.0, 0.0, 0.0, 0.0]))).expect("ok");
    let layout = Layout::new(&[path], 0.08, false);
    let scales = Scales::from_logarithms(
        &[0.0; COUNT],
        Known { noise: ReadingNoise::default(), rear_share: 0.0, load_n: 0.2 },
    );
    let map = scales.map(&layout, false);
    for [a_m, b_m] in [[0.0, 0.0], [0.0, 0.03], [0.015, 0.075], [0.075, 0.075]] {
        let expected = scales.process_noise_n[1].powi(2) * (-f64::abs(a_m - b_m) / scales.memory_m).exp();
        let correlation: f64 =
            load_row(a_m, &layout, &map).iter().zip(load_row(b_m, &layout, &map)).map(|(a, b)| a * b).sum();
        assert!(
            (correlation / expected - 1.0).abs() < 1e-9,
            "{correlation} is not {expected} between {a_m} and {b_m}"
        );
    }
}

/// Load at a depth by the process noise's standard normal numbers.
fn load_row(depth_m: f64, layout: &Layout, map: &scales::Map) -> Vec<f64> {
    let mut row: Vec<f64> = layout.load_row(0, depth_m).iter().copied().collect();
    row[LOAD] = 0.0;
    map.pull_back_rows(&mut row, 1, layout.of_plane());
    row
}

/// Modulus and surface are one for both planes, each of which has their prior: two that tell nothing leave it as it is, and the precisions of
/// two that tell something add up beside it.
#[test]
fn the_prior_of_what_both_planes_share_counts_once() {
    let straight: Vec<[f64; 6]> = (0..=80).map(|mm| [f64::from(mm), 0.0, 0.0, 0.0, 0.0, 0.0]).collect();
    let path = TipPath::new(&run(&straight)).expect("an insertion");
    let candidates = Candidates::new(&tissue(0.5), std::slice::from_ref(&path), 0.08).expect("candidates");
    assert_eq!(candidates.layout.systems(), 2);
    let scales = Scales::from_logarithms(
        &[0.0; COUNT],
        Known { noise: ReadingNoise::default(), rear_share: 0.0, load_n: 0.2 },
    );
    let empty_evidence = Evidence::new(&candidates.layout, &[], &scales, false).expect("a number");
    let basis = Arc::new(basis(&candidates, Candidate::default(), [0.0; 2]));
    let node = Node { candidate: Candidate::default(), gap_m: 0.02, basis };
    // Both planes with the variances of their priors times a share.
    let sds = |share: f64| {
        let mut normals = empty_evidence.next(&candidates.layout, &scales);
        normals.iter_mut().for_each(|normal| normal.covariance *= share);
        let mixture_part = Part { node: 0, scales: 0, ln_weight: 0.0, normals };
        let learned = Learned { scales: vec![scales], parts: vec![mixture_part], nodes: vec![node.clone()] };
        Posterior::new(&candidates, &learned).ln_modulus_factor_and_gap().map(|moments| moments.sd)
    };
    let priors = [scales.modulus_ln, scales.shared_and_own_entry_m() / 0.02];
    for share in [1.0, 0.5, 0.1] {
        for (found, prior) in sds(share).into_iter().zip(priors) {
            let expected = prior / (2.0 / share - 1.0f64).sqrt();
            assert!((found / expected - 1.0).abs() < 1e-6, "{found} is not {expected} at {share}");
        }
    }
}

/// Half turns mirror the load in its plane: they couple nothing.
#[test]
fn half_turns_leave_the_planes_apart() {
    assert_eq!(
        [180.0, -180.0, 360.0, 90.0].map(|degrees| {
            let path = TipPath::new(&run(&(0..=60)
                .map(|mm| [f64::from(mm), 0.0, 0.0, if mm > 30 { degrees } else { 0.0 }, 0.0, 0.0])
                .collect::<Vec<_>>()))
            .expect("an insertion");
            Layout::new(&[path], 0.06, false).coupled
        }),
        [false, false, false, true]
    );
}

/// Steps of guide 2 at depths that differ by less than any measurement resolves are at one depth: the beam stays solvable.
#[test]
fn rests_that_nearly_coincide_are_one() {
    let rows: Vec<[f64; 6]> = (0..=60)
        .flat_map(|mm| {
            let d = f64::from(mm);
            if mm % 5 == 0 {
                vec![
                    reading_row(d, 0.0),
                    reading_row(d + 1e-7, 0.2),
                    reading_row(d + 2e-7, 0.5),
                    reading_row(d + 3e-7, 0.0),
                ]
            } else {
                vec![reading_row(d, 0.0)]
            }
        })
        .collect();
    let path = TipPath::new(&run(&rows)).expect("an insertion");
    let candidates = Candidates::new(&tissue(0.5), std::slice::from_ref(&path), 0.06).expect("candidates");
    let nodes_m = candidates.nodes_m(0);
    assert!(nodes_m.windows(2).all(|pair| pair[1] - pair[0] > 0.05e-3));
}

fn reading_row(d: f64, guide: f64) -> [f64; 6] {
    [d, 0.0, 0.0, 0.0, guide, 0.0]
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
    assert_eq!(path.rows_skipped, 20);
    assert!(path.bins.iter().all(|bin| bin.depth_m < 0.063));
    let observed = path.until(0.03).expect("observed");
    assert!(observed.bins.iter().all(|bin| bin.depth_m <= 0.03));
    assert_eq!(observed.done, path.done);
}

#[test]
fn a_turn_and_a_push_at_rest_are_jumps() {
    let mut rows: Vec<[f64; 6]> = (0..=20).map(|mm| turned_row(f64::from(mm), 0.0, 0.0)).collect();
    // The guide moves at rest, step by step; then the needle is turned and advances.
    rows.extend([turned_row(20.0, 0.0, 0.4), turned_row(20.0, 0.0, 0.9), turned_row(20.0, 0.0, 1.0)]);
    rows.extend((21..=40).map(|mm| turned_row(f64::from(mm), 180.0, 1.0)));
    let path = TipPath::new(&run(&rows)).expect("an insertion");
    let [guide, _] = path.done.guide2_m.as_ref().expect("guide 2");
    assert_eq!(guide.jumps_m().collect::<Vec<_>>(), [0.02]);
    assert_eq!((guide.before(0.02), guide.after(0.02)), (0.0, 1e-3));
    assert_eq!(path.done.rotation_rad.jumps_m().collect::<Vec<_>>(), [0.02]);
    // Rows in the middle of the push count for nothing.
    assert_eq!(path.rows_skipped, 3, "{:?}", path.bins);
}

fn turned_row(d: f64, angle: f64, guide: f64) -> [f64; 6] {
    [d, 0.0, 0.0, angle, guide, 0.0]
}

#[test]
fn what_is_no_insertion_is_rejected() {
    assert!(rejection(&[10.0]).contains("1 of 1 rows advance into the tissue, expected 5 or more"));
    assert!(rejection(&[50.0, 40.0, 30.0, 20.0, 10.0, 5.0]).contains("of 6 rows advance"));
    assert!(rejection(&[10.0; 9]).contains("9 of 9 rows advance into the tissue"));
    assert!(rejection(&[0.0, 0.01, 0.02, 0.03, 1.04, 2.05]).contains("is this in millimetres?"));
    let path = TipPath::new(&run_at(&[0.0, 10.0, 20.0, 60.0, 70.0, 80.0])).expect("an insertion");
    assert_eq!(path.gaps_m.len(), 1);
    assert!(path.until(0.01).expect_err("too little").to_string().contains("2 depths up to 10 mm"));
}

fn rejection(list: &[f64]) -> String {
    TipPath::new(&run_at(list)).expect_err("no insertion").to_string()
}

fn run_at(list: &[f64]) -> InsertionRun {
    run(&list.iter().map(|d| [*d, 0.0, 0.0, 0.0, 0.0, 0.0]).collect::<Vec<_>>())
}

/// Readings one by one lead to the same posterior as their bins at once.
#[test]
fn live_and_recorded_agree() {
    let rows: Vec<[f64; 6]> =
        (0..=50).flat_map(|mm| [[f64::from(mm), 0.02 * f64::from(mm), 0.3, 0.0, 0.0, 0.0]; 3]).collect();
    let path = TipPath::new(&run(&rows)).expect("an insertion");
    let paths = [path];
    let candidates = Candidates::new(&tissue(0.5), &paths, 0.1).expect("candidates");
    let learned =
        learn(&candidates, &paths, &[], 0, ReadingNoise { position_m: 0.05e-3, ..ReadingNoise::default() });
    let mut recorded = Posterior::new(&candidates, &learned);
    recorded.update_all(&paths[0]);
    let mut live = OnlinePosterior::new(Posterior::new(&candidates, &learned));
    rows.iter().for_each(|row| live.push(1e-3 * row[0], [1e-3 * row[1], 1e-3 * row[2]]));
    for (a, b) in recorded.tip_m(&[0.1])[0].iter().zip(&live.posterior().tip_m(&[0.1])[0]) {
        assert!((a.mean - b.mean).abs() < 1e-9 && (a.sd - b.sd).abs() < 1e-9);
    }
}

/// One guide with a rear that is stiff in one plane and soft in the other, guide 2 moved at rest between nodes: position and direction of
/// the tip are those of the forward model, and so is what a little more of the rear does.
#[test]
fn the_design_of_one_guide_is_the_forward_model() {
    let rows: Vec<[f64; 6]> = (0..=80)
        .flat_map(|mm| {
            let d = f64::from(mm);
            let clamp_mm = if d > 30.0 { 1.5 } else { 0.0 };
            if mm == 30 {
                vec![held_row(30.0, 0.0), held_row(30.4, 0.0), held_row(30.4, 1.5)]
            } else {
                vec![held_row(d, clamp_mm)]
            }
        })
        .collect();
    let mut run = run(&rows);
    run.tip_direction_y_rad = Some(vec![0.0; rows.len()]);
    let path = TipPath::new(&run).expect("an insertion");
    let rig = Rig {
        needle: Needle::gauge_18(),
        guide2_m: 0.0,
        entry_m: 0.028,
        guides: one_guide([None; 2]),
        tolerances: mechanics::Tolerances::default(),
    };
    let model = Model::uniform(rig.clone(), 12e3).expect("a model");
    let rear = Rear { needle_n_m_per_rad: 1.1, middle: 0.4, sd: 0.3, unknown: [true; 2] };
    let tissue = Tissue { model, modulus_sd_ln: 0.5, gap_m: 0.028, gap_sd_ln: 0.5, rear: Some(rear) };
    let candidates = Candidates::new(&tissue, std::slice::from_ref(&path), 0.08).expect("candidates");
    let load_n = [0.2, -0.1];
    let depths =
        [(0.013, false), (0.0302, false), (0.0304, false), (0.0304, true), (0.035, false), (0.08, false)];
    let forward = |at: Candidate, depths: &[(f64, bool)]| {
        let stiffness = at.rear_share.map(|share| Some(rear.stiffness_n_m_per_rad(share)));
        let entry_m = 0.028 * at.gap_ln.exp();
        let rig = Rig { entry_m, guides: one_guide(stiffness), ..rig.clone() };
        let mut model = Model::uniform(rig, 12e3 * at.modulus_ln.exp()).expect("a model");
        model.tip = TipLaw::load(load_n);
        // Leaving a depth is arriving a hair beyond it.
        let depth_m = depths.iter().map(|(depth_m, leaving)| depth_m + if *leaving { 1e-7 } else { 0.0 });
        let insertion = Insertion { depth_m: depth_m.collect(), tip_direction: true, ..path.done.clone() };
        let channels = predict(&model, &Experiment::Insertion(insertion)).expect("predicts");
        [channels.tip_m, channels.tip_direction_rad].map(|series| [series.y, series.x.expect("two planes")])
    };
    let candidate = Candidate { modulus_ln: 0.11, gap_ln: -0.07, rear_share: [-0.33, 0.23] };
    let basis = basis(&candidates, candidate, load_n);
    let layout = &candidates.layout;
    let rear_column = layout.rear().expect("an unknown rear");
    let more = Candidate { rear_share: candidate.rear_share.map(|share| share + 0.02), ..candidate };
    let (base_path, changed_path) = (forward(candidate, &depths), forward(more, &depths));
    for (measured, within) in [(Measured::Position, 6e-6), (Measured::Direction, 1.5e-4)] {
        for plane in 0..2 {
            for (i, depth) in depths.into_iter().enumerate() {
                let tip_values =
                    tip_m(measured, plane, depth, candidate.rear_share[plane], &basis, load_n, rear_column);
                let expected = base_path[measured as usize][plane][i];
                assert!(
                    (tip_values - expected).abs() < within,
                    "{measured:?} {plane} at {depth:?}: {tip_values}, {expected}"
                );
                let change =
                    tip_m(measured, plane, depth, more.rear_share[plane], &basis, load_n, rear_column)
                        - tip_values;
                let expected = changed_path[measured as usize][plane][i] - expected;
                assert!(
                    (change - expected).abs() < 0.1 * within,
                    "{measured:?} {plane} {depth:?}: {change}, {expected}"
                );
            }
        }
    }
}

fn tip_m(
    measured: Measured,
    plane: usize,
    (depth_m, leaving): (f64, bool),
    share: f64,
    basis: &Basis,
    load_n: [f64; 2],
    rear_column: usize,
) -> f64 {
    let (row, offset) = basis.row(plane, measured, depth_m, leaving);
    offset + row[LOAD] * load_n[plane] + row[rear_column] * share
}

fn one_guide(stiffness: [Option<f64>; 2]) -> Guides {
    Guides::One { rear_rotation_n_m_per_rad: stiffness }
}

fn held_row(d: f64, held: f64) -> [f64; 6] {
    [d, 0.0, 0.0, 0.0, held, -0.5 * held]
}
