//! A rig in air that the device itself characterises (`guide characterize --port`): before the rig of the demonstration hides anything,
//! and `cargo xtask study demo --part air`, how often the intervals hold the truth.

use super::{SPEED, Typist, path, sweep_command};
use crate::bench::Bench;
use crate::cosim::Appointment;
use crate::images;
use crate::qemu::HANGS;
use anyhow::{Context, Result};
use device::air::{Axis, Timetable, reach_mm, run_program, tare_program};
use device::link::Program;
use mechanics::Model;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde_json::Value;
use simulation::rig::config::{HiddenEffect, RigConfig};
use simulation::rig::imperfections::Imperfections;
use std::collections::BTreeMap;
use std::path::Path;

/// When home and the first tare start, seconds of the device's clock.
const HOME_AT_S: u32 = 4;
const AIR_AT_S: u32 = 10;
/// Start of the rig whose imperfections the runs in air have: none of the starts of the sessions in tissue.
pub(super) const START: u64 = 100;

/// Lets the device make its runs in air, one of each axis, and characterises them.
///
/// # Errors
/// Where a command fails.
pub(super) fn characterized(
    xtask: &Path,
    seed: u64,
    config: RigConfig,
    [rig_file, session, out]: [&Path; 3],
    show: &mut dyn FnMut(&str),
) -> Result<Value> {
    let stiffness_n_per_m = Model::uniform(config.rig.clone(), 1e3)?.beam(0.0)?.lateral_stiffness_n_per_m();
    let program = images::build_guide()?;
    let bench = Bench::start(config, seed, SPEED, HANGS)?;
    bench.rig().expect(std::iter::once(Appointment::at_s(HOME_AT_S)).chain(appointments(stiffness_n_per_m)?));
    let (port, sweep) = (bench.port(), sweep_command(xtask, &bench));
    let mut guide = Typist { program, show };
    guide.output(&["home", "--port", &port, "--at-s", &HOME_AT_S.to_string()])?;
    let time_text = AIR_AT_S.to_string();
    let device =
        ["characterize", "--port", &port, "--at-s", &time_text, "--runs", "1", "--rig", path(rig_file)?];
    let files = ["--session", path(session)?, "--out", path(out)?, "--sweep-command", &sweep];
    guide.echo(&[&device[..], &files].concat());
    let printed = guide.output(&[&device[..], &files, &["--json"]].concat())?;
    bench.stop()?;
    serde_json::from_str(&printed).context("guide characterize --json printed no JSON")
}

/// The starts of the runs, as the command computes them.
fn appointments(stiffness_n_per_m: f64) -> Result<Vec<Appointment>> {
    let mut timetable = Timetable::new(Some(f64::from(AIR_AT_S)));
    let mut bench_runs = Vec::new();
    for axis in [Axis::Y, Axis::X] {
        for program in
            [program_of(tare_program())?, program_of(run_program(axis, reach_mm(stiffness_n_per_m)))?]
        {
            let start_s = timetable.start_s(&program).context("runs in air without a start")?;
            let sweeps =
                (0..).zip(&program.steps).filter(|(_, planned)| planned.sweep).map(|(index, _)| index);
            bench_runs.push(Appointment::at_s(start_s as u32).with_sweeps(sweeps.collect()));
        }
    }
    Ok(bench_runs)
}

fn program_of(program: Result<Program, &'static str>) -> Result<Program> {
    program.map_err(|problem| anyhow::anyhow!(problem))
}

/// Ranges from which a rig's effects are drawn, each of them with a probability of a half.
const DRAWN: [(&str, [f64; 2]); 2] = [("rig.backlash", [0.04, 0.2]), ("rig.clamp_compliance", [0.2, 0.8])];

/// A parameter that is identified: its error, its standard deviation, and whether its interval holds the truth.
struct Estimate {
    error: f64,
    sd: f64,
    held: bool,
}

/// Coverage of the intervals of rigs in air over seeds: one line each and a table.
///
/// # Errors
/// Where a command fails.
pub(super) fn study(xtask: &Path, seeds: std::ops::Range<u64>, folder: &Path) -> Result<()> {
    let mut rows: BTreeMap<String, Vec<Estimate>> = BTreeMap::new();
    for seed in seeds {
        let effects = drawn(seed);
        let mut config = RigConfig::default();
        config.simulation.depth_mm = 0.0;
        config.simulation.effects = effects.clone();
        config.simulation.imperfections = Imperfections::of_seed(seed, START);
        let rig_file = seed_folder("rig.toml", seed, folder);
        std::fs::write(&rig_file, super::rig_toml(&config.rig))?;
        let characterized_rig = characterized(
            xtask,
            seed,
            config,
            [&rig_file, &seed_folder("air", seed, folder), &seed_folder("out.toml", seed, folder)],
            &mut |_| {},
        )?;
        println!("{}", line(seed, &effects, &characterized_rig));
        for one in characterized_rig["parameters"].as_array().into_iter().flatten() {
            if let Some((name, estimate)) = estimate(one, &effects) {
                rows.entry(name).or_default().push(estimate);
            }
        }
    }
    println!("| parameter | identified | covered | RMS error | mean sd |\n|---|---|---|---|---|");
    for (name, all) in &rows {
        let count = all.len() as f64;
        println!(
            "| {name} | {} | {} | {:.5} | {:.5} |",
            all.len(),
            all.iter().filter(|one| one.held).count(),
            mean(&|one| one.error * one.error, count, all).sqrt(),
            mean(&|one| one.sd, count, all)
        );
    }
    Ok(())
}

fn mean(of: &dyn Fn(&Estimate) -> f64, count: f64, all: &[Estimate]) -> f64 {
    all.iter().map(of).sum::<f64>() / count
}

fn seed_folder(name: &str, seed: u64, folder: &Path) -> std::path::PathBuf {
    folder.join(format!("{seed}-{name}"))
}

/// Hidden effects of a rig.
fn drawn(seed: u64) -> Vec<HiddenEffect> {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let mut effects = Vec::new();
    for (id, [low, high]) in DRAWN {
        let (strength, is_there): (f64, f64) = (random.random(), random.random());
        if is_there < 0.5 {
            effects.push(HiddenEffect { id: id.to_owned(), values: vec![low + strength * (high - low)] });
        }
    }
    effects
}

fn truth_of(effects: &[HiddenEffect], id: &str) -> f64 {
    effects
        .iter()
        .find(|effect| effect.id == id)
        .and_then(|effect| effect.values.first())
        .copied()
        .unwrap_or(0.0)
}

/// The effects that a rig can have here are compared; everything else of it is as designed. The force's zero drifts by the rig's imperfections.
fn estimate(one: &Value, effects: &[HiddenEffect]) -> Option<(String, Estimate)> {
    let id = one["effect"].as_str()?;
    let (low, high, value, sd) =
        (interval_end(0, one)?, interval_end(1, one)?, one["value"].as_f64()?, one["sd"].as_f64()?);
    if one["standing"] != "identified" || matches!(id, "sensor.force_drift" | "sensor.shape_offset") {
        return None;
    }
    let truth = truth_of(effects, id);
    let estimate = Estimate { error: value - truth, sd, held: (low..=high).contains(&truth) };
    Some((format!("{id} {}", one["parameter"].as_str()?), estimate))
}

fn interval_end(end: usize, one: &Value) -> Option<f64> {
    one["ci95"][end].as_f64()
}

fn line(seed: u64, effects: &[HiddenEffect], found: &Value) -> String {
    let missed = found["parameters"].as_array().into_iter().flatten().filter_map(|one| {
        let (name, estimate) = estimate(one, effects)?;
        let sds = estimate.error / estimate.sd;
        (!estimate.held).then(|| format!("{name} {} {sds:+.1} sd off", one["value"]))
    });
    let has = effects.iter().map(|effect| format!("{} {:.4}", effect.id, effect.values[0]));
    let (has, missed): (Vec<_>, Vec<_>) = (has.collect(), missed.collect());
    format!(
        "seed {seed}: has [{}]; outside their intervals [{}]; chi-square per reading {:.2}",
        has.join(", "),
        missed.join("; "),
        found["chi_square_per_reading"].as_f64().unwrap_or(f64::NAN)
    )
}
