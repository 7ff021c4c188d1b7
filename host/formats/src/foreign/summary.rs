//! Rows at the end of a table that are no readings but statistics of the rows above them: a mean, a standard deviation, a total.
//!
//! They are known by their numbers, with or without a word beside them: every number of such a row is the same statistic of its column.
//! One of the columns is a clock or a counter, which readings go on with, or an empty line is above them: without either, the last
//! rows of a hold at zero would be a mean.

use super::RawColumn;
use crate::session::LEAST_HOLD;

/// Rows that a run has at least, those of one hold: fewer ones below an empty line are no second recording.
pub(super) const LEAST_RUN: usize = LEAST_HOLD;
/// Statistics of [`Sums`]. A summary has each of them once at most, so that it is no longer.
const STATISTICS: usize = 10;
/// Rounding of programs that add in double precision: `n` sums lose `n` half units of the last digit at most, 1.1e-16 of the sum each, and
/// no table here has more than ten million rows.
const ROUNDING: f64 = 1e-9;

/// Sums over the rows of a column so far.
#[derive(Debug, Clone, Copy)]
struct Sums {
    count: f64,
    mean: f64,
    /// Of squared differences from the mean (Welford).
    squares: f64,
    least: f64,
    most: f64,
}

impl Sums {
    const NONE: Self =
        Self { count: 0.0, mean: 0.0, squares: 0.0, least: f64::INFINITY, most: f64::NEG_INFINITY };

    fn add(&mut self, value: f64) {
        if !value.is_finite() {
            return;
        }
        self.count += 1.0;
        let difference = value - self.mean;
        self.mean += difference / self.count;
        self.squares += difference * (value - self.mean);
        self.least = self.least.min(value);
        self.most = self.most.max(value);
    }

    /// Statistics that a number of this column may be: from the column's origin, and whether they are counted from there.
    fn statistics(&self, origin: f64, median: Option<f64>) -> [(f64, bool); STATISTICS] {
        let Self { count, mean, squares, least, most } = *self;
        let variance = squares / (count - 1.0);
        let from_origin = [mean, least, most, median.unwrap_or(f64::NAN)].map(|value| (value, true));
        let total = count * (mean + origin);
        let absolute = [count, total, most - least, variance, variance.sqrt(), (squares / count).sqrt()];
        let [count, total, range, variance, sd, sd_of_all] = absolute.map(|value| (value, false));
        let [mean, least, most, median] = from_origin;
        [count, total, mean, median, least, most, range, variance, sd, sd_of_all]
    }
}

/// How many rows at the end are statistics of all rows above them; `kept` are the cells of the rows, `lines` where they are.
pub(super) fn rows_of_statistics(
    columns: &[RawColumn],
    kept: &[&[String]],
    lines: &[usize],
    has_decimal_comma: bool,
) -> usize {
    let start = kept.len().saturating_sub(STATISTICS).max(LEAST_RUN);
    let mut sums = vec![Sums::NONE; columns.len()];
    fn add(sums: &mut [Sums], columns: &[RawColumn], row: usize) {
        sums.iter_mut().zip(columns).for_each(|(sums, column)| sums.add(column.value(row)));
    }
    (0..start.min(kept.len())).for_each(|row| add(&mut sums, columns, row));
    for first in start..kept.len() {
        let is_apart =
            lines.get(first - 1).zip(lines.get(first)).is_some_and(|(above, line)| line - above > 1);
        let is = |row: usize, medians: Option<&[f64]>| {
            is_statistic(columns, kept, row, &sums, medians, has_decimal_comma)
        };
        if (first..kept.len()).any(|row| is(row, None))
            && (is_apart || columns.iter().any(|column| ascends(column, first)))
        {
            let medians: Vec<f64> =
                columns.iter().map(|column| median((0..first).map(|row| column.value(row)))).collect();
            if (first..kept.len()).all(|row| is(row, Some(&medians))) {
                return kept.len() - first;
            }
        }
        add(&mut sums, columns, first);
    }
    0
}

/// How many rows at the end stand below an empty line and do not go on from those above, as the results of a fit: fewer than a run has, whose
/// clock or counter steps back, or further than it ever does above. A reading that goes on there takes the longest of `n` steps with the
/// chance `1 / n`.
pub(super) fn rows_apart(columns: &[RawColumn], lines: &[usize]) -> usize {
    let Some(gap_index) = lines.windows(2).rposition(|pair| pair[1] - pair[0] > 1) else { return 0 };
    let (first, count) = (gap_index + 1, lines.len() - gap_index - 1);
    if first < LEAST_RUN || count >= LEAST_RUN {
        return 0;
    }
    let goes_on = columns.iter().filter(|column| ascends(column, first)).find_map(|column| {
        let earlier_values = column.values.get(..first)?;
        let longest = earlier_values.windows(2).map(|pair| pair[1] - pair[0]).fold(0.0, f64::max);
        let step = column.values.get(first)? - column.values.get(gap_index)?;
        Some((0.0..=longest).contains(&step))
    });
    if goes_on == Some(false) { count } else { 0 }
}

/// Whether a column is a clock or a counter in the rows before this one.
fn ascends(column: &RawColumn, end: usize) -> bool {
    let earlier_values = column.values.get(..end).unwrap_or_default();
    earlier_values.windows(2).all(|pair| pair[0] < pair[1] || column.is_stamp && pair[0] == pair[1])
}

/// A number of a row, from its column's origin.
struct Number {
    value: f64,
    /// Rounding of its digits.
    digit: f64,
    origin: f64,
    /// Statistics of the rows above.
    statistics: [(f64, bool); STATISTICS],
}

/// Whether all numbers of a row, two or more, are one statistic of their columns.
fn is_statistic(
    columns: &[RawColumn],
    kept: &[&[String]],
    row: usize,
    sums: &[Sums],
    medians: Option<&[f64]>,
    has_decimal_comma: bool,
) -> bool {
    let Some(cells) = kept.get(row) else { return false };
    let numbers: Vec<Number> = columns
        .iter()
        .zip(sums)
        .enumerate()
        .filter_map(|(at, (column, sums))| {
            let value = column.values.get(row).copied().filter(|value| value.is_finite())?;
            let digit = last_digit(cells.get(column.number - 1)?, has_decimal_comma);
            let origin = column.origin as f64;
            let median = medians.and_then(|medians| medians.get(at).copied());
            Some(Number { value, digit, origin, statistics: sums.statistics(origin, median) })
        })
        .collect();
    numbers.len() >= 2
        && (0..STATISTICS).any(|place| {
            numbers.iter().all(|number| {
                number.statistics.get(place).is_some_and(|(statistic, is_from_origin)| {
                    let value = if *is_from_origin { number.value } else { number.value + number.origin };
                    // Half a unit of the last digit: a whole one would make the next number of a counter its greatest.
                    (value - statistic).abs() <= 0.5 * number.digit + ROUNDING * statistic.abs()
                })
            })
        })
}

/// Value of the last digit of a number as it is written.
fn last_digit(cell: &str, has_decimal_comma: bool) -> f64 {
    let lower = cell.to_lowercase();
    let (digits, exponent) = lower.split_once('e').unwrap_or((&lower, "0"));
    let point = if has_decimal_comma { ',' } else { '.' };
    let decimals = digits.split_once(point).map_or(0, |(_, decimals)| decimals.trim().len());
    10f64.powi(exponent.trim().parse().unwrap_or(0) - i32::try_from(decimals).unwrap_or(i32::MAX))
}

fn median(values: impl Iterator<Item = f64>) -> f64 {
    let mut values: Vec<f64> = values.filter(|value| value.is_finite()).collect();
    values.sort_by(f64::total_cmp);
    let half = values.len() / 2;
    let upper = values.get(half).copied().unwrap_or(f64::NAN);
    let lower = values.get(half.wrapping_sub(1)).copied().unwrap_or(f64::NAN);
    if values.len().is_multiple_of(2) { 0.5 * (lower + upper) } else { upper }
}
