//! The source state, for the build scripts of firmware and `guide`.

use std::path::Path;
use std::process::Command;

/// The short commit, `-dirty` where tracked files differ from it, `unknown` outside a git repository.
pub fn describe(workspace: &Path) -> String {
    let Some(commit) = git(workspace, &["rev-parse", "--short=9", "HEAD"]) else {
        return "unknown".to_owned();
    };
    let clean =
        git(workspace, &["status", "--porcelain", "--untracked-files=no"]).is_some_and(|s| s.is_empty());
    if clean { commit } else { format!("{commit}-dirty") }
}

/// Output of a git command, if it succeeds.
pub fn git(workspace: &Path, arguments: &[&str]) -> Option<String> {
    let output = Command::new("git").current_dir(workspace).args(arguments).output().ok()?;
    output.status.success().then(|| String::from_utf8_lossy(&output.stdout).trim().to_owned())
}
