//! The parts of the pages that a rig in QEMU is needed for.
//!
//! * `demo`: the procedure of `cargo xtask demo`
//! * `hidden`: its end, where the rig hides an effect
//! * `recording`: console blocks about the files that the procedure left
//! * `new`: console blocks on a rig as it is after mounting
//! * `live`: console blocks on a running rig, one after the other; what shows the moment is compared without its numbers
//!
//! The end-to-end tests run the same procedures, and compare these parts on the way.

use super::page::{Block, Made};
use super::shell::Shell;
use crate::bench::Bench;
use crate::demo::{hidden, judgement, procedure};
use crate::images;
use crate::qemu::HANGS;
use anyhow::{Result, bail};
use simulation::rig::config::RigConfig;
use std::path::{Path, PathBuf};

/// Seed of the pages' rig.
pub const SEED: u64 = 1;
/// Folder of the demonstration's files, from the folder it runs in.
const OUT: &str = "target/demo";
/// The program that takes sweeps, as the demonstration names it when it is called from the root.
const XTASK: &str = "target/debug/system";
/// Rig seconds per second of the running rig.
const SPEED: f64 = 4.0;

/// A rig whose force has a tenth of the noise. A drift is estimated from a second of noisy readings, and the default noise appears
/// as one that matters once in some twenty tares, depending on when the tare happens to begin; this noise does not.
pub fn quiet() -> RigConfig {
    let mut config = RigConfig::default();
    config.simulation.force.noise_n /= 10.0;
    config
}

/// Folder of the demonstration's files if it runs in this folder.
pub fn out(folder: &Path) -> PathBuf {
    folder.join(OUT)
}

/// Output of a run, as it prints it if `folder` is the working folder and `xtask` was built by cargo.
pub fn as_shown(printed: &str, folder: &Path, xtask: &Path) -> String {
    let printed = printed.replace(&format!("{}/", folder.display()), "");
    let printed = printed.replace(&xtask.display().to_string(), XTASK);
    // The acquisitions before the diagnosis are like those of the procedure.
    let begin = printed.find("$ guide diagnose").unwrap_or(0);
    printed[begin..].to_owned()
}

/// All parts, with what they show now.
pub(super) fn all(blocks: &[Block]) -> Result<Vec<(&Block, String)>> {
    let (folder, xtask) = (tempfile::tempdir()?, std::env::current_exe()?);
    let output_dir = out(folder.path());
    let shell = Shell::new(images::build_guide()?, folder.path());
    let of = |part: &str| {
        let rig_part = Made::Rig(part.to_owned());
        blocks.iter().filter(move |block| block.made == rig_part)
    };
    let mut fresh = Vec::new();
    eprintln!("the procedure of the demonstration");
    let mut printed = String::new();
    let outcome = procedure(&xtask, SEED, &output_dir, &mut |text| printed.push_str(text))?;
    printed.push_str(&judgement(&outcome, SEED, &output_dir)?);
    let printed = as_shown(&printed, folder.path(), &xtask);
    fresh.extend(of("demo").map(|block| (block, printed.clone())));
    for block in of("recording") {
        fresh.push((block, shell.run(block)?));
    }
    eprintln!("the rig that hides an effect");
    let mut printed = String::new();
    let diagnosis =
        hidden::diagnosis(&xtask, SEED, &output_dir, hidden::AFTER_AIR, &mut |text| printed.push_str(text))?;
    printed.push_str(&diagnosis.summary(SEED));
    let printed = as_shown(&printed, folder.path(), &xtask);
    fresh.extend(of("hidden").map(|block| (block, printed.clone())));
    eprintln!("a new rig");
    let bench = Bench::start(RigConfig::default(), SEED, SPEED, HANGS)?;
    let shell_of_new = shell.clone().with_port(bench.port());
    for block in of("new") {
        fresh.push((block, shell_of_new.run(block)?));
    }
    bench.stop()?;
    eprintln!("a running rig");
    let bench = Bench::start(quiet(), SEED, SPEED, HANGS)?;
    let shell = shell.with_port(bench.port());
    super::write_files(blocks, &shell)?;
    for block in of("live") {
        fresh.push((block, shell.run(block)?));
    }
    bench.stop()?;
    for block in blocks {
        if let Made::Rig(rig_part) = &block.made
            && !["demo", "recording", "hidden", "new", "live"].contains(&rig_part.as_str())
        {
            bail!("{}: no part {rig_part}", block.place());
        }
    }
    Ok(fresh)
}
