//! Sessions: made, read and analysed on both systems.

use crate::Checks;
use crate::numbers::{SAME, SAME_FIT, same, same_text};
use crate::program::Program;
use anyhow::{Context, Result, ensure};
use release::archive;
use serde_json::Value;
use std::fs;
use std::path::Path;

/// Analyses of a session, with their arguments and the tolerance of their numbers on another system.
const ANALYSES: [(&str, &[&str], f64); 5] = [
    ("check", &[], SAME),
    ("identify", &[], SAME),
    ("diagnose", &[], SAME_FIT),
    ("predict", &["--until", "50", "--compare"], SAME),
    ("track", &[], SAME),
];

/// A session with line ends of Windows.
const CRLF: &str = "crlf";

/// Runs all of it.
///
/// # Errors
/// Where a folder cannot be written; what a program does wrong is counted.
pub fn check(checks: &mut Checks, here: &Program, wine: Option<&Program>, folder: &Path) -> Result<()> {
    for program in [Some(here), wine].into_iter().flatten() {
        let initialized = program.call(&["init", "--example", program.system()]).map(drop);
        checks.report(&format!("guide init --example ({})", program.system()), initialized);
    }
    with_line_ends_of_windows(&folder.join("Linux"), &folder.join(CRLF))?;
    let native = here.system();
    for (name, options, tolerance) in ANALYSES {
        let ours = document(here, name, native, options);
        let is_computed = ours.as_ref().map(|_| ()).map_err(|error| anyhow::anyhow!("{error:#}"));
        checks.report(&format!("guide {name} ({native})"), is_computed);
        let Ok(ours) = ours else { continue };
        let crlf = document(here, name, CRLF, options).and_then(|document| same(&ours, &document, 0.0));
        checks.report(&format!("guide {name} reads line ends of Windows ({native})"), crlf);
        let Some(wine) = wine else { continue };
        let outcome = (|| {
            // Each reads what the other one has written, too.
            same(&ours, &document(wine, name, native, options)?, tolerance)?;
            same(&ours, &document(wine, name, CRLF, options)?, tolerance)
        })();
        checks.report(&format!("guide {name} has the same numbers on Windows"), outcome);
    }
    let reported = report(here, folder).map(drop);
    checks.report(&format!("guide report ({native})"), reported);
    if let Some(wine) = wine {
        checks.report(
            "a session made on Windows has the same bytes",
            same_files(folder, native, wine.system()),
        );
        checks.report("guide report writes the same page on Windows", reports(here, wine, folder));
        checks.report("paths and patterns of Windows", paths(here, wine, folder));
        checks.report("a session is locked on Windows, and free again", import(wine, folder));
    }
    Ok(())
}

/// The JSON document of a command on a session, without the names that depend on where the session is.
fn document(program: &Program, name: &str, session: &str, options: &[&str]) -> Result<Value> {
    let text = program.call(&[&[name, session], options, &["--json"]].concat())?;
    let text = text.replace(session, "SESSION");
    serde_json::from_str(&text).with_context(|| format!("guide {name} --json ({})", program.system()))
}

fn with_line_ends_of_windows(from: &Path, to: &Path) -> Result<()> {
    fs::create_dir_all(to)?;
    for entry in archive::entries(from)? {
        let text = String::from_utf8(entry.content).with_context(|| format!("{}: is no text", entry.name))?;
        fs::write(to.join(&entry.name), text.replace('\n', "\r\n"))?;
    }
    Ok(())
}

fn same_files(folder: &Path, one: &str, other: &str) -> Result<()> {
    let [a, b] = [one, other].map(|name| archive::entries(&folder.join(name)));
    let (a, b) = (a?, b?);
    ensure!(!a.is_empty() && a.len() == b.len(), "{} files and {}", a.len(), b.len());
    for (a, b) in a.iter().zip(&b) {
        ensure!(a.name == b.name, "{} and {}", a.name, b.name);
        ensure!(a.content == b.content, "{} differs", a.name);
    }
    Ok(())
}

/// The report of the same session, dated so that it depends on nothing else.
fn report(program: &Program, folder: &Path) -> Result<Vec<u8>> {
    let name = format!("{}.html", program.system());
    program.call(&["report", "Linux", "--date", "2026-01-01", "--out", &name])?;
    let page = fs::read(folder.join(&name))?;
    ensure!(page.starts_with(b"<!DOCTYPE html>"), "{name}: no page");
    Ok(page)
}

fn reports(here: &Program, wine: &Program, folder: &Path) -> Result<()> {
    let [ours, theirs] = [report(here, folder)?, report(wine, folder)?].map(String::from_utf8);
    same_text(&ours?, &theirs?, SAME_FIT)
}

/// An absolute path, one with a backslash, and a pattern, which the shells of Windows leave to the program.
fn paths(here: &Program, wine: &Program, folder: &Path) -> Result<()> {
    let expected = here.call(&["check", "Linux"])?;
    for path in [wine.path(&folder.join("Linux")), ".\\Linux".to_owned()] {
        let check_output = wine.call(&["check", &path])?;
        ensure!(
            check_output.lines().count() == expected.lines().count(),
            "guide check {path}: {check_output}"
        );
    }
    let written = wine.call(&["summarize", "Lin*", "crl*", "--out", "records.jsonl"])?;
    let records = fs::read_to_string(folder.join("records.jsonl"))?;
    ensure!(records.lines().count() == 2, "guide summarize Lin* crl*: {written}");
    let missing = wine.failure(&["identify", "C:\\nowhere"])?;
    ensure!(missing.contains("C:\\nowhere"), "{missing}");
    Ok(())
}

/// Adds a run to a session on Windows: the lock is taken and removed.
fn import(wine: &Program, folder: &Path) -> Result<()> {
    let session = folder.join("written");
    let plan = wine.path(&folder.join("Linux").join("plan.toml"));
    wine.call(&["simulate", "--config", &plan, "--out", "written", "--seed", "3"])?;
    let names: Vec<String> = archive::entries(&session)?.into_iter().map(|entry| entry.name).collect();
    ensure!(names.iter().any(|name| name == "session.toml"), "{names:?}");
    ensure!(
        names.iter().all(|name| !name.ends_with(".lock") && !name.ends_with(".part")),
        "left behind: {names:?}"
    );
    Ok(())
}
