//! Output of the program for the same session, and the distance of two documents.

use anyhow::{Context, Result, ensure};
use serde_json::Value;
use std::ffi::OsString;
use std::path::Path;
use std::process::Command;

/// Units of processor times in `/proc`, as Linux has them on every machine.
const TICKS_PER_S: f64 = 100.0;

/// The document that `guide ... --json` prints, run in the folder that holds the session.
///
/// # Errors
/// Where it prints none.
pub fn document(folder: &Path, arguments: &[&str]) -> Result<Value> {
    printed(Command::new(tested()?), folder, arguments)
}

/// The same on one thread, by another program where it is given, and the processor time that it took, s.
///
/// # Errors Where there is no program. The result has the program's report.
pub fn timed(folder: &Path, arguments: &[&str], program: Option<&Path>) -> Result<(Result<Value>, f64)> {
    let mut command = Command::new(program.map_or_else(tested, |program| Ok(program.into()))?);
    command.env("RAYON_NUM_THREADS", "1");
    let children_before_s = children_s();
    let document = printed(command, folder, arguments);
    Ok((document, children_s() - children_before_s))
}

fn tested() -> Result<OsString> {
    std::env::var_os("NEEDLE_GUIDE_PROGRAM").context("NEEDLE_GUIDE_PROGRAM: expected the program guide")
}

fn printed(mut program: Command, folder: &Path, arguments: &[&str]) -> Result<Value> {
    let output = program.args(arguments).arg("--json").current_dir(folder).output()?;
    let error = String::from_utf8_lossy(&output.stderr);
    ensure!(!output.stdout.is_empty(), "guide {}: {}", arguments.join(" "), error.trim());
    Ok(serde_json::from_slice(&output.stdout)?)
}

/// Processor time of all programs that this one has run to their ends, s.
fn children_s() -> f64 {
    let text = std::fs::read_to_string("/proc/self/stat").unwrap_or_default();
    // The name in brackets may have blanks; cutime and cstime are the 14th and 15th field behind it.
    let fields = text.rsplit_once(')').map_or("", |(_, fields)| fields).split_whitespace();
    let ticks: f64 = fields.skip(13).take(2).filter_map(|field| field.parse::<f64>().ok()).sum();
    ticks / TICKS_PER_S
}

/// Distance of two documents.
#[derive(Debug, Default)]
pub struct Distance {
    /// Numbers that were compared.
    pub numbers: usize,
    /// Largest difference, as a share of the number, or of the largest number of its list.
    pub largest: f64,
    /// Place of the largest difference.
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
            let value_pairs = a.iter().zip(b.values());
            value_pairs
                .into_iter()
                .try_for_each(|((key, a), b)| walk(a, b, &format!("{place}.{key}"), 0.0, distance))
        }
        (Value::Array(a), Value::Array(b)) => {
            ensure!(a.len() == b.len(), "{place}: {} values, the program has {}", a.len(), b.len());
            let largest =
                b.iter().filter_map(Value::as_f64).fold(0.0, |most: f64, number| most.max(number.abs()));
            let mut element_pairs = a.iter().zip(b).enumerate();
            element_pairs.try_for_each(|(i, (a, b))| walk(a, b, &format!("{place}[{i}]"), largest, distance))
        }
        (Value::Number(a), Value::Number(b)) => {
            let (a, b) = (a.as_f64().unwrap_or(f64::NAN), b.as_f64().unwrap_or(f64::NAN));
            let size = a.abs().max(b.abs()).max(of_list);
            let relative_difference = if size < ZERO { 0.0 } else { (a - b).abs() / size };
            distance.numbers += 1;
            if relative_difference > distance.largest {
                (distance.largest, distance.place) = (relative_difference, place.to_owned());
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
        let distance = compare(&json!({"a": [1.0, 2.0], "b": "x"}), &json!({"a": [1.0, 2.0002], "b": "x"}))
            .expect("alike");
        assert_eq!((distance.numbers, distance.place.as_str()), (2, ".a[1]"));
        assert!((distance.largest - 1e-4).abs() < 1e-6);
        assert!(compare(&json!({"a": 1}), &json!({"b": 1})).is_err());
        assert!(compare(&json!(["x"]), &json!(["y"])).is_err());
    }
}
