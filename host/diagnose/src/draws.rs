//! Draws from the posterior of a diagnosis over all plausible models, with the same fits and weights as its intervals (theory,
//! eq. 66), and the readings that they predict.
//!
//! For each draw a model is drawn with probability proportional to its weight, then the parameters from the normal posterior of its
//! fit. The parameters of an effect that the model does not have are at their neutral values.

mod readings;

pub(super) use readings::Readings;

use super::averaged::Averaged;
use super::choice::Beside;
use super::evidence::Patterns;
use super::layout::{NORMAL_975, Prepared, Scale};
use super::on_springs::OnSprings;
use super::posterior::Fitted;
use super::results::Diagnosis;
use ::readings::draws::{DrawOptions, Draws, Group, Random};
use ::readings::{FitError, Parameter};
use mechanics::effects::{Effect, effect};
use nalgebra::{DMatrix, DVector};

/// Streams of random numbers.
const MODELS: u64 = 1;
const PARAMETERS: u64 = 2;
const APART: u64 = 3;
const PRIOR: u64 = 4;
pub(super) const READINGS: u64 = 5;
/// Smallest fraction of the total weight of a model that is drawn: less changes no printed digit of a mean.
const MIN_WEIGHT: f64 = 1e-4;
/// Largest number of tries for a draw within a range, or for a draw at which the model has a solution.
const MAX_TRIES: usize = 100;
const MM_PER_M: f64 = 1e3;

/// Draws: the model of each draw, and the deviation of its parameters from the values of the fit.
pub(super) struct Deviations<'a> {
    pub options: DrawOptions,
    pub models: Vec<(f64, &'a Fitted)>,
    /// Number of each draw's model.
    pub picks: Vec<usize>,
    pub deviations: Vec<DVector<f64>>,
}

impl<'a> Deviations<'a> {
    /// Draws from fits with their weights.
    pub fn new(mut models: Vec<(f64, &'a Fitted)>, options: DrawOptions) -> Self {
        let total: f64 = models.iter().map(|(weight, _)| weight).sum();
        models.retain(|(weight, _)| *weight > MIN_WEIGHT * total);
        let weights: Vec<f64> = models.iter().map(|(weight, _)| *weight).collect();
        let picks = Random::new(options.seed, MODELS).choices(&weights, options.count());
        let roots: Vec<DMatrix<f64>> =
            models.iter().map(|(_, fitted)| Random::root(&fitted.covariance)).collect();
        let mut random = Random::new(options.seed, PARAMETERS);
        let deviations = picks
            .iter()
            .map(|pick| {
                roots.get(*pick).map_or_else(DVector::default, |root| root * random.normals(root.ncols()))
            })
            .collect();
        Self { options, models, picks, deviations }
    }

    /// Values of a quantity in all draws; `form` is its linear form in a model.
    fn of(&self, stream: u64, form: impl Fn(&Fitted) -> Linear) -> Vec<f64> {
        let forms: Vec<Linear> = self.models.iter().map(|(_, fitted)| form(fitted)).collect();
        let mut random = Random::new(self.options.seed, stream);
        self.picks
            .iter()
            .zip(&self.deviations)
            .map(|(pick, deviation)| {
                let standard_deviate = random.normal();
                forms.get(*pick).map_or(f64::NAN, |form| form.at(deviation, standard_deviate))
            })
            .collect()
    }

    /// Logarithm of the modulus in every draw, standardized with the mean and standard deviation of the fit.
    pub fn standard_ln_modulus(&self) -> Vec<f64> {
        self.picks
            .iter()
            .zip(&self.deviations)
            .map(|(pick, deviation)| {
                let sd = self.models.get(*pick).map_or(f64::NAN, |(_, fitted)| fitted.sd(0));
                deviation.get(0).map_or(f64::NAN, |first| first / sd)
            })
            .collect()
    }

    /// Adds the parameters of an effect under their names, which state the units.
    pub fn add_effect(&self, effect: &dyn Effect, draws: &mut Draws) {
        for (number, info) in effect.parameters().iter().enumerate() {
            let name = parameter_name(effect, info.name);
            // Deviates of different parameters are independent.
            let stream =
                name.bytes().fold(APART, |stream, byte| stream.wrapping_mul(257).wrapping_add(byte.into()));
            let mut random = Random::new(self.options.seed, stream);
            let pairs = self.picks.iter().zip(&self.deviations);
            let values = pairs.map(|(pick, deviation)| {
                let deviate = random.normal();
                let (_, fitted) = self.models.get(*pick)?;
                value_of(fitted, deviation, effect, number, deviate)
            });
            let values = values.map(|value| value.unwrap_or(info.neutral)).collect();
            draws.scalar(Group::Posterior, &name, values);
        }
    }

    /// Adds the stated positions of the rig that are estimated within a tolerance.
    pub fn add_stated(&self, own: &Fitted, draws: &mut Draws) {
        for place in own.layout.stated() {
            let values = self.of(APART, |fitted| {
                let same_effect = fitted.layout.stated().find(|other| other.effect == place.effect);
                same_effect.map_or(Linear::fixed(0.0), |same_effect| {
                    Linear::parameter(fitted, same_effect.parameter)
                })
            });
            let values = values.into_iter().map(|value| MM_PER_M * value).collect();
            draws.scalar(Group::Posterior, &format!("{}_mm", place.effect), values);
        }
    }

    /// Adds the number of the model of each draw, and the names of the models.
    fn add_models(&self, draws: &mut Draws) {
        let names = self.models.iter().enumerate().map(|(number, (_, fitted))| {
            let effects: Vec<&str> = fitted.layout.effects.iter().map(|effect| effect.id()).collect();
            let effects = if effects.is_empty() { "no effects".to_owned() } else { effects.join(" with ") };
            format!("{number}: {effects} on {}", fitted.layout.support.name())
        });
        draws.attribute("models", names.collect::<Vec<_>>().join("; "));
        let model = self.picks.iter().map(|pick| *pick as f64).collect();
        draws.scalar(Group::Posterior, "model", model);
    }
}

/// Parameter of an effect in a draw, in its own unit; `None` if the model does not have the effect. `deviate` is an independent standard
/// normal deviate.
fn value_of(
    fitted: &Fitted,
    deviation: &DVector<f64>,
    effect: &dyn Effect,
    number: usize,
    deviate: f64,
) -> Option<f64> {
    let info = effect.parameters().get(number)?;
    let index = fitted.layout.index_of(effect)?;
    let first = fitted.layout.first_of(index) + number;
    let inside_value = fitted.values().get(first)? + deviation.get(first)?;
    let (_, [low, high]) = fitted.estimate(index, number);
    // The interval of a depth also includes the spacing of the readings, which the covariance of the fit does not.
    let sd = 0.5 * (high - low) / NORMAL_975;
    let own_sd = Scale::of(info).outside(fitted.values().get(first)? + fitted.sd(first))
        - Scale::of(info).outside(*fitted.values().get(first)?);
    let excess_sd = (sd * sd - own_sd * own_sd).max(0.0).sqrt();
    let depth_shift = if info.name == "depth_mm" { excess_sd * deviate } else { 0.0 };
    let [least, most] = info.range;
    Some((Scale::of(info).outside(inside_value) + depth_shift).clamp(least, most))
}

/// `tissue.skin.stiffness_n_per_mm`.
fn parameter_name(effect: &dyn Effect, parameter: &str) -> String {
    format!("{}.{parameter}", effect.id())
}

/// Moduli from their logarithms.
fn kpa(ln_pa: Vec<f64>) -> Vec<f64> {
    ln_pa.into_iter().map(|ln_pa| 1e-3 * ln_pa.exp()).collect()
}

/// Adds parameters of a model that were drawn from their priors: its modulus under `modulus`, its tip load and those of its effects.
fn add_prior_parameters(own: &Fitted, modulus: &str, drawn_values: &[Vec<f64>], draws: &mut Draws) {
    let of_place = |place: usize| -> Option<Vec<f64>> {
        drawn_values.iter().map(|values| values.get(place).copied()).collect()
    };
    if let Some(ln_pa) = of_place(0) {
        draws.scalar(Group::Prior, modulus, kpa(ln_pa));
    }
    if let Some(load) = own.layout.load().and_then(of_place) {
        draws.scalar(Group::Prior, "tip_load_n", load);
    }
    for (index, effect) in own.layout.effects.iter().enumerate() {
        for (number, info) in effect.parameters().iter().enumerate() {
            if let Some(values) = of_place(own.layout.first_of(index) + number) {
                let scale = Scale::of(info);
                let values = values.into_iter().map(|inside| scale.outside(inside)).collect();
                draws.scalar(Group::Prior, &parameter_name(*effect, info.name), values);
            }
        }
    }
}

/// Draw from the normal prior of a parameter, truncated to its range.
fn from_prior(parameter: &Parameter, random: &mut Random) -> f64 {
    let Some(prior) = parameter.prior else { return parameter.start };
    let mut drawn_values = (0..MAX_TRIES).map(|_| prior.mean + prior.sd * random.normal());
    let drawn_value = drawn_values.find(|value| (parameter.least..=parameter.most).contains(value));
    drawn_value.unwrap_or_else(|| prior.mean.clamp(parameter.least, parameter.most))
}

/// A quantity that is linear in the parameters of a fit, plus an independent normal part.
struct Linear {
    value: f64,
    slopes: DVector<f64>,
    /// Standard deviation of the part that does not depend on the parameters.
    apart: f64,
}

impl Linear {
    fn fixed(value: f64) -> Self {
        Self::apart(value, 0.0)
    }

    fn apart(value: f64, apart: f64) -> Self {
        Self { value, slopes: DVector::zeros(0), apart }
    }

    fn parameter(fitted: &Fitted, place: usize) -> Self {
        let mut slopes = DVector::zeros(fitted.values().len());
        slopes[place] = 1.0;
        Self { value: fitted.values()[place], slopes, apart: 0.0 }
    }

    fn at(&self, deviation: &DVector<f64>, apart: f64) -> f64 {
        let moved: f64 = self.slopes.iter().zip(deviation.iter()).map(|(slope, by)| slope * by).sum();
        self.value + moved + self.apart * apart
    }
}

/// Inputs of the draws.
pub(super) struct Sources<'a> {
    pub averaged: &'a Averaged,
    /// Models on the other foundation.
    pub beside: &'a [Beside],
    /// K of the models of a body.
    pub on_springs: &'a OnSprings,
    pub runs: &'a [Prepared],
    pub patterns: &'a Patterns,
}

impl Sources<'_> {
    /// Draws of the results of a diagnosis.
    ///
    /// # Errors
    /// [`FitError`] where a model cannot be evaluated.
    pub fn draws(&self, found: &Diagnosis, options: DrawOptions) -> Result<Draws, FitError> {
        let Self { averaged, beside, on_springs, .. } = *self;
        let chosen_fit = averaged.own();
        let of_choice: Vec<(f64, &Fitted)> =
            averaged.fits().iter().map(|(weight, fitted)| (*weight, fitted)).collect();
        let total: f64 = of_choice.iter().map(|(weight, _)| weight).sum();
        let other_fits = beside.iter().map(|other| (total * other.ln_odds.exp(), &other.fitted));
        let deviations = Deviations::new(of_choice.iter().copied().chain(other_fits).collect(), options);
        let mut draws = Draws::new(options, "guide diagnose");
        deviations.add_models(&mut draws);
        let is_body = chosen_fit.layout.support.is_body();
        let k = deviations.of(APART, |fitted| match fitted.layout.support.is_body() {
            true => match averaged.ln_modulus(on_springs.stating_k_of(fitted)) {
                Some((value, sd)) => Linear::apart(value, sd),
                None => Linear::fixed(f64::NAN),
            },
            false => self.ln_modulus(fitted),
        });
        draws.scalar(Group::Posterior, "k_kpa", kpa(k));
        // Young's modulus and the mean modulus are conditional on the chosen foundation.
        let chosen = Deviations::new(of_choice, options);
        if is_body {
            let youngs = chosen.of(APART, |fitted| self.ln_modulus(fitted));
            draws.scalar(Group::Posterior, "youngs_modulus_kpa", kpa(youngs));
        }
        if found.mean_modulus.is_some() {
            let mean = chosen.of(APART, |fitted| self.ln_mean(fitted));
            draws.scalar(Group::Posterior, "mean_modulus_kpa", kpa(mean));
        }
        if found.tip_load_n.is_some() {
            let load = deviations.of(APART, |fitted| match fitted.tip_load_slopes() {
                Some((value, slopes)) => Linear { value, slopes, apart: 0.0 },
                None => Linear::fixed(f64::NAN),
            });
            draws.scalar(Group::Posterior, "tip_load_n", load);
        }
        if found.reference.is_some() {
            let ratio = deviations.of(APART, |fitted| {
                fitted.layout.ratio().map_or(Linear::fixed(0.0), |place| Linear::parameter(fitted, place))
            });
            draws.scalar(Group::Posterior, "modulus_ratio", ratio.into_iter().map(f64::exp).collect());
        }
        for id in found.effects.iter().map(|effect| &effect.id).chain(&found.given) {
            if let Some(effect) = effect(id) {
                deviations.add_effect(effect, &mut draws);
            }
        }
        deviations.add_stated(chosen_fit, &mut draws);
        let readings = Readings { runs: self.runs, patterns: self.patterns };
        let modulus = if is_body { "youngs_modulus_kpa" } else { "k_kpa" };
        readings.add_prior(chosen_fit, modulus, &mut draws)?;
        readings.add(&deviations, READINGS, &mut draws)?;
        Ok(draws)
    }

    fn ln_modulus(&self, fitted: &Fitted) -> Linear {
        if self.averaged.counts_with_mean(fitted) {
            self.ln_mean(fitted)
        } else {
            Linear::parameter(fitted, 0)
        }
    }

    fn ln_mean(&self, fitted: &Fitted) -> Linear {
        match fitted.ln_mean_modulus_slopes(self.averaged.touched_m()) {
            Some((value, slopes)) => Linear { value, slopes, apart: 0.0 },
            None => Linear::parameter(fitted, 0),
        }
    }
}

#[cfg(test)]
mod tests;
