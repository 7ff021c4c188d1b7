//! One connection: the user's commands become motion programs, and the ends of those are reported.

use super::command::UserCommand;
use super::health::LinkTotals;
use super::state::{Event, Outcome};
use crate::link::error::{AT_THE_MIDDLE, explain_fault, explain_retreat};
use crate::link::keepalive::Keepalive;
use crate::link::program::move_to;
use crate::link::{Client, LinkError, Telemetry};
use protocol::{
    EventKind, Fault, Outcome as End, RETREAT_LIMIT_UM, Request, RetreatOutcome, State, Status, Step, Tare,
};
use std::time::{Duration, Instant};

/// Time for which one poll for telemetry waits: short, so that commands are handled soon.
const POLL_INTERVAL: Duration = Duration::from_millis(10);
/// A status that has not come unsolicited for this long is requested.
const STATUS: Duration = Duration::from_millis(100);
/// Limit of a device that has not stated its own yet, milliseconds.
const LIMIT_MS: u32 = 2_000;
/// Interval at which the link's counters are reported.
const CARRIED: Duration = Duration::from_millis(100);
/// Speeds of jogs and of homing, millimetres per second.
const JOG_MM_S: f64 = 1.0;
const HOME_MM_S: f64 = 2.0;
/// Averaging time of a tare, milliseconds.
const TARE_MS: u32 = 1_000;

/// Program or move that was started here.
struct Running {
    name: String,
    is_jog: bool,
    tare: Option<Tare>,
}

/// A connected device and what is known of it.
pub(super) struct Session<'a> {
    client: Client,
    on_event: &'a mut dyn FnMut(Event),
    keepalive: Keepalive,
    /// When a status came last.
    status_at: Instant,
    reported: Instant,
    /// A program waits or runs, or a retreat, started by any host.
    active: bool,
    fault: Option<Fault>,
    running: Option<Running>,
    /// Last commanded position of guide 2, metres; `None` if guide 2 did not go there.
    sent_to_m: Option<[f64; 2]>,
    /// A jog that waits for the end of the one that runs, metres.
    next_jog_m: Option<[f64; 2]>,
}

impl<'a> Session<'a> {
    /// Switches telemetry on.
    pub fn begin(client: Client, on_event: &'a mut dyn FnMut(Event)) -> Result<Self, LinkError> {
        let hello = client.hello();
        let now = Instant::now();
        let keepalive = Keepalive::new(now, hello.now_us, LIMIT_MS);
        on_event(Event::Connected { boot_id: client.boot_id(), hello: Box::new(hello.clone()) });
        let mut session = Self {
            client,
            on_event,
            keepalive,
            status_at: now,
            reported: now,
            active: false,
            fault: None,
            running: None,
            sent_to_m: None,
            next_jog_m: None,
        };
        session.request(Request::Stream { enable: true })?;
        session.status()?;
        Ok(session)
    }

    /// Polls the device once, and sends what is due.
    pub fn poll(&mut self) -> Result<(), LinkError> {
        if let Some(telemetry) = self.client.next(POLL_INTERVAL)? {
            self.received(telemetry)?;
        }
        let now = Instant::now();
        if self.keepalive.is_due(now) || now.saturating_duration_since(self.status_at) >= STATUS {
            self.status()?;
        }
        if self.reported.elapsed() >= CARRIED {
            self.reported = Instant::now();
            let totals = LinkTotals { bytes: self.client.bytes(), losses: self.client.losses() };
            (self.on_event)(Event::LinkTotals(totals));
        }
        Ok(())
    }

    /// Sends a command. A refusal is reported and does not end the connection.
    pub fn handle_command(&mut self, command: UserCommand) -> Result<(), LinkError> {
        let outcome = match command {
            UserCommand::Tare => self.start("tare".to_owned(), &[Step::Tare { duration_ms: TARE_MS }], false),
            UserCommand::Run(program) => self.start(program.name.clone(), &program.device_steps(), false),
            UserCommand::Home => self.go("home".to_owned(), [0.0; 2], HOME_MM_S, false),
            UserCommand::Jog(by_m) if self.fault.is_some_and(Fault::allows_retreat) => {
                let [x_um, y_um] = micrometres(by_m);
                self.request(Request::Retreat { x_um, y_um }).map(|()| self.retreats([x_um, y_um]))
            }
            UserCommand::Jog(by_m) => self.jog(by_m),
            UserCommand::Retreat => self.client.retreat_to_middle().map(|by_um| {
                self.keepalive.sent(Instant::now());
                match by_um {
                    Some(by_um) => self.retreats(by_um),
                    None => self.report(AT_THE_MIDDLE, false),
                }
            }),
            UserCommand::Stop => self.stop(),
            UserCommand::Clear => self.request(Request::ClearFault).map(|()| self.report("cleared", true)),
        };
        match outcome {
            Err(refused @ LinkError::Refused { .. }) => {
                self.report(&refused.to_string(), false);
                Ok(())
            }
            other => other,
        }
    }

    /// Stops all motion and switches telemetry off.
    pub fn end(mut self) -> Result<(), LinkError> {
        if self.active || self.running.is_some() {
            self.request(Request::Stop)?;
        }
        self.request(Request::Stream { enable: false })
    }

    fn report(&mut self, text: &str, good: bool) {
        (self.on_event)(Event::Command(Outcome { text: text.to_owned(), good }));
    }

    fn request(&mut self, request: Request) -> Result<(), LinkError> {
        self.client.request(request)?;
        self.keepalive.sent(Instant::now());
        Ok(())
    }

    /// Requests the status: it shows for certain whether a program has ended whose end was lost.
    fn status(&mut self) -> Result<Status, LinkError> {
        let status = self.client.status()?;
        self.keepalive.sent(Instant::now());
        // Answers to earlier commands come first; this answer is among them.
        self.catch_up()?;
        match status.state {
            State::Idle => self.ended(End::Completed)?,
            State::Faulted | State::Retreating => self.ended(End::Faulted)?,
            State::Pending | State::Moving | State::Holding | State::Taring => {}
        }
        Ok(status)
    }

    fn catch_up(&mut self) -> Result<(), LinkError> {
        while let Some(telemetry) = self.client.waiting() {
            self.received(telemetry)?;
        }
        Ok(())
    }

    fn stop(&mut self) -> Result<(), LinkError> {
        (self.next_jog_m, self.sent_to_m) = (None, None);
        self.request(Request::Stop)?;
        self.running = None;
        self.report("stopped", true);
        Ok(())
    }

    fn retreats(&mut self, by_um: [i32; 2]) {
        let [x_mm, y_mm] = by_um.map(|um| f64::from(um) * 1e-3);
        self.report(&format!("retreat by x {x_mm:+.3} mm, y {y_mm:+.3} mm ..."), true);
    }

    fn jog(&mut self, by_m: [f64; 2]) -> Result<(), LinkError> {
        if self.running.as_ref().is_some_and(|running| running.is_jog) {
            // One may wait, so that a key that is held down moves evenly; with more of them the guide would go on long after it
            // was let go.
            if self.next_jog_m.replace(by_m).is_some() {
                self.report("one jog waits already: this one takes its place", true);
            }
            return Ok(());
        }
        let start_m = match self.sent_to_m {
            Some(sent_to_m) => sent_to_m,
            None => {
                let status = self.status()?;
                self.client.displacement_m(status.position_counts)
            }
        };
        let ([x, y], [dx, dy]) = (start_m, by_m);
        let [x_m, y_m] = [x + dx, y + dy];
        let name = format!("jog to x {:+.3} mm, y {:+.3} mm", x_m * 1e3, y_m * 1e3);
        self.go(name, [x_m, y_m], JOG_MM_S, true)
    }

    fn go(&mut self, name: String, to_m: [f64; 2], speed_mm_s: f64, is_jog: bool) -> Result<(), LinkError> {
        match move_to(to_m.map(|metres| metres * 1e3), speed_mm_s) {
            Ok(step) => {
                self.start(name, &[step], is_jog)?;
                self.sent_to_m = Some(to_m);
            }
            Err(problem) => self.report(&format!("{name}: {problem}"), false),
        }
        Ok(())
    }

    fn start(&mut self, name: String, steps: &[Step], is_jog: bool) -> Result<(), LinkError> {
        for (index, step) in (0u8..).zip(steps) {
            self.request(Request::LoadStep { index, step: *step })?;
        }
        let crc = protocol::program_crc(steps);
        self.request(Request::Run { steps: steps.len() as u8, crc, start_us: 0 })?;
        // Ends that are received up to here are those of earlier programs; this one's, should it be among them because the
        // acceptance came late, is found by the status.
        self.running = None;
        self.catch_up()?;
        self.active = true;
        self.report(&format!("{name} ..."), true);
        self.running = Some(Running { name, is_jog, tare: None });
        Ok(())
    }

    fn received(&mut self, telemetry: Telemetry) -> Result<(), LinkError> {
        let mut end = None;
        self.keepalive.clock(telemetry.device_us().unwrap_or_default());
        match &telemetry {
            Telemetry::Samples(batch) => {
                self.state(batch.state);
            }
            Telemetry::Status(status) => {
                self.state(status.state);
                self.fault = status.fault;
                self.status_at = Instant::now();
                self.keepalive.limit(status.silence_limit_ms);
            }
            Telemetry::Event(event) => match event.kind {
                EventKind::Faulted { fault } => self.fault = Some(fault),
                EventKind::Tared(tare) => {
                    if let Some(running) = &mut self.running {
                        running.tare = Some(tare);
                    }
                }
                EventKind::ProgramEnded { outcome } => end = Some(outcome),
                EventKind::RetreatEnded { outcome } => {
                    let good = matches!(outcome, RetreatOutcome::Unloaded | RetreatOutcome::Moved);
                    self.report(&format!("retreat: {}", explain_retreat(outcome)), good);
                }
                EventKind::TareRejected { .. }
                | EventKind::PulseEnded(_)
                | EventKind::StepStarted { .. }
                | EventKind::StepEnded { .. } => {}
            },
        }
        (self.on_event)(Event::Telemetry(telemetry));
        end.map_or(Ok(()), |end| self.ended(end))
    }

    fn state(&mut self, state: State) {
        self.active = !matches!(state, State::Idle | State::Faulted);
        if matches!(state, State::Faulted | State::Retreating) {
            // It has not come to where it was sent.
            (self.sent_to_m, self.next_jog_m) = (None, None);
        }
    }

    /// The program that was started here has ended; nothing where none was.
    fn ended(&mut self, end: End) -> Result<(), LinkError> {
        let Some(Running { name, tare, .. }) = self.running.take() else { return Ok(()) };
        let next_jog_m = self.next_jog_m.take();
        match end {
            End::Completed => {
                let noise = tare.map(|tare| {
                    let counts = tare.sd_counts.map(|count| i32::try_from(count).unwrap_or(i32::MAX));
                    let [x, y] = self.client.force_n(counts);
                    format!(", noise x {x:.4} N, y {y:.4} N (sd of one reading)")
                });
                self.report(&format!("{name}: done{}", noise.unwrap_or_default()), true);
                if let Some(jog_m) = next_jog_m {
                    return self.handle_command(UserCommand::Jog(jog_m));
                }
            }
            End::TareRejected => {
                let text = "rejected: unload the needle, wait until the force has settled, tare again";
                self.report(&format!("{name}: {text}"), false);
            }
            End::Stopped => {
                self.sent_to_m = None;
                self.report(&format!("{name}: stopped"), false);
            }
            End::Faulted => {
                self.sent_to_m = None;
                let fault = self.fault.map_or("a fault".to_owned(), explain_fault);
                self.report(&format!("{name}: ended by {fault}"), false);
            }
        }
        Ok(())
    }
}

/// A jog as a retreat, which is bounded.
fn micrometres(by_m: [f64; 2]) -> [i32; 2] {
    by_m.map(|metres| ((metres * 1e6).round() as i32).clamp(-RETREAT_LIMIT_UM, RETREAT_LIMIT_UM))
}
