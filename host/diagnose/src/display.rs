//! Text of a diagnosis, for the screen and for reports.

use super::results::{FoundEffect, ModulusStatus, RegionResult, Verdict};
use std::fmt::{self, Display};

impl Verdict {
    /// The name of the verdict, with an explanation if the name is not sufficient.
    pub fn explained(self) -> &'static str {
        match self {
            Self::Adequate => "adequate: these runs show no missing effect",
            Self::Named => "named",
            Self::Ambiguous => "ambiguous: these runs do not decide between several explanations",
            Self::Unexplained => "unexplained: no effect of the catalogue explains the misfit",
        }
    }
}

impl Display for RegionResult {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let side = if self.changes_sign_with_level { " towards the displacement" } else { "" };
        write!(
            f,
            "{}, {} {}: {:+.3} {}{side} ({:.1} sigma)",
            self.channel,
            words(&self.coordinate),
            span(self.from, self.to),
            self.mean_residual,
            self.unit,
            self.sigma
        )
    }
}

impl ModulusStatus {
    /// Text of a modulus with its interval, kPa; without a value if the runs do not identify it.
    pub fn modulus_text(self, value_kpa: f64, [low_kpa, high_kpa]: [f64; 2]) -> String {
        match self {
            Self::Identified => format!("{value_kpa:.2} kPa ({low_kpa:.2} to {high_kpa:.2})"),
            Self::NotIdentified => {
                format!(
                    "not identifiable ({low_kpa:.2} to {high_kpa:.2} kPa with what was assumed beforehand)"
                )
            }
        }
    }
}

impl FoundEffect {
    /// Its parameters with their intervals.
    pub fn parameters_in_words(&self) -> String {
        let parameter_text = self.parameters.iter().map(|(name, estimate)| {
            let [low, high] = estimate.ci95;
            format!("{name} {:.4} ({low:.4} to {high:.4})", estimate.value)
        });
        let values = parameter_text.collect::<Vec<_>>().join(", ");
        match &self.formula {
            Some(formula) => format!("{formula}; {values}"),
            None => values,
        }
    }

    /// Its probability, and that of its class if it is not the only explanation.
    pub fn probability_in_words(&self) -> String {
        let number = self.class.iter().position(|id| *id == self.id);
        match number.and_then(|number| self.class_probability.get(number)) {
            Some(own) if self.class.len() > 1 => {
                format!("probability {}, of the class {}", percent(*own), percent(self.probability))
            }
            _ => format!("probability {}", percent(self.probability)),
        }
    }

    /// Other effects that explain the data, with their probabilities.
    pub fn competing_effects(&self) -> Vec<String> {
        let competitors = self.class.iter().zip(&self.class_probability).filter(|(id, _)| **id != self.id);
        competitors.map(|(id, probability)| format!("{id} ({:.0} %)", 100.0 * probability)).collect()
    }
}

/// A probability in percent.
fn percent(probability: f64) -> String {
    match 100.0 * probability {
        more if more > 99.9 => "> 99.9 %".to_owned(),
        other => format!("{other:.1} %"),
    }
}

/// `shape_y_mm` without its unit.
pub fn channel(name: &str) -> &str {
    name.rsplit_once('_').map_or(name, |(channel, _)| channel)
}

/// The unit in a name like `shape_y_mm`.
pub fn unit(name: &str) -> &'static str {
    match name.rsplit_once('_') {
        Some((_, "n")) => "N",
        Some((_, "mrad")) => "mrad",
        _ => "mm",
    }
}

/// `shape_y_mm` and its value: `shape_y 0.020 mm`.
pub fn quantity(name: &str, value: f64) -> String {
    format!("{} {value:.3} {}", channel(name), unit(name))
}

fn words(coordinate: &str) -> String {
    coordinate.rsplit_once('_').map_or(coordinate, |(name, _)| name).replace('_', " ")
}

/// Text of an interval, or of its value if it has no length.
fn span(from: f64, to: f64) -> String {
    if (to - from).abs() < 0.05 { format!("{from:.1}") } else { format!("{from:.1} to {to:.1}") }
}
