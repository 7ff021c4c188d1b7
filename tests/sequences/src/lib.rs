//! Random sequences of commands of the protocol, with loads, tares, calibrations, faults, restarts and old frames, against
//! what must hold for any sequence; and the plant on which they are carried out.
//!
//! A sequence is one to [`MAX_ACTS`] acts ([`acts`]), each a few commands and causes, and then the recovery from any
//! latched fault. It depends on its seed alone, or on the bytes of a fuzzer, and is carried out by a [`Target`]: the
//! controller in this process ([`in_process`]), or the firmware in QEMU. Both have the same [`rig`]: a [`plant`] that
//! knows the true force and position, written from the documents and without the simulated rig, and [`sensors`] that
//! drop out, freeze, saturate and hum. The conditions are in [`judge`]:
//!
//! * no force beyond the limit, counted from the calibration's zero, by more than the stated overshoot;
//! * no rest beyond the travel, and no motion that is the wrong way for more than 0.3 mm;
//! * no latched fault that goes without its clear, nothing driven in a fault but a retreat, no clear before the guide is at rest;
//! * no pulse of a motor that moves it by more than its bound;
//! * no program that starts twice, or without a request;
//! * no restart that forgets a fault or how the motors were driven;
//! * every command is answered once, and every fault is cleared by the manual's recovery, under the load that caused it.
//!
//! # Example
//!
//! ```
//! let done = sequences::run_in_process(7)?;
//! assert!(done.commands > 0);
//! # Ok::<(), sequences::Violation>(())
//! ```
#![forbid(unsafe_code)]
#![deny(missing_docs)]

pub mod acts;
pub mod in_process;
pub mod judge;
pub mod plant;
pub mod random;
pub mod rig;
pub mod sensors;

use acts::Sequence;
use control::calibration::counts_of_mn;
use protocol::{CalibrationRecord, Command, Refusal, Request};
use random::Random;
use sensors::Failing;
use std::fmt;

/// Most acts of a sequence.
pub const MAX_ACTS: u32 = 12;

/// Condition that does not hold.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Violation(pub String);

impl fmt::Display for Violation {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

impl std::error::Error for Violation {}

/// Outcome of something that must hold throughout.
pub type Checked<T> = Result<T, Violation>;

/// Disturbances of the rig beside the commands.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Disturbances {
    /// The emergency stop is pressed.
    pub emergency_stop: bool,
    /// The wire of this potentiometer is open.
    pub potentiometer_open: Option<usize>,
    /// Behaviour of the force converter.
    pub converter: Converter,
    /// Failure of the force channels.
    pub force: Option<Failing>,
    /// Failure of the potentiometers.
    pub potentiometers: Option<Failing>,
    /// Hum of the mains on the force channels, newtons.
    pub hum_n: f64,
}

/// Behaviour of the force converter.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum Converter {
    /// It measures.
    #[default]
    Healthy,
    /// It gives nothing new.
    Silent,
    /// Its first channel is saturated.
    Saturated,
    /// It was saturated for one reading and has been silent since.
    SaturatedOnce,
}

/// State of the device and its rig at one time.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Condition {
    /// Device time, microseconds.
    pub now_us: u64,
    /// Latched fault.
    pub fault: Option<protocol::Fault>,
    /// True position of both axes, micrometres.
    pub position_um: [f32; 2],
    /// Force per displacement, newtons per micrometre.
    pub stiffness_n_per_um: f32,
    /// Time until the motors have cooled, seconds.
    pub cools_in_s: [u16; 2],
    /// Zero of the latest tare, from the calibration's, force counts.
    pub zero_counts: [i32; 2],
    /// Force limit, millinewtons.
    pub limit_mn: u32,
}

impl Condition {
    /// The larger zero of the tare as a share of the force limit: from 2 on no force is within the limit of both zeros.
    pub fn zero_per_limit(&self) -> f32 {
        let larger = self.zero_counts.into_iter().map(i32::unsigned_abs).fold(0, u32::max);
        larger as f32 / counts_of_mn(self.limit_mn) as f32
    }
}

/// A device with a rig, which sequences are carried out on. Each of its methods checks what must hold while time passes.
pub trait Target {
    /// Sends a command that is new in this connection, and waits for its answer.
    ///
    /// # Errors
    /// What does not hold.
    fn request(&mut self, request: Request) -> Checked<Result<(), Refusal>>;

    /// Sends a frame again that was sent before, or one of another connection; its answer does not matter.
    ///
    /// # Errors
    /// What does not hold.
    fn replay(&mut self, command: Command) -> Checked<()>;

    /// Lets milliseconds pass, with a sign of life of the host now and then.
    ///
    /// # Errors
    /// What does not hold.
    fn pass(&mut self, ms: u32) -> Checked<()>;

    /// The host is silent for so long.
    ///
    /// # Errors
    /// What does not hold.
    fn silence(&mut self, ms: u32) -> Checked<()>;

    /// Sets what acts on the rig.
    ///
    /// # Errors
    /// What does not hold.
    fn set(&mut self, causes: Disturbances) -> Checked<()>;

    /// The device starts again by itself, as after a panic or when the supply sagged.
    ///
    /// # Errors
    /// What does not hold.
    fn reset(&mut self) -> Checked<()>;

    /// The present condition.
    ///
    /// # Errors
    /// What does not hold.
    fn condition(&mut self) -> Checked<Condition>;

    /// The commands that were sent so far, the latest last; a few hundred at most.
    fn sent(&self) -> &[Command];

    /// The calibration that the device works with.
    fn record(&self) -> &CalibrationRecord;

    /// Whether minutes may pass: a motor is heated and cools.
    fn is_patient(&self) -> bool;
}

/// Counts of a campaign.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct CampaignCounts {
    /// Sequences.
    pub sequences: u64,
    /// Acts of them.
    pub acts: u64,
    /// Commands, repeated and old ones included.
    pub commands: u64,
    /// Faults that were left.
    pub faults: u64,
    /// Restarts.
    pub restarts: u64,
    /// Device time, milliseconds.
    pub device_ms: u64,
}

impl CampaignCounts {
    /// Both together.
    pub fn add(&mut self, other: Self) {
        self.sequences += other.sequences;
        self.acts += other.acts;
        self.commands += other.commands;
        self.faults += other.faults;
        self.restarts += other.restarts;
        self.device_ms += other.device_ms;
    }
}

impl fmt::Display for CampaignCounts {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { sequences, acts, commands, faults, restarts, device_ms } = self;
        write!(
            f,
            "{sequences} sequences: {acts} acts, {commands} commands, {faults} faults left, {restarts} restarts, {:.1} h of device time",
            *device_ms as f64 / 3_600_000.0
        )
    }
}

/// Carries out the sequence of these random numbers; acts and faults left.
///
/// # Errors
/// What does not hold, with the number of the act.
pub fn run<T: Target>(random: Random, target: &mut T) -> Checked<[u64; 2]> {
    let mut sequence = Sequence::new(random, target);
    let count = sequence.length();
    for act in 0..count {
        sequence.act().map_err(|found| Violation(format!("act {act}: {found}")))?;
    }
    sequence.leave().map_err(|found| Violation(format!("at its end: {found}")))?;
    Ok([count.into(), sequence.faults_cleared()])
}

/// Carries out the sequence of a seed on a controller of its own.
///
/// # Errors
/// As [`run`], with the seed.
pub fn run_in_process(seed: u64) -> Checked<CampaignCounts> {
    on_controller(seed, Random::new(seed)).map_err(|found| Violation(format!("sequence {seed}, {found}")))
}

/// Carries out the sequence of a fuzzer's bytes.
///
/// # Panics
/// What does not hold.
pub fn run_bytes(bytes: &[u8]) {
    if let Err(violation) = on_controller(0, Random::after(bytes, 0)) {
        panic!("{violation}");
    }
}

fn on_controller(rig: u64, random: Random) -> Checked<CampaignCounts> {
    let mut bench = Box::new(in_process::Bench::new(rig));
    let [acts, faults] = run(random, &mut *bench)?;
    Ok(CampaignCounts { sequences: 1, acts, faults, ..bench.tally() })
}

#[cfg(test)]
mod tests;
