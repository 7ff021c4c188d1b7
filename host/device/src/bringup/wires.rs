//! The serial link, the clock, and why the device last started.

use super::findings::Finding;
use super::report::StepReport;
use super::session::Session;
use crate::link::{LinkError, display};
use protocol::{Fault, Hello, ResetReason, Status};
use std::time::{Duration, Instant};

/// Duration of the stream of samples, seconds of the device.
const STREAM_S: f64 = 3.0;
/// Round trips that are timed.
const ROUND_TRIPS: u32 = 20;
/// Answers before the stream, one of which dates the device's clock.
const DATED_ANSWERS: u32 = 5;
/// A crystal is off by 0.01 %, the internal oscillator by 1 %: more is another clock tree.
const CLOCK_TOLERANCE: f64 = 0.03;

pub(super) fn link(session: &mut Session, report: &mut StepReport) -> Result<(), LinkError> {
    let first_answer = dated(session, DATED_ANSWERS)?;
    let (lost_before, bytes_before) = (session.client.losses(), session.client.bytes());
    let points = session.record(STREAM_S)?;
    let began = Instant::now();
    let last_answer = dated(session, ROUND_TRIPS)?;
    let round_trip_ms = began.elapsed().as_secs_f64() * 1e3 / f64::from(ROUND_TRIPS);
    let device_s = (last_answer.status.t_us - first_answer.status.t_us) as f64 * 1e-6;
    let lost = session.client.losses();
    let damaged = [
        lost.frames_corrupt - lost_before.frames_corrupt,
        lost.frames_missing - lost_before.frames_missing,
        lost.frames_unreadable - lost_before.frames_unreadable,
        u64::from(last_answer.status.counters.frames_corrupt - first_answer.status.counters.frames_corrupt),
        u64::from(last_answer.status.counters.line_errors - first_answer.status.counters.line_errors),
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
    if let (Some(first_window), Some(last_window)) = (first_answer.within, last_answer.within) {
        // The host's time between the two answers: at least, at most.
        let host_s =
            [last_window[0].saturating_sub(first_window[1]), last_window[1].saturating_sub(first_window[0])];
        let [most, least] = host_s.map(|time| device_s / time.as_secs_f64());
        let ratio = 2.0 * device_s / (host_s[0] + host_s[1]).as_secs_f64();
        report.measure("clock_ratio", ratio);
        // A computer that was busy between request and answer does not make the device's clock wrong.
        if least > 1.0 + CLOCK_TOLERANCE || most < 1.0 - CLOCK_TOLERANCE {
            let measured = format!("{:+.1} % against this computer's clock", 100.0 * (ratio - 1.0));
            report.find(Finding::new("link.clock", None, measured));
        }
    }
    Ok(())
}

/// A status, and between which two times of the host's clock the device has answered.
struct Dated {
    status: Status,
    within: Option<[Duration; 2]>,
}

/// The answer with the shortest round trip among so many.
fn dated(session: &mut Session, answers: u32) -> Result<Dated, LinkError> {
    let mut best: Option<(Duration, Dated)> = None;
    for _ in 0..answers {
        let clock_before = session.operator.clock();
        let status = session.client.status()?;
        let window =
            clock_before.zip(session.operator.clock()).map(|(clock_before, after)| [clock_before, after]);
        let took = window.map_or(Duration::ZERO, |[clock_before, after]| after.saturating_sub(clock_before));
        if best.as_ref().is_none_or(|(least, _)| took <= *least) {
            best = Some((took, Dated { status, within: window }));
        }
    }
    match best {
        Some((_, dated)) => Ok(dated),
        None => Ok(Dated { status: session.client.status()?, within: None }),
    }
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
