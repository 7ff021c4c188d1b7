//! `cargo xtask wheel`: builds the Python wheel and tests it in a fresh virtual environment.
//!
//! Packages from PyPI (maturin, pytest and those that the tests name) go into environments below `target/wheel`; no
//! package is installed elsewhere.

use crate::build::{cargo, root, target_dir};
use crate::licences::{self, Licences, MODULES};
use anyhow::{Context, Result, bail, ensure};
use std::ffi::OsString;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

/// First Python that the wheel works with.
const PYTHON_NEEDED: (u32, u32) = (3, 10);
/// Requirement by which pip finds the program that builds wheels.
pub const MATURIN: &str = "maturin>=1.9,<2";

/// Help of the task.
pub const HELP: &str = "Build the Python wheel and test it in a fresh virtual environment\n\n\
    Usage: cargo xtask wheel [--debug] [--no-test]\n\n\
    Options:\n  \
      --debug    Build with the profile of tests: quickly, and slow to run\n  \
      --no-test  Only build\n\n\
    The wheel is written to target/wheel/dist. PYTHON names the interpreter (default: python3), 3.10 or later.\n";

/// Runs the task.
///
/// # Errors
/// Where there is no Python, or anything fails.
pub fn wheel(arguments: &[OsString]) -> Result<()> {
    let (mut profile, mut test) = ("release", true);
    for argument in arguments {
        match argument.to_str() {
            Some("--debug") => profile = "dev",
            Some("--no-test") => test = false,
            _ => bail!("wheel: unknown option {}, expected --debug or --no-test", argument.display()),
        }
    }
    let python = python()?;
    let folder = target_dir().join("wheel");
    let built = build(&python, &folder, &Kind::here(profile))?;
    eprintln!("xtask: {}, {} kB", built.display(), fs::metadata(&built)?.len() / 1000);
    if test { check(&python, &folder, &built) } else { Ok(()) }
}

/// The interpreter.
///
/// # Errors
/// Where there is none, or it is too old.
pub fn python() -> Result<PathBuf> {
    let name = std::env::var_os("PYTHON").unwrap_or_else(|| "python3".into());
    let (major, minor) = PYTHON_NEEDED;
    let version = format!("import sys; sys.exit(sys.version_info < ({major}, {minor}))");
    let good = Command::new(&name).args(["-c", &version]).stderr(Stdio::null()).status();
    ensure!(
        good.is_ok_and(|status| status.success()),
        "{}: is not there or too old, expected Python {major}.{minor} or later with venv (PYTHON names another)",
        name.display()
    );
    Ok(name.into())
}

/// Kind of the wheel.
pub struct Kind<'a> {
    /// Profile of cargo.
    pub profile: &'a str,
    /// Rust's name of the system; none for this one.
    pub target: Option<&'a str>,
    /// Further options of maturin.
    pub options: Vec<String>,
    /// Environment of the build.
    pub environment: Vec<(&'static str, OsString)>,
}

impl<'a> Kind<'a> {
    /// For this system.
    pub fn here(profile: &'a str) -> Self {
        let environment = vec![("CARGO_TARGET_DIR", target_dir().into_os_string())];
        Self { profile, target: None, options: Vec::new(), environment }
    }
}

/// Builds a wheel and returns its path.
///
/// # Errors
/// Where the build fails, or the wheel holds what its licences do not name.
pub fn build(python: &Path, folder: &Path, kind: &Kind) -> Result<PathBuf> {
    let tools = folder.join("tools");
    if !tools.join("bin/maturin").exists() {
        environment(python, &tools)?;
        pip(&tools, &[MATURIN.into()])?;
    }
    let dist = folder.join("dist");
    // One wheel is in there: the one that is tested.
    remove(&dist)?;
    let manifest = root().join("host/python/Cargo.toml");
    let mut maturin = Command::new(tools.join("bin/maturin"));
    maturin
        .args(["build", "--locked", "--profile", kind.profile, "--manifest-path"])
        .arg(manifest)
        .arg("--out")
        .arg(&dist)
        .args(&kind.options)
        .envs(kind.environment.iter().map(|(name, value)| (name, value)));
    match kind.target {
        Some(target) => maturin.args(["--target", target]),
        None => maturin.arg("--interpreter").arg(python),
    };
    // Beside the build's description, where it finds the file; it is made each time and is not kept in the repository.
    let licences = licences::collect(&licences::module(kind.target.unwrap_or("x86_64-unknown-linux-gnu")))?;
    fs::write(root().join("host/python").join(licences::FILE), &licences.text)?;
    run(&mut maturin)?;
    let wheels = fs::read_dir(&dist)?.map(|entry| Ok(entry?.path())).collect::<Result<Vec<_>>>()?;
    let [wheel] = wheels.as_slice() else { bail!("{}: expected one wheel", dist.display()) };
    holds_what_it_states(python, wheel, &licences)?;
    Ok(wheel.clone())
}

/// Checks what is in a wheel; the interpreter unpacks it.
fn holds_what_it_states(python: &Path, wheel: &Path, licences: &Licences) -> Result<()> {
    let unpacked = wheel.with_extension("unpacked");
    remove(&unpacked)?;
    run(Command::new(python).args(["-m", "zipfile", "--extract"]).arg(wheel).arg(&unpacked))?;
    let names = files(&unpacked, &unpacked)?;
    let module = MODULES.iter().map(|name| unpacked.join(name)).find(|path| path.is_file());
    let library = fs::read(module.context("the wheel has no compiled module")?)?;
    let checked = licences::check(&names, &library, licences);
    remove(&unpacked)?;
    checked.with_context(|| format!("{}", wheel.display()))
}

/// Files below a folder, from a root.
fn files(root: &Path, folder: &Path) -> Result<Vec<String>> {
    let mut wheel_files = Vec::new();
    for entry in fs::read_dir(folder)? {
        let path = entry?.path();
        if path.is_dir() {
            wheel_files.extend(files(root, &path)?);
        } else {
            wheel_files.push(path.strip_prefix(root)?.to_string_lossy().into_owned());
        }
    }
    Ok(wheel_files)
}

/// Tests, documentation examples, types and stubs of an installed wheel.
fn check(python: &Path, folder: &Path, wheel: &Path) -> Result<()> {
    cargo(&["build", "--package", "fake-device", "--example", "fake_device"])?;
    let fresh = folder.join("fresh");
    remove(&fresh)?;
    environment(python, &fresh)?;
    pip(&fresh, &[format!("{}[test]", wheel.display()).into()])?;
    let source = root().join("host/python");
    let program = |name: &str| fresh.join("bin").join(name);
    let device = target_dir().join("debug/examples/fake_device");
    let installed = Command::new(program("python"))
        .args(["-c", "import needle_guide, os; print(os.path.dirname(needle_guide.__file__))"])
        .output()
        .context("cannot run the interpreter")?;
    let installed = String::from_utf8_lossy(&installed.stdout).trim().to_owned();
    ensure!(!installed.is_empty(), "the wheel cannot be imported");
    // Beside the sources the package would be found there, without its compiled part.
    run(Command::new(program("pytest"))
        .arg(source.join("tests"))
        .args(["--doctest-modules", &installed, "-p", "no:cacheprovider"])
        .arg("--rootdir")
        .arg(source.join("tests"))
        .current_dir(folder)
        .env("NEEDLE_GUIDE_FAKE_DEVICE", device))?;
    run(Command::new(program("mypy")).args(["--strict", "-p", "needle_guide"]).current_dir(folder))?;
    run(Command::new(program("stubtest")).args(["needle_guide._core"]).current_dir(folder))?;
    run(Command::new(program("pyright"))
        .arg("--project")
        .arg(source.join("pyproject.toml"))
        .arg("--pythonpath")
        .arg(program("python")))
}

/// Makes a virtual environment.
///
/// # Errors
/// Where the interpreter cannot.
pub fn environment(python: &Path, folder: &Path) -> Result<()> {
    eprintln!("xtask: virtual environment {}", folder.display());
    run(Command::new(python).args(["-m", "venv"]).arg(folder))
}

/// Installs packages into a virtual environment.
///
/// # Errors
/// Where pip fails.
pub fn pip(folder: &Path, packages: &[OsString]) -> Result<()> {
    run(Command::new(folder.join("bin/pip")).args(["install", "--quiet"]).args(packages))
}

/// Removes a folder if it is there.
///
/// # Errors
/// Where it cannot be removed.
pub fn remove(folder: &Path) -> Result<()> {
    match fs::remove_dir_all(folder) {
        Err(error) if error.kind() != std::io::ErrorKind::NotFound => {
            Err(error).with_context(|| format!("{}: cannot remove", folder.display()))
        }
        _ => Ok(()),
    }
}

fn run(command: &mut Command) -> Result<()> {
    let name = command.get_program().to_owned();
    let status = command.status().with_context(|| format!("cannot run {}", name.display()))?;
    ensure!(status.success(), "{} failed", name.display());
    Ok(())
}
