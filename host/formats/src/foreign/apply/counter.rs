//! Rows at one rate by a column that counts them, of which some were lost.

use super::super::raw::{RawColumn, RawTable};
use super::Part;

/// Numbers from which on counters of 8, 16 and 32 bit begin anew.
const WRAPS: [f64; 3] = [256.0, 65_536.0, 4_294_967_296.0];

/// Number of each row among all that were recorded: by a counter, else as they stand in the file.
pub(super) fn row_numbers(table: &RawTable, parts: &[Part], notes: &mut Vec<String>) -> Vec<f64> {
    let of_file: Vec<f64> = table.places.iter().map(|place| *place as f64).collect();
    let counters = table
        .columns
        .iter()
        .filter(|column| is_free(column, parts))
        .filter_map(|column| Some((column, counted(column)?)));
    // An index of the file counts the rows that are left; one with gaps is of those that were recorded.
    let longest = counters.max_by(|a, b| last(&a.1).total_cmp(&last(&b.1)));
    let Some((column, numbers)) = longest.filter(|(_, numbers)| last(numbers) > last(&of_file)) else {
        return of_file;
    };
    let gaps: Vec<(usize, f64)> = numbers
        .windows(2)
        .enumerate()
        .filter(|(_, pair)| pair[1] - pair[0] > 1.0)
        .map(|(at, pair)| (at + 1, pair[1] - pair[0] - 1.0))
        .collect();
    let lost: f64 = gaps.iter().map(|(_, count)| count).sum();
    let line = gaps.first().and_then(|(row, _)| table.lines.get(*row)).copied().unwrap_or_default();
    notes.push(format!(
        "{}: line {line}: \"{}\" counts the rows and leaves out {lost} in {} places, the first before this line: times are by its numbers",
        table.path.display(),
        column.header,
        gaps.len()
    ));
    numbers
}

/// Whether a column is taken for nothing.
fn is_free(column: &RawColumn, parts: &[Part]) -> bool {
    !parts.iter().any(|part| std::ptr::eq(part.column, column))
}

fn last(numbers: &[f64]) -> f64 {
    numbers.last().copied().unwrap_or(0.0)
}

/// The numbers of a counter from 0 on, in its usual step; none of another column.
///
/// A counter has whole numbers, most of them one step apart and all of them whole steps: a reading that never rests and always goes up by
/// the same does not exist.
fn counted(column: &RawColumn) -> Option<Vec<f64>> {
    let origin = column.origin as f64;
    let values: Vec<f64> = column.values.iter().map(|value| origin + value).collect();
    if column.is_stamp || values.iter().any(|value| value.fract() != 0.0) {
        return None;
    }
    let most = values.iter().copied().fold(0.0, f64::max);
    let wrap = WRAPS.into_iter().find(|wrap| most < *wrap).unwrap_or(0.0);
    let steps: Vec<f64> = values
        .windows(2)
        .map(|pair| if pair[1] < pair[0] { pair[1] + wrap - pair[0] } else { pair[1] - pair[0] })
        .collect();
    let mut sorted = steps.clone();
    sorted.sort_by(f64::total_cmp);
    let usual = sorted.get(sorted.len() / 2).copied().filter(|usual| *usual > 0.0)?;
    let usual_count = steps.iter().filter(|step| **step == usual).count();
    let are_whole = steps.iter().all(|step| *step > 0.0 && (step / usual).fract() == 0.0);
    (2 * usual_count > steps.len() && are_whole).then(|| {
        let mut number = 0.0;
        let later_numbers = steps.iter().map(|step| {
            number += step / usual;
            number
        });
        std::iter::once(0.0).chain(later_numbers).collect()
    })
}
