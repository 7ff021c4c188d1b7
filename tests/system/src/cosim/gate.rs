//! When device time has to wait for a host: a busy computer must not let the device run ahead of a program that is not given
//! processor time.
//!
//! The device's own messages ([`super::output`]) show how far the host is, and no clock of the computer does:
//!
//! | device time waits | until |
//! |---|---|
//! | half the host's silence limit after the last command that the device answered, while a program is pending or runs | the device has answered another one |
//! | [`START_RESERVE_MS`] before the start of a program that was announced ([`Appointment`]) | the device has accepted a program |
//! | [`SWEEP_RESERVE_MS`] into an announced hold with an ultrasound sweep | the sweep has been taken, and the program that took it has ended |
//! | while someone takes a sweep | that one has ended |
//!
//! Waiting means one period per [`CRAWL`] or [`SWEEP_CRAWL`]: a device that stood still would answer nothing, and a host gives
//! up a device that sends nothing for seconds. The reserves are so long that what is waited for comes long before device time
//! has crawled to where it would be missed.
//!
//! A host that is silent on purpose, cut off or killed is like one that gets no processor time, only for longer: after
//! [`TIMEOUT`] at a crawl it is let be silent, until a command is answered again. Tests whose subject is silence declare it
//! ([`super::Cosim::host_may_be_silent`]) and do not wait for that.

use super::POLL_INTERVAL;
use protocol::{Event, EventKind, Message, State};
use std::collections::VecDeque;
use std::time::{Duration, Instant};

/// Wall-clock time of a period while device time waits.
pub(super) const CRAWL: Duration = Duration::from_millis(10);
/// The same while it waits for a sweep: a hold has less time to lose.
pub(super) const SWEEP_CRAWL: Duration = Duration::from_millis(20);
/// The same beyond what the host allows ([`super::allowance`]).
const ALLOWANCE_CRAWL: Duration = Duration::from_millis(2);
/// Time before its start within which an announced program has to have been accepted, milliseconds of the
/// device.
const START_RESERVE_MS: u64 = 2_000;
/// Time within a hold at which its sweep has to have been taken, milliseconds of the device. Hosts take it
/// after 0.3 s.
const SWEEP_RESERVE_MS: u64 = 500;
/// Wall-clock time at a crawl after which a silent host is let be silent. A program whose thread is ready to run gets processor
/// time within a fraction of this, also where ten others compete for it.
const TIMEOUT: Duration = Duration::from_secs(4);
/// Silence limit of the host before the device has stated another one, milliseconds.
const SILENCE_LIMIT_MS: u64 = 2_000;

/// A motion program that a host is going to start, in the order in which they start.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Appointment {
    /// Time of the device's clock at which it starts, milliseconds.
    pub start_ms: u64,
    /// Its steps in which the host takes an ultrasound sweep, counted from 0.
    pub sweeps: Vec<u8>,
}

impl Appointment {
    /// A program without sweeps.
    pub fn at_s(start_s: u32) -> Self {
        Self { start_ms: u64::from(start_s) * 1_000, sweeps: Vec::new() }
    }

    /// The same with sweeps in these steps.
    #[must_use]
    pub fn with_sweeps(self, sweeps: Vec<u8>) -> Self {
        Self { sweeps, ..self }
    }
}

/// Event that device time waits for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Waiting {
    /// A command of the host.
    Host,
    /// The acceptance of the next program.
    Start,
    /// An ultrasound sweep.
    Sweep,
    /// Permission of the host to go on.
    Allowance,
}

impl Waiting {
    /// Wall-clock time of a period meanwhile.
    pub(super) fn crawl(self) -> Duration {
        match self {
            Self::Host | Self::Start => CRAWL,
            Self::Sweep => SWEEP_CRAWL,
            Self::Allowance => ALLOWANCE_CRAWL,
        }
    }

    /// Interval at which to check whether it still has to.
    pub(super) fn poll_interval(self) -> Duration {
        match self {
            Self::Host | Self::Start | Self::Sweep => POLL_INTERVAL,
            // Thousands of times in a row.
            Self::Allowance => POLL_INTERVAL / 10,
        }
    }
}

/// The gate. Times are milliseconds of the device's clock, which are periods since it started.
#[derive(Debug)]
pub(super) struct Gate {
    /// The host may be silent as long as it likes.
    may_be_silent: bool,
    /// A program is pending or runs.
    active: bool,
    /// When the last program ended, microseconds: states from before do not belong to the next one.
    ended_us: u64,
    silence_limit_ms: u64,
    /// When a command was answered last.
    answered_ms: u64,
    /// Since when device time has waited for the host, by the computer's clock.
    waiting_since: Option<Instant>,
    appointments: VecDeque<Appointment>,
    /// When the hold began whose sweep is not taken yet.
    hold_ms: Option<u64>,
    /// Sweeps that are being taken.
    under_way: u32,
}

impl Gate {
    pub(super) fn new() -> Self {
        Self {
            may_be_silent: false,
            active: false,
            ended_us: 0,
            silence_limit_ms: SILENCE_LIMIT_MS,
            answered_ms: 0,
            waiting_since: None,
            appointments: VecDeque::new(),
            hold_ms: None,
            under_way: 0,
        }
    }

    pub(super) fn host_may_be_silent(&mut self, may: bool) {
        self.may_be_silent = may;
    }

    pub(super) fn expect(&mut self, appointments: impl IntoIterator<Item = Appointment>) {
        self.appointments.extend(appointments);
    }

    /// The device has started again: its clock begins at zero, and nothing runs.
    pub(super) fn restarted(&mut self) {
        let appointments = std::mem::take(&mut self.appointments);
        let (may_be_silent, under_way) = (self.may_be_silent, self.under_way);
        *self = Self { may_be_silent, under_way, appointments, ..Self::new() };
    }

    /// When the device answered a command last.
    pub(super) fn answered_ms(&self) -> u64 {
        self.answered_ms
    }

    /// A sweep begins to be taken.
    pub(super) fn sweep_begins(&mut self) {
        self.under_way += 1;
    }

    /// A sweep has been taken, and the program that took it has ended.
    pub(super) fn sweep_ends(&mut self) {
        self.under_way = self.under_way.saturating_sub(1);
        self.hold_ms = None;
    }

    /// Takes a message of the device up to this time.
    pub(super) fn receive(&mut self, now_ms: u64, message: &Message) {
        match message {
            Message::Ack { .. }
            | Message::Refused { .. }
            | Message::Connected { .. }
            | Message::Hello(_)
            | Message::Calibration(_)
            | Message::Safety(_)
            | Message::Description(_) => {
                self.answered_ms = now_ms;
                self.waiting_since = None;
            }
            Message::Status(status) => {
                self.silence_limit_ms = u64::from(status.silence_limit_ms);
                if status.t_us >= self.ended_us {
                    self.active = !matches!(status.state, State::Idle | State::Faulted);
                }
            }
            Message::Event(event) => self.on_event(now_ms, event),
            // Their states come late, and the events report the same.
            Message::Samples(_) => {}
        }
    }

    fn on_event(&mut self, now_ms: u64, event: &Event) {
        match event.kind {
            EventKind::StepStarted { index } => {
                self.active = true;
                let has_sweep = self.appointments.front().is_some_and(|next| next.sweeps.contains(&index));
                self.hold_ms = has_sweep.then_some(now_ms);
            }
            EventKind::StepEnded { .. } => self.hold_ms = None,
            EventKind::ProgramEnded { .. } => {
                self.appointments.pop_front();
                self.ends(event.t_us);
            }
            EventKind::Faulted { .. } | EventKind::RetreatEnded { .. } | EventKind::PulseEnded(_) => {
                self.ends(event.t_us)
            }
            EventKind::Tared(_) | EventKind::TareRejected { .. } => {}
        }
    }

    fn ends(&mut self, at_us: u64) {
        (self.active, self.ended_us, self.hold_ms) = (false, at_us, None);
    }

    /// Event that device time has to wait for in this period.
    pub(super) fn waiting(&mut self, now_ms: u64, now: Instant) -> Option<Waiting> {
        if self.under_way > 0 || self.hold_ms.is_some_and(|from_ms| now_ms >= from_ms + SWEEP_RESERVE_MS) {
            return Some(Waiting::Sweep);
        }
        if !self.active
            && self.appointments.front().is_some_and(|next| {
                (next.start_ms.saturating_sub(START_RESERVE_MS)..next.start_ms).contains(&now_ms)
            })
        {
            return Some(Waiting::Start);
        }
        let is_late = now_ms.saturating_sub(self.answered_ms) >= self.silence_limit_ms / 2;
        if !self.active || self.may_be_silent || !is_late {
            return None;
        }
        let waiting_start = *self.waiting_since.get_or_insert(now);
        (now.saturating_duration_since(waiting_start) < TIMEOUT).then_some(Waiting::Host)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use protocol::{Fault, Outcome, Status};

    const MS: Duration = Duration::from_millis(1);

    fn status(t_ms: u64, state: State, silence_limit_ms: u32) -> Message {
        Message::Status(Status {
            t_us: 1_000 * t_ms,
            state,
            step: 255,
            fault: None,
            position_counts: [0; 2],
            force_counts: [0; 2],
            streaming: false,
            counters: Default::default(),
            load: Default::default(),
            motor_budget_permille: [0; 2],
            force_limit_mn: 4_000,
            silence_limit_ms,
            stiffness: [None; 2],
            repeats_force: false,
        })
    }

    fn event(t_ms: u64, kind: EventKind) -> Message {
        Message::Event(Event { t_us: 1_000 * t_ms, kind })
    }

    /// A device on which a program runs from this time on, with its last answer then.
    fn running(from_ms: u64) -> Gate {
        let mut gate = Gate::new();
        gate.receive(from_ms, &status(from_ms, State::Pending, 2_000));
        gate.receive(from_ms, &Message::Ack { id: 1 });
        gate
    }

    /// The first time at which the gate has something to wait for, and what.
    fn first_wait(
        gate: &mut Gate,
        mut times_ms: std::ops::Range<u64>,
        now: Instant,
    ) -> Option<(u64, Waiting)> {
        times_ms.find_map(|ms| Some((ms, gate.waiting(ms, now)?)))
    }

    #[test]
    fn device_time_waits_for_a_host_that_falls_behind_long_before_its_silence_is_a_fault() {
        let now = Instant::now();
        let mut gate = running(100);
        assert_eq!(first_wait(&mut gate, 100..3_000, now), Some((1_100, Waiting::Host)));
        gate.receive(1_110, &Message::Refused { id: 2, refusal: protocol::Refusal::Busy });
        assert_eq!(first_wait(&mut gate, 1_110..3_000, now), Some((2_110, Waiting::Host)));
        // Another limit, which comes before its answer, as it does from the device.
        gate.receive(2_200, &status(2_200, State::Moving, 300));
        gate.receive(2_200, &Message::Ack { id: 3 });
        assert_eq!(first_wait(&mut gate, 2_200..3_000, now), Some((2_350, Waiting::Host)));
        // An unsolicited message of the device is no sign of the host.
        gate.receive(2_360, &status(2_360, State::Moving, 300));
        gate.receive(2_360, &event(2_360, EventKind::StepStarted { index: 1 }));
        assert_eq!(gate.waiting(2_361, now), Some(Waiting::Host));
        gate.receive(2_370, &event(2_370, EventKind::ProgramEnded { outcome: Outcome::Completed }));
        assert_eq!(first_wait(&mut gate, 2_370..9_000, now), None, "silence is no fault any more");
    }

    #[test]
    fn a_host_at_rest_may_be_silent() {
        let now = Instant::now();
        let mut gate = Gate::new();
        gate.receive(50, &Message::Connected { connection: 1 });
        gate.receive(60, &status(60, State::Idle, 200));
        assert_eq!(first_wait(&mut gate, 60..9_000, now), None);
        let mut gate = running(100);
        gate.receive(200, &event(200, EventKind::Faulted { fault: Fault::Stall }));
        // A status from before is no news.
        gate.receive(201, &status(199, State::Moving, 2_000));
        assert_eq!(first_wait(&mut gate, 201..9_000, now), None);
    }

    #[test]
    fn a_silent_host_is_not_waited_for_until_it_is_answered_again() {
        let began = Instant::now();
        let mut gate = running(0);
        assert_eq!(gate.waiting(1_000, began), Some(Waiting::Host));
        assert_eq!(gate.waiting(1_100, began + TIMEOUT - MS), Some(Waiting::Host));
        assert_eq!(gate.waiting(1_101, began + TIMEOUT), None);
        assert_eq!(gate.waiting(1_900, began + 9 * TIMEOUT), None);
        gate.receive(1_950, &Message::Ack { id: 7 });
        assert_eq!(gate.waiting(2_950, began + 10 * TIMEOUT), Some(Waiting::Host));
        let mut gate = running(0);
        gate.host_may_be_silent(true);
        assert_eq!(first_wait(&mut gate, 0..9_000, began), None);
        gate.host_may_be_silent(false);
        assert_eq!(gate.waiting(9_000, began), Some(Waiting::Host));
    }

    /// At a crawl, the timeout is over long before the silence is a fault: nothing of what is waited for is missed.
    #[test]
    fn the_reserves_are_longer_than_the_timeout_at_a_crawl() {
        assert!(crawled_ms(CRAWL) <= u128::from(SILENCE_LIMIT_MS / 4));
        assert!(crawled_ms(CRAWL) <= u128::from(START_RESERVE_MS / 4));
        // The shortest hold with a sweep that comes with the programs has 1.2 s.
        assert!(crawled_ms(SWEEP_CRAWL) <= u128::from((1_200 - SWEEP_RESERVE_MS) / 3));
    }

    fn crawled_ms(crawl: Duration) -> u128 {
        TIMEOUT.as_millis() / crawl.as_millis()
    }

    #[test]
    fn device_time_waits_for_the_programs_that_are_announced_in_their_order() {
        let now = Instant::now();
        let mut gate = Gate::new();
        gate.expect([Appointment::at_s(4), Appointment::at_s(10)]);
        let reserve = START_RESERVE_MS;
        assert_eq!(first_wait(&mut gate, 0..4_000, now), Some((4_000 - reserve, Waiting::Start)));
        gate.receive(3_000, &status(3_000, State::Pending, 60_000));
        gate.receive(3_001, &Message::Ack { id: 1 });
        assert_eq!(first_wait(&mut gate, 3_001..5_000, now), None);
        gate.receive(5_000, &event(5_000, EventKind::ProgramEnded { outcome: Outcome::Completed }));
        gate.receive(5_001, &status(4_999, State::Moving, 60_000));
        gate.receive(5_002, &status(5_002, State::Idle, 60_000));
        assert_eq!(first_wait(&mut gate, 5_003..10_000, now), Some((10_000 - reserve, Waiting::Start)));
        assert_eq!(gate.waiting(10_000, now), None, "it is too late now: the device refuses the program");
    }

    #[test]
    fn device_time_waits_in_a_hold_for_its_sweep() {
        let now = Instant::now();
        let mut gate = running(0);
        gate.expect([Appointment::at_s(1).with_sweeps(vec![0, 2])]);
        assert_eq!(step_at(&mut gate, 1_000, 0, now), Some((1_000 + SWEEP_RESERVE_MS, Waiting::Sweep)));
        gate.sweep_begins();
        assert_eq!(gate.waiting(1_510, now), Some(Waiting::Sweep));
        gate.sweep_ends();
        assert_eq!(gate.waiting(1_510, now), None);
        assert_eq!(step_at(&mut gate, 2_000, 1, now), None, "a step without a sweep");
        // One that is taken early is not waited for.
        gate.receive(3_000, &Message::Ack { id: 2 });
        gate.receive(3_000, &event(3_000, EventKind::StepStarted { index: 2 }));
        gate.sweep_begins();
        gate.sweep_ends();
        assert_eq!(first_wait(&mut gate, 3_000..3_900, now), None);
        gate.receive(3_900, &event(3_900, EventKind::ProgramEnded { outcome: Outcome::Completed }));
        assert_eq!(step_at(&mut gate, 4_000, 0, now), None, "another program");
    }

    fn step_at(gate: &mut Gate, from_ms: u64, index: u8, now: Instant) -> Option<(u64, Waiting)> {
        gate.receive(from_ms, &Message::Ack { id: 1 });
        gate.receive(from_ms, &event(from_ms, EventKind::StepStarted { index }));
        first_wait(gate, from_ms..from_ms + 900, now)
    }

    #[test]
    fn a_restart_forgets_what_ran_and_keeps_what_was_announced() {
        let now = Instant::now();
        let mut gate = running(5_000);
        gate.expect([Appointment::at_s(6)]);
        gate.restarted();
        assert_eq!(first_wait(&mut gate, 0..3_999, now), None);
        assert_eq!(gate.waiting(4_000, now), Some(Waiting::Start));
    }
}
