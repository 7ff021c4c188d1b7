//! Stacks of PNG, TIFF and JPEG files: a frame for each file, or several in a TIFF.

use super::depth::{shift_for, shifted};
use super::{Source, check_size, grey, jpeg, whole};
use crate::error::ImagingError;
use crate::frame::{Frame, Header, MAX_FRAMES, MAX_PIXELS};
use std::fs::{self, File};
use std::io::{BufReader, Read};
use std::path::{Path, PathBuf};
use tiff::ColorType;
use tiff::decoder::{Decoder, DecodingResult, Limits};

/// Files with the pages of each.
pub(super) struct Stack {
    /// A file and a page in it for each frame.
    pages: Vec<(PathBuf, usize)>,
    /// The TIFF that is being read, and the page it is at.
    open: Option<(PathBuf, usize, Decoder<BufReader<File>>)>,
    size: [usize; 2],
    /// Bits of 16 that are dropped.
    shift: u32,
}

/// Longest JPEG file.
const MAX_JPEG: u64 = 8 * MAX_PIXELS as u64;

/// Samples as a file has them.
enum Samples {
    Eight(Vec<u8>),
    Sixteen(Vec<u16>),
}

/// An image as a file has it.
struct Image {
    size: [usize; 2],
    channels: usize,
    samples: Samples,
}

impl Image {
    /// Brightness with 8 bit.
    fn frame(self, path: &Path, shift: u32) -> Result<Frame, ImagingError> {
        let samples = match self.samples {
            Samples::Eight(samples) => samples,
            Samples::Sixteen(samples) => samples.into_iter().map(|value| shifted(value, shift)).collect(),
        };
        whole(path, "image", self.size, grey(samples, self.channels))
    }
}

/// The image files in a folder, in the order of the numbers in their names.
pub(super) fn files(folder: &Path) -> Result<Vec<PathBuf>, ImagingError> {
    let entries = fs::read_dir(folder).map_err(ImagingError::io(folder))?;
    let is_image = |path: &PathBuf| {
        path.extension().is_some_and(|extension| {
            ["png", "tif", "tiff", "jpg", "jpeg"].iter().any(|known| extension.eq_ignore_ascii_case(known))
        })
    };
    let mut files: Vec<PathBuf> = entries
        .filter_map(Result::ok)
        .map(|entry| entry.path())
        .filter(is_image)
        .take(MAX_FRAMES + 1)
        .collect();
    files.sort_by_cached_key(|path| natural(&path.file_name().unwrap_or_default().to_string_lossy()));
    if files.is_empty() {
        return Err(ImagingError::invalid(folder, "files", "none", "PNG, TIFF or JPEG files"));
    }
    Ok(files)
}

/// A name as text and numbers, so that `frame-10` is behind `frame-9`.
fn natural(name: &str) -> Vec<(String, u128, usize)> {
    let mut parts: Vec<(String, u128, usize)> = vec![Default::default()];
    let mut in_number = false;
    for letter in name.chars() {
        match letter.to_digit(10) {
            Some(digit) => {
                if let Some((_, number, digits)) = parts.last_mut() {
                    *number = number.saturating_mul(10).saturating_add(u128::from(digit));
                    *digits += 1;
                }
                in_number = true;
            }
            None => {
                if in_number {
                    parts.push(Default::default());
                }
                in_number = false;
                if let Some((text, ..)) = parts.last_mut() {
                    text.push(letter);
                }
            }
        }
    }
    parts
}

pub(super) fn open(path: &Path, files: Vec<PathBuf>) -> Result<(Header, Source), ImagingError> {
    let mut pages = Vec::new();
    for file in &files {
        let count = if is_tiff(file) { tiff_pages(file)? } else { 1 };
        pages.extend((0..count).map(|page| (file.clone(), page)));
        if pages.len() > MAX_FRAMES {
            check_size(path, "frames", [1, 1, pages.len()])?;
        }
    }
    let mut stack = Stack { pages, open: None, size: [0, 0], shift: 0 };
    let first = stack.image(0)?;
    stack.size = first.size;
    if matches!(first.samples, Samples::Sixteen(_)) {
        stack.shift = shift_for(stack.greatest());
    }
    stack.open = None;
    let [width, height] = first.size;
    let header = Header { width, height, count: stack.pages.len(), ..Header::default() };
    Ok((header, Source::Stack(Box::new(stack))))
}

fn is_tiff(path: &Path) -> bool {
    path.extension().is_some_and(|e| e.eq_ignore_ascii_case("tif") || e.eq_ignore_ascii_case("tiff"))
}

fn decoder(path: &Path) -> Result<Decoder<BufReader<File>>, ImagingError> {
    let file = File::open(path).map_err(ImagingError::io(path))?;
    let mut limits = Limits::default();
    limits.decoding_buffer_size = 8 * MAX_PIXELS;
    limits.intermediate_buffer_size = 8 * MAX_PIXELS;
    limits.ifd_value_size = 1 << 20;
    Ok(Decoder::new(BufReader::new(file)).map_err(damaged(path))?.with_limits(limits))
}

fn tiff_pages(path: &Path) -> Result<usize, ImagingError> {
    let mut decoder = decoder(path)?;
    let mut count = 1;
    while decoder.more_images() {
        decoder.next_image().map_err(damaged(path))?;
        count += 1;
        if count > MAX_FRAMES {
            check_size(path, "pages", [1, 1, count])?;
        }
    }
    Ok(count)
}

impl Stack {
    /// A frame by its number.
    pub(super) fn frame(&mut self, number: usize) -> Result<Frame, ImagingError> {
        let image = self.image(number)?;
        let path = self.pages.get(number).map(|(path, _)| path.clone()).unwrap_or_default();
        let [width, height] = self.size;
        if image.size != self.size {
            let problem = format!("{} x {} pixels", image.size[0], image.size[1]);
            let expected =
                format!("{width} x {height} as in the first frame: depth or zoom changed in between");
            return Err(ImagingError::invalid(&path, format!("frame {}", number + 1), problem, expected));
        }
        image.frame(&path, self.shift)
    }

    fn image(&mut self, number: usize) -> Result<Image, ImagingError> {
        let Some((path, page)) = self.pages.get(number).cloned() else {
            let problem = number.to_string();
            return Err(ImagingError::invalid(Path::new(""), "frame", problem, "a frame of the stack"));
        };
        if is_tiff(&path) {
            self.tiff(&path, page)
        } else if path.extension().is_some_and(|e| e.eq_ignore_ascii_case("png")) {
            png(&path)
        } else {
            let file = File::open(&path).map_err(ImagingError::io(&path))?;
            let mut bytes = Vec::new();
            file.take(MAX_JPEG).read_to_end(&mut bytes).map_err(ImagingError::io(&path))?;
            let Frame { width, height, pixels } = jpeg::decode(&path, "image", &bytes, false)?;
            Ok(Image { size: [width, height], channels: 1, samples: Samples::Eight(pixels) })
        }
    }

    /// The greatest sample of all frames of 16 bit. A frame that cannot be read is reported when it is reached.
    fn greatest(&mut self) -> u16 {
        let of = |image: Image| match image.samples {
            Samples::Sixteen(samples) => samples.into_iter().max().unwrap_or(0),
            Samples::Eight(_) => 0,
        };
        (0..self.pages.len()).filter_map(|number| self.image(number).ok()).map(of).max().unwrap_or(0)
    }

    fn tiff(&mut self, path: &Path, page: usize) -> Result<Image, ImagingError> {
        let (mut at, mut decoder) = match self.open.take() {
            Some((open, at, decoder)) if open == path && at <= page => (at, decoder),
            _ => (0, decoder(path)?),
        };
        while at < page {
            decoder.next_image().map_err(damaged(path))?;
            at += 1;
        }
        let (width, height) = decoder.dimensions().map_err(damaged(path))?;
        let [width, height] = [width as usize, height as usize];
        check_size(path, "size", [width, height, 1])?;
        let kind = decoder.colortype().map_err(damaged(path))?;
        let channels = match kind {
            ColorType::Gray(8 | 16) => 1,
            ColorType::GrayA(8 | 16) => 2,
            ColorType::RGB(8 | 16) => 3,
            ColorType::RGBA(8 | 16) => 4,
            other => {
                let expected = "grey or RGB of 8 or 16 bit";
                return Err(ImagingError::invalid(path, "colour", format!("{other:?}"), expected));
            }
        };
        let samples = match decoder.read_image().map_err(damaged(path))? {
            DecodingResult::U8(samples) => Samples::Eight(samples),
            DecodingResult::U16(samples) => Samples::Sixteen(samples),
            _ => return Err(ImagingError::invalid(path, "colour", format!("{kind:?}"), "8 or 16 bit")),
        };
        self.open = Some((path.to_owned(), page, decoder));
        Ok(Image { size: [width, height], channels, samples })
    }
}

fn png(path: &Path) -> Result<Image, ImagingError> {
    let file = File::open(path).map_err(ImagingError::io(path))?;
    let damaged = |cause: png::DecodingError| {
        ImagingError::invalid(
            path,
            "image",
            cause.to_string(),
            "a whole PNG file of at most 16 million pixels",
        )
    };
    let limits = png::Limits { bytes: 8 * MAX_PIXELS };
    let mut decoder = png::Decoder::new_with_limits(BufReader::new(file), limits);
    decoder.set_transformations(png::Transformations::EXPAND);
    let mut reader = decoder.read_info().map_err(damaged)?;
    let [width, height] = [reader.info().width as usize, reader.info().height as usize];
    check_size(path, "size", [width, height, 1])?;
    let (kind, depth) = reader.output_color_type();
    let bytes = if depth == png::BitDepth::Sixteen { 2 } else { 1 };
    let mut pixels = vec![0; width * height * kind.samples() * bytes];
    reader.next_frame(&mut pixels).map_err(damaged)?;
    let samples = match depth {
        png::BitDepth::Sixteen => {
            Samples::Sixteen(pixels.as_chunks::<2>().0.iter().map(|pair| u16::from_be_bytes(*pair)).collect())
        }
        _ => Samples::Eight(pixels),
    };
    Ok(Image { size: [width, height], channels: kind.samples(), samples })
}

fn damaged(path: &Path) -> impl Fn(tiff::TiffError) -> ImagingError + '_ {
    move |cause| {
        ImagingError::invalid(
            path,
            "image",
            cause.to_string(),
            "a whole TIFF file of at most 16 million pixels",
        )
    }
}
