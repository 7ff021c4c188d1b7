//! Results of a session beside those of the program, and the time that both take.

use crate::checks::SAME;
use crate::driver::Browser;
use crate::program::{compare, timed};
use anyhow::{Context, Result, ensure};
use serde_json::{Value, json};
use std::fs;
use std::path::Path;

/// Results may differ by this share where fits end as soon as a step is shorter than a twentieth of a standard deviation, whose end
/// moves with the rounding of each processor. Chosen after the example's differences of 2e-3 were measured; other sessions may differ by more.
const SAME_END: f64 = 5e-3;

/// Ends of intervals may differ by this share: that of E of the example differs by 2.9e-9 between engine and program, and by 1.4e-9 between the
/// programs of two systems, where K itself differs by 1e-14.
const SAME_INTERVAL: f64 = 1e-8;

/// Compares every result of a session, and the processor time of page and program.
///
/// # Errors
/// What differs.
pub fn equal(browser: &Browser, address: &str, session: &Path, program: Option<&Path>) -> Result<String> {
    let session = session.canonicalize().with_context(|| format!("{}: cannot read", session.display()))?;
    let (parent, name) = (session.parent().context("a folder")?, session.file_name().context("a folder")?);
    let name = name.to_string_lossy().into_owned();
    let mut files = Vec::new();
    collect(&session, &name, &mut files)?;
    browser.open(address)?;
    browser.wait_for(
        "await engine.ready; await engine.open(arguments[0].map(([name, text]) => [name, new TextEncoder().encode(text)]));",
        json!([files]),
    )?;
    let mut differences = Vec::new();
    for (request, arguments, bound) in [
        (json!({"do": "check", "dir": name}), vec!["check", name.as_str()], SAME),
        (json!({"do": "identify", "dir": name}), vec!["identify", &name], SAME_INTERVAL),
        (json!({"do": "diagnose", "dir": name}), vec!["diagnose", &name], SAME_END),
        (
            json!({"do": "predict", "dir": name, "until_mm": 50}),
            vec!["predict", &name, "--until", "50"],
            SAME_END,
        ),
    ] {
        let command = arguments[0];
        let (of_program, program_s) = timed(parent, &arguments, program)?;
        // As text: the driver's own numbers have fewer digits.
        let script = "return JSON.stringify((await engine.request('compared', arguments[0])).document);";
        let engine_before_s = browser.engine_s();
        let of_page = browser.wait_for(script, json!([request]));
        let page_s = browser.engine_s() - engine_before_s;
        match (of_page, of_program) {
            (Ok(page), Ok(program)) => {
                let document: Value = serde_json::from_str(page.as_str().unwrap_or_default())?;
                let distance = compare(&document, &program).with_context(|| command.to_owned())?;
                ensure!(
                    distance.largest < bound,
                    "{command}: {:.1e} apart at {}",
                    distance.largest,
                    distance.place
                );
                differences.push(format!(
                    "{command} {} numbers within {:.0e}, processor time {page_s:.2} s, program {program_s:.2} s",
                    distance.numbers, distance.largest
                ));
            }
            (Err(page), Err(program)) => {
                let (page, program) = (page.to_string(), program.to_string());
                // The program names the folder too.
                let reason = page.split_once(": ").map_or(page.as_str(), |(_, reason)| reason);
                ensure!(program.contains(reason), "{command}: \"{page}\", the program has \"{program}\"");
                differences.push(format!("{command}: the same error"));
            }
            (Err(page), Ok(_)) => return Err(page.context(format!("{command}: the page alone fails"))),
            (Ok(_), Err(program)) => {
                return Err(program.context(format!("{command}: the program alone fails")));
            }
        }
    }
    Ok(differences.join("; "))
}

/// The text files of a session, with the names that the page gives them.
fn collect(folder: &Path, prefix: &str, files: &mut Vec<(String, String)>) -> Result<()> {
    for entry in fs::read_dir(folder)? {
        let path = entry?.path();
        let name = format!("{prefix}/{}", path.file_name().unwrap_or_default().to_string_lossy());
        if path.is_dir() {
            collect(&path, &name, files)?;
        } else if let Ok(text) = fs::read_to_string(&path) {
            files.push((name, text));
        }
    }
    Ok(())
}
