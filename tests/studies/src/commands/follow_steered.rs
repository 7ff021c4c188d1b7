//! `cargo xtask study follow --only steer`: the same for needles that are steered, whose force and tip are compared with what the controller expects of them.
//!
//! Plants are those of `study steer`, of another method than the controller's model. A fault begins at a depth on the way.

use super::follow::{delay_text, quantile, sorted};
use anyhow::{Result, ensure};
use inference::follow::{Comparer, Parted, ReadingDifference};
use steering::{Answer, Command, ComparedChannel, End, Event, Options, Plant, PlantError, Statement, steer};
use worlds::on_all_cores;
use worlds::steering::{Kind, SimulatedPlant, reachable_target, world};

const DEPTH_MM: f64 = 100.0;
/// Depth at which faults begin.
const FAULTY_MM: f64 = 42.0;

/// Fault from a depth on.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Fault {
    None,
    /// Force added, N.
    Jump(f64),
    /// Force that grows, N/s.
    Drift(f64),
    /// Share of the force that is lost.
    Slip(f64),
    /// Tip reading displaced, mm.
    Shift(f64),
    /// Tip reading that drifts, mm/s.
    Wander(f64),
}

impl Fault {
    const ALL: [Self; 13] = [
        Self::None,
        Self::Jump(0.2),
        Self::Jump(0.5),
        Self::Jump(1.0),
        Self::Drift(0.02),
        Self::Drift(0.1),
        Self::Slip(0.5),
        Self::Slip(1.0),
        Self::Shift(0.5),
        Self::Shift(1.0),
        Self::Shift(2.0),
        Self::Wander(0.05),
        Self::Wander(0.2),
    ];

    fn words(self) -> String {
        match self {
            Self::None => String::new(),
            Self::Jump(n) => format!("force that jumps | {n} N"),
            Self::Drift(n_per_s) => format!("cell that drifts | {:.0} mN/s", 1e3 * n_per_s),
            Self::Slip(share) => {
                format!("needle that slips in its guide | {:.0} % of the force lost", 1e2 * share)
            }
            Self::Shift(mm) => format!("tracker that is pushed | {mm} mm"),
            Self::Wander(mm_per_s) => format!("tracker that drifts | {mm_per_s} mm/s"),
        }
    }

    /// Changes an answer so long after the fault has begun, s.
    fn change(self, answer: &mut Answer, since_s: f64) {
        let mut force = |change: &dyn Fn(f64) -> f64| {
            answer.force_x_n = answer.force_x_n.map(change);
            answer.force_y_n = answer.force_y_n.map(change);
        };
        match self {
            Self::None => {}
            Self::Jump(n) => force(&|force_n| force_n + n),
            Self::Drift(n_per_s) => force(&|force_n| force_n + n_per_s * since_s),
            Self::Slip(share) => force(&|force_n| (1.0 - share) * force_n),
            Self::Shift(mm) => answer.tip_x_mm += mm,
            Self::Wander(mm_per_s) => answer.tip_x_mm += mm_per_s * since_s,
        }
    }
}

/// A plant with a fault.
struct Faulty {
    plant: SimulatedPlant,
    fault: Fault,
    began_s: Option<f64>,
    ended_s: f64,
}

impl Plant for Faulty {
    fn start(&mut self) -> Result<Statement, PlantError> {
        self.plant.start()
    }

    fn step(&mut self, command: &Command) -> Result<Answer, PlantError> {
        let mut answer = self.plant.step(command)?;
        self.ended_s = answer.t_s;
        if answer.depth_mm > FAULTY_MM {
            let began_s = *self.began_s.get_or_insert(answer.t_s);
            let duration_s = answer.t_s - began_s;
            self.fault.change(&mut answer, duration_s);
        }
        Ok(answer)
    }

    fn end(&mut self) -> Result<End, PlantError> {
        self.plant.end()
    }
}

/// Result of a run: its duration, when the fault began, and what was found.
struct Followed {
    duration_s: f64,
    began_s: f64,
    parted: Vec<Parted>,
}

fn followed(number: u64, seed: u64, fault: Fault) -> Result<Followed> {
    let plant = world(Kind::Plain, seed, number);
    let target = reachable_target(&plant, DEPTH_MM, seed, number)?;
    let mut comparers = [Comparer::of_force(), Comparer::of_force(), Comparer::of_tip()];
    let mut plant = Faulty { plant, fault, began_s: None, ended_s: 0.0 };
    let mut parted = Vec::new();
    // A run that its supervisor stops is followed until there.
    let _ = steer(&mut plant, &Options::new(target), &mut |event| {
        let Event::Compared(comparison) = event else { return };
        let comparer = match comparison.channel {
            ComparedChannel::Force => &mut comparers[0],
            ComparedChannel::ForceFromStop => &mut comparers[1],
            ComparedChannel::Tip => &mut comparers[2],
        };
        parted.extend(comparer.push(ReadingDifference {
            time_s: comparison.t_s,
            displacement_mm: comparison.guide_mm,
            depth_mm: comparison.depth_mm,
            difference: comparison.difference,
            possible: comparison.possible,
            noise: comparison.noise,
        }));
    });
    let began_s = plant.began_s.unwrap_or(f64::INFINITY);
    Ok(Followed { duration_s: plant.ended_s, began_s, parted })
}

/// Runs the study.
///
/// # Errors
/// Where a plant cannot be steered.
pub fn run(runs: usize, seed: u64, verbose: bool) -> Result<()> {
    ensure!(runs > 0, "--sessions 0: expected 1 or more");
    for fault in Fault::ALL {
        let results = on_all_cores(runs, |number| followed(number as u64, seed, fault));
        let results = results.into_iter().collect::<Result<Vec<_>>>()?;
        if fault == Fault::None {
            let hours = results.iter().map(|one| one.duration_s).sum::<f64>() / 3600.0;
            let alarms: Vec<&Parted> = results.iter().flat_map(|one| &one.parted).collect();
            if verbose {
                for alarm in &alarms {
                    eprintln!("{}", alarm.sentence(format_args!("{:.1} s", alarm.since_s)));
                }
            }
            println!("Without a fault: {} false alarms in {hours:.1} h of {runs} runs.\n", alarms.len());
            println!(
                "| fault | size | found | within 2 s | delay, median, s | delay, 95 %, s |\n|---|---|---|---|---|---|"
            );
            continue;
        }
        // Runs with a false alarm before the fault are left out.
        let without_false_alarm =
            results.iter().filter(|one| one.parted.iter().all(|parted| parted.found_s >= one.began_s));
        let delays = sorted(
            without_false_alarm
                .map(|one| one.parted.first().map_or(f64::INFINITY, |parted| parted.found_s - one.began_s)),
        );
        println!(
            "| {} | {} of {} | {} | {} | {} |",
            fault.words(),
            delays.iter().filter(|delay_s| delay_s.is_finite()).count(),
            delays.len(),
            delays.iter().filter(|delay_s| **delay_s <= 2.0).count(),
            delay_text(quantile(&delays, 0.5)),
            delay_text(quantile(&delays, 0.95)),
        );
    }
    Ok(())
}
