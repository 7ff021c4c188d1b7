//! Pulses of one motor on rigs that are wired wrong.

use super::*;
use protocol::{PulseOutcome, PulseReport};
use simulation::rig::SimulatedRig;
use std::collections::HashSet;

const UP: Request = Request::Pulse { axis: 1, duty_permille: 350, duration_ms: 50 };
const DOWN: Request = Request::Pulse { axis: 1, duty_permille: -350, duration_ms: 50 };
/// Largest sum of motions while wires are wrong, millimetres.
const BOUND_MM: f64 = 0.3;

/// A rig with a fault, fresh from the solder, its constants acknowledged.
fn wired(fault: &str) -> (Bench, Client) {
    let faults = if fault.is_empty() { vec![] } else { vec![fault.parse().unwrap()] };
    let bench = Bench::wired(RigConfig::default(), 5, SPEED, faults).unwrap();
    let mut client = Client::connect(&bench.port()).unwrap();
    client.request(Request::AcknowledgeCalibration).unwrap();
    (bench, client)
}

/// One pulse: its report, and how far the rig really moved along x and y, millimetres.
fn pulse(bench: &Bench, client: &mut Client, request: Request) -> (PulseReport, [f64; 2]) {
    let start_m = bench.rig().rig(|rig: &mut SimulatedRig| rig.position_m());
    bench.rig().keep_history();
    bench.rig().take_reach();
    client.request(request).unwrap();
    let report = until(client, |kind| match kind {
        EventKind::PulseEnded(report) => Some(report),
        _ => None,
    });
    let start_step = bench.rig().steps();
    eventually("time passes", || bench.rig().steps() > start_step + 100);
    assert!(!bench.rig().bridges_driven(), "driven after a pulse");
    let end_m = bench.rig().rig(|rig| rig.position_m());
    (report, [0, 1].map(|axis| 1e3 * (end_m[axis] - start_m[axis])))
}

#[test]
#[ignore = "needs QEMU: cargo xtask test runs it"]
fn a_pulse_ends_within_its_bound_whatever_is_wired_wrong() {
    let cases: [(&str, PulseOutcome, [f64; 2]); 6] = [
        ("", PulseOutcome::Reached, [0.0, 1.0]),
        ("leads-reversed:y", PulseOutcome::Reached, [0.0, -1.0]),
        ("potentiometer-reversed:y", PulseOutcome::Reached, [0.0, 1.0]),
        ("motors-swapped", PulseOutcome::OtherAxis, [1.0, 0.0]),
        ("potentiometers-swapped", PulseOutcome::OtherAxis, [0.0, 1.0]),
        ("jammed:y", PulseOutcome::Completed, [0.0, 0.0]),
    ];
    for (fault, outcome, way) in cases {
        let (bench, mut client) = wired(fault);
        for (request, sign) in [(UP, 1.0), (DOWN, -1.0)] {
            let (report, moved_mm) = pulse(&bench, &mut client, request);
            println!(
                "{fault:28} {:?} after {} ms, moved {moved_mm:.3?} mm",
                report.outcome, report.driven_ms
            );
            assert_eq!(report.outcome, outcome, "{fault}: {report:?}");
            for (moved_mm, way) in moved_mm.into_iter().zip(way) {
                assert!(moved_mm.abs() <= BOUND_MM, "{fault}: {moved_mm} mm");
                let expected = sign * moved_mm * way > 0.08 || (way == 0.0 && moved_mm.abs() < 1e-6);
                assert!(expected, "{fault}: {moved_mm} mm");
            }
        }
        assert_eq!(client.status().unwrap().fault, None, "{fault}");
        drop(client);
        bench.stop().unwrap();
    }
}

#[test]
#[ignore = "needs QEMU: cargo xtask test runs it"]
fn pulses_do_not_add_up_and_are_refused_without_an_acknowledged_calibration_and_in_a_fault() {
    let bench =
        Bench::wired(RigConfig::default(), 5, SPEED, vec!["leads-reversed:y".parse().unwrap()]).unwrap();
    let mut client = Client::connect(&bench.port()).unwrap();
    assert_eq!(refusal(client.request(UP)), Refusal::CalibrationNotAcknowledged);
    client.request(Request::AcknowledgeCalibration).unwrap();
    let start_m = bench.rig().rig(|rig| rig.position_m());
    for restarts in 0..3 {
        for pulse in 0..4 {
            match client.request(UP) {
                Ok(()) => {
                    assert_eq!((restarts, pulse), (0, 0), "the direction is used up");
                    until(&mut client, |kind| matches!(kind, EventKind::PulseEnded(_)).then_some(()));
                }
                Err(error) => assert_eq!(refusal(Err(error)), Refusal::OutOfTravel),
            }
        }
        let end_m = bench.rig().rig(|rig| rig.position_m());
        let moved_mm = 1e3 * (end_m[1] - start_m[1]);
        assert!((0.08..=BOUND_MM).contains(&moved_mm.abs()), "{moved_mm} mm");
        // The device restarts by itself and remembers.
        bench.rig().inject(Injection { brown_out: true, ..NOTHING });
        drop(client);
        client = Client::connect(&bench.port()).unwrap();
        bench.rig().inject(NOTHING);
        eventually("the fault is cleared", || client.request(Request::ClearFault).is_ok());
        client.request(Request::AcknowledgeCalibration).unwrap();
    }
    bench.rig().press_stop(true);
    await_fault(&mut client, Fault::EmergencyStop);
    assert!(matches!(refusal(client.request(UP)), Refusal::Faulted { fault: Fault::EmergencyStop }));
    drop(client);
    bench.stop().unwrap();
}

/// Every command that moves something, on a rig with reversed leads; the others move nothing at all.
#[test]
#[ignore = "needs QEMU: cargo xtask test runs it"]
fn no_command_moves_reversed_leads_or_feedback_by_more_than_the_bound() {
    let ramp = Step::Ramp { x_um: 0, y_um: -3_000, duration_ms: 1_000 };
    let tare_first = Step::Tare { duration_ms: 50 };
    let load = Request::LoadCalibration { piece: 0, bytes: [0; protocol::PIECE_BYTES] };
    let commands: [(&str, Vec<Request>); 17] = [
        ("move up", run(move_to(2_000, 2_000))),
        ("move down, fast", run(move_to(-8_000, 10_000))),
        ("move, slow", run(move_to(2_000, 300))),
        ("ramp", run(ramp)),
        ("tare", run(tare_first)),
        ("hold", run(Step::Hold { duration_ms: 100 })),
        ("pulse up", pulse_request(350, 50)),
        ("pulse down", pulse_request(-350, 50)),
        ("pulse too strong", pulse_request(700, 50)),
        ("pulse too long", pulse_request(350, 51)),
        ("retreat", vec![Request::Retreat { x_um: 0, y_um: 900 }]),
        ("limits", vec![Request::Limits { force_mn: 5_000, silence_ms: SILENCE_MS }]),
        ("stop, clear", vec![Request::Stop, Request::ClearFault]),
        ("questions", vec![Request::Status, Request::Safety, Request::Describe, Request::Calibration]),
        ("stream", vec![Request::Stream { enable: true }, Request::Stream { enable: false }]),
        ("store", vec![load, Request::StoreCalibration { length: 8, crc: 0 }]),
        ("acknowledge", vec![Request::AcknowledgeCalibration]),
    ];
    let tested_requests: HashSet<_> = commands.iter().flat_map(|(_, requests)| requests).map(name).collect();
    // Connecting is the last one.
    assert_eq!(tested_requests.len() + 1, COMMANDS, "every command of the protocol: {tested_requests:?}");
    for fault in ["leads-reversed:y", "potentiometer-reversed:y"] {
        let bench = Bench::wired(RigConfig::default(), 5, SPEED, vec![fault.parse().unwrap()]).unwrap();
        let mut client = Client::connect(&bench.port()).unwrap();
        client.request(Request::Limits { force_mn: 4_000, silence_ms: SILENCE_MS }).unwrap();
        // Before the bring-up: nobody has acknowledged its constants, and nothing moves.
        let from_m = bench.rig().rig(|rig| rig.position_m());
        let all_requests = commands.iter().flat_map(|(_, requests)| requests);
        for request in all_requests.filter(|request| **request != Request::AcknowledgeCalibration) {
            let _ = client.request(*request);
            assert!(!bench.rig().bridges_driven(), "{fault}, {request:?} before the bring-up");
        }
        let start_step = bench.rig().steps();
        eventually("time passes", || bench.rig().steps() > start_step + 500);
        let to_m = bench.rig().rig(|rig| rig.position_m());
        assert!((to_m[1] - from_m[1]).abs() < 1e-9, "{fault}, before the bring-up: {from_m:?} to {to_m:?}");
        let _ = client.request(Request::ClearFault);
        client.request(Request::AcknowledgeCalibration).unwrap();
        let mut ran = 0;
        for (name, requests) in &commands {
            let start_m = bench.rig().rig(|rig| rig.position_m());
            let accepted = requests.iter().map(|request| client.request(*request).is_ok()).last();
            let start_step = bench.rig().steps();
            eventually("it ends", || {
                bench.rig().steps() > start_step + 1_500 && !bench.rig().bridges_driven()
            });
            let end_m = bench.rig().rig(|rig| rig.position_m());
            // Along x, which is sound, the guide may well go where it is sent.
            let moved_mm = 1e3 * (end_m[1] - start_m[1]);
            let fault_after = client.status().unwrap().fault;
            println!("{fault:26} {name:18} {accepted:?}, moved {moved_mm:.3} mm, {fault_after:?}");
            assert!(moved_mm.abs() <= BOUND_MM, "{fault}, {name}: {moved_mm} mm");
            ran += u32::from(moved_mm != 0.0);
            if fault_after.is_some() {
                eventually("the fault is cleared", || client.request(Request::ClearFault).is_ok());
            }
        }
        assert!(ran >= 5, "{ran} of them moved");
        drop(client);
        bench.stop().unwrap();
    }
}

fn pulse_request(duty_permille: i16, duration_ms: u8) -> Vec<Request> {
    vec![Request::Pulse { axis: 1, duty_permille, duration_ms }]
}

fn move_to(y_um: i32, speed_um_s: u32) -> Step {
    Step::Move { x_um: 0, y_um, speed_um_s }
}

fn run(step: Step) -> Vec<Request> {
    vec![Request::LoadStep { index: 0, step }, run_one(step)]
}

/// Number of commands of the protocol.
const COMMANDS: usize = 16;

/// A command by its name: the compiler requires a new one here.
fn name(request: &Request) -> &'static str {
    match request {
        Request::Hello => "hello",
        Request::Status => "status",
        Request::Stream { .. } => "stream",
        Request::LoadStep { .. } => "load step",
        Request::Run { .. } => "run",
        Request::Stop => "stop",
        Request::ClearFault => "clear fault",
        Request::Limits { .. } => "limits",
        Request::LoadCalibration { .. } => "load calibration",
        Request::StoreCalibration { .. } => "store calibration",
        Request::Calibration => "calibration",
        Request::Retreat { .. } => "retreat",
        Request::AcknowledgeCalibration => "acknowledge calibration",
        Request::Describe => "describe",
        Request::Safety => "safety",
        Request::Pulse { .. } => "pulse",
    }
}

fn run_one(step: Step) -> Request {
    Request::Run { steps: 1, crc: program_crc(&[step]), start_us: 0 }
}
