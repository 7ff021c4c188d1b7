//! Recordings of a guided needle that another program has saved again, and a camera's clip.

use super::{Answer, assert_rejected, assert_right_or_rejected, folder, import, read_columns, with_file};
use std::fmt::Write as _;
use std::fs;

const COLUMNS: &str = "Timestamp sec,Timestamp nanosec,Target x,Target y,Target z, Target sec, Target nanosec,\
    Entry_point x,Entry_point y,Entry_point z, Entry_point sec, Entry_point nanosec,AuroraTip x,AuroraTip y,AuroraTip z,\
    AuroraTip qw,AuroraTip qx,AuroraTip qy,AuroraTip qz,AuroraTip sec,AuroraTip nanosec,Tip x,Tip y,Tip z,Tip qw,Tip qx,\
    Tip qy,Tip qz,Tip sec,Tip nanosec,AuroraBase x,AuroraBase y,AuroraBase z,AuroraBase qw,AuroraBase qx,AuroraBase qy,\
    AuroraBase qz,AuroraBase sec,AuroraBase nanosec,Base x,Base y,Base z,Base qw,Base qx,Base qy,Base qz,Base sec,\
    Base nanosec,Robot x,Robot z,Robot sec,Robot nanosec";

/// An insertion of 60 mm in 121 rows, two a second: the tip goes along -y and bends upwards, guide 2 rests.
pub fn recording() -> String {
    let mut table = format!("{COLUMNS}\n");
    for row in 0..=120 {
        let (sec, nanosec) = (1_664_902_096 + row / 2, 500_000_000 * (row % 2) + 952_878_739 % 500_000_000);
        let depth = 0.5 * f64::from(row);
        let tip = format!(
            "{},{},{},0.72,0.694,0.0092,-0.0012,{sec},{nanosec}",
            -24.8,
            2.8 - depth,
            23.5 + 5e-4 * depth * depth
        );
        let _ = writeln!(
            table,
            "{sec},{nanosec},{},{},{tip},{},{},-0.025,0.022625,{sec},{nanosec}",
            zeros(10),
            zeros(9),
            zeros(9),
            zeros(9)
        );
    }
    table
}

fn zeros(count: usize) -> String {
    vec!["0"; count].join(",")
}

pub fn insertion(content: &str) -> Answer {
    import(with_file("run.csv", content), &["trajcontrol", "run.csv"])
}

/// The insertion's rows in the session.
fn path(answer: &Answer) -> Vec<[f64; 3]> {
    let output_path = answer.folder.path().join("out");
    let file = fs::read_dir(output_path)
        .expect("a session")
        .map(|entry| entry.expect("an entry").path())
        .find(|file| file.extension().is_some_and(|ending| ending == "csv"))
        .unwrap_or_else(|| panic!("no table:\n{}", answer.printed));
    read_columns(&file, ["depth_mm", "tip_y_mm", "time_s"])
}

pub fn assert_insertion(answer: &Answer) {
    let rows = path(answer);
    assert!(rows.len() > 110, "{} rows:\n{}", rows.len(), answer.printed);
    let [first, last] = [rows[0], rows[rows.len() - 1]];
    assert!((last[0] - first[0] - 60.0).abs() < 1.0, "{first:?} {last:?}:\n{}", answer.printed);
    assert!((last[1] - first[1] - 1.8).abs() < 0.02, "{first:?} {last:?}:\n{}", answer.printed);
    assert!((last[2] - first[2] - 60.0).abs() < 1.0, "{first:?} {last:?}:\n{}", answer.printed);
}

#[test]
fn the_recording_itself_is_read() {
    let answer = insertion(&recording());
    assert!(answer.succeeded, "{}", answer.printed);
    assert_insertion(&answer);
}

#[test]
fn saved_again_with_decimal_commas() {
    let content = recording().replace(',', ";").replace('.', ",");
    assert_right_or_rejected(&insertion(&content), &["Tip x", "column", "separator", ";"], assert_insertion);
}

#[test]
fn saved_again_with_rounded_stamps() {
    // A spreadsheet shows 1664902096 as 1.66E+09 in a narrow column, and saves what it shows.
    let content: String = recording()
        .lines()
        .map(|line| {
            line.split(',')
                .map(|cell| if cell.starts_with("16649") { "1.66E+09" } else { cell })
                .collect::<Vec<_>>()
                .join(",")
                + "\n"
        })
        .collect();
    assert_rejected(&insertion(&content), &["sec", "time", "clock"]);
}

#[test]
fn stamps_in_another_order_of_columns() {
    let content: String = recording()
        .lines()
        .map(|line| {
            let mut cells: Vec<&str> = line.split(',').collect();
            cells.reverse();
            cells.join(",") + "\n"
        })
        .collect();
    let answer = insertion(&content);
    assert!(answer.succeeded, "{}", answer.printed);
    assert_insertion(&answer);
}

/// Pictures of a mark with edges that rises by a tenth of a pixel per frame, 41 wide (a row in a bitmap is longer) and 48 high.
pub fn clip() -> Vec<Vec<u8>> {
    (0..20)
        .map(|frame| {
            let top = 20.0 - 0.1 * f64::from(frame);
            (0..48 * 41).map(|index| pixel(f64::from(index % 41), f64::from(index / 41), top)).collect()
        })
        .collect()
}

fn pixel(x: f64, y: f64, top: f64) -> u8 {
    let is_inside = edge(x - 14.0) * edge(27.0 - x) * edge(y - top) * edge(top + 11.0 - y);
    let grain = 3.0 * (0.9 * x).sin() * (1.3 * y).cos();
    (40.0 + 160.0 * is_inside + if is_inside < 0.01 { grain } else { 0.0 }).round() as u8
}

fn edge(distance: f64) -> f64 {
    1.0 / (1.0 + (-distance / 0.6).exp())
}

/// An AVI of uncompressed grey frames with a palette: rows from below, each of a whole number of four bytes.
pub fn avi(frames: &[Vec<u8>], width: usize, rate: u32, scale: u32) -> Vec<u8> {
    let height = frames[0].len() / width;
    let stride = width.div_ceil(4) * 4;
    let size = (stride * height) as u32;
    let period_us = u32::try_from(1_000_000_u64 * u64::from(scale) / u64::from(rate)).expect("fits");
    let count = frames.len() as u32;
    let main = numbers(&[period_us, 0, 0, 0x10, count, 0, 1, size, width as u32, height as u32, 0, 0, 0, 0]);
    let stream =
        [b"vidsDIB ".to_vec(), numbers(&[0, 0, 0, scale, rate, 0, count, size, 0, 0, 0, 0])].concat();
    let mut bitmap = numbers(&[40, width as u32, height as u32]);
    bitmap.extend([1, 0, 8, 0]);
    bitmap.extend(numbers(&[0, size, 0, 0, 256, 0]));
    bitmap.extend((0..=255_u8).flat_map(|grey| [grey, grey, grey, 0]));
    let stream = list(b"strl", [chunk(b"strh", stream), chunk(b"strf", bitmap)].concat());
    let header = list(b"hdrl", [chunk(b"avih", main), stream].concat());
    let pictures = frames.iter().flat_map(|frame| {
        let rows = frame.chunks(width).rev();
        chunk(b"00db", rows.flat_map(|row| row.iter().copied().chain(vec![0xA5; stride - width])).collect())
    });
    let movie = list(b"movi", pictures.collect());
    chunk(b"RIFF", [b"AVI ".to_vec(), header, movie].concat())
}

fn numbers(values: &[u32]) -> Vec<u8> {
    values.iter().flat_map(|value| word(*value)).collect::<Vec<u8>>()
}

fn list(name: &[u8], content: Vec<u8>) -> Vec<u8> {
    chunk(b"LIST", [name.to_vec(), content].concat())
}

fn chunk(name: &[u8], content: Vec<u8>) -> Vec<u8> {
    let padding = vec![0; content.len() % 2];
    [name.to_vec(), word(content.len() as u32), content, padding].concat()
}

fn word(value: u32) -> Vec<u8> {
    value.to_le_bytes().to_vec()
}

#[test]
fn a_clip_of_a_television_standard() {
    let folder = folder();
    fs::write(folder.path().join("clip.avi"), avi(&clip(), 41, 30_000, 1001)).expect("written");
    let options =
        ["camera", "clip.avi", "--template", "10,14,22,24", "--mm-per-px", "0.05", "--start-s", "0"];
    let answer = import(folder, &options);
    assert!(answer.succeeded, "{}", answer.printed);
    let file = answer.folder.path().join("out/clip.camera.csv");
    let rows = read_columns(&file, ["time_s", "displacement_y_mm", "displacement_x_mm"]);
    assert_eq!(rows.len(), 20, "{}", answer.printed);
    for (frame, [time_s, y_mm, x_mm]) in rows.into_iter().enumerate() {
        let expected_s = frame as f64 * 1001.0 / 30_000.0;
        assert!((time_s - rows_start(&file) - expected_s).abs() < 2e-5, "{time_s} for {expected_s}");
        assert!(
            (y_mm - 0.005 * frame as f64).abs() < 1e-3 && x_mm.abs() < 1e-3,
            "{y_mm} {x_mm} in frame {frame}"
        );
    }
}

fn rows_start(file: &std::path::Path) -> f64 {
    read_columns(file, ["time_s", "", ""])[0][0]
}
