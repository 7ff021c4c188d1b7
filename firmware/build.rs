//! Puts the workspace's `memory.x` on the linker's search path and names the source state in `FIRMWARE_GIT`: the short
//! commit, `-dirty` where files differ from it, `unknown` outside a git repository.

mod git;

use git::{describe, git};
use std::path::Path;

fn main() {
    let manifest = std::env::var("CARGO_MANIFEST_DIR").expect("cargo sets CARGO_MANIFEST_DIR");
    let workspace = Path::new(&manifest).parent().expect("the crate is a folder of the workspace");
    let memory = workspace.join("memory.x");
    println!("cargo:rustc-link-search={}", workspace.display());
    println!("cargo:rerun-if-changed={}", memory.display());
    println!("cargo:rerun-if-changed=build.rs");
    println!("cargo:rerun-if-changed=git.rs");
    for watched in ["src", "control/src", "emulation/src", "estimator/src"] {
        println!("cargo:rerun-if-changed={watched}");
    }
    println!("cargo:rustc-env=FIRMWARE_GIT={}", describe(workspace));
    // The name changes with a commit or a check-out.
    if let Some(head) = git(workspace, &["rev-parse", "--git-path", "logs/HEAD"]) {
        println!("cargo:rerun-if-changed={}", workspace.join(head).display());
    }
}
