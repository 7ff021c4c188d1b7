//! The order of files by the numbers in their names.

use crate::error::ImagingError;
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

/// Digits behind a point that are kept.
const DIGITS: usize = 9;

/// Decimal signs of names, of which some file systems have no point.
const POINTS: [&str; 3] = [".", ",", "p"];

/// A text and the number behind it.
#[derive(Debug, Clone, Default, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct Part {
    text: String,
    /// In units of the last of [`DIGITS`] where names have decimals.
    number: i128,
    digits: usize,
    /// Its first digit is a zero before others.
    is_padded: bool,
}

/// Sorts files by the numbers in their names, so that `frame-10` is behind `frame-9`, `z_1.5` behind `z_1.25` and `z_-5` before `z_0`.
///
/// Returns a remark where a minus that is taken as a hyphen decides the order.
///
/// # Errors
/// Names that have another order with decimals than with two numbers, or with a minus than with a hyphen before a length.
pub(super) fn sort(folder: &Path, files: &mut [PathBuf]) -> Result<Option<String>, ImagingError> {
    let is_decimal = has_decimals(files);
    let mut sorted: Vec<(Vec<Part>, PathBuf)> =
        all_parts(files, is_decimal).into_iter().zip(files.to_vec()).collect();
    sorted.sort();
    for (place, (_, file)) in files.iter_mut().zip(sorted) {
        *place = file;
    }
    let are_numbers = is_decimal || are_two_numbers(files);
    if !are_numbers && let Some(pair) = first_descent(&all_parts(files, true), files) {
        let problem = format!("{pair}: decimals, or two numbers");
        let expected = "as many digits behind the point in every name, or numbers without a point";
        return Err(ImagingError::invalid(folder, "names", problem, expected));
    }
    let signed = with_minus_signs(all_parts(files, is_decimal || !are_numbers));
    let Some(pair) = signed.iter().find_map(|(_, parts)| first_descent(parts, files)) else {
        return Ok(None);
    };
    if signed.iter().any(|(is_length, _)| *is_length) {
        let problem = format!("{pair}: a minus, or a hyphen");
        let expected = "_- before numbers below zero (z_-30.0mm), and _ alone before others (z_30.0mm)";
        return Err(ImagingError::invalid(folder, "names", problem, expected));
    }
    let ends = [files.first(), files.last()].map(|path| path.map_or_else(String::new, |path| name(path)));
    Ok(Some(format!(
        "frames from {} to {}: the minus before their numbers is taken as a hyphen",
        ends[0], ends[1]
    )))
}

/// The first two names that are in another order than these parts of theirs.
fn first_descent(parts: &[Vec<Part>], files: &[PathBuf]) -> Option<String> {
    let place = parts.windows(2).position(|pair| pair[0] > pair[1])?;
    let pair: Vec<String> = files.iter().skip(place).take(2).map(|path| name(path)).collect();
    Some(pair.join(" and "))
}

/// The parts with numbers below zero, for the first place where all names have a minus before a number that changes; with whether that is a
/// length, by the axis before it or the unit behind it. None where the numbers count frames: they have zeros before them, or are 0 or 1 and what
/// follows by ones.
fn with_minus_signs(mut names: Vec<Vec<Part>>) -> Option<(bool, Vec<Vec<Part>>)> {
    let first = names.first()?;
    let place = (0..first.len()).find(|at| names.iter().any(|parts| parts.get(*at) != first.get(*at)))?;
    let column: Vec<&Part> = names.iter().filter_map(|parts| parts.get(place)).collect();
    let before = first.get(place)?.text.strip_suffix('-')?.to_owned();
    if column.len() != names.len() || column.iter().any(|part| part.text.strip_suffix('-') != Some(&before)) {
        return None;
    }
    let behind = first.get(place + 1).map(|part| part.text.trim_start_matches(['_', ' ', '-']));
    let is_unit = behind.is_some_and(|text| {
        let letters: String = text.chars().take_while(|letter| letter.is_alphabetic()).collect();
        ["mm", "cm", "um", "µm", "μm"].contains(&letters.as_str())
    });
    let mut letters = before.chars().rev();
    let is_axis = letters.next().is_some_and(|letter| matches!(letter, 'x' | 'y' | 'z' | 'X' | 'Y' | 'Z'))
        && letters.next().is_none_or(|letter| !letter.is_alphanumeric());
    let is_padded = column.iter().any(|part| part.is_padded);
    let numbers: Vec<i128> = column.iter().map(|part| part.number).collect();
    let is_count = numbers.first().is_some_and(|first| (0..=1).contains(first))
        && numbers.windows(2).all(|pair| pair[1] - pair[0] == 1);
    let is_length = is_unit || is_axis;
    if !is_length && (is_padded || is_count) {
        return None;
    }
    for part in names.iter_mut().filter_map(|parts| parts.get_mut(place)) {
        part.number = -part.number;
    }
    Some((is_length, names))
}

/// Refuses names that count frames and leave some out: places along the needle are counted from the first one. If the
/// distances of numbers are no multiples of the smallest one they are times or another quantity.
pub(super) fn check_numbers(folder: &Path, files: &[PathBuf]) -> Result<(), ImagingError> {
    let is_decimal = has_decimals(files);
    let names = all_parts(files, is_decimal);
    let Some(first) = names.first().filter(|first| names.iter().all(|parts| parts.len() == first.len()))
    else {
        return Ok(());
    };
    fn named(parts: &[Part], at: usize) -> Option<(&str, i128)> {
        parts.get(at).map(|part| (part.text.as_str(), part.number))
    }
    let changing: Vec<usize> = (0..first.len())
        .filter(|at| names.iter().any(|parts| named(parts, *at) != named(first, *at)))
        .collect();
    let &[column] = changing.as_slice() else { return Ok(()) };
    let numbers: Vec<i128> = names.iter().filter_map(|parts| Some(parts.get(column)?.number)).collect();
    let steps: Vec<i128> = numbers.windows(2).map(|pair| pair[1].saturating_sub(pair[0])).collect();
    let smallest = steps.iter().copied().min().unwrap_or(0);
    if smallest <= 0 || steps.iter().any(|step| step % smallest != 0) {
        return Ok(());
    }
    let usual = 2 * steps.iter().filter(|step| **step == smallest).count() > steps.len();
    let Some(gap) = steps.iter().position(|step| usual && *step > smallest) else { return Ok(()) };
    let problem = format!(
        "{} between {} and {}",
        match steps.get(gap).map_or(0, |step| step / smallest - 1) {
            1 => "a frame is missing".to_owned(),
            count => format!("{count} frames are missing"),
        },
        files.get(gap).map(|path| name(path)).unwrap_or_default(),
        files.get(gap + 1).map(|path| name(path)).unwrap_or_default()
    );
    let expected = "a frame for each number, as they are counted along the needle: leave out those behind the gap, or number them anew";
    Err(ImagingError::invalid(folder, "names", problem, expected))
}

fn name(path: &Path) -> String {
    path.file_name().unwrap_or_default().to_string_lossy().into_owned()
}

/// Whether points in the names are decimal ones: some names do without, as `z_3` beside `z_1.5`.
fn has_decimals(files: &[PathBuf]) -> bool {
    count_of_layouts(files, false) > 1 && count_of_layouts(files, true) == 1
}

/// In how many ways the names have text and numbers.
fn count_of_layouts(files: &[PathBuf], is_decimal: bool) -> usize {
    let mut counts: Vec<usize> = files.iter().map(|path| parts(&name(path), is_decimal).len()).collect();
    counts.sort_unstable();
    counts.dedup();
    counts.len()
}

/// Whether points part two numbers in every name: decimals have no zero at the end that others do without, as `1.10` beside `1.9`.
fn are_two_numbers(files: &[PathBuf]) -> bool {
    let mut fractions: Vec<Part> = Vec::new();
    for path in files {
        let parts = parts(&name(path), false);
        let behind_point = parts.iter().enumerate().filter(|(at, _)| is_fraction(&parts, *at));
        fractions.extend(behind_point.map(|(_, part)| part.clone()));
    }
    let Some(fewest) = fractions.iter().map(|part| part.digits).min() else { return true };
    fractions.iter().any(|part| part.digits > fewest && part.number % 10 == 0)
}

/// Whether a part is the digits behind the point of the number before it.
fn is_fraction(parts: &[Part], at: usize) -> bool {
    fn is_behind_point(parts: &[Part], at: usize) -> bool {
        parts.get(at).is_some_and(|part| POINTS.contains(&part.text.as_str()) && part.digits > 0)
    }
    is_behind_point(parts, at)
        && !is_behind_point(parts, at + 1)
        && at.checked_sub(1).is_some_and(|before| {
            !is_behind_point(parts, before) && parts.get(before).is_some_and(|part| part.digits > 0)
        })
}

/// The texts and numbers of all names. A minus is a sign, also behind a letter, where other names have the same text without it: `z-5` beside
/// `z0` and `z+5`. One that all have is a hyphen.
fn all_parts(files: &[PathBuf], is_decimal: bool) -> Vec<Vec<Part>> {
    let mut names: Vec<Vec<Part>> = files.iter().map(|path| parts(&name(path), is_decimal)).collect();
    let longest = names.iter().map(Vec::len).max().unwrap_or(0);
    for at in 0..longest {
        let parts = names.iter().filter_map(|parts| parts.get(at)).filter(|part| part.digits > 0);
        let positive: BTreeSet<String> = parts
            .filter(|part| !part.text.ends_with('-'))
            .map(|part| part.text.trim_end_matches('+').to_owned())
            .collect();
        for part in names.iter_mut().filter_map(|parts| parts.get_mut(at)).filter(|part| part.digits > 0) {
            if let Some(text) = part.text.strip_suffix('-').filter(|text| positive.contains(*text)) {
                (part.text, part.number) = (text.to_owned(), -part.number);
            } else if let Some(text) = part.text.strip_suffix('+') {
                part.text = text.to_owned();
            }
        }
    }
    names
}

/// The texts and numbers of a name.
fn parts(name: &str, is_decimal: bool) -> Vec<Part> {
    let mut parts: Vec<Part> = vec![Part::default()];
    let mut in_number = false;
    for letter in name.chars() {
        match letter.to_digit(10) {
            Some(digit) => {
                if let Some(part) = parts.last_mut() {
                    part.is_padded |= part.digits == 1 && part.number == 0;
                    part.number = part.number.saturating_mul(10).saturating_add(digit.into());
                    part.digits += 1;
                }
                in_number = true;
            }
            None => {
                if in_number {
                    parts.push(Part::default());
                }
                in_number = false;
                if let Some(part) = parts.last_mut() {
                    part.text.push(letter);
                }
            }
        }
    }
    let mut joined: Vec<Part> = Vec::new();
    let unit = if is_decimal { 10i128.pow(DIGITS as u32) } else { 1 };
    for (at, part) in parts.iter().enumerate() {
        if is_decimal && is_fraction(&parts, at) {
            // Further digits change no order of places along a needle.
            let digits = part.digits.min(DIGITS);
            let fraction = part.number / 10i128.saturating_pow((part.digits - digits) as u32);
            if let Some(whole) = joined.last_mut() {
                whole.number = whole
                    .number
                    .saturating_add(fraction.saturating_mul(10i128.pow((DIGITS - digits) as u32)));
                whole.digits += part.digits;
            }
        } else {
            joined.push(Part { number: part.number.saturating_mul(unit), ..part.clone() });
        }
    }
    for (at, part) in joined.iter_mut().enumerate() {
        // A minus behind a letter or a digit is a hyphen.
        let before = part.text.strip_suffix('-');
        let is_sign = before.is_some_and(|text| match text.chars().next_back() {
            None => at == 0,
            Some(letter) => matches!(letter, '_' | '=' | '(' | '['),
        });
        if is_sign && part.digits > 0 {
            part.text.pop();
            part.number = -part.number;
        }
    }
    joined
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sorted(names: &[&str]) -> Result<Vec<String>, String> {
        let mut files: Vec<PathBuf> = names.iter().map(PathBuf::from).collect();
        sort(Path::new("frames"), &mut files).map_err(|error| error.to_string())?;
        check_numbers(Path::new("frames"), &files).map_err(|error| error.to_string())?;
        Ok(files.iter().map(|path| name(path)).collect())
    }

    #[test]
    fn names_with_decimals_and_signs_are_in_the_order_of_their_numbers() {
        for right in [
            &["z_0mm.png", "z_0.75mm.png", "z_1.5mm.png", "z_2.25mm.png", "z_3mm.png"][..],
            &["z_1mm.png", "z_1.25mm.png", "z_1.5mm.png", "z_1.75mm.png", "z_2mm.png"],
            &["z_-10.png", "z_-5.png", "z_0.png", "z_5.png"],
            &["-2.5.png", "-2.png", "-1.5.png", "-1.png"],
            &["z-10.png", "z-5.png", "z0.png", "z5.png", "z10.png"],
            &["at 1 -2.png", "at 1 -1.png", "at 1 +1.png", "at 2 -1.png"],
            &["run-8.png", "run-9.png", "run-10.png"],
            &["2024-05-06_10.00.09.png", "2024-05-06_10.00.10.png", "2024-05-06_10.01.00.png"],
            &["scan 1.08.png", "scan 1.09.png", "scan 1.10.png"],
            &["run 1.8.png", "run 1.9.png", "run 1.10.png"],
            &["z_0.0.png", "z_0.75.png", "z_1.5.png"],
            &["pos_0.png", "pos_0,25.png", "pos_0,5.png", "pos_0,75.png", "pos_1.png"],
            &["z0p25mm.png", "z0p50mm.png", "z1p00mm.png", "z10p25mm.png"],
            &["z_-30.0mm.png", "z_-29.5mm.png", "z_-0.5mm.png"],
            &["frame-0008.png", "frame-0009.png", "frame-0010.png"],
        ] {
            let mut names = right.to_vec();
            names.reverse();
            assert_eq!(
                sorted(&names).as_deref(),
                Ok(&right.iter().map(|name| (*name).to_owned()).collect::<Vec<_>>()[..])
            );
        }
        for point in POINTS {
            let [half, quarter] = ["5", "25"].map(|digits| format!("z_1{point}{digits}.png"));
            let error = sorted(&[&format!("z_1{point}0.png"), &quarter, &half]).expect_err("two orders");
            assert!(error.contains(&format!("{half} and {quarter}: decimals, or two numbers")), "{error}");
        }
        // A minus before a length that all names have, by the unit behind it or the axis before it, at any place.
        for names in [
            &["z-30.0mm.png", "z-29.5mm.png", "z-0.5mm.png"][..],
            &["probe -30 mm.tif", "probe -20 mm.tif", "probe -10 mm.tif"],
            &["scan2_Z-12.tif", "scan2_Z-11.tif", "scan2_Z-1.tif"],
        ] {
            let error = sorted(names).expect_err("two orders");
            assert!(error.contains("a minus, or a hyphen, expected _- before numbers below zero"), "{error}");
        }
        let note = |names: &[&str]| {
            let mut files: Vec<PathBuf> = names.iter().map(PathBuf::from).collect();
            sort(Path::new("frames"), &mut files).expect("sorted")
        };
        assert_eq!(note(&["run-0.png", "run-1.png", "run-2.png"]), None);
        assert_eq!(note(&["run-7-a.png", "run-7-b.png"]), None);
        let stated =
            "frames from pos-10.png to pos-30.png: the minus before their numbers is taken as a hyphen";
        assert_eq!(note(&["pos-30.png", "pos-20.png", "pos-10.png"]).as_deref(), Some(stated));
        let error = sorted(&["z_0.png", "z_0.5.png", "z_1.png", "z_2.png"]).expect_err("a gap");
        assert!(error.contains("between z_1.png and z_2.png"), "{error}");
    }
}
