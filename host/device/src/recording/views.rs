//! The device's messages, for people and tools: units instead of counts, names instead of numbers.

use super::error::RecordingError;
use crate::link::condition::{Condition, ErrorCounters};
use crate::link::error::explain_fault;
use crate::link::{Point, display};
use protocol::{
    Envelope, Event, EventKind, Hello, MAX_FRAME_TO_HOST, Outcome, PulseOutcome, RetreatOutcome, State,
    Status, TareProblem,
};
use serde::{Deserialize, Serialize};

/// Description of a recording and its rig.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct RecordingInfo {
    /// `guide.recording/1`.
    pub schema: String,
    /// The sub-command that recorded: `record` or `acquire`.
    pub command: String,
    /// Name of the run in its session.
    pub run: String,
    /// Insertion depth of the needle, millimetres.
    pub depth_mm: f64,
    /// Needle, guides and noise, as a session states them.
    pub rig_toml: String,
    /// Version of the program that recorded.
    pub program_version: String,
    /// The force had a zero that was measured; recordings of before do not state it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub tared: Option<bool>,
}

impl RecordingInfo {
    /// A recording by this program.
    pub fn new(command: &str, run: &str, depth_mm: f64, rig_toml: String) -> Self {
        Self {
            schema: "guide.recording/1".to_owned(),
            command: command.to_owned(),
            run: run.to_owned(),
            depth_mm,
            rig_toml,
            program_version: env!("CARGO_PKG_VERSION").to_owned(),
            tared: None,
        }
    }

    /// With whether the force had a zero that was measured.
    #[must_use]
    pub fn with_tared(self, tared: bool) -> Self {
        Self { tared: Some(tared), ..self }
    }
}

/// An event.
#[derive(Debug, Default, Serialize)]
pub struct EventView {
    time_s: f64,
    kind: &'static str,
    step: Option<u8>,
    outcome: Option<&'static str>,
    fault: Option<u8>,
    cause: Option<String>,
    zero_x_n: Option<f64>,
    zero_y_n: Option<f64>,
    sd_x_n: Option<f64>,
    sd_y_n: Option<f64>,
    readings: Option<u32>,
}

impl EventView {
    /// The view of an event; forces in newtons only where a hello has stated what a count is.
    pub fn new(event: &Event, hello: Option<&Hello>) -> Self {
        let view = Self { time_s: seconds(event.t_us), ..Self::default() };
        fn newtons(counts: f64, hello: &Option<&Hello>) -> Option<f64> {
            hello.map(|hello| counts * f64::from(hello.scales.force_nn_per_count) * 1e-9)
        }
        match event.kind {
            EventKind::StepStarted { index } => Self { kind: "step_started", step: Some(index), ..view },
            EventKind::StepEnded { index } => Self { kind: "step_ended", step: Some(index), ..view },
            EventKind::TareRejected { tare, problem } => Self {
                kind: "tare_rejected",
                cause: Some(
                    match problem {
                        TareProblem::FarFromZero => "far from zero",
                        TareProblem::Settling => "settling",
                    }
                    .to_owned(),
                ),
                ..Self::new(&Event { t_us: event.t_us, kind: EventKind::Tared(tare) }, hello)
            },
            EventKind::RetreatEnded { outcome } => {
                let outcome = match outcome {
                    RetreatOutcome::Unloaded => "unloaded",
                    RetreatOutcome::Moved => "moved",
                    RetreatOutcome::ForceNotFalling => "force_not_falling",
                    RetreatOutcome::Stopped => "stopped",
                };
                Self { kind: "retreat_ended", outcome: Some(outcome), ..view }
            }
            EventKind::PulseEnded(report) => {
                let outcome = match report.outcome {
                    PulseOutcome::Completed => "completed",
                    PulseOutcome::Reached => "reached",
                    PulseOutcome::OtherAxis => "other_axis",
                    PulseOutcome::Force => "force",
                    PulseOutcome::Stopped => "stopped",
                };
                Self { kind: "pulse_ended", outcome: Some(outcome), ..view }
            }
            EventKind::Tared(tare) => Self {
                kind: "tared",
                zero_x_n: newtons(f64::from(tare.zero_counts[0]), &hello),
                zero_y_n: newtons(f64::from(tare.zero_counts[1]), &hello),
                sd_x_n: newtons(f64::from(tare.sd_counts[0]), &hello),
                sd_y_n: newtons(f64::from(tare.sd_counts[1]), &hello),
                readings: Some(tare.readings),
                ..view
            },
            EventKind::ProgramEnded { outcome } => {
                let outcome = match outcome {
                    Outcome::Completed => "completed",
                    Outcome::Stopped => "stopped",
                    Outcome::Faulted => "faulted",
                    Outcome::TareRejected => "tare_rejected",
                };
                Self { kind: "program_ended", outcome: Some(outcome), ..view }
            }
            EventKind::Faulted { fault } => {
                Self { kind: "faulted", fault: Some(fault as u8), cause: Some(explain_fault(fault)), ..view }
            }
        }
    }
}

/// A status.
#[derive(Debug, Serialize)]
pub struct StatusView {
    time_s: f64,
    state: &'static str,
    step: Option<u8>,
    fault: Option<u8>,
    displacement_x_mm: f64,
    displacement_y_mm: f64,
    force_x_n: f64,
    force_y_n: f64,
    streaming: bool,
    #[serde(flatten)]
    condition: Condition,
    stiffness_x_n_per_mm: Option<f64>,
    stiffness_y_n_per_mm: Option<f64>,
    counters: ErrorCounters,
}

impl StatusView {
    /// The view of a status.
    pub fn new(status: &Status, hello: &Hello) -> Self {
        fn mm(counts: i32, hello_scales_position_nm_per_count: u32) -> f64 {
            f64::from(counts) * f64::from(hello_scales_position_nm_per_count) * 1e-6
        }
        fn newtons(counts: i32, hello_scales_force_nn_per_count: u32) -> f64 {
            f64::from(counts) * f64::from(hello_scales_force_nn_per_count) * 1e-9
        }
        let [position_x, position_y] = status.position_counts;
        let [force_x, force_y] = status.force_counts;
        let [stiffness_x, stiffness_y] =
            status.stiffness.map(|axis| axis.map(|stiffness| f64::from(stiffness.slope_mn_per_m) * 1e-6));
        Self {
            time_s: seconds(status.t_us),
            state: display::state(status.state),
            step: step(status.step),
            fault: status.fault.map(|fault| fault as u8),
            displacement_x_mm: mm(position_x, hello.scales.position_nm_per_count),
            displacement_y_mm: mm(position_y, hello.scales.position_nm_per_count),
            force_x_n: newtons(force_x, hello.scales.force_nn_per_count),
            force_y_n: newtons(force_y, hello.scales.force_nn_per_count),
            streaming: status.streaming,
            condition: status.into(),
            stiffness_x_n_per_mm: stiffness_x,
            stiffness_y_n_per_mm: stiffness_y,
            counters: (&status.counters).into(),
        }
    }
}

/// A hello, and the frame that it came in.
#[derive(Debug, Serialize)]
pub struct HelloView<'a> {
    time_s: f64,
    boot_id: u32,
    protocol_version: u16,
    firmware_version: &'a str,
    commit: &'a str,
    board: &'a str,
    reset_reason: &'static str,
    sample_period_us: u32,
    position_nm_per_count: u32,
    force_nn_per_count: u32,
    travel_mm: f64,
    force_range_n: f64,
    calibration_id: &'a str,
    calibration_crc: String,
    last_panic: Option<&'a str>,
    frame_hex: String,
}

impl<'a> HelloView<'a> {
    /// The view of a hello that came in this frame.
    pub fn new(boot_id: u32, hello: &'a Hello, frame: &[u8]) -> Self {
        Self {
            time_s: seconds(hello.now_us),
            boot_id,
            protocol_version: hello.protocol_version,
            firmware_version: hello.firmware_version.as_str(),
            commit: hello.commit.as_str(),
            board: hello.board.as_str(),
            reset_reason: display::reset_reason(hello.reset_reason),
            sample_period_us: hello.sample_period_us,
            position_nm_per_count: hello.scales.position_nm_per_count,
            force_nn_per_count: hello.scales.force_nn_per_count,
            travel_mm: f64::from(hello.scales.travel_um) * 1e-3,
            force_range_n: f64::from(hello.scales.force_range_mn) * 1e-3,
            calibration_id: hello.calibration.id.as_str(),
            calibration_crc: format!("{:08x}", hello.calibration.crc),
            last_panic: hello.last_panic.as_ref().map(|text| text.as_str()),
            frame_hex: frame.iter().map(|byte| format!("{byte:02x}")).collect(),
        }
    }
}

/// The frame in a view of a hello.
#[derive(Debug, Deserialize)]
pub struct HelloFrame {
    frame_hex: String,
}

impl HelloFrame {
    /// Its bytes; `None` where it is no frame.
    pub fn bytes(&self) -> Option<Vec<u8>> {
        let digits: Option<Vec<u8>> =
            self.frame_hex.chars().map(|digit| digit.to_digit(16).map(|value| value as u8)).collect();
        let digits = digits.filter(|digits| digits.len() <= 2 * MAX_FRAME_TO_HOST)?;
        digits
            .chunks(2)
            .map(|pair| match pair {
                [high, low] => Some(high << 4 | low),
                _ => None,
            })
            .collect()
    }
}

/// Appends a sample, in the form of its schema.
pub fn sample(point: &Point, step: Option<u8>, state: State, lost_before: u64, out: &mut Vec<u8>) {
    let [x_m, y_m] = point.displacement_m;
    let [force_x_n, force_y_n] = point.force_n;
    for value in [1e3 * x_m, 1e3 * y_m, force_x_n, force_y_n] {
        out.extend_from_slice(&(value as f32).to_le_bytes());
    }
    out.extend_from_slice(&step.map_or(-1, i16::from).to_le_bytes());
    out.push(state as u8);
    out.extend_from_slice(&u32::try_from(lost_before).unwrap_or(u32::MAX).to_le_bytes());
}

/// A view as JSON.
pub fn json(view: &impl Serialize) -> Result<Vec<u8>, RecordingError> {
    serde_json::to_vec(view).map_err(RecordingError::View)
}

/// The bytes of an envelope on the wire. Their encoding has one form only, so that these are the bytes it came in.
pub fn frame<'a>(
    envelope: &Envelope,
    buffer: &'a mut [u8; MAX_FRAME_TO_HOST],
) -> Result<&'a [u8], RecordingError> {
    Ok(protocol::encode_envelope(envelope, buffer)?)
}

fn seconds(t_us: u64) -> f64 {
    t_us as f64 * 1e-6
}

fn step(step: u8) -> Option<u8> {
    (step != u8::MAX).then_some(step)
}
