//! Acts of a sequence.

mod retreats;

use super::judge::{farthest, is_turned};
use super::random::Random;
use super::sensors::Failing;
use super::{Checked, Condition, Converter, Disturbances, MAX_ACTS, Target, Violation};
use control::calibration::Calibration;
use control::commands::MAX_STORED_ANSWERS;
use control::limits::FORCE_READINGS;
use protocol::{
    CalibrationRecord, Command, Fault, MAX_CALIBRATION, PIECE_BYTES, Refusal, Request, Step, program_crc,
};

/// Tries of the recovery from a fault: a travel of 25 mm in retreats of 1 mm, and some.
const TRIES: u32 = 40;
/// Longest retreat, micrometres.
const RETREAT_UM: f32 = protocol::RETREAT_LIMIT_UM as f32;
/// At the middle the needle presses with no more than this, newtons: what is left is the cell's offset or a tare.
const MIDDLE_N: f32 = 0.17;
/// Near it, micrometres: the same on 1.1 N/mm.
const MIDDLE_UM: f32 = 150.0;
/// A retreat that moves the guide by less has not helped, micrometres.
const STAYS_UM: f32 = 10.0;
/// Up to this [`Condition::zero_per_limit`] a limit is met at the middle: a retreat ends with 0.85 of it left, and cells have offsets.
const MET: f32 = 0.5;
/// Most time in which a motor cools, seconds: the window of its duty cycle and a bin.
const COOLING_LIMIT_S: u16 = 310;

/// A sequence at work on a target.
pub struct Sequence<'a, T> {
    random: Random,
    target: &'a mut T,
    faults_cleared: u64,
}

impl<'a, T: Target> Sequence<'a, T> {
    /// The sequence of these random numbers.
    pub fn new(random: Random, target: &'a mut T) -> Self {
        Self { random, target, faults_cleared: 0 }
    }

    /// Number of acts.
    pub fn length(&mut self) -> u32 {
        1 + self.random.below(MAX_ACTS)
    }

    /// Faults that were left.
    pub fn faults_cleared(&self) -> u64 {
        self.faults_cleared
    }

    /// One act.
    ///
    /// # Errors
    /// What does not hold.
    pub fn act(&mut self) -> Checked<()> {
        match self.random.below(33) {
            0..10 => self.program(),
            10 | 11 => self.creep_by_tares(),
            12 => self.creep_by_retreats(),
            13 | 14 => self.calibrate(),
            15 => self.old_frame(),
            16 | 17 => {
                let force_mn = 300 + self.random.below(4_700);
                self.request(Request::Limits { force_mn, silence_ms: 2_000 })
            }
            18 => {
                self.target.set(Disturbances { emergency_stop: true, ..Disturbances::default() })?;
                self.target.pass(5)?;
                self.old_frame()?;
                self.calibrate()
            }
            19 => {
                let axis = self.random.below(2) as usize;
                self.target
                    .set(Disturbances { potentiometer_open: Some(axis), ..Disturbances::default() })?;
                self.target.pass(5)?;
                self.calibrate()
            }
            20 | 21 => self.converter_fails(),
            22 => {
                let by_um = |random: &mut Random| random.between(-1_000, 1_000);
                let (x_um, y_um) = (by_um(&mut self.random), by_um(&mut self.random));
                self.request(Request::Retreat { x_um, y_um })?;
                let wait_ms = self.random.below(1_500);
                self.target.pass(wait_ms)
            }
            23 => self.target.replay(Command { id: 0, connection: 0, request: Request::Hello }),
            24 => self.interrupted(),
            25 => {
                self.program()?;
                let ms = 2_000 + self.random.below(500);
                self.target.silence(ms)
            }
            26 => self.target.reset(),
            27 => self.request(Request::AcknowledgeCalibration),
            29 => self.pulses(),
            30 => self.retreat_in_motion(),
            31 => self.sensors_fail(),
            32 => self.retreat_blind(),
            28 if self.target.is_patient() && self.random.one_in(40) => self.heat(),
            _ => self.leave(),
        }
    }

    fn request(&mut self, request: Request) -> Checked<()> {
        self.target.request(request).map(drop)
    }

    fn step(&mut self) -> Step {
        let travel_um = self.target.record().travel_um.min(40_000) as i32;
        let reach_um = [400, 3_000, travel_um][self.random.below(3) as usize];
        let (x_um, y_um) =
            (self.random.between(-reach_um / 8, reach_um / 8), self.random.between(-reach_um, reach_um));
        let y_um = if self.random.one_in(4) { reach_um } else { y_um };
        match self.random.below(7) {
            0 => Step::Hold { duration_ms: 1 + self.random.below(200) },
            1 => Step::Tare { duration_ms: 50 + self.random.below(150) },
            2 | 3 => Step::Ramp { x_um, y_um, duration_ms: 1_000 + self.random.below(800) },
            _ => Step::Move { x_um, y_um, speed_um_s: 500 + self.random.below(9_500) },
        }
    }

    /// A program of up to three steps, and a wait that may end before the program does.
    fn program(&mut self) -> Checked<()> {
        let count = 1 + self.random.below(3) as usize;
        let steps: Vec<Step> = (0..count).map(|_| self.step()).collect();
        self.run(&steps)?;
        let wait_ms = [50, 600, 3_000][self.random.below(3) as usize];
        self.target.pass(wait_ms)
    }

    fn run(&mut self, steps: &[Step]) -> Checked<()> {
        for (index, step) in (0..).zip(steps) {
            self.request(Request::LoadStep { index, step: *step })?;
        }
        let start_us = match self.random.below(12) {
            0 => u64::MAX - u64::from(self.random.below(9)),
            1 => self.target.condition()?.now_us + 50_000,
            _ => 0,
        };
        self.request(Request::Run { steps: steps.len() as u8, crc: program_crc(steps), start_us })
    }

    /// A fast motion is stopped anywhere, or ends in a fault that is cleared at once, and another one follows.
    fn interrupted(&mut self) -> Checked<()> {
        let step = self.step();
        self.run(&[step])?;
        let wait_ms = self.random.below(1_500);
        self.target.pass(wait_ms)?;
        if self.random.one_in(3) {
            self.target.set(Disturbances { emergency_stop: true, ..Disturbances::default() })?;
            self.target.pass(1)?;
            self.target.set(Disturbances::default())?;
            self.request(Request::ClearFault)?;
            self.target.pass(100)?;
        } else {
            self.request(Request::Stop)?;
        }
        self.program()
    }

    /// A little further each time, with a tare.
    fn creep_by_tares(&mut self) -> Checked<()> {
        let mut y_um = self.target.condition()?.position_um[1] as i32;
        let shift_um = if self.random.one_in(2) { 250 } else { -250 };
        for _ in 0..10 {
            y_um = (y_um + shift_um).clamp(-9_000, 9_000);
            self.run(&[
                Step::Move { x_um: 0, y_um, speed_um_s: 2_000 },
                Step::Hold { duration_ms: 60 },
                Step::Tare { duration_ms: 60 },
            ])?;
            self.target.pass(600)?;
        }
        Ok(())
    }

    /// Pulses of one motor, some beyond what a pulse may be.
    fn pulses(&mut self) -> Checked<()> {
        let axis = self.random.below(2) as u8;
        let sign = if self.random.one_in(2) { 1 } else { -1 };
        for _ in 0..=self.random.below(6) {
            let duty_permille = sign * [200, 350, 350, 700][self.random.below(4) as usize];
            let duration_ms = [20, 50, 50, 200][self.random.below(4) as usize];
            self.request(Request::Pulse { axis, duty_permille, duration_ms })?;
            let wait_ms = [30, 200, 200][self.random.below(3) as usize];
            self.target.pass(wait_ms)?;
        }
        Ok(())
    }

    /// Into the tissue while the force converter fails.
    fn converter_fails(&mut self) -> Checked<()> {
        self.program()?;
        let converter = [Converter::Silent, Converter::Saturated, Converter::SaturatedOnce]
            [self.random.below(3) as usize];
        self.target.set(Disturbances { converter, ..Disturbances::default() })?;
        let y_um = if self.random.one_in(2) { 9_000 } else { -9_000 };
        self.run(&[Step::Move { x_um: 0, y_um, speed_um_s: 5_000 }])?;
        self.target.pass(3_000)?;
        if self.random.one_in(2) { self.target.set(Disturbances::default()) } else { Ok(()) }
    }

    /// A motor that never rests, until it has to.
    fn heat(&mut self) -> Checked<()> {
        self.target.set(Disturbances::default())?;
        let steps: Vec<Step> = (0..60)
            .map(|step| Step::Ramp {
                x_um: 0,
                y_um: if step % 2 == 0 { 900 } else { -900 },
                duration_ms: 2_000,
            })
            .collect();
        self.run(&steps)?;
        self.target.pass(130_000)
    }

    /// Stores a calibration: that of the rig, one slipped by a unit, one that is off within what a rig can have, tables of the
    /// wrong sign, swapped channels, another travel.
    fn calibrate(&mut self) -> Checked<()> {
        let mut record = Calibration::nominal_record();
        let mut scale = |times: f64| {
            record.force_pn_per_code =
                record.force_pn_per_code.map(|row| row.map(|pn| (f64::from(pn) * times) as i32));
        };
        match self.random.below(7) {
            0 => scale(10_f64.powi([-3, -2, -1, 1, 2, 3][self.random.below(6) as usize])),
            1 => scale([0.7, 0.9, 1.2, 2.0][self.random.below(4) as usize]),
            2 => turn(&mut record),
            3 => record.travel_um = [5_000, 10_000, 100_000][self.random.below(3) as usize],
            4 => record.force_pn_per_code = record.force_pn_per_code.map(|[x, y]| [y, x]),
            5 => record.force_pn_per_code = record.force_pn_per_code.map(|row| row.map(|pn| -pn)),
            _ => {}
        }
        self.store(&record)
    }

    fn store(&mut self, record: &CalibrationRecord) -> Checked<()> {
        let mut buffer = [0; MAX_CALIBRATION];
        let bytes = record.encode(&mut buffer);
        for (piece, chunk) in (0..).zip(bytes.chunks(PIECE_BYTES)) {
            let mut bytes = [0; PIECE_BYTES];
            bytes[..chunk.len()].copy_from_slice(chunk);
            self.request(Request::LoadCalibration { piece, bytes })?;
        }
        self.request(Request::StoreCalibration { length: bytes.len() as u8, crc: record.crc() })
    }

    /// A frame that was sent before: any, or the latest program when its answer is no longer stored; with its own content or another.
    fn old_frame(&mut self) -> Checked<()> {
        let count = self.target.sent().len() as u32;
        if count == 0 {
            return Ok(());
        }
        let frame_index = self.random.below(count) as usize;
        let mut old = self.target.sent()[frame_index];
        let latest = self
            .target
            .sent()
            .iter()
            .rev()
            .find(|command| matches!(command.request, Request::Run { .. }))
            .copied();
        if self.random.one_in(2)
            && let Some(run) = latest
        {
            old = run;
            for _ in 0..MAX_STORED_ANSWERS {
                let answer = self.target.request(Request::Status)?;
                answer.map_err(|refusal| Violation(format!("a status is refused: {refusal:?}")))?;
            }
        }
        if self.random.one_in(6) {
            old.request = Request::AcknowledgeCalibration;
        }
        self.target.replay(old)?;
        self.target.pass(5)
    }

    /// Into the tissue, and on while a sensor fails in some of its readings, with hum beside it.
    fn sensors_fail(&mut self) -> Checked<()> {
        let failing = Failing::any(&mut self.random);
        let (force, potentiometers) = match self.random.below(3) {
            0 => (None, Some(failing)),
            _ => (Some(failing), None),
        };
        let hum_n = [0.0, 0.0, 0.1][self.random.below(3) as usize];
        let y_um = if self.random.one_in(2) { 9_000 } else { -9_000 };
        let x_um = [0, 0, 9_000][self.random.below(3) as usize];
        let speed_um_s = [1_000, 5_000, 10_000][self.random.below(3) as usize];
        self.run(&[Step::Move { x_um, y_um, speed_um_s }])?;
        let wait_ms = self.random.below(600);
        self.target.pass(wait_ms)?;
        self.target.set(Disturbances { force, potentiometers, hum_n, ..Disturbances::default() })?;
        self.target.pass(3_000)?;
        // A fault while it fails: nothing that can be requested may lead further into the load.
        self.request(Request::ClearFault)?;
        self.request(Request::Retreat { x_um: 0, y_um: -y_um.signum() * 500 })?;
        self.target.pass(500)?;
        if self.random.one_in(2) { self.target.set(Disturbances::default()) } else { Ok(()) }
    }

    /// Any latched fault has a recovery, under the load that caused it, by commands alone.
    ///
    /// # Errors
    /// Where there is none, and what does not hold.
    pub fn leave(&mut self) -> Checked<()> {
        self.target.set(Disturbances::default())?;
        self.request(Request::Stop)?;
        self.target.pass(FORCE_READINGS.into())?;
        let mut waited = false;
        let mut tried_from_um = [f32::INFINITY; 2];
        for _ in 0..TRIES {
            let condition = self.target.condition()?;
            let Some(fault) = condition.fault else { return Ok(()) };
            if fault == Fault::CalibrationLost {
                self.request(Request::AcknowledgeCalibration)?;
            }
            if self.target.request(Request::ClearFault)?.is_ok() {
                self.faults_cleared += 1;
                return Ok(());
            }
            let cools_in_s = condition.cools_in_s.into_iter().max().unwrap_or(0);
            if cools_in_s > 0 {
                if waited || cools_in_s > COOLING_LIMIT_S {
                    return Err(Violation(format!(
                        "a motor has not cooled in the time stated: {condition:?}"
                    )));
                }
                waited = true;
                self.target.pass((u32::from(cools_in_s) + 1) * 1_000)?;
                continue;
            }
            // One that was lost before another fault was latched.
            self.request(Request::AcknowledgeCalibration)?;
            self.unload(fault, &condition, tried_from_um)?;
            tried_from_um = condition.position_um;
        }
        let condition = self.target.condition()?;
        Err(Violation(format!("no recovery in {TRIES} tries: {condition:?}")))
    }

    /// Towards the middle of the travel. If the limit is not met there, a higher one; if the tables have the wrong
    /// sign, and the middle lies in the other direction, other ones, or a higher limit. `tried_from_um`: where the try before has begun.
    fn unload(&mut self, fault: Fault, condition: &Condition, tried_from_um: [f32; 2]) -> Checked<()> {
        let is_reversed = is_turned(self.target.record());
        if is_reversed && fault.may_come_of_calibration() {
            return self.store(&Calibration::nominal_record());
        }
        // A soft needle may be further off, where the offset of the cell along the other axis outweighs it.
        let stays = farthest(condition.position_um, tried_from_um) < STAYS_UM;
        let [x_um, y_um] = condition.position_um.map(|um| {
            let is_soft = um.abs() * condition.stiffness_n_per_um < MIDDLE_N;
            match um.abs() < MIDDLE_UM || (stays && is_soft) {
                true => 0,
                false => -um.clamp(-RETREAT_UM, RETREAT_UM) as i32,
            }
        });
        // The middle is a load from the zero of a tare that is far from it.
        if is_reversed || [x_um, y_um] == [0; 2] || condition.zero_per_limit() > MET {
            let force_mn = self.target.record().force_range_mn;
            self.request(Request::Stop)?;
            return self.request(Request::Limits { force_mn, silence_ms: 2_000 });
        }
        match self.target.request(Request::Retreat { x_um, y_um })? {
            // A millimetre at a quarter of one a second, from rest to rest.
            Ok(()) => self.target.pass(5_000),
            // Another cause to stop is there as well, or was until now.
            Err(Refusal::NotUnderLoad | Refusal::Busy) => self.target.pass(500),
            Err(refusal) => Err(Violation(format!("a retreat is refused: {refusal:?}"))),
        }
    }
}

/// Gives the tables the wrong sign.
fn turn(record: &mut CalibrationRecord) {
    for table in &mut record.potentiometers {
        (table.rising_um, table.falling_um) = (table.rising_um.map(|um| -um), table.falling_um.map(|um| -um));
    }
}
