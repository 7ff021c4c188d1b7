//! What the sub-commands that operate the rig share: port, interrupt, running one step, telling the state.

use super::output::Output;
use clap::Args;
use host::link::error::explain_fault;
use host::link::{Client, LinkError, Program, RunOptions, Telemetry, run};
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
    run(&mut client, &program, start.options(false)?, |_, telemetry| {
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
    fn new(schema: &'static str, client: &Client, status: &Status) -> Self {
        let [position_x_mm, position_y_mm] = client.displacement_m(status.position_counts).map(|m| m * 1e3);
        let [force_x_n, force_y_n] = client.force_n(status.force_counts);
        let counters = status.counters;
        Self {
            schema,
            time_s: status.t_us as f64 * 1e-6,
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

/// Asks the device for its state and prints it.
pub fn report_status(schema: &'static str, client: &mut Client, out: &mut Output) -> anyhow::Result<()> {
    let status = client.status()?;
    let report = Report::new(schema, client, &status);
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
