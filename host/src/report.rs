//! A session's report for the lab notebook: the results of every analysis of it, as one page that needs nothing else.
//!
//! | step | file |
//! |---|---|
//! | what a report is made of | `page` |
//! | the sections | `setup`, `images`, `identification`, `insertions`, `steering`, `discrepancy`, `origin` |
//! | the page as HTML | `html` |
//! | the report with all that makes it again, in one file | `bundle` |
//!
//! An analysis that the session has nothing for is skipped with a line that reports it; one that fails is a line with its reason. The
//! same session, options and [`Origin`] give the same report, byte by byte.

pub mod bundle;
mod discrepancy;
mod html;
mod identification;
mod images;
mod insertions;
pub mod origin;
pub mod page;
mod setup;
mod steering;

pub use origin::{Day, Origin};
pub use page::{Outcome, Report};

use formats::model_file::ModelFile;
use formats::session::Session;
use inference::diagnose::{self, Diagnosis, diagnose};
use inference::draws::DrawOptions;
use inference::identify::{self, Identification, YoungsMethod, identify};
use inference::predict::{self, Prediction, predict};
use inference::track::results::Tracking;
use inference::track::{self, track};
use mechanics::continuum::Contact;
use std::fmt::Display;

/// Warnings on the first screen.
const FIRST: usize = 6;

/// Choices of the user.
#[derive(Debug, Clone)]
pub struct Options {
    /// Depth up to which readings of each insertion are used.
    pub until_m: f64,
    /// Effects to take into the model, and its modulus where the session has no lateral runs.
    pub model: Option<ModelFile>,
    /// Rig as known beforehand.
    pub rig: Option<ModelFile>,
    /// Draws from the posteriors beside the results.
    pub draws: Option<DrawOptions>,
}

impl Default for Options {
    fn default() -> Self {
        Self { until_m: predict::Options::default().until_m, model: None, rig: None, draws: None }
    }
}

/// Every analysis of a session, with the options that the commands of the same names have by default.
#[derive(Debug, Clone, PartialEq)]
pub struct Analyses {
    /// The tissue's modulus.
    pub identification: Outcome<Identification>,
    /// Tip load and path.
    pub prediction: Outcome<Prediction>,
    /// Stiffness and damping over steering runs.
    pub tracking: Outcome<Tracking>,
    /// Effects that the model lacks.
    pub diagnosis: Outcome<Diagnosis>,
}

impl Analyses {
    /// Analyses a session; `on_progress` is called with each step.
    pub fn of(session: &Session, options: &Options, mut on_progress: impl FnMut(&str)) -> Self {
        let has_lateral = !session.lateral.is_empty();
        let has_insertions = !session.insertion.is_empty();

        on_progress("identifying");
        let no_model = ModelFile::default();
        let model = options.model.as_ref().unwrap_or(&no_model);
        let of_identification = identify::Options {
            relation: YoungsMethod::Continuum(Contact::Bonded),
            draws: options.draws,
            ..identify::Options::default()
        }
        .with_model(model)
        .with_rig(options.rig.as_ref());
        let identification =
            outcome(has_lateral, "the session has no lateral runs", || identify(session, &of_identification));
        on_progress("predicting");
        let of_prediction = predict::Options {
            until_m: options.until_m,
            draws: options.draws,
            ..predict::Options::default()
        }
        .with_model(model, !has_lateral)
        .with_rig(options.rig.as_ref());
        let prediction =
            outcome(has_insertions, "the session has no insertions", || predict(session, &of_prediction));
        on_progress("tracking");
        let tracking = outcome(!session.steering.is_empty(), "the session has no steering runs", || {
            track(session, &track::Options::default())
        });
        let of_diagnosis = diagnose::Options {
            given: model.effects(),
            discrepancy: model.discrepancy.clone(),
            draws: Some(options.draws.unwrap_or(DrawOptions::FIGURE)),
            foundation: session.tissue.foundation.into(),
            poisson: session.tissue.poisson.unwrap_or(diagnose::INCOMPRESSIBLE),
            ..diagnose::Options::default()
        }
        .with_rig(options.rig.as_ref());
        let no_runs = "the session has neither lateral runs nor insertions";
        let diagnosis = outcome(has_lateral || has_insertions, no_runs, || {
            diagnose(session, &of_diagnosis, &mut on_progress)
        });
        Self { identification, prediction, tracking, diagnosis }
    }

    /// Analyses that failed, with their reason.
    pub fn failures(&self) -> Vec<String> {
        fn failure<T>(name: &str, outcome: &Outcome<T>) -> Option<String> {
            match outcome {
                Outcome::Failed(why) => Some(format!("{name} failed: {why}")),
                Outcome::NotThere(_) | Outcome::Found(_) => None,
            }
        }
        let failures = [
            failure("identification", &self.identification),
            failure("prediction", &self.prediction),
            failure("tracking", &self.tracking),
            failure("diagnosis", &self.diagnosis),
        ];
        failures.into_iter().flatten().collect()
    }
}

fn outcome<T, E: Display>(
    is_there: bool,
    what: &'static str,
    analysis: impl FnOnce() -> Result<T, E>,
) -> Outcome<T> {
    match is_there.then(analysis) {
        None => Outcome::NotThere(what),
        Some(Err(why)) => Outcome::Failed(why.to_string()),
        Some(Ok(found)) => Outcome::Found(found),
    }
}

impl Report {
    /// The report of a session and its analyses.
    pub fn new(session: &Session, analyses: &Analyses, origin: &Origin) -> Self {
        let Analyses { identification, prediction, tracking, diagnosis } = analyses;
        let folder = session.dir.file_name().map(|name| name.to_string_lossy().into_owned());
        let name = session.name.clone().filter(|name| !name.trim().is_empty()).or(folder);
        let mut summary = Vec::new();
        // A result that the first warning contradicts is no headline.
        let headline = diagnosis.found().and_then(discrepancy::headline);
        let is_short = headline.is_some();
        summary.extend(headline);
        summary.extend(
            identification.found().into_iter().flat_map(|found| identification::facts(found, is_short)),
        );
        summary.extend(prediction.found().into_iter().flat_map(insertions::facts));
        summary.extend(tracking.found().into_iter().flat_map(steering::facts));
        summary.extend(diagnosis.found().into_iter().flat_map(discrepancy::facts));
        let warnings = warnings(session, analyses);
        let mut sections = vec![
            setup::section(session),
            identification::section(session, identification),
            insertions::section(prediction),
            steering::section(tracking),
            discrepancy::section(diagnosis),
            origin.section(),
        ];
        if let Some(images) = images::section(session) {
            sections.insert(1, images);
        }
        sections.iter_mut().for_each(|section| section.without_notes(&warnings));
        Self {
            name: name.unwrap_or_else(|| "session".to_owned()),
            warnings,
            summary,
            sections,
            date: origin.date.clone(),
        }
    }

    /// The report as one HTML file that needs nothing else.
    pub fn html(&self) -> String {
        html::page(self)
    }
}

/// Failures first, then what the model lacks and what concerns the session, then the analyses' own; of many the first, and how many more.
fn warnings(session: &Session, analyses: &Analyses) -> Vec<String> {
    let mut warnings = analyses.failures();
    let moved = analyses.diagnosis.found().map(|found| found.moved_since.as_slice()).unwrap_or_default();
    warnings.extend(moved.iter().map(|one| format!("the rig has changed: {one}")));
    warnings.extend(analyses.diagnosis.found().and_then(discrepancy::warning));
    let calibrations = session.calibrations();
    if calibrations.len() > 1 {
        let named = calibrations.iter().map(|(crc, runs)| format!("{} with {crc:08x}", runs.join(", ")));
        let named: Vec<String> = named.collect();
        warnings.push(format!("runs were recorded with different calibrations: {}", named.join("; ")));
    }
    let analysis_warnings = [
        analyses.identification.found().map(|found| found.warnings.clone()),
        analyses.prediction.found().map(insertions::warnings),
        analyses.tracking.found().map(steering::warnings),
        analyses.diagnosis.found().map(|found| found.warnings.clone()),
    ];
    // One fact may be noticed by two analyses.
    for warning in analysis_warnings.into_iter().flatten().flatten() {
        if !warnings.contains(&warning) {
            warnings.push(warning);
        }
    }
    let more = warnings.len().saturating_sub(FIRST);
    if more > 1 {
        warnings.truncate(FIRST);
        warnings.push(format!("and {more} more, in the sections below"));
    }
    warnings
}

#[cfg(test)]
mod tests;
