//! `guide tare`: make the present force zero.

use super::output::Output;
use super::rig_args::{PortArgs, StartArgs, run_step};
use anyhow::{Context, anyhow};
use host::link::Telemetry;
use host::link::program::milliseconds;
use protocol::{EventKind, Step};
use serde::Serialize;
use std::fmt::{self, Display};

/// Average the force and make that the zero of both force channels
#[derive(clap::Args)]
#[command(after_help = "Example:\n  guide tare --port /dev/ttyACM0")]
pub struct Args {
    #[command(flatten)]
    port: PortArgs,
    #[command(flatten)]
    start: StartArgs,
    /// How long to average, seconds
    #[arg(long, default_value_t = 1.0, value_name = "SECONDS")]
    duration_s: f64,
}

#[derive(Serialize)]
struct Tared {
    schema: &'static str,
    zero_x_n: f64,
    zero_y_n: f64,
    sd_x_n: f64,
    sd_y_n: f64,
}

impl Display for Tared {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(
            f,
            "zero       x {:+.4} N   y {:+.4} N (from the converter's own zero)",
            self.zero_x_n, self.zero_y_n
        )?;
        writeln!(f, "noise      x {:.4} N    y {:.4} N (sd of one reading)", self.sd_x_n, self.sd_y_n)
    }
}

/// Runs `guide tare`.
pub fn run(args: &Args, out: &mut Output) -> anyhow::Result<()> {
    let duration_ms = milliseconds(args.duration_s).map_err(|problem| anyhow!("--duration-s: {problem}"))?;
    let (client, said) = run_step(&args.port, args.start, "tare", Step::Tare { duration_ms })?;
    let tared = said.iter().find_map(|telemetry| match telemetry {
        Telemetry::Event(event) => match event.kind {
            EventKind::Tared(tare) => Some((tare.zero_counts, tare.sd_counts)),
            _ => None,
        },
        Telemetry::Samples(_) | Telemetry::Status(_) => None,
    });
    let (zero, sd) = tared.context("the tare was done, but what it found was lost on the way; tare again")?;
    let [zero_x_n, zero_y_n] = client.force_n(zero);
    let [sd_x_n, sd_y_n] = client.force_n(sd.map(|count| i32::try_from(count).unwrap_or(i32::MAX)));
    let tared = Tared { schema: "guide.tare/1", zero_x_n, zero_y_n, sd_x_n, sd_y_n };
    out.result(&tared, &tared)
}
