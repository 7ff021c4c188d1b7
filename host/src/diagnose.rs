//! The discrepancy workflow: where model and measurement disagree, which effect is missing, and what adding it is worth.
//!
//! | step | file |
//! |---|---|
//! | runs as numbers with their places | `data`, `cells` |
//! | split: what is learned from, what judges | `split` |
//! | noise, and residuals made independent | `noise`, `whiten` |
//! | what is unknown | `believed` |
//! | what every rig leaves behind any model | `discrepancy` |
//! | evidence with that discrepancy, and fits | `evidence`, `posterior` |
//! | where it disagrees, and whether at all | `adequacy` |
//! | score every effect, margin by bootstrap | `score` |
//! | refit, accept, add, repeat; rivals | `search` |
//! | what would tell rivals apart | `next` |
//! | before and after on what was held out | `split` |
//! | what remains, and whether it matters | `remaining` |
//! | the result | `story`, `results` |
//!
//! Related: Kennedy and O'Hagan's model discrepancy, nested-model comparison by evidence, efficient score tests, scan statistics,
//! optimal discriminating designs. What is added is the loop, with names, abstention and a proof on runs that nothing has seen.

mod adequacy;
mod believed;
pub mod blind;
mod cells;
mod data;
mod discrepancy;
mod evidence;
mod next;
mod noise;
mod posterior;
mod remaining;
mod results;
mod score;
mod search;
mod split;
mod story;
pub mod study;
mod whiten;
pub mod words;

pub use data::Channel;
pub use results::{
    AdequacyResult, Diagnosis, Estimate, FoundEffect, Gap, GapSide, NextMeasurement, Ranked, RegionResult,
    ResidualPoint, Verdict,
};

use crate::inference::FitError;
use crate::model::effects::Effect;
use crate::model::ModelError;
use crate::session::Session;
use adequacy::{Adequacy, regions};
use believed::{Layout, Prepared, Scale};
use data::{Kind, Run};
use discrepancy::patterns;
use evidence::Patterns;
use noise::Noise;
use posterior::{Fitted, MAX_ROUNDS};
use remaining::Remaining;
use search::{Found, Search};
use split::{Training, split};
use std::path::PathBuf;
use story::Story;
use whiten::Whitener;

/// What the user may choose.
#[derive(Debug, Clone)]
pub struct Options {
    /// Effects of the model to start from, with first values of their parameters.
    pub given: Vec<(&'static dyn Effect, Vec<f64>)>,
    /// Seed of the bootstraps.
    pub seed: u64,
}

impl Default for Options {
    fn default() -> Self {
        Self { given: Vec::new(), seed: 1 }
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

/// Beside others an effect with more rivals than this is no name.
const MOST_IN_CLASS: usize = 3;

/// Diagnoses a session; `tell` hears what goes on.
///
/// # Errors
/// [`DiagnoseError`] where nothing can be said at all.
pub fn diagnose(
    session: &Session,
    options: &Options,
    mut tell: impl FnMut(&str),
) -> Result<Diagnosis, DiagnoseError> {
    let (runs, warnings) = runs_of(session)?;
    let all: Vec<Run> = runs.clone();
    let (Training { runs, rule }, held_out) = split(runs);
    tell(&rule);
    let noise = Noise::of(&runs, &session.noise);
    let layout = Layout {
        rig: session.rig.clone(),
        kinds: [Kind::Lateral, Kind::Insertion].map(|kind| runs.iter().any(|run| run.kind == kind)),
        effects: options.given.iter().map(|(effect, _)| *effect).collect(),
        cache: Default::default(),
    };
    let Start { runs: prepared, patterns, fitted: start } =
        fit_start(&layout, &runs, &noise, &options.given)?;
    let before = Adequacy::of(&start, &prepared, &patterns)?;
    let where_before = regions(&start, &prepared);
    let judge = held_out.judge(&start, &prepared, &noise)?;
    tell(&format!("{} effects are scored", crate::model::effects::EFFECTS.len() - layout.effects.len()));
    let search = Search { start: &start, runs: &prepared, patterns: &patterns, judge: &judge, seed: options.seed };
    let found = search.run(&mut tell)?;
    let after = Adequacy::of(&found.fitted, &prepared, &patterns)?;

    let verdict = verdict(&found, &before, judge.share(&start, &found.fitted));
    let is_named = matches!(verdict, Verdict::Named | Verdict::Ambiguous);
    let final_fit = if is_named { &found.fitted } else { &start };
    tell("the runs that were held out are compared");
    let gap = judge.gap(&start, final_fit, options.seed)?;
    let remaining = Remaining::of(if is_named { &after } else { &before }, final_fit, &patterns, gap.as_ref());
    let story = Story {
        session,
        options,
        all: &all,
        start: &start,
        found: &found,
        final_fit,
        noise: &noise,
        adequacy: [&before, &after],
        verdict,
        split: rule,
        held_out: judge.runs(),
    };
    Ok(story.told(where_before.iter().map(story::region).collect(), gap, remaining, warnings))
}

/// How a session would be divided.
#[derive(Debug, Clone, PartialEq)]
pub struct Division {
    /// Runs that can be used.
    pub used: Vec<String>,
    /// Why others cannot.
    pub left_out: Vec<String>,
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
    let (runs, left_out) = runs_of(session)?;
    let used = runs.iter().map(|run| run.id.clone()).collect();
    let (Training { rule, .. }, held_out) = split(runs);
    Ok(Division { used, left_out, held_out: held_out.ids(), rule })
}

/// All runs that can be used, and why others cannot.
fn runs_of(session: &Session) -> Result<(Vec<Run>, Vec<String>), DiagnoseError> {
    if session.lateral.is_empty() && session.insertion.is_empty() {
        return Err(DiagnoseError::NoRuns { path: session.dir.join("session.toml") });
    }
    let lateral = session.lateral.iter().map(|run| (&run.id, Run::lateral(run, &session.rig)));
    let insertion = session.insertion.iter().map(|run| (&run.id, Run::insertion(run)));
    let (mut runs, mut warnings) = (Vec::new(), Vec::new());
    for (id, run) in lateral.chain(insertion) {
        match run {
            Ok(run) => runs.push(run),
            Err(why) => warnings.push(format!("run {id} is left out: {why}")),
        }
    }
    if runs.is_empty() { Err(DiagnoseError::AllFailed { reasons: warnings }) } else { Ok((runs, warnings)) }
}

/// The starting model, fitted, and what everything after it works on.
struct Start {
    runs: Vec<Prepared>,
    patterns: Patterns,
    fitted: Fitted,
}

/// Fits the starting model: twice, because what makes residuals independent, and what the discrepancy looks like, need to know about
/// what to expect. The first time there is noise alone.
fn fit_start(
    layout: &Layout,
    runs: &[Run],
    noise: &Noise,
    given: &[(&'static dyn Effect, Vec<f64>)],
) -> Result<Start, DiagnoseError> {
    let mut values = layout.first_values();
    let infos = given.iter().flat_map(|(effect, values)| effect.parameters().iter().zip(values));
    for (value, (info, given)) in values[layout.own()..].iter_mut().zip(infos) {
        *value = Scale::of(info).inside(*given);
    }
    let prepared = |values: &[f64]| -> Result<Vec<Prepared>, ModelError> {
        let of_run = |run: &Run| {
            let model = layout.model(values, run.kind)?;
            Ok(Prepared { run: run.clone(), whitener: Whitener::new(run, noise, &model)? })
        };
        runs.iter().map(of_run).collect()
    };
    let first = prepared(&values)?;
    let beside_noise = Fitted::new(layout, &first, &Patterns::none(&first), &values, &[], MAX_ROUNDS)?;
    let values = beside_noise.values();
    let runs = prepared(values)?;
    let patterns = patterns(layout, values, &runs)?;
    let fitted = Fitted::new(layout, &runs, &patterns, values, &patterns.everyday(), MAX_ROUNDS)?;
    Ok(Start { runs, patterns, fitted })
}

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

/// Whether effects were added that could be any of many: they soak up what another thing has left, and are no names. A single effect
/// of many possible ones is another matter: that is a weak one, and its class says so.
fn absorbs(found: &Found) -> bool {
    found.members.len() > 1 && found.members.iter().any(|member| member.class.len() > MOST_IN_CLASS)
}

#[cfg(test)]
mod tests;
