//! Random sequences of commands that know the protocol: loads, tares, calibrations, faults, restarts and old frames, against what must
//! hold whatever the sequence. With any mend taken out the campaign finds the gap, so that it is known to look.
//!
//! `NEEDLE_GUIDE_CAMPAIGN=SEEDS` runs more of them: a million commands are some 25 000 seeds.

use super::*;
use crate::control::mutation::Mutation;
use std::boxed::Box;
use std::format;
use std::string::String;
use std::vec::Vec;

/// Force beyond the limit while a motor rolls on, newtons: 2 periods and its lag at full speed, at the stiffest needle.
const OVERSHOOT_N: f32 = 0.45;
/// Most that a sound calibration may be off by, so that both it and the true one are within the bounds.
const GAIN_ERROR: f32 = 1.6;
/// A guide rests within its travel and the loop's own error.
const REST_UM: f32 = 60.0;
/// Motion the wrong way before it is noticed.
const WRONG_WAY_MOST_UM: f32 = 310.0;
const COMMANDS: u32 = 40;

struct Random(u64);

impl Random {
    fn below(&mut self, limit: u32) -> u32 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        ((self.0 >> 33) as u32) % limit
    }

    fn between(&mut self, least: i32, most: i32) -> i32 {
        least + self.below((most - least + 1) as u32) as i32
    }
}

/// The rig: two actuators with a lag on springs, whose codes are those of the rig as designed.
struct Rig {
    position_um: [f32; 2],
    speed_um_s: [f32; 2],
    stiffness_n_per_um: f32,
    emergency_stop: bool,
    potentiometer_codes: Option<[u16; 2]>,
}

impl Rig {
    fn force_n(&self) -> f32 {
        self.position_um.iter().map(|um| (um * self.stiffness_n_per_um).abs()).fold(0.0, f32::max)
    }

    fn step(&mut self, drive: Drive) {
        let duty = match drive {
            Drive::Release => [0.0; 2],
            Drive::Duty(duty) => duty,
        };
        for ((position_um, speed_um_s), duty) in
            self.position_um.iter_mut().zip(&mut self.speed_um_s).zip(duty)
        {
            let wanted = ((duty.abs() - 0.18) / 0.82).max(0.0).copysign(duty) * 20_000.0;
            *speed_um_s += (wanted - *speed_um_s) / 12.0;
            *position_um += *speed_um_s * PERIOD_S;
        }
    }
}

struct Campaign {
    random: Random,
    controller: Controller,
    rig: Rig,
    record: CalibrationRecord,
    boot_id: u32,
    connection: u32,
    next_id: u16,
    now_us: u64,
    sent: Vec<Command>,
    /// Force that is allowed, newtons: the limit, or what there was when it was lowered.
    allowed_n: f32,
    limit_n: f32,
    latched: Option<Fault>,
    runs: u32,
    starts: u32,
    /// True position at the last start, and whether the tables have the wrong sign.
    from_um: [f32; 2],
    turned: bool,
    released: u32,
    completed: bool,
}

type Found = Result<(), String>;

impl Campaign {
    fn new(seed: u64) -> Self {
        let record = Calibration::nominal_record();
        let calibration = Calibration::new(record.clone()).expect("sound");
        let (controller, connection) = connected(calibration, Start::ordinary(BOOT));
        let mut random = Random(seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) ^ 77);
        random.below(2);
        let stiffness = [1e-6, 0.3e-3, 1.0e-3, 1.1e-3][random.below(4) as usize];
        Self {
            rig: Rig {
                position_um: [0.0; 2],
                speed_um_s: [0.0; 2],
                stiffness_n_per_um: stiffness,
                emergency_stop: false,
                potentiometer_codes: None,
            },
            random,
            controller,
            record,
            boot_id: BOOT,
            connection,
            next_id: 0,
            now_us: 0,
            sent: Vec::new(),
            allowed_n: 4.0,
            limit_n: 4.0,
            latched: None,
            runs: 0,
            starts: 0,
            from_um: [0.0; 2],
            turned: false,
            released: 0,
            completed: false,
        }
    }

    fn period(&mut self, command: Option<Command>) -> Result<Outputs, String> {
        self.now_us += u64::from(PERIOD_US);
        let code = |um: f32| (um / 12.207_031 + 2_048.0).round().clamp(0.0, 4_095.0) as u16;
        let dither = (self.now_us / 1_000 % 7) as i32;
        let force =
            self.rig.position_um.map(|um| (um * self.rig.stiffness_n_per_um / 931.323e-9) as i32 + dither);
        let readings = Readings {
            potentiometer_codes: self.rig.potentiometer_codes.unwrap_or(self.rig.position_um.map(code)),
            force_codes: Ok(force.map(|code| code.clamp(-8_388_607, 8_388_607))),
            emergency_stop: self.rig.emergency_stop,
        };
        let (counters, load) = (Counters::default(), Load::default());
        let inputs = Inputs { now_us: self.now_us, late_us: 0, readings, command, counters, load };
        let outputs = self.controller.step(&inputs);
        self.rig.step(outputs.drive);
        self.judge(&outputs, command.as_ref())?;
        Ok(outputs)
    }

    /// What must hold in every period.
    fn judge(&mut self, outputs: &Outputs, command: Option<&Command>) -> Found {
        let acked = |id: u16| outputs.notes.contains(&Note::Ack(id));
        let cleared = command.is_some_and(|command| {
            acked(command.id)
                && matches!(command.request, Request::ClearFault | Request::AcknowledgeCalibration)
        });
        let now = self.controller.interlock.latched();
        if self.latched.is_some() && now != self.latched && !cleared {
            return Err(format!("fault {:?} has gone without its clear ({now:?})", self.latched));
        }
        self.latched = now;
        let driven = outputs.drive != Drive::Release;
        if driven && now.is_some() && outputs.state != State::Retreating {
            return Err(format!("driven in {now:?}"));
        }
        let force_n = self.rig.force_n();
        self.allowed_n = self.allowed_n.min(force_n.max(self.limit_n));
        if force_n > GAIN_ERROR * self.allowed_n + OVERSHOOT_N {
            return Err(format!("{force_n} N at a limit of {} N", self.allowed_n));
        }
        for note in &outputs.notes {
            match note {
                Note::Event(Event { kind: EventKind::StepStarted { index: 0 }, .. }) => self.starts += 1,
                Note::Event(Event { kind: EventKind::ProgramEnded { outcome }, .. }) => {
                    self.completed = *outcome == Outcome::Completed;
                }
                Note::Connected(token) => (self.connection, self.next_id) = (*token, 0),
                _ => {}
            }
        }
        if self.starts > self.runs {
            return Err(format!("{} programs began of {} that were asked for", self.starts, self.runs));
        }
        self.released = if driven { 0 } else { self.released + 1 };
        let most_um = self.rig.position_um.iter().map(|um| um.abs()).fold(0.0, f32::max);
        let travel_um = self.record.travel_um as f32;
        if self.released > 100 && self.completed && !self.turned && most_um > travel_um + REST_UM {
            return Err(format!("rests at {most_um} um beyond a travel of {travel_um} um"));
        }
        if self.turned {
            let moved = self.rig.position_um.iter().zip(self.from_um).map(|(um, from)| (um - from).abs());
            let moved_um = moved.fold(0.0, f32::max);
            if moved_um > WRONG_WAY_MOST_UM {
                return Err(format!("moved {moved_um} um by tables of the wrong sign"));
            }
        }
        Ok(())
    }

    fn periods(&mut self, count: u32) -> Found {
        for _ in 0..count {
            // A host that is there.
            let asks = self.now_us.is_multiple_of(500_000);
            if asks { self.ask(Request::Status).map(drop)? } else { self.period(None).map(drop)? }
        }
        Ok(())
    }

    fn ask(&mut self, request: Request) -> Result<Result<(), Refusal>, String> {
        let command = Command { id: self.next_id, connection: self.connection, request };
        self.next_id += 1;
        self.sent.push(command);
        if matches!(request, Request::Run { .. }) {
            // Before its answer: it may start in the next period.
            self.runs += 1;
            self.from_um = self.rig.position_um;
        }
        let outputs = self.period(Some(command))?;
        let answer = outputs.notes.iter().find_map(|note| match *note {
            Note::Ack(id) if id == command.id => Some(Ok(())),
            Note::Refused(id, refusal) if id == command.id => Some(Err(refusal)),
            _ => None,
        });
        let answer = answer.ok_or_else(|| format!("no answer to {request:?}"))?;
        match (request, answer) {
            (Request::Run { .. }, Err(_)) => self.runs -= 1,
            (Request::Run { start_us, .. }, Ok(())) if start_us > self.now_us + protocol::START_LIMIT_US => {
                return Err(format!("a start at {start_us} us is taken at {} us", self.now_us));
            }
            (Request::Limits { force_mn, .. }, Ok(())) => {
                self.limit_n = force_mn as f32 * 1e-3;
                self.allowed_n = self.limit_n.max(self.rig.force_n());
            }
            _ => {}
        }
        if let Some(record) = outputs.store {
            self.restart(record)?;
        }
        Ok(answer)
    }

    /// The device starts again, with what the board has kept.
    fn restart(&mut self, record: CalibrationRecord) -> Found {
        let used = self.controller.budgets.each_ref().map(DutyBudget::used);
        let before = self.controller.interlock.latched();
        let carried = Carried::from_bytes(&self.controller.carried().to_bytes());
        self.boot_id += 1;
        let start = Start { carried, ..Start::ordinary(self.boot_id) };
        let calibration = Calibration::new(record.clone()).map_err(|_| "an unsound calibration was taken")?;
        let [first, .., last] = record.potentiometers[0].rising_um;
        self.turned = last < first;
        let limits = interlock::Limits::of(&calibration);
        (self.controller, self.connection) = connected(calibration, start);
        (self.record, self.next_id, self.from_um) = (record, 0, self.rig.position_um);
        self.limit_n = limits.force_mn as f32 * 1e-3;
        self.allowed_n = self.limit_n.max(self.rig.force_n());
        let after = self.controller.interlock.latched();
        let lost = before.is_some_and(|fault| fault != Fault::CalibrationLost) && after.is_none();
        let cooled = self.controller.budgets.each_ref().map(DutyBudget::used);
        if lost || cooled.iter().zip(used).any(|(now, before)| *now < before - 1e-3) {
            return Err(format!("a restart forgot {before:?} or the heat: {used:?} to {cooled:?}"));
        }
        self.latched = after;
        Ok(())
    }

    fn step_to(&mut self) -> Step {
        let travel_um = self.record.travel_um as i32;
        let reach_um = [400, 3_000, travel_um][self.random.below(3) as usize];
        let (x_um, y_um) =
            (self.random.between(-reach_um / 8, reach_um / 8), self.random.between(-reach_um, reach_um));
        let y_um = if self.random.below(4) == 0 { reach_um } else { y_um };
        match self.random.below(7) {
            0 => Step::Hold { duration_ms: 1 + self.random.below(200) },
            1 => Step::Tare { duration_ms: 50 + self.random.below(150) },
            2 | 3 => Step::Ramp { x_um, y_um, duration_ms: 1_000 + self.random.below(800) },
            _ => Step::Move { x_um, y_um, speed_um_s: 500 + self.random.below(9_500) },
        }
    }

    fn program(&mut self) -> Found {
        let count = 1 + self.random.below(3) as usize;
        let steps: Vec<Step> = (0..count).map(|_| self.step_to()).collect();
        self.run_steps(&steps)
    }

    fn run_steps(&mut self, steps: &[Step]) -> Found {
        for (index, step) in steps.iter().enumerate() {
            let _ = self.ask(Request::LoadStep { index: index as u8, step: *step })?;
        }
        self.completed = false;
        let start_us = match self.random.below(12) {
            0 => u64::MAX - u64::from(self.random.below(9)),
            1 => self.now_us + 50_000,
            _ => 0,
        };
        let _ = self.ask(Request::Run { steps: steps.len() as u8, crc: program_crc(steps), start_us })?;
        let wait = [50, 600, 3_000][self.random.below(3) as usize];
        self.periods(wait)
    }

    /// A little further each time, with a tare.
    fn creep(&mut self) -> Found {
        let mut y_um = self.rig.position_um[1] as i32;
        let by_um = if self.random.below(2) == 0 { 250 } else { -250 };
        for _ in 0..10 {
            y_um = (y_um + by_um).clamp(-9_000, 9_000);
            let steps = [
                Step::Move { x_um: 0, y_um, speed_um_s: 2_000 },
                Step::Hold { duration_ms: 60 },
                Step::Tare { duration_ms: 60 },
            ];
            self.run_steps(&steps)?;
            self.periods(600)?;
        }
        Ok(())
    }

    fn calibrate(&mut self) -> Found {
        let mut record = Calibration::nominal_record();
        let slip = 10_f64.powi(self.random.between(-3, 3));
        match self.random.below(4) {
            0 => {
                record.force_pn_per_code =
                    record.force_pn_per_code.map(|row| row.map(|pn| (f64::from(pn) * slip) as i32))
            }
            1 => {
                for table in &mut record.potentiometers {
                    (table.rising_um, table.falling_um) =
                        (table.rising_um.map(|um| -um), table.falling_um.map(|um| -um));
                }
            }
            2 => record.travel_um = [5_000, 10_000, 100_000][self.random.below(3) as usize],
            _ => {}
        }
        let mut buffer = [0; protocol::MAX_CALIBRATION];
        let bytes = record.encode(&mut buffer);
        for (piece, chunk) in (0..).zip(bytes.chunks(protocol::PIECE_BYTES)) {
            let mut bytes = [0; protocol::PIECE_BYTES];
            bytes[..chunk.len()].copy_from_slice(chunk);
            let _ = self.ask(Request::LoadCalibration { piece, bytes })?;
        }
        let _ = self.ask(Request::StoreCalibration { length: bytes.len() as u8, crc: record.crc() })?;
        Ok(())
    }

    /// Whatever is latched has a way out, under the load that caused it.
    fn leave(&mut self) -> Found {
        (self.rig.emergency_stop, self.rig.potentiometer_codes) = (false, None);
        let _ = self.ask(Request::Stop)?;
        self.periods(20)?;
        for _ in 0..40 {
            if self.controller.interlock.latched().is_none() || self.ask(Request::ClearFault)?.is_ok() {
                return Ok(());
            }
            if self.controller.budgets.iter().any(DutyBudget::is_locked) {
                // The way out is to wait, for which there is a test of its own.
                return Ok(());
            }
            let force = self.controller.force.absolute_counts();
            let axis = usize::from(force[1].abs() > force[0].abs());
            let mut by_um = [0; 2];
            by_um[axis] = if (force[axis] > 0) != self.turned { -1_000 } else { 1_000 };
            let _ = self.ask(Request::Retreat { x_um: by_um[0], y_um: by_um[1] })?;
            self.periods(2_500)?;
        }
        Err(format!("no way out of {:?} at {} N", self.controller.interlock.latched(), self.rig.force_n()))
    }

    fn old_frame(&mut self) -> Found {
        if self.sent.is_empty() {
            return Ok(());
        }
        let at = self.random.below(self.sent.len() as u32) as usize;
        let mut old = self.sent[at];
        let is_run = |command: &&Command| matches!(command.request, Request::Run { .. });
        if self.random.below(2) == 0
            && let Some(run) = self.sent.iter().rev().find(is_run)
        {
            // The latest program, when its answer is forgotten.
            old = *run;
            for _ in 0..commands::REMEMBERED {
                self.ask(Request::Status)?.map_err(|refusal| format!("a status is refused: {refusal:?}"))?;
            }
        }
        self.period(Some(old))?;
        self.periods(5)
    }

    fn command(&mut self) -> Found {
        match self.random.below(20) {
            0..9 => self.program(),
            9 => self.creep(),
            10 => self.calibrate(),
            11 => self.old_frame(),
            12 => {
                let force_mn = 300 + self.random.below(4_700);
                self.ask(Request::Limits { force_mn, silence_ms: 2_000 }).map(drop)
            }
            13 => {
                self.rig.emergency_stop = true;
                self.periods(5)?;
                self.old_frame()?;
                self.calibrate()
            }
            14 => {
                self.rig.potentiometer_codes = Some([2_048, 4_090]);
                self.periods(5)?;
                self.calibrate()
            }
            15 if self.turned => Ok(()),
            15 => {
                let y_um = self.random.between(-1_000, 1_000);
                self.ask(Request::Retreat { x_um: 0, y_um }).map(drop)
            }
            16 => self.period(Some(Command { id: 0, connection: 0, request: Request::Hello })).map(drop),
            17 => self.ask(Request::Stop).map(drop),
            _ => self.leave(),
        }
    }
}

fn run(seed: u64) -> Found {
    let mut campaign = Box::new(Campaign::new(seed));
    for command in 0..COMMANDS {
        campaign.command().map_err(|found| format!("seed {seed}, command {command}: {found}"))?;
    }
    campaign.leave().map_err(|found| format!("seed {seed}, at the end: {found}"))
}

fn seeds(otherwise: u64) -> u64 {
    std::env::var("NEEDLE_GUIDE_CAMPAIGN").ok().and_then(|seeds| seeds.parse().ok()).unwrap_or(otherwise)
}

#[test]
fn no_sequence_of_commands_gets_round_the_limits() {
    for seed in 1..=seeds(4) {
        run(seed).unwrap_or_else(|found| panic!("{found}"));
    }
}

#[test]
fn each_mend_that_is_taken_out_is_missed_by_the_campaign() {
    for mend in Mutation::ALL {
        let found = (1..=400).find_map(|seed| Mutation::without(Some(mend), || run(seed).err()));
        assert!(found.is_some(), "without {mend:?} nothing is found");
        std::println!("without {mend:?}: {}", found.unwrap_or_default());
    }
}
