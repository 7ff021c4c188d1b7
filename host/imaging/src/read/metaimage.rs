//! MetaImage sequences (`.mha`, `.mhd` with its data beside it), raw or compressed, as PLUS and ITK write them.
//!
//! Format: <https://itk.org/Wiki/MetaIO/Documentation>; fields of frames: PLUS sequence files.

use super::depth::Depth;
use super::header::{frame_field, line, short, sizes, spacing};
use super::{Source, check_size};
use crate::error::ImagingError;
use crate::frame::{Header, Orientation};
use flate2::read::ZlibDecoder;
use std::fs::File;
use std::io::{BufReader, Read};
use std::path::Path;

pub(super) fn open(path: &Path) -> Result<(Header, Source), ImagingError> {
    let file = File::open(path).map_err(ImagingError::io(path))?;
    let mut bytes = BufReader::new(file);
    let mut header = Header::default();
    let (mut read, mut channels, mut compressed) = (0, 1, false);
    let (mut kind, mut is_big_endian) = ("MET_UCHAR", false);
    let mut dimensions = Vec::new();
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
        let (key, value) = (key.trim(), value.trim());
        match key {
            "DimSize" => dimensions = sizes(path, key, value)?,
            "ElementSpacing" | "ElementSize" => header.spacing_mm = spacing(path, key, value)?,
            "ElementNumberOfChannels" => {
                channels = single(path, key, value, &["1", "3"])?.parse().unwrap_or(1)
            }
            "ElementType" => {
                kind = match single(path, key, value, &["MET_UCHAR", "MET_USHORT", "MET_SHORT"])? {
                    ushort if ushort.eq_ignore_ascii_case("MET_USHORT") => "MET_USHORT",
                    short if short.eq_ignore_ascii_case("MET_SHORT") => "MET_SHORT",
                    _ => "MET_UCHAR",
                };
            }
            "BinaryDataByteOrderMSB" | "ElementByteOrderMSB" => {
                is_big_endian = single(path, key, value, &["True", "False"])?.eq_ignore_ascii_case("True");
            }
            "BinaryData" => {
                single(path, key, value, &["True"])?;
            }
            "HeaderSize" => {
                single(path, key, value, &["0"])?;
            }
            "CompressedData" => {
                compressed = single(path, key, value, &["True", "False"])?.eq_ignore_ascii_case("True");
            }
            "UltrasoundImageOrientation" => {
                header.orientation = Some(Orientation::parse(value).ok_or_else(|| {
                    ImagingError::invalid(path, key, format!("\"{}\"", short(value)), "MF, UF, MN or UN")
                })?);
            }
            "ElementDataFile" => break value.to_owned(),
            _ => frame_field(path, key, value, &mut header.frames)?,
        }
    };
    let [width, height, count] = three(path, "DimSize", &dimensions)?;
    check_size(path, "DimSize", [width, height, count])?;
    (header.width, header.height, header.count) = (width, height, count);
    header.frames.truncate(count);
    let raw: Box<dyn Read> = if data == "LOCAL" {
        Box::new(bytes)
    } else {
        // The name is a file's own: it may not lead out of its folder.
        let beside = path.parent().map(|folder| folder.join(&data));
        let plain = !data.contains(['/', '\\', ' ']) && data != "LIST";
        let beside = beside.filter(|_| plain).ok_or_else(|| {
            ImagingError::invalid(
                path,
                "ElementDataFile",
                format!("\"{}\"", short(&data)),
                "LOCAL or a file beside this one",
            )
        })?;
        Box::new(BufReader::new(File::open(&beside).map_err(ImagingError::io(&beside))?))
    };
    let bytes: Box<dyn Read> = if compressed { Box::new(ZlibDecoder::new(raw)) } else { raw };
    let depth = match kind {
        "MET_UCHAR" => Depth::Eight,
        _ => Depth::Sixteen { is_big_endian, is_signed: kind == "MET_SHORT", shift: 8 },
    };
    Ok((header, Source::Stream { bytes, channels, depth }))
}

/// One of a few values.
fn single<'a>(path: &Path, key: &str, value: &'a str, known: &[&str]) -> Result<&'a str, ImagingError> {
    if known.iter().any(|known| known.eq_ignore_ascii_case(value)) {
        return Ok(value);
    }
    Err(ImagingError::invalid(path, key, format!("\"{}\"", short(value)), known.join(" or ")))
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
