//! Terms as formulas with their values.

use super::form::{WIDTH, powers};
use super::{Form, Regressor, Site};

impl Form {
    /// The function as a formula with its values.
    pub fn formula(self, parameters: &[f64], site: Site, regressor: Regressor) -> String {
        let (unit, of, x) = (text(site.unit()), text(regressor.unit()), regressor.symbol());
        let place = |at: usize| format!("{:.4} {of}", number(at, parameters)).trim_end().to_owned();
        match self {
            Self::Constant => value(0, 0, of, unit, parameters),
            Self::Linear if regressor == Regressor::Direction => {
                format!("{} {x}", value(0, 0, of, unit, parameters))
            }
            Self::Linear => format!("{} {x}", value(0, 1, of, unit, parameters)),
            Self::Absolute => format!("{} |{x}|", value(0, 1, of, unit, parameters)),
            Self::Quadratic => format!("{} {x}^2", value(0, 2, of, unit, parameters)),
            Self::Cubic => format!("{} {x}^3", value(0, 3, of, unit, parameters)),
            Self::Sign => format!("{} sign({x})", value(0, 0, of, unit, parameters)),
            Self::Saturation => {
                format!("{} {x} / sqrt({x}^2 + ({})^2)", value(0, 0, of, unit, parameters), place(1))
            }
            Self::Exponential => {
                format!("{} (1 - exp(-{x} / {}))", value(0, 0, of, unit, parameters), place(1))
            }
            Self::Step => format!("{} where {x} > {}", value(0, 0, of, unit, parameters), place(1)),
            Self::Within => format!("{} where {x} < {}", value(0, 0, of, unit, parameters), place(1)),
            Self::Knee => format!(
                "{} (1 - {} / sqrt({x}^2 + ({})^2))",
                value(0, 0, of, unit, parameters),
                place(1),
                place(1)
            ),
            Self::Toe => {
                format!("{} {} / sqrt({x}^2 + ({})^2)", value(0, 0, of, unit, parameters), place(1), place(1))
            }
            Self::Bump => {
                let width = format!("{:.3} {of}", WIDTH * regressor.typical());
                format!(
                    "{} exp(-({x} - {})^2 / (2 ({})^2))",
                    value(0, 0, of, unit, parameters),
                    place(1),
                    width.trim_end()
                )
            }
            Self::Sine => {
                let turn = format!("2 pi {x} / {}", place(2));
                format!(
                    "{} sin({turn}) + {} (cos({turn}) - 1)",
                    value(0, 0, of, unit, parameters),
                    value(1, 0, of, unit, parameters)
                )
            }
            Self::Play => format!("{} play({x}, {})", value(0, 1, of, unit, parameters), place(1)),
            Self::Bristle => {
                let width = place(1);
                format!("{} ({x} - play({x}, {width})) / {width}", value(0, 0, of, unit, parameters))
            }
            Self::Decay => {
                format!("{} sign({x}) exp(-|{x}| / {})", value(0, 0, of, unit, parameters), place(1))
            }
            Self::Own => String::new(),
            Self::Polynomial => {
                let [a, b, c, d] = powers(parameters, regressor);
                let with_unit = |value: f64, power: usize| match (power, of) {
                    (0, _) | (_, "") => format!("{value:.4} {unit}"),
                    (1, of) => format!("{value:.4} {unit}/{of}"),
                    (power, of) => format!("{value:.3e} {unit}/{of}^{power}"),
                };
                format!(
                    "{} + {} {x} + {} {x}^2 + {} {x}^3",
                    with_unit(a, 0),
                    with_unit(b, 1),
                    with_unit(c, 2),
                    with_unit(d, 3)
                )
            }
        }
    }
}

/// Parameter as text, with the unit of its power of the regressor.
fn value(at: usize, power: usize, of: &str, unit: &str, parameters: &[f64]) -> String {
    let per = match (power, of) {
        (0, _) | (_, "") => String::new(),
        (1, of) if of.contains('/') => format!("/({of})"),
        (1, of) => format!("/{of}"),
        (power, of) => format!("/{of}^{power}"),
    };
    let unit = if unit.is_empty() && !per.is_empty() { "1" } else { unit };
    format!("{:.4} {unit}{per}", number(at, parameters)).trim_end().to_owned()
}

/// Value of a parameter; not a number where it is missing.
fn number(at: usize, parameters: &[f64]) -> f64 {
    parameters.get(at).copied().unwrap_or(f64::NAN)
}

/// A unit as it is written.
fn text(unit: &'static str) -> &'static str {
    match unit {
        "n" => "N",
        "rad_per_n_m" => "rad/(N m)",
        "n_m_per_rad" => "N m/rad",
        "n_per_mm" => "N/mm",
        "mm_per_s" => "mm/s",
        unit => unit,
    }
}
