//! TIFF: pages of grey, RGB or palette samples, planes apart or together, and the stacks of ImageJ in one directory.

use super::check_size;
use super::header::{short, spacing};
use super::metaimage::{millimetres, unit};
use super::stack::{Image, Samples};
use crate::error::ImagingError;
use crate::frame::{MAX_FRAMES, MAX_PIXELS, Unclear};
use std::fs::File;
use std::io::{BufReader, Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};
use tiff::decoder::{Decoder, DecodingResult, Limits};
use tiff::tags::{ByteOrder, CompressionMethod, PhotometricInterpretation, PlanarConfiguration, Tag};
use tiff::{ColorType, TiffError};

/// A file that is being read, and the page it is at.
pub(super) struct Open {
    path: PathBuf,
    page: usize,
    /// How the first page is to be turned.
    orientation: u16,
    decoder: Decoder<BufReader<File>>,
}

pub(super) fn is_tiff(path: &Path) -> bool {
    path.extension().is_some_and(|e| e.eq_ignore_ascii_case("tif") || e.eq_ignore_ascii_case("tiff"))
}

/// The images of a file that are frames: previews and masks beside them are none.
pub(super) fn pages(path: &Path) -> Result<Vec<usize>, ImagingError> {
    /// Bits of the kind of a directory: smaller than another image of the file, and a mask for one.
    const NO_FRAME: u32 = 1 | 4;
    let mut open = Open::new(path)?;
    open.check_axes()?;
    if !open.decoder.more_images() {
        return Ok((0..open.stacked()?.unwrap_or(1)).collect());
    }
    let mut pages = Vec::new();
    for page in 0.. {
        check_size(path, "pages", [1, 1, page + 1])?;
        let kind = open.decoder.find_tag_unsigned::<u32>(Tag::NewSubfileType).map_err(damaged(path))?;
        if kind.is_none_or(|kind| kind & NO_FRAME == 0) {
            pages.push(page);
        }
        if !open.decoder.more_images() {
            break;
        }
        open.decoder.next_image().map_err(damaged(path))?;
    }
    if pages.is_empty() {
        return Err(ImagingError::invalid(path, "NewSubfileType", "previews alone", "an image"));
    }
    Ok(pages)
}

/// Size of a pixel, and time from one image to the next, where a program states them.
#[derive(Debug, Default, Clone, Copy, PartialEq)]
pub(super) struct Calibration {
    /// Size of the first image's pixels, for all of them.
    pub spacing_mm: Option<[f64; 2]>,
    pub interval_s: Option<f64>,
    /// Distance of slices, where the images are slices.
    pub step_mm: Option<f64>,
}

/// Calibration of a file.
pub(super) fn calibration(path: &Path) -> Result<Result<Calibration, Unclear>, ImagingError> {
    Ok(Open::new(path)?.calibration())
}

/// Millimetres of a unit of length.
fn length(field: &str, value: &str) -> Result<f64, Unclear> {
    match value.trim() {
        "inch" | "in" => Ok(25.4),
        other => millimetres(other).ok_or_else(|| unit(field, other)),
    }
}

/// One of the images; `open` is kept for the next one.
pub(super) fn image(open: &mut Option<Open>, path: &Path, page: usize) -> Result<Image, ImagingError> {
    let mut reader = match open.take() {
        Some(open) if open.path == path && open.page <= page => open,
        _ => Open::new(path)?,
    };
    // All images of such a stack are behind the first one.
    let stacked = if reader.decoder.more_images() || page == 0 { None } else { reader.stacked()? };
    while reader.page < page && stacked.is_none() {
        reader.decoder.next_image().map_err(damaged(path))?;
        reader.page += 1;
    }
    let orientation = orientation(&mut reader.decoder, path)?;
    // Some programs write it into the first page alone, and it is not known which of both is right.
    if orientation != reader.orientation {
        let problem = format!("{orientation} of page {}, and {} of the first", page + 1, reader.orientation);
        return Err(ImagingError::invalid(path, "Orientation", problem, "one orientation of all pages"));
    }
    let image = reader.image(if stacked.is_some() { page } else { 0 })?.turned(orientation);
    *open = Some(reader);
    Ok(image)
}

/// How the present page is to be turned, as EXIF counts it.
fn orientation(decoder: &mut Decoder<BufReader<File>>, path: &Path) -> Result<u16, ImagingError> {
    Ok(decoder.find_tag_unsigned::<u16>(Tag::Orientation).map_err(damaged(path))?.unwrap_or(1))
}

impl Open {
    fn new(path: &Path) -> Result<Self, ImagingError> {
        let file = File::open(path).map_err(ImagingError::io(path))?;
        let mut limits = Limits::default();
        limits.decoding_buffer_size = 8 * MAX_PIXELS;
        limits.intermediate_buffer_size = 8 * MAX_PIXELS;
        limits.ifd_value_size = 1 << 20;
        let mut decoder = Decoder::new(BufReader::new(file)).map_err(damaged(path))?.with_limits(limits);
        let orientation = orientation(&mut decoder, path)?;
        Ok(Self { path: path.to_owned(), page: 0, orientation, decoder })
    }

    /// Refuses files whose images are not one list of frames: several channels of each, or volumes over time.
    fn check_axes(&mut self) -> Result<(), ImagingError> {
        let text = self.description();
        let (channels, slices, times, field) = if text.starts_with("ImageJ=") {
            let [channels, slices, frames] = ["channels", "slices", "frames"].map(|name| {
                let value = text.lines().find_map(|line| line.strip_prefix(name)?.strip_prefix('='));
                value.and_then(|value| value.trim().parse::<usize>().ok()).unwrap_or(1)
            });
            (channels, slices, frames, "ImageJ")
        } else if text.contains("<OME") {
            let [samples, channels, planes, times] =
                ["SamplesPerPixel", "SizeC", "SizeZ", "SizeT"].map(|name| {
                    attribute(&text, name).and_then(|value| value.parse::<usize>().ok()).unwrap_or(1)
                });
            // Samples of one image are channels too.
            (channels / samples.max(1), planes, times, "OME")
        } else {
            return Ok(());
        };
        let problem = if channels > 1 {
            format!("{channels} channels of each frame")
        } else if slices > 1 && times > 1 {
            format!("{times} volumes of {slices} slices")
        } else {
            return Ok(());
        };
        let expected = "one channel, and frames along one axis: in ImageJ, Image > Color > Split Channels or Image > Duplicate";
        Err(ImagingError::invalid(&self.path, field, problem, expected))
    }

    /// Size of a pixel and times of the images, as ImageJ or a program that writes OME states them; tags alone are those of a printer.
    fn calibration(&mut self) -> Result<Calibration, Unclear> {
        let text = self.description();
        if text.starts_with("ImageJ=") {
            let seconds = value_of("tunit", &text)
                .is_none_or(|unit| matches!(unit.trim(), "s" | "sec" | "second" | "seconds"));
            let interval_s =
                value_of("finterval", &text).and_then(|text| text.trim().parse().ok()).filter(|_| seconds);
            let Some(unit) =
                value_of("unit", &text).filter(|unit| !matches!(unit.trim(), "pixel" | "pixels" | ""))
            else {
                return Ok(Calibration { interval_s, ..Calibration::default() });
            };
            // ImageJ writes letters outside of ASCII as their number.
            let mm_per_unit = length("ImageJ: unit", &unit.replace("\\u00B5", "\u{b5}"))?;
            let has_slices = value_of("slices", &text).is_some_and(|slices| slices.trim() != "1");
            let step: Option<f64> = value_of("spacing", &text).and_then(|text| text.trim().parse().ok());
            let step_mm = step.filter(|_| has_slices).map(|step| mm_per_unit * step);
            let mut size = |tag| {
                let [above, below]: [u32; 2] = self.decoder.get_tag_u32_vec(tag).ok()?.try_into().ok()?;
                Some(mm_per_unit * f64::from(below) / f64::from(above))
            };
            let mm = size(Tag::XResolution).zip(size(Tag::YResolution)).map(<[f64; 2]>::from);
            let Some(mm) = mm else { return Ok(Calibration { spacing_mm: None, interval_s, step_mm }) };
            let problem = format!("{} x {} mm", mm[0], mm[1]);
            return Ok(Calibration {
                spacing_mm: spacing("ImageJ: resolution", Some(mm), &problem)?,
                interval_s,
                step_mm,
            });
        }
        let sizes = attribute(&text, "PhysicalSizeX")
            .zip(attribute(&text, "PhysicalSizeY"))
            .filter(|_| text.contains("<OME"));
        let Some((x, y)) = sizes else { return Ok(Calibration::default()) };
        let mm = [ome_size(x, "PhysicalSizeXUnit", &text)?, ome_size(y, "PhysicalSizeYUnit", &text)?];
        Ok(Calibration {
            spacing_mm: spacing("OME: PhysicalSize", Some(mm), &format!("{x} x {y}"))?,
            interval_s: None,
            step_mm: attribute(&text, "PhysicalSizeZ")
                .and_then(|z| ome_size(z, "PhysicalSizeZUnit", &text).ok())
                .filter(|mm| mm.is_finite()),
        })
    }

    /// Description of the images by the program that wrote them; empty where there is none.
    fn description(&mut self) -> String {
        let tag = self.decoder.find_tag(Tag::ImageDescription).ok().flatten();
        tag.and_then(|text| text.into_string().ok()).unwrap_or_default()
    }

    /// Number of images that ImageJ has put behind the first without directories of their own.
    fn stacked(&mut self) -> Result<Option<usize>, ImagingError> {
        let text = self.description();
        let lines = text.lines().filter(|_| text.starts_with("ImageJ="));
        let count: Option<usize> =
            lines.filter_map(|line| line.strip_prefix("images=")?.trim().parse().ok()).next();
        match count.filter(|count| *count > 1) {
            Some(count) if count > MAX_FRAMES => {
                check_size(&self.path, "images", [1, 1, count]).map(|()| None)
            }
            count => Ok(count),
        }
    }

    /// The image of this directory, or the one so many behind it.
    fn image(&mut self, behind: usize) -> Result<Image, ImagingError> {
        let path = self.path.clone();
        let (width, height) = self.decoder.dimensions().map_err(damaged(&path))?;
        let size = [width as usize, height as usize];
        check_size(&path, "size", [size[0], size[1], 1])?;
        let photometric =
            self.decoder.find_tag_unsigned(Tag::PhotometricInterpretation).map_err(damaged(&path))?;
        let is_palette = photometric == Some(PhotometricInterpretation::RGBPalette.to_u16());
        if is_palette || behind > 0 {
            return self.plain(size, behind, photometric);
        }
        let kind = self.decoder.colortype().map_err(damaged(&path))?;
        let channels = match kind {
            ColorType::Gray(8 | 16) => 1,
            ColorType::GrayA(8 | 16) => 2,
            ColorType::RGB(8 | 16) => 3,
            ColorType::RGBA(8 | 16) => 4,
            other => {
                let expected = "grey, RGB or a palette of 8 or 16 bit";
                return Err(ImagingError::invalid(&path, "colour", format!("{other:?}"), expected));
            }
        };
        let planar = self.decoder.find_tag_unsigned(Tag::PlanarConfiguration).map_err(damaged(&path))?;
        let mut samples = DecodingResult::U8(Vec::new());
        self.decoder.read_image_to_buffer(&mut samples).map_err(damaged(&path))?;
        let is_apart = planar == Some(PlanarConfiguration::Planar.to_u16()) && channels > 1;
        let samples = match samples {
            DecodingResult::U8(samples) if is_apart => Samples::Eight(together(&samples, channels)),
            DecodingResult::U16(samples) if is_apart => Samples::Sixteen(together(&samples, channels)),
            DecodingResult::U8(samples) => Samples::Eight(samples),
            DecodingResult::U16(samples) => Samples::Sixteen(samples),
            _ => return Err(ImagingError::invalid(&path, "colour", format!("{kind:?}"), "8 or 16 bit")),
        };
        Ok(Image { size, channels, samples })
    }

    /// Samples that are not compressed: of a palette, or of one of the images behind the first.
    fn plain(
        &mut self,
        [width, height]: [usize; 2],
        behind: usize,
        photometric: Option<u16>,
    ) -> Result<Image, ImagingError> {
        let path = self.path.clone();
        let is_palette = photometric == Some(PhotometricInterpretation::RGBPalette.to_u16());
        let mut tag = |tag| self.decoder.find_tag_unsigned::<u16>(tag).map_err(damaged(&path));
        let (bits, samples) =
            (tag(Tag::BitsPerSample)?.unwrap_or(1), tag(Tag::SamplesPerPixel)?.unwrap_or(1));
        if tag(Tag::Compression)?.is_some_and(|of| of != CompressionMethod::None.to_u16()) {
            let expected = "no compression where there is a palette or a stack in one directory: tiffcp -c none converts";
            return Err(ImagingError::invalid(&path, "Compression", "compressed", expected));
        }
        let bytes = match (bits, samples, is_palette) {
            (8, 1, _) => 1,
            (16, 1, false) => 2,
            _ => {
                let problem = format!("{samples} samples of {bits} bits");
                return Err(ImagingError::invalid(
                    &path,
                    "colour",
                    problem,
                    "one sample of 8 or, without a palette, 16 bit",
                ));
            }
        };
        let strips = |decoder: &mut Decoder<BufReader<File>>, tag| -> Result<Vec<u64>, ImagingError> {
            decoder.get_tag_u64_vec(tag).map_err(damaged(&path))
        };
        let offsets = strips(&mut self.decoder, Tag::StripOffsets)?;
        let counts = strips(&mut self.decoder, Tag::StripByteCounts)?;
        let needed = width * height * bytes;
        let mut raw = Vec::with_capacity(needed);
        // The images of a stack follow each other without a gap.
        let pieces: Vec<(u64, u64)> = match (behind, offsets.first()) {
            (0, _) => offsets.into_iter().zip(counts).collect(),
            (behind, Some(first)) => vec![(first + (behind * needed) as u64, needed as u64)],
            (_, None) => Vec::new(),
        };
        let byte_order = self.decoder.byte_order();
        let file = self.decoder.inner();
        for (at, count) in pieces {
            file.seek(SeekFrom::Start(at)).map_err(ImagingError::io(&path))?;
            let missing_bytes = (needed - raw.len()) as u64;
            file.take(count.min(missing_bytes)).read_to_end(&mut raw).map_err(ImagingError::io(&path))?;
        }
        if raw.len() < needed {
            let problem = format!("{} bytes", raw.len());
            return Err(ImagingError::invalid(
                &path,
                format!("image {}", behind + 1),
                problem,
                format!("{needed} bytes"),
            ));
        }
        if is_palette {
            let colours = self.decoder.get_tag_u16_vec(Tag::ColorMap).map_err(damaged(&path))?;
            let brightness = brightness(&colours);
            return Ok(Image {
                size: [width, height],
                channels: 1,
                samples: Samples::Eight(
                    raw.into_iter()
                        .map(|index| brightness.get(usize::from(index)).copied().unwrap_or(0))
                        .collect(),
                ),
            });
        }
        if photometric == Some(PhotometricInterpretation::WhiteIsZero.to_u16()) {
            // The complement of a sample is that of each of its bytes.
            raw.iter_mut().for_each(|byte| *byte = !*byte);
        }
        let samples = if bytes == 1 {
            Samples::Eight(raw)
        } else {
            Samples::Sixteen(
                raw.as_chunks::<2>()
                    .0
                    .iter()
                    .map(|pair| match byte_order {
                        ByteOrder::LittleEndian => u16::from_le_bytes(*pair),
                        ByteOrder::BigEndian => u16::from_be_bytes(*pair),
                    })
                    .collect(),
            )
        };
        Ok(Image { size: [width, height], channels: 1, samples })
    }
}

fn ome_size(value: &str, unit: &str, text: &str) -> Result<f64, Unclear> {
    let mm_per_unit = length("OME: PhysicalSize", attribute(text, unit).unwrap_or("\u{b5}m"))?;
    Ok::<_, Unclear>(value.parse().map_or(f64::NAN, |size: f64| mm_per_unit * size))
}

fn value_of<'a>(name: &str, text: &'a str) -> Option<&'a str> {
    text.lines().find_map(|line| line.strip_prefix(name)?.strip_prefix('='))
}

/// Brightness of the colours of a palette: all reds, greens and blues, of 16 bit.
fn brightness(colours: &[u16]) -> Vec<u8> {
    let count = colours.len() / 3;
    let pixels: Vec<u8> = (0..count)
        .flat_map(|index| {
            [
                colour_byte(index, colours),
                colour_byte(count + index, colours),
                colour_byte(2 * count + index, colours),
            ]
        })
        .collect();
    super::grey(pixels, 3)
}

fn colour_byte(at: usize, colours: &[u16]) -> u8 {
    colours.get(at).map_or(0, |value| (value >> 8) as u8)
}

/// Samples pixel by pixel of those plane by plane.
fn together<T: Copy>(planes: &[T], channels: usize) -> Vec<T> {
    let pixels = planes.len() / channels.max(1);
    (0..pixels)
        .flat_map(|pixel| (0..channels).filter_map(move |c| planes.get(c * pixels + pixel).copied()))
        .collect()
}

fn damaged(path: &Path) -> impl Fn(TiffError) -> ImagingError + '_ {
    move |cause| {
        let expected = match &cause {
            TiffError::UnsupportedError(_) => {
                "grey, RGB or a palette of 8 or 16 bit: ImageJ converts others".to_owned()
            }
            TiffError::LimitsExceeded => format!("frames of at most {MAX_PIXELS} pixels"),
            _ => "a whole TIFF file".to_owned(),
        };
        ImagingError::invalid(path, "image", short(&cause.to_string()), expected)
    }
}

/// Value of the first attribute of this name in a description by OME.
fn attribute<'t>(text: &'t str, name: &str) -> Option<&'t str> {
    Some(text.split_once(&format!(" {name}=\""))?.1.split_once('"')?.0)
}
