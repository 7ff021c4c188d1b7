//! The wire format is pinned: these bytes for these messages, both ways.

use super::{
    BUFFER, Golden, Verdict, bytes, check, gives, golden_commands::COMMANDS, golden_envelopes::ENVELOPES,
};
use crate::{
    CalibrationSource, Command, CommandReceiver, EncodeError, Envelope, EnvelopeReceiver, EventKind, Fault,
    Incoming, MAX_FRAME_TO_DEVICE, MAX_FRAME_TO_HOST, Message, Outcome, PulseOutcome, Receiver, Refusal,
    Request, ResetReason, RetreatOutcome, State, Step, TareProblem, encode_command, encode_envelope,
    program_crc, schema_hash,
};

type Encode<T> = for<'a> fn(&T, &'a mut [u8]) -> Result<&'a [u8], EncodeError>;

fn encodes<T>(golden: &[Golden<T>], encode: Encode<T>) -> Verdict {
    golden.iter().try_for_each(|Golden { message, frame }| {
        let (mut expected, mut buffer) = (BUFFER, BUFFER);
        let expected = bytes(frame, &mut expected)?;
        let encoded = encode(&message(), &mut buffer).map_err(|_| "a message was not encoded")?;
        check(encoded == expected, "a message has other bytes than its golden ones")
    })
}

fn decodes<T: Incoming + PartialEq, const N: usize>(
    golden: &[Golden<T>],
    mut receiver: Receiver<T, N>,
) -> Verdict {
    golden.iter().try_for_each(|Golden { message, frame }| {
        let mut buffer = BUFFER;
        gives(&mut receiver, bytes(frame, &mut buffer)?, &message())
    })
}

pub(super) fn commands_encode_to_their_golden_bytes() -> Verdict {
    encodes(COMMANDS, encode_command)
}

pub(super) fn commands_decode_from_their_golden_bytes() -> Verdict {
    decodes(COMMANDS, CommandReceiver::new())
}

pub(super) fn envelopes_encode_to_their_golden_bytes() -> Verdict {
    encodes(ENVELOPES, encode_envelope)
}

pub(super) fn envelopes_decode_from_their_golden_bytes() -> Verdict {
    decodes(ENVELOPES, EnvelopeReceiver::new())
}

/// The variants of an enum covered so far. If a variant is not listed, the code does not compile.
macro_rules! covered {
    ($name:ident: $type:ident { $($variant:ident)* }) => {
        #[derive(Default)]
        struct $name(u32);

        impl $name {
            const ALL: u32 = (1 << [$(stringify!($variant)),*].len()) - 1;

            fn add(&mut self, value: &$type) {
                match value { $($type::$variant { .. } => {})* }
                let mut bit = 1;
                $(if matches!(value, $type::$variant { .. }) { self.0 |= bit; } bit <<= 1;)*
                let _ = bit;
            }

            fn check(&self) -> Verdict {
                check(self.0 == Self::ALL, concat!(stringify!($type), ": a variant has no golden bytes"))
            }
        }
    };
}

covered!(Requests: Request {
    Hello Status Stream LoadStep Run Stop ClearFault Limits LoadCalibration StoreCalibration Calibration
    Retreat AcknowledgeCalibration Describe Safety Pulse
});
covered!(Steps: Step { Move Hold Tare Ramp });
covered!(Messages: Message { Hello Ack Refused Samples Event Status Calibration Connected Safety Description });
covered!(ResetReasons: ResetReason { PowerOn Pin Watchdog Software BrownOut Other });
covered!(Refusals: Refusal {
    OtherBoot Faulted Busy OutOfTravel OutOfRange ProgramMismatch TooLate CauseRemains Unreadable
    CalibrationInvalid IdUsed NotUnderLoad CalibrationNotAcknowledged
});
covered!(Faults: Fault {
    EmergencyStop ForceSensor ForceRange Potentiometer MoveTimeout ForceLimit Travel Stall FollowingError ForceStuck HostSilent
    Restarted Overrun MotorHot WrongWay CalibrationLost
});
covered!(States: State { Idle Pending Moving Holding Taring Faulted Retreating });
covered!(EventKinds: EventKind { StepStarted StepEnded Tared ProgramEnded Faulted TareRejected RetreatEnded PulseEnded });
covered!(PulseOutcomes: PulseOutcome { Completed Reached OtherAxis Force Stopped });
covered!(Outcomes: Outcome { Completed Stopped Faulted TareRejected });
covered!(TareProblems: TareProblem { FarFromZero Settling });
covered!(RetreatOutcomes: RetreatOutcome { Unloaded Moved ForceNotFalling Stopped });
covered!(CalibrationSources: CalibrationSource { Stored Nominal NominalAcknowledged });

pub(super) fn every_variant_has_golden_bytes() -> Verdict {
    let (mut requests, mut steps) = (Requests::default(), Steps::default());
    for Golden { message, .. } in COMMANDS {
        let Command { request, .. } = message();
        requests.add(&request);
        if let Request::LoadStep { step, .. } = request {
            steps.add(&step);
        }
    }
    requests.check()?;
    steps.check()?;

    let (mut messages, mut reasons, mut refusals) =
        (Messages::default(), ResetReasons::default(), Refusals::default());
    let (mut states, mut kinds, mut outcomes) =
        (States::default(), EventKinds::default(), Outcomes::default());
    let (mut problems, mut retreats, mut sources) =
        (TareProblems::default(), RetreatOutcomes::default(), CalibrationSources::default());
    let mut pulses = PulseOutcomes::default();
    let (mut refused_faults, mut event_faults) = (Faults::default(), Faults::default());
    for Golden { message, .. } in ENVELOPES {
        let Envelope { message, .. } = message();
        messages.add(&message);
        match message {
            Message::Hello(hello) => reasons.add(&hello.reset_reason),
            Message::Refused { refusal, .. } => {
                refusals.add(&refusal);
                if let Refusal::Faulted { fault } = refusal {
                    refused_faults.add(&fault);
                }
            }
            Message::Samples(samples) => states.add(&samples.state),
            Message::Event(event) => {
                kinds.add(&event.kind);
                match event.kind {
                    EventKind::ProgramEnded { outcome } => outcomes.add(&outcome),
                    EventKind::Faulted { fault } => event_faults.add(&fault),
                    EventKind::TareRejected { problem, .. } => problems.add(&problem),
                    EventKind::RetreatEnded { outcome } => retreats.add(&outcome),
                    EventKind::PulseEnded(report) => pulses.add(&report.outcome),
                    _ => {}
                }
            }
            Message::Safety(safety) => sources.add(&safety.calibration),
            Message::Ack { .. }
            | Message::Status(_)
            | Message::Calibration(_)
            | Message::Connected { .. }
            | Message::Description(_) => {}
        }
    }
    messages.check()?;
    reasons.check()?;
    refusals.check()?;
    refused_faults.check()?;
    states.check()?;
    kinds.check()?;
    outcomes.check()?;
    problems.check()?;
    retreats.check()?;
    pulses.check()?;
    sources.check()?;
    event_faults.check()
}

/// If this fails, a type has changed: raise [`crate::VERSION`] unless a variant was only appended, then pin the new hash.
pub(super) fn schema_hash_is_pinned() -> Verdict {
    let pinned = [0x5F, 0x02, 0x22, 0x51, 0xD2, 0xF7, 0xD6, 0x38];
    check(schema_hash() == pinned, "the message types have changed")
}

pub(super) fn program_checksum_is_pinned() -> Verdict {
    let steps = [
        Step::Move { x_um: -1500, y_um: 1000, speed_um_s: 500 },
        Step::Hold { duration_ms: 5000 },
        Step::Tare { duration_ms: 1000 },
        Step::Ramp { x_um: 0, y_um: -200, duration_ms: 400 },
    ];
    check(program_crc(&steps) == 0x45FF_6411, "the checksum of a program has changed")?;
    check(program_crc(&[]) == 0, "the checksum of no steps is not 0")
}

pub(super) fn largest_messages_fill_the_frame_bound() -> Verdict {
    let mut buffer = BUFFER;
    let largest = ENVELOPES.last().map(|golden| bytes(golden.frame, &mut buffer)).transpose()?;
    check(
        largest.map(<[u8]>::len) == Some(MAX_FRAME_TO_HOST),
        "the bound of frames to the host is not tight",
    )?;
    let largest = COMMANDS.last().map(|golden| bytes(golden.frame, &mut buffer)).transpose()?;
    check(
        largest.map(<[u8]>::len) == Some(MAX_FRAME_TO_DEVICE),
        "the bound of frames to the device is not tight",
    )
}
