//! NRRD sequences (`.nrrd`, and `.nhdr` with data in other files), raw or gzip, as PLUS and 3D Slicer write them. Format: <https://teem.sourceforge.net/nrrd/format.html>.
//!
//! 3D Slicer writes the list of frames as the first axis or as the last one. If it is the first, samples of all frames
//! alternate, and the frames are kept whole, up to [`MAX_KEPT`].

use super::beside::{self, Joined, beside};
use super::depth::{Depth, Extremes};
use super::header::{Fields, Frames, line, mirrored, one_of, orientation, short, sizes, spacing};
use super::metaimage::{millimetres, three, unit};
use super::{FrameReader, Source, check_size};
use crate::error::ImagingError;
use crate::frame::{Frame, FrameFields, Header, Statement, Unclear};
use crate::places::StatedPlaces;
use flate2::read::MultiGzDecoder;
use std::fs::File;
use std::io::{self, BufRead, BufReader, Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};

/// Spaces whose third axis is that of a mirror image.
const LEFT_HANDED: [&str; 6] = [
    "left-anterior-superior",
    "las",
    "left-anterior-superior-time",
    "last",
    "3d-left-handed",
    "3d-left-handed-time",
];
/// Most bytes of frames whose samples alternate.
const MAX_KEPT: usize = 1 << 30;

pub(super) fn open(path: &Path) -> Result<(Header, Source), ImagingError> {
    let file = File::open(path).map_err(ImagingError::io(path))?;
    let mut bytes = BufReader::new(file);
    let mut header = Header::default();
    let (fields, files) = fields(path, &mut bytes, &mut header)?;
    let text = |names: &[&'static str]| fields.get(names);
    let (_, value) = text(&["sizes"]).unwrap_or_default();
    let dimensions = sizes(path, "sizes", value)?;
    let axes = Axes::new(path, text(&["kinds"]).map(|(_, value)| value), &dimensions)?;
    let [width, height, count] = three(path, "sizes", &axes.sizes)?;
    check_size(path, "sizes", [width, height, count])?;
    (header.width, header.height, header.count) = (width, height, count);
    let depth = depth(path, &fields)?;
    let channels = axes.channels;
    let needed = width * height * count * channels * depth.bytes();
    let mut bytes: Box<dyn Read> = if files.is_empty() {
        data(path, bytes, &fields, needed)?
    } else {
        let each = needed / files.len();
        let open = move |data_path: &Path| {
            let file = File::open(data_path).map_err(ImagingError::io(data_path))?;
            data(data_path, BufReader::new(file), &fields, each)
        };
        Box::new(Joined::new(path, "data file", files, (count, needed as u64), Box::new(open))?)
    };
    if !axes.is_list_first {
        return Ok((header, Source::Stream { bytes, channels, depth }));
    }
    if needed > MAX_KEPT {
        let expected = "frames as the last axis, or at most 1 GiB of them";
        return Err(ImagingError::invalid(path, "kinds", "frames as the first axis", expected));
    }
    let mut samples = vec![0; needed];
    bytes.read_exact(&mut samples).map_err(|cause| {
        ImagingError::invalid(path, "data", cause.to_string(), expected_frames(count, width, height))
    })?;
    let mut extremes = Extremes::default();
    extremes.add(depth, &samples);
    let depth = extremes.fit(depth);
    let frames = Alternating { path: path.to_owned(), samples, depth, size: [width, height], count, next: 0 };
    Ok((header, Source::Reader(Box::new(frames))))
}

fn expected_frames(count: usize, width: usize, height: usize) -> String {
    format!("{count} frames of {width} x {height}")
}

/// The fields of the header, names in lower case, and the files of the data if they are not behind it; fields of frames go into
/// `header`, which has its number of frames from `sizes`.
fn fields(
    path: &Path,
    bytes: &mut BufReader<File>,
    header: &mut Header,
) -> Result<(Fields, Vec<PathBuf>), ImagingError> {
    let (mut read, mut fields, mut frames) = (0, Fields::default(), Frames::default());
    let (mut files, mut is_list, mut index) = (Vec::new(), false, None);
    let magic = line(path, bytes, &mut read)?.unwrap_or_default();
    if !magic.starts_with("NRRD000") {
        return Err(ImagingError::invalid(
            path,
            "header",
            format!("\"{}\"", short(&magic)),
            "NRRD0001 to NRRD0005",
        ));
    }
    loop {
        let text = match line(path, bytes, &mut read)? {
            Some(text) if is_list => {
                if !text.is_empty() {
                    files.push(beside(path, "data file", text.trim())?);
                }
                continue;
            }
            Some(text) => text,
            // Behind a header of its own there is nothing.
            None if is_list || !files.is_empty() => break,
            None => {
                let expected = "data behind an empty line, or a data file";
                return Err(ImagingError::invalid(path, "header", "ends without an empty line", expected));
            }
        };
        if text.is_empty() {
            break;
        }
        if text.starts_with('#') {
            continue;
        }
        if let Some((key, value)) = text.split_once(":=") {
            match key {
                "ultrasound image orientation" | "UltrasoundImageOrientation" => {
                    orientation(header, key, value.trim())
                }
                "ultrasound image type" | "UltrasoundImageType"
                    if !["BRIGHTNESS", "RGB_COLOR", "XX"].contains(&value.trim()) =>
                {
                    let problem = format!("\"{}\"", short(value));
                    return Err(ImagingError::invalid(path, key, problem, "BRIGHTNESS or RGB_COLOR"));
                }
                _ => match key.strip_prefix("axis ").and_then(|rest| rest.strip_suffix(" index values")) {
                    Some(axis) => index = Some((axis.trim().to_owned(), value.to_owned())),
                    None => frames.enter(path, key, value)?,
                },
            }
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
        let (key, value) = (key.to_lowercase(), value.trim());
        if matches!(key.as_str(), "data file" | "datafile") {
            // A list of names is the end of the header.
            is_list = value.split_whitespace().next() == Some("LIST");
            if !is_list {
                files = beside::files(path, "data file", value)?;
            }
        }
        fields.enter(path, &key, value)?;
    }
    if is_list && files.is_empty() {
        return Err(ImagingError::invalid(
            path,
            "data file",
            "an empty list",
            "names of files, one in a line",
        ));
    }
    let dimensions = sizes(path, "sizes", fields.get(&["sizes"]).unwrap_or_default().1)?;
    if let Some((key, value)) = fields.get(&["dimension"])
        && value.parse() != Ok(dimensions.len())
    {
        let problem = format!("{} beside sizes with {} numbers", short(value), dimensions.len());
        return Err(ImagingError::invalid(path, key, problem, "a size for each dimension"));
    }
    let axes = Axes::new(path, fields.get(&["kinds"]).map(|(_, value)| value), &dimensions)?;
    if let Ok([_, _, count]) = three(path, "sizes", &axes.sizes) {
        header.count = count;
    }
    if let Some((key, value)) = fields.get(&["space directions"]) {
        let space = fields.get(&["space"]).map(|(_, value)| value.to_lowercase());
        let is_left_handed = space.is_some_and(|space| LEFT_HANDED.contains(&space.as_str()));
        mirrored(
            header,
            key,
            [0, 1].map(|vector| [vector_part(vector, 0, value), vector_part(vector, 1, value)]),
            is_left_handed,
        );
    }
    match stated_spacing(&fields, &axes) {
        Ok(mm) => header.spacing_mm = mm,
        Err(unclear) => header.unclear.push((Statement::Spacing, unclear)),
    }
    frames.finish(header);
    if header.frames.is_empty() {
        header.places = axes.places(&fields, header.count);
    }
    if let Some((axis, values)) = index {
        add_times(header, &fields, &axis, &values);
    }
    Ok((fields, files))
}

fn vector_part(vector: usize, place: usize, value: &str) -> Option<f64> {
    let inside = value.split('(').nth(vector + 1)?.split_once(')')?.0;
    inside.split(',').nth(place)?.trim().parse().ok()
}

/// Times of the frames that have no stamps, where the values of a list axis are times, as 3D Slicer writes them.
fn add_times(header: &mut Header, fields: &Fields, axis: &str, values: &str) {
    let Ok(axis) = axis.parse::<usize>() else { return };
    let quoted = |names: &[&'static str]| {
        let (_, value) = fields.get(names)?;
        value.split('"').skip(1).step_by(2).nth(axis).map(str::to_lowercase)
    };
    let to_s = match quoted(&["units"]).as_deref() {
        None | Some("" | "s" | "second" | "seconds") => 1.0,
        Some("ms") => 1e-3,
        Some(_) => return,
    };
    let times: Option<Vec<f64>> = values
        .split_whitespace()
        .map(|value| value.parse().ok().filter(|time: &f64| time.is_finite()))
        .collect();
    let Some(times) = times.filter(|times| times.len() == header.count) else { return };
    if quoted(&["labels"]).is_none_or(|label| label != "time") {
        return;
    }
    header.frames.resize(header.count, FrameFields::default());
    for (frame, time) in header.frames.iter_mut().zip(times) {
        frame.time_s = frame.time_s.or(Some(to_s * time));
    }
}

/// Meaning of the axes of the data.
struct Axes {
    channels: usize,
    is_list_first: bool,
    /// Width, height (and depth 1), frames.
    sizes: Vec<usize>,
    /// Positions of width and height among all axes.
    plane: [usize; 2],
    all: usize,
}

impl Axes {
    fn new(path: &Path, kinds: Option<&str>, dimensions: &[usize]) -> Result<Self, ImagingError> {
        let kinds: Vec<&str> = kinds.unwrap_or_default().split_whitespace().collect();
        let first = kinds.first().copied().unwrap_or_default();
        let channels = match (first, dimensions.first()) {
            ("vector" | "RGB-color" | "3-color", Some(3)) => 3,
            ("vector" | "RGBA-color" | "4-color", Some(4)) => 4,
            _ => 1,
        };
        let is_colour = channels > 1;
        let place_kinds = ["domain", "space", "time", "list", "none", "???"];
        if let Some(other) =
            kinds.iter().skip(usize::from(is_colour)).find(|kind| !place_kinds.contains(&**kind))
        {
            let expected = "domain, space, time or list, behind RGB-color, RGBA-color or a vector of 3 or 4";
            return Err(ImagingError::invalid(path, "kinds", format!("\"{}\"", short(other)), expected));
        }
        let is_list_first = first == "list" && !kinds.iter().skip(1).any(|kind| *kind == "list");
        let skipped = usize::from(is_colour || is_list_first);
        let mut sizes = dimensions.get(skipped..).unwrap_or_default().to_vec();
        if is_list_first {
            // An image in space has a third axis, of one slice.
            sizes.extend(dimensions.first());
        }
        Ok(Self { channels, is_list_first, sizes, plane: [skipped, skipped + 1], all: dimensions.len() })
    }

    /// Positions of the frames by the third of three axes, where that is one of space.
    fn places(&self, fields: &Fields, count: usize) -> Option<StatedPlaces> {
        let is_of_space = fields.get(&["kinds"]).is_none_or(|(_, kinds)| {
            kinds.split_whitespace().nth(2).is_some_and(|kind| matches!(kind, "domain" | "space"))
        });
        if self.all != 3 || self.plane != [0, 1] || !is_of_space {
            return None;
        }
        let unit = |names: &[&'static str], axis: usize| {
            let quoted =
                fields.get(names).and_then(|(_, value)| value.split('"').skip(1).step_by(2).nth(axis));
            quoted.filter(|name| !matches!(*name, "" | "???")).map_or(Some(1.0), millimetres)
        };
        let (field, step_mm) = match (fields.get(&["spacings"]), fields.get(&["space directions"])) {
            (Some((field, value)), _) => {
                let step: f64 = value.split_whitespace().nth(2)?.parse().ok()?;
                (field, step * unit(&["units"], 2)?)
            }
            (None, Some((field, value))) => {
                let vector = value.split('(').nth(3)?.split_once(')')?.0;
                (field, vector_length(vector)? * unit(&["space units"], 0)?)
            }
            (None, None) => return None,
        };
        StatedPlaces::evenly(field, step_mm, count)
    }

    /// Values of the plane's axes, where there is one for each axis.
    fn plane<'t>(&self, values: &[&'t str]) -> Option<[&'t str; 2]> {
        // Units and vectors of space have no entry for axes that are none of it.
        let plane_axes = if values.len() == self.all { self.plane } else { [0, 1] };
        let [x, y] = plane_axes.map(|plane_axes| values.get(plane_axes).copied());
        Some([x?, y?])
    }
}

/// The distance of pixels by each field that states it, in millimetres by its unit.
fn stated_spacing(fields: &Fields, axes: &Axes) -> Result<Option<[f64; 2]>, Unclear> {
    let to_mm = |names: &[&'static str]| -> Result<[f64; 2], Unclear> {
        let Some((field, value)) = fields.get(names) else { return Ok([1.0; 2]) };
        let units: Vec<&str> = value.split('"').skip(1).step_by(2).collect();
        let Some(units) = axes.plane(&units) else { return Ok([1.0; 2]) };
        match units.map(|name| match name {
            "" | "???" => Some(1.0),
            name => millimetres(name),
        }) {
            [Some(x), Some(y)] => Ok([x, y]),
            _ => Err(unit(field, value)),
        }
    };
    let spacings = match fields.get(&["spacings"]) {
        None => None,
        Some((field, value)) => {
            let values: Vec<&str> = value.split_whitespace().collect();
            let sizes = axes.plane(&values).and_then(|[x, y]| Some([x.parse().ok()?, y.parse().ok()?]));
            spacing(field, sizes_mm(sizes, to_mm(&["units"])?), value)?
        }
    };
    let directions = match fields.get(&["space directions"]) {
        None => None,
        Some((field, value)) => {
            let units = to_mm(&["space units"])?;
            spacing(field, sizes_mm(lengths(value), [units[0]; 2]), value)?
        }
    };
    one_of(&[("spacings", spacings), ("space directions", directions)])
}

fn sizes_mm(sizes: Option<[f64; 2]>, to_mm: [f64; 2]) -> Option<[f64; 2]> {
    sizes.map(|sizes| [0, 1].map(|axis: usize| sizes[axis] * to_mm[axis]))
}

/// Lengths of the first two of vectors such as `(0.1,0) (0,0.1) none`.
fn lengths(value: &str) -> Option<[f64; 2]> {
    let vectors = value.split('(').skip(1).take(2);
    let lengths: Option<Vec<f64>> = vectors.map(|part| vector_length(part.split_once(')')?.0)).collect();
    lengths?.try_into().ok()
}

fn vector_length(vector: &str) -> Option<f64> {
    let numbers: Option<Vec<f64>> = vector.split(',').map(|number| number.trim().parse().ok()).collect();
    Some(numbers?.iter().map(|number: &f64| number * number).sum::<f64>().sqrt())
}

/// Format of samples.
fn depth(path: &Path, fields: &Fields) -> Result<Depth, ImagingError> {
    let expected = "uint8, uint16 or int16";
    let Some((key, value)) = fields.get(&["type"]) else {
        return Err(ImagingError::invalid(path, "type", "missing", expected));
    };
    let is_signed = match value.to_lowercase().as_str() {
        "uint8" | "uchar" | "unsigned char" | "uint8_t" => return Ok(Depth::Eight),
        "uint16" | "ushort" | "unsigned short" | "uint16_t" | "unsigned short int" => false,
        "int16" | "short" | "int16_t" | "signed short" | "short int" | "signed short int" => true,
        _ => return Err(ImagingError::invalid(path, key, format!("\"{}\"", short(value)), expected)),
    };
    let is_big_endian = match fields.get(&["endian"]) {
        Some((_, order)) if order.eq_ignore_ascii_case("little") => false,
        Some((_, order)) if order.eq_ignore_ascii_case("big") => true,
        other => {
            let problem =
                other.map_or_else(|| "missing".to_owned(), |(_, value)| format!("\"{}\"", short(value)));
            return Err(ImagingError::invalid(path, "endian", problem, "little or big"));
        }
    };
    Ok(Depth::Sixteen { is_big_endian, is_signed, black: 0, shift: 8 })
}

/// The data behind the header, and behind the lines and bytes that it skips.
fn data(
    path: &Path,
    mut bytes: BufReader<File>,
    fields: &Fields,
    needed: usize,
) -> Result<Box<dyn Read>, ImagingError> {
    for _ in 0..whole_number(&["line skip", "lineskip"], 0, path, fields)? {
        if bytes.skip_until(b'\n').map_err(ImagingError::io(path))? == 0 {
            return Err(ImagingError::invalid(
                path,
                "line skip",
                "more lines than there are",
                "lines before the data",
            ));
        }
    }
    let skip = whole_number(&["byte skip", "byteskip"], -1, path, fields)?;
    let mut data: Box<dyn Read> =
        match fields.get(&["encoding"]).map(|(_, value)| value.to_lowercase()).as_deref() {
            Some("raw") => {
                if skip < 0 {
                    let end = bytes.seek(SeekFrom::End(0)).map_err(ImagingError::io(path))?;
                    let expected = format!("{needed} bytes of frames at the end of the file");
                    let start = end.checked_sub(needed as u64).ok_or_else(|| {
                        ImagingError::invalid(path, "byte skip", format!("{end} bytes"), expected)
                    })?;
                    bytes.seek(SeekFrom::Start(start)).map_err(ImagingError::io(path))?;
                }
                Box::new(bytes)
            }
            Some("gzip" | "gz") if skip < 0 => {
                return Err(ImagingError::invalid(
                    path,
                    "byte skip",
                    "-1",
                    "a number of bytes before compressed data",
                ));
            }
            Some("gzip" | "gz") => Box::new(MultiGzDecoder::new(bytes)),
            other => {
                let problem =
                    other.map_or_else(|| "missing".to_owned(), |other| format!("\"{}\"", short(other)));
                return Err(ImagingError::invalid(path, "encoding", problem, "raw or gzip"));
            }
        };
    let skip = u64::try_from(skip).unwrap_or(0);
    let skipped = io::copy(&mut (&mut data).take(skip), &mut io::sink()).map_err(ImagingError::io(path))?;
    if skipped < skip {
        let problem = format!("{skip}, of {skipped} bytes");
        return Err(ImagingError::invalid(path, "byte skip", problem, "bytes before the data"));
    }
    Ok(data)
}

fn whole_number(
    names: &[&'static str],
    least: i64,
    path: &Path,
    fields: &Fields,
) -> Result<i64, ImagingError> {
    match fields.get(names) {
        None => Ok(0),
        Some((key, value)) => {
            let number: Option<i64> = value.parse().ok().filter(|number| *number >= least);
            let problem = format!("\"{}\"", short(value));
            number.ok_or_else(|| {
                ImagingError::invalid(path, key, problem, format!("a whole number from {least} on"))
            })
        }
    }
}

/// Frames whose samples alternate.
struct Alternating {
    path: PathBuf,
    samples: Vec<u8>,
    depth: Depth,
    size: [usize; 2],
    count: usize,
    next: usize,
}

impl FrameReader for Alternating {
    fn next(&mut self) -> Result<Frame, ImagingError> {
        let [width, height] = self.size;
        let (bytes, number) = (self.depth.bytes(), self.next);
        self.next += 1;
        let frame_samples = self.samples.chunks_exact(bytes).skip(number).step_by(self.count.max(1));
        let frame_bytes: Vec<u8> = frame_samples.flatten().copied().collect();
        super::whole(
            &self.path,
            &format!("frame {}", number + 1),
            [width, height],
            self.depth.samples(frame_bytes),
        )
    }
}
