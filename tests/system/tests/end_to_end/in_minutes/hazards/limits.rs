//! Sequences of commands that once led round the limits of force and travel, or into a fault that no command clears.

use super::*;
use device::monitor::{Event, UserCommand, Worker};
use protocol::{Command, RetreatOutcome, encode_command};
use std::path::Path;

fn retreat(client: &mut Client, y_um: i32) -> RetreatOutcome {
    client.request(Request::Retreat { x_um: 0, y_um }).unwrap();
    retreat_ended(client)
}

fn retreat_ended(client: &mut Client) -> RetreatOutcome {
    until(client, |kind| match kind {
        EventKind::RetreatEnded { outcome } => Some(outcome),
        _ => None,
    })
}

#[test]
#[ignore = "needs QEMU: cargo xtask test runs it"]
fn a_load_beyond_the_range_is_removed_by_a_retreat() {
    let (bench, mut client) = bench(RigConfig::default());
    client.request(Request::Limits { force_mn: 5_000, silence_ms: SILENCE_MS }).unwrap();
    assert_eq!(ended(&mut client, &[move_y(9_000, 2_000)]), Outcome::Faulted);
    let fault = client.status().unwrap().fault.unwrap();
    assert!(fault.allows_retreat(), "{fault:?}");
    assert_eq!(refusal(client.request(Request::ClearFault)), Refusal::CauseRemains);
    // Only towards the middle of the travel.
    for (x_um, y_um) in [(0, 800), (0, 1)] {
        assert_eq!(refusal(client.request(Request::Retreat { x_um, y_um })), Refusal::OutOfTravel);
    }
    assert_eq!(retreat(&mut client, -1_000), RetreatOutcome::Unloaded);
    assert_eq!(client.status().unwrap().fault, Some(fault), "it stands until it is cleared");
    eventually("the fault is cleared", || client.request(Request::ClearFault).is_ok());
    assert_eq!(ended(&mut client, &[move_y(0, 2_000)]), Outcome::Completed);
    drop(client);
    bench.stop().unwrap();
}

/// A short retreat that is accepted while the guide still rolls on into the load: what rolled on must not count for the way out.
#[test]
#[ignore = "needs QEMU: cargo xtask test runs it"]
fn hasty_retreats_leave_the_way_out_open() {
    // Slow enough that a request arrives in the few milliseconds after the fault.
    let bench = Bench::start(RigConfig::default(), 41, 0.5, HANGS).unwrap();
    let mut client = Client::connect(&bench.port()).unwrap();
    client.request(Request::Limits { force_mn: 2_000, silence_ms: SILENCE_MS }).unwrap();
    start(&mut client, &[move_y(9_000, 10_000)]);
    let connection = client.connection();
    drop(client);
    let force_n = || bench.rig().rig(|rig| rig.force_n()[1].abs());
    // No client is fast enough: frames are sent without waiting for their answers. All are refused until the fault is latched.
    let port = system::pty::open(Path::new(&bench.port())).unwrap();
    let mut ids = 10_000..;
    let mut request_retreat = || {
        let request = Request::Retreat { x_um: 0, y_um: -20 };
        let command = Command { id: ids.next().unwrap(), connection, request };
        let mut buffer = [0; protocol::MAX_FRAME_TO_DEVICE];
        let frame = encode_command(&command, &mut buffer).unwrap();
        assert_eq!(rustix::io::write(&port, frame), Ok(frame.len()));
    };
    let mut pass = |steps: u64| {
        let start_step = bench.rig().steps();
        while bench.rig().steps() < start_step + steps {
            request_retreat();
            let step = bench.rig().steps();
            while bench.rig().steps() < step + 2 {
                std::thread::sleep(Duration::from_micros(100));
            }
        }
    };
    while force_n() < 2.0 {
        pass(1);
    }
    pass(20);
    drop(port);
    let mut client = Client::connect(&bench.port()).unwrap();
    eventually("the short one has ended", || client.status().unwrap().state == State::Faulted);
    match client.request(Request::Retreat { x_um: 0, y_um: -1_000 }) {
        // Several short ones were accepted if the computer is busy.
        Err(LinkError::Refused { refusal: Refusal::NotUnderLoad, .. }) => {}
        answered => answered.unwrap(),
    }
    eventually("the fault is cleared", || client.request(Request::ClearFault).is_ok());
    drop(client);
    bench.stop().unwrap();
}

/// The force counts from the calibration's zero too: with a tare that is far from it a low limit would be exceeded everywhere.
#[test]
#[ignore = "needs QEMU: cargo xtask test runs it"]
fn a_limit_that_no_position_meets_is_rejected_and_changes_nothing() {
    let (bench, mut client) = bench(RigConfig::default());
    let tare = [move_y(-600, 2_000), Step::Hold { duration_ms: 300 }, Step::Tare { duration_ms: 200 }];
    assert_eq!(ended(&mut client, &tare), Outcome::Completed);
    let zero_counts = client.safety().unwrap().zero_counts;
    let zero_n = client.force_n(zero_counts).map(f64::abs).into_iter().fold(0.0, f64::max);
    let limits_before = client.limits().unwrap();
    let error = client.set_limits(Some(0.9 * zero_n), None).unwrap_err();
    assert!(matches!(error, LinkError::LimitBelowZero { .. }), "{error}");
    assert_eq!(client.limits().unwrap(), limits_before);
    client.set_limits(Some(1.5 * zero_n), None).unwrap();
    assert_eq!(client.status().unwrap().fault, None);
    drop(client);
    bench.stop().unwrap();
}

/// No reading is left to follow: both axes have moved the way they were driven, so the middle is where the tables have
/// it.
#[test]
#[ignore = "needs QEMU: cargo xtask test runs it"]
fn a_converter_that_saturates_in_a_retreat_is_left_towards_the_middle() {
    let (bench, mut client) = bench(RigConfig::default());
    client.request(Request::Limits { force_mn: 2_000, silence_ms: SILENCE_MS }).unwrap();
    assert_eq!(ended(&mut client, &[move_y(6_000, 2_000)]), Outcome::Faulted);
    let start_mm = y_mm(&bench);
    client.request(Request::Retreat { x_um: 0, y_um: -500 }).unwrap();
    bench.rig().inject(Injection { force_saturated: Some(1), ..Injection::default() });
    assert_eq!(retreat_ended(&mut client), RetreatOutcome::Moved);
    assert!((start_mm - y_mm(&bench) - 0.5).abs() < 0.1, "from {start_mm} mm to {} mm", y_mm(&bench));
    assert_eq!(refusal(client.request(Request::Retreat { x_um: 0, y_um: 500 })), Refusal::OutOfTravel);
    bench.rig().inject(Injection::default());
    eventually("the fault is cleared", || {
        let _ = client.request(Request::Retreat { x_um: 0, y_um: -500 }).map(|()| retreat_ended(&mut client));
        client.request(Request::ClearFault).is_ok()
    });
    drop(client);
    bench.stop().unwrap();
}

fn y_mm(bench: &Bench) -> f64 {
    1e3 * bench.rig().rig(|rig| rig.position_m()[1])
}

#[test]
#[ignore = "needs QEMU: cargo xtask test runs it"]
fn the_monitor_retreats_from_a_load() {
    let (bench, mut client) = bench(RigConfig::default());
    client.request(Request::Limits { force_mn: 2_000, silence_ms: SILENCE_MS }).unwrap();
    assert_eq!(ended(&mut client, &[move_y(6_000, 2_000)]), Outcome::Faulted);
    assert_eq!(client.status().unwrap().fault, Some(Fault::ForceLimit));
    let (sender, events) = std::sync::mpsc::channel();
    let worker = Worker::start(client, move |event| drop(sender.send(event))).unwrap();
    worker.send(UserCommand::Clear);
    assert!(!outcome_with("cause of the fault", &events).good);
    // Into the load by an arrow key, and out of it by the key for that.
    worker.send(UserCommand::Jog([0.0, 1e-3]));
    assert!(!outcome_with("towards the middle", &events).good);
    worker.send(UserCommand::Retreat);
    assert!(outcome_with("unloaded", &events).good);
    // Rejected while the guide still settles: a person presses the key again.
    eventually("the fault is cleared", || {
        worker.send(UserCommand::Clear);
        outcome_with("", &events).good
    });
    worker.send(UserCommand::Home);
    assert!(outcome_with("home: done", &events).good);
    drop(worker);
    bench.stop().unwrap();
}

fn outcome_with(wanted: &str, events: &std::sync::mpsc::Receiver<Event>) -> device::monitor::state::Outcome {
    let began = Instant::now();
    while began.elapsed() < HANGS {
        if let Ok(Event::Command(outcome)) = events.recv_timeout(Duration::from_millis(100))
            && outcome.text.contains(wanted)
        {
            return outcome;
        }
    }
    panic!("the monitor does not report {wanted:?}");
}

#[test]
#[ignore = "needs QEMU: cargo xtask test runs it"]
fn tares_under_load_do_not_move_the_force_limit() {
    let (bench, mut client) = bench(RigConfig::default());
    assert_eq!(ended(&mut client, &[move_y(0, 2_000), Step::Tare { duration_ms: 200 }]), Outcome::Completed);
    client.request(Request::Limits { force_mn: 600, silence_ms: SILENCE_MS }).unwrap();
    let zero_counts = client.safety().unwrap().zero_counts;
    let zero_n = client.force_n(zero_counts)[1];
    let mut most_n = 0.0_f64;
    for turn in 1..=10 {
        let steps =
            [move_y(300 * turn, 1_000), Step::Hold { duration_ms: 300 }, Step::Tare { duration_ms: 200 }];
        if ended(&mut client, &steps) == Outcome::Faulted {
            break;
        }
        most_n = most_n.max(bench.rig().rig(|rig| rig.force_n()[1].abs()));
    }
    assert_eq!(client.status().unwrap().fault, Some(Fault::ForceLimit));
    most_n = most_n.max(bench.rig().rig(|rig| rig.force_n()[1].abs()));
    // The rig's own force has the offset of its bridge beside it.
    assert!(most_n < 0.6 + zero_n.abs() + 0.1, "{most_n} N at a limit of 0.6 N and an offset of {zero_n} N");
    drop(client);
    bench.stop().unwrap();
}

#[test]
#[ignore = "needs QEMU: cargo xtask test runs it"]
fn a_tare_under_load_is_rejected() {
    let (bench, mut client) = bench(RigConfig::default());
    let steps = [move_y(3_000, 2_000), Step::Hold { duration_ms: 300 }, Step::Tare { duration_ms: 200 }];
    assert_eq!(ended(&mut client, &steps), Outcome::TareRejected);
    let safety = client.safety().unwrap();
    assert_eq!((safety.tared, safety.zero_counts), (false, [0; 2]));
    drop(client);
    bench.stop().unwrap();
}

#[test]
#[ignore = "needs QEMU: cargo xtask test runs it"]
fn a_ramp_to_the_end_of_the_travel_rests_within_it() {
    let (bench, mut client) = bench(unloaded());
    bench.rig().keep_history();
    assert_eq!(ended(&mut client, &[move_y(0, 2_000)]), Outcome::Completed);
    let ramp = Step::Ramp { x_um: 0, y_um: 10_000, duration_ms: 1_000 };
    assert_eq!(ended(&mut client, &[ramp]), Outcome::Completed);
    eventually("it has come to rest", || !bench.rig().bridges_driven());
    let start_step = bench.rig().steps();
    eventually("time passes", || bench.rig().steps() > start_step + 300);
    let final_mm = bench.rig().rig(|rig| rig.position_m()[1]) * 1e3;
    let most_mm = bench.rig().take_reach().position_m * 1e3;
    println!("rests at {final_mm} mm, at most {most_mm} mm");
    assert!(final_mm < 10.06 && most_mm < 10.1, "rests at {final_mm} mm, at most {most_mm} mm");
    drop(client);
    bench.stop().unwrap();
}

#[test]
#[ignore = "needs QEMU: cargo xtask test runs it"]
fn a_frame_from_before_does_not_move_the_guide_again() {
    let (bench, mut client) = bench(RigConfig::default());
    assert_eq!(ended(&mut client, &[move_y(0, 2_000), move_y(500, 1_000)]), Outcome::Completed);
    let connection = client.connection();
    let old: Vec<Vec<u8>> = (0..60)
        .map(|id| {
            let steps = [move_y(0, 2_000), move_y(500, 1_000)];
            let request = Request::Run { steps: 2, crc: program_crc(&steps), start_us: 0 };
            let mut buffer = [0; protocol::MAX_FRAME_TO_DEVICE];
            encode_command(&Command { id, connection, request }, &mut buffer).unwrap().to_vec()
        })
        .collect();
    for _ in 0..60 {
        client.status().unwrap();
    }
    drop(client);
    let counters = {
        let port = system::pty::open(Path::new(&bench.port())).unwrap();
        for frame in &old {
            assert_eq!(rustix::io::write(&port, frame), Ok(frame.len()));
        }
        let start_step = bench.rig().steps();
        eventually("they have arrived", || bench.rig().steps() > start_step + 3_000);
        drop(port);
        Client::connect(&bench.port()).unwrap().status().unwrap()
    };
    assert_eq!((counters.state, counters.fault), (State::Idle, None));
    assert!(
        bench.rig().released_since().is_some_and(|since| bench.rig().steps() > since + 3_000),
        "it moved"
    );
    bench.stop().unwrap();
}

#[test]
#[ignore = "needs QEMU: cargo xtask test runs it"]
fn a_start_years_ahead_is_refused() {
    let (bench, mut client) = bench(RigConfig::default());
    let run = load(&mut client, &[move_y(0, 1_000)], u64::MAX);
    assert_eq!(refusal(client.request(run)), Refusal::OutOfRange);
    let description = client.description().unwrap();
    assert_eq!(description.start_limit_us, protocol::START_LIMIT_US);
    assert_eq!(description.schema_hash, protocol::schema_hash());
    drop(client);
    bench.stop().unwrap();
}
