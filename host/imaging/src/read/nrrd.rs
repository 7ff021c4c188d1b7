//! NRRD sequences (`.nrrd`), raw or gzip, as PLUS and 3D Slicer write them. Format: <https://teem.sourceforge.net/nrrd/format.html>.

use super::depth::Depth;
use super::header::{frame_field, line, short, sizes, spacing};
use super::metaimage::three;
use super::{Source, check_size};
use crate::error::ImagingError;
use crate::frame::{Header, Orientation};
use flate2::read::GzDecoder;
use std::fs::File;
use std::io::{BufReader, Read};
use std::path::Path;

pub(super) fn open(path: &Path) -> Result<(Header, Source), ImagingError> {
    let file = File::open(path).map_err(ImagingError::io(path))?;
    let mut bytes = BufReader::new(file);
    let mut read = 0;
    let magic = line(path, &mut bytes, &mut read)?.unwrap_or_default();
    if !magic.starts_with("NRRD000") {
        return Err(ImagingError::invalid(
            path,
            "header",
            format!("\"{}\"", short(&magic)),
            "NRRD0001 to NRRD0005",
        ));
    }
    let mut header = Header::default();
    let mut dimensions = Vec::new();
    let mut encoding = None;
    let (mut depth, mut is_big_endian, mut is_colour) = (None, false, false);
    loop {
        let Some(text) = line(path, &mut bytes, &mut read)? else {
            return Err(ImagingError::invalid(
                path,
                "header",
                "ends without an empty line",
                "data behind an empty line",
            ));
        };
        if text.is_empty() {
            break;
        }
        if text.starts_with('#') {
            continue;
        }
        if let Some((key, value)) = text.split_once(":=") {
            if key == "ultrasound image orientation" {
                header.orientation = Some(Orientation::parse(value).ok_or_else(|| {
                    ImagingError::invalid(path, key, format!("\"{}\"", short(value)), "MF, UF, MN or UN")
                })?);
            }
            frame_field(path, key, value, &mut header.frames)?;
            continue;
        }
        let Some((key, value)) = text.split_once(':') else {
            return Err(ImagingError::invalid(
                path,
                "header",
                format!("\"{}\"", short(&text)),
                "field: value",
            ));
        };
        let value = value.trim();
        match key {
            "sizes" => dimensions = sizes(path, key, value)?,
            "type" => {
                depth = Some(match value {
                    "uint8" | "uchar" | "unsigned char" | "uint8_t" => Depth::Eight,
                    "uint16" | "ushort" | "unsigned short" | "uint16_t" | "unsigned short int" => {
                        Depth::Sixteen { is_big_endian: false, is_signed: false, shift: 8 }
                    }
                    "int16" | "short" | "int16_t" | "signed short" | "short int" => {
                        Depth::Sixteen { is_big_endian: false, is_signed: true, shift: 8 }
                    }
                    _ => {
                        let problem = format!("\"{}\"", short(value));
                        return Err(ImagingError::invalid(path, key, problem, "uint8, uint16 or int16"));
                    }
                });
            }
            "endian" => is_big_endian = value == "big",
            "kinds" => {
                let first = value.split_whitespace().next().unwrap_or_default();
                is_colour = ["vector", "RGB-color", "3-color"].contains(&first);
            }
            "encoding" => encoding = Some(value.to_owned()),
            "spacings" => {
                // The axis of colours has none.
                let sizes = value.split_whitespace().skip_while(|size| size.eq_ignore_ascii_case("nan"));
                header.spacing_mm = spacing(path, key, &sizes.collect::<Vec<_>>().join(" "))?;
            }
            "space directions" => header.spacing_mm = directions(path, key, value)?,
            "data file" | "datafile" => {
                return Err(ImagingError::invalid(
                    path,
                    key,
                    format!("\"{}\"", short(value)),
                    "data in the file itself",
                ));
            }
            _ => {}
        }
    }
    let channels = match dimensions.first() {
        Some(3) if is_colour => 3,
        _ => 1,
    };
    let [width, height, count] = three(path, "sizes", dimensions.get(channels / 3..).unwrap_or_default())?;
    check_size(path, "sizes", [width, height, count])?;
    (header.width, header.height, header.count) = (width, height, count);
    header.frames.truncate(count);
    let depth = match depth {
        Some(Depth::Sixteen { is_signed, shift, .. }) => Depth::Sixteen { is_big_endian, is_signed, shift },
        Some(Depth::Eight) => Depth::Eight,
        None => return Err(ImagingError::invalid(path, "type", "missing", "uint8, uint16 or int16")),
    };
    let bytes: Box<dyn Read> = match encoding.as_deref() {
        Some("raw") => Box::new(bytes),
        Some("gzip" | "gz") => Box::new(GzDecoder::new(bytes)),
        other => {
            let problem = other.map_or_else(|| "missing".to_owned(), |other| format!("\"{}\"", short(other)));
            return Err(ImagingError::invalid(path, "encoding", problem, "raw or gzip"));
        }
    };
    Ok((header, Source::Stream { bytes, channels, depth }))
}

/// Lengths of the first two of vectors such as `(0.1,0) (0,0.1) none`.
fn directions(path: &Path, key: &str, value: &str) -> Result<Option<[f64; 2]>, ImagingError> {
    let length = |vector: &str| -> Option<f64> {
        let numbers: Option<Vec<f64>> = vector.split(',').map(|number| number.trim().parse().ok()).collect();
        Some(numbers?.iter().map(|number: &f64| number * number).sum::<f64>().sqrt())
    };
    let lengths: Option<Vec<String>> = value
        .split('(')
        .skip(1)
        .take(2)
        .map(|part| {
            part.split_once(')').and_then(|(vector, _)| length(vector)).map(|length| length.to_string())
        })
        .collect();
    spacing(path, key, &lengths.unwrap_or_default().join(" "))
}
