//! `cargo xtask lint`: format, words, lints, documentation and licences. `cargo xtask test` begins with them.

use crate::build::{cargo, cargo_with, target_dir};
use crate::setup::TARGET;
use crate::words;
use anyhow::Result;
use std::process::{Command, Stdio};

/// Features of the firmware's images that are linted.
const IMAGES: [&str; 4] = [
    "flash,conformance,b-l475e-iot01a",
    "flash,conformance,nucleo-l476rg",
    "qemu,conformance,b-l475e-iot01a",
    "qemu,conformance,nucleo-l476rg",
];
/// Folder in which the images are built, so that linting them builds nothing twice.
const IMAGE_PARTS: &str = "image-parts";

/// What `cargo xtask test` does, before it does it.
pub fn announce() {
    eprintln!(
        "xtask: format, lints and documentation first, then every test; the first time this builds everything"
    );
}

/// All checks that run nothing of the project.
///
/// # Errors
/// Where there is anything to complain about.
pub fn all() -> Result<()> {
    cargo(&["fmt", "--all", "--check"])?;
    words::check()?;
    cargo(&["clippy", "--workspace", "--all-targets", "--", "-D", "warnings"])?;
    cargo_with(&["doc", "--workspace", "--no-deps", "--lib"], &[("RUSTDOCFLAGS", "-D warnings")])?;
    let parts = target_dir().join(IMAGE_PARTS).display().to_string();
    for features in IMAGES {
        let of_image = [
            "clippy",
            "--package",
            "firmware",
            "--target",
            TARGET,
            "--profile",
            "firmware",
            "--features",
            features,
        ];
        cargo(&[&of_image[..], &["--target-dir", &parts, "--", "-D", "warnings"]].concat())?;
    }
    licences()
}

/// Licences, bans and sources of all dependencies, by cargo-deny where it is installed.
fn licences() -> Result<()> {
    let installed =
        Command::new("cargo-deny").arg("--version").stdout(Stdio::null()).status().is_ok_and(|s| s.success());
    if installed {
        return cargo(&["deny", "--all-features", "check", "licenses", "bans", "sources"]);
    }
    eprintln!(
        "xtask: cargo-deny is not installed, licences are not checked (cargo install --locked cargo-deny)"
    );
    Ok(())
}
