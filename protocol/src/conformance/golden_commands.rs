//! Golden bytes of every command. Once released, entries are added and never changed.

use super::{Golden, command};
use crate::{Command, Request, Step};

pub(super) const COMMANDS: &[Golden<Command>] = &[
    Golden { message: || command(Request::Hello), frame: "0008ac02d487cb8d0a056607783700" },
    Golden { message: || command(Request::Status), frame: "000dac02d487cb8d0a01f0377f4000" },
    Golden {
        message: || command(Request::Stream { enable: false }),
        frame: "0009ac02d487cb8d0a02056531d24400",
    },
    Golden {
        message: || command(Request::Stream { enable: true }),
        frame: "000eac02d487cb8d0a0201f301d53300",
    },
    Golden {
        message: || {
            let step = Step::Move { x_um: -1500, y_um: 1000, speed_um_s: 500 };
            command(Request::LoadStep { index: 0, step })
        },
        frame: "0009ac02d487cb8d0a03010bb717d00ff403dc7c226a00",
    },
    Golden {
        message: || command(Request::LoadStep { index: 1, step: Step::Hold { duration_ms: 5000 } }),
        frame: "0011ac02d487cb8d0a03010188271de793cd00",
    },
    Golden {
        message: || command(Request::LoadStep { index: 63, step: Step::Tare { duration_ms: 1000 } }),
        frame: "0011ac02d487cb8d0a033f02e807b99db28100",
    },
    Golden {
        message: || command(Request::Run { steps: 3, crc: 0xCBF4_3926, start_us: 12_345_678 }),
        frame: "0017ac02d487cb8d0a0403a6f2d0df0ccec2f10577ff52cc00",
    },
    Golden { message: || command(Request::Stop), frame: "000dac02d487cb8d0a05e9f3124700" },
    Golden { message: || command(Request::ClearFault), frame: "000dac02d487cb8d0a0653a21bde00" },
    Golden {
        message: || {
            let step = Step::Ramp { x_um: 0, y_um: -200, duration_ms: 400 };
            command(Request::LoadStep { index: 2, step })
        },
        frame: "000bac02d487cb8d0a030203098f039003ff5ae10c00",
    },
    Golden {
        message: || command(Request::Limits { force_mn: 2_500, silence_ms: 1_500 }),
        frame: "0011ac02d487cb8d0a07c413dc0b44dc2d8a00",
    },
    Golden {
        message: || {
            let bytes = [0x55, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 0xFF];
            command(Request::LoadCalibration { piece: 9, bytes })
        },
        frame: "000bac02d487cb8d0a080955130102030405060708090a0b0c0dff0188eb9e00",
    },
    Golden {
        message: || command(Request::StoreCalibration { length: 150, crc: 0xCBF4_3926 }),
        frame: "0013ac02d487cb8d0a0996a6f2d0df0cce4ed05d00",
    },
    Golden { message: || command(Request::Calibration), frame: "000dac02d487cb8d0a0a78eeadd700" },
    Golden {
        message: || command(Request::Retreat { x_um: -1_000, y_um: 250 }),
        frame: "0011ac02d487cb8d0a0bcf0ff403c8ca66de00",
    },
    Golden { message: || command(Request::AcknowledgeCalibration), frame: "000dac02d487cb8d0a0c4d4bce3e00" },
    Golden { message: || command(Request::Describe), frame: "000dac02d487cb8d0a0ddb7bc94900" },
    Golden { message: || command(Request::Safety), frame: "000dac02d487cb8d0a0e612ac0d000" },
    Golden {
        message: || command(Request::Pulse { axis: 1, duty_permille: -350, duration_ms: 50 }),
        frame: "0011ac02d487cb8d0a0f01bb053237735a2300",
    },
    Golden {
        message: || Command { id: 0, connection: 0, request: Request::Hello },
        frame: "000101010512d941ff00",
    },
    Golden {
        message: || Command {
            id: u16::MAX,
            connection: u32::MAX,
            request: Request::LoadStep {
                index: u8::MAX,
                step: Step::Move { x_um: i32::MIN, y_um: i32::MAX, speed_um_s: u32::MAX },
            },
        },
        frame: "000bffff03ffffffff0f03ff14ffffffff0ffeffffff0fffffffff0f1c5c4ef900",
    },
];
