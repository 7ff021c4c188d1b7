//! A fault from its cause to its end: injected, noticed in time, not cleared while it is there, remedied, cleared.

use super::PATIENT_MS;
use super::answers::Answer;
use super::device::{ATTEMPTS, Device};
use super::faults::{Cause, Leads};
use crate::cosim::{Injection, Trigger};
use crate::qemu::HANGS;
use anyhow::{Result, bail, ensure};
use protocol::{Fault, Refusal, Request, ResetReason, State, Status};
use rand::RngExt;
use std::thread;
use std::time::{Duration, Instant};

/// Time in which a fault shows that has been caused, milliseconds: a jam at the end of a move takes longest.
const SHOWS_MS: u64 = 20_000;
/// Time in which a fault whose cause is gone can be cleared.
const CLEARS_MS: u64 = 3_000;
/// Silence that ends a program where the host is silent on purpose.
const SILENT_MS: u32 = 1_500;
/// Time in which a request that was sent has been received.
const DELIVERY_MS: u64 = 40;
/// How long a MoveTimeout takes.
const MOVE_TIMEOUT_MS: u64 = 10_000;

impl Device<'_> {
    /// Makes a cause, and all that follows.
    pub fn fault(&mut self, cause: &Cause) -> Result<()> {
        self.deadline_ms = None;
        self.insist(Request::Stop)?;
        let status = self.status()?;
        ensure!(status.fault.is_none(), "fault {:?} without a cause", status.fault);
        let cool = Self::motors_are_cool(&status);
        if cause.in_motion && !cool {
            return Ok(());
        }
        let moves = cause.in_motion || (cool && self.random.random_bool(0.6));
        let reaches_n = self.reaches_n(&status);
        let injection = (cause.injection)(&mut self.random, reaches_n);
        let (from_ms, resets) = (self.now_ms(), self.rig().resets());
        self.reported.clear();
        if cause.leads == Leads::Deaf || matches!(cause.leads, Leads::Restart(..)) {
            self.watch.may_be_late();
        }
        if moves {
            // The trigger comes with the motion, so that it is not there before the answer to what begins it.
            if !self.move_for_a_fault(status.position_counts, 3_000)? {
                return self.insist(Request::Stop);
            }
            let for_periods = self.random.random_range(20..200);
            self.rig().inject_when(Trigger::Driving { for_periods }, injection);
        } else {
            self.rig().inject(injection);
        }
        if let Leads::Restart(reason, panics) = cause.leads {
            return self.restarts(cause, from_ms, resets, reason, panics);
        }
        let begun =
            self.until("it is injected", SHOWS_MS, |device| Ok(device.injected(from_ms).is_some()))?;
        if !begun {
            // The move was over before it had been driven for so long.
            self.rig().inject(Injection::default());
            return self.insist(Request::Stop);
        }
        match cause.leads {
            Leads::Nothing => {
                self.rig().inject(Injection::default());
                self.pass(100)?;
                let status = self.status()?;
                ensure!(status.fault.is_none(), "{} led to {:?}", cause.name, status.fault);
                self.tally.fault(cause.name, 0);
                Ok(())
            }
            Leads::Deaf => {
                let released = |device: &mut Self| Ok(device.rig().released_since().is_some());
                let released = self.until("the bridges are off", SHOWS_MS, released)?;
                self.rig().inject(Injection::default());
                ensure!(released, "{}: the bridges were on after {SHOWS_MS} ms", cause.name);
                self.pass(100)?;
                self.latched(cause, from_ms, &[Fault::Overrun])
            }
            Leads::To(faults) | Leads::Maybe(faults) => self.latched(cause, from_ms, faults),
            Leads::Restart(..) => Ok(()),
        }
    }

    /// Force along x that takes it beyond the limit, newtons.
    fn reaches_n(&self, status: &Status) -> f64 {
        let now_n = f64::from(status.force_counts[0]) * 50e-6;
        (f64::from(self.force_mn) * 1e-3 - now_n.abs() + 0.3).copysign(now_n)
    }

    fn injected(&self, from_ms: u64) -> Option<crate::cosim::Reaction> {
        self.rig().reaction().filter(|reaction| reaction.injected_at_step >= from_ms)
    }

    /// The fault is latched, in time and as the right one; then the remedy.
    fn latched(&mut self, cause: &Cause, from_ms: u64, faults: &[Fault]) -> Result<()> {
        let mut latched = None;
        let shows = self.until("the fault is latched", SHOWS_MS, |device| {
            let status = device.status()?;
            latched = status.fault;
            // A jam at the very end of a move has nothing left to hinder.
            let over = matches!(cause.leads, Leads::Maybe(_)) && status.state == State::Idle;
            Ok(latched.is_some() || over)
        })?;
        ensure!(shows, "{} was not noticed in {SHOWS_MS} ms", cause.name);
        let Some(fault) = latched else {
            self.rig().inject(Injection::default());
            return self.pass(100);
        };
        ensure!(faults.contains(&fault), "{} led to {fault:?}", cause.name);
        if let Some((reported, _)) = self.reported.first() {
            ensure!(*reported == fault, "{}: {reported:?} was reported and {fault:?} is latched", cause.name);
        }
        self.deadline_ms = None;
        let within = if fault == Fault::MoveTimeout { MOVE_TIMEOUT_MS } else { cause.within };
        self.off_in_time(cause.name, from_ms, within)?;
        if cause.persists && self.random.random() {
            self.order(Request::ClearFault, Err(Refusal::CauseRemains), None)?;
        }
        let faulted = Err(Refusal::Faulted { fault });
        if self.random.random() {
            self.order(Request::Run { steps: 1, crc: 0, start_us: 0 }, faulted, None)?;
        }
        let waits_ms = self.random.random_range(0..1_500);
        self.pass(waits_ms)?;
        let periods = self.off_in_time(cause.name, from_ms, within)?;
        self.rig().inject(Injection::default());
        self.pass(100)?;
        self.clear()?;
        self.tally.fault(cause.name, periods);
        Ok(())
    }

    /// Both bridges went off in time and have stayed off.
    fn off_in_time(&self, name: &str, from_ms: u64, within: u64) -> Result<u64> {
        let Some(reaction) = self.injected(from_ms) else { bail!("{name} was not injected") };
        let Some(periods) = reaction.periods() else { bail!("{name}: a bridge is on") };
        ensure!(periods <= within, "{name}: the bridges were off after {periods} periods, {within} at most");
        let again = reaction.driven_after_release;
        ensure!(again == 0, "{name}: a bridge was on in {again} periods after the fault");
        Ok(periods)
    }

    /// Clears a fault whose cause is gone. Until then, and by itself afterwards, nothing is driven.
    fn clear(&mut self) -> Result<()> {
        let since = self.rig().released_since();
        ensure!(since.is_some(), "a bridge is on in a latched fault");
        let from_ms = self.now_ms();
        let mut lost = 0;
        loop {
            // A cable that is cut is waited for, and what is lost on a bad one is no answer: neither is the device's time.
            let requested_ms = self.now_ms();
            match self.request(Request::ClearFault)? {
                Answer::Accepted => break,
                Answer::Refused(Refusal::CauseRemains) => {
                    ensure!(
                        requested_ms - from_ms < CLEARS_MS,
                        "the cause remained for {CLEARS_MS} ms after its end"
                    );
                }
                Answer::Refused(refusal) => bail!("clear was refused with {refusal:?}"),
                Answer::Unanswered => {
                    lost += 1;
                    ensure!(lost < ATTEMPTS, "{ATTEMPTS} questions to clear the fault were lost");
                }
            }
            self.tick()?;
        }
        let status = self.status()?;
        ensure!(status.state == State::Idle, "{:?} ({:?}) after it was cleared", status.state, status.fault);
        ensure!(self.rig().released_since() == since, "a bridge was on though nothing was started");
        Ok(())
    }

    /// The device starts again, reports why, and has it acknowledged before anything moves.
    fn restarts(
        &mut self,
        cause: &Cause,
        from_ms: u64,
        resets: u64,
        reason: ResetReason,
        panics: bool,
    ) -> Result<()> {
        let began = Instant::now();
        while self.rig().resets() == resets {
            if self.injected(from_ms).is_none() && self.now_ms() > from_ms + SHOWS_MS {
                self.rig().inject(Injection::default());
                return self.insist(Request::Stop);
            }
            ensure!(began.elapsed() < HANGS, "{}: no restart in {HANGS:?}", cause.name);
            thread::sleep(Duration::from_millis(2));
        }
        self.rig().inject(Injection::default());
        let boot_id = self.client()?.boot_id();
        self.forget_client();
        self.deadline_ms = None;
        self.connect()?;
        let again = self.rig().resets() - resets;
        // A hang lasts until it is ended from here: the next start may hang too.
        ensure!(again == 1 || reason == ResetReason::Watchdog, "{}: {again} restarts", cause.name);
        self.tally.restarts += again as u32;
        self.books.restarted(self.rig().started());
        self.watch.restarted();
        let hello = self.client()?.hello().clone();
        ensure!(self.client()?.boot_id() != boot_id, "{}: the boot is the same one", cause.name);
        ensure!(hello.reset_reason == reason, "{}: restarted for {:?}", cause.name, hello.reset_reason);
        ensure!(hello.last_panic.is_some() == panics, "{}: last panic {:?}", cause.name, hello.last_panic);
        let status = self.status()?;
        ensure!(status.fault == Some(Fault::Restarted), "{}: {:?} after it", cause.name, status.fault);
        let periods = self.off_in_time(cause.name, from_ms, cause.within)?;
        self.clear()?;
        self.tally.fault(cause.name, periods);
        self.set_limits(self.force_mn, PATIENT_MS)?;
        self.resume_stream()
    }

    /// The host sends nothing while a program runs.
    pub fn host_is_silent(&mut self) -> Result<()> {
        self.deadline_ms = None;
        self.insist(Request::Stop)?;
        self.set_limits(self.force_mn, SILENT_MS)?;
        let status = self.status()?;
        ensure!(status.fault.is_none(), "fault {:?} without a cause", status.fault);
        let begun =
            Self::motors_are_cool(&status) && self.move_for_a_fault(status.position_counts, 600_000)?;
        if begun {
            let status = self.status()?;
            let received_ms = status.t_us / 1_000 + self.rig().started();
            let latest_ms = self.now_ms() + DELIVERY_MS + u64::from(SILENT_MS);
            self.rig().host_may_be_silent(true);
            // A bad line can be a silence of its own.
            if status.fault.is_none() {
                let off = |device: &mut Self| Ok(device.rig().released_since().is_some());
                self.until("the silence is noticed", 2 * u64::from(SILENT_MS), off)?;
            }
            self.rig().host_may_be_silent(false);
            let Some(off_ms) = self.rig().released_since() else {
                bail!("a silence of {} ms was not noticed", 2 * SILENT_MS)
            };
            ensure!(off_ms <= latest_ms, "a silence was noticed {} ms too late", off_ms - latest_ms);
            let fault = self.status()?.fault;
            ensure!(fault == Some(Fault::HostSilent), "a silent host led to {fault:?}");
            let silent_ms = off_ms.saturating_sub(received_ms);
            let early = status.fault.is_none() && silent_ms < u64::from(SILENT_MS);
            ensure!(!early, "a silence of {silent_ms} ms was one of {SILENT_MS} ms");
            self.tally.fault("host silent", silent_ms.saturating_sub(u64::from(SILENT_MS)));
            self.deadline_ms = None;
            self.clear()?;
        } else {
            self.insist(Request::Stop)?;
        }
        self.set_limits(self.force_mn, PATIENT_MS)
    }
}
