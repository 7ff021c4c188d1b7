//! Numbers of the command line within what they may be.

/// Minutes of the device's time: at most a day's.
pub fn minutes(text: &str) -> Result<f64, String> {
    let number = text.parse().ok().filter(|number| (0.01..=1440.0).contains(number));
    number.ok_or_else(|| "expected a number from 0.01 to 1440".to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_number_out_of_range_is_rejected_with_its_range() {
        assert_eq!(minutes("60"), Ok(60.0));
        for wrong in ["-3", "0", "1e300", "NaN", "an hour"] {
            assert_eq!(minutes(wrong), Err("expected a number from 0.01 to 1440".to_owned()), "{wrong}");
        }
    }
}
