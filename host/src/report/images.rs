//! The section on runs that come from images: which frames were used, why others were not, and what they looked like.

use super::page::{Block, Figure, Outcome, Section, number, value, words};
use formats::session::{Session, is_file_name};
use imaging::sheet::base64;
use serde_json::Value;
use std::fs::File;
use std::io::Read;
use std::path::Path;

/// Longest record and contact sheet that a report reads.
const MAX_BYTES: u64 = 32 << 20;
const MAX_SHEET: u64 = 4 << 20;
/// First bytes of every PNG file.
const PNG: [u8; 8] = [0x89, b'P', b'N', b'G', b'\r', b'\n', 0x1a, b'\n'];

/// The section; none where no run comes from images.
pub(super) fn section(session: &Session) -> Option<Section> {
    let mut sequences = Vec::new();
    let mut clips = Vec::new();
    let mut notes = Vec::new();
    let mut figures = Vec::new();
    for run in session.lateral.iter().filter(|run| is_file_name(&run.id)) {
        let of_shape = record(&session.dir, &format!("{}.frames.json", run.id));
        let of_camera = record(&session.dir, &format!("{}.camera.json", run.id));
        if let Some(document) = &of_shape {
            let list = document.get("sweeps").and_then(Value::as_array).into_iter().flatten();
            let straight = document.get("straight").filter(|straight| !straight.is_null());
            sequences.extend(straight.map(|one| sweep(&format!("{}, straight", run.id), one)));
            sequences.extend(list.map(|one| sweep(&run.id, one)));
        }
        if let Some(camera) = of_camera.as_ref().and_then(|document| document.get("camera")) {
            clips.push(clip(&run.id, camera));
        }
        let image_records = [of_shape.as_ref(), of_camera.as_ref()];
        if image_records.iter().all(Option::is_none) {
            continue;
        }
        for note in image_records
            .into_iter()
            .flatten()
            .filter_map(|document| document.get("notes")?.as_array())
            .flatten()
        {
            notes.extend(note.as_str().map(|note| format!("{}: {note}", run.id)));
        }
        figures.extend(sheet(&session.dir, &run.id));
    }
    if sequences.is_empty() && clips.is_empty() {
        return None;
    }
    let mut blocks = Vec::new();
    if !sequences.is_empty() {
        let columns = [
            words("run"),
            words("file"),
            number("frames"),
            number("used"),
            words("rejected"),
            number("sd across, mm"),
            number("sd along the beam, mm"),
            number("lag, s"),
        ];
        blocks.push(Block::table("Ultrasound frames", columns, sequences));
    }
    if !clips.is_empty() {
        let columns = [
            words("run"),
            words("file"),
            number("frames"),
            number("used"),
            words("rejected"),
            number("sd, mm"),
            number("mm per pixel"),
            number("camera moved by, mm"),
        ];
        blocks.push(Block::table("Camera frames", columns, clips));
    }
    blocks.push(Block::Notes(notes));
    blocks.push(Block::Screen(figures));
    Some(Section { id: "images", title: "Images", content: Outcome::Found(blocks) })
}

/// Record of the import beside a run; `None` if there is none, or it is not readable.
fn record(folder: &Path, name: &str) -> Option<Value> {
    serde_json::from_slice(&bytes(&folder.join(name), MAX_BYTES)?).ok()
}

fn bytes(path: &Path, most: u64) -> Option<Vec<u8>> {
    let mut bytes = Vec::new();
    File::open(path).ok()?.take(most + 1).read_to_end(&mut bytes).ok()?;
    (bytes.len() as u64 <= most).then_some(bytes)
}

/// Used and rejected frames, and the file's name.
fn counts(of: &Value) -> [String; 4] {
    let states = || of.get("states").and_then(Value::as_object).into_iter().flatten();
    let used_text =
        states().find(|(state, _)| *state == "used").map_or_else(|| "0".to_owned(), |(_, n)| n.to_string());
    let rejected: Vec<String> = states()
        .filter(|(state, _)| *state != "used")
        .map(|(state, count)| format!("{count} {}", state.replace('_', " ")))
        .collect();
    let rejected = if rejected.is_empty() { "none".to_owned() } else { rejected.join(", ") };
    let path = of.get("path").and_then(Value::as_str).unwrap_or_default();
    let name =
        Path::new(path).file_name().map_or_else(String::new, |name| name.to_string_lossy().into_owned());
    let frames = of.get("frames").map_or_else(String::new, Value::to_string);
    [name, frames, used_text, rejected]
}

fn quantity(of: &Value, name: &str, digits: usize) -> String {
    value(of.get(name).and_then(Value::as_f64), digits)
}

fn sweep(id: &str, of: &Value) -> Vec<String> {
    let mut row = vec![id.to_owned()];
    row.extend(counts(of));
    row.extend([quantity(of, "sd_x_mm", 3), quantity(of, "sd_y_mm", 3)]);
    let is_estimated = of.get("lag_sd_s").is_some_and(|sd| !sd.is_null());
    let lag = quantity(of, "lag_s", 3);
    row.push(if is_estimated { lag } else { format!("{lag} (not estimated)") });
    row
}

fn clip(id: &str, of: &Value) -> Vec<String> {
    let mut row = vec![id.to_owned()];
    row.extend(counts(of));
    row.extend([quantity(of, "sd_y_mm", 5), quantity(of, "mm_per_px", 5)]);
    let mark = of.get("mark").filter(|mark| !mark.is_null());
    row.push(mark.map_or_else(|| "no mark".to_owned(), |mark| quantity(mark, "largest_mm", 3)));
    row
}

/// The contact sheet that the import kept, where it drew one.
fn sheet(folder: &Path, id: &str) -> Option<Block> {
    let png = bytes(&folder.join(format!("{id}.frames.png")), MAX_SHEET)?;
    let is_png = png.starts_with(&PNG) && png.get(12..16) == Some(b"IHDR");
    let (width, height) = (size(16, &png)?, size(20, &png)?);
    let svg = format!(
        "<svg width=\"{width}\" height=\"{height}\" viewBox=\"0 0 {width} {height}\" xmlns=\"http://www.w3.org/2000/svg\"><image width=\"{width}\" \
         height=\"{height}\" href=\"data:image/png;base64,{}\"/></svg>",
        base64(&png)
    );
    let caption =
        format!("{id}: frames with what was found in them; green borders are used, red ones rejected");
    is_png.then_some(Block::Figure(Figure { caption, svg }))
}

fn size(at: usize, png: &[u8]) -> Option<u32> {
    let bytes: [u8; 4] = png.get(at..at + 4)?.try_into().ok()?;
    Some(u32::from_be_bytes(bytes)).filter(|size| (1..=20_000).contains(size))
}
