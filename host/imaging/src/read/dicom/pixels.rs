//! Pixels of a DICOM file, frame by frame.

use super::super::depth::Depth;
use super::super::{FrameReader, grey, jpeg, whole};
use super::{
    Attributes, BITS_ALLOCATED, BITS_STORED, HIGH_BIT, INTERCEPT, PHOTOMETRIC, PLANAR, SAMPLES, SIGNED, SLOPE,
};
use crate::error::ImagingError;
use crate::frame::{Frame, MAX_PIXELS};
use std::fs::File;
use std::io::{BufReader, Read};
use std::path::{Path, PathBuf};

/// Longest compressed frame, bytes.
const MAX_FRAME: usize = 4 * MAX_PIXELS;

/// Compression of pixels.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Coding {
    Plain,
    Rle,
    Jpeg,
}

/// Meaning of a pixel's samples.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Colours {
    Grey,
    /// Bright is dark.
    Inverted,
    /// Places in a table of colours.
    Palette,
    Rgb,
    /// Brightness first.
    Ybr,
    /// Two brightnesses, then the two differences of both pixels.
    Ybr422,
}

/// Layout of a frame.
#[derive(Debug, Clone, Copy)]
pub(super) struct Layout {
    size: [usize; 2],
    colours: Colours,
    depth: Depth,
    /// Bits of 16 that are the sample's, and above which of them: others may hold an overlay.
    stored: [u32; 2],
    /// Samples of a kind lie together.
    is_planar: bool,
    /// Samples of 8 bit are exchanged two by two, as words whose high byte is first.
    is_exchanged: bool,
}

impl Layout {
    pub(super) fn new(header: &Attributes, size: [usize; 2]) -> Result<Self, ImagingError> {
        let photometric = header.text(PHOTOMETRIC).unwrap_or_default();
        let samples = header.number(SAMPLES).unwrap_or(1);
        // Values that fall as samples rise are the other way round.
        let falls = header
            .text(SLOPE)
            .and_then(|text| text.trim().parse().ok())
            .is_some_and(|slope: f64| slope < 0.0);
        let colours = match (photometric.as_str(), samples) {
            ("MONOCHROME2" | "MONOCHROME1", 1) if (photometric == "MONOCHROME1") == falls => Colours::Grey,
            ("MONOCHROME2" | "MONOCHROME1", 1) => Colours::Inverted,
            ("PALETTE COLOR", 1) => Colours::Palette,
            ("RGB", 3) => Colours::Rgb,
            ("YBR_FULL", 3) => Colours::Ybr,
            ("YBR_FULL_422", 3) => Colours::Ybr422,
            _ => {
                let problem =
                    format!("\"{}\" with {samples} samples", super::super::header::short(&photometric));
                let expected = "MONOCHROME1 or 2, PALETTE COLOR, RGB, YBR_FULL or YBR_FULL_422";
                return invalid("PhotometricInterpretation", problem, expected, header.path);
            }
        };
        let (allocated, is_signed) = (header.number(BITS_ALLOCATED), header.number(SIGNED) == Some(1));
        // Black is where the intercept lifts it to, not 0.
        if let Some(intercept) = header.text(INTERCEPT).filter(|text| is_signed && text.parse() != Ok(0.0)) {
            let problem = format!("{} with signed samples", super::super::header::short(&intercept));
            return invalid(
                "RescaleIntercept",
                problem,
                "unsigned samples: dcmconv or gdcmconv convert others",
                header.path,
            );
        }
        let stored = header.number(BITS_STORED).or(allocated).unwrap_or(8);
        let depth = match allocated {
            Some(8) => Depth::Eight,
            Some(16) if (1..=16).contains(&stored) => {
                let value_bits = if is_signed { stored - 1 } else { stored };
                Depth::Sixteen {
                    is_big_endian: header.is_big,
                    is_signed,
                    black: 0,
                    shift: (value_bits as u32).saturating_sub(8),
                }
            }
            _ => {
                let problem =
                    allocated.map_or_else(|| "missing".to_owned(), |bits| format!("{bits}, {stored} stored"));
                return invalid("BitsAllocated", problem, "8 or 16", header.path);
            }
        };
        if depth != Depth::Eight && !matches!(colours, Colours::Grey | Colours::Inverted) {
            return invalid("BitsAllocated", "16 with colours".to_owned(), "8 with colours", header.path);
        }
        let shift_bits = header
            .number(HIGH_BIT)
            .map_or(0, |high| (high + 1).saturating_sub(stored).min(16 - stored.min(16)));
        let stored = [stored as u32, shift_bits as u32];
        Ok(Self {
            size,
            colours,
            depth,
            stored,
            is_planar: header.number(PLANAR) == Some(1),
            is_exchanged: false,
        })
    }

    /// The layout of pixels that are written as words whose high byte is first, where there are such.
    pub(super) fn with_words(self, path: &Path, is_of_big_words: bool) -> Result<Self, ImagingError> {
        let is_exchanged = is_of_big_words && self.depth == Depth::Eight;
        if is_exchanged && !self.bytes().is_multiple_of(2) {
            let problem = format!("words of 16 bit, and frames of {} bytes", self.bytes());
            return Err(ImagingError::invalid(
                path,
                "PixelData",
                problem,
                "whole words in a frame: dcmconv +te converts",
            ));
        }
        Ok(Self { is_exchanged, ..self })
    }

    /// Whether samples are places in a table of colours.
    pub(super) fn has_palette(self) -> bool {
        self.colours == Colours::Palette
    }

    fn samples(self) -> usize {
        if matches!(self.colours, Colours::Grey | Colours::Inverted | Colours::Palette) { 1 } else { 3 }
    }

    /// Bytes of an uncompressed frame.
    fn bytes(self) -> usize {
        let pixels = self.size[0] * self.size[1];
        match self.colours {
            Colours::Ybr422 => 2 * pixels,
            _ => pixels * self.samples() * self.depth.bytes(),
        }
    }

    /// The samples without the bits that are none of them.
    fn used(self, mut bytes: Vec<u8>) -> Vec<u8> {
        let [stored, shift_bits] = self.stored;
        let Depth::Sixteen { is_big_endian, is_signed, .. } = self.depth else { return bytes };
        if stored == 16 {
            return bytes;
        }
        for pair in bytes.as_chunks_mut::<2>().0 {
            let value = if is_big_endian { u16::from_be_bytes(*pair) } else { u16::from_le_bytes(*pair) };
            // To the upper end, which is where a sign is, and down again.
            let upper = (value >> shift_bits) << (16 - stored);
            let value = if is_signed {
                (upper.cast_signed() >> (16 - stored)).cast_unsigned()
            } else {
                upper >> (16 - stored)
            };
            *pair = if is_big_endian { value.to_be_bytes() } else { value.to_le_bytes() };
        }
        bytes
    }

    /// Refuses a frame with samples below zero of more than one value, which is the fill beside an image: what of them is black is not stated.
    fn check_signs(self, path: &Path, field: &str, bytes: &[u8]) -> Result<(), ImagingError> {
        let Depth::Sixteen { is_signed: true, .. } = self.depth else { return Ok(()) };
        if self.depth.levels_below_zero(&self.used(bytes.to_vec())) < 2 {
            return Ok(());
        }
        let expected = "samples from 0 up: dcmconv or gdcmconv convert others";
        Err(ImagingError::invalid(path, field, "samples below zero", expected))
    }

    /// Brightness of an uncompressed frame.
    fn grey(self, bytes: Vec<u8>) -> Vec<u8> {
        let pixels = self.size[0] * self.size[1];
        let together = |bytes: Vec<u8>| {
            if !self.is_planar {
                return bytes;
            }
            let plane = |number: usize| bytes.iter().skip(number * pixels).take(pixels);
            plane(0).zip(plane(1)).zip(plane(2)).flat_map(|((a, b), c)| [*a, *b, *c]).collect()
        };
        match self.colours {
            Colours::Palette => bytes,
            Colours::Grey => self.depth.samples(self.used(bytes)),
            Colours::Inverted => {
                self.depth.samples(self.used(bytes)).into_iter().map(|value| !value).collect()
            }
            Colours::Rgb => grey(together(bytes), 3),
            Colours::Ybr => {
                let (triples, _) = bytes.as_chunks::<3>();
                let of_planes = || together(bytes.clone());
                let triples =
                    if self.is_planar { of_planes().as_chunks::<3>().0.to_vec() } else { triples.to_vec() };
                triples.into_iter().map(|[y, b, r]| without_colour(y, b, r)).collect()
            }
            Colours::Ybr422 => {
                let (quads, _) = bytes.as_chunks::<4>();
                quads
                    .iter()
                    .flat_map(|[y, other, b, r]| [*y, *other].map(|y| without_colour(y, *b, *r)))
                    .collect()
            }
        }
    }
}

fn invalid(field: &str, problem: String, expected: &str, path: &Path) -> Result<Layout, ImagingError> {
    Err(ImagingError::invalid(path, field, problem, expected))
}

/// Brightness of a pixel; black where it has a colour, as [`grey`] has it.
fn without_colour(y: u8, b: u8, r: u8) -> u8 {
    /// Half the difference of channels from which a pixel has a colour, over the factor from differences to channels.
    const DIFFERENCE: u8 = 36;
    if b.abs_diff(128).max(r.abs_diff(128)) > DIFFERENCE { 0 } else { y }
}

/// The frames of a file.
pub(super) struct Pixels {
    path: PathBuf,
    bytes: BufReader<File>,
    coding: Coding,
    layout: Layout,
    /// Brightness of every index, where samples are places in a table.
    palette: Vec<u8>,
    count: usize,
    next: usize,
    /// The first fragment of the next frame, where it had to be read to find the end of this one.
    ahead: Option<Vec<u8>>,
}

impl Pixels {
    pub(super) fn new(
        path: &Path,
        mut bytes: BufReader<File>,
        coding: Coding,
        (layout, palette): (Layout, Vec<u8>),
        count: usize,
        length: Option<u64>,
    ) -> Result<Self, ImagingError> {
        let needed = layout.bytes() as u64 * count as u64;
        if let Some(length) = length.filter(|length| *length < needed) {
            let expected =
                format!("{needed} bytes for {count} frames of {} x {}", layout.size[0], layout.size[1]);
            return Err(ImagingError::invalid(path, "PixelData", format!("{length} bytes"), expected));
        }
        if coding != Coding::Plain {
            // The table of offsets; frames are found by what they begin with.
            fragment(path, &mut bytes, "table of offsets")?;
        }
        Ok(Self { path: path.to_owned(), bytes, coding, layout, palette, count, next: 0, ahead: None })
    }

    /// The bytes of a compressed frame. One of JPEG may have several fragments: the next one begins with its marker.
    fn compressed(&mut self, field: &str) -> Result<Vec<u8>, ImagingError> {
        let mut whole = match self.ahead.take() {
            Some(ahead) => ahead,
            None => fragment(&self.path, &mut self.bytes, field)?.ok_or_else(|| {
                let expected = format!("a fragment for each of {} frames", self.count);
                ImagingError::invalid(&self.path, field, "missing", expected)
            })?,
        };
        if self.coding == Coding::Rle {
            return Ok(whole);
        }
        while let Some(next) = fragment(&self.path, &mut self.bytes, field)? {
            if next.starts_with(&[0xFF, 0xD8]) {
                self.ahead = Some(next);
                break;
            }
            if whole.len() + next.len() > MAX_FRAME {
                let problem = format!("more than {MAX_FRAME} bytes");
                return Err(ImagingError::invalid(&self.path, field, problem, "a compressed frame"));
            }
            whole.extend(next);
        }
        Ok(whole)
    }

    /// An uncompressed frame out of segments of run lengths, one for each byte of a pixel, high bytes first (PS3.5, annex G).
    fn unpacked(&self, field: &str, bytes: &[u8]) -> Result<Vec<u8>, ImagingError> {
        let (words, _) = bytes
            .get(..64)
            .ok_or_else(|| self.field_problem("shorter than its header", field))?
            .as_chunks::<4>();
        let words: Vec<usize> = words.iter().map(|word| u32::from_le_bytes(*word) as usize).collect();
        let (samples, size) = (self.layout.samples(), self.layout.depth.bytes());
        let (segments, pixels) = (samples * size, self.layout.size[0] * self.layout.size[1]);
        if words.first() != Some(&segments) {
            return Err(self.field_problem(&format!("not {segments} segments"), field));
        }
        let mut frame = vec![0; segments * pixels];
        for segment in 0..segments {
            let segment_start = words.get(segment + 1).copied().unwrap_or(0);
            let segment_end = if segment + 1 < segments { words.get(segment + 2).copied() } else { None };
            let packed = bytes
                .get(segment_start..segment_end.unwrap_or(bytes.len()))
                .ok_or_else(|| self.field_problem("a segment beyond its end", field))?;
            // Samples lie pixel by pixel, the low byte of one first.
            let (sample, byte) = (segment / size, size - 1 - segment % size);
            let mut slots = frame.iter_mut().skip(sample * size + byte).step_by(segments);
            let mut packed = packed.iter().copied();
            let mut remaining_pixels = pixels;
            while remaining_pixels > 0 {
                let count = packed
                    .next()
                    .ok_or_else(|| self.field_problem("a segment ends early", field))?
                    .cast_signed();
                let run = 1 + usize::from(count.unsigned_abs());
                let mut put = |value: Option<u8>| -> Result<(), ImagingError> {
                    let value = value.ok_or_else(|| self.field_problem("a segment ends early", field))?;
                    if let Some(slot) = slots.next() {
                        *slot = value;
                    }
                    Ok(())
                };
                match count {
                    i8::MIN => continue,
                    0.. => (0..run.min(remaining_pixels)).try_for_each(|_| put(packed.next()))?,
                    _ => {
                        let value = packed.next();
                        (0..run.min(remaining_pixels)).try_for_each(|_| put(value))?;
                    }
                }
                remaining_pixels -= run.min(remaining_pixels);
            }
        }
        Ok(frame)
    }

    fn field_problem(&self, problem: &str, field: &str) -> ImagingError {
        ImagingError::invalid(&self.path, field, problem.to_owned(), "a whole frame of run lengths")
    }
}

impl FrameReader for Pixels {
    fn next(&mut self) -> Result<Frame, ImagingError> {
        self.next += 1;
        let field = format!("frame {}", self.next);
        let layout = self.layout;
        let plain = match self.coding {
            Coding::Plain => {
                let mut bytes = vec![0; layout.bytes()];
                self.bytes.read_exact(&mut bytes).map_err(|cause| {
                    let [width, height] = layout.size;
                    let expected = format!("{} frames of {width} x {height}", self.count);
                    ImagingError::invalid(&self.path, &*field, cause.to_string(), expected)
                })?;
                if layout.is_exchanged {
                    bytes.as_chunks_mut::<2>().0.iter_mut().for_each(|pair| pair.swap(0, 1));
                }
                layout.check_signs(&self.path, &field, &bytes)?;
                layout.grey(bytes)
            }
            Coding::Rle => {
                let bytes = self.compressed(&field)?;
                // Unpacked samples lie pixel by pixel, and have the processor's own order.
                let depth = match layout.depth {
                    Depth::Sixteen { is_signed, black, shift, .. } => {
                        Depth::Sixteen { is_big_endian: false, is_signed, black, shift }
                    }
                    Depth::Eight => Depth::Eight,
                };
                let colours = if layout.colours == Colours::Ybr422 { Colours::Ybr } else { layout.colours };
                let unpacked = self.unpacked(&field, &bytes)?;
                let layout = Layout { is_planar: false, depth, colours, ..layout };
                layout.check_signs(&self.path, &field, &unpacked)?;
                layout.grey(unpacked)
            }
            Coding::Jpeg => {
                let bytes = self.compressed(&field)?;
                let frame = jpeg::decode(&self.path, &field, &bytes, layout.colours == Colours::Rgb)?;
                if [frame.width, frame.height] != layout.size {
                    let problem = format!("{} x {} pixels", frame.width, frame.height);
                    let expected = format!("{} x {} as the header states", layout.size[0], layout.size[1]);
                    return Err(ImagingError::invalid(&self.path, &*field, problem, expected));
                }
                match layout.colours {
                    Colours::Inverted => frame.pixels.into_iter().map(|value| !value).collect(),
                    _ => frame.pixels,
                }
            }
        };
        let plain = if layout.has_palette() {
            plain
                .into_iter()
                .map(|index| self.palette.get(usize::from(index)).copied().unwrap_or(0))
                .collect()
        } else {
            plain
        };
        whole(&self.path, &field, layout.size, plain)
    }
}

/// The next item of a sequence of fragments; none at its end.
fn fragment(path: &Path, bytes: &mut impl Read, field: &str) -> Result<Option<Vec<u8>>, ImagingError> {
    let mut header = [0u8; 8];
    bytes.read_exact(&mut header).map_err(|cause| fragment_problem(cause.to_string(), field, path))?;
    let [group, 0xFF, kind, 0xE0, a, b, c, d] = header else {
        return Err(fragment_problem("no item".to_owned(), field, path));
    };
    let length = u32::from_le_bytes([a, b, c, d]);
    match (group, kind) {
        (0xFE, 0xDD) => Ok(None),
        (0xFE, 0x00) if length as usize <= MAX_FRAME => {
            let mut fragment = Vec::new();
            bytes.take(length.into()).read_to_end(&mut fragment).map_err(ImagingError::io(path))?;
            if fragment.len() as u64 != u64::from(length) {
                return Err(fragment_problem(format!("{} of {length} bytes", fragment.len()), field, path));
            }
            Ok(Some(fragment))
        }
        (0xFE, 0x00) => Err(fragment_problem(format!("an item of {length} bytes"), field, path)),
        _ => Err(fragment_problem("no item".to_owned(), field, path)),
    }
}

fn fragment_problem(problem: String, field: &str, path: &Path) -> ImagingError {
    ImagingError::invalid(path, field, problem, "fragments of compressed frames")
}
