//! Stacks of PNG and TIFF files: a frame for each file, or several in a TIFF.

use super::{Source, check_size, grey};
use crate::error::ImagingError;
use crate::frame::{Frame, Header, MAX_FRAMES, MAX_PIXELS};
use std::fs::{self, File};
use std::io::BufReader;
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
}

/// The PNG and TIFF files in a folder, in the order of the numbers in their names.
pub(super) fn files(folder: &Path) -> Result<Vec<PathBuf>, ImagingError> {
    let entries = fs::read_dir(folder).map_err(ImagingError::io(folder))?;
    let is_image = |path: &PathBuf| {
        path.extension().is_some_and(|extension| {
            ["png", "tif", "tiff"].iter().any(|known| extension.eq_ignore_ascii_case(known))
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
        return Err(ImagingError::invalid(folder, "files", "none", "PNG or TIFF files"));
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
    let mut stack = Stack { pages, open: None, size: [0, 0] };
    let first = stack.frame(0)?;
    let header =
        Header { width: first.width, height: first.height, count: stack.pages.len(), ..Header::default() };
    stack.size = [first.width, first.height];
    stack.open = None;
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
        let Some((path, page)) = self.pages.get(number).cloned() else {
            return Err(ImagingError::invalid(
                Path::new(""),
                "frame",
                number.to_string(),
                "a frame of the stack",
            ));
        };
        let frame = if is_tiff(&path) { self.tiff(&path, page)? } else { png(&path)? };
        let [width, height] = self.size;
        if width > 0 && [frame.width, frame.height] != self.size {
            let problem = format!("{} x {} pixels", frame.width, frame.height);
            let expected =
                format!("{width} x {height} as in the first frame: depth or zoom changed in between");
            return Err(ImagingError::invalid(&path, format!("frame {}", number + 1), problem, expected));
        }
        Ok(frame)
    }

    fn tiff(&mut self, path: &Path, page: usize) -> Result<Frame, ImagingError> {
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
        let pixels = match decoder.read_image().map_err(damaged(path))? {
            DecodingResult::U8(pixels) => pixels,
            DecodingResult::U16(pixels) => pixels.into_iter().map(|value| (value >> 8) as u8).collect(),
            _ => return Err(ImagingError::invalid(path, "colour", format!("{kind:?}"), "8 or 16 bit")),
        };
        self.open = Some((path.to_owned(), page, decoder));
        whole(path, width, height, grey(pixels, channels))
    }
}

fn png(path: &Path) -> Result<Frame, ImagingError> {
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
    decoder.set_transformations(png::Transformations::normalize_to_color8());
    let mut reader = decoder.read_info().map_err(damaged)?;
    let [width, height] = [reader.info().width as usize, reader.info().height as usize];
    check_size(path, "size", [width, height, 1])?;
    let (kind, _) = reader.output_color_type();
    let mut pixels = vec![0; width * height * kind.samples()];
    reader.next_frame(&mut pixels).map_err(damaged)?;
    whole(path, width, height, grey(pixels, kind.samples()))
}

fn whole(path: &Path, width: usize, height: usize, pixels: Vec<u8>) -> Result<Frame, ImagingError> {
    if pixels.len() == width * height {
        return Ok(Frame { width, height, pixels });
    }
    let expected = format!("{width} x {height}");
    Err(ImagingError::invalid(path, "image", format!("{} pixels", pixels.len()), expected))
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
