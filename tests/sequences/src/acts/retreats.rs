//! Acts that try to add to a load by retreats.

use super::super::judge::is_turned;
use super::super::{Checked, Converter, Disturbances, Target};
use super::{Sequence, turn};
use control::calibration::Calibration;
use control::limits::FORCE_READINGS;
use protocol::{Request, Step};

impl<T: Target> Sequence<'_, T> {
    /// Into a load, and further into it by one retreat after the other: along one axis or both, after a tare elsewhere, with a limit that
    /// is lowered, each retreat to its end or stopped on its way, and with a converter that saturates.
    pub(super) fn creep_by_retreats(&mut self) -> Checked<()> {
        let y_um = if self.random.one_in(2) { 8_000 } else { -8_000 };
        let x_um = [0, 0, 8_000, -8_000][self.random.below(4) as usize];
        if self.random.one_in(2) {
            let retreat_um = -y_um / 16;
            self.run(&[
                Step::Move { x_um: 0, y_um: retreat_um, speed_um_s: 2_000 },
                Step::Hold { duration_ms: 60 },
                Step::Tare { duration_ms: 60 },
            ])?;
            self.target.pass(800)?;
        }
        self.run(&[Step::Move { x_um, y_um, speed_um_s: 4_000 }])?;
        self.target.pass(3_000)?;
        if self.random.one_in(2) {
            self.request(Request::Limits { force_mn: 300, silence_ms: 2_000 })?;
        }
        let (crosses, saturates) = (self.random.one_in(2), self.random.one_in(6));
        let (turns, wait_ms) = if self.random.one_in(4) { (60, 40) } else { (16, 900) };
        for turn in 0..turns {
            let sideways_um = if x_um < 0 { -300 } else { 300 };
            let x_um = if crosses && turn % 2 == 0 { sideways_um } else { 0 };
            let y_um = if x_um == 0 { y_um.signum() * 1_000 } else { 0 };
            self.request(Request::Retreat { x_um, y_um })?;
            if turn == 1 && saturates {
                self.target.pass(30)?;
                self.target
                    .set(Disturbances { converter: Converter::Saturated, ..Disturbances::default() })?;
            }
            self.target.pass(wait_ms)?;
            if turns > 16 {
                self.request(Request::Stop)?;
            }
        }
        Ok(())
    }

    /// Short retreats one after the other, each stopped once it moves, while the converter is saturated: mostly by tables of the wrong sign, which
    /// lead away from the middle.
    pub(super) fn retreat_blind(&mut self) -> Checked<()> {
        if self.random.below(4) > 0 {
            let mut record = Calibration::nominal_record();
            turn(&mut record);
            self.store(&record)?;
        }
        self.request(Request::AcknowledgeCalibration)?;
        self.target.set(Disturbances { converter: Converter::Saturated, ..Disturbances::default() })?;
        self.target.pass(FORCE_READINGS.into())?;
        let [x, y] = self.target.condition()?.position_um.map(f32::signum);
        let outward_um = if is_turned(self.target.record()) { 1_000.0 } else { -1_000.0 };
        let (x_um, y_um) = ((x * outward_um) as i32, (y * outward_um) as i32);
        let wait_ms = 100 + self.random.below(150);
        for _ in 0..16 {
            let retreat_um = if self.random.one_in(4) { (x_um, 0) } else { (0, y_um) };
            self.request(Request::Retreat { x_um: retreat_um.0, y_um: retreat_um.1 })?;
            self.target.pass(wait_ms)?;
            self.request(Request::Stop)?;
        }
        Ok(())
    }

    /// Fast into a load, and out of it before the motor is at rest; stopped on its way.
    pub(super) fn retreat_in_motion(&mut self) -> Checked<()> {
        let y_um = if self.random.one_in(2) { 9_000 } else { -9_000 };
        let x_um = [0, 0, y_um, -y_um][self.random.below(4) as usize];
        let speed_um_s = 5_000 + self.random.below(5_000);
        self.run(&[Step::Move { x_um, y_um, speed_um_s }])?;
        let tries = if self.target.is_patient() { 2_000 } else { 20 };
        let by_um = |um: i32| -um.signum() * 1_000;
        let request = match x_um != 0 && self.random.one_in(2) {
            true => Request::Retreat { x_um: by_um(x_um), y_um: 0 },
            false => Request::Retreat { x_um: 0, y_um: by_um(y_um) },
        };
        for _ in 0..tries {
            if self.target.request(request)?.is_ok() {
                break;
            }
        }
        let wait_ms = self.random.below(200);
        self.target.pass(wait_ms)?;
        self.request(Request::Stop)
    }
}
