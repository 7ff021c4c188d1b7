//! Needle shapes as shape-sensing fibres give them: one pose per line, base first, in steps of half a millimetre of arc length.
//!
//! A line has a position (3 numbers), a position and a quaternion (7), or a matrix, row by row or column by column (12 or 16, see
//! [`super::matrices`]); commas, semicolons, tabs or spaces part them, and decimal commas are read where something else does. A header
//! may name the columns; then `x`, `y` and `z` are read, with their unit where it is stated (`x_mm`, `x [m]`, `pose.position.x`).

use super::frame::NeedlePoints;
use super::matrices::{MATRIX, Matrices};
use crate::document::{Place, Problem, SessionError, read_foreign_text};
use std::path::Path;

/// Lengths in a file.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum LengthUnit {
    /// Millimetres.
    Millimetres,
    /// Metres.
    Metres,
}

impl LengthUnit {
    /// Metres in one of it.
    fn to_m(self) -> f64 {
        match self {
            Self::Millimetres => 1e-3,
            Self::Metres => 1.0,
        }
    }
}

/// Units in headers with the metres in one of them.
const UNITS: [(&str, f64); 6] =
    [("mm", 1e-3), ("um", 1e-6), ("\u{b5}m", 1e-6), ("\u{3bc}m", 1e-6), ("cm", 1e-2), ("m", 1.0)];
/// No needle is longer than this many metres, nor shorter than this many millimetres: that distinguishes the units.
const LONGEST: f64 = 2.0;
/// No shape is shorter than this, metres.
const SHORTEST_M: f64 = 5e-3;
/// A step so many times the usual one, and this long, metres, is a jump: a row is missing, or misread.
const JUMP_TIMES: f64 = 10.0;
const JUMP_M: f64 = 5e-3;
/// Largest difference of a quaternion's length from 1.
const ROUNDING: f64 = 1e-2;
const WIDTHS: &str = "3 (x y z), 7 (with a quaternion), 12 or 16 numbers (a matrix)";

/// A number's text and where it starts in its line.
type Cell<'t> = (usize, &'t str);

/// Columns of the position in a line.
enum Layout {
    Positions([usize; 3]),
    /// By the number of numbers.
    Plain,
}

/// Reads a list of poses; without a unit it is inferred from the needle's length, and noted.
///
/// # Errors
/// [`SessionError`] with file, line and column.
pub fn poses(path: &Path, unit: Option<LengthUnit>) -> Result<NeedlePoints, SessionError> {
    let text = read_foreign_text(path)?;
    let fault = |offset: usize, field: &str, problem, expected: &str| SessionError::Field {
        place: Place::at(path, &text, offset),
        field: field.to_owned(),
        problem,
        expected: expected.to_owned(),
    };
    let mut layout = None;
    let mut matrices = Matrices::default();
    let mut header_to_m = None;
    let (mut width, mut missing, mut is_below_header) = (None, 0, false);
    // Each point with the offset of its line.
    let mut located: Vec<(usize, [f64; 3])> = Vec::new();
    let mut start = 0;
    for line in text.split_inclusive('\n') {
        let offset = start;
        start += line.len();
        let line = line.trim_end();
        if line.trim().is_empty() || line.trim_start().starts_with(['#', '%']) {
            continue;
        }
        let cells = cells(line);
        if layout.is_none()
            && let Some((named, stated)) = header(&cells)
        {
            let columns = named.ok_or_else(|| {
                let problem = Problem::Syntax("no columns of a position".to_owned());
                fault(offset, "header", problem, "columns x, y and z in one unit, or lines of numbers alone")
            })?;
            (layout, header_to_m) = (Some(Layout::Positions(columns)), stated);
            width = Some(cells.len());
            is_below_header = true;
            continue;
        }
        // Units in a line of their own.
        if std::mem::take(&mut is_below_header)
            && header_to_m.is_none()
            && let Some(Layout::Positions(columns)) = &layout
            && let Some(metres) = unit_below(&cells, *columns)
        {
            header_to_m = Some(metres);
            continue;
        }
        let mut numbers = Vec::with_capacity(cells.len());
        for (at, cell) in &cells {
            let cell = &cell.trim_matches(['"', '\'']);
            let is_decimal_comma = cell.contains(',') && !cell.contains('.');
            let number: Option<f64> =
                if is_decimal_comma { cell.replacen(',', ".", 1).parse().ok() } else { cell.parse().ok() };
            let problem = match number {
                // A row without a reading.
                Some(number) if number.is_finite() || number.is_nan() => {
                    numbers.push(number);
                    continue;
                }
                Some(_) => Problem::NotFinite,
                None if cell.is_empty() => Problem::Empty,
                // Columns that are not read may hold words.
                None if matches!(&layout, Some(Layout::Positions(columns)) if !columns.contains(&numbers.len())) =>
                {
                    numbers.push(f64::NAN);
                    continue;
                }
                None => Problem::NotANumber(cell.chars().take(40).collect()),
            };
            return Err(fault(offset + at, "pose", problem, "a number"));
        }
        let count = numbers.len();
        if width.is_some_and(|width| width != count) {
            let expected = format!("{} on every line as before", width.unwrap_or_default());
            return Err(fault(offset, "pose", numbers_there(count), &expected));
        }
        width = Some(count);
        let layout = layout.get_or_insert(Layout::Plain);
        let is_missing = match layout {
            Layout::Positions(columns) => {
                columns.iter().any(|column| numbers.get(*column).is_some_and(|number| number.is_nan()))
            }
            Layout::Plain => numbers.iter().any(|number| number.is_nan()),
        };
        if is_missing {
            missing += 1;
            continue;
        }
        let position = match layout {
            Layout::Positions(columns) => pick(&numbers, *columns),
            Layout::Plain => {
                let position = plain(&numbers, &mut matrices);
                position.map_err(|(problem, expected)| fault(offset, "pose", problem, &expected))?
            }
        };
        located.extend(position.map(|position| (offset, position)));
    }
    let end = text.len();
    if let Some(order) =
        matrices.order().map_err(|ambiguous| fault(0, "pose", Problem::Syntax(ambiguous), ORDER))?
    {
        located
            .iter_mut()
            .zip(matrices.positions(order))
            .for_each(|((_, point), position)| *point = position);
    }
    if located.len() < 2 {
        let problem =
            Problem::Syntax(format!("{} in the file", if located.is_empty() { "none" } else { "one" }));
        return Err(fault(end, "pose", problem, "two poses or more"));
    }

    let steps: Vec<f64> =
        located.iter().zip(located.iter().skip(1)).map(|((_, a), (_, b))| distance(*a, *b)).collect();
    let length: f64 = steps.iter().sum();
    let mut notes = Vec::new();
    if missing > 0 {
        notes.push(format!("{}: {missing} rows without numbers (nan) are skipped", path.display()));
    }
    if let Some((option_to_m, header)) =
        unit.map(LengthUnit::to_m).zip(header_to_m).filter(|(option, header)| option != header)
    {
        notes.push(format!(
            "{}: the header states lengths in units of {} mm, and those of --units, {} mm, are taken",
            path.display(),
            1e3 * header,
            1e3 * option_to_m
        ));
    }
    let stated_to_m = unit.map(LengthUnit::to_m).or(header_to_m);
    let to_metres = stated_to_m.unwrap_or_else(|| {
        let (unit, name) = if length > LONGEST {
            (LengthUnit::Millimetres, "millimetres")
        } else {
            (LengthUnit::Metres, "metres")
        };
        notes.push(format!("{}: taken as {name}, of which the needle is {length:.3} long", path.display()));
        unit.to_m()
    });
    let length_m = to_metres * length;
    if !(SHORTEST_M..=LONGEST).contains(&length_m) {
        let expected =
            format!("a needle {} to {} mm long: is the unit right?", 1e3 * SHORTEST_M, 1e3 * LONGEST);
        return Err(fault(
            0,
            "pose",
            Problem::Syntax(format!("a needle {:.3} mm long", 1e3 * length_m)),
            &expected,
        ));
    }
    let mut sorted = steps.clone();
    sorted.sort_by(f64::total_cmp);
    let usual = sorted.get(sorted.len() / 2).copied().unwrap_or_default();
    let jump = steps.iter().position(|step| *step > JUMP_TIMES * usual && to_metres * step > JUMP_M);
    if let Some((index, (offset, _))) = jump.and_then(|index| Some((index, located.get(index + 1)?))) {
        let step_mm = 1e3 * to_metres * steps.get(index).copied().unwrap_or_default();
        let problem = Problem::Syntax(format!("{step_mm:.2} mm from the pose before"));
        return Err(fault(
            *offset,
            "pose",
            problem,
            &format!("about {:.2} mm as elsewhere", 1e3 * to_metres * usual),
        ));
    }
    let points_m = located.into_iter().map(|(_, point)| point.map(|value| to_metres * value)).collect();
    Ok(NeedlePoints { path: path.to_owned(), points_m, notes })
}

/// The cells of a line: between commas or semicolons where there are any, else between spaces.
fn cells(line: &str) -> Vec<Cell<'_>> {
    // A comma beside another separator is a decimal one; in quotation marks, too.
    let bare: String = line.split('"').step_by(2).collect();
    // Names and words may have blanks in them.
    let has_words = line.chars().any(char::is_alphabetic);
    let tabulator = Some('\t').filter(|separator| has_words && bare.contains(*separator));
    let separator = tabulator.or_else(|| [';', ','].into_iter().find(|separator| bare.contains(*separator)));
    let separator = separator.filter(|separator| *separator != ',' || !decimal_commas(line));
    let mut start = 0;
    let mut is_quoted = false;
    let mut parts_at = |c: char| {
        is_quoted ^= c == '"';
        Some(c) == separator && !is_quoted
    };
    let cells: Vec<Cell<'_>> = match separator {
        Some(_) => line
            .split(&mut parts_at)
            .map(|cell| {
                let column = start + (cell.len() - cell.trim_start().len());
                start += cell.len() + 1;
                (column, cell.trim())
            })
            .collect(),
        None => line
            .split(char::is_whitespace)
            .map(|cell| {
                let column = start;
                // Every white space is of one to three bytes; the next cell is found, not counted.
                start += cell.len()
                    + line
                        .get(start + cell.len()..)
                        .and_then(|rest| rest.chars().next())
                        .map_or(0, char::len_utf8);
                (column, cell)
            })
            .filter(|(_, cell)| !cell.is_empty())
            .collect(),
    };
    cells
}

/// Whether every word of a line is a number with one comma: "1,5 2,25 3,0" are three numbers.
fn decimal_commas(line: &str) -> bool {
    line.split_whitespace().count() > 1
        && line.split_whitespace().all(|word| {
            fn digits(part: &str) -> bool {
                !part.is_empty() && part.bytes().all(|b| b.is_ascii_digit())
            }
            let whole_and_rest = word.trim_start_matches(['-', '+']).split_once(',');
            whole_and_rest.is_some_and(|(whole, rest)| digits(whole) && digits(rest))
        })
}

/// Evidence for the order of numbers.
const ORDER: &str = "matrices whose rotation part shows whether they are row by row or column by column; or columns x, y and z";

/// Columns of a header (none where it has no position) and the unit that it states; `None` where this is no header.
fn header(cells: &[Cell<'_>]) -> Option<(Option<[usize; 3]>, Option<f64>)> {
    fn is_word(cell: &str) -> bool {
        cell.parse::<f64>().is_err() && cell.chars().any(char::is_alphabetic)
    }
    if !cells.iter().any(|(_, cell)| is_word(cell))
        || cells.iter().any(|(_, cell)| cell.parse::<f64>().is_ok())
    {
        return None;
    }
    let names: Vec<(String, Option<f64>)> = cells.iter().map(|(_, cell)| name(cell)).collect();
    let column = |axis: &str| {
        names.iter().position(|(name, _)| name == axis).or_else(|| {
            let endings = [format!("position.{axis}"), format!("position_{axis}")];
            names.iter().position(|(name, _)| endings.iter().any(|ending| name.ends_with(ending.as_str())))
        })
    };
    let columns = match (column("x"), column("y"), column("z")) {
        (Some(x), Some(y), Some(z)) => Some([x, y, z]),
        _ => None,
    };
    let unit_of = |column: usize| names.get(column).and_then(|(_, to_m)| *to_m);
    // Coordinates of two units are no position.
    let columns = columns.filter(|[x, y, z]| [*y, *z].into_iter().all(|axis| unit_of(axis) == unit_of(*x)));
    Some((columns, columns.and_then(|[x, ..]| unit_of(x))))
}

/// The one unit that a line below the header states of the position's columns.
fn unit_below(cells: &[Cell<'_>], columns: [usize; 3]) -> Option<f64> {
    let [x, y, z] = columns.map(|column| {
        let (_, cell) = cells.get(column)?;
        let plain = cell.trim_matches(['"', '\'', '[', ']', '(', ')', ' ']).to_lowercase();
        UNITS.iter().find(|(unit, _)| plain == *unit).map(|(_, to_m)| *to_m)
    });
    x.filter(|_| x == y && y == z)
}

/// A column's name without its unit, and the metres in one of it.
fn name(cell: &str) -> (String, Option<f64>) {
    let plain = cell.trim_matches(['"', '\'']).to_lowercase();
    for (unit, to_m) in UNITS {
        for ending in [format!("_{unit}"), format!("[{unit}]"), format!("({unit})")] {
            if let Some(name) = plain.strip_suffix(ending.as_str()) {
                return (name.trim().to_owned(), Some(to_m));
            }
        }
    }
    (plain, None)
}

/// The position in a line without a header; that of a matrix counts when the order of all is known.
fn plain(numbers: &[f64], matrices: &mut Matrices) -> Result<Option<[f64; 3]>, (Problem, String)> {
    match numbers.len() {
        3 => Ok(pick(numbers, [0, 1, 2])),
        7 => {
            let square: f64 = numbers.iter().skip(3).map(|number| number * number).sum();
            if (square - 1.0).abs() > 2.0 * ROUNDING {
                let length = square.sqrt();
                return Err((
                    Problem::Syntax(format!("a quaternion of length {length:.3}")),
                    "one of length 1 after x y z".to_owned(),
                ));
            }
            Ok(pick(numbers, [0, 1, 2]))
        }
        12 | 16 => match matrices.add(numbers) {
            Ok(()) => Ok(Some([0.0; 3])),
            Err(problem) => Err((Problem::Syntax(problem), MATRIX.to_owned())),
        },
        count => Err((numbers_there(count), WIDTHS.to_owned())),
    }
}

fn numbers_there(count: usize) -> Problem {
    Problem::Syntax(format!("{count} number{}", if count == 1 { "" } else { "s" }))
}

fn pick(numbers: &[f64], columns: [usize; 3]) -> Option<[f64; 3]> {
    let [x, y, z] = columns.map(|column| numbers.get(column).copied());
    Some([x?, y?, z?])
}

fn distance(a: [f64; 3], b: [f64; 3]) -> f64 {
    a.iter().zip(b).map(|(a, b)| (a - b).powi(2)).sum::<f64>().sqrt()
}
