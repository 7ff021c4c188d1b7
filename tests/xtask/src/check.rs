//! `cargo xtask lint`: format, words, import circles, lints, documentation, manual and licences. `cargo xtask test` begins with them.

use crate::build::{cargo, cargo_with, root, target_dir};
use crate::setup::TARGET;
use crate::{circles, words};
use anyhow::{Context, Result, bail};
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
    circles::check()?;
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
    manual()?;
    licences()
}

fn is_installed(program: &str) -> bool {
    Command::new(program).arg("--version").stdout(Stdio::null()).status().is_ok_and(|s| s.success())
}

/// Builds the manual as a site into the target folder, where mdbook is installed; a warning of it counts as an error.
fn manual() -> Result<()> {
    if !is_installed("mdbook") {
        eprintln!("xtask: mdbook is not installed, the manual is not built (cargo install --locked mdbook)");
        return Ok(());
    }
    let site = std::path::absolute(target_dir().join("manual"))?;
    let output = Command::new("mdbook")
        .arg("build")
        .arg(root().join("host/manual"))
        .arg("--dest-dir")
        .arg(site)
        .output()
        .context("cannot run mdbook")?;
    let log = String::from_utf8_lossy(&output.stderr);
    if !output.status.success() || ["WARN", "ERROR"].iter().any(|level| log.contains(level)) {
        bail!("mdbook build host/manual:\n{log}");
    }
    Ok(())
}

/// Licences, bans and sources of all dependencies, by cargo-deny where it is installed.
fn licences() -> Result<()> {
    if is_installed("cargo-deny") {
        return cargo(&["deny", "--all-features", "check", "licenses", "bans", "sources"]);
    }
    eprintln!(
        "xtask: cargo-deny is not installed, licences are not checked (cargo install --locked cargo-deny)"
    );
    Ok(())
}
