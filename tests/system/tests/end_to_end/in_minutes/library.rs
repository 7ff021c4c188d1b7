//! The firmware driven with the host library: what the physics predicts must be what is measured.

use control::axis::REENGAGE_ERROR_UM;
use device::link::{Batch, Client, LinkError, Program, RunOptions, Telemetry, run};
use mechanics::Model;
use protocol::{Fault, Refusal, Request, State, Step};
use simulation::rig::config::RigConfig;
use std::sync::atomic::AtomicBool;
use std::thread;
use std::time::{Duration, Instant};
use system::bench::Bench;
use system::cosim::Injection;
use system::qemu::HANGS;

/// Rig seconds per second.
const SPEED: f64 = 4.0;
static NEVER: AtomicBool = AtomicBool::new(false);

fn bench(seed: u64) -> (Bench, Client) {
    let bench = Bench::start(RigConfig::default(), seed, SPEED, HANGS).unwrap();
    let client = Client::connect(&bench.port()).unwrap();
    (bench, client)
}

/// Runs steps and returns what was streamed.
fn measure(client: &mut Client, steps: &[Step]) -> Result<Vec<Batch>, LinkError> {
    let mut program = Program::single("measure", steps[0]);
    for step in &steps[1..] {
        program.steps.extend(Program::single("next", *step).steps);
    }
    let mut batches = Vec::new();
    let options = RunOptions { start_us: None, stream: true, interrupted: &NEVER };
    run(client, &program, options, |_, telemetry| {
        if let Telemetry::Samples(batch) = telemetry {
            batches.push(batch.clone());
        }
        Ok::<(), LinkError>(())
    })?;
    Ok(batches)
}

fn move_to(x_um: i32, y_um: i32) -> Step {
    Step::Move { x_um, y_um, speed_um_s: 2_000 }
}

/// Mean displacement and force of a step, metres and newtons, and the number of samples.
fn mean(batches: &[Batch], step: u8) -> ([f64; 2], [f64; 2], f64) {
    let points: Vec<_> =
        batches.iter().filter(|batch| batch.step == Some(step)).flat_map(|batch| &batch.points).collect();
    let count = points.len() as f64;
    let mean = |value: &dyn Fn(usize) -> f64| (0..points.len()).map(value).sum::<f64>() / count;
    (
        [0, 1].map(|axis| mean(&|i| points[i].displacement_m[axis])),
        [0, 1].map(|axis| mean(&|i| points[i].force_n[axis])),
        count,
    )
}

pub fn eventually(what: &str, mut holds: impl FnMut() -> bool) {
    let began = Instant::now();
    while !holds() {
        assert!(began.elapsed() < HANGS, "never: {what}");
        thread::sleep(Duration::from_millis(10));
    }
}

#[test]
#[ignore = "needs QEMU: cargo xtask test runs it"]
fn the_guide_goes_where_it_is_sent_and_the_force_is_that_of_the_model() {
    let (bench, mut client) = bench(11);
    let home = [move_to(0, 0), Step::Tare { duration_ms: 1_000 }];
    measure(&mut client, &home).unwrap();
    let at_tare_m = bench.rig().rig(|rig| rig.position_m());
    let targets_um = [[0, 1_200], [-900, 300]];
    for [x_um, y_um] in targets_um {
        let steps = [move_to(x_um, y_um), Step::Hold { duration_ms: 1_000 }];
        let batches = measure(&mut client, &steps).unwrap();
        assert_eq!(batches.iter().map(|batch| batch.lost_before).sum::<u64>(), 0);
        let (measured_m, force_n, count) = mean(&batches, 1);
        assert!(count >= 999.0, "{count} samples of a hold of 1 s");
        let (true_m, truth) = bench.rig().rig(|rig| (rig.position_m(), rig.truth()));
        let beam = Model::uniform(RigConfig::default().rig, truth.modulus_pa)
            .and_then(|model| model.beam(truth.depth_m))
            .unwrap();
        for axis in [0, 1] {
            let target_m = f64::from([x_um, y_um][axis]) * 1e-6;
            let error_m = true_m[axis] - target_m;
            assert!(
                error_m.abs() < f64::from(REENGAGE_ERROR_UM) * 1e-6,
                "axis {axis} rests {error_m:e} m off its target"
            );
            // A code is 12 um; the mean of a second of noisy codes is far better than one, and offset by half at most.
            let measured_off_m = measured_m[axis] - true_m[axis];
            assert!(measured_off_m.abs() < 7e-6, "axis {axis} is measured {measured_off_m:e} m off");
            // Both the tare and the hold average 1000 readings of 5 mN: 0.16 mN each; counts are 0.05 mN.
            let expected_n = beam.force_n(true_m[axis]) - beam.force_n(at_tare_m[axis]);
            let error_n = force_n[axis] - expected_n;
            assert!(error_n.abs() < 1e-3, "axis {axis}: {error_n:e} N off the model's {expected_n} N");
        }
    }
    assert_eq!(client.losses(), Default::default());
    let counters = client.status().unwrap().counters;
    assert_eq!(counters, Default::default(), "the device counts no loss, no bad reading and no late period");
    drop(client);
    bench.stop().unwrap();
}

#[test]
#[ignore = "needs QEMU: cargo xtask test runs it"]
fn the_emergency_stop_releases_both_bridges_and_stays_until_cleared() {
    let (bench, mut client) = bench(12);
    client.request(Request::LoadStep { index: 0, step: move_to(5_000, 5_000) }).unwrap();
    let crc = protocol::program_crc(&[move_to(5_000, 5_000)]);
    client.request(Request::Run { steps: 1, crc, start_us: 0 }).unwrap();
    eventually("the bridges drive", || bench.rig().bridges_driven());
    bench.rig().inject(Injection { emergency_stop: true, ..Injection::default() });
    eventually("the bridges are released", || !bench.rig().bridges_driven());
    let status = client.status().unwrap();
    assert_eq!((status.state, status.fault), (State::Faulted, Some(Fault::EmergencyStop)));
    let refusal = client.request(Request::ClearFault).unwrap_err();
    assert!(
        matches!(refusal, LinkError::Refused { refusal: Refusal::CauseRemains, .. }),
        "cleared with the button pressed: {refusal}"
    );
    bench.rig().inject(Injection::default());
    eventually("the fault is cleared", || client.request(Request::ClearFault).is_ok());
    assert_eq!(client.status().unwrap().state, State::Idle);
    assert!(!bench.rig().bridges_driven(), "clearing a fault moves nothing");
    drop(client);
    bench.stop().unwrap();
}

#[test]
#[ignore = "needs QEMU: cargo xtask test runs it"]
fn force_readings_that_fail_their_checksum_end_the_motion() {
    let (bench, mut client) = bench(13);
    bench.rig().inject(Injection { corrupt_force: true, ..Injection::default() });
    let ended = measure(&mut client, &[move_to(4_000, 0)]).unwrap_err();
    match ended {
        LinkError::ProgramEnded { fault: Some(Fault::ForceSensor) }
        | LinkError::Refused { refusal: Refusal::Faulted { fault: Fault::ForceSensor }, .. } => {}
        other => panic!("ended with {other}"),
    }
    assert!(!bench.rig().bridges_driven());
    assert!(client.status().unwrap().counters.force_readings_bad > 0);
    drop(client);
    bench.stop().unwrap();
}

#[test]
#[ignore = "needs QEMU: cargo xtask test runs it"]
fn a_firmware_that_hangs_is_given_up_and_its_qemu_killed() {
    let (bench, mut client) = bench(14);
    bench.rig().inject(Injection { freeze: true, ..Injection::default() });
    let given_up = client.status().unwrap_err();
    assert!(matches!(given_up, LinkError::Unanswered { .. } | LinkError::Gone { .. }), "{given_up}");
    assert!(bench.runs().unwrap(), "its time limit is far");
    bench.limit(Duration::from_millis(200));
    eventually("QEMU is killed at its time limit", || !bench.runs().unwrap());
}

#[test]
#[ignore = "needs QEMU: cargo xtask test runs it"]
fn powering_off_ends_the_firmware_with_code_0_and_its_log_is_readable() {
    let (bench, client) = bench(15);
    drop(client);
    let log = bench.stop().unwrap();
    assert!(log.iter().any(|line| line.contains("needle guide")), "{log:?}");
}
