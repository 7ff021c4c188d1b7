//! Other models that explain the runs that a model was learned from: what follows from the data is averaged over all of them.

use super::{ModelFile, decimal};
use crate::document::{Fields, Problem, SessionError};
use std::fmt::Write as _;
use std::path::Path;

/// Probabilities of models.
const PROBABILITY: [f64; 2] = [0.0, 1.0];
/// Largest excess of the sum of the probabilities above 1, by rounding.
const ROUNDING: f64 = 1e-9;

/// Another model of the same runs.
#[derive(Debug, Clone, PartialEq)]
pub struct Alternative {
    /// Its probability, given the runs: what those of all alternatives leave is that of the model itself.
    pub probability: f64,
    /// Tissue, tip, discrepancy and effects.
    pub model: ModelFile,
}

/// The tables `[[alternative]]` of a file.
pub(super) fn read(file: &Fields<'_>) -> Result<Vec<Alternative>, SessionError> {
    let mut remaining_probability = 1.0 + ROUNDING;
    let mut alternatives = Vec::new();
    for fields in file.tables("alternative")? {
        fields.only(&["probability", "tissue", "tip", "discrepancy", "effect"])?;
        let probability = fields.number("probability", PROBABILITY)?;
        remaining_probability -= probability;
        if remaining_probability < 0.0 {
            let expected = "probabilities of all alternatives whose sum is at most 1";
            return Err(fields.field_fault("probability", Problem::OutOfRange(probability), expected));
        }
        alternatives.push(Alternative { probability, model: ModelFile::tables(&fields, &[])? });
    }
    Ok(alternatives)
}

impl Alternative {
    /// Appends it to the text of a file.
    pub(super) fn write(&self, path: &Path, text: &mut String) -> Result<(), SessionError> {
        let probability = decimal(path, "probability", self.probability, 0)?;
        let _ = write!(text, "\n[[alternative]]\nprobability = {probability}\n");
        self.model.write_tables(path, "alternative.", text)
    }
}
