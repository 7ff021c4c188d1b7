//! `guide bringup`: from a soldered board to the first motion; names what is wired or mounted wrong.

mod record;

use super::output::Output;
use super::rig_args::{PortArgs, interrupted};
use anyhow::bail;
use clap::ValueEnum;
use device::bringup::{self, Operator, Prompt, Report, Step};
use formats::calibration_file;
use record::Record;
use std::io::{self, IsTerminal, Write};
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc;
use std::thread;
use std::time::{Duration, Instant};

/// Bring a rig up: find what is wired or mounted wrong, before and with the first small motions
///
/// Set both guides to the middle of their travel and mount the needle in both guides, in air. Each step first prints
/// what it does. Before the position loop is closed, motors are driven in pulses of at most 50 ms, 0.3 mm and 1 N,
/// which the device itself enforces. The device stores no values, except with --calibration after all other steps have
/// passed.
#[derive(clap::Args)]
#[command(
    after_help = "Example:\n  guide bringup --port /dev/ttyACM0\n  guide bringup --port /dev/ttyACM0 --step motors --step loop"
)]
pub struct Args {
    #[command(flatten)]
    port: PortArgs,
    /// Run only these steps; the results of the others are taken from the file
    #[arg(long, value_name = "STEP")]
    step: Vec<StepName>,
    /// Print no prompts: motion is allowed, the emergency stop is not tested
    #[arg(long)]
    yes: bool,
    /// Do not compare the device's clock with this computer's: for a simulated rig, whose clock runs at another rate
    #[arg(long)]
    no_clock: bool,
    /// Store this calibration (of `guide calibrate`) as the last step, restart the device and read it back
    #[arg(long, value_name = "FILE")]
    calibration: Option<PathBuf>,
    /// Write the result to this file after each step
    #[arg(long, value_name = "FILE", default_value = "bringup.toml")]
    out: PathBuf,
}

/// A step by its name.
#[derive(Clone, Copy, ValueEnum)]
enum StepName {
    Link,
    Supply,
    Stop,
    Converter,
    Potentiometers,
    Motors,
    Loop,
    Force,
    Store,
}

impl From<StepName> for Step {
    fn from(name: StepName) -> Self {
        match name {
            StepName::Link => Self::Link,
            StepName::Supply => Self::Supply,
            StepName::Stop => Self::EmergencyStop,
            StepName::Converter => Self::Converter,
            StepName::Potentiometers => Self::Potentiometers,
            StepName::Motors => Self::Motors,
            StepName::Loop => Self::Loop,
            StepName::Force => Self::Force,
            StepName::Store => Self::Store,
        }
    }
}

/// Interval at which a prompt checks for an interrupt.
const POLL_INTERVAL: Duration = Duration::from_millis(50);

/// The person at the terminal.
struct Terminal {
    yes: bool,
    clock: Option<Instant>,
    record: Record,
    interrupted: &'static AtomicBool,
}

impl Terminal {
    /// A line that the user types; nothing after the end of the input, or where the user interrupts.
    fn line(&self) -> Option<String> {
        let (sender, lines) = mpsc::channel();
        // Reading goes on through an interrupt, in a thread that ends with the program.
        thread::spawn(move || {
            let mut line = String::new();
            let read = io::stdin().read_line(&mut line);
            let _ = sender.send(matches!(read, Ok(1..)).then_some(line));
        });
        while !self.is_interrupted() {
            match lines.recv_timeout(POLL_INTERVAL) {
                Ok(line) => return line,
                Err(mpsc::RecvTimeoutError::Timeout) => {}
                Err(mpsc::RecvTimeoutError::Disconnected) => return None,
            }
        }
        None
    }
}

impl Operator for Terminal {
    fn confirm(&mut self, prompt: Prompt) -> bool {
        if self.yes {
            return matches!(prompt, Prompt::Allow(_));
        }
        let text = match prompt {
            Prompt::PressStop => "press the emergency stop and hold it, then Enter (s: skip) ",
            Prompt::ReleaseStop => "release the emergency stop, then Enter ",
            Prompt::Allow(_) => "keep clear of the guide; Enter to go on (s: skip) ",
        };
        eprint!("  {text}");
        let _ = io::stderr().flush();
        self.line().is_some_and(|line| !line.trim().eq_ignore_ascii_case("s"))
    }

    fn begins(&mut self, step: Step, report: &Report) -> io::Result<()> {
        eprintln!("{}: {}", step.name(), step.announcement());
        self.record.keep(report)
    }

    fn is_interrupted(&self) -> bool {
        self.interrupted.load(Ordering::Acquire)
    }

    fn clock(&mut self) -> Option<Duration> {
        self.clock.map(|since| since.elapsed())
    }
}

/// Runs `guide bringup`.
pub fn run(args: &Args, out: &mut Output) -> anyhow::Result<()> {
    if !args.yes && !io::stdin().is_terminal() {
        bail!("no terminal for prompts: with --yes motion is allowed and the emergency stop is not tested");
    }
    let calibration = args.calibration.as_deref().map(calibration_file::read).transpose()?;
    if calibration.is_none() && args.step.iter().any(|name| matches!(name, StepName::Store)) {
        bail!("--step store: nothing to store, expected --calibration FILE too");
    }
    let steps: Vec<Step> = match args.step.as_slice() {
        [] => Step::ALL.to_vec(),
        names => {
            Step::ALL.into_iter().filter(|step| names.iter().any(|name| Step::from(*name) == *step)).collect()
        }
    };
    let record = Record::read(&args.out)?;
    if let Some((step, date)) = record.interrupted() {
        out.note(format_args!(
            "{}: the bring-up of {date} was interrupted in `{step}`; the results of that step are not used",
            args.out.display()
        ));
    }
    let failed = record.failed();
    let clock = (!args.no_clock).then(Instant::now);
    let mut operator = Terminal { yes: args.yes, clock, record, interrupted: interrupted()? };
    let report = bringup::run(&args.port.port, &steps, &failed, calibration.as_ref(), &mut operator)?;
    operator.record.keep(&report)?;
    out.note(format_args!("wrote {}", args.out.display()));
    out.result(&report, &report)?;
    if !report.passed {
        out.finish()?;
        bail!(
            "the bring-up has not passed; findings: {}, each with its remedy in the result",
            report.findings().count()
        );
    }
    Ok(())
}
