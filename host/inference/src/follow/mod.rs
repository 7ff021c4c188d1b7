//! Measurement against model while readings come: says since when they no longer follow (theory, eq. 86, 87 and 89).
//!
//! [`Follower`] compares the force of a lateral run with a model that was learned; [`Comparer`] takes differences that another
//! computation has made of readings, as the controller of a steered insertion does. Both state what they find as [`Parted`].

mod compared;
mod lateral;

pub use compared::{Comparer, ReadingDifference};
pub use lateral::{Discernible, FollowError, Follower};

use serde::Serialize;
use std::fmt::Display;

/// Length of a step, seconds.
pub const STEP_S: f64 = 0.1;
/// False alarms an hour in the mean, at most: one in six weeks of measuring.
pub const FALSE_ALARMS_PER_HOUR: f64 = 1e-3;
/// Largest excess over a usual value, in standard deviations.
const SURE_SD: f64 = 3.0;
/// Axes as programs and results name them, in the order of the device.
const AXES: [&str; 2] = ["x", "y"];

/// Force and displacement of guide 2 at a time.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GuideReading {
    /// Clock of the device, seconds.
    pub time_s: f64,
    /// Displacement along x and y, metres.
    pub displacement_m: [f64; 2],
    /// Force along x and y, newtons.
    pub force_n: [f64; 2],
    /// The force is that of the reading before, because none has come since.
    pub repeats_force: bool,
}

/// What no longer follows the model, with the mean of measured less modelled since then.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[serde(tag = "channel", rename_all = "snake_case")]
pub enum Difference {
    /// The force at guide 2.
    Force {
        /// Newtons.
        mean_n: f64,
    },
    /// The tip.
    Tip {
        /// Millimetres.
        mean_mm: f64,
    },
}

impl Difference {
    /// Whether another one is of the same channel.
    pub fn is_as(self, other: Self) -> bool {
        std::mem::discriminant(&self) == std::mem::discriminant(&other)
    }
}

/// A measurement no longer follows the model.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Parted {
    /// `x` or `y`.
    pub axis: &'static str,
    /// Time since when, seconds of the clock of the readings.
    pub since_s: f64,
    /// Time at which it was found.
    pub found_s: f64,
    /// Displacement of guide 2 when it began.
    pub displacement_mm: f64,
    /// Depth of the needle when it began, where it is pushed meanwhile.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub depth_mm: Option<f64>,
    /// The channel, with its mean difference.
    #[serde(flatten)]
    pub difference: Difference,
    /// Number of standard deviations beyond the model's possible error.
    pub sigma: f64,
}

impl Parted {
    /// In words, with the time at which it began.
    pub fn sentence(&self, since: impl Display) -> String {
        let at = match self.depth_mm {
            Some(depth_mm) => format!("at {depth_mm:.1} mm depth"),
            None => format!("at {:.2} mm", self.displacement_mm),
        };
        let (channel, mean) = match self.difference {
            Difference::Force { mean_n } => ("force", format!("{mean_n:+.3} N")),
            Difference::Tip { mean_mm } => ("tip", format!("{mean_mm:+.2} mm")),
        };
        format!(
            "the {channel} along {} no longer follows the model since {since}, {at}: {mean}, {:.0} sigma",
            self.axis,
            self.sigma.abs()
        )
    }
}

fn norm(sizes: &[f64]) -> f64 {
    sizes.iter().map(|size| size * size).sum::<f64>().sqrt()
}

#[cfg(test)]
mod tests;
