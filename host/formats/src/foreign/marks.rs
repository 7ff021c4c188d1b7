//! Numbers that stand for a reading that is missing: `-99.99`, `9999`, the ends of the range of an integer.

use super::RawColumn;
use super::dropouts::{Readings, leave_out, rounded};

/// Ends of the ranges of integers of 16 and 32 bit.
const ENDS: [f64; 6] = [32_767.0, 32_768.0, 65_535.0, 2_147_483_647.0, 2_147_483_648.0, 4_294_967_295.0];

/// Takes such numbers out of a column, and says which they were; `lines` are those of the rows.
pub(super) fn take_out(column: &mut RawColumn, lines: &[usize]) -> Vec<String> {
    let readings = Readings::new(column);
    let values = readings.values_that(|value| is_of_nines(value) || ENDS.contains(&value.abs()));
    let mut notes = Vec::new();
    for value in &values {
        // An end of a range has five digits at least, and is one number of them.
        let prior = 0.1f64.powi(i32::try_from(digits(*value).len()).unwrap_or(i32::MAX));
        let Some(mark) = readings.mark(*value, prior, &values) else { continue };
        leave_out(column, &mark);
        notes.push(format!(
            "line {}: \"{}\": {value} differs from {} beside it by more than any other two neighbouring readings differ: readings of this value \
             ({} in all) mark missing ones and are left out",
            lines.get(mark.row).copied().unwrap_or_default(),
            column.header,
            rounded(mark.beside),
            mark.rows.len()
        ));
    }
    notes
}

/// Digits of a number, as it is written.
fn digits(value: f64) -> Vec<u8> {
    value.abs().to_string().bytes().filter(u8::is_ascii_digit).collect()
}

/// Whether the digits of a number are nines alone, two or more: 99, -99.99, 9999.
fn is_of_nines(value: f64) -> bool {
    let digits = digits(value);
    digits.len() >= 2 && digits.iter().all(|digit| *digit == b'9')
}
