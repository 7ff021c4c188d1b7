//! A session's files: read, checked, identified.
//!
//! Input: the session file, then other files, each after a line `==> NAME <==`.

use super::folder;
use formats::session::Session;
use inference::check::check;
use inference::identify::{Options, identify};
use std::fs;
use std::path::Path;

/// Most other files.
const MAX_FILES: usize = 8;

/// Reads, checks and identifies.
///
/// # Panics
/// Where a check finds no error in what cannot be read, or one in what can.
pub fn run(data: &[u8]) {
    let folder = folder();
    lay(data, folder.path());
    let read = Session::read(folder.path());
    let check = check(folder.path());
    match read {
        Ok(session) => {
            assert_eq!(check.errors(), 0, "{:?}", check.findings);
            let _ = identify(&session, &Options::default());
        }
        Err(error) => assert!(check.errors() > 0, "not found by a check: {error}"),
    }
}

/// Writes the files of an input.
fn lay(data: &[u8], folder: &Path) {
    const BEGIN: &[u8] = b"\n==> ";
    const END: &[u8] = b" <==\n";
    let mut name = "session.toml".to_owned();
    let mut remaining = data;
    for _ in 0..=MAX_FILES {
        let end = find(remaining, BEGIN);
        let content = &remaining[..end.map_or(remaining.len(), |end| end + 1)];
        fs::write(folder.join(&name), content).expect("writes");
        let Some(end) = end else { break };
        remaining = &remaining[end + BEGIN.len()..];
        let Some(length) = find(remaining, END) else { break };
        name = String::from_utf8_lossy(&remaining[..length]).into_owned();
        if name.starts_with('.')
            || !(1..=64).contains(&name.len())
            || !name.chars().all(|c| c.is_ascii_alphanumeric() || ".-_".contains(c))
        {
            break;
        }
        remaining = &remaining[length + END.len()..];
    }
}

fn find(bytes: &[u8], what: &[u8]) -> Option<usize> {
    bytes.windows(what.len()).position(|window| window == what)
}
