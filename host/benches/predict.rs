//! Speed of the prediction: the insertion model, a whole session of twelve insertions on one core, learning from five insertions, and one step of the live form (a reading goes in, the
//! path to 140 mm with its band comes out), which has to keep up with a tracker at 100 Hz.

#![allow(dead_code, reason = "the modules are those of the page of benches, which uses more of them")]

#[path = "beside/src/clock.rs"]
mod clock;
#[path = "beside/src/estimators.rs"]
mod estimators;
#[path = "beside/src/forward.rs"]
mod forward;

use criterion::Criterion;
use formats::session::{InsertionRun, Noise, Session};
use forward::insertion_model as model;
use inference::insertion::{
    Candidates, Learned, OnlinePosterior, Posterior, ReadingNoise, TipPath, Tissue, learn,
};
use inference::predict::{Options, predict};
use mechanics::growth::{DEFAULT_STEP_M, GrowingBeam, Guide2Grip, NodeLoads};
use mechanics::insertion::grid_m;
use std::hint::black_box;

const READING_M: f64 = 0.1e-3;

fn learned(paths: &[TipPath]) -> (Candidates, Learned) {
    let tissue = Tissue { model: model(), modulus_sd_ln: 0.2, gap_m: 0.025, gap_sd_ln: 0.7, rear: None };
    let candidates = Candidates::new(&tissue, paths, 0.14).expect("candidates");
    let learned = learn(
        &candidates,
        paths,
        &[1, 2, 3, 4, 5],
        0,
        ReadingNoise { position_m: READING_M, ..ReadingNoise::default() },
    );
    (candidates, learned)
}

/// Twelve insertions to 120 mm in two planes, a row per millimetre, with errors that repeat.
fn session() -> Session {
    let model = model();
    let problem = model.problem(0.12).expect("a problem");
    let growth = GrowingBeam::new(&problem, grid_m(0.12, 1e-3, &[]), Guide2Grip::Holding).expect("grows");
    Session {
        dir: Default::default(),
        name: None,
        rig: model.rig.clone(),
        fixture_mass_kg: None,
        noise: Noise { tip_m: Some(0.05e-3), ..Noise::default() },
        tissue: Default::default(),
        lateral: Vec::new(),
        insertion: (0..12)
            .map(|number| {
                let tip_m = |plane: usize| {
                    let load_n = [0.2, 0.02][plane] * (1.0 + 0.03 * (3.0 * number as f64).sin());
                    let states = growth.under_load(|_| NodeLoads { load_n: [load_n; 2], guide2_m: [0.0; 2] });
                    let error = |row: usize| 7e-5 * (2.0 * (row + 131 * number + 57 * plane) as f64).sin();
                    states.iter().enumerate().map(|(row, state)| state.tip_m[0] + error(row)).collect()
                };
                InsertionRun {
                    tip_direction_y_rad: None,
                    tip_direction_x_rad: None,
                    id: format!("i{number}"),
                    path: format!("i{number}.csv").into(),
                    depth_m: growth.depths_m().to_vec(),
                    tip_y_m: tip_m(0),
                    tip_x_m: Some(tip_m(1)),
                    time_s: None,
                    rotation_rad: None,
                    guide2_y_m: None,
                    guide2_x_m: None,
                    base_force_y_n: None,
                }
            })
            .collect(),
        indentation: Vec::new(),
        steering: Vec::new(),
    }
}

fn main() {
    let mut criterion = Criterion::default().configure_from_args().sample_size(20);
    let problem = model().problem(0.14).expect("a problem");
    criterion.bench_function("insertion model, 140 mm in steps of 0.5 mm", |bencher| {
        bencher.iter(|| {
            let nodes_m = grid_m(0.14, DEFAULT_STEP_M, &[]);
            let growth = GrowingBeam::new(black_box(&problem), nodes_m, Guide2Grip::Holding).expect("grows");
            growth.under_load(|_| NodeLoads { load_n: [0.2; 2], guide2_m: [0.0; 2] })
        });
    });
    let whole = session();
    criterion.bench_function(
        "predict twelve insertions, each from the others and its first 50 mm",
        |bencher| {
            bencher.iter(|| predict(black_box(&whole), &Options::default()).expect("predicts"));
        },
    );
    let paths = estimators::paths().expect("insertions");
    criterion.bench_function("learn from five insertions", |bencher| {
        bencher.iter(|| learned(black_box(&paths)));
    });
    let (candidates, learned) = learned(&paths);
    let mut followed = OnlinePosterior::new(Posterior::new(&candidates, &learned));
    for bin in paths[0].bins.iter().take_while(|bin| bin.depth_m < 0.0695) {
        followed.push(bin.depth_m, bin.tip_m);
    }
    let depths_m: Vec<f64> = (70..=140).map(|mm| 1e-3 * f64::from(mm)).collect();
    criterion.bench_function("live: one reading, then the path to 140 mm", |bencher| {
        bencher.iter(|| {
            let mut live = followed.clone();
            live.push(0.07, black_box([2e-3, 0.0]));
            live.posterior().tip_m(&depths_m)
        });
    });
    criterion.final_summary();
}
