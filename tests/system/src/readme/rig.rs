//! The parts of the page that a rig in QEMU is needed for.
//!
//! * `demo`: the procedure of `cargo xtask demo`
//! * `hidden`: its end, where the rig hides an effect
//! * `recording`: a console block about the files that the procedure left
//! * `live`: a console block on a running rig; what shows the moment is compared without its numbers
//!
//! The end-to-end tests run the same procedures, and compare these parts on the way.

use super::page::{Block, Made};
use super::shell::Shell;
use crate::bench::Bench;
use crate::demo::{hidden, judgement, procedure};
use crate::images;
use anyhow::{Context, Result};
use simulation::rig::config::RigConfig;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::time::Duration;

/// What the page's rig is drawn from.
pub const SEED: u64 = 1;
/// Where the demonstration keeps its files, from the folder it runs in.
const OUT: &str = "target/demo";
/// The program that takes sweeps, as the demonstration names it when it is called from the root.
const XTASK: &str = "target/debug/xtask";
const LIMIT: Duration = Duration::from_secs(120);
/// Rig seconds per second of the running rig.
const SPEED: f64 = 4.0;

/// Where the demonstration keeps its files if it runs in this folder.
pub fn out(folder: &Path) -> PathBuf {
    folder.join(OUT)
}

/// What a run said, as it says it where `folder` is the working folder and `xtask` was built by cargo.
pub fn as_shown(said: &str, folder: &Path, xtask: &Path) -> String {
    let said = said.replace(&format!("{}/", folder.display()), "");
    let said = said.replace(&xtask.display().to_string(), XTASK);
    // The acquisitions before the diagnosis are like those of the procedure.
    let begin = said.find("$ guide diagnose").unwrap_or(0);
    said[begin..].to_owned()
}

/// All parts.
pub(super) fn all(blocks: &[Block]) -> Result<BTreeMap<String, String>> {
    let (folder, xtask) = (tempfile::tempdir()?, std::env::current_exe()?);
    let out = out(folder.path());
    let mut parts = BTreeMap::new();
    eprintln!("the procedure of the demonstration");
    let mut said = String::new();
    let outcome = procedure(&xtask, SEED, &out, &mut |text| said.push_str(text))?;
    said.push_str(&judgement(&outcome, SEED, &out)?);
    parts.insert("demo".to_owned(), as_shown(&said, folder.path(), &xtask));
    let shell = Shell::new(images::build_guide()?, folder.path());
    parts.insert("recording".to_owned(), shell.run(find(blocks, "recording")?)?);
    eprintln!("the rig that hides an effect");
    said.clear();
    let found = hidden::diagnosis(&xtask, SEED, &out, &hidden::PLAN, &mut |text| said.push_str(text))?;
    said.push_str(&found.told(SEED));
    parts.insert("hidden".to_owned(), as_shown(&said, folder.path(), &xtask));
    eprintln!("a running rig");
    let bench = Bench::start(RigConfig::default(), SEED, SPEED, LIMIT)?;
    parts.insert("live".to_owned(), shell.with_port(bench.port()).run(find(blocks, "live")?)?);
    bench.stop()?;
    Ok(parts)
}

fn find<'a>(blocks: &'a [Block], part: &str) -> Result<&'a Block> {
    let found = blocks.iter().find(|block| block.made == Made::Rig(part.to_owned()));
    found.with_context(|| format!("README.md has no part {part}"))
}
