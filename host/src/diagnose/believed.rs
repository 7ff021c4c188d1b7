//! What is believed while the workflow goes on: which parameters are unknown, and the model that their values make.
//!
//! Unknown in every session: the modulus; with insertions the tip load, and, where there are lateral runs too, how far the modulus
//! felt in an insertion is from that of a lateral run. Then the parameters of the effects in the model. Inside the fits a ratio, a
//! place or a time is its logarithm, everything else itself ([`Scale`]).

use super::data::{Kind, Run, Source};
use super::whiten::Whitener;
use crate::inference::{Parameter, Prior};
use crate::model::effects::{Effect, ParameterInfo};
use crate::model::{Cache, Channels, Model, ModelError, Rig, Support, TipLaw, predict_with};
use std::sync::Arc;

/// Modulus of soft tissue, and the standard deviation of its logarithm.
const TYPICAL_MODULUS_PA: f64 = 15e3;
const MODULUS_SD_LN: f64 = 1.5;
const MODULUS_PA: [f64; 2] = [50.0, 5e6];
/// Tip load before anything is known of it, and its standard deviation.
const TYPICAL_LOAD_N: f64 = 0.1;
const LOAD_SD_N: f64 = 1.0;
/// How far the modulus felt in an insertion may be from that of a lateral run, logarithm.
const INSERTION_SD_LN: f64 = 0.05;

/// How a parameter is counted inside the fits.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Scale {
    Linear,
    Log,
}

impl Scale {
    pub fn of(info: &ParameterInfo) -> Self {
        if info.neutral == 1.0 || !info.nodes.is_empty() { Self::Log } else { Self::Linear }
    }

    pub fn inside(self, value: f64) -> f64 {
        match self {
            Self::Linear => value,
            Self::Log => value.max(1e-9).ln(),
        }
    }

    pub fn outside(self, inside: f64) -> f64 {
        match self {
            Self::Linear => inside,
            Self::Log => inside.exp(),
        }
    }
}

/// Sizes that a careful laboratory would overlook reach so many times as far as those of an ordinary rig.
const OVERLOOKED: f64 = 3.0;

/// Prior of an effect's parameter inside the fits: mean and standard deviation of a uniform one over the likely values, or of sizes
/// that may be overlooked, whichever is narrower.
pub(super) fn prior(info: &ParameterInfo) -> Prior {
    let scale = Scale::of(info);
    let [low, high] = info.likely.map(|end| scale.inside(end));
    let mean = if info.nodes.is_empty() { scale.inside(info.neutral) } else { 0.5 * (low + high) };
    let likely = (high - low) / 12f64.sqrt();
    let overlooked = scale.inside(info.neutral + info.prior_sd) - scale.inside(info.neutral);
    let sd = if info.nodes.is_empty() { likely.min(OVERLOOKED * overlooked) } else { likely };
    Prior { mean, sd }
}

/// Which parameters are unknown.
#[derive(Debug, Clone)]
pub(super) struct Layout {
    pub rig: Rig,
    /// What the tissue is made of; the modulus is K of springs, or E of a body.
    pub support: Support,
    /// Whether there are lateral runs and insertions.
    pub kinds: [bool; 2],
    pub effects: Vec<&'static dyn Effect>,
    /// Needles that were solved lately.
    pub cache: Arc<Cache>,
}

impl Layout {
    /// With one effect more.
    pub fn with(&self, effect: &'static dyn Effect) -> Self {
        let mut effects = self.effects.clone();
        effects.push(effect);
        Self { effects, ..self.clone() }
    }

    /// With one effect less.
    pub fn without(&self, index: usize) -> Self {
        let mut effects = self.effects.clone();
        effects.remove(index);
        Self { effects, ..self.clone() }
    }

    /// Parameters that are no effect's.
    pub fn own(&self) -> usize {
        match self.kinds {
            [_, false] => 1,
            [false, true] => 2,
            [true, true] => 3,
        }
    }

    /// Where the parameters of an effect start.
    pub fn first_of(&self, index: usize) -> usize {
        self.own() + self.effects[..index].iter().map(|effect| effect.parameters().len()).sum::<usize>()
    }

    /// Parameters of a fit that starts from these values.
    pub fn parameters(&self, starts: &[f64]) -> Vec<Parameter> {
        let bounded = |least: f64, most: f64, mean: f64, sd: f64, step: f64| Parameter {
            start: 0.0,
            step,
            least,
            most,
            prior: Some(Prior { mean, sd }),
        };
        let [least, most] = MODULUS_PA.map(f64::ln);
        let mut parameters = vec![bounded(least, most, TYPICAL_MODULUS_PA.ln(), MODULUS_SD_LN, 1e-4)];
        if self.kinds[1] {
            parameters.push(bounded(-50.0, 50.0, 0.0, LOAD_SD_N, 1e-4));
            if self.kinds[0] {
                parameters.push(bounded(-1.0, 1.0, 0.0, INSERTION_SD_LN, 1e-4));
            }
        }
        for info in self.effects.iter().flat_map(|effect| effect.parameters()) {
            let scale = Scale::of(info);
            let [least, most] = info.range.map(|end| scale.inside(end));
            let Prior { mean, sd } = prior(info);
            let step = match (scale, info.nodes.is_empty()) {
                (Scale::Log, false) => 0.03,
                (Scale::Log, true) => 1e-3,
                (Scale::Linear, _) => 3e-3 * info.prior_sd,
            };
            parameters.push(bounded(least, most, mean, sd, step));
        }
        for (parameter, start) in parameters.iter_mut().zip(starts) {
            // Off a bound, so that both differences of the derivative exist.
            let room = parameter.step.min(0.25 * (parameter.most - parameter.least));
            parameter.start = start.clamp(parameter.least + room, parameter.most - room);
        }
        parameters
    }

    /// Where a fit starts that knows nothing.
    pub fn first_values(&self) -> Vec<f64> {
        let mut values = vec![TYPICAL_MODULUS_PA.ln(), TYPICAL_LOAD_N, 0.0];
        values.truncate(self.own());
        let infos = self.effects.iter().flat_map(|effect| effect.parameters());
        values.extend(infos.map(|info| Scale::of(info).inside(info.neutral)));
        values
    }

    /// Values of the effects' parameters in their own units.
    pub fn effect_values(&self, values: &[f64]) -> Vec<(&'static dyn Effect, Vec<f64>)> {
        let mut at = self.own();
        let mut of_effect = |effect: &&'static dyn Effect| {
            let infos = effect.parameters();
            let own = infos.iter().zip(&values[at..]).map(|(info, v)| Scale::of(info).outside(*v)).collect();
            at += infos.len();
            (*effect, own)
        };
        self.effects.iter().map(&mut of_effect).collect()
    }

    /// The model of these values for a kind of run.
    ///
    /// # Errors
    /// [`ModelError::OutOfRange`] where a value is impossible.
    pub fn model(&self, values: &[f64], kind: Kind) -> Result<Model, ModelError> {
        let apart = if kind == Kind::Insertion && self.own() == 3 { values[2] } else { 0.0 };
        let mut model = Model::on(self.rig.clone(), self.support, (values[0] + apart).exp())?;
        if self.kinds[1] {
            model.tip = TipLaw::load([values[1], 0.0]);
        }
        model.effects = self.effect_values(values);
        // The order of the catalogue is that of the physics: what the needle does comes before what sensors make of it.
        let place = |id: &str| crate::model::effects::EFFECTS.iter().position(|effect| effect.id() == id);
        model.effects.sort_by_key(|(effect, _)| place(effect.id()));
        Ok(model)
    }
}

/// What a run's data should be, in SI, in their order.
pub(super) fn predicted(run: &Run, channels: &Channels) -> Vec<f64> {
    let of = |datum: &super::data::Datum| {
        let plane = datum.channel.plane();
        let values = |series: &crate::model::Series, index: usize| match plane {
            0 => series.y.get(index).copied(),
            _ => series.x.as_ref().and_then(|x| x.get(index)).copied(),
        };
        let value = match &datum.source {
            Source::Force(cells) => {
                let sum: Option<f64> = cells.iter().map(|i| values(&channels.force_n, *i)).sum();
                sum.map(|sum| sum / cells.len() as f64)
            }
            Source::Shape(index) => values(&channels.shape_m, *index),
            Source::Tip(index) => values(&channels.tip_m, *index),
        };
        value.unwrap_or(f64::NAN)
    };
    run.data.iter().map(of).collect()
}

/// Measured less predicted, in SI, in the order of the run's data.
pub(super) fn differences(run: &Run, channels: &Channels) -> Vec<f64> {
    run.data.iter().zip(predicted(run, channels)).map(|(datum, value)| datum.measured - value).collect()
}

/// A run with what makes its residuals independent.
#[derive(Debug, Clone)]
pub(super) struct Prepared {
    pub run: Run,
    pub whitener: Whitener,
}

impl Prepared {
    /// Independent residuals of unit variance under a model.
    ///
    /// # Errors
    /// Where the model cannot be evaluated.
    pub fn residuals(&self, layout: &Layout, values: &[f64]) -> Result<Vec<f64>, ModelError> {
        let model = layout.model(values, self.run.kind)?;
        let predicted = predict_with(&model, &self.run.experiment, &layout.cache)?;
        let mut residuals = differences(&self.run, &predicted);
        self.whitener.apply(&mut residuals);
        Ok(residuals)
    }
}

/// Quantile of the normal distribution for intervals of 95 %.
pub(super) const NORMAL_975: f64 = 1.959_963_984_540_054;
