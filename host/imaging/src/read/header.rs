//! Fields that MetaImage and NRRD sequences share: `Seq_FrameNNNN_Name = value`, spacing, orientation.

use crate::error::ImagingError;
use crate::frame::{FrameFields, MAX_FRAMES};
use std::io::{BufRead, Read};
use std::path::Path;

/// Longest header.
const MAX_HEADER: u64 = 64 << 20;
/// A pixel is not smaller or larger than this, millimetres.
pub(super) const SPACING_MM: [f64; 2] = [1e-3, 10.0];

/// The next line without its end; none at the end of the file.
pub(super) fn line(
    path: &Path,
    bytes: &mut impl BufRead,
    read: &mut u64,
) -> Result<Option<String>, ImagingError> {
    let mut line = Vec::new();
    let left = MAX_HEADER.saturating_sub(*read);
    let count = bytes.take(left).read_until(b'\n', &mut line).map_err(ImagingError::io(path))?;
    *read += count as u64;
    if count as u64 == left {
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

/// Two sizes of a pixel, or none where it is 1 in both directions: programs write that where they have no spacing.
pub(super) fn spacing(path: &Path, field: &str, value: &str) -> Result<Option<[f64; 2]>, ImagingError> {
    let numbers: Option<Vec<f64>> =
        value.split_whitespace().take(2).map(|number| number.parse().ok()).collect();
    let given = numbers.and_then(|numbers| <[f64; 2]>::try_from(numbers).ok());
    match given {
        Some([x, y]) if x == 1.0 && y == 1.0 => Ok(None),
        Some(mm) if mm.iter().all(|mm| (SPACING_MM[0]..=SPACING_MM[1]).contains(mm)) => Ok(Some(mm)),
        _ => {
            let expected = format!("two sizes of a pixel from {} to {} mm", SPACING_MM[0], SPACING_MM[1]);
            Err(ImagingError::invalid(path, field, format!("\"{}\"", short(value)), expected))
        }
    }
}

/// Enters a field of a frame, where it is one.
pub(super) fn frame_field(
    path: &Path,
    key: &str,
    value: &str,
    frames: &mut Vec<FrameFields>,
) -> Result<(), ImagingError> {
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
    if frames.len() <= number {
        frames.resize(number + 1, FrameFields::default());
    }
    let Some(frame) = frames.get_mut(number) else { return Ok(()) };
    let value = value.trim();
    if name == "Timestamp" {
        let time_s: Option<f64> = value.parse().ok().filter(|time_s: &f64| time_s.is_finite());
        let problem = || format!("\"{}\"", short(value));
        frame.time_s =
            Some(time_s.ok_or_else(|| ImagingError::invalid(path, key, problem(), "a time in seconds"))?);
    } else if name == "Status" || name == "ImageStatus" {
        frame.is_invalid |= value != "OK";
    } else if let Some(transform) = name.strip_suffix("TransformStatus") {
        if value != "OK" {
            frame.transforms.remove(transform);
        }
    } else if let Some(transform) = name.strip_suffix("Transform") {
        frame.transforms.insert(transform.to_owned(), matrix(path, key, value)?);
    } else if let Some(number) = value.parse().ok().filter(|number: &f64| number.is_finite()) {
        frame.numbers.insert(name.to_owned(), number);
    }
    Ok(())
}

/// A homogeneous transform, row by row.
fn matrix(path: &Path, key: &str, value: &str) -> Result<[f64; 16], ImagingError> {
    let numbers: Option<Vec<f64>> = value.split_whitespace().map(|number| number.parse().ok()).collect();
    numbers
        .and_then(|numbers| <[f64; 16]>::try_from(numbers).ok())
        .filter(|matrix| matrix.iter().all(|number| number.is_finite()))
        .ok_or_else(|| {
            ImagingError::invalid(
                path,
                key,
                format!("\"{}\"", short(value)),
                "16 numbers of a homogeneous transform",
            )
        })
}

/// The beginning of a value, for messages.
pub(super) fn short(value: &str) -> String {
    value.chars().take(40).collect()
}
