//! Puts the workspace's `memory.x` on the linker's search path and names the source state in `FIRMWARE_GIT`: the short
//! commit, `-dirty` where files differ from it, `unknown` outside a git repository.

use std::path::Path;
use std::process::Command;

fn main() {
    let manifest = std::env::var("CARGO_MANIFEST_DIR").expect("cargo sets CARGO_MANIFEST_DIR");
    let workspace = Path::new(&manifest).parent().expect("the crate is a folder of the workspace");
    let memory = workspace.join("memory.x");
    println!("cargo:rustc-link-search={}", workspace.display());
    println!("cargo:rerun-if-changed={}", memory.display());
    println!("cargo:rerun-if-changed=build.rs");
    println!("cargo:rerun-if-changed=src");
    println!("cargo:rustc-env=FIRMWARE_GIT={}", describe(workspace));
    // The name changes with a commit or a check-out.
    if let Some(head) = git(workspace, &["rev-parse", "--git-path", "logs/HEAD"]) {
        println!("cargo:rerun-if-changed={}", workspace.join(head).display());
    }
}

/// The source state.
fn describe(workspace: &Path) -> String {
    let Some(commit) = git(workspace, &["rev-parse", "--short=9", "HEAD"]) else {
        return "unknown".to_owned();
    };
    let clean =
        git(workspace, &["status", "--porcelain", "--untracked-files=no"]).is_some_and(|s| s.is_empty());
    if clean { commit } else { format!("{commit}-dirty") }
}

/// Output of a git command, if it succeeds.
fn git(workspace: &Path, arguments: &[&str]) -> Option<String> {
    let output = Command::new("git").current_dir(workspace).args(arguments).output().ok()?;
    output.status.success().then(|| String::from_utf8_lossy(&output.stdout).trim().to_owned())
}
