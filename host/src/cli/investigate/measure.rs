//! Who makes the runs of an investigation: the device, the forward model, or the person.

use anyhow::{Context, bail, ensure};
use formats::files;
use formats::session::{SessionWriter, Setup, Walls};
use inference::investigate::PlannedRun;
use simulation::simulate::{Axis, LateralPlan, Sensors, Simulated, SimulationPlan};
use std::fmt::Write as _;
use std::io::{self, IsTerminal};
use std::path::Path;
use std::process::Command;

/// The motion program of the next run, in the session's folder.
const PROGRAM: &str = "next.toml";

/// Who makes the runs.
pub enum Rig<'a> {
    /// The device, through `guide acquire`.
    Device { port: &'a str, setup: Option<&'a Path>, options: &'a [String], ask: bool },
    /// The forward model, with what a plan hides.
    Simulated { plan: &'a Path, seed: u64, ask: bool },
    /// The person, by the program that is written.
    Person,
}

/// Result of a run.
pub enum Measured {
    /// It is in the session.
    Done,
    /// The person does not want it.
    Stopped,
    /// It is left to the person.
    Left {
        /// The motion program.
        program: String,
        /// The command that makes the run.
        command: String,
    },
}

impl<'a> Rig<'a> {
    /// The device.
    pub fn device(port: &'a str, setup: Option<&'a Path>, options: &'a [String], ask: bool) -> Self {
        Self::Device { port, setup, options, ask }
    }

    /// The forward model.
    pub fn simulated(plan: &'a Path, seed: u64, ask: bool) -> Self {
        Self::Simulated { plan, seed, ask }
    }

    /// Makes a run.
    pub fn measure(&mut self, dir: &Path, run: &PlannedRun) -> anyhow::Result<Measured> {
        match *self {
            Self::Device { ask, .. } | Self::Simulated { ask, .. } if ask && !confirmed(run)? => {
                return Ok(Measured::Stopped);
            }
            Self::Device { port, setup, options, .. } => on_device(dir, run, port, setup, options)?,
            Self::Simulated { plan, seed, .. } => simulate(dir, &run.plan, plan, seed)?,
            Self::Person => return left(dir, run),
        }
        Ok(Measured::Done)
    }
}

/// Asks at the terminal.
fn confirmed(run: &PlannedRun) -> anyhow::Result<bool> {
    ensure!(io::stdin().is_terminal(), "--ask: no terminal to ask at");
    let depth = if run.is_elsewhere {
        format!("bring the needle to {:.0} mm, then ", 1e3 * run.plan.depth_m)
    } else {
        String::new()
    };
    eprint!("  {depth}Enter to measure (q: stop) ");
    let mut answer = String::new();
    let read = io::stdin().read_line(&mut answer).context("standard input: cannot read")?;
    Ok(read > 0 && !answer.trim().eq_ignore_ascii_case("q"))
}

/// Makes the run with `guide acquire`, whose output goes to standard error.
fn on_device(
    dir: &Path,
    run: &PlannedRun,
    port: &str,
    setup: Option<&Path>,
    options: &[String],
) -> anyhow::Result<()> {
    let guide = std::env::current_exe().context("the path of this program")?;
    let scratch = tempfile::tempdir().context("a folder for the motion program")?;
    let program = scratch.path().join(PROGRAM);
    std::fs::write(&program, program_text(&run.plan))
        .with_context(|| format!("{}: cannot write", program.display()))?;
    let mut command = Command::new(guide);
    command
        .args(["acquire", "--port", port, "--id", &run.plan.id])
        .args(["--depth-mm", &depth_mm(&run.plan)])
        .arg("--program")
        .arg(&program)
        .arg("--out")
        .arg(dir);
    if let Some(setup) = setup.filter(|_| !dir.join("session.toml").exists()) {
        command.arg("--rig").arg(setup);
    }
    command.args(options).stdout(io::stderr());
    let status = command.status().context("guide acquire: cannot be run")?;
    if !status.success() {
        bail!(
            "the run {} was not made: `guide acquire` failed; the same command goes on from here",
            run.plan.id
        );
    }
    Ok(())
}

/// Adds the run, as the forward model with what the plan hides makes it.
fn simulate(dir: &Path, run: &LateralPlan, config: &Path, seed: u64) -> anyhow::Result<()> {
    let mut setup = Setup::read(config)?;
    let plan = SimulationPlan::read(config, None)?;
    if setup.name.is_empty()
        && let Some(own) = dir.file_name()
    {
        setup.name = own.to_string_lossy().into_owned();
    }
    setup.tissue.walls.get_or_insert(Walls::Far);
    let cannot = || format!("{}: cannot simulate", config.display());
    let mut session = SessionWriter::open(dir, &setup)?;
    let number = session.lateral_ids().len() as u64;
    let model = plan.model(&setup.rig).with_context(cannot)?;
    let made = run.carry_out(&model, Sensors::new(&setup.noise), seed, number).with_context(cannot)?;
    Simulated { lateral: vec![made], ..Simulated::default() }.write(&mut session)?;
    Ok(())
}

/// Writes the program for the person.
fn left(dir: &Path, run: &PlannedRun) -> anyhow::Result<Measured> {
    let program = dir.join(PROGRAM);
    files::replace(&program, program_text(&run.plan).as_bytes())
        .with_context(|| format!("{}: cannot write", program.display()))?;
    let [folder, file] = [dir, &program].map(files::with_slashes);
    Ok(Measured::Left {
        command: format!(
            "guide acquire --port PORT --out {folder} --depth-mm {} --id {} --program {file}",
            depth_mm(&run.plan),
            run.plan.id
        ),
        program: file,
    })
}

fn depth_mm(plan: &LateralPlan) -> String {
    // Micrometres are beyond what a person sets.
    format!("{}", (1e6 * plan.depth_m).round() / 1e3)
}

/// The motion program of a run, as `guide acquire` reads it.
fn program_text(plan: &LateralPlan) -> String {
    let axis = if plan.axis == Axis::Y { "y" } else { "x" };
    let largest_m = plan.levels_m.iter().copied().fold(0.0, f64::max);
    let smallest_m = plan.levels_m.iter().copied().fold(0.0, f64::min);
    let mut text = format!("name = \"{}\"\n", plan.id);
    for level_m in &plan.levels_m {
        let is_extreme = [0.0, largest_m, smallest_m].contains(level_m);
        let sweep = if is_extreme { "sweep = true\n" } else { "" };
        // Writing into a string does not fail.
        let _ = write!(
            text,
            "\n[[step]]\nmove_{axis}_mm = {:.3}\nspeed_mm_s = {:.3}\n\n[[step]]\nhold_s = {:.1}\n{sweep}",
            1e3 * level_m,
            1e3 * plan.ramp_m_per_s,
            plan.hold_s
        );
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;
    use device::link::Program;
    use simulation::simulate::SweepLevels;

    #[test]
    fn the_program_is_one_that_acquire_reads() {
        let plan = LateralPlan {
            id: "x30-1".to_owned(),
            depth_m: 0.03,
            axis: Axis::X,
            levels_m: vec![0.0, 0.6e-3, 1.2e-3, 0.0, -1.2e-3, 0.0],
            hold_s: 3.0,
            ramp_m_per_s: 1e-3,
            rate_hz: 20.0,
            sweep_levels: SweepLevels::Extremes,
            spacing_m: 1e-3,
        };
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join(PROGRAM);
        std::fs::write(&path, program_text(&plan)).expect("written");
        let program = Program::load(path.to_str().expect("a name")).expect("a program");
        assert_eq!((program.name.as_str(), program.steps.len()), ("x30-1", 12));
        assert_eq!(program.steps.iter().filter(|step| step.sweep).count(), 5);
        assert_eq!(depth_mm(&plan), "30");
    }
}
