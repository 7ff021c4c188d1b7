//! Units as names have them, and whether a formula has one.

use std::fmt::{self, Display};

/// Base units of names, each with how it is written.
const BASE: [(&str, &str); 6] =
    [("n", "N"), ("mm", "mm"), ("s", "s"), ("mrad", "mrad"), ("rad", "rad"), ("kpa", "kPa")];
/// Factors by which base units are scaled; no product of small powers of them is 1.
const FACTORS: [f64; BASE.len()] = [1.618, 1.259, 0.755, 1.913, 0.687, 1.447];
/// Places of the regressor at which a formula is tried, in its unit.
const PLACES: [f64; 3] = [0.7, -1.3, 2.9];
/// Rounding, and differences of the kind of a logarithm of a number with a unit.
const ROUNDING: f64 = 1e-9;

/// Powers of the base units.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Unit([i32; BASE.len()]);

impl Unit {
    /// The unit that a name ends with, as `stiffening_n_per_mm3`; none where it ends otherwise.
    pub fn of_name(name: &str) -> Self {
        let mut name_parts: Vec<&str> = name.split('_').collect();
        // The first word is the name itself.
        name_parts.remove(0);
        (0..name_parts.len())
            .find_map(|from| Self::of_parts(&name_parts[from..]))
            .unwrap_or(Self([0; BASE.len()]))
    }

    fn of_parts(parts: &[&str]) -> Option<Self> {
        let mut powers = [0; BASE.len()];
        let mut sign = 1;
        for part in parts {
            if *part == "per" {
                sign = -1;
                continue;
            }
            let word = part.trim_end_matches(|c: char| c.is_ascii_digit());
            let power: i32 = match &part[word.len()..] {
                "" => 1,
                digits => digits.parse().ok()?,
            };
            // A number without a unit, as of runs.
            if word == "unit" {
                continue;
            }
            let base = BASE.iter().position(|(name, _)| *name == word)?;
            powers[base] += sign * power;
        }
        Some(Self(powers))
    }

    /// By what a number in this unit is larger where every base unit is smaller by its factor.
    fn factor(self) -> f64 {
        self.0.iter().zip(FACTORS).map(|(power, factor)| factor.powi(*power)).product()
    }
}

impl Display for Unit {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let powers: Vec<String> = self
            .0
            .iter()
            .zip(&BASE)
            .filter_map(|(power, (_, name))| match power {
                0 => None,
                1 => Some((*name).to_owned()),
                power => Some(format!("{name}^{power}")),
            })
            .collect();
        f.write_str(if powers.is_empty() { "no unit" } else { "" })?;
        f.write_str(&powers.join(" "))
    }
}

/// Whether a function of parameters and a regressor has a unit: in other base units all of its numbers change, and its value has to change as
/// its unit says (Buckingham).
pub(super) fn agree(
    value: &dyn Fn(&[f64], f64) -> f64,
    (units, sizes): (&[Unit], &[f64]),
    of_x: Unit,
    of_value: Unit,
) -> bool {
    let scaled: Vec<f64> = sizes.iter().zip(units).map(|(size, unit)| size * unit.factor()).collect();
    PLACES.iter().all(|x| {
        let original_value = value(sizes, *x) * of_value.factor();
        let scaled_value = value(&scaled, x * of_x.factor());
        // A formula without a value at one of the points has none in other units either.
        (original_value - scaled_value).abs() <= ROUNDING * original_value.abs()
            || (original_value.is_nan() && scaled_value.is_nan())
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_end_with_their_units() {
        fn text(name: &str) -> String {
            Unit::of_name(name).to_string()
        }
        assert_eq!(text("stiffening_n_per_mm3"), "N mm^-3");
        assert_eq!(text("half_width_mm"), "mm");
        assert_eq!(text("share"), "no unit");
        assert_eq!(text("slope_per_s"), "s^-1");
        assert_eq!(text("step_per_unit"), "no unit");
    }

    #[test]
    fn units_have_to_agree() {
        let [a, mm] = ["a_n_per_mm", "b_mm"].map(Unit::of_name);
        let dimensionless = Unit::of_name("c");
        let force = Unit::of_name("f_n");
        let agrees_on = |value: &dyn Fn(&[f64], f64) -> f64| {
            agree(value, (&[a, mm, dimensionless], &[0.3, 1.2, 0.5]), mm, force)
        };
        assert!(agrees_on(&|p, x| p[0] * x));
        assert!(agrees_on(&|p, x| p[0] * p[1] * (x / p[1]).tanh() * p[2]));
        assert!(!agrees_on(&|p, x| p[0] * x * x));
        assert!(!agrees_on(&|p, x| p[0] * x + p[2]));
        assert!(!agrees_on(&|p, x| p[0] * p[1] * x.tanh()));
    }
}
