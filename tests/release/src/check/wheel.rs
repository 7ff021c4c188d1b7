//! The Python wheel of this system, in a virtual environment that has nothing else.

use crate::numbers::same;
use crate::program::Program;
use anyhow::{Context, Result, ensure};
use release::manifest::Manifest;
use serde_json::Value;
use std::path::Path;
use std::process::Command;

/// Identifies a session, and prints the document.
const IDENTIFY: &str = "import json, needle_guide, sys; print(json.dumps(needle_guide.Session.open(sys.argv[1]).identify().to_dict()))";

/// Installs it, and compares its numbers with those of the program.
///
/// # Errors
/// Where it cannot be installed, or differs.
pub fn check(bundle: &Path, manifest: &Manifest, python: &Path, here: &Program, folder: &Path) -> Result<()> {
    let wheel = manifest.files.keys().find(|name| name.contains("manylinux") && name.ends_with(".whl"));
    let wheel = bundle.join(wheel.context("the bundle has no wheel for Linux")?);
    let fresh = folder.join("fresh");
    run(Command::new(python).args(["-m", "venv"]).arg(&fresh), folder)?;
    run(Command::new(fresh.join("bin/pip")).args(["install", "--quiet"]).arg(&wheel), folder)?;
    let version = run(Command::new(fresh.join("bin/guide")).arg("--version"), folder)?;
    ensure!(version.starts_with(&format!("guide {}", manifest.version)), "{version}");
    let module_output = run(Command::new(fresh.join("bin/python")).args(["-c", IDENTIFY, "Linux"]), folder)?;
    let module_json: Value = serde_json::from_str(&module_output).context("the module's document")?;
    let expected: Value = serde_json::from_str(&here.call(&["identify", "Linux", "--json"])?)?;
    same(&expected, &module_json, 0.0)
}

fn run(command: &mut Command, folder: &Path) -> Result<String> {
    let output = command.current_dir(folder).env_remove("PYTHONPATH").output()?;
    let errors = String::from_utf8_lossy(&output.stderr);
    ensure!(output.status.success(), "{}: {}", command.get_program().display(), errors.trim());
    Ok(String::from_utf8(output.stdout)?)
}
