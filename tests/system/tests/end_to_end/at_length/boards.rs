//! Every board's images: the second board works as the first, and the tests for boards are those that run in QEMU.

use device::link::{Client, LinkError, Program, RunOptions, run};
use protocol::{Fault, Request, State, Step};
use simulation::rig::config::RigConfig;
use std::process::Command;
use std::sync::atomic::AtomicBool;
use system::bench::Bench;
use system::cosim::Injection;
use system::images::{self, Board, Image, build_for};
use system::qemu::{HANGS, Line, Qemu, turn};

static NEVER: AtomicBool = AtomicBool::new(false);

#[test]
#[ignore = "needs QEMU: cargo xtask test --all runs it"]
fn the_nucleo_moves_where_it_is_sent_and_stops_when_it_has_to() {
    let bench = Bench::on(Board::NucleoL476rg, RigConfig::default(), 71, 4.0).unwrap();
    let mut client = Client::connect(&bench.port()).unwrap();
    assert_eq!(client.hello().board.as_str(), "NUCLEO-L476RG");
    let mut program = Program::single("home", Step::Move { x_um: 0, y_um: 0, speed_um_s: 2_000 });
    program.steps.extend(Program::single("tare", Step::Tare { duration_ms: 500 }).steps);
    program
        .steps
        .extend(Program::single("push", Step::Move { x_um: -400, y_um: 900, speed_um_s: 2_000 }).steps);
    let options = RunOptions { start_us: None, stream: false, interrupted: &NEVER };
    run(&mut client, &program, options, |_, _| Ok::<(), LinkError>(())).unwrap();
    // Each axis on its own bridge and its own potentiometer: swapped ones would end elsewhere.
    let position_m = bench.rig().rig(|rig| rig.position_m());
    for (position_m, sent_um) in position_m.into_iter().zip([-400.0, 900.0]) {
        assert!((position_m * 1e6 - sent_um).abs() < 30.0, "{position_m} m, sent to {sent_um} um");
    }
    let counters = client.status().unwrap().counters;
    assert_eq!(counters, Default::default(), "no loss, no bad reading, no late period");
    bench.rig().inject(Injection { emergency_stop: true, ..Injection::default() });
    crate::in_minutes::library::eventually("the emergency stop is a fault", || {
        let status = client.status().unwrap();
        (status.state, status.fault) == (State::Faulted, Some(Fault::EmergencyStop))
    });
    assert!(!bench.rig().bridges_driven());
    bench.rig().inject(Injection::default());
    crate::in_minutes::library::eventually("the fault is cleared", || {
        client.request(Request::ClearFault).is_ok()
    });
    assert_eq!(bench.rig().resets(), 0, "a watchdog that is fed does not reset");
    drop(client);
    bench.stop().unwrap();
}

#[test]
#[ignore = "needs QEMU: cargo xtask test --all runs it"]
fn the_test_program_for_boards_passes_in_qemu() {
    for board in Board::ALL {
        let elf = build_for(board, Image::BoardConformance).unwrap();
        let folder = tempfile::tempdir().unwrap();
        let qemu = Qemu::start_for(board, Line::Socket, turn(), &elf, folder.path(), HANGS).unwrap();
        let (code, log) = qemu.wait(HANGS).unwrap();
        assert_eq!(code, 0, "{}: {log:#?}", board.name());
    }
}

#[cfg(unix)]
#[test]
#[ignore = "needs the firmware's toolchain: cargo xtask test --all runs it"]
fn a_board_whose_tests_fail_gets_no_firmware() {
    use std::os::unix::fs::PermissionsExt;
    let folder = tempfile::tempdir().unwrap();
    let (calls, probe_rs) = (folder.path().join("calls"), folder.path().join("probe-rs"));
    let script = format!("#!/bin/sh\necho \"$1\" >> '{}'\ntest \"$1\" != run\n", calls.display());
    std::fs::write(&probe_rs, script).unwrap();
    std::fs::set_permissions(&probe_rs, std::fs::Permissions::from_mode(0o755)).unwrap();
    let path = std::env::var("PATH").unwrap();
    let hil = |path: String| {
        let mut command = Command::new(env!("CARGO_BIN_EXE_system"));
        command.current_dir(images::root()).arg("hil").env("PATH", path).output().unwrap()
    };
    let output = hil(format!("{}:{path}", folder.path().display()));
    let text = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(!output.status.success() && text.contains("the protocol's tests failed"), "{text}");
    assert_eq!(std::fs::read_to_string(&calls).unwrap(), "--version\nrun\n");

    let output = hil(folder.path().join("nothing").display().to_string());
    let text = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(!output.status.success() && text.contains("probe-rs is not installed"), "{text}");
}
