//! The unit of a column as its name and the line of units below it state it, and why it is not known where these leave it open.

use super::unit::{Unit, split_name};
use std::fmt;

/// Why the unit of a column is not known although something is stated of it.
#[derive(Debug, Clone, PartialEq)]
pub enum UnitDoubt {
    /// Its name has a factor, of which it is not known whether the numbers are to be multiplied by it or divided.
    Factor(String),
    /// Its name and the line of units state different ones.
    Contradiction {
        /// In its name.
        named: String,
        /// In the line of units.
        below: String,
    },
    /// What is in brackets behind its name is no unit that is known.
    Unknown(String),
}

impl fmt::Display for UnitDoubt {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Factor(text) => {
                write!(f, "its name has a factor, {text}, and does not say what one in it stands for")
            }
            Self::Contradiction { named, below } => {
                write!(f, "its name states {named}, and the line of units {below}")
            }
            Self::Unknown(text) => write!(f, "no unit is stated that is known ({text})"),
        }
    }
}

/// What a header states.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct StatedUnit {
    /// Name of the column without its unit.
    pub name: String,
    /// Its unit.
    pub unit: Option<Unit>,
    /// Why there is none.
    pub doubt: Option<UnitDoubt>,
}

impl StatedUnit {
    /// Of a column with this header, and this unit in the line below the names.
    pub fn of(header: &str, below: Option<Unit>) -> Self {
        let (name, named) = split_name(header);
        if let Some(factor) = factor(header) {
            return Self { name, unit: None, doubt: Some(UnitDoubt::Factor(factor)) };
        }
        match (named, below) {
            (Some(named), Some(below)) if named.quantity != below.quantity || named.to_si != below.to_si => {
                let doubt = UnitDoubt::Contradiction { named: named.name, below: below.name };
                Self { name, unit: None, doubt: Some(doubt) }
            }
            (None, None) => {
                let doubt = in_brackets(header).map(UnitDoubt::Unknown);
                Self { name, unit: None, doubt }
            }
            (named, below) => Self { name, unit: below.or(named), doubt: None },
        }
    }
}

/// What is in brackets at the end of a header.
fn in_brackets(header: &str) -> Option<String> {
    let header = header.trim_end();
    [('[', ']'), ('(', ')'), ('{', '}'), ('<', '>')].into_iter().find_map(|(open, close)| {
        let (_, text) = header.strip_suffix(close)?.rsplit_once(open)?;
        (!text.trim().is_empty()).then(|| text.trim().to_owned())
    })
}

/// Signs of a product.
const TIMES: [char; 3] = ['*', '×', '·'];
/// Digits of exponents, as typesetters write them.
const RAISED: [char; 11] = ['⁰', '¹', '²', '³', '⁴', '⁵', '⁶', '⁷', '⁸', '⁹', '⁻'];

/// A factor in a header: `x100`, `*1000`, `/10`, `1e3`, `10^-3`, `%`. The numbers of channels, trials and ranges (`Force 2`, `Load cell 10N`,
/// `Fx2`) are none.
pub(super) fn factor(header: &str) -> Option<String> {
    let letters: Vec<char> = header.trim_start_matches(['%', '#']).chars().collect();
    if letters.contains(&'%') {
        return Some("%".to_owned());
    }
    let mut start = 0;
    while start < letters.len() {
        let length = number_length(letters.get(start..).unwrap_or_default());
        if length == 0 {
            start += 1;
            continue;
        }
        let end = start + length;
        if is_factor(&letters, start, end) {
            let is_joined =
                start.checked_sub(1).and_then(|at| letters.get(at)).is_some_and(|of| !of.is_whitespace());
            let text = letters.get(start - usize::from(is_joined)..end).unwrap_or_default();
            return Some(text.iter().collect());
        }
        start = end;
    }
    None
}

/// How many letters at the beginning are a number, with its exponent.
fn number_length(letters: &[char]) -> usize {
    let digits = |from: usize| letters.iter().skip(from).take_while(|letter| letter.is_ascii_digit()).count();
    let mut length = digits(0);
    if length == 0 {
        return 0;
    }
    if letters.get(length) == Some(&'.') && digits(length + 1) > 0 {
        length += 1 + digits(length + 1);
    }
    let raised = letters.iter().skip(length).take_while(|letter| RAISED.contains(letter)).count();
    if raised > 0 {
        return length + raised;
    }
    if matches!(letters.get(length), Some('e' | 'E' | '^')) {
        let sign = usize::from(matches!(letters.get(length + 1), Some('+' | '-')));
        let exponent = digits(length + 1 + sign);
        if exponent > 0 {
            return length + 1 + sign + exponent;
        }
    }
    length
}

/// Whether the number between these places is a factor.
fn is_factor(letters: &[char], start: usize, end: usize) -> bool {
    let text: String = letters.get(start..end).unwrap_or_default().iter().collect();
    let beside = |place: Option<usize>| place.and_then(|place| letters.get(place)).copied();
    fn is_letter(letter: Option<char>) -> bool {
        letter.is_some_and(char::is_alphanumeric)
    }
    // Nearest signs, without the blanks before them, and what is beyond.
    let place_before = letters.iter().take(start).rposition(|letter| !letter.is_whitespace());
    let place_behind = letters.iter().skip(end).position(|letter| !letter.is_whitespace()).map(|at| end + at);
    let (before, behind) = (beside(place_before), beside(place_behind));
    let beyond_before = beside(place_before.and_then(|place| place.checked_sub(1)));
    let beyond_behind = beside(place_behind.map(|place| place + 1));
    if [before, behind].into_iter().flatten().any(|sign| TIMES.contains(&sign)) {
        return true;
    }
    // The first of two trials (1/2) is no quotient.
    if before == Some('/') && !beyond_before.is_some_and(|letter| letter.is_ascii_digit()) {
        return true;
    }
    let is_power = text.contains(['e', 'E', '^']) || text.contains(RAISED);
    let is_of_ten = text != "1" && text.trim_start_matches("0.").trim_matches('0') == "1";
    // The x of a product stands by itself: `Fx10` and `x1` are channels.
    let is_x_before =
        matches!(before, Some('x' | 'X')) && !is_letter(beyond_before) && !is_letter(beside(Some(end)));
    let is_x_behind = matches!(behind, Some('x' | 'X')) && !is_letter(beyond_behind);
    let begins_word = !is_letter(beside(start.checked_sub(1)));
    (is_of_ten || is_power) && (is_x_before || is_x_behind && begins_word) || is_power && begins_word
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::foreign::Quantity;

    #[test]
    fn a_factor_in_a_name_leaves_its_unit_open() {
        for header in [
            "Force x100 [N]",
            "Force ×100 [N]",
            "100 x Force [N]",
            "Force/100 [N]",
            "Force [N] x100",
            "Force (N)*1000",
            "1000*Force (N)",
            "Force 1e2 [N]",
            "Force (x10^2) [N]",
            "Force (100x) (N)",
            "Force %[N]",
            "Force (% FS)",
            "Kraft 10⁻³ [N]",
            "Force [N*100]",
            "Force (N x 10)",
        ] {
            let stated = StatedUnit::of(header, Unit::parse("N"));
            assert!(
                stated.unit.is_none() && matches!(stated.doubt, Some(UnitDoubt::Factor(_))),
                "{header}: {stated:?}"
            );
        }
        for (header, unit) in [
            ("Force 2 [N]", "N"),
            ("Load cell 10N [N]", "N"),
            ("Fx2 (mN)", "mN"),
            ("Trial 1/2 Force [N]", "N"),
            ("Stage x1 (mm)", "mm"),
            ("X100Y (mm)", "mm"),
            ("%force_n", "n"),
            ("Laser2x_mm", "mm"),
            ("EE1 (um)", "um"),
            ("mean of 4 (g)", "g"),
        ] {
            let stated = StatedUnit::of(header, None);
            assert_eq!(stated.unit.map(|unit| unit.name).as_deref(), Some(unit), "{header}");
        }
    }

    #[test]
    fn a_name_and_a_line_of_units_that_differ_are_no_unit() {
        let below = || Unit::parse("mN");
        let stated = StatedUnit::of("Force (N)", below());
        assert_eq!(
            stated.doubt.map(|doubt| doubt.to_string()).as_deref(),
            Some("its name states N, and the line of units mN")
        );
        assert_eq!(StatedUnit::of("Force (mN)", below()).unit, below());
        assert_eq!(StatedUnit::of("Force", below()).unit, below());
        // Two names of one unit.
        let of_seconds = StatedUnit::of("Time (sec)", Unit::parse("s"));
        assert_eq!(of_seconds.unit.map(|unit| unit.quantity), Some(Quantity::Time));
        let stated = StatedUnit::of("LC (mV)", None);
        assert_eq!(stated.doubt, Some(UnitDoubt::Unknown("mV".to_owned())));
        assert_eq!(StatedUnit::of("Force", None).doubt, None);
    }
}
