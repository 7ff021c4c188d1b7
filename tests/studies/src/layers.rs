//! Monte Carlo study of tracking through two layers whose boundary lies anywhere: is it found, and do the intervals have their stated coverage?
//!
//! Tissue of two layers, each uniform, boundary between 15 and 65 % of the depth, at all speeds and motions of [`track`](crate::track);
//! runs go through the workflow of `guide track` as a user's do.

use crate::track::{MOTIONS, Motion, SPEEDS_MM_S, TIP_SD_MM};
use formats::session::{Noise, Session};
use inference::track::{Options, TrackError, track};
use mechanics::{Needle, Rig};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use simulation::rig::steering::{Plan, Sensors, SteeringRig, Tissue, TissueLayer};

const LENGTH_M: f64 = 0.13;
const FIXTURE_KG: f64 = 0.3;
const DEPTH_MM: f64 = 80.0;
/// Shares of the depth between which boundaries are drawn.
const BOUNDARY: [f64; 2] = [0.15, 0.65];
/// Found is a boundary that is reported within so much of the truth.
const NEAR_MM: f64 = 3.0;
/// Layers that differ by less than this factor have no boundary worth the name.
const DISTINCT: f64 = 1.5;
/// Values are judged from this depth of sideways motion on.
const JUDGED_MM: f64 = 10.0;

/// Counts over the runs of one motion.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Row {
    /// Motion of the needle.
    pub motion: &'static str,
    /// Runs.
    pub runs: usize,
    /// Results of runs whose layers differ by half or more: boundary reported, within 3 mm, in its interval; and their
    /// number.
    pub boundary: [usize; 4],
    /// Intervals of the mean stiffness, of the mean damping and of the stiffness of cells that hold the truth, and their number.
    pub held: [[usize; 2]; 3],
    /// Root mean square relative error of the mean stiffness at the end.
    pub stiffness_rms: f64,
}

/// Runs `runs` of every motion.
///
/// # Errors
/// [`TrackError`] where the model cannot be evaluated, which it can for these rigs.
pub fn layers_study(runs: usize, seed: u64) -> Result<Vec<Row>, TrackError> {
    MOTIONS.iter().map(|motion| of_motion(*motion, runs, seed)).collect()
}

fn of_motion(motion: Motion, runs: usize, seed: u64) -> Result<Row, TrackError> {
    let mut row = Row { motion: motion.name, runs, ..Row::default() };
    let mut squares = 0.0;
    for number in 0..runs {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        random.set_stream(number as u64);
        let mut log_uniform = |low: f64, high: f64| low * (high / low).powf(random.random::<f64>());
        let boundary_mm = DEPTH_MM
            * (BOUNDARY[0] + (BOUNDARY[1] - BOUNDARY[0]) * log_uniform(1.0, std::f64::consts::E).ln());
        let mut layer = |bottom_mm: f64| TissueLayer {
            bottom_mm,
            stiffness_n_per_m2: log_uniform(8e3, 5e4),
            damping_n_s_per_m2: log_uniform(2e2, 3e3),
        };
        let tissue = Tissue { layers: vec![layer(boundary_mm), layer(DEPTH_MM)], inclusions: Vec::new() };
        let tip_sd_mm = TIP_SD_MM[number % 2];
        let run = simulated(&tissue, motion, SPEEDS_MM_S[number % 3], tip_sd_mm, seed, number as u64)?;
        let tracked = track(&run, &Options::default())?;
        let Some(result) = tracked.runs.first() else { continue };
        let [upper, lower] = [0, 1].map(|i| tissue.layers[i].stiffness_n_per_m2);
        let layers = result.layers.as_ref();
        if (lower / upper).ln().abs() >= DISTINCT.ln() {
            row.boundary[3] += 1;
            let reported = layers.and_then(|layers| layers.boundary_mm.zip(layers.boundary_ci95_mm));
            if let Some((interval_mm, [low_mm, high_mm])) = reported {
                row.boundary[0] += 1;
                row.boundary[1] += usize::from((interval_mm - boundary_mm).abs() <= NEAR_MM);
                row.boundary[2] += usize::from((low_mm..=high_mm).contains(&boundary_mm));
            }
        }
        let mut count = |of: usize, low: f64, high: f64, truth: f64| {
            row.held[of][0] += usize::from((low..=high).contains(&truth));
            row.held[of][1] += 1;
        };
        for (index, depth_mm) in result.depth_mm.iter().enumerate() {
            if *depth_mm <= motion.straight_mm + JUDGED_MM {
                continue;
            }
            let [stiffness, damping] = tissue.mean(1e-3 * depth_mm);
            let low_high = [result.stiffness_lo95_n_per_m2[index], result.stiffness_hi95_n_per_m2[index]];
            count(0, low_high[0], low_high[1], stiffness);
            let low_high = [result.damping_lo95_n_s_per_m2[index], result.damping_hi95_n_s_per_m2[index]];
            count(1, low_high[0], low_high[1], damping);
        }
        if let Some(field) = &result.field {
            for (index, depth_mm) in field.depth_mm.iter().enumerate() {
                let truth = if *depth_mm < boundary_mm { upper } else { lower };
                count(2, field.lo95_n_per_m2[index], field.hi95_n_per_m2[index], truth);
            }
        }
        let last =
            result.last.as_ref().and_then(|last| Some((last.depth_mm, last.stiffness_n_per_m2.value?)));
        squares +=
            last.map_or(0.0, |(depth_mm, value)| (value / tissue.mean(1e-3 * depth_mm)[0] - 1.0).powi(2));
    }
    row.stiffness_rms = (squares / runs.max(1) as f64).sqrt();
    Ok(row)
}

/// A session of one run, its noise stated.
fn simulated(
    tissue: &Tissue,
    motion: Motion,
    speed_mm_s: f64,
    tip_sd_mm: f64,
    seed: u64,
    number: u64,
) -> Result<Session, TrackError> {
    let mut needle = Needle::gauge_18();
    needle.length_m = Some(LENGTH_M);
    let rig = Rig::two_guides(needle, 0.06, 0.07);
    let steering = SteeringRig::new(rig.clone(), LENGTH_M, FIXTURE_KG, tissue)?;
    let plan = Plan {
        id: format!("run-{number}"),
        speed_mm_s,
        depth_mm: DEPTH_MM,
        lateral_mm: 20.0,
        straight_mm: motion.straight_mm,
        wobble_mm: motion.wobble_mm,
        wobble_hz: 0.5,
        period_ms: 20.0,
        disturbances: 0,
    };
    let sensors = Sensors { base_m: 0.02e-3, force_n: 0.05, tip_m: 1e-3 * tip_sd_mm };
    let run = steering.carry_out(&plan)?.measure(sensors, seed, number);
    Ok(Session {
        dir: "simulated".into(),
        name: None,
        rig,
        fixture_mass_kg: Some(FIXTURE_KG),
        noise: Noise {
            force_n: Some(sensors.force_n),
            displacement_m: Some(sensors.base_m),
            tip_m: Some(sensors.tip_m),
            ..Noise::default()
        },
        tissue: Default::default(),
        lateral: Vec::new(),
        insertion: Vec::new(),
        indentation: Vec::new(),
        steering: vec![run],
    })
}
