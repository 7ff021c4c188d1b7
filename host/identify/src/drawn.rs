//! Draws from the posterior of an identification: of the moduli that it states, with the readings that the fit beside the discrepancy
//! predicts.
//!
//! The pooled modulus is drawn with the parameters and readings of that fit; Young's modulus with it too, by a relation or as that of the
//! body. Each interval that is printed is the distribution of its draws: on the scale of the logarithm, normal on both sides of the value
//! with the ends of the interval, also where it is one by Student's t.

use super::model_error::DiscrepancyFits;
use super::{NORMAL_975, Pooled, RunResult, YoungsModulus};
use diagnose::ModulusDraws;
use mechanics::Support;
use readings::draws::{DrawOptions, Draws, Group, Random, two_piece};

/// Stream of random numbers of the moduli of single runs, and of those that no fit beside the discrepancy gives.
const RUNS: u64 = 11;
const ALONE: u64 = 12;

/// Stated result.
pub(super) struct Stated<'a> {
    pub runs: &'a [RunResult],
    pub pooled: &'a Pooled,
    pub youngs: &'a YoungsModulus,
    /// The foundation in use.
    pub used: &'static str,
}

impl Stated<'_> {
    /// Draws of all of it.
    pub fn draws(&self, beside: Option<Result<DiscrepancyFits, String>>, options: DrawOptions) -> Draws {
        let is_springs = self.used == Support::Springs.name();
        let (fits, why) = match beside {
            Some(Ok(fits)) => (fits.draws, String::new()),
            Some(Err(why)) => (None, why),
            None => (None, "without model error".to_owned()),
        };
        let (k_draws, of_youngs, mut draws) = match fits {
            Some((springs, Some(body))) if !is_springs => (springs.standard_ln, body.standard_ln, body.draws),
            Some((ModulusDraws { standard_ln, draws }, _)) => (standard_ln.clone(), standard_ln, draws),
            None => {
                let mut draws = Draws::new(options, "guide identify");
                draws.attribute("readings", format!("not predicted: {why}"));
                (standard_draws(options), standard_draws(options), draws)
            }
        };
        let k = two_piece_draws(self.pooled.k_kpa, self.pooled.ci95_kpa, &k_draws);
        draws.scalar(Group::Posterior, "k_kpa", k);
        if let (Some(value), Some(ci95)) = (self.youngs.value, self.youngs.ci95) {
            draws.scalar(Group::Posterior, "youngs_modulus_kpa", two_piece_draws(value, ci95, &of_youngs));
        }
        let runs: Vec<(String, f64, [f64; 2])> = self
            .runs
            .iter()
            .filter_map(|run| {
                let likelihood = &run.methods.likelihood;
                Some((run.id.clone(), likelihood.k_kpa?, likelihood.ci95_kpa?))
            })
            .collect();
        let mut random = Random::new(options.seed, RUNS);
        let rows = (0..options.count())
            .map(|_| {
                runs.iter()
                    .map(|(_, value, ci95)| two_piece(*value, *ci95, random.normal(), NORMAL_975))
                    .collect()
            })
            .collect();
        draws.names("run", runs.iter().map(|(id, ..)| id.clone()).collect());
        draws.list(Group::Posterior, "k_of_run_kpa", "run", rows);
        draws
    }
}

fn two_piece_draws(value: f64, ci95: [f64; 2], standard: &[f64]) -> Vec<f64> {
    standard.iter().map(|standard| two_piece(value, ci95, *standard, NORMAL_975)).collect()
}

/// Standard normal numbers of one method, which no other method shares.
fn standard_draws(options: DrawOptions) -> Vec<f64> {
    let mut random = Random::new(options.seed, ALONE);
    (0..options.count()).map(|_| random.normal()).collect::<Vec<f64>>()
}
