//! The firmware in QEMU, on which sequences are carried out.

use super::lockstep::{ANSWER_PERIODS, Lockstep, Upset};
use crate::qemu::HANGS;
use anyhow::{Context, Result, anyhow};
use control::calibration::Calibration;
use protocol::{
    CalibrationRecord, Command, EventKind, MAX_FRAME_TO_DEVICE, Message, Outcome, Refusal, Request, Safety,
    Samples, Status, encode_command,
};
use sequences::judge::{LimitChecker, Observation, ROLLS_ON_UM};
use sequences::random::Random;
use sequences::rig::Rig;
use sequences::{CampaignCounts, Checked, Condition, Disturbances, Target, Violation};

/// Device time in which the device starts and has its first period, milliseconds.
const RESTART_MS: u64 = 1_000;
/// Number of times a command is sent.
const TRIES: u32 = 8;
/// Device time between two signs of life, milliseconds.
const STATUS_INTERVAL_MS: u64 = 400;
/// Without a drive for so long nothing moves any more, milliseconds: each of three steps holds or tares for 200 and settles for 100 at most, a
/// retreat waits for 150, and a start that is not refused is 50 ahead. What is left of a wait for a motion is then left out.
const RESTS_MS: u32 = 800;
/// A longer wait is one for something else: a motor that cools.
const MOTION_MS: u32 = 5_000;
/// Device time in which a replayed frame has been received and carried out, milliseconds.
const REPLAY_MS: u64 = 60;
/// Noise of the cell, newtons.
const NOISE_N: f32 = 0.03;
/// Share of the duty that may leave the window while the device restarts: a bin of 5 s, and some.
const COOLED_SHARE: f32 = 0.1;
/// Frames that are kept for sending them again.
const KEPT_FRAMES: usize = 400;
/// One frame in so many arrives damaged, and is sent again.
const DAMAGED_ONE_IN: u32 = 50;
/// Periods after which that is done.
const DAMAGED_PERIODS: u32 = 100;
/// Stack that must never be used, bytes.
const STACK_LEAST_BYTES: u32 = 48 << 10;
const HELLO: Command = Command { id: 0, connection: 0, request: Request::Hello };

/// Carries out sequences one after the other on one device, from its power-on.
///
/// # Errors
/// The first violation, with the seeds; or where the firmware fails.
pub fn boot(first: u64, count: u64) -> Result<CampaignCounts> {
    let mut device = Device::new(first).map_err(|violation| anyhow!("{violation}")).context("no hello")?;
    for seed in first..first + count {
        // Set again for each: on a busy computer a power-on with all its sequences takes an hour.
        device.firmware.limit(HANGS);
        let outcome = sequences::run(Random::new(seed), &mut device);
        let [acts, faults] = outcome.map_err(|violation| {
            let log = device.firmware.log();
            anyhow!("in QEMU, powered on with sequence {first}, sequence {seed}, {violation}; the firmware's log: {log:#?}")
        })?;
        device.tally.add(CampaignCounts { sequences: 1, acts, faults, ..CampaignCounts::default() });
    }
    let tally = CampaignCounts { device_ms: device.firmware.periods, ..device.tally };
    device.firmware.stop()?;
    Ok(tally)
}

struct Device {
    firmware: Lockstep,
    judge: LimitChecker,
    calibration: Calibration,
    noise: Random,
    connection: u32,
    next_id: u16,
    status: Option<Status>,
    safety: Option<Safety>,
    /// Time of the sample that is due, milliseconds; none at the first.
    next_ms: Option<u64>,
    /// Since the last check.
    started: u32,
    ended: Option<Outcome>,
    cleared: bool,
    sent: Vec<Command>,
    tally: CampaignCounts,
}

impl Device {
    fn new(seed: u64) -> Checked<Self> {
        let rig = Rig::drawn(seed);
        let calibration = Calibration::default();
        let mut judge =
            LimitChecker::new(rig.stiffness_n_per_um() * ROLLS_ON_UM + NOISE_N, calibration.record());
        judge.started(calibration.record(), rig.position_um());
        let mut device = Self {
            firmware: broken(Lockstep::start(rig, HANGS))?,
            judge,
            calibration,
            noise: Random::new(!seed),
            connection: 0,
            next_id: 0,
            status: None,
            safety: None,
            next_ms: None,
            started: 0,
            ended: None,
            cleared: false,
            sent: Vec::new(),
            tally: CampaignCounts::default(),
        };
        device.connect()?;
        device.stream()?;
        Ok(device)
    }

    fn connect(&mut self) -> Checked<()> {
        self.connection = 0;
        self.exchange(HELLO)?.map_err(|refusal| Violation(format!("a hello is refused: {refusal:?}")))
    }

    /// Has the device send its samples, which are compared by the calibration that it works with.
    fn stream(&mut self) -> Checked<()> {
        self.next_ms = None;
        for request in [Request::Calibration, Request::Stream { enable: true }, Request::Status] {
            self.command(request)?.map_err(|refusal| Violation(format!("{request:?}: {refusal:?}")))?;
        }
        Ok(())
    }

    /// One control period.
    fn period(&mut self) -> Checked<()> {
        broken(self.firmware.period())?;
        self.answer(None).map(drop)
    }

    /// Takes what the device has sent; the answer to a command, if it came.
    fn answer(&mut self, id: Option<u16>) -> Checked<Option<Result<(), Refusal>>> {
        let mut answer = None;
        while let Some(message) = self.firmware.receive() {
            match self.take(message)? {
                Some((answered, result)) if Some(answered) == id => answer = Some(result),
                _ => {}
            }
        }
        Ok(answer)
    }

    /// Sends a command until it is answered; its answer.
    fn exchange(&mut self, command: Command) -> Checked<Result<(), Refusal>> {
        for _ in 0..TRIES {
            self.tally.commands += 1;
            let is_damaged = self.noise.one_in(DAMAGED_ONE_IN);
            broken(if is_damaged { self.damaged(&command) } else { self.firmware.send(&command) })?;
            // A damaged frame has no answer.
            let periods = if is_damaged { DAMAGED_PERIODS } else { ANSWER_PERIODS };
            for number in 0..periods {
                broken(self.firmware.waiting_period(number))?;
                if let Some(answer) = self.answer(Some(command.id))? {
                    return Ok(answer);
                }
            }
        }
        Err(Violation(format!("no answer to {command:?} in {TRIES} tries")))
    }

    /// Sends a frame with one bit flipped.
    fn damaged(&mut self, command: &Command) -> Result<()> {
        let mut buffer = [0; MAX_FRAME_TO_DEVICE];
        let mut frame = encode_command(command, &mut buffer)?.to_vec();
        let byte_index = self.noise.below(frame.len() as u32) as usize;
        frame[byte_index] ^= 1 << self.noise.below(8);
        self.firmware.send_bytes(&frame)
    }

    /// Takes a message; an answer, if it is one.
    fn take(&mut self, message: Message) -> Checked<Option<(u16, Result<(), Refusal>)>> {
        match message {
            Message::Ack { id } => return Ok(Some((id, Ok(())))),
            Message::Refused { id, refusal } => return Ok(Some((id, Err(refusal)))),
            Message::Connected { connection } => (self.connection, self.next_id) = (connection, 1),
            Message::Status(status) => self.status = Some(status),
            Message::Safety(safety) => self.safety = Some(safety),
            Message::Calibration(record) => {
                self.calibration = Calibration::new(record)
                    .map_err(|error| Violation(format!("an unsound calibration was accepted: {error}")))?;
            }
            Message::Event(event) => {
                self.started += u32::from(matches!(event.kind, EventKind::StepStarted { index: 0 }));
                if let EventKind::ProgramEnded { outcome } = event.kind {
                    self.ended = Some(outcome);
                }
            }
            Message::Samples(batch) => self.compare(&batch)?,
            Message::Hello(_) | Message::Description(_) => {}
        }
        Ok(None)
    }

    /// Every sample is what was sensed in its millisecond, and none is missing that is not counted.
    fn compare(&mut self, batch: &Samples) -> Checked<()> {
        let samples = batch.unpack(1_000).map_err(|error| Violation(format!("a batch: {error}")))?;
        for (index, (t_us, sample)) in samples.enumerate() {
            let ms = t_us / 1_000;
            let expected_ms = self.next_ms.replace(ms + 1).unwrap_or(ms);
            if ms != expected_ms && (index > 0 || batch.dropped == 0) {
                return Err(Violation(format!(
                    "the sample of {ms} ms comes where that of {expected_ms} ms is due"
                )));
            }
            let Some(codes) = self.firmware.codes_at(ms) else { continue };
            let position = |rising| {
                self.calibration.position_um(codes.potentiometer, [rising; 2]).map(|um| um.round() as i32)
            };
            let (falling, rising) = (position(0.0), position(1.0));
            let between = |axis: usize| {
                let read = sample.position_counts[axis];
                (falling[axis].min(rising[axis])..=falling[axis].max(rising[axis])).contains(&read)
            };
            if !between(0) || !between(1) {
                return Err(Violation(format!(
                    "the sample of {ms} ms has {:?} um where {falling:?} was sensed",
                    sample.position_counts
                )));
            }
        }
        Ok(())
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
        let causes = *self.firmware.rig.causes();
        self.judge.observe(&Observation {
            now_ms: self.firmware.periods,
            driven: self.firmware.driven,
            state: status.state,
            fault: status.fault,
            position_um: self.firmware.rig.position_um(),
            force_n: std::mem::take(&mut self.firmware.most_n),
            fails: [causes.force.is_some(), causes.potentiometers.is_some()],
            cleared: std::mem::take(&mut self.cleared),
            started: std::mem::take(&mut self.started),
            ended: self.ended.take(),
        })?;
        let (load, counters) = (status.load, status.counters);
        let stack = load.stack_free_bytes;
        if counters.control_overruns > 0
            || counters.messages_dropped > 0
            || (1..STACK_LEAST_BYTES).contains(&stack)
        {
            return Err(Violation(format!("{load:?}, {counters:?}")));
        }
        Ok(status)
    }

    /// Waits for the next start and connects.
    fn restarted(&mut self, resets: u64, before: &Status) -> Checked<()> {
        let start_ms = self.firmware.periods;
        while self.firmware.resets == resets {
            if self.firmware.periods > start_ms + RESTART_MS {
                return Err(Violation("the device does not restart".to_owned()));
            }
            self.period()?;
        }
        self.tally.restarts += 1;
        for _ in 0..20 {
            self.period()?;
        }
        self.connect()?;
        self.stream()?;
        let status = self.status.ok_or_else(|| Violation("an answer without a status".to_owned()))?;
        self.judge.kept(kept(before), kept(&status), COOLED_SHARE)?;
        self.judge.started(self.calibration.record(), self.firmware.rig.position_um());
        Ok(())
    }
}

fn kept(status: &Status) -> (Option<protocol::Fault>, [f32; 2]) {
    (status.fault, status.motor_budget_permille.map(|permille| f32::from(permille) * 1e-3))
}

/// A firmware that fails ends the sequence as a violation does.
fn broken<T>(outcome: Result<T>) -> Checked<T> {
    outcome.map_err(|error| Violation(format!("the firmware fails: {error:#}")))
}

impl Target for Device {
    fn request(&mut self, request: Request) -> Checked<Result<(), Refusal>> {
        // Whatever was done before has been checked at its end; a byte takes a period or two.
        let stores = matches!(request, Request::StoreCalibration { .. });
        let state_before = if stores { Some(self.check()?) } else { None };
        let resets = self.firmware.resets;
        self.judge.sends(&request, self.firmware.rig.position_um());
        let answer = self.command(request)?;
        let now_us = self.status.map_or(0, |status| status.t_us);
        self.judge.answered(&request, answer.is_ok(), now_us, self.firmware.rig.most_n())?;
        self.cleared |=
            answer.is_ok() && matches!(request, Request::ClearFault | Request::AcknowledgeCalibration);
        if answer.is_ok()
            && let Some(state_before) = state_before
        {
            self.restarted(resets, &state_before)?;
        }
        self.check()?;
        Ok(answer)
    }

    fn replay(&mut self, command: Command) -> Checked<()> {
        broken(self.firmware.send(&command))?;
        self.tally.commands += 1;
        for _ in 0..REPLAY_MS {
            self.period()?;
        }
        // A frame of this connection may be the repeat of a clear: its answer is remembered, and clears nothing.
        self.check().map(drop)
    }

    fn pass(&mut self, ms: u32) -> Checked<()> {
        let end_ms = self.firmware.periods + u64::from(ms);
        let rests_ms = if ms <= MOTION_MS { RESTS_MS } else { ms };
        let mut undriven_ms = 0;
        while self.firmware.periods < end_ms && undriven_ms < rests_ms {
            let next_ms = end_ms.min(self.firmware.periods + STATUS_INTERVAL_MS);
            while self.firmware.periods < next_ms && undriven_ms < rests_ms {
                self.period()?;
                undriven_ms = if self.firmware.driven { 0 } else { undriven_ms + 1 };
            }
            self.check()?;
        }
        Ok(())
    }

    fn silence(&mut self, ms: u32) -> Checked<()> {
        for _ in 0..ms {
            self.period()?;
        }
        self.check().map(drop)
    }

    fn set(&mut self, causes: Disturbances) -> Checked<()> {
        self.firmware.rig.set(causes);
        self.period()?;
        self.period()
    }

    fn reset(&mut self) -> Checked<()> {
        let (state_before, resets) = (self.check()?, self.firmware.resets);
        let upset = if state_before.t_us.is_multiple_of(2_000) { Upset::BrownOut } else { Upset::Panic };
        self.firmware.upset = Some(upset);
        self.restarted(resets, &state_before)
    }

    fn condition(&mut self) -> Checked<Condition> {
        self.command(Request::Safety)?.map_err(|refusal| Violation(format!("safety: {refusal:?}")))?;
        let status = self.check()?;
        Ok(Condition {
            now_us: status.t_us,
            fault: status.fault,
            position_um: self.firmware.rig.position_um(),
            stiffness_n_per_um: self.firmware.rig.stiffness_n_per_um(),
            cools_in_s: self.safety.map_or([0; 2], |safety| safety.cools_in_s),
            zero_counts: self.safety.map_or([0; 2], |safety| safety.zero_counts),
            limit_mn: status.force_limit_mn,
        })
    }

    fn sent(&self) -> &[Command] {
        &self.sent
    }

    fn record(&self) -> &CalibrationRecord {
        self.calibration.record()
    }

    /// A motor that is heated and cools takes seven minutes of device time.
    fn is_patient(&self) -> bool {
        false
    }
}
