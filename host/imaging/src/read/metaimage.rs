//! MetaImage sequences (`.mha`, `.mhd` with its data beside it), raw or compressed, as PLUS and ITK write them.
//!
//! Format: <https://itk.org/Wiki/MetaIO/Documentation>; fields of frames: PLUS sequence files.

use super::beside::{Joined, beside, files};
use super::depth::Depth;
use super::header::{Fields, Frames, line, mirrored, one_of, orientation, short, sizes, spacing, two};
use super::{Source, check_size};
use crate::error::ImagingError;
use crate::frame::{Header, Statement, Unclear};
use crate::places::StatedPlaces;
use flate2::read::ZlibDecoder;
use std::fs::File;
use std::io::{BufRead, BufReader, Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};

pub(super) fn open(path: &Path) -> Result<(Header, Source), ImagingError> {
    let file = File::open(path).map_err(ImagingError::io(path))?;
    let mut bytes = BufReader::new(file);
    let mut header = Header::default();
    let (mut read, mut fields, mut frames) = (0, Fields::default(), Frames::default());
    let data = loop {
        let Some(text) = line(path, &mut bytes, &mut read)? else {
            return Err(ImagingError::invalid(
                path,
                "ElementDataFile",
                "missing",
                "LOCAL or a file beside this one",
            ));
        };
        let Some((key, value)) = text.split_once('=') else {
            let expected = "a MetaImage header: Name = value";
            return Err(ImagingError::invalid(path, "header", format!("\"{}\"", short(&text)), expected));
        };
        match (key.trim(), value.trim()) {
            ("ElementDataFile", data) => break data.to_owned(),
            (key, value) if key.starts_with("Seq_Frame") => frames.enter(path, key, value)?,
            (key, value) => fields.enter(path, key, value)?,
        }
    };
    let is_true =
        |names: &[&str]| Ok::<_, ImagingError>(single(names, &["False", "True"], &fields, path)? == Some(1));
    let channels = match single(&["ElementNumberOfChannels"], &["1", "3", "4"], &fields, path)? {
        None | Some(0) => 1,
        Some(1) => 3,
        Some(_) => 4,
    };
    let kind = single(&["ElementType"], &["MET_UCHAR", "MET_USHORT", "MET_SHORT"], &fields, path)?;
    let is_big_endian = is_true(&["BinaryDataByteOrderMSB", "ElementByteOrderMSB"])?;
    single(&["BinaryData"], &["True"], &fields, path)?;
    if let Some((key, value)) = fields.get(&["ElementToIntensityFunctionSlope"])
        && !value.trim().parse::<f64>().is_ok_and(|slope| slope > 0.0)
    {
        let expected = "a number above 0, so that echoes are bright";
        return Err(ImagingError::invalid(path, key, format!("\"{value}\""), expected));
    }
    // Echoes before they are an image have no brightness.
    single(&["UltrasoundImageType"], &["BRIGHTNESS", "RGB_COLOR", "XX"], &fields, path)?;
    let compressed = is_true(&["CompressedData"])?;
    if let Some((key, value)) = fields.get(&["UltrasoundImageOrientation"]) {
        orientation(&mut header, key, value);
    }
    if let Some((key, value)) = fields.get(&["TransformMatrix", "Orientation", "Rotation"]) {
        let numbers: Option<Vec<f64>> = value.split_whitespace().map(|number| number.parse().ok()).collect();
        let numbers = numbers.unwrap_or_default();
        let sides = numbers.len().isqrt();
        let directions = [0, sides].map(|row| [row, row + 1].map(|place| numbers.get(place).copied()));
        mirrored(&mut header, key, directions, false);
    }
    match stated_spacing(&fields) {
        Ok(mm) => header.spacing_mm = mm,
        Err(unclear) => header.unclear.push((Statement::Spacing, unclear)),
    }
    let (key, value) = fields.get(&["DimSize"]).unwrap_or(("DimSize", ""));
    let dimensions = sizes(path, key, value)?;
    if let Some((key, value)) = fields.get(&["NDims"])
        && value.parse() != Ok(dimensions.len())
    {
        let problem = format!("{} beside DimSize with {} numbers", short(value), dimensions.len());
        return Err(ImagingError::invalid(path, key, problem, "a size for each dimension"));
    }
    let [width, height, count] = three(path, "DimSize", &dimensions)?;
    check_size(path, "DimSize", [width, height, count])?;
    (header.width, header.height, header.count) = (width, height, count);
    frames.finish(&mut header);
    // The third spacing of frames with fields of their own is that of no space.
    if header.frames.is_empty() {
        header.places = places(&fields, count);
    }
    let depth = match kind.unwrap_or(0) {
        0 => Depth::Eight,
        other => Depth::Sixteen { is_big_endian, is_signed: other == 2, black: 0, shift: 8 },
    };
    let header_bytes = fields.get(&["HeaderSize"]).map(|(key, value)| {
        let bytes: Option<i64> = value.parse().ok().filter(|bytes| *bytes >= -1);
        bytes.ok_or_else(|| ImagingError::invalid(path, key, format!("\"{}\"", short(value)), "bytes, or -1"))
    });
    let data_start = header_bytes.transpose()?.unwrap_or(0);
    if data.eq_ignore_ascii_case("LOCAL") {
        if data_start != 0 {
            let expected = "0, as the data follow this header";
            return Err(ImagingError::invalid(path, "HeaderSize", data_start.to_string(), expected));
        }
        let bytes: Box<dyn Read> =
            if compressed { Box::new(ZlibDecoder::new(bytes)) } else { Box::new(bytes) };
        return Ok((header, Source::Stream { bytes, channels, depth }));
    }
    let files = if data.split_whitespace().next() == Some("LIST") {
        listed(path, &mut bytes, &mut read)?
    } else {
        files(path, "ElementDataFile", &data)?
    };
    let needed = (width * height * count * channels * depth.bytes()) as u64;
    let each = needed / files.len().max(1) as u64;
    let open: Box<dyn Fn(&Path) -> _> =
        Box::new(move |data_path| data_in(data_path, data_start, each, compressed));
    let joined = Joined::new(path, "ElementDataFile", files, (count, needed), open)?;
    Ok((header, Source::Stream { bytes: Box::new(joined), channels, depth }))
}

fn single(
    names: &[&str],
    known: &[&str],
    fields: &Fields,
    path: &Path,
) -> Result<Option<usize>, ImagingError> {
    let Some((key, value)) = fields.get(names) else { return Ok(None) };
    let known_index = known.iter().position(|known| known.eq_ignore_ascii_case(value));
    known_index
        .map(Some)
        .ok_or_else(|| ImagingError::invalid(path, key, format!("\"{}\"", short(value)), known.join(" or ")))
}

/// The files whose names follow the header, one in a line.
fn listed(path: &Path, bytes: &mut impl BufRead, read: &mut u64) -> Result<Vec<PathBuf>, ImagingError> {
    let mut files = Vec::new();
    while let Some(text) = line(path, bytes, read)? {
        if !text.trim().is_empty() {
            files.push(beside(path, "ElementDataFile", text.trim())?);
        }
    }
    Ok(files)
}

/// Opens the data in a file of their own, behind so many bytes; at its end where that is -1.
fn data_in(
    data_path: &Path,
    before: i64,
    needed: u64,
    compressed: bool,
) -> Result<Box<dyn Read>, ImagingError> {
    let mut file = BufReader::new(File::open(data_path).map_err(ImagingError::io(data_path))?);
    let start = match u64::try_from(before) {
        Ok(bytes) => bytes,
        Err(_) if compressed => {
            let expected = "the number of bytes before compressed data";
            return Err(ImagingError::invalid(data_path, "HeaderSize", "-1", expected));
        }
        Err(_) => {
            let end = file.seek(SeekFrom::End(0)).map_err(ImagingError::io(data_path))?;
            end.checked_sub(needed).ok_or_else(|| {
                let expected = format!("{needed} bytes of frames");
                ImagingError::invalid(data_path, "size", format!("{end} bytes"), expected)
            })?
        }
    };
    file.seek(SeekFrom::Start(start)).map_err(ImagingError::io(data_path))?;
    Ok(if compressed { Box::new(ZlibDecoder::new(file)) } else { Box::new(file) })
}

/// The distance of pixels; their size where that is not stated. A size that differs from the distance contradicts it.
fn stated_spacing(fields: &Fields) -> Result<Option<[f64; 2]>, Unclear> {
    let millimetres_per_unit = match fields.get(&["DistanceUnits"]) {
        None => 1.0,
        Some((field, value)) => millimetres(value).ok_or_else(|| unit(field, value))?,
    };
    let stated = |field: &'static str| {
        let Some((field, value)) = fields.get(&[field]) else { return Ok((field, None)) };
        let mm = two(value).map(|sizes| sizes.map(|size| millimetres_per_unit * size));
        Ok((field, spacing(field, mm, value)?))
    };
    one_of(&[stated("ElementSpacing")?, stated("ElementSize")?])
}

/// Positions of the frames by the third distance.
fn places(fields: &Fields, count: usize) -> Option<StatedPlaces> {
    let millimetres_per_unit =
        fields.get(&["DistanceUnits"]).map_or(Some(1.0), |(_, value)| millimetres(value))?;
    let (field, value) = fields.get(&["ElementSpacing", "ElementSize"])?;
    let step: f64 = value.split_whitespace().nth(2)?.parse().ok()?;
    StatedPlaces::evenly(field, millimetres_per_unit * step, count)
}

/// Millimetres of a unit of length.
pub(super) fn millimetres(unit: &str) -> Option<f64> {
    Some(match unit.trim() {
        "mm" | "millimeter" | "millimeters" | "millimetre" | "millimetres" => 1.0,
        "cm" | "centimeter" | "centimeters" | "centimetre" | "centimetres" => 10.0,
        "m" | "meter" | "meters" | "metre" | "metres" => 1e3,
        "um" | "µm" | "μm" | "micron" | "microns" | "micrometer" | "micrometers" => 1e-3,
        _ => return None,
    })
}

/// A unit that is no length.
pub(super) fn unit(field: &str, value: &str) -> Unclear {
    Unclear {
        field: field.to_owned(),
        problem: format!("\"{}\"", short(value)),
        expected: "mm, cm, m or um; or --spacing-mm".to_owned(),
    }
}

/// Width, height and number of frames of two to four dimensions.
pub(super) fn three(path: &Path, field: &str, dimensions: &[usize]) -> Result<[usize; 3], ImagingError> {
    match *dimensions {
        [width, height] => Ok([width, height, 1]),
        [width, height, count] | [width, height, 1, count] => Ok([width, height, count]),
        _ => {
            let problem = format!("{} dimensions", dimensions.len());
            Err(ImagingError::invalid(path, field, problem, "width, height and number of frames"))
        }
    }
}
