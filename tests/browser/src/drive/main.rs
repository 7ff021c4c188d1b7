//! `cargo xtask web --test`: opens `guide.html` from disk in Chromium, compares what it computes with the program, measures, and takes
//! pictures of every view.
#![forbid(unsafe_code)]
#![deny(missing_docs)]

mod axe;
mod checks;
mod driver;
mod endurance;
mod figures;
mod live;
mod program;
mod results;
mod serial;
mod served;
mod views;

use anyhow::{Context, Result, bail};
use checks::{Checks, Options};
use driver::Browser;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

const HELP: &str = "Test guide.html in Chromium

Usage: cargo xtask web --test [OPTIONS]

Options:
  --test          run this test; without it the page is made and not tested
  --manual        in place of --test: make the page and put it beside the pages of the manual
  --session DIR   compare the results of this session too: may be given more than once
  --program FILE  compare results and times with this program, as guide of a release build (default: that of the tests)
  --only NAME     run the checks whose names contain this
  --no-pictures   take no pictures
  --minutes N     watch the live view for so long, at the full rate of a device (default: not at all)
  --figures DIR   write the pictures of the manual's live figures into this folder
";

fn main() -> Result<ExitCode> {
    let mut arguments = std::env::args().skip(1);
    let (mut page, mut sessions, mut options) = (None, Vec::new(), Options::default());
    while let Some(argument) = arguments.next() {
        match argument.as_str() {
            "--page" => page = Some(PathBuf::from(value(&mut arguments, &argument)?)),
            "--session" => sessions.push(PathBuf::from(value(&mut arguments, &argument)?)),
            "--minutes" => {
                let text = value(&mut arguments, &argument)?;
                options.minutes =
                    text.parse().with_context(|| format!("--minutes: {text}, expected a number"))?;
            }
            "--program" => {
                let text = value(&mut arguments, &argument)?;
                let file = Path::new(&text).canonicalize();
                options.program = Some(file.with_context(|| format!("--program: {text}: cannot read"))?);
            }
            "--only" => options.only = value(&mut arguments, &argument)?,
            "--no-pictures" => options.no_pictures = true,
            "--figures" => options.figures = Some(PathBuf::from(value(&mut arguments, &argument)?)),
            "--help" | "-h" => {
                print!("{HELP}");
                return Ok(ExitCode::SUCCESS);
            }
            other => bail!("{other}: unknown option\n\n{HELP}"),
        }
    }
    let page = page.context("--page: missing, expected the page to test")?;
    let page = page.canonicalize().with_context(|| format!("{}: cannot read", page.display()))?;
    let folder = page.parent().unwrap_or(Path::new("/")).to_owned();
    let profile = folder.join(format!("profile-{}", std::process::id()));
    let browser = Browser::start(&profile)?;
    let mut checks = Checks::new(&browser, &page, folder, options);
    let outcome = checks.all(&sessions);
    drop(browser);
    let _ = std::fs::remove_dir_all(&profile);
    Ok(if outcome? == 0 { ExitCode::SUCCESS } else { ExitCode::FAILURE })
}

fn value(arguments: &mut std::iter::Skip<std::env::Args>, argument: &str) -> Result<String> {
    arguments.next().with_context(|| format!("{argument}: expected a value"))
}
