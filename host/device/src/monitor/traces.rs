//! Series from which the plots are drawn: least and greatest value of every channel per short bin of time, for the last
//! two minutes.
//!
//! A spike of one sample stays visible at any scale because only extremes are kept and merged, never means.

use std::collections::VecDeque;

/// Number of channels that are plotted.
pub const CHANNELS: usize = 4;
/// Length of a bin, seconds: shorter than a dot of the shortest window is wide.
pub const BIN_S: f64 = 0.005;
/// Duration that is kept, seconds: the longest window.
pub const HISTORY_S: f64 = 120.0;
/// Bins that are kept at most.
pub const MAX_BINS: usize = (HISTORY_S / BIN_S) as usize;
/// Bins without a sample that make a gap; a slow device leaves single ones empty.
const GAP_BINS: i64 = 3;

/// One value of every channel.
pub type Values = [f64; CHANNELS];

/// Extremes of one channel over one column of a plot.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Column {
    /// Number of the column, from 0.
    pub place: usize,
    /// Least value.
    pub low: f64,
    /// Greatest value.
    pub high: f64,
}

#[derive(Debug, Clone, Copy)]
struct Bin {
    /// Time of its begin in bins.
    index: i64,
    low: Values,
    high: Values,
}

/// The last two minutes of every channel.
#[derive(Debug, Clone)]
pub struct Traces {
    bins: VecDeque<Bin>,
}

impl Default for Traces {
    /// None yet. All memory is taken and written to now: bins are missing where the port was unplugged, and a program that watches a rig
    /// for a day would else grow whenever such a gap leaves the last two minutes.
    fn default() -> Self {
        let unused = Bin { index: 0, low: [0.0; CHANNELS], high: [0.0; CHANNELS] };
        let mut bins = VecDeque::from(vec![unused; MAX_BINS + 1]);
        // `vec!` of zeros is memory that the system has not given yet.
        bins.iter_mut().for_each(|bin| bin.index = i64::MIN);
        bins.clear();
        Self { bins }
    }
}

impl Traces {
    /// Takes one sample. One that is older than the newest counts as of that one's time: nothing is lost, and time goes on.
    pub fn push(&mut self, time_s: f64, values: Values) {
        if !time_s.is_finite() {
            return;
        }
        let index = (time_s / BIN_S).floor() as i64;
        match self.bins.back_mut() {
            Some(last) if index <= last.index => {
                // `min` and `max` of two numbers skip what is no number.
                for (low, value) in last.low.iter_mut().zip(values) {
                    *low = low.min(value);
                }
                for (high, value) in last.high.iter_mut().zip(values) {
                    *high = high.max(value);
                }
            }
            _ => self.bins.push_back(Bin { index, low: values, high: values }),
        }
        let oldest = index.saturating_sub(MAX_BINS as i64);
        while self.bins.front().is_some_and(|bin| bin.index <= oldest) {
            self.bins.pop_front();
        }
    }

    /// Time of the newest sample, to the length of a bin.
    pub fn latest_s(&self) -> Option<f64> {
        self.bins.back().map(|bin| bin.index as f64 * BIN_S)
    }

    /// Bins that are held.
    pub fn len(&self) -> usize {
        self.bins.len()
    }

    /// Whether no value has been taken yet.
    pub fn is_empty(&self) -> bool {
        self.bins.is_empty()
    }

    /// Extremes of one channel in `columns` columns of the time from `from_s` to `to_s`, in order of time, in runs between which
    /// there were no samples.
    pub fn runs(&self, channel: usize, from_s: f64, to_s: f64, columns: usize) -> Vec<Vec<Column>> {
        let width_s = (to_s - from_s) / columns.max(1) as f64;
        if width_s.is_nan() || width_s <= 0.0 {
            return Vec::new();
        }
        let first = (from_s / BIN_S).floor() as i64;
        let start = self.bins.partition_point(|bin| bin.index < first);
        let mut runs: Vec<Vec<Column>> = Vec::new();
        let mut last: Option<(i64, usize)> = None;
        for bin in self.bins.range(start..) {
            let begin_s = bin.index as f64 * BIN_S;
            if begin_s > to_s {
                break;
            }
            let (Some(low), Some(high)) = (bin.low.get(channel), bin.high.get(channel)) else { break };
            if !(low.is_finite() && high.is_finite()) {
                continue;
            }
            let column_index = ((begin_s - from_s) / width_s).max(0.0) as usize;
            let clamped = column_index.min(columns.max(1) - 1);
            let joined = last.is_some_and(|(index, _)| bin.index.saturating_sub(index) <= GAP_BINS);
            let is_same = last.is_some_and(|(_, column)| column == clamped);
            match runs.last_mut() {
                Some(run) if joined => match run.last_mut() {
                    Some(column) if is_same => {
                        column.low = column.low.min(*low);
                        column.high = column.high.max(*high);
                    }
                    _ => run.push(Column { place: clamped, low: *low, high: *high }),
                },
                _ => runs.push(vec![Column { place: clamped, low: *low, high: *high }]),
            }
            last = Some((bin.index, clamped));
        }
        runs
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn extremes(runs: &[Vec<Column>]) -> (f64, f64) {
        runs.iter()
            .flatten()
            .fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), c| (l.min(c.low), h.max(c.high)))
    }

    #[test]
    fn a_spike_of_one_sample_is_visible_in_the_longest_window() {
        let mut traces = Traces::default();
        for i in 0..100_000 {
            let value = if i == 50_000 { 9.0 } else { 0.0 };
            traces.push(f64::from(i) * 1e-3, [value, 0.0, 0.0, -value]);
        }
        let runs = traces.runs(0, 0.0, 100.0, 60);
        assert_eq!(runs.len(), 1);
        let spikes: Vec<_> = runs[0].iter().filter(|column| column.high > 0.0).collect();
        assert_eq!(spikes.len(), 1);
        assert_eq!((spikes[0].low, spikes[0].high), (0.0, 9.0));
        assert_eq!(spikes[0].place, 30);
        assert_eq!(extremes(&traces.runs(3, 0.0, 100.0, 60)), (-9.0, 0.0));
    }

    #[test]
    fn time_without_samples_is_a_gap_however_coarse_the_columns() {
        let mut traces = Traces::default();
        for i in (0..1_000).chain(2_000..3_000) {
            traces.push(f64::from(i) * 1e-3, [1.0; CHANNELS]);
        }
        for columns in [3, 60, 600] {
            let runs = traces.runs(1, 0.0, 3.0, columns);
            assert_eq!(runs.len(), 2, "{columns} columns");
            assert!(runs[0].iter().all(|column| column.place <= columns / 2));
            assert!(runs[1].iter().all(|column| column.place >= columns / 2));
        }
    }

    #[test]
    fn a_device_of_a_hundred_samples_per_second_has_no_gaps() {
        let mut traces = Traces::default();
        for i in 0..200 {
            traces.push(f64::from(i) * 1e-2, [0.0; CHANNELS]);
        }
        assert_eq!(traces.runs(0, 0.0, 2.0, 1_000).len(), 1);
    }

    #[test]
    fn what_makes_no_sense_is_survived() {
        let mut traces = Traces::default();
        assert!(traces.runs(0, 0.0, 1.0, 10).is_empty());
        traces.push(f64::NAN, [0.0; CHANNELS]);
        assert!(traces.is_empty());
        traces.push(1e300, [f64::NAN; CHANNELS]);
        traces.push(0.0, [f64::INFINITY, 1.0, 2.0, 3.0]);
        for (from_s, to_s) in [(0.0, 0.0), (1.0, 0.0), (f64::NAN, 1.0), (0.0, f64::INFINITY)] {
            for columns in [0, 1, 10] {
                traces.runs(0, from_s, to_s, columns);
                assert!(traces.runs(99, from_s, to_s, columns).is_empty());
            }
        }
    }

    proptest! {
        #[test]
        fn extremes_are_never_lost_and_memory_is_bounded(
            steps in proptest::collection::vec((1u32..400_000, -1e3..1e3f64), 1..400),
            columns in 1usize..300,
        ) {
            let mut traces = Traces::default();
            let (mut time_us, mut points) = (0u64, Vec::new());
            for (step_us, value) in steps {
                time_us += u64::from(step_us);
                let time_s = time_us as f64 * 1e-6;
                traces.push(time_s, [value, -value, 0.0, 2.0 * value]);
                points.push((time_s, value));
                prop_assert!(traces.len() <= MAX_BINS);
            }
            let end_s = time_us as f64 * 1e-6;
            let start_s = (end_s - HISTORY_S + 2.0 * BIN_S).max(0.0);
            let runs = traces.runs(0, start_s, end_s, columns);
            let kept_points = points.iter().filter(|(time_s, _)| *time_s >= start_s);
            let (low, high) = kept_points.fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), (_, v)| (l.min(*v), h.max(*v)));
            let (least, greatest) = extremes(&runs);
            prop_assert!(least <= low && greatest >= high);
            // No value is added either.
            prop_assert!(points.iter().any(|(_, v)| *v == least) && points.iter().any(|(_, v)| *v == greatest));
            // In order of time, and at most one entry per column of a run.
            let places: Vec<usize> = runs.iter().flatten().map(|column| column.place).collect();
            prop_assert!(places.windows(2).all(|pair| pair[0] <= pair[1]) && places.iter().all(|place| *place < columns));
            prop_assert!(runs.iter().all(|run| run.windows(2).all(|pair| pair[0].place < pair[1].place)));
        }

        #[test]
        fn every_long_silence_is_a_gap(lengths in proptest::collection::vec((10u32..200, 30u32..2_000), 1..12)) {
            let (mut traces, mut t_ms) = (Traces::default(), 0u32);
            for (samples, silence_ms) in &lengths {
                for _ in 0..*samples {
                    traces.push(f64::from(t_ms) * 1e-3, [0.0; CHANNELS]);
                    t_ms += 1;
                }
                t_ms += silence_ms;
            }
            prop_assert_eq!(traces.runs(2, 0.0, f64::from(t_ms) * 1e-3, 100).len(), lengths.len());
        }

        #[test]
        fn memory_is_bounded_for_any_clock(
            times in proptest::collection::vec(prop_oneof![-1e12..1e12f64, 0.0..1e3f64, Just(f64::INFINITY)], 0..200),
        ) {
            let mut traces = Traces::default();
            for time_s in times {
                traces.push(time_s, [1.0; CHANNELS]);
                prop_assert!(traces.len() <= MAX_BINS);
                traces.runs(0, 0.0, 10.0, 100);
            }
        }
    }
}
