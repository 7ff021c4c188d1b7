//! NRRD sequences (`.nrrd`), raw or gzip, as PLUS and 3D Slicer write them. Format: <https://teem.sourceforge.net/nrrd/format.html>.

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
    let mut is_byte = false;
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
                is_byte = ["uint8", "uchar", "unsigned char", "uint8_t"].contains(&value);
                if !is_byte {
                    return Err(ImagingError::invalid(path, key, format!("\"{}\"", short(value)), "uint8"));
                }
            }
            "encoding" => encoding = Some(value.to_owned()),
            "spacings" => header.spacing_mm = spacing(path, key, value)?,
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
    let [width, height, count] = three(path, "sizes", &dimensions)?;
    check_size(path, "sizes", [width, height, count])?;
    (header.width, header.height, header.count) = (width, height, count);
    header.frames.truncate(count);
    if !is_byte {
        return Err(ImagingError::invalid(path, "type", "missing", "uint8"));
    }
    let bytes: Box<dyn Read> = match encoding.as_deref() {
        Some("raw") => Box::new(bytes),
        Some("gzip" | "gz") => Box::new(GzDecoder::new(bytes)),
        other => {
            let problem = other.map_or_else(|| "missing".to_owned(), |other| format!("\"{}\"", short(other)));
            return Err(ImagingError::invalid(path, "encoding", problem, "raw or gzip"));
        }
    };
    Ok((header, Source::Stream { bytes, channels: 1 }))
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
