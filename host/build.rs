//! Names the source state in `GUIDE_GIT`: the short commit, `-dirty` where tracked files differ from it, `unknown` outside a git
//! repository.

#[path = "../firmware/git.rs"]
mod git;

use git::{describe, git};
use std::path::Path;

fn main() {
    let manifest = std::env::var("CARGO_MANIFEST_DIR").expect("cargo sets CARGO_MANIFEST_DIR");
    let workspace = Path::new(&manifest).parent().expect("the crate is a folder of the workspace");
    println!("cargo:rerun-if-changed=build.rs");
    println!("cargo:rerun-if-changed=../firmware/git.rs");
    // Sources of the program; a commit or a check-out changes the log.
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
