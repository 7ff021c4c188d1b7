//! Known parameters of a rig with their standard deviations, for example from runs in air, and the test of whether they have
//! changed since.

use super::DiagnoseError;
use super::characterize::Characterisation;
use super::layout::{Layout, Scale};
use super::posterior::Fitted;
use super::start::Start;
use formats::NORMAL_975;
use formats::model_file::ModelFile;
use mechanics::effects::Effect;
use readings::{FitError, Prior};
use serde::Serialize;
use std::fmt::{self, Display};
use std::sync::Arc;

/// A difference of more standard deviations than this is a change: by chance one of a dozen parameters exceeds it in one session of 180.
const MOVED_SD: f64 = 3.5;
/// Smallest fraction of a parameter's precision that comes from the runs, if they are to contradict the known value.
const MIN_SHARE: f64 = 0.05;
/// A parameter is fixed by a prior with this fraction of its standard deviation.
const HELD: f64 = 1e-3;

/// A known parameter of an effect, in the unit of its name.
#[derive(Debug, Clone, PartialEq)]
pub struct KnownParameter {
    /// Id of the effect.
    pub effect: String,
    /// Name of the parameter.
    pub parameter: String,
    /// Its value.
    pub value: f64,
    /// Standard deviation of it.
    pub sd: f64,
}

impl KnownParameter {
    /// All parameters that a file states with an interval, which is taken as that of a normal distribution.
    pub fn of_model(model: &ModelFile) -> Vec<Self> {
        let mut known_parameters = Vec::new();
        for learned in &model.effects {
            let parameters = learned.effect.parameters().iter().zip(&learned.values).zip(&learned.ci95);
            known_parameters.extend(parameters.filter_map(|((info, value), ci95)| {
                let [low, high] = (*ci95)?;
                let sd = (high - low) / (2.0 * NORMAL_975);
                let is_usable = sd > 0.0 && sd.is_finite();
                is_usable.then(|| Self {
                    effect: learned.effect.id().to_owned(),
                    parameter: info.name.to_owned(),
                    value: *value,
                    sd,
                })
            }));
        }
        known_parameters
    }

    /// Adds the effects of a rig to those of a model, and the parameters that the rig states to the known ones, where they replace those of
    /// the same name. The values of effects that were stated before are kept: a fit only starts from them, so that they are no knowledge
    /// beside the rig's intervals.
    pub fn take(effects: &mut Vec<(&'static dyn Effect, Vec<f64>)>, known: &mut Vec<Self>, rig: &ModelFile) {
        for (effect, values) in rig.effects() {
            if effects.iter().all(|(own, _)| own.id() != effect.id()) {
                effects.push((effect, values));
            }
        }
        let of_rig = Self::of_model(rig);
        known.retain(|own| !of_rig.iter().any(|one| one.is_of(&own.effect, &own.parameter)));
        known.extend(of_rig);
    }

    /// Whether it is this parameter of this effect.
    pub(super) fn is_of(&self, effect: &str, parameter: &str) -> bool {
        self.effect == effect && self.parameter == parameter
    }

    /// The change to an independent estimate, if it is significant.
    fn moved_to(&self, now: f64, now_sd: f64) -> Option<Moved> {
        let sd = self.sd.hypot(now_sd);
        let change = now - self.value;
        (change.abs() > MOVED_SD * sd).then(|| Moved {
            effect: self.effect.clone(),
            parameter: self.parameter.clone(),
            before: self.value,
            now,
            change95: [change - NORMAL_975 * sd, change + NORMAL_975 * sd],
            sds: change / sd,
        })
    }

    /// The prior in the scale of the fits.
    pub(super) fn prior(&self, scale: Scale) -> Prior {
        let mean = scale.inside(self.value);
        Prior { mean, sd: (scale.inside(self.value + self.sd) - mean).abs() }
    }
}

/// A parameter that has changed.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Moved {
    /// Id of the effect.
    pub effect: String,
    /// Name of the parameter.
    pub parameter: String,
    /// Former value.
    pub before: f64,
    /// Present value.
    pub now: f64,
    /// The 95 % interval of the difference.
    pub change95: [f64; 2],
    /// The difference in its standard deviations.
    pub sds: f64,
}

impl Display for Moved {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { effect, parameter, before, now, change95: [low, high], .. } = self;
        let change = now - before;
        write!(
            f,
            "{effect} {parameter}: from {before:.4} to {now:.4}, a change of {change:+.4} ({low:+.4} to {high:+.4})"
        )
    }
}

/// Parameters that have changed from the known values to those of these runs, the clearest change first.
pub fn moved_since(known: &[KnownParameter], found: &Characterisation) -> Vec<Moved> {
    let moved = known.iter().filter_map(|known| {
        let now = found.parameters.iter().find(|one| known.is_of(one.effect, one.parameter))?;
        // The estimate of a parameter that the runs do not identify is that of its prior.
        if now.is_identified() { known.moved_to(now.value, now.sd) } else { None }
    });
    sorted(moved.collect())
}

/// A start without the known values that the runs contradict.
pub(super) struct Released {
    /// The fit.
    pub start: Start,
    /// The model with the known values, if the runs contradict them.
    pub as_known: Option<AsKnown>,
    /// Changed parameters, the clearest change first.
    pub moved: Vec<Moved>,
}

/// A start with all known parameters fixed at their values. If they were free within their intervals, parameters that have not changed
/// would absorb the effect of the changed one.
pub(super) struct AsKnown {
    start: Start,
    known: Arc<[KnownParameter]>,
}

impl AsKnown {
    /// The same on the foundation of another start, without the sensitivities to the fixed parameters, which must not explain any misfit.
    pub fn beside(self, other: &Start) -> Result<Start, FitError> {
        let support = other.fitted.layout.support;
        let is_there = self.start.fitted.layout.support == support;
        let mut start = if is_there { self.start } else { self.start.on(support)? };
        for known in self.known.iter() {
            if let Some((parameter_index, _)) = place(known, &start.fitted) {
                start
                    .fitted
                    .jacobian
                    .iter_mut()
                    .for_each(|of_run| of_run.column_mut(parameter_index).fill(0.0));
            }
        }
        Ok(start)
    }
}

/// Fits the start. If the runs contradict known values, it is fitted again with all known parameters fixed, and without the contradicted
/// values.
pub(super) fn released(
    layout: &mut Layout,
    fit: impl Fn(&Layout) -> Result<Start, DiagnoseError>,
) -> Result<Released, DiagnoseError> {
    let start = fit(layout)?;
    let contradicted = contradicted(&start.fitted);
    if contradicted.is_empty() {
        return Ok(Released { start, as_known: None, moved: Vec::new() });
    }
    let held_parameters =
        layout.known.iter().map(|one| KnownParameter { sd: HELD * one.sd, ..one.clone() }).collect();
    let held_layout = Layout { known: held_parameters, ..layout.clone() };
    let as_known = AsKnown { start: fit(&held_layout)?, known: held_layout.known };
    layout.known = without(&layout.known, &contradicted);
    let start = fit(layout)?;
    let moved = moved(&contradicted, &start.fitted);
    Ok(Released { start, as_known: Some(as_known), moved })
}

/// Known parameters that the runs contradict: the estimate by the runs alone, without the prior, is too far from the known value.
fn contradicted(fitted: &Fitted) -> Vec<KnownParameter> {
    let contradicted = fitted.layout.known.iter().filter(|known| {
        let Some((parameter_index, scale)) = place(known, fitted) else { return false };
        let Prior { mean, sd } = known.prior(scale);
        let (value, precision) = (
            fitted.values().get(parameter_index).copied().unwrap_or(mean),
            fitted.sd(parameter_index).powi(-2),
        );
        let data_precision = precision - sd.powi(-2);
        // If nearly all of the precision is that of the prior, the runs have no information of their own.
        data_precision > MIN_SHARE * precision && {
            let estimate = (value * precision - mean * sd.powi(-2)) / data_precision;
            (estimate - mean).abs() > MOVED_SD * sd.hypot(data_precision.sqrt().recip())
        }
    });
    contradicted.cloned().collect()
}

/// The known parameters without some of them.
fn without(known: &[KnownParameter], less: &[KnownParameter]) -> Arc<[KnownParameter]> {
    known.iter().filter(|one| !less.contains(one)).cloned().collect()
}

/// Values of contradicted parameters in a fit without their prior knowledge.
fn moved(contradicted: &[KnownParameter], fitted: &Fitted) -> Vec<Moved> {
    let moved = contradicted.iter().filter_map(|known| {
        let (parameter_index, scale) = place(known, fitted)?;
        let inside_value = *fitted.values().get(parameter_index)?;
        let now = scale.outside(inside_value);
        let sd = (scale.outside(inside_value + fitted.sd(parameter_index)) - now).abs();
        known.moved_to(now, sd)
    });
    sorted(moved.collect())
}

/// Position of a known parameter among those of a fit.
fn place(known: &KnownParameter, fitted: &Fitted) -> Option<(usize, Scale)> {
    let effects = fitted.layout.effects.iter().enumerate();
    let mut effect_parameters = effects.flat_map(|(number, effect)| {
        let parameters = effect.parameters().iter().enumerate();
        parameters.map(move |(index, info)| (number, index, effect.id(), info))
    });
    let (number, index, _, info) = effect_parameters.find(|(_, _, id, info)| known.is_of(id, info.name))?;
    Some((fitted.layout.first_of(number) + index, Scale::of(info)))
}

/// The clearest change first.
fn sorted(mut moved: Vec<Moved>) -> Vec<Moved> {
    moved.sort_by(|a, b| b.sds.abs().total_cmp(&a.sds.abs()));
    moved
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::path::Path;

    fn parameter(effect: &str, parameter: &str, value: f64) -> KnownParameter {
        KnownParameter { effect: effect.to_owned(), parameter: parameter.to_owned(), value, sd: 0.01 }
    }

    #[test]
    fn a_rig_replaces_the_parameters_that_it_states_and_keeps_all_others() {
        let text = "[model]\nformat = 1\n[[effect]]\nid = \"rig.play\"\n[effect.parameters.half_width_mm]\n\
                    value = 0.05\nci95 = [0.04, 0.06]\n";
        let rig = ModelFile::parse(Path::new("rig.toml"), text).expect("a model");
        let weighed = parameter("sensor.force_gain", "gain", 1.02);
        let mut known = vec![parameter("rig.play", "half_width_mm", 0.2), weighed.clone()];
        let mut effects = Vec::new();
        // Every list of effects takes the same rig; the second time changes nothing.
        for _ in 0..2 {
            KnownParameter::take(&mut effects, &mut known, &rig);
            assert_eq!(known.len(), 2, "{known:?}");
            assert!(known.contains(&weighed), "{known:?}");
            let play = known.iter().find(|one| one.is_of("rig.play", "half_width_mm")).expect("the play");
            assert_eq!(play.value, 0.05);
            assert_eq!(effects.len(), 1);
        }
    }
}
