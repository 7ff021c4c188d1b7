//! JPEG frames: of DICOM, of AVI and of stacks.

use super::{check_size, grey};
use crate::error::ImagingError;
use crate::frame::Frame;
use std::path::Path;
use zune_core::bytestream::ZCursor;
use zune_core::colorspace::ColorSpace;
use zune_core::options::DecoderOptions;
use zune_jpeg::JpegDecoder;

/// Longest side.
const MAX_SIDE: usize = 1 << 14;

/// Decodes one. `is_rgb` states that three components are red, green and blue whatever the file's own markers are.
pub(super) fn decode(path: &Path, field: &str, bytes: &[u8], is_rgb: bool) -> Result<Frame, ImagingError> {
    let damaged = |cause: &dyn std::fmt::Display| {
        let cause = cause.to_string().split_whitespace().collect::<Vec<_>>().join(" ");
        ImagingError::invalid(path, field, cause, "a whole JPEG image (baseline or progressive, 8 bit)")
    };
    let options =
        DecoderOptions::default().set_max_width(MAX_SIDE).set_max_height(MAX_SIDE).set_strict_mode(true);
    let mut decoder = JpegDecoder::new_with_options(ZCursor::new(bytes), options);
    decoder.decode_headers().map_err(|cause| damaged(&cause))?;
    let (width, height) = decoder.dimensions().ok_or_else(|| damaged(&"no size"))?;
    check_size(path, field, [width, height, 1])?;
    let (space, channels) = match decoder.input_colorspace() {
        Some(ColorSpace::Luma) => (ColorSpace::Luma, 1),
        // Its own space is no conversion.
        Some(ColorSpace::YCbCr) if is_rgb => (ColorSpace::YCbCr, 3),
        _ => (ColorSpace::RGB, 3),
    };
    let options = decoder.options().jpeg_set_out_colorspace(space);
    decoder.set_options(options);
    let pixels = decoder.decode().map_err(|cause| damaged(&cause))?;
    super::whole(path, field, [width, height], grey(pixels, channels))
}
