//! Numbers of a model file as decimal text.

use crate::document::SessionError;
use std::path::Path;

/// A number divided by a power of ten such that reading it, scaled back, gives the same number to the last bit.
pub(super) fn decimal(
    path: &Path,
    field: &'static str,
    value: f64,
    power: i32,
) -> Result<String, SessionError> {
    if !value.is_finite() {
        return Err(SessionError::NotFinite { path: path.to_owned(), field });
    }
    if power == 0 {
        return Ok(format!("{value:?}"));
    }
    let plain = value / 10f64.powi(power);
    let scaled_back: Option<f64> = format!("{plain:e}").split_once('e').and_then(|(digits, exponent)| {
        format!("{digits}e{}", exponent.parse::<i32>().ok()?.saturating_add(power)).parse().ok()
    });
    if scaled_back == Some(value) {
        return Ok(format!("{plain:?}"));
    }
    // The quotient is rounded: the decimal digits of the number itself, with another exponent.
    let text = format!("{value:e}");
    let (digits, exponent) = text.split_once('e').unwrap_or((&text, "0"));
    Ok(format!("{digits}e{}", exponent.parse::<i32>().unwrap_or_default() - power))
}
