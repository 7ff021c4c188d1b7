//! `guide status`, `home`, `move`, `stop`, `clear`: operating the rig by hand. Each ends by telling where the guide is.

use super::output::Output;
use super::rig_args::{ForceLimitArgs, PortArgs, Rest, StartArgs, run_step};
use super::status::{Detail, report_status};
use anyhow::anyhow;
use host::link::error::explain_fault;
use host::link::program::move_to;
use host::link::{Client, LinkError};
use protocol::{Refusal, Request};

/// Show what the device is doing, where the guide is and what has gone wrong
#[derive(clap::Args)]
#[command(after_help = "Example:\n  guide status --port /dev/ttyACM0")]
pub struct StatusArgs {
    #[command(flatten)]
    port: PortArgs,
}

/// Runs `guide status`.
pub fn status(args: &StatusArgs, out: &mut Output) -> anyhow::Result<()> {
    report_status("guide.status/1", &mut Client::connect(&args.port.port)?, None, Detail::Full, out)
}

/// Bring guide 2 to where the needle is straight
#[derive(clap::Args)]
#[command(after_help = "Example:\n  guide home --port /dev/ttyACM0")]
pub struct HomeArgs {
    #[command(flatten)]
    port: PortArgs,
    #[command(flatten)]
    start: StartArgs,
    /// Speed along the path, millimetres per second
    #[arg(long, default_value_t = 2.0, value_name = "MM_PER_S")]
    speed_mm_s: f64,
}

/// Runs `guide home`.
pub fn home(args: &HomeArgs, out: &mut Output) -> anyhow::Result<()> {
    let step = move_to([0.0, 0.0], args.speed_mm_s).map_err(|problem| anyhow!("{problem}"))?;
    let (mut client, said) = run_step(&args.port, args.start, ForceLimitArgs::default(), "home", step)?;
    report_status("guide.home/1", &mut client, Rest::of(&said), Detail::Brief, out)
}

/// Move guide 2 to a position and stay there
#[derive(clap::Args)]
#[command(after_help = "Example:\n  guide move --port /dev/ttyACM0 --y-mm 1.2 --speed-mm-s 0.5")]
pub struct MoveArgs {
    #[command(flatten)]
    port: PortArgs,
    #[command(flatten)]
    start: StartArgs,
    #[command(flatten)]
    limit: ForceLimitArgs,
    /// Horizontal position, millimetres from where the needle is straight
    #[arg(long, default_value_t = 0.0, value_name = "MM", allow_negative_numbers = true)]
    x_mm: f64,
    /// Vertical position, millimetres from where the needle is straight
    #[arg(long, default_value_t = 0.0, value_name = "MM", allow_negative_numbers = true)]
    y_mm: f64,
    /// Speed along the path, millimetres per second
    #[arg(long, default_value_t = 1.0, value_name = "MM_PER_S")]
    speed_mm_s: f64,
}

/// Runs `guide move`.
pub fn move_guide(args: &MoveArgs, out: &mut Output) -> anyhow::Result<()> {
    let step = move_to([args.x_mm, args.y_mm], args.speed_mm_s).map_err(|problem| anyhow!("{problem}"))?;
    let (mut client, said) = run_step(&args.port, args.start, args.limit, "move", step)?;
    report_status("guide.move/1", &mut client, Rest::of(&said), Detail::Brief, out)
}

/// Stop the guide where it is; its lead screws hold it
#[derive(clap::Args)]
#[command(after_help = "Example:\n  guide stop --port /dev/ttyACM0")]
pub struct StopArgs {
    #[command(flatten)]
    port: PortArgs,
}

/// Runs `guide stop`.
pub fn stop(args: &StopArgs, out: &mut Output) -> anyhow::Result<()> {
    let mut client = Client::connect(&args.port.port)?;
    client.request(Request::Stop)?;
    report_status("guide.stop/1", &mut client, None, Detail::Brief, out)
}

/// Leave the fault state once the fault's cause is gone
#[derive(clap::Args)]
#[command(after_help = "Example:\n  guide clear --port /dev/ttyACM0")]
pub struct ClearArgs {
    #[command(flatten)]
    port: PortArgs,
}

/// Runs `guide clear`.
pub fn clear(args: &ClearArgs, out: &mut Output) -> anyhow::Result<()> {
    let mut client = Client::connect(&args.port.port)?;
    client.request(Request::ClearFault).or_else(|error| match (&error, client.status()?.fault) {
        (LinkError::Refused { refusal: Refusal::CauseRemains, .. }, Some(fault)) => {
            Err(anyhow!("{error}: {}", explain_fault(fault)))
        }
        _ => Err(error.into()),
    })?;
    report_status("guide.clear/1", &mut client, None, Detail::Brief, out)
}
