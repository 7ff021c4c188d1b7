//! Messages that the device sends unsolicited, in SI units.

use protocol::{Hello, Samples, State, Status};

/// Messages that the device sends unsolicited.
#[derive(Debug, Clone, PartialEq)]
pub enum Telemetry {
    /// Samples in SI units.
    Samples(Batch),
    /// Something happened.
    Event(protocol::Event),
    /// State, counters, load and stiffness: ten times a second while samples are streamed.
    Status(Box<Status>),
}

impl Telemetry {
    /// Device time of it, microseconds: of the last sample of a batch.
    pub(crate) fn device_us(&self) -> Option<u64> {
        match self {
            Self::Samples(batch) => batch.points.last().map(|point| (point.time_s * 1e6) as u64),
            Self::Event(event) => Some(event.t_us),
            Self::Status(status) => Some(status.t_us),
        }
    }
}

/// Consecutive samples of one state and step.
#[derive(Debug, Clone, PartialEq)]
pub struct Batch {
    /// State of the controller.
    pub state: State,
    /// Program step; `None` outside a program.
    pub step: Option<u8>,
    /// Samples that went missing between the batch before and this one.
    pub lost_before: u64,
    /// The samples, in order.
    pub points: Vec<Point>,
}

/// One sample.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Point {
    /// Device time, seconds since its start.
    pub time_s: f64,
    /// Displacement of guide 2 along x and y, metres.
    pub displacement_m: [f64; 2],
    /// Force along x and y relative to the tare, newtons.
    pub force_n: [f64; 2],
    /// There was no valid reading of the force, which repeats the one before.
    pub repeats_force: bool,
}

/// A batch in SI units; `None` where its packed bytes are broken.
pub(crate) fn to_batch(hello: &Hello, samples: &Samples, lost_before: u64) -> Option<Batch> {
    let unpacked = samples.unpack(hello.sample_period_us).ok()?;
    let points = unpacked
        .map(|(t_us, sample)| Point {
            time_s: t_us as f64 * 1e-6,
            displacement_m: displacement_m(hello, sample.position_counts),
            force_n: force_n(hello, sample.force_counts),
            repeats_force: sample.repeats_force,
        })
        .collect();
    let step = (samples.step != u8::MAX).then_some(samples.step);
    Some(Batch { state: samples.state, step, lost_before, points })
}

/// Displacement in SI units.
pub(super) fn displacement_m(hello: &Hello, counts: [i32; 2]) -> [f64; 2] {
    counts.map(|count| f64::from(count) * f64::from(hello.scales.position_nm_per_count) * 1e-9)
}

/// Force in SI units.
pub(super) fn force_n(hello: &Hello, counts: [i32; 2]) -> [f64; 2] {
    counts.map(|count| f64::from(count) * f64::from(hello.scales.force_nn_per_count) * 1e-9)
}
