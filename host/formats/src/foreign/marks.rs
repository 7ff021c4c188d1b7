//! Numbers that stand for a reading that is missing: `-99.99`, `9999`, the ends of the range of an integer.

use super::RawColumn;

/// Ends of the ranges of integers of 16 and 32 bit.
const ENDS: [f64; 6] = [32_767.0, 32_768.0, 65_535.0, 2_147_483_647.0, 2_147_483_648.0, 4_294_967_295.0];
/// Largest share of the readings that are missing: a value that is more of them is a level.
const SHARE: usize = 4;

/// Widest gaps between neighbouring readings by which a mark is apart from them: levels of a stage have gaps of one kind.
const FAR: f64 = 3.0;

/// Takes such numbers out of a column, and says which they were: a number of nines, or an end of an integer's range, far from all other
/// readings.
pub(super) fn take_out(column: &mut RawColumn) -> Option<String> {
    let origin = column.origin as f64;
    let is_mark = |value: &f64| is_of_nines(origin + value) || ENDS.contains(&(origin + value).abs());
    let mut candidates: Vec<f64> = column.values.iter().copied().filter(is_mark).collect();
    candidates.sort_by(f64::total_cmp);
    candidates.dedup();
    let mark = candidates.into_iter().find(|mark| is_apart(&column.values, *mark))?;
    let marked = column.values.iter_mut().filter(|value| **value == mark);
    let count = marked.map(|value| *value = f64::NAN).count();
    Some(format!(
        "\"{}\": {count} readings of {}, far from all others, are marks of missing ones, and left out",
        column.header,
        origin + mark
    ))
}

/// Whether readings of this value are few, and further from all others than these are from their neighbours.
fn is_apart(values: &[f64], mark: f64) -> bool {
    let mut others: Vec<f64> =
        values.iter().copied().filter(|value| value.is_finite() && *value != mark).collect();
    others.sort_by(f64::total_cmp);
    let widest = others.windows(2).map(|pair| pair[1] - pair[0]).fold(0.0, f64::max);
    let distance = others.iter().map(|value| (value - mark).abs()).fold(f64::INFINITY, f64::min);
    let count = values.iter().filter(|value| **value == mark).count();
    widest > 0.0 && distance > FAR * widest && SHARE * count <= values.len()
}

/// Whether the digits of a number are nines alone, two or more: 99, -99.99, 9999.
fn is_of_nines(value: f64) -> bool {
    let digits: Vec<u8> = value.abs().to_string().bytes().filter(u8::is_ascii_digit).collect();
    digits.len() >= 2 && digits.iter().all(|digit| *digit == b'9')
}
