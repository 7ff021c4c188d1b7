//! The program and the Python wheel for each system.

use super::{Release, stubs, tools};
use crate::build::{self, cargo_with, root};
use crate::licences::{self, Built};
use crate::{check, setup, wheel};
use anyhow::{Context, Result, ensure};
use std::ffi::OsString;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

/// A system that there is a program for.
pub struct System {
    /// Its name in the bundle.
    pub name: &'static str,
    /// Rust's name.
    target: &'static str,
    linker: Linker,
}

/// Linker of the program.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Linker {
    /// Zig, with the version of glibc that the program needs at least.
    ZigForLinux(&'static str),
    /// Zig, with stubs of the frameworks that the program uses.
    ZigForMac,
    /// Debian's mingw-w64.
    Mingw,
}

/// All of them.
pub const SYSTEMS: [System; 4] = [
    // glibc of Debian 10, Ubuntu 20.04 and RHEL 8.
    System { name: "linux-x86_64", target: "x86_64-unknown-linux-gnu", linker: Linker::ZigForLinux("2.28") },
    System { name: "windows-x86_64", target: check::WINDOWS, linker: Linker::Mingw },
    System { name: "macos-x86_64", target: "x86_64-apple-darwin", linker: Linker::ZigForMac },
    System { name: "macos-aarch64", target: "aarch64-apple-darwin", linker: Linker::ZigForMac },
];
/// Shells that completions are made for, with the files' names.
const SHELLS: [(&str, &str); 5] = [
    ("bash", "guide.bash"),
    ("zsh", "_guide"),
    ("fish", "guide.fish"),
    ("powershell", "guide.ps1"),
    ("elvish", "guide.elv"),
];

/// Options of cargo by which program, wheel and tests are one choice of features. Python's macros turn on features of parsers that serde's have
/// too: in a choice of its own each would compile everything that uses serde again.
pub const WITH_MODULE: [&str; 4] = ["--package", "needle-guide", "--features", "needle-guide/extension"];

impl System {
    fn is_windows(&self) -> bool {
        self.linker == Linker::Mingw
    }

    /// As cargo-zigbuild and maturin take it.
    fn with_version(&self) -> String {
        match self.linker {
            Linker::ZigForLinux(version) => format!("{}.{version}", self.target),
            _ => self.target.to_owned(),
        }
    }

    /// Options of the linker.
    fn link(&self, release: &Release) -> Result<Vec<String>> {
        Ok(match self.linker {
            // The header of a program for Windows has the time of its making.
            Linker::Mingw => vec!["-Wl,--no-insert-timestamp".to_owned()],
            Linker::ZigForMac => stubs::written(&release.tools.join("stubs"))?,
            Linker::ZigForLinux(_) => Vec::new(),
        })
    }
}

/// Builds program and wheel, and stages them; a line states where a system is omitted because its linker is missing.
///
/// # Errors
/// Where the build fails.
pub fn stage(system: &System, release: &Release, page: &Path, python: Option<&Path>) -> Result<()> {
    let environment = match linker(system, release, python)? {
        Ok(environment) => environment,
        Err(missing) => {
            eprintln!("xtask: no program for {}: {missing}", system.name);
            return Ok(());
        }
    };
    setup::ensure_rust_target(system.target, "to build the program for it")?;
    eprintln!("xtask: the program for {}", system.name);
    let flags = flags(system.target, release)?;
    program(system, release, &flags, &environment)?;
    let folder = release.stage.join("systems").join(system.name);
    let ending = if system.is_windows() { ".exe" } else { "" };
    fs::create_dir_all(&folder).with_context(|| format!("{}: cannot create", folder.display()))?;
    let built =
        release.target.join(system.target).join(release.profile_folder()).join(format!("guide{ending}"));
    copy(&built, &folder.join(format!("guide{ending}")))?;
    copy(page, &folder.join("guide.html"))?;
    for name in ["LICENSE-MIT", "LICENSE-APACHE"] {
        copy(&root().join(name), &folder.join(name))?;
    }
    let licences = licences::collect(&Built { package: "host", features: "", target: system.target })?;
    fs::write(folder.join(licences::FILE), &licences.text)?;
    fs::write(release.stage.join("licences").join(format!("guide {}.txt", system.name)), licences.lines())?;
    shell(&folder, !system.is_windows())?;
    match python {
        Some(python) => module(system, release, python, flags, environment),
        None => {
            eprintln!("xtask: no wheel for {}: there is no Python 3.10 or later", system.name);
            Ok(())
        }
    }
}

/// Options of cargo for all that is built for a system, by Rust's name of it.
///
/// # Errors
/// Where what its linker needs cannot be written.
pub fn flags(target: &str, release: &Release) -> Result<Vec<String>> {
    let system = SYSTEMS.iter().find(|system| system.target == target);
    let of_linker = system.map(|system| system.link(release)).transpose()?.unwrap_or_default();
    let mut flags = release.flags(target, &of_linker)?;
    if system.is_some_and(|system| system.linker != Linker::Mingw) {
        let script = linker_script(target, release)?;
        flags.extend([
            "--config".to_owned(),
            format!("target.{target}.linker={:?}", script.display().to_string()),
        ]);
    }
    Ok(flags)
}

/// A linker of one name for program and wheel. cargo-zigbuild and maturin each name their own by an environment variable, and cargo compiles
/// everything again where the linker's name is another one.
fn linker_script(target: &str, release: &Release) -> Result<PathBuf> {
    let variable = format!("CARGO_TARGET_{}_LINKER", target.replace('-', "_").to_uppercase());
    script(&release.tools.join("linkers"), target, &format!("exec \"${variable}\" \"$@\""))
}

/// Writes a program of the shell.
///
/// # Errors
/// Where it cannot be written or made one.
pub fn script(folder: &Path, name: &str, text: &str) -> Result<PathBuf> {
    let path = folder.join(format!("{name}.sh"));
    fs::create_dir_all(folder)
        .and_then(|()| fs::write(&path, format!("#!/bin/sh\n{text}\n")))
        .with_context(|| format!("{}: cannot write", path.display()))?;
    let status = Command::new("chmod").arg("+x").arg(&path).status().context("cannot run chmod")?;
    ensure!(status.success(), "chmod of {}: {status}", path.display());
    Ok(path)
}

/// Environment in which the linker of a system is found, or what is missing.
fn linker(
    system: &System,
    release: &Release,
    python: Option<&Path>,
) -> Result<Result<Vec<(&'static str, OsString)>, String>> {
    if system.linker == Linker::Mingw {
        return Ok(tools::mingw()?.map(|()| Vec::new()));
    }
    let Some(python) = python else {
        return Ok(Err("zig comes from PyPI, and there is no Python 3.10 or later".into()));
    };
    Ok(Ok(vec![("PATH", tools::zig(release, python)?)]))
}

fn program(
    system: &System,
    release: &Release,
    flags: &[String],
    environment: &[(&'static str, OsString)],
) -> Result<()> {
    let target = system.with_version();
    let verb = if system.linker == Linker::Mingw { "build" } else { "zigbuild" };
    let folder = release.target.to_string_lossy();
    let first = [verb, "--locked", "--package", "host", "--bin", "guide", "--profile", release.profile];
    let target_options = ["--target", &target, "--target-dir", &folder];
    let flags: Vec<&str> = flags.iter().map(String::as_str).collect();
    let environment: Vec<(&str, &str)> =
        environment.iter().filter_map(|(name, value)| Some((*name, value.to_str()?))).collect();
    cargo_with(&[&first[..], &WITH_MODULE, &target_options, &flags].concat(), &environment)
}

/// Completions and manual pages, from the program that was built for this system.
fn shell(folder: &Path, is_unix: bool) -> Result<()> {
    let guide = |arguments: &[&str]| {
        let output = Command::new(build::guide()).args(arguments).output().context("cannot run guide")?;
        ensure!(output.status.success(), "guide {} failed", arguments.join(" "));
        Ok(output.stdout)
    };
    let completions = folder.join("completions");
    fs::create_dir_all(&completions)?;
    for (shell, name) in SHELLS {
        fs::write(completions.join(name), guide(&["completions", shell])?)?;
    }
    if is_unix {
        guide(&["man", "--out", &folder.join("man").to_string_lossy()])?;
    }
    Ok(())
}

/// The Python wheel.
fn module(
    system: &System,
    release: &Release,
    python: &Path,
    flags: Vec<String>,
    mut environment: Vec<(&'static str, OsString)>,
) -> Result<()> {
    let mut options = flags;
    if let Linker::ZigForLinux(version) = system.linker {
        options.extend([
            "--zig".into(),
            "--compatibility".into(),
            format!("manylinux_{}", version.replace('.', "_")),
        ]);
    } else if system.linker == Linker::ZigForMac {
        options.push("--zig".into());
    }
    environment.push(("CARGO_TARGET_DIR", release.target.clone().into_os_string()));
    environment.push(("SOURCE_DATE_EPOCH", release.time.clone().into()));
    let kind = wheel::Kind { profile: release.profile, target: Some(system.target), options, environment };
    eprintln!("xtask: the Python wheel for {}", system.name);
    let wheel = wheel::build(python, &release.tools.join("wheel"), &kind)?;
    let name = wheel.file_name().context("a wheel without a name")?;
    copy(&wheel, &release.stage.join("files").join(name))?;
    let licences = licences::collect(&licences::module(system.target))?;
    fs::write(release.stage.join("licences").join(format!("wheel {}.txt", system.name)), licences.lines())?;
    Ok(())
}

/// Copies a file.
///
/// # Errors
/// With the names of both.
pub fn copy(from: &Path, to: &Path) -> Result<()> {
    fs::copy(from, to)
        .map(drop)
        .with_context(|| format!("cannot copy {} to {}", from.display(), to.display()))
}
