//! Sequences of frames as laboratories record them, read frame by frame.
//!
//! Memory: one frame (at most [`MAX_PIXELS`] bytes of brightness, eight times as much while a colour or 16 bit image is converted; what is
//! compressed at most 128 MiB), and the header (at most 64 MiB of text), whatever a file declares.

mod avi;
mod beside;
mod depth;
#[cfg(feature = "dicom")]
mod dicom;
mod header;
mod jpeg;
mod metaimage;
mod names;
mod nrrd;
mod stack;
mod tiff;
mod turned;

use crate::error::ImagingError;
use crate::frame::{Frame, Header, MAX_FRAMES, MAX_PIXELS};
use depth::{Depth, Extremes};
use std::io::Read;
use std::path::{Path, PathBuf};

/// Formats of frames that are read: names of files, and what of their formats.
pub const READ: &[[&str; 2]] = &[
    [
        ".mha, .mhd",
        "MetaImage, raw or zlib, 8 or 16 bit, grey or RGB; fields of frames as PLUS writes them; data beside it: a file, a LIST of them or a pattern, behind HeaderSize",
    ],
    [
        ".nrrd, .nhdr",
        "NRRD, raw or gzip, 8 or 16 bit, grey or RGB; frames as the last or the first axis; line skip, byte skip, units; data file",
    ],
    #[cfg(feature = "dicom")]
    [
        ".dcm, .ima, any name",
        "DICOM, one frame or many, or a folder of files: uncompressed, RLE, JPEG baseline, palettes; size of a pixel by region",
    ],
    [
        ".avi",
        "Motion JPEG (with or without Huffman tables) or uncompressed; a last frame that is cut off is left out",
    ],
    [".png, .jpg", "a file, or a folder of them in the order of their numbers"],
    [
        ".tif",
        "TIFF, 8 or 16 bit: grey, RGB, palettes, planes apart; several pages; stacks of ImageJ in one directory; size of a pixel of ImageJ and OME",
    ],
];

/// A sequence of frames being read.
pub struct Sequence {
    path: PathBuf,
    header: Header,
    source: Source,
    next: usize,
}

/// Source of the frames.
enum Source {
    /// One frame behind the other, so many samples for each pixel.
    Stream { bytes: Box<dyn Read>, channels: usize, depth: Depth },
    /// A file for each frame, or several frames in a file.
    Stack(Box<stack::Stack>),
    /// A container with frames of its own.
    Reader(Box<dyn FrameReader>),
}

/// Frames of a container, in order.
trait FrameReader {
    /// The next one.
    fn next(&mut self) -> Result<Frame, ImagingError>;
}

impl Sequence {
    /// Opens a file of frames (`.mha`, `.mhd`, `.nrrd`, `.nhdr`, `.dcm`, `.avi`, `.png`, `.tif`, `.tiff`, `.jpg`, `.jpeg`; DICOM under any other
    /// name), or a folder of PNG, TIFF or JPEG files, which are its frames in the order of the numbers in their names, or of DICOM
    /// files, in the order of their instance numbers. Hidden files are left out.
    ///
    /// Samples of 16 bit are scaled by the power of two that the brightest of the sequence needs to have 8, for which the file is read
    /// twice; in DICOM the header states how many bits are used.
    ///
    /// # Errors
    /// [`ImagingError`] names file, field and what is valid.
    pub fn open(path: &Path) -> Result<Self, ImagingError> {
        let extension = path.extension().map(|extension| extension.to_string_lossy().to_lowercase());
        let (header, source) = if path.is_dir() {
            folder(path)?
        } else {
            match extension.as_deref() {
                Some("mha" | "mhd") => twice(|| metaimage::open(path))?,
                Some("nrrd" | "nhdr") => twice(|| nrrd::open(path))?,
                #[cfg(feature = "dicom")]
                Some("dcm" | "dicom" | "ima") => dicom::open(path)?,
                #[cfg(not(feature = "dicom"))]
                Some("dcm" | "dicom" | "ima") => {
                    let expected = "a sequence in another format: this program was built without DICOM (its feature `dicom`)";
                    return Err(ImagingError::invalid(path, "name", "DICOM", expected));
                }
                Some("avi") => avi::open(path)?,
                Some("png" | "tif" | "tiff" | "jpg" | "jpeg") => stack::open(path, vec![path.to_owned()])?,
                // Archives name files by their UID, whose last number looks like an ending.
                #[cfg(feature = "dicom")]
                _ if dicom::is_dicom(path) => dicom::open(path)?,
                Some(film @ ("mp4" | "mov" | "m4v" | "mkv" | "wmv" | "webm" | "mpg" | "gif")) => {
                    let problem = format!("a film of .{film}");
                    let expected = "AVI with motion JPEG: ffmpeg -i FILM -c:v mjpeg -q:v 2 film.avi";
                    return Err(ImagingError::invalid(path, "name", problem, expected));
                }
                Some("mcap" | "bag" | "db3") => {
                    let expected = "pictures or a film: `ros2 run image_view image_saver --ros-args -r image:=/TOPIC` while \
                                    `ros2 bag play` plays it, and a folder of them here (forces and positions in it are read by `guide import table`)";
                    return Err(ImagingError::invalid(path, "name", "a bag of ROS", expected));
                }
                _ => {
                    let problem = extension.map_or_else(|| "no extension".to_owned(), |e| format!(".{e}"));
                    let expected = ".mha, .mhd, .nrrd, .nhdr, .dcm, .avi, .png, .tif, .tiff, .jpg, or a folder of PNG, TIFF or JPEG files";
                    return Err(ImagingError::invalid(path, "name", problem, expected));
                }
            }
        };
        Ok(Self { path: path.to_owned(), header, source, next: 0 })
    }

    /// Opens several PNG or TIFF files as one sequence, in the given order.
    ///
    /// # Errors
    /// As [`Self::open`].
    pub fn open_stack(paths: &[PathBuf]) -> Result<Self, ImagingError> {
        let path = paths.first().cloned().unwrap_or_default();
        let (header, source) = stack::open(&path, paths.to_vec())?;
        Ok(Self { path, header, source, next: 0 })
    }

    /// Header of the file.
    pub fn header(&self) -> &Header {
        &self.header
    }

    /// The next frame; none behind the last.
    ///
    /// # Errors
    /// [`ImagingError`] where the file ends early or is damaged.
    pub fn next_frame(&mut self) -> Result<Option<Frame>, ImagingError> {
        if self.next >= self.header.count {
            return Ok(None);
        }
        let (width, height) = (self.header.width, self.header.height);
        let number = self.next;
        self.next += 1;
        match &mut self.source {
            Source::Stream { bytes, channels, depth } => {
                let mut pixels = vec![0; width * height * *channels * depth.bytes()];
                bytes.read_exact(&mut pixels).map_err(|cause| {
                    let field = format!("frame {}", number + 1);
                    let expected = format!("{} frames of {width} x {height}", self.header.count);
                    ImagingError::invalid(&self.path, field, cause.to_string(), expected)
                })?;
                Ok(Some(Frame { width, height, pixels: grey(depth.samples(pixels), *channels) }))
            }
            Source::Stack(stack) => stack.frame(number).map(Some),
            Source::Reader(reader) => reader.next().map(Some),
        }
    }
}

/// Opens a folder of files that are frames each.
fn folder(path: &Path) -> Result<(Header, Source), ImagingError> {
    let (files, remark) = stack::files(path)?;
    #[cfg(feature = "dicom")]
    if files.is_empty() {
        let files = dicom::files(path)?;
        if !files.is_empty() {
            return dicom::open_files(path, &files);
        }
    }
    if files.is_empty() {
        return Err(ImagingError::invalid(path, "files", "none", "PNG, TIFF, JPEG or DICOM files"));
    }
    names::check_numbers(path, &files)?;
    let (mut header, source) = stack::open(path, files)?;
    header.notes.extend(remark);
    Ok((header, source))
}

/// Opens a stream; one of 16 bit is read through once for its darkest and brightest samples, and opened again.
fn twice(
    open: impl Fn() -> Result<(Header, Source), ImagingError>,
) -> Result<(Header, Source), ImagingError> {
    let (header, mut source) = open()?;
    let Source::Stream { bytes, channels, depth: depth @ Depth::Sixteen { .. } } = &mut source else {
        return Ok((header, source));
    };
    let row = header.width * *channels * depth.bytes();
    let mut samples = vec![0; row];
    let mut extremes = Extremes::default();
    // A file that ends early is reported with the number of its frame, when it is reached.
    for _ in 0..header.height * header.count {
        if bytes.read_exact(&mut samples).is_err() {
            break;
        }
        extremes.add(*depth, &samples);
    }
    let (header, mut source) = open()?;
    if let Source::Stream { depth, .. } = &mut source {
        *depth = extremes.fit(*depth);
    }
    Ok((header, source))
}

/// Files that systems leave beside those of the user: names that begin with a dot, and lists of pictures.
fn is_hidden(path: &Path) -> bool {
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    name.starts_with('.') || ["Thumbs.db", "desktop.ini"].iter().any(|known| name.eq_ignore_ascii_case(known))
}

/// A frame with as many pixels as it has.
fn whole(path: &Path, field: &str, size: [usize; 2], pixels: Vec<u8>) -> Result<Frame, ImagingError> {
    let [width, height] = size;
    if pixels.len() == width * height {
        return Ok(Frame { width, height, pixels });
    }
    let expected = format!("{width} x {height}");
    Err(ImagingError::invalid(path, field, format!("{} pixels", pixels.len()), expected))
}

/// Brightness of pixels of several channels. A coloured pixel is part of the screen's overlay, and no echo: black.
fn grey(pixels: Vec<u8>, channels: usize) -> Vec<u8> {
    /// Channels of a grey pixel of a lossy recording differ by less.
    const COLOUR: u8 = 64;
    match channels {
        0 | 1 => pixels,
        2 => pixels.chunks_exact(2).filter_map(|pixel| pixel.first().copied()).collect(),
        _ => pixels
            .chunks_exact(channels)
            .map(|pixel| {
                let [r, g, b] = [0, 1, 2].map(|i| pixel.get(i).copied().unwrap_or(0));
                let (least, most) = (r.min(g).min(b), r.max(g).max(b));
                let luminance = (299 * u32::from(r) + 587 * u32::from(g) + 114 * u32::from(b)) / 1000;
                if most - least > COLOUR { 0 } else { luminance as u8 }
            })
            .collect(),
    }
}

/// Refuses sizes that no sequence has, before anything of that size is kept.
fn check_size(path: &Path, field: &str, sizes: [usize; 3]) -> Result<(), ImagingError> {
    let [width, height, count] = sizes;
    let pixels = width.checked_mul(height);
    let is_possible =
        pixels.is_some_and(|pixels| (1..=MAX_PIXELS).contains(&pixels)) && (1..=MAX_FRAMES).contains(&count);
    if is_possible {
        return Ok(());
    }
    let expected = format!("1 to {MAX_PIXELS} pixels in a frame and 1 to {MAX_FRAMES} frames");
    Err(ImagingError::invalid(path, field, format!("{width} x {height} pixels, {count} frames"), expected))
}

#[cfg(test)]
mod beside_tests;
#[cfg(test)]
mod others_tests;
#[cfg(test)]
mod stated_tests;
#[cfg(test)]
mod tests;
#[cfg(test)]
mod valid_tests;
