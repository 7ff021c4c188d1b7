//! Dates and times of day in cells: `2024-05-01T12:00:01.25Z`, `01.05.2024 12:00:01,25`, `5/1/2024 12:00:01 PM`, `12:00:01.25`.

use time::{Date, Month};

/// Seconds since 1970, or since midnight where there is no date: whole ones and the rest.
pub(super) fn parse(text: &str) -> Option<(i64, f64)> {
    let text = text.trim();
    let (date, time_text) = match text.split_once(['T', ' ']) {
        Some((date, rest)) if !date.contains(':') => (Some(date), rest.trim()),
        _ => (None, text),
    };
    let (day, is_later) = match time_text.to_uppercase() {
        upper if upper.ends_with("PM") => (time_text.get(..time_text.len() - 2)?, Some(true)),
        upper if upper.ends_with("AM") => (time_text.get(..time_text.len() - 2)?, Some(false)),
        _ => (time_text, None),
    };
    // The zone is the same for all rows.
    let day = day.trim().trim_end_matches(['Z', 'z']);
    let day = day.split(['+']).next()?.trim();
    let day = match day.rsplit_once('-') {
        Some((day, _)) => day,
        None => day,
    };
    let (whole, whole_seconds) = time_of_day(day, is_later)?;
    let days = match date {
        Some(date) => i64::from(calendar(date)?.to_julian_day() - JULIAN_1970),
        None => 0,
    };
    Some((86_400 * days + whole, whole_seconds))
}

/// Julian day of 1970-01-01.
const JULIAN_1970: i32 = 2_440_588;

fn time_of_day(text: &str, is_later: Option<bool>) -> Option<(i64, f64)> {
    let clock_fields: Vec<&str> = text.split(':').collect();
    let (&[hours, minutes], seconds) = clock_fields.split_first_chunk::<2>()?;
    let seconds = match seconds {
        [] => "0".to_owned(),
        [seconds] => seconds.replacen(',', ".", 1),
        // Milliseconds behind another colon, as some loggers write them.
        [seconds, clock_fields] => format!("{seconds}.{clock_fields}"),
        _ => return None,
    };
    let (whole, fraction) = seconds.split_once('.').unwrap_or((&seconds, "0"));
    fn number(text: &str, most: i64) -> Option<i64> {
        text.parse::<i64>().ok().filter(|number| (0..=most).contains(number))
    }
    let (mut hours, minutes, whole) = (number(hours, 24)?, number(minutes, 59)?, number(whole, 60)?);
    if !fraction.bytes().all(|digit| digit.is_ascii_digit()) {
        return None;
    }
    match is_later {
        Some(true) if hours < 12 => hours += 12,
        Some(false) if hours == 12 => hours = 0,
        _ => {}
    }
    Some((3600 * hours + 60 * minutes + whole, format!("0.{fraction}").parse().ok()?))
}

/// A day: year first, or last. With slashes the month is first, unless it cannot be: only differences of times matter.
fn calendar(text: &str) -> Option<Date> {
    let separator = ['-', '.', '/'].into_iter().find(|separator| text.contains(*separator))?;
    let date_fields: Vec<&str> = text.split(separator).collect();
    let [a, b, c] = <[&str; 3]>::try_from(date_fields).ok()?;
    fn number(text: &str) -> Option<u16> {
        text.parse::<u16>().ok()
    }
    fn of(year: u16, month: u16, day: u16) -> Option<Date> {
        let month = Month::try_from(u8::try_from(month).ok()?).ok()?;
        Date::from_calendar_date(year.into(), month, u8::try_from(day).ok()?).ok()
    }
    if a.len() == 4 {
        return of(number(a)?, number(b)?, number(c)?);
    }
    let year = if c.len() == 2 { 2000 + number(c)? } else { number(c)? };
    let (first, second) = (number(a)?, number(b)?);
    let day_first = of(year, second, first);
    let month_first = of(year, first, second);
    if separator == '/' { month_first.or(day_first) } else { day_first.or(month_first) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn dates_and_times_of_day_are_read_in_every_order() {
        let noon = 1_714_564_801;
        for text in [
            "2024-05-01T12:00:01.25Z",
            "2024-05-01 12:00:01.25",
            "2024-05-01T12:00:01.250+02:00",
            "2024/05/01 12:00:01,25",
            "01.05.2024 12:00:01,25",
            "5/1/2024 12:00:01.25 PM",
            "01-05-24 12:00:01:25",
        ] {
            assert_eq!(parse(text), Some((noon, 0.25)), "{text}");
        }
        assert_eq!(parse("23/12/2024 00:00:00"), Some((1_734_912_000, 0.0)));
        assert_eq!(parse("12:00:01.5"), Some((43_201, 0.5)));
        assert_eq!(parse("12:00"), Some((43_200, 0.0)));
        for text in ["", "12", "12:61:00", "2024-13-01 12:00:00", "a:b:c", "1:2:3:4:5", "é:ü"] {
            assert_eq!(parse(text), None, "{text}");
        }
    }
}
