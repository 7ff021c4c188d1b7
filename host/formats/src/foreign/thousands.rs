//! Signs that part thousands: `1,003.5`, `1.003,5`, `1'003.5`, `1 003,5`.
//!
//! `1,003` is a number about one or one about a thousand; the column decides which.

/// Signs that part thousands and nothing else: apostrophes and blanks, of which some do not break.
const PARTING: [char; 7] = ['\'', '\u{2019}', '\u{a0}', '\u{202f}', '\u{2007}', '\u{2009}', ' '];
/// Stands for a decimal sign where there is none.
const NO_SIGN: char = '\0';
/// Different whole numbers below a thousand that a column of thousands has, so that its commas are no decimal ones.
const WHOLE: usize = 3;

/// Whether a number has groups of three digits behind this sign, and at most one decimal sign behind them.
fn has_groups(cell: &str, sign: char, decimal: char) -> bool {
    let digits = cell.strip_prefix(['+', '-', '\u{2212}']).unwrap_or(cell);
    let (whole, fraction) = digits.split_once(decimal).unwrap_or((digits, ""));
    let mut groups = whole.split(sign);
    fn is_digits(text: &str) -> bool {
        text.bytes().all(|digit| digit.is_ascii_digit())
    }
    let is_first = groups
        .next()
        .is_some_and(|first| (1..=3).contains(&first.len()) && is_digits(first) && !first.starts_with('0'));
    let mut count = 0;
    let are_groups = groups.all(|group| {
        count += 1;
        group.len() == 3 && is_digits(group)
    });
    is_first && are_groups && count > 0 && is_digits(fraction)
}

/// Decimal sign, and the sign that parts thousands beside it.
fn signs(has_decimal_comma: bool) -> (char, char) {
    if has_decimal_comma { (',', '.') } else { ('.', ',') }
}

/// The sign that certainly parts thousands in a cell: one of [`PARTING`], or one with the decimal sign behind it.
fn certain(cell: &str, has_decimal_comma: bool) -> Option<char> {
    let (decimal, group_sign) = signs(has_decimal_comma);
    let parting = PARTING.into_iter().find(|sign| has_groups(cell, *sign, decimal));
    parting
        .or_else(|| (cell.contains(decimal) && has_groups(cell, group_sign, decimal)).then_some(group_sign))
}

/// Takes the signs that part thousands out of the numbers of every column that has them; the columns' places, from 0.
pub(super) fn join(rows: &mut [(usize, Vec<String>)], has_decimal_comma: bool) -> Vec<usize> {
    let width = rows.iter().map(|(_, cells)| cells.len()).max().unwrap_or(0);
    let mut joined = Vec::new();
    for place in 0..width {
        let Some(sign) = sign_of(rows, place, has_decimal_comma) else { continue };
        let (decimal, _) = signs(has_decimal_comma);
        // In a column of whole numbers there is no decimal sign.
        let decimal = if sign == decimal { NO_SIGN } else { decimal };
        for cell in rows.iter_mut().filter_map(|(_, cells)| cells.get_mut(place)) {
            if has_groups(cell, sign, decimal) {
                cell.retain(|letter| letter != sign);
            }
        }
        joined.push(place);
    }
    joined
}

/// The sign that parts thousands in a column.
fn sign_of(rows: &[(usize, Vec<String>)], place: usize, has_decimal_comma: bool) -> Option<char> {
    fn cells(rows: &[(usize, Vec<String>)], place: usize) -> impl Iterator<Item = &str> {
        rows.iter().filter_map(move |(_, cells)| cells.get(place)).map(String::as_str)
    }
    let certain_sign = cells(rows, place).find_map(|cell| certain(cell, has_decimal_comma));
    certain_sign.or_else(|| [',', '.'].into_iter().find(|sign| is_of_whole(cells(rows, place), *sign)))
}

/// Whether the cells are whole numbers up to 999, and behind them `1,000`: decimals have a sign in nearly every cell, and
/// not three digits behind each.
fn is_of_whole<'c>(cells: impl Iterator<Item = &'c str>, sign: char) -> bool {
    let (mut whole, mut groups) = (Vec::new(), 0usize);
    for cell in cells {
        let digits = cell.strip_prefix(['+', '-', '\u{2212}']).unwrap_or(cell);
        if has_groups(cell, sign, NO_SIGN) {
            groups += 1;
        } else if let Ok(number) = digits.parse::<u64>() {
            // Four digits in a row, where thousands are not parted.
            if number >= 1000 {
                return false;
            }
            if number > 0 && !whole.contains(&number) && (whole.len() < WHOLE || number >= 100) {
                whole.push(number);
            }
        } else if digits.contains([',', '.']) && digits.starts_with(|first: char| first.is_ascii_digit()) {
            return false;
        }
    }
    groups > 0 && whole.len() >= WHOLE && whole.iter().any(|number| *number >= 100)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn joined(cells: &[&str], has_decimal_comma: bool) -> Vec<String> {
        let mut rows: Vec<(usize, Vec<String>)> =
            cells.iter().enumerate().map(|(line, cell)| (line, vec![(*cell).to_owned()])).collect();
        join(&mut rows, has_decimal_comma);
        rows.into_iter().flat_map(|(_, cells)| cells).collect()
    }

    #[test]
    fn thousands_are_told_from_decimals_by_their_column() {
        for (cells, has_decimal_comma, right) in [
            (["998.1", "1,003.5", "-1,200", "1,234,567.0"], false, ["998.1", "1003.5", "-1200", "1234567.0"]),
            (["998,1", "1.003,5", "-1.200", "0,5"], true, ["998,1", "1003,5", "-1200", "0,5"]),
            (["998.1", "1'003.5", "2", "12'000"], false, ["998.1", "1003.5", "2", "12000"]),
            (["998,1", "1\u{a0}003,5", "2", "3"], true, ["998,1", "1003,5", "2", "3"]),
            (["998,1", "1\u{2009}003,5", "2", "3"], true, ["998,1", "1003,5", "2", "3"]),
            // Whole numbers, and thousands behind them.
            (["12", "655", "999", "1,203"], true, ["12", "655", "999", "1203"]),
            (["12", "655", "999", "1.203"], false, ["12", "655", "999", "1203"]),
            (["1", "2", "3", "1.203"], false, ["1", "2", "3", "1.203"]),
            // Decimal commas: every number has one, or one has another count of digits, or a number is 0 elsewhere.
            (["12,395", "12,396", "13,601", "9,998"], true, ["12,395", "12,396", "13,601", "9,998"]),
            (["12", "13", "14", "1,25"], true, ["12", "13", "14", "1,25"]),
            (["0", "0", "0", "1,203"], true, ["0", "0", "0", "1,203"]),
            (["1200", "655", "999", "1,203"], true, ["1200", "655", "999", "1,203"]),
            (["0.5", "1.5", "12,395", "2.5"], false, ["0.5", "1.5", "12,395", "2.5"]),
        ] {
            assert_eq!(joined(&cells, has_decimal_comma), right, "{cells:?}");
        }
    }
}
