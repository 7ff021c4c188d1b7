//! Hazards that take minutes of the device's time to come about, and random sequences.

use crate::in_minutes::hazards::{await_fault, bench, start, unloaded};
use control::calibration::Calibration;
use control::motor::ON_LIMIT_PERIODS;
use device::link::{Client, LinkError, Telemetry};
use protocol::{Fault, Refusal, Request, Step};
use std::time::Duration;
use system::bench::Bench;
use system::qemu::HANGS;
use system::wire::{Direction, NoisyWire};

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
    // 12 s of 60 s of uninterrupted driving have to leave the window of 300 s.
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
    let args = system::sequences::Args { sequences: 0, qemu: 10, seed: 1 };
    let survived = system::sequences::run(args).unwrap();
    println!("{survived}");
    let (tally, _) = survived.in_qemu.unwrap();
    assert!(tally.sequences == 10 && tally.commands > 300 && tally.faults > 3, "{tally}");
}

/// Bits flip both ways and the cable is cut: every sample that arrives is what the sensors gave in its millisecond, every other one is counted.
#[test]
#[ignore = "needs QEMU: cargo xtask test --all runs it"]
fn a_bad_cable_loses_samples_that_are_counted_and_nothing_else() {
    let bench = Bench::start(unloaded(), 3, f64::INFINITY, HANGS).unwrap();
    bench.rig().keep_history();
    let wire = NoisyWire::connect(&bench.folder().join("serial"), 3).unwrap();
    let mut client = Client::connect(&wire.port()).unwrap();
    client.request(Request::Stream { enable: true }).unwrap();
    let calibration = Calibration::default();
    let (mut samples, mut missing, mut first_ms, mut last_ms) = (0, 0, None, 0);
    for round in 0..40 {
        wire.bit_error_rate(Direction::ToHost, if round < 38 { 1e-4 } else { 0.0 });
        match round % 10 {
            5 => wire.cut(),
            6 => wire.mend(),
            _ => {}
        }
        let end_step = bench.rig().steps() + 300;
        while bench.rig().steps() < end_step {
            let Some(Telemetry::Samples(batch)) = client.next(Duration::from_millis(20)).unwrap() else {
                continue;
            };
            if first_ms.is_some() {
                missing += batch.lost_before;
            }
            for point in &batch.points {
                let ms = (point.time_s * 1e3).round() as u64;
                let sensed = bench.rig().period(bench.rig().started() + ms - 1).expect("it is kept");
                let expected_um = calibration.position_um(sensed.potentiometer_codes, [0.5; 2]);
                for (measured_m, um) in point.displacement_m.into_iter().zip(expected_um) {
                    assert_eq!((measured_m * 1e6).round(), f64::from(um.round()), "at {ms} ms");
                }
                let expected = calibration.force_counts(sensed.force_codes);
                for (force_n, counts) in point.force_n.into_iter().zip(expected) {
                    assert_eq!((force_n / 50e-6).round() as i32, counts, "at {ms} ms");
                }
                samples += 1;
                first_ms.get_or_insert(ms);
                last_ms = ms;
            }
        }
    }
    let span = last_ms - first_ms.expect("samples arrive") + 1;
    assert_eq!(samples + missing, span, "{samples} samples and {missing} lost");
    assert!(samples > 3_000 && missing > 300, "{samples} samples and {missing} lost");
    assert!(client.losses().frames_corrupt > 5, "{:?}", client.losses());
    assert_eq!(client.status().unwrap().counters.control_overruns, 0);
    drop(client);
    drop(wire);
    bench.stop().unwrap();
}

#[test]
#[ignore = "needs QEMU: cargo xtask test --all runs it"]
fn programs_that_are_left_running_come_back_to_their_device_and_are_not_disturbed() {
    let args = system::left_running::Args { minutes: 0.4, seed: 1 };
    let served = system::left_running::run(args).unwrap();
    println!("{served}");
    // The number of updates in the time depends on the computer; that every kind occurs does not.
    assert!(served.updates >= 4 && served.replugged > 0 && served.refused > 0, "{served}");
    assert!(served.strangers > 0 && served.keys > 0, "{served}");
}
