//! The host, and the cable to it.

use super::*;
use protocol::{Command, Message};
use sequences::plant::Build;
use sequences::rig::Rig;
use std::collections::BTreeSet;
use system::sequences::lockstep::Lockstep;

#[test]
#[ignore = "needs QEMU: cargo xtask test runs it"]
fn the_host_is_killed() {
    let (bench, mut client) = bench(RigConfig::default());
    client.request(Request::Limits { force_mn: 4_000, silence_ms: 1_500 }).unwrap();
    bench.rig().host_may_be_silent(true);
    start(&mut client, &[move_y(1_000, 2_000), Step::Hold { duration_ms: 600_000 }]);
    // The time of a status is that of the period in which its request was received.
    let last_command_us = client.status().unwrap().t_us;
    let began = Instant::now();
    let fault_us = loop {
        assert!(began.elapsed() < HANGS, "no fault");
        if let Some(Telemetry::Event(event)) = client.next(Duration::from_millis(100)).unwrap()
            && event.kind == (EventKind::Faulted { fault: Fault::HostSilent })
        {
            break event.t_us;
        }
    };
    // The first period after the time that is set. A request that was sent twice, because its answer came late, was received once
    // more, before its answer was sent.
    let since_answer_ms = (fault_us / 1_000).saturating_sub(bench.rig().answered_ms());
    assert!(fault_us >= last_command_us + 1_501_000, "after {} us", fault_us - last_command_us);
    assert!((1_480..=1_501).contains(&since_answer_ms), "{since_answer_ms} ms after the last answer");
    eventually("the bridges are off", || !bench.rig().bridges_driven());
    clears(&bench, &mut client);
    drop(client);
    bench.stop().unwrap();
}

/// A program runs, and then the link has these troubles: the device stops, and reports it when the link is back.
fn without_a_host(trouble: impl FnOnce(&NoisyWire)) -> protocol::Counters {
    let (bench, client) = bench(RigConfig::default());
    drop(client);
    bench.rig().host_may_be_silent(true);
    let wire = NoisyWire::connect(&bench.folder().join("serial"), 5).unwrap();
    let mut client = Client::connect(&wire.port()).unwrap();
    client.request(Request::Limits { force_mn: 4_000, silence_ms: 1_500 }).unwrap();
    start(&mut client, &[move_y(1_000, 2_000), Step::Hold { duration_ms: 600_000 }]);
    let last_command_us = client.status().unwrap().t_us;
    trouble(&wire);
    eventually("the silence is long", || bench.rig().steps() * 1_000 > last_command_us + 2_500_000);
    assert!(!bench.rig().bridges_driven());
    wire.babble(0.0);
    wire.mend();
    eventually("it answers again", || client.status().is_ok());
    let status = client.status().unwrap();
    assert_eq!((status.state, status.fault), (State::Faulted, Some(Fault::HostSilent)));
    drop(client);
    drop(wire);
    bench.stop().unwrap();
    status.counters
}

#[test]
#[ignore = "needs QEMU: cargo xtask test runs it"]
fn the_link_is_cut() {
    let counters = without_a_host(NoisyWire::cut);
    assert_eq!((counters.control_overruns, counters.faults), (0, 1));
}

#[test]
#[ignore = "needs QEMU: cargo xtask test runs it"]
fn a_babbling_host_is_no_host() {
    let counters = without_a_host(|wire| wire.babble(2.0));
    assert!(counters.frames_corrupt + counters.frames_overlong > 0, "{counters:?}");
    assert_eq!((counters.control_overruns, counters.faults), (0, 1));
}

/// A conversation is recorded at one power-on and sent again, whole and as it was, at each of the next ones: nothing moves.
#[test]
#[ignore = "needs QEMU: cargo xtask test runs it"]
fn what_was_recorded_at_one_power_on_is_not_carried_out_at_another() {
    let mut firmware = Lockstep::start(quiet_rig(), HANGS).unwrap();
    let hello = Command { id: 0, connection: 0, request: Request::Hello };
    let first = token(firmware.ask(&hello).unwrap());
    let step = move_y(2_000, 2_000);
    let run = Request::Run { steps: 1, crc: program_crc(&[step]), start_us: 0 };
    let recorded: Vec<Command> = (1..)
        .zip([Request::LoadStep { index: 0, step }, run])
        .map(|(id, request)| Command { id, connection: first, request })
        .collect();
    for command in &recorded {
        let answered = firmware.ask(command).unwrap();
        assert!(matches!(answered.last(), Some(Message::Ack { .. })), "{answered:?}");
    }
    let mut tokens = BTreeSet::from([first]);
    for power_on in 1..5 {
        for _ in 0..200 {
            firmware.period().unwrap();
        }
        let folder = firmware.stop().unwrap();
        firmware = Lockstep::power_on(folder, quiet_rig(), HANGS).unwrap();
        assert!(tokens.insert(token(firmware.ask(&hello).unwrap())), "power-on {power_on}: {tokens:?}");
        for command in &recorded {
            let answered = firmware.ask(command).unwrap();
            let refused = Message::Refused { id: command.id, refusal: Refusal::OtherBoot };
            assert_eq!(answered.last(), Some(&refused), "power-on {power_on}");
        }
        for _ in 0..200 {
            firmware.period().unwrap();
            assert!(!firmware.driven, "power-on {power_on}");
        }
    }
    firmware.stop().unwrap();
}

fn token(messages: Vec<Message>) -> u32 {
    let found = messages.into_iter().find_map(|message| match message {
        Message::Connected { connection } => Some(connection),
        _ => None,
    });
    found.expect("a hello is answered with a token")
}

fn quiet_rig() -> Rig {
    Rig::new(Build::default(), 1)
}
