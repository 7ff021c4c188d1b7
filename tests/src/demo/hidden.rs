//! The end of the demonstration: a rig that hides an effect, and the discrepancy workflow that finds it.

use super::{LIMIT, SPEED, Typist, path, rig_toml, sweep_command};
use crate::bench::Bench;
use crate::images;
use anyhow::{Context, Result};
use host::rig::config::{HiddenEffect, RigConfig};
use serde_json::Value;
use std::fs;
use std::path::Path;

/// When home, tare and the first staircase start, and how long after it the next one does; seconds of the device's clock.
const HOME_AT: &str = "4";
const TARE_AT: &str = "10";
const FIRST_AT_S: u32 = 15;
const EVERY_S: u32 = 24;
/// Depths of the needle, millimetres, and staircases at each.
pub const PLAN: [(f64, usize); 3] = [(20.0, 1), (30.0, 2), (40.0, 1)];

/// What was hidden and what was found.
#[derive(Debug, Clone, PartialEq)]
pub struct Found {
    /// What the rig hid.
    pub hidden: HiddenEffect,
    /// `guide diagnose --json`.
    pub diagnosis: Value,
}

impl Found {
    /// Whether the hidden effect is named, or in the class that is.
    pub fn is_in_class(&self) -> bool {
        let classes = self.diagnosis["effects"].as_array().into_iter().flatten();
        let mut ids = classes.flat_map(|effect| effect["class"].as_array().into_iter().flatten());
        ids.any(|id| id.as_str() == Some(&self.hidden.id))
    }

    /// What was hidden, in words.
    pub fn told(&self, seed: u64) -> String {
        let values: Vec<String> = self.hidden.values.iter().map(f64::to_string).collect();
        format!("what the rig hid (seed {seed}): {} {}", self.hidden.id, values.join(", "))
    }

    /// Share of the removable gap that is gone on runs that no fit has seen.
    pub fn removed(&self) -> Option<f64> {
        self.diagnosis.pointer("/gap/removed").and_then(Value::as_f64)
    }
}

/// Lets the firmware run the diagnostic staircase on rigs that hide the seed's effect, one per depth, and diagnoses the session.
///
/// # Errors
/// Where a command fails.
pub fn diagnosis(
    xtask: &Path,
    seed: u64,
    out: &Path,
    plan: &[(f64, usize)],
    say: &mut dyn FnMut(&str),
) -> Result<Found> {
    let guide = images::build_guide()?;
    let session = out.join("hidden");
    if session.exists() {
        fs::remove_dir_all(&session).with_context(|| format!("cannot clear {}", session.display()))?;
    }
    fs::create_dir_all(out).with_context(|| format!("cannot make {}", out.display()))?;
    let rig_file = out.join("rig.toml");
    fs::write(&rig_file, rig_toml(&RigConfig::default().rig))?;
    let (model_file, figures) = (out.join("model.toml"), out.join("figures"));
    let (session, rig_file) = (path(&session)?, path(&rig_file)?);
    let hidden = HiddenEffect::of_seed(seed);
    let mut guide = Typist { program: guide, say };
    for (depth_mm, staircases) in plan {
        let mut config = RigConfig::default();
        config.simulation.depth_mm = *depth_mm;
        config.simulation.effects = vec![hidden.clone()];
        let bench = Bench::start(config, seed, SPEED, LIMIT)?;
        let (port, sweep) = (bench.port(), sweep_command(xtask, &bench));
        guide.output(&["home", "--port", &port, "--at-s", HOME_AT])?;
        guide.output(&["tare", "--port", &port, "--at-s", TARE_AT])?;
        for number in 0..*staircases {
            let at_s = (FIRST_AT_S + EVERY_S * number as u32).to_string();
            let depth_mm = depth_mm.to_string();
            let acquire = ["acquire", "--port", &port, "--at-s", &at_s, "--program", "quick-staircase"];
            let recording = ["--rig", rig_file, "--depth-mm", &depth_mm, "--out", session];
            let arguments = [&acquire[..], &recording, &["--sweep-command", &sweep]].concat();
            guide.echo(&arguments);
            guide.output(&arguments)?;
        }
        bench.stop()?;
    }
    (guide.say)("\n");
    let diagnose = ["diagnose", session, "--out", path(&model_file)?, "--plots", path(&figures)?];
    guide.shown(&diagnose)?;
    let diagnosis = serde_json::from_str(&guide.output(&["diagnose", session, "--json"])?)
        .context("guide diagnose --json printed no JSON")?;
    Ok(Found { hidden, diagnosis })
}
