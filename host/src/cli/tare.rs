//! `guide tare`: make the present force zero.

use super::output::Output;
use super::rig_args::{ForceLimitArgs, PortArgs, StartArgs, run_step};
use anyhow::{Context, anyhow};
use device::link::program::milliseconds;
use device::link::{Client, Telemetry};
use device::tare::TareQuality;
use protocol::{EventKind, Step, UNIQUE_CODES};
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
    /// Averaging time, seconds
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
    zero_standard_error_x_n: Option<f64>,
    zero_standard_error_y_n: Option<f64>,
    drift_x_n_per_s: f64,
    drift_y_n_per_s: f64,
    drift_ci95_x_n_per_s: Option<[f64; 2]>,
    drift_ci95_y_n_per_s: Option<[f64; 2]>,
    duration_s: f64,
    readings: u32,
    expected_readings: u32,
    readings_per_s: Option<f64>,
    unique_codes: [u8; 2],
    verdict: String,
}

impl Tared {
    fn new(quality: &TareQuality) -> Self {
        let [x, y] = quality.axes;
        Self {
            schema: "guide.tare/1",
            zero_x_n: x.zero_n,
            zero_y_n: y.zero_n,
            sd_x_n: x.sd_n,
            sd_y_n: y.sd_n,
            zero_standard_error_x_n: x.zero_standard_error_n,
            zero_standard_error_y_n: y.zero_standard_error_n,
            drift_x_n_per_s: x.drift_n_per_s,
            drift_y_n_per_s: y.drift_n_per_s,
            drift_ci95_x_n_per_s: x.drift_ci95_n_per_s,
            drift_ci95_y_n_per_s: y.drift_ci95_n_per_s,
            duration_s: quality.duration_s,
            readings: quality.readings,
            expected_readings: quality.expected_readings,
            readings_per_s: quality.readings_per_s(),
            unique_codes: quality.unique_codes,
            verdict: quality.verdict(),
        }
    }
}

impl Display for Tared {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(
            f,
            "zero       x {:+.4} N   y {:+.4} N (from the calibration's zero)",
            self.zero_x_n, self.zero_y_n
        )?;
        writeln!(
            f,
            "           x {} N   y {} N (standard error)",
            error_text(self.zero_standard_error_x_n),
            error_text(self.zero_standard_error_y_n)
        )?;
        writeln!(f, "noise      x {:.4} N    y {:.4} N (sd of one reading)", self.sd_x_n, self.sd_y_n)?;
        writeln!(
            f,
            "drift      x {}   y {} (95 % interval)",
            drift_text(self.drift_x_n_per_s, self.drift_ci95_x_n_per_s),
            drift_text(self.drift_y_n_per_s, self.drift_ci95_y_n_per_s)
        )?;
        let rate = self.readings_per_s.map_or(String::new(), |rate| format!(", {rate:.1} a second"));
        let codes = self.unique_codes.map(|codes| {
            let more = if codes >= UNIQUE_CODES { " or more" } else { "" };
            format!("{codes}{more}")
        });
        writeln!(
            f,
            "readings   {} of {} valid in {:.3} s{rate}; distinct codes {}",
            self.readings,
            self.expected_readings,
            self.duration_s,
            codes.join(", ")
        )?;
        writeln!(f, "verdict    {}", self.verdict)
    }
}

fn drift_text(n_per_s: f64, ci95: Option<[f64; 2]>) -> String {
    match ci95 {
        Some([low, high]) => format!("{n_per_s:+.5} ({low:+.5} to {high:+.5}) N/s"),
        None => "not identifiable".to_owned(),
    }
}

fn error_text(error: Option<f64>) -> String {
    error.map_or("-".to_owned(), |error| format!("{error:.5}"))
}

/// Runs `guide tare`.
pub fn run(args: &Args, out: &mut Output) -> anyhow::Result<()> {
    let duration_ms = milliseconds(args.duration_s).map_err(|problem| anyhow!("--duration-s: {problem}"))?;
    let limit = ForceLimitArgs::default();
    let (client, received) = run_step(&args.port, args.start, limit, "tare", Step::Tare { duration_ms })?;
    report_tare(&client, &received, out)
}

/// Reports the tare that was received.
pub(super) fn report_tare(client: &Client, received: &[Telemetry], out: &mut Output) -> anyhow::Result<()> {
    let tared = received.iter().find_map(|telemetry| match telemetry {
        Telemetry::Event(event) => match event.kind {
            EventKind::Tared(tare) => Some(tare),
            _ => None,
        },
        Telemetry::Samples(_) | Telemetry::Status(_) => None,
    });
    let tare = tared.context("the tare was done, but its result was not received; tare again")?;
    let tared = Tared::new(&TareQuality::new(client, &tare));
    out.result(&tared, &tared)
}
