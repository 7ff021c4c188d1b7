//! Calibration of a rig from manual measurements: the force sensor's matrix from known loads, a potentiometer's table from a
//! gauge.
//!
//! Both start from the calibration that the device had while the readings were taken, and return the one that it should have.

mod force;
mod position;

pub use force::{ForceFit, ForceReading, fit_force};
pub use position::{GaugeReading, PositionFit, fit_position};

use protocol::Implausible;
use statrs::distribution::{ContinuousCDF, StudentsT};

/// Reason for which readings give no calibration.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum CalibrateError {
    /// Fewer readings than unknowns.
    #[error("{count} readings, expected {least} or more")]
    TooFew {
        /// Readings given.
        count: usize,
        /// Readings needed.
        least: usize,
    },
    /// One direction was hardly loaded.
    #[error(
        "loads vary by {along_n:.3} N in their main direction and by {across_n:.3} N across it: hang a weight so that it pulls across \
         the main direction, {main_deg:.0} degrees from x, too"
    )]
    OneDirection {
        /// Standard deviation of the loads in their main direction, newtons.
        along_n: f64,
        /// The same across it.
        across_n: f64,
        /// Angle of the main direction from x, degrees.
        main_deg: f64,
    },
    /// The reported forces do not follow the loads.
    #[error(
        "the reported forces do not follow the loads: their determinant is {determinant:.2e}, expected about 1"
    )]
    Unrelated {
        /// Determinant of reported over true forces.
        determinant: f64,
    },
    /// The gauge covers too little.
    #[error("positions from {from_mm:.3} to {to_mm:.3} mm, expected at least {least_mm} mm between them")]
    ShortRange {
        /// Least reported position, millimetres.
        from_mm: f64,
        /// Greatest.
        to_mm: f64,
        /// Distance needed.
        least_mm: f64,
    },
    /// The table would not be monotonic.
    #[error("the gauge falls where the reported position rises: is the gauge's sign that of the axis?")]
    Opposite,
    /// Constants that no rig has, which the device would reject.
    #[error("{0}")]
    Implausible(#[from] Implausible),
}

/// A value with its 95 % interval; none where there are as many unknowns as readings.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Estimate {
    /// The value.
    pub value: f64,
    /// Its 95 % interval by Student's t.
    pub ci95: Option<[f64; 2]>,
}

impl Estimate {
    /// From a standard deviation that was estimated with so many degrees of freedom.
    fn new(value: f64, sd: f64, freedom: usize) -> Self {
        let t = StudentsT::new(0.0, 1.0, freedom as f64).ok().filter(|_| freedom > 0);
        let half = t.map(|t| t.inverse_cdf(0.975) * sd);
        Self { value, ci95: half.map(|half| [value - half, value + half]) }
    }
}

/// The reading that fits worst.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct WorstReading {
    /// Its number, from 0.
    pub index: usize,
    /// Residual of the reading, newtons or metres.
    pub residual: f64,
}

#[cfg(test)]
mod tests;
