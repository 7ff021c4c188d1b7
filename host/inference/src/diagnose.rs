//! The discrepancy workflow: where model and measurement disagree, which effect is missing, and what adding it is worth.
//!
//! | step | file |
//! |---|---|
//! | runs as numbers with their places | `data`, `cells` |
//! | split: what is learned from, what judges | `split` |
//! | noise, and residuals made independent | `noise`, `whiten` |
//! | what is unknown | `layout` |
//! | what every rig leaves behind any model | `discrepancy` |
//! | evidence with that discrepancy, and fits | `evidence`, `posterior` |
//! | where it disagrees, and whether at all | `adequacy` |
//! | score every effect, margin by bootstrap | `score` |
//! | refit, accept, add, repeat; competing effects | `search` |
//! | what would distinguish competing effects | `next` |
//! | before and after on what was held out | `split` |
//! | what remains, and whether it matters | `remaining` |
//! | intervals over all members of a class | `averaged` |
//! | the result | `report`, `results` |
//!
//! Related: Kennedy and O'Hagan's model discrepancy, nested-model comparison by evidence, efficient score tests, scan statistics,
//! optimal discriminating designs. What is added is the loop, with names, abstention and a proof on runs that no fit has used.

mod adequacy;
mod averaged;
mod cells;
mod data;
mod discrepancy;
pub mod display;
mod evidence;
mod expected;
mod foundation;
mod layout;
mod misread;
mod next;
mod noise;
mod posterior;
mod remaining;
mod report;
mod results;
mod score;
mod search;
mod split;
mod two_layers;
mod whiten;

pub use data::Channel;
pub use expected::{Expected, Truth, expected};
pub use formats::model_file::{DISCREPANCY_NAMES, Multiples};
pub(crate) use foundation::{BesideInput, DiscrepantModulus, FoundationEvidence, beside_discrepancy};
pub use results::{
    AdequacyResult, Diagnosis, Estimate, FoundEffect, FoundationResult, Gap, GapSide, MeanModulus,
    NextMeasurement, Ranked, ReferenceResult, RegionResult, RemainingResult, RemainingSize, ResidualPoint,
    Verdict,
};
pub(crate) use two_layers::{Interval, TwoLayers, two_layers};

use crate::FitError;
use adequacy::{Adequacy, regions};
use data::Run;
use discrepancy::patterns;
use evidence::Patterns;
use formats::session::Session;
use layout::{Layout, Prepared, Scale, kinds};
use mechanics::effects::Effect;
use mechanics::{Experiment, Insertion, ModelError, Support};
use noise::Noise;
use posterior::{Fitted, MAX_ROUNDS};
use rayon::prelude::*;
use remaining::Remaining;
use report::DiagnosisReport;
use search::{Found, Search};
use split::{Judge, Training, split};
use std::path::PathBuf;
use whiten::Whitener;

/// What the user may choose.
#[derive(Debug, Clone)]
pub struct Options {
    /// Effects of the model to start from, with first values of their parameters.
    pub given: Vec<(&'static dyn Effect, Vec<f64>)>,
    /// Seed of the bootstraps.
    pub seed: u64,
    /// What the tissue is taken for.
    pub foundation: FoundationChoice,
    /// Poisson's ratio of the tissue where it is a body, 0 to 0.5.
    pub poisson: f64,
    /// What of the discrepancy is larger than in an ordinary rig, as multiples of that, by the names of a model file.
    pub discrepancy: Multiples,
    /// The session to compare with: what it determines is carried over, and what differs from it is searched for.
    pub reference: Option<Session>,
}

/// What the tissue is taken for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum FoundationChoice {
    /// Springs or a body, as the evidence has it.
    #[default]
    Auto,
    /// Springs (Winkler).
    Springs,
    /// An elastic body.
    Body,
}

/// Poisson's ratio of soft tissue and gels.
pub const INCOMPRESSIBLE: f64 = 0.5;

impl Default for Options {
    fn default() -> Self {
        Self {
            given: Vec::new(),
            seed: 1,
            foundation: FoundationChoice::Auto,
            poisson: INCOMPRESSIBLE,
            discrepancy: Multiples::new(),
            reference: None,
        }
    }
}

/// Why a session cannot be diagnosed.
#[derive(Debug, thiserror::Error)]
pub enum DiagnoseError {
    /// It has nothing to diagnose.
    #[error("{}: lateral, insertion: missing, expected at least one [[lateral]] or [[insertion]]", path.display())]
    NoRuns {
        /// The session file.
        path: PathBuf,
    },
    /// None of its runs can be used.
    #[error("no run can be used: {}", reasons.join("; "))]
    AllFailed {
        /// Reason of each run.
        reasons: Vec<String>,
    },
    /// The model cannot be evaluated.
    #[error(transparent)]
    Model(#[from] ModelError),
    /// The starting model does not fit in any way.
    #[error("the model cannot be fitted: {0}")]
    Fit(#[from] FitError),
}

/// Beside others an effect with more competitors than this is no name.
const MAX_IN_CLASS: usize = 3;

/// Diagnoses a session; `on_progress` receives a line for each step.
///
/// # Errors
/// [`DiagnoseError`] where nothing can be diagnosed.
pub fn diagnose(
    session: &Session,
    options: &Options,
    mut on_progress: impl FnMut(&str),
) -> Result<Diagnosis, DiagnoseError> {
    let (runs, mut warnings) = runs_of(session)?;
    let all: Vec<Run> = runs.clone();
    let (Training { mut runs, rule }, held_out) = split(runs);
    on_progress(&rule);
    let (noise, disagreements) = Noise::with_disagreements(&runs, &session.stated_noise());
    warnings.extend(disagreements);
    let given: Vec<&'static dyn Effect> = options.given.iter().map(|(effect, _)| *effect).collect();
    let mut layout = Layout::new(&session.rig, &runs, given);
    let mut noises = Noises { session: noise, reference: noise };
    let mut multiples = options.discrepancy.clone();
    if let Some(reference) = &options.reference {
        on_progress("the reference is fitted");
        let (mut of_reference, skipped) = runs_of(reference)?;
        of_reference.iter_mut().for_each(|run| run.is_reference = true);
        warnings.extend(skipped.into_iter().map(|what| format!("reference: {what}")));
        noises.reference = Noise::of(&of_reference, &reference.noise);
        let alone = Layout { rig: reference.rig.clone(), kinds: kinds(&of_reference), ..layout.clone() };
        let fitted = fit_start(&alone, &of_reference, &noises, &options.given, &multiples)?;
        multiples.extend(fitted.fitted.multiples(&fitted.patterns));
        layout.reference = Some(reference.rig.clone());
        runs.extend(of_reference);
        layout.kinds = kinds(&runs);
        share_nodes(&mut runs);
    }
    let start = fit_start(&layout, &runs, &noises, &options.given, &multiples)?;
    let judge = held_out.judge(&start.fitted, &start.runs, &noise, &multiples)?;
    on_progress(&format!("{} effects are scored", mechanics::effects::EFFECTS.len() - layout.effects.len()));
    let (foundation, start, found) = choose(start, &judge, options, &mut on_progress)?;
    let Start { runs: prepared, patterns, fitted: start } = start;
    let before = Adequacy::of(&start, &prepared, &patterns)?;
    let where_before = regions(&start, &prepared);
    let after = Adequacy::of(&found.fitted, &prepared, &patterns)?;

    let verdict = verdict(&found, &before, judge.share(&start, &found.fitted));
    let is_large = || Remaining::of(&before, &start, &patterns, None).size == RemainingSize::Large;
    // What moves the modulus beyond its interval is no everyday matter, however smooth it is.
    let verdict = if verdict == Verdict::Adequate && is_large() { Verdict::Unexplained } else { verdict };
    let is_named = matches!(verdict, Verdict::Named | Verdict::Ambiguous);
    let final_fit = if is_named { &found.fitted } else { &start };
    on_progress("the runs that were held out are compared");
    let gap = judge.gap(&start, final_fit, options.seed)?;
    let remaining =
        Remaining::of(if is_named { &after } else { &before }, final_fit, &patterns, gap.as_ref());
    let report = DiagnosisReport {
        session,
        options,
        all: &all,
        start: &start,
        found: &found,
        final_fit,
        noise: &noise,
        adequacy: [&before, &after],
        verdict,
        foundation,
        split: rule,
        multiples: final_fit.multiples(&patterns),
        held_out: judge.runs(),
    };
    Ok(report.diagnosis(where_before.iter().map(report::region).collect(), gap, remaining, warnings))
}

/// How a session would be divided.
#[derive(Debug, Clone, PartialEq)]
pub struct Division {
    /// Runs that can be used.
    pub used: Vec<String>,
    /// Why others cannot.
    pub skipped: Vec<String>,
    /// Runs of which something, or all, is held out; without any nothing is ever named.
    pub held_out: Vec<String>,
    /// The division in words.
    pub rule: String,
}

/// How [`diagnose`] would divide a session into runs to learn from and runs to be judged by; nothing is fitted.
///
/// # Errors
/// [`DiagnoseError`] where no run can be used.
pub fn division(session: &Session) -> Result<Division, DiagnoseError> {
    let (runs, skipped) = runs_of(session)?;
    let used = runs.iter().map(|run| run.id.clone()).collect();
    let (Training { rule, .. }, held_out) = split(runs);
    Ok(Division { used, skipped, held_out: held_out.ids(), rule })
}

/// All runs that can be used, and why others cannot.
fn runs_of(session: &Session) -> Result<(Vec<Run>, Vec<String>), DiagnoseError> {
    if session.lateral.is_empty() && session.insertion.is_empty() {
        return Err(DiagnoseError::NoRuns { path: session.dir.join("session.toml") });
    }
    let lateral = session.lateral.iter().map(|run| (&run.id, Run::lateral(run, &session.rig)));
    let insertion = session.insertion.iter().map(|run| (&run.id, Run::insertion(run)));
    let (mut runs, mut warnings) = (Vec::new(), Vec::new());
    let criteria = crate::holds::HoldCriteria::default();
    for run in &session.lateral {
        let unused = crate::holds::unused(run, &session.rig, &criteria);
        warnings.extend(crate::holds::summary(&unused).iter().map(|what| format!("run {}: {what}", run.id)));
    }
    for (id, run) in lateral.chain(insertion) {
        match run {
            Ok(run) => runs.push(run),
            Err(why) => warnings.push(format!("run {id} is skipped: {why}")),
        }
    }
    share_nodes(&mut runs);
    if runs.is_empty() { Err(DiagnoseError::AllFailed { reasons: warnings }) } else { Ok((runs, warnings)) }
}

/// Lets all insertions use the same solutions.
fn share_nodes(runs: &mut [Run]) {
    Insertion::share_nodes(runs.iter_mut().filter_map(|run| match &mut run.experiment {
        Experiment::Insertion(done) => Some(done),
        _ => None,
    }));
}

/// Noise of a session and of its reference.
struct Noises {
    session: Noise,
    reference: Noise,
}

impl Noises {
    fn of(&self, run: &Run) -> &Noise {
        if run.is_reference { &self.reference } else { &self.session }
    }
}

/// The starting model, fitted, and what everything after it works on.
struct Start {
    runs: Vec<Prepared>,
    patterns: Patterns,
    fitted: Fitted,
}

/// Fits the starting model: twice, because what makes residuals independent, and the form of the discrepancy, depend on what to
/// expect. The first time there is noise alone. `multiples` state what of the discrepancy is larger than usual.
fn fit_start(
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
    let prepared = |values: &[f64]| -> Result<Vec<Prepared>, ModelError> {
        let of_run = |run: &Run| {
            let model = layout.model_of(values, run.kind, run.is_reference)?;
            Ok(Prepared { run: run.clone(), whitener: Whitener::new(run, noises.of(run), &model)? })
        };
        runs.iter().map(of_run).collect()
    };
    let first = prepared(&first_values)?;
    let none = Patterns::none(&first);
    let ends = layout.starts(&first_values);
    let mut ends: Vec<Fitted> = ends
        .par_iter()
        .map(|values| Fitted::new(layout, &first, &none, values, &[], MAX_ROUNDS))
        .collect::<Result<_, _>>()?;
    ends.sort_by(|a, b| b.log_evidence.total_cmp(&a.log_evidence));
    // Places that lead to the same end are one.
    ends.dedup_by(|a, b| a.is_at(b));
    let best = ends.first().ok_or(FitError::Undetermined)?.values();
    let runs = prepared(best)?;
    let patterns = patterns(layout, best, &runs, multiples)?;
    let everyday = patterns.everyday();
    let from = |starts: &Fitted, sizes: &[f64], rounds: usize| {
        Fitted::new(layout, &runs, &patterns, starts.values(), sizes, rounds)
    };
    // Most ends are far behind after a few rounds.
    let rounds = if ends.len() == 1 { MAX_ROUNDS } else { FIRST_ROUNDS };
    let fits: Vec<Fitted> =
        ends.par_iter().map(|end| from(end, &everyday, rounds)).collect::<Result<_, _>>()?;
    let best = fits.iter().map(|fit| fit.log_evidence).fold(f64::NEG_INFINITY, f64::max);
    let mut near: Vec<Fitted> = fits.into_iter().filter(|fit| fit.log_evidence > best - FAR_BEHIND).collect();
    near.dedup_by(|a, b| a.is_at(b));
    let settled: Vec<Fitted> = near
        .into_par_iter()
        .map(|fit| if fit.settled { Ok(fit) } else { from(&fit, &fit.sizes, MAX_ROUNDS) })
        .collect::<Result<_, _>>()?;
    let best = settled.into_iter().max_by(|a, b| a.log_evidence.total_cmp(&b.log_evidence));
    Ok(Start { runs, patterns, fitted: best.ok_or(FitError::Undetermined)? })
}

/// Searches on springs and, where the evidence is for it, on an elastic body, and takes what explains the runs best. A body is taken
/// where its evidence is larger by the margin: springs are the simpler model.
fn choose(
    springs: Start,
    judge: &Judge,
    options: &Options,
    mut report: impl FnMut(&str),
) -> Result<(FoundationResult, Start, Found), DiagnoseError> {
    let search = |start: &Start, report: &mut dyn FnMut(&str)| {
        let Start { runs, patterns, fitted } = start;
        Search { start: fitted, runs, patterns, judge, seed: options.seed }.run(report)
    };
    let body = match options.foundation {
        FoundationChoice::Springs => None,
        FoundationChoice::Body | FoundationChoice::Auto => {
            springs.on(Support::Body { poisson: options.poisson }).ok()
        }
    };
    let Some(body) = body else {
        let found = search(&springs, &mut report)?;
        return Ok((FoundationResult::springs(None, &springs.fitted), springs, found));
    };
    let gain = body.fitted.log_evidence - springs.fitted.log_evidence;
    let comparison = Some((gain, body.fitted.clone()));
    let only_body = options.foundation == FoundationChoice::Body;
    let (first, second) =
        if only_body || gain > FOUNDATION_MARGIN { (body, springs) } else { (springs, body) };
    report(&format!(
        "tissue as {}: log evidence of a body over springs {gain:+.1}",
        first.fitted.layout.support.name()
    ));
    let found = search(&first, &mut report)?;
    // Effects that stand in for the other foundation are needed on one of them only; and what has no name on one may have one on the
    // other, which has effects of its own.
    let is_adequate =
        found.members.is_empty() && Adequacy::of(&first.fitted, &first.runs, &first.patterns)?.is_adequate();
    let other = if is_adequate || only_body { None } else { search(&second, &mut report).ok() };
    let second_is_body = second.fitted.layout.support.is_body();
    let ahead = if second_is_body { FOUNDATION_MARGIN } else { 0.0 };
    match other {
        Some(other) if other.fitted.log_evidence > found.fitted.log_evidence + ahead => {
            let springs = if second_is_body { &first } else { &second };
            let result = FoundationResult::of(&other.fitted, &springs.fitted, comparison);
            Ok((result, second, other))
        }
        _ => {
            let springs = if second_is_body { &first } else { &second };
            let result = FoundationResult::of(&found.fitted, &springs.fitted, comparison);
            Ok((result, first, found))
        }
    }
}

impl Start {
    /// The same runs on another foundation.
    fn on(&self, support: Support) -> Result<Self, FitError> {
        let layout = Layout { support, ..self.fitted.layout.clone() };
        let (values, sizes) = (self.fitted.values(), &self.fitted.sizes);
        let everyday = self.patterns.everyday();
        let sizes: Vec<f64> = sizes.iter().zip(everyday).map(|(size, most)| size.min(most)).collect();
        let fitted = Fitted::new(&layout, &self.runs, &self.patterns, values, &sizes, MAX_ROUNDS)?;
        Ok(Self { fitted, runs: self.runs.clone(), patterns: self.patterns.clone() })
    }
}

/// Rounds after which fits from several places are compared, and how far behind the best of them one is given up.
const FIRST_ROUNDS: usize = 5;
const FAR_BEHIND: f64 = 20.0;

/// Log evidence by which a body has to be ahead of springs.
pub(crate) const FOUNDATION_MARGIN: f64 = 2.0;

/// Nothing is named that leaves the larger part of the gap.
const NAMED_SHARE: f64 = 0.15;

fn verdict(found: &Found, before: &Adequacy, share: f64) -> Verdict {
    match found.members.is_empty() {
        true if before.is_adequate() => Verdict::Adequate,
        true => Verdict::Unexplained,
        false if share < NAMED_SHARE || absorbs(found) => Verdict::Unexplained,
        false if found.members.iter().all(|member| member.class.len() == 1) => Verdict::Named,
        false => Verdict::Ambiguous,
    }
}

/// Whether effects were added that could be any of many: they absorb what another effect has left, and are no names. A single effect
/// of many possible ones is another matter: that is a weak one, as its class shows.
fn absorbs(found: &Found) -> bool {
    found.members.len() > 1 && found.members.iter().any(|member| member.class.len() > MAX_IN_CLASS)
}

#[cfg(test)]
mod moved_tests;
#[cfg(test)]
mod tests;
