//! The end of the demonstration: a rig that hides an effect, and the discrepancy workflow that finds it.

use super::{SPEED, Typist, air, path, rig_toml, sweep_command, sweeps};
use crate::bench::Bench;
use crate::cosim::Appointment;
use crate::images;
use crate::qemu::HANGS;
use anyhow::{Context, Result};
use serde_json::Value;
use simulation::rig::config::{HiddenEffect, RigConfig};
use simulation::rig::imperfections::Imperfections;
use std::fs;
use std::path::{Path, PathBuf};

/// When home, tare and the first staircase start, and how long after it the next one does; seconds of the device's clock.
const HOME_AT_S: u32 = 4;
const TARE_AT_S: u32 = 10;
const FIRST_AT_S: u32 = 15;
const EVERY_S: u32 = 24;
/// The motion program.
const PROGRAM: &str = "quick-staircase";
/// File of the characterized rig, beside its rig file.
const CHARACTERIZED: &str = "characterized.toml";
/// Depths of the needle, millimetres, and staircases at each.
pub const PLAN: [(f64, usize); 3] = [(20.0, 1), (30.0, 2), (40.0, 1)];
/// The diagnosis of a rig of which nothing is known beside what is stated.
pub const AS_STATED: (&[(f64, usize)], RigKnown) = (&PLAN, RigKnown::AsStated);
/// Plan of the demonstration: after runs in air.
pub const AFTER_AIR: (&[(f64, usize)], RigKnown) = (&PLAN, RigKnown::InAir);

/// Knowledge of the rig for the diagnosis beside its statements.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum RigKnown {
    /// No more than the statements.
    AsStated,
    /// Parameters that the device's runs in air determine, before the rig hides its effect.
    InAir,
}

/// Hidden and found effects.
#[derive(Debug, Clone, PartialEq)]
pub struct Found {
    /// Effect that the rig hid.
    pub hidden: HiddenEffect,
    /// Modulus of the tissue, the mean over the staircases: it differs a little from start to start.
    pub true_k_kpa: f64,
    /// `guide diagnose --json`.
    pub diagnosis: Value,
}

impl Found {
    /// Classes of the effects that are named, and effects of the rig that are reported as moved since it was characterised.
    pub fn classes(&self) -> Vec<Vec<&str>> {
        let is_named = matches!(self.verdict(), "named" | "ambiguous");
        let list = |field: &str| self.diagnosis[field].as_array().into_iter().flatten();
        let effects = list("effects").filter(|_| is_named).map(|effect| {
            effect["class"].as_array().into_iter().flatten().filter_map(Value::as_str).collect()
        });
        let mut classes: Vec<Vec<&str>> = effects.collect();
        for id in list("moved_since").filter_map(|one| one["effect"].as_str()) {
            if !classes.iter().any(|class| class.contains(&id)) {
                classes.push(vec![id]);
            }
        }
        classes
    }

    /// Whether the diagnosis reports an effect of the rig as changed.
    fn has_moved(&self, id: &str) -> bool {
        let moved = self.diagnosis["moved_since"].as_array();
        moved.into_iter().flatten().any(|one| one["effect"] == id)
    }

    /// The verdict of the diagnosis.
    pub fn verdict(&self) -> &str {
        self.diagnosis["verdict"].as_str().unwrap_or("no verdict")
    }

    /// Whether the hidden effect is named, or in the class that is.
    pub fn is_in_class(&self) -> bool {
        self.classes().iter().any(|class| class.contains(&self.hidden.id.as_str()))
    }

    /// Whether it is named, alone in its class.
    pub fn is_named(&self) -> bool {
        self.classes().contains(&vec![self.hidden.id.as_str()])
    }

    /// Classes that are named and do not hold the hidden effect.
    pub fn further(&self) -> Vec<Vec<&str>> {
        self.classes().into_iter().filter(|class| !class.contains(&self.hidden.id.as_str())).collect()
    }

    /// The modulus that the diagnosis reports, against the true one, as a share, and whether its interval holds that.
    pub fn modulus_error(&self) -> Option<(f64, bool)> {
        let interval = &self.diagnosis["k_ci95_kpa"];
        let (low, high) = (interval.get(0)?.as_f64()?, interval.get(1)?.as_f64()?);
        let error = self.diagnosis["k_kpa"].as_f64()? / self.true_k_kpa - 1.0;
        Some((error, (low..=high).contains(&self.true_k_kpa)))
    }

    /// Hidden effect and result, in words.
    pub fn summary(&self, seed: u64) -> String {
        let values: Vec<String> = self.hidden.values.iter().map(f64::to_string).collect();
        let verdict = if self.is_named() && self.has_moved(&self.hidden.id) {
            "found: the rig has changed by it since it was characterised".to_owned()
        } else if self.is_named() {
            "found: named".to_owned()
        } else if self.is_in_class() {
            format!("found: one of {}", class_list(self.classes()))
        } else if self.classes().is_empty() {
            let partial = self.diagnosis["partial"].as_array().into_iter().flatten();
            let partial: Vec<&str> = partial.filter_map(Value::as_str).collect();
            let helps = if partial.is_empty() {
                String::new()
            } else {
                format!("; these explain a part: {}", partial.join(", "))
            };
            format!("not found: the verdict is {}{helps}", self.verdict())
        } else {
            format!("not found: named is {}", class_list(self.classes()))
        };
        let further = match self.further() {
            further if further.is_empty() || !self.is_in_class() => String::new(),
            further => format!("; named beside it, and not there: {}", class_list(further)),
        };
        format!("hidden effect (seed {seed}): {} {}\n{verdict}{further}", self.hidden.id, values.join(", "))
    }

    /// Share of the removable misfit that is removed on runs that no fit has used.
    pub fn removed(&self) -> Option<f64> {
        self.diagnosis.pointer("/gap/removed").and_then(Value::as_f64)
    }
}

fn class_list(classes: Vec<Vec<&str>>) -> String {
    classes.iter().map(|class| class.join(" or ")).collect::<Vec<_>>().join("; ")
}

/// Lets the firmware run the diagnostic staircase on rigs that hide the seed's effect behind small imperfections, one per depth, and
/// diagnoses the session, with what is known of the rig.
///
/// # Errors
/// Where a command fails.
pub fn diagnosis(
    xtask: &Path,
    seed: u64,
    out: &Path,
    (plan, known): (&[(f64, usize)], RigKnown),
    show: &mut dyn FnMut(&str),
) -> Result<Found> {
    let (session, rig_file) = prepared(xtask, seed, out, known, show)?;
    let (session, rig_file) = (path(&session)?, path(&rig_file)?);
    let hidden = HiddenEffect::of_seed(seed);
    let mut guide = Typist { program: images::build_guide()?, show };
    let (mut modulus_kpa, mut runs) = (0.0, 0.0);
    for (start, (depth_mm, staircases)) in (0..).zip(plan) {
        let mut config = RigConfig::default();
        config.simulation.depth_mm = *depth_mm;
        config.simulation.effects = vec![hidden.clone()];
        config.simulation.imperfections = Imperfections::of_seed(seed, start);
        let bench = Bench::start(config, seed, SPEED, HANGS)?;
        let starts_s: Vec<u32> =
            (0..*staircases).map(|number| FIRST_AT_S + EVERY_S * number as u32).collect();
        bench.rig().expect([HOME_AT_S, TARE_AT_S].map(Appointment::at_s));
        let sweeps = sweeps(PROGRAM)?;
        bench.rig().expect(starts_s.iter().map(|at_s| Appointment::at_s(*at_s).with_sweeps(sweeps.clone())));
        let (port, sweep) = (bench.port(), sweep_command(xtask, &bench));
        guide.output(&["home", "--port", &port, "--at-s", &HOME_AT_S.to_string()])?;
        guide.output(&["tare", "--port", &port, "--at-s", &TARE_AT_S.to_string()])?;
        for at_s in starts_s {
            let (time_text, depth_mm) = (at_s.to_string(), depth_mm.to_string());
            let acquire = ["acquire", "--port", &port, "--at-s", &time_text, "--program", PROGRAM];
            let recording = ["--rig", rig_file, "--depth-mm", &depth_mm, "--out", session];
            let arguments = [&acquire[..], &recording, &["--sweep-command", &sweep]].concat();
            guide.echo(&arguments);
            guide.output(&arguments)?;
        }
        modulus_kpa += *staircases as f64 * 1e-3 * bench.rig().rig(|rig| rig.truth().modulus_pa);
        runs += *staircases as f64;
        bench.stop()?;
    }
    (guide.show)("\n");
    let diagnosis = diagnosed(&mut guide, session, out)?;
    Ok(Found { hidden, true_k_kpa: modulus_kpa / runs, diagnosis })
}

/// Diagnoses a session, with model and figures beside it.
pub(super) fn diagnosed(guide: &mut Typist, session: &str, out: &Path) -> Result<Value> {
    let (model_file, figures, result) =
        (out.join("model.toml"), out.join("figures"), out.join("diagnosis.json"));
    let files = ["--out", path(&model_file)?, "--plots", path(&figures)?, "--json-out", path(&result)?];
    guide.shown(&[&["diagnose", session], &files[..]].concat())?;
    let diagnosis = fs::read(&result).with_context(|| format!("cannot read {}", result.display()))?;
    serde_json::from_slice(&diagnosis).context("guide diagnose --json-out wrote no JSON")
}

/// Folder of a session that is not there yet, and the rig's file with what is known of the rig.
pub(super) fn prepared(
    xtask: &Path,
    seed: u64,
    out: &Path,
    known: RigKnown,
    show: &mut dyn FnMut(&str),
) -> Result<(PathBuf, PathBuf)> {
    let session = out.join("hidden");
    let in_air = out.join("air");
    for folder in [&session, &in_air] {
        if folder.exists() {
            fs::remove_dir_all(folder).with_context(|| format!("cannot clear {}", folder.display()))?;
        }
    }
    fs::create_dir_all(out).with_context(|| format!("cannot make {}", out.display()))?;
    let (rig_file, characterized) = (out.join("rig.toml"), out.join(CHARACTERIZED));
    let plain = rig_toml(&RigConfig::default().rig);
    fs::write(&rig_file, &plain)?;
    if known == RigKnown::InAir {
        // Later versions hide other effects for a seed: in air the rig has its imperfections only.
        let mut config = RigConfig::default();
        config.simulation.depth_mm = 0.0;
        config.simulation.imperfections = Imperfections::of_seed(seed, air::START);
        let files = [rig_file.as_path(), &in_air, &characterized];
        air::characterized(xtask, seed, config, files, show)?;
        fs::write(&rig_file, format!("{plain}characterized = \"{CHARACTERIZED}\"\n"))?;
    }
    Ok((session, rig_file))
}
