//! The tests of the Python module, on what the tests' own build has made: no wheel, no release build.
//!
//! The package is laid out in an environment below the target folder as the wheel would install it. `cargo xtask wheel` tests the wheel
//! itself, its types and its stubs.

use crate::images::root;
use crate::peers;
use anyhow::{Context, Result, ensure};
use std::fs;
use std::io::{BufRead, BufReader};
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

/// The feature with which the workspace builds the module.
pub const FEATURE: &str = "needle-guide/extension";
/// Packages that the tests need from PyPI: the module's own dependency, and theirs.
const PACKAGES: [&str; 7] = [
    "numpy>=1.24",
    "pandas>=2",
    "pytest>=8",
    "arviz>=0.17,<1",
    "dask[distributed]>=2024.8",
    "nbclient>=0.10",
    "ipykernel>=6.29",
];
/// The module's compiled part, in the folder of a build: a copy, because every later build of the workspace replaces cargo's own with one
/// that Python cannot load.
const MODULE: &str = "extension/libneedle_guide_core.so";
/// Program behind an entry point of the package.
const PROGRAM: &str = "import sys\nfrom needle_guide._program import main\nsys.exit(main())\n";

/// Outcome of a run of pytest.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Outcome {
    /// Tests that passed.
    pub passed: u64,
    /// Tests that failed, or whose set-up did.
    pub failed: u64,
}

/// A Python that has the package.
#[derive(Debug, Clone)]
pub struct Installed {
    /// The interpreter.
    pub python: PathBuf,
    /// Folder of the package.
    pub package: PathBuf,
}

/// Lays the package out as the wheel would install it; `target` as for [`run`]. The inner error is why that cannot be: no PyPI, or a
/// build without the module.
///
/// # Errors
/// Where the package cannot be laid out.
pub fn installed(target: &Path) -> Result<Result<Installed, String>> {
    let module = target.join(MODULE);
    if !module.exists() {
        return Ok(Err(format!("{}: is not built, which the feature {FEATURE} does", module.display())));
    }
    match peers::environment("module", &PACKAGES) {
        Ok(python) => lay_out(target, &python).map(|package| Ok(Installed { python, package })),
        Err(reason) => Ok(Err(reason)),
    }
}

/// Runs them; `target` is the folder in which the module, built with [`FEATURE`], is. If the environment cannot be made
/// (no PyPI), the reason is printed and no test is counted.
///
/// # Errors
/// Where the package cannot be laid out, or pytest ended without a count.
pub fn run(target: &Path) -> Result<Outcome> {
    let target = std::path::absolute(target)?;
    let Installed { python, package } = match installed(&target)? {
        Ok(installed) => installed,
        Err(reason) => {
            println!("the Python module is not tested: {reason}");
            return Ok(Outcome::default());
        }
    };
    let sources = root().join("host/python/tests");
    // Beside the sources the package would be found there, without its compiled part.
    let mut child = Command::new(&python)
        .args(["-m", "pytest", "-q", "-p", "no:cacheprovider", "--doctest-modules"])
        .arg(&sources)
        .arg(&package)
        .arg("--rootdir")
        .arg(&sources)
        .current_dir(&package)
        .env("NEEDLE_GUIDE_FAKE_DEVICE", target.join("examples/fake_device"))
        .stdin(Stdio::null())
        .stdout(Stdio::piped())
        .spawn()
        .context("cannot run pytest")?;
    let mut last = String::new();
    for line in BufReader::new(child.stdout.take().context("pytest has no output")?).lines() {
        last = line?;
        println!("{last}");
    }
    let status = child.wait()?;
    let outcome =
        closing_line(&last).with_context(|| format!("pytest ended with {status} without a count"))?;
    ensure!(status.success() || outcome.failed > 0, "pytest ended with {status}");
    Ok(outcome)
}

/// Puts the package where that Python finds it, with the program beside the interpreter; the package's folder.
fn lay_out(target: &Path, python: &Path) -> Result<PathBuf> {
    let query = "import sysconfig; print(sysconfig.get_path('platlib'))";
    let query_output =
        Command::new(python).args(["-c", query]).output().context("cannot run the interpreter")?;
    let libraries = String::from_utf8(query_output.stdout)?.trim().to_owned();
    ensure!(!libraries.is_empty(), "{}: has no folder of packages", python.display());
    let package = Path::new(&libraries).join("needle_guide");
    if package.exists() {
        fs::remove_dir_all(&package)?;
    }
    fs::create_dir_all(&package)?;
    for entry in fs::read_dir(root().join("host/python/python/needle_guide"))? {
        let file = entry?.path();
        if let (true, Some(name)) = (file.is_file(), file.file_name()) {
            fs::copy(&file, package.join(name))?;
        }
    }
    let module = target.join(MODULE);
    fs::copy(&module, package.join("_core.abi3.so")).with_context(|| format!("{}", module.display()))?;
    let program = python.with_file_name("guide");
    fs::write(&program, format!("#!{}\n{PROGRAM}", python.display()))?;
    fs::set_permissions(&program, fs::Permissions::from_mode(0o755))?;
    Ok(package)
}

/// Counts in pytest's last line, like `2 failed, 40 passed, 1 skipped in 9.41s`.
fn closing_line(line: &str) -> Option<Outcome> {
    let counts = line.trim_matches('=').trim().rsplit_once(" in ")?.0;
    let mut outcome = Outcome::default();
    for (number, kind) in counts.split(", ").filter_map(|part| part.split_once(' ')) {
        let number: u64 = number.parse().ok()?;
        match kind {
            "passed" => outcome.passed += number,
            "failed" | "error" | "errors" => outcome.failed += number,
            _ => {}
        }
    }
    Some(outcome)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pytests_last_line_is_counted() {
        assert_eq!(counted("45 passed, 1 skipped in 12.31s"), Some((45, 0)));
        assert_eq!(counted("==== 2 failed, 40 passed, 1 error in 9.41s (0:00:09) ===="), Some((40, 3)));
        assert_eq!(counted("no tests ran in 0.01s"), None);
        assert_eq!(counted("Interrupted"), None);
    }

    fn counted(line: &str) -> Option<(u64, u64)> {
        closing_line(line).map(|outcome| (outcome.passed, outcome.failed))
    }
}
