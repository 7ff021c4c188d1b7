//! `guide import ultrasound`: a lateral run's shape from transverse ultrasound frames.

mod alike;
mod args;
mod contradictions;
mod document;
mod recorded;
mod reference;
mod values;

pub use args::FrameArgs;
pub use document::checksum;
pub use values::{numbers, orientation, region, spacing};

use super::frame_pictures::{self, PictureArgs, Shown, open, sequences};
use super::import_shapes::{self, ShapeArgs, SweepTimes};
use super::output::Output;
use alike::Imaged;
use anyhow::{Context, bail, ensure};
use args::MISSING_STRAIGHT;
use document::{Imported, Straight};
use formats::session::import::{id_of, name_of};
use formats::session::{DEPTH_RANGE_MM, ForceSeries, SessionWriter, Setup, ShapeSeries, is_file_name};
use imaging::overlay::Picture;
use imaging::pose::Place;
use imaging::sweep::{
    Deflection, Geometry, Line, Settings, State, Sweep, SweepError, deflections, measure, share_noise,
};
use mechanics::ShapeImage;
use recorded::RecordedRun;
use reference::refer_to_zero;
use std::path::{Path, PathBuf};

/// Imports sequences of frames as one lateral run.
pub fn run(
    paths: &[PathBuf],
    shapes: &ShapeArgs,
    args: &FrameArgs,
    pictures: &PictureArgs,
    to: &Path,
    setup: &Setup,
    out: &mut Output,
) -> anyhow::Result<()> {
    ensure!(
        !import_shapes::is_placed(shapes),
        "ultrasound: has options that are for points in space, expected those of frames (--straight, --step-mm, ...)"
    );
    let missing = args.missing();
    ensure!(missing.is_empty(), "{}", missing.join("; "));
    let settings = args.settings(setup)?;
    let recorded = args.run.as_deref().map(|id| RecordedRun::read(to, id)).transpose()?;
    let sweeps: Vec<Vec<PathBuf>> = match &recorded {
        Some(recorded) => recorded.sweeps.iter().map(|sweep| vec![sweep.frames.clone()]).collect(),
        None => sequences(paths),
    };
    // A straight needle that is given was imaged at another time: guide 2 is taken to have been at zero.
    let is_given = args.straight.is_some() || args.straight_px.is_some();
    let recorded_straight =
        recorded.as_ref().filter(|_| !is_given).and_then(|recorded| recorded.straight.as_ref());
    let of_straight = args.straight.as_ref().or(recorded_straight.map(|(path, _)| path));
    let mut of_straight =
        of_straight.map(|path| one(std::slice::from_ref(path), &settings, out)).transpose()?;
    let mut of_sweeps: Vec<(PathBuf, Sweep, Imaged)> =
        sweeps.iter().map(|files| one(files, &settings, out)).collect::<anyhow::Result<_>>()?;
    alike::check(of_straight.iter().chain(&of_sweeps).map(|(path, _, imaged)| (path, imaged)))?;
    let all_sweeps = of_straight.iter_mut().chain(&mut of_sweeps);
    share_noise(&mut all_sweeps.map(|(_, sweep, _)| sweep).collect::<Vec<_>>());
    let straight = of_straight.map(straight).transpose()?;
    let mut sheets: Vec<Vec<u8>> = Vec::new();
    let mut measured: Vec<(PathBuf, Sweep, Vec<Deflection>)> = Vec::new();
    for (files, (path, sweep, _)) in sweeps.iter().zip(of_sweeps) {
        sheets.extend(draw(pictures, files, &settings, &sweep, out)?);
        let line = match (&straight, args.straight_px) {
            (Some((_, _, line)), _) => *line,
            (None, Some(px)) => along(px, files, &settings)?,
            (None, None) => bail!(MISSING_STRAIGHT),
        };
        let points = deflections(&sweep.points(), &line);
        measured.push((path, sweep, points));
    }
    if let (Some(recorded), Some((_, zero_hold))) = (&recorded, recorded_straight) {
        let mut points: Vec<Vec<Deflection>> =
            measured.iter_mut().map(|(_, _, points)| std::mem::take(points)).collect();
        refer_to_zero(&mut points, &recorded.displacements_mm, *zero_hold);
        measured.iter_mut().zip(points).for_each(|((_, _, of_sweep), points)| *of_sweep = points);
    }
    let columns: Vec<ShapeSeries> =
        measured.iter().map(|(_, sweep, points)| series(points, args.shared_sd_mm(sweep, points))).collect();
    let entry_mm = 1e3 * setup.rig.entry_m;
    let deepest_mm =
        measured.iter().flat_map(|(_, _, points)| points).map(|p| p.z_mm).fold(f64::NEG_INFINITY, f64::max);
    let stated_mm = recorded.as_ref().map(|recorded| 1e3 * recorded.run.depth_m).or(shapes.depth_mm);
    let depth_mm = stated_mm.unwrap_or(deepest_mm - entry_mm);
    let [least_mm, most_mm] = DEPTH_RANGE_MM;
    ensure!(
        (least_mm..=most_mm).contains(&depth_mm),
        "the needle would be {depth_mm:.1} mm deep in the tissue, expected {least_mm} to {most_mm} mm: do --sweep-start-mm and entry_mm fit?"
    );
    let first =
        sweeps.first().and_then(|files| files.first()).context("PATH: no file, expected one or more")?;
    let id = args.run.clone().or_else(|| shapes.id.clone()).unwrap_or_else(|| id_of(first));
    ensure!(
        is_file_name(&id),
        "--id: \"{id}\" cannot be part of a file name, expected letters, digits, - _ ."
    );
    let times_s = match &recorded {
        Some(recorded) => Some(recorded.sweeps.iter().map(|sweep| sweep.time_s).collect()),
        None => {
            let SweepTimes { times_s, note } =
                import_shapes::times_s(shapes, &id, 1e-3 * depth_mm, columns.len())?;
            note.iter().for_each(|note| out.note(note));
            times_s
        }
    };
    let mut shape = import_shapes::joined(&columns, times_s.as_deref());
    // A column of zeros would say nothing.
    for column in shape.shared_m.iter_mut().flatten().chain([&mut shape.z_shared_sd_m]) {
        *column = column.take().filter(|of| of.iter().any(|value| *value != 0.0));
    }
    let has_force = recorded.is_some() || shapes.force.is_some();
    let straight_mm = recorded_straight.map(|(_, zero_hold)| zero_hold.at_mm);
    let mut document = Imported::new(to, &id, depth_mm, times_s, has_force, &measured, straight.as_ref())?;
    document.straight_displacement_mm = straight_mm;
    let mut session = SessionWriter::open(to, setup)?;
    match &recorded {
        Some(recorded) => session.reshape(&recorded.run, &shape)?,
        None => session.lateral_from(&id, 1e-3 * depth_mm, shapes.force.as_deref(), &shape)?,
    }
    let record = to.join(format!("{id}.frames.json"));
    let text = serde_json::to_string_pretty(&document)?;
    formats::files::replace(&record, text.as_bytes())
        .with_context(|| format!("{}: cannot write", record.display()))?;
    frame_pictures::keep(to, &id, sheets.first().map(Vec::as_slice))?;
    let force = match (&recorded, &shapes.force) {
        (Some(recorded), _) => Some(recorded.run.force.clone()),
        (None, Some(path)) => Some(ForceSeries::read(path)?),
        (None, None) => None,
    };
    let doubt = force.and_then(|force| shape.doubt(&force, setup.rig.guide2_m));
    if let Some(doubt) = doubt {
        out.note(format_args!(
            "{id}: {doubt} (--straight is the straight needle, --orientation the axes of the image)"
        ));
    }
    if !has_force {
        out.note(format_args!(
            "{id}.force.csv has a header only: without a force series no modulus is identified"
        ));
    }
    out.result(&document, &document)
}

/// Measures a sequence.
fn one(files: &[PathBuf], settings: &Settings, out: &Output) -> anyhow::Result<(PathBuf, Sweep, Imaged)> {
    let path = files.first().cloned().unwrap_or_default();
    let mut sequence = open(files)?;
    let count = sequence.header().count;
    let progress = out.progress();
    let sweep = measure(&mut sequence, settings, |frame| {
        progress.set_message(format!("{}: frame {} of {count}", path.display(), frame + 1));
    });
    progress.finish_and_clear();
    let context = || path.display().to_string();
    let sweep = match sweep {
        // Its message begins with the file.
        Err(SweepError::File(error)) => return Err(error.into()),
        sweep => sweep.with_context(context)?,
    };
    sequence.header().notes.iter().for_each(|note| out.note(format_args!("{}: {note}", path.display())));
    let geometry = Geometry::new(sequence.header(), settings)?;
    contradictions::notes(&path, sequence.header(), settings, &sweep.frames, &geometry)
        .iter()
        .for_each(|note| out.note(note));
    let imaged = Imaged::new(sequence.header(), settings).with_context(context)?;
    Ok((path, sweep, imaged))
}

/// The straight needle from a sweep of its own.
fn straight((path, sweep, _): (PathBuf, Sweep, Imaged)) -> anyhow::Result<Straight> {
    let line = Line::through(&sweep.points()).with_context(|| {
        format!("{}: fewer than 3 points, expected a sweep along the needle", path.display())
    })?;
    Ok((path, sweep, line))
}

/// The straight needle at a pixel, parallel to the sweep.
fn along(px: [f64; 2], files: &[PathBuf], settings: &Settings) -> anyhow::Result<Line> {
    ensure!(
        !matches!(settings.place, Place::Transform { .. }),
        "--straight-px: has no meaning with --transform, expected --straight"
    );
    let [x, y] = Geometry::new(open(files)?.header(), settings)?.spacing_mm;
    Ok(Line::along([px[0] * x, -px[1] * y]))
}

/// Draws what is requested of a sweep.
fn draw(
    args: &PictureArgs,
    files: &[PathBuf],
    settings: &Settings,
    sweep: &Sweep,
    out: &Output,
) -> anyhow::Result<Option<Vec<u8>>> {
    if !args.is_requested() {
        return Ok(None);
    }
    let shown: Vec<Shown> = sweep
        .frames
        .iter()
        .map(|frame| Shown {
            kind: kind(frame.state),
            state: frame.state.name(),
            is_used: frame.state == State::Used,
            place: frame.place_mm.map_or_else(String::new, |[x, y, z]| format!("z {z:.1}  {x:.2}, {y:.2}")),
        })
        .collect();
    let Geometry { orientation, .. } = Geometry::new(open(files)?.header(), settings)?;
    let name = files.first().map(|path| name_of(path)).unwrap_or_default();
    frame_pictures::draw(
        args,
        &name,
        files,
        &shown,
        |number: usize, frame: imaging::frame::Frame| {
            let result = sweep.frames.get(number);
            let (state, candidate) =
                result.map_or((State::Invalid, None), |result| (result.state, result.candidate.as_ref()));
            Picture::of_sweep(&frame.oriented(orientation), state, candidate)
        },
        out,
    )
}

fn kind(state: State) -> usize {
    State::ALL.iter().position(|other| *other == state).unwrap_or(0)
}

/// Columns of a sweep whose points share an error of their positions of this standard deviation.
fn series(points: &[Deflection], shared_sd_mm: f64) -> ShapeSeries {
    let shared = |axis: usize, error: usize| -> Option<Vec<f64>> {
        Some(points.iter().map(|point| 1e-3 * point.shared_mm[axis][error]).collect())
    };
    ShapeSeries {
        time_s: None,
        z_m: column(|point| point.z_mm, points),
        y_m: column(|point| point.across_mm[1], points),
        x_m: Some(column(|point| point.across_mm[0], points)),
        y_sd_m: Some(column(|point| point.sd_mm[1], points)),
        x_sd_m: Some(column(|point| point.sd_mm[0], points)),
        images: Some(
            points
                .iter()
                .map(|point| ShapeImage {
                    beam_rad: point.motion.beam_rad,
                    probe_m_per_s: 1e-3 * point.motion.mm_per_s,
                })
                .collect(),
        ),
        z_shared_sd_m: Some(vec![1e-3 * shared_sd_mm; points.len()]),
        // The vertical plane first.
        shared_m: [1, 0].map(|axis: usize| [0, 1, 2].map(|error: usize| shared(axis, error))),
    }
}

fn column(of: fn(&Deflection) -> f64, points: &[Deflection]) -> Vec<f64> {
    points.iter().map(|point| 1e-3 * of(point)).collect()
}

/// Share of rejected frames from which the user is warned.
const MANY_REJECTED: f64 = 0.3;

/// Remarks about a sweep that deserve a warning.
fn remarks(path: &Path, sweep: &Sweep) -> Vec<String> {
    let (used_count, frame_count) = (sweep.count(State::Used), sweep.frames.len());
    let mut remarks = Vec::new();
    if ((frame_count - used_count) as f64) > MANY_REJECTED * frame_count as f64 {
        remarks.push(format!(
            "{}: {used_count} of {frame_count} frames are used: see the states, and --overlay for pictures",
            path.display()
        ));
    }
    if sweep.lag.is_none() && sweep.lag_s == 0.0 {
        remarks.push(format!(
            "{}: the lag between images and positions is not identifiable from this sweep and is taken as 0: a sweep forth and back, or \
             --lag-s, determines it",
            path.display()
        ));
    }
    remarks
}
