//! The rear of a needle in one guide, whose rotation stiffness is not stated.

/// No rear is stiffer or softer than by this share.
const MIN_SHARE: f64 = 0.01;
/// Shares that are solved: from a clamp to next to a hinge.
pub(super) const REAR_SHARES: [f64; 2] = [0.0, 0.97];

/// Prior of a rear whose rotation stiffness k_r is not stated.
///
/// Its measure is the share of the needle's own stiffness k_n in the series of both, `s = k_n / (k_n + k_r)`: 0 in a clamp, 1 in a
/// hinge. With k_n about what the needle beyond the guide resists a rotation with, what the rear does is linear in it (a rank-one change
/// of a stiffness is a Moebius function of its compliance).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Rear {
    /// k_n.
    pub needle_n_m_per_rad: f64,
    /// Middle of the share.
    pub middle: f64,
    /// Its standard deviation.
    pub sd: f64,
    /// Planes in which it is not known: vertical, horizontal.
    pub unknown: [bool; 2],
}

impl Rear {
    /// k_r of a difference of the share from its middle.
    pub fn stiffness_n_m_per_rad(&self, difference: f64) -> f64 {
        let rear_fraction = (self.middle + difference).clamp(MIN_SHARE, 1.0 - MIN_SHARE);
        self.needle_n_m_per_rad * (1.0 / rear_fraction - 1.0)
    }

    /// Nearest difference that is solved.
    pub(super) fn clamped(&self, difference: f64) -> f64 {
        difference.clamp(REAR_SHARES[0] - self.middle, REAR_SHARES[1] - self.middle)
    }
}
