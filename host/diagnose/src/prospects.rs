//! Expected information of planned runs about the missing effects and about the modulus (theory, eq. 90).
//!
//! Every plausible model has a normal predictive distribution of a planned run, with noise, discrepancy, and the posterior
//! uncertainty of its parameters and of the discrepancy that runs share. The mutual information between the model and the
//! planned readings is at least `-sum_i w_i ln sum_j w_j exp(-B_ij)`, with the posterior weights `w` and Bhattacharyya's
//! distances `B` (Kolchinsky and Tracey, "Estimating mixture entropy with pairwise distances", Entropy 19:361, 2017). The
//! models include effects that no run has shown so far, each with its prior odds and the posterior variance of its amplitude.
//! Therefore the proposed runs of a first session are spread over depths and axes.

use super::Multiples;
use super::averaged::Averaged;
use super::data::{Channel, Kind, Run};
use super::discrepancy::patterns;
use super::evidence::Patterns;
use super::layout::Prepared;
use super::noise::Noise;
use super::posterior::{Fitted, jacobian, residuals};
use super::score::{Directions, Scores, Unseen};
use super::whiten::Whitener;
use mechanics::effects::{Effect, all};
use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;
use readings::FitError;
use serde::Serialize;
use simulation::simulate::LateralPlan;

/// Smallest probability of a model that is included: a less probable one adds less than 0.007 nats, `-p ln p`.
const MIN_PROBABILITY: f64 = 1e-3;
/// Effects that are named as the reason for a run.
const REASONS: usize = 3;

/// Plausible hypotheses, and the expected information of planned runs about them.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Prospects {
    /// Sets of effects that explain the runs, with their probabilities, most probable first.
    pub explanations: Vec<PossibleSet>,
    /// Probability that a further effect is missing, which no run has shown so far.
    pub unseen_probability: f64,
    /// The planned runs, in their order.
    pub runs: Vec<Prospect>,
}

impl Prospects {
    /// Probability that nothing is missing.
    pub fn nothing_missing(&self) -> f64 {
        let empty_sets = self.explanations.iter().filter(|set| set.effects.is_empty());
        (1.0 - self.unseen_probability) * empty_sets.map(|set| set.probability).sum::<f64>()
    }
}

/// A set of effects that explains the runs.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct PossibleSet {
    /// Ids of the effects; empty if nothing is missing.
    pub effects: Vec<String>,
    /// Its probability.
    pub probability: f64,
}

/// Expected information of a planned run.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Prospect {
    /// Name of the planned run.
    pub run: String,
    /// Expected information about the missing effect, nats.
    pub information_nats: f64,
    /// Expected information about the modulus: the logarithm of the ratio of its standard deviations before and after, nats.
    pub modulus_nats: f64,
    /// Largest lateral force that the model predicts, N.
    pub force_n: f64,
    /// Effects about which it would be most informative, in descending order.
    pub reasons: Vec<String>,
}

/// Inputs of the prospects.
pub(super) struct Known<'a> {
    pub averaged: &'a Averaged,
    pub runs: &'a [Prepared],
    pub patterns: &'a Patterns,
    pub noise: &'a Noise,
    pub multiples: &'a Multiples,
}

/// The models in question with their probabilities.
struct Models<'a> {
    base: &'a Fitted,
    fits: Vec<(f64, &'a Fitted)>,
    directions: Directions,
    /// Amplitudes of effects that no run has shown so far.
    unseen: Vec<(f64, Unseen)>,
    ln_modulus_variance: f64,
}

/// A planned run, with the patterns of the discrepancy in the recorded runs and in it.
struct Foreseen {
    run: Prepared,
    /// Its residuals under the base, which are nearly zero.
    here: Vec<f64>,
    patterns: Patterns,
}

impl Known<'_> {
    /// Expected information of these runs.
    ///
    /// # Errors
    /// Where the model cannot be evaluated.
    pub fn prospects(&self, plans: &[LateralPlan]) -> Result<Prospects, FitError> {
        let models = self.models()?;
        let runs = plans.par_iter().map(|plan| self.prospect(&models, plan)).collect::<Result<_, _>>()?;
        let unseen_probability: f64 = models.unseen.iter().map(|(probability, _)| probability).sum();
        let mut explanations: Vec<PossibleSet> = Vec::new();
        for (probability, fit) in &models.fits {
            let (effects, probability) = (added(fit), probability / (1.0 - unseen_probability));
            match explanations.iter_mut().find(|known| known.effects == effects) {
                Some(known) => known.probability += probability,
                None => explanations.push(PossibleSet { effects, probability }),
            }
        }
        explanations.sort_by(|a, b| b.probability.total_cmp(&a.probability));
        Ok(Prospects { explanations, unseen_probability, runs })
    }

    fn models(&self) -> Result<Models<'_>, FitError> {
        let base = self.averaged.own();
        let fits = self.averaged.fits();
        let names = all().into_iter().filter(|effect| {
            let mut fitted_effects = fits.iter().flat_map(|(_, fit)| &fit.layout.effects);
            fitted_effects.all(|fitted| fitted.id() != effect.id())
        });
        let names: Vec<&'static dyn Effect> = names.collect();
        let directions = Directions::of(&names, base, self.runs);
        let unseen = Scores::along(directions.clone(), base, self.patterns)?.unseen();
        let of_base = fits.iter().filter(|(_, fit)| fit.layout.has_effects_of(&base.layout));
        let of_base: f64 = of_base.map(|(weight, _)| weight).sum();
        // All effects of the catalogue together have the prior probability of no effect, whether the runs so far can show them or not.
        let prior = of_base / all().len() as f64;
        let weights: Vec<f64> = unseen.iter().map(|one| prior * one.log_evidence.exp()).collect();
        let total: f64 = fits.iter().map(|(weight, _)| weight).chain(&weights).sum();
        let fits = fits.iter().map(|(weight, fit)| (weight / total, fit));
        Ok(Models {
            base,
            fits: fits.filter(|(probability, _)| *probability > MIN_PROBABILITY).collect(),
            directions,
            unseen: weights.into_iter().map(|weight| weight / total).zip(unseen).collect(),
            ln_modulus_variance: base
                .ln_modulus_variance(self.patterns, &base.sizes)
                .ok_or(FitError::Undetermined)?,
        })
    }

    /// A planned run without noise, as the model predicts it.
    fn foreseen(&self, base: &Fitted, plan: &LateralPlan) -> Result<Foreseen, FitError> {
        let model = base.layout.model(base.values(), Kind::Lateral)?;
        let order = self.runs.len() as f64;
        let measured = plan.foreseen(&model, order)?;
        let run = Run::lateral(&measured, &model.rig).map_err(|_| FitError::Undetermined)?.numbered(order);
        let run = Prepared { whitener: Whitener::new(&run, self.noise, &model)?, run };
        let here = run.residuals(&base.layout, base.values())?;
        let with_planned: Vec<Prepared> = self.runs.iter().chain([&run]).cloned().collect();
        let patterns = patterns(&base.layout, base.values(), &with_planned, self.multiples)?;
        Ok(Foreseen { run, here, patterns })
    }

    fn prospect(&self, models: &Models<'_>, plan: &LateralPlan) -> Result<Prospect, FitError> {
        let base = models.base;
        let foreseen = self.foreseen(base, plan)?;
        let base_with_run = foreseen.with(base).ok_or(FitError::Undetermined)?;
        // A model that cannot predict the planned run (the needle buckles) gives no reason to plan it: its prediction is that of the base.
        let fits: Vec<Option<Fitted>> = models.fits.iter().map(|(_, fit)| foreseen.with(fit)).collect();
        let of_base = self.expected(&foreseen, &base_with_run).ok_or(FitError::Undetermined)?;
        let means = fits.iter().map(|fit| self.expected(&foreseen, fit.as_ref()?));
        let means: Vec<DVector<f64>> = means.map(|mean| mean.unwrap_or(of_base.clone())).collect();
        let squares = fits.iter().zip(&means).map(|(fit, mean)| {
            let squares = fit.as_ref().and_then(|fit| self.distances(&foreseen, fit, mean, &means));
            squares.unwrap_or(vec![0.0; fits.len()])
        });
        let squares: Vec<Vec<f64>> = squares.collect();
        let sizes = self.sizes(base, &foreseen.patterns);
        let mut at_sizes = base_with_run.clone();
        at_sizes.sizes.clone_from(&sizes);
        let directions = models.directions.clone().with_run(base, &foreseen.run, &foreseen.here);
        let unseen_after = Scores::along(directions, &at_sizes, &foreseen.patterns)?.unseen();
        // The Bhattacharyya distance of two normal distributions, one of which is wider along one direction.
        let unseen = models.unseen.iter().zip(&unseen_after).map(|((_, before), after)| {
            let ratio = (before.variance / after.variance - 1.0).max(0.0);
            0.5 * ((1.0 + 0.5 * ratio) / (1.0 + ratio).sqrt()).ln()
        });
        let base_number =
            models.fits.iter().position(|(_, fit)| fit.layout.has_effects_of(&base.layout)).unwrap_or(0);
        let distances = Distances { squares, unseen: unseen.collect(), base_number };
        let of_unseen = models.unseen.iter().map(|(weight, _)| *weight);
        let weights: Vec<f64> = models.fits.iter().map(|(weight, _)| *weight).chain(of_unseen).collect();
        let gains: Vec<f64> = (0..weights.len())
            .map(|i| {
                let mixed: f64 = weights
                    .iter()
                    .enumerate()
                    .map(|(j, weight)| weight * (-distances.between(i, j)).exp())
                    .sum();
                // The weights of the models that are included do not sum to one.
                if weights[i] > 0.0 { -weights[i] * (mixed / weights.iter().sum::<f64>()).ln() } else { 0.0 }
            })
            .collect();
        let effects = models.fits.iter().map(|(_, fit)| added(fit));
        let effects = effects.chain(models.unseen.iter().map(|(_, one)| vec![one.effect.id().to_owned()]));
        let planned_variance =
            base_with_run.ln_modulus_variance(&foreseen.patterns, &sizes).ok_or(FitError::Undetermined)?;
        Ok(Prospect {
            run: plan.id.clone(),
            information_nats: gains.iter().sum::<f64>().max(0.0),
            modulus_nats: (0.5 * (models.ln_modulus_variance / planned_variance).ln()).max(0.0),
            force_n: largest_force_n(&foreseen.run.run),
            reasons: reasons(&gains, &effects.collect::<Vec<_>>()),
        })
    }

    /// Residuals of the planned run under a fit that has it, less the expected discrepancy there given the other runs.
    fn expected(&self, foreseen: &Foreseen, fit: &Fitted) -> Option<DVector<f64>> {
        let (last, before) = fit.residuals.split_last()?;
        let less = self.patterns.less_patterns(&fit.sizes, before)?;
        let sizes = self.sizes(fit, &foreseen.patterns);
        Some(DVector::from_column_slice(last) - foreseen.patterns.expected_in_last(&sizes, &less)?)
    }

    /// Squared distances between the predictions of a fit and of all fits for the planned run, in the metric of noise, discrepancy and the
    /// uncertainty of the fit's own parameters.
    fn distances(
        &self,
        foreseen: &Foreseen,
        fit: &Fitted,
        own: &DVector<f64>,
        means: &[DVector<f64>],
    ) -> Option<Vec<f64>> {
        let mut columns: Vec<DMatrix<f64>> =
            self.runs.iter().map(|run| DMatrix::zeros(run.run.data.len(), means.len())).collect();
        let differences: Vec<DVector<f64>> = means.iter().map(|mean| mean - own).collect();
        columns.push(DMatrix::from_columns(&differences));
        let products = fit.products_beside_parameters(&foreseen.patterns, &columns);
        let (reduced, _) =
            fit.eliminated(&foreseen.patterns, &self.sizes(fit, &foreseen.patterns), &products)?;
        Some(reduced.diagonal().iter().copied().collect())
    }

    /// Sizes of the groups of the discrepancy with the planned run: those of a fit, and everyday ones for further groups.
    fn sizes(&self, fit: &Fitted, beside: &Patterns) -> Vec<f64> {
        let fitted_sizes: Vec<(&str, f64)> =
            self.patterns.groups.iter().map(|group| group.name).zip(fit.sizes.iter().copied()).collect();
        beside
            .groups
            .iter()
            .map(|group| {
                let size = fitted_sizes.iter().find(|(name, _)| *name == group.name).map(|(_, size)| *size);
                size.unwrap_or(group.everyday)
            })
            .collect()
    }
}

/// Bhattacharyya distances between the predictive distributions of the models for a planned run: fits, followed by unseen effects.
struct Distances {
    /// Squared distances between the predictions of fits, in the metric of the first one.
    squares: Vec<Vec<f64>>,
    unseen: Vec<f64>,
    base_number: usize,
}

impl Distances {
    fn between_fits(&self, i: usize, j: usize) -> f64 {
        let [square, reverse] = [(i, j), (j, i)]
            .map(|(i, j)| self.squares.get(i).and_then(|row| row.get(j)).copied().unwrap_or(0.0));
        (square + reverse) / 16.0
    }

    fn between(&self, i: usize, j: usize) -> f64 {
        let count = self.squares.len();
        match (i < count, j < count) {
            (true, true) => self.between_fits(i, j),
            // An unseen effect differs from the base along a direction of its own.
            (true, false) => self.unseen[j - count] + self.between_fits(i, self.base_number),
            (false, true) => self.unseen[i - count] + self.between_fits(j, self.base_number),
            (false, false) if i == j => 0.0,
            (false, false) => self.unseen[i - count] + self.unseen[j - count],
        }
    }
}

impl Foreseen {
    /// A fit with its residuals and sensitivities in the planned run; `None` if it cannot predict the run.
    fn with(&self, fit: &Fitted) -> Option<Fitted> {
        let planned = std::slice::from_ref(&self.run);
        let residuals = residuals(&fit.layout, planned, fit.values()).ok()?;
        let parameters = fit.layout.parameters(fit.values());
        let jacobian = jacobian(&fit.layout, planned, fit.values(), &parameters, &residuals, &[]).ok()?;
        Some(fit.with_run(residuals.into_iter().next()?, jacobian.into_iter().next()?))
    }
}

/// Ids of the effects that were added to a model.
fn added(fit: &Fitted) -> Vec<String> {
    fit.layout.effects.iter().skip(fit.layout.given).map(|effect| effect.id().to_owned()).collect()
}

/// Largest force of a run.
fn largest_force_n(run: &Run) -> f64 {
    let forces = run.data.iter().filter(|datum| matches!(datum.channel, Channel::ForceY | Channel::ForceX));
    forces.map(|datum| datum.measured.abs()).fold(0.0, f64::max)
}

/// Effects about which a run is most informative.
fn reasons(gains: &[f64], effects: &[Vec<String>]) -> Vec<String> {
    let mut by_effect: Vec<(f64, &String)> = Vec::new();
    for (gain, effects) in gains.iter().zip(effects) {
        for effect in effects {
            match by_effect.iter_mut().find(|(_, known)| *known == effect) {
                Some((sum, _)) => *sum += gain,
                None => by_effect.push((*gain, effect)),
            }
        }
    }
    by_effect.sort_by(|a, b| b.0.total_cmp(&a.0));
    by_effect.into_iter().take(REASONS).map(|(_, effect)| effect.clone()).collect()
}
