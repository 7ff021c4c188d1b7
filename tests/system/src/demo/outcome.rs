//! Results of the demonstration, and the numbers in them.

use anyhow::{Context, Result};
use formats::session::Session;
use serde_json::Value;
use simulation::rig::Truth;
use std::time::Duration;

/// Results of the demonstration, beside the truth.
#[derive(Debug, Clone, PartialEq)]
pub struct Outcome {
    /// `guide identify --json`.
    pub identified: Value,
    /// `guide predict --json`.
    pub predicted: Value,
    /// The session it recorded.
    pub session: Session,
    /// Report of `guide import ultrasound` about the frames.
    pub imported: Value,
    /// True parameters of the rig.
    pub truth: Truth,
    /// From the start of QEMU to the result.
    pub elapsed: Duration,
}

/// Use of the ultrasound frames.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Frames {
    /// In the shape, or in the straight needle.
    pub used: u64,
    /// In neither.
    pub rejected: u64,
}

impl Outcome {
    /// A number of the first run's result of a method, kilopascals.
    ///
    /// # Errors
    /// Where the result has no such number.
    pub fn number(&self, method: &str, field: &str) -> Result<f64> {
        let value = self.identified.pointer(&format!("/runs/0/methods/{method}/{field}"));
        value.and_then(Value::as_f64).with_context(|| format!("identify gave no {field} by {method}"))
    }

    /// Relative error of the identified modulus.
    ///
    /// # Errors
    /// Where the result has none.
    pub fn error(&self) -> Result<f64> {
        Ok(self.number("likelihood", "k_kpa")? / (self.truth.modulus_pa * 1e-3) - 1.0)
    }

    /// Share of the measured tip positions beyond the last reading used that lie inside the predicted bands.
    pub fn share_inside(&self) -> f64 {
        let (mut inside_weight, mut total_weight) = (0.0, 0.0);
        for one in self.predicted["insertions"].as_array().into_iter().flatten() {
            for plane in ["y", "x"] {
                let (low, high, measured) =
                    (series("lo95", plane, one), series("hi95", plane, one), series("measured", plane, one));
                for (i, measured) in measured.iter().enumerate().skip(51) {
                    if let (Some(measured), Some(low), Some(high)) =
                        (measured.as_f64(), number_at(&low, i), number_at(&high, i))
                    {
                        total_weight += 1.0;
                        inside_weight += f64::from(u8::from((low..=high).contains(&measured)));
                    }
                }
            }
        }
        inside_weight / total_weight
    }

    /// Mean error of a predicted path, millimetres; `method` is one of those compared, or none for this one.
    pub fn path_error_mm(&self, method: Option<&str>) -> f64 {
        let errors =
            self.predicted["insertions"].as_array().into_iter().flatten().filter_map(|one| match method {
                None => one["mae_mm"].as_f64(),
                Some(name) => {
                    one["compare"].as_array()?.iter().find(|other| other["method"] == name)?["mae_mm"]
                        .as_f64()
                }
            });
        let errors: Vec<f64> = errors.collect();
        errors.iter().sum::<f64>() / errors.len() as f64
    }

    /// Samples that the session counts as lost between the first and the last.
    pub fn lost_samples(&self) -> f64 {
        self.session.lateral.iter().flat_map(|run| run.force.lost_before.iter().flatten()).sum()
    }

    /// Use of the frames of all sweeps.
    ///
    /// # Errors
    /// Where the import states no frames.
    pub fn frames(&self) -> Result<Frames> {
        let sweeps = self.imported["sweeps"].as_array().context("the import states no sweeps")?;
        let mut frames = Frames::default();
        for sweep in sweeps.iter().chain([&self.imported["straight"]]) {
            let states = sweep["states"].as_object().context("a sweep states no frames")?;
            for (state, count) in states {
                let count = count.as_u64().context("a count is no number")?;
                if state == "used" { frames.used += count } else { frames.rejected += count }
            }
        }
        Ok(frames)
    }

    /// The likelihood's 95 % interval, kilopascals.
    ///
    /// # Errors
    /// Where the result has none.
    pub fn interval_kpa(&self) -> Result<[f64; 2]> {
        Ok([self.number("likelihood", "ci95_kpa/0")?, self.number("likelihood", "ci95_kpa/1")?])
    }
}

fn number_at(list: &[Value], i: usize) -> Option<f64> {
    list.get(i).and_then(Value::as_f64)
}

fn series(name: &str, plane: &str, one: &Value) -> Vec<Value> {
    one[format!("{name}_{plane}_mm")].as_array().cloned().unwrap_or_default()
}
