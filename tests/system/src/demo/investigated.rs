//! An investigation in the demonstration: `guide investigate` chooses every run, and the firmware makes it, until what the rig hides has its name.

use super::hidden::{Found, RigKnown, diagnosed, prepared};
use super::{SPEED, Typist, path, sweep_command, sweeps};
use crate::bench::Bench;
use crate::cosim::Appointment;
use crate::images;
use crate::qemu::HANGS;
use anyhow::{Context, Result, ensure};
use serde_json::Value;
use simulation::rig::config::{HiddenEffect, RigConfig};
use simulation::rig::imperfections::Imperfections;
use std::fs;
use std::path::Path;

/// When home, tare and the run start, seconds of the device's clock.
const HOME_AT_S: u32 = 4;
const TARE_AT_S: u32 = 10;
const RUN_AT_S: u32 = 15;
/// The first run, before anything is known.
const FIRST_DEPTH_MM: &str = "30";
const FIRST_PROGRAM: &str = "quick-staircase";
/// Depths to which the needle can be brought.
const DEPTHS_MM: [&str; 3] = ["20", "30", "40"];
/// Runs of the investigation at most.
const MAX_RUNS: usize = 6;

/// Result of an investigation.
#[derive(Debug, Clone, PartialEq)]
pub struct Investigated {
    /// What was hidden, and what the session says of it in the end.
    pub found: Found,
    /// The file of the investigation.
    pub log: Value,
}

impl Investigated {
    /// Runs that were made.
    pub fn runs(&self) -> u64 {
        let steps = self.log["steps"].as_array();
        steps.and_then(|steps| steps.last()?["runs"].as_u64()).unwrap_or_default()
    }

    /// What was found, and after how many runs.
    pub fn summary(&self, seed: u64) -> String {
        format!("{}, after {} runs", self.found.summary(seed), self.runs())
    }
}

/// A run that the investigation wants.
struct Wanted {
    depth_mm: String,
    id: String,
    program: String,
}

impl Wanted {
    /// From the command that `guide investigate` prints; nothing where it has ended.
    fn of(printed: &str) -> Result<Option<Self>> {
        let Some(command) = printed.lines().find(|line| line.trim_start().starts_with("guide acquire "))
        else {
            return Ok(None);
        };
        let words = shlex::split(command).context("the command of a run")?;
        let option = |name: &str| {
            let value = words.iter().skip_while(|word| *word != name).nth(1).cloned();
            value.with_context(|| format!("{command}: no {name}"))
        };
        Ok(Some(Self { depth_mm: option("--depth-mm")?, id: option("--id")?, program: option("--program")? }))
    }
}

/// Investigates a rig that hides the seed's effect behind small imperfections: each run is made by the firmware, on a rig that starts with the needle
/// at the depth that was asked for.
///
/// # Errors
/// Where a command fails.
pub fn investigated(
    xtask: &Path,
    seed: u64,
    out: &Path,
    known: RigKnown,
    show: &mut dyn FnMut(&str),
) -> Result<Investigated> {
    let (session, rig_file) = prepared(xtask, seed, out, known, show)?;
    let (session, rig_file) = (path(&session)?, path(&rig_file)?);
    let hidden = HiddenEffect::of_seed(seed);
    let mut guide = Typist { program: images::build_guide()?, show };
    let (mut modulus_kpa, mut runs) = (0.0, 0);
    let mut wanted = Wanted {
        depth_mm: FIRST_DEPTH_MM.to_owned(),
        id: "first".to_owned(),
        program: FIRST_PROGRAM.to_owned(),
    };
    loop {
        let Wanted { depth_mm, id, program } = &wanted;
        let mut config = RigConfig::default();
        config.simulation.depth_mm = depth_mm.parse().context("the depth of a run")?;
        config.simulation.effects = vec![hidden.clone()];
        config.simulation.imperfections = Imperfections::of_seed(seed, runs);
        let bench = Bench::start(config, seed, SPEED, HANGS)?;
        let run = Appointment::at_s(RUN_AT_S).with_sweeps(sweeps(program)?);
        bench.rig().expect([HOME_AT_S, TARE_AT_S].map(Appointment::at_s));
        bench.rig().expect([run]);
        let (port, sweep) = (bench.port(), sweep_command(xtask, &bench));
        guide.output(&["home", "--port", &port, "--at-s", &HOME_AT_S.to_string()])?;
        guide.output(&["tare", "--port", &port, "--at-s", &TARE_AT_S.to_string()])?;
        let time_text = RUN_AT_S.to_string();
        let acquire = ["acquire", "--port", &port, "--at-s", &time_text, "--program", program];
        let recording = ["--rig", rig_file, "--depth-mm", depth_mm, "--id", id, "--out", session];
        let arguments = [&acquire[..], &recording, &["--sweep-command", &sweep]].concat();
        guide.echo(&arguments);
        guide.output(&arguments)?;
        modulus_kpa += 1e-3 * bench.rig().rig(|rig| rig.truth().modulus_pa);
        bench.stop()?;
        runs += 1;
        ensure!(runs as usize <= MAX_RUNS, "the investigation goes on after {runs} runs");
        let left = (MAX_RUNS - runs as usize).max(1).to_string();
        let investigate = ["investigate", session, "--max-runs", &left, "--depths-mm"];
        let printed = guide.printed(&[&investigate[..], &DEPTHS_MM].concat())?;
        if runs as usize == MAX_RUNS {
            break;
        }
        match Wanted::of(&printed)? {
            Some(next) => wanted = next,
            None => break,
        }
    }
    let diagnosis = diagnosed(&mut guide, session, out)?;
    let log = Path::new(session).join("investigation.json");
    let log = fs::read(&log).with_context(|| format!("{}: cannot read", log.display()))?;
    let log = serde_json::from_slice(&log).context("the investigation's file is no JSON")?;
    let found = Found { hidden, true_k_kpa: modulus_kpa / runs as f64, diagnosis };
    Ok(Investigated { found, log })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_run_that_is_wanted_is_that_of_the_printed_command() {
        let printed = "1   run    adequate: nothing missing 90 %\nmeasure    a staircase\nprogram    demo/hidden/next.toml\n           \
                       guide acquire --port PORT --out demo/hidden --depth-mm 40 --id y40-1 --program demo/hidden/next.toml\n";
        let wanted = Wanted::of(printed).expect("a command").expect("a run");
        assert_eq!((wanted.depth_mm.as_str(), wanted.id.as_str()), ("40", "y40-1"));
        assert_eq!(wanted.program, "demo/hidden/next.toml");
        assert!(Wanted::of("end        the missing effect is named\n").expect("nothing").is_none());
        assert!(Wanted::of("  guide acquire --port PORT\n").is_err());
    }
}
