//! Stacks of PNG, TIFF and JPEG files: a frame for each file, or several in a TIFF.

use super::depth::{shift_for, shifted};
use super::turned::orientation;
use super::{Source, check_size, grey, jpeg, names, tiff, whole};
use crate::error::ImagingError;
use crate::frame::{Frame, FrameFields, Header, MAX_FRAMES, MAX_PIXELS, Statement};
use crate::places::StatedPlaces;
use std::fs::{self, File};
use std::io::{BufReader, Read};
use std::path::{Path, PathBuf};

/// Files with the pages of each.
pub(super) struct Stack {
    /// A file and a page in it for each frame.
    pages: Vec<(PathBuf, usize)>,
    /// The TIFF that is being read.
    open: Option<tiff::Open>,
    size: [usize; 2],
    /// Bits of 16 that are dropped.
    shift: u32,
}

/// Longest JPEG file.
const MAX_JPEG: u64 = 8 * MAX_PIXELS as u64;

/// Samples as a file has them.
pub(super) enum Samples {
    Eight(Vec<u8>),
    Sixteen(Vec<u16>),
}

/// An image as a file has it.
pub(super) struct Image {
    pub size: [usize; 2],
    pub channels: usize,
    pub samples: Samples,
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

/// The image files in a folder, in the order of the numbers in their names, with a remark on it; hidden ones are left out.
pub(super) fn files(folder: &Path) -> Result<(Vec<PathBuf>, Option<String>), ImagingError> {
    let entries = fs::read_dir(folder).map_err(ImagingError::io(folder))?;
    let mut files: Vec<PathBuf> = entries
        .filter_map(Result::ok)
        .map(|entry| entry.path())
        .filter(|path| !super::is_hidden(path) && is_image(path))
        .take(MAX_FRAMES + 1)
        .collect();
    let remark = names::sort(folder, &mut files)?;
    Ok((files, remark))
}

fn is_image(path: &Path) -> bool {
    path.extension().is_some_and(|extension| {
        ["png", "tif", "tiff", "jpg", "jpeg"].iter().any(|known| extension.eq_ignore_ascii_case(known))
    })
}

pub(super) fn open(path: &Path, files: Vec<PathBuf>) -> Result<(Header, Source), ImagingError> {
    let mut pages = Vec::new();
    for file in &files {
        let of_file = if tiff::is_tiff(file) { tiff::pages(file)? } else { vec![0] };
        pages.extend(of_file.into_iter().map(|page| (file.clone(), page)));
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
    let mut header = Header { width, height, count: stack.pages.len(), ..Header::default() };
    if let Some(first) = files.first().filter(|first| tiff::is_tiff(first)) {
        match tiff::calibration(first)? {
            Ok(calibration) => {
                header.spacing_mm = calibration.spacing_mm;
                if files.len() == 1 {
                    let count = header.count;
                    header.places = calibration
                        .step_mm
                        .and_then(|mm| StatedPlaces::evenly("distance of slices", mm, count));
                }
                if let Some(interval_s) = calibration.interval_s.filter(|s| *s > 0.0 && files.len() == 1) {
                    header.frames = (0..header.count)
                        .map(|frame| FrameFields {
                            time_s: Some(interval_s * frame as f64),
                            ..FrameFields::default()
                        })
                        .collect();
                }
            }
            Err(unclear) => header.unclear.push((Statement::Spacing, unclear)),
        }
    }
    Ok((header, Source::Stack(Box::new(stack))))
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
        if tiff::is_tiff(&path) {
            tiff::image(&mut self.open, &path, page)
        } else if path.extension().is_some_and(|e| e.eq_ignore_ascii_case("png")) {
            png(&path)
        } else {
            let file = File::open(&path).map_err(ImagingError::io(&path))?;
            let mut bytes = Vec::new();
            file.take(MAX_JPEG).read_to_end(&mut bytes).map_err(ImagingError::io(&path))?;
            let Frame { width, height, pixels } = jpeg::decode(&path, "image", &bytes, false)?;
            let image = Image { size: [width, height], channels: 1, samples: Samples::Eight(pixels) };
            Ok(image.turned(jpeg::exif(&bytes).map_or(1, orientation)))
        }
    }

    /// The greatest sample of all frames of 16 bit. A frame that cannot be read is reported when it is reached.
    fn greatest(&mut self) -> u16 {
        (0..self.pages.len())
            .filter_map(|number| self.image(number).ok())
            .map(|image| match image.samples {
                Samples::Sixteen(samples) => samples.into_iter().max().unwrap_or(0),
                Samples::Eight(_) => 0,
            })
            .max()
            .unwrap_or(0)
    }
}

fn png(path: &Path) -> Result<Image, ImagingError> {
    let file = File::open(path).map_err(ImagingError::io(path))?;
    let damaged = |cause: png::DecodingError| {
        ImagingError::invalid(
            path,
            "image",
            cause.to_string(),
            format!("a whole PNG file of at most {MAX_PIXELS} pixels"),
        )
    };
    let limits = png::Limits { bytes: 8 * MAX_PIXELS };
    let mut decoder = png::Decoder::new_with_limits(BufReader::new(file), limits);
    decoder.set_transformations(png::Transformations::EXPAND);
    let mut reader = decoder.read_info().map_err(damaged)?;
    let [width, height] = [reader.info().width as usize, reader.info().height as usize];
    check_size(path, "size", [width, height, 1])?;
    let turn = reader.info().exif_metadata.as_deref().map_or(1, orientation);
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
    Ok(Image { size: [width, height], channels: kind.samples(), samples }.turned(turn))
}
