//! The controller with a small rig, in the same process: two actuators with a lag on springs, a cell with an offset.

use super::judge::{LimitChecker, Observation, ROLLS_ON_UM};
use super::random::Random;
use super::{Checked, Condition, Converter, Disturbances, Target, Violation};
use crate::ads131m02::ForceFault;
use crate::calibration::Calibration;
use crate::hal::Readings;
use crate::motor::DutyBudget;
use crate::retained::ControllerState;
use crate::{Controller, Drive, Inputs, Origin, OutboundMessage, Outputs, PERIOD_S, PERIOD_US, Start};
use protocol::{
    CalibrationRecord, Command, Counters, Event, EventKind, Fault, Load, Refusal, Request, Safety, State,
};
use std::format;
use std::vec::Vec;

const BOOT: u32 = 42;
/// Greatest code of the force converter.
const CODE_MAX: i32 = 0x7F_FFFF;
const HELLO: Command = Command { id: 0, connection: 0, request: Request::Hello };
/// Newtons of a code of the rig as designed.
const N_PER_CODE: f32 = 931.323e-9;
/// Newtons that the noise of the cell and its codes may add.
const NOISE_N: f32 = 0.03;
/// Periods between two signs of life of the host.
const STATUS_PERIODS: u64 = 500;
/// Frames that are kept for sending them again.
const KEPT_FRAMES: usize = 400;

struct Rig {
    position_um: [f32; 2],
    speed_um_s: [f32; 2],
    stiffness_n_per_um: f32,
    /// Share of a displacement that loads the other axis.
    coupling: f32,
    offset_n: [f32; 2],
    lag_periods: f32,
    full_speed_um_s: f32,
    dead_band: f32,
}

impl Rig {
    fn force_n(&self) -> [f32; 2] {
        let [x_um, y_um] = self.position_um;
        let along_um = [x_um + self.coupling * y_um, y_um + self.coupling * x_um];
        let mut force_n = self.offset_n;
        for (force_n, um) in force_n.iter_mut().zip(along_um) {
            *force_n += um * self.stiffness_n_per_um;
        }
        force_n
    }

    fn step(&mut self, drive: Drive) {
        let duty = match drive {
            Drive::Release => [0.0; 2],
            Drive::Duty(duty) => duty,
        };
        for ((position_um, speed_um_s), duty) in
            self.position_um.iter_mut().zip(&mut self.speed_um_s).zip(duty)
        {
            let share = ((duty.abs() - self.dead_band) / (1.0 - self.dead_band)).max(0.0);
            let wanted = share.copysign(duty) * self.full_speed_um_s;
            *speed_um_s += (wanted - *speed_um_s) / self.lag_periods;
            *position_um += *speed_um_s * PERIOD_S;
        }
    }
}

/// A controller and its rig.
pub struct Bench {
    controller: Controller,
    rig: Rig,
    causes: Disturbances,
    /// Codes of both sensors when they began to fail.
    kept: Option<[[i32; 2]; 2]>,
    saturated_once: bool,
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
    sent: Vec<Command>,
    tally: super::CampaignCounts,
}

impl Bench {
    /// The rig of a seed: stiffness, offset and motors are drawn, and where the calibration comes from.
    pub fn new(seed: u64) -> Self {
        let mut random = Random::new(seed ^ 0x5249_4700);
        let mut pick = |choices: &[f32]| choices[random.below(choices.len() as u32) as usize];
        let rig = Rig {
            position_um: [0.0, pick(&[0.0, 0.0, -800.0, 2_000.0])],
            speed_um_s: [0.0; 2],
            stiffness_n_per_um: pick(&[1e-6, 0.3e-3, 1.0e-3, 1.1e-3]),
            offset_n: [pick(&[0.0, 0.05, -0.2]), pick(&[0.0, -0.05, 0.2])],
            lag_periods: pick(&[5.0, 8.0, 12.0]),
            full_speed_um_s: pick(&[16_000.0, 20_000.0]),
            dead_band: pick(&[0.15, 0.18, 0.22]),
            coupling: pick(&[0.0, 0.0, 0.02, -0.02, 0.1, -0.1]),
        };
        let origin = [Origin::Stored, Origin::Nominal, Origin::Lost]
            [pick(&[0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 2.0]) as usize];
        let record = Calibration::nominal_record();
        let rolls_on_n = rig.stiffness_n_per_um * (1.0 + rig.coupling.abs()) * ROLLS_ON_UM;
        let judge = LimitChecker::new(rolls_on_n + NOISE_N, &record);
        let start = Start { origin, ..Start::ordinary(BOOT) };
        let mut bench = Self {
            controller: Controller::new(Calibration::default(), start),
            rig,
            causes: Disturbances::default(),
            kept: None,
            saturated_once: false,
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
            sent: Vec::new(),
            tally: super::CampaignCounts::default(),
        };
        bench.judge.started(&bench.record, bench.rig.position_um);
        // A fault that the start has latched.
        bench.fault = bench.controller.retained_state().fault;
        bench
    }

    /// What was done so far.
    pub fn tally(&self) -> super::CampaignCounts {
        super::CampaignCounts { device_ms: (self.before_us + self.now_us) / 1_000, ..self.tally }
    }

    fn most_n(&self) -> f32 {
        self.rig.force_n().iter().map(|n| n.abs()).fold(0.0, f32::max)
    }

    fn used(&self) -> [f32; 2] {
        self.controller.retained_state().budgets.each_ref().map(DutyBudget::used)
    }

    fn readings(&mut self) -> Readings {
        let period = (self.before_us + self.now_us) / 1_000;
        let code = |um: f32| (um / 12.207_031 + 2_048.0).round().clamp(0.0, 4_095.0) as i32;
        let mut potentiometers = self.rig.position_um.map(code);
        let hum_n = self.causes.hum_n * (std::f32::consts::TAU * 0.05 * (period % 20) as f32).sin();
        // The converter's own noise.
        let mut random = Random::new(period);
        let mut noise = || random.between(-700, 700);
        let mut codes = self.rig.force_n().map(|n| ((n + hum_n) / N_PER_CODE) as i32 + noise());
        let [kept_force, kept_potentiometers] = *self.kept.get_or_insert([codes, potentiometers]);
        if let Some(failing) = self.causes.force {
            codes = failing.codes(period, codes, kept_force, CODE_MAX);
        }
        if let Some(failing) = self.causes.potentiometers {
            potentiometers = failing.codes(period, potentiometers, kept_potentiometers, 4_095);
        }
        if let Some(code) = self.causes.potentiometer_open.and_then(|axis| potentiometers.get_mut(axis)) {
            *code = 4_095;
        }
        let codes = codes.map(|code| code.clamp(-CODE_MAX - 1, CODE_MAX));
        let at_its_end = codes.iter().position(|code| code.abs() >= CODE_MAX);
        let saturated = |channel: usize| Err(ForceFault::Saturated { channel: channel as u8 });
        let force_codes = match self.causes.converter {
            Converter::Healthy => at_its_end.map_or(Ok(codes), saturated),
            Converter::Silent => Err(ForceFault::NotReady),
            Converter::SaturatedOnce if self.saturated_once => Err(ForceFault::NotReady),
            Converter::Saturated | Converter::SaturatedOnce => {
                self.saturated_once = true;
                saturated(0)
            }
        };
        let potentiometer_codes = potentiometers.map(|code| code as u16);
        Readings { potentiometer_codes, force_codes, emergency_stop: self.causes.emergency_stop }
    }

    fn period(&mut self, command: Option<Command>) -> Checked<Outputs> {
        self.now_us += u64::from(PERIOD_US);
        let readings = self.readings();
        let (counters, load) = (Counters::default(), Load::default());
        let inputs = Inputs { now_us: self.now_us, late_us: 0, readings, command, counters, load };
        let outputs = self.controller.step(&inputs);
        self.rig.step(outputs.drive);
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
            position_um: self.rig.position_um,
            force_n: self.most_n(),
            fails: [self.causes.force.is_some(), self.causes.potentiometers.is_some()],
            cleared,
            started,
            ended,
        })
    }

    /// The device starts again with what the board has kept.
    fn restart(&mut self, restarted: bool) -> Checked<()> {
        self.tally.restarts += 1;
        let before = (self.controller.retained_state().fault, self.used());
        let retained = ControllerState::from_bytes(&self.controller.retained_state().to_bytes());
        self.boot_id += 1;
        let start = Start { retained, origin: self.origin, restarted, ..Start::ordinary(self.boot_id) };
        let calibration = Calibration::new(self.record.clone())
            .map_err(|error| Violation(format!("an unsound calibration was accepted: {error}")))?;
        self.controller = Controller::new(calibration, start);
        self.before_us += self.now_us;
        self.now_us = 0;
        self.fault = self.controller.retained_state().fault;
        self.judge.kept(before, (self.fault, self.used()), 1e-3)?;
        self.judge.started(&self.record, self.rig.position_um);
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
        self.judge.sends(&request, self.rig.position_um);
        let outputs = self.period(Some(command))?;
        let answer = outputs.notes.iter().find_map(|note| match *note {
            OutboundMessage::Ack(id) if id == command.id => Some(Ok(())),
            OutboundMessage::Refused(id, refusal) if id == command.id => Some(Err(refusal)),
            _ => None,
        });
        let answer = answer.ok_or_else(|| Violation(format!("no answer to {request:?}")))?;
        self.judge.answered(&request, answer.is_ok(), self.now_us, self.most_n())?;
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
        (self.causes, self.saturated_once, self.kept) = (causes, false, None);
        Ok(())
    }

    fn reset(&mut self) -> Checked<()> {
        self.restart(true)
    }

    fn condition(&mut self) -> Checked<Condition> {
        self.request(Request::Safety)?.map_err(|refusal| Violation(format!("safety: {refusal:?}")))?;
        Ok(Condition {
            now_us: self.now_us,
            fault: self.fault,
            position_um: self.rig.position_um,
            cools_in_s: self.safety.map_or([0; 2], |safety| safety.cools_in_s),
            zero_counts: self.safety.map_or([0; 2], |safety| safety.zero_counts),
            limit_mn: self.controller.interlock.limits().force_mn,
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
