//! The link against a device that misbehaves.

use super::keepalive::INTERVAL;
use super::{Batch, Client, Limits, LinkError, LinkLosses, Program, RunOptions, Telemetry, run};
use fake_device::{self as fake, Act, FakeDevice, Script};
use protocol::{CalibrationRecord, Fault, Refusal, Request, State, Step, Text};
use std::sync::atomic::AtomicBool;
use std::time::Duration;

static NEVER: AtomicBool = AtomicBool::new(false);
const OPTIONS: RunOptions = RunOptions { start_us: None, stream: true, interrupted: &NEVER };

fn hold() -> Program {
    Program::single("hold", Step::Hold { duration_ms: 1_000 })
}

/// Runs a program on the device; what was streamed, and how it ended.
fn run_program(client: &mut Client) -> (Vec<Batch>, Result<(), LinkError>) {
    let mut batches = Vec::new();
    let ended = run(client, &hold(), OPTIONS, |_, telemetry| {
        if let Telemetry::Samples(batch) = telemetry {
            batches.push(batch.clone());
        }
        Ok(())
    });
    (batches, ended)
}

fn with_program(program: &[Act]) -> (FakeDevice, Client) {
    let device = FakeDevice::start(Script { program: program.to_vec(), ..Script::default() });
    let client = Client::connect(&device.port).expect("connects");
    (device, client)
}

/// Samples received and samples lost before each batch.
fn account(batches: &[Batch]) -> (usize, Vec<u64>) {
    (batches.iter().map(|b| b.points.len()).sum(), batches.iter().map(|b| b.lost_before).collect())
}

fn connect_error(script: Script) -> LinkError {
    let device = FakeDevice::start(script);
    match Client::connect_within(&device.port, 1) {
        Ok(_) => panic!("connected"),
        Err(error) => error,
    }
}

#[test]
fn a_whole_run_loses_nothing() {
    let (device, mut client) = with_program(&[Act::Batch(32), Act::Batch(32), Act::Batch(5), Act::Complete]);
    let (batches, ended) = run_program(&mut client);
    ended.expect("completes");
    assert_eq!(account(&batches), (69, vec![0, 0, 0]));
    assert_eq!(client.losses(), LinkLosses::default());
    let first = batches[0].points[0];
    assert!((first.time_s - 1.001).abs() < 1e-9);
    assert!((first.displacement_m[1] - 1_001e-6).abs() < 1e-12, "1 um per count");
    assert!((first.force_n[1] - 10_010.0 * 50e-6).abs() < 1e-9, "50 uN per count");
    let executed = device.executed();
    assert!(matches!(
        executed[..],
        [
            Request::LoadStep { index: 0, .. },
            Request::Stream { enable: true },
            Request::Run { steps: 1, start_us: 0, .. },
            Request::Stream { enable: false },
        ]
    ));
}

#[test]
fn damaged_lost_and_dropped_samples_are_counted_where_they_are_missing() {
    let program = [
        Act::Batch(10),
        Act::Corrupt(7),
        Act::Batch(10),
        Act::Lost(3),
        Act::Lost(4),
        Act::Batch(10),
        Act::Dropped(6),
        Act::Batch(10),
        Act::Complete,
    ];
    let (_device, mut client) = with_program(&program);
    let (batches, ended) = run_program(&mut client);
    ended.expect("completes");
    assert_eq!(account(&batches), (40, vec![0, 7, 7, 6]));
    let losses = client.losses();
    assert_eq!(
        (losses.samples_missing, losses.frames_missing, losses.frames_corrupt, losses.frames_unreadable),
        (20, 3, 1, 0)
    );
}

#[test]
fn a_command_whose_answer_is_lost_is_repeated_and_carried_out_once() {
    let device = FakeDevice::start(Script { lost_answers: 2, ..Script::default() });
    let mut client = Client::connect(&device.port).expect("connects");
    client.request(Request::ClearFault).expect("answered at the third try");
    assert_eq!(device.executed(), [Request::ClearFault]);
}

/// A hello that was sent again meanwhile begins another connection; that of the first answer stays.
#[test]
fn a_device_that_answers_late_is_connected_to_once() {
    let device = FakeDevice::start(Script { first_answer_after_ms: 700, ..Script::default() });
    let mut client = Client::connect(&device.port).expect("connects");
    client.request(Request::ClearFault).expect("the first connection is open");
    assert_eq!(device.executed(), [Request::ClearFault]);
}

#[test]
fn a_device_that_never_answers_a_command_is_given_up() {
    let device = FakeDevice::start(Script { lost_answers: usize::MAX, ..Script::default() });
    let mut client = Client::connect(&device.port).expect("connects");
    let error = client.request(Request::Stop).expect_err("no answer");
    assert!(matches!(error, LinkError::Unanswered { command: "stop", .. }), "{error}");
    assert_eq!(device.executed().len(), 1, "repeats are not carried out again");
}

#[test]
fn a_lost_status_is_requested_again_and_an_older_one_is_not_taken_for_it() {
    let device = FakeDevice::start(Script { lost_statuses: 2, ..Script::default() });
    let mut client = Client::connect(&device.port).expect("connects");
    assert_eq!(client.status().expect("the third arrives").position_counts, [1, 2]);
}

#[test]
fn the_end_of_an_earlier_program_is_not_that_of_this_one() {
    let device = FakeDevice::start(Script { late_end: true, ..Script::default() });
    let mut client = Client::connect(&device.port).expect("connects");
    let (batches, ended) = run_program(&mut client);
    ended.expect("completes");
    assert_eq!(account(&batches), (32, vec![0]));
}

#[test]
fn a_refusal_is_typed_and_explained() {
    let device = FakeDevice::start(Script { refusal: Some(Refusal::OutOfTravel), ..Script::default() });
    let mut client = Client::connect(&device.port).expect("connects");
    let error = client.request(Request::ClearFault).expect_err("refused");
    assert!(matches!(error, LinkError::Refused { refusal: Refusal::OutOfTravel, .. }));
    assert!(error.to_string().contains("beyond the travel"), "{error}");
}

#[test]
fn no_answer_and_another_protocol_are_distinguished() {
    let mute = connect_error(Script { mute: true, ..Script::default() });
    assert!(matches!(mute, LinkError::NoAnswer { tries: 1, bytes: 0, .. }), "{mute}");
    let newer = connect_error(Script { version: protocol::VERSION + 1, ..Script::default() });
    assert!(matches!(newer, LinkError::OtherVersion { .. }), "{newer}");
    let mismatch = connect_error(Script { schema_hash: [9; 8], ..Script::default() });
    assert!(matches!(&mismatch, LinkError::OtherSchema { commit, .. } if commit == "fake"), "{mismatch}");
}

/// The bytes of a hello of version 3, as its firmware sends them.
#[test]
fn a_device_of_version_3_is_refused_with_a_clear_line() {
    let old = connect_error(Script { version: 3, ..Script::default() });
    assert!(matches!(old, LinkError::OtherVersion { theirs: 3, ours: protocol::VERSION, .. }), "{old}");
    assert!(old.to_string().contains("uses protocol version 3"), "{old}");
    // A hello of our own version with a field more cannot be read, and is no other version.
    let longer = super::client::other_version("p", protocol::VERSION).to_string();
    assert!(longer.contains("message types differ") && !longer.contains("this program uses"), "{longer}");
}

#[test]
fn a_connection_whose_ids_are_used_up_is_followed_by_another() {
    let device = FakeDevice::start(Script::default());
    let mut client = Client::connect(&device.port).expect("connects");
    client.skip_ids(u16::MAX - 1);
    for _ in 0..4 {
        client.request(Request::ClearFault).expect("answered");
    }
    assert_eq!(device.executed(), [Request::ClearFault; 4]);
}

#[test]
fn an_answer_that_never_comes_with_its_acknowledgement_is_named() {
    let device = FakeDevice::start(Script { lost_statuses: usize::MAX, ..Script::default() });
    let mut client = Client::connect(&device.port).expect("connects");
    let error = client.status().expect_err("only acknowledged");
    assert!(matches!(error, LinkError::AnswerMissing { command: "status", .. }), "{error}");
    assert!(error.to_string().contains("acknowledged `status` 5 times without its answer"), "{error}");
}

#[test]
fn a_missing_port_is_named() {
    let nowhere = Client::connect("/dev/no-such-port").err().expect("no port");
    assert!(nowhere.to_string().contains("no such port"), "{nowhere}");
}

/// A server decides itself whom it serves.
#[cfg(unix)]
#[test]
fn a_port_in_use_is_named() {
    let device = FakeDevice::start(Script::default());
    let _first = Client::connect(&device.port).expect("connects");
    let second = Client::connect(&device.port).err().expect("in use");
    assert!(second.to_string().contains("in use by another program"), "{second}");
}

#[test]
fn a_port_that_disappears_gives_what_came_before() {
    let (_device, mut client) = with_program(&[Act::Batch(32), Act::Batch(8), Act::Wait(200), Act::Vanish]);
    let (batches, ended) = run_program(&mut client);
    assert_eq!(account(&batches).0, 40);
    let error = ended.expect_err("gone");
    assert!(matches!(error, LinkError::Gone { .. }), "{error}");
}

#[test]
fn a_restart_in_mid_run_is_no_end_of_the_program() {
    let (_device, mut client) = with_program(&[Act::Batch(32), Act::Restart, Act::Batch(8)]);
    let (batches, ended) = run_program(&mut client);
    assert_eq!(account(&batches).0, 32);
    assert!(matches!(ended, Err(LinkError::Restarted { .. })));
}

#[test]
fn a_fault_ends_the_run_and_is_named() {
    let (_device, mut client) = with_program(&[Act::Batch(32), Act::Fail(Fault::ForceRange)]);
    let (_, ended) = run_program(&mut client);
    let error = ended.expect_err("faulted");
    assert!(matches!(error, LinkError::ProgramEnded { fault: Some(Fault::ForceRange) }), "{error}");
    assert_eq!(client.status().expect("answers").state, State::Faulted);
}

/// A host that is behind has requested the state before it has handled what came first.
#[test]
fn an_end_found_by_a_status_loses_no_sample() {
    let (_device, mut client) =
        with_program(&[Act::Batch(32), Act::Batch(32), Act::Batch(9), Act::CompleteWithoutEvent]);
    let mut samples = 0;
    run(&mut client, &hold(), OPTIONS, |_, telemetry| {
        if let Telemetry::Samples(batch) = telemetry {
            if samples == 0 {
                std::thread::sleep(INTERVAL + Duration::from_millis(50));
            }
            samples += batch.points.len();
        }
        Ok::<(), LinkError>(())
    })
    .expect("completes");
    assert_eq!(samples, 73);
}

/// A host that is behind notices that the port has gone before it has handled what came first.
#[test]
fn a_port_that_disappears_while_the_host_is_behind_loses_no_sample() {
    let program = [Act::Batch(32), Act::Batch(32), Act::Batch(9), Act::Wait(200), Act::Vanish];
    let (_device, mut client) = with_program(&program);
    let mut samples = 0;
    let ended = run(&mut client, &hold(), OPTIONS, |_, telemetry| {
        if let Telemetry::Samples(batch) = telemetry {
            if samples == 0 {
                std::thread::sleep(INTERVAL + Duration::from_millis(50));
            }
            samples += batch.points.len();
        }
        Ok::<(), LinkError>(())
    });
    assert!(matches!(ended, Err(LinkError::Gone { .. })));
    assert_eq!(samples, 73);
}

/// The device's clock runs ten times as fast as this machine's, as that of a simulated rig may. By its own clock the host would request
/// the status three times.
#[test]
fn a_device_with_a_fast_clock_receives_commands_in_time() {
    let mut program = vec![[Act::Batch(32), Act::Wait(3)]; 200].concat();
    program.push(Act::Complete);
    let device = FakeDevice::start(Script { program, is_patient: true, ..Script::default() });
    let mut client = Client::connect(&device.port).expect("connects");
    let (batches, ended) = run_program(&mut client);
    ended.expect("completes");
    assert_eq!(account(&batches).0, 6_400);
    assert!(device.questions() >= 6, "{}", device.questions());
}

/// Every answer gets lost while the program runs, and every request arrives: the device takes only new frames for signs of life.
#[test]
fn a_line_that_loses_all_answers_carries_new_keepalives_all_the_same() {
    let mut program = vec![Act::Batch(32), Act::Question, Act::LoseAnswers(usize::MAX)];
    program.extend([[Act::Batch(32), Act::Wait(3)]; 200].concat());
    program.extend([Act::LoseAnswers(0), Act::Complete]);
    let device = FakeDevice::start(Script { program, is_patient: true, ..Script::default() });
    let mut client = Client::connect(&device.port).expect("connects");
    let (_, ended) = run_program(&mut client);
    ended.expect("completes");
    assert!(device.questions() >= 6, "{}", device.questions());
}

#[test]
fn a_status_whose_answers_are_lost_is_requested_by_new_frames() {
    let device = FakeDevice::start(Script { lost_answers: 2, ..Script::default() });
    let mut client = Client::connect(&device.port).expect("connects");
    client.status().expect("answers at the third request");
    assert_eq!(device.questions(), 3);
}

#[test]
fn a_silent_device_receives_commands_all_the_same() {
    let (device, mut client) = with_program(&[Act::Wait(900), Act::Complete]);
    let (_, ended) = run_program(&mut client);
    ended.expect("completes");
    assert!(device.questions() >= 3, "{}", device.questions());
}

#[test]
fn a_host_that_is_busy_for_too_long_is_reported_as_silent() {
    let mut program = vec![Act::Batch(32); 80];
    program.push(Act::Complete);
    let (_device, mut client) = with_program(&program);
    let (_, ended) = run_program(&mut client);
    let error = ended.expect_err("2.6 s at once");
    assert!(matches!(error, LinkError::ProgramEnded { fault: Some(Fault::HostSilent) }), "{error}");
    assert!(error.to_string().contains("no command was accepted from the host"), "{error}");
}

#[test]
fn limits_are_set_one_by_one_and_checked_first() {
    let device = FakeDevice::start(Script::default());
    let mut client = Client::connect(&device.port).expect("connects");
    assert_eq!(client.limits().expect("answers"), Limits { force_n: 4.0, silence_s: 2.0 });
    let set = client.set_limits(Some(2.5), None).expect("taken");
    assert_eq!(set, Limits { force_n: 2.5, silence_s: 2.0 });
    assert_eq!(client.set_limits(None, Some(5.0)).expect("taken"), Limits { force_n: 2.5, silence_s: 5.0 });
    for (force_n, silence_s, expected) in [
        (Some(6.0), None, "limit of the force: 6 N, expected 0.001 to 5 N"),
        (Some(f64::NAN), None, "limit of the force: NaN N, expected 0.001 to 5 N"),
        (None, Some(0.1), "limit of the silence: 0.1 s, expected 0.2 to 60 s"),
    ] {
        assert_eq!(client.set_limits(force_n, silence_s).expect_err("refused").to_string(), expected);
    }
    assert_eq!(device.executed().len(), 2, "what cannot be taken is not sent");
}

#[test]
fn a_calibration_is_kept_through_the_restart_that_follows() {
    let device = FakeDevice::start(Script::default());
    let mut client = Client::connect(&device.port).expect("connects");
    let mut record = client.calibration().expect("answers");
    assert_eq!(record, fake::calibration());
    (record.id, record.travel_um) = (Text::new("fake-2"), 9_000);
    let mut client = client.store_calibration(&record).expect("kept");
    assert_eq!(client.boot_id(), fake::BOOT_ID + 1);
    assert_eq!(client.hello().calibration.id.as_str(), "fake-2");
    assert_eq!(client.calibration().expect("answers"), record);
}

#[test]
fn a_calibration_that_is_not_kept_is_reported() {
    let device = FakeDevice::start(Script { keeps_no_calibration: true, ..Script::default() });
    let client = Client::connect(&device.port).expect("connects");
    let record = CalibrationRecord { id: Text::new("fake-2"), ..fake::calibration() };
    let error = client.store_calibration(&record).err().expect("not kept");
    assert!(matches!(error, LinkError::CalibrationNotKept { .. }), "{error}");
    assert!(error.to_string().contains("works with `fake-1`"), "{error}");

    let device =
        FakeDevice::start(Script { refusal: Some(Refusal::CalibrationInvalid), ..Script::default() });
    let client = Client::connect(&device.port).expect("connects");
    let error = client.store_calibration(&record).err().expect("refused");
    assert!(matches!(error, LinkError::Refused { refusal: Refusal::CalibrationInvalid, .. }), "{error}");
}
