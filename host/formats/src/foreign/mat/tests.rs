//! Files written field by field as the format states it, plain and compressed, in either order of bytes.

use super::*;
use crate::foreign::{Choice, Mapping, Options, Taken, take};
use flate2::Compression;
use flate2::write::ZlibEncoder;
use std::io::Write;

/// Writes elements.
struct Writer {
    bytes: Vec<u8>,
    is_big: bool,
}

impl Writer {
    fn new(is_big: bool) -> Self {
        Self { bytes: Vec::new(), is_big }
    }

    fn u32(&mut self, value: u32) {
        self.bytes.extend(if self.is_big { value.to_be_bytes() } else { value.to_le_bytes() });
    }

    /// An element; what is at most four bytes long stands in the tag, as MATLAB writes it.
    fn element(&mut self, kind: u32, content: &[u8]) {
        if (1..=4).contains(&content.len()) {
            self.u32((content.len() as u32) << 16 | kind);
            self.bytes.extend(content);
            self.bytes.extend(vec![0; 4 - content.len()]);
        } else {
            self.u32(kind);
            self.u32(content.len() as u32);
            self.bytes.extend(content);
            if kind != COMPRESSED {
                self.bytes.extend(vec![0; content.len().next_multiple_of(8) - content.len()]);
            }
        }
    }

    fn words(&self, values: &[u32]) -> Vec<u8> {
        values
            .iter()
            .flat_map(|value| if self.is_big { value.to_be_bytes() } else { value.to_le_bytes() })
            .collect()
    }
}

fn head(is_big: bool, class: u32, name: &str, sides: [u32; 2]) -> Writer {
    let mut writer = Writer::new(is_big);
    let (flags, sides) = (writer.words(&[class, 0]), writer.words(&sides));
    writer.element(6, &flags);
    writer.element(5, &sides);
    writer.element(1, name.as_bytes());
    writer
}

/// A matrix of doubles, by columns.
fn doubles(is_big: bool, name: &str, sides: [u32; 2], values: &[f64]) -> Vec<u8> {
    let mut writer = head(is_big, 6, name, sides);
    let content: Vec<u8> = values
        .iter()
        .flat_map(|value| if is_big { value.to_be_bytes() } else { value.to_le_bytes() })
        .collect();
    writer.element(9, &content);
    writer.bytes
}

/// A structure of one element.
fn structure(is_big: bool, name: &str, fields: &[(&str, Vec<u8>)]) -> Vec<u8> {
    let mut writer = head(is_big, 2, name, [1, 1]);
    let length = writer.words(&[8]);
    writer.element(5, &length);
    let names: Vec<u8> = fields
        .iter()
        .flat_map(|(name, _)| name.bytes().chain(std::iter::repeat(0)).take(8).collect::<Vec<u8>>())
        .collect();
    writer.element(1, &names);
    for (_, field) in fields {
        writer.element(MATRIX, field);
    }
    writer.bytes
}

fn file(is_big: bool, is_packed: bool, arrays: &[Vec<u8>]) -> Vec<u8> {
    let mut writer = Writer::new(is_big);
    let text = b"MATLAB 5.0 MAT-file, Platform: GLNXA64";
    writer.bytes.extend(text);
    writer.bytes.resize(HEADER - 4, b' ');
    writer.bytes.extend(if is_big { [1, 0, b'M', b'I'] } else { [0, 1, b'I', b'M'] });
    for array in arrays {
        if is_packed {
            let mut plain = Writer::new(is_big);
            plain.element(MATRIX, array);
            let mut encoder = ZlibEncoder::new(Vec::new(), Compression::default());
            encoder.write_all(&plain.bytes).expect("packs");
            writer.element(COMPRESSED, &encoder.finish().expect("packs"));
        } else {
            writer.element(MATRIX, array);
        }
    }
    writer.bytes
}

const ROWS: usize = 60;

fn truth(row: usize) -> [f64; 3] {
    let t = 0.05 * row as f64;
    let x = 1.2 * (t - 1.0).clamp(0.0, 1.0);
    [t, x, 2.5 * x + 0.01 * (0.9 * row as f64).sin()]
}

fn column(at: usize) -> Vec<f64> {
    (0..ROWS).map(|row| truth(row)[at]).collect()
}

fn read_bytes(bytes: &[u8]) -> Result<Vec<RawTable>, TableError> {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("run.mat");
    fs::write(&path, bytes).expect("written");
    RawTable::read(&path)
}

fn taken(bytes: &[u8], maps: [&str; 3]) -> Taken {
    let choices = maps.map(|map| Choice::parse(map).expect("a choice")).to_vec();
    let tables = read_bytes(bytes).expect("tables");
    take(&tables, &Mapping { choices }, &Options::default()).expect("a run")
}

fn assert_truth(name: &str, taken: &Taken) {
    let force = taken.force.as_ref().expect("a force");
    assert_eq!(force.time_s.len(), ROWS, "{name}");
    for row in 0..ROWS {
        let [t, x, f] = truth(row);
        let matches_row = (force.time_s[row] - t).abs() < 1e-6
            && (force.displacement_y_m[row] - 1e-3 * x).abs() < 1e-9
            && (force.force_y_n[row] - f).abs() < 1e-9;
        assert!(matches_row, "{name}: row {row}");
    }
}

#[test]
fn arrays_structures_and_matrices_hold_what_was_written() {
    for (is_big, is_packed) in [(false, false), (false, true), (true, false), (true, true)] {
        let name = format!("{is_big} {is_packed}");
        let (t, x, f) = (column(0), column(1), column(2));
        let mut note = head(is_big, 4, "note", [1, 3]);
        note.element(16, b"a b");
        // Vectors in either direction, times since 1970, a scalar and a text beside them.
        let since_1970: Vec<f64> = t.iter().map(|t| 1_764_000_000.0 + t).collect();
        let vectors = [
            doubles(is_big, "t", [ROWS as u32, 1], &since_1970),
            note.bytes,
            doubles(is_big, "disp", [1, ROWS as u32], &x),
            doubles(is_big, "rate", [1, 1], &[20.0]),
            doubles(is_big, "force_mN", [ROWS as u32, 1], &f.iter().map(|f| 1e3 * f).collect::<Vec<f64>>()),
        ];
        let result = taken(
            &file(is_big, is_packed, &vectors),
            ["t=time_s", "disp=displacement_y_mm:mm", "force_mN=force_y_n"],
        );
        assert_truth(&name, &result);
        assert!(result.others.iter().any(|other| other.ends_with("note, rate")), "{:?}", result.others);
        // A matrix by columns in a structure, one by rows beside it.
        let columns = [t.clone(), x.clone(), f.clone()].concat();
        let rows: Vec<f64> = (0..ROWS).flat_map(|row| truth(row)[..2].to_vec()).collect();
        let nested = structure(is_big, "data", &[("all", doubles(is_big, "", [ROWS as u32, 3], &columns))]);
        let arrays = [nested, doubles(is_big, "m", [2, ROWS as u32], &rows)];
        let bytes = file(is_big, is_packed, &arrays);
        let maps =
            ["data.all(:,1)=time_s:s", "data.all(:,2)=displacement_y_mm:mm", "data.all(:,3)=force_y_n:N"];
        assert_truth(&name, &taken(&bytes, maps));
        let maps = ["m(1,:)=time_s:s", "m(2,:)=displacement_y_mm:mm", "data.all(:,3)=force_y_n:N"];
        assert_truth(&name, &taken(&bytes, maps));
    }
}

#[test]
fn integers_and_arrays_of_other_lengths_are_told_apart() {
    let mut counts = head(false, 11, "counts", [4, 1]);
    let content: Vec<u8> = [1_u16, 2, 65_534, 4].iter().flat_map(|count| count.to_le_bytes()).collect();
    counts.element(4, &content);
    // MATLAB keeps doubles that are small whole numbers as bytes.
    let mut small = head(false, 6, "small", [1, 3]);
    small.element(2, &[7, 0, 255]);
    let tables = read_bytes(&file(false, true, &[counts.bytes, small.bytes])).expect("tables");
    let shown: Vec<(String, &str, Vec<f64>)> = tables
        .iter()
        .flat_map(|table| table.columns.iter().map(move |column| (table, column)))
        .map(|(table, column)| {
            let origin = column.origin as f64;
            let file = table.path.file_name().expect("a name").to_string_lossy().into_owned();
            (file, column.name.as_str(), column.values.iter().map(|value| origin + value).collect())
        })
        .collect();
    assert_eq!(
        shown,
        [
            ("run.mat#3".to_owned(), "small", vec![7.0, 0.0, 255.0]),
            ("run.mat#4".to_owned(), "counts", vec![1.0, 2.0, 65_534.0, 4.0])
        ]
    );
}

#[test]
fn what_is_not_read_is_named_with_a_way_on() {
    let plain = file(false, false, &[doubles(false, "x", [3, 1], &[1.0, 2.0, 3.0])]);
    let mut newer = plain.clone();
    newer.splice(..10, *b"MATLAB 7.3");
    newer.resize(512, 0);
    newer.extend(HDF5);
    for (bytes, words) in [
        (newer, "version 7.3, expected a file of version 7 or older: save('run.mat', ..., '-v7')"),
        (b"text".to_vec(), "is shorter than a header"),
        (vec![b' '; 300], "is no file of MATLAB"),
        (file(false, false, &[doubles(false, "x", [1, 1], &[1.0])]), "no numeric arrays of two values"),
    ] {
        let printed = read_bytes(&bytes).expect_err("refused").to_string();
        assert!(printed.contains(words), "{words} is not in {printed}");
    }
    // A complex array is none of readings; one that is cut off is missed.
    let mut complex = doubles(false, "z", [2, 1], &[1.0, 2.0]);
    complex[9] = 0x08;
    let two = file(false, false, &[doubles(false, "x", [3, 1], &[1.0, 2.0, 3.0]), complex]);
    let tables = read_bytes(&two).expect("a table");
    assert_eq!((tables[0].columns.len(), tables[0].words[0].header.as_str()), (1, "z"));
    let tables = read_bytes(&two[..two.len() - 20]).expect("a table");
    assert!(tables[0].notes[0].contains("cut off"), "{:?}", tables[0].notes);
}

proptest::proptest! {
    #![proptest_config(proptest::prelude::ProptestConfig::with_cases(64))]
    /// Whatever is changed in a file, there are tables or an error.
    #[test]
    fn damaged_files_are_borne(at in 100_usize..400, byte: u8, is_packed: bool, is_big: bool) {
        let nested = structure(is_big, "d", &[("a", doubles(is_big, "", [4, 2], &[1.0; 8]))]);
        let mut bytes = file(is_big, is_packed, &[nested, doubles(is_big, "x", [5, 1], &[2.0; 5])]);
        let byte_index = at % bytes.len();
        bytes[byte_index] = byte;
        let _ = read_bytes(&bytes);
    }
}

#[test]
fn states_and_marks_are_obeyed_as_those_of_a_text() {
    let [t, x, mut f] = [0, 1, 2].map(|at: usize| (0..ROWS).map(|row| truth(row)[at]).collect::<Vec<f64>>());
    f[5] = 9999.0;
    f[7] = -3.697_314e28;
    let valid: Vec<u8> = (0..ROWS).map(|row| u8::from(row != 20 && row != 21)).collect();
    let side = [ROWS as u32, 1];
    let vectors = [
        doubles(false, "t", side, &t),
        doubles(false, "x", side, &x),
        doubles(false, "f", side, &f),
        // A flag of the array states that its bytes are truth values.
        {
            let mut logical = Writer::new(false);
            for words in [[0x200 | 9, 0], [ROWS as u32, 1]] {
                let kind = if words[1] == 0 { 6 } else { 5 };
                let content = logical.words(&words);
                logical.element(kind, &content);
            }
            logical.element(1, b"valid");
            logical.element(2, &valid);
            logical.bytes
        },
    ];
    let run = taken(&file(false, false, &vectors), ["t=time_s:s", "x=displacement_y_mm:mm", "f=force_y_n:N"]);
    assert_eq!(run.force.expect("a force").time_s.len(), ROWS - 4, "{:?}", run.notes);
    assert!(
        run.notes.iter().any(|note| note.contains("2 rows whose \"valid\" is 0 are skipped")),
        "{:?}",
        run.notes
    );
}
