//! From converter codes to micrometres and newtons: the constants of one rig, and the maps that use them.
//!
//! The constants come from the record that the host has stored on the device, or are those of the rig as designed. All arithmetic is in
//! `f32`, whose 24-bit mantissa holds every code of both converters exactly.

#![cfg_attr(
    not(test),
    deny(clippy::indexing_slicing, clippy::unwrap_used, clippy::expect_used, clippy::panic)
)]

use crate::mutation::Mutation;
use crate::round;
pub use protocol::Implausible;
use protocol::{CalibrationId, CalibrationRecord, KNOTS, PotentiometerTable, Text};

/// Value of one position count on the wire, nanometres.
pub const POSITION_NM_PER_COUNT: u32 = 1_000;
/// Value of one force count on the wire, nanonewtons: a hundredth of the noise of a good cell.
pub const FORCE_NN_PER_COUNT: u32 = 50_000;

/// Constants of one rig, checked.
#[derive(Debug, Clone)]
pub struct Calibration {
    record: CalibrationRecord,
    /// Force counts (x; y) per converter code of channel 0 and 1.
    force_counts_per_code: [[f32; 2]; 2],
}

impl Calibration {
    /// The rig as designed: an L16 of 50 mm stroke on a 12-bit converter; a 5 N bridge of 2 mV/V at 2.5 V excitation on a
    /// converter with a full scale of 1.2 V / 128 for 2^23 codes.
    pub fn nominal_record() -> CalibrationRecord {
        const STROKE_UM: i32 = 50_000;
        /// A code is 1.2 V / 128 / 2^23, and 5 mV are 5 N.
        const PN_PER_CODE: i32 = 1_117_587;
        let mut position_um = [0; KNOTS];
        for (knot, um) in (0..).zip(&mut position_um) {
            *um = (STROKE_UM / (KNOTS as i32 - 1) * knot - STROKE_UM / 2) as i16;
        }
        let table =
            PotentiometerTable { track_codes: [40, 4_055], rising_um: position_um, falling_um: position_um };
        CalibrationRecord {
            id: Text::new("nominal"),
            potentiometers: [table; 2],
            travel_um: 10_000,
            force_pn_per_code: [[PN_PER_CODE, 0], [0, PN_PER_CODE]],
            force_range_mn: 5_000,
        }
    }

    /// The constants of a record.
    ///
    /// # Errors
    /// [`Implausible`] for constants that no rig has, so that nothing is driven by them.
    pub fn new(record: CalibrationRecord) -> Result<Self, Implausible> {
        match record.check() {
            Err(problem) if !Mutation::AnyCalibration.is_out() => return Err(problem),
            _ => {}
        }
        let force_counts_per_code =
            record.force_pn_per_code.map(|row| row.map(|pn| pn as f32 * (1e-3 / FORCE_NN_PER_COUNT as f32)));
        Ok(Self { record, force_counts_per_code })
    }

    /// The record from which these constants come.
    pub fn record(&self) -> &CalibrationRecord {
        &self.record
    }

    /// Name and checksum of the record.
    pub fn id(&self) -> CalibrationId {
        CalibrationId { id: self.record.id.clone(), crc: self.record.crc() }
    }

    /// Position of guide 2 relative to the straight needle, micrometres. `rising`: for each axis 1 after moving up, 0 after
    /// moving down, and between them while the play is taken up.
    pub fn position_um(&self, codes: [u16; 2], rising: [f32; 2]) -> [f32; 2] {
        let [table_x, table_y] = &self.record.potentiometers;
        let ([code_x, code_y], [rising_x, rising_y]) = (codes, rising);
        [table_x.position_um(code_x, rising_x), table_y.position_um(code_y, rising_y)]
    }

    /// Whether the codes lie on the tracks of the potentiometers, x and y.
    pub fn on_track(&self, codes: [u16; 2]) -> [bool; 2] {
        let ([code_x, code_y], [table_x, table_y]) = (codes, &self.record.potentiometers);
        [table_x.on_track(code_x), table_y.on_track(code_y)]
    }

    /// Largest distance of guide 2 from zero along each axis, micrometres.
    pub fn travel_um(&self) -> u32 {
        self.record.travel_um
    }

    /// Force from the calibration's zero, which is code 0 of the converter, in force counts.
    pub fn force_counts(&self, codes: [i32; 2]) -> [i32; 2] {
        let [c0, c1] = codes.map(|code| code as f32);
        self.force_counts_per_code.map(|[g0, g1]| round(g0 * c0 + g1 * c1))
    }

    /// Rated range of the force sensor, millinewtons.
    pub fn force_range_mn(&self) -> u32 {
        self.record.force_range_mn
    }
}

impl Default for Calibration {
    /// The rig as designed.
    fn default() -> Self {
        let record = Self::nominal_record();
        Self::new(record.clone()).unwrap_or(Self { record, force_counts_per_code: [[0.0; 2]; 2] })
    }
}

/// Force counts of a force in millinewtons.
pub const fn counts_of_mn(force_mn: u32) -> i32 {
    (force_mn as u64 * 1_000_000 / FORCE_NN_PER_COUNT as u64) as i32
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_nominal_rig_spans_its_ranges() {
        let rig = Calibration::default();
        assert_eq!(counts_of_mn(rig.force_range_mn()), 100_000);
        // 5 N is 5 mV of the converter's 9.375 mV: room for a zero offset.
        let code = (5.0 / 9.375 * 8_388_608.0) as i32;
        let [x, y] = rig.force_counts([code, -code]);
        assert!((x - 100_000).abs() < 2 && (y + 100_000).abs() < 2, "{x} {y}");
        for rising in [0.0, 1.0] {
            assert_eq!(rig.position_um([2_048, 2_049], [rising; 2]), [0.0, 50_000.0 / 4_096.0]);
        }
        assert!(Calibration::new(Calibration::nominal_record()).is_ok());
    }

    #[test]
    fn tables_are_piecewise_straight_and_differ_by_direction() {
        let mut record = Calibration::nominal_record();
        record.potentiometers[1].rising_um[5] += 300;
        for um in &mut record.potentiometers[1].falling_um {
            *um -= 40;
        }
        let rig = Calibration::new(record).unwrap();
        let y_um = |code, rising| rig.position_um([2_048, code], [0.5, rising])[1];
        assert_eq!(y_um(2_560, 1.0), 6_550.0);
        assert_eq!(y_um(2_560 - 256, 1.0), 3_275.0);
        assert_eq!(y_um(2_560, 0.0), 6_210.0);
        assert_eq!(y_um(2_560, 0.5), 6_380.0);
        assert_eq!(y_um(4_095, 0.0), 25_000.0 - 6_250.0 / 512.0 - 40.0);
    }

    #[test]
    fn a_potentiometer_may_be_wired_either_way() {
        let mut record = Calibration::nominal_record();
        let table = &mut record.potentiometers[0];
        table.rising_um = table.rising_um.map(|um| -um);
        table.falling_um = table.rising_um;
        let rig = Calibration::new(record).unwrap();
        assert_eq!(rig.position_um([2_560, 2_560], [0.5; 2]), [-6_250.0, 6_250.0]);
    }

    #[test]
    fn cross_talk_mixes_the_channels() {
        let record = CalibrationRecord {
            force_pn_per_code: [[50_000_000, 5_000_000], [-10_000_000, 50_000_000]],
            force_range_mn: 100_000,
            ..Calibration::nominal_record()
        };
        assert_eq!(Calibration::new(record).unwrap().force_counts([100, 20]), [102, 0]);
    }
}
