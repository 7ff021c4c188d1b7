//! Why a request has no answer.

use formats::foreign::TableError;
use formats::session::SessionError;
use inference::diagnose::DiagnoseError;
use inference::identify::IdentifyError;
use inference::investigate::LogError;
use inference::plan::PlanError;
use inference::predict::PredictError;
use mechanics::ModelError;
use population::PopulationError;

/// Why a request has no answer.
#[derive(Debug, thiserror::Error)]
pub enum AnswerError {
    /// The text is no request.
    #[error("request: {0}")]
    Request(#[from] serde_json::Error),
    /// A value is out of range.
    #[error("{name}: {value}, expected {expected}")]
    Value {
        /// Field of the request.
        name: &'static str,
        /// Value that was given.
        value: String,
        /// Valid values.
        expected: String,
    },
    /// The session cannot be read.
    #[error(transparent)]
    Session(#[from] SessionError),
    /// A foreign table cannot be read.
    #[error(transparent)]
    Table(#[from] TableError),
    /// The modulus cannot be identified.
    #[error("cannot identify: {0}")]
    Identify(#[from] IdentifyError),
    /// The session cannot be diagnosed.
    #[error("cannot diagnose: {0}")]
    Diagnose(#[from] DiagnoseError),
    /// The log of an investigation cannot be read.
    #[error(transparent)]
    Log(#[from] LogError),
    /// The path cannot be predicted.
    #[error("cannot predict: {0}")]
    Predict(#[from] PredictError),
    /// The run cannot be planned.
    #[error("cannot plan: {0}")]
    Plan(#[from] PlanError),
    /// The records cannot be analysed.
    #[error("cannot analyse the population: {0}")]
    Population(#[from] PopulationError),
    /// The model cannot be evaluated.
    #[error(transparent)]
    Model(#[from] ModelError),
    /// A figure cannot be drawn.
    #[error(transparent)]
    Figure(#[from] figures::FigureError),
}
