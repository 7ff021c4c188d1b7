//! The workflow of a diagnosis: regions in which model and measurement disagree, the missing effect, and the reduction of the misfit
//! by adding it.
//!
//! | step | file |
//! |---|---|
//! | measured values with their coordinates, and the trajectory of guide 2 | `data`, `cells`, `course` |
//! | split into training and held-out data | `split` |
//! | noise, and whitening of the residuals | `noise`, `whiten` |
//! | the unknown parameters | `layout` |
//! | the starting model, fitted | `start` |
//! | basis functions of the discrepancy between real rigs and any model | `discrepancy` |
//! | evidence with that discrepancy, and fits | `evidence`, `posterior` |
//! | adequacy, and regions of disagreement | `adequacy` |
//! | springs or an elastic body | `choice` |
//! | scores of all effects, without a fit | `score` |
//! | linearised likelihood, for statistics over many sessions | `linearise` |
//! | stated positions of the rig that the runs exclude | `stated` |
//! | the rig alone, from runs in air; parameters that have changed since | `characterize`, `known` |
//! | search: fits of the best effects, additions and exchanges; competing effects | `search` |
//! | probabilities of models, and the probability of a statement | `weights` |
//! | the result of the search, with alternatives | `found` |
//! | laws that no effect of the catalogue describes | `discover` |
//! | the measurement that distinguishes competing effects | `next` |
//! | misfit of held-out data before and after | `split` |
//! | the remaining misfit and its relevance | `remaining` |
//! | intervals over all members of a class | `averaged` |
//! | the result | `report`, `results` |
//! | draws from its posterior, for other programs | `draws` |
//! | expected information of planned runs | `prospects` |
//! | sensitivity of a session before its diagnosis | `check` |
//! | effect of the tissue's walls on E | `walls` |
//! | effects that a user switches on and off | `workbench` |
//!
//! Related: Kennedy and O'Hagan's model discrepancy, nested-model comparison by evidence, efficient score tests, scan
//! statistics, optimal discriminating designs. The crate combines them in a search for named effects, which names nothing if the
//! evidence is not sufficient, and tests every effect on held-out runs.
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
mod on_springs;
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
mod workflow;

pub use adequacy::region_coordinates;
pub use averaged::{interval as mixture_interval, modulus_interval_pa};
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
#[cfg(test)]
use choice::{Choice, choose};
use data::Run;
use formats::model_file::ModelFile;
use formats::session::Session;
#[cfg(test)]
use found::Found;
use layout::Layout;
use mechanics::effects::Effect;
use mechanics::{Experiment, Insertion, ModelError};
use noise::Noise;
use posterior::MAX_ROUNDS;
use readings::FitError;
use readings::draws::DrawOptions;
use simulation::simulate::LateralPlan;
use split::{Training, split};
use start::{Noises, Start, fit_start};
use std::path::PathBuf;
use workflow::workflow;

/// Choices of the user.
#[derive(Debug, Clone)]
pub struct Options {
    /// Effects of the starting model, with the start values of their parameters.
    pub given: Vec<(&'static dyn Effect, Vec<f64>)>,
    /// Priors of the parameters of these effects that replace those of the catalogue. Parameters whose prior the runs
    /// contradict become free.
    pub known: Vec<KnownParameter>,
    /// Seed of the bootstraps.
    pub seed: u64,
    /// Foundation of the tissue.
    pub foundation: FoundationChoice,
    /// Poisson's ratio of the tissue where it is a body, 0 to 0.5.
    pub poisson: f64,
    /// Sizes of the discrepancy as multiples of those of an ordinary rig, where they are larger, under the names of a model
    /// file.
    pub discrepancy: Multiples,
    /// Whether laws outside the catalogue are searched for.
    pub discovery: bool,
    /// Effects that the search excludes, as if they were not in the catalogue.
    pub left_out: Vec<&'static str>,
    /// Settings of draws from the posterior; `None` for no draws.
    pub draws: Option<DrawOptions>,
    /// Runs that could be made next; the result has the expected information of each.
    pub plans: Vec<LateralPlan>,
    /// The reference session: its estimates are carried over, and the search looks for differences from it.
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
    /// Adds the characterized rig (`guide characterize`): its effects, and their intervals as priors. Start values that were stated
    /// before are kept.
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
    /// The starting model cannot be fitted.
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

/// Diagnoses a session, and linearises its likelihood in every effect of the catalogue around the starting model, for
/// statistics over many sessions.
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

/// Runs of a session that a diagnosis uses, skips and holds out.
#[derive(Debug, Clone, PartialEq)]
pub struct DataSplit {
    /// Runs that can be used.
    pub used: Vec<String>,
    /// Runs that cannot be used, with the reasons.
    pub skipped: Vec<String>,
    /// Runs that are held out, in part or entirely; without any, no effect is ever named.
    pub held_out: Vec<String>,
    /// The rule of the split.
    pub rule: String,
}

/// Division of a session into training and held-out runs as in [`diagnose`], without a fit.
///
/// # Errors
/// [`DiagnoseError`] where no run can be used.
pub fn data_split(session: &Session) -> Result<DataSplit, DiagnoseError> {
    let (runs, skipped) = runs_of(session)?;
    let used_ids = runs.iter().map(|run| run.id.clone()).collect();
    let (Training { rule, .. }, held_out) = split(runs);
    Ok(DataSplit { used: used_ids, skipped, held_out: held_out.ids(), rule })
}

/// All runs in tissue that can be used, and warnings about the others.
fn runs_of(session: &Session) -> Result<(Vec<Run>, Vec<String>), DiagnoseError> {
    runs_in(session, false)
}

/// All runs in air, or in tissue, that can be used, and warnings about the others.
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

/// Reason for which a run in air is not used for the identification of the tissue.
pub const IN_AIR: &str = "in air (depth_mm = 0), where there is no tissue; `guide characterize` uses it";

/// Gives all insertions common nodes, so that they share solutions of the forward model.
fn share_nodes(runs: &mut [Run]) {
    Insertion::share_nodes(runs.iter_mut().filter_map(|run| match &mut run.experiment {
        Experiment::Insertion(done) => Some(done),
        _ => None,
    }));
}

/// The starting model of a session on springs, and the judge of models on its held-out data.
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
