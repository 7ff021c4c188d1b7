//! The firmware in QEMU with its simulated rig, as a sequence has it.
//!
//! What must hold is checked after every exchange: the rig's own largest force and position since the last check, the bridges, the
//! state that the device reports.

use super::line::Line;
use crate::bench::Bench;
use crate::cosim::Injection;
use crate::qemu::HANGS;
use anyhow::{Context, Result, anyhow};
use control::calibration::Calibration;
use control::campaign::judge::{LimitChecker, Observation, ROLLS_ON_UM};
use control::campaign::{
    self, CampaignCounts, Checked, Condition, Converter, Disturbances, Target, Violation,
};
use protocol::{CalibrationRecord, Command, EventKind, Message, Outcome, Refusal, Request, Safety, Status};
use simulation::rig::config::{Range, RigConfig};
use std::time::{Duration, Instant};

/// As many rig seconds per second as the computer can do.
const SPEED: f64 = f64::INFINITY;
/// Time in which a command is answered, before it is sent again: by this computer's clock, and by the device's, milliseconds.
const ANSWER_TIMEOUT: Duration = Duration::from_millis(1_500);
const ANSWER_DEVICE_MS: u64 = 1_000;
/// Device time that a command and its answer may take before the device waits for this computer, milliseconds.
const EXCHANGE_MS: u64 = 100;
/// Device time that is allowed at a time while a restart is awaited, milliseconds.
const RESTART_MS: u64 = 20;
/// How often a command is sent.
const TRIES: u32 = 8;
/// Device time between two signs of life, milliseconds.
const STATUS_INTERVAL_MS: u64 = 400;
/// Device time in which a replayed frame has been received and carried out, milliseconds.
const REPLAY_MS: u64 = 30;
/// Largest slope of the rig's force over its displacement, newtons per micrometre, over its travel.
const STIFFNESS_N_PER_UM: f32 = 1.3e-3;
/// Noise of the cell and what the needle's dynamics add, newtons.
const NOISE_N: f32 = 0.1;
/// Share of the duty that may leave the window while the device restarts: a bin of 5 s, and some.
const COOLED_SHARE: f32 = 0.1;
/// Frames that are kept for sending them again.
const KEPT_FRAMES: usize = 400;
const HELLO: Command = Command { id: 0, connection: 0, request: Request::Hello };

/// Carries out sequences one after the other on one device, from its power-on.
///
/// # Errors
/// The first violation, with the seeds; or where the bench fails.
pub fn boot(first: u64, count: u64) -> Result<CampaignCounts> {
    let mut config = RigConfig::default();
    // The bridge's offset is unknown to the limits; without it the true force is the one that counts.
    config.simulation.force.offset_n = Range { low: 0.0, high: 0.0 };
    if first.is_multiple_of(2) {
        // A needle that is hardly felt: the travel is what limits.
        config.simulation.force.share_of_full_scale *= 0.01;
    }
    let soft = first.is_multiple_of(2);
    let bench = Bench::start(config, first, SPEED, HANGS)?;
    bench.rig().keep_history();
    // Device time goes as far as each exchange and each wait of a sequence allows; it waits for nothing else.
    bench.rig().host_may_be_silent(true);
    let mut device = Device::new(&bench, soft)?;
    for seed in first..first + count {
        // Set again for each: on a busy computer a boot with all its sequences takes an hour.
        bench.limit(HANGS);
        let outcome = campaign::run(seed, &mut device);
        let [acts, faults] = outcome.map_err(|violation| {
            anyhow!(
                "in QEMU, booted with sequence {first}: {violation}; the firmware's log: {:#?}",
                bench.log()
            )
        })?;
        device.tally.add(CampaignCounts { sequences: 1, acts, faults, ..CampaignCounts::default() });
    }
    let tally = CampaignCounts { device_ms: bench.rig().steps(), ..device.tally };
    drop(device);
    bench.stop()?;
    Ok(tally)
}

struct Device<'a> {
    bench: &'a Bench,
    line: Line,
    soft: bool,
    judge: LimitChecker,
    connection: u32,
    next_id: u16,
    record: CalibrationRecord,
    status: Option<Status>,
    safety: Option<Safety>,
    /// Since the last check.
    started: u32,
    ended: Option<Outcome>,
    cleared: bool,
    /// A force channel fails; a potentiometer does.
    fails: [bool; 2],
    sent: Vec<Command>,
    tally: CampaignCounts,
}

impl<'a> Device<'a> {
    fn new(bench: &'a Bench, soft: bool) -> Result<Self> {
        let line = Line::open(&bench.folder().join("serial"))?;
        let record = Calibration::nominal_record();
        let mut judge = LimitChecker::new(STIFFNESS_N_PER_UM * ROLLS_ON_UM + NOISE_N, &record);
        judge.started(&record, position_um(bench));
        let mut device = Self {
            bench,
            line,
            soft,
            judge,
            connection: 0,
            next_id: 0,
            record,
            status: None,
            safety: None,
            started: 0,
            ended: None,
            cleared: false,
            fails: [false; 2],
            sent: Vec::new(),
            tally: CampaignCounts::default(),
        };
        device.connect().map_err(|violation| anyhow!("{violation}")).context("no hello")?;
        Ok(device)
    }

    fn now_ms(&self) -> u64 {
        self.bench.rig().steps()
    }

    fn connect(&mut self) -> Checked<()> {
        self.connection = 0;
        self.exchange(HELLO)?.map_err(|refusal| Violation(format!("a hello is refused: {refusal:?}")))
    }

    /// Sends a command until it is answered; its answer.
    fn exchange(&mut self, command: Command) -> Checked<Result<(), Refusal>> {
        for _ in 0..TRIES {
            self.tally.commands += 1;
            let allowed_ms = self.now_ms() + EXCHANGE_MS;
            self.bench.rig().allow(allowed_ms, Some(command.id));
            broken(self.line.send(&command))?;
            // Both clocks: on a busy machine the device may get no time for longer than any answer takes.
            let (began, began_ms) = (Instant::now(), self.now_ms());
            while began.elapsed() < ANSWER_TIMEOUT || self.now_ms() < began_ms + ANSWER_DEVICE_MS {
                if began.elapsed() > HANGS {
                    return Err(Violation(format!(
                        "the device's clock stands still at {} ms",
                        self.now_ms()
                    )));
                }
                let Some(message) = broken(self.line.receive(Duration::from_millis(20)))? else { continue };
                match self.take(message) {
                    Some((id, answer)) if id == command.id => return Ok(answer),
                    _ => {}
                }
            }
        }
        Err(Violation(format!("no answer to {command:?} in {TRIES} tries")))
    }

    /// Takes a message; an answer, if it is one.
    fn take(&mut self, message: Message) -> Option<(u16, Result<(), Refusal>)> {
        match message {
            Message::Ack { id } => return Some((id, Ok(()))),
            Message::Refused { id, refusal } => return Some((id, Err(refusal))),
            Message::Connected { connection } => (self.connection, self.next_id) = (connection, 1),
            Message::Status(status) => self.status = Some(status),
            Message::Safety(safety) => self.safety = Some(safety),
            Message::Calibration(record) => self.record = record,
            Message::Event(event) => {
                self.started += u32::from(matches!(event.kind, EventKind::StepStarted { index: 0 }));
                if let EventKind::ProgramEnded { outcome } = event.kind {
                    self.ended = Some(outcome);
                }
            }
            Message::Hello(_) | Message::Samples(_) | Message::Description(_) => {}
        }
        None
    }

    fn command(&mut self, request: Request) -> Checked<Result<(), Refusal>> {
        if self.next_id == u16::MAX {
            self.connect()?;
        }
        let command = Command { id: self.next_id, connection: self.connection, request };
        self.next_id += 1;
        if self.sent.len() == KEPT_FRAMES {
            self.sent.drain(..KEPT_FRAMES / 2);
        }
        self.sent.push(command);
        self.exchange(command)
    }

    /// Requests the status and compares it, and the rig, with what must hold.
    fn check(&mut self) -> Checked<Status> {
        self.command(Request::Status)?.map_err(|refusal| Violation(format!("a status: {refusal:?}")))?;
        let status = self.status.ok_or_else(|| Violation("an answer without a status".to_owned()))?;
        let rig = self.bench.rig();
        let driven = rig.bridges_driven();
        self.judge.observe(&Observation {
            now_ms: rig.steps(),
            driven,
            state: status.state,
            fault: status.fault,
            position_um: position_um(self.bench),
            force_n: self.measured_n(rig.take_reach().force_n),
            fails: self.fails,
            cleared: std::mem::take(&mut self.cleared),
            started: std::mem::take(&mut self.started),
            ended: self.ended.take(),
        })?;
        Ok(status)
    }

    /// The force as the cell measures it: a soft rig has its share.
    fn measured_n(&self, true_n: f64) -> f32 {
        (if self.soft { true_n * 0.01 } else { true_n }) as f32
    }

    fn force_n(&self) -> [f32; 2] {
        self.bench.rig().rig(|rig| rig.force_n()).map(|n| self.measured_n(n))
    }

    /// Waits until the device's clock has gone on.
    fn until_ms(&self, ms: u64) -> Checked<()> {
        self.bench.rig().allow(ms, None);
        let (mut last, mut began) = (self.now_ms(), Instant::now());
        while self.now_ms() < ms {
            std::thread::sleep(Duration::from_millis(1));
            if self.now_ms() > last {
                (last, began) = (self.now_ms(), Instant::now());
            }
            if began.elapsed() > HANGS {
                return Err(Violation(format!("device time stands still at {last} ms")));
            }
        }
        Ok(())
    }

    /// Waits for the next start and connects.
    fn restarted(&mut self, resets: u64, before: &Status) -> Checked<()> {
        let began = Instant::now();
        while self.bench.rig().resets() == resets {
            if began.elapsed() > HANGS {
                return Err(Violation("the device does not restart".to_owned()));
            }
            self.bench.rig().allow(self.now_ms() + RESTART_MS, None);
            std::thread::sleep(Duration::from_millis(1));
        }
        self.tally.restarts += 1;
        let now_ms = self.now_ms();
        self.until_ms(now_ms + 20)?;
        self.connect()?;
        for request in [Request::Calibration, Request::Status] {
            self.command(request)?.map_err(|refusal| Violation(format!("{request:?}: {refusal:?}")))?;
        }
        let status = self.status.ok_or_else(|| Violation("an answer without a status".to_owned()))?;
        self.judge.kept(kept(before), kept(&status), COOLED_SHARE)?;
        let record = self.record.clone();
        self.judge.started(&record, position_um(self.bench));
        Ok(())
    }
}

fn kept(status: &Status) -> (Option<protocol::Fault>, [f32; 2]) {
    (status.fault, status.motor_budget_permille.map(|permille| f32::from(permille) * 1e-3))
}

fn position_um(bench: &Bench) -> [f32; 2] {
    bench.rig().rig(|rig| rig.position_m()).map(|m| (m * 1e6) as f32)
}

/// A bench that fails ends the sequence as a violation does.
fn broken<T>(outcome: Result<T>) -> Checked<T> {
    outcome.map_err(|error| Violation(format!("the bench fails: {error:#}")))
}

impl Target for Device<'_> {
    fn request(&mut self, request: Request) -> Checked<Result<(), Refusal>> {
        let before = self.check()?;
        let resets = self.bench.rig().resets();
        self.judge.sends(&request, position_um(self.bench));
        let answer = self.command(request)?;
        let most_n = self.force_n().map(f32::abs).into_iter().fold(0.0, f32::max);
        let now_us = self.status.map_or(0, |status| status.t_us);
        self.judge.answered(&request, answer.is_ok(), now_us, most_n)?;
        self.cleared |=
            answer.is_ok() && matches!(request, Request::ClearFault | Request::AcknowledgeCalibration);
        if matches!(request, Request::StoreCalibration { .. }) && answer.is_ok() {
            self.restarted(resets, &before)?;
        }
        self.check()?;
        Ok(answer)
    }

    fn replay(&mut self, command: Command) -> Checked<()> {
        broken(self.line.send(&command))?;
        self.tally.commands += 1;
        let from_ms = self.now_ms();
        self.until_ms(from_ms + REPLAY_MS)?;
        while let Some(message) = broken(self.line.receive(Duration::from_millis(2)))? {
            self.take(message);
        }
        // A frame of this connection may be the repeat of a clear: its answer is remembered, and clears nothing.
        self.check().map(drop)
    }

    fn pass(&mut self, ms: u32) -> Checked<()> {
        let until_ms = self.now_ms() + u64::from(ms);
        while self.now_ms() < until_ms {
            self.until_ms(until_ms.min(self.now_ms() + STATUS_INTERVAL_MS))?;
            self.check()?;
        }
        Ok(())
    }

    fn silence(&mut self, ms: u32) -> Checked<()> {
        self.until_ms(self.now_ms() + u64::from(ms))?;
        self.check().map(drop)
    }

    fn set(&mut self, causes: Disturbances) -> Checked<()> {
        let Disturbances { emergency_stop, potentiometer_open, converter, force, potentiometers, hum_n } =
            causes;
        self.fails = [force.is_some(), potentiometers.is_some()];
        let injection = Injection {
            emergency_stop,
            potentiometer_open,
            force_fails: force,
            potentiometers_fail: potentiometers,
            hum_n: hum_n.into(),
            ..Injection::default()
        };
        self.bench.rig().inject(match converter {
            Converter::Healthy => injection,
            Converter::Silent => Injection { force_silent: true, ..injection },
            Converter::Saturated => Injection { force_saturated: Some(0), ..injection },
            Converter::SaturatedOnce => Injection { force_saturated_once: Some(0), ..injection },
        });
        self.until_ms(self.now_ms() + 2)
    }

    fn reset(&mut self) -> Checked<()> {
        let (before, resets) = (self.check()?, self.bench.rig().resets());
        let sag = before.t_us.is_multiple_of(2);
        self.bench.rig().inject(Injection { brown_out: sag, panic: !sag, ..Injection::default() });
        self.restarted(resets, &before)
    }

    fn condition(&mut self) -> Checked<Condition> {
        self.command(Request::Safety)?.map_err(|refusal| Violation(format!("safety: {refusal:?}")))?;
        let status = self.check()?;
        Ok(Condition {
            now_us: status.t_us,
            fault: status.fault,
            position_um: position_um(self.bench),
            cools_in_s: self.safety.map_or([0; 2], |safety| safety.cools_in_s),
            zero_counts: self.safety.map_or([0; 2], |safety| safety.zero_counts),
            limit_mn: status.force_limit_mn,
        })
    }

    fn sent(&self) -> &[Command] {
        &self.sent
    }

    fn record(&self) -> &CalibrationRecord {
        &self.record
    }

    /// A motor that is heated and cools takes seven minutes of device time.
    fn is_patient(&self) -> bool {
        false
    }
}
