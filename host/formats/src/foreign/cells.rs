//! Numbers and times in cells.

use super::stamp;
use std::borrow::Cow;

/// Content of a cell.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Number {
    /// Whole part, as far as it is exact.
    pub whole: i64,
    /// Remainder to be added to it.
    pub rest: f64,
    /// Whether it is a time of day or a date.
    pub is_stamp: bool,
}

/// Words for a reading that is missing.
const MISSING: [&str; 24] = [
    "nan",
    "-nan",
    "+nan",
    // As libraries of C for Windows write them.
    "nan(ind)",
    "-nan(ind)",
    "1.#qnan",
    "1.#ind",
    "-1.#ind",
    "1.#inf",
    "-1.#inf",
    "na",
    "n/a",
    "null",
    "none",
    "inf",
    "+inf",
    "-inf",
    "infinity",
    "-infinity",
    // Results that a spreadsheet does not have.
    "#n/a",
    "#div/0!",
    "#value!",
    "#num!",
    "#ref!",
];

impl Number {
    /// Reads a number or a time; nothing where it is none.
    pub fn parse(cell: &str, has_decimal_comma: bool) -> Option<Self> {
        // A minus sign as typesetters write it.
        let text: Cow<'_, str> =
            if cell.is_ascii() { cell.into() } else { cell.replacen('\u{2212}', "-", 1).into() };
        let written = written(text.trim());
        let text = written.as_ref();
        let plain = number(text, has_decimal_comma).map(|rest| Self { whole: 0, rest, is_stamp: false });
        plain.map(Self::exact(text, has_decimal_comma)).or_else(|| {
            let (whole, whole_seconds) = stamp::parse(text)?;
            Some(Self { whole, rest: whole_seconds, is_stamp: true })
        })
    }

    /// Whether a cell is a number, a time, or one that is missing.
    pub fn is_one(cell: &str, has_decimal_comma: bool) -> bool {
        is_missing(cell) && !cell.is_empty() || Self::parse(cell, has_decimal_comma).is_some()
    }

    /// Keeps the whole part of a large number apart, so that the digits behind it are not lost.
    fn exact(text: &str, has_decimal_comma: bool) -> impl Fn(Self) -> Self + '_ {
        move |number| {
            let point = if has_decimal_comma { ',' } else { '.' };
            let (whole, fraction) = text.split_once(point).unwrap_or((text, ""));
            fn is_digits(part: &str) -> bool {
                part.bytes().all(|digit| digit.is_ascii_digit())
            }
            let whole: Option<i64> =
                whole.parse().ok().filter(|_| is_digits(fraction) && !text.starts_with('-'));
            let fraction_seconds = format!("0.{fraction}0").parse();
            match (whole, fraction_seconds) {
                (Some(whole), Ok(fraction_seconds)) => Self { whole, rest: fraction_seconds, ..number },
                _ => number,
            }
        }
    }
}

/// A number without what spreadsheets and programs put round it: `'1.5'`, `="1.5"`, `- 1.5`.
fn written(text: &str) -> Cow<'_, str> {
    let text = text.strip_prefix('=').unwrap_or(text).trim_matches(['\'', '"']).trim();
    match text.strip_prefix("- ").or_else(|| text.strip_prefix("-\t")) {
        Some(digits) => format!("-{}", digits.trim_start()).into(),
        None => text.into(),
    }
}

/// Whether a cell states that there is no reading.
pub(super) fn is_missing(cell: &str) -> bool {
    let word = cell.trim();
    // There may be any number of dashes.
    word.bytes().all(|letter| letter == b'-')
        || MISSING.iter().any(|missing| word.eq_ignore_ascii_case(missing))
}

/// Remark on a cell that is no number, and what is expected in its place: signs are not guessed, and a word may stand for a reading beyond the
/// range of an instrument.
pub(super) fn not_a_number(cell: &str) -> (String, String) {
    fn is_number(text: &str) -> bool {
        [false, true].iter().any(|comma| number(text.trim(), *comma).is_some())
    }
    let cell = cell.trim();
    let in_parentheses = cell.strip_prefix('(').and_then(|rest| rest.strip_suffix(')'));
    if let Some(inner) = in_parentheses.map(str::trim).filter(|inner| is_number(inner)) {
        return (
            " but one in parentheses".to_owned(),
            format!("-{inner} if it is one below zero, else {inner}"),
        );
    }
    if let Some(number_text) =
        cell.strip_suffix(['-', '\u{2212}']).map(str::trim).filter(|number_text| is_number(number_text))
    {
        return (" but one with a minus behind it".to_owned(), format!("-{number_text}"));
    }
    let digits = cell.find(|letter: char| letter.is_alphabetic() || matches!(letter, '°' | '"' | '%'));
    if let Some((number_text, unit)) =
        digits.map(|place| cell.split_at(place)).filter(|(number_text, _)| is_number(number_text))
    {
        return (
            " but one with a unit".to_owned(),
            format!("{} with {unit} in the name of the column", number_text.trim()),
        );
    }
    let expected = "numbers, and where there is no reading (overload, out of range) an empty cell or nan, which is left out and counted";
    (String::new(), expected.to_owned())
}

fn number(text: &str, has_decimal_comma: bool) -> Option<f64> {
    // Fortran's exponents of double precision.
    if text.bytes().any(|byte| byte.is_ascii_alphabetic() && !matches!(byte, b'e' | b'E' | b'd' | b'D')) {
        return None;
    }
    let text: Cow<'_, str> =
        if text.contains(['d', 'D']) { text.replace(['d', 'D'], "e").into() } else { text.into() };
    let text = text.as_ref();
    let number: f64 = match (has_decimal_comma, text.contains(',')) {
        (true, true) if !text.contains('.') => text.replacen(',', ".", 1).parse().ok()?,
        (_, true) => return None,
        // With decimal commas a point would part thousands.
        (true, false) if text.contains('.') => return None,
        _ => text.parse().ok()?,
    };
    number.is_finite().then_some(number)
}
