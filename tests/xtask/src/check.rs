//! `cargo xtask lint`: format, lints, documentation, manual and licences. The first tier of `cargo xtask test` begins with
//! the first two, the second with the others.

use crate::build::{FIRST_IMAGE, cargo, cargo_with, image_parts, root, target_dir};
use crate::setup::{self, TARGET};
use crate::wording;
use anyhow::{Context, Result, bail};
use std::path::Path;
use std::process::{Command, Stdio};

/// The firmware's images: features.
const IMAGES: [&str; 4] = [
    FIRST_IMAGE,
    "flash,conformance,b-l475e-iot01a",
    "flash,conformance,nucleo-l476rg",
    "qemu,conformance,nucleo-l476rg",
];

/// Rust's name of Windows, as a release is built for it.
pub const WINDOWS: &str = "x86_64-pc-windows-gnu";

/// All checks that run nothing of the project.
///
/// # Errors
/// Where there is anything to complain about.
pub fn all() -> Result<()> {
    texts()?;
    lints()?;
    rest()
}

/// Format and wording: seconds, without a build.
///
/// # Errors
/// Where there is anything to complain about.
pub fn texts() -> Result<()> {
    cargo(&["fmt", "--all", "--check"])?;
    wording::check()
}

/// Lints of the host's code, and of the firmware's that the host compiles too.
///
/// # Errors
/// Where there is anything to complain about.
pub fn lints() -> Result<()> {
    cargo(&["clippy", "--workspace", "--all-targets", "--", "-D", "warnings"])
}

/// Checks of the second tier: the Python module, documentation, the firmware's images, manual and licences.
///
/// # Errors
/// Where there is anything to complain about.
pub fn rest() -> Result<()> {
    let python_module = ["clippy", "--workspace", "--all-targets", "--features", "needle-guide/extension"];
    // The module is for the stable interface of Python, and no interpreter is needed to compile it.
    let without_python = [("PYO3_NO_PYTHON", "1"), ("PYO3_BUILD_EXTENSION_MODULE", "1")];
    cargo_with(&[&python_module[..], &["--", "-D", "warnings"]].concat(), &without_python)?;
    cargo_with(&["doc", "--workspace", "--no-deps", "--lib"], &[("RUSTDOCFLAGS", "-D warnings")])?;
    IMAGES.into_iter().try_for_each(image)?;
    // The programs as the demonstration builds them.
    let programs = ["clippy", "--package", "host", "--package", "system", "--no-default-features"];
    cargo(&[&programs[..], &["--", "-D", "warnings"]].concat())?;
    other_system()?;
    manual()?;
    licences()
}

/// Lints of an image, in the folder in which images are built, so that what runs while building is built once.
fn image(features: &str) -> Result<()> {
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
    let parts_dir = image_parts().display().to_string();
    cargo(&[&of_image[..], &["--target-dir", &parts_dir, "--", "-D", "warnings"]].concat())
}

/// Checks that the program compiles for Windows, which needs no linker; `cargo xtask release` links and
/// runs it.
fn other_system() -> Result<()> {
    setup::ensure_rust_target(WINDOWS, "to check the program for Windows")?;
    cargo(&["check", "--package", "host", "--bin", "guide", "--target", WINDOWS])
}

/// Whether a program is there and states its version.
pub fn is_installed(program: &str) -> bool {
    Command::new(program)
        .arg("--version")
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .status()
        .is_ok_and(|s| s.success())
}

/// Builds the manual as a site into the target folder, where mdbook is installed.
fn manual() -> Result<()> {
    if !is_installed("mdbook") {
        eprintln!("xtask: mdbook is not installed, the manual is not built (cargo install --locked mdbook)");
        return Ok(());
    }
    book(Path::new("mdbook"), &target_dir().join("manual"))
}

/// Builds the manual as a site into a folder; a warning of mdbook counts as an error.
///
/// # Errors
/// Where mdbook cannot be run, fails or warns.
pub fn book(mdbook: &Path, site: &Path) -> Result<()> {
    let output = Command::new(mdbook)
        .arg("build")
        .arg(root().join("host/manual"))
        .arg("--dest-dir")
        .arg(std::path::absolute(site)?)
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
