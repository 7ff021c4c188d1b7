//! Whether two documents have the same numbers.

use anyhow::{Result, bail};
use serde_json::Value;

/// Compilers and libraries round elementary functions differently in the last bit: K of the example differs by 1e-14 of it, an end of an interval by
/// 1.4e-9, and forces of a millionth of a newton by 2e-9 N.
pub const SAME: f64 = 1e-6;

/// Below this size, in the units of the documents, a number is compared by its difference.
const SMALL: f64 = 1e-2;

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
        assert!(same(&a, &json!({ "k_kpa": [12.000_000_1, null], "file": "a\\b", "n": 3 }), SAME).is_ok());
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
}
