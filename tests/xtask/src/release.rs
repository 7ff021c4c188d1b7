//! `cargo xtask release`: the bundle that a user downloads, in `target/release-bundle`.
//!
//! The same sources give the same bytes: paths of this machine are not in what is compiled, files are dated by the commit, and archives have
//! their entries in order.

mod parts;
mod stubs;
mod systems;
mod tools;
mod wine;

use crate::build::{self, cargo, root, target_dir};
use crate::wheel::{self, remove};
use anyhow::{Context, Result, bail, ensure};
use std::ffi::{OsStr, OsString};
use std::fs;
use std::path::PathBuf;
use std::process::{Command, ExitCode};
use systems::SYSTEMS;

/// Help of the task.
pub const HELP: &str = "Make the bundle of a release in target/release-bundle: `guide` for Linux, Windows and macOS, Python wheels, guide.html, firmware, manual\n\n\
    Usage: cargo xtask release [--only SYSTEM]... [--debug] [--test] [--same-as BUNDLE]\n\n\
    Options:\n  \
      --only SYSTEM     Only for this system: linux-x86_64, windows-x86_64, macos-x86_64 or macos-aarch64 (may be given more than once)\n  \
      --debug           Build with the profile of tests: quickly, and slow to run\n  \
      --test            Then unpack the bundle into a fresh folder and run what is in it, here and under Wine, with the unit tests for Windows\n  \
      --same-as BUNDLE  Then compare its bytes with those of another bundle: one that was downloaded, or made in another checkout of the same commit\n\n\
    SOURCE_DATE_EPOCH dates the files; else the commit does.\n";

/// Requested options.
struct Options {
    only: Vec<String>,
    profile: &'static str,
    test: bool,
    same_as: Option<PathBuf>,
}

/// Runs the task.
///
/// # Errors
/// Where something cannot be installed or built, or a test of the bundle failed.
pub fn release(arguments: &[OsString]) -> Result<ExitCode> {
    let options = options(arguments)?;
    let release = Release::new(options.profile)?;
    announce(&release);
    let python = wheel::python().ok();
    let stage = &release.stage;
    remove(stage)?;
    for folder in ["systems", "files", "licences"] {
        fs::create_dir_all(stage.join(folder))
            .with_context(|| format!("{}: cannot create", stage.display()))?;
    }
    let page = parts::page(&release)?;
    for system in SYSTEMS
        .iter()
        .filter(|one| options.only.is_empty() || options.only.iter().any(|name| name == one.name))
    {
        systems::stage(system, &release, &page, python.as_deref())?;
    }
    parts::firmware(&release)?;
    parts::manual(&release)?;
    pack(&release)?;
    if let Some(bundle_path) = &options.same_as {
        let comparison =
            build::run(&checker(), [OsStr::new(&bundle()), OsStr::new("--same-as")], &[bundle_path.into()])?;
        if comparison != ExitCode::SUCCESS {
            return Ok(comparison);
        }
    }
    if options.test { test(&release, python.as_deref()) } else { Ok(ExitCode::SUCCESS) }
}

fn options(arguments: &[OsString]) -> Result<Options> {
    let mut options = Options { only: Vec::new(), profile: "release", test: false, same_as: None };
    let mut arguments = arguments.iter();
    while let Some(argument) = arguments.next() {
        match argument.to_str() {
            Some("--debug") => options.profile = "dev",
            Some("--test") => options.test = true,
            Some("--same-as") => {
                let folder = arguments.next().context("--same-as: expected the folder of a bundle")?;
                options.same_as = Some(std::path::absolute(folder)?);
            }
            Some("--only") => {
                let name = arguments.next().and_then(|name| name.to_str()).unwrap_or_default();
                let system_names: Vec<&str> = SYSTEMS.iter().map(|system| system.name).collect();
                ensure!(
                    system_names.contains(&name),
                    "--only: `{name}` is not known, expected {}",
                    system_names.join(", ")
                );
                options.only.push(name.to_owned());
            }
            _ => bail!(
                "release: unknown option {}, expected --only, --debug, --test or --same-as",
                argument.display()
            ),
        }
    }
    Ok(options)
}

/// Common parts of a bundle.
pub struct Release {
    /// Profile of cargo.
    profile: &'static str,
    version: &'static str,
    commit: String,
    /// Seconds since 1970 that the files are dated by.
    time: String,
    /// Folder in which it is put together.
    stage: PathBuf,
    /// Folder in which programs are built.
    target: PathBuf,
    /// Programs that only the release needs.
    tools: PathBuf,
}

impl Release {
    fn new(profile: &'static str) -> Result<Self> {
        let target = std::path::absolute(target_dir())?;
        let time = match std::env::var("SOURCE_DATE_EPOCH") {
            Ok(time) => time,
            Err(_) => git(&["log", "-1", "--format=%ct"])?,
        };
        let is_changed = !git(&["status", "--porcelain", "--untracked-files=no"])?.is_empty();
        let commit = git(&["rev-parse", "--short=9", "HEAD"])?;
        Ok(Self {
            profile,
            version: env!("CARGO_PKG_VERSION"),
            commit: if is_changed { format!("{commit}-dirty") } else { commit },
            time,
            stage: target.join("release-stage"),
            tools: target.join("release-tools"),
            target: target.join("release-build"),
        })
    }

    /// Folder of cargo for the profile.
    fn profile_folder(&self) -> &str {
        if self.profile == "dev" { "debug" } else { self.profile }
    }

    /// Options of cargo by which what is compiled for a system does not depend on where it is compiled.
    fn flags(&self, target: &str, linker: &[String]) -> Result<Vec<String>> {
        let home = std::env::var_os("CARGO_HOME").map(PathBuf::from);
        let home = home.or_else(|| Some(std::env::home_dir()?.join(".cargo"))).context("no home folder")?;
        let root = fs::canonicalize(root())?;
        // A later one comes before an earlier one where both begin a path.
        let replacements = [
            (home, "/cargo"),
            (root, "/needle-guide"),
            (self.target.clone(), "/target"),
            (std::path::absolute(target_dir())?, "/target"),
        ];
        let flags =
            replacements.iter().map(|(path, name)| format!("--remap-path-prefix={}={name}", path.display()));
        let flags = flags.chain(linker.iter().map(|option| format!("-Clink-arg={option}")));
        let list = flags.map(|flag| format!("{flag:?}")).collect::<Vec<_>>().join(", ");
        Ok(vec!["--config".to_owned(), format!("target.{target}.rustflags=[{list}]")])
    }
}

fn git(arguments: &[&str]) -> Result<String> {
    let output =
        Command::new("git").current_dir(root()).args(arguments).output().context("cannot run git")?;
    ensure!(output.status.success(), "git {}: a release is made in a checkout", arguments.join(" "));
    Ok(String::from_utf8_lossy(&output.stdout).trim().to_owned())
}

fn announce(release: &Release) {
    eprintln!(
        "xtask: release {} of {}\n\
         xtask: 1. guide.html, with the engine of the page\n\
         xtask: 2. `guide` and the Python wheel for Linux, Windows and macOS (a quarter of an hour each; Rust targets through rustup, mingw-w64 with \
         apt, zig and maturin from PyPI into {}, where they are missing)\n\
         xtask: 3. firmware of both boards, and the manual (mdbook through cargo)\n\
         xtask: 4. archives, manifest and checksums",
        release.version,
        release.commit,
        release.tools.display()
    );
}

/// The folder of the bundle.
fn bundle() -> PathBuf {
    target_dir().join("release-bundle")
}

/// The program that tests a bundle.
fn checker() -> PathBuf {
    target_dir().join("debug/release-check")
}

/// Makes the bundle of what is staged.
fn pack(release: &Release) -> Result<()> {
    cargo(&["build", "--package", "release", "--bins"])?;
    remove(&bundle())?;
    fs::create_dir_all(bundle()).with_context(|| format!("{}: cannot create", bundle().display()))?;
    let status = Command::new(target_dir().join("debug/release-pack"))
        .args([release.stage.as_os_str(), bundle().as_os_str()])
        .args([release.version, &release.commit, &release.time])
        .status()
        .context("cannot run release-pack")?;
    ensure!(status.success(), "the bundle could not be packed");
    println!("bundle: {}", bundle().display());
    Ok(())
}

/// Tests the bundle, and the libraries for Windows.
fn test(release: &Release, python: Option<&std::path::Path>) -> Result<ExitCode> {
    let wine = tools::wine(release)?;
    let mut arguments: Vec<OsString> = Vec::new();
    if let Some(prefix) = &wine {
        arguments.extend(["--wine".into(), prefix.as_os_str().to_owned()]);
    }
    if let Some(python) = python {
        arguments.extend(["--python".into(), python.as_os_str().to_owned()]);
    }
    let bundle = std::path::absolute(bundle())?;
    let checked = build::run(&checker(), [OsStr::new(&bundle)], &arguments)?;
    let units = match &wine {
        Some(prefix) => wine::unit_tests(release, prefix)?,
        None => ExitCode::SUCCESS,
    };
    Ok(if checked == ExitCode::SUCCESS { units } else { checked })
}
