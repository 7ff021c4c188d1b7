//! Common parts of the sub-commands that operate the rig: port, interrupt, limit, running one step, reporting
//! faults.

use super::output::Output;
use anyhow::bail;
use clap::Args;
use device::link::error::explain_latched;
use device::link::{Client, LinkError, Point, Program, RunOptions, Telemetry, run};
use protocol::{CalibrationSource, Event, EventKind, Fault, Refusal, Request, Step};
use std::io::{IsTerminal, Write};
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::Duration;

/// The port of the device.
#[derive(Args)]
pub struct PortArgs {
    /// Port of the device, as `guide ports` lists it, a socket, or tcp:HOST:PORT
    #[arg(long, value_name = "PORT")]
    pub port: String,
}

/// When a motion starts.
#[derive(Args, Clone, Copy)]
pub struct StartArgs {
    /// Start when the device's clock reads this, in seconds since its start (default: at once)
    #[arg(long, value_name = "SECONDS", value_parser = device_time)]
    pub at_s: Option<f64>,
    /// Use the nominal calibration, that of the rig as designed, where the device has none stored (until its next
    /// start)
    #[arg(long)]
    pub nominal: bool,
}

/// The force at which the device stops by itself.
#[derive(Args, Clone, Copy, Default)]
pub struct ForceLimitArgs {
    /// Largest force along either axis, newtons: set before the motion, stays set (`guide limits`)
    #[arg(long, value_name = "N")]
    force_limit_n: Option<f64>,
}

impl ForceLimitArgs {
    /// Sets the limit where one was requested.
    pub fn set(self, client: &mut Client) -> Result<(), LinkError> {
        if self.force_limit_n.is_some() {
            client.set_limits(self.force_limit_n, None)?;
        }
        Ok(())
    }
}

/// A time of the device's clock that a motion can start at, seconds.
pub fn device_time(text: &str) -> Result<f64, String> {
    let time_s: f64 = text.parse().map_err(|_| "expected a number of seconds".to_owned())?;
    if time_s > 0.0 && time_s < 1e9 {
        Ok(time_s)
    } else {
        Err("expected more than 0, up to 1e9 seconds".to_owned())
    }
}

/// The same in the device's unit, microseconds.
pub fn device_us(time_s: f64) -> u64 {
    (time_s * 1e6).round() as u64
}

/// Time that a program has to end by itself once it is interrupted; stopping a guide takes some tens of milliseconds.
const LONGEST_END: Duration = Duration::from_millis(800);

/// Set when the user interrupts, the terminal is closed or the program is asked to end. One that waits for what does not come then (a device
/// that no longer answers, a reader of its output that has stalled) never looks at it, and is ended: the device stops as its host is silent.
pub fn interrupted() -> anyhow::Result<&'static AtomicBool> {
    static INTERRUPTED: AtomicBool = AtomicBool::new(false);
    ctrlc::set_handler(|| {
        INTERRUPTED.store(true, Ordering::Release);
        thread::sleep(LONGEST_END);
        // Beside this thread, which must not wait for a stalled reader too.
        thread::spawn(|| {
            let text = "error: interrupted: ended while it waited; a guide that moves stops within the device's limit of silence";
            let _ = writeln!(std::io::stderr(), "{text}");
        });
        thread::sleep(Duration::from_millis(50));
        std::process::exit(1);
    })?;
    Ok(&INTERRUPTED)
}

impl StartArgs {
    /// Has the device move by the constants of the rig as designed, where it has no calibration of its own: with `--nominal`, or when
    /// the user confirms it at a terminal.
    pub fn acknowledge(self, client: &mut Client) -> anyhow::Result<()> {
        if client.safety()?.calibration != CalibrationSource::Nominal && !self.nominal {
            return Ok(());
        }
        if self.nominal || confirmed()? {
            client.request(Request::AcknowledgeCalibration)?;
            return Ok(());
        }
        bail!(LinkError::Refused { command: "run", refusal: Refusal::CalibrationNotAcknowledged })
    }

    /// Options for a program that starts then.
    pub fn options(self, stream: bool) -> anyhow::Result<RunOptions<'static>> {
        let start_us = self.at_s.map(device_us);
        Ok(RunOptions { start_us, stream, interrupted: interrupted()? })
    }
}

/// Prompts at the terminal; no where there is none.
fn confirmed() -> anyhow::Result<bool> {
    if !std::io::stdin().is_terminal() || !std::io::stderr().is_terminal() {
        return Ok(false);
    }
    eprint!(
        "no calibration is stored on this device: positions and forces, and the force limit, would be those of the rig as designed.\n\
         Move all the same, until its next start? [y/N] "
    );
    let mut answer = String::new();
    std::io::stdin().read_line(&mut answer)?;
    Ok(matches!(answer.trim(), "y" | "Y" | "yes"))
}

/// Position at which the guide has come to rest: means over the last readings of a motion, which ends when the guide
/// has settled.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Rest {
    /// Device time, seconds.
    pub time_s: f64,
    /// Displacement along x and y, metres.
    pub displacement_m: [f64; 2],
    /// Force along x and y relative to the tare, newtons.
    pub force_n: [f64; 2],
}

/// Readings of [`Rest`]: as many as the device itself waits before a motion counts as settled.
const REST_SAMPLES: usize = 100;

impl Rest {
    /// The end of what was streamed; `None` where nothing was.
    pub fn of(received: &[Telemetry]) -> Option<Self> {
        let points = received.iter().rev().flat_map(|telemetry| {
            match telemetry {
                Telemetry::Samples(batch) if batch.step.is_some() => batch.points.as_slice(),
                _ => &[],
            }
            .iter()
            .rev()
        });
        let points: Vec<_> = points.take(REST_SAMPLES).collect();
        let count = points.len() as f64;
        Some(Self {
            time_s: points.first()?.time_s,
            displacement_m: [0, 1].map(|axis| mean(&|point| point.displacement_m[axis], &points, count)),
            force_n: [0, 1].map(|axis| mean(&|point| point.force_n[axis], &points, count)),
        })
    }
}

fn mean(value: &dyn Fn(&Point) -> f64, points: &[&Point], count: f64) -> f64 {
    points.iter().map(|point| value(point)).sum::<f64>() / count
}

/// Runs one step on the device and returns the telemetry received meanwhile.
pub fn run_step(
    port: &PortArgs,
    start: StartArgs,
    limit: ForceLimitArgs,
    name: &str,
    step: Step,
) -> anyhow::Result<(Client, Vec<Telemetry>)> {
    let mut client = Client::connect(&port.port)?;
    start.acknowledge(&mut client)?;
    limit.set(&mut client)?;
    let program = Program::single(name, step);
    let mut received = Vec::new();
    run(&mut client, &program, start.options(true)?, |_, telemetry| {
        received.push(telemetry.clone());
        Ok::<(), LinkError>(())
    })?;
    Ok((client, received))
}

/// Reports faults during work that they do not end: each once, from whichever message comes first.
#[derive(Default)]
pub struct FaultNotes {
    reported: Option<Fault>,
}

impl FaultNotes {
    /// Checks what the device sends; `meanwhile` names the work under way.
    pub fn see(&mut self, telemetry: &Telemetry, meanwhile: &str, out: &Output) {
        let fault = match telemetry {
            Telemetry::Event(Event { kind: EventKind::Faulted { fault }, .. }) => Some(*fault),
            Telemetry::Status(status) => status.fault,
            Telemetry::Event(_) | Telemetry::Samples(_) => return,
        };
        if let Some(fault) = fault.filter(|_| fault != self.reported) {
            out.note(format_args!("{}; {meanwhile}", explain_latched(fault)));
        }
        self.reported = fault;
    }
}
