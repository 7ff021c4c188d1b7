//! Limits that matter: needles tied to their path, with limits as stated and halved, to targets that they can reach and to such as another needle of the same
//! prior can reach.

use super::DEPTH_MM;
use rayon::prelude::*;
use steering::{Options, Outcome, PlantError, SteerError, steer};
use worlds::steering::{SimulatedPlant, TiedNeedle, Tissues, far_target, tied_sibling, tied_world};

/// Share of its limits within which a needle has reached its target.
const SHARE: f64 = 0.8;

/// Limit that is half of its usual value.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Halved {
    /// None.
    None,
    /// Bending strain of the needle.
    Strain,
    /// Force of guide 2.
    Force,
    /// Travel of guide 2.
    Travel,
    /// Speed of guide 2.
    Speed,
    /// All of these.
    All,
}

impl Halved {
    /// All.
    pub const ALL: [Self; 6] = [Self::None, Self::Strain, Self::Force, Self::Travel, Self::Speed, Self::All];

    /// Name in tables.
    pub fn name(self) -> &'static str {
        match self {
            Self::None => "as stated",
            Self::Strain => "strain halved",
            Self::Force => "force halved",
            Self::Travel => "travel halved",
            Self::Speed => "speed halved",
            Self::All => "all halved",
        }
    }

    fn apply(self, plant: &mut SimulatedPlant<TiedNeedle>) {
        let limits = &mut plant.stated.limits;
        if self.is_halved(Self::Strain) {
            limits.needle_strain = limits.needle_strain.map(|strain| 0.5 * strain);
        }
        if self.is_halved(Self::Force) {
            limits.guide_force_n = limits.guide_force_n.map(|n| 0.5 * n);
        }
        if self.is_halved(Self::Travel) {
            limits.guide_travel_mm *= 0.5;
        }
        if self.is_halved(Self::Speed) {
            limits.guide_speed_mm_s *= 0.5;
        }
    }

    fn is_halved(self, one: Self) -> bool {
        self == one || self == Self::All
    }
}

/// Whose run has ended at the target.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Target {
    /// The needle's own, within 0.8 of its limits.
    Own,
    /// Move for another needle of the same prior: this one may not reach it.
    Other,
}

/// One run.
#[derive(Debug, Clone, PartialEq)]
pub struct LimitedRun {
    /// Miss, mm; nothing where the run was refused or ended by a fault.
    pub miss_mm: Option<f64>,
    /// Refused before the first push.
    pub refused: bool,
    /// Stopped, or ended by a fault.
    pub stopped: bool,
    /// Limits exceeded.
    pub broken: u64,
    /// Radius, mm, and probability of a smaller miss, as stated before the first push.
    pub stated: Vec<[f64; 2]>,
    /// Whether a decision has named what limits it.
    pub named: bool,
    /// Number of decisions that a limit has changed.
    pub limited_stops: usize,
    /// Largest strain of the needle and force of guide 2, as shares of their limits.
    pub peak_shares: [Option<f64>; 2],
    /// Replans of the run, s: median and slowest.
    pub replans_s: [f64; 2],
}

/// Runs `count` needles.
///
/// # Errors
/// None that a simulated plant has.
pub fn limited(
    tissues: Tissues,
    halved: Halved,
    target: Target,
    count: u64,
    seed: u64,
) -> Result<Vec<LimitedRun>, PlantError> {
    (0..count)
        .into_par_iter()
        .map(|number| {
            let mut plant = tied_world(tissues, seed, number);
            halved.apply(&mut plant);
            let target_mm = match target {
                Target::Own => far_target(&plant, SHARE, DEPTH_MM, seed, number)?,
                Target::Other => {
                    let mut sibling = tied_sibling(tissues, seed, number, 1);
                    halved.apply(&mut sibling);
                    far_target(&sibling, SHARE, DEPTH_MM, seed, number)?
                }
            };
            let limits = plant.stated.limits.clone();
            match steer(&mut plant, &Options::new(target_mm), &mut |_| {}) {
                Ok(run) => {
                    let refused = matches!(run.outcome, Outcome::Refused { .. });
                    Ok(LimitedRun {
                        miss_mm: run.miss_mm.filter(|_| !refused),
                        refused,
                        stopped: matches!(run.outcome, Outcome::Stopped { .. }),
                        broken: run
                            .end
                            .as_ref()
                            .and_then(|end| end.limits_broken)
                            .map_or(0, |broken| broken.total()),
                        stated: run
                            .within_before
                            .iter()
                            .map(|one| [one.radius_mm, one.probability])
                            .collect(),
                        named: run.decisions.iter().any(|one| one.limits.is_some()),
                        limited_stops: run.decisions.iter().filter(|one| one.limits.is_some()).count(),
                        peak_shares: run.end.as_ref().map_or([None; 2], |end| {
                            let share = |(peak, limit): (f64, f64)| peak / limit;
                            [
                                end.peak_strain.zip(limits.needle_strain).map(share),
                                end.peak_force_n.zip(limits.guide_force_n).map(share),
                            ]
                        }),
                        replans_s: [run.median_replan_s, run.slowest_replan_s],
                    })
                }
                Err(SteerError::Plant(error)) => Err(error),
                Err(_) => Ok(LimitedRun {
                    miss_mm: None,
                    refused: false,
                    stopped: true,
                    broken: 0,
                    stated: Vec::new(),
                    named: true,
                    limited_stops: 0,
                    peak_shares: [None; 2],
                    replans_s: [0.0; 2],
                }),
            }
        })
        .collect()
}

/// A radius in millimetres with the probability that was stated for it, and what a run missed by.
type Judged = ([f64; 2], f64);

/// A row of the table, and below it what was stated and observed.
pub fn row(tissues: Tissues, halved: Halved, target: Target, runs: &[LimitedRun]) -> String {
    let mut misses: Vec<f64> = runs.iter().filter_map(|run| run.miss_mm).collect();
    misses.sort_by(f64::total_cmp);
    format!(
        "| {} | {} | {} | {:.2} | {:.2} | {:.2} | {:.1} % | {} | {} | {} | {} | {}, {}, {} |",
        if tissues == Tissues::Plain { "plain" } else { "standard" },
        halved.name(),
        if target == Target::Own { "own" } else { "other's" },
        misses.iter().sum::<f64>() / misses.len().max(1) as f64,
        quantile(0.5, &misses),
        quantile(0.95, &misses),
        100.0 * misses.iter().filter(|mm| **mm > 2.0).count() as f64 / misses.len().max(1) as f64,
        runs.iter().filter(|run| run.refused).count(),
        runs.iter().filter(|run| run.stopped).count(),
        runs.iter().filter(|run| misses_in_silence(run)).count(),
        runs.iter().filter(|run| run.broken > 0).count(),
        calibration(0, runs),
        calibration(1, runs),
        calibration(2, runs)
    )
}

fn misses_in_silence(run: &LimitedRun) -> bool {
    run.miss_mm.is_some_and(|mm| mm > 0.5) && !run.named && !run.stopped
}

fn calibration(i: usize, runs: &[LimitedRun]) -> String {
    let stated_and_miss: Vec<Judged> =
        runs.iter().filter_map(|run| Some((*run.stated.get(i)?, run.miss_mm?))).collect();
    let observed =
        mean_percent(|([radius_mm, _], miss_mm)| f64::from(u8::from(miss_mm <= radius_mm)), &stated_and_miss);
    format!("{:.0} / {observed:.0}", mean_percent(|([_, stated], _)| *stated, &stated_and_miss))
}

fn mean_percent(value: fn(&Judged) -> f64, stated_and_miss: &[([f64; 2], f64)]) -> f64 {
    100.0 * stated_and_miss.iter().map(value).sum::<f64>() / stated_and_miss.len().max(1) as f64
}

fn quantile(share: f64, misses: &[f64]) -> f64 {
    let quantile_index = (share * misses.len().saturating_sub(1) as f64).round() as usize;
    misses.get(quantile_index).copied().unwrap_or(f64::NAN)
}
