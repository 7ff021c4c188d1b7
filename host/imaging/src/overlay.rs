//! Pictures of frames with what was found in them.

use crate::error::ImagingError;
use crate::frame::Frame;
use crate::sweep::{FrameResult, State};
use std::fs::File;
use std::io::BufWriter;
use std::path::Path;

/// Arms of a cross, pixels from its middle.
const ARM: std::ops::RangeInclusive<i64> = 4..=12;

/// Writes a frame as PNG with a cross at the used echo (green), or at the best one of a rejected frame (red).
///
/// # Errors
/// [`ImagingError`] where it cannot be written.
pub fn write(path: &Path, frame: &Frame, result: &FrameResult) -> Result<(), ImagingError> {
    let mut pixels: Vec<u8> = frame.pixels.iter().flat_map(|pixel| [*pixel; 3]).collect();
    let colour = if result.state == State::Used { [0, 220, 60] } else { [240, 40, 40] };
    let mut draw = |x: i64, y: i64| {
        let (Ok(x), Ok(y)) = (usize::try_from(x), usize::try_from(y)) else { return };
        if x < frame.width && y < frame.height {
            let at = 3 * (y * frame.width + x);
            if let Some(pixel) = pixels.get_mut(at..at + 3) {
                pixel.copy_from_slice(&colour);
            }
        }
    };
    if let Some(candidate) = &result.candidate {
        let (x, y) = (candidate.centre.x_px.round() as i64, candidate.centre.y_px.round() as i64);
        for arm in ARM {
            for (x, y) in [(x - arm, y), (x + arm, y), (x, y - arm), (x, y + arm)] {
                draw(x, y);
            }
        }
    }
    if result.state != State::Used {
        // A border marks a rejected frame.
        let (width, height) = (frame.width as i64, frame.height as i64);
        (0..width).for_each(|x| [0, 1, height - 2, height - 1].into_iter().for_each(|y| draw(x, y)));
        (0..height).for_each(|y| [0, 1, width - 2, width - 1].into_iter().for_each(|x| draw(x, y)));
    }
    let io = |cause: png::EncodingError| {
        ImagingError::invalid(path, "overlay", cause.to_string(), "a place to write to")
    };
    let file = File::create(path).map_err(ImagingError::io(path))?;
    let mut encoder = png::Encoder::new(BufWriter::new(file), frame.width as u32, frame.height as u32);
    encoder.set_color(png::ColorType::Rgb);
    encoder.set_depth(png::BitDepth::Eight);
    encoder.write_header().map_err(io)?.write_image_data(&pixels).map_err(io)
}
