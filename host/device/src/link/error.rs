//! Errors between this program and the device, each with its cause and its remedy in one line.

use super::port::{self, PortError};
use super::timeouts::{ANSWER_TIMEOUT, SILENCE_LIMIT};
use protocol::{Fault, Refusal, RetreatOutcome, TARE_CHANGE_PERCENT, TARE_ZERO_PERCENT, TareProblem};
use std::io;

/// Error of a link.
#[derive(Debug, thiserror::Error)]
pub enum LinkError {
    /// The port cannot be opened.
    #[error(transparent)]
    Port(#[from] PortError),
    /// No answer to the hello.
    #[error(
        "{port}: no answer to {tries} hellos ({bytes} bytes received, none of them a valid frame): \
         is this the needle guide, is its firmware flashed, is the rate {rate} baud?",
        rate = port::BAUD
    )]
    NoAnswer {
        /// The port's name.
        port: String,
        /// Hellos sent.
        tries: u32,
        /// Bytes that arrived meanwhile.
        bytes: u64,
    },
    /// The device speaks another version of the protocol.
    #[error(
        "{port}: the device uses protocol version {theirs}, this program uses {ours}: \
         flash the matching firmware or use the matching `guide`"
    )]
    OtherVersion {
        /// The port's name.
        port: String,
        /// The device's version.
        theirs: u16,
        /// This program's version.
        ours: u16,
    },
    /// The version is the same but the message types differ.
    #[error(
        "{port}: the device's message types differ from this program's though both state protocol version {version} \
         (firmware commit {commit}): build both from the same source"
    )]
    OtherSchema {
        /// The port's name.
        port: String,
        /// The version both claim.
        version: u16,
        /// Commit of the firmware.
        commit: String,
    },
    /// A command was not answered.
    #[error("{port}: the device did not answer `{command}` in {tries} tries of {ANSWER_TIMEOUT:?}")]
    Unanswered {
        /// The port's name.
        port: String,
        /// The command.
        command: &'static str,
        /// Number of times it was sent.
        tries: u32,
    },
    /// A request was acknowledged, but its answer did not come.
    #[error(
        "{port}: the device acknowledged `{command}` {tries} times without its answer: the line loses frames, or firmware and \
         program differ"
    )]
    AnswerMissing {
        /// The port's name.
        port: String,
        /// The request.
        command: &'static str,
        /// Number of times it was requested.
        tries: u32,
    },
    /// A command was refused.
    #[error("the device refused `{command}`: {}", explain_refusal(*refusal))]
    Refused {
        /// The command.
        command: &'static str,
        /// Why.
        refusal: Refusal,
    },
    /// The port disappeared.
    #[error("{port}: the port disappeared ({cause}): was the cable pulled or the board switched off?")]
    Gone {
        /// The port's name.
        port: String,
        /// The system's error.
        cause: io::Error,
    },
    /// The device fell silent while it streamed or had to answer.
    #[error("{port}: the device has sent nothing for {SILENCE_LIMIT:?}: check the cable and its supply")]
    Silent {
        /// The port's name.
        port: String,
    },
    /// The device restarted in the middle of something.
    #[error(
        "{port}: the device restarted during the run: `guide status` reports why; check its supply, then `guide clear`"
    )]
    Restarted {
        /// The port's name.
        port: String,
    },
    /// A batch was intact but its samples are not what it states.
    #[error("{port}: a batch of samples cannot be unpacked: firmware and program differ")]
    Garbled {
        /// The port's name.
        port: String,
    },
    /// A program ended before its last step.
    #[error("the motion program was ended by {}", .fault.map_or("a stop".to_owned(), explain_latched))]
    ProgramEnded {
        /// The fault that ended it; `None` for a stop.
        fault: Option<Fault>,
    },
    /// A tare among the steps of a program was rejected, which ended the program.
    #[error("{}", explain_tare(*problem, *zero_n))]
    TareRejected {
        /// Why.
        problem: Option<TareProblem>,
        /// The zero that was found, newtons from the calibration's zero.
        zero_n: [f64; 2],
    },
    /// A limit that the device cannot take.
    #[error("limit of the {name}: {value} {unit}, expected {least} to {most} {unit}")]
    Limit {
        /// Name of the constant.
        name: &'static str,
        /// The requested value.
        value: f64,
        /// Least value.
        least: f64,
        /// Greatest value.
        most: f64,
        /// Unit of the three.
        unit: &'static str,
    },
    /// A limit of the force that no position can meet.
    #[error(
        "limit of the force: {force_n} N, expected more than the {zero_n:.3} N between the tare and the calibration's zero, from which the device \
         counts too: take a larger limit, tare without load, or calibrate the sensor"
    )]
    LimitBelowZero {
        /// The requested limit.
        force_n: f64,
        /// Largest distance of the zero along either axis.
        zero_n: f64,
    },
    /// A device that was to restart has not.
    #[error(
        "{port}: the device has not restarted with its new calibration ({}): reset it, then see `guide calibration`",
        .cause.as_ref().map_or("it still answers as before".to_owned(), |cause| cause.to_string())
    )]
    NotBack {
        /// The port's name.
        port: String,
        /// Why it cannot be reached; `None` where it answers and has not restarted.
        cause: Option<Box<LinkError>>,
    },
    /// A device has restarted and works with another calibration than it was sent.
    #[error(
        "{port}: the calibration {sent} was sent, but the device works with {theirs} after its restart: \
         it was not stored; try again, then check the board"
    )]
    CalibrationNotKept {
        /// The port's name.
        port: String,
        /// The calibration that was sent.
        sent: String,
        /// The one that the device works with.
        theirs: String,
    },
    /// The user requested a stop.
    #[error("interrupted: the guide was stopped")]
    Interrupted,
    /// A message that this program built cannot be encoded.
    #[error("a command cannot be encoded: {0}")]
    Encode(#[from] protocol::EncodeError),
}

/// A refusal in words, with what to do about it.
pub fn explain_refusal(refusal: Refusal) -> String {
    match refusal {
        Refusal::OtherBoot => {
            "it has restarted since the hello, or other programs have connected since; connect again".to_owned()
        }
        Refusal::Faulted { fault } => explain_latched(fault),
        Refusal::Busy => "a motion program, a retreat or a pulse waits or runs, which `guide stop` ends, or the device is about to restart".to_owned(),
        Refusal::OutOfTravel => {
            "the target lies beyond the travel of the guide; a retreat leads towards the middle of the travel, and without a force \
             reading only where the axis has moved before"
                .to_owned()
        }
        Refusal::OutOfRange => "a speed, a duration, a distance or the number of steps is zero or too large, or the start is more \
                                than an hour ahead"
            .to_owned(),
        Refusal::ProgramMismatch => {
            "the steps it holds differ from those that were sent; load them again".to_owned()
        }
        Refusal::TooLate => "the start time has passed on its clock; see `guide status`".to_owned(),
        Refusal::CauseRemains => "the cause of the fault is still there, or an axis still moves".to_owned(),
        Refusal::CalibrationInvalid => {
            "the calibration it received differs from the one sent, or its constants are implausible".to_owned()
        }
        Refusal::IdUsed => "its id was used before; connect again".to_owned(),
        Refusal::NotUnderLoad => {
            "there is no load to retreat from, or another cause to stop as well; see `guide status`".to_owned()
        }
        Refusal::CalibrationNotAcknowledged => {
            "no calibration is stored on it, so that it would move by the constants of the rig as designed; store one with \
             `guide calibration --store FILE`, or give `--nominal` to work with those constants until its next start"
                .to_owned()
        }
        Refusal::Unreadable => "it cannot read the command; firmware and program differ".to_owned(),
    }
}

/// A fault in words.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct FaultText {
    /// Cause of the fault.
    pub cause: &'static str,
    /// Remedy, before `guide clear`.
    pub remedy: &'static str,
}

/// Cause and remedy of a fault.
pub fn fault_text(fault: Fault) -> FaultText {
    let (cause, remedy) = match fault {
        Fault::EmergencyStop => ("the emergency stop is pressed or its wire is open", "release it"),
        Fault::ForceSensor => (
            "the force converter gives no valid readings, or readings that no motion explains",
            "check its cable and supply",
        ),
        Fault::ForceRange => (
            "the force is beyond the sensor's range or its converter is saturated",
            "`guide retreat` unloads the guide; by hand: open the clamp of the needle",
        ),
        Fault::Potentiometer => {
            ("a potentiometer reads beyond its track or jumps", "check its wires, then home the guide")
        }
        Fault::MoveTimeout => {
            ("an axis did not reach its target in time", "check for a jam and the motor supply")
        }
        Fault::ForceLimit => (
            "the force exceeds the limit that is set",
            "`guide retreat` unloads the guide, or see `guide limits`",
        ),
        Fault::Travel => (
            "an axis is driven beyond its travel",
            "check the bridge and the calibration, then home the guide",
        ),
        Fault::Stall => {
            ("an axis is driven and does not move", "check for a jam, the motor's wires and its supply")
        }
        Fault::FollowingError => {
            ("an axis cannot follow its setpoint", "check the motor supply, or reduce the speed")
        }
        Fault::ForceStuck => (
            "the force converter repeats its readings",
            "check the force sensor's cable, the converter and its clock",
        ),
        Fault::HostSilent => {
            ("no command was accepted from the host that started the program", "check the cable and the host")
        }
        Fault::Restarted => {
            ("the device restarted by itself", "see the reset reason and the last panic, check the supply")
        }
        Fault::Overrun => ("the control task was late", "see the load in `guide status`; report it"),
        Fault::MotorHot => {
            ("a motor has used up its duty cycle", "let it cool: `guide status` reports for how long")
        }
        Fault::WrongWay => (
            "an axis moves against the direction in which it is driven",
            "check the sign of its position table in the calibration, and the wires of motor and potentiometer",
        ),
        Fault::CalibrationLost => (
            "the stored calibration, or a newer one than is used, cannot be read any more",
            "store it again with `guide calibration --store FILE`, or give `--nominal` to work with the constants that `guide status` \
             names",
        ),
    };
    FaultText { cause, remedy }
}

/// A fault in one line: number, cause, remedy.
pub fn explain_fault(fault: Fault) -> String {
    let FaultText { cause, remedy } = fault_text(fault);
    format!("fault {} ({cause}: {remedy})", fault as u8)
}

/// A latched fault in one line, with what ends it.
pub fn explain_latched(fault: Fault) -> String {
    format!("{}; then `guide clear`", explain_fault(fault))
}

/// A rejected tare in words, with what to do.
fn explain_tare(problem: Option<TareProblem>, [x_n, y_n]: [f64; 2]) -> String {
    let offsets = format!("x {x_n:+.3} N, y {y_n:+.3} N from the calibration's zero");
    match problem {
        Some(TareProblem::FarFromZero) => format!(
            "the tare was rejected ({offsets}): the zero may lie within {TARE_ZERO_PERCENT} % of the rated range; unload the needle, \
             or correct the force sensor's offset"
        ),
        Some(TareProblem::Settling) => format!(
            "the tare was rejected ({offsets}): the force changed by more than {TARE_CHANGE_PERCENT} % of the rated range meanwhile; \
             wait until it has settled"
        ),
        None => {
            "a tare was rejected: unload the needle, wait until the force has settled, tare again".to_owned()
        }
    }
}

/// Why there is nowhere to retreat to.
pub const AT_THE_MIDDLE: &str = "the guide is at the middle of its travel: if the load remains, open the needle's clamp, or see `guide limits`";

/// The end of a retreat in words.
pub fn explain_retreat(outcome: RetreatOutcome) -> &'static str {
    match outcome {
        RetreatOutcome::Unloaded => "unloaded: `guide clear` clears the fault",
        RetreatOutcome::Moved => "moved; retreat again if the load remains",
        RetreatOutcome::ForceNotFalling => {
            "the force does not fall towards the middle of the travel: open the needle's clamp, or see `guide limits`"
        }
        RetreatOutcome::Stopped => "stopped: see `guide status`",
    }
}
