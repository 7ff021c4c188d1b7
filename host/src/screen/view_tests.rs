//! The screen as it is drawn: texts that must be there, and sizes that must not matter.

use super::*;
use crate::screen::testing::{batch, hello, running, status};
use device::link::Telemetry;
use device::monitor::state::{Event, Outcome};
use protocol::Fault;
use ratatui::Terminal;
use ratatui::backend::TestBackend;

fn drawn(state: &State, settings: Settings, now_s: f64, width: u16, height: u16) -> String {
    let mut terminal = Terminal::new(TestBackend::new(width, height)).expect("a terminal");
    terminal
        .draw(|frame| frame.render_widget(Screen { state, settings, now_s }, frame.area()))
        .expect("draws");
    let buffer = terminal.backend().buffer();
    let cells: Vec<&str> = buffer.content().iter().map(|cell| cell.symbol()).collect();
    cells.chunks(usize::from(width).max(1)).map(|row| format!("{}\n", row.concat().trim_end())).collect()
}

fn has(screen: &str, texts: &[&str]) {
    for text in texts {
        assert!(screen.contains(text), "no {text:?} in\n{screen}");
    }
}

fn faulted() -> State {
    let mut state = running(5);
    let status = status(5_000_000, Some(Fault::Stall));
    state.take(Event::Telemetry(Telemetry::Status(Box::new(status))), 5.0);
    state
}

fn restarted() -> State {
    let mut state = faulted();
    state.take(Event::Lost("the device restarted".to_owned()), 5.0);
    let hello = hello(100_000, Some("src/control.rs:12: overflow"));
    state.take(Event::Connected { boot_id: 8, hello }, 5.1);
    state.take(Event::Telemetry(batch(100, 25)), 5.2);
    state
}

fn lost() -> State {
    let mut state = running(5);
    state
        .take(Event::Lost("/dev/ttyACM0: the port disappeared (EOF): was the cable pulled?".to_owned()), 5.0);
    state
}

#[test]
fn all_that_matters_is_on_the_smallest_usual_terminal() {
    let mut state = running(5);
    state.take(Event::Command(Outcome { text: "home: done".to_owned(), good: true }), 5.0);
    for (width, height) in [(80, 24), (120, 40)] {
        let screen = drawn(&state, Settings::default(), 5.0, width, height);
        has(&screen, &["guide monitor", "/dev/ttyACM0", "B-L475E-IOT01A firmware 0.1.0 (abc1234)"]);
        has(&screen, &["force, N: x and y, last 10 s", "displacement, mm: x and y", "-10 s", "now"]);
        has(&screen, &["-0.250 mm", "+0.0010 N", "not identified yet", "1.530 (1.491 to 1.569) N/mm"]);
        has(&screen, &["holding, step 2", "device clock 5.0 s", "telemetry on"]);
        has(
            &screen,
            &["kB/s", "samples/s", "last received 0.0 s ago", "0 samples   0 frames missing   0 CRC errors"],
        );
        has(&screen, &["CPU 23 %", "longest period 412 us", "free stack 10240 B", "motors 3, 0 %"]);
        has(
            &screen,
            &["periods without a new force reading: 3", "home: done", "jog 0.50 mm", "? help", "q quit"],
        );
        assert!(!screen.contains("FAULT") && !screen.contains("OLD") && !screen.contains("NO CONNECTION"));
        assert!(screen.chars().any(|c| ('\u{2801}'..='\u{28ff}').contains(&c)), "no curve\n{screen}");
        assert_eq!(
            screen,
            Screen { state: &state, settings: Settings::default(), now_s: 5.0 }.to_text(width, height)
        );
    }
}

#[test]
fn a_fault_has_number_cause_remedy_and_key() {
    let screen = drawn(&faulted(), Settings::default(), 5.0, 80, 24);
    has(
        &screen,
        &["FAULT 7", "an axis is driven and does not move", "check for a jam", "then press c to clear"],
    );
    has(&screen, &["faulted", "force, N", "q quit"]);
}

#[test]
fn a_fault_under_load_shows_the_way_out_and_its_key() {
    for fault in Fault::ALL {
        let mut state = running(5);
        state.take(Event::Telemetry(Telemetry::Status(Box::new(status(5_000_000, Some(fault))))), 5.0);
        let screen = drawn(&state, Settings::default(), 5.0, 80, 24);
        has(&screen, &[&format!("FAULT {}", fault as u8), "press c to clear", "force, N"]);
        assert_eq!(screen.contains("press r to retreat"), fault.allows_retreat(), "{fault:?}\n{screen}");
    }
}

#[test]
fn a_restart_has_its_reason_and_the_last_panic() {
    let mut state = restarted();
    let restart = "started by its watchdog; last panic: src/control.rs:12: overflow";
    state.take(status_with(Some(Fault::Restarted)), 5.2);
    let screen = drawn(&state, Settings::default(), 5.2, 80, 24);
    has(&screen, &["FAULT 11, and the device has restarted", "then press c to", restart, "force, N"]);
    state.take(status_with(None), 5.3);
    let screen = drawn(&state, Settings::default(), 5.3, 80, 24);
    has(&screen, &["THE DEVICE HAS RESTARTED: press c to dismiss", "force, N"]);
    has(&screen, &[restart]);
    state.dismiss();
    let screen = drawn(&state, Settings::default(), 5.3, 80, 24);
    assert!(!screen.contains("RESTARTED") && !screen.contains("started by"), "{screen}");
}

/// The fault with the most words.
fn status_with(fault: Option<Fault>) -> Event {
    Event::Telemetry(Telemetry::Status(Box::new(status(200_000, fault))))
}

#[test]
fn without_a_connection_values_stay_and_are_marked_as_old() {
    let state = lost();
    let screen = drawn(&state, Settings::default(), 8.0, 80, 24);
    has(
        &screen,
        &[
            "NO CONNECTION for 3 s",
            "was the cable pulled",
            "OLD",
            "-0.250 mm",
            "values are old, trying again",
        ],
    );
    let mut buffer = Buffer::empty(Rect::new(0, 0, 80, 24));
    Screen { state: &state, settings: Settings::default(), now_s: 8.0 }.render(buffer.area, &mut buffer);
    assert!(
        !(8..22).any(|y| (0..80).filter_map(|x| buffer.cell((x, y))).any(|cell| cell.fg == Color::Cyan)),
        "a live colour among old values"
    );
}

#[test]
fn time_without_data_is_empty_in_the_plots() {
    let mut state = lost();
    state.take(Event::Connected { boot_id: 7, hello: hello(8_000_000, None) }, 8.0);
    for t_ms in (8_000..10_000).step_by(25) {
        state.take(Event::Telemetry(batch(t_ms, 25)), (t_ms + 25) as f64 * 1e-3);
    }
    let screen = drawn(&state, Settings::default(), 10.0, 109, 40);
    assert!(has_curve(0, 48, &screen), "\n{screen}");
    assert!(!has_curve(51, 77, &screen), "\n{screen}");
    assert!(has_curve(80, 98, &screen), "\n{screen}");
}

/// 98 columns from -10 s to now: nothing from 5 s to 8 s.
fn has_curve(from: usize, to: usize, screen: &str) -> bool {
    screen.lines().skip(1).take(20).any(|line| {
        line.chars().skip(9 + from).take(to - from).any(|c| ('\u{2801}'..='\u{28ff}').contains(&c))
    })
}

#[test]
fn the_help_names_every_key() {
    let settings = Settings { help: true, ..Settings::default() };
    let screen = drawn(&running(1), settings, 1.0, 80, 24);
    for (key, what) in HELP {
        has(&screen, &[key, what]);
    }
}

#[test]
fn no_size_is_too_small_and_none_too_large() {
    let states = [State::new("a port"), running(3), faulted(), restarted(), lost()];
    let settings = [Settings::default(), Settings { help: true, ..Settings::default() }];
    let sizes = (0..30).flat_map(|width| (0..26).map(move |height| (width, height)));
    let sizes = sizes.chain([(1, 200), (500, 1), (80, 24), (81, 25), (300, 120)]);
    for (width, height) in sizes {
        for state in &states {
            for settings in settings {
                Screen { state, settings, now_s: 5.0 }.to_text(width, height);
            }
        }
    }
}

#[test]
fn choices_stay_within_their_limits() {
    let mut settings = Settings::default();
    assert_eq!((settings.window_s(), settings.jog_step_m()), (10.0, 0.5e-3));
    for _ in 0..20 {
        settings.change_window(true);
        settings.change_jog_step(true);
    }
    assert_eq!((settings.window_s(), settings.jog_step_m()), (120.0, 2e-3));
    for _ in 0..20 {
        settings.change_window(false);
        settings.change_jog_step(false);
    }
    assert_eq!((settings.window_s(), settings.jog_step_m()), (1.0, 0.05e-3));
}

#[test]
fn lines_are_broken_between_words() {
    assert_eq!(wrapped("one two three", 7), ["one two", "three"]);
    assert_eq!(wrapped("", 7), [""]);
    assert_eq!(wrapped("longer than that", 3), ["longer", "than", "that"]);
}
