//! From converter codes to micrometres and newtons: the constants of one rig, and the maps that use them.
//!
//! They come from the record that the host has stored on the device, or are those of the rig as designed. All arithmetic is in
//! `f32`, whose 24-bit mantissa holds every code of both converters exactly.

#![cfg_attr(
    not(test),
    deny(clippy::indexing_slicing, clippy::unwrap_used, clippy::expect_used, clippy::panic)
)]

use crate::control::round;
use protocol::{
    CODES_PER_KNOT, CalibrationId, CalibrationRecord, KNOTS, MAX_CALIBRATION, PotentiometerTable, Text,
    calibration_crc,
};

/// Value of one position count on the wire, nanometres.
pub const POSITION_NM_PER_COUNT: u32 = 1_000;
/// Value of one force count on the wire, nanonewtons: a hundredth of the noise of a good cell.
pub const FORCE_NN_PER_COUNT: u32 = 50_000;
/// Greatest code of the potentiometers' converter.
const CODE_MAX: u16 = 4_095;
/// Most that a rated range may be, millinewtons: beyond it force counts could leave 32 bits.
const FORCE_RANGE_LIMIT_MN: u32 = 100_000;

/// Constants of one rig, checked.
#[derive(Debug, Clone)]
pub struct Calibration {
    record: CalibrationRecord,
    /// Force counts (x; y) per converter code of channel 0 and 1.
    force_counts_per_code: [[f32; 2]; 2],
}

/// Why a record cannot be used.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum CalibrationError {
    /// The id is empty.
    Id,
    /// A table neither rises nor falls throughout, its two directions differ by more than 2 mm, or its track is not within the codes.
    Potentiometer {
        /// 0 for x, 1 for y.
        axis: u8,
    },
    /// The travel is zero, or a table does not reach it on both sides.
    Travel,
    /// The force matrix cannot be inverted, or its cross-talk exceeds its gains.
    ForceMatrix,
    /// The rated range is zero or beyond what is representable.
    ForceRange,
}

impl Calibration {
    /// The rig as designed: an L16 of 50 mm stroke on a 12-bit converter; a 5 N bridge of 2 mV/V at 3.0 V excitation on a
    /// converter with a full scale of 1.2 V / 128 for 2^23 codes.
    pub fn nominal_record() -> CalibrationRecord {
        const STROKE_UM: i32 = 50_000;
        /// 1.2 V / 128 / 2^23 per code, times 5 N per 6 mV.
        const PN_PER_CODE: i32 = 931_323;
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
    /// [`CalibrationError`] for constants that no rig has, so that nothing is driven by them.
    pub fn new(record: CalibrationRecord) -> Result<Self, CalibrationError> {
        if record.id.as_str().is_empty() {
            return Err(CalibrationError::Id);
        }
        for (axis, table) in (0..).zip(&record.potentiometers) {
            if !is_sound(table) {
                return Err(CalibrationError::Potentiometer { axis });
            }
        }
        if record.travel_um == 0
            || !record.potentiometers.iter().all(|table| reaches(table, record.travel_um))
        {
            return Err(CalibrationError::Travel);
        }
        let [[xx, xy], [yx, yy]] = record.force_pn_per_code.map(|row| row.map(i64::from));
        if xx.abs() <= xy.abs() || yy.abs() <= yx.abs() {
            return Err(CalibrationError::ForceMatrix);
        }
        if !(1..=FORCE_RANGE_LIMIT_MN).contains(&record.force_range_mn) {
            return Err(CalibrationError::ForceRange);
        }
        let counts = |pn: i32| pn as f32 * (1e-3 / FORCE_NN_PER_COUNT as f32);
        let force_counts_per_code = record.force_pn_per_code.map(|row| row.map(counts));
        Ok(Self { record, force_counts_per_code })
    }

    /// The record these come from.
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
        [interpolate(table_x, code_x, rising_x), interpolate(table_y, code_y, rising_y)]
    }

    /// A code that a sound potentiometer can give, for both axes.
    pub fn on_track(&self, codes: [u16; 2]) -> bool {
        let within = |(code, table): (u16, &PotentiometerTable)| {
            let [least, greatest] = table.track_codes;
            (least..=greatest).contains(&code)
        };
        codes.into_iter().zip(&self.record.potentiometers).all(within)
    }

    /// Guide 2 may be sent this far from zero along each axis, micrometres.
    pub fn travel_um(&self) -> u32 {
        self.record.travel_um
    }

    /// Force from the converter's own zero, in force counts.
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

/// Bytes of a record as it is kept: its length, its checksum, and the record, filled up to whole units of the flash.
pub const STORED_BYTES: usize = (HEAD_BYTES + MAX_CALIBRATION).next_multiple_of(8);
/// Marks a stored record, with its length in the last byte.
const STORED_MARK: [u8; 3] = *b"cal";
const HEAD_BYTES: usize = 8;

/// A record as it is kept.
pub fn to_stored(record: &CalibrationRecord) -> [u8; STORED_BYTES] {
    let mut buffer = [0; MAX_CALIBRATION];
    let bytes = record.encode(&mut buffer);
    let mut stored = [0xFF; STORED_BYTES];
    let (head, rest) = stored.split_at_mut(HEAD_BYTES);
    let [a, b, c] = STORED_MARK;
    let [d, e, f, g] = calibration_crc(bytes).to_le_bytes();
    head.copy_from_slice(&[a, b, c, bytes.len() as u8, d, e, f, g]);
    for (kept, byte) in rest.iter_mut().zip(bytes) {
        *kept = *byte;
    }
    stored
}

/// The record that is kept; nothing where none is, or one that is damaged.
pub fn from_stored(stored: &[u8; STORED_BYTES]) -> Option<CalibrationRecord> {
    let (&[a, b, c, length, d, e, f, g], rest) = stored.split_first_chunk::<HEAD_BYTES>()?;
    let bytes = rest.get(..usize::from(length))?;
    let sound = [a, b, c] == STORED_MARK && calibration_crc(bytes) == u32::from_le_bytes([d, e, f, g]);
    if sound { CalibrationRecord::decode(bytes) } else { None }
}

/// Force counts of so many millinewtons.
pub const fn counts_of_mn(force_mn: u32) -> i32 {
    (force_mn as u64 * 1_000_000 / FORCE_NN_PER_COUNT as u64) as i32
}

/// The table at a code, between its two directions.
fn interpolate(table: &PotentiometerTable, code: u16, rising: f32) -> f32 {
    let knot = usize::from(code / CODES_PER_KNOT).min(KNOTS - 2);
    let share = (f32::from(code) - (knot as u16 * CODES_PER_KNOT) as f32) / f32::from(CODES_PER_KNOT);
    let along = |positions_um: &[i16; KNOTS]| match positions_um.get(knot..) {
        Some(&[low, high, ..]) => f32::from(low) + share * (f32::from(high) - f32::from(low)),
        _ => 0.0,
    };
    let (up_um, down_um) = (along(&table.rising_um), along(&table.falling_um));
    down_um + rising * (up_um - down_um)
}

fn is_sound(table: &PotentiometerTable) -> bool {
    let [least, greatest] = table.track_codes;
    let rise = |positions_um: &[i16; KNOTS]| positions_um.is_sorted_by(|low, high| low < high);
    let fall = |positions_um: &[i16; KNOTS]| positions_um.is_sorted_by(|high, low| low < high);
    let both = [&table.rising_um, &table.falling_um];
    let monotonic = both.into_iter().all(rise) || both.into_iter().all(fall);
    // Play is a fraction of a millimetre; a table of another potentiometer in one direction is far more than this.
    let apart = table.rising_um.iter().zip(&table.falling_um).any(|(up, down)| up.abs_diff(*down) > 2_000);
    least < greatest && greatest <= CODE_MAX && monotonic && !apart
}

fn reaches(table: &PotentiometerTable, travel_um: u32) -> bool {
    let [least, greatest] = table.track_codes;
    let travel_um = travel_um as f32;
    [0.0, 1.0].into_iter().all(|rising| {
        let ends = [interpolate(table, least, rising), interpolate(table, greatest, rising)];
        ends.iter().any(|um| *um < -travel_um) && ends.iter().any(|um| *um > travel_um)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_nominal_rig_spans_its_ranges() {
        let rig = Calibration::default();
        assert_eq!(counts_of_mn(rig.force_range_mn()), 100_000);
        // 5 N is 6 mV, 64 % of the converter's 9.375 mV: room for a zero offset.
        let code = (0.64 * 8_388_608.0) as i32;
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
            force_pn_per_code: [[50_000_000, 5_000_000], [-10_000_000, 100_000_000]],
            ..Calibration::nominal_record()
        };
        assert_eq!(Calibration::new(record).unwrap().force_counts([100, 10]), [101, 0]);
    }

    #[test]
    fn what_is_kept_is_read_back_and_what_is_damaged_is_not() {
        let record = CalibrationRecord { id: Text::new("unit-7"), ..Calibration::nominal_record() };
        let stored = to_stored(&record);
        assert_eq!(from_stored(&stored), Some(record.clone()));
        assert_eq!(from_stored(&[0xFF; STORED_BYTES]), None);
        let length = record.encode(&mut [0; MAX_CALIBRATION]).len();
        for byte in 0..HEAD_BYTES + length {
            for bit in 0..8 {
                let mut damaged = stored;
                damaged[byte] ^= 1 << bit;
                assert_eq!(from_stored(&damaged), None, "bit {bit} of byte {byte}");
            }
        }
    }

    #[test]
    fn constants_that_no_rig_has_are_refused() {
        let refused = |change: &dyn Fn(&mut CalibrationRecord)| {
            let mut record = Calibration::nominal_record();
            change(&mut record);
            Calibration::new(record).err()
        };
        assert_eq!(refused(&|record| record.id = Text::new("")), Some(CalibrationError::Id));
        let potentiometer = |axis| Some(CalibrationError::Potentiometer { axis });
        assert_eq!(refused(&|record| record.potentiometers[1].rising_um[3] = 9_000), potentiometer(1));
        assert_eq!(refused(&|record| record.potentiometers[0].track_codes = [40, 5_000]), potentiometer(0));
        let apart = |record: &mut CalibrationRecord| {
            record.potentiometers[0].falling_um = record.potentiometers[0].falling_um.map(|um| um - 3_000)
        };
        assert_eq!(refused(&apart), potentiometer(0));
        assert_eq!(refused(&|record| record.travel_um = 24_900), Some(CalibrationError::Travel));
        assert_eq!(
            refused(&|record| record.force_pn_per_code = [[0; 2]; 2]),
            Some(CalibrationError::ForceMatrix)
        );
        assert_eq!(refused(&|record| record.force_range_mn = 0), Some(CalibrationError::ForceRange));
    }
}
