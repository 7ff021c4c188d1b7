//! Names the source state in `GUIDE_GIT`: the short commit, `-dirty` where tracked files differ from it, `unknown` outside a git
//! repository.

use std::path::Path;
use std::process::Command;

fn main() {
    let manifest = std::env::var("CARGO_MANIFEST_DIR").expect("cargo sets CARGO_MANIFEST_DIR");
    let workspace = Path::new(&manifest).parent().expect("the crate is a folder of the workspace");
    println!("cargo:rerun-if-changed=build.rs");
    // What the program is made of; a commit or a check-out changes the log.
    for watched in ["src", "device/src", "formats/src", "inference/src", "mechanics/src", "simulation/src"] {
        println!("cargo:rerun-if-changed={watched}");
    }
    for watched in ["protocol/src", "firmware/estimator/src", "Cargo.lock"] {
        println!("cargo:rerun-if-changed={}", workspace.join(watched).display());
    }
    if let Some(head) = git(workspace, &["rev-parse", "--git-path", "logs/HEAD"]) {
        println!("cargo:rerun-if-changed={}", workspace.join(head).display());
    }
    println!("cargo:rustc-env=GUIDE_GIT={}", describe(workspace));
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
