//! Remaining difference between the model with all named effects and the measurement.

use super::adequacy::{Adequacy, LEVEL, allowed_sizes};
use super::evidence::Patterns;
use super::layout::NORMAL_975;
use super::posterior::Fitted;
use super::results::{HeldOutMisfit, RemainingResult, RemainingSize};
use statrs::distribution::{ContinuousCDF, Normal};

/// Smallest ratio of a size to the everyday one that is reported.
const ABOVE: f64 = 1.5;

/// Assembles the remaining difference.
pub(super) struct Remaining;

impl Remaining {
    /// The difference that remains under a model whose adequacy is known.
    pub fn of(
        adequacy: &Adequacy,
        fitted: &Fitted,
        patterns: &Patterns,
        gap: Option<&HeldOutMisfit>,
    ) -> RemainingResult {
        let change_ln = fitted.change_without_discrepancy(patterns);
        // Imperfections within the limits of their priors also change the modulus by chance.
        let by_chance = fitted
            .sd_of_change_without_discrepancy(patterns, &allowed_sizes(fitted, patterns))
            .map_or(0.0, |sd| sd * Normal::standard().inverse_cdf(1.0 - 0.5 * LEVEL));
        let usual = by_chance.max(NORMAL_975 * fitted.sd(0));
        let size = if adequacy.is_within_noise() {
            RemainingSize::WithinNoise
        } else if change_ln.is_some_and(|change| change.abs() <= usual) {
            RemainingSize::Small
        } else {
            RemainingSize::Large
        };
        let rms = adequacy.discrepancy.iter().map(|(channel, sd)| {
            let name = format!("{}_{}", channel.name(), channel.unit().to_lowercase());
            (name, channel.per_si() * sd)
        });
        let larger_groups = patterns.groups.iter().zip(&fitted.sizes).filter_map(|(group, size)| {
            let times = group.multiple * size / group.everyday;
            (times > ABOVE).then(|| (group.name.to_owned(), times))
        });
        RemainingResult {
            size,
            rms: rms.collect(),
            share_of_gap: gap.and_then(|gap| gap.removed).map(|removed| (1.0 - removed).max(0.0)),
            k_change_without_discrepancy: change_ln.map_or(f64::NAN, |change| change.exp() - 1.0),
            above_everyday: larger_groups.collect(),
        }
    }
}

#[cfg(test)]
mod tests {
    use crate::start_of;
    use worlds::{Background, Design, Truth, session_on};

    /// In sessions with everyday imperfections, the change of the modulus in a fit with noise alone is not larger than its computed standard
    /// deviation states.
    #[test]
    fn the_modulus_by_noise_alone_moves_as_imperfections_make_it_move() {
        const SEEDS: u64 = 12;
        let truth = Truth { k_kpa: 12.0, tip_load_n: 0.0, effects: Vec::new(), foreign: None };
        let design = Design::four_runs();
        let mut squares = 0.0;
        for seed in 100..100 + SEEDS {
            let background = Background::drawn(&truth, &design, seed);
            let (start, _) = start_of(&session_on(&truth, &background, &design, seed));
            let (fitted, patterns) = (&start.fitted, &start.patterns);
            let change = fitted.change_without_discrepancy(patterns).expect("a change");
            let [sd, sd_without] = [patterns.everyday(), vec![0.0; patterns.groups.len()]]
                .map(|sizes| fitted.sd_of_change_without_discrepancy(patterns, &sizes).expect("an sd"));
            // Without imperfections both estimates are the same.
            assert!(sd_without < 1e-3 * sd);
            squares += (change / sd).powi(2);
        }
        let mean_square = squares / SEEDS as f64;
        assert!((0.02..2.0).contains(&mean_square), "{mean_square}");
    }
}
