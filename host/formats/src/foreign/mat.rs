//! Files of MATLAB up to version 7 (MAT-file level 5), also those that Octave and SciPy write: numeric arrays, and those in structures.
//!
//! Arrays of one length are a table; a matrix is a column for each of its shorter side. The only library that reads these files without
//! C states that it is of alpha quality, and decompresses without a bound. The layout is that of "MAT-File Format" by The MathWorks.

use super::unit::split_name;
use super::{RawColumn, RawTable, TableError, WordColumn, status};
use flate2::read::ZlibDecoder;
use std::collections::BTreeMap;
use std::fs;
use std::io::Read;
use std::path::{Path, PathBuf};

/// Largest file, and most bytes of it once it is decompressed.
const MAX_BYTES: usize = 512 << 20;
/// Columns of one matrix, and of all.
const MAX_WIDTH: usize = 64;
const MAX_COLUMNS: usize = 1024;
/// Structures within structures.
const MAX_DEPTH: usize = 4;
/// Length of the header; order of bytes and version are at its end.
const HEADER: usize = 128;
/// Beginning of files of version 7.3, which are HDF5 behind the same header.
const HDF5: &[u8] = b"\x89HDF\r\n\x1a\n";
/// Types of elements.
const MATRIX: u32 = 14;
const COMPRESSED: u32 = 15;
/// Classes of arrays.
const STRUCTURE: u8 = 2;
const NUMERIC: std::ops::RangeInclusive<u8> = 6..=15;

/// Alternative to a file that is not read.
const EXPECTED: &str = "a file of version 7 or older: save('run.mat', ..., '-v7') in MATLAB; or CSV, in Python from version 7.3: \
    import h5py, pandas; pandas.DataFrame({k: v[()].ravel() for k, v in h5py.File('run.mat').items() if v.dtype.kind in 'fiu'}).to_csv('run.csv')";

/// An array: its name, sides and values by columns.
struct Array {
    name: String,
    sides: [usize; 2],
    values: Vec<f64>,
}

/// Reads the arrays of a file.
pub(super) fn read(path: &Path) -> Result<Vec<RawTable>, TableError> {
    fn fault(problem: String, expected: &str, path: &Path) -> TableError {
        TableError::File { path: path.to_owned(), problem, expected: expected.to_owned() }
    }
    let size = fs::metadata(path).map_err(|cause| TableError::io(path, cause))?.len();
    if size > MAX_BYTES as u64 {
        return Err(fault(format!("{size} bytes"), "at most 512 MiB, or CSV", path));
    }
    let bytes = fs::read(path).map_err(|cause| TableError::io(path, cause))?;
    let (header, body) = bytes
        .split_at_checked(HEADER)
        .ok_or_else(|| fault("is shorter than a header".to_owned(), EXPECTED, path))?;
    let is_big = match header.get(HEADER - 2..) {
        Some(b"IM") => false,
        Some(b"MI") => true,
        _ => {
            return Err(fault(
                "is no file of MATLAB of version 5 to 7 (7.3 and 4 are others)".to_owned(),
                EXPECTED,
                path,
            ));
        }
    };
    let start = bytes.get(512..520).or(bytes.get(..8));
    if start == Some(HDF5) || header.starts_with(b"MATLAB 7.3") {
        return Err(fault("a file of MATLAB, version 7.3".to_owned(), EXPECTED, path));
    }
    let mut variables = Found { is_big, left: MAX_BYTES, arrays: Vec::new(), others: Vec::new() };
    let is_whole = variables.elements(body, false);
    let tables = variables.tables(path, is_whole);
    if tables.is_empty() {
        return Err(fault("no numeric arrays of two values or more".to_owned(), "columns of numbers", path));
    }
    Ok(tables)
}

/// Bytes from which fields are taken.
struct Cursor<'a> {
    bytes: &'a [u8],
    is_big: bool,
}

impl<'a> Cursor<'a> {
    fn take(&mut self, length: usize) -> Option<&'a [u8]> {
        let (head, tail) = self.bytes.split_at_checked(length)?;
        self.bytes = tail;
        Some(head)
    }

    fn u32(&mut self) -> Option<u32> {
        let bytes: [u8; 4] = self.take(4)?.try_into().ok()?;
        Some(if self.is_big { u32::from_be_bytes(bytes) } else { u32::from_le_bytes(bytes) })
    }

    /// The next element: its type and content. An element of at most four bytes may lie in the tag.
    fn element(&mut self) -> Option<(u32, &'a [u8])> {
        let tag = self.u32()?;
        let (kind, short) = (tag & 0xFFFF, (tag >> 16) as usize);
        if short > 0 {
            let content = self.take(4)?.get(..short)?;
            return Some((kind, content));
        }
        let size = usize::try_from(self.u32()?).ok()?;
        let content = self.take(size)?;
        if kind != COMPRESSED {
            // To the next multiple of eight; the last one of a file may end before.
            let padding = size.next_multiple_of(8) - size;
            let _ = self.take(padding.min(self.bytes.len()));
        }
        Some((kind, content))
    }

    /// The next element as whole numbers.
    fn integers(&mut self) -> Option<Vec<i64>> {
        let (kind, content) = self.element()?;
        numbers(kind, content, self.is_big)?.into_iter().map(|number| Some(number as i64)).collect()
    }
}

/// The numbers of an element.
fn numbers(kind: u32, content: &[u8], is_big: bool) -> Option<Vec<f64>> {
    fn each<const N: usize>(content: &[u8], is_big: bool, from: fn([u8; N]) -> f64) -> Vec<f64> {
        let chunks = content.as_chunks::<N>().0.iter().copied();
        chunks
            .map(|mut bytes| {
                if is_big {
                    bytes.reverse();
                }
                from(bytes)
            })
            .collect()
    }
    Some(match kind {
        1 => each(content, is_big, |b| f64::from(i8::from_le_bytes(b))),
        2 => each(content, is_big, |b| f64::from(u8::from_le_bytes(b))),
        3 => each(content, is_big, |b| f64::from(i16::from_le_bytes(b))),
        4 => each(content, is_big, |b| f64::from(u16::from_le_bytes(b))),
        5 => each(content, is_big, |b| f64::from(i32::from_le_bytes(b))),
        6 => each(content, is_big, |b| f64::from(u32::from_le_bytes(b))),
        7 => each(content, is_big, |b| f64::from(f32::from_le_bytes(b))),
        9 => each(content, is_big, f64::from_le_bytes),
        12 => each(content, is_big, |b| i64::from_le_bytes(b) as f64),
        13 => each(content, is_big, |b| u64::from_le_bytes(b) as f64),
        _ => return None,
    })
}

/// Variables of a file.
struct Found {
    is_big: bool,
    /// Bytes that may still be decompressed.
    left: usize,
    arrays: Vec<Array>,
    /// Names of what is no numeric array.
    others: Vec<String>,
}

impl Found {
    /// Reads elements up to the end; whether nothing was cut off or damaged.
    fn elements(&mut self, bytes: &[u8], is_packed: bool) -> bool {
        let mut cursor = Cursor { bytes, is_big: self.is_big };
        while !cursor.bytes.is_empty() {
            let is_read = match cursor.element() {
                Some((MATRIX, content)) => self.array(content, "", 0).is_some(),
                // Decompressed content holds no compressed element: it would have no end where it holds
                // itself.
                Some((COMPRESSED, content)) if !is_packed => {
                    let mut plain = Vec::new();
                    let limit = self.left as u64;
                    let read = ZlibDecoder::new(content).take(limit).read_to_end(&mut plain);
                    self.left = self.left.saturating_sub(plain.len());
                    read.is_ok() && self.left > 0 && self.elements(&plain, true)
                }
                // Something that later versions may have.
                Some(_) => true,
                None => false,
            };
            if !is_read {
                return false;
            }
        }
        true
    }

    /// Reads an array; its name is behind that of the structure that it belongs to.
    fn array(&mut self, content: &[u8], within: &str, depth: usize) -> Option<()> {
        // An empty field of a structure.
        if content.is_empty() {
            return Some(());
        }
        let mut cursor = Cursor { bytes: content, is_big: self.is_big };
        let flags = *cursor.integers()?.first()?;
        let (class, is_complex, is_logical) = ((flags & 0xFF) as u8, flags & 0x800 != 0, flags & 0x200 != 0);
        let sides = cursor.integers()?;
        let (_, name) = cursor.element()?;
        let name =
            String::from_utf8_lossy(name.split(|byte| *byte == 0).next().unwrap_or_default()).into_owned();
        let name = if within.is_empty() { name } else { within.to_owned() };
        if class == STRUCTURE && sides.iter().all(|side| *side == 1) && depth < MAX_DEPTH {
            let length = usize::try_from(*cursor.integers()?.first()?).ok().filter(|length| *length > 0)?;
            let (_, names) = cursor.element()?;
            for field in names.chunks(length) {
                let field = field.split(|byte| *byte == 0).next().unwrap_or_default();
                let full = format!("{name}.{}", String::from_utf8_lossy(field));
                let (MATRIX, content) = cursor.element()? else { return None };
                self.array(content, &full, depth + 1)?;
            }
            return Some(());
        }
        let sides: Option<[usize; 2]> = <[i64; 2]>::try_from(sides)
            .ok()
            .and_then(|[a, b]| Some([usize::try_from(a).ok()?, usize::try_from(b).ok()?]));
        // Of truth values those count that mark the rows which can be used.
        let is_number = !is_complex && (!is_logical || status::is_status(&name));
        let plain = sides.filter(|_| NUMERIC.contains(&class) && is_number);
        let Some(sides) = plain else {
            if self.others.len() < MAX_COLUMNS {
                self.others.push(name);
            }
            return Some(());
        };
        let (kind, content) = cursor.element()?;
        let values = numbers(kind, content, self.is_big)?;
        if Some(values.len()) != sides[0].checked_mul(sides[1]) {
            return None;
        }
        if values.len() > 1 && self.arrays.len() < MAX_COLUMNS {
            self.arrays.push(Array { name, sides, values });
        } else {
            self.others.push(name);
        }
        Some(())
    }

    /// A table for each length.
    fn tables(self, path: &Path, is_whole: bool) -> Vec<RawTable> {
        let mut by_rows: BTreeMap<usize, Vec<RawColumn>> = BTreeMap::new();
        let mut unreadable = self.others;
        for Array { name, sides: [high, wide], values } in self.arrays {
            let (rows, width) = (high.max(wide), high.min(wide));
            let columns = by_rows.entry(rows).or_default();
            if width > MAX_WIDTH || columns.len() + width > MAX_COLUMNS {
                unreadable.push(name);
                continue;
            }
            for at in 0..width {
                let (header, column): (String, Vec<f64>) = if width == 1 {
                    (name.clone(), values.clone())
                } else if high >= wide {
                    (
                        format!("{name}(:,{})", at + 1),
                        values.iter().skip(at * high).take(high).copied().collect(),
                    )
                } else {
                    (format!("{name}({},:)", at + 1), values.iter().skip(at).step_by(high).copied().collect())
                };
                columns.push(raw(header, columns.len() + 1, column));
            }
        }
        let is_one = by_rows.len() == 1;
        fn named(rows: usize, is_one: bool, path: &Path) -> PathBuf {
            if is_one { path.to_owned() } else { PathBuf::from(format!("{}#{rows}", path.display())) }
        }
        let mut tables: Vec<RawTable> = by_rows
            .into_iter()
            .filter(|(_, columns)| !columns.is_empty())
            .map(|(rows, columns)| RawTable {
                path: named(rows, is_one, path),
                form: "MATLAB".to_owned(),
                columns,
                words: Vec::new(),
                lines: (1..=rows).collect(),
                places: (0..rows).collect(),
                remarks: Vec::new(),
                stated_rate: None,
                notes: Vec::new(),
            })
            .collect();
        if let Some(first) = tables.first_mut() {
            first.words = unreadable.into_iter().map(WordColumn::named).collect();
            if !is_whole {
                first
                    .notes
                    .push("the file is cut off or damaged: arrays behind that place are missing".to_owned());
            }
        }
        tables.into_iter().map(RawTable::of_numbers).collect()
    }
}

/// A column without the whole part of its first value, so that the digits of times since 1970 are not lost.
fn raw(header: String, number: usize, values: Vec<f64>) -> RawColumn {
    let first = values.iter().copied().find(|value| value.is_finite()).unwrap_or(0.0).trunc();
    let origin = if first.abs() < 1e15 { first as i64 } else { 0 };
    let (name, unit) = split_name(&header);
    let has_values = values.iter().any(|value| value.is_finite());
    let values =
        values.into_iter().map(|value| if value.is_finite() { value - origin as f64 } else { f64::NAN });
    RawColumn {
        name,
        header,
        unit,
        unit_doubt: None,
        number,
        is_stamp: false,
        origin,
        values: values.collect(),
        bad: None,
        has_values,
    }
}

#[cfg(test)]
mod tests;
