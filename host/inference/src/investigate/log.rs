//! The file of an investigation.

use super::{ChosenRun, End};
use diagnose::{Diagnosis, PossibleSet, Prospects, Verdict};
use formats::files;
use serde::{Deserialize, Serialize};
use std::io;
use std::path::{Path, PathBuf};

/// Name of the file in the session's folder.
const FILE: &str = "investigation.json";
const SCHEMA: &str = "guide.investigate/1";
/// Number of explanations that are kept per step.
const KEPT: usize = 6;
/// Lower bound of the probability of an explanation at an earlier step, used for explanations that were not kept there.
const UNLIKELY: f64 = 1e-3;

/// All steps so far.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Log {
    /// Name and version of this schema.
    pub schema: String,
    /// The steps.
    pub steps: Vec<Step>,
    /// Reason of the end; `None` while the investigation goes on.
    pub end: Option<End>,
}

/// A diagnosis and the run that was chosen after it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Step {
    /// Runs that it is from.
    pub runs: usize,
    /// Verdict of the diagnosis.
    pub verdict: String,
    /// Sets of effects that explain the runs, likeliest first.
    pub explanations: Vec<Explanation>,
    /// Probability that an effect is missing which no run has shown so far.
    pub unseen_probability: f64,
    /// Foundation modulus and its 95 % interval, kPa.
    pub k_kpa: f64,
    /// Its 95 % interval, kPa.
    pub k_ci95_kpa: [f64; 2],
    /// Kullback-Leibler divergence of these probabilities from those of the step before, nats: the information from the last
    /// run.
    pub realised_nats: Option<f64>,
    /// The run that was chosen.
    pub next: Option<Next>,
}

/// A set of effects.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Explanation {
    /// Their ids; empty where nothing is missing.
    pub effects: Vec<String>,
    /// Its probability.
    pub probability: f64,
}

/// A chosen run.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Next {
    /// Its name.
    pub run: String,
    /// Action of the step.
    pub what: String,
    /// Minutes that it takes.
    pub minutes: f64,
    /// Expected information about the missing effect, nats.
    pub information_nats: f64,
    /// Expected information about the modulus, nats.
    pub modulus_nats: f64,
    /// Effects about which it is most informative.
    pub reasons: Vec<String>,
}

/// Why a log cannot be read or written.
#[derive(Debug, thiserror::Error)]
pub enum LogError {
    /// The operating system's error.
    #[error("{}: {source}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// The error.
        source: io::Error,
    },
    /// The file is no log.
    #[error("{}:{}:{}: {source}; expected a file of `guide investigate` (remove it to begin anew)", path.display(), source.line(), source.column())]
    Form {
        /// The file.
        path: PathBuf,
        /// The error.
        source: serde_json::Error,
    },
}

impl Log {
    /// Log of a session, to be continued; a new one if there is none.
    ///
    /// # Errors
    /// [`LogError`] where there is a file of this name that is none.
    pub fn read(folder: &Path) -> Result<Self, LogError> {
        let new = Self { schema: SCHEMA.to_owned(), steps: Vec::new(), end: None };
        Ok(Self { end: None, ..Self::of_session(folder)?.unwrap_or(new) })
    }

    /// Log of a session as it was left; nothing where the session was not investigated.
    ///
    /// # Errors
    /// [`LogError`] where there is a file of this name that is none.
    pub fn of_session(folder: &Path) -> Result<Option<Self>, LogError> {
        let path = folder.join(FILE);
        match std::fs::read(&path) {
            Ok(bytes) => {
                let log = serde_json::from_slice(&bytes);
                Ok(Some(log.map_err(|source| LogError::Form { path, source })?))
            }
            Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(None),
            Err(source) => Err(LogError::Io { path, source }),
        }
    }

    /// Writes it, whole or not at all.
    ///
    /// # Errors
    /// [`LogError::Io`] where it cannot be written.
    pub fn write(&self, folder: &Path) -> Result<PathBuf, LogError> {
        let path = folder.join(FILE);
        let io = |source: io::Error| LogError::Io { path: path.clone(), source };
        let text = serde_json::to_string_pretty(self).map_err(|error| io(error.into()))?;
        files::replace(&path, format!("{text}\n").as_bytes()).map_err(io)?;
        Ok(path)
    }

    /// Adds a diagnosis. If it is of the same runs as that of the last step, it replaces that step, at which the investigation
    /// resumes.
    pub fn push(&mut self, runs: usize, diagnosis: &Diagnosis, prospects: &Prospects) {
        self.steps.retain(|step| step.runs < runs);
        let explanations: Vec<Explanation> =
            prospects.explanations.iter().take(KEPT).map(Explanation::from).collect();
        let step = Step {
            runs,
            verdict: name(diagnosis.verdict).to_owned(),
            unseen_probability: prospects.unseen_probability,
            k_kpa: diagnosis.k_kpa,
            k_ci95_kpa: diagnosis.k_ci95_kpa,
            realised_nats: self.steps.last().map(|before| before.told_by(&explanations)),
            explanations,
            next: None,
        };
        self.steps.push(step);
    }

    /// Enters the run that was chosen after the last diagnosis.
    pub fn choose(&mut self, choice: &ChosenRun) {
        if let Some(step) = self.steps.last_mut() {
            step.next = Some(Next {
                run: choice.run.plan.id.clone(),
                what: choice.run.words.clone(),
                minutes: choice.run.minutes,
                information_nats: choice.prospect.information_nats,
                modulus_nats: choice.prospect.modulus_nats,
                reasons: choice.prospect.reasons.clone(),
            });
        }
    }

    /// Minutes of all runs that were chosen.
    pub fn minutes(&self) -> f64 {
        self.steps.iter().filter_map(|step| step.next.as_ref()).fold(0.0, |sum, next| sum + next.minutes)
    }
}

impl Step {
    /// Kullback-Leibler divergence of later probabilities from these, nats.
    fn told_by(&self, later: &[Explanation]) -> f64 {
        let earlier = |effects: &[String]| {
            let explanation = self.explanations.iter().find(|one| one.effects == effects);
            explanation.map_or(UNLIKELY, |one| one.probability.max(UNLIKELY))
        };
        let term = |one: &Explanation| one.probability * (one.probability / earlier(&one.effects)).ln();
        later.iter().filter(|one| one.probability > 0.0).map(term).sum::<f64>().max(0.0)
    }
}

impl From<&PossibleSet> for Explanation {
    fn from(set: &PossibleSet) -> Self {
        Self { effects: set.effects.clone(), probability: set.probability }
    }
}

fn name(verdict: Verdict) -> &'static str {
    match verdict {
        Verdict::Adequate => "adequate",
        Verdict::Named => "named",
        Verdict::Ambiguous => "ambiguous",
        Verdict::Unexplained => "unexplained",
    }
}
