//! Plausibility of a calibration. The device checks a record before it uses it, and the host before it sends it.
//!
//! The interlocks compare with newtons and micrometres, so that a wrong unit in the calibration would disable them. The bounds
//! are physical and exclude every error by a factor of ten:
//!
//! * A bridge gives 0.75 to 3.7 mV/V at its rated range. At 2.5 V of excitation and a full scale of 9.375 mV the converter's full
//!   scale is then 1 to 5 times the rated range ([`FULL_SCALE_TIMES`]).
//! * The cross-talk of a two-axis cell is a few percent of its gain; with at most a third ([`CROSS_TALK_SHARE`]) no load on
//!   the cell can hide from both axes.
//! * An actuator of 50 mm stroke over the 4096 codes makes 6.25 mm between two knots. The bounds ([`KNOT_STEP_UM`]) admit a
//!   trimmed potentiometer and actuators of neighbouring strokes.
//!
//! An error that no record reveals (a sign, swapped wires) is detected in the first tenths of a millimetre of motion:
//! [`crate::Fault::WrongWay`].

use crate::{CODES_PER_KNOT, CalibrationRecord, KNOTS, PotentiometerTable};

/// Smallest and largest force at the converter's full scale, as multiples of the rated range.
pub const FULL_SCALE_TIMES: [u64; 2] = [1, 5];
/// Divisor of the gain that gives the largest cross-talk.
pub const CROSS_TALK_SHARE: u64 = 3;
/// Smallest and largest change of the position from one knot to the next, micrometres.
pub const KNOT_STEP_UM: [u16; 2] = [2_500, 12_500];
/// Largest difference of the two directions of a table, micrometres. Play is a fraction of a millimetre; the tables of two
/// different potentiometers differ by far more than this bound.
pub const PLAY_LIMIT_UM: u16 = 2_000;
/// Largest rated range, millinewtons: with it sums of 100 readings at the converter's full scale fit 32 bits.
pub const FORCE_RANGE_LIMIT_MN: u32 = 100_000;
/// Greatest code of the potentiometers' converter.
pub const POTENTIOMETER_CODE_MAX: u16 = 4_095;
/// Codes of the force converter from zero to full scale.
const FORCE_CODES: u64 = 1 << 23;
/// Piconewtons in a millinewton.
const PN_PER_MN: u64 = 1_000_000_000;

/// Why no rig has the constants of a record. Axes are 0 for x and 1 for y.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum Implausible {
    /// The id is empty.
    #[error("the id is empty")]
    Id,
    /// The track is not within the codes.
    #[error(
        "track codes of axis {axis}: expected the least below the greatest, and that at most {POTENTIOMETER_CODE_MAX}"
    )]
    Track {
        /// Number of the axis.
        axis: u8,
    },
    /// A table neither rises nor falls throughout.
    #[error(
        "the position table of axis {axis} is not monotonic, expected one that rises, or falls, from code to code"
    )]
    Turns {
        /// Number of the axis.
        axis: u8,
    },
    /// The two directions of a table differ by more than play can.
    #[error("the rising and the falling table of axis {axis} are more than {} mm apart", f32::from(PLAY_LIMIT_UM) * 1e-3)]
    Play {
        /// Number of the axis.
        axis: u8,
    },
    /// The change of the position between two knots is one that no actuator has.
    #[error(
        "the position of axis {axis} changes by {step_um} um over {CODES_PER_KNOT} codes, expected {} to {} um: wrong unit?",
        KNOT_STEP_UM[0],
        KNOT_STEP_UM[1]
    )]
    Slope {
        /// Number of the axis.
        axis: u8,
        /// The first change that is out of bounds, micrometres.
        step_um: u16,
    },
    /// The travel is zero, or a table does not reach it on both sides.
    #[error("the travel of {travel_um} um is zero or beyond the position tables: wrong unit?")]
    Travel {
        /// The travel.
        travel_um: u32,
    },
    /// The rated range is zero or above [`FORCE_RANGE_LIMIT_MN`].
    #[error("the rated range is {range_mn} mN, expected 1 to {FORCE_RANGE_LIMIT_MN} mN")]
    ForceRange {
        /// The range.
        range_mn: u32,
    },
    /// The force at the converter's full scale does not fit the rated range.
    #[error(
        "the force along axis {axis} at the converter's full scale is {full_scale_mn} mN, expected {} to {} times the rated range \
         of {range_mn} mN: wrong unit, or swapped channels?",
        FULL_SCALE_TIMES[0],
        FULL_SCALE_TIMES[1]
    )]
    ForceGain {
        /// Number of the axis.
        axis: u8,
        /// Force at the converter's full scale, millinewtons.
        full_scale_mn: u64,
        /// The rated range, millinewtons.
        range_mn: u32,
    },
    /// The cross-talk is larger than any cell's.
    #[error("the cross-talk of axis {axis} is more than a third of its gain: swapped channels?")]
    CrossTalk {
        /// Number of the axis.
        axis: u8,
    },
}

impl CalibrationRecord {
    /// Checks that a rig can have these constants.
    ///
    /// # Errors
    /// [`Implausible`] for the first constant that no rig has.
    pub fn check(&self) -> Result<(), Implausible> {
        if self.id.as_str().is_empty() {
            return Err(Implausible::Id);
        }
        for (axis, table) in (0..).zip(&self.potentiometers) {
            table.check(axis)?;
        }
        let travel_um = self.travel_um;
        if travel_um == 0 || !self.potentiometers.iter().all(|table| table.reaches(travel_um)) {
            return Err(Implausible::Travel { travel_um });
        }
        let range_mn = self.force_range_mn;
        if !(1..=FORCE_RANGE_LIMIT_MN).contains(&range_mn) {
            return Err(Implausible::ForceRange { range_mn });
        }
        let [[xx, xy], [yx, yy]] =
            self.force_pn_per_code.map(|row| row.map(|pn| u64::from(pn.unsigned_abs())));
        for (axis, gain) in [(0, xx), (1, yy)] {
            let full_scale_mn = gain * FORCE_CODES / PN_PER_MN;
            let [least, most] = FULL_SCALE_TIMES.map(|times| times * u64::from(range_mn));
            if !(least..=most).contains(&full_scale_mn) {
                return Err(Implausible::ForceGain { axis, full_scale_mn, range_mn });
            }
        }
        for (axis, gain, other) in [(0, xx, xy), (1, yy, yx)] {
            if other * CROSS_TALK_SHARE > gain {
                return Err(Implausible::CrossTalk { axis });
            }
        }
        Ok(())
    }
}

impl PotentiometerTable {
    fn check(&self, axis: u8) -> Result<(), Implausible> {
        let [least, greatest] = self.track_codes;
        if least >= greatest || greatest > POTENTIOMETER_CODE_MAX {
            return Err(Implausible::Track { axis });
        }
        let direction_tables = [&self.rising_um, &self.falling_um];
        if !direction_tables.into_iter().all(|positions_um| positions_um.is_sorted_by(|low, high| low < high))
            && !direction_tables
                .into_iter()
                .all(|positions_um| positions_um.is_sorted_by(|high, low| low < high))
        {
            return Err(Implausible::Turns { axis });
        }
        if self.rising_um.iter().zip(&self.falling_um).any(|(up, down)| up.abs_diff(*down) > PLAY_LIMIT_UM) {
            return Err(Implausible::Play { axis });
        }
        let steps = direction_tables.into_iter().flat_map(|positions_um| {
            positions_um.iter().zip(positions_um.iter().skip(1)).map(|(from, to)| from.abs_diff(*to))
        });
        let [least, most] = KNOT_STEP_UM;
        match steps.into_iter().find(|step_um| !(least..=most).contains(step_um)) {
            Some(step_um) => Err(Implausible::Slope { axis, step_um }),
            None => Ok(()),
        }
    }

    /// The position at a code, micrometres. `rising`: 1 after moving up, 0 after moving down, and between them while the play is
    /// taken up.
    pub fn position_um(&self, code: u16, rising: f32) -> f32 {
        let knot = usize::from(code / CODES_PER_KNOT).min(KNOTS - 2);
        let fraction = (f32::from(code) - (knot as u16 * CODES_PER_KNOT) as f32) / f32::from(CODES_PER_KNOT);
        let along = |positions_um: &[i16; KNOTS]| match positions_um.get(knot..) {
            Some(&[low, high, ..]) => f32::from(low) + fraction * (f32::from(high) - f32::from(low)),
            _ => 0.0,
        };
        let (rising_um, falling_um) = (along(&self.rising_um), along(&self.falling_um));
        falling_um + rising * (rising_um - falling_um)
    }

    /// Whether a code lies on the track.
    pub fn on_track(&self, code: u16) -> bool {
        let [least, greatest] = self.track_codes;
        (least..=greatest).contains(&code)
    }

    fn reaches(&self, travel_um: u32) -> bool {
        let travel_um = travel_um as f32;
        [0.0, 1.0].into_iter().all(|rising| {
            let ends = self.track_codes.map(|code| self.position_um(code, rising));
            ends.iter().any(|um| *um < -travel_um) && ends.iter().any(|um| *um > travel_um)
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Text;
    use proptest::prelude::*;

    /// A rig as designed: an actuator of 50 mm on a converter of 12 bits, a cell of 5 N and 2 mV/V.
    fn designed() -> CalibrationRecord {
        let position_um = core::array::from_fn(|knot| (6_250 * knot as i32 - 25_000) as i16);
        let table =
            PotentiometerTable { track_codes: [40, 4_055], rising_um: position_um, falling_um: position_um };
        CalibrationRecord {
            id: Text::new("unit-7"),
            potentiometers: [table; 2],
            travel_um: 10_000,
            force_pn_per_code: [[1_117_587, 0], [0, 1_117_587]],
            force_range_mn: 5_000,
        }
    }

    fn refused(change: impl Fn(&mut CalibrationRecord)) -> Option<Implausible> {
        let mut record = designed();
        change(&mut record);
        record.check().err()
    }

    #[test]
    fn constants_that_no_rig_has_are_refused_and_the_reason_names_them() {
        assert_eq!(designed().check(), Ok(()));
        assert_eq!(refused(|record| record.id = Text::new("")), Some(Implausible::Id));
        assert_eq!(
            refused(|record| record.potentiometers[1].rising_um[3] = 9_000),
            Some(Implausible::Turns { axis: 1 })
        );
        assert_eq!(
            refused(|record| record.potentiometers[0].track_codes = [40, 5_000]),
            Some(Implausible::Track { axis: 0 })
        );
        assert_eq!(
            refused(|record: &mut CalibrationRecord| {
                record.potentiometers[0].falling_um =
                    record.potentiometers[0].falling_um.map(|um| um - 3_000);
            }),
            Some(Implausible::Play { axis: 0 })
        );
        assert_eq!(
            refused(|record| record.travel_um = 24_900),
            Some(Implausible::Travel { travel_um: 24_900 })
        );
        assert_eq!(
            refused(|record| record.force_pn_per_code = [[0; 2]; 2]),
            Some(Implausible::ForceGain { axis: 0, full_scale_mn: 0, range_mn: 5_000 })
        );
        assert_eq!(
            refused(|record| record.force_range_mn = 0),
            Some(Implausible::ForceRange { range_mn: 0 })
        );
        assert_eq!(
            refused(|record| record.force_pn_per_code[1][0] = 400_000),
            Some(Implausible::CrossTalk { axis: 1 })
        );
        assert!(matches!(
            refused(|record: &mut CalibrationRecord| record.force_pn_per_code.swap(0, 1)),
            Some(Implausible::ForceGain { axis: 0, .. })
        ));
    }

    /// A potentiometer or a force channel that is wired the other way has the opposite sign.
    #[test]
    fn either_polarity_is_plausible() {
        assert_eq!(
            refused(|record: &mut CalibrationRecord| {
                let table = &mut record.potentiometers[0];
                (table.rising_um, table.falling_um) =
                    (table.rising_um.map(|um| -um), table.falling_um.map(|um| -um));
                record.force_pn_per_code[1][1] *= -1;
            }),
            None
        );
    }

    proptest! {
        /// A unit that is wrong by a power of ten is refused, for any cell and actuator within the bounds.
        #[test]
        fn a_unit_wrong_by_ten_or_more_is_refused(
            millivolts_per_volt in 0.78_f64..3.6, range_mn in 500_u32..20_000, stroke_mm in 25.0_f64..65.0,
            power in 1_i32..4, up: bool,
        ) {
            let mut record = designed();
            // 9.375 mV of full scale at 2.5 V.
            let gain_pn = 9.375 / 2.5 / millivolts_per_volt * f64::from(range_mn) * 1e9 / FORCE_CODES as f64;
            record.force_pn_per_code = [[gain_pn as i32, 0], [0, -gain_pn as i32]];
            record.force_range_mn = range_mn;
            for table in &mut record.potentiometers {
                let um = |knot: usize| ((knot as f64 / 8.0 - 0.5) * stroke_mm * 1e3) as i16;
                (table.rising_um, table.falling_um) = (core::array::from_fn(um), core::array::from_fn(um));
            }
            prop_assert_eq!(record.check(), Ok(()));
            let slip = 10_f64.powi(if up { power } else { -power });
            let slipped = |value: i32| (f64::from(value) * slip) as i32;
            let mut gains = record.clone();
            gains.force_pn_per_code = gains.force_pn_per_code.map(|row| row.map(slipped));
            prop_assert!(gains.check().is_err());
            let mut range = record.clone();
            range.force_range_mn = (f64::from(range_mn) * slip) as u32;
            prop_assert!(range.check().is_err());
            let mut tables = record.clone();
            for table in &mut tables.potentiometers {
                table.rising_um = table.rising_um.map(|um| slipped(um.into()).clamp(-32_768, 32_767) as i16);
                table.falling_um = table.rising_um;
            }
            prop_assert!(tables.check().is_err());
        }
    }
}
