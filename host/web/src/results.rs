//! Results with the program's own defaults, as its documents with their figures.

use crate::answer::AnswerError;
use crate::drawing::{self, Figure};
use formats::model_file::ModelFile;
use formats::session::{FoundationKind, Session};
use inference::diagnose::{self, Diagnosis, INCOMPRESSIBLE, Trial, Workbench, diagnose};
use inference::draws::DrawOptions;
use inference::identify::{self, YoungsMethod, identify};
use inference::investigate::Log;
use inference::predict::{self, predict};
use mechanics::continuum::Contact;
use mechanics::effects::{EFFECTS, Effect, effect};
use serde::Serialize;
use std::path::{Path, PathBuf};

/// Depths up to which an insertion can be observed, as the program accepts them.
const UNTIL_MM: [f64; 2] = [5.0, 500.0];

/// Name of a model file in errors.
const MODEL_FILE: &str = "model.toml";

/// A document of the program with figures of it.
#[derive(Serialize)]
struct Answer<T> {
    document: T,
    figures: Vec<Figure>,
}

/// A document with its figures, as text.
pub(crate) fn json<T: Serialize>(document: T, figures: Vec<Figure>) -> Result<String, AnswerError> {
    Ok(serde_json::to_string(&Answer { document, figures })?)
}

/// An effect of the catalogue, for lists and sliders.
#[derive(Serialize)]
struct EffectEntry {
    id: &'static str,
    physics: &'static str,
    signature: &'static str,
    in_lateral_runs: bool,
    in_insertions: bool,
    parameters: Vec<ParameterEntry>,
}

#[derive(Serialize)]
struct ParameterEntry {
    name: &'static str,
    /// Value at which the effect does nothing; for a place where it starts.
    neutral: f64,
    likely: [f64; 2],
    range: [f64; 2],
    is_place: bool,
}

impl From<&'static dyn Effect> for EffectEntry {
    fn from(effect: &'static dyn Effect) -> Self {
        let info = effect.info();
        let parameters = info.parameters.iter().map(|parameter| ParameterEntry {
            name: parameter.name,
            neutral: parameter.neutral,
            likely: parameter.likely,
            range: parameter.range,
            is_place: !parameter.nodes.is_empty(),
        });
        Self {
            id: info.id,
            physics: info.physics,
            signature: info.signature,
            in_lateral_runs: info.observable_in.lateral,
            in_insertions: info.observable_in.insertion,
            parameters: parameters.collect(),
        }
    }
}

/// The catalogue.
pub fn effects() -> Result<String, AnswerError> {
    Ok(serde_json::to_string(&EFFECTS.map(EffectEntry::from)[..])?)
}

/// Result of `guide check`.
pub fn check(dir: &Path) -> Result<String, AnswerError> {
    json(inference::check::check(dir), Vec::new())
}

/// Result of `guide identify --relation`.
pub fn identification(
    dir: &Path,
    relation: Option<&str>,
    foundation: Option<&str>,
) -> Result<String, AnswerError> {
    let foundation = foundation.map(foundation_of).transpose()?.map(|kind| Some(kind).into());
    let session = Session::read(dir)?;
    let relation =
        relation
            .map(|name| {
                YoungsMethod::ALL.into_iter().find(|one| one.name() == name).ok_or_else(|| {
                    AnswerError::Value { name: "relation", value: name.to_owned(), expected: method_names() }
                })
            })
            .transpose()?
            .unwrap_or(YoungsMethod::Continuum(Contact::Bonded));
    let options = identify::Options { relation, foundation, ..Default::default() };
    let identification = identify(&session, &options.with_rig(rig(dir)?.as_ref()))?;
    let drawn = drawing::identification(&session, &identification)?;
    json(identification, drawn)
}

fn method_names() -> String {
    YoungsMethod::ALL.map(YoungsMethod::name).join(", ")
}

/// Foundation by its name.
fn foundation_of(name: &str) -> Result<FoundationKind, AnswerError> {
    match name {
        "springs" => Ok(FoundationKind::Springs),
        "body" => Ok(FoundationKind::Body),
        other => {
            let expected = "springs or body".to_owned();
            Err(AnswerError::Value { name: "foundation", value: other.to_owned(), expected })
        }
    }
}

/// Rig of the session, if the session names a file of it.
fn rig(dir: &Path) -> Result<Option<ModelFile>, AnswerError> {
    Ok(ModelFile::of_session_rig(dir)?.map(|(_, rig)| rig))
}

/// Default options of `guide diagnose` for a session.
fn diagnose_options(session: &Session) -> diagnose::Options {
    diagnose::Options {
        foundation: session.tissue.foundation.into(),
        poisson: session.tissue.poisson.unwrap_or(INCOMPRESSIBLE),
        draws: Some(DrawOptions::FIGURE),
        ..diagnose::Options::default()
    }
}

/// A diagnosis with the text of its model file, which a prediction takes.
#[derive(Serialize)]
struct DiagnosisAnswer {
    document: Diagnosis,
    figures: Vec<Figure>,
    model: String,
}

/// Result of `guide diagnose`.
pub fn diagnosis(dir: &Path, on_progress: impl FnMut(&str)) -> Result<String, AnswerError> {
    let session = Session::read(dir)?;
    let options = diagnose_options(&session).with_rig(rig(dir)?.as_ref());
    let diagnosis = diagnose(&session, &options, on_progress)?;
    let figures = drawing::diagnosis(&diagnosis)?;
    let model = diagnosis.model().text(Path::new(MODEL_FILE))?;
    Ok(serde_json::to_string(&DiagnosisAnswer { document: diagnosis, figures, model })?)
}

/// File of `guide investigate` in the session's folder; `null` without one.
pub fn investigation(dir: &Path) -> Result<String, AnswerError> {
    Ok(serde_json::to_string(&Log::of_session(dir)?)?)
}

/// Result of `guide predict --until`, with `--model` where the text of a model file is given.
pub fn prediction(dir: &Path, until_mm: f64, model: Option<&str>) -> Result<String, AnswerError> {
    let [least, most] = UNTIL_MM;
    if !(least..=most).contains(&until_mm) {
        let expected = format!("{least} to {most} mm");
        return Err(AnswerError::Value { name: "until_mm", value: until_mm.to_string(), expected });
    }
    let session = Session::read(dir)?;
    let model = model.map(|text| ModelFile::parse(Path::new(MODEL_FILE), text)).transpose()?;
    let plain = predict::Options { until_m: 1e-3 * until_mm, ..Default::default() };
    let options = plain.with_model(&model.unwrap_or_default(), session.lateral.is_empty());
    let prediction = predict(&session, &options.with_rig(rig(dir)?.as_ref()))?;
    let drawn = drawing::prediction(&prediction)?;
    json(prediction, drawn)
}

/// A trial, with the residuals that were held out under both models.
#[derive(Serialize)]
struct TrialAnswer {
    #[serde(flatten)]
    trial: Trial,
    held_out_points: Vec<HeldOutPoint>,
}

#[derive(Serialize)]
struct HeldOutPoint {
    channel: &'static str,
    unit: &'static str,
    at_mm: f64,
    before: f64,
    after: f64,
}

/// The model fitted with effects.
pub fn trial(
    bench: &mut Option<(PathBuf, String, Workbench)>,
    dir: &Path,
    foundation: &str,
    effects: &[String],
) -> Result<String, AnswerError> {
    let choice = Some(foundation_of(foundation)?).into();
    let mut trial_effects = Vec::new();
    for id in effects {
        trial_effects.push(effect(id).ok_or_else(|| AnswerError::Value {
            name: "effects",
            value: id.clone(),
            expected: expected_effect(),
        })?);
    }
    let is_prepared = bench.as_ref().is_some_and(|(of, on, _)| of == dir && on == foundation);
    if !is_prepared {
        let session = Session::read(dir)?;
        let options = diagnose::Options { foundation: choice, ..diagnose_options(&session) }
            .with_rig(rig(dir)?.as_ref());
        *bench = Some((dir.to_owned(), foundation.to_owned(), Workbench::new(&session, &options)?));
    }
    let Some((.., prepared)) = bench else {
        return Err(AnswerError::Diagnose(inference::FitError::Undetermined.into()));
    };
    let trial = prepared.fit(&trial_effects)?;
    let held_out = trial.held_out.iter().flat_map(|gap| &gap.points);
    let held_out_points = held_out.map(|point| HeldOutPoint {
        channel: point.channel.name(),
        unit: point.channel.unit(),
        at_mm: point.at_mm,
        before: point.before,
        after: point.after,
    });
    let held_out_points = held_out_points.collect();
    Ok(serde_json::to_string(&TrialAnswer { trial, held_out_points })?)
}

fn expected_effect() -> String {
    "the id of an effect".to_owned()
}
