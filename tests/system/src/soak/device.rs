//! The device as the soak has it: every question and answer is checked against the rig and against what went before.

use super::answers::{self, Answer, is_active};
use super::line::Line;
use super::tally::Tally;
use super::watch::{Memory, Watch};
use crate::bench::Bench;
use crate::cosim::Cosim;
use crate::qemu::HANGS;
use crate::trial::Books;
use anyhow::{Context, Result, bail, ensure};
use device::link::display::request_name;
use device::link::{Client, LinkError, Telemetry};
use protocol::{EventKind, Fault, Refusal, Request, Status};
use rand_chacha::ChaCha8Rng;
use std::time::{Duration, Instant};

/// How long one poll of the device waits.
const POLL_INTERVAL: Duration = Duration::from_millis(5);
/// How often a request on a bad line is sent again, each time with the client's own repeats.
pub const ATTEMPTS: u32 = 8;

/// Everything about the device under trial.
pub struct Device<'a> {
    pub bench: &'a Bench,
    pub line: Line<'a>,
    client: Option<Client>,
    pub books: Books,
    pub watch: Watch,
    pub memory: Memory,
    pub random: ChaCha8Rng,
    pub tally: Tally,
    /// Rig time up to which the program must have ended.
    pub deadline_ms: Option<u64>,
    /// Rig time before the last command that was answered.
    pub answered_ms: u64,
    /// Limits that are set.
    pub force_mn: u32,
    pub silence_ms: u32,
    /// Faults that were reported and not handled yet.
    pub reported: Vec<(Fault, u64)>,
}

impl<'a> Device<'a> {
    pub fn new(bench: &'a Bench, line: Line<'a>, random: ChaCha8Rng, warm_ms: u64) -> Result<Self> {
        let client = Client::connect(&line.port())?;
        let rig = bench.rig();
        Ok(Self {
            bench,
            line,
            client: Some(client),
            books: Books::new(rig.started()),
            watch: Watch::default(),
            memory: Memory::new(rig.steps().saturating_add(warm_ms)),
            random,
            tally: Tally::default(),
            deadline_ms: None,
            answered_ms: rig.steps(),
            force_mn: 4_000,
            silence_ms: 2_000,
            reported: Vec::new(),
        })
    }

    pub fn rig(&self) -> &'a Cosim {
        self.bench.rig()
    }

    pub fn now_ms(&self) -> u64 {
        self.rig().steps()
    }

    /// Device time as the rig has it, milliseconds.
    pub fn device_ms(&self) -> u64 {
        self.now_ms() - self.rig().started()
    }

    pub fn client(&mut self) -> Result<&mut Client> {
        self.client.as_mut().context("no client is connected")
    }

    /// Takes what has come, and what is due: the line's changes, a check of rig and memory.
    pub fn tick(&mut self) -> Result<()> {
        self.line.step(self.bench.rig().steps(), &mut self.random);
        self.watch.reach(self.rig().take_reach())?;
        self.memory.sample(self.now_ms())?;
        let telemetry = self.client()?.next(POLL_INTERVAL)?;
        telemetry.map_or(Ok(()), |telemetry| self.take(telemetry))?;
        self.drain()
    }

    /// Takes what waits.
    pub fn drain(&mut self) -> Result<()> {
        while let Some(telemetry) = self.client()?.waiting() {
            self.take(telemetry)?;
        }
        Ok(())
    }

    fn take(&mut self, telemetry: Telemetry) -> Result<()> {
        match telemetry {
            Telemetry::Samples(batch) => self.books.compare(&batch, self.bench.rig()),
            Telemetry::Event(event) => {
                let now_us = self.device_ms() * 1_000;
                ensure!(event.t_us <= now_us, "an event of {} us came at {now_us} us", event.t_us);
                match event.kind {
                    EventKind::Tared(tare) => self.books.tared(event.t_us / 1_000, tare.zero_counts),
                    EventKind::TareRejected { .. } => self.books.tare_rejected(),
                    EventKind::Faulted { fault } => {
                        self.reported.push((fault, event.t_us / 1_000 + self.rig().started()));
                    }
                    _ => {}
                }
                Ok(())
            }
            Telemetry::Status(status) => self.watch.status(&status),
        }
    }

    /// Lets time pass.
    pub fn pass(&mut self, ms: u64) -> Result<()> {
        let until = self.now_ms() + ms;
        self.until("time passes", u64::MAX, |device| Ok(device.now_ms() >= until)).map(|_| ())
    }

    /// Goes on until something holds; false where it has not within a time.
    pub fn until(
        &mut self,
        what: &str,
        within_ms: u64,
        mut holds: impl FnMut(&mut Self) -> Result<bool>,
    ) -> Result<bool> {
        let from_ms = self.now_ms();
        let mut last = (from_ms, Instant::now());
        loop {
            if holds(self)? {
                return Ok(true);
            }
            let now_ms = self.now_ms();
            if now_ms - from_ms > within_ms {
                return Ok(false);
            }
            if now_ms > last.0 {
                last = (now_ms, Instant::now());
            }
            ensure!(last.1.elapsed() < HANGS, "the rig stood still for {HANGS:?} until {what}");
            self.tick()?;
        }
    }

    /// Waits for a cable that is cut.
    fn whole(&mut self) -> Result<()> {
        self.until("the cable is mended", u64::MAX, |device| Ok(!device.line.is_cut())).map(|_| ())
    }

    /// What a failed question means: on a bad line it is lost, anything else is wrong.
    fn lost(&self, error: LinkError) -> Result<()> {
        match error {
            LinkError::Unanswered { .. } if self.line.is_bad() => Ok(()),
            LinkError::Unanswered { .. } => Err(error).context("on a line without errors"),
            error => bail!(error),
        }
    }

    /// The state now; its time is that of the rig.
    pub fn status(&mut self) -> Result<Status> {
        for _ in 0..ATTEMPTS {
            self.whole()?;
            let from_ms = self.device_ms();
            match self.client()?.status() {
                Ok(status) => {
                    let (t_ms, until_ms) = (status.t_us / 1_000, self.device_ms());
                    self.tally.command("status", Answer::Accepted);
                    // A period that has begun is counted by the rig when it ends.
                    ensure!(
                        (from_ms..=until_ms).contains(&t_ms),
                        "a status requested between {from_ms} and {until_ms} ms of the rig states {t_ms} ms"
                    );
                    self.answered_ms = from_ms + self.rig().started();
                    // It comes among the rest too, and is handled there in its order.
                    self.drain()?;
                    if let Some(deadline_ms) = self.deadline_ms.filter(|_| is_active(status.state)) {
                        let over_ms = (t_ms + self.rig().started()).saturating_sub(deadline_ms);
                        ensure!(over_ms == 0, "a program runs {over_ms} ms longer than it can");
                    }
                    return Ok(status);
                }
                Err(error) => self.lost(error)?,
            }
            self.tally.command("status", Answer::Unanswered);
        }
        bail!("{ATTEMPTS} questions for the status were lost")
    }

    /// Sends a request once.
    pub fn request(&mut self, request: Request) -> Result<Answer> {
        self.whole()?;
        let from_ms = self.now_ms();
        let answer = match self.client()?.request(request) {
            Ok(()) => Answer::Accepted,
            Err(LinkError::Refused { refusal, .. }) => Answer::Refused(refusal),
            Err(error) => {
                self.lost(error)?;
                Answer::Unanswered
            }
        };
        if answer != Answer::Unanswered {
            self.answered_ms = from_ms;
        }
        self.tally.command(request_name(&request), answer);
        self.drain()?;
        Ok(answer)
    }

    /// Sends a request once and checks the answer. `sound`: the answer of an idle device; `or`: another one that it may give.
    pub fn order(
        &mut self,
        request: Request,
        sound: Result<(), Refusal>,
        or: Option<Refusal>,
    ) -> Result<Answer> {
        let before = self.status()?;
        let answer = self.request(request)?;
        let fits = |state, fault| {
            let expected = answers::expected(&request, state, fault, sound);
            expected == answer
                || (expected == Answer::Accepted && or.is_some_and(|or| answer == Answer::Refused(or)))
        };
        if answer == Answer::Unanswered || fits(before.state, before.fault) {
            return Ok(answer);
        }
        // The program may have ended since, or a fault have come.
        let after = self.status()?;
        let ended = is_active(before.state) && fits(protocol::State::Idle, None);
        let faulted = after.fault.is_some() && fits(after.state, after.fault);
        ensure!(
            ended || faulted,
            "`{}` was answered with {answer:?} in {:?} (fault {:?}), {:?} (fault {:?}) after it; for an idle device {sound:?} is right",
            request_name(&request),
            before.state,
            before.fault,
            after.state,
            after.fault
        );
        Ok(answer)
    }

    /// Repeats a request until it is accepted.
    pub fn insist(&mut self, request: Request) -> Result<()> {
        for _ in 0..ATTEMPTS {
            match self.request(request)? {
                Answer::Accepted => return Ok(()),
                Answer::Unanswered => {}
                Answer::Refused(refusal) => {
                    bail!("`{}` was refused with {refusal:?}", request_name(&request))
                }
            }
        }
        bail!("`{}` was lost {ATTEMPTS} times", request_name(&request))
    }

    /// Sets limits that the device has accepted.
    pub fn set_limits(&mut self, force_mn: u32, silence_ms: u32) -> Result<()> {
        self.insist(Request::Limits { force_mn, silence_ms })?;
        (self.force_mn, self.silence_ms) = (force_mn, silence_ms);
        Ok(())
    }

    /// Switches the samples on; what was not received until then is a known gap.
    pub fn resume_stream(&mut self) -> Result<()> {
        self.drain()?;
        self.books.reopen(false);
        self.insist(Request::Stream { enable: true })
    }

    /// Closes the port, after the losses that the client reports are compared with the books.
    pub fn close(&mut self) -> Result<()> {
        self.drain()?;
        let client = self.client.take().context("no client is connected")?;
        let (reported, booked) = (client.losses().samples_missing, self.books.lost_of_client());
        ensure!(
            reported == booked,
            "the client reports {reported} samples lost, {booked} are missing between batches"
        );
        Ok(())
    }

    /// Forgets a client whose device has restarted.
    pub fn forget_client(&mut self) {
        self.client = None;
    }

    /// Opens the port and sends a hello, as often as a bad line makes it necessary.
    pub fn connect(&mut self) -> Result<()> {
        for _ in 0..ATTEMPTS {
            while self.line.is_cut() {
                std::thread::sleep(POLL_INTERVAL);
                self.line.step(self.bench.rig().steps(), &mut self.random);
            }
            let from_ms = self.device_ms();
            match Client::connect(&self.line.port()) {
                Ok(client) => {
                    let (t_ms, until_ms) = (client.hello().now_us / 1_000, self.device_ms());
                    ensure!(
                        (from_ms..=until_ms).contains(&t_ms),
                        "a hello sent between {from_ms} and {until_ms} ms of the rig states {t_ms} ms"
                    );
                    self.client = Some(client);
                    self.answered_ms = from_ms + self.rig().started();
                    return Ok(());
                }
                Err(LinkError::NoAnswer { .. }) if self.line.is_bad() => {}
                Err(error) => bail!(error),
            }
        }
        bail!("{ATTEMPTS} times 5 hellos were lost")
    }

    /// How long the guide may still be driven: below this the motors have enough left.
    pub fn motors_are_cool(status: &Status) -> bool {
        status.motor_budget_permille.into_iter().all(|used| used < 700)
    }
}
