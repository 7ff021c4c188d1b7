//! The controller on the plant of a seed, in the same process.

use crate::judge::{LimitChecker, Observation, ROLLS_ON_UM};
use crate::plant::Inputs as Bridge;
use crate::random::Random;
use crate::rig::Rig;
use crate::{CampaignCounts, Checked, Condition, Disturbances, Target, Violation};
use control::calibration::Calibration;
use control::motor::DutyBudget;
use control::retained::ControllerState;
use control::{Controller, Drive, Inputs, Origin, OutboundMessage, Outputs, PERIOD_US, Start};
use protocol::{
    CalibrationRecord, Command, Counters, Event, EventKind, Fault, Load, Refusal, Request, Safety, State,
};

const BOOT: u32 = 42;
const HELLO: Command = Command { id: 0, connection: 0, request: Request::Hello };
/// Newtons that the noise of the cell and its codes may add.
const NOISE_N: f32 = 0.03;
/// Periods between two signs of life of the host.
const STATUS_PERIODS: u64 = 500;
/// Frames that are kept for sending them again.
const KEPT_FRAMES: usize = 400;

/// A controller and its rig.
pub struct Bench {
    controller: Controller,
    rig: Rig,
    record: CalibrationRecord,
    origin: Origin,
    judge: LimitChecker,
    boot_id: u32,
    connection: u32,
    next_id: u16,
    /// Device time, which begins again with every start, and the time before the start.
    now_us: u64,
    before_us: u64,
    fault: Option<Fault>,
    safety: Option<Safety>,
    /// Force limit of the latest status, millinewtons.
    limit_mn: u32,
    sent: Vec<Command>,
    tally: CampaignCounts,
}

impl Bench {
    /// The rig of a seed, and where its calibration comes from.
    pub fn new(seed: u64) -> Self {
        let rig = Rig::drawn(seed);
        let origin = match Random::new(seed ^ 0x4F52_4900).below(8) {
            0 => Origin::Nominal,
            1 => Origin::Lost,
            _ => Origin::Stored,
        };
        let record = Calibration::nominal_record();
        let judge = LimitChecker::new(rig.stiffness_n_per_um() * ROLLS_ON_UM + NOISE_N, &record);
        let start = Start { origin, ..Start::ordinary(BOOT) };
        let mut bench = Self {
            controller: Controller::new(Calibration::default(), start),
            rig,
            record,
            origin,
            judge,
            boot_id: BOOT,
            connection: 0,
            next_id: 0,
            now_us: 0,
            before_us: 0,
            fault: None,
            safety: None,
            limit_mn: 0,
            sent: Vec::new(),
            tally: CampaignCounts::default(),
        };
        bench.judge.started(&bench.record, bench.rig.position_um());
        // A fault that the start has latched.
        bench.fault = bench.controller.retained_state().fault;
        bench
    }

    /// Acts so far.
    pub fn tally(&self) -> CampaignCounts {
        CampaignCounts { device_ms: (self.before_us + self.now_us) / 1_000, ..self.tally }
    }

    fn used(&self) -> [f32; 2] {
        self.controller.retained_state().budgets.each_ref().map(DutyBudget::used)
    }

    fn period(&mut self, command: Option<Command>) -> Checked<Outputs> {
        self.now_us += u64::from(PERIOD_US);
        let readings = self.rig.codes().readings();
        let (counters, load) = (Counters::default(), Load::default());
        let inputs = Inputs { now_us: self.now_us, late_us: 0, readings, command, counters, load };
        let outputs = self.controller.step(&inputs);
        self.rig.step(match outputs.drive {
            Drive::Release => [Bridge::OFF; 2],
            Drive::Duty(duty) => duty.map(|duty| Bridge::of_duty(duty.into())),
        });
        self.tally.commands += u64::from(command.is_some());
        self.observe(&outputs, command.as_ref())?;
        if let Some(record) = outputs.store.clone() {
            (self.record, self.origin) = (record, Origin::Stored);
            self.restart(false)?;
        }
        Ok(outputs)
    }

    fn observe(&mut self, outputs: &Outputs, command: Option<&Command>) -> Checked<()> {
        let mut started = 0;
        let mut answers = 0;
        let mut cleared = false;
        let mut ended = None;
        for note in &outputs.notes {
            match note {
                OutboundMessage::Event(Event { kind: EventKind::StepStarted { index: 0 }, .. }) => {
                    started += 1
                }
                OutboundMessage::Event(Event { kind: EventKind::Faulted { fault }, .. }) => {
                    self.fault = Some(*fault)
                }
                OutboundMessage::Event(Event { kind: EventKind::ProgramEnded { outcome }, .. }) => {
                    ended = Some(*outcome)
                }
                OutboundMessage::Connected(token) => (self.connection, self.next_id) = (*token, 0),
                OutboundMessage::Safety(safety) => self.safety = Some(*safety),
                OutboundMessage::Status(status) => self.limit_mn = status.force_limit_mn,
                OutboundMessage::Ack(id) | OutboundMessage::Refused(id, _) => {
                    answers += u32::from(command.is_some_and(|command| command.id == *id));
                    cleared |= matches!(note, OutboundMessage::Ack(_))
                        && command.is_some_and(|command| {
                            matches!(command.request, Request::ClearFault | Request::AcknowledgeCalibration)
                        });
                }
                _ => {}
            }
        }
        if answers != u32::from(command.is_some()) {
            return Err(Violation(format!("{answers} answers to {command:?}")));
        }
        // The latched fault is read only where it may have changed: the copy takes time.
        if outputs.keep || cleared {
            self.fault = self.controller.retained_state().fault;
        }
        let idle = !matches!(outputs.state, State::Faulted | State::Retreating);
        if idle == self.fault.is_some() {
            return Err(Violation(format!("{:?} with the fault {:?}", outputs.state, self.fault)));
        }
        self.judge.observe(&Observation {
            now_ms: (self.before_us + self.now_us) / 1_000,
            driven: outputs.drive != Drive::Release,
            state: outputs.state,
            fault: self.fault,
            position_um: self.rig.position_um(),
            force_n: self.rig.most_n(),
            fails: [self.rig.causes().force.is_some(), self.rig.causes().potentiometers.is_some()],
            cleared,
            started,
            ended,
        })
    }

    /// The device starts again with what the board has kept.
    fn restart(&mut self, restarted: bool) -> Checked<()> {
        self.tally.restarts += 1;
        let state_before = (self.controller.retained_state().fault, self.used());
        let retained = ControllerState::from_bytes(&self.controller.retained_state().to_bytes());
        self.boot_id += 1;
        let start = Start { retained, origin: self.origin, restarted, ..Start::ordinary(self.boot_id) };
        let calibration = Calibration::new(self.record.clone())
            .map_err(|error| Violation(format!("an unsound calibration was accepted: {error}")))?;
        self.controller = Controller::new(calibration, start);
        self.before_us += self.now_us;
        self.now_us = 0;
        self.fault = self.controller.retained_state().fault;
        self.judge.kept(state_before, (self.fault, self.used()), 1e-3)?;
        self.judge.started(&self.record, self.rig.position_um());
        self.period(Some(HELLO)).map(drop)
    }
}

impl Target for Bench {
    fn request(&mut self, request: Request) -> Checked<Result<(), Refusal>> {
        if self.connection == 0 {
            self.period(Some(HELLO))?;
        }
        let command = Command { id: self.next_id, connection: self.connection, request };
        self.next_id += 1;
        if self.sent.len() == KEPT_FRAMES {
            self.sent.drain(..KEPT_FRAMES / 2);
        }
        self.sent.push(command);
        self.judge.sends(&request, self.rig.position_um());
        let outputs = self.period(Some(command))?;
        let answer = outputs.notes.iter().find_map(|note| match *note {
            OutboundMessage::Ack(id) if id == command.id => Some(Ok(())),
            OutboundMessage::Refused(id, refusal) if id == command.id => Some(Err(refusal)),
            _ => None,
        });
        let answer = answer.ok_or_else(|| Violation(format!("no answer to {request:?}")))?;
        self.judge.answered(&request, answer.is_ok(), self.now_us, self.rig.most_n())?;
        Ok(answer)
    }

    fn replay(&mut self, command: Command) -> Checked<()> {
        self.period(Some(command)).map(drop)
    }

    fn pass(&mut self, ms: u32) -> Checked<()> {
        for _ in 0..ms {
            if (self.now_us / u64::from(PERIOD_US)).is_multiple_of(STATUS_PERIODS) {
                self.request(Request::Status).map(drop)?;
            } else {
                self.period(None)?;
            }
        }
        Ok(())
    }

    fn silence(&mut self, ms: u32) -> Checked<()> {
        (0..ms).try_for_each(|_| self.period(None).map(drop))
    }

    fn set(&mut self, causes: Disturbances) -> Checked<()> {
        self.rig.set(causes);
        Ok(())
    }

    fn reset(&mut self) -> Checked<()> {
        self.restart(true)
    }

    fn condition(&mut self) -> Checked<Condition> {
        for request in [Request::Safety, Request::Status] {
            self.request(request)?.map_err(|refusal| Violation(format!("{request:?}: {refusal:?}")))?;
        }
        Ok(Condition {
            now_us: self.now_us,
            fault: self.fault,
            position_um: self.rig.position_um(),
            stiffness_n_per_um: self.rig.stiffness_n_per_um(),
            cools_in_s: self.safety.map_or([0; 2], |safety| safety.cools_in_s),
            zero_counts: self.safety.map_or([0; 2], |safety| safety.zero_counts),
            limit_mn: self.limit_mn,
        })
    }

    fn sent(&self) -> &[Command] {
        &self.sent
    }

    fn record(&self) -> &CalibrationRecord {
        &self.record
    }

    fn is_patient(&self) -> bool {
        true
    }
}
