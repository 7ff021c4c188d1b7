//! Hazards that take minutes of the device's time to come about, and random sequences.

use crate::in_minutes::hazards::{await_fault, bench, start, unloaded};
use control::motor::ON_LIMIT_PERIODS;
use device::link::LinkError;
use protocol::{Fault, Refusal, Request, Step};

#[test]
#[ignore = "needs QEMU: cargo xtask test --all runs it"]
fn a_motor_that_never_rests_is_locked_out() {
    let (bench, mut client) = bench(unloaded());
    let to_and_fro: Vec<_> = (0..60)
        .map(|step| Step::Ramp { x_um: 0, y_um: if step % 2 == 0 { 900 } else { -900 }, duration_ms: 1_500 })
        .collect();
    let began_us = client.status().unwrap().t_us;
    start(&mut client, &to_and_fro);
    let hot_s = await_fault(&mut client, Fault::MotorHot);
    let driven_s = hot_s - began_us as f64 * 1e-6;
    let limit_s = f64::from(ON_LIMIT_PERIODS) * 1e-3;
    assert!((limit_s..limit_s + 10.0).contains(&driven_s), "locked out after {driven_s} s");
    assert!(!bench.rig().bridges_driven());
    let status = client.status().unwrap();
    assert_eq!(status.motor_budget_permille[1], 1_000);
    // Of 60 s of driving at a stretch 12 s have to leave the window of 300 s.
    let cools_in_s = client.safety().unwrap().cools_in_s;
    assert!(cools_in_s[0] == 0 && (200..=310).contains(&cools_in_s[1]), "{cools_in_s:?} s");
    let refusal = client.request(Request::ClearFault).unwrap_err();
    assert!(matches!(refusal, LinkError::Refused { refusal: Refusal::CauseRemains, .. }), "{refusal}");
    drop(client);
    bench.stop().unwrap();
}

#[test]
#[ignore = "needs QEMU: cargo xtask test --all runs it"]
fn sequences_of_commands_through_the_firmware_get_round_no_limit() {
    let args = system::campaign::Args { sequences: 0, qemu: 10, seed: 1 };
    let survived = system::campaign::run(args).unwrap();
    println!("{survived}");
    let (tally, _) = survived.in_qemu.unwrap();
    assert!(tally.sequences == 10 && tally.commands > 300 && tally.faults > 3, "{tally}");
}

#[test]
#[ignore = "needs QEMU: cargo xtask test --all runs it"]
fn a_bad_cable_loses_samples_that_are_counted_and_nothing_else() {
    let args = system::stress::Args { minutes: 0.4, bit_error_rate: 1e-4, seed: 3 };
    let survived = system::stress::run(args).unwrap();
    println!("{survived}");
    assert!(survived.samples > 10_000 && survived.cuts > 0 && survived.programs > 0, "{survived}");
    assert!(survived.losses.frames_corrupt > 10 && survived.flipped_bits[1] > 10, "{survived}");
}

#[test]
#[ignore = "needs QEMU: cargo xtask test --all runs it"]
fn random_commands_faults_and_restarts_leave_nothing_that_must_hold_behind() {
    let survived = system::soak::run(system::soak::Args { minutes: 0.3, seed: 1, programs: false }).unwrap();
    println!("{survived}");
    assert!(survived.samples > 8_000 && survived.tally.commands() > 50, "{survived}");
    assert!(survived.tally.fault_kinds() > 1, "{survived}");
}

#[test]
#[ignore = "needs QEMU: cargo xtask test --all runs it"]
fn programs_that_are_left_running_come_back_to_their_device_and_are_not_disturbed() {
    let args = system::soak::Args { minutes: 0.4, seed: 1, programs: true };
    let served = system::soak::programs::run(args).unwrap();
    println!("{served}");
    // How much is done in the time depends on the computer; that everything is done does not.
    assert!(served.updates >= 4 && served.replugged > 0 && served.refused > 0, "{served}");
    assert!(served.strangers > 0 && served.keys > 0, "{served}");
}
