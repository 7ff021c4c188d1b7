//! Documents of a run, and how its end is reported.

use super::text::Text;
use crate::cli::output::Output;
use crate::follow::ModelAgreement;
use anyhow::anyhow;
use serde::Serialize;
use std::path::Path;
use steering::{Cue, Options, Outcome, Run, SteerError};

/// The document of a run.
#[derive(Serialize)]
struct Document<'a> {
    schema: &'static str,
    target_mm: [f64; 3],
    /// File of the record.
    record: Option<String>,
    /// Whether this is a recorded run carried out again.
    replayed: bool,
    /// Name and cause, where the run ended by a fault.
    fault: Option<Fault>,
    /// `None` if the run ended by a fault.
    run: Option<&'a Run>,
    /// ModelAgreement of the readings with what was expected of them.
    followed: &'a ModelAgreement,
}

/// The document of a cue, on one line.
#[derive(Serialize)]
pub struct CueDocument {
    /// `guide.steer_cue/1`.
    pub schema: &'static str,
    /// The cue.
    #[serde(flatten)]
    pub cue: Cue,
}

/// A fault, as record and document have it.
#[derive(Serialize, Clone)]
pub struct Fault {
    name: &'static str,
    cause: String,
}

impl From<&SteerError> for Fault {
    fn from(error: &SteerError) -> Self {
        Self { name: error.name(), cause: error.to_string() }
    }
}

/// Prints the outcome; a fault, a refusal and a stop are failures of the command too.
pub fn report(
    outcome: Result<Run, SteerError>,
    options: &Options,
    record: Option<&Path>,
    replayed: bool,
    followed: &ModelAgreement,
    out: &mut Output,
) -> anyhow::Result<()> {
    let fault = outcome.as_ref().err().map(Fault::from);
    let document = Document {
        schema: "guide.steer/1",
        target_mm: options.target_mm,
        record: record.map(|path| path.display().to_string()),
        replayed,
        fault: fault.clone(),
        run: outcome.as_ref().ok(),
        followed,
    };
    match &outcome {
        Ok(run) => {
            out.result(&document, Text { run, followed, record })?;
            match &run.outcome {
                Outcome::Arrived => Ok(()),
                Outcome::Stopped { name, cause } => Err(anyhow!("stopped ({name}): {cause}")),
                Outcome::Refused { cause, .. } => Err(anyhow!("refused: {cause}")),
            }
        }
        Err(error) => {
            if out.is_json() {
                out.result(&document, "")?;
            }
            out.finish()?;
            Err(anyhow!("{}: {error}", error.name()))
        }
    }
}
