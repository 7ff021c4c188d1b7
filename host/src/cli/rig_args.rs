//! What the sub-commands that operate the rig share: port, interrupt, running one step, telling the state.

use super::output::Output;
use clap::Args;
use host::link::error::explain_fault;
use host::link::{Client, LinkError, Point, Program, RunOptions, Telemetry, run};
use protocol::{State, Status, Step};
use serde::Serialize;
use std::fmt::{self, Display};
use std::sync::atomic::{AtomicBool, Ordering};

/// The serial port of the device.
#[derive(Args)]
pub struct PortArgs {
    /// Serial port of the device, as `guide ports` lists it
    #[arg(long, value_name = "PORT")]
    pub port: String,
}

/// When a motion starts.
#[derive(Args, Clone, Copy)]
pub struct StartArgs {
    /// Start when the device's clock reads this, in seconds since its start (default: at once)
    #[arg(long, value_name = "SECONDS", value_parser = device_time)]
    pub at_s: Option<f64>,
}

fn device_time(text: &str) -> Result<f64, String> {
    let time_s: f64 = text.parse().map_err(|_| "expected a number of seconds".to_owned())?;
    if time_s > 0.0 && time_s < 1e9 { Ok(time_s) } else { Err("expected 0 to 1e9 seconds".to_owned()) }
}

/// Set when the user asks to end.
pub fn interrupted() -> anyhow::Result<&'static AtomicBool> {
    static INTERRUPTED: AtomicBool = AtomicBool::new(false);
    ctrlc::set_handler(|| INTERRUPTED.store(true, Ordering::Release))?;
    Ok(&INTERRUPTED)
}

impl StartArgs {
    /// Options for a program that starts then.
    pub fn options(self, stream: bool) -> anyhow::Result<RunOptions<'static>> {
        let start_us = self.at_s.map(|time_s| (time_s * 1e6).round() as u64);
        Ok(RunOptions { start_us, stream, interrupted: interrupted()? })
    }
}

/// Where the guide has come to rest: means over the last readings of a motion, which ends when the guide has settled.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Rest {
    time_s: f64,
    displacement_m: [f64; 2],
    force_n: [f64; 2],
}

/// Readings of [`Rest`]: as many as the device itself waits before a motion counts as settled.
const REST_SAMPLES: usize = 100;

impl Rest {
    /// The end of what was streamed; nothing where nothing was.
    pub fn of(said: &[Telemetry]) -> Option<Self> {
        let points = said.iter().rev().flat_map(|telemetry| {
            match telemetry {
                Telemetry::Samples(batch) if batch.step.is_some() => batch.points.as_slice(),
                _ => &[],
            }
            .iter()
            .rev()
        });
        let points: Vec<_> = points.take(REST_SAMPLES).collect();
        let count = points.len() as f64;
        let mean =
            |value: &dyn Fn(&Point) -> f64| points.iter().map(|point| value(point)).sum::<f64>() / count;
        Some(Self {
            time_s: points.first()?.time_s,
            displacement_m: [0, 1].map(|axis| mean(&|point| point.displacement_m[axis])),
            force_n: [0, 1].map(|axis| mean(&|point| point.force_n[axis])),
        })
    }
}

/// Runs one step on the device and returns all that it said meanwhile.
pub fn run_step(
    port: &PortArgs,
    start: StartArgs,
    name: &str,
    step: Step,
) -> anyhow::Result<(Client, Vec<Telemetry>)> {
    let mut client = Client::connect(&port.port)?;
    let program = Program::single(name, step);
    let mut said = Vec::new();
    run(&mut client, &program, start.options(true)?, |_, telemetry| {
        said.push(telemetry.clone());
        Ok::<(), LinkError>(())
    })?;
    Ok((client, said))
}

/// State of the device in the units of a user.
#[derive(Serialize)]
pub struct Report {
    schema: &'static str,
    time_s: f64,
    state: &'static str,
    fault: Option<String>,
    position_x_mm: f64,
    position_y_mm: f64,
    force_x_n: f64,
    force_y_n: f64,
    samples_dropped: u32,
    messages_dropped: u32,
    command_frames_corrupt: u32,
    command_frames_overlong: u32,
    command_frames_unreadable: u32,
    force_readings_bad: u32,
    control_overruns: u32,
}

impl Report {
    fn new(schema: &'static str, client: &Client, status: &Status, rest: Option<Rest>) -> Self {
        let now = Rest {
            time_s: status.t_us as f64 * 1e-6,
            displacement_m: client.displacement_m(status.position_counts),
            force_n: client.force_n(status.force_counts),
        };
        let Rest { time_s, displacement_m, force_n: [force_x_n, force_y_n] } = rest.unwrap_or(now);
        let [position_x_mm, position_y_mm] = displacement_m.map(|metres| metres * 1e3);
        let counters = status.counters;
        Self {
            schema,
            time_s,
            state: state_name(status.state),
            fault: status.fault.map(explain_fault),
            position_x_mm,
            position_y_mm,
            force_x_n,
            force_y_n,
            samples_dropped: counters.samples_dropped,
            messages_dropped: counters.messages_dropped,
            command_frames_corrupt: counters.frames_corrupt,
            command_frames_overlong: counters.frames_overlong,
            command_frames_unreadable: counters.frames_unreadable,
            force_readings_bad: counters.force_readings_bad,
            control_overruns: counters.control_overruns,
        }
    }
}

impl Display for Report {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "state      {}", self.state)?;
        if let Some(fault) = &self.fault {
            writeln!(f, "           {fault}")?;
        }
        writeln!(f, "guide 2    x {:+.3} mm   y {:+.3} mm", self.position_x_mm, self.position_y_mm)?;
        writeln!(f, "force      x {:+.4} N    y {:+.4} N", self.force_x_n, self.force_y_n)?;
        writeln!(f, "clock      {:.3} s since the device started", self.time_s)?;
        let counters = [
            (self.samples_dropped, "samples dropped by the device"),
            (self.messages_dropped, "messages dropped by the device"),
            (self.command_frames_corrupt, "corrupt command frames"),
            (self.command_frames_overlong, "over-long command frames"),
            (self.command_frames_unreadable, "unreadable command frames"),
            (self.force_readings_bad, "bad force readings"),
            (self.control_overruns, "late control periods"),
        ];
        for (count, what) in counters.into_iter().filter(|(count, _)| *count > 0) {
            writeln!(f, "counted    {count} {what}")?;
        }
        Ok(())
    }
}

/// Asks the device for its state and prints it; position and force are those of `rest` where there is one.
pub fn report_status(
    schema: &'static str,
    client: &mut Client,
    rest: Option<Rest>,
    out: &mut Output,
) -> anyhow::Result<()> {
    let status = client.status()?;
    let report = Report::new(schema, client, &status, rest);
    out.result(&report, &report)
}

fn state_name(state: State) -> &'static str {
    match state {
        State::Idle => "idle",
        State::Pending => "waiting for its start time",
        State::Moving => "moving",
        State::Holding => "holding",
        State::Taring => "taring",
        State::Faulted => "faulted",
    }
}
