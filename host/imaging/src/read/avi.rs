//! AVI films: Motion JPEG and uncompressed frames, as grabbers of scanners' screens and ffmpeg write them.
//!
//! Format: Microsoft's RIFF, AVI and BITMAPINFOHEADER; chapters of OpenDML (`AVIX`) are read, indices are not needed. Places and sizes of
//! the frames are found by one walk over the chunks; frames are then read one at a time.

use super::{FrameReader, Source, check_size, grey, jpeg, whole};
use crate::error::ImagingError;
use crate::frame::{Frame, FrameFields, Header, MAX_FRAMES, MAX_PIXELS};
use std::fs::File;
use std::io::{BufReader, Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};

/// Longest header of a stream.
const MAX_FORMAT: u64 = 4096;
/// Deepest nesting of lists.
const MAX_LEVELS: usize = 8;
/// Most chunks that are walked over: frames, sound, indices.
const MAX_CHUNKS: usize = 8 * MAX_FRAMES;

/// Format of pixels.
#[derive(Debug, Clone, PartialEq)]
enum Pixels {
    Jpeg,
    /// Rows padded to four bytes, the last row first unless the height is negative; so many bytes for a pixel.
    Bitmap {
        bytes: usize,
        is_top_down: bool,
    },
    /// Indices of colours.
    Palette {
        brightness: Vec<u8>,
        is_top_down: bool,
    },
    /// Brightness of every pixel; colours may follow.
    Planes {
        bytes: usize,
    },
    /// Brightness of every second byte.
    Packed {
        first: usize,
    },
}

/// Content that is found while walking.
#[derive(Default)]
struct Found {
    /// Seconds of a frame, by the header of the whole file and that of the stream.
    step_s: Option<f64>,
    is_video: bool,
    /// Streams so far, and the number of the one with the frames.
    streams: usize,
    video: usize,
    format: Option<(usize, usize, Pixels)>,
    /// Place and size of each frame.
    frames: Vec<(u64, u32)>,
}

impl Found {
    /// Whether the two digits of a chunk's name are those of the video's stream.
    fn is_of_video(&self, tens: &u8, ones: &u8) -> bool {
        let stream = hex_digit(tens).zip(hex_digit(ones)).map(|(tens, ones)| 16 * tens + ones);
        stream == Some(self.video)
    }
}

pub(super) fn open(path: &Path) -> Result<(Header, Source), ImagingError> {
    let mut bytes = BufReader::new(File::open(path).map_err(ImagingError::io(path))?);
    let end = bytes.seek(SeekFrom::End(0)).map_err(ImagingError::io(path))?;
    let mut contents = Found::default();
    walk(path, &mut bytes, end, &mut contents)?;
    let Found { step_s, format, mut frames, .. } = contents;
    let mut notes = Vec::new();
    // A recorder that is stopped by a power cut leaves the frames before whole.
    if frames.len() > 1 && frames.pop_if(|(place, size)| *place + u64::from(*size) > end).is_some() {
        notes.push(format!("the last frame is cut off: the {} frames before it are read", frames.len()));
    }
    let Some((width, height, pixels)) = format else {
        return Err(ImagingError::invalid(path, "strf", "missing", "an AVI film with a video stream"));
    };
    if frames.is_empty() {
        return Err(ImagingError::invalid(path, "movi", "no frames", "an AVI film with a video stream"));
    }
    let count = frames.len();
    check_size(path, "strf", [width, height, count])?;
    let times = step_s.map(|step_s| {
        (0..count)
            .map(|frame| FrameFields { time_s: Some(step_s * frame as f64), ..FrameFields::default() })
            .collect()
    });
    let frames_of = times.unwrap_or_default();
    let header = Header { width, height, count, frames: frames_of, notes, ..Header::default() };
    let avi =
        Avi { path: path.to_owned(), bytes, pixels, size: [width, height], frames, next: 0, last: None };
    Ok((header, Source::Reader(Box::new(avi))))
}

/// Goes over the chunks of a file.
fn walk(path: &Path, bytes: &mut BufReader<File>, end: u64, found: &mut Found) -> Result<(), ImagingError> {
    // Ends of the lists that are open.
    let mut lists: Vec<u64> = Vec::new();
    let mut chunk_index = 0u64;
    for _ in 0..MAX_CHUNKS {
        while lists.last().is_some_and(|list_end| chunk_index >= *list_end) {
            lists.pop();
        }
        bytes.seek(SeekFrom::Start(chunk_index)).map_err(ImagingError::io(path))?;
        let mut header = [0u8; 8];
        let is_first = chunk_index == 0;
        match bytes.read_exact(&mut header) {
            Ok(()) => {}
            Err(_) if is_first => return Err(header_problem("shorter than 8 bytes".to_owned(), path)),
            Err(_) => return Ok(()),
        }
        let [a, b, c, d, size @ ..] = header;
        let (name, size) = ([a, b, c, d], u32::from_le_bytes(size));
        let body = chunk_index + 8;
        if is_first && name != *b"RIFF" {
            return Err(header_problem("no RIFF".to_owned(), path));
        }
        if matches!(&name, b"RIFF" | b"LIST") {
            let mut kind = [0u8; 4];
            if bytes.read_exact(&mut kind).is_err() {
                return Ok(());
            }
            if is_first && kind != *b"AVI " {
                return Err(header_problem(format!("\"{}\" in RIFF", String::from_utf8_lossy(&kind)), path));
            }
            if matches!(&kind, b"AVI " | b"AVIX" | b"hdrl" | b"strl" | b"movi" | b"rec ") {
                if lists.len() >= MAX_LEVELS {
                    return Err(header_problem("lists in more than 8 levels".to_owned(), path));
                }
                if kind == *b"strl" {
                    found.is_video = false;
                    found.streams += 1;
                }
                lists.push(body.saturating_add(size.into()));
                chunk_index = body + 4;
                continue;
            }
        } else {
            chunk(path, bytes, name, size, found)?;
            if found.frames.len() > MAX_FRAMES {
                return check_size(path, "movi", [1, 1, found.frames.len()]);
            }
        }
        chunk_index = body + u64::from(size) + u64::from(size & 1);
        if chunk_index >= end {
            return Ok(());
        }
    }
    Err(header_problem(format!("more than {MAX_CHUNKS} chunks"), path))
}

fn header_problem(problem: String, path: &Path) -> ImagingError {
    ImagingError::invalid(path, "header", problem, "an AVI film: RIFF ... AVI")
}

/// Takes what matters of a chunk.
fn chunk(
    path: &Path,
    bytes: &mut BufReader<File>,
    name: [u8; 4],
    size: u32,
    found: &mut Found,
) -> Result<(), ImagingError> {
    match &name {
        b"avih" => {
            let step_us = little_endian_word(&chunk_content(size, bytes, path)?, 0);
            found.step_s = (step_us > 0).then(|| 1e-6 * f64::from(step_us));
        }
        b"strh" => {
            let content = chunk_content(size, bytes, path)?;
            found.is_video = found.format.is_none() && content.starts_with(b"vids");
            let (scale, rate) = (little_endian_word(&content, 20), little_endian_word(&content, 24));
            if found.is_video && scale > 0 && rate > 0 {
                found.step_s = Some(f64::from(scale) / f64::from(rate));
            }
        }
        b"strf" if found.is_video => {
            found.format = Some(format(path, &chunk_content(size, bytes, path)?)?);
            found.video = found.streams.saturating_sub(1);
            found.is_video = false;
        }
        [_, _, b'p', b'c'] => {
            let expected = "one palette for all frames, in the header, or frames without one";
            return Err(ImagingError::invalid(path, "movi", "a palette that changes", expected));
        }
        [tens, ones, b'd', b'b' | b'c'] if found.format.is_some() && found.is_of_video(tens, ones) => {
            let chunk_start = bytes.stream_position().map_err(ImagingError::io(path))?;
            found.frames.push((chunk_start, size));
        }
        _ => {}
    }
    Ok(())
}

fn hex_digit(byte: &u8) -> Option<usize> {
    char::from(*byte).to_digit(16).map(|digit| digit as usize)
}

fn little_endian_word(content: &[u8], at: usize) -> u32 {
    content
        .get(at..at + 4)
        .and_then(|word| word.first_chunk::<4>())
        .map_or(0, |word| u32::from_le_bytes(*word))
}

fn chunk_content(size: u32, bytes: &mut BufReader<File>, path: &Path) -> Result<Vec<u8>, ImagingError> {
    let mut content = Vec::new();
    let length = u64::from(size).min(MAX_FORMAT);
    bytes.take(length).read_to_end(&mut content).map_err(ImagingError::io(path))?;
    Ok::<_, ImagingError>(content)
}

/// Size of the frames and how pixels are written.
fn format(path: &Path, content: &[u8]) -> Result<(usize, usize, Pixels), ImagingError> {
    let (width, height) =
        (little_endian_word(content, 4) as usize, little_endian_word(content, 8).cast_signed());
    let (rows, is_top_down) = (height.unsigned_abs() as usize, height < 0);
    let bits = little_endian_word(content, 12) >> 16;
    let code = little_endian_word(content, 16).to_le_bytes();
    let pixels = match (&code, bits) {
        (b"MJPG" | b"mjpg" | b"JPEG", _) => Pixels::Jpeg,
        ([0, 0, 0, 0] | b"DIB ", 24 | 32) => Pixels::Bitmap { bytes: bits as usize / 8, is_top_down },
        ([0, 0, 0, 0], 8) => {
            let colours = content.get(40..).unwrap_or_default();
            let colours = colours.chunks_exact(4).take(256).flat_map(|colour| {
                let [b, g, r] = [0, 1, 2].map(|at| colour.get(at).copied().unwrap_or(0));
                [r, g, b]
            });
            let mut brightness = grey(colours.collect(), 3);
            if brightness.is_empty() {
                brightness = (0..=u8::MAX).collect();
            }
            Pixels::Palette { brightness, is_top_down }
        }
        (b"Y800" | b"GREY" | b"Y8  ", _) => Pixels::Planes { bytes: width.saturating_mul(rows) },
        (b"I420" | b"YV12" | b"IYUV" | b"NV12", _) => Pixels::Planes {
            bytes: width
                .saturating_mul(rows)
                .saturating_add(2 * width.div_ceil(2).saturating_mul(rows.div_ceil(2))),
        },
        (b"YUY2" | b"YUYV", _) => Pixels::Packed { first: 0 },
        (b"UYVY", _) => Pixels::Packed { first: 1 },
        _ => {
            let problem = format!("\"{}\" with {bits} bits", String::from_utf8_lossy(&code).escape_default());
            let expected = "Motion JPEG, or uncompressed frames: ffmpeg -i FILM -c:v mjpeg -q:v 1 -an OUT.avi converts others";
            return Err(ImagingError::invalid(path, "strf", problem, expected));
        }
    };
    check_size(path, "strf", [width, rows, 1])?;
    Ok((width, rows, pixels))
}

/// The frames of a film.
struct Avi {
    path: PathBuf,
    bytes: BufReader<File>,
    pixels: Pixels,
    size: [usize; 2],
    frames: Vec<(u64, u32)>,
    next: usize,
    /// The frame before: one without bytes repeats it.
    last: Option<Frame>,
}

impl FrameReader for Avi {
    fn next(&mut self) -> Result<Frame, ImagingError> {
        let number = self.next;
        self.next += 1;
        let field = format!("frame {}", number + 1);
        let problem = |problem: String| {
            ImagingError::invalid(&self.path, &*field, problem, "a whole frame of the film")
        };
        let (frame_offset, size) =
            self.frames.get(number).copied().ok_or_else(|| problem("missing".to_owned()))?;
        if size == 0 {
            return self.last.clone().ok_or_else(|| problem("no bytes".to_owned()));
        }
        if size as usize > 8 * MAX_PIXELS {
            return Err(problem(format!("{size} bytes")));
        }
        self.bytes.seek(SeekFrom::Start(frame_offset)).map_err(ImagingError::io(&self.path))?;
        let mut bytes = Vec::new();
        (&mut self.bytes).take(size.into()).read_to_end(&mut bytes).map_err(ImagingError::io(&self.path))?;
        if bytes.len() as u64 != u64::from(size) {
            return Err(problem(format!("{} of {size} bytes", bytes.len())));
        }
        let frame = self.decoded(&field, bytes)?;
        self.last = Some(frame.clone());
        Ok(frame)
    }
}

impl Avi {
    fn decoded(&self, field: &str, bytes: Vec<u8>) -> Result<Frame, ImagingError> {
        let [width, height] = self.size;
        let rows = |bytes_per_pixel: usize, is_top_down: bool| -> Vec<u8> {
            let stride = (width * bytes_per_pixel).next_multiple_of(4);
            let row = |row: &[u8]| row.get(..width * bytes_per_pixel).unwrap_or_default().to_vec();
            let rows = bytes.chunks_exact(stride).take(height);
            if is_top_down { rows.flat_map(row).collect() } else { rows.rev().flat_map(row).collect() }
        };
        let pixels = match &self.pixels {
            Pixels::Jpeg => {
                let frame = jpeg::decode(&self.path, field, &bytes, false)?;
                if [frame.width, frame.height] != self.size {
                    let problem = format!("{} x {} pixels", frame.width, frame.height);
                    let expected = format!("{width} x {height} as the header states");
                    return Err(ImagingError::invalid(&self.path, field, problem, expected));
                }
                frame.pixels
            }
            Pixels::Bitmap { bytes, is_top_down } => {
                let mut colours = rows(*bytes, *is_top_down);
                // Blue comes first.
                colours.chunks_exact_mut(*bytes).for_each(|pixel| pixel.swap(0, 2));
                grey(colours, *bytes)
            }
            Pixels::Palette { brightness, is_top_down } => rows(1, *is_top_down)
                .into_iter()
                .map(|index| brightness.get(usize::from(index)).copied().unwrap_or(0))
                .collect(),
            Pixels::Planes { bytes: needed } if bytes.len() < *needed => Vec::new(),
            Pixels::Planes { .. } => bytes.get(..width * height).unwrap_or_default().to_vec(),
            Pixels::Packed { first } => {
                bytes.iter().skip(*first).step_by(2).take(width * height).copied().collect()
            }
        };
        whole(&self.path, field, self.size, pixels)
    }
}
