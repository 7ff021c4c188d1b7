//! Unit tests of what runs on Windows, under Wine.

use super::{Release, systems};
use crate::build::{program, root};
use crate::check::WINDOWS;
use anyhow::{Context, Result};
use std::path::Path;
use std::process::{Command, ExitCode};

/// Packages whose code depends on the system: files, locks, ports, sockets, processes, terminals; and what they use for computing.
const PACKAGES: [&str; 9] =
    ["protocol", "formats", "mechanics", "readings", "population", "device", "server", "steering", "host"];

/// Wine for all tests but those of the Python module: it has none, and its program looks for Python.
const RUNNER: &str = "case \"$1\" in *needle_guide*) exit 0;; esac\nexec wine \"$@\"";

/// Builds and runs them, with the profile and the flags of the program: what it is made of is not built again.
///
/// # Errors
/// Where cargo cannot be run.
pub fn unit_tests(release: &Release, prefix: &Path) -> Result<ExitCode> {
    eprintln!("xtask: unit tests for Windows, under Wine");
    let runner = systems::script(&release.tools, "wine-tests", RUNNER)?;
    let packages = PACKAGES.iter().flat_map(|name| ["--package", name]);
    let status = Command::new(program())
        .current_dir(root())
        .args([
            "test",
            "--locked",
            "--lib",
            "--no-fail-fast",
            "--target",
            WINDOWS,
            "--profile",
            release.profile,
        ])
        .args(packages)
        .args(systems::WITH_MODULE)
        .args(systems::flags(WINDOWS, release)?)
        .arg("--target-dir")
        .arg(&release.target)
        .env("CARGO_TARGET_X86_64_PC_WINDOWS_GNU_RUNNER", runner)
        .env("WINEPREFIX", prefix)
        .env("WINEDEBUG", "-all")
        .status()
        .context("cannot run cargo")?;
    Ok(if status.success() { ExitCode::SUCCESS } else { ExitCode::FAILURE })
}
