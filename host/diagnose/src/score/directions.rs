//! Effect of amplitudes on the readings, with one hypothesis per possible place or time of an effect.

use crate::data::Kind;
use crate::layout::{Layout, Prepared, Scale, prior};
use crate::posterior::Fitted;
use mechanics::effects::{Effect, neutral};
use nalgebra::DVector;
use rayon::prelude::*;
use std::sync::Arc;

/// One hypothesis of an effect: a place or time at which it acts, and the directions of its amplitudes.
#[derive(Debug, Clone)]
pub(in crate::score) struct Hypothesis {
    /// Values of the parameters at amplitudes of one, each alone.
    pub probes: Vec<Vec<f64>>,
    /// Precision of the prior of every amplitude.
    pub precisions: Vec<f64>,
    /// Whether an amplitude may be negative.
    pub two_sided: Vec<bool>,
    /// Columns of all directions.
    pub columns: Vec<usize>,
}

/// Effect of every amplitude on the whitened readings of every run.
#[derive(Debug, Clone)]
pub(crate) struct Directions {
    pub(in crate::score) hypotheses: Arc<[(&'static dyn Effect, Vec<Hypothesis>)]>,
    /// Directions of every amplitude, per run.
    pub(in crate::score) directions: Vec<Vec<DVector<f64>>>,
    /// Number of readings of each run.
    pub(in crate::score) readings: Vec<usize>,
}

impl Directions {
    /// Directions of all hypotheses of some effects around a fit; effects that are in its model have none.
    pub fn of(effects: &[&'static dyn Effect], fitted: &Fitted, runs: &[Prepared]) -> Self {
        let known = |effect: &dyn Effect| fitted.layout.effects.iter().any(|e| e.id() == effect.id());
        let unknown: Vec<&'static dyn Effect> = effects
            .iter()
            .copied()
            .filter(|effect| !known(*effect) && fitted.layout.is_applicable(*effect))
            .collect();
        let of_effect = |effect: &'static dyn Effect| {
            let layout = fitted.layout.with(effect);
            let with_directions = |hypothesis: Hypothesis| {
                let directions: Vec<Vec<DVector<f64>>> = hypothesis
                    .probes
                    .iter()
                    .map(|probe| {
                        let values = values_at(fitted, effect, probe);
                        runs.iter()
                            .zip(&fitted.residuals)
                            .map(|(run, plain)| direction(&layout, &values, effect, run, plain))
                            .collect()
                    })
                    .collect();
                (hypothesis, directions)
            };
            (effect, hypotheses_of(effect).into_iter().map(with_directions).collect::<Vec<_>>())
        };
        let all: Vec<_> = unknown.into_par_iter().map(of_effect).collect();
        let (mut hypotheses, mut directions) = (Vec::new(), Vec::new());
        for (effect, of_effect) in all {
            let numbered = |(mut hypothesis, mut more): (Hypothesis, Vec<Vec<DVector<f64>>>)| {
                hypothesis.columns.extend(directions.len()..directions.len() + more.len());
                directions.append(&mut more);
                hypothesis
            };
            hypotheses.push((effect, of_effect.into_iter().map(numbered).collect()));
        }
        let readings = fitted.residuals.iter().map(Vec::len).collect();
        Self { hypotheses: hypotheses.into(), directions, readings }
    }

    /// Directions with the readings of one more run, whose residuals are those of the fit.
    pub fn with_run(mut self, fitted: &Fitted, run: &Prepared, residuals: &[f64]) -> Self {
        self.readings.push(residuals.len());
        for (effect, hypotheses) in self.hypotheses.iter() {
            let layout = fitted.layout.with(*effect);
            for hypothesis in hypotheses {
                for (probe, column) in hypothesis.probes.iter().zip(&hypothesis.columns) {
                    let values = values_at(fitted, *effect, probe);
                    if let Some(of_runs) = self.directions.get_mut(*column) {
                        of_runs.push(direction(&layout, &values, *effect, run, residuals));
                    }
                }
            }
        }
        self
    }
}

/// Values of a fit's parameters and of an effect behind them.
fn values_at(fitted: &Fitted, effect: &dyn Effect, probe: &[f64]) -> Vec<f64> {
    let mut values = fitted.values().to_vec();
    let infos = effect.parameters().iter().zip(probe);
    values.extend(infos.map(|(info, value)| Scale::of(info).inside(*value)));
    values
}

/// Change of the predictions of a run; zero if the run does not show the effect, or if the model has no solution with the effect of this size
/// (a needle that buckles).
fn direction(
    layout: &Layout,
    values: &[f64],
    effect: &dyn Effect,
    run: &Prepared,
    plain: &[f64],
) -> DVector<f64> {
    let shows = effect.info().observable_in;
    let is_shown = if run.run.kind == Kind::Insertion { shows.insertion } else { shows.lateral };
    let changed = is_shown.then(|| run.residuals(layout, values).ok()).flatten();
    match changed {
        Some(changed) if changed.iter().all(|value| value.is_finite()) => {
            DVector::from_iterator(plain.len(), plain.iter().zip(changed).map(|(a, b)| a - b))
        }
        _ => DVector::zeros(plain.len()),
    }
}

/// Every hypothesis of an effect.
fn hypotheses_of(effect: &'static dyn Effect) -> Vec<Hypothesis> {
    let infos = effect.parameters();
    let places: Vec<Option<f64>> = match infos.iter().find(|info| !info.nodes.is_empty()) {
        Some(info) => info.nodes.iter().map(|node| Some(*node)).collect(),
        None => vec![None],
    };
    let hypothesis = |place: Option<f64>| {
        let mut hypothesis = Hypothesis {
            probes: Vec::new(),
            precisions: Vec::new(),
            two_sided: Vec::new(),
            columns: Vec::new(),
        };
        for (index, info) in infos.iter().enumerate().filter(|(_, info)| info.nodes.is_empty()) {
            let mut values = neutral(effect);
            values[index] += info.prior_sd;
            for (value, info) in values.iter_mut().zip(infos) {
                if !info.nodes.is_empty() {
                    *value = place.unwrap_or(*value);
                }
            }
            let scale = Scale::of(info);
            let step = scale.inside(values[index]) - scale.inside(info.neutral);
            hypothesis.probes.push(values);
            hypothesis.precisions.push((step / prior(info).sd).powi(2));
            hypothesis.two_sided.push(info.is_two_sided());
        }
        hypothesis
    };
    places.into_iter().map(hypothesis).collect()
}
