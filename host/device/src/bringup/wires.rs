//! The serial link, the clock, and why the device last started.

use super::findings::Finding;
use super::report::StepReport;
use super::session::Session;
use crate::link::{LinkError, display};
use protocol::{Fault, Hello, ResetReason};
use std::time::Instant;

/// How long samples are streamed, seconds of the device.
const STREAM_S: f64 = 3.0;
/// Round trips that are timed.
const ROUND_TRIPS: u32 = 20;
/// A crystal is off by 0.01 %, the internal oscillator by 1 %: more is another clock tree.
const CLOCK_TOLERANCE: f64 = 0.03;

pub(super) fn link(session: &mut Session, report: &mut StepReport) -> Result<(), LinkError> {
    // The clock is read directly after an answer, both times: what the answer took falls out.
    let from = session.client.status()?;
    let clock = session.operator.clock();
    let (lost_before, bytes_before) = (session.client.losses(), session.client.bytes());
    let points = session.record(STREAM_S)?;
    let began = Instant::now();
    for _ in 0..ROUND_TRIPS {
        session.client.status()?;
    }
    let round_trip_ms = began.elapsed().as_secs_f64() * 1e3 / f64::from(ROUND_TRIPS);
    let to = session.client.status()?;
    let clock_then = session.operator.clock();
    let device_s = (to.t_us - from.t_us) as f64 * 1e-6;
    let lost = session.client.losses();
    let damaged = [
        lost.frames_corrupt - lost_before.frames_corrupt,
        lost.frames_missing - lost_before.frames_missing,
        lost.frames_unreadable - lost_before.frames_unreadable,
        u64::from(to.counters.frames_corrupt - from.counters.frames_corrupt),
        u64::from(to.counters.line_errors - from.counters.line_errors),
    ];
    report.measure("samples", points.len() as f64);
    report.measure("samples_missing", (lost.samples_missing - lost_before.samples_missing) as f64);
    report.measure("bytes_per_s", (session.client.bytes() - bytes_before) as f64 / device_s);
    report.measure("round_trip_ms", round_trip_ms);
    let [corrupt, missing, unreadable, to_device, line] = damaged;
    if damaged.iter().sum::<u64>() > 0 {
        let measured = format!(
            "in {device_s:.1} s to the host {corrupt} frames damaged, {missing} missing, {unreadable} unreadable; to the device {to_device} damaged, \
             {line} line errors"
        );
        report.find(Finding::new("link.lossy", None, measured));
    }
    if let (Some(before), Some(after)) = (clock, clock_then) {
        let ratio = device_s / (after - before).as_secs_f64();
        report.measure("clock_ratio", ratio);
        if (ratio - 1.0).abs() > CLOCK_TOLERANCE {
            let measured = format!("{:+.1} % against this computer's clock", 100.0 * (ratio - 1.0));
            report.find(Finding::new("link.clock", None, measured));
        }
    }
    Ok(())
}

pub(super) fn supply(session: &mut Session, report: &mut StepReport) -> Result<(), LinkError> {
    let fault = session.client.status()?.fault;
    let hello = session.client.hello();
    let unasked = matches!(hello.reset_reason, ResetReason::BrownOut | ResetReason::Watchdog)
        || hello.last_panic.is_some();
    if unasked || fault == Some(Fault::Restarted) {
        report.find(reset_finding(hello, "before this bring-up"));
    }
    Ok(())
}

/// The finding of an unrequested restart.
pub(super) fn reset_finding(hello: &Hello, when: &str) -> Finding {
    let measured = format!("restarted {when}: {}", display::reset_reason(hello.reset_reason));
    match hello.reset_reason {
        ResetReason::BrownOut => Finding::new("supply.brown_out", None, measured),
        _ => Finding::new("supply.restarted", None, measured).or("supply.brown_out"),
    }
}
