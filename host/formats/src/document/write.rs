//! Writing of texts and of numbers in them.

use super::error::SessionError;
use crate::files;
use std::path::Path;

/// Writes a file so that at any moment either the old or the new content is there.
///
/// # Errors
/// [`SessionError::Io`].
pub fn replace(path: &Path, text: &str) -> Result<(), SessionError> {
    files::replace(path, text.as_bytes()).map_err(io(path, "write"))
}

/// The error of an action on a file.
pub fn io(path: &Path, action: &'static str) -> impl FnOnce(std::io::Error) -> SessionError {
    move |cause| SessionError::Io { path: path.to_owned(), action, cause }
}

/// A number with nine decimals at most, as TOML and CSV both read it.
pub fn number(path: &Path, field: &'static str, value: f64) -> Result<String, SessionError> {
    if !value.is_finite() {
        return Err(SessionError::NotFinite { path: path.to_owned(), field });
    }
    let text = format!("{value:.9}");
    let text = text.trim_end_matches('0');
    let text = if text.ends_with('.') { format!("{text}0") } else { text.to_owned() };
    Ok(if text == "-0.0" { "0.0".to_owned() } else { text })
}
