//! The last part of the demonstration: the firmware's guide 2 steers a needle to a target, both drawn from the seed.

use super::{Typist, path};
use crate::bench::Bench;
use crate::images;
use crate::needle;
use crate::qemu::HANGS;
use anyhow::{Context, Result, ensure};
use serde_json::Value;
use simulation::rig::config::RigConfig;
use std::fs;
use std::path::Path;
use steering::{Options, steer};

/// Depth of the target, mm.
pub const DEPTH_MM: f64 = 100.0;
/// Rig seconds per second: as fast as the machine can. The controller's time is that of the needle.
const SPEED: f64 = 50.0;

/// What came of it.
#[derive(Debug, Clone, PartialEq)]
pub struct Steered {
    /// `guide steer --json`.
    pub run: Value,
    /// Miss of the same needle where guide 2 is not moved, mm.
    pub unsteered_mm: f64,
}

impl Steered {
    /// Miss of the steered needle, mm.
    ///
    /// # Errors
    /// Where the document has none.
    pub fn miss_mm(&self) -> Result<f64> {
        self.run.pointer("/run/miss_mm").and_then(Value::as_f64).context("guide steer printed no miss")
    }

    /// What came of it, in words.
    ///
    /// # Errors
    /// Where the document has no miss.
    pub fn summary(&self, seed: u64) -> Result<String> {
        Ok(format!(
            "target and needle drawn from seed {seed}: {:.2} mm from the target; {:.2} mm where the same needle is not steered",
            self.miss_mm()?,
            self.unsteered_mm
        ))
    }
}

/// Homes, tares and steers with the program `guide` on the firmware; the needle is one that shares no computation with the controller's
/// model.
///
/// # Errors
/// Where a command fails.
pub fn steered(xtask: &Path, seed: u64, out: &Path, show: &mut dyn FnMut(&str)) -> Result<Steered> {
    let folder = out.join("steered");
    if folder.exists() {
        fs::remove_dir_all(&folder).with_context(|| format!("cannot clear {}", folder.display()))?;
    }
    fs::create_dir_all(out).with_context(|| format!("cannot make {}", out.display()))?;
    let target_mm @ [x_mm, y_mm, depth_mm] =
        needle::target_mm(seed, DEPTH_MM)?.map(|mm| (1e2 * mm).round() / 1e2);
    let unsteered = Options { steered: false, ..Options::new(target_mm) };
    let unsteered_mm = steer(&mut needle::drawn(seed), &unsteered, &mut |_| {})?
        .miss_mm
        .context("a needle without truth")?;

    let bench = Bench::start(RigConfig::default(), seed, SPEED, HANGS)?;
    let port = bench.port();
    let mut guide = Typist { program: images::build_guide()?, show };
    guide.output(&["home", "--port", &port])?;
    guide.output(&["tare", "--port", &port])?;
    let tip = needle::command(xtask, &bench.rig().needle(), seed);
    let target = format!("--target-mm={x_mm},{y_mm},{depth_mm}");
    let folder = path(&folder)?;
    guide.shown(&["steer", folder, "--port", &port, &target, "--tip", &tip])?;
    bench.stop()?;
    let record = format!("{folder}/steer.jsonl");
    let run: Value = serde_json::from_str(&guide.output(&["steer", "--replay", &record, "--json"])?)
        .context("guide steer --json printed no JSON")?;
    let steered = Steered { run, unsteered_mm };
    ensure!(steered.run["replayed"] == true, "the replay is none");
    Ok(steered)
}
