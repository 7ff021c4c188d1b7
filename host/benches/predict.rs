//! Speed of the prediction: the insertion model, learning from five insertions, and one step of the live form (a reading goes in, the
//! path to 140 mm with its band comes out), which has to keep up with a tracker at 100 Hz.

#![allow(dead_code, reason = "the modules are those of the page of benches, which says more of them")]

#[path = "beside/src/clock.rs"]
mod clock;
#[path = "beside/src/estimators.rs"]
mod estimators;
#[path = "beside/src/mechanics.rs"]
mod mechanics;

use criterion::Criterion;
use host::inference::insertion::{Belief, Candidates, Learned, Live, TipPath, Tissue, learn};
use host::model::growth::{Acting, DEFAULT_STEP_M, Growth, Guide2Grip};
use host::model::insertion::grid_m;
use mechanics::insertion_model as model;
use std::hint::black_box;

const READING_M: f64 = 0.1e-3;

fn learned(paths: &[TipPath]) -> (Candidates, Learned) {
    let tissue = Tissue { model: model(), modulus_sd_ln: 0.2, gap_m: 0.025, gap_sd_ln: 0.7 };
    let candidates = Candidates::new(&tissue, paths, 0.14).expect("candidates");
    let learned = learn(&candidates, paths, &[1, 2, 3, 4, 5], 0, READING_M);
    (candidates, learned)
}

fn main() {
    let mut criterion = Criterion::default().configure_from_args().sample_size(20);
    let problem = model().problem(0.14).expect("a problem");
    criterion.bench_function("insertion model, 140 mm in steps of 0.5 mm", |bencher| {
        bencher.iter(|| {
            let nodes_m = grid_m(0.14, DEFAULT_STEP_M, &[]);
            let growth = Growth::new(black_box(&problem), nodes_m, Guide2Grip::Holding).expect("grows");
            growth.under_load(|_| Acting { load_n: [0.2; 2], guide2_m: [0.0; 2] })
        });
    });
    let paths = estimators::paths().expect("insertions");
    criterion.bench_function("learn from five insertions", |bencher| {
        bencher.iter(|| learned(black_box(&paths)));
    });
    let (candidates, learned) = learned(&paths);
    let mut followed = Live::new(Belief::new(&candidates, 0, &learned));
    for bin in paths[0].bins.iter().take_while(|bin| bin.depth_m < 0.0695) {
        followed.push(bin.depth_m, bin.tip_m);
    }
    let depths_m: Vec<f64> = (70..=140).map(|mm| 1e-3 * f64::from(mm)).collect();
    criterion.bench_function("live: one reading, then the path to 140 mm", |bencher| {
        bencher.iter(|| {
            let mut live = followed.clone();
            live.push(0.07, black_box([2e-3, 0.0]));
            live.belief().tip_m(&depths_m)
        });
    });
    criterion.final_summary();
}
