//! Numbers of an output against those of a page, within the tolerance that the page states: `<!-- readme: numbers within 0.5 % -->` holds
//! for the blocks below it. The third decimal of an estimate changes with the order of a sum, and says nothing about the program.
//!
//! Whole numbers are counts, settings and names, and have no tolerance; a decimal number may also differ by one in its last digit, which
//! rounding decides.

use anyhow::{Context, Result, ensure};
use regex::Regex;
use std::sync::LazyLock;

/// Begin of the mark.
const MARK: &str = "numbers within ";
/// More would hide what a reader sees.
const MOST_PERCENT: f64 = 5.0;

/// Allowed difference of the decimal numbers of a page's outputs.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Tolerance {
    /// As a share of the number; zero where the page states none.
    share: f64,
}

impl Tolerance {
    /// From the text of a mark, if it is one of a tolerance.
    ///
    /// # Errors
    /// Where the tolerance is not a number of percent that a page may state.
    pub fn read(mark: &str) -> Result<Option<Self>> {
        let Some(stated) = mark.strip_prefix(MARK) else { return Ok(None) };
        let percent = stated.strip_suffix(" %").and_then(|number| number.parse::<f64>().ok());
        let percent = percent.with_context(|| format!("`{stated}`: expected a number and ` %`"))?;
        let is_valid = percent > 0.0 && percent <= MOST_PERCENT;
        ensure!(is_valid, "{percent} %: expected more than 0 and at most {MOST_PERCENT} %");
        Ok(Some(Self { share: percent * 1e-2 }))
    }

    /// The fresh text, in which each line that agrees with the shown one within the tolerance is the shown one.
    pub fn settle(self, shown: &str, fresh: &str) -> String {
        if self.share == 0.0 || shown.lines().count() != fresh.lines().count() {
            return fresh.to_owned();
        }
        let agreed = shown.lines().zip(fresh.lines());
        agreed
            .map(|(shown, fresh)| format!("{}\n", if self.agree(shown, fresh) { shown } else { fresh }))
            .collect()
    }

    /// Whether two lines have the same words, and numbers within the tolerance. A number with another length moves the words after it.
    fn agree(self, shown: &str, fresh: &str) -> bool {
        let (shown, fresh) = (Line::of(shown), Line::of(fresh));
        shown.words == fresh.words
            && shown.numbers.len() == fresh.numbers.len()
            && shown.numbers.iter().zip(&fresh.numbers).all(|(shown, fresh)| self.close(shown, fresh))
    }

    fn close(self, shown: &str, fresh: &str) -> bool {
        let (Some(shown_decimals), Some(fresh_decimals)) = (decimals(shown), decimals(fresh)) else {
            return shown == fresh;
        };
        let (Ok(shown), Ok(fresh)) = (shown.parse::<f64>(), fresh.parse::<f64>()) else { return false };
        // Half a digit more than one: two rounded numbers are compared.
        let last_digit = 1.5 * 0.1f64.powi(shown_decimals.min(fresh_decimals) as i32);
        (shown - fresh).abs() <= last_digit.max(self.share * shown.abs().max(fresh.abs()))
    }
}

fn decimals(text: &str) -> Option<usize> {
    text.split_once('.').map(|(_, digits)| digits.len())
}

/// A line, taken apart.
struct Line<'a> {
    /// Text between the numbers, with single spaces.
    words: Vec<String>,
    numbers: Vec<&'a str>,
}

impl<'a> Line<'a> {
    fn of(text: &'a str) -> Self {
        static NUMBER: LazyLock<Regex> =
            LazyLock::new(|| Regex::new(r"[-+]?\d+(?:\.\d+)?").expect("a constant"));
        let words = NUMBER.split(text).map(|words| words.split_whitespace().collect::<Vec<_>>().join(" "));
        Self { words: words.collect(), numbers: NUMBER.find_iter(text).map(|found| found.as_str()).collect() }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn settled(shown: &str, fresh: &str) -> bool {
        let half_percent = Tolerance::read("numbers within 0.5 %").unwrap().unwrap();
        half_percent.settle(shown, fresh).trim_end() == shown
    }

    #[test]
    fn decimal_numbers_agree_within_the_share_or_one_in_the_last_digit_and_counts_do_not() {
        assert!(settled("K  14.47 (13.73 to 15.26) kPa", "K  14.52 (13.70 to 15.20) kPa"));
        assert!(!settled("K  14.47 kPa", "K  14.57 kPa"));
        assert!(settled("sd 0.39 kPa", "sd  0.40 kPa") && !settled("sd 0.39 kPa", "sd 0.41 kPa"));
        assert!(settled("below 10.0 mm, x", "below 9.99 mm, x"));
        assert!(!settled("4 runs", "5 runs") && !settled("100000 readings", "100001 readings"));
        assert!(!settled("named 0.5", "found 0.5") && !settled("1.0 2.0", "1.0"));
        assert!(!settled("-1.00 mm", "+1.00 mm"));
    }

    #[test]
    fn without_a_tolerance_every_digit_counts_and_marks_state_a_number_of_percent() {
        assert_eq!(Tolerance::default().settle("1.00\n", "1.01\n"), "1.01\n");
        assert_eq!(Tolerance::read("quick").unwrap(), None);
        for wrong in ["numbers within 50 %", "numbers within 0 %", "numbers within much", "numbers within 1"]
        {
            assert!(Tolerance::read(wrong).is_err(), "{wrong}");
        }
    }
}
