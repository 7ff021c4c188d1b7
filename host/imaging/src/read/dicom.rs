//! DICOM ultrasound, one frame or many: uncompressed, RLE and JPEG baseline.
//!
//! The header's elements are read by `dicom-parser`, values of the few that matter only and none longer than [`MAX_VALUE`]; frames are read
//! from the file one at a time ([`pixels`]). The size of a pixel is that of the ultrasound region with a 2D image (PS3.3, C.8.5.5), or
//! `PixelSpacing` where there is none inside the frame.

mod attributes;
mod files;
mod palette;
mod pixels;

pub(super) use files::{files, open_files};

use super::{Source, check_size};
use crate::error::ImagingError;
use crate::frame::{Header, MAX_FRAMES, Statement};
use attributes::{Attributes, region};
use dicom_core::{Tag, VR};
use dicom_encoding::transfer_syntax::Codec;
use dicom_encoding::{Endianness, TransferSyntax};
use dicom_parser::StatefulDecode;
use dicom_parser::dataset::LazyDataToken;
use dicom_parser::dataset::lazy_read::LazyDataSetReader;
use pixels::{Coding, Layout, Pixels};
use std::collections::BTreeMap;
use std::fs::File;
use std::io::{BufReader, Cursor, Read, Seek, SeekFrom};
use std::path::Path;

/// Longest value that is kept, bytes: a list of the frames' times.
const MAX_VALUE: u32 = 1 << 21;
/// Longest group of file information.
const MAX_INFORMATION: u32 = 1 << 20;
/// Deepest nesting of sequences and items.
const MAX_LEVELS: usize = 32;
/// Most regions.
const MAX_REGIONS: usize = 64;

const TRANSFER_SYNTAX: Tag = Tag(0x0002, 0x0010);
const REGIONS: Tag = Tag(0x0018, 0x6011);
const PIXEL_DATA: Tag = Tag(0x7FE0, 0x0010);
const SERIES: Tag = Tag(0x0020, 0x000E);
const INSTANCE: Tag = Tag(0x0020, 0x0013);
/// When the image was taken: date and time, time, and time of its content.
const TAKEN: [Tag; 3] = [Tag(0x0008, 0x002A), Tag(0x0008, 0x0032), Tag(0x0008, 0x0033)];
const SPACING_BETWEEN: Tag = Tag(0x0018, 0x0088);
const POSITION: Tag = Tag(0x0020, 0x0032);
const ORIENTATION: Tag = Tag(0x0020, 0x0037);
/// Position of the plane of each frame, in a sequence of its own.
const PLANE_POSITION: Tag = Tag(0x0020, 0x9113);
const FRAMES: Tag = Tag(0x0028, 0x0008);
const ROWS: Tag = Tag(0x0028, 0x0010);
const COLUMNS: Tag = Tag(0x0028, 0x0011);
const SAMPLES: Tag = Tag(0x0028, 0x0002);
const PHOTOMETRIC: Tag = Tag(0x0028, 0x0004);
const PLANAR: Tag = Tag(0x0028, 0x0006);
const PIXEL_SPACING: Tag = Tag(0x0028, 0x0030);
const BITS_ALLOCATED: Tag = Tag(0x0028, 0x0100);
const BITS_STORED: Tag = Tag(0x0028, 0x0101);
const HIGH_BIT: Tag = Tag(0x0028, 0x0102);
const INTERCEPT: Tag = Tag(0x0028, 0x1052);
const SLOPE: Tag = Tag(0x0028, 0x1053);
const SIGNED: Tag = Tag(0x0028, 0x0103);
/// Number of colours, first index and bits of red, green and blue; and the colours.
const PALETTE_SIZES: [Tag; 3] = [Tag(0x0028, 0x1101), Tag(0x0028, 0x1102), Tag(0x0028, 0x1103)];
const PALETTE: [Tag; 3] = [Tag(0x0028, 0x1201), Tag(0x0028, 0x1202), Tag(0x0028, 0x1203)];
/// Attributes of all frames and of each, and sizes of a pixel among them (PS3.3, C.7.6.16.2.1).
const GROUPS: [Tag; 2] = [Tag(0x5200, 0x9229), Tag(0x5200, 0x9230)];
const MEASURES: Tag = Tag(0x0028, 0x9110);
const FRAME_TIME_MS: Tag = Tag(0x0018, 0x1063);
const FRAME_TIMES_MS: Tag = Tag(0x0018, 0x1065);
/// Values that are read of the data set.
const VALUES: [Tag; 29] = [
    TAKEN[0],
    TAKEN[1],
    TAKEN[2],
    SERIES,
    INSTANCE,
    SPACING_BETWEEN,
    POSITION,
    ORIENTATION,
    FRAMES,
    ROWS,
    COLUMNS,
    SAMPLES,
    PHOTOMETRIC,
    PLANAR,
    PIXEL_SPACING,
    BITS_ALLOCATED,
    BITS_STORED,
    HIGH_BIT,
    INTERCEPT,
    SLOPE,
    SIGNED,
    FRAME_TIME_MS,
    FRAME_TIMES_MS,
    PALETTE_SIZES[0],
    PALETTE_SIZES[1],
    PALETTE_SIZES[2],
    PALETTE[0],
    PALETTE[1],
    PALETTE[2],
];
const FORMAT: Tag = Tag(0x0018, 0x6012);
const CORNERS: [Tag; 4] =
    [Tag(0x0018, 0x6018), Tag(0x0018, 0x601A), Tag(0x0018, 0x601C), Tag(0x0018, 0x601E)];
const UNITS: [Tag; 2] = [Tag(0x0018, 0x6024), Tag(0x0018, 0x6026)];
const DELTAS: [Tag; 2] = [Tag(0x0018, 0x602C), Tag(0x0018, 0x602E)];

/// Values by their tag.
type Values = BTreeMap<Tag, Vec<u8>>;

/// Transfer syntax of the data set.
struct Syntax {
    coding: Coding,
    is_explicit: bool,
    endianness: Endianness,
}

pub(super) fn open(path: &Path) -> Result<(Header, Source), ImagingError> {
    let Opened { header, pixels, .. } = open_file(path)?;
    Ok((header, Source::Reader(Box::new(pixels))))
}

/// A file whose header is read.
struct Opened {
    header: Header,
    pixels: Pixels,
    /// Its place in a series, where it is stated.
    instance: Option<i64>,
    /// When it was taken, as digits in their order.
    taken: Option<String>,
    /// Identifier of the series.
    series: Option<String>,
    /// Position of its image, and the normal of its plane.
    position_mm: Option<[f64; 3]>,
    normal: Option<[f64; 3]>,
}

fn open_file(path: &Path) -> Result<Opened, ImagingError> {
    let mut file = BufReader::new(File::open(path).map_err(ImagingError::io(path))?);
    let (syntax, start) = syntax(path, &mut file)?;
    let is_big = syntax.endianness == Endianness::Big;
    let DataSet { values, regions, measures, positions, pixels: (position, length), is_of_words } =
        data_set(path, file, start, &syntax)?;
    let header = Attributes { path, values: &values, measures: &measures, is_big };
    let instance = header.text(INSTANCE).and_then(|text| text.trim().parse().ok());
    let taken = TAKEN.into_iter().find_map(|tag| header.text(tag).filter(|text| !text.trim().is_empty()));
    let series = header.text(SERIES);
    let (width, height) =
        (required_number(COLUMNS, "Columns", header, path)?, required_number(ROWS, "Rows", header, path)?);
    let count = match header.text(FRAMES) {
        None => 1,
        Some(text) => text.parse().map_err(|_| {
            ImagingError::invalid(
                path,
                "NumberOfFrames",
                format!("\"{}\"", super::header::short(&text)),
                "a number",
            )
        })?,
    };
    check_size(path, "Rows, Columns, NumberOfFrames", [width, height, count])?;
    let layout = Layout::new(&header, [width, height])?.with_words(path, is_of_words && is_big)?;
    let palette = if layout.has_palette() { palette::brightness(&header)? } else { Vec::new() };
    let (stated, region) = region(&header, &regions);
    let frames = header.times(count);
    let (position_mm, normal) = (header.numbers(POSITION), header.normal());
    let places = header.places(&positions, count);
    let mut header = Header { width, height, count, region, places, frames, ..Header::default() };
    match stated {
        Ok(mm) => header.spacing_mm = mm,
        Err(unclear) => header.unclear.push((Statement::Spacing, unclear)),
    }
    let file = File::open(path).map_err(ImagingError::io(path))?;
    let mut bytes = BufReader::new(file);
    bytes.seek(SeekFrom::Start(position)).map_err(ImagingError::io(path))?;
    let pixels = Pixels::new(path, bytes, syntax.coding, (layout, palette), count, length)?;
    Ok(Opened { header, pixels, instance, taken, series, position_mm, normal })
}

fn required_number(tag: Tag, name: &str, header: Attributes<'_>, path: &Path) -> Result<usize, ImagingError> {
    header.number(tag).ok_or_else(|| ImagingError::invalid(path, name, "missing", "a DICOM image"))
}

/// Whether a file begins as DICOM does: they often have no extension.
pub(super) fn is_dicom(path: &Path) -> bool {
    let mut start = [0u8; 132];
    let read = File::open(path).and_then(|mut file| file.read_exact(&mut start));
    read.is_ok() && start.ends_with(b"DICM")
}

/// The transfer syntax of the file information, and where the data set begins.
fn syntax(path: &Path, file: &mut BufReader<File>) -> Result<(Syntax, u64), ImagingError> {
    let expected = "a DICOM file: 128 bytes, DICM, file information with its length";
    let mut start = [0u8; 144];
    file.read_exact(&mut start).map_err(|_| syntax_problem("shorter than 144 bytes", expected, path))?;
    let (&[.., a, b, c, d], tail) =
        start.split_first_chunk::<132>().ok_or_else(|| syntax_problem("too short", expected, path))?;
    if [a, b, c, d] != *b"DICM" {
        return Err(syntax_problem("no DICM behind 128 bytes", expected, path));
    }
    let (first, length) =
        tail.split_first_chunk::<8>().ok_or_else(|| syntax_problem("too short", expected, path))?;
    if *first != [2, 0, 0, 0, b'U', b'L', 4, 0] {
        return Err(syntax_problem("no length of the file information", expected, path));
    }
    let length = length.first_chunk::<4>().map_or(0, |bytes| u32::from_le_bytes(*bytes));
    if length > MAX_INFORMATION {
        return Err(syntax_problem("more than 1 MiB of file information", expected, path));
    }
    let mut information = Vec::new();
    file.take(length.into()).read_to_end(&mut information).map_err(ImagingError::io(path))?;
    let explicit = transfer_syntax(true, Endianness::Little);
    let mut reader = LazyDataSetReader::new_with_ts(Cursor::new(information), &explicit)
        .map_err(|cause| syntax_problem(&cause.to_string(), expected, path))?;
    let mut uid = None;
    while let Some(token) = reader.advance() {
        match token.map_err(|cause| syntax_problem(&cause.to_string(), expected, path))? {
            LazyDataToken::ElementHeader(_) => {}
            LazyDataToken::LazyValue { header, mut decoder } => {
                let value = value(&mut decoder, header.len.0)
                    .map_err(|cause| syntax_problem(&cause, expected, path))?;
                if header.tag == TRANSFER_SYNTAX {
                    uid = Some(text(&value));
                }
            }
            _ => return Err(syntax_problem("a sequence in the file information", expected, path)),
        }
    }
    let (coding, is_explicit, endianness) = match uid.as_deref() {
        Some("1.2.840.10008.1.2") => (Coding::Plain, false, Endianness::Little),
        Some("1.2.840.10008.1.2.1") => (Coding::Plain, true, Endianness::Little),
        Some("1.2.840.10008.1.2.2") => (Coding::Plain, true, Endianness::Big),
        Some("1.2.840.10008.1.2.5") => (Coding::Rle, true, Endianness::Little),
        Some("1.2.840.10008.1.2.4.50" | "1.2.840.10008.1.2.4.51") => (Coding::Jpeg, true, Endianness::Little),
        other => {
            let problem = format!("\"{}\"", super::header::short(other.unwrap_or_default()));
            let expected =
                "uncompressed, RLE or JPEG baseline: dcmconv, dcmdjpeg or gdcmconv --raw convert others";
            return Err(ImagingError::invalid(path, "TransferSyntaxUID", problem, expected));
        }
    };
    Ok((Syntax { coding, is_explicit, endianness }, 144 + u64::from(length)))
}

fn syntax_problem(problem: &str, expected: &str, path: &Path) -> ImagingError {
    ImagingError::invalid(path, "header", problem.to_owned(), expected)
}

fn transfer_syntax(is_explicit: bool, endianness: Endianness) -> TransferSyntax {
    TransferSyntax::new("", "", endianness, is_explicit, Codec::None)
}

/// A value; skipped where it is longer than any that matters.
fn value(decoder: &mut impl StatefulDecode, length: u32) -> Result<Vec<u8>, String> {
    let mut bytes = Vec::new();
    if length > MAX_VALUE {
        decoder.skip_bytes(length).map_err(|cause| cause.to_string())?;
        return Ok(bytes);
    }
    decoder.read_to_vec(length, &mut bytes).map_err(|cause| cause.to_string())?;
    if bytes.len() as u64 != u64::from(length) {
        return Err("a value ends early".to_owned());
    }
    Ok(bytes)
}

/// Values of a data set that are used.
struct DataSet {
    values: Values,
    regions: Vec<Values>,
    /// Sizes of a pixel of all frames or of each, those that differ.
    measures: Vec<Vec<u8>>,
    /// Positions of the frames.
    positions: Vec<Vec<u8>>,
    /// Whether the pixels are written as words of 16 bit.
    is_of_words: bool,
    /// Position of the pixels, and their number of bytes if it is stated.
    pixels: (u64, Option<u64>),
}

fn data_set(
    path: &Path,
    mut file: BufReader<File>,
    start: u64,
    syntax: &Syntax,
) -> Result<DataSet, ImagingError> {
    #[derive(PartialEq)]
    enum Level {
        Sequence(Tag),
        Item,
    }
    file.seek(SeekFrom::Start(start)).map_err(ImagingError::io(path))?;
    let written = transfer_syntax(syntax.is_explicit, syntax.endianness);
    let mut reader = LazyDataSetReader::new_with_ts(file, &written)
        .map_err(|cause| data_problem(&cause.to_string(), path))?;
    let (mut values, mut regions) = (Values::new(), Vec::<Values>::new());
    let (mut measures, mut is_of_words) = (Vec::<Vec<u8>>::new(), false);
    let mut positions: Vec<Vec<u8>> = Vec::new();
    let mut levels: Vec<Level> = Vec::new();
    let mut length = None;
    loop {
        let Some(token) = reader.advance() else {
            return Err(ImagingError::invalid(path, "PixelData", "missing", "a DICOM image"));
        };
        // Delimiters that close nothing would confuse the parser: an error, before it continues.
        let closes = match token.map_err(|cause| data_problem(&cause.to_string(), path))? {
            LazyDataToken::SequenceStart { tag, .. } => {
                levels.push(Level::Sequence(tag));
                true
            }
            LazyDataToken::ItemStart { .. } => {
                if levels == [Level::Sequence(REGIONS)] && regions.len() < MAX_REGIONS {
                    regions.push(Values::new());
                }
                let is_inside = matches!(levels.last(), Some(Level::Sequence(_)));
                levels.push(Level::Item);
                is_inside
            }
            LazyDataToken::ItemEnd => levels.pop() == Some(Level::Item),
            LazyDataToken::SequenceEnd => matches!(levels.pop(), Some(Level::Sequence(_))),
            LazyDataToken::PixelSequenceStart if levels.is_empty() => break,
            LazyDataToken::ElementHeader(header) if header.tag == PIXEL_DATA && levels.is_empty() => {
                length = Some(u64::from(header.len.0));
                is_of_words = header.vr == VR::OW;
                break;
            }
            LazyDataToken::ElementHeader(_) => true,
            LazyDataToken::LazyValue { header, mut decoder } => {
                let is_region = levels == [Level::Sequence(REGIONS), Level::Item];
                let is_measure = header.tag == PIXEL_SPACING
                    && GROUPS.iter().any(|group| {
                        levels
                            == [Level::Sequence(*group), Level::Item, Level::Sequence(MEASURES), Level::Item]
                    });
                let is_position = header.tag == POSITION
                    && levels
                        == [
                            Level::Sequence(GROUPS[1]),
                            Level::Item,
                            Level::Sequence(PLANE_POSITION),
                            Level::Item,
                        ];
                if is_position && positions.len() < MAX_FRAMES {
                    positions
                        .push(value(&mut decoder, header.len.0).map_err(|cause| data_problem(&cause, path))?);
                    continue;
                }
                if is_measure && measures.len() < MAX_REGIONS {
                    let value =
                        value(&mut decoder, header.len.0).map_err(|cause| data_problem(&cause, path))?;
                    if !measures.contains(&value) {
                        measures.push(value);
                    }
                    continue;
                }
                let destination = match levels.len() {
                    0 if VALUES.contains(&header.tag) => Some(&mut values),
                    2 if is_region => regions.last_mut(),
                    _ => None,
                };
                match destination {
                    Some(destination) => {
                        let value =
                            value(&mut decoder, header.len.0).map_err(|cause| data_problem(&cause, path))?;
                        destination.insert(header.tag, value);
                    }
                    None => decoder
                        .skip_bytes(header.len.0)
                        .map_err(|cause| data_problem(&cause.to_string(), path))?,
                }
                true
            }
            LazyDataToken::LazyItemValue { len, decoder } => {
                decoder.skip_bytes(len).map_err(|cause| data_problem(&cause.to_string(), path))?;
                true
            }
            _ => false,
        };
        if !closes || levels.len() > MAX_LEVELS {
            return Err(data_problem("items and sequences that do not nest", path));
        }
    }
    let position = reader.into_decoder().position();
    if length.is_none() && syntax.coding == Coding::Plain {
        return Err(data_problem("PixelData without a length in an uncompressed file", path));
    }
    if length.is_some() && syntax.coding != Coding::Plain {
        return Err(data_problem("PixelData that are not in fragments in a compressed file", path));
    }
    Ok(DataSet { values, regions, measures, positions, pixels: (position, length), is_of_words })
}

fn data_problem(problem: &str, path: &Path) -> ImagingError {
    let problem: String = problem.chars().take(200).collect();
    ImagingError::invalid(path, "data set", problem, "elements up to PixelData")
}

/// A text without its padding.
fn text(value: &[u8]) -> String {
    String::from_utf8_lossy(value).trim_matches(['\0', ' ']).to_owned()
}
