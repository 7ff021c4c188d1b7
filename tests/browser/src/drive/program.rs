//! What the program prints for the same session, and how far two documents are apart.

use anyhow::{Context, Result, ensure};
use serde_json::Value;
use std::path::Path;
use std::process::Command;

/// The document that `guide ... --json` prints, run in the folder that holds the session.
///
/// # Errors
/// Where it prints none.
pub fn document(folder: &Path, arguments: &[&str]) -> Result<Value> {
    let program = std::env::var_os("NEEDLE_GUIDE_PROGRAM")
        .context("NEEDLE_GUIDE_PROGRAM: expected the program guide")?;
    let output = Command::new(program).args(arguments).arg("--json").current_dir(folder).output()?;
    let error = String::from_utf8_lossy(&output.stderr);
    ensure!(!output.stdout.is_empty(), "guide {}: {}", arguments.join(" "), error.trim());
    Ok(serde_json::from_slice(&output.stdout)?)
}

/// How far two documents are apart.
#[derive(Debug, Default)]
pub struct Distance {
    /// Numbers that were compared.
    pub numbers: usize,
    /// Largest difference, as a share of the number, or of the largest number of its list.
    pub largest: f64,
    /// Where it is.
    pub place: String,
}

/// Below this a number is as good as zero.
const ZERO: f64 = 1e-12;

/// Compares all numbers of two documents; everything else has to be the same.
///
/// # Errors
/// The first place at which they differ otherwise.
pub fn compare(page: &Value, program: &Value) -> Result<Distance> {
    let mut distance = Distance::default();
    walk(page, program, "", 0.0, &mut distance)?;
    Ok(distance)
}

fn walk(page: &Value, program: &Value, place: &str, of_list: f64, distance: &mut Distance) -> Result<()> {
    match (page, program) {
        (Value::Object(a), Value::Object(b)) => {
            ensure!(a.keys().eq(b.keys()), "{place}: other fields");
            let both = a.iter().zip(b.values());
            both.into_iter()
                .try_for_each(|((key, a), b)| walk(a, b, &format!("{place}.{key}"), 0.0, distance))
        }
        (Value::Array(a), Value::Array(b)) => {
            ensure!(a.len() == b.len(), "{place}: {} values, the program has {}", a.len(), b.len());
            let largest =
                b.iter().filter_map(Value::as_f64).fold(0.0, |most: f64, number| most.max(number.abs()));
            let mut both = a.iter().zip(b).enumerate();
            both.try_for_each(|(i, (a, b))| walk(a, b, &format!("{place}[{i}]"), largest, distance))
        }
        (Value::Number(a), Value::Number(b)) => {
            let (a, b) = (a.as_f64().unwrap_or(f64::NAN), b.as_f64().unwrap_or(f64::NAN));
            let size = a.abs().max(b.abs()).max(of_list);
            let apart = if size < ZERO { 0.0 } else { (a - b).abs() / size };
            distance.numbers += 1;
            if apart > distance.largest {
                (distance.largest, distance.place) = (apart, place.to_owned());
            }
            Ok(())
        }
        _ => {
            ensure!(page == program, "{place}: {page}, the program has {program}");
            Ok(())
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn the_largest_relative_difference_is_found_with_its_place() {
        let found = compare(&json!({"a": [1.0, 2.0], "b": "x"}), &json!({"a": [1.0, 2.0002], "b": "x"}))
            .expect("alike");
        assert_eq!((found.numbers, found.place.as_str()), (2, ".a[1]"));
        assert!((found.largest - 1e-4).abs() < 1e-6);
        assert!(compare(&json!({"a": 1}), &json!({"b": 1})).is_err());
        assert!(compare(&json!(["x"]), &json!(["y"])).is_err());
    }
}
