//! JPEG frames: of DICOM, of AVI and of stacks.

use super::{check_size, grey};
use crate::error::ImagingError;
use crate::frame::Frame;
use std::borrow::Cow;
use std::path::Path;
use zune_core::bytestream::ZCursor;
use zune_core::colorspace::ColorSpace;
use zune_core::options::DecoderOptions;
use zune_jpeg::JpegDecoder;

/// Longest side.
const MAX_SIDE: usize = 1 << 14;

/// Decodes one. `is_rgb` states that three components are red, green and blue whatever the file's own markers are.
pub(super) fn decode(path: &Path, field: &str, bytes: &[u8], is_rgb: bool) -> Result<Frame, ImagingError> {
    let bytes = &*with_tables(bytes);
    let options =
        DecoderOptions::default().set_max_width(MAX_SIDE).set_max_height(MAX_SIDE).set_strict_mode(true);
    let mut decoder = JpegDecoder::new_with_options(ZCursor::new(bytes), options);
    decoder.decode_headers().map_err(|cause| damaged(&cause, field, path))?;
    let (width, height) = decoder.dimensions().ok_or_else(|| damaged(&"no size", field, path))?;
    check_size(path, field, [width, height, 1])?;
    let (space, channels) = match decoder.input_colorspace() {
        Some(ColorSpace::Luma) => (ColorSpace::Luma, 1),
        // Its own space is no conversion.
        Some(ColorSpace::YCbCr) if is_rgb => (ColorSpace::YCbCr, 3),
        _ => (ColorSpace::RGB, 3),
    };
    let options = decoder.options().jpeg_set_out_colorspace(space);
    decoder.set_options(options);
    let pixels = decoder.decode().map_err(|cause| damaged(&cause, field, path))?;
    super::whole(path, field, [width, height], grey(pixels, channels))
}

fn damaged(cause: &dyn std::fmt::Display, field: &str, path: &Path) -> ImagingError {
    let cause = cause.to_string().split_whitespace().collect::<Vec<_>>().join(" ");
    ImagingError::invalid(path, field, cause, "a whole JPEG image (baseline or progressive, 8 bit)")
}

/// A frame of a film may omit Huffman tables, which are then those of the standard's Annex K (AVI, Motion JPEG DIB extension); the decoder
/// takes these where the frame is marked as one of a film, for tables that it does not have.
fn with_tables(bytes: &[u8]) -> Cow<'_, [u8]> {
    /// APP0 of a frame of a film, as long as the decoder reads it.
    const FILM: [u8; 10] = [0xFF, 0xE0, 0, 8, b'A', b'V', b'I', b'1', 0, 0];
    match bytes.split_first_chunk::<2>() {
        Some((start @ [0xFF, 0xD8], rest)) if !has_tables(rest) => {
            Cow::Owned([start, &FILM[..], rest].concat())
        }
        _ => Cow::Borrowed(bytes),
    }
}

/// Markers before the scan with what belongs to them; what is damaged ends them.
fn segments(bytes: &[u8]) -> impl Iterator<Item = (u8, &[u8])> {
    let mut remaining = bytes;
    std::iter::from_fn(move || {
        let (&[0xFF, marker, high, low], _) = remaining.split_first_chunk::<4>()? else { return None };
        let length = 2 + usize::from(u16::from_be_bytes([high, low]));
        let content = remaining.get(4..length).unwrap_or_default();
        remaining = remaining.get(length..).unwrap_or_default();
        Some((marker, content))
    })
}

/// Whether there are as many Huffman tables before the scan as a frame of its kind needs: two of brightness, two more of colours where there are
/// such. Frames that are not baseline have theirs at each scan; what is damaged is left to the decoder.
fn has_tables(bytes: &[u8]) -> bool {
    /// Place of the number of components in a baseline frame's header.
    const COMPONENTS: usize = 5;
    let (mut tables, mut components) = (0, 0);
    for (marker, content) in segments(bytes) {
        match marker {
            0xC4 => tables += count_of_tables(content),
            0xC0 => components = content.get(COMPONENTS).copied().unwrap_or(0),
            0xDA => return components == 0 || tables >= if components == 1 { 2 } else { 4 },
            _ => {}
        }
    }
    true
}

/// Huffman tables in a segment: a byte with class and number, how many codes there are of each length, and their symbols.
fn count_of_tables(mut content: &[u8]) -> usize {
    const LENGTHS: usize = 16;
    let mut count = 0;
    while let Some((lengths, rest)) = content.get(1..).and_then(|table| table.split_at_checked(LENGTHS)) {
        let symbols: usize = lengths.iter().copied().map(usize::from).sum();
        content = rest.get(symbols..).unwrap_or_default();
        count += 1;
    }
    count
}

/// EXIF data of a file.
pub(super) fn exif(bytes: &[u8]) -> Option<&[u8]> {
    let jpeg_segments = segments(bytes.strip_prefix(&[0xFF, 0xD8])?);
    jpeg_segments
        .take_while(|(marker, _)| *marker != 0xDA)
        .filter(|(marker, _)| *marker == 0xE1)
        .find_map(|(_, content)| content.strip_prefix(b"Exif\0\0"))
}
