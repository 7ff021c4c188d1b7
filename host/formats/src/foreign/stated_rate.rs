//! Rows a second, as a line above the names states them: `Sample rate: 50 Hz`, `Scan rate [Hz]: 50`, `Sampling interval;20;ms`.

use super::unit::{Quantity, Unit};

/// Words for a rate, and for the time from row to row.
const OF_RATE: [&str; 7] = ["rate", "freq", "frequency", "fs", "samplerate", "abtastrate", "sampling"];
const OF_INTERVAL: [&str; 6] = ["interval", "period", "dt", "delta", "abtastintervall", "spacing"];
/// Words of lines with another frequency.
const OF_OTHER: [&str; 9] =
    ["filter", "cutoff", "lowpass", "highpass", "bandwidth", "excitation", "notch", "pwm", "natural"];
/// Units of a rate, and how many hertz they are.
const RATES: [(&str, f64); 4] = [("hz", 1.0), ("khz", 1e3), ("sps", 1.0), ("ksps", 1e3)];

/// A rate and its line.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StatedRate {
    /// The line.
    pub line: usize,
    /// Rows a second.
    pub hz: f64,
}

impl StatedRate {
    /// The one line that states a rate; none where there are several rates.
    pub(super) fn find(above: &[(usize, Vec<String>)]) -> Option<Self> {
        let mut rates = above
            .iter()
            .filter_map(|(line, cells)| Some(Self { line: *line, hz: rate_hz(&cells.join(" "))? }));
        let first = rates.next()?;
        rates.all(|other| is_same(other.hz, first.hz)).then_some(first)
    }

    /// Whether this is the same rate, in the digits that files have of one.
    pub(super) fn is(self, hz: f64) -> bool {
        is_same(self.hz, hz)
    }
}

/// Whether two rates differ by less than a row in a run of a thousand rows.
fn is_same(a: f64, b: f64) -> bool {
    (a - b).abs() < 1e-3 * a.abs().max(b.abs())
}

/// The rate of a line with one number and a word and a unit of a rate, or of an interval.
fn rate_hz(text: &str) -> Option<f64> {
    let tokens = tokens(text);
    let mut numbers = tokens.iter().filter_map(|token| token.replace(',', ".").parse::<f64>().ok());
    let number = numbers.next().filter(|number| *number > 0.0 && numbers.next().is_none())?;
    if has_one_of(&tokens, &OF_OTHER) {
        return None;
    }
    let rate = RATES.iter().find(|(unit, _)| has_one_of(&tokens, &[unit]));
    if let Some((_, hz)) = rate.filter(|_| has_one_of(&tokens, &OF_RATE)) {
        return Some(number * hz);
    }
    let unit =
        tokens.iter().filter_map(|token| Unit::parse(token)).find(|unit| unit.quantity == Quantity::Time)?;
    has_one_of(&tokens, &OF_INTERVAL).then(|| (number * unit.to_si).recip()).filter(|hz| hz.is_finite())
}

fn has_one_of(tokens: &[String], words: &[&str]) -> bool {
    tokens.iter().any(|token| words.contains(&token.as_str()))
}

/// Words and numbers of a line, in small letters: a unit behind a number is a word of its own.
fn tokens(text: &str) -> Vec<String> {
    let mut tokens: Vec<String> = vec![String::new()];
    let (mut was_digit, lower) = (false, text.to_lowercase());
    for letter in lower.chars() {
        let is_digit = letter.is_ascii_digit() || was_digit && matches!(letter, '.' | ',');
        let is_part = is_digit || letter.is_alphabetic() || matches!(letter, 'µ');
        if !is_part || was_digit != is_digit {
            tokens.push(String::new());
        }
        if is_part {
            tokens.iter_mut().next_back().into_iter().for_each(|token| token.push(letter));
        }
        was_digit = is_digit;
    }
    tokens
        .into_iter()
        .map(|token| token.trim_end_matches(['.', ',']).to_owned())
        .filter(|token| !token.is_empty())
        .collect()
}
