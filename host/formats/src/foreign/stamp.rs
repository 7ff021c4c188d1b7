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
    let (clock_text, zone_s) = without_zone(day.trim())?;
    let (whole, whole_seconds) = time_of_day(clock_text, is_later)?;
    let days = match date {
        Some(date) => i64::from(calendar(date)?.to_julian_day() - JULIAN_1970),
        None => 0,
    };
    Some((86_400 * days + whole - zone_s, whole_seconds))
}

/// A time without its zone, and how far that is ahead of UTC, seconds: it changes within a recording where the clocks
/// are put forward, and between files of two programs.
fn without_zone(text: &str) -> Option<(&str, i64)> {
    let upper = text.to_ascii_uppercase();
    if let Some(name) = ["UTC", "GMT", "Z"].into_iter().find(|name| upper.ends_with(name)) {
        return Some((text.get(..text.len() - name.len())?.trim_end(), 0));
    }
    let Some(sign_at) = text.rfind(['+', '-']) else { return Some((text, 0)) };
    let (clock_text, zone) = (text.get(..sign_at)?, text.get(sign_at + 1..)?);
    let (hours, minutes) = match zone.split_once(':') {
        Some(parts) => parts,
        None => (zone.get(..2)?, zone.get(2..)?),
    };
    fn part(text: &str, most: i64) -> Option<i64> {
        let is_two = text.len() == 2 && text.bytes().all(|digit| digit.is_ascii_digit());
        text.parse().ok().filter(|number| is_two && *number <= most)
    }
    let minutes = if minutes.is_empty() { 0 } else { part(minutes, 59)? };
    let zone_s = 3600 * part(hours, 14)? + 60 * minutes;
    Some((clock_text.trim_end(), if text.get(sign_at..)?.starts_with('-') { -zone_s } else { zone_s }))
}

/// Names of the months, as far as they are told apart by.
const MONTHS: [&str; 12] =
    ["jan", "feb", "mar", "apr", "may", "jun", "jul", "aug", "sep", "oct", "nov", "dec"];

/// Julian day of 1970-01-01.
const JULIAN_1970: i32 = 2_440_588;

fn time_of_day(text: &str, is_later: Option<bool>) -> Option<(i64, f64)> {
    let clock_fields: Vec<&str> = text.split(':').collect();
    // Minutes and seconds alone, as spreadsheets show times: hours and minutes have no fraction.
    if let [minutes, seconds] = clock_fields.as_slice()
        && seconds.contains(['.', ','])
    {
        return time_of_day(&format!("0:{minutes}:{seconds}"), None);
    }
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
    fn full_year(text: &str) -> Option<u16> {
        Some(if text.len() == 2 { 2000 + number(text)? } else { number(text)? })
    }
    fn of(year: u16, month: u16, day: u16) -> Option<Date> {
        let month = Month::try_from(u8::try_from(month).ok()?).ok()?;
        Date::from_calendar_date(year.into(), month, u8::try_from(day).ok()?).ok()
    }
    // A month's name, as MATLAB writes it: 06-May-2024.
    fn month_name(text: &str) -> Option<u16> {
        let start = text.get(..3)?.to_ascii_lowercase();
        let month_index = MONTHS.iter().position(|name| *name == start)?;
        text.bytes().all(|letter| letter.is_ascii_alphabetic()).then_some(month_index as u16 + 1)
    }
    if let Some(month) = month_name(b) {
        return if a.len() == 4 {
            of(number(a)?, month, number(c)?)
        } else {
            of(full_year(c)?, month, number(a)?)
        };
    }
    if a.len() == 4 {
        return of(number(a)?, number(b)?, number(c)?);
    }
    let year = full_year(c)?;
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
            "2024-05-01T14:00:01.250+02:00",
            "2024-05-01T08:30:01.25-0330",
            "2024-05-01 12:00:01.25 UTC",
            "01-May-2024 12:00:01.25",
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
        assert_eq!(parse("59:58.5"), Some((3598, 0.5)));
        assert_eq!(parse("2024-11-03T01:30:00-05:00"), Some((1_730_615_400, 0.0)));
        for text in [
            "",
            "12",
            "12:00:01+2",
            "2024-05-01 12:00:01-x",
            "12:61:00",
            "2024-13-01 12:00:00",
            "a:b:c",
            "1:2:3:4:5",
            "é:ü",
        ] {
            assert_eq!(parse(text), None, "{text}");
        }
    }
}
