//! Numbers of the command line within what they may be.

/// Minutes of the device's time: at most a day's.
pub fn minutes(text: &str) -> Result<f64, String> {
    between(text, [0.01, 1440.0])
}

/// A share of a whole.
pub fn share(text: &str) -> Result<f64, String> {
    between(text, [0.0, 1.0])
}

fn between(text: &str, [least, most]: [f64; 2]) -> Result<f64, String> {
    let number = text.parse().ok().filter(|number| (least..=most).contains(number));
    number.ok_or_else(|| format!("expected a number from {least} to {most}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_number_out_of_range_is_rejected_with_its_range() {
        assert_eq!((minutes("60"), share("1e-5")), (Ok(60.0), Ok(1e-5)));
        for wrong in ["-3", "0", "1e300", "NaN", "an hour"] {
            assert_eq!(minutes(wrong), Err("expected a number from 0.01 to 1440".to_owned()), "{wrong}");
        }
        assert_eq!(share("1.5"), Err("expected a number from 0 to 1".to_owned()));
    }
}
