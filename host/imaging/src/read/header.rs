//! Fields that MetaImage and NRRD sequences share: `Seq_FrameNNNN_Name = value`, spacing, orientation.

use crate::error::ImagingError;
use crate::frame::{FrameFields, Header, MAX_FRAMES, Orientation, Statement, Unclear};
use crate::pose::{self, Pose};
use std::collections::{BTreeMap, BTreeSet};
use std::io::{BufRead, Read};
use std::path::Path;

/// Longest header.
const MAX_HEADER: u64 = 64 << 20;
/// A pixel is not smaller or larger than this, millimetres.
pub(super) const SPACING_MM: [f64; 2] = [1e-3, 10.0];
/// Sizes that differ by less than this share are the same, rounded.
const SAME: f64 = 1e-3;
/// Fields of frames that change when the scanner is set to another depth or zoom, as PLUS names them.
const SCANNER_SETTINGS: [&str; 2] = ["DepthMm", "ZoomFactor"];

/// The next line without its end; none at the end of the file.
pub(super) fn line(
    path: &Path,
    bytes: &mut impl BufRead,
    read: &mut u64,
) -> Result<Option<String>, ImagingError> {
    let mut line = Vec::new();
    let remaining_bytes = MAX_HEADER.saturating_sub(*read);
    let count = bytes.take(remaining_bytes).read_until(b'\n', &mut line).map_err(ImagingError::io(path))?;
    *read += count as u64;
    if count as u64 == remaining_bytes {
        return Err(ImagingError::invalid(
            path,
            "header",
            "does not end within 64 MiB",
            "a header of text lines",
        ));
    }
    let text = String::from_utf8_lossy(&line).trim_end_matches(['\n', '\r']).to_owned();
    Ok((count > 0).then_some(text))
}

/// Whole numbers of a field, separated by blanks.
pub(super) fn sizes(path: &Path, field: &str, value: &str) -> Result<Vec<usize>, ImagingError> {
    let numbers: Result<Vec<usize>, _> = value.split_whitespace().map(str::parse).collect();
    numbers.map_err(|_| ImagingError::invalid(path, field, format!("\"{}\"", short(value)), "whole numbers"))
}

/// Fields of a header by their names, each once: a second statement that differs contradicts the first.
#[derive(Default, Clone)]
pub(super) struct Fields(BTreeMap<String, String>);

impl Fields {
    /// Enters a field.
    pub fn enter(&mut self, path: &Path, key: &str, value: &str) -> Result<(), ImagingError> {
        match self.0.insert(key.to_owned(), value.to_owned()) {
            Some(before) if before != value => {
                let problem = format!("\"{}\" and \"{}\"", short(&before), short(value));
                Err(ImagingError::invalid(path, key, problem, "one value"))
            }
            _ => Ok(()),
        }
    }

    /// The first of these names that is there: name and value.
    pub fn get<'n>(&self, names: &[&'n str]) -> Option<(&'n str, &str)> {
        names.iter().find_map(|name| Some((*name, self.0.get(*name)?.as_str())))
    }
}

/// Two sizes of a pixel in millimetres, or none where it is 1 in both directions: programs write that where they have no spacing.
pub(super) fn spacing(field: &str, mm: Option<[f64; 2]>, text: &str) -> Result<Option<[f64; 2]>, Unclear> {
    match mm {
        Some([x, y]) if x == 1.0 && y == 1.0 => Ok(None),
        Some(mm) if mm.iter().all(|mm| (SPACING_MM[0]..=SPACING_MM[1]).contains(mm)) => Ok(Some(mm)),
        _ => {
            let expected = format!("two sizes of a pixel from {} to {} mm", SPACING_MM[0], SPACING_MM[1]);
            Err(Unclear { field: field.to_owned(), problem: format!("\"{}\"", short(text)), expected })
        }
    }
}

/// The first two numbers of a text.
pub(super) fn two(text: &str) -> Option<[f64; 2]> {
    let numbers: Option<Vec<f64>> =
        text.split_whitespace().take(2).map(|number| number.parse().ok()).collect();
    numbers.and_then(|numbers| numbers.try_into().ok())
}

/// One size of a pixel of several statements of it, the first of which has precedence; those that differ contradict each other.
pub(super) fn one_of(stated: &[(&str, Option<[f64; 2]>)]) -> Result<Option<[f64; 2]>, Unclear> {
    let mut statement: Option<(&str, [f64; 2])> = None;
    for (field, mm) in stated.iter().filter_map(|(field, mm)| Some((*field, (*mm)?))) {
        match statement {
            Some((first, known)) if !is_same(known, mm) => {
                let problem = format!("{} and {}", size_text(first, known), size_text(field, mm));
                return Err(Unclear {
                    field: field.to_owned(),
                    problem,
                    expected: "one size of a pixel; or --spacing-mm".to_owned(),
                });
            }
            Some(_) => {}
            None => statement = Some((field, mm)),
        }
    }
    Ok(statement.map(|(_, mm)| mm))
}

fn size_text(field: &str, [x, y]: [f64; 2]) -> String {
    format!("{field} {x} x {y} mm")
}

pub(super) fn is_same(a: [f64; 2], b: [f64; 2]) -> bool {
    a.iter().zip(b).all(|(a, b)| (a / b - 1.0).abs() < SAME)
}

/// The axes of the image that a file states.
pub(super) fn orientation(header: &mut Header, field: &str, value: &str) {
    header.orientation = Orientation::parse(value);
    if header.orientation.is_none() {
        let unclear = Unclear {
            field: field.to_owned(),
            problem: format!("\"{}\"", short(value)),
            expected: "MF, UF, MN or UN; or --orientation".to_owned(),
        };
        header.unclear.push((Statement::Orientation, unclear));
    }
}

/// Directions in space, those of the image's two axes by the first two of space, in which the image is reversed: one axis and not the other, or
/// both exchanged. The stored frame is a mirror image of what was in space, and which side of it is far from the probe does not follow. Both
/// are reversed where right and anterior are written as left and posterior. Axes that the file states as those of the probe count instead.
pub(super) fn mirrored(
    header: &mut Header,
    field: &str,
    directions: [[Option<f64>; 2]; 2],
    is_left_handed: bool,
) {
    let [[Some(x0), Some(x1)], [Some(y0), Some(y1)]] = directions else { return };
    let area = x0 * y1 - x1 * y0;
    let is_mirrored = area != 0.0 && (area < 0.0) != is_left_handed;
    if !is_mirrored || header.orientation.is_some() || header.unclear(Statement::Orientation).is_some() {
        return;
    }
    let unclear = Unclear {
        field: field.to_owned(),
        problem: "one axis of the image is reversed in space, as in a mirror, or both are exchanged".to_owned(),
        expected: "--orientation: MF where frames are stored as the scanner shows them, UF where left and right are exchanged, MN where \
                   they are upside down"
            .to_owned(),
    };
    header.unclear.push((Statement::Orientation, unclear));
}

/// Fields of the frames in a file, in any order of its lines.
#[derive(Default)]
pub(super) struct Frames(Vec<Stated>);

/// Fields of a frame.
#[derive(Default, Clone)]
struct Stated {
    fields: FrameFields,
    /// Transforms that are marked as invalid.
    invalid: BTreeSet<String>,
    spacing_mm: Option<[f64; 2]>,
}

impl Frames {
    /// Enters a field of a frame, where it is one.
    pub fn enter(&mut self, path: &Path, key: &str, value: &str) -> Result<(), ImagingError> {
        let Some((number, name)) = key.strip_prefix("Seq_Frame").and_then(|rest| rest.split_once('_')) else {
            return Ok(());
        };
        let number: usize = number.parse().ok().filter(|number| *number < MAX_FRAMES).ok_or_else(|| {
            ImagingError::invalid(
                path,
                key,
                "no number of a frame",
                format!("Seq_Frame0000_... to {MAX_FRAMES} frames"),
            )
        })?;
        if self.0.len() <= number {
            self.0.resize(number + 1, Stated::default());
        }
        let Some(frame) = self.0.get_mut(number) else { return Ok(()) };
        let value = value.trim();
        let is_new = if name == "Timestamp" {
            let time_s: Option<f64> = value.parse().ok().filter(|time_s: &f64| time_s.is_finite());
            let time_s = time_s.ok_or_else(|| invalid_value("a time in seconds", key, value, path))?;
            frame.fields.time_s.replace(time_s).is_none_or(|before| before == time_s)
        } else if name == "Status" || name == "ImageStatus" {
            frame.fields.is_invalid |= value != "OK";
            true
        } else if let Some(transform) = name.strip_suffix("TransformStatus") {
            if value != "OK" {
                frame.invalid.insert(transform.to_owned());
            }
            true
        } else if let Some(transform) = name.strip_suffix("TransformValid") {
            if !["true", "1"].iter().any(|yes| value.eq_ignore_ascii_case(yes)) {
                frame.invalid.insert(transform.to_owned());
            }
            true
        } else if let Some(transform) = name.strip_suffix("Transform") {
            // A tracker that does not see a tool may write numbers that are none.
            if is_unmeasured(value) {
                frame.invalid.insert(transform.to_owned());
                return Ok(());
            }
            let matrix = matrix(value).ok_or_else(|| {
                invalid_value("16 numbers of a homogeneous transform, row by row", key, value, path)
            })?;
            let previous = frame.fields.transforms.insert(transform.to_owned(), matrix);
            previous.is_none_or(|previous| previous == matrix)
        } else if matches!(name, "ElementSpacing" | "ElementSize" | "Spacing") {
            let mm = spacing(key, two(value), value)
                .map_err(|unclear| invalid_value(&unclear.expected, key, value, path))?;
            let previous = std::mem::replace(&mut frame.spacing_mm, mm);
            previous.is_none() || previous == mm
        } else if let Some(number) = value.parse().ok().filter(|number: &f64| number.is_finite()) {
            let previous = frame.fields.numbers.insert(name.to_owned(), number);
            previous.is_none_or(|previous| previous == number)
        } else {
            true
        };
        if is_new {
            Ok(())
        } else {
            Err(invalid_value("one value: the file states another one before", key, value, path))
        }
    }

    /// Gives a header its frames, and the size of a pixel that they state.
    pub fn finish(self, header: &mut Header) {
        let mut frames = self.0;
        frames.truncate(header.count);
        let first_mm = frames.iter().find_map(|frame| frame.spacing_mm);
        match one_of(&[("the header's size of a pixel", header.spacing_mm), ("that of its frames", first_mm)])
        {
            Ok(mm) => header.spacing_mm = mm,
            Err(unclear) => header.unclear.push((Statement::Spacing, unclear)),
        }
        // A tracker that does not see a tool sends a frame that is neither turned nor moved, whatever is stated of it.
        let moved: BTreeSet<String> = frames
            .iter()
            .flat_map(|frame| &frame.fields.transforms)
            .filter(|(_, matrix)| **matrix != pose::IDENTITY)
            .map(|(name, _)| name.clone())
            .collect();
        let first = SCANNER_SETTINGS.map(|name| frames.iter().find_map(|frame| setting(frame, name)));
        for frame in &mut frames {
            let differs = frame.spacing_mm.zip(first_mm).is_some_and(|(mm, first_mm)| !is_same(mm, first_mm));
            let other_setting = SCANNER_SETTINGS.iter().zip(first).any(|(name, first)| {
                setting(frame, name).zip(first).is_some_and(|(value, first)| value != first)
            });
            frame.fields.is_other_depth = differs || other_setting;
            let invalid = &frame.invalid;
            frame.fields.transforms.retain(|name, matrix| {
                !(invalid.contains(name) || *matrix == pose::IDENTITY && moved.contains(name))
            });
        }
        header.frames = frames.into_iter().map(|frame| frame.fields).collect();
    }
}

fn setting(frame: &Stated, name: &str) -> Option<f64> {
    frame.fields.numbers.get(name).copied()
}

fn invalid_value(expected: &str, key: &str, value: &str, path: &Path) -> ImagingError {
    ImagingError::invalid(path, key, format!("\"{}\"", short(value)), expected)
}

/// Whether a transform is 16 numbers of which some are NaN.
fn is_unmeasured(value: &str) -> bool {
    let numbers: Option<Vec<f64>> = value.split_whitespace().map(|number| number.parse().ok()).collect();
    numbers.is_some_and(|numbers| numbers.len() == 16 && numbers.iter().any(|number| number.is_nan()))
}

/// A homogeneous transform, row by row.
fn matrix(value: &str) -> Option<Pose> {
    let numbers: Option<Vec<f64>> = value.split_whitespace().map(|number| number.parse().ok()).collect();
    numbers.and_then(|numbers| pose::by_rows(numbers.try_into().ok()?))
}

/// The beginning of a value, for messages.
pub(super) fn short(value: &str) -> String {
    value.chars().take(40).collect()
}
