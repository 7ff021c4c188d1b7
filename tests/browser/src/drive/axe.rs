//! Accessibility by the rules of axe-core, which npm installs for the test.

use crate::driver::Browser;
use anyhow::Result;
use serde_json::json;
use std::fs;
use std::path::Path;
use std::process::Command;

const REPORT: &str = "const found = await axe.run(document); return found.violations.map((one) => `${one.id}: ${one.nodes.slice(0, 3).map((node) => node.html.slice(0, 120)).join(' | ')}`);";

/// The script, installed below this folder where it is missing; nothing where npm cannot install it.
///
/// # Errors
/// Where it cannot be read.
pub fn script(folder: &Path) -> Result<Option<String>> {
    let folder = folder.join("axe");
    let script = folder.join("node_modules/axe-core/axe.min.js");
    if !script.exists() {
        eprintln!("installing axe-core with npm into {} (for this test only)", folder.display());
        let npm = Command::new("npm")
            .args(["install", "--no-save", "--silent", "axe-core", "--prefix"])
            .arg(&folder)
            .status();
        if !npm.is_ok_and(|status| status.success()) {
            return Ok(None);
        }
    }
    Ok(Some(fs::read_to_string(&script)?))
}

/// Violations on the page as it is, each with the first elements.
///
/// # Errors
/// What the browser reports.
pub fn violations(browser: &Browser, script: &str) -> Result<Vec<String>> {
    browser.run(script, json!([]))?;
    let report = browser.wait_for(REPORT, json!([]))?;
    Ok(report.as_array().into_iter().flatten().map(ToString::to_string).collect())
}
