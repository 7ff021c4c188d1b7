//! `cargo xtask cluster`: runs the workflow for many sessions on Slurm, with this machine as the only node.
//!
//! Slurm and Munge are Debian's; their daemons run while the task runs. The checks are in `host/python/tests/slurm.py`.

use crate::build::{root, target_dir};
use crate::{setup, wheel};
use anyhow::{Context, Result, bail, ensure};
use std::ffi::OsString;
use std::path::Path;
use std::process::{Command, Stdio};

/// Packages that apt installs, and a program of each.
const PACKAGES: [(&str, &str); 2] = [("slurm-wlm", "slurmctld"), ("munge", "munge")];

/// Help of the task.
pub const HELP: &str = "Run the workflow for many sessions on Slurm, with this machine as the only node\n\n\
    Usage: cargo xtask cluster\n\n\
    As root, on Debian and its relatives. Packages that it installs stay; its configuration of Slurm, its daemons and \
    its mount are removed when it ends. PYTHON names the interpreter (default: python3), 3.11 or later for Snakemake.\n";

/// Runs the task.
///
/// # Errors
/// Where something cannot be installed, and where a check fails.
pub fn cluster(arguments: &[OsString]) -> Result<()> {
    if let Some(unknown) = arguments.first() {
        bail!("cluster: unknown option {}, expected none", unknown.display());
    }
    announce();
    let python = wheel::python()?;
    ensure_slurm()?;
    let folder = target_dir().join("cluster");
    let built = wheel::build(&python, &target_dir().join("wheel"), &wheel::Kind::here("release"))?;
    let environment = folder.join("python");
    wheel::remove(&environment)?;
    wheel::environment(&python, &environment)?;
    wheel::pip(&environment, &[format!("{}[slurm]", built.display()).into()])?;
    let status = Command::new(environment.join("bin/python"))
        .arg(root().join("host/python/tests/slurm.py"))
        .arg(folder.join("runs"))
        .status()
        .context("cannot run the interpreter")?;
    ensure!(status.success(), "the workflow on Slurm failed");
    Ok(())
}

fn announce() {
    eprintln!(
        "xtask: 1. Debian's packages slurm-wlm and munge, if they are missing (with apt, as root)\n\
         xtask: 2. builds the Python wheel (minutes), installs it with Snakemake below target/cluster\n\
         xtask: 3. writes /etc/slurm/slurm.conf, runs munged, slurmctld and slurmd, mounts 4 MB of memory below target/cluster; all of it \
         is removed at the end\n\
         xtask: 4. runs the workflow with two cores, then with Slurm: undisturbed, and with jobs, controller and disk that fail"
    );
}

/// Installs Slurm and Munge where they are missing.
fn ensure_slurm() -> Result<()> {
    let is_there = |program: &str| {
        let lookup =
            Command::new("sh").args(["-c", &format!("command -v {program}")]).stdout(Stdio::null()).status();
        lookup.is_ok_and(|status| status.success())
    };
    let names = PACKAGES.map(|(package, _)| package).join(" and ");
    if !setup::can_install() {
        bail!("{names} are needed, and root to run them: expected Debian or one of its relatives, as root");
    }
    ensure!(Path::new("/bin/mount").exists(), "mount is needed, for a disk that is full");
    if PACKAGES.iter().all(|(_, program)| is_there(program)) {
        return Ok(());
    }
    eprintln!("xtask: installing {names} with apt (to run the workflow on Slurm)");
    setup::apt(&["update"])?;
    let mut arguments = vec!["install", "--yes", "--no-install-recommends"];
    arguments.extend(PACKAGES.map(|(package, _)| package));
    setup::apt(&arguments).with_context(|| format!("cannot install {names}"))
}
