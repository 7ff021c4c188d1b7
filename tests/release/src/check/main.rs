//! Tests a bundle as a stranger uses it: unpacked into a fresh folder, without the repository in sight, on this system and under Wine.
//!
//! Usage: `release-check BUNDLE [--wine PREFIX] [--python PROGRAM]`. Without `--wine` the program for Windows is not run, without `--python` the
//! wheel is not installed; a line states it. `release-check BUNDLE --same-as OTHER` compares the bytes of two bundles, and runs nothing.
#![forbid(unsafe_code)]
#![deny(missing_docs)]

mod live;
mod numbers;
mod program;
mod sessions;
mod wheel;

use anyhow::{Context, Result, bail};
use program::Program;
use release::{archive, manifest};
use std::fs;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

/// Arguments of the command line.
struct Args {
    bundle: PathBuf,
    wine: Option<PathBuf>,
    python: Option<PathBuf>,
    same_as: Option<PathBuf>,
}

fn main() -> Result<ExitCode> {
    let args = args()?;
    if let Some(other_bundle) = &args.same_as {
        return same(&args.bundle, other_bundle);
    }
    let mut checks = Checks::default();
    let manifest = manifest::verify(&args.bundle)?;
    checks.report("every file has the size and the checksum that the manifest states", Ok(()));
    let folder = tempfile::tempdir().context("no folder for temporary files")?;
    let unpacked_dir = unpacked(&args.bundle, &manifest.files, "linux-x86_64", folder.path())?;
    let native_program = Program::native(unpacked_dir.join("guide"), folder.path());
    checks.report("the program runs without the repository", native_program.states(&manifest.version));
    let wine = match &args.wine {
        Some(prefix) => {
            let windows = unpacked(&args.bundle, &manifest.files, "windows-x86_64", folder.path())?;
            Some(Program::under_wine(windows.join("guide.exe"), prefix, folder.path()))
        }
        None => {
            println!("skipped: the program for Windows (no Wine)");
            None
        }
    };
    sessions::check(&mut checks, &native_program, wine.as_ref(), folder.path())?;
    live::check(&mut checks, &native_program)?;
    if let Some(wine) = &wine {
        checks.report("the program for Windows runs", wine.states(&manifest.version));
        live::check(&mut checks, wine)?;
    }
    match &args.python {
        Some(python) => checks.report(
            "the wheel in a fresh environment gives the program's numbers",
            wheel::check(&args.bundle, &manifest, python, &native_program, folder.path()),
        ),
        None => println!("skipped: the Python wheel (no Python 3.10 or later)"),
    }
    println!("\n{} passed, {} failed", checks.passed, checks.failed);
    Ok(if checks.failed == 0 { ExitCode::SUCCESS } else { ExitCode::FAILURE })
}

fn args() -> Result<Args> {
    let mut arguments = std::env::args_os().skip(1);
    let bundle = arguments.next().context("expected the folder of a bundle")?.into();
    let mut args = Args { bundle, wine: None, python: None, same_as: None };
    while let Some(option) = arguments.next() {
        match option.to_str() {
            Some("--wine") => args.wine = Some(value(&mut arguments, &option)?),
            Some("--python") => args.python = Some(value(&mut arguments, &option)?),
            Some("--same-as") => args.same_as = Some(value(&mut arguments, &option)?),
            _ => bail!("unknown option {}, expected --wine, --python or --same-as", option.display()),
        }
    }
    Ok(args)
}

fn value(arguments: &mut std::iter::Skip<std::env::ArgsOs>, option: &std::ffi::OsString) -> Result<PathBuf> {
    arguments.next().map(PathBuf::from).with_context(|| format!("{}: no value", option.display()))
}

/// Prints in what two bundles differ.
fn same(bundle: &Path, other: &Path) -> Result<ExitCode> {
    let (manifest, other_manifest) = (manifest::verify(bundle)?, manifest::verify(other)?);
    let differing = manifest::differences(&manifest, &other_manifest);
    for line in &differing {
        println!("differs: {line}");
    }
    if differing.is_empty() {
        println!("the same bytes: {} files of {}", manifest.files.len(), manifest.commit);
        return Ok(ExitCode::SUCCESS);
    }
    Ok(ExitCode::FAILURE)
}

/// Unpacks the archive of a system, and returns its folder.
fn unpacked(
    bundle: &Path,
    files: &std::collections::BTreeMap<String, manifest::File>,
    system: &str,
    folder: &Path,
) -> Result<PathBuf> {
    let archive = files.keys().find(|name| name.contains(system) && !name.ends_with(".whl"));
    let archive = archive.with_context(|| format!("the bundle has no archive for {system}"))?;
    archive::unpack(&bundle.join(archive), folder)?;
    let top = archive.trim_end_matches(".tar.gz").trim_end_matches(".zip");
    // With a space in its name, as folders of Windows have.
    let destination = folder.join(format!("unpacked {system}"));
    fs::rename(folder.join(top), &destination)
        .with_context(|| format!("{archive}: expected the folder {top}"))?;
    Ok(destination)
}

/// Outcomes.
#[derive(Default)]
pub struct Checks {
    passed: usize,
    failed: usize,
}

impl Checks {
    /// Counts and prints one.
    pub fn report(&mut self, name: &str, outcome: Result<()>) {
        match outcome {
            Ok(()) => {
                self.passed += 1;
                println!("ok      {name}");
            }
            Err(error) => {
                self.failed += 1;
                println!("FAILED  {name}: {error:#}");
            }
        }
    }
}
