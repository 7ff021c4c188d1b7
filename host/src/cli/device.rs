//! Operations on a device that stays connected, for a program that calls them: each ends with the document that the command of the
//! same name prints.

use super::operate::{clear_latched, retreat_from};
use super::output::{Memory, Output};
use super::rig_args::Rest;
use super::status::{Detail, report_status};
use super::tare::report_tare;
use anyhow::{anyhow, bail};
use device::link::program::{milliseconds, move_to};
use device::link::{Batch, Client, LinkError, Program, RunOptions, Telemetry, run};
use protocol::{CalibrationSource, Refusal, Request, Step};
use std::sync::atomic::AtomicBool;

/// Manner of a motion.
#[derive(Debug, Clone, Copy)]
pub struct Motion<'a> {
    /// Move by the nominal calibration where the device has none stored.
    pub nominal: bool,
    /// Largest force along either axis, from the tare and from the calibration's zero, newtons; stays set.
    pub force_limit_n: Option<f64>,
    /// Set by the caller to stop the guide.
    pub interrupted: &'a AtomicBool,
}

impl Motion<'_> {
    /// Runs a program; `observe` gets the samples as they arrive.
    ///
    /// # Errors
    /// Of the link and the device. Unless the link is gone, the guide has been stopped.
    pub fn run(
        &self,
        client: &mut Client,
        program: &Program,
        mut observe: impl FnMut(&Batch),
    ) -> anyhow::Result<Vec<Telemetry>> {
        if client.safety()?.calibration == CalibrationSource::Nominal {
            if !self.nominal {
                bail!(LinkError::Refused { command: "run", refusal: Refusal::CalibrationNotAcknowledged });
            }
            client.request(Request::AcknowledgeCalibration)?;
        }
        if self.force_limit_n.is_some() {
            client.set_limits(self.force_limit_n, None)?;
        }
        let options = RunOptions { start_us: None, stream: true, interrupted: self.interrupted };
        let mut received = Vec::new();
        run(client, program, options, |_, telemetry| {
            if let Telemetry::Samples(batch) = telemetry {
                observe(batch);
            }
            received.push(telemetry.clone());
            Ok::<(), LinkError>(())
        })?;
        Ok(received)
    }
}

/// Text of `guide status`.
///
/// # Errors
/// Of the link.
pub fn status(client: &mut Client) -> anyhow::Result<String> {
    document(|out| report_status("guide.status/1", client, None, Detail::Full, out))
}

/// Moves guide 2 to a position in millimetres: what `guide move` prints.
///
/// # Errors
/// As [`Motion::run`], and where position or speed is out of range.
pub fn move_guide(
    client: &mut Client,
    target_mm: [f64; 2],
    speed_mm_s: f64,
    motion: &Motion,
    observe: impl FnMut(&Batch),
) -> anyhow::Result<String> {
    let step = move_to(target_mm, speed_mm_s).map_err(|problem| anyhow!("{problem}"))?;
    let received = motion.run(client, &Program::single("move", step), observe)?;
    document(|out| report_status("guide.move/1", client, Rest::of(&received), Detail::Brief, out))
}

/// Averages the force for so many seconds and makes that the zero: what `guide tare` prints.
///
/// # Errors
/// As [`Motion::run`], and where the duration is out of range.
pub fn tare(
    client: &mut Client,
    duration_s: f64,
    motion: &Motion,
    observe: impl FnMut(&Batch),
) -> anyhow::Result<String> {
    let duration_ms = milliseconds(duration_s).map_err(|problem| anyhow!("duration_s: {problem}"))?;
    let received = motion.run(client, &Program::single("tare", Step::Tare { duration_ms }), observe)?;
    document(|out| report_tare(client, &received, out))
}

/// Stops the guide where it is: what `guide stop` prints.
///
/// # Errors
/// Of the link.
pub fn stop(client: &mut Client) -> anyhow::Result<String> {
    client.request(Request::Stop)?;
    document(|out| report_status("guide.stop/1", client, None, Detail::Brief, out))
}

/// Clears a latched fault: what `guide clear` prints.
///
/// # Errors
/// Where its cause remains, and of the link.
pub fn clear(client: &mut Client) -> anyhow::Result<String> {
    clear_latched(client)?;
    document(|out| report_status("guide.clear/1", client, None, Detail::Brief, out))
}

/// Unloads the guide while the fault of the load is latched: what `guide retreat` prints. It is stopped on its way once `interrupted` is
/// set.
///
/// # Errors
/// Where no such fault is latched, and of the link.
pub fn retreat(client: &mut Client, interrupted: &AtomicBool) -> anyhow::Result<String> {
    document(|out| retreat_from(client, [None; 2], interrupted, out))
}

fn document(report: impl FnOnce(&mut Output) -> anyhow::Result<()>) -> anyhow::Result<String> {
    let mut output = Output::to_memory(Box::new(|_| {}));
    report(&mut output)?;
    let Memory { document, .. } = output.into_memory().unwrap_or_else(Memory::empty);
    Ok(String::from_utf8_lossy(&document).into_owned())
}
