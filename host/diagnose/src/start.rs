//! Fit of the starting model before the search: first on springs, then on another foundation.

use super::adequacy::Adequacy;
use super::data::Run;
use super::discrepancy::patterns;
use super::evidence::Patterns;
use super::found::Found;
use super::layout::{Layout, Prepared, Scale};
use super::noise::Noise;
use super::posterior::{Fitted, MAX_ROUNDS};
use super::weights::NO_WEIGHT;
use super::whiten::Whitener;
use super::{DiagnoseError, Multiples};
use mechanics::effects::Effect;
use mechanics::{ModelError, Support};
use rayon::prelude::*;
use readings::FitError;

/// Number of rounds after which fits from several starts are compared, and log evidence behind the best one at which a fit is given up.
const FIRST_ROUNDS: usize = 5;
const FAR_BEHIND: f64 = 20.0;

/// Noise of a session and of its reference.
pub(super) struct Noises {
    pub session: Noise,
    pub reference: Noise,
}

impl Noises {
    pub fn of(&self, run: &Run) -> &Noise {
        if run.is_reference { &self.reference } else { &self.session }
    }
}

/// The fitted starting model, with the prepared runs and the patterns of the discrepancy.
#[derive(Debug)]
pub(super) struct Start {
    pub runs: Vec<Prepared>,
    pub patterns: Patterns,
    pub fitted: Fitted,
}

/// Fits the starting model twice, because the whitening and the patterns of the discrepancy depend on the predictions; the first fit is
/// without discrepancy. `multiples` are the ratios of the discrepancy's sizes to usual ones.
pub(super) fn fit_start(
    layout: &Layout,
    runs: &[Run],
    noises: &Noises,
    given: &[(&'static dyn Effect, Vec<f64>)],
    multiples: &Multiples,
) -> Result<Start, DiagnoseError> {
    let mut first_values = layout.first_values();
    let infos = given.iter().flat_map(|(effect, values)| effect.parameters().iter().zip(values));
    for (value, (info, given)) in first_values[layout.own()..].iter_mut().zip(infos) {
        *value = Scale::of(info).inside(*given);
    }
    let first = prepared(layout, &first_values, runs, noises)?;
    let no_patterns = Patterns::none(first.iter().map(|run| run.run.data.len()));
    let ends = layout.starts(&first_values);
    let mut ends: Vec<Fitted> = ends
        .par_iter()
        .map(|values| Fitted::new(layout, &first, &no_patterns, values, &[], MAX_ROUNDS))
        .collect::<Result<_, _>>()?;
    ends.sort_by(|a, b| b.log_evidence.total_cmp(&a.log_evidence));
    // Fits that have converged to the same values are the same.
    ends.dedup_by(|a, b| a.is_at(b));
    let best = ends.first().ok_or(FitError::Undetermined)?.values();
    let runs = prepared(layout, best, runs, noises)?;
    let patterns = patterns(layout, best, &runs, multiples)?;
    let everyday = patterns.everyday();
    // If there are several fits, most of them are far behind after a few rounds.
    let rounds = if ends.len() == 1 { MAX_ROUNDS } else { FIRST_ROUNDS };
    let fits: Vec<Fitted> = ends
        .par_iter()
        .map(|end| Fitted::new(layout, &runs, &patterns, end.values(), &everyday, rounds))
        .collect::<Result<_, _>>()?;
    let best = fits.iter().map(|fit| fit.log_evidence).fold(f64::NEG_INFINITY, f64::max);
    let mut near_fits: Vec<Fitted> =
        fits.into_iter().filter(|fit| fit.log_evidence > best - FAR_BEHIND).collect();
    near_fits.dedup_by(|a, b| a.is_at(b));
    let settled: Vec<Fitted> = near_fits
        .into_par_iter()
        .map(|fit| match fit.settled {
            true => Ok(fit),
            false => Fitted::new(layout, &runs, &patterns, fit.values(), &fit.sizes, MAX_ROUNDS),
        })
        .collect::<Result<_, _>>()?;
    let best = settled.into_iter().max_by(|a, b| a.log_evidence.total_cmp(&b.log_evidence));
    Ok(Start { runs, patterns, fitted: best.ok_or(FitError::Undetermined)? })
}

/// Runs with whiteners around the model with these values.
fn prepared(
    layout: &Layout,
    values: &[f64],
    runs: &[Run],
    noises: &Noises,
) -> Result<Vec<Prepared>, ModelError> {
    let mut prepared = Vec::with_capacity(runs.len());
    for run in runs {
        let model = layout.model_of(values, run.kind, run.is_reference)?;
        prepared.push(Prepared { run: run.clone(), whitener: Whitener::new(run, noises.of(run), &model)? });
    }
    Ok(prepared)
}

impl Start {
    /// Whether this foundation is implausible given the result on the other one: effects were found there, and the same effects
    /// on this foundation have far less evidence. If no effect was named there, this foundation is searched too.
    ///
    /// # Errors
    /// Where the model cannot be evaluated.
    pub fn is_far_behind(&self, found: &Found, plain: &Fitted) -> Result<bool, FitError> {
        if found.members.is_empty() {
            return Ok(false);
        }
        let (layout, starts) =
            self.with_effects_of(&found.fitted, self.ln_modulus_beside(&found.fitted, plain));
        let same_fit =
            Fitted::new(&layout, &self.runs, &self.patterns, &starts, &found.fitted.sizes, MAX_ROUNDS);
        Ok(same_fit.is_ok_and(|same_fit| same_fit.log_evidence < found.fitted.log_evidence + NO_WEIGHT))
    }

    /// Start value of the logarithm of this foundation's modulus with the effects of a model on another foundation. It assumes
    /// that effects change the moduli of both by about the same factor.
    pub fn ln_modulus_beside(&self, model: &Fitted, plain: &Fitted) -> f64 {
        let [own_ln, model_ln, plain_ln] = [&self.fitted, model, plain].map(Fitted::ln_modulus);
        own_ln + model_ln - plain_ln
    }

    /// This foundation with the effects of a model on another one, and start values, which are those of that model except for
    /// the modulus.
    pub fn with_effects_of(&self, model: &Fitted, ln_modulus: f64) -> (Layout, Vec<f64>) {
        let layout = Layout { support: self.fitted.layout.support, ..model.layout.clone() };
        let mut values = model.values().to_vec();
        values.iter_mut().take(1).for_each(|value| *value = ln_modulus);
        (layout, values)
    }

    /// Adequacy of the starting model.
    ///
    /// # Errors
    /// Where the model cannot be evaluated.
    pub fn adequacy(&self) -> Result<Adequacy, FitError> {
        Adequacy::of(&self.fitted, &self.runs, &self.patterns)
    }

    /// The same runs on another foundation.
    pub fn on(&self, support: Support) -> Result<Self, FitError> {
        let layout = Layout { support, ..self.fitted.layout.clone() };
        let (values, sizes) = (self.fitted.values(), &self.fitted.sizes);
        let everyday = self.patterns.everyday();
        let sizes: Vec<f64> = sizes.iter().zip(everyday).map(|(size, most)| size.min(most)).collect();
        let fitted = Fitted::new(&layout, &self.runs, &self.patterns, values, &sizes, MAX_ROUNDS)?;
        Ok(Self { fitted, runs: self.runs.clone(), patterns: self.patterns.clone() })
    }
}
