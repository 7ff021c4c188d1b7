//! Online estimator of the tissue's stiffness and damping while the needle goes in and its base moves sideways: no heap, any
//! precision, a bounded amount of work per sample. It runs in the firmware and on the host.
//!
//! The estimated parameters are properties of the tissue at its depth ([`field`]), not of the insertion: mean values
//! over the inserted part, which the spring-beam-damper paper estimates, follow from them. A prefilter averages force, base and
//! tip of the samples into rows of about a millimetre of insertion. For every row a simulation of the needle ([`simulation`])
//! predicts force and tip with their derivatives with respect to the parameters. They are two rows of least squares, which a
//! square-root information filter ([`information`]) takes in.
//!
//! The simulation is not linear in the parameters, so that rows from a time of wrong parameters would stay linearised there.
//! Therefore the whole insertion is replayed with the current parameters, one old row per sample. When the replay has reached
//! the newest row, it replaces the filter (Gauss-Newton, one step per replay, halved where it makes the fit worse). A start
//! that is wrong by a factor of a hundred is corrected within a few replays.
//!
//! # Example
//!
//! A needle goes 40 mm into tissue of 15 kN/m^2, and its base moves sideways; samples in, mean stiffness with its interval out:
//!
//! ```
//! use estimator::{Identifiability, Sample, Settings, Tracker, field::Layout};
//! # use estimator::{Row, field::Field, needle::{Mode, Shape}, simulation::Simulation};
//! # let mode = |a: f64, frequency_rad_s: f64, base: f64| {
//! #     let (sin, cos) = a.sin_cos();
//! #     let sine = (sin + cos) / (cos - sin + (-a).exp());
//! #     Mode { wave_number_per_m: a / 0.13, frequency_rad_s, factors: [base - 45.0 * sine, 45.0, 45.0, 45.0] }
//! # };
//! # let modes = [mode(1.8756, 424.6, -0.06), mode(4.6945, 2659.9, 0.03), mode(7.855, 7447.0, -0.02)];
//!
//! const LAYOUT: Layout = Layout { segments: 2, stiffness: 3, damping: 2 };
//! let noise = Settings { force_sd_n: 0.01, tip_sd_m: 1e-4, base_sd_m: 1e-5, ..Settings::new(0.13, 0.3, modes) };
//! let settings = Settings { layout: LAYOUT, segment_m: 0.02, ..noise };
//! # let samples = {
//! #     let shape = Shape::new(settings.modes, settings.length_m, settings.cell_m);
//! #     let mut field = Field::<f64, 24>::new(LAYOUT, settings.cell_m, settings.segment_m, settings.reach_m);
//! #     let ln = 15e3_f64.ln();
//! #     field.set(&[ln, 0.0, 0.0, ln, 0.0, 0.0, 0.3, 0.0, 0.3, 0.0, 0.0, 0.0], 24);
//! #     let mut simulation = Simulation::<f64, 3, 24, 12>::new(settings.cell_m, settings.length_m, 0.3, 0.0);
//! #     let mut sample = |i: u32| {
//! #         let depth_m = 0.1e-3 * f64::from(i);
//! #         let step_s = if i == 0 { 1.0 } else { 0.02 };
//! #         let row = Row { step_s, depth_m, base_m: 0.2 * depth_m, force_n: 0.0, tip_m: 0.0, samples: 1.0 };
//! #         let predicted = simulation.predict(&shape, &field, &row).expect("regular");
//! #         simulation.advance(&row, &predicted, 0.0);
//! #         let (force_n, tip_m) = (predicted.force_n, predicted.tip_m);
//! #         Sample { time_s: 0.02 * f64::from(i), depth_m, base_m: row.base_m, force_n, tip_m }
//! #     };
//! #     (0..400).map(|i| sample(i)).collect::<Vec<_>>()
//! # };
//! let mut tracker = Tracker::<f64, 3, 24, { LAYOUT.parameters() }, 64>::new(settings).expect("the layout fits");
//! for sample in &samples {
//!     tracker.update(sample).expect("a sample that goes on from the one before");
//! }
//! let stiffness = tracker.finish().expect("rows").stiffness;
//! assert_eq!(stiffness.identifiability, Identifiability::Identified);
//! assert!((stiffness.low..stiffness.high).contains(&15e3), "{stiffness:?}");
//! ```
#![cfg_attr(not(test), no_std)]
#![forbid(unsafe_code)]
#![deny(missing_docs)]

pub mod field;
pub mod information;
pub mod needle;
pub mod simulation;

mod filter;
mod noise;
mod replay;

use field::{Field, Layout};
use filter::Filter;
use heapless::Vec;
use nalgebra::{RealField, convert};
use needle::{Mode, Shape};
use noise::Noise;
use replay::Replay;

/// Measurement at one time.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sample<T> {
    /// Time.
    pub time_s: T,
    /// Insertion depth.
    pub depth_m: T,
    /// Lateral position of the base.
    pub base_m: T,
    /// Lateral force at the base.
    pub force_n: T,
    /// Lateral position of the tip.
    pub tip_m: T,
}

/// The mean of consecutive samples.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Row<T> {
    /// Time since the row before.
    pub step_s: T,
    /// Insertion depth, which never decreases.
    pub depth_m: T,
    /// Lateral position of the base.
    pub base_m: T,
    /// Lateral force at the base.
    pub force_n: T,
    /// Lateral position of the tip.
    pub tip_m: T,
    /// Number of samples.
    pub samples: T,
}

impl<T: RealField> Default for Row<T> {
    fn default() -> Self {
        let zero = T::zero;
        Self {
            step_s: zero(),
            depth_m: zero(),
            base_m: zero(),
            force_n: zero(),
            tip_m: zero(),
            samples: zero(),
        }
    }
}

/// Prior of needle, sensors and tissue before the first sample.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Settings<T, const M: usize> {
    /// Length of the needle from the fixture to the tip.
    pub length_m: T,
    /// Mass of needle and fixture.
    pub moving_mass_kg: T,
    /// The needle's first modes.
    pub modes: [Mode<T>; M],
    /// Segments and orders.
    pub layout: Layout,
    /// Length of a segment.
    pub segment_m: T,
    /// End of the last segment. If it is not beyond the segment's start, the segment has the length of the others.
    pub reach_m: T,
    /// Length of a cell of tissue.
    pub cell_m: T,
    /// Insertion after which a row ends.
    pub row_m: T,
    /// Lateral motion of the base after which a row ends.
    pub row_base_m: T,
    /// Time after which a row ends. Only the first of several rows without motion counts.
    pub row_s: T,
    /// Standard deviation of a single force; 0: estimated from the samples.
    pub force_sd_n: T,
    /// Standard deviation of a single tip position; 0: estimated from the samples.
    pub tip_sd_m: T,
    /// Standard deviation of a single position of the base; 0: estimated from the samples.
    pub base_sd_m: T,
    /// Variation within a segment: standard deviation of the first order of the logarithm of stiffness, and of the
    /// first order of damping in its units; order n has an n-th of it.
    pub variation: T,
    /// Standard deviation of the force sensor's offset.
    pub force_offset_sd_n: T,
    /// Standard deviation of the tip sensor's offset relative to the base.
    pub tip_offset_sd_m: T,
    /// Start of the search: stiffness, N/m^2, and damping, N s/m^2.
    pub start: [T; 2],
    /// Factor on the weight of the earlier rows at every new row; 1: no forgetting.
    pub forgetting: T,
    /// Fraction of the tip's innovation that corrects the simulated path, per metre of insertion.
    pub follow_per_m: T,
}

impl<T: RealField + Copy, const M: usize> Settings<T, M> {
    /// Two segments of 40 mm, stiffness of order 5, damping of order 1, cells of 2 mm, rows of 1 mm, and a wide prior of the
    /// tissue.
    pub fn new(length_m: T, moving_mass_kg: T, modes: [Mode<T>; M]) -> Self {
        Self {
            length_m,
            moving_mass_kg,
            modes,
            layout: Layout { segments: 2, stiffness: 6, damping: 2 },
            segment_m: convert(0.04),
            reach_m: T::zero(),
            cell_m: convert(2e-3),
            row_m: convert(1e-3),
            row_base_m: convert(0.5e-3),
            row_s: convert(1.0),
            force_sd_n: T::zero(),
            tip_sd_m: T::zero(),
            base_sd_m: T::zero(),
            variation: convert(0.5),
            force_offset_sd_n: convert(0.01),
            tip_offset_sd_m: convert(0.2e-3),
            start: [convert(1e4), convert(100.0)],
            forgetting: T::one(),
            follow_per_m: T::zero(),
        }
    }
}

/// Why a sample was rejected.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SampleError {
    /// A value is not finite, or outside what a rig can have.
    NotANumber,
    /// The time is not later than that of the sample before.
    TimeNotIncreasing,
    /// Deeper than the cells or the needle reach.
    TooDeep,
}

/// Whether the data so far determine a value.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Identifiability {
    /// Within its interval.
    Identified,
    /// Not above the interval's end.
    UpperBound,
    /// The motion so far does not determine it.
    NotIdentified,
}

/// A value with its 95 % interval.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Value<T> {
    /// Most probable value.
    pub value: T,
    /// Lower end.
    pub low: T,
    /// Upper end.
    pub high: T,
    /// Whether the data determine it.
    pub identifiability: Identifiability,
}

/// Estimate after a row.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Estimate<T> {
    /// Insertion depth.
    pub depth_m: T,
    /// Mean stiffness over the inserted part, N/m^2.
    pub stiffness: Value<T>,
    /// Mean damping over the inserted part, N s/m^2.
    pub damping: Value<T>,
    /// Correlation of stiffness and damping: near -1 or 1 only a combination of them is determined.
    pub correlation: T,
    /// Position of the simulated tip, before this row was used.
    pub tip_m: T,
    /// Position of the measured tip, without its offset.
    pub measured_tip_m: T,
    /// Simulated force, before this row was used.
    pub force_n: T,
    /// Measured force, without its offset.
    pub measured_force_n: T,
    /// Mean squared standardized residual of all rows: 1 where model and noise are right.
    pub misfit: T,
    /// Whether the information is from a converged replay, so that the intervals are valid.
    pub settled: bool,
}

/// Evidence of the rows for a layout of segments against another one, of the same rows and noise: logarithm of the evidence
/// `-cost / (2 wide) - occam`, by Laplace's method.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Evidence<T> {
    /// Sum of the squared standardized residuals of all rows.
    pub squares: T,
    /// Robust cost: the same sum with outliers down-weighted, plus the prior cost of the parameters.
    pub cost: T,
    /// Half the logarithm of the determinant of the information, less that of the prior.
    pub occam: T,
    /// Variance inflation relative to independent noise.
    pub wide: T,
}

/// The online estimator: `M` modes, `C` cells of tissue, `N` parameters, `H` rows of memory.
#[derive(Debug, Clone)]
pub struct Tracker<T: RealField, const M: usize, const C: usize, const N: usize, const H: usize> {
    settings: Settings<T, M>,
    shape: Shape<T, M>,
    noise: Noise<T>,
    rows: Vec<Row<T>, H>,
    live: Filter<T, M, C, N>,
    replay: Replay<T, M, C, N>,
}

impl<T: RealField + Copy, const M: usize, const C: usize, const N: usize, const H: usize>
    Tracker<T, M, C, N, H>
{
    /// Estimator before any measurement. `None` if the layout does not have `N` parameters or has
    /// too many per segment.
    pub fn new(settings: Settings<T, M>) -> Option<Self> {
        let layout = settings.layout;
        let most = field::MAX_COEFFICIENTS;
        let fits = layout.parameters() == N && layout.segments > 0 && (1..=most).contains(&layout.stiffness);
        if !fits || !(1..=most).contains(&layout.damping) {
            return None;
        }
        let live = Filter::new(&settings);
        Some(Self {
            shape: Shape::new(settings.modes, settings.length_m, settings.cell_m),
            noise: Noise::new([settings.force_sd_n, settings.tip_sd_m, settings.base_sd_m]),
            rows: Vec::new(),
            replay: Replay::new(&live),
            live,
            settings,
        })
    }

    /// Takes a sample. Returns an estimate where the sample before completed a row: the filter takes the row in with one sample
    /// and updates the parameters with the next, which bounds the work per sample.
    ///
    /// # Errors
    /// [`SampleError`]; the sample is skipped and nothing else changes.
    pub fn update(&mut self, sample: &Sample<T>) -> Result<Option<Estimate<T>>, SampleError> {
        let reach_m = (self.settings.cell_m * convert(C as f64)).min(self.settings.length_m);
        let row = self.noise.take(sample, &self.settings, reach_m)?;
        let estimate = self.live.conclude();
        match row {
            Some(row) => {
                let deviation = self.noise.deviation();
                self.live.take(&self.settings, &self.shape, &row, deviation);
                if self.rows.is_full() {
                    self.condense();
                }
                // Half the rows were merged, so that there is room.
                let _ = self.rows.push(row);
            }
            None if estimate.is_some() => {}
            None if self.rows.is_full() => self.condense(),
            None => self.replay_one(),
        }
        Ok(estimate)
    }

    /// The memory is full: every two rows become one, and new ones twice as long.
    fn condense(&mut self) {
        let (mut time_s, mut last_s) = (T::zero(), T::zero());
        let mut condensed = Vec::new();
        for pair in self.rows.chunks(2) {
            let samples = pair.iter().fold(T::zero(), |sum, row| sum + row.samples);
            let mut mean = Row { samples, ..Row::default() };
            for row in pair {
                let sample_weight = row.samples / samples;
                time_s += row.step_s;
                mean.step_s += sample_weight * time_s;
                mean.depth_m += sample_weight * row.depth_m;
                mean.base_m += sample_weight * row.base_m;
                mean.force_n += sample_weight * row.force_n;
                mean.tip_m += sample_weight * row.tip_m;
            }
            let mean_s = mean.step_s;
            mean.step_s -= last_s;
            last_s = mean_s;
            let _ = condensed.push(mean);
        }
        self.rows = condensed;
        let twice: T = convert(2.0);
        self.settings.row_m *= twice;
        self.settings.row_base_m *= twice;
        self.settings.row_s *= twice;
        self.replay.renew(&self.live);
    }

    /// Replays one row. A complete replay replaces the filter.
    fn replay_one(&mut self) {
        let deviation = self.noise.deviation();
        self.replay.step(&self.settings, &self.shape, &self.rows, deviation, &mut self.live);
    }

    /// Settings of the estimator.
    pub fn settings(&self) -> &Settings<T, M> {
        &self.settings
    }

    /// Tissue at each cell's depth: stiffness and damping.
    pub fn field(&self) -> &Field<T, C> {
        self.live.field()
    }

    /// Stiffness of one cell with its interval.
    pub fn stiffness_at(&self, cell: usize) -> Option<Value<T>> {
        (cell < C).then(|| self.live.stiffness_of(&[(cell, T::one())]))
    }

    /// The same rows with other segments, cells and variation. The parameters are still those of the prior; [`Tracker::finish`]
    /// estimates them.
    pub fn resegmented(&self, segment_m: T, cell_m: T, variation: T) -> Self {
        let settings = Settings { segment_m, cell_m, variation, ..self.settings };
        let mut live = Filter::new(&settings);
        live.start_from(&self.live);
        let replay = Replay::new(&live);
        let shape = Shape::new(settings.modes, settings.length_m, cell_m);
        Self { settings, shape, live, replay, ..self.clone() }
    }

    /// Evidence of the rows for these segments.
    pub fn evidence(&self) -> Evidence<T> {
        self.live.evidence()
    }

    /// Present estimate, without a new row.
    pub fn parameters(&self) -> &[T; N] {
        self.live.parameters()
    }

    /// Ends the stream: replays until the parameters converge, then returns the final estimate.
    pub fn finish(&mut self) -> Option<Estimate<T>> {
        let _ = self.live.conclude();
        let most = 40 * (self.rows.len() + 1);
        for _ in 0..most {
            if self.replay.is_settled() {
                break;
            }
            self.replay_one();
        }
        self.live.last()
    }
}

#[cfg(test)]
mod tests;
