//! Tracking through layers whose boundary is not known: the boundary is an unknown like any other.
//!
//! The estimator has two segments of depth, and its tissue may jump where they meet. While a run goes on three of them go through it,
//! each with its own place of the jump, and every value is their mixture: their weights are those of their deviations, and the
//! interval of a value has what they differ by in it. When the run has ended its rows are fitted again with a jump at every depth, and with
//! none ([`places`]), and the mixture of all of them is what is reported: tissue against depth, means, and the boundary with its interval.

use super::mixture::{mixed, weights};
use super::online::{MODES, OnlineTracker};
use super::places::{self, Layered};
use estimator::{Estimate, Sample, SampleError, Settings};
use rayon::prelude::*;

/// Boundaries that are followed while a run goes on, as shares of the depth.
const FOLLOWED: [f64; 3] = [0.25, 0.5, 0.75];

/// The estimators of a run with two layers at most.
#[derive(Debug, Clone)]
pub struct LayeredTracker {
    followed: Vec<OnlineTracker<f64>>,
}

impl LayeredTracker {
    /// For runs to `settings.reach_m`; `None` where the layout does not fit.
    pub fn new(settings: Settings<f64, MODES>) -> Option<Self> {
        Some(Self {
            followed: FOLLOWED
                .into_iter()
                .map(|share| OnlineTracker::new(Settings { segment_m: share * settings.reach_m, ..settings }))
                .collect::<Option<_>>()?,
        })
    }

    /// Takes a sample; as the estimator's own.
    ///
    /// # Errors
    /// [`SampleError`]; the sample is skipped and nothing else changes.
    pub fn update(&mut self, sample: &Sample<f64>) -> Result<Option<Estimate<f64>>, SampleError> {
        let mut followed_results = Vec::with_capacity(self.followed.len());
        for tracker in &mut self.followed {
            if let Some(estimate) = tracker.update(sample)? {
                followed_results.push((estimate, tracker.evidence()));
            }
        }
        let wide = followed_results.iter().map(|(_, evidence)| evidence.wide).fold(f64::INFINITY, f64::min);
        let logs: Vec<f64> =
            followed_results.iter().map(|(_, evidence)| -0.5 * evidence.squares / wide).collect();
        let estimates: Vec<Estimate<f64>> =
            followed_results.into_iter().map(|(estimate, _)| estimate).collect();
        Ok(mixed(&estimates, &weights(&logs)))
    }

    /// No more samples: the boundary and what is known beside it.
    pub fn finish(&mut self) -> Option<Layered> {
        let finished: Vec<Option<Estimate<f64>>> =
            self.followed.par_iter_mut().map(|tracker| tracker.finish()).collect();
        let reached = self.followed.iter().zip(finished);
        let reached = reached.filter_map(|(tracker, estimate)| Some((tracker, estimate?.depth_m)));
        let (best, reach_m) =
            reached.filter(|(_, depth_m)| *depth_m > 0.0).min_by(|a, b| cost(a).total_cmp(&cost(b)))?;
        places::posterior(best, reach_m)
    }
}

fn cost(of: &(&OnlineTracker<f64>, f64)) -> f64 {
    of.0.evidence().cost
}
