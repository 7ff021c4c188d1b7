//! `guide status`, `home`, `move`, `stop`, `clear`, `retreat`: operating the rig by hand. Each ends by reporting where the guide is.

use super::output::Output;
use super::rig_args::{ForceLimitArgs, PortArgs, Rest, StartArgs, interrupted, run_step};
use super::status::{Detail, report_status};
use anyhow::{anyhow, bail};
use device::link::error::{AT_THE_MIDDLE, explain_fault, explain_retreat};
use device::link::program::move_to;
use device::link::{Client, LinkError, Telemetry};
use protocol::{EventKind, Fault, RETREAT_LIMIT_UM, Refusal, Request, RetreatOutcome, State};
use serde::Serialize;
use std::fmt::{self, Display};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

/// Show state, position, force, faults and load of the device
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

/// Move guide 2 to where the needle is straight
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
    let (mut client, received) = run_step(&args.port, args.start, ForceLimitArgs::default(), "home", step)?;
    report_status("guide.home/1", &mut client, Rest::of(&received), Detail::Brief, out)
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
    #[arg(long, default_value_t = 0.0, value_name = "MM")]
    x_mm: f64,
    /// Vertical position, millimetres from where the needle is straight
    #[arg(long, default_value_t = 0.0, value_name = "MM")]
    y_mm: f64,
    /// Speed along the path, millimetres per second
    #[arg(long, default_value_t = 1.0, value_name = "MM_PER_S")]
    speed_mm_s: f64,
}

/// Runs `guide move`.
pub fn move_guide(args: &MoveArgs, out: &mut Output) -> anyhow::Result<()> {
    let step = move_to([args.x_mm, args.y_mm], args.speed_mm_s).map_err(|problem| anyhow!("{problem}"))?;
    let (mut client, received) = run_step(&args.port, args.start, args.limit, "move", step)?;
    report_status("guide.move/1", &mut client, Rest::of(&received), Detail::Brief, out)
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

/// Clear a latched fault once its cause is gone
#[derive(clap::Args)]
#[command(after_help = "Example:\n  guide clear --port /dev/ttyACM0")]
pub struct ClearArgs {
    #[command(flatten)]
    port: PortArgs,
}

/// Runs `guide clear`.
pub fn clear(args: &ClearArgs, out: &mut Output) -> anyhow::Result<()> {
    let mut client = Client::connect(&args.port.port)?;
    clear_latched(&mut client)?;
    report_status("guide.clear/1", &mut client, None, Detail::Brief, out)
}

/// Clears the latched fault; where its cause remains, reports what it is.
pub(super) fn clear_latched(client: &mut Client) -> anyhow::Result<()> {
    clear_at_rest(client).or_else(|error| match (&error, client.status()?.fault) {
        (LinkError::Refused { refusal: Refusal::CauseRemains, .. }, Some(fault @ Fault::MotorHot)) => {
            let [x_s, y_s] = client.safety()?.cools_in_s;
            Err(anyhow!("{error}: {}; {} s left", explain_fault(fault), x_s.max(y_s)))
        }
        (LinkError::Refused { refusal: Refusal::CauseRemains, .. }, Some(fault)) => {
            Err(anyhow!("{error}: {}", explain_fault(fault)))
        }
        _ => Err(error.into()),
    })
}

/// Clears the latched fault. The device refuses that for a moment while an axis still coasts after a motion.
fn clear_at_rest(client: &mut Client) -> Result<(), LinkError> {
    const TRIES: u32 = 4;
    const PAUSE: Duration = Duration::from_millis(100);
    for _ in 1..TRIES {
        match client.request(Request::ClearFault) {
            Err(LinkError::Refused { refusal: Refusal::CauseRemains, .. }) => std::thread::sleep(PAUSE),
            outcome => return outcome,
        }
    }
    client.request(Request::ClearFault)
}

/// Unload the guide while the fault caused by the load is latched
///
/// Guide 2 moves slowly towards the middle of its travel, where the needle is straight, until the force is below the limit. It stops
/// where the force does not fall.
#[derive(clap::Args)]
#[command(
    after_help = "Example:\n  guide retreat --port /dev/ttyACM0\n  guide retreat --port /dev/ttyACM0 --y-mm -0.5\n\nIt fails where the load remains: open the needle's clamp."
)]
pub struct RetreatArgs {
    #[command(flatten)]
    port: PortArgs,
    /// Displacement along x, millimetres, -1 to 1
    #[arg(long, value_name = "MM", value_parser = retreat_um)]
    x_mm: Option<i32>,
    /// Displacement along y, millimetres, -1 to 1
    #[arg(long, value_name = "MM", value_parser = retreat_um)]
    y_mm: Option<i32>,
}

/// Reads a distance in millimetres as micrometres.
fn retreat_um(text: &str) -> Result<i32, String> {
    let um = text.parse().ok().map(|mm: f64| (1e3 * mm).round());
    let limit = f64::from(RETREAT_LIMIT_UM);
    um.filter(|um| um.abs() <= limit)
        .map(|um| um as i32)
        .ok_or(format!("expected -{l} to {l}", l = limit / 1e3))
}

#[derive(Serialize)]
struct Retreated {
    schema: &'static str,
    outcome: &'static str,
    position_x_mm: f64,
    position_y_mm: f64,
    force_x_n: f64,
    force_y_n: f64,
    fault: Option<String>,
}

impl Display for Retreated {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "retreat    {}", self.outcome)?;
        writeln!(f, "guide 2    x {:+.3} mm   y {:+.3} mm", self.position_x_mm, self.position_y_mm)?;
        writeln!(f, "force      x {:+.4} N    y {:+.4} N", self.force_x_n, self.force_y_n)?;
        match &self.fault {
            Some(fault) => writeln!(f, "fault      {fault}"),
            None => Ok(()),
        }
    }
}

/// Runs `guide retreat`.
pub fn retreat(args: &RetreatArgs, out: &mut Output) -> anyhow::Result<()> {
    let mut client = Client::connect(&args.port.port)?;
    retreat_from(&mut client, [args.x_mm, args.y_mm], interrupted()?, out)
}

/// Retreats by so many micrometres, or towards the middle of the travel until the load is gone; where the user interrupts, it is
/// stopped on its way.
pub(super) fn retreat_from(
    client: &mut Client,
    by_um: [Option<i32>; 2],
    interrupted: &AtomicBool,
    out: &mut Output,
) -> anyhow::Result<()> {
    let mut outcome;
    if by_um == [None; 2] {
        client.retreat_to_middle()?.ok_or_else(|| anyhow!(AT_THE_MIDDLE))?;
        loop {
            outcome = retreat_ended(client, interrupted)?;
            if outcome != Some(RetreatOutcome::Moved) {
                break;
            }
            match client.retreat_to_middle() {
                Ok(by_um) => drop(by_um.ok_or_else(|| anyhow!(AT_THE_MIDDLE))?),
                // The force is below the limit, if not by the margin of a retreat's end.
                Err(LinkError::Refused { refusal: Refusal::NotUnderLoad, .. }) => {
                    outcome = Some(RetreatOutcome::Unloaded);
                    break;
                }
                Err(error) => return Err(error.into()),
            }
        }
    } else {
        let [x_um, y_um] = by_um.map(|um| um.unwrap_or(0));
        client.request(Request::Retreat { x_um, y_um })?;
        outcome = retreat_ended(client, interrupted)?;
    }
    let status = client.status()?;
    let [position_x_mm, position_y_mm] =
        client.displacement_m(status.position_counts).map(|metres| metres * 1e3);
    let [force_x_n, force_y_n] = client.force_n(status.force_counts);
    let retreated = Retreated {
        schema: "guide.retreat/1",
        outcome: outcome.map_or("ended; its outcome was not received", explain_retreat),
        position_x_mm,
        position_y_mm,
        force_x_n,
        force_y_n,
        fault: status.fault.map(explain_fault),
    };
    out.result(&retreated, &retreated)?;
    match outcome {
        Some(failed @ RetreatOutcome::ForceNotFalling) => bail!(explain_retreat(failed)),
        _ => Ok(()),
    }
}

/// Waits for the end of a retreat; nothing where its event was lost.
fn retreat_ended(client: &mut Client, interrupted: &AtomicBool) -> anyhow::Result<Option<RetreatOutcome>> {
    /// Longest that a retreat takes on the slowest simulated rig.
    const LIMIT: Duration = Duration::from_secs(60);
    const POLL: Duration = Duration::from_millis(50);
    let began = Instant::now();
    let (mut outcome, mut stopped) = (None, false);
    // The event may be lost; the state is not.
    loop {
        let is_over = client.status()?.state != State::Retreating;
        while let Some(telemetry) = client.waiting() {
            if let Telemetry::Event(event) = telemetry
                && let EventKind::RetreatEnded { outcome: ended } = event.kind
            {
                outcome = Some(ended);
            }
        }
        if is_over {
            return Ok(outcome);
        }
        if interrupted.load(Ordering::Acquire) && !stopped {
            client.request(Request::Stop)?;
            stopped = true;
        }
        if began.elapsed() > LIMIT {
            client.request(Request::Stop)?;
            bail!(
                "the retreat did not end within {} s and was stopped: look at the guide, then `guide status`",
                LIMIT.as_secs()
            );
        }
        std::thread::sleep(POLL);
    }
}
