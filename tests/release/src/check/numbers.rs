//! Whether two documents have the same numbers.

use anyhow::{Result, bail, ensure};
use regex::Regex;
use serde_json::Value;

/// Tolerance of numbers from two systems, whose elementary functions differ in the last bit: a thousandth of the last digit that is printed. On
/// the example they differ by at most 3e-6, where an interval is integrated.
pub const SAME: f64 = 1e-5;
/// The same where fits end once a step changes no value by more than a twentieth of its standard deviation, which may be one step earlier on
/// the other system. On the example ends of the interval of K differ by 5e-4 of them, the score of an effect that does nothing by 5e-3.
pub const SAME_FIT: f64 = 1e-2;

/// Below this size, in the units of the documents, a number is compared by its difference: to a thousandth of the third decimal, the last one
/// that is printed of such a number.
const SMALL: f64 = 0.1;

/// Compares two texts: the same but for numbers, which may differ by the tolerance or by one in their last digit.
///
/// # Errors
/// The first difference.
pub fn same_text(a: &str, b: &str, tolerance: f64) -> Result<()> {
    let number = Regex::new(r"-?\d+(\.\d+)?(e-?\d+)?")?;
    let (mut begin_a, mut begin_b) = (0, 0);
    let (mut numbers_a, mut numbers_b) = (number.find_iter(a), number.find_iter(b));
    loop {
        let (one, other) = (numbers_a.next(), numbers_b.next());
        let between_a = &a[begin_a..one.map_or(a.len(), |found| found.start())];
        let between_b = &b[begin_b..other.map_or(b.len(), |found| found.start())];
        ensure!(between_a == between_b, "`{between_a}` and `{between_b}`");
        let (Some(one), Some(other)) = (one, other) else { return Ok(()) };
        (begin_a, begin_b) = (one.end(), other.end());
        // Checksums may look like numbers beyond any.
        if one.as_str() == other.as_str() {
            continue;
        }
        let (x, y): (f64, f64) = (one.as_str().parse()?, other.as_str().parse()?);
        let last_digit =
            one.as_str().split_once('.').map_or(1.0, |(_, digits)| 0.1_f64.powi(digits.len() as i32));
        let is_same = (x - y).abs() <= (tolerance * x.abs().max(y.abs())).max(1.01 * last_digit);
        ensure!(is_same, "after `{}`: {x} and {y}", last_words(between_a));
    }
}

/// The end of a text, for a message.
fn last_words(text: &str) -> String {
    let start = text.char_indices().rev().nth(60).map_or(0, |(index, _)| index);
    text[start..].to_owned()
}

/// Compares two documents: the same fields, texts and numbers, the latter to a relative tolerance. Paths may have the separators of another
/// system.
///
/// # Errors
/// The first field that differs.
pub fn same(a: &Value, b: &Value, tolerance: f64) -> Result<()> {
    compare(a, b, tolerance, "")
}

fn compare(a: &Value, b: &Value, tolerance: f64, place: &str) -> Result<()> {
    match (a, b) {
        (Value::Object(one), Value::Object(other)) if one.len() == other.len() => {
            for (name, a) in one {
                let Some(b) = other.get(name) else { bail!("{place}.{name}: is in one document only") };
                compare(a, b, tolerance, &format!("{place}.{name}"))?;
            }
            Ok(())
        }
        (Value::Array(one), Value::Array(other)) if one.len() == other.len() => {
            let mut pairs = one.iter().zip(other).enumerate();
            pairs.try_for_each(|(number, (a, b))| compare(a, b, tolerance, &format!("{place}[{number}]")))
        }
        (Value::Number(one), Value::Number(other)) => {
            let (Some(x), Some(y)) = (one.as_f64(), other.as_f64()) else { bail!("{place}: {one}, {other}") };
            let is_same = (x - y).abs() <= tolerance * x.abs().max(y.abs()).max(SMALL);
            if is_same { Ok(()) } else { bail!("{place}: {x} and {y}") }
        }
        (Value::String(one), Value::String(other)) if one.replace('\\', "/") == other.replace('\\', "/") => {
            Ok(())
        }
        _ if a == b => Ok(()),
        _ => bail!("{place}: {a} and {b}"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn numbers_may_differ_in_what_rounding_leaves_open_and_nothing_else_may() {
        let a = json!({ "k_kpa": [12.0, null], "file": "a/b", "n": 3 });
        assert!(same(&a, &json!({ "k_kpa": [12.000_1, null], "file": "a\\b", "n": 3 }), SAME).is_ok());
        for (other, place) in [
            (json!({ "k_kpa": [12.001, null], "file": "a/b", "n": 3 }), ".k_kpa[0]"),
            (json!({ "k_kpa": [12.0], "file": "a/b", "n": 3 }), ".k_kpa"),
            (json!({ "k_kpa": [12.0, null], "file": "a/c", "n": 3 }), ".file"),
            (json!({ "k_kpa": [12.0, null], "file": "a/b", "m": 3 }), ".n"),
        ] {
            let error = same(&a, &other, SAME).unwrap_err().to_string();
            assert!(error.starts_with(place), "{error}");
        }
    }

    #[test]
    fn texts_may_differ_in_the_last_digits_of_numbers() {
        let text = "K 11.16 (9.14 to 22.13) kPa, 3 runs";
        assert!(same_text(text, "K 11.16 (9.15 to 22.12) kPa, 3 runs", SAME_FIT).is_ok());
        for other in [
            "K 11.16 (9.14 to 22.13) Pa, 3 runs",
            "K 11.16 (8.14 to 22.13) kPa, 3 runs",
            "K 11.16 (9.14 to 22.13) kPa",
        ] {
            assert!(same_text(text, other, SAME_FIT).is_err(), "{other}");
        }
        assert!(same_text("cx 101.2 cy -3", "cx 101.3 cy -3", SAME_FIT).is_ok());
    }
}
