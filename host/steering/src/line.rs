//! Messages of the protocol as lines of JSON.

use crate::plant::PlantError;
use serde::Serialize;
use serde::de::DeserializeOwned;

/// A message as one line.
pub(crate) fn to_line(message: &impl Serialize) -> String {
    serde_json::to_string(message).unwrap_or_default()
}

/// A line as a message, or as the plant's own error.
pub(crate) fn parse<T: DeserializeOwned>(
    line: &str,
    number: u64,
    expected: &'static str,
) -> Result<T, PlantError> {
    let value: serde_json::Value =
        serde_json::from_str(line).map_err(|error| malformed(error.to_string(), number, expected))?;
    if !value.is_object() {
        return Err(malformed("not a JSON object".to_owned(), number, expected));
    }
    if let Some(text) = value.get("error") {
        return Err(PlantError::Reported(text.as_str().map_or_else(|| text.to_string(), str::to_owned)));
    }
    serde_json::from_value(value).map_err(|error| malformed(error.to_string(), number, expected))
}

fn malformed(problem: String, number: u64, expected: &'static str) -> PlantError {
    PlantError::Malformed { line: number, expected: expected.into(), problem }
}
