//! Times of a table: as they are written, or counted from a second.

/// Name of the column of times.
pub(super) const TIME: &str = "time_s";
/// Times beyond this are on the clock of a computer, since 1970 or since it was started. Differences of times are compared to 1e-10 s (a
/// part in 1e9 of the shortest stretch of a hold), which a double holds up to 2e5 s.
const COMPUTER_CLOCK_S: f64 = 131_072.0;

/// From where the times of a table are counted.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Clock {
    /// As they are written.
    AsWritten,
    /// From the whole second of the first one where that is a computer's time, so that adding a constant to all times changes nothing.
    FromFirst,
    /// From this second.
    From(i64),
}

impl Clock {
    /// Origin to subtract if this is the first time.
    pub(super) fn origin_s(self, first: Option<&str>) -> i64 {
        match self {
            Self::AsWritten => 0,
            Self::From(origin_s) => origin_s,
            Self::FromFirst => {
                let first_s: f64 = first.and_then(|text| text.parse().ok()).unwrap_or(0.0);
                if first_s.abs() > COMPUTER_CLOCK_S { first_s.floor() as i64 } else { 0 }
            }
        }
    }
}

/// A number less whole ones, without the digits that a double loses behind many others.
pub(super) fn less(text: &str, value: f64, origin: i64) -> f64 {
    let (whole, fraction) = text.split_once('.').unwrap_or((text, ""));
    let is_plain = !text.starts_with('-') && fraction.bytes().all(|digit| digit.is_ascii_digit());
    let whole = whole.parse::<i64>().ok().filter(|_| is_plain).and_then(|whole| whole.checked_sub(origin));
    match whole {
        Some(whole) if whole >= 0 => format!("{whole}.{fraction}0").parse().unwrap_or(value - origin as f64),
        _ => value - origin as f64,
    }
}
