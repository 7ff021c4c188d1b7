//! The needle's side of a rig in QEMU, as a program of its own: it pushes a needle of `worlds`, which shares no computation with the
//! forward model, into its tissue, and reads its tip. Guide 2 is that of the rig: the needle is where the firmware has moved it, and
//! loads the firmware's force sensor.

use crate::cosim::GuideSocket;
use anyhow::{Context, Result, bail};
use clap::ValueEnum;
use serde_json::Value;
use simulation::rig::NeedleLoad;
use std::io::{BufRead, Write};
use std::path::{Path, PathBuf};
use steering::{Answer, Command, Plant};
use worlds::steering::{Kind, SimulatedPlant, reachable_target, world};

/// Force limit of the firmware with which a run begins, N: the target is drawn for this.
const FORCE_N: f64 = 4.0;
/// Depth of the targets of the demonstration, mm.
pub const DEPTH_MM: f64 = 100.0;
/// Least miss of a seed's needle if guide 2 is not moved, mm: otherwise there is nothing to steer.
pub const UNSTEERED_MM: f64 = 1.0;
/// Largest number of needles that are drawn until one misses by so much.
const DRAWS: u64 = 100;
/// Displacement of guide 2 with which the growth of its force is measured, mm, and its duration, s.
const DIFFERENCE_MM: f64 = 0.05;
const DIFFERENCE_S: f64 = 0.05;

/// Failure of the tracker or the push from a depth on.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Failure {
    /// The tracker sends nothing.
    Silent,
    /// The tracker repeats its last reading.
    Frozen,
    /// The tracker jumps by 25 mm.
    Jumping,
    /// The tracker's readings arrive 3 s late.
    Late,
    /// The operator lets go of the needle, which slips back by 4 mm.
    LetGo,
}

/// Options of `cargo xtask needle`.
#[derive(clap::Args)]
pub struct Args {
    /// Socket on which the rig serves guide 2
    #[arg(long, value_name = "SOCKET")]
    socket: PathBuf,
    /// Seed of needle, tissue and sensor
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Failure of the run
    #[arg(long, value_name = "WHAT", requires = "beyond_mm")]
    fails: Option<Failure>,
    /// From this depth on, millimetres
    #[arg(long, value_name = "MM", requires = "fails")]
    beyond_mm: Option<f64>,
}

/// The command that pushes this needle for `guide steer --tip`.
pub fn command(xtask: &Path, socket: &Path, seed: u64) -> String {
    format!("'{}' needle --socket '{}' --seed {seed}", xtask.display(), socket.display())
}

/// Needle and tissue of a seed, with a target.
#[derive(Debug, Clone)]
pub struct Drawn {
    /// Plant that is steered.
    pub plant: SimulatedPlant,
    /// Number of the needle among those of the seed.
    pub number: u64,
    /// A target at [`DEPTH_MM`] that this needle reaches with some guide moves within limits: x, y, depth, mm.
    pub target_mm: [f64; 3],
    /// Distance at which the needle ends if guide 2 is not moved, mm.
    pub unsteered_mm: f64,
}

/// The first needle of a seed that misses its target by [`UNSTEERED_MM`] or more where guide 2 is not moved.
///
/// # Errors
/// None that a simulated needle has, and where no needle of the seed is such a one.
pub fn drawn(seed: u64) -> Result<Drawn> {
    for number in 0..DRAWS {
        let mut plant = world(Kind::Plain, seed, number);
        plant.stated.limits.guide_force_n = Some(FORCE_N);
        let target_mm @ [x_mm, y_mm, _] = reachable_target(&plant, DEPTH_MM, seed, number)?;
        let mut pushed = plant.clone();
        let mut command = Command { bevel_deg: plant.stated.bevel_deg, ..Command::default() };
        while command.depth_mm < DEPTH_MM {
            command = Command { t_s: command.t_s + 0.25, depth_mm: command.depth_mm + 1.0, ..command };
            pushed.step(&command)?;
        }
        let [tip_x_mm, tip_y_mm] = pushed.tip_mm();
        let unsteered_mm = (tip_x_mm - x_mm).hypot(tip_y_mm - y_mm);
        if unsteered_mm >= UNSTEERED_MM {
            return Ok(Drawn { plant, number, target_mm, unsteered_mm });
        }
    }
    bail!("none of {DRAWS} needles of seed {seed} misses its target by {UNSTEERED_MM} mm")
}

/// Pushes the needle as it is commanded on standard input, until that ends.
///
/// # Errors
/// Where the rig has ended, or a command is none.
pub fn run(args: &Args) -> Result<()> {
    let mut guide = GuideSocket::connect(&args.socket)?;
    let mut needle = drawn(args.seed)?.plant;
    let mut last: Option<Answer> = None;
    // Until it is pushed the needle does not load the guide.
    let mut acting = None;
    guide.load(acting)?;
    let stated = serde_json::to_string(&needle.stated)?;
    print(&stated)?;
    for line in std::io::stdin().lock().lines() {
        let line: Value = serde_json::from_str(&line?).context("a command that is no JSON")?;
        if line["done"] == true {
            return print(&serde_json::to_string(&needle.end()?)?);
        }
        let command: Command = serde_json::from_value(line)?;
        let guide_m = guide.load(acting)?;
        let mut answer = step(&mut needle, &command, guide_m)?;
        acting = Some(load(&needle, &command, guide_m)?);
        guide.load(acting)?;
        match (args.fails, args.beyond_mm) {
            (Some(fails), Some(beyond_mm)) if command.depth_mm > beyond_mm => {
                let Some(last) = &last else { bail!("--beyond-mm is above the surface") };
                fail(fails, &mut answer, last);
            }
            _ => last = Some(answer.clone()),
        }
        print(&serde_json::to_string(&answer)?)?;
    }
    // The controller is gone: the needle stays where it is.
    Ok(())
}

fn step(needle: &mut SimulatedPlant, command: &Command, guide_m: [f64; 2]) -> Result<Answer> {
    let [guide_x_mm, guide_y_mm] = guide_m.map(|m| 1e3 * m);
    Ok(needle.step(&Command { guide_x_mm, guide_y_mm, ..*command })?)
}

/// With which force the needle loads guide 2 now, and how that grows with its position.
fn load(needle: &SimulatedPlant, command: &Command, guide_m: [f64; 2]) -> Result<NeedleLoad> {
    let mut moved = needle.clone();
    // The actuators' play hides small moves.
    moved.flaws.play_mm = 0.0;
    let force_n = moved.needle.force_n;
    let mut later = Command { t_s: command.t_s + DIFFERENCE_S, ..*command };
    step(&mut moved, &later, guide_m)?;
    let previous_n = moved.needle.force_n;
    later.t_s += DIFFERENCE_S;
    let [x_m, y_m] = guide_m;
    step(&mut moved, &later, [x_m + 1e-3 * DIFFERENCE_MM, y_m])?;
    let stiffness_n_per_m = (moved.needle.force_n[0] - previous_n[0]) / (1e-3 * DIFFERENCE_MM);
    Ok(NeedleLoad { at_m: guide_m, force_n, stiffness_n_per_m: stiffness_n_per_m.max(0.0) })
}

fn fail(failure: Failure, answer: &mut Answer, last: &Answer) {
    match failure {
        Failure::Silent => {
            (answer.tip_seq, answer.tip_x_mm, answer.tip_y_mm, answer.tip_t_s) =
                (last.tip_seq, last.tip_x_mm, last.tip_y_mm, last.tip_t_s);
        }
        Failure::Frozen => (answer.tip_x_mm, answer.tip_y_mm) = (last.tip_x_mm, last.tip_y_mm),
        Failure::Jumping => answer.tip_x_mm += 25.0,
        Failure::Late => answer.tip_t_s = Some(answer.t_s - 3.0),
        Failure::LetGo => answer.depth_mm -= 4.0,
    }
}

fn print(line: &str) -> Result<()> {
    let mut output = std::io::stdout().lock();
    writeln!(output, "{line}").and_then(|()| output.flush()).context("cannot print")
}
