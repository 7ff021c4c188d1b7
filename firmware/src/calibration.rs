//! From converter codes to micrometres and newtons: the constants of one rig, and the maps that use them.
//!
//! All arithmetic is in `f32`, whose 24-bit mantissa holds every code of both converters exactly.

use crate::control::round;
use core::ops::RangeInclusive;

/// Value of one position count on the wire, nanometres.
pub const POSITION_NM_PER_COUNT: u32 = 1_000;
/// Value of one force count on the wire, nanonewtons: a hundredth of the noise of a good cell.
pub const FORCE_NN_PER_COUNT: u32 = 50_000;

/// Constants of one rig.
#[derive(Debug, Clone)]
pub struct Calibration {
    /// Potentiometer code of the straight needle, x and y.
    pub zero_codes: [f32; 2],
    /// Micrometres per potentiometer code, x and y.
    pub um_per_code: [f32; 2],
    /// Codes that a sound potentiometer can give; beyond it a wire is open or shorted.
    pub potentiometer_track: RangeInclusive<u16>,
    /// Guide 2 may be sent this far from zero along each axis, micrometres.
    pub travel_um: u32,
    /// Force counts (x; y) per converter code of channel 0 and 1: gains on the diagonal, cross-talk off it.
    pub force_counts_per_code: [[f32; 2]; 2],
    /// Rated range of the force sensor, millinewtons.
    pub force_range_mn: u32,
}

impl Calibration {
    /// The rig as designed: an L16 of 50 mm stroke on a 12-bit converter; a 5 N bridge of 2 mV/V at 3.0 V excitation on a
    /// converter with a full scale of 1.2 V / 128 for 2^23 codes.
    pub const fn nominal() -> Self {
        const UM_PER_CODE: f32 = 50_000.0 / 4_096.0;
        const FULL_SCALE_V: f32 = 1.2 / 128.0;
        const NEWTON_PER_VOLT: f32 = 5.0 / (2.0e-3 * 3.0);
        const NEWTON_PER_CODE: f32 = FULL_SCALE_V / 8_388_608.0 * NEWTON_PER_VOLT;
        const COUNTS_PER_CODE: f32 = NEWTON_PER_CODE * 1e9 / FORCE_NN_PER_COUNT as f32;
        Self {
            zero_codes: [2_048.0; 2],
            um_per_code: [UM_PER_CODE; 2],
            potentiometer_track: 40..=4_055,
            travel_um: 10_000,
            force_counts_per_code: [[COUNTS_PER_CODE, 0.0], [0.0, COUNTS_PER_CODE]],
            force_range_mn: 5_000,
        }
    }

    /// Position of guide 2 relative to the straight needle, micrometres.
    pub fn position_um(&self, codes: [u16; 2]) -> [f32; 2] {
        [0, 1].map(|axis| (f32::from(codes[axis]) - self.zero_codes[axis]) * self.um_per_code[axis])
    }

    /// Force from the converter's own zero, in force counts.
    pub fn force_counts(&self, codes: [i32; 2]) -> [i32; 2] {
        let codes = codes.map(|code| code as f32);
        self.force_counts_per_code.map(|row| round(row[0] * codes[0] + row[1] * codes[1]))
    }

    /// Rated range in force counts.
    pub const fn force_range_counts(&self) -> i32 {
        (self.force_range_mn as u64 * 1_000_000 / FORCE_NN_PER_COUNT as u64) as i32
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_nominal_rig_spans_its_ranges() {
        let rig = Calibration::nominal();
        assert_eq!(rig.force_range_counts(), 100_000);
        // 5 N is 6 mV, 64 % of the converter's 9.375 mV: room for a zero offset.
        let code = (0.64 * 8_388_608.0) as i32;
        let [x, y] = rig.force_counts([code, -code]);
        assert!((x - 100_000).abs() < 2 && (y + 100_000).abs() < 2, "{x} {y}");
        assert_eq!(rig.position_um([2_048, 2_049]), [0.0, 50_000.0 / 4_096.0]);
    }

    #[test]
    fn cross_talk_mixes_the_channels() {
        let rig = Calibration { force_counts_per_code: [[1.0, 0.1], [-0.2, 2.0]], ..Calibration::nominal() };
        assert_eq!(rig.force_counts([100, 10]), [101, 0]);
    }
}
