//! Workbench in which a user switches effects on and off. The model is fitted again each time, by the same steps as in the search.
//!
//! The criteria of the search do not apply: any effect can be tried, and the result states its evidence.

use super::data::{Channel, Source};
use super::layout::{Layout, Prepared};
use super::noise::Noise;
use super::posterior::Fitted;
use super::predicted::differences;
use super::results::{Estimate, HeldOutMisfit, Misfit};
use super::search::{Catalogue, Search};
use super::split::{Judge, Training, split};
use super::start::{Noises, Start, fit_start};
use super::{DiagnoseError, FoundationChoice, Options, runs_of};
use formats::session::Session;
use mechanics::effects::Effect;
use mechanics::{ModelError, Support, predict_with};
use readings::FitError;
use serde::Serialize;
use std::collections::BTreeMap;

/// A session with its starting model and all models that were tried.
#[derive(Debug)]
pub struct Workbench {
    start: Start,
    judge: Judge,
    noise: Noise,
    seed: u64,
    /// Fits, and their log evidence over the start, by the ids of their effects.
    tried: BTreeMap<Vec<&'static str>, (Fitted, f64)>,
}

/// A fitted model with the chosen effects.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Trial {
    /// The effects with their parameters, in the order of their ids.
    pub effects: Vec<TrialEffect>,
    /// `springs` or `body`.
    pub foundation: &'static str,
    /// Modulus of the fitted model, K of springs or E of a body.
    pub modulus_kpa: Estimate,
    /// Log evidence over the starting model.
    pub log_evidence_gain: f64,
    /// Misfit on the training data, of the starting model and of this one.
    pub learned: [Misfit; 2],
    /// Misfit on held-out data; `None` without such data.
    pub held_out: Option<HeldOutMisfit>,
    /// Residuals of all training readings.
    pub points: Vec<TrialPoint>,
}

/// An effect of a trial.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct TrialEffect {
    /// Its id.
    pub id: &'static str,
    /// Its parameters by name.
    pub parameters: BTreeMap<&'static str, Estimate>,
}

/// Residual of a reading or of a mean of readings, measured less predicted.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct TrialPoint {
    /// The run.
    pub run: String,
    /// The sensor.
    pub channel: &'static str,
    /// Unit of the residuals.
    pub unit: &'static str,
    /// Depth below the surface; for forces the depth of the needle.
    pub depth_mm: f64,
    /// Displacement of guide 2 along the axis of the run.
    pub displacement_mm: f64,
    /// Residual under the starting model.
    pub before: f64,
    /// Residual under this model.
    pub after: f64,
    /// Standard deviation of the value by noise alone.
    pub noise_sd: f64,
}

impl Workbench {
    /// Fits the starting model to a session. With [`FoundationChoice::Auto`] the foundation is springs; only [`super::diagnose`] chooses
    /// by evidence. A reference is ignored.
    ///
    /// # Errors
    /// [`DiagnoseError`] where nothing can be fitted.
    pub fn new(session: &Session, options: &Options) -> Result<Self, DiagnoseError> {
        let (runs, _) = runs_of(session)?;
        let (Training { runs, .. }, held_out) = split(runs);
        let noise = Noise::of(&runs, &session.stated_noise());
        let noises = Noises { session: noise, reference: noise };
        let given_effects: Vec<&'static dyn Effect> =
            options.given.iter().map(|(effect, _)| *effect).collect();
        let mut layout = Layout::new(&session.rig, &runs, given_effects);
        layout.known = options.known.as_slice().into();
        let springs = fit_start(&layout, &runs, &noises, &options.given, &options.discrepancy)?;
        let judge = held_out.judge(&springs, &noise, &options.discrepancy)?;
        let start = if options.foundation == FoundationChoice::Body {
            springs.on(Support::Body { poisson: options.poisson, block: session.tissue.block() })?
        } else {
            springs
        };
        let mut fitted_trials = BTreeMap::new();
        fitted_trials.insert(Vec::new(), (start.fitted.clone(), 0.0));
        Ok(Self { start, judge, noise, seed: options.seed, tried: fitted_trials })
    }

    /// Effects that can be added to the model of this session's rig.
    pub fn applicable(&self) -> Vec<&'static dyn Effect> {
        let layout = &self.start.fitted.layout;
        let is_in_model = |effect: &dyn Effect| layout.effects.iter().any(|own| own.id() == effect.id());
        let all_effects = mechanics::effects::EFFECTS.into_iter();
        all_effects.filter(|effect| layout.is_applicable(*effect) && !is_in_model(*effect)).collect()
    }

    /// Fits the model with these effects and those of the starting model. The result does not depend on their order or on
    /// earlier trials.
    ///
    /// # Errors
    /// [`DiagnoseError::Fit`] where the model with them cannot be fitted, or an effect cannot be added to this rig.
    pub fn fit(&mut self, effects: &[&'static dyn Effect]) -> Result<Trial, DiagnoseError> {
        let applicable = self.applicable();
        let mut ids: Vec<&'static str> = effects.iter().map(|effect| effect.id()).collect();
        ids.sort_unstable();
        ids.dedup();
        let mut trial_effects = Vec::new();
        for id in ids {
            let known_effect = applicable.iter().find(|effect| effect.id() == id);
            trial_effects.push(*known_effect.ok_or(FitError::Undetermined)?);
        }
        let mut key: Vec<&'static str> = Vec::new();
        let (mut fitted, mut gain) = (self.start.fitted.clone(), 0.0);
        for effect in &trial_effects {
            key.push(effect.id());
            if let Some((cached_fit, of_known)) = self.tried.get(&key) {
                (fitted, gain) = (cached_fit.clone(), *of_known);
                continue;
            }
            let Start { fitted: start, runs, patterns } = &self.start;
            let search = Search::new(start, runs, patterns, &self.judge, Catalogue::WHOLE);
            let (next, more) = search.with_effect(&fitted, *effect)?.ok_or(FitError::Undetermined)?;
            (fitted, gain) = (next, gain + more);
            self.tried.insert(key.clone(), (fitted.clone(), gain));
        }
        self.trial(&fitted, gain)
    }

    fn trial(&self, fitted: &Fitted, gain: f64) -> Result<Trial, DiagnoseError> {
        let start = &self.start.fitted;
        let first = start.layout.effects.len();
        let effects = fitted.layout.effects.iter().enumerate().skip(first).map(|(index, effect)| {
            let parameter = |(number, info): (usize, &mechanics::effects::ParameterInfo)| {
                let (value, ci95) = fitted.estimate(index, number);
                (info.name, Estimate { value, ci95 })
            };
            TrialEffect {
                id: effect.id(),
                parameters: effect.parameters().iter().enumerate().map(parameter).collect(),
            }
        });
        let (pa, ends_pa) = fitted.modulus_pa();
        let points = self.points(fitted)?;
        Ok(Trial {
            effects: effects.collect(),
            foundation: fitted.layout.support.name(),
            modulus_kpa: Estimate { value: 1e-3 * pa, ci95: ends_pa.map(|end| 1e-3 * end) },
            log_evidence_gain: gain,
            learned: [
                misfit(&start.residuals, &points, |point| point.before),
                misfit(&fitted.residuals, &points, |point| point.after),
            ],
            held_out: self.judge.gap(start, fitted, self.seed)?,
            points,
        })
    }

    /// Residuals of the training runs under the starting model and under a fit.
    fn points(&self, fitted: &Fitted) -> Result<Vec<TrialPoint>, ModelError> {
        let mut points = Vec::new();
        for prepared in &self.start.runs {
            let values_before = self.plain(&self.start.fitted, prepared)?;
            let values_after = self.plain(fitted, prepared)?;
            for ((datum, values_before), values_after) in
                prepared.run.data.iter().zip(values_before).zip(values_after)
            {
                let unit = datum.channel.per_si();
                points.push(TrialPoint {
                    run: prepared.run.id.clone(),
                    channel: datum.channel.name(),
                    unit: datum.channel.unit(),
                    depth_mm: 1e3 * datum.place.depth_m,
                    displacement_mm: 1e3 * datum.place.level_m,
                    before: unit * values_before,
                    after: unit * values_after,
                    noise_sd: unit * self.noise_sd(datum.channel, &datum.source),
                });
            }
        }
        Ok(points)
    }

    fn plain(&self, fitted: &Fitted, prepared: &Prepared) -> Result<Vec<f64>, ModelError> {
        let run = &prepared.run;
        let model = fitted.layout.model_of(fitted.values(), run.kind, run.is_reference)?;
        Ok(differences(run, &predict_with(&model, &run.experiment, &fitted.layout.cache)?))
    }

    fn noise_sd(&self, channel: Channel, source: &Source) -> f64 {
        let noise = &self.noise;
        match (channel, source) {
            (_, Source::Force(cells)) => noise.force.of_mean(cells.len(), 0.0).sqrt(),
            (Channel::ShapeY | Channel::ShapeX, _) => noise.shape.sd(),
            (Channel::TipDirectionY | Channel::TipDirectionX, _) => noise.direction.sd(),
            _ => noise.tip.sd(),
        }
    }
}

/// Chi-square per reading of whitened residuals, and the root mean square of the plain ones by channel.
fn misfit(white: &[Vec<f64>], points: &[TrialPoint], value: impl Fn(&TrialPoint) -> f64) -> Misfit {
    let squares: f64 = white.iter().flatten().map(|residual| residual * residual).sum();
    let count = white.iter().map(Vec::len).sum::<usize>();
    let mut channels: BTreeMap<String, (f64, usize)> = BTreeMap::new();
    for point in points {
        let name = format!("{}_{}", point.channel, point.unit.to_lowercase());
        let (sum, count) = channels.entry(name).or_default();
        *sum += value(point).powi(2);
        *count += 1;
    }
    let rmse = channels.into_iter().map(|(name, (sum, count))| (name, (sum / count as f64).sqrt()));
    Misfit { chi2_reduced: squares / count.max(1) as f64, rmse: rmse.collect() }
}

#[cfg(test)]
#[path = "workbench_tests.rs"]
mod tests;
