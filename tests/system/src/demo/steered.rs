//! The last part of the demonstration: the firmware's guide 2 steers a needle to a target, both drawn from the seed.

use super::{Typist, path};
use crate::bench::Bench;
use crate::images;
use crate::needle::{self, Drawn};
use crate::qemu::HANGS;
use anyhow::{Context, Result};
use serde_json::Value;
use simulation::rig::config::RigConfig;
use std::fs;
use std::path::Path;

/// Rig seconds per second: as fast as the machine can. The controller's time is that of the needle.
const SPEED: f64 = 50.0;

/// Result of the run.
#[derive(Debug, Clone, PartialEq)]
pub struct Steered {
    /// Miss of the steered needle, mm, or why the run was stopped.
    pub miss_mm: Result<f64, String>,
    /// Miss of the same needle where guide 2 is not moved, mm.
    pub unsteered_mm: f64,
}

impl Steered {
    /// Result in words.
    pub fn summary(&self, seed: u64) -> String {
        let steered = match &self.miss_mm {
            Ok(mm) => format!("{mm:.2} mm from the target"),
            Err(cause) => format!("the run did not arrive: {cause}"),
        };
        format!(
            "needle, tissue and target drawn from seed {seed}: {steered}; {:.2} mm where the same needle is not steered",
            self.unsteered_mm
        )
    }
}

/// Homes, tares and steers with the program `guide` on the firmware; the needle is one that shares no computation with the controller's
/// model. A run that the supervisor stops is a result.
///
/// # Errors
/// Where another command fails, or the record of a run that arrived does not replay.
pub fn steered(xtask: &Path, seed: u64, out: &Path, show: &mut dyn FnMut(&str)) -> Result<Steered> {
    let folder = out.join("steered");
    if folder.exists() {
        fs::remove_dir_all(&folder).with_context(|| format!("cannot clear {}", folder.display()))?;
    }
    fs::create_dir_all(out).with_context(|| format!("cannot make {}", out.display()))?;
    let Drawn { target_mm, unsteered_mm, .. } = needle::drawn(seed)?;
    let [x_mm, y_mm, depth_mm] = target_mm.map(|mm| (1e2 * mm).round() / 1e2);

    let bench = Bench::start(RigConfig::default(), seed, SPEED, HANGS)?;
    let port = bench.port();
    let mut guide = Typist { program: images::build_guide()?, show };
    guide.output(&["home", "--port", &port])?;
    guide.output(&["tare", "--port", &port])?;
    let tip = needle::command(xtask, &bench.rig().needle(), seed);
    let target = format!("--target-mm={x_mm},{y_mm},{depth_mm}");
    let folder = path(&folder)?;
    let ended = guide.shown(&["steer", folder, "--port", &port, &target, "--tip", &tip]);
    bench.stop()?;
    let miss_mm = match ended {
        Err(cause) => Err(cause.to_string()),
        Ok(()) => {
            let record = format!("{folder}/steer.jsonl");
            let run: Value = serde_json::from_str(&guide.output(&["steer", "--replay", &record, "--json"])?)
                .context("guide steer --json printed no JSON")?;
            let miss_mm = run.pointer("/run/miss_mm").and_then(Value::as_f64);
            Ok(miss_mm.context("guide steer printed no miss")?)
        }
    };
    Ok(Steered { miss_mm, unsteered_mm })
}
