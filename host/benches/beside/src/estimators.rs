//! The recursive estimator, the prediction and the diagnosis.

use crate::clock::Clock;
use crate::forward::{Own, insertion_model};
use anyhow::{Context, Result};
use estimator::Sample;
use estimator::information::Information;
use formats::session::InsertionRun;
use inference::diagnose::{Options, diagnose};
use inference::insertion::{
    Candidates, Learned, OnlinePosterior, Posterior, ReadingNoise, TipPath, Tissue as InsertionTissue, learn,
};
use inference::track::method::{Method, samples};
use inference::track::online::{OnlineEstimator, settings};
use mechanics::growth::{GrowingBeam, Guide2Grip, NodeLoads};
use mechanics::insertion::grid_m;
use mechanics::{Dynamics, Needle, Rig};
use serde::Serialize;
use simulation::rig::steering::{Plan, Sensors, SteeringRig, Tissue, TissueLayer};
use std::hint::black_box;
use studies::diagnose::{Hidden, make};

/// Unknowns of the online estimator.
pub const UNKNOWNS: usize = 18;
const ROWS: usize = 1000;
const PRIOR_VARIANCE: f64 = 100.0;

/// Rows of least squares, for us and for the peers.
#[derive(Serialize)]
pub struct Rows {
    rows: Vec<Vec<f64>>,
    values: Vec<f64>,
    prior_variance: f64,
}

/// Rows with errors of one standard deviation or so.
pub fn rows(seed: u64) -> Rows {
    let mut state = seed;
    let mut random = || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 11) as f64 / (1_u64 << 53) as f64 - 0.5
    };
    let rows: Vec<Vec<f64>> = (0..ROWS).map(|_| (0..UNKNOWNS).map(|_| random()).collect()).collect();
    let values = rows.iter().map(|row| value_of(row) + random()).collect();
    Rows { rows, values, prior_variance: PRIOR_VARIANCE }
}

fn value_of(row: &[f64]) -> f64 {
    row.iter().enumerate().map(|(i, x)| x * (1.0 + i as f64)).sum::<f64>()
}

/// One row taken in by the information filter of the online estimator, and the estimate after it.
pub fn recursive(clock: &mut Clock, data: &Rows) -> Result<Own> {
    let rows: Vec<[f64; UNKNOWNS]> = data.rows.iter().map(|row| std::array::from_fn(|i| row[i])).collect();
    let work = || {
        let mut information = Information::<f64, UNKNOWNS>::none();
        for i in 0..UNKNOWNS {
            let mut row = [0.0; UNKNOWNS];
            row[i] = PRIOR_VARIANCE.sqrt().recip();
            information.add(row, 0.0);
        }
        let mut last = [0.0; UNKNOWNS];
        for (row, value) in rows.iter().zip(&data.values) {
            information.add(*row, *value);
            last = black_box(information.solve());
        }
        last.to_vec()
    };
    Ok(Own { result: work(), seconds: clock.seconds("recursive least squares", work)? / ROWS as f64 })
}

/// The needle and the rig of the steering run.
pub fn steered() -> (Rig, Dynamics) {
    let rig = Rig::two_guides(Needle::gauge_18(), 0.06, 0.07);
    let dynamics = Dynamics::steel(&rig.needle, 0.13, 0.3);
    (rig, dynamics)
}

/// Errors of its sensors.
pub const SENSORS: Sensors = Sensors { base_m: 2e-5, force_n: 0.05, tip_m: 2e-4 };

/// A whole steering run of 1001 samples: 80 mm at 4 mm/s, one every 20 ms.
pub fn steering(seed: u64) -> Result<Vec<Sample<f64>>> {
    let tissue = Tissue { layers: vec![layer(40.0, 1.5e4), layer(80.0, 4e4)], inclusions: Vec::new() };
    let plan = Plan {
        id: "s".to_owned(),
        speed_mm_s: 4.0,
        depth_mm: 80.0,
        lateral_mm: 20.0,
        straight_mm: 0.0,
        wobble_mm: 0.0,
        wobble_hz: 0.5,
        period_ms: 20.0,
        disturbances: 0,
    };
    let run = SteeringRig::new(steered().0, 0.13, 0.3, &tissue)?.carry_out(&plan)?.measure(SENSORS, seed, 0);
    Ok(samples(&run).collect())
}

fn layer(bottom_mm: f64, stiffness_n_per_m2: f64) -> TissueLayer {
    TissueLayer { bottom_mm, stiffness_n_per_m2, damping_n_s_per_m2: 1e3 }
}

/// The run through the online estimator; seconds per sample.
pub fn online(clock: &mut Clock, seed: u64) -> Result<f64> {
    let (rig, dynamics) = steered();
    let run = steering(seed)?;
    let start = settings::<f64>(&rig.needle, &dynamics)?;
    let seconds = clock.seconds("online estimator", || {
        let mut method = OnlineEstimator::new(start).expect("the layout fits");
        run.iter().filter_map(|sample| method.update(black_box(sample))).count()
    })?;
    Ok(seconds / run.len() as f64)
}

/// Size of the prediction, for the peer.
#[derive(Serialize)]
pub struct PredictionSize {
    /// Parts of the mixture.
    pub parts: usize,
    /// Different candidates of modulus and gap among them.
    pub candidates: usize,
    /// Unknowns of each.
    pub unknowns: usize,
    /// Depths at which the path is predicted.
    pub depths: usize,
}

/// Six insertions to 140 mm, a row per millimetre, with errors that repeat.
pub fn paths() -> Result<Vec<TipPath>> {
    let problem = insertion_model().problem(0.14)?;
    let growth = GrowingBeam::new(&problem, grid_m(0.14, 1e-3, &[]), Guide2Grip::Holding)?;
    (0..6)
        .map(|number| {
            let load_n = 0.2 + 0.01 * (3.0 * number as f64).sin();
            let states = growth.under_load(|_| NodeLoads { load_n: [load_n; 2], guide2_m: [0.0; 2] });
            let run = InsertionRun {
                id: format!("i{number}"),
                path: format!("i{number}.csv").into(),
                depth_m: growth.depths_m().to_vec(),
                tip_y_m: states
                    .iter()
                    .enumerate()
                    .map(|(row, state)| state.tip_m[0] + reading_error(row, number))
                    .collect(),
                tip_x_m: None,
                time_s: None,
                rotation_rad: None,
                guide2_y_m: None,
                guide2_x_m: None,
                base_force_y_n: None,
                tip_direction_y_rad: None,
                tip_direction_x_rad: None,
            };
            TipPath::new(&run).context("an insertion")
        })
        .collect()
}

fn reading_error(row: usize, number: usize) -> f64 {
    1e-4 * (2.0 * (row + 100 * number) as f64).sin()
}

/// One reading taken in, then the path to 140 mm with its band; seconds, and the size of it.
pub fn prediction(clock: &mut Clock) -> Result<(f64, PredictionSize)> {
    let paths = paths()?;
    let tissue = InsertionTissue {
        model: insertion_model(),
        modulus_sd_ln: 0.2,
        gap_m: 0.025,
        gap_sd_ln: 0.7,
        rear: None,
    };
    let candidates = Candidates::new(&tissue, &paths, 0.14)?;
    let learned: Learned = learn(
        &candidates,
        &paths,
        &[1, 2, 3, 4, 5],
        0,
        ReadingNoise { position_m: 1e-4, ..ReadingNoise::default() },
    );
    let mut followed = OnlinePosterior::new(Posterior::new(&candidates, &learned));
    for bin in paths[0].bins.iter().take_while(|bin| bin.depth_m < 0.0695) {
        followed.push(bin.depth_m, bin.tip_m);
    }
    let depths_m: Vec<f64> = (70..=140).map(|mm| 1e-3 * f64::from(mm)).collect();
    let seconds = clock.seconds("prediction", || {
        let mut live = followed.clone();
        live.push(0.07, black_box([2e-3, 0.0]));
        live.posterior().tip_m(&depths_m)
    })?;
    let [part_count, different] = learned.counts();
    let size = PredictionSize {
        parts: part_count,
        candidates: different,
        unknowns: candidates.layout.unknowns(),
        depths: depths_m.len(),
    };
    Ok((seconds, size))
}

/// The diagnosis of a session of nine runs that lacks an effect.
pub fn diagnosis(clock: &mut Clock) -> Result<f64> {
    let (session, _) = make(&Hidden::One("tissue.layers", 1), 1);
    clock.seconds_of_long("diagnosis", || {
        diagnose(black_box(&session), &Options::default(), |_| {}).map(|found| found.margin).ok()
    })
}
