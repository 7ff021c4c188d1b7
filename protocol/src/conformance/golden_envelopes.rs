//! Golden bytes of every message from the device. Once released, entries are added and never changed.

use super::golden_messages::{
    batch, calibration, description, happened, hello, pulse, refused, safety, status, tare,
};
use super::{Golden, envelope};
use crate::{
    CalibrationSource, Envelope, EventKind, Fault, Message, Outcome, PACKED_BYTES, Packed, PulseOutcome,
    Refusal, ResetReason, RetreatOutcome, Samples, State, TareProblem,
};

pub(super) const ENVELOPES: &[Golden<Envelope>] = &[
    Golden {
        message: || hello(ResetReason::PowerOn, None),
        frame: "0009d487cb8d0af0a20432021032547698badcfe05302e312e30123031323334353637383961622d64697274790e422d\
            4c343735452d494f543031411dc0843da0cb9801d00f64e8078827882706756e69742d37a6f2d0df0c05f36d7d0d00",
    },
    Golden {
        message: || hello(ResetReason::Pin, None),
        frame: "0009d487cb8d0af0a2044f021032547698badcfe05302e312e30123031323334353637383961622d64697274790e422d\
            4c343735452d494f5430314101c0843da0cb9801d00f64e8078827882706756e69742d37a6f2d0df0c05fb8e1d3100",
    },
    Golden {
        message: || hello(ResetReason::Watchdog, None),
        frame: "0009d487cb8d0af0a2044f021032547698badcfe05302e312e30123031323334353637383961622d64697274790e422d\
            4c343735452d494f5430314102c0843da0cb9801d00f64e8078827882706756e69742d37a6f2d0df0c05e3abbc7500",
    },
    Golden {
        message: || hello(ResetReason::Software, Some("src/app.rs:99:5: index out of bounds")),
        frame: "0009d487cb8d0af0a20479021032547698badcfe05302e312e30123031323334353637383961622d64697274790e422d\
            4c343735452d494f5430314103c0843da0cb9801d00f64e8078827882706756e69742d37a6f2d0df0c01247372632f61\
            70702e72733a39393a353a20696e646578206f7574206f6620626f756e6473d5e6033c00",
    },
    Golden {
        message: || hello(ResetReason::BrownOut, None),
        frame: "0009d487cb8d0af0a2044f021032547698badcfe05302e312e30123031323334353637383961622d64697274790e422d\
            4c343735452d494f5430314104c0843da0cb9801d00f64e8078827882706756e69742d37a6f2d0df0c05d3e1fefc00",
    },
    Golden {
        message: || hello(ResetReason::Other, None),
        frame: "0009d487cb8d0af0a2044f021032547698badcfe05302e312e30123031323334353637383961622d64697274790e422d\
            4c343735452d494f5430314105c0843da0cb9801d00f64e8078827882706756e69742d37a6f2d0df0c05db029ec000",
    },
    Golden { message: || envelope(Message::Ack { id: 300 }), frame: "0010d487cb8d0af0a20401ac023bd06dfb00" },
    Golden { message: || refused(Refusal::OtherBoot), frame: "000cd487cb8d0af0a20402ac020597c4477100" },
    Golden {
        message: || refused(Refusal::Faulted { fault: Fault::EmergencyStop }),
        frame: "000dd487cb8d0af0a20402ac020105ef9f03a500",
    },
    Golden {
        message: || refused(Refusal::Faulted { fault: Fault::ForceSensor }),
        frame: "0012d487cb8d0af0a20402ac02010179af04d200",
    },
    Golden {
        message: || refused(Refusal::Faulted { fault: Fault::ForceRange }),
        frame: "0012d487cb8d0af0a20402ac020102c3fe0d4b00",
    },
    Golden {
        message: || refused(Refusal::Faulted { fault: Fault::Potentiometer }),
        frame: "0012d487cb8d0af0a20402ac02010355ce0a3c00",
    },
    Golden {
        message: || refused(Refusal::Faulted { fault: Fault::MoveTimeout }),
        frame: "0012d487cb8d0af0a20402ac020104f65b6ea200",
    },
    Golden {
        message: || refused(Refusal::Faulted { fault: Fault::ForceLimit }),
        frame: "0012d487cb8d0af0a20402ac020105606b69d500",
    },
    Golden {
        message: || refused(Refusal::Faulted { fault: Fault::Travel }),
        frame: "0012d487cb8d0af0a20402ac020106da3a604c00",
    },
    Golden {
        message: || refused(Refusal::Faulted { fault: Fault::Stall }),
        frame: "0012d487cb8d0af0a20402ac0201074c0a673b00",
    },
    Golden {
        message: || refused(Refusal::Faulted { fault: Fault::FollowingError }),
        frame: "0012d487cb8d0af0a20402ac020108dd17d8ab00",
    },
    Golden {
        message: || refused(Refusal::Faulted { fault: Fault::ForceStuck }),
        frame: "0012d487cb8d0af0a20402ac0201094b27dfdc00",
    },
    Golden {
        message: || refused(Refusal::Faulted { fault: Fault::HostSilent }),
        frame: "0012d487cb8d0af0a20402ac02010af176d64500",
    },
    Golden {
        message: || refused(Refusal::Faulted { fault: Fault::Restarted }),
        frame: "0012d487cb8d0af0a20402ac02010b6746d13200",
    },
    Golden {
        message: || refused(Refusal::Faulted { fault: Fault::Overrun }),
        frame: "0012d487cb8d0af0a20402ac02010cc4d3b5ac00",
    },
    Golden {
        message: || refused(Refusal::Faulted { fault: Fault::MotorHot }),
        frame: "0012d487cb8d0af0a20402ac02010d52e3b2db00",
    },
    Golden { message: || refused(Refusal::Busy), frame: "0011d487cb8d0af0a20402ac0202bba5499f00" },
    Golden { message: || refused(Refusal::OutOfTravel), frame: "0011d487cb8d0af0a20402ac02032d954ee800" },
    Golden { message: || refused(Refusal::OutOfRange), frame: "000ed487cb8d0af0a20402ac02048e032a7600" },
    Golden { message: || refused(Refusal::ProgramMismatch), frame: "0011d487cb8d0af0a20402ac020518302d0100" },
    Golden { message: || refused(Refusal::TooLate), frame: "0011d487cb8d0af0a20402ac0206a261249800" },
    Golden { message: || refused(Refusal::CauseRemains), frame: "0011d487cb8d0af0a20402ac0207345123ef00" },
    Golden { message: || refused(Refusal::Unreadable), frame: "0011d487cb8d0af0a20402ac0208a54c9c7f00" },
    Golden {
        message: || refused(Refusal::CalibrationInvalid),
        frame: "0011d487cb8d0af0a20402ac0209337c9b0800",
    },
    Golden {
        message: || batch(State::Idle),
        frame: "0010d487cb8d0af0a2040380ade204c8010b02031201e60701e707070b07c0990c018002010201055976593c00",
    },
    Golden {
        message: || batch(State::Pending),
        frame: "001bd487cb8d0af0a2040380ade204c8010102031201e60701e707070b07c0990c018002010201058d9c2aa700",
    },
    Golden {
        message: || batch(State::Moving),
        frame: "001bd487cb8d0af0a2040380ade204c8010202031201e60701e707070b07c0990c01800201020105b0a5cfd100",
    },
    Golden {
        message: || batch(State::Holding),
        frame: "001bd487cb8d0af0a2040380ade204c8010302031201e60701e707070b07c0990c01800201020105644fbc4a00",
    },
    Golden {
        message: || batch(State::Taring),
        frame: "001bd487cb8d0af0a2040380ade204c8010402031201e60701e707070b07c0990c01800201020105cad7053c00",
    },
    Golden {
        message: || batch(State::Faulted),
        frame: "001bd487cb8d0af0a2040380ade204c8010502031201e60701e707070b07c0990c018002010201051e3d76a700",
    },
    Golden {
        message: || happened(EventKind::StepStarted { index: 0 }),
        frame: "000fd487cb8d0af0a204048080808010010590eadcd200",
    },
    Golden {
        message: || happened(EventKind::StepEnded { index: 63 }),
        frame: "0015d487cb8d0af0a204048080808010013fecf6a17d00",
    },
    Golden {
        message: || happened(EventKind::Tared(tare())),
        frame: "0015d487cb8d0af0a20404808080801002dfc50846640d0603e807e70718010fbd0e5900",
    },
    Golden {
        message: || happened(EventKind::ProgramEnded { outcome: Outcome::Completed }),
        frame: "0010d487cb8d0af0a204048080808010030553b9f1f900",
    },
    Golden {
        message: || happened(EventKind::ProgramEnded { outcome: Outcome::Stopped }),
        frame: "0015d487cb8d0af0a2040480808080100301c589f68e00",
    },
    Golden {
        message: || happened(EventKind::ProgramEnded { outcome: Outcome::Faulted }),
        frame: "0015d487cb8d0af0a20404808080801003027fd8ff1700",
    },
    Golden {
        message: || happened(EventKind::Faulted { fault: Fault::EmergencyStop }),
        frame: "0010d487cb8d0af0a2040480808080100405942fb0b600",
    },
    Golden {
        message: || happened(EventKind::Faulted { fault: Fault::ForceSensor }),
        frame: "0015d487cb8d0af0a2040480808080100401021fb7c100",
    },
    Golden {
        message: || happened(EventKind::Faulted { fault: Fault::ForceRange }),
        frame: "0015d487cb8d0af0a2040480808080100402b84ebe5800",
    },
    Golden {
        message: || happened(EventKind::Faulted { fault: Fault::Potentiometer }),
        frame: "0015d487cb8d0af0a20404808080801004032e7eb92f00",
    },
    Golden {
        message: || happened(EventKind::Faulted { fault: Fault::MoveTimeout }),
        frame: "0015d487cb8d0af0a20404808080801004048debddb100",
    },
    Golden {
        message: || happened(EventKind::Faulted { fault: Fault::ForceLimit }),
        frame: "0015d487cb8d0af0a20404808080801004051bdbdac600",
    },
    Golden {
        message: || happened(EventKind::Faulted { fault: Fault::Travel }),
        frame: "0015d487cb8d0af0a2040480808080100406a18ad35f00",
    },
    Golden {
        message: || happened(EventKind::Faulted { fault: Fault::Stall }),
        frame: "0015d487cb8d0af0a204048080808010040737bad42800",
    },
    Golden {
        message: || happened(EventKind::Faulted { fault: Fault::FollowingError }),
        frame: "0015d487cb8d0af0a2040480808080100408a6a76bb800",
    },
    Golden {
        message: || happened(EventKind::Faulted { fault: Fault::ForceStuck }),
        frame: "0015d487cb8d0af0a204048080808010040930976ccf00",
    },
    Golden {
        message: || happened(EventKind::Faulted { fault: Fault::HostSilent }),
        frame: "0015d487cb8d0af0a204048080808010040a8ac6655600",
    },
    Golden {
        message: || happened(EventKind::Faulted { fault: Fault::Restarted }),
        frame: "0015d487cb8d0af0a204048080808010040b1cf6622100",
    },
    Golden {
        message: || happened(EventKind::Faulted { fault: Fault::Overrun }),
        frame: "0015d487cb8d0af0a204048080808010040cbf6306bf00",
    },
    Golden {
        message: || happened(EventKind::Faulted { fault: Fault::MotorHot }),
        frame: "0015d487cb8d0af0a204048080808010040d295301c800",
    },
    Golden {
        message: || calibration(),
        frame: "001fd487cb8d0af0a2040606756e69742d3728d71fcf8603fba402a7c301d36131d461a8c301fca402d08603a78603d3\
            a402ffc201ab6128fc61d0c301a4a502f8860328d71fcf8603fba402a7c301d36135d461a8c301fca402d08603a78603\
            d3a402ffc201ab6128fc61d0c301a4a502f88603904ef6d771df12c00cd0b3718827460d791600",
    },
    Golden {
        message: || status(None),
        frame: "000ed487cb8d0af0a2040580ade20402ff2bafea01a09c01c09a0cf30301010203040506ac020708090a0b0cc102bb01\
            03f0a20405e8070ca01fd00f0a018eda9601fa06900305b9af726b00",
    },
    Golden {
        message: || status(Some(Fault::MoveTimeout)),
        frame: "000ed487cb8d0af0a2040580ade2042eff0104afea01a09c01c09a0cf30301010203040506ac020708090a0b0cc102bb\
            0103f0a20405e8070ca01fd00f0a018eda9601fa0690030519b6483d00",
    },
    Golden { message: || refused(Refusal::IdUsed), frame: "0011d487cb8d0af0a20402ac020a892d929100" },
    Golden { message: || refused(Refusal::NotUnderLoad), frame: "0011d487cb8d0af0a20402ac020b1f1d95e600" },
    Golden {
        message: || refused(Refusal::CalibrationNotAcknowledged),
        frame: "0011d487cb8d0af0a20402ac020cbc88f17800",
    },
    Golden {
        message: || refused(Refusal::Faulted { fault: Fault::WrongWay }),
        frame: "0012d487cb8d0af0a20402ac02010ee8b2bb4200",
    },
    Golden {
        message: || happened(EventKind::Faulted { fault: Fault::WrongWay }),
        frame: "0015d487cb8d0af0a204048080808010040e9302085100",
    },
    Golden {
        message: || refused(Refusal::Faulted { fault: Fault::CalibrationLost }),
        frame: "0012d487cb8d0af0a20402ac02010f7e82bc3500",
    },
    Golden {
        message: || happened(EventKind::Faulted { fault: Fault::CalibrationLost }),
        frame: "0015d487cb8d0af0a204048080808010040f05320f2600",
    },
    Golden {
        message: || batch(State::Retreating),
        frame: "001bd487cb8d0af0a2040380ade204c8010602031201e60701e707070b07c0990c01800201020105230493d100",
    },
    Golden {
        message: || happened(EventKind::ProgramEnded { outcome: Outcome::TareRejected }),
        frame: "0015d487cb8d0af0a2040480808080100303e9e8f86000",
    },
    Golden {
        message: || happened(EventKind::TareRejected { tare: tare(), problem: TareProblem::FarFromZero }),
        frame: "0015d487cb8d0af0a20404808080801005dfc5084664090603e807e707180105d4041dbf00",
    },
    Golden {
        message: || happened(EventKind::TareRejected { tare: tare(), problem: TareProblem::Settling }),
        frame: "0015d487cb8d0af0a20404808080801005dfc50846640e0603e807e70718010142341ac800",
    },
    Golden {
        message: || happened(EventKind::RetreatEnded { outcome: RetreatOutcome::Unloaded }),
        frame: "0010d487cb8d0af0a2040480808080100605164d868400",
    },
    Golden {
        message: || happened(EventKind::RetreatEnded { outcome: RetreatOutcome::Moved }),
        frame: "0015d487cb8d0af0a2040480808080100601807d81f300",
    },
    Golden {
        message: || happened(EventKind::RetreatEnded { outcome: RetreatOutcome::ForceNotFalling }),
        frame: "0015d487cb8d0af0a20404808080801006023a2c886a00",
    },
    Golden {
        message: || happened(EventKind::RetreatEnded { outcome: RetreatOutcome::Stopped }),
        frame: "0015d487cb8d0af0a2040480808080100603ac1c8f1d00",
    },
    Golden {
        message: || happened(EventKind::PulseEnded(pulse(PulseOutcome::Completed))),
        frame: "0011d487cb8d0af0a2040480808080100701171f03d6024bfc02a006f09c06cf8c01e0c50853bfd8b800",
    },
    Golden {
        message: || happened(EventKind::PulseEnded(pulse(PulseOutcome::Reached))),
        frame: "0028d487cb8d0af0a2040480808080100701011f03d6024bfc02a006f09c06cf8c01e0c5080b3f3a6f00",
    },
    Golden {
        message: || happened(EventKind::PulseEnded(pulse(PulseOutcome::OtherAxis))),
        frame: "0028d487cb8d0af0a2040480808080100701021f03d6024bfc02a006f09c06cf8c01e0c508a2b96ccc00",
    },
    Golden {
        message: || happened(EventKind::PulseEnded(pulse(PulseOutcome::Force))),
        frame: "0028d487cb8d0af0a2040480808080100701031f03d6024bfc02a006f09c06cf8c01e0c508fa398e1b00",
    },
    Golden {
        message: || happened(EventKind::PulseEnded(pulse(PulseOutcome::Stopped))),
        frame: "0028d487cb8d0af0a2040480808080100701041f03d6024bfc02a006f09c06cf8c01e0c508b1b2b05100",
    },
    Golden {
        message: || envelope(Message::Connected { connection: 0xDEAD_BEEF }),
        frame: "0013d487cb8d0af0a20407effdb6f50df027e2a400",
    },
    Golden {
        message: || safety(CalibrationSource::Stored),
        frame: "000ed487cb8d0af0a2040880ade2040601dfc5084604a6020105c3eed48b00",
    },
    Golden {
        message: || safety(CalibrationSource::Nominal),
        frame: "0014d487cb8d0af0a2040880ade2040101dfc5084604a602010503315a4a00",
    },
    Golden {
        message: || safety(CalibrationSource::NominalAcknowledged),
        frame: "0014d487cb8d0af0a2040880ade2040201dfc5084604a60201050257b8d300",
    },
    Golden {
        message: || description(),
        frame: "002fd487cb8d0af0a20409041032547698badcfe40904e80dddb01e0d40380c8ceb40de807c801e0d4030804b6\
            ba43a100",
    },
    Golden {
        message: || Envelope { boot_id: 0, sequence: 0, message: Message::Ack { id: 0 } },
        frame: "0001010201055dee5f3800",
    },
    Golden {
        message: || Envelope {
            boot_id: u32::MAX,
            sequence: u32::MAX,
            message: Message::Samples(Samples {
                t_us: u64::MAX,
                dropped: u32::MAX,
                state: State::Faulted,
                step: u8::MAX,
                count: u8::MAX,
                packed: Packed::from_slice(&[0xFF; PACKED_BYTES]).unwrap_or_default(),
                repeats_force: u32::MAX,
            }),
        },
        frame: "00fcffffffff0fffffffff0f03ffffffffffffffffff01ffffffff0f05ffffd301ffffffffffffffffffffffffffffff\
            ffffffffffffffffffffffffffffffffffffffffffffffffffffffffffffffffffffffffffffffffffffffffffffffff\
            ffffffffffffffffffffffffffffffffffffffffffffffffffffffffffffffffffffffffffffffffffffffffffffffff\
            ffffffffffffffffffffffffffffffffffffffffffffffffffffffffffffffffffffffffffffffffffffffffffffffff\
            ffffffffffffffffffffffffffffffffffffffffffffffffffffffffffffffffffffffffffffffffffffffffffffffff\
            ffffffffffffffff0ff70c044800",
    },
];
