//! Pictures of frames with what was found in them.

use crate::camera;
use crate::detect::Candidate;
use crate::error::ImagingError;
use crate::frame::{Frame, Region};
use crate::sweep::{FrameResult, State};
use std::io::BufWriter;
use std::path::Path;

/// Arms of a cross, pixels from its middle.
const ARM: std::ops::RangeInclusive<i64> = 4..=12;
/// Colour of what is used, and of what is rejected.
const USED: [u8; 3] = [0, 220, 60];
const REJECTED: [u8; 3] = [240, 40, 40];
/// Colour of a camera's fixed mark.
const MARK: [u8; 3] = [60, 160, 255];

/// A picture in colour.
pub struct Picture {
    width: usize,
    height: usize,
    /// Red, green, blue, row by row.
    pixels: Vec<u8>,
}

impl Picture {
    /// Image of one colour.
    pub(crate) fn plain(width: usize, height: usize, colour: [u8; 3]) -> Self {
        Self { width, height, pixels: colour.repeat(width * height) }
    }

    fn of(frame: &Frame) -> Self {
        let pixels = frame.pixels.iter().flat_map(|pixel| [*pixel; 3]).collect();
        Self { width: frame.width, height: frame.height, pixels }
    }

    /// A frame of a sweep with a cross at the used echo (green), or at the best one of a rejected frame (red, with a border).
    pub fn of_sweep(frame: &Frame, state: State, candidate: Option<&Candidate>) -> Self {
        let mut picture = Self::of(frame);
        let colour = if state == State::Used { USED } else { REJECTED };
        if let Some(candidate) = candidate {
            picture.cross([candidate.centre.x_px, candidate.centre.y_px], colour);
        }
        if state != State::Used {
            picture.border(colour);
        }
        picture
    }

    /// A frame of a camera with the template where it is (green; red in a rejected frame, with a border), and the mark (blue).
    pub fn of_camera(frame: &Frame, settings: &camera::Settings, result: &camera::FrameResult) -> Self {
        let mut picture = Self::of(frame);
        let is_used = result.state == camera::State::Used;
        let colour = if is_used { USED } else { REJECTED };
        if let Some(template_match) = &result.template {
            picture.rectangle(settings.template, template_match.shift_px, colour);
        }
        if let (Some(mark), Some(mark_match)) = (settings.mark, &result.mark) {
            picture.rectangle(mark, mark_match.shift_px, MARK);
        }
        if !is_used {
            picture.border(colour);
        }
        picture
    }

    /// A frame with crosses at places: green, or red with a border.
    pub fn of_places(frame: &Frame, places: &[[f64; 2]], is_used: bool) -> Self {
        let mut picture = Self::of(frame);
        let colour = if is_used { USED } else { REJECTED };
        places.iter().for_each(|at| picture.cross(*at, colour));
        if !is_used {
            picture.border(colour);
        }
        picture
    }

    fn dot(&mut self, x: i64, y: i64, colour: [u8; 3]) {
        let (Ok(x), Ok(y)) = (usize::try_from(x), usize::try_from(y)) else { return };
        if x < self.width && y < self.height {
            let pixel_index = 3 * (y * self.width + x);
            if let Some(pixel) = self.pixels.get_mut(pixel_index..pixel_index + 3) {
                pixel.copy_from_slice(&colour);
            }
        }
    }

    fn cross(&mut self, at: [f64; 2], colour: [u8; 3]) {
        let [x, y] = at.map(|at| at.round() as i64);
        for arm in ARM {
            for (x, y) in [(x - arm, y), (x + arm, y), (x, y - arm), (x, y + arm)] {
                self.dot(x, y, colour);
            }
        }
    }

    fn rectangle(&mut self, region: Region, shift: [f64; 2], colour: [u8; 3]) {
        let corner = [region.x as f64 + shift[0], region.y as f64 + shift[1]].map(|at| at.round() as i64);
        let opposite_corner = [corner[0] + region.width as i64 - 1, corner[1] + region.height as i64 - 1];
        (corner[0]..=opposite_corner[0])
            .for_each(|x| [corner[1], opposite_corner[1]].into_iter().for_each(|y| self.dot(x, y, colour)));
        (corner[1]..=opposite_corner[1])
            .for_each(|y| [corner[0], opposite_corner[0]].into_iter().for_each(|x| self.dot(x, y, colour)));
    }

    /// Marks a rejected frame.
    fn border(&mut self, colour: [u8; 3]) {
        let (width, height) = (self.width as i64, self.height as i64);
        (0..width)
            .for_each(|x| [0, 1, height - 2, height - 1].into_iter().for_each(|y| self.dot(x, y, colour)));
        (0..height)
            .for_each(|y| [0, 1, width - 2, width - 1].into_iter().for_each(|x| self.dot(x, y, colour)));
    }

    /// The picture as means of its pixels, at most of this size, and how many pixels became one.
    pub(crate) fn reduced(&self, most: [usize; 2]) -> Self {
        let reduction = self.width.div_ceil(most[0].max(1)).max(self.height.div_ceil(most[1].max(1))).max(1);
        let (width, height) = ((self.width / reduction).max(1), (self.height / reduction).max(1));
        let mut pixels = Vec::with_capacity(3 * width * height);
        for (y, x, channel) in
            (0..height).flat_map(|y| (0..width).flat_map(move |x| (0..3).map(move |channel| (y, x, channel))))
        {
            let samples = (0..reduction * reduction).filter_map(|i| {
                let sample_index = 3
                    * ((y * reduction + i / reduction) * self.width + x * reduction + i % reduction)
                    + channel;
                self.pixels.get(sample_index).map(|value| u32::from(*value))
            });
            let (sum, count) = samples.fold((0, 0), |(sum, count), value| (sum + value, count + 1));
            pixels.push((sum / count.max(1)) as u8);
        }
        Self { width, height, pixels }
    }

    /// Puts another picture at a place; what lies outside is cut off.
    pub(crate) fn put(&mut self, other: &Self, at: [usize; 2]) {
        for (row, pixels) in other.pixels.chunks_exact(3 * other.width.max(1)).enumerate() {
            let y = at[1] + row;
            let count = other.width.min(self.width.saturating_sub(at[0]));
            let first_index = 3 * (y * self.width + at[0]);
            if y < self.height
                && let (Some(target), Some(pixels)) =
                    (self.pixels.get_mut(first_index..first_index + 3 * count), pixels.get(..3 * count))
            {
                target.copy_from_slice(pixels);
            }
        }
    }

    /// Paints a border of one colour outside of a place.
    pub(crate) fn frame(&mut self, from: [usize; 2], size: [usize; 2], colour: [u8; 3]) {
        let [x, y] = from.map(|from| from as i64);
        let [width, height] = size.map(|size| size as i64);
        for ring in 1..=2 {
            (x - ring..x + width + ring).for_each(|at| {
                self.dot(at, y - ring, colour);
                self.dot(at, y + height + ring - 1, colour);
            });
            (y - ring..y + height + ring).for_each(|at| {
                self.dot(x - ring, at, colour);
                self.dot(x + width + ring - 1, at, colour);
            });
        }
    }

    /// Pixels of a row, and rows.
    pub fn size(&self) -> [usize; 2] {
        [self.width, self.height]
    }

    /// As PNG.
    ///
    /// # Errors
    /// What the encoder reports.
    pub fn png(&self) -> Result<Vec<u8>, png::EncodingError> {
        let mut bytes = Vec::new();
        let mut encoder =
            png::Encoder::new(BufWriter::new(&mut bytes), self.width as u32, self.height as u32);
        encoder.set_color(png::ColorType::Rgb);
        encoder.set_depth(png::BitDepth::Eight);
        encoder.write_header()?.write_image_data(&self.pixels)?;
        Ok(bytes)
    }

    /// Writes it as PNG.
    ///
    /// # Errors
    /// [`ImagingError`] where it cannot be written.
    pub fn write(&self, path: &Path) -> Result<(), ImagingError> {
        let bytes = self.png().map_err(|cause| {
            ImagingError::invalid(path, "picture", cause.to_string(), "a frame with pixels")
        })?;
        std::fs::write(path, bytes).map_err(ImagingError::io(path))
    }
}

/// Writes a frame of a sweep as PNG with a cross at the used echo (green), or at the best one of a rejected frame (red).
///
/// # Errors
/// [`ImagingError`] where it cannot be written.
pub fn write(path: &Path, frame: &Frame, result: &FrameResult) -> Result<(), ImagingError> {
    Picture::of_sweep(frame, result.state, result.candidate.as_ref()).write(path)
}
