//! A folder of DICOM files as one sequence: archives keep the frames of a sweep as a file each.

use super::super::{FrameReader, Source, is_hidden, names};
use super::{Opened, is_dicom, open_file};
use crate::error::ImagingError;
use crate::frame::{Frame, FrameFields, Header, MAX_FRAMES};
use crate::places::StatedPlaces;
use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};

/// The DICOM files in a folder, whatever their names are, but for a directory of them.
pub(in super::super) fn files(folder: &Path) -> Result<Vec<PathBuf>, ImagingError> {
    let entries = fs::read_dir(folder).map_err(ImagingError::io(folder))?;
    let paths = entries.filter_map(Result::ok).map(|entry| entry.path()).filter(|path| {
        let is_list = path.file_name().is_some_and(|name| name == "DICOMDIR");
        !is_list && !is_hidden(path) && path.is_file() && is_dicom(path)
    });
    let mut files: Vec<PathBuf> = paths.take(MAX_FRAMES + 1).collect();
    files.sort();
    Ok(files)
}

/// Opens the files of a folder as one sequence, in the order of their instance numbers where all have one, else of their times, else of the numbers in
/// their names.
pub(in super::super) fn open_files(
    folder: &Path,
    files: &[PathBuf],
) -> Result<(Header, Source), ImagingError> {
    let mut opened: Vec<(PathBuf, Opened)> =
        files.iter().map(|path| Ok((path.clone(), open_file(path)?))).collect::<Result<_, ImagingError>>()?;
    let has_numbers = sort(&mut opened)?;
    let has_times = !has_numbers && sort_by_times(&mut opened);
    let remark = if has_numbers {
        None
    } else if has_times {
        Some("no file has an InstanceNumber of its own: frames are in the order of their times".to_owned())
    } else {
        let mut named = files.to_vec();
        let remark = names::sort(folder, &mut named)?;
        opened.sort_by_key(|(path, _)| named.iter().position(|of| of == path));
        remark
    };
    let mut header = opened.first().map(|(_, first)| first.header.clone()).unwrap_or_default();
    header.notes.extend(remark);
    let order = match (has_numbers, has_times) {
        (true, _) => "InstanceNumber",
        (false, true) => "their times",
        (false, false) => "their names",
    };
    header.places = places(&opened);
    header.notes.extend(header.places.as_ref().and_then(|places| order_note(places, order)));
    let mut pages = Vec::new();
    let mut frames = Vec::new();
    for (path, Opened { header: own, .. }) in opened {
        if [own.width, own.height] != [header.width, header.height] {
            let problem = format!("{} x {} pixels", own.width, own.height);
            let expected = format!(
                "{} x {} as in the first file: depth or zoom changed in between",
                header.width, header.height
            );
            return Err(ImagingError::invalid(&path, "Rows, Columns", problem, expected));
        }
        // Times of a file begin with that file, and are none of the series.
        let is_other_depth = own.spacing_mm != header.spacing_mm || own.region != header.region;
        frames.extend((0..own.count).map(|_| FrameFields { is_other_depth, ..FrameFields::default() }));
        pages.push((path, own.count));
    }
    header.count = frames.len();
    header.frames = frames;
    super::check_size(
        files.first().map_or(Path::new(""), PathBuf::as_path),
        "files",
        [header.width, header.height, header.count],
    )?;
    Ok((header, Source::Reader(Box::new(Files { files: pages.into_iter(), open: None }))))
}

/// Positions of the files' images, where each has one frame and a position.
fn places(opened: &[(PathBuf, Opened)]) -> Option<StatedPlaces> {
    if opened.len() == 1 {
        return opened.first().and_then(|(_, one)| one.header.places.clone());
    }
    let points: Option<Vec<[f64; 3]>> =
        opened.iter().map(|(_, one)| one.position_mm.filter(|_| one.header.count == 1)).collect();
    let normal = opened.first().and_then(|(_, first)| first.normal);
    StatedPlaces::of_points("ImagePositionPatient", &points?, normal)
}

/// Remark on files whose order is not that of their positions, or is it backwards.
fn order_note(places: &StatedPlaces, order: &str) -> Option<String> {
    let steps: Vec<f64> = places.mm.windows(2).map(|pair| pair[1] - pair[0]).collect();
    let (first, last) = (places.mm.first()?, places.mm.last()?);
    let direction = format!(
        "in the order of {order}, in which {} goes from {first:.2} to {last:.2} mm along the normal of the images",
        places.field
    );
    if steps.iter().all(|step| *step < 0.0) {
        return Some(format!(
            "the files are {direction}, backwards: if the sweep went the other way, --step-mm or --speed-mm-per-s is negative and --sweep-start-mm is at its end"
        ));
    }
    let (frame, _) = steps.iter().enumerate().find(|(_, step)| **step * (last - first) <= 0.0)?;
    Some(format!(
        "the files are {direction}, forth and back: frame {} is at {:.2} mm and frame {} at {:.2} mm: is it one sweep, in the order of its frames?",
        frame + 1,
        places.mm.get(frame)?,
        frame + 2,
        places.mm.get(frame + 1)?
    ))
}

/// Puts files in the order of their instance numbers where these differ, and returns whether they do. Two series are two sweeps, whose numbers would mix; if every
/// file has a series of its own or all have one number, as anonymised files may, they say nothing.
fn sort(opened: &mut [(PathBuf, Opened)]) -> Result<bool, ImagingError> {
    let series: BTreeSet<&Option<String>> = opened.iter().map(|(_, one)| &one.series).collect();
    let first = opened.first().and_then(|(_, first)| first.series.clone());
    if (2..opened.len()).contains(&series.len())
        && let Some((path, _)) = opened.iter().find(|(_, one)| one.series != first)
    {
        let problem = format!("not {} as in the first file", first.as_deref().unwrap_or("missing"));
        return Err(ImagingError::invalid(path, "SeriesInstanceUID", problem, "a folder for each series"));
    }
    let instances: BTreeSet<Option<i64>> = opened.iter().map(|(_, one)| one.instance).collect();
    if instances.contains(&None) || instances.len() == 1 {
        return Ok(false);
    }
    opened.sort_by_key(|(_, one)| one.instance);
    let twice = opened.windows(2).position(|pair| pair[0].1.instance == pair[1].1.instance);
    match twice.and_then(|at| opened.get(at + 1)) {
        Some((path, one)) => {
            let problem = format!("{} a second time", one.instance.unwrap_or_default());
            let expected = "one for each file: are there copies, or two sweeps?";
            Err(ImagingError::invalid(path, "InstanceNumber", problem, expected))
        }
        None => Ok(true),
    }
}

/// Puts files in the order in which they were taken, if all state that and no two the same.
fn sort_by_times(opened: &mut [(PathBuf, Opened)]) -> bool {
    let times: BTreeSet<&Option<String>> = opened.iter().map(|(_, one)| &one.taken).collect();
    if times.contains(&None) || times.len() != opened.len() {
        return false;
    }
    opened.sort_by(|(_, a), (_, b)| a.taken.cmp(&b.taken));
    true
}

/// Files with the number of their frames, one of them open.
struct Files {
    files: std::vec::IntoIter<(PathBuf, usize)>,
    open: Option<(Opened, usize)>,
}

impl FrameReader for Files {
    fn next(&mut self) -> Result<Frame, ImagingError> {
        loop {
            if let Some((opened, remaining_frames)) = &mut self.open
                && *remaining_frames > 0
            {
                *remaining_frames -= 1;
                return opened.pixels.next();
            }
            let Some((path, count)) = self.files.next() else {
                return Err(ImagingError::invalid(
                    Path::new(""),
                    "frame",
                    "missing",
                    "a frame of the series",
                ));
            };
            self.open = Some((open_file(&path)?, count));
        }
    }
}
