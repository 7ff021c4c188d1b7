//! The link's thread against a device that misbehaves.

use super::*;
use crate::link::{Program, Telemetry};
use fake_device::{Act, BOOT_ID, FakeDevice, Script};
use protocol::{Fault, Request, Step};
#[cfg(unix)]
use std::path::Path;
use std::sync::Arc;

const TIMEOUT: Duration = Duration::from_secs(10);

fn started(port: &str) -> (Worker, Receiver<Event>) {
    let (sender, events) = mpsc::channel();
    let client = Client::connect(port).expect("connects");
    (
        Worker::start(client, move |event| {
            // The test may have ended.
            let _ = sender.send(event);
        })
        .expect("a thread"),
        events,
    )
}

fn with_program(program: &[Act]) -> (FakeDevice, Worker, Receiver<Event>) {
    let device = FakeDevice::start(Script { program: program.to_vec(), ..Script::default() });
    let (worker, events) = started(&device.port);
    (device, worker, events)
}

/// Waits for an event and returns what is wanted of it.
fn wait_for<T>(events: &Receiver<Event>, mut wanted: impl FnMut(Event) -> Option<T>) -> T {
    let deadline = Instant::now() + TIMEOUT;
    loop {
        let remaining = deadline.saturating_duration_since(Instant::now());
        if let Some(event) = wanted(events.recv_timeout(remaining).expect("the event comes in time")) {
            return event;
        }
    }
}

fn outcome(events: &Receiver<Event>) -> (String, bool) {
    wait_for(events, |event| match event {
        Event::Command(outcome) => Some((outcome.text, outcome.good)),
        _ => None,
    })
}

fn lost(events: &Receiver<Event>) -> String {
    wait_for(events, |event| match event {
        Event::Lost(reason) => Some(reason),
        _ => None,
    })
}

fn connected(events: &Receiver<Event>) -> u32 {
    wait_for(events, |event| match event {
        Event::Connected { boot_id, .. } => Some(boot_id),
        _ => None,
    })
}

fn moves(device: &FakeDevice) -> Vec<[i32; 2]> {
    let executed = device.executed();
    let targets = executed.iter().filter_map(|request| match request {
        Request::LoadStep { step: Step::Move { x_um, y_um, .. }, .. } => Some([*x_um, *y_um]),
        _ => None,
    });
    targets.collect()
}

#[test]
fn telemetry_is_switched_on_and_off_and_the_state_requested() {
    let (device, worker, events) = with_program(&[]);
    assert_eq!(connected(&events), BOOT_ID);
    for _ in 0..5 {
        wait_for(&events, |event| matches!(event, Event::Telemetry(Telemetry::Status(_))).then_some(()));
    }
    wait_for(&events, |event| matches!(event, Event::LinkTotals(totals) if totals.bytes > 0).then_some(()));
    drop(worker);
    assert_eq!(device.executed(), [Request::Stream { enable: true }, Request::Stream { enable: false }]);
}

#[test]
fn jogs_go_on_from_where_the_guide_was_sent_last() {
    let (device, worker, events) = with_program(&[Act::Batch(32), Act::Complete]);
    for (by_m, text) in [
        ([0.5e-3, 0.0], "jog to x +0.501 mm, y +0.002 mm"),
        ([0.0, -1e-3], "jog to x +0.501 mm, y -0.998 mm"),
    ] {
        worker.send(UserCommand::Jog(by_m));
        assert_eq!(outcome(&events), (format!("{text} ..."), true));
        assert_eq!(outcome(&events), (format!("{text}: done"), true));
    }
    worker.send(UserCommand::Home);
    outcome(&events);
    assert_eq!(outcome(&events), ("home: done".to_owned(), true));
    worker.send(UserCommand::Jog([0.0, 0.1e-3]));
    outcome(&events);
    outcome(&events);
    assert_eq!(moves(&device), [[501, 2], [501, -998], [0, 0], [0, 100]]);
}

#[test]
fn one_jog_waits_for_the_end_of_another_and_a_second_replaces_it() {
    let (device, worker, events) = with_program(&[Act::Batch(32), Act::Wait(300), Act::Complete]);
    worker.send(UserCommand::Jog([1e-3, 0.0]));
    assert!(outcome(&events).0.ends_with("..."));
    worker.send(UserCommand::Jog([0.0, 1e-3]));
    worker.send(UserCommand::Jog([0.0, 2e-3]));
    assert_eq!(outcome(&events).0, "one jog waits already: this one takes its place");
    assert!(outcome(&events).0.ends_with(": done"));
    assert!(outcome(&events).0.ends_with("..."));
    assert!(outcome(&events).0.ends_with(": done"));
    assert_eq!(moves(&device).len(), 2);
}

#[test]
fn a_stop_cancels_a_program_that_waits() {
    let (sender, commands) = mpsc::channel();
    for command in [UserCommand::Home, UserCommand::Stop, UserCommand::Clear] {
        sender.send(command).expect("the receiver is there");
    }
    assert_eq!(waiting(&commands), Some(vec![UserCommand::Stop, UserCommand::Clear]));
    assert_eq!(waiting(&commands), Some(Vec::new()));
    drop(sender);
    assert_eq!(waiting(&commands), None);
}

#[test]
fn an_end_that_was_lost_is_found_and_a_fault_is_named() {
    let (_device, worker, events) = with_program(&[Act::Batch(32), Act::CompleteWithoutEvent]);
    worker.send(UserCommand::Tare);
    assert_eq!(outcome(&events), ("tare ...".to_owned(), true));
    assert_eq!(outcome(&events), ("tare: done".to_owned(), true));
    let (_device, worker, events) = with_program(&[Act::Batch(32), Act::Fail(Fault::Stall)]);
    worker.send(UserCommand::Home);
    outcome(&events);
    let (text, good) = outcome(&events);
    assert!(text.contains("fault 7") && text.contains("jam") && !good, "{text}");
}

#[test]
fn in_a_fault_under_load_jogs_are_retreats_and_a_key_leads_to_the_middle() {
    let (device, worker, events) = with_program(&[Act::Batch(32), Act::Fail(Fault::ForceLimit)]);
    worker.send(UserCommand::Home);
    outcome(&events);
    assert!(outcome(&events).0.contains("fault 5"));
    // The fake device's guide is there.
    worker.send(UserCommand::Retreat);
    let (text, good) = outcome(&events);
    assert!(text.contains("open the needle's clamp") && !good, "{text}");
    worker.send(UserCommand::Jog([2e-3, 0.0]));
    assert_eq!(outcome(&events), ("retreat by x +1.000 mm, y +0.000 mm ...".to_owned(), true));
    assert_eq!(outcome(&events), ("retreat: unloaded: `guide clear` clears the fault".to_owned(), true));
    fn retreats(request: &&Request) -> bool {
        matches!(request, Request::Retreat { .. })
    }
    assert_eq!(device.executed().iter().filter(retreats).count(), 1);
    assert_eq!(moves(&device).len(), 1, "only the way home before the fault");
}

#[test]
fn what_cannot_be_done_is_reported_and_ends_nothing() {
    let (_device, worker, events) = with_program(&[]);
    worker.send(UserCommand::Jog([2_000.0, 0.0]));
    let (text, good) = outcome(&events);
    assert!(text.contains("within 1000") && !good, "{text}");
    worker.send(UserCommand::Clear);
    assert_eq!(outcome(&events), ("cleared".to_owned(), true));
    worker.send(UserCommand::Stop);
    assert_eq!(outcome(&events), ("stopped".to_owned(), true));
}

#[test]
fn leaving_while_something_moves_stops_it() {
    let (device, worker, events) = with_program(&[Act::Batch(32)]);
    worker.send(UserCommand::Home);
    outcome(&events);
    drop(worker);
    let executed = device.executed();
    assert_eq!(executed[executed.len() - 2..], [Request::Stop, Request::Stream { enable: false }]);
}

#[test]
fn a_device_that_restarts_is_connected_again_at_once() {
    let (_device, worker, events) = with_program(&[Act::Batch(32), Act::Restart]);
    assert_eq!(connected(&events), BOOT_ID);
    worker.send(UserCommand::Home);
    assert!(lost(&events).contains("restarted"));
    let started = Instant::now();
    assert_eq!(connected(&events), BOOT_ID + 1);
    assert!(started.elapsed() < RECONNECT);
}

/// Another device at the same name is a link to another pseudo terminal.
#[cfg(unix)]
#[test]
fn a_device_that_is_plugged_in_again_is_found_and_orders_meanwhile_are_not_kept() {
    let folder = tempfile::tempdir().expect("a folder");
    let port = folder.path().join("port");
    fn lead_to(device: &FakeDevice, port: &std::path::PathBuf) {
        let _ = std::fs::remove_file(port);
        std::os::unix::fs::symlink(Path::new(&device.port), port).expect("a link");
    }
    let program = vec![Act::Batch(32), Act::Wait(200), Act::Vanish];
    let first = FakeDevice::start(Script { program, ..Script::default() });
    lead_to(&first, &port);
    let (worker, events) = started(port.to_str().expect("UTF-8"));
    connected(&events);
    worker.send(UserCommand::Home);
    assert!(lost(&events).contains("disappeared"));
    worker.send(UserCommand::Home);
    assert_eq!(outcome(&events), ("not done: there is no connection".to_owned(), false));
    drop(first);
    lost(&events);
    let second = FakeDevice::start(Script::default());
    lead_to(&second, &port);
    assert_eq!(connected(&events), BOOT_ID);
    drop(worker);
    assert!(moves(&second).is_empty(), "an command from before the connection was carried out");
}

#[test]
fn a_program_of_several_steps_is_loaded_whole_and_its_end_is_reported() {
    let (device, worker, events) = with_program(&[Act::Batch(32), Act::Complete]);
    let program = Program::load("displace").expect("built in");
    let (name, steps) = (program.name.clone(), program.device_steps());
    worker.send(UserCommand::Run(Arc::new(program)));
    assert_eq!(outcome(&events), (format!("{name} ..."), true));
    assert_eq!(outcome(&events), (format!("{name}: done"), true));
    let executed = device.executed();
    let loaded = executed.iter().filter_map(|request| match request {
        Request::LoadStep { step, .. } => Some(*step),
        _ => None,
    });
    assert_eq!(loaded.collect::<Vec<_>>(), steps);
    let run = executed.iter().find_map(|request| match request {
        Request::Run { steps, crc, .. } => Some((usize::from(*steps), *crc)),
        _ => None,
    });
    assert_eq!(run, Some((steps.len(), protocol::program_crc(&steps))));
}
