//! From a lateral run's time series to its displacement holds.
//!
//! A run ramps guide 2 sideways, holds it, and comes back, with any number of holds on the way. [`holds`](fn@holds) finds the
//! holds, gives each its mean displacement and force with standard errors from its own scatter, and assigns the shape sweeps to them.

mod detection;
mod median;
mod motion;
mod spikes;
mod statistics;
mod sweeps;
mod unused;

pub use detection::{HoldCriteria, HoldSpan, find_holds, find_marked_holds, trimmed_s};
pub use median::{SD_OF_MEDIAN, median};
pub use motion::{reading_sd_m, reversal_m, reversal_of_means_m};
pub use statistics::{Mean, mean, means, scatter_and_systematic};
pub use unused::{BEYOND_TIP_M, UnusedPart, summary, unused, unused_of_session};

use formats::session::LateralRun;
use sweeps::UnassignedPoints;

/// Position of a level in the motion of guide 2.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Path {
    /// Guide 2 where it does not push: the reference for force.
    Zero,
    /// Further out than the hold before.
    Loading,
    /// Further in than the hold before.
    Unloading,
}

/// A displacement level: one hold of guide 2.
#[derive(Debug, Clone, PartialEq)]
pub struct Hold {
    /// First and last time of the hold.
    pub time_s: [f64; 2],
    /// Loading, unloading or zero.
    pub path: Path,
    /// Vertical displacement of guide 2.
    pub displacement_y_m: Mean,
    /// Vertical force.
    pub force_y_n: Mean,
    /// Horizontal displacement, where it was measured.
    pub displacement_x_m: Option<Mean>,
    /// Horizontal force, where it was measured.
    pub force_x_n: Option<Mean>,
    /// Samples lost inside the hold; where it is not 0 the hold is not fit for estimation.
    pub lost_samples: u64,
    /// Shape points measured during the hold, as indices into the run's shape series.
    pub shape: Vec<usize>,
}

impl Hold {
    /// Displacement in the plane of guide 2, `[y, x]`.
    pub fn displacement_m(&self) -> [f64; 2] {
        [self.displacement_y_m.value, self.displacement_x_m.map_or(0.0, |mean| mean.value)]
    }

    /// Distance of guide 2 from its zero.
    pub fn distance_m(&self) -> f64 {
        let [y, x] = self.displacement_m();
        y.hypot(x)
    }

    /// The time at which guide 2 was as it was for a shape point with this stamp: the stamp itself, but within the hold.
    pub fn observed_s(&self, stamp_s: f64) -> f64 {
        stamp_s.max(self.time_s[0]).min(self.time_s[1])
    }
}

/// The levels of a run, in order of time.
///
/// A shape point belongs to the hold that contains its time, or that begins or ends within three samples (at least 0.15 s)
/// of it while guide 2 stood; points at other times (ramps) belong to none and are listed by [`unused`]. Without
/// times the shape belongs to the last hold that is not at zero displacement.
pub fn holds(run: &LateralRun, criteria: &HoldCriteria) -> Vec<Hold> {
    survey(run, criteria).0
}

/// The levels, and the shape points that belong to none.
fn survey(run: &LateralRun, criteria: &HoldCriteria) -> (Vec<Hold>, Vec<UnassignedPoints>) {
    let force = &run.force;
    let mut planes = vec![force.displacement_y_m.as_slice()];
    planes.extend(force.displacement_x_m.as_deref());
    let holds = match &force.marks {
        Some(marks) => find_marked_holds(&force.time_s, &planes, marks, criteria),
        None => find_holds(&force.time_s, &planes, criteria),
    };
    let mut displacement_y_m = hold_means(&force.displacement_y_m, &holds);
    let mut force_y_n = hold_means(&force.force_y_n, &holds);
    let mut displacement_x_m = force.displacement_x_m.as_deref().map(|values| hold_means(values, &holds));
    let mut force_x_n = force.force_x_n.as_deref().map(|values| hold_means(values, &holds));
    let mut levels: Vec<Hold> = holds
        .iter()
        .filter_map(|hold| {
            // Rows lost before the first row of the hold were lost on the way to it.
            let interior = hold.rows.start + 1..hold.rows.end.max(hold.rows.start + 1);
            let lost = force.lost_before.as_deref().and_then(|lost| lost.get(interior)).unwrap_or_default();
            Some(Hold {
                time_s: hold.time_s,
                path: Path::Zero,
                displacement_y_m: displacement_y_m.next()?,
                force_y_n: force_y_n.next()?,
                displacement_x_m: displacement_x_m.as_mut().and_then(Iterator::next),
                force_x_n: force_x_n.as_mut().and_then(Iterator::next),
                lost_samples: lost.iter().sum::<f64>() as u64,
                shape: Vec::new(),
            })
        })
        .collect();
    name_paths(&mut levels, criteria);
    let strays = sweeps::assign(&mut levels, &run.shape, force, criteria);
    (levels, strays)
}

fn hold_means(values: &[f64], holds: &[HoldSpan]) -> std::vec::IntoIter<Mean> {
    let hold_values: Vec<&[f64]> =
        holds.iter().map(|hold| values.get(hold.rows.clone()).unwrap_or_default()).collect();
    means(&hold_values).into_iter()
}

/// Zero is what is close to zero in itself and beside the largest level, or too close to be distinguished from it; the rest is
/// loading or unloading.
fn name_paths(levels: &mut [Hold], criteria: &HoldCriteria) {
    let largest_m = levels.iter().map(Hold::distance_m).fold(0.0, f64::max);
    let zero_m = criteria.zero_m.min(0.1 * largest_m).max(criteria.still_m);
    let mut previous_level = [0.0; 2];
    for level in levels {
        let [y, x] = level.displacement_m();
        // Further out along the present direction: a reversal through zero is loading again.
        let projection = y * previous_level[0] + x * previous_level[1];
        level.path = if level.distance_m() <= zero_m {
            Path::Zero
        } else if projection <= 0.0 || level.distance_m() >= previous_level[0].hypot(previous_level[1]) {
            Path::Loading
        } else {
            Path::Unloading
        };
        previous_level = [y, x];
    }
}

#[cfg(test)]
mod tests;
