//! Monte Carlo study of the prediction, in the form of Table II of Paper A (Lehmann et al.): how far off the tip is at four
//! depths, predicted from 50 and from 70 mm, by the published method and by this one.
//!
//! The truth shares no code with the prediction: every depth is solved by the exact beam, the cut path is integrated against its
//! influence line in steps of a quarter of a millimetre, the tip load varies as a stationary process (not as the random walk that
//! is assumed), and the modulus that the prediction is given is off by a standard deviation of 17 %, as identified ones are.

use formats::session::Session;
use inference::insertion::TipPath;
use inference::insertion::published::published;
use inference::predict::{Options, PredictError, predict};
use mechanics::{Model, Needle, Rig};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use serde::Serialize;
use worlds::random::normal;
use worlds::reciprocal::{STEP_M, STEPS_PER_MM, cut, influence, insertion_session};

/// Insertions of one session.
const INSERTIONS: usize = 6;
/// Depths of the table, mm.
pub const DEPTHS_MM: [usize; 4] = [80, 100, 120, 140];
/// Depths at which the identification ends, mm.
pub const UNTIL_MM: [usize; 2] = [50, 70];
/// Standard deviation of the modulus that the prediction is given, as a share of the true one.
const MODULUS_SD: f64 = 0.17;
/// Standard deviation of the logarithm of the ratio of effective to stated gap, the needle's angle to the axis of depth
/// in all insertions of a session and in each, the tip load's
const GAP_SD_LN: f64 = 0.3;
const SHARED_ANGLE_SD_RAD: f64 = 3e-3;
const ANGLE_SD_RAD: f64 = 2e-3;
const LOAD_SD: f64 = 0.15;
const MEMORY_M: f64 = 0.05;
const LAST_MM: usize = 140;

/// The methods compared.
pub const METHODS: [&str; 3] = ["published", "this insertion alone", "learned from the others"];

/// One cell of the table: one method at one depth.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Cell {
    /// Name of the method.
    pub method: &'static str,
    /// Depth at which the identification ended.
    pub until_mm: usize,
    /// Depth at which the prediction is judged.
    pub depth_mm: usize,
    /// Mean and standard deviation of the predicted tip, mm.
    pub predicted_mm: [f64; 2],
    /// Mean and standard deviation of the true tip, mm.
    pub true_mm: [f64; 2],
    /// Mean and standard deviation of the absolute error, mm.
    pub mae_mm: [f64; 2],
    /// Share of 95 % bands that hold what was measured; `None` where the method gives none.
    pub coverage: Option<f64>,
    /// Insertions behind it.
    pub count: usize,
}

/// Runs `sessions` sessions of six insertions each, on all cores; every session has its own stream of the seed.
///
/// # Errors
/// Where the model cannot be evaluated, which it can for these rigs.
pub fn study(sessions: usize, seed: u64) -> Result<Vec<Cell>, PredictError> {
    let mut samples: Vec<Vec<Sample>> = vec![Vec::new(); METHODS.len() * UNTIL_MM.len() * DEPTHS_MM.len()];
    let of_sessions: Vec<Vec<(usize, Sample)>> = (0..sessions)
        .into_par_iter()
        .map(|number| {
            let mut rng = ChaCha8Rng::seed_from_u64(seed);
            rng.set_stream(number as u64);
            let drawn = draw(&mut rng)?;
            let mut placed_samples = Vec::new();
            for (row, until_mm) in UNTIL_MM.into_iter().enumerate() {
                for (method, sample, insertion) in drawn.judge(until_mm)? {
                    for (column, depth_mm) in DEPTHS_MM.into_iter().enumerate() {
                        let index = (method * UNTIL_MM.len() + row) * DEPTHS_MM.len() + column;
                        let true_mm = 1e3 * drawn.truth_m[insertion][depth_mm];
                        placed_samples.push((index, Sample { true_mm, ..sample(depth_mm) }));
                    }
                }
            }
            Ok(placed_samples)
        })
        .collect::<Result<_, PredictError>>()?;
    of_sessions.into_iter().flatten().for_each(|(index, sample)| samples[index].push(sample));
    let cells = samples.iter().enumerate().map(|(index, samples)| {
        let (row, column) = (index / DEPTHS_MM.len(), index % DEPTHS_MM.len());
        let (method, until_index) = (row / UNTIL_MM.len(), row % UNTIL_MM.len());
        let covered: Option<Vec<bool>> = samples.iter().map(|sample| sample.held).collect();
        Cell {
            method: METHODS[method],
            until_mm: UNTIL_MM[until_index],
            depth_mm: DEPTHS_MM[column],
            predicted_mm: mean_of(&|s| s.predicted_mm, samples),
            true_mm: mean_of(&|s| s.true_mm, samples),
            mae_mm: mean_of(&|s| (s.predicted_mm - s.true_mm).abs(), samples),
            coverage: covered.map(|covered| {
                covered.iter().filter(|covered| **covered).count() as f64 / covered.len() as f64
            }),
            count: samples.len(),
        }
    });
    Ok(cells.collect())
}

fn mean_of(value: &dyn Fn(&Sample) -> f64, samples: &[Sample]) -> [f64; 2] {
    mean_and_sd(samples.iter().map(value).collect())
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

/// A session, the modulus that the prediction is given, and the truth.
struct Drawn {
    session: Session,
    given_pa: f64,
    /// Tip position at every millimetre, per insertion.
    truth_m: Vec<Vec<f64>>,
}

type Judged<'a> = (usize, Box<dyn Fn(usize) -> Sample + 'a>, usize);

impl Drawn {
    /// Prediction of every method for every insertion, as functions of depth.
    fn judge(&self, until_mm: usize) -> Result<Vec<Judged<'_>>, PredictError> {
        let limit_m = 1e-3 * until_mm as f64;
        let model = Model::uniform(self.session.rig.clone(), self.given_pa)?;
        let mut judged: Vec<Judged<'_>> = Vec::new();
        for (number, run) in self.session.insertion.iter().enumerate() {
            let tracked = TipPath::new(run).and_then(|path| path.until(limit_m));
            let Ok(tracked) = tracked else { continue };
            let baseline = published(&model, &tracked, [0.0; 2], [0.03, limit_m, 1e-3 * LAST_MM as f64])?;
            let path_m = baseline.tip_m.into_iter().next().unwrap_or_default();
            judged.push((
                0,
                Box::new(move |depth_mm: usize| Sample {
                    predicted_mm: 1e3 * path_m[depth_mm],
                    ..Sample::default()
                }),
                number,
            ));
        }
        for (method, learn) in [(1, false), (2, true)] {
            let modulus_pa = Some([self.given_pa, MODULUS_SD * self.given_pa]);
            let options = Options { until_m: limit_m, learn, modulus_pa, ..Options::default() };
            for (number, result) in predict(&self.session, &options)?.insertions.into_iter().enumerate() {
                judged.push((
                    method,
                    Box::new(move |depth_mm: usize| Sample {
                        predicted_mm: result.tip_y_mm[depth_mm],
                        held: result.measured_y_mm[depth_mm].map(|measured_mm| {
                            (result.lo95_y_mm[depth_mm]..=result.hi95_y_mm[depth_mm]).contains(&measured_mm)
                        }),
                        ..Sample::default()
                    }),
                    number,
                ));
            }
        }
        Ok(judged)
    }
}

fn draw(rng: &mut ChaCha8Rng) -> Result<Drawn, PredictError> {
    let guide2_m = 0.06;
    let gap_m = rng.random_range(0.015..0.045);
    let rig = Rig::two_guides(Needle::gauge_18(), guide2_m, guide2_m + gap_m);
    let effective = Rig { entry_m: guide2_m + gap_m * (GAP_SD_LN * normal(rng)).exp(), ..rig.clone() };
    let shared_angle_rad = SHARED_ANGLE_SD_RAD * normal(rng);
    let modulus_pa = rng.random_range(6e3..18e3);
    let stated_modulus_pa = modulus_pa * (MODULUS_SD * normal(rng)).exp();
    let noise_m = rng.random_range(0.05e-3..0.2e-3);
    let level_n = rng.random_range(0.15..0.25);
    let lines = influence(&effective, modulus_pa, LAST_MM)?;
    let (mut recorded, mut truth_m) = (Vec::new(), Vec::new());
    for _ in 0..INSERTIONS {
        let angle_rad = shared_angle_rad + ANGLE_SD_RAD * normal(rng);
        let mean_n = level_n * (1.0 + 0.1 * normal(rng));
        let memory = (-STEP_M / MEMORY_M).exp();
        let mut variation = LOAD_SD * normal(rng);
        let load_n: Vec<f64> = (0..lines.len())
            .map(|_| {
                variation = memory * variation + LOAD_SD * (1.0 - memory * memory).sqrt() * normal(rng);
                mean_n * (1.0 + variation)
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
        recorded.push((tip_m.iter().map(|u_m| u_m + noise_m * normal(rng)).collect(), None, None));
        truth_m.push(tip_m);
    }
    Ok(Drawn {
        session: insertion_session(rig, Some(noise_m), recorded),
        given_pa: stated_modulus_pa,
        truth_m,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_table_does_not_depend_on_the_number_of_threads() {
        assert_eq!(study_on(1), study_on(4));
    }

    fn study_on(threads: usize) -> String {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads");
        // Written out, numbers differ where any of their bits does.
        pool.install(|| format!("{:?}", study(2, 1).expect("a study")))
    }

    /// The table of the study on a few sessions: better than the published method, bands that hold. `cargo xtask study insertion`
    /// prints the whole.
    #[test]
    fn the_study_holds_on_a_few_sessions() {
        let cells = study(4, 1).expect("a study");
        let (published, learned) = (mean_error_mm(METHODS[0], &cells), mean_error_mm(METHODS[2], &cells));
        assert!(learned < 0.75 * published, "{learned} mm against {published} mm");
        assert!(mean_error_mm(METHODS[1], &cells) < published);
        let coverages: Vec<f64> = cells.iter().filter_map(|cell| cell.coverage).collect();
        let mean_coverage = coverages.iter().sum::<f64>() / coverages.len() as f64;
        assert!((0.88..=1.0).contains(&mean_coverage), "{mean_coverage}");
    }

    fn mean_error_mm(method: &str, cells: &[Cell]) -> f64 {
        let errors_mm: Vec<f64> =
            cells.iter().filter(|cell| cell.method == method).map(|cell| cell.mae_mm[0]).collect();
        errors_mm.iter().sum::<f64>() / errors_mm.len() as f64
    }
}
