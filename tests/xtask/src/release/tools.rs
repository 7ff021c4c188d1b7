//! Tools that only a release needs: linkers for other systems, mdBook, Wine. Installed where that takes no decision of
//! the user.

use super::Release;
use crate::build::{cargo, root};
use crate::check::is_installed;
use crate::setup;
use crate::wheel::{environment, pip};
use anyhow::{Context, Result, ensure};
use std::ffi::OsString;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

/// Zig and what has cargo use it, from PyPI.
const ZIG: [&str; 2] = ["cargo-zigbuild==0.24.*", "ziglang==0.15.*"];
/// Linker of programs for Windows, and Debian's package of it.
const MINGW: (&str, &str) = ("x86_64-w64-mingw32-gcc", "gcc-mingw-w64-x86-64");
/// Debian's packages of Wine.
const WINE: [&str; 2] = ["wine", "wine64"];
/// Version of mdBook.
const MDBOOK: &str = "0.5.1";

/// The search path with zig and cargo-zigbuild in an environment of their own.
///
/// # Errors
/// Where pip fails.
pub fn zig(release: &Release, python: &Path) -> Result<OsString> {
    // The environment of maturin, which looks for zig there too.
    let tools = release.tools.join("wheel/tools");
    if !tools.join("bin/cargo-zigbuild").exists() {
        if !tools.join("bin/pip").exists() {
            environment(python, &tools)?;
        }
        eprintln!("xtask: {} from PyPI (to link for older Linux and for macOS)", ZIG.join(", "));
        pip(&tools, &[ZIG.map(OsString::from).to_vec(), vec![crate::wheel::MATURIN.into()]].concat())?;
    }
    let old_path = std::env::var_os("PATH").unwrap_or_default();
    let folders = std::iter::once(tools.join("bin")).chain(std::env::split_paths(&old_path));
    std::env::join_paths(folders).context("PATH")
}

/// The linker for Windows, or what is missing.
///
/// # Errors
/// Where apt fails.
pub fn mingw() -> Result<Result<(), String>> {
    let (program, package) = MINGW;
    if !is_installed(program) {
        if !setup::can_install() {
            return Ok(Err(format!("{program} is not installed (Debian's package {package})")));
        }
        install(&[package], "to link for Windows")?;
    }
    Ok(Ok(()))
}

/// A folder of settings for Wine, ready to be used; none where there is no Wine.
///
/// # Errors
/// Where apt fails, or Wine does not start.
pub fn wine(release: &Release) -> Result<Option<PathBuf>> {
    if !is_installed("wine") {
        if !setup::can_install() {
            eprintln!(
                "xtask: Wine is not installed, what is for Windows is not run (Debian's packages {})",
                WINE.join(", ")
            );
            return Ok(None);
        }
        install(&WINE, "to run what is for Windows")?;
    }
    let prefix = release.tools.join("wine");
    if !prefix.join("system.reg").exists() {
        fs::create_dir_all(&prefix)?;
        eprintln!("xtask: settings of Wine in {}", prefix.display());
        let exit_status = Command::new("wineboot")
            .arg("--init")
            .env("WINEPREFIX", &prefix)
            .env("WINEDEBUG", "-all")
            .env("DISPLAY", "")
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .status()
            .context("cannot run wineboot")?;
        ensure!(exit_status.success(), "wineboot: {exit_status}");
    }
    random_numbers(&prefix)?;
    Ok(Some(prefix))
}

/// Gives Wine the library of random numbers that programs of Rust use, where it has none, as those before 8.8.
fn random_numbers(prefix: &Path) -> Result<()> {
    const SOURCE: &str = "tests/release/wine/bcryptprimitives.c";
    let library = prefix.join("drive_c/windows/system32/bcryptprimitives.dll");
    if library.exists() {
        return Ok(());
    }
    let exit_status = Command::new(MINGW.0)
        .args(["-shared", "-o"])
        .arg(&library)
        .arg(root().join(SOURCE))
        .arg("-ladvapi32")
        .status()
        .with_context(|| format!("cannot run {}", MINGW.0))?;
    ensure!(exit_status.success(), "{SOURCE}: {exit_status}");
    Ok(())
}

/// The program mdbook.
///
/// # Errors
/// Where it cannot be installed.
pub fn mdbook(release: &Release) -> Result<PathBuf> {
    if is_installed("mdbook") {
        return Ok("mdbook".into());
    }
    let root = release.tools.join("mdbook");
    let program = root.join("bin/mdbook");
    if !program.exists() {
        eprintln!("xtask: installing mdbook into {} (minutes)", root.display());
        cargo(&["install", "--locked", "mdbook", "--version", MDBOOK, "--root", &root.to_string_lossy()])?;
    }
    Ok(program)
}

fn install(packages: &[&str], purpose: &str) -> Result<()> {
    eprintln!("xtask: installing {} with apt ({purpose})", packages.join(", "));
    setup::apt(&["update"])?;
    setup::apt(&[&["install", "--yes", "--no-install-recommends"], packages].concat())
        .with_context(|| format!("cannot install {}", packages.join(", ")))
}
