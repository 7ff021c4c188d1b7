//! Scales of the unknowns of an insertion, and their values from standard normal numbers.

use super::basis::Measured;
use super::layout::{ANGLE, BENDS, DRIFT, DRIFTS, ENTRY, GAP, GUIDE2, LOAD, Layout, MODULUS, OFFSET};
use mechanics::unknowns::discrepancy::insertion as of_insertions;
use mechanics::unknowns::{Unknown, rig, sensors, tip, tissue};
use std::f64::consts::FRAC_PI_2;
use std::ops::Range;

/// Scales of the unknowns: standard deviations of what all insertions share, and of each insertion's own part.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Scales {
    /// Own offset of the tip sensor, m.
    pub offset_m: f64,
    /// Own angle of entry, rad.
    pub entry_angle_rad: f64,
    /// Own tip load, N.
    pub load_n: f64,
    /// Shared tip load, N: wide, in proportion to what the paths require, so that its size weighs no modulus against another.
    pub shared_load_n: f64,
    /// Shared and own process noise of the tip load about its mean, N.
    pub process_noise_n: [f64; 2],
    /// Depth over which the process noise is correlated, m.
    pub memory_m: f64,
    /// Own difference of the logarithm of the modulus.
    pub modulus_ln: f64,
    /// Own place of the tissue surface, m.
    pub entry_m: f64,
    /// Own slow drift of the tracker, m.
    pub drift_m: f64,
    /// Irregularity of the tip about a smooth path at single depths, m.
    pub irregularity_m: f64,
    /// More of it while the needle is on its way, m.
    pub moving_m: f64,
    /// Own tilt of the direction sensor on the needle, rad.
    pub tilt_rad: f64,
    /// Its slow change with depth, rad.
    pub bend_rad: f64,
    /// Irregularity of the tip's direction about a smooth course at single depths, rad.
    pub unsteady_rad: f64,
    /// Noise of one reading of the tip sensor, m; known beforehand.
    pub reading_m: f64,
    /// Noise of one reading of the tip's direction, rad; known beforehand.
    pub direction_rad: f64,
    /// Standard deviation of the prior of the rear's share; 0 where it is known.
    pub rear_share: f64,
}

/// Noise of one reading of the tip: standard deviations.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct ReadingNoise {
    /// Noise of its position, m.
    pub position_m: f64,
    /// Noise of its direction, rad.
    pub direction_rad: f64,
}

/// Prior of the scales.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Known {
    /// Noise of one reading of the tip.
    pub noise: ReadingNoise,
    /// Standard deviation of the prior of the rear's share.
    pub rear_share: f64,
    /// About how large the tip load is at a candidate, N.
    pub load_n: f64,
}

/// Scales that are found.
pub(super) const COUNT: usize = 14;
/// Assumed priors: weak, physical. Those of the tip load are shares of it.
const ASSUMED: [Unknown; COUNT] = [
    sensors::TIP_ZERO_OF_ONE,
    tip::ENTRY_ANGLE,
    of_insertions::LOAD_OF_ONE,
    of_insertions::LOAD_OVER_DEPTH,
    of_insertions::LOAD_OVER_DEPTH_OF_ONE,
    tip::LOAD_MEMORY,
    of_insertions::MODULUS_OF_ONE,
    of_insertions::SURFACE_OF_ONE,
    tip::DRIFT,
    tip::IRREGULARITY,
    tip::MOVING_IRREGULARITY,
    sensors::TILT_OF_ONE,
    of_insertions::DIRECTION_DRIFT_OF_ONE,
    tip::UNSTEADINESS,
];
/// Number of the one that matters only where a needle that rests was read on its way.
pub(super) const MOVING: usize = 10;
/// Numbers of those that matter only where the tip's direction is measured.
pub(super) const DIRECTION: Range<usize> = 11..14;
/// Loads below this are as large, N: where a tip takes hardly any, nothing is known to a share of it.
const MIN_LOAD_N: f64 = 0.02;
/// Steps of the logarithms of modulus and gap that a search may take at once, and the part of it that stands for one insertion.
const TRUST_LN: f64 = 0.3;
const SEARCHED_OWN_LN: f64 = 1e-3;

/// Standard deviations of one plane's unknowns before the process noise, and how those of their shared parts compare.
pub(super) struct Map {
    pub sds: Vec<f64>,
    pub ratios: Vec<f64>,
    /// Places of the process noise, whose own standard deviation is given by what follows.
    pub process_noise: Range<usize>,
    /// Stationary standard deviation of the process noise, and its correlation over a stretch between knots.
    pub process_noise_n: f64,
    pub correlation: f64,
}

impl Scales {
    /// From distances to the typical ones, in standard deviations, for tip loads of about `load_n`.
    pub(super) fn from_logarithms(x: &[f64], known: Known) -> Self {
        let Known { noise, rear_share, load_n } = known;
        let load_n = load_n.max(MIN_LOAD_N);
        Self {
            offset_m: scale_of(0, x),
            entry_angle_rad: scale_of(1, x),
            load_n: load_n * scale_of(2, x),
            shared_load_n: tip::SHARED_LOAD.sd() * load_n,
            process_noise_n: [load_n * scale_of(3, x), load_n * scale_of(4, x)],
            memory_m: scale_of(5, x),
            modulus_ln: scale_of(6, x),
            entry_m: scale_of(7, x),
            drift_m: scale_of(8, x),
            irregularity_m: scale_of(9, x).max(tip::IRREGULARITY.least()),
            moving_m: scale_of(MOVING, x),
            tilt_rad: scale_of(11, x),
            bend_rad: scale_of(12, x),
            unsteady_rad: scale_of(13, x).max(tip::UNSTEADINESS.least()),
            reading_m: noise.position_m,
            direction_rad: noise.direction_rad,
            rear_share,
        }
    }

    /// Variance of the median of so many readings at one depth, m^2 or rad^2.
    pub(super) fn variance(&self, measured: Measured, rows: f64, moving: bool) -> f64 {
        let [irregular, moving, reading] = match measured {
            Measured::Position => {
                [self.irregularity_m, if moving { self.moving_m } else { 0.0 }, self.reading_m]
            }
            Measured::Direction => [self.unsteady_rad, 0.0, self.direction_rad],
        };
        irregular.powi(2) + moving.powi(2) + reading.powi(2) * variance_of_median(rows)
    }

    /// Sizes of a plane's unknowns. `searching`: modulus and gap that all insertions share may step away from the candidate.
    pub(super) fn map(&self, layout: &Layout, searching: bool) -> Map {
        let length = layout.of_plane();
        let (mut sds, mut ratios) = (vec![0.0; length], vec![0.0; length]);
        ratios[layout.process_noise()].fill(self.process_noise_n[0] / self.process_noise_n[1]);
        let mut set = |i: usize, [shared, own]: [f64; 2]| {
            sds[i] = own;
            ratios[i] = if own > 0.0 { shared / own } else { 0.0 };
        };
        set(OFFSET, [sensors::SHARED_TIP_ZERO.sd(), self.offset_m]);
        set(ANGLE, [of_insertions::TILT_BY_HAND.sd(), self.entry_angle_rad]);
        set(GUIDE2, [rig::GUIDE2_ZERO, rig::GUIDE2_ZERO_OF_ONE].map(|guide2| guide2.sd()));
        set(MODULUS, [if searching { TRUST_LN } else { 0.0 }, self.modulus_ln]);
        set(ENTRY, [tissue::SURFACE.sd(), self.entry_m]);
        set(GAP, if searching { [TRUST_LN, SEARCHED_OWN_LN] } else { [0.0; 2] });
        for number in 0..DRIFTS {
            let component_m = self.drift_m / ((number + 1) as f64).sqrt();
            set(DRIFT + number, [tip::SHARED_DRIFT.sd() * component_m, component_m]);
        }
        set(LOAD, [self.shared_load_n, self.load_n]);
        if let Some(rear) = layout.rear() {
            set(rear, [self.rear_share, rig::REAR_SHARE_OF_ONE.sd()]);
        }
        if let Some(tilt) = layout.tilt() {
            set(tilt, [sensors::COIL_ANGLE.sd(), self.tilt_rad]);
            for number in 0..BENDS {
                let component_rad = self.bend_rad / ((number + 1) as f64).sqrt();
                set(tilt + 1 + number, [component_rad, component_rad]);
            }
        }
        let stretch_m = layout.knots_m.get(1).copied().unwrap_or(1.0);
        Map {
            sds,
            ratios,
            process_noise: layout.process_noise(),
            process_noise_n: self.process_noise_n[1],
            correlation: (-stretch_m / self.memory_m).exp(),
        }
    }

    /// Change of the load over a distance by shared and own process noise, N.
    pub fn process_noise_over_n(&self, distance_m: f64) -> [f64; 2] {
        let decorrelation = (2.0 * (1.0 - (-distance_m / self.memory_m).exp())).sqrt();
        self.process_noise_n.map(|process_noise_n| decorrelation * process_noise_n)
    }

    /// Standard deviation of the place of an insertion's surface, m.
    pub(super) fn shared_and_own_entry_m(&self) -> f64 {
        tissue::SURFACE.sd().hypot(self.entry_m)
    }

    /// Variance of a step of the search, of the logarithm.
    pub(super) fn trust_variance() -> f64 {
        TRUST_LN * TRUST_LN
    }
}

/// Scale from its standardized logarithm.
fn scale_of(i: usize, x: &[f64]) -> f64 {
    ASSUMED[i].mean() * (x[i] * ASSUMED[i].sd()).clamp(-9.0, 9.0).exp()
}

impl Map {
    /// Rows of a matrix of so many columns, from the unknowns' units of `length` per plane to standard normal numbers, transposed: `D^T S`.
    /// The process noise is stationary, with a memory that is exponential along the depth.
    #[inline(always)]
    pub fn pull_back_rows(&self, values: &mut [f64], columns: usize, length: usize) {
        let push = (1.0 - self.correlation * self.correlation).sqrt();
        let mut sums = vec![0.0; columns];
        for plane in values.chunks_exact_mut(length * columns) {
            sums.fill(0.0);
            let Range { start, end } = self.process_noise;
            for (place, (row, sd)) in plane.chunks_exact_mut(columns).zip(&self.sds).enumerate().rev() {
                if (start..end).contains(&place) {
                    let fresh = if place > start { push } else { 1.0 };
                    for (value, sum) in row.iter_mut().zip(&mut sums) {
                        *sum = *value + self.correlation * *sum;
                        *value = self.process_noise_n * *sum * fresh;
                    }
                } else {
                    row.iter_mut().for_each(|value| *value *= sd);
                }
            }
        }
    }

    /// From standard normal numbers to the unknowns: `D v`.
    pub fn push_forward(&self, values: &mut [f64], length: usize) {
        let push = (1.0 - self.correlation * self.correlation).sqrt();
        for plane in values.chunks_exact_mut(length) {
            let mut load = 0.0;
            for (knot, value) in plane[self.process_noise.clone()].iter_mut().enumerate() {
                let fresh = if knot > 0 { push * *value } else { *value };
                load = self.correlation * load + fresh;
                *value = self.process_noise_n * load;
            }
            self.scale(plane);
        }
    }

    /// The unknowns beside the process noise.
    fn scale(&self, plane: &mut [f64]) {
        let [leading, trailing] = [0..self.process_noise.start, self.process_noise.end..plane.len()];
        for (value, sd) in plane[leading.clone()].iter_mut().zip(&self.sds[leading]) {
            *value *= sd;
        }
        for (value, sd) in plane[trailing.clone()].iter_mut().zip(&self.sds[trailing]) {
            *value *= sd;
        }
    }

    /// Shared over own standard deviation of the unknown at a place of a vector.
    pub fn ratio(&self, place: usize, length: usize) -> f64 {
        self.ratios.get(place % length).copied().unwrap_or_default()
    }
}

/// Variance of the median of so many readings over that of one.
pub fn variance_of_median(readings: f64) -> f64 {
    if readings > 2.0 { FRAC_PI_2 / readings } else { 1.0 / readings }
}
