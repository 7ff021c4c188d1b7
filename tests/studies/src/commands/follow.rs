//! `cargo xtask study follow`: hidden faults that begin while a rig is measured, and how soon the comparison with its model says so.
//!
//! An ordinary laboratory, its imperfections with it, measures plain tissue. The first runs of a session give the model, as `guide identify`
//! has it; the last ones are followed as `guide acquire --follow` follows them, by the same code, without a fault for the
//! false alarms, and with a fault that begins while guide 2 is displaced. The sessions' generator shares nothing with the forward model.

use anyhow::{Context, Result, ensure};
use formats::model_file::ModelFile;
use formats::session::LateralRun as Run;
use inference::follow::{FALSE_ALARMS_PER_HOUR, Follower, GuideReading, Parted};
use inference::identify::{self, identify};
use mechanics::effects::effect;
use mechanics::{Model, Rig, Support};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::collections::BTreeMap;
use worlds::{Background, Design, LateralPlan, Truth, on_all_cores, session_on};

const MM: f64 = 1e-3;
/// Depth of the runs that are followed, their number in a laboratory, levels and holds.
const DEPTH_MM: f64 = 30.0;
const FOLLOWED: usize = 4;
const LEVELS_MM: [f64; 9] = [0.0, 0.6, 1.2, 0.6, 0.0, -0.6, -1.2, -0.6, 0.0];
const HOLD_S: f64 = 20.0;
/// Time in the hold at the largest displacement at which faults begin.
const BEGINS_S: [f64; 2] = [2.0, 10.0];
/// Displacement of that hold.
const HELD_M: f64 = 1.2e-3;
/// Goal: a fault of five standard deviations of a step, beyond what the model may be off.
const GOAL_SD: f64 = 5.0;
/// Time within which it is to be found.
const GOAL_S: f64 = 2.0;

/// A fault that begins at a time.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Fault {
    /// Force added, N.
    Jump(f64),
    /// The same, in standard deviations beyond what the model may be off.
    Sigma(f64),
    /// Force that grows, N/s.
    Drift(f64),
    /// Needle that slips through guide 2: share of its deflection.
    Slip(f64),
    /// Nut of guide 2 that comes loose: play, m.
    Loose(f64),
    /// Clamp of guide 1 that comes loose: compliance, rad/(N m).
    Clamp(f64),
    /// Needle that is drawn back, m.
    Back(f64),
    /// Tissue that tears: share of its modulus.
    Tear(f64),
    /// Gain of the force that changes: share.
    Gain(f64),
}

impl Fault {
    /// Those of the table.
    const ALL: [Self; 23] = [
        Self::Sigma(GOAL_SD),
        Self::Sigma(2.0 * GOAL_SD),
        Self::Jump(0.1),
        Self::Jump(0.2),
        Self::Jump(0.4),
        Self::Drift(0.002),
        Self::Drift(0.01),
        Self::Drift(0.05),
        Self::Slip(0.1),
        Self::Slip(0.25),
        Self::Slip(0.5),
        Self::Loose(0.1 * MM),
        Self::Loose(0.3 * MM),
        Self::Clamp(1.0),
        Self::Clamp(5.0),
        Self::Clamp(20.0),
        Self::Back(2.0 * MM),
        Self::Back(5.0 * MM),
        Self::Back(10.0 * MM),
        Self::Tear(0.2),
        Self::Tear(0.5),
        Self::Gain(0.1),
        Self::Gain(0.3),
    ];

    fn name(self) -> &'static str {
        match self {
            Self::Jump(_) | Self::Sigma(_) => "force that jumps",
            Self::Drift(_) => "cell that drifts",
            Self::Slip(_) => "needle that slips through guide 2",
            Self::Loose(_) => "guide 2 that comes loose",
            Self::Clamp(_) => "clamp of guide 1 that comes loose",
            Self::Back(_) => "needle that is drawn back",
            Self::Tear(_) => "tissue that tears",
            Self::Gain(_) => "gain of the force that changes",
        }
    }

    fn size(self) -> String {
        match self {
            Self::Jump(n) => format!("{n} N"),
            Self::Sigma(sd) => format!("{sd:.0} sigma beyond what the model may be off"),
            Self::Drift(n_per_s) => format!("{:.0} mN/s", 1e3 * n_per_s),
            Self::Slip(share) => format!("by {:.0} % of its deflection", 1e2 * share),
            Self::Loose(m) => format!("play of {:.1} mm", m / MM),
            Self::Clamp(compliance) => format!("{compliance} rad/(N m)"),
            Self::Back(m) => format!("by {:.0} mm", m / MM),
            Self::Tear(share) => format!("{:.0} % of its modulus lost", 1e2 * share),
            Self::Gain(share) => format!("by {:.0} %", 1e2 * share),
        }
    }
}

/// A laboratory with what was learned of it.
struct Laboratory {
    rig: Rig,
    model: ModelFile,
    modulus_pa: f64,
    runs: Vec<Vec<GuideReading>>,
}

impl Laboratory {
    fn drawn(seed: u64) -> Result<Self> {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let k_kpa = 8.0 * 4.0f64.powf(random.random::<f64>());
        let truth = Truth { k_kpa, tip_load_n: 0.0, effects: Vec::new(), foreign: None };
        let learning = Design::four_runs();
        let background = Background::drawn(&truth, &learning, random.random());
        let followed = (0..FOLLOWED).map(|number| LateralPlan {
            id: format!("followed{number}"),
            depth_mm: DEPTH_MM,
            axis: number % 2,
            levels_mm: LEVELS_MM.to_vec(),
            hold_s: HOLD_S,
            ramp_mm_per_s: 1.0,
        });
        let first = learning.lateral.len();
        let lateral = learning.lateral.iter().cloned().chain(followed).collect();
        let design = Design { lateral, ..learning };
        let mut session = session_on(&truth, &background, &design, random.random());
        let runs = session.lateral.split_off(first);
        let identification = identify(&session, &identify::Options::default())?;
        let modulus_pa = 1e3 * identification.pooled.k_kpa;
        let model = ModelFile {
            modulus_pa: Some(modulus_pa),
            modulus_ci95_pa: Some(identification.pooled.ci95_kpa.map(|kpa| 1e3 * kpa)),
            ..ModelFile::default()
        };
        let runs = runs.iter().map(readings_of).collect();
        Ok(Self { rig: session.rig, model, modulus_pa, runs })
    }

    fn follower(&self) -> Result<Follower> {
        Follower::new(&self.model, &self.rig, MM * DEPTH_MM).context("a model to follow")
    }

    /// Force per displacement of guide 2, N/m, of the rig with a fault.
    fn stiffness_n_per_m(&self, fault: Option<Fault>) -> Result<f64> {
        let (modulus_pa, depth_m) = match fault {
            Some(Fault::Tear(share)) => ((1.0 - share) * self.modulus_pa, MM * DEPTH_MM),
            Some(Fault::Back(m)) => (self.modulus_pa, MM * DEPTH_MM - m),
            _ => (self.modulus_pa, MM * DEPTH_MM),
        };
        let mut model = Model::on(self.rig.clone(), Support::Springs, modulus_pa)?;
        if let (Some(Fault::Clamp(compliance)), Some(clamp)) = (fault, effect("rig.clamp_compliance")) {
            model.effects = vec![(clamp, vec![compliance])];
        }
        Ok(model.beam(depth_m)?.lateral_stiffness_n_per_m())
    }
}

/// Readings of a run, along the device's axes.
fn readings_of(run: &Run) -> Vec<GuideReading> {
    let series = &run.force;
    let count = series.time_s.len();
    let [x_m, x_n] = [&series.displacement_x_m, &series.force_x_n]
        .map(|along_x| along_x.clone().unwrap_or_else(|| vec![0.0; count]));
    (0..count)
        .map(|i| GuideReading {
            time_s: series.time_s[i],
            displacement_m: [x_m[i], series.displacement_y_m[i]],
            force_n: [x_n[i], series.force_y_n[i]],
            repeats_force: false,
        })
        .collect()
}

/// Result of a fault in a run.
#[derive(Debug, Clone, Copy)]
struct Outcome {
    /// Change of the force when it begins, N; of a drift, a second later.
    change_n: f64,
    /// Time until it was found, s.
    delay_s: Option<f64>,
    sigma: f64,
}

/// Everything of a laboratory.
struct Followed {
    hours: f64,
    false_alarms: Vec<Parted>,
    /// By the number of the fault.
    outcomes: Vec<(usize, Outcome)>,
}

fn followed(laboratory: &Laboratory, seed: u64) -> Result<Followed> {
    let mut random = ChaCha8Rng::seed_from_u64(!seed);
    let mut followed = Followed { hours: 0.0, false_alarms: Vec::new(), outcomes: Vec::new() };
    for (number, run) in laboratory.runs.iter().enumerate() {
        let mut follower = laboratory.follower()?;
        followed.false_alarms.extend(follower.push(run));
        ensure!(follower.is_following(), "a run of which nothing is compared");
        followed.hours += (run[run.len() - 1].time_s - run[0].time_s) / 3600.0;
        // A fault adds force along the axis that is moved; x is the first of the device.
        let axis = if number % 2 == 0 { 1 } else { 0 };
        let is_held = |reading: &GuideReading| reading.displacement_m[axis] > 0.98 * HELD_M;
        let hold_s = run.iter().find(|reading| is_held(reading)).context("a hold")?.time_s;
        let begins_s = hold_s + random.random_range(BEGINS_S[0]..BEGINS_S[1]);
        for (place, fault) in Fault::ALL.into_iter().enumerate() {
            if let Some(outcome) = with_fault(laboratory, run, axis, fault, begins_s)? {
                followed.outcomes.push((place, outcome));
            }
        }
    }
    Ok(followed)
}

/// Follows a run with a fault until it is found; nothing where something was found before.
fn with_fault(
    laboratory: &Laboratory,
    run: &[GuideReading],
    axis: usize,
    fault: Fault,
    begins_s: f64,
) -> Result<Option<Outcome>> {
    let mut follower = laboratory.follower()?;
    let sound = laboratory.stiffness_n_per_m(None)?;
    let faulty = laboratory.stiffness_n_per_m(Some(fault))?;
    let start = run.partition_point(|reading| reading.time_s < begins_s);
    if !follower.push(&run[..start]).is_empty() {
        return Ok(None);
    }
    let discernible = follower.discernible()[axis].context("a comparison")?;
    let change_n = |reading: &GuideReading| {
        let displacement_m = reading.displacement_m[axis];
        let whole_n = -sound * displacement_m;
        match fault {
            Fault::Jump(n) => n,
            Fault::Sigma(sd) => discernible.possible_n + sd * discernible.noise_n,
            Fault::Drift(n_per_s) => n_per_s * (reading.time_s - begins_s),
            Fault::Slip(share) => share * whole_n,
            Fault::Loose(play_m) => -sound * displacement_m.clamp(-play_m, play_m),
            Fault::Gain(share) => -share * whole_n,
            Fault::Clamp(_) | Fault::Back(_) | Fault::Tear(_) => (1.0 - faulty / sound) * whole_n,
        }
    };
    let first = match fault {
        Fault::Drift(n_per_s) => n_per_s,
        _ => run.get(start).map_or(0.0, change_n),
    };
    for reading in &run[start..] {
        let mut changed = *reading;
        changed.force_n[axis] += change_n(reading);
        let departures = follower.push(&[changed]);
        if let Some(parted) = departures.first() {
            let delay_s = Some(parted.found_s - begins_s);
            return Ok(Some(Outcome { change_n: first, delay_s, sigma: parted.sigma.abs() }));
        }
    }
    Ok(Some(Outcome { change_n: first, delay_s: None, sigma: f64::NAN }))
}

/// Runs the study.
///
/// # Errors
/// Where a session cannot be identified.
pub fn run(laboratories: usize, seed: u64, only: &str, verbose: bool) -> Result<()> {
    if only == "steer" {
        return super::follow_steered::run(laboratories, seed, verbose);
    }
    ensure!(laboratories > 0, "--sessions 0: expected 1 or more");
    let sessions = on_all_cores(laboratories, |number| {
        let seed = seed.wrapping_mul(1_000_003).wrapping_add(number as u64);
        followed(&Laboratory::drawn(seed)?, seed)
    });
    let sessions = sessions.into_iter().collect::<Result<Vec<_>>>()?;
    let hours: f64 = sessions.iter().map(|one| one.hours).sum();
    let alarms: Vec<&Parted> = sessions.iter().flat_map(|one| &one.false_alarms).collect();
    if verbose {
        alarms
            .iter()
            .for_each(|parted| eprintln!("{}", parted.sentence(format_args!("{:.1} s", parted.since_s))));
    }
    println!(
        "Without a fault: {} false alarms in {hours:.1} h of {} runs; at most {FALSE_ALARMS_PER_HOUR} an hour in the mean are stated.\n",
        alarms.len(),
        laboratories * FOLLOWED
    );
    println!(
        "| fault | size | change of the force, N | found | within {GOAL_S:.0} s | delay, median, s | delay, 95 %, s | sigma, median |\n|---|---|---|---|---|---|---|---|"
    );
    let mut by_fault: BTreeMap<usize, Vec<Outcome>> = BTreeMap::new();
    for (place, outcome) in sessions.iter().flat_map(|one| &one.outcomes) {
        by_fault.entry(*place).or_default().push(*outcome);
    }
    for (place, outcomes) in &by_fault {
        let fault = Fault::ALL[*place];
        let count = outcomes.len();
        let delays = sorted(outcomes.iter().map(|one| one.delay_s.unwrap_or(f64::INFINITY)));
        let quick_count = delays.iter().filter(|delay_s| **delay_s <= GOAL_S).count();
        println!(
            "| {} | {} | {:.2} | {} of {count} | {quick_count} | {} | {} | {:.0} |",
            fault.name(),
            fault.size(),
            quantile(&sorted(outcomes.iter().map(|one| one.change_n.abs())), 0.5),
            outcomes.iter().filter(|one| one.delay_s.is_some()).count(),
            delay_text(quantile(&delays, 0.5)),
            delay_text(quantile(&delays, 0.95)),
            quantile(&sorted(outcomes.iter().map(|one| one.sigma).filter(|sigma| sigma.is_finite())), 0.5),
        );
    }
    Ok(())
}

pub(super) fn delay_text(delay_s: f64) -> String {
    if delay_s.is_finite() { format!("{delay_s:.1}") } else { "not found".to_owned() }
}

pub(super) fn sorted(values: impl Iterator<Item = f64>) -> Vec<f64> {
    let mut values: Vec<f64> = values.collect();
    values.sort_by(f64::total_cmp);
    values
}

pub(super) fn quantile(sorted: &[f64], share: f64) -> f64 {
    let rank = (share * sorted.len() as f64) as usize;
    sorted.get(rank.min(sorted.len().saturating_sub(1))).copied().unwrap_or(f64::NAN)
}
