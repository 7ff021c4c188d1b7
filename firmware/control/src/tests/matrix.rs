//! The table of requests and states in the protocol's chapter equals what the controller answers.

use super::*;
use std::string::{String, ToString};
use std::vec::Vec;
use std::{format, vec};

const CHAPTER: &str = include_str!("../../../../protocol/spec/protocol.md");
const STATES: [State; 5] = [State::Idle, State::Pending, State::Moving, State::Faulted, State::Retreating];

fn requests(record: &CalibrationRecord) -> [(&'static str, Request); 15] {
    let hold = Step::Hold { duration_ms: 5_000 };
    let length = record.encode(&mut [0; protocol::MAX_CALIBRATION]).len() as u8;
    [
        ("Status", Request::Status),
        ("Stream", Request::Stream { enable: true }),
        ("LoadStep", Request::LoadStep { index: 1, step: hold }),
        ("Run", Request::Run { steps: 1, crc: program_crc(&[hold]), start_us: 0 }),
        ("Stop", Request::Stop),
        ("ClearFault", Request::ClearFault),
        ("Limits", Request::Limits { force_mn: 1_000, silence_ms: 2_000 }),
        ("LoadCalibration", Request::LoadCalibration { piece: 0, bytes: [0; 16] }),
        ("StoreCalibration", Request::StoreCalibration { length, crc: record.crc() }),
        ("Calibration", Request::Calibration),
        ("Retreat", Request::Retreat { x_um: 0, y_um: -500 }),
        ("AcknowledgeCalibration", Request::AcknowledgeCalibration),
        ("Describe", Request::Describe),
        ("Safety", Request::Safety),
        ("Pulse", Request::Pulse { axis: 0, duty_permille: 300, duration_ms: 20 }),
    ]
}

/// A bench in a state, with a valid calibration and a step loaded.
fn in_state(state: State, record: &CalibrationRecord) -> Bench {
    let mut bench = Bench::new();
    bench.position_um = [0.0, 1_500.0];
    let mut buffer = [0; protocol::MAX_CALIBRATION];
    let bytes = record.encode(&mut buffer);
    for (piece, chunk) in (0..).zip(bytes.chunks(protocol::PIECE_BYTES)) {
        let mut bytes = [0; protocol::PIECE_BYTES];
        bytes[..chunk.len()].copy_from_slice(chunk);
        bench.command(Request::LoadCalibration { piece, bytes }).expect("idle");
    }
    let load = |bench: &mut Bench, step: Step, start_us: u64| {
        bench.command(Request::LoadStep { index: 0, step }).expect("loads");
        bench.command(Request::Run { steps: 1, crc: program_crc(&[step]), start_us }).expect("runs");
    };
    let hold = Step::Hold { duration_ms: 5_000 };
    bench.command(Request::LoadStep { index: 0, step: hold }).expect("loads");
    match state {
        State::Pending => load(&mut bench, hold, 10_000_000),
        State::Moving => load(&mut bench, Step::Move { x_um: 0, y_um: 2_500, speed_um_s: 500 }, 0),
        State::Faulted | State::Retreating => {
            bench.command(Request::Limits { force_mn: 800, silence_ms: 2_000 }).expect("in range");
            bench.periods(3);
            if state == State::Retreating {
                bench.command(Request::Retreat { x_um: 0, y_um: -1_000 }).expect("under load");
            }
        }
        _ => {}
    }
    assert_eq!(bench.periods(5).state, state);
    bench
}

#[test]
fn the_chapters_matrix_is_what_the_controller_answers() {
    let record = Calibration::nominal_record();
    let mut table = vec![
        format!("| request | {} |", STATES.map(|state| format!("{state:?}")).join(" | ")),
        String::from("|---|---|---|---|---|---|"),
    ];
    for (name, request) in requests(&record) {
        let cells: Vec<String> = STATES
            .iter()
            .map(|state| match in_state(*state, &record).command(request) {
                Ok(()) => "-".to_string(),
                Err(Refusal::Faulted { .. }) => "Faulted".to_string(),
                Err(refusal) => format!("{refusal:?}"),
            })
            .collect();
        table.push(format!("| {name} | {} |", cells.join(" | ")));
    }
    let generated = table.join("\n");
    let written = CHAPTER
        .split("<!-- matrix -->\n")
        .nth(1)
        .and_then(|rest| rest.split("\n<!-- matrix ends -->").next());
    assert!(written == Some(generated.as_str()), "the controller answers:\n{generated}");
}
