//! `guide limits`: what the device's interlocks compare with.

use super::output::Output;
use super::rig_args::PortArgs;
use device::link::{Client, Limits};
use serde::Serialize;

/// Show or set the force and the silence of the host at which the device stops by itself
///
/// They hold until the device starts again. A limit that is not given stays as it is.
#[derive(clap::Args)]
#[command(after_help = "Example:\n  guide limits --port /dev/ttyACM0 --force-n 2.5")]
pub struct Args {
    #[command(flatten)]
    port: PortArgs,
    /// Largest force along either axis, from the tare and from the calibration's zero, newtons, at most the sensor's rated range
    #[arg(long, value_name = "N")]
    force_n: Option<f64>,
    /// Longest time without a command from the host while a program waits or runs, seconds of the device's clock,
    /// 0.2 to 60
    #[arg(long, value_name = "SECONDS")]
    silence_s: Option<f64>,
}

#[derive(Serialize)]
struct Report {
    schema: &'static str,
    force_limit_n: f64,
    silence_limit_s: f64,
}

/// Runs `guide limits`.
pub fn run(args: &Args, out: &mut Output) -> anyhow::Result<()> {
    let mut client = Client::connect(&args.port.port)?;
    let Limits { force_n, silence_s } = client.set_limits(args.force_n, args.silence_s)?;
    let report = Report { schema: "guide.limits/1", force_limit_n: force_n, silence_limit_s: silence_s };
    let text = format!(
        "force      {force_n:.3} N along either axis, from the tare and from the calibration's zero\n\
         silence    {silence_s:.3} s without a command from the host while a program waits or runs\n"
    );
    out.result(&report, text)
}
