//! The estimator of the firmware on the host.

use super::method::{Method, Report};
use estimator::needle::Mode;
use estimator::{Estimate, Identifiability, Sample, Settings, Tracker, Value};
use mechanics::steering::modes::free_modes;
use mechanics::{Dynamics, ModelError, Needle};
use nalgebra::{RealField, convert};

/// Modes of the needle.
pub const MODES: usize = 5;
/// Cells of tissue.
pub const CELLS: usize = 60;
/// Five modes, 120 mm of tissue in cells of 2 mm, two segments with orders 5 and 1, 256 rows.
pub type OnlineTracker<T> = Tracker<T, MODES, CELLS, 18, 256>;

/// Settings for a needle.
///
/// # Errors
/// [`ModelError::OutOfRange`] for a needle that is none.
pub fn settings<T: RealField + Copy>(
    needle: &Needle,
    dynamics: &Dynamics,
) -> Result<Settings<T, MODES>, ModelError> {
    let modes = free_modes(&dynamics.clamped(needle), MODES)?;
    Ok(Settings::new(
        convert(dynamics.length_m),
        convert(dynamics.moving_mass_kg()),
        std::array::from_fn(|index: usize| {
            let mode = &modes[index];
            Mode {
                wave_number_per_m: convert(mode.wave_number_per_m),
                frequency_rad_s: convert(mode.frequency_rad_s),
                factors: mode.factors.map(convert),
            }
        }),
    ))
}

/// The estimator as one of several.
#[derive(Debug, Clone)]
pub struct OnlineEstimator<T: RealField> {
    tracker: OnlineTracker<T>,
}

impl<T: RealField + Copy> OnlineEstimator<T> {
    /// `None` if the settings' layout does not fit.
    pub fn new(settings: Settings<T, MODES>) -> Option<Self> {
        Some(Self { tracker: OnlineTracker::new(settings)? })
    }
}

impl<T: RealField + Copy + Into<f64>> Method for OnlineEstimator<T> {
    fn update(&mut self, sample: &Sample<f64>) -> Option<Report> {
        let Sample { time_s, depth_m, base_m, force_n, tip_m } = *sample;
        let sample = Sample {
            time_s: convert(time_s),
            depth_m: convert(depth_m),
            base_m: convert(base_m),
            force_n: convert(force_n),
            tip_m: convert(tip_m),
        };
        self.tracker.update(&sample).ok().flatten().map(report)
    }

    fn finish(&mut self) -> Option<Report> {
        self.tracker.finish().map(report)
    }
}

/// An estimate in double precision; a value that is not identified is none.
pub fn report<T: RealField + Copy + Into<f64>>(estimate: Estimate<T>) -> Report {
    Report {
        depth_m: estimate.depth_m.into(),
        stiffness: identified_value(estimate.stiffness),
        stiffness_ci95: interval(estimate.stiffness),
        damping: identified_value(estimate.damping),
        damping_ci95: interval(estimate.damping),
        tip_m: estimate.tip_m.into(),
    }
}

fn interval<T: RealField + Copy + Into<f64>>(value: Value<T>) -> Option<[f64; 2]> {
    Some([value.low.into(), value.high.into()])
}

fn identified_value<T: RealField + Copy + Into<f64>>(value: Value<T>) -> Option<f64> {
    (value.identifiability == Identifiability::Identified).then(|| value.value.into())
}
