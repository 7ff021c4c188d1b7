//! Frames and what files state of them.

use crate::places::StatedPlaces;
use std::collections::BTreeMap;

/// Most pixels of a frame.
pub const MAX_PIXELS: usize = 1 << 24;
/// Most frames of a sequence.
pub const MAX_FRAMES: usize = 100_000;

/// A grey image of 8 bit, row by row from the top left.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Frame {
    /// Pixels of a row.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// `width * height` brightnesses.
    pub pixels: Vec<u8>,
}

impl Frame {
    /// Brightness at a pixel; 0 outside.
    pub fn at(&self, x: usize, y: usize) -> u8 {
        if x < self.width { self.pixels.get(y * self.width + x).copied().unwrap_or(0) } else { 0 }
    }

    /// The same image with its first axis towards the probe's marker and its second away from the probe.
    #[must_use]
    pub fn oriented(mut self, orientation: Orientation) -> Self {
        if orientation.flip_x {
            self.pixels.chunks_exact_mut(self.width.max(1)).for_each(<[u8]>::reverse);
        }
        if orientation.flip_y {
            let rows: Vec<&[u8]> = self.pixels.chunks_exact(self.width.max(1)).rev().collect();
            self.pixels = rows.concat();
        }
        self
    }
}

/// Orientation of an image's axes on the probe: which of them point the other way than `MF` (first axis to the marked
/// side, second to the far side).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Orientation {
    /// The first axis points to the unmarked side.
    pub flip_x: bool,
    /// The second axis points to the probe.
    pub flip_y: bool,
}

impl Orientation {
    /// Reads `MF`, `UF`, `MN`, `UN`, with or without a third letter; nothing for others.
    pub fn parse(text: &str) -> Option<Self> {
        let mut letters = text.trim().chars();
        let flip_x = match letters.next()? {
            'M' => false,
            'U' => true,
            _ => return None,
        };
        let flip_y = match letters.next()? {
            'F' => false,
            'N' => true,
            _ => return None,
        };
        letters.next().is_none_or(|third| matches!(third, 'A' | 'D')).then_some(Self { flip_x, flip_y })
    }
}

/// A rectangle of pixels.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Region {
    /// First column.
    pub x: usize,
    /// First row.
    pub y: usize,
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
}

impl Region {
    /// The same part of the image where its axes are turned, in a frame of this width and height.
    #[must_use]
    pub fn oriented(self, orientation: Orientation, [width, height]: [usize; 2]) -> Self {
        let x = if orientation.flip_x { mirrored_start(self.x, self.width, width) } else { self.x };
        let y = if orientation.flip_y { mirrored_start(self.y, self.height, height) } else { self.y };
        Self { x, y, ..self }
    }
}

fn mirrored_start(from: usize, size: usize, all: usize) -> usize {
    all.saturating_sub(from.saturating_add(size))
}

/// Fields of one frame in a file.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct FrameFields {
    /// Time stamp.
    pub time_s: Option<f64>,
    /// Whether the file marks the frame as unusable.
    pub is_invalid: bool,
    /// Whether it has another size of a pixel, depth or zoom than the first frame, by what the file states.
    pub is_other_depth: bool,
    /// Homogeneous transforms that are marked as valid, row by row, millimetres, by name without `Transform`.
    pub transforms: BTreeMap<String, [f64; 16]>,
    /// Other fields that are one number.
    pub numbers: BTreeMap<String, f64>,
}

/// Fields of all frames in a file.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Header {
    /// Pixels of a row.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Frames.
    pub count: usize,
    /// Size of a pixel along both axes, millimetres; none where the file states none or 1.
    pub spacing_mm: Option<[f64; 2]>,
    /// Orientation of the axes on the probe, if it is stated.
    pub orientation: Option<Orientation>,
    /// Part of the frame that is ultrasound and not the screen around it, where it is stated.
    pub region: Option<Region>,
    /// Positions of the frames along the sweep, where they are stated.
    pub places: Option<StatedPlaces>,
    /// Fields of the frames; empty where the file has none.
    pub frames: Vec<FrameFields>,
    /// Statements of the file that cannot be followed: an error unless an option of the user takes its
    /// place.
    pub unclear: Vec<(Statement, Unclear)>,
    /// Notes for people on content that was left out.
    pub notes: Vec<String>,
}

impl Header {
    /// Statement of the file about this that cannot be followed.
    pub fn unclear(&self, statement: Statement) -> Option<&Unclear> {
        self.unclear.iter().find(|(of, _)| *of == statement).map(|(_, unclear)| unclear)
    }
}

/// Statement that an option of the user can make in place of a file.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Statement {
    /// Size of a pixel.
    Spacing,
    /// Axes of the image.
    Orientation,
}

/// A field that cannot be followed.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{field}: {problem}, expected {expected}")]
pub struct Unclear {
    /// Field of the header.
    pub field: String,
    /// Content of the file.
    pub problem: String,
    /// Valid content.
    pub expected: String,
}
