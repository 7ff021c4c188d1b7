//! Tests of the state after events.

use super::*;
use crate::link::LinkLosses;
use crate::monitor::report::Report;
use crate::monitor::testing::{batch, hello, running, status};

fn received(status: Status) -> Event {
    Event::Telemetry(Telemetry::Status(Box::new(status)))
}

#[test]
fn force_and_position_are_means_over_a_tenth_of_a_second() {
    let state = running(3);
    let (displacement_m, force_n) = state.mean().expect("streamed");
    // 2900 to 2999 ms of a ramp of 0.3 mm/s.
    assert!((displacement_m[1] - 0.3e-3 * 2.9495).abs() < 1e-9, "{displacement_m:?}");
    assert!((force_n[1] - 1_530.0 * displacement_m[1]).abs() < 1e-9);
    assert!((displacement_m[0] + 0.25e-3).abs() < 1e-12);
}

#[test]
fn without_samples_the_status_is_used() {
    let mut state = State::new("p");
    assert_eq!(state.mean(), None);
    state.take(Event::Connected { boot_id: 1, hello: hello(0, None) }, 0.0);
    state.take(received(status(1_000, None)), 0.1);
    let (displacement_m, force_n) = state.mean().expect("a status");
    assert!((displacement_m[1] - 1.2e-3).abs() < 1e-12);
    assert!((force_n[1] - 1.893).abs() < 1e-9);
}

#[test]
fn stiffness_comes_with_an_interval_or_not_at_all() {
    let mut state = running(1);
    let [x, y] = state.stiffness();
    assert_eq!(x, None);
    let y = y.expect("reported");
    assert!((y.value_n_per_m - 1_530.0).abs() < 1e-9);
    let [low, high] = y.ci95_n_per_m;
    assert!((high - low - 2.0 * 1.962 * 20.0).abs() < 0.1, "{low} to {high}");
    for readings in [0, 1, 2] {
        let estimate = protocol::Stiffness { slope_mn_per_m: 1, sd_mn_per_m: 1, readings };
        state.take(received(Status { stiffness: [Some(estimate); 2], ..status(2_000_000, None) }), 1.0);
        assert_eq!(state.stiffness(), [None, None], "{readings} readings leave no freedom");
    }
}

#[test]
fn a_fault_stays_until_a_status_is_without_it() {
    let mut state = running(1);
    let event = protocol::Event { t_us: 1_000_000, kind: EventKind::Faulted { fault: Fault::Stall } };
    state.take(Event::Telemetry(Telemetry::Event(event)), 1.0);
    assert_eq!(state.fault, Some(Fault::Stall));
    state.take(Event::Telemetry(batch(1_000, 25)), 1.1);
    assert_eq!(state.fault, Some(Fault::Stall));
    state.take(received(status(1_100_000, None)), 1.2);
    assert_eq!(state.fault, None);
}

#[test]
fn a_lost_connection_keeps_the_values_and_marks_them_old() {
    let mut state = running(5);
    assert!(!state.is_old(5.5));
    assert!(state.is_old(6.5), "nothing received for longer than a second");
    let first_mean = state.mean();
    state.take(Event::Lost("unplugged".to_owned()), 5.5);
    state.take(Event::Lost("no such port".to_owned()), 6.5);
    assert!(state.is_old(6.5) && state.mean() == first_mean);
    assert_eq!(state.down(), Some(&ConnectionLoss { reason: "no such port".to_owned(), since_s: 5.5 }));
    assert!((state.edge_s(8.0) - 8.0).abs() < 0.01, "the plots go on");
}

#[test]
fn the_same_device_plugged_in_again_leaves_a_gap_as_long_as_it_was_away() {
    let mut state = running(5);
    state.take(Event::Lost("unplugged".to_owned()), 5.2);
    state.take(Event::Connected { boot_id: 7, hello: hello(9_000_000, None) }, 9.0);
    assert_eq!((state.down(), &state.restart), (None, &None));
    state.take(Event::Telemetry(batch(9_000, 1_000)), 10.0);
    let runs = state.traces.runs(0, 0.0, 10.0, 100);
    assert_eq!(runs.len(), 2);
    assert_eq!((runs[0].last().map(|c| c.place), runs[1].first().map(|c| c.place)), (Some(49), Some(90)));
    assert!((state.streamed_s() - 0.999).abs() < 1e-9);
}

#[test]
fn a_device_that_starts_again_from_zero_goes_on_in_the_plots() {
    let mut state = running(5);
    state.take(Event::Lost("restarted".to_owned()), 5.0);
    state.take(Event::Connected { boot_id: 8, hello: hello(500_000, Some("src/main.rs:1: oh")) }, 6.0);
    let restart = state.restart.clone().expect("reported");
    assert_eq!(restart.reason, ResetReason::Watchdog);
    assert_eq!(restart.panic.as_deref(), Some("src/main.rs:1: oh"));
    assert_eq!(state.clock_s(), Some(0.5));
    state.take(Event::Telemetry(batch(500, 1_000)), 7.0);
    let runs = state.traces.runs(0, 0.0, 7.0, 70);
    assert_eq!(runs.len(), 2, "one second without data");
    assert!((59..=60).contains(&runs[1][0].place), "{}", runs[1][0].place);
    state.dismiss();
    assert_eq!(state.restart, None);
}

#[test]
fn a_panic_before_the_first_hello_is_reported_too() {
    let mut state = State::new("p");
    state.take(Event::Connected { boot_id: 1, hello: hello(0, None) }, 0.0);
    assert_eq!(state.restart, None);
    let mut state = State::new("p");
    state.take(Event::Connected { boot_id: 1, hello: hello(0, Some("oh")) }, 0.0);
    assert!(state.restart.is_some());
}

#[test]
fn memory_is_bounded_for_any_telemetry() {
    let mut state = running(1);
    for i in 0..200 {
        // The clock stands.
        state.take(Event::Telemetry(batch(1_000, 25)), f64::from(i));
    }
    assert!(state.recent.len() <= MEAN_SAMPLES);
    assert!(state.traces.len() <= 210);
}

#[test]
fn every_status_and_every_change_of_the_connection_is_news() {
    let mut state = State::new("p");
    let mut news = vec![state.news()];
    let losses = LinkLosses::default();
    for event in [
        Event::Connected { boot_id: 1, hello: hello(0, None) },
        received(status(0, None)),
        Event::Lost("gone".to_owned()),
        Event::LinkTotals(LinkTotals { bytes: 1, losses }),
        Event::Telemetry(batch(0, 25)),
    ] {
        state.take(event, 0.0);
        news.push(state.news());
    }
    assert_eq!(news, [0, 1, 2, 3, 3, 3]);
}

#[test]
fn what_no_longer_follows_a_model_is_shown_and_kept() {
    let mut state = State::new("port");
    let first_news = state.news();
    state.take(Event::Parted("the force along y no longer follows".to_owned()), 1.0);
    assert!(state.news() > first_news);
    assert!(state.outcome.as_ref().is_some_and(|outcome| !outcome.good && outcome.text.contains("along y")));
    // A command's outcome takes its line, and not its place in the document.
    state.take(Event::Command(Outcome { text: "home: done".to_owned(), good: true }), 2.0);
    let document = serde_json::to_value(Report::new(&state, 3.0)).expect("a document");
    assert_eq!(document["parted"], serde_json::json!(["the force along y no longer follows"]));
    assert!(
        serde_json::to_value(Report::new(&State::new("port"), 0.0)).expect("a document")["parted"].is_null()
    );
}
