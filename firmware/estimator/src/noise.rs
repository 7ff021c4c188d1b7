//! The prefilter, which averages samples into rows, and the estimate of the samples' noise (theory, eq. 53).

use super::{Row, Sample, SampleError, Settings};
use nalgebra::{RealField, convert};

/// Standard deviations of a single sample: force, tip and base.
pub type StandardDeviations<T> = [T; 3];

/// The row under construction, and the noise estimate so far.
#[derive(Debug, Clone)]
pub struct Noise<T> {
    stated: StandardDeviations<T>,
    last: Option<Sample<T>>,
    /// Time, depth and base of the row before.
    before: Option<[T; 3]>,
    sum: [T; 5],
    count: T,
    /// Deepest so far.
    depth_m: T,
    start_s: T,
    start_depth_m: T,
    start_base_m: T,
    /// Whether the previous row had no motion.
    rested: bool,
    /// Second differences: how many, and their squares.
    pairs: T,
    squares: [T; 3],
    previous: Option<Sample<T>>,
}

/// Largest values that are accepted, in SI units.
const LARGEST: f64 = 1e6;

impl<T: RealField + Copy> Noise<T> {
    /// Stated deviations; 0 where there are none.
    pub fn new(stated: StandardDeviations<T>) -> Self {
        let zero = T::zero();
        Self {
            stated,
            last: None,
            before: None,
            sum: [zero; 5],
            count: zero,
            depth_m: zero,
            start_s: zero,
            start_depth_m: zero,
            start_base_m: zero,
            rested: false,
            pairs: zero,
            squares: [zero; 3],
            previous: None,
        }
    }

    /// Takes a sample, and returns the row that it completes, if any.
    pub fn take<const M: usize>(
        &mut self,
        sample: &Sample<T>,
        settings: &Settings<T, M>,
        reach_m: T,
    ) -> Result<Option<Row<T>>, SampleError> {
        let Sample { time_s, depth_m, base_m, force_n, tip_m } = *sample;
        let largest: T = convert(LARGEST);
        if ![depth_m, base_m, force_n, tip_m].into_iter().all(|value| value.abs() < largest)
            || !time_s.is_finite()
        {
            return Err(SampleError::NotANumber);
        }
        if self.last.is_some_and(|last| time_s <= last.time_s) {
            return Err(SampleError::TimeNotIncreasing);
        }
        if depth_m > reach_m {
            return Err(SampleError::TooDeep);
        }
        self.learn(sample);
        // A slight retraction of the needle does not change its path.
        self.depth_m = self.depth_m.max(depth_m);
        if self.count == T::zero() {
            (self.start_s, self.start_depth_m, self.start_base_m) = (time_s, self.depth_m, base_m);
        }
        for (sum, value) in self.sum.iter_mut().zip([time_s, self.depth_m, base_m, force_n, tip_m]) {
            *sum += value;
        }
        self.count += T::one();
        let deeper = self.depth_m - self.start_depth_m >= settings.row_m;
        let aside = (base_m - self.start_base_m).abs() >= settings.row_base_m;
        let long = time_s - self.start_s >= settings.row_s;
        if !(deeper || aside || long) {
            return Ok(None);
        }
        // A rest is informative once, when the damping fades; a long one must not fill the memory.
        let is_resting = !(deeper || aside);
        let drop = is_resting && self.rested;
        self.rested = is_resting;
        if drop {
            self.sum = [T::zero(); 5];
            self.count = T::zero();
            return Ok(None);
        }
        let [time_s, depth_m, base_m, force_n, tip_m] = self.sum.map(|sum| sum / self.count);
        let step_s = self.before.map_or(T::one(), |[before_s, ..]| time_s - before_s);
        let row = Row { step_s, depth_m, base_m, force_n, tip_m, samples: self.count };
        self.before = Some([time_s, depth_m, base_m]);
        self.sum = [T::zero(); 5];
        self.count = T::zero();
        Ok(Some(row))
    }

    /// Second differences: motion at constant speed cancels, and independent noise appears with six times its variance.
    fn learn(&mut self, sample: &Sample<T>) {
        if let (Some(last), Some(previous)) = (self.last, self.previous) {
            let second = |now: T, last: T, previous: T| now - last - last + previous;
            let force = second(sample.force_n, last.force_n, previous.force_n);
            let tip = second(sample.tip_m, last.tip_m, previous.tip_m);
            let bounded = |square: T, sum: T, pairs: T| {
                // A jump is clipped at nine times the mean square so far.
                let most = convert::<f64, T>(9.0) * sum / pairs.max(T::one());
                if pairs < convert(8.0) { square } else { square.min(most) }
            };
            let base = second(sample.base_m, last.base_m, previous.base_m);
            for (sum, second) in self.squares.iter_mut().zip([force, tip, base]) {
                *sum += bounded(second * second, *sum, self.pairs);
            }
            self.pairs += T::one();
        }
        self.previous = self.last;
        self.last = Some(*sample);
    }

    /// Standard deviations of a single sample, never below what sensors of this kind resolve.
    pub fn deviation(&self) -> StandardDeviations<T> {
        let six: T = convert(6.0);
        let floor: [T; 3] = [convert(1e-3), convert(5e-6), convert(1e-6)];
        let mut deviation = self.stated;
        for ((deviation, &square), floor) in deviation.iter_mut().zip(&self.squares).zip(floor) {
            if *deviation == T::zero() {
                *deviation = (square / (six * self.pairs.max(T::one()))).sqrt();
            }
            *deviation = deviation.max(floor);
        }
        deviation
    }
}
