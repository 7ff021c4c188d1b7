//! The online estimator on the target: the firmware's core, in single precision, over a simulated run in QEMU, against the
//! host's in double precision.

use crate::images::{self, Image};
use crate::qemu::{HANGS, Qemu, turn};
use anyhow::{Context, Result, ensure};
use estimator::{Estimate, Settings};
use formats::session::SteeringRun;
use inference::track::method::samples;
use inference::track::online::{MODES, OnlineTracker, settings};
use mechanics::{Dynamics, Needle, Rig};
use simulation::rig::steering::{Inclusion, Plan, Sensors, SteeringRig, Tissue, TissueLayer};
use std::fmt::{self, Display};
use std::fs;
use std::path::Path;

/// The run takes a few seconds in QEMU. Largest difference between target and host: stiffness as a share
/// of its interval's half-width, tip in m.
const STIFFNESS_SHARE: f64 = 0.25;
const TIP_M: f64 = 0.05e-3;
/// Instructions that one period of the controller has: a millisecond at 80 MHz, one and a half cycles each.
const BUDGET: u64 = 80_000 * 2 / 3;
const LENGTH_M: f64 = 0.13;
const FIXTURE_KG: f64 = 0.3;

/// Output of the target.
#[derive(Debug, Clone, PartialEq)]
pub struct Tracked {
    /// Estimates.
    pub rows: usize,
    /// Updates.
    pub updates: u64,
    /// Instructions of an update on average.
    pub mean_instructions: u64,
    /// Instructions of the longest update.
    pub most_instructions: u64,
    /// RAM of the estimator.
    pub bytes: u64,
    /// Largest difference to the host: stiffness, as a share of the half-width of its interval; tip, m.
    pub largest: [f64; 2],
}

impl Display for Tracked {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { rows, updates, mean_instructions, most_instructions, bytes, largest: [stiffness, tip_m] } =
            self;
        writeln!(f, "{updates} updates, {rows} rows, single precision against the host's double:")?;
        writeln!(
            f,
            "  stiffness within {stiffness:.3} of the half-width of its interval, simulated tip within {:.4} mm",
            1e3 * tip_m
        )?;
        write!(
            f,
            "  {mean_instructions} instructions per update on average, {most_instructions} at most (a period of 1 ms at 80 MHz has about {BUDGET}), {bytes} bytes of RAM"
        )
    }
}

/// Runs the estimator in QEMU and compares.
///
/// # Errors
/// Where it cannot be run, differs from the host, or takes longer than a period of the controller has.
pub fn run() -> Result<Tracked> {
    let elf = images::build(Image::Tracking)?;
    let folder = tempfile::tempdir()?;
    let needle = Needle::gauge_18();
    let dynamics = Dynamics::steel(&needle, LENGTH_M, FIXTURE_KG);
    let settings = settings::<f64>(&needle, &dynamics)?;
    let run = recorded()?;
    write(folder.path(), &settings, &run)?;
    let qemu = Qemu::start(turn(), &elf, folder.path(), HANGS)?;
    let (code, log) = qemu.wait(HANGS)?;
    ensure!(code == 0, "the estimator's image ended with {code}: {log:#?}");
    let mut tracker = OnlineTracker::new(settings).context("the layout does not fit")?;
    let host: Vec<Estimate<f64>> =
        samples(&run).filter_map(|sample| tracker.update(&sample).ok().flatten()).collect();
    let tracked = compare(&host, &log)?;
    let [stiffness, tip_m] = tracked.largest;
    ensure!(
        stiffness < STIFFNESS_SHARE && tip_m < TIP_M,
        "the target is off from the host by more than {STIFFNESS_SHARE} and {} mm: {tracked}",
        1e3 * TIP_M
    );
    ensure!(
        tracked.most_instructions < BUDGET,
        "an update takes longer than a period of the controller has: {tracked}"
    );
    Ok(tracked)
}

/// Two layers and an inclusion at 4 mm/s with support.
fn recorded() -> Result<SteeringRun> {
    let tissue = Tissue {
        layers: vec![layer(40.0, 1.5e4, 1e3), layer(80.0, 4e4, 2e3)],
        inclusions: vec![Inclusion { depth_mm: 12.0, width_mm: 3.0, factor: 1.8 }],
    };
    let rig = Rig::two_guides(Needle::gauge_18(), 0.06, 0.07);
    let plan = Plan {
        id: "target".to_owned(),
        speed_mm_s: 4.0,
        depth_mm: 80.0,
        lateral_mm: 20.0,
        straight_mm: 20.0,
        wobble_mm: 0.0,
        wobble_hz: 0.5,
        period_ms: 20.0,
        disturbances: 1,
    };
    let sensors = Sensors { base_m: 2e-5, force_n: 0.05, tip_m: 2e-4 };
    Ok(SteeringRig::new(rig, LENGTH_M, FIXTURE_KG, &tissue)?.carry_out(&plan)?.measure(sensors, 1, 0))
}

fn layer(bottom_mm: f64, stiffness_n_per_m2: f64, damping_n_s_per_m2: f64) -> TissueLayer {
    TissueLayer { bottom_mm, stiffness_n_per_m2, damping_n_s_per_m2 }
}

/// The recording as the image reads it.
fn write(folder: &Path, settings: &Settings<f64, MODES>, run: &SteeringRun) -> Result<()> {
    let mut bytes = Vec::new();
    let mut put = |value: f64| bytes.extend((value as f32).to_le_bytes());
    put(settings.length_m);
    put(settings.moving_mass_kg);
    for mode in &settings.modes {
        put(mode.wave_number_per_m);
        put(mode.frequency_rad_s);
        mode.factors.iter().for_each(|factor| put(*factor));
    }
    for sample in samples(run) {
        [sample.time_s, sample.depth_m, sample.base_m, sample.force_n, sample.tip_m]
            .into_iter()
            .for_each(&mut put);
    }
    fs::write(folder.join("stream.bin"), bytes).context("cannot write the recording")
}

/// Reads the image's log.
fn compare(host: &[Estimate<f64>], log: &[String]) -> Result<Tracked> {
    let mut rows = 0;
    let mut largest = [0.0_f64; 2];
    for line in log.iter().filter_map(|line| line.split_once("estimate ")).map(|(_, numbers)| numbers) {
        let numbers: Vec<f64> = line.split_whitespace().map(str::parse).collect::<Result<_, _>>()?;
        let [_, stiffness, _, _, tip_m] = numbers[..] else { anyhow::bail!("not an estimate: {line}") };
        let expected = host.get(rows).context("the target has more rows than the host")?;
        let half = 0.5 * (expected.stiffness.high / expected.stiffness.low).ln();
        largest[0] = largest[0].max((stiffness / expected.stiffness.value).ln().abs() / half);
        largest[1] = largest[1].max((tip_m - expected.tip_m).abs());
        rows += 1;
    }
    ensure!(rows == host.len() && rows > 0, "{rows} rows on the target, {} on the host", host.len());
    let cost = log.iter().find_map(|line| line.split_once("cost ")).context("the image prints no cost")?.1;
    let numbers: Vec<u64> =
        cost.split(|c: char| !c.is_ascii_digit()).filter_map(|word| word.parse().ok()).collect();
    let [updates, mean_instructions, most_instructions, bytes] = numbers[..] else {
        anyhow::bail!("not a cost: {cost}")
    };
    Ok(Tracked { rows, updates, mean_instructions, most_instructions, bytes, largest })
}
