//! The cells of a file as text, from CSV in any encoding and with any separator, or from a sheet of a workbook.

use super::cells::Number;
use super::forms::other_form;
use super::{TableError, thousands};
use std::fs;
use std::path::{Path, PathBuf};

/// Largest file.
const MAX_BYTES: u64 = 1 << 30;
/// Lines from which separator and decimal sign are found.
const SAMPLE: usize = 400;
/// Lines behind the first one that a cell in quotation marks may have.
const NAME_LINES: usize = 4;
/// Separators that are tried; a blank stands for any number of them.
pub(super) const SEPARATORS: [(char, &str); 5] =
    [(',', "commas"), (';', "semicolons"), ('\t', "tabulators"), ('|', "vertical bars"), (' ', "blanks")];

/// Formats that are no tables of text, by their endings, and how a file becomes one that is read.
const CONVERTED: [(&[&str], &str, &str); 8] = [
    (
        &["parquet"],
        "a file of Parquet",
        "CSV, in Python: pandas.read_parquet('run.parquet').to_csv('run.csv', index=False)",
    ),
    (
        &["feather", "arrow"],
        "a file of Arrow",
        "CSV, in Python: pandas.read_feather('run.feather').to_csv('run.csv', index=False)",
    ),
    (
        &["h5", "hdf5", "hdf"],
        "a file of HDF5",
        "CSV, in Python: import h5py, pandas; pandas.DataFrame({k: v[()].ravel() for k, v in h5py.File('run.h5').items()}).to_csv('run.csv')",
    ),
    (
        &["npy", "npz"],
        "arrays of NumPy",
        "CSV, in Python: numpy.savetxt('run.csv', numpy.load('run.npy'), delimiter=',', header='t,x,f', comments='')",
    ),
    (
        &["tdms"],
        "a file of LabVIEW (TDMS)",
        "CSV, in Python: nptdms.TdmsFile('run.tdms').as_dataframe().to_csv('run.csv')",
    ),
    (
        &["db3"],
        "a bag of ROS 2 in SQLite",
        "MCAP: rosbags-convert --src BAG --dst RUN --dst-storage mcap (pip install rosbags), or ros2 bag convert",
    ),
    (
        &["bag"],
        "a bag of ROS 1",
        "MCAP of ROS 2: rosbags-convert --src run.bag --dst RUN --dst-storage mcap (pip install rosbags)",
    ),
    (
        &["gz", "zst", "zstd", "xz", "bz2", "zip", "7z", "rar"],
        "a compressed file",
        "the file in it: unpack it first",
    ),
];

/// The error for a file of a format that is no table, by its ending: how it becomes one.
pub fn of_other_format(path: &Path) -> Option<TableError> {
    let ending = path.extension()?.to_string_lossy().to_lowercase();
    let (_, problem, expected) = CONVERTED.iter().find(|(endings, ..)| endings.contains(&ending.as_str()))?;
    Some(TableError::File {
        path: path.to_owned(),
        problem: (*problem).to_owned(),
        expected: (*expected).to_owned(),
    })
}

/// A file's cells.
#[derive(Debug, Clone, PartialEq)]
pub struct Grid {
    /// The file, with the sheet behind `#` where it is a workbook.
    pub path: PathBuf,
    /// Its lines that are not empty: number of the line, from 1, and cells.
    pub rows: Vec<(usize, Vec<String>)>,
    /// Whether numbers have a decimal comma.
    pub has_decimal_comma: bool,
    /// Encoding and separator, for people.
    pub form: String,
    /// Whether the last line has no end, as that of a file that is cut off.
    pub is_cut: bool,
    /// Rows of a sheet that are none of its rows here, as they are hidden there.
    pub left_out: Vec<usize>,
    /// Remarks on such rows.
    pub notes: Vec<String>,
    /// Lines that are numbers alone in another form than the rows' own, and that form.
    pub of_other_form: Vec<(usize, String)>,
}

impl Grid {
    /// Reads a file; `book.xlsx#Sheet` is a sheet of a workbook, the first one where none is named.
    ///
    /// # Errors
    /// [`TableError`].
    pub fn read(path: &Path) -> Result<Self, TableError> {
        let (file, sheet) = split_sheet(path);
        let extension = file.extension().map(|extension| extension.to_string_lossy().to_lowercase());
        if matches!(extension.as_deref(), Some("xlsx" | "xlsm" | "xlsb" | "xls" | "ods")) {
            #[cfg(feature = "excel")]
            return super::excel::read(&file, sheet.as_deref());
            #[cfg(not(feature = "excel"))]
            return Err(TableError::File {
                path: file,
                problem: format!(
                    "a workbook{}",
                    sheet.map_or_else(String::new, |sheet| format!(", sheet {sheet}"))
                ),
                expected: "CSV: this program was built without workbooks (its feature `excel`)".to_owned(),
            });
        }
        if let Some(error) = of_other_format(&file) {
            return Err(error);
        }
        let size = fs::metadata(path).map_err(|cause| TableError::io(path, cause))?.len();
        if size > MAX_BYTES {
            let (problem, expected) = (format!("{size} bytes"), format!("at most {MAX_BYTES}"));
            return Err(TableError::File { path: path.to_owned(), problem, expected });
        }
        Self::parse(path, &fs::read(path).map_err(|cause| TableError::io(path, cause))?)
    }

    /// As [`Self::read`], from bytes that were found in this file.
    ///
    /// # Errors
    /// [`TableError`].
    pub fn parse(path: &Path, bytes: &[u8]) -> Result<Self, TableError> {
        // A logger that loses its power leaves zeros behind the last line.
        let end = bytes.iter().rposition(|byte| *byte != 0).map_or(0, |at| at + 1);
        let (mut text, encoding) = decoded(bytes, end);
        // Lines that end with a carriage return alone, as some spreadsheets still write them.
        if !text.contains('\n') {
            text = text.replace('\r', "\n");
        }
        if text.contains('\0') {
            let expected = "a table of text: CSV, or a workbook by its ending".to_owned();
            return Err(TableError::File {
                path: path.to_owned(),
                problem: "bytes that are no text".to_owned(),
                expected,
            });
        }
        let lines: Vec<&str> = text.lines().filter(|line| !line.trim().is_empty()).collect();
        // The middle of a file is its rows; preambles are at its beginning.
        let start = (lines.len() / 2).saturating_sub(SAMPLE / 2);
        let sample: Vec<&str> = lines.iter().skip(start).take(SAMPLE).copied().collect();
        let Some((separator, has_decimal_comma)) = separator(&sample) else {
            let middle = lines.get(lines.len() / 2).map_or("", |line| line.trim());
            let shown: String = middle.chars().take(60).collect();
            let problem = format!("no rows of two numbers or more: \"{shown}\" in the middle of the file");
            let expected =
                "columns of numbers between commas, semicolons, tabulators, bars or blanks".to_owned();
            return Err(TableError::File { path: path.to_owned(), problem, expected });
        };
        let (mut rows, mut of_other_form) = (Vec::new(), Vec::new());
        let mut lines = text.lines().enumerate();
        while let Some((number, line)) = lines.next() {
            // A name of two lines is in quotation marks that end in a later one.
            let next = (separator != ' ' && is_open(line))
                .then(|| lines.clone().take(NAME_LINES).position(|(_, next)| is_open(next)))
                .flatten();
            let mut line = line.to_owned();
            for (_, next) in lines.by_ref().take(next.map_or(0, |count| count + 1)) {
                line.push(' ');
                line.push_str(next);
            }
            if !line.trim().is_empty() {
                let cells = split(&line, separator);
                let form = other_form(&line, &cells, separator, has_decimal_comma);
                of_other_form.extend(form.map(|form| (number + 1, form)));
                rows.push((number + 1, cells));
            }
        }
        Ok(Self {
            path: path.to_owned(),
            rows,
            has_decimal_comma,
            form: format!("{encoding}, {}", form_of(separator, has_decimal_comma)),
            is_cut: !text.ends_with('\n'),
            left_out: Vec::new(),
            notes: Vec::new(),
            of_other_form,
        })
    }
}

/// Whether a quotation mark of a line has no other one.
fn is_open(line: &str) -> bool {
    line.matches('"').count() % 2 == 1
}

/// `book.xlsx#Sheet` as file and sheet; a file of that name is itself.
fn split_sheet(path: &Path) -> (PathBuf, Option<String>) {
    let text = path.to_string_lossy();
    match text.rsplit_once('#') {
        Some((file, sheet)) if !path.exists() && !sheet.is_empty() => {
            (PathBuf::from(file), Some(sheet.to_owned()))
        }
        _ => (path.to_owned(), None),
    }
}

/// Text of bytes, of which those behind `end` are zeros: UTF-16 by its mark or by the zeros beside its letters, UTF-8, else the encoding of Western Windows, of which every byte is a letter.
fn decoded(all_bytes: &[u8], end: usize) -> (String, &'static str) {
    fn wide(rest: &[u8], of: fn([u8; 2]) -> u16) -> String {
        let units = rest.as_chunks::<2>().0.iter().map(|pair| of(*pair));
        let text: String = char::decode_utf16(units).map(|letter| letter.unwrap_or('\u{fffd}')).collect();
        text.trim_start_matches('\u{feff}').to_owned()
    }
    // A zero may be half of the last letter of UTF-16.
    let bytes = all_bytes.get(..end.next_multiple_of(2).min(all_bytes.len())).unwrap_or_default();
    if let Some(letter) = byte_order_without_mark(bytes) {
        return (wide(bytes, letter), "UTF-16");
    }
    match bytes {
        [0xFF, 0xFE, rest @ ..] => (wide(rest, u16::from_le_bytes), "UTF-16"),
        [0xFE, 0xFF, rest @ ..] => (wide(rest, u16::from_be_bytes), "UTF-16"),
        _ => match str::from_utf8(all_bytes.get(..end).unwrap_or_default()) {
            Ok(text) => (text.trim_start_matches('\u{feff}').to_owned(), "UTF-8"),
            Err(_) => (all_bytes.iter().take(end).map(|byte| char::from(*byte)).collect(), "Latin-1"),
        },
    }
}

/// The byte order of UTF-16 without a mark: nearly every letter of a table has a zero on the same side.
fn byte_order_without_mark(bytes: &[u8]) -> Option<fn([u8; 2]) -> u16> {
    let pairs = bytes.as_chunks::<2>().0;
    fn is_most_zero(pairs: &[[u8; 2]], side: usize) -> bool {
        let count = pairs.iter().filter(|pair| pair[side] == 0 && pair[1 - side] != 0).count();
        10 * count > 9 * pairs.len() && count > 0
    }
    if is_most_zero(pairs, 1) {
        Some(u16::from_le_bytes)
    } else if is_most_zero(pairs, 0) {
        Some(u16::from_be_bytes)
    } else {
        None
    }
}

/// The separator and whether numbers have a decimal comma: the reading in which most cells are numbers.
fn separator(sample: &[&str]) -> Option<(char, bool)> {
    let mut best: Option<(f64, usize, (char, bool))> = None;
    for (separator, _) in SEPARATORS {
        for has_decimal_comma in [false, true] {
            if separator == ',' && has_decimal_comma && !sample.iter().any(|line| line.contains('"')) {
                continue;
            }
            let (mut cells, mut numbers, mut lines) = (0usize, 0usize, 0usize);
            let mut rows: Vec<(usize, Vec<String>)> =
                sample.iter().map(|line| (0, split(line, separator))).collect();
            thousands::join(&mut rows, has_decimal_comma);
            for (_, split_cells) in &rows {
                let number_count =
                    split_cells.iter().filter(|cell| Number::is_one(cell, has_decimal_comma)).count();
                let filled = split_cells.iter().filter(|cell| !cell.is_empty()).count();
                cells += filled;
                if number_count >= 2 {
                    numbers += number_count;
                    lines += 1;
                }
            }
            if lines == 0 {
                continue;
            }
            let numeric_fraction = numbers as f64 / cells as f64;
            // The convention that reads most cells as numbers is chosen; decimal points first.
            if best.is_none_or(|(most, count, _)| {
                numeric_fraction > most + 1e-9 || (numeric_fraction - most).abs() <= 1e-9 && numbers > count
            }) {
                best = Some((numeric_fraction, numbers, (separator, has_decimal_comma)));
            }
        }
    }
    best.map(|(.., found)| found)
}

/// Separator and decimal sign, for people.
pub(super) fn form_of(separator: char, has_decimal_comma: bool) -> String {
    let words = SEPARATORS.iter().find(|(of, _)| *of == separator).map_or("", |(_, words)| words);
    let decimal = if has_decimal_comma { "decimal commas" } else { "decimal points" };
    format!("{words}, {decimal}")
}

/// Cells of a line, without blanks and quotation marks around them.
pub(super) fn split(line: &str, separator: char) -> Vec<String> {
    if separator == ' ' {
        return line.split_whitespace().map(|cell| cell.trim_matches('"').to_owned()).collect();
    }
    let mut cells = vec![String::new()];
    let mut is_quoted = false;
    for letter in line.chars() {
        match letter {
            '"' => is_quoted = !is_quoted,
            letter if letter == separator && !is_quoted => cells.push(String::new()),
            letter => cells.iter_mut().next_back().into_iter().for_each(|cell| cell.push(letter)),
        }
    }
    cells.into_iter().map(|cell| cell.trim().to_owned()).collect()
}
