//! Columns in which an instrument states whether its readings can be used.

/// Names of columns with a word for each row.
const OF_WORDS: [&str; 8] = ["status", "state", "valid", "validity", "quality", "flag", "ok", "isvalid"];
/// Names of columns that are 1 for a reading that can be used, and 0 for another.
const OF_ONE: [&str; 3] = ["valid", "ok", "isvalid"];
/// Names of columns that are 0 for a reading that can be used, and another whole number for one that cannot.
const OF_FAULT: [&str; 15] = [
    "fault",
    "faults",
    "alarm",
    "error",
    "errors",
    "err",
    "errorcode",
    "invalid",
    "bad",
    "overload",
    "overrange",
    "saturated",
    "outlier",
    "lost",
    "missing",
];
/// Words for readings that can be used.
const GOOD: [&str; 11] =
    ["ok", "valid", "good", "true", "yes", "y", "no error", "none", "running", "normal", "pass"];
/// Words in those for readings that cannot.
const BAD: [&str; 18] = [
    "invalid",
    "missing",
    "out of",
    "out_of",
    "over",
    "under",
    "err",
    "fault",
    "fail",
    "bad",
    "lost",
    "saturat",
    "disabled",
    "not ok",
    "not_ok",
    "nok",
    "not valid",
    "not_valid",
];
/// Words that are named at most: a column of remarks has many.
const NAMED: usize = 4;

/// Statement of a cell about its row.
enum Statement {
    Good,
    Bad,
    Unknown,
}

/// Rows that a column marks as unusable, and words in it whose meaning is not known.
#[derive(Debug, Default, PartialEq)]
pub(super) struct Marked {
    /// Places of the rows.
    pub rows: Vec<usize>,
    /// Words for them.
    pub words: Vec<String>,
    /// Words of which neither is known.
    pub unknown: Vec<String>,
}

/// Whether a column of this name is one of states.
pub(super) fn is_status(header: &str) -> bool {
    is_one_of(header, &OF_WORDS) || is_one_of(header, &OF_FAULT)
}

/// Rows that the cells of a column of states mark.
pub(super) fn marked<'c>(header: &str, cells: impl Iterator<Item = &'c str>) -> Marked {
    let mut marked = Marked::default();
    let cells: Vec<&str> = cells.collect();
    // A deviation is an error too, and none of the instrument.
    if is_one_of(header, &OF_FAULT) && cells.iter().any(|cell| cell.contains(['.', ','])) {
        return marked;
    }
    for (row, cell) in cells.into_iter().enumerate() {
        let list = match statement(header, cell.trim()) {
            Statement::Good => continue,
            Statement::Bad => {
                marked.rows.push(row);
                &mut marked.words
            }
            Statement::Unknown => &mut marked.unknown,
        };
        if list.len() < NAMED && !list.iter().any(|word| word == cell) {
            list.push(cell.to_owned());
        }
    }
    marked
}

fn statement(header: &str, cell: &str) -> Statement {
    let word = cell.to_lowercase();
    if is_one_of(header, &OF_ONE) && matches!(word.as_str(), "0" | "false" | "no" | "n") {
        return Statement::Bad;
    }
    if is_one_of(header, &OF_FAULT) {
        match word.trim_start_matches("0x").parse::<i64>() {
            Ok(0) => return Statement::Good,
            Ok(_) => return Statement::Bad,
            Err(_) if matches!(word.as_str(), "false" | "no" | "n") => return Statement::Good,
            Err(_) if matches!(word.as_str(), "true" | "yes" | "y") => return Statement::Bad,
            Err(_) => {}
        }
    }
    if word.is_empty() || GOOD.contains(&word.as_str()) || is_one_of(header, &OF_ONE) && word == "1" {
        return Statement::Good;
    }
    let is_bad = BAD.iter().any(|bad| word.starts_with(bad));
    if is_bad { Statement::Bad } else { Statement::Unknown }
}

fn is_one_of(header: &str, names: &[&str]) -> bool {
    let plain: String = header.to_lowercase().chars().filter(|letter| letter.is_alphanumeric()).collect();
    let last = header.to_lowercase();
    let last = last.rsplit(|letter: char| !letter.is_alphanumeric()).next().unwrap_or_default();
    names.contains(&plain.as_str()) || names.contains(&last)
}
