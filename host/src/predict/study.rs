//! Monte Carlo study of the prediction, in the form of Table II of Paper A (Lehmann et al.): how far off the tip is at four
//! depths, predicted from 50 and from 70 mm, by the published method and by this one.
//!
//! The truth shares no code with the prediction: every depth is solved by the exact beam, the cut path is integrated against its
//! influence line in steps of a quarter of a millimetre, the tip load wanders as a stationary process (not as the random walk that
//! is assumed), and the modulus that the prediction is told is off by a standard deviation of 17 %, as identified ones are.

use super::{Options, predict};
use crate::inference::insertion::TipPath;
use crate::inference::insertion::published::published;
use crate::model::{Beam, Foundation, Model, Needle, Rig};
use crate::session::{InsertionRun, Noise, Session};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, Normal, Uniform};
use rayon::prelude::*;
use serde::Serialize;
use std::path::PathBuf;

/// Insertions of one session.
const INSERTIONS: usize = 6;
/// Depths of the table, mm.
pub const DEPTHS_MM: [usize; 4] = [80, 100, 120, 140];
/// Where the identification ends, mm.
pub const UNTIL_MM: [usize; 2] = [50, 70];
/// Standard deviation of the modulus that the prediction is told, as a share of the true one.
const MODULUS_SD: f64 = 0.17;
/// How far the effective gap is from the stated one (standard deviation of the logarithm), the needle's angle to the axis of depth
/// in all insertions of a session and in each, the tip load's wander about its mean and its memory.
const GAP_SD_LN: f64 = 0.3;
const SHARED_ANGLE_SD_RAD: f64 = 3e-3;
const ANGLE_SD_RAD: f64 = 2e-3;
const WANDER_SD: f64 = 0.15;
const MEMORY_M: f64 = 0.05;
const STEP_M: f64 = 0.25e-3;
pub(super) const STEPS_PER_MM: usize = 4;
const LAST_MM: usize = 140;

/// The methods compared.
pub const METHODS: [&str; 3] = ["published", "this insertion alone", "learned from the others"];

/// One cell of the table: one method at one depth.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Cell {
    /// Which method.
    pub method: &'static str,
    /// Where the identification ended.
    pub until_mm: usize,
    /// Where the prediction is judged.
    pub depth_mm: usize,
    /// Mean and standard deviation of the predicted tip, mm.
    pub predicted_mm: [f64; 2],
    /// Mean and standard deviation of the true tip, mm.
    pub true_mm: [f64; 2],
    /// Mean and standard deviation of the absolute error, mm.
    pub mae_mm: [f64; 2],
    /// Share of 95 % bands that hold what was measured; nothing where the method gives none.
    pub coverage: Option<f64>,
    /// Insertions behind it.
    pub count: usize,
}

/// Runs `sessions` sessions of six insertions each, on all cores; every session has its own stream of the seed.
///
/// # Errors
/// Where the model cannot be evaluated, which it can for these rigs.
pub fn study(sessions: usize, seed: u64) -> Result<Vec<Cell>, super::PredictError> {
    let mut samples: Vec<Vec<Sample>> = vec![Vec::new(); METHODS.len() * UNTIL_MM.len() * DEPTHS_MM.len()];
    let of_session = |number: usize| {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        rng.set_stream(number as u64);
        let drawn = draw(&mut rng)?;
        let mut placed = Vec::new();
        for (row, until_mm) in UNTIL_MM.into_iter().enumerate() {
            for (method, sample, insertion) in drawn.judge(until_mm)? {
                for (column, depth_mm) in DEPTHS_MM.into_iter().enumerate() {
                    let index = (method * UNTIL_MM.len() + row) * DEPTHS_MM.len() + column;
                    let true_mm = 1e3 * drawn.truth_m[insertion][depth_mm];
                    placed.push((index, Sample { true_mm, ..sample(depth_mm) }));
                }
            }
        }
        Ok(placed)
    };
    let of_sessions: Vec<Vec<(usize, Sample)>> =
        (0..sessions).into_par_iter().map(of_session).collect::<Result<_, super::PredictError>>()?;
    of_sessions.into_iter().flatten().for_each(|(index, sample)| samples[index].push(sample));
    let cells = samples.iter().enumerate().map(|(index, samples)| {
        let (row, column) = (index / DEPTHS_MM.len(), index % DEPTHS_MM.len());
        let (method, until) = (row / UNTIL_MM.len(), row % UNTIL_MM.len());
        let of = |value: &dyn Fn(&Sample) -> f64| mean_and_sd(samples.iter().map(value).collect());
        let held: Option<Vec<bool>> = samples.iter().map(|sample| sample.held).collect();
        Cell {
            method: METHODS[method],
            until_mm: UNTIL_MM[until],
            depth_mm: DEPTHS_MM[column],
            predicted_mm: of(&|s| s.predicted_mm),
            true_mm: of(&|s| s.true_mm),
            mae_mm: of(&|s| (s.predicted_mm - s.true_mm).abs()),
            coverage: held.map(|held| held.iter().filter(|held| **held).count() as f64 / held.len() as f64),
            count: samples.len(),
        }
    });
    Ok(cells.collect())
}

#[derive(Debug, Clone, Copy, Default)]
struct Sample {
    predicted_mm: f64,
    true_mm: f64,
    /// Whether the band holds what was measured.
    held: Option<bool>,
}

fn mean_and_sd(values: Vec<f64>) -> [f64; 2] {
    let count = values.len() as f64;
    let mean = values.iter().sum::<f64>() / count;
    let square: f64 = values.iter().map(|value| (value - mean).powi(2)).sum();
    [mean, (square / (count - 1.0).max(1.0)).sqrt()]
}

/// A session, what the prediction is told of its tissue, and the truth.
struct Drawn {
    session: Session,
    told_pa: f64,
    /// Tip position at every millimetre, per insertion.
    truth_m: Vec<Vec<f64>>,
}

type Judged<'a> = (usize, Box<dyn Fn(usize) -> Sample + 'a>, usize);

impl Drawn {
    /// Prediction of every method for every insertion, as functions of depth.
    fn judge(&self, until_mm: usize) -> Result<Vec<Judged<'_>>, super::PredictError> {
        let until_m = 1e-3 * until_mm as f64;
        let model = Model::uniform(self.session.rig.clone(), self.told_pa)?;
        let mut judged: Vec<Judged<'_>> = Vec::new();
        for (number, run) in self.session.insertion.iter().enumerate() {
            let seen = TipPath::new(run).and_then(|path| path.until(until_m));
            let Ok(seen) = seen else { continue };
            let found = published(&model, &seen, [0.0; 2], [0.03, until_m, 1e-3 * LAST_MM as f64])?;
            let path_m = found.tip_m.into_iter().next().unwrap_or_default();
            let sample =
                move |depth_mm: usize| Sample { predicted_mm: 1e3 * path_m[depth_mm], ..Sample::default() };
            judged.push((0, Box::new(sample), number));
        }
        for (method, learn) in [(1, false), (2, true)] {
            let modulus_pa = Some([self.told_pa, MODULUS_SD * self.told_pa]);
            let options = Options { until_m, learn, modulus_pa, ..Options::default() };
            for (number, result) in predict(&self.session, &options)?.insertions.into_iter().enumerate() {
                let sample = move |depth_mm: usize| Sample {
                    predicted_mm: result.tip_y_mm[depth_mm],
                    held: result.measured_y_mm[depth_mm].map(|measured_mm| {
                        (result.lo95_y_mm[depth_mm]..=result.hi95_y_mm[depth_mm]).contains(&measured_mm)
                    }),
                    ..Sample::default()
                };
                judged.push((method, Box::new(sample), number));
            }
        }
        Ok(judged)
    }
}

fn draw(rng: &mut ChaCha8Rng) -> Result<Drawn, super::PredictError> {
    let uniform = |least: f64, most: f64, rng: &mut ChaCha8Rng| {
        Uniform::new(least, most).map_or(least, |range| range.sample(rng))
    };
    let normal =
        |sd: f64, rng: &mut ChaCha8Rng| Normal::new(0.0, sd).map_or(0.0, |normal| normal.sample(rng));
    let guide2_m = 0.06;
    let gap_m = uniform(0.015, 0.045, rng);
    let rig = Rig::two_guides(Needle::gauge_18(), guide2_m, guide2_m + gap_m);
    let effective = Rig { entry_m: guide2_m + gap_m * normal(GAP_SD_LN, rng).exp(), ..rig.clone() };
    let shared_angle_rad = normal(SHARED_ANGLE_SD_RAD, rng);
    let modulus_pa = uniform(6e3, 18e3, rng);
    let told_pa = modulus_pa * normal(MODULUS_SD, rng).exp();
    let noise_m = uniform(0.05e-3, 0.2e-3, rng);
    let level_n = uniform(0.15, 0.25, rng);
    let lines = influence(&effective, modulus_pa, LAST_MM)?;
    let (mut recorded, mut truth_m) = (Vec::new(), Vec::new());
    for _ in 0..INSERTIONS {
        let angle_rad = shared_angle_rad + normal(ANGLE_SD_RAD, rng);
        let mean_n = level_n * (1.0 + normal(0.1, rng));
        let memory = (-STEP_M / MEMORY_M).exp();
        let mut wander = normal(WANDER_SD, rng);
        let load_n: Vec<f64> = (0..lines.len())
            .map(|_| {
                wander = memory * wander + normal(WANDER_SD * (1.0 - memory * memory).sqrt(), rng);
                mean_n * (1.0 + wander)
            })
            .collect();
        let straight = (0..=LAST_MM).map(|mm| angle_rad * 1e-3 * mm as f64);
        let cut_m = cut(&lines, modulus_pa, &load_n);
        let tip_m: Vec<f64> = cut_m
            .iter()
            .step_by(STEPS_PER_MM)
            .zip(straight)
            .map(|(u_m, straight_m)| u_m + straight_m)
            .collect();
        recorded.push((tip_m.iter().map(|u_m| u_m + normal(noise_m, rng)).collect(), None, None));
        truth_m.push(tip_m);
    }
    Ok(Drawn { session: insertion_session(rig, Some(noise_m), recorded), told_pa, truth_m })
}

/// Tip at every millimetre under a load given at every step, by the study's own solution.
#[cfg(test)]
pub(super) fn truth(
    rig: &Rig,
    modulus_pa: f64,
    last_mm: usize,
    load_n: impl Fn(usize) -> f64,
) -> Result<Vec<f64>, super::PredictError> {
    let lines = influence(rig, modulus_pa, last_mm)?;
    let load_n: Vec<f64> = (0..lines.len()).map(load_n).collect();
    Ok(cut(&lines, modulus_pa, &load_n).into_iter().step_by(STEPS_PER_MM).collect())
}

/// What one insertion recorded at every millimetre: vertical and horizontal tip, rotation.
type Recorded = (Vec<f64>, Option<Vec<f64>>, Option<Vec<f64>>);

/// A session of insertions recorded at every millimetre.
pub(super) fn insertion_session(rig: Rig, tip_sd_m: Option<f64>, recorded: Vec<Recorded>) -> Session {
    let run = |(number, (tip_y_m, tip_x_m, rotation_rad)): (usize, Recorded)| InsertionRun {
        id: format!("i{}", number + 1),
        path: PathBuf::from(format!("i{}.csv", number + 1)),
        depth_m: (0..tip_y_m.len()).map(|mm| 1e-3 * mm as f64).collect(),
        tip_y_m,
        tip_x_m,
        time_s: None,
        rotation_rad,
        guide2_y_m: None,
        guide2_x_m: None,
        base_force_y_n: None,
        tip_direction_y_rad: None,
        tip_direction_x_rad: None,
    };
    Session {
        dir: PathBuf::new(),
        name: None,
        rig,
        fixture_mass_kg: None,
        noise: Noise { tip_m: tip_sd_m, ..Noise::default() },
        tissue: Default::default(),
        lateral: Vec::new(),
        insertion: recorded.into_iter().enumerate().map(run).collect(),
        indentation: Vec::new(),
        steering: Vec::new(),
    }
}

/// At every step: shape of the needle inside the tissue, from the surface to the tip, under 1 N at the tip with guide 2 at zero.
/// By reciprocity this is also the tip's answer to a force anywhere along the needle.
fn influence(rig: &Rig, modulus_pa: f64, last_mm: usize) -> Result<Vec<Vec<f64>>, super::PredictError> {
    let foundation = Foundation::uniform(modulus_pa)?;
    let mut lines = Vec::new();
    for step in 0..=last_mm * STEPS_PER_MM {
        let beam = Beam::solve(rig, &foundation, STEP_M * step as f64)?;
        let (tip, guide) = (beam.tip_force(), beam.guide2_force());
        let held = tip.deflection_m(rig.guide2_m) / guide.deflection_m(rig.guide2_m);
        let line = (0..=step).map(|i| {
            let z_m = rig.entry_m + STEP_M * i as f64;
            tip.deflection_m(z_m) - held * guide.deflection_m(z_m)
        });
        lines.push(line.collect());
    }
    Ok(lines)
}

/// The path that a load cuts, by the trapezoidal rule with its newest end implicit.
fn cut(lines: &[Vec<f64>], modulus_pa: f64, load_n: &[f64]) -> Vec<f64> {
    let mut path_m: Vec<f64> = Vec::with_capacity(lines.len());
    for (line, load_n) in lines.iter().zip(load_n) {
        let compliance = line.last().copied().unwrap_or_default();
        let inner: f64 = line.iter().zip(&path_m).map(|(influence, u_m)| influence * u_m).sum();
        let first = line[0] * path_m.first().copied().unwrap_or_default();
        let springs = modulus_pa * STEP_M * (inner - 0.5 * first);
        let newest = if path_m.is_empty() { 0.0 } else { 0.5 * modulus_pa * STEP_M * compliance };
        path_m.push((load_n * compliance + springs) / (1.0 - newest));
    }
    path_m
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_table_does_not_depend_on_the_number_of_threads() {
        let on = |threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads");
            // Written out, numbers differ where any of their bits does.
            pool.install(|| format!("{:?}", study(2, 1).expect("a study")))
        };
        assert_eq!(on(1), on(4));
    }
}
