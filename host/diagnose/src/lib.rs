//! The discrepancy workflow: where model and measurement disagree, which effect is missing, and what adding it is worth.
//!
//! | step | file |
//! |---|---|
//! | runs as numbers with their places, and how guide 2 moved | `data`, `cells`, `course` |
//! | split: what is learned from, what judges | `split` |
//! | noise, and residuals made independent | `noise`, `whiten` |
//! | what is unknown | `layout` |
//! | the starting model, fitted | `start` |
//! | discrepancy that every rig has from any model | `discrepancy` |
//! | evidence with that discrepancy, and fits | `evidence`, `posterior` |
//! | where it disagrees, and whether at all | `adequacy` |
//! | springs or an elastic body | `choice` |
//! | score every effect, margin by bootstrap | `score` |
//! | the same for statistics over many sessions | `linearise` |
//! | what is stated of the rig and is not so | `stated` |
//! | the rig alone, from runs in air; parameters that have changed since | `characterize`, `known` |
//! | refit, accept, add, repeat; competing effects | `search` |
//! | probabilities of models, and what is stated for sure | `weights` |
//! | what it found, and what else may be in its place | `found` |
//! | laws that no effect of the catalogue describes | `discover` |
//! | what would distinguish competing effects | `next` |
//! | before and after on what was held out | `split` |
//! | what remains, and whether it matters | `remaining` |
//! | intervals over all members of a class | `averaged` |
//! | the result | `report`, `results` |
//! | draws from its posterior, for other programs | `draws` |
//! | what runs that were not made yet would tell | `prospects` |
//! | what a session could show, before it is asked | `check` |
//! | what the walls of the tissue do to E | `walls` |
//! | effects switched on and off by a person | `workbench` |
//!
//! Related: Kennedy and O'Hagan's model discrepancy, nested-model comparison by evidence, efficient score tests, scan
//! statistics, optimal discriminating designs. The crate adds the loop, with names, abstention and a proof on runs that
//! no fit has used.
#![forbid(unsafe_code)]
#![deny(missing_docs)]

mod across;
mod adequacy;
mod averaged;
mod cells;
mod characterize;
mod check;
mod choice;
mod course;
mod data;
mod determined;
mod discover;
mod discrepancy;
pub mod display;
mod draws;
mod expected;
mod found;
mod foundation;
mod known;
mod layout;
mod learned;
mod linearise;
mod misread;
pub mod models;
mod next;
mod noise;
mod posterior;
mod predicted;
mod prospects;
mod remaining;
mod report;
mod results;
mod rounding;
mod score;
mod search;
mod shapes;
mod split;
mod start;
mod stated;
mod two_layers;
mod walls;
mod weights;
mod whiten;
mod whole;
mod workbench;

pub use averaged::interval as mixture_interval;
pub use characterize::{
    Characterisation, CharacterizeError, CharacterizeOptions, CharacterizedParameter, Standing, characterize,
};
pub use check::{Check, NAMED_PROBABILITY, Showable, check};
pub use data::Channel;
pub use expected::{Expected, Truth, expected};
pub use formats::model_file::{DISCREPANCY_NAMES, Multiples};
pub use foundation::{
    DiscrepancyFit, DiscrepancyFitInput, DiscrepantModulus, FOUNDATION_MARGIN, FoundationChoice,
    FoundationEvidence, ModulusDraws, VARIED_NATS, fit_with_discrepancy,
};
pub use known::{KnownParameter, Moved, moved_since};
pub use linearise::{EffectAmplitude, Linearisation, ScaleKind};
pub use prospects::{PossibleSet, Prospect, Prospects};
pub use results::{
    AdequacyResult, Diagnosis, Estimate, FoundEffect, FoundationResult, HeldOutMisfit, MeanModulus, Misfit,
    ModulusStatus, NextMeasurement, Ranked, ReferenceResult, RegionResult, RemainingResult, RemainingSize,
    ResidualPoint, Verdict,
};
pub use two_layers::{Interval, TwoLayers, two_layers};
pub use workbench::{Trial, TrialEffect, TrialPoint, Workbench};

use ::discrepancy::evidence;
use adequacy::{Adequacy, regions};
use averaged::Averaged;
use choice::{Choice, choose};
use data::{Kind, Run};
use formats::model_file::ModelFile;
use formats::session::Session;
use found::{Found, Member};
use known::Released;
use layout::{Layout, kinds};
use mechanics::effects::Effect;
use mechanics::{Experiment, Insertion, ModelError};
use modulus::walls::WallsResult;
use noise::Noise;
use posterior::MAX_ROUNDS;
use readings::FitError;
use readings::draws::DrawOptions;
use remaining::Remaining;
use report::DiagnosisReport;
use simulation::simulate::LateralPlan;
use split::{Training, split};
use start::{Noises, Start, fit_start};
use std::path::PathBuf;
use whole::{Stated, Whole};

/// Choices of the user.
#[derive(Debug, Clone)]
pub struct Options {
    /// Effects of the model to start from, with first values of their parameters.
    pub given: Vec<(&'static dyn Effect, Vec<f64>)>,
    /// Knowledge of the parameters of these effects, in place of the catalogue's priors; knowledge that contradicts the
    /// runs is released.
    pub known: Vec<KnownParameter>,
    /// Seed of the bootstraps.
    pub seed: u64,
    /// Foundation of the tissue.
    pub foundation: FoundationChoice,
    /// Poisson's ratio of the tissue where it is a body, 0 to 0.5.
    pub poisson: f64,
    /// Sizes of the discrepancy above those of an ordinary rig, as multiples, by the names of a model file.
    pub discrepancy: Multiples,
    /// Whether laws are searched for that no effect of the catalogue is.
    pub discovery: bool,
    /// Effects that the search takes as unknown to anyone.
    pub left_out: Vec<&'static str>,
    /// Draws from the posterior beside the result.
    pub draws: Option<DrawOptions>,
    /// Runs that could be made next: the result states what each would tell.
    pub plans: Vec<LateralPlan>,
    /// The session to compare with: what it determines is carried over, and what differs from it is searched for.
    pub reference: Option<Session>,
}

/// Poisson's ratio of soft tissue and gels.
pub const INCOMPRESSIBLE: f64 = 0.5;

impl Default for Options {
    fn default() -> Self {
        Self {
            given: Vec::new(),
            known: Vec::new(),
            seed: 1,
            foundation: FoundationChoice::Auto,
            poisson: INCOMPRESSIBLE,
            discrepancy: Multiples::new(),
            discovery: true,
            left_out: Vec::new(),
            draws: None,
            plans: Vec::new(),
            reference: None,
        }
    }
}

impl Options {
    /// With what is known of the rig (`guide characterize`): its effects with their intervals. Values that are there already stay.
    #[must_use]
    pub fn with_rig(mut self, rig: Option<&ModelFile>) -> Self {
        if let Some(rig) = rig {
            KnownParameter::take(&mut self.given, &mut self.known, rig);
        }
        self
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

/// Diagnoses a session; `on_progress` receives a line for each step.
///
/// # Errors
/// [`DiagnoseError`] where nothing can be diagnosed.
pub fn diagnose(
    session: &Session,
    options: &Options,
    on_progress: impl FnMut(&str),
) -> Result<Diagnosis, DiagnoseError> {
    workflow(session, options, on_progress, |_| Ok(())).map(|(found, ())| found)
}

/// Diagnoses a session, and linearises its likelihood in every effect of the catalogue around the model that it starts from: what
/// statistics over many sessions need of each.
///
/// # Errors
/// As [`diagnose`].
pub fn diagnose_and_linearise(
    session: &Session,
    options: &Options,
    on_progress: impl FnMut(&str),
) -> Result<(Diagnosis, Linearisation), DiagnoseError> {
    workflow(session, options, on_progress, Linearisation::of)
}

/// The whole workflow; `beside` computes something more from the starting model that was chosen.
fn workflow<T>(
    session: &Session,
    options: &Options,
    mut on_progress: impl FnMut(&str),
    beside: impl FnOnce(&Start) -> Result<T, DiagnoseError>,
) -> Result<(Diagnosis, T), DiagnoseError> {
    let (runs, mut warnings) = runs_of(session)?;
    let all_runs: Vec<Run> = runs.clone();
    let (Training { mut runs, rule }, held_out) = split(runs);
    on_progress(&rule);
    let (noise, disagreements) = Noise::with_disagreements(&runs, &session.stated_noise());
    warnings.extend(disagreements);
    let given_effects: Vec<&'static dyn Effect> = options.given.iter().map(|(effect, _)| *effect).collect();
    let mut layout = Layout::new(&session.rig, &runs, given_effects);
    layout.known = options.known.clone().into();
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
    let Released { start, as_known, moved: moved_since } =
        known::released(&mut layout, |layout| fit_start(layout, &runs, &noises, &options.given, &multiples))?;
    let judge = held_out.judge(&start, &noise, &multiples)?;
    on_progress(&format!("{} effects are scored", mechanics::effects::EFFECTS.len() - layout.effects.len()));
    let Choice { foundation, start, found, beside: other_foundation } =
        choose(start, &judge, options, &session.tissue, &mut on_progress)?;
    let more = beside(&start)?;
    let search_result = found.around_itself(&start, &judge, &multiples);
    let (search_result, is_stated_wrong) = search_result.with_names_of_stated(&start, &judge)?;
    // If the rig has changed since it was characterized, model and measurement disagree by that: it is part of the gap,
    // and no name is needed for what is in the model already.
    let as_known = match as_known {
        Some(known) => Some(known.beside(&start)?),
        None if is_stated_wrong => Some(start.as_stated()?),
        None => None,
    };
    let disagreement = as_known.as_ref().map(Start::adequacy).transpose()?;
    let adequacy_before = start.adequacy()?;
    let compared = as_known.as_ref().unwrap_or(&start);
    let where_start = regions(&start.fitted, &start.runs, &start.patterns)?;
    let where_before = match &as_known {
        Some(known) => regions(&known.fitted, &known.runs, &known.patterns)?,
        None => where_start.clone(),
    };
    let where_left = adequacy::regions(&search_result.fitted, &start.runs, &start.patterns)?;
    let is_explained = !adequacy::has_regions_beyond_prior(&start.fitted, &start.runs, &start.patterns)?;
    let is_adequate = adequacy_before.is_adequate() && is_explained;
    let compared = compared.fitted.clone();
    let Start { runs: prepared, patterns, fitted: start } = start;
    let adequacy_after = Adequacy::of(&search_result.fitted, &prepared, &patterns)?;

    on_progress("the runs that were held out are compared");
    let gap_of_found = judge.gap(&compared, &search_result.fitted, options.seed)?;
    // A misfit that the reference has too is no gap between them.
    let judged = gap_of_found.as_ref().filter(|_| options.reference.is_none());
    let verdict = verdict(&search_result, is_adequate, judged);
    // A misfit that moves the modulus beyond its interval is not usual, however smooth it is.
    let is_unexplained = verdict == Verdict::Adequate
        && Remaining::of(&adequacy_before, &start, &patterns, None).size == RemainingSize::Large;
    let verdict = if is_unexplained { Verdict::Unexplained } else { verdict };
    let is_named = matches!(verdict, Verdict::Named | Verdict::Ambiguous);
    let final_fit = if is_named { &search_result.fitted } else { &start };
    let gap = if is_named { gap_of_found } else { judge.gap(&compared, final_fit, options.seed)? };
    let remaining = Remaining::of(
        if is_named { &adequacy_after } else { &adequacy_before },
        final_fit,
        &patterns,
        gap.as_ref(),
    );
    let multiples_found = final_fit.multiples(&patterns);
    let final_fit = if is_named { final_fit.clone() } else { start.clone().over_sizes(&patterns) };
    let averaged = Averaged::over(&final_fit, &search_result, is_named, &patterns, touched_m(&all_runs));
    let mut stated = Stated {
        start: Start { runs: prepared, patterns, fitted: start.clone() },
        final_fit,
        averaged,
        beside: other_foundation,
        foundation,
    };
    if judge.runs() > 0 {
        on_progress("the models are fitted to all runs");
        let mut whole = all_runs.clone();
        whole.extend(runs.iter().filter(|run| run.is_reference).cloned());
        share_nodes(&mut whole);
        noises.session = Noise::of(&all_runs, &session.stated_noise());
        let of_all = Whole::new(&layout, &whole, &noises, &options.given, &multiples)
            .and_then(|whole| whole.stated(&stated, is_named, &multiples));
        match of_all {
            Ok(of_all) => stated = of_all,
            Err(why) => warnings.push(format!("values are without what was held out: {why}")),
        }
    }
    let report = DiagnosisReport {
        session,
        options,
        all: &all_runs,
        start: &start,
        found: &search_result,
        final_fit: &stated.final_fit,
        averaged: stated.averaged,
        other_foundation: stated.beside,
        noise: &noise,
        adequacy: [&adequacy_before, &adequacy_after],
        disagreement: disagreement.as_ref(),
        verdict,
        foundation: stated.foundation,
        split: rule,
        multiples: multiples_found,
        held_out: judge.runs(),
    };
    let mut result =
        report.diagnosis(where_before.iter().map(report::region).collect(), gap, remaining, warnings);
    if verdict == Verdict::Adequate && disagreement.is_none() {
        // Imperfections no larger than their prior allows explain them.
        result.regions.clear();
    }
    result.left =
        if is_named { where_left.iter().map(report::region).collect() } else { result.regions.clone() };
    result.moved_since = moved_since;
    if let Some(draws) = options.draws {
        on_progress("draws are taken");
        result.draws =
            Some(report.sources(&stated.start.runs, &stated.start.patterns).draws(&result, draws)?);
    }
    if !options.plans.is_empty() {
        on_progress("what further runs would tell is computed");
        result.prospects = Some(report.foreseen(&stated.start.runs, &stated.start.patterns)?);
    }
    let walls =
        WallsResult::new(session.tissue.walls, &session.rig.needle, touched_m(&all_runs), options.poisson);
    Ok((result.with_walls(walls), more))
}

/// Depth of the tissue that the runs have touched: by guide 2 where there are lateral runs.
fn touched_m(runs: &[Run]) -> f64 {
    let [lateral, _] = kinds(runs);
    runs.iter()
        .filter(|run| (run.kind == Kind::Lateral) == lateral)
        .map(|run| run.depth_m)
        .fold(0.0, f64::max)
}

/// Runs of a session that a diagnosis uses, skips and holds out.
#[derive(Debug, Clone, PartialEq)]
pub struct DataSplit {
    /// Runs that can be used.
    pub used: Vec<String>,
    /// Why others cannot.
    pub skipped: Vec<String>,
    /// Runs of which something, or all, is held out; without any nothing is ever named.
    pub held_out: Vec<String>,
    /// The rule of the split.
    pub rule: String,
}

/// Division of a session by [`diagnose`] into training and held-out runs; there is no fit.
///
/// # Errors
/// [`DiagnoseError`] where no run can be used.
pub fn data_split(session: &Session) -> Result<DataSplit, DiagnoseError> {
    let (runs, skipped) = runs_of(session)?;
    let used_ids = runs.iter().map(|run| run.id.clone()).collect();
    let (Training { rule, .. }, held_out) = split(runs);
    Ok(DataSplit { used: used_ids, skipped, held_out: held_out.ids(), rule })
}

/// All runs in tissue that can be used, and why others cannot.
fn runs_of(session: &Session) -> Result<(Vec<Run>, Vec<String>), DiagnoseError> {
    runs_in(session, false)
}

/// All runs in air, or in tissue, that can be used, and why others cannot.
fn runs_in(session: &Session, air: bool) -> Result<(Vec<Run>, Vec<String>), DiagnoseError> {
    if session.lateral.is_empty() && session.insertion.is_empty() {
        return Err(DiagnoseError::NoRuns { path: session.dir.join("session.toml") });
    }
    let usable = session.lateral.iter().filter(|run| run.is_in_air() == air);
    let lateral = usable.clone().map(|run| (&run.id, Run::lateral(run, &session.rig)));
    let insertion = session.insertion.iter().filter(|_| !air).map(|run| (&run.id, Run::insertion(run)));
    let (mut runs, mut warnings) = (Vec::new(), Vec::new());
    let criteria = readings::holds::HoldCriteria::default();
    if !air {
        let air_runs = session.lateral.iter().filter(|run| run.is_in_air());
        warnings.extend(air_runs.map(|run| format!("run {} is skipped: {IN_AIR}", run.id)));
    }
    for run in usable {
        let unused = readings::holds::unused(run, &session.rig, &criteria);
        warnings
            .extend(readings::holds::summary(&unused).iter().map(|what| format!("run {}: {what}", run.id)));
    }
    for (id, run) in lateral.chain(insertion) {
        match run {
            Ok(run) => runs.push(run.numbered(session.order_of(id))),
            Err(why) => warnings.push(format!("run {id} is skipped: {why}")),
        }
    }
    share_nodes(&mut runs);
    if runs.is_empty() { Err(DiagnoseError::AllFailed { reasons: warnings }) } else { Ok((runs, warnings)) }
}

/// Why a run in air is not used where the tissue is identified.
pub const IN_AIR: &str = "in air (depth_mm = 0), where there is no tissue; `guide characterize` uses it";

/// Lets all insertions use the same solutions.
fn share_nodes(runs: &mut [Run]) {
    Insertion::share_nodes(runs.iter_mut().filter_map(|run| match &mut run.experiment {
        Experiment::Insertion(done) => Some(done),
        _ => None,
    }));
}

/// No effect is named that leaves the larger part of the held-out misfit.
fn verdict(found: &Found, is_adequate: bool, gap: Option<&HeldOutMisfit>) -> Verdict {
    let removed = gap.and_then(|gap| gap.removed);
    match found.members.is_empty() {
        true if is_adequate => Verdict::Adequate,
        true => Verdict::Unexplained,
        false if removed.is_some_and(|share| share < 0.5) => Verdict::Unexplained,
        false if found.members.iter().all(Member::is_the_only_explanation) => Verdict::Named,
        false => Verdict::Ambiguous,
    }
}

/// The model from which a session on springs is searched, and the judge of what is found.
#[cfg(test)]
fn start_of(session: &Session) -> (Start, split::Judge) {
    let (runs, _) = runs_of(session).expect("runs");
    let (Training { runs, .. }, held_out) = split(runs);
    let noise = Noise::of(&runs, &session.stated_noise());
    let noises = Noises { session: noise, reference: noise };
    let layout = Layout::new(&session.rig, &runs, Vec::new());
    let start = fit_start(&layout, &runs, &noises, &[], &Multiples::new()).expect("a fit");
    let judge = held_out.judge(&start, &noise, &Multiples::new()).expect("a judge");
    (start, judge)
}

/// Result of the search in a session on springs, and the model that it starts from.
#[cfg(test)]
fn found_in(session: &Session) -> (Start, Found) {
    let (start, judge) = start_of(session);
    let options = Options { foundation: FoundationChoice::Springs, ..Options::default() };
    let Choice { start, found, .. } =
        choose(start, &judge, &options, &session.tissue, |_| {}).expect("a search");
    (start, found)
}

#[cfg(test)]
mod moved_tests;
#[cfg(test)]
mod play_tests;
#[cfg(test)]
mod tests;
