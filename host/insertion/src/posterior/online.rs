//! The posterior of an insertion that is under way.

use super::super::path::Bin;
use super::Posterior;

/// Follows a needle while it moves: readings come one by one, predictions are available at any time.
///
/// Readings at one depth are gathered to one bin, as they are in a recording.
#[derive(Debug, Clone)]
pub struct OnlinePosterior<'c> {
    /// Without the bin that readings still go to.
    settled: Posterior<'c>,
    /// With it.
    now: Posterior<'c>,
    /// Depth, vertical and horizontal tip position of each of its readings, m.
    open: Vec<[f64; 3]>,
}

impl<'c> OnlinePosterior<'c> {
    /// Follows an insertion.
    pub fn new(posterior: Posterior<'c>) -> Self {
        Self { settled: posterior.clone(), now: posterior, open: Vec::new() }
    }

    /// Takes in one reading: depth, vertical and horizontal tip position, m.
    pub fn push(&mut self, depth_m: f64, tip_m: [f64; 2]) {
        if self.open.first().is_some_and(|first| (first[0] - depth_m).abs() < 0.5e-3) {
            self.now.copy_from(&self.settled);
        } else {
            self.settled.copy_from(&self.now);
            self.open.clear();
        }
        self.open.push([depth_m, tip_m[0], tip_m[1]]);
        let mean_m = self.open_column(0).iter().sum::<f64>() / self.open.len() as f64;
        self.now.update(&Bin {
            depth_m: mean_m,
            tip_m: [
                readings::holds::median(self.open_column(1)),
                readings::holds::median(self.open_column(2)),
            ],
            direction_rad: [None; 2],
            rows: self.open.len() as f64,
            moving: false,
            leaving: false,
        });
    }

    fn open_column(&self, i: usize) -> Vec<f64> {
        self.open.iter().map(|reading| reading[i]).collect::<Vec<_>>()
    }

    /// Present posterior.
    pub fn posterior(&self) -> &Posterior<'c> {
        &self.now
    }
}
