//! Bring-up of a rig: from a soldered board to the first motion, step by step, with every fault named.
//!
//! Each step measures and judges; a finding states the fault, the measured values and the remedy. A blocking finding prevents
//! the steps that depend on it, so that nothing moves with wiring that is known to be wrong. Before the position loop has been
//! checked, the only motions are the device's own bounded pulses ([`protocol::Request::Pulse`]).
//!
//! | step | module |
//! |---|---|
//! | link, supply | [`wires`] |
//! | emergency stop | [`stop`] |
//! | force converter, potentiometers at rest | [`rest`] |
//! | motors by pulses | [`pulses`] |
//! | position loop, force channels against motion | [`moves`] |
//! | calibration stored and read back | [`session`] |
//! | their order | [`sequence`] |
//!
//! A person's actions (press the emergency stop, clear the way) are requested through [`Operator`], so that tests stand
//! in for the person.

mod findings;
mod moves;
mod pulses;
mod report;
mod rest;
mod sequence;
mod series;
mod session;
mod stop;
mod wires;

pub use findings::{CATALOGUE, CatalogueEntry, Finding};
pub use report::{Device, Measure, Report, StepReport, StepResult};
pub use sequence::run;

use crate::link::LinkError;
use std::io;
use std::time::Duration;

/// A step of the bring-up, in the order in which they run.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Step {
    /// The serial link, and the device's clock.
    Link,
    /// The cause of the device's last start.
    Supply,
    /// The emergency stop, pressed and released.
    EmergencyStop,
    /// The force converter at rest.
    Converter,
    /// The potentiometers at rest.
    Potentiometers,
    /// Each motor in single short pulses.
    Motors,
    /// The position loop in small moves.
    Loop,
    /// The force channels against those moves.
    Force,
    /// A calibration stored and read back, where one is given.
    Store,
}

impl Step {
    /// All steps.
    pub const ALL: [Self; 9] = [
        Self::Link,
        Self::Supply,
        Self::EmergencyStop,
        Self::Converter,
        Self::Potentiometers,
        Self::Motors,
        Self::Loop,
        Self::Force,
        Self::Store,
    ];

    /// Its name on the command line and in documents.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Link => "link",
            Self::Supply => "supply",
            Self::EmergencyStop => "stop",
            Self::Converter => "converter",
            Self::Potentiometers => "potentiometers",
            Self::Motors => "motors",
            Self::Loop => "loop",
            Self::Force => "force",
            Self::Store => "store",
        }
    }

    /// Announcement for the operator: the moving axis, and the largest distance and force.
    pub const fn announcement(self) -> &'static str {
        match self {
            Self::Link => "streams samples for 3 s; nothing moves",
            Self::Supply => "reads why the device last started; nothing moves",
            Self::EmergencyStop => "waits for the emergency stop to be pressed and released; nothing moves",
            Self::Converter => "records the force for 4 s at rest; nothing moves",
            Self::Potentiometers => "records the positions at rest; nothing moves",
            Self::Motors => {
                "pulses each motor for at most 50 ms at 35 % duty, both ways: 0.3 mm and 1 N at most, ended by the device itself"
            }
            Self::Loop => "moves each axis by 0.8 mm both ways at 2 mm/s, within the force limit",
            Self::Force => "judges the forces of the moves before; nothing moves",
            Self::Store => "stores the calibration, restarts the device and reads it back; nothing moves",
        }
    }

    /// The steps whose blocking findings prevent it; for a step that moves the guide, all steps before it.
    pub const fn needs(self) -> &'static [Self] {
        match self {
            Self::Link | Self::Supply => &[],
            Self::EmergencyStop | Self::Converter | Self::Potentiometers => &[Self::Link],
            Self::Motors => Self::ALL.split_at(5).0,
            Self::Loop => Self::ALL.split_at(6).0,
            Self::Force => Self::ALL.split_at(7).0,
            Self::Store => Self::ALL.split_at(8).0,
        }
    }
}

/// Requests to the person at the rig.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Prompt {
    /// Press the emergency stop and hold it.
    PressStop,
    /// Release the emergency stop.
    ReleaseStop,
    /// Allow this step to move the guide.
    Allow(Step),
}

/// Reason for which a bring-up ended early. The device has been stopped, unless the link is lost; then the device ends its
/// motion by its host timeout.
#[derive(Debug, thiserror::Error)]
pub enum BringupError {
    /// The device cannot be reached, speaks another protocol, or the link was lost.
    #[error(transparent)]
    Link(#[from] LinkError),
    /// The user interrupted it.
    #[error("interrupted in `{step}`: the guide is stopped")]
    Interrupted {
        /// The step under way.
        step: &'static str,
    },
    /// The results of the steps so far cannot be written.
    #[error("the result cannot be written")]
    Keep(#[from] io::Error),
}

/// The person at the rig, and the clock on the wall.
pub trait Operator {
    /// Requests it; false where it was not done or is not allowed.
    fn confirm(&mut self, prompt: Prompt) -> bool;
    /// A step begins; `report` holds those before it, and states that this one is under way.
    ///
    /// # Errors
    /// Where that cannot be kept: the bring-up ends.
    fn begins(&mut self, step: Step, report: &Report) -> io::Result<()>;
    /// The user interrupts.
    fn is_interrupted(&self) -> bool;
    /// Time of the host's clock; `None` where the device's is not to be compared with it.
    fn clock(&mut self) -> Option<Duration>;
}
