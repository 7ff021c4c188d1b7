//! Units as laboratories write them, and what is measured in them.

use std::fmt;

/// Quantity of a unit.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Quantity {
    /// Seconds.
    Time,
    /// Metres.
    Length,
    /// Newtons.
    Force,
    /// Radians.
    Angle,
}

/// A unit with its factor to SI; a factor may be negative where a column counts the other way.
#[derive(Debug, Clone, PartialEq)]
pub struct Unit {
    /// As it is written.
    pub name: String,
    /// Quantity that it measures.
    pub quantity: Quantity,
    /// SI units in one of it.
    pub to_si: f64,
}

/// Standard gravity, for weights: m/s^2.
const GRAVITY: f64 = 9.806_65;
const POUND_KG: f64 = 0.453_592_37;
const INCH_M: f64 = 0.025_4;

/// Names, in lower case but where the case decides, with their factors.
const UNITS: [(&[&str], Quantity, f64); 29] = [
    (&["s", "sec", "secs", "second", "seconds"], Quantity::Time, 1.0),
    (&["ms", "msec", "millisecond", "milliseconds"], Quantity::Time, 1e-3),
    (&["us", "µs", "μs", "usec", "microsecond", "microseconds"], Quantity::Time, 1e-6),
    (&["ns", "nsec", "nanosecond", "nanoseconds"], Quantity::Time, 1e-9),
    (&["min", "minute", "minutes"], Quantity::Time, 60.0),
    (&["h", "hr", "hour", "hours"], Quantity::Time, 3600.0),
    (&["d", "day", "days"], Quantity::Time, 86_400.0),
    (&["m", "meter", "meters", "metre", "metres"], Quantity::Length, 1.0),
    (&["cm", "centimeter", "centimeters", "centimetre", "centimetres"], Quantity::Length, 1e-2),
    (&["mm", "millimeter", "millimeters", "millimetre", "millimetres"], Quantity::Length, 1e-3),
    (
        &["um", "µm", "μm", "micron", "microns", "micrometer", "micrometers", "micrometre", "micrometres"],
        Quantity::Length,
        1e-6,
    ),
    (&["nm", "nanometer", "nanometers", "nanometre", "nanometres"], Quantity::Length, 1e-9),
    (&["in", "inch", "inches", "\""], Quantity::Length, INCH_M),
    (&["mil", "mils", "thou"], Quantity::Length, 1e-3 * INCH_M),
    (&["n", "newton", "newtons"], Quantity::Force, 1.0),
    (&["millinewton", "millinewtons"], Quantity::Force, 1e-3),
    (&["un", "µn", "μn", "micronewton", "micronewtons"], Quantity::Force, 1e-6),
    (&["kn", "kilonewton", "kilonewtons"], Quantity::Force, 1e3),
    (&["g", "gf", "gram", "grams", "gramforce", "gram-force", "pond", "p"], Quantity::Force, 1e-3 * GRAVITY),
    (&["mg", "mgf", "milligram", "milligrams"], Quantity::Force, 1e-6 * GRAVITY),
    (&["kg", "kgf", "kilogram", "kilograms", "kp"], Quantity::Force, GRAVITY),
    (&["lb", "lbs", "lbf", "pound", "pounds"], Quantity::Force, POUND_KG * GRAVITY),
    (&["oz", "ozf", "ounce", "ounces"], Quantity::Force, POUND_KG / 16.0 * GRAVITY),
    (&["dyn", "dyne", "dynes"], Quantity::Force, 1e-5),
    (&["cn", "centinewton", "centinewtons"], Quantity::Force, 1e-2),
    (&["rad", "radian", "radians"], Quantity::Angle, 1.0),
    (&["mrad", "milliradian", "milliradians"], Quantity::Angle, 1e-3),
    (&["deg", "°", "degree", "degrees"], Quantity::Angle, std::f64::consts::PI / 180.0),
    (&["turn", "turns", "rev", "revolutions"], Quantity::Angle, std::f64::consts::TAU),
];

impl Unit {
    /// Reads one; a minus sign before it turns the direction round.
    pub fn parse(text: &str) -> Option<Self> {
        let name = text.trim();
        let (sign, plain) = match name.strip_prefix('-') {
            Some(rest) => (-1.0, rest.trim()),
            None => (1.0, name),
        };
        // Here the case decides: mN and MN.
        let exact = match plain {
            "mN" => Some((Quantity::Force, 1e-3)),
            "MN" | "Mm" | "Ms" => return None,
            _ => None,
        };
        let lower = plain.to_lowercase();
        let unit_entry = UNITS.iter().find(|(names, ..)| names.contains(&lower.as_str()));
        let (quantity, to_si) =
            exact.or_else(|| unit_entry.map(|(_, quantity, to_si)| (*quantity, *to_si)))?;
        Some(Self { name: name.to_owned(), quantity, to_si: sign * to_si })
    }

    /// Reads one, or a multiple of one: `0.5 N` for a count of half a newton, `1/100 mm`, `-1e-3 N`.
    pub fn multiple(text: &str) -> Option<Self> {
        let name = text.trim();
        if let Some(unit) = Self::parse(name) {
            return Some(unit);
        }
        let (sign, plain) = match name.strip_prefix('-') {
            Some(rest) => (-1.0, rest),
            None => (1.0, name),
        };
        plain.char_indices().find_map(|(place, _)| {
            let (number, unit) = plain.split_at(place);
            let factor = factor(number.trim().trim_end_matches(['*', '×', '·']).trim_end())?;
            let unit = Self::parse(unit).filter(|_| !unit.trim_start().starts_with('-'))?;
            Some(Self { name: name.to_owned(), quantity: unit.quantity, to_si: sign * factor * unit.to_si })
        })
    }

    /// The SI unit of a quantity.
    pub fn si(quantity: Quantity) -> Self {
        let name = match quantity {
            Quantity::Time => "s",
            Quantity::Length => "m",
            Quantity::Force => "N",
            Quantity::Angle => "rad",
        };
        Self { name: name.to_owned(), quantity, to_si: 1.0 }
    }
}

/// A number above zero: `0.01`, `1e-3`, `10^-3`, `1/100`.
fn factor(text: &str) -> Option<f64> {
    let number = match (text.split_once('/'), text.split_once('^')) {
        (Some((part, whole)), _) => part.parse::<f64>().ok()? / whole.parse::<f64>().ok()?,
        (None, Some((base, exponent))) => base.parse::<f64>().ok()?.powf(exponent.parse().ok()?),
        (None, None) => text.parse().ok()?,
    };
    (number.is_finite() && number > 0.0).then_some(number)
}

impl Quantity {
    /// A multiple of one of its units, for messages.
    pub(super) fn multiple(self) -> &'static str {
        match self {
            Self::Time => "0.5 ms",
            Self::Length => "0.01 mm",
            Self::Force => "0.5 N",
            Self::Angle => "0.1 deg",
        }
    }

    /// Some units of it, for messages.
    pub fn examples(self) -> &'static str {
        match self {
            Self::Time => "s, ms, us, ns, min",
            Self::Length => "m, cm, mm, um, in",
            Self::Force => "N, mN, g, kg, lbf",
            Self::Angle => "rad, mrad, deg",
        }
    }
}

impl fmt::Display for Quantity {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Time => "time",
            Self::Length => "length",
            Self::Force => "force",
            Self::Angle => "angle",
        })
    }
}

/// A column's name and the unit in it: `Force [g]`, `Force (g)`, `Force/g`, `Force, g`, `force_g`, `Force:g`.
pub(super) fn split_name(header: &str) -> (String, Option<Unit>) {
    let header = header.trim();
    for (open, close) in [('[', ']'), ('(', ')'), ('{', '}'), ('<', '>')] {
        if let Some((name, unit_tail)) = header.rsplit_once(open)
            && let Some((unit_text, _)) = unit_tail.split_once(close)
            && let Some(unit) = Unit::parse(unit_text)
        {
            return (name.trim().to_owned(), Some(unit));
        }
    }
    for separator in ["/", ",", ":", "_", " in ", " ", "."] {
        if let Some((name, last)) = header.rsplit_once(separator)
            && !name.trim().is_empty()
            && let Some(unit) = Unit::parse(last)
            // A single letter behind a blank may be an axis or a number of a column.
            && (last.trim().chars().count() > 1 || !matches!(separator, " " | "."))
        {
            return (name.trim().to_owned(), Some(unit));
        }
    }
    (header.to_owned(), None)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn units_are_found_in_every_form_of_a_header() {
        for (header, name, unit) in [
            ("Force [g]", "Force", Some(("g", 9.806_65e-3))),
            ("Kraft (mN)", "Kraft", Some(("mN", 1e-3))),
            ("force_y_n", "force_y", Some(("n", 1.0))),
            ("Weg/mm", "Weg", Some(("mm", 1e-3))),
            ("Load, lbf", "Load", Some(("lbf", 4.448_221_615_260_5))),
            ("t:ms", "t", Some(("ms", 1e-3))),
            ("Position µm", "Position", Some(("µm", 1e-6))),
            ("Time (sec)", "Time", Some(("sec", 1.0))),
            ("Axial Counts (deg)", "Axial Counts", Some(("deg", 0.017_453_292_519_943_295))),
            ("Stage X", "Stage X", None),
            ("Tip m", "Tip m", None),
            ("Current (A)", "Current (A)", None),
            ("Load (MN)", "Load (MN)", None),
        ] {
            let (header_unit, stated) = split_name(header);
            assert_eq!(header_unit, name, "{header}");
            match (stated, unit) {
                (None, None) => {}
                (Some(stated), Some((unit, to_si))) => {
                    assert_eq!(stated.name, unit, "{header}");
                    assert!((stated.to_si / to_si - 1.0).abs() < 1e-9, "{header}: {}", stated.to_si);
                }
                (stated, _) => panic!("{header}: {stated:?}"),
            }
        }
        assert_eq!(Unit::parse("-N").map(|unit| unit.to_si), Some(-1.0));
        for (text, to_si) in [
            ("0.5 N", 0.5),
            ("0.5N", 0.5),
            ("1e-3 N", 1e-3),
            ("-2.5 mN", -2.5e-3),
            ("10^-3*N", 1e-3),
            ("1/100 mm", 1e-5),
            ("25 g", 25.0 * 9.806_65e-3),
            ("mN", 1e-3),
        ] {
            let found = Unit::multiple(text).map(|unit| unit.to_si);
            assert!(found.is_some_and(|found| (found / to_si - 1.0).abs() < 1e-12), "{text}: {found:?}");
        }
        for text in ["", "0 N", "0.5", "0.5 V", "1/0 N", "nan N", "0.5 -N", "--N", "5 5 N"] {
            assert_eq!(Unit::multiple(text), None, "{text}");
        }
        assert_eq!(Unit::parse("V"), None);
    }
}
