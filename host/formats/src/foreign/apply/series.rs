//! Readings over time, and what is wrong with them.
//!
//! No magnitude decides, but what the readings are elsewhere in the record, with the error probability [`CHANCE`]:
//!
//! * **Interruptions.** Losses of single readings, independent of each other, leave out `k` in succession with the chance `q^k` at each of `n`
//!   places; `q` is the share that is missing elsewhere (rule of succession). Where `n q^k` is below [`CHANCE`] the record was interrupted: the
//!   guide may have gone anywhere, and nothing is interpolated.

use super::super::TableError;
use super::super::align::{ALIKE, Clock, Correlation};
use super::super::cells::not_a_number;
use super::super::dropouts::CHANCE;
use super::super::raw::RawTable;
use super::Part;

/// Readings in the order of their times, all of which differ.
#[derive(Debug, Clone, PartialEq)]
pub(in super::super) struct Series {
    readings: Vec<(f64, f64)>,
    period_s: f64,
    /// Places of the readings behind which the record was interrupted, in their order.
    interruptions: Vec<usize>,
}

impl Series {
    /// The readings of a column, in SI. Those of one time are one.
    pub fn new(part: &Part, times_s: &[f64]) -> Result<Self, TableError> {
        let values = values(part)?;
        let finite_pairs = times_s
            .iter()
            .copied()
            .zip(values)
            .filter(|(time_s, value)| time_s.is_finite() && value.is_finite());
        Ok(Self::of(finite_pairs.collect()))
    }

    /// Series of readings whose times never step back.
    pub fn of(all: Vec<(f64, f64)>) -> Self {
        let readings: Vec<(f64, f64)> = all
            .chunk_by(|a, b| a.0 == b.0)
            .filter_map(|same| {
                let mean = same.iter().map(|(_, value)| value).sum::<f64>() / same.len() as f64;
                Some((same.first()?.0, mean))
            })
            .collect();
        let period_s = median(readings.windows(2).map(|pair| pair[1].0 - pair[0].0).collect());
        let interruptions = interruptions(&readings, period_s);
        Self { readings, period_s, interruptions }
    }

    pub fn readings(&self) -> impl Iterator<Item = (f64, f64)> + '_ {
        self.readings.iter().copied()
    }

    pub fn len(&self) -> usize {
        self.readings.len()
    }

    /// Time from one reading to the next, usually.
    pub fn period_s(&self) -> f64 {
        self.period_s
    }

    /// First and last time.
    pub fn span_s(&self) -> Option<[f64; 2]> {
        Some([self.readings.first()?.0, self.readings.last()?.0])
    }

    /// The same, later by this.
    pub fn shifted(self, by_s: f64) -> Self {
        self.on(&Clock::shift(by_s))
    }

    /// The readings of a stretch of time, its ends included.
    pub fn between(&self, start_s: f64, end_s: f64) -> &[(f64, f64)] {
        let [first, end] = [
            self.readings.partition_point(|(time_s, _)| *time_s < start_s),
            self.readings.partition_point(|(time_s, _)| *time_s <= end_s),
        ];
        self.readings.get(first..end).unwrap_or_default()
    }

    /// The same on another clock.
    pub fn on(mut self, clock: &Clock) -> Self {
        self.readings.iter_mut().for_each(|(time_s, _)| *time_s = clock.time_s(*time_s));
        self
    }

    /// The same behind a drive with play of this width: at rest until the play is crossed.
    pub fn behind_play(mut self, width: f64) -> Self {
        let mut follower = self.readings.first().map_or(0.0, |(_, value)| *value);
        for (_, value) in &mut self.readings {
            follower = follower.clamp(*value - 0.5 * width, *value + 0.5 * width);
            *value = follower;
        }
        self
    }

    /// The value at a time, linearly between readings; none outside of them and in gaps.
    pub fn at(&self, time_s: f64) -> Option<f64> {
        let next_index = self.readings.partition_point(|(reading_s, _)| *reading_s <= time_s);
        let (earlier_s, earlier_value) = *self.readings.get(next_index.checked_sub(1)?)?;
        let Some((later_s, later_value)) = self.readings.get(next_index).copied() else {
            return (time_s == earlier_s).then_some(earlier_value);
        };
        if earlier_s == time_s {
            return Some(earlier_value);
        }
        let is_interrupted = self.interruptions.binary_search(&(next_index - 1)).is_ok();
        let gap_s = later_s - earlier_s;
        (!is_interrupted)
            .then(|| earlier_value + (later_value - earlier_value) * (time_s - earlier_s) / gap_s)
    }
}

/// Places of readings behind which more are missing in succession than single losses explain.
fn interruptions(readings: &[(f64, f64)], period_s: f64) -> Vec<usize> {
    if period_s <= 0.0 {
        return Vec::new();
    }
    let missing: Vec<f64> =
        readings.windows(2).map(|pair| ((pair[1].0 - pair[0].0) / period_s).round() - 1.0).collect();
    let missing_in_all: f64 = missing.iter().map(|count| count.max(0.0)).sum();
    fn is_interruption(count: f64, missing_in_all: f64, gap_count: f64) -> bool {
        let elsewhere = missing_in_all - count;
        let ratio = (elsewhere + 1.0) / (elsewhere + gap_count + 2.0);
        count > 0.0 && gap_count * ratio.powf(count) < CHANCE
    }
    let gaps = missing.iter().enumerate();
    gaps.filter(|(_, count)| is_interruption(**count, missing_in_all, missing.len() as f64))
        .map(|(place, _)| place)
        .collect()
}

/// The middle one of these values; 0 of none.
pub(super) fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied().unwrap_or(0.0)
}

/// The values of a column in SI; NaN where there is none.
pub(super) fn values(part: &Part) -> Result<Vec<f64>, TableError> {
    let Part { table, column, unit, .. } = part;
    if let Some((line, text)) = &column.bad {
        return Err(bad(table, &column.header, *line, text));
    }
    let origin = column.origin as f64;
    Ok(column.values.iter().map(|value| (origin + value) * unit.to_si).collect())
}

/// A cell that is no number.
pub(super) fn bad(table: &RawTable, header: &str, line: usize, text: &str) -> TableError {
    let (remark, expected) = not_a_number(text);
    let shown: String = text.chars().take(40).collect();
    TableError::Cell {
        path: table.path.clone(),
        line,
        field: header.to_owned(),
        problem: format!("\"{shown}\" is not a number{remark}"),
        expected,
    }
}

/// Refuses columns of two files where one is expected.
pub(super) fn same_table(a: &Part, b: &Part) -> Result<(), TableError> {
    if std::ptr::eq(a.table, b.table) {
        return Ok(());
    }
    Err(TableError::Map {
        choice: b.target.name.to_owned(),
        problem: format!("in another file than {}", a.target.name),
        expected: "both in one file, row by row".to_owned(),
    })
}

/// Refuses what no run has: a wrong unit.
pub(super) fn check_range(name: &str, values: &[f64], most: f64) -> Result<(), TableError> {
    match values.iter().find(|value| value.abs() > most) {
        Some(value) => Err(TableError::Map {
            choice: name.to_owned(),
            problem: format!("{value:.6} in SI"),
            expected: format!(
                "at most {most} m or N: is the unit right? A number that stands for a missing reading is left empty"
            ),
        }),
        None => Ok(()),
    }
}

/// Remarks on a force that acts against the displacement: a line through both explains more than chance.
pub(super) fn check_sign(force_n: &[f64], moved_m: &[f64], notes: &mut Vec<String>) {
    let pairs: Vec<(f64, f64)> = moved_m.iter().copied().zip(force_n.iter().copied()).collect();
    if Correlation::of(&pairs).is_some_and(|line| line.slope < 0.0 && line.log_likelihood() > ALIKE) {
        notes.push(
            "the force falls where the displacement rises, as the force of the tissue on the guide does: a minus before its unit reverses its sign (--map '...=force_y_n:-N')"
                .to_owned(),
        );
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Numbers that look random, from -1 to 1.
    fn noise(at: usize) -> f64 {
        ((at * 7919 + 13) * 104_729 % 2003) as f64 / 1001.0 - 1.0
    }

    #[test]
    fn single_losses_are_bridged_and_interruptions_are_not() {
        fn at_10_hz(missing: &dyn Fn(usize) -> bool) -> Series {
            Series::of(
                (0..200).filter(|row| !missing(*row)).map(|row| (0.1 * row as f64, row as f64)).collect(),
            )
        }
        fn near(value: Option<f64>, expected: f64) -> bool {
            value.is_some_and(|value| (value - expected).abs() < 1e-9)
        }
        // One reading is lost, by itself or as every seventh is.
        assert!(near(at_10_hz(&|row| row == 100).at(10.02), 100.2));
        assert!(near(at_10_hz(&|row| row % 7 == 3).at(10.82), 108.2));
        // Two and more in succession where no other one is; ten where every seventh is.
        assert_eq!(at_10_hz(&|row| (100..102).contains(&row)).at(10.05), None);
        assert_eq!(at_10_hz(&|row| row % 7 == 3 || (100..110).contains(&row)).at(10.55), None);
        // Three where every second reading is lost are not unusual.
        assert!(near(at_10_hz(&|row| row % 5 == 1 || row % 5 == 3 || row == 102).at(10.22), 102.2));
    }

    #[test]
    fn a_force_that_falls_is_noted_and_noise_is_not() {
        fn noted(stiffness: f64, noise_n: f64) -> usize {
            let moved: Vec<f64> =
                (0..100).map(|row| 1.2e-3 * (0.05 * (row as f64 - 40.0)).clamp(0.0, 1.0)).collect();
            let force: Vec<f64> =
                moved.iter().enumerate().map(|(row, y_m)| stiffness * y_m + noise_n * noise(row)).collect();
            let mut notes = Vec::new();
            check_sign(&force, &moved, &mut notes);
            notes.len()
        }
        assert_eq!([noted(-1e3, 0.01), noted(-1e3, 0.5), noted(1e3, 0.01), noted(0.0, 0.1)], [1, 1, 0, 0]);
    }
}
