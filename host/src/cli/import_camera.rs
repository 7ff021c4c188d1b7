//! `guide import camera`: displacement of guide 2 from the frames of a camera, by following a part of the image.

mod document;
mod series;

use super::frame_pictures::{self, PictureArgs, Shown, open, sequences};
use super::import_shapes::{self, ShapeArgs};
use super::import_ultrasound::{numbers, region};
use super::output::{Output, figures_file};
use crate::figures;
use anyhow::{Context, bail, ensure};
use document::{Imported, Run};
use formats::session::{DEPTH_RANGE_MM, ForceSeries, SessionWriter, Setup, import::id_of, is_file_name};
use imaging::camera::{CameraError, Clip, Directions, Settings, State, measure};
use imaging::frame::Region;
use imaging::overlay::Picture;
use mechanics::unknowns::sensors;
use series::{Axes, Series, rate_note};
use std::fs;
use std::path::{Path, PathBuf};

/// Camera that shows guide 2.
#[derive(clap::Args)]
#[command(next_help_heading = "Clip (camera)")]
pub struct CameraArgs {
    /// Part of the first frame that shows guide 2 and moves with it, pixels: with edges in both directions
    #[arg(long, value_name = "X,Y,W,H", value_parser = region)]
    template: Option<Region>,
    /// Part of the first frame that shows something fixed, pixels: its motion is that of the camera, and is subtracted
    #[arg(long, value_name = "X,Y,W,H", value_parser = region)]
    mark: Option<Region>,
    /// Size of a pixel in the plane of guide 2
    #[arg(long, value_name = "MM", value_parser = scale)]
    mm_per_px: Option<f64>,
    /// Two points of known distance in the plane of guide 2 instead, such as marks of a ruler: pixels, and the distance in millimetres
    #[arg(long, value_name = "X1,Y1,X2,Y2,MM", value_parser = ruler, conflicts_with = "mm_per_px")]
    ruler: Option<Ruler>,
    /// Direction of the image that is up, the session's y
    #[arg(long, value_name = "DX,DY", value_parser = direction, default_value = "0,-1", allow_hyphen_values = true)]
    up_px: Direction,
    /// The camera looks from the tissue to guide 2, so that the session's x is to the left
    #[arg(long)]
    mirrored: bool,
    /// Frames per second, where the file has no time stamps
    #[arg(long, value_name = "HZ", value_parser = rate)]
    fps: Option<f64>,
    /// When the first frame was taken, on the clock of the force series (default: with its first row)
    #[arg(long, value_name = "SECONDS")]
    start_s: Option<f64>,
}

const MISSING_TEMPLATE: &str =
    "--template: missing, expected the part of the first frame that shows guide 2: X,Y,W,H";
const MISSING_SCALE: &str =
    "size of a pixel: missing, expected --mm-per-px, or two points of known distance (--ruler)";
const MISSING_DEPTH: &str = "--depth-mm: missing, expected the length of the needle in the tissue (0 in air): a clip of guide 2 does not show it";

/// Two points of known distance.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Ruler {
    length_px: f64,
    mm: f64,
}

/// A direction of the image, of length 1.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Direction([f64; 2]);

/// Sine of the largest angle between up and an axis of the image at which a template with texture in one direction is enough.
const MAX_SLANT: f64 = 0.05;

/// Size of a pixel, and how well it is known.
#[derive(Debug, Clone, Copy)]
pub(super) struct Scale {
    /// Millimetres.
    pub mm_per_px: f64,
    /// Its standard deviation; none where it is given.
    pub sd: Option<f64>,
}

impl CameraArgs {
    /// Whether any of its options is given.
    pub fn is_requested(&self) -> bool {
        let has_camera_options =
            self.template.is_some() || self.mark.is_some() || self.ruler.is_some() || self.mirrored;
        has_camera_options
            || [self.mm_per_px, self.fps, self.start_s].iter().any(Option::is_some)
            || self.up_px.0 != [0.0, -1.0]
    }

    fn scale(&self) -> anyhow::Result<Scale> {
        match (self.mm_per_px, self.ruler) {
            (Some(mm_per_px), _) => Ok(Scale { mm_per_px, sd: None }),
            (None, Some(Ruler { length_px, mm })) => {
                let mm_per_px = mm / length_px;
                Ok(Scale {
                    mm_per_px,
                    sd: Some(mm_per_px * 2f64.sqrt() * sensors::PLACED_POINT.sd() / length_px),
                })
            }
            (None, None) => bail!(MISSING_SCALE),
        }
    }

    /// All that is missing of what a clip needs.
    fn missing(&self, shapes: &ShapeArgs) -> Vec<&'static str> {
        [
            self.template.is_none().then_some(MISSING_TEMPLATE),
            (self.mm_per_px.is_none() && self.ruler.is_none()).then_some(MISSING_SCALE),
            (shapes.force.is_some() && shapes.depth_mm.is_none()).then_some(MISSING_DEPTH),
        ]
        .into_iter()
        .flatten()
        .collect()
    }

    /// Directions of the session's axes in the image, with those that the texture determines.
    fn axes(&self, directions: Directions) -> anyhow::Result<Axes> {
        let Direction([up_x, up_y]) = self.up_px;
        let side = if self.mirrored { -1.0 } else { 1.0 };
        let both_axes = Axes { y: [up_x, up_y], x: Some([-side * up_y, side * up_x]) };
        let (x_axis, y_axis) = match directions {
            Directions::Both => return Ok(both_axes),
            Directions::Vertical => (up_x, "columns"),
            Directions::Horizontal => (up_y, "rows"),
        };
        ensure!(
            x_axis.abs() <= MAX_SLANT,
            "--template: motion is identifiable along the {y_axis} of the image only, expected a part with edges across the session's y, which \
             is {up_x:.2},{up_y:.2} (--up-px)"
        );
        Ok(Axes { x: None, ..both_axes })
    }
}

/// Imports a clip as displacement of guide 2, with the force series as one lateral run.
pub fn run(
    paths: &[PathBuf],
    shapes: &ShapeArgs,
    args: &CameraArgs,
    pictures: &PictureArgs,
    to: &Path,
    setup: &Setup,
    out: &mut Output,
) -> anyhow::Result<()> {
    ensure!(
        !import_shapes::is_placed(shapes),
        "camera: has options that are for points in space, expected those of clips (--template, --mm-per-px, ...)"
    );
    let sequences = sequences(paths);
    let [files] = sequences.as_slice() else {
        bail!("camera: {} clips, expected one: each run has its own", sequences.len())
    };
    let missing = args.missing(shapes);
    ensure!(missing.is_empty(), "{}", missing.join("; "));
    let template = args.template.context(MISSING_TEMPLATE)?;
    let scale = args.scale()?;
    let settings = Settings { template, mark: args.mark };
    let path = files.first().cloned().unwrap_or_default();
    let id = shapes.id.clone().unwrap_or_else(|| id_of(&path));
    ensure!(
        is_file_name(&id),
        "--id: \"{id}\" cannot be part of a file name, expected letters, digits, - _ ."
    );
    let force = shapes.force.as_deref().map(ForceSeries::read_without_displacement).transpose()?;
    let depth_mm = force.as_ref().map(|_| depth_mm(shapes)).transpose()?;
    let clip = followed(files, &path, &settings, out)?;
    let axes = args.axes(clip.directions)?;
    let start_s = args.start_s.or_else(|| force.as_ref().and_then(|force| force.time_s.first().copied()));
    let series = Series::new(&clip, &axes, scale.mm_per_px, args.fps, start_s)
        .with_context(|| path.display().to_string())?;
    if let Some(note) = force.as_ref().and_then(|force| series.clock_note(force)) {
        out.note(format_args!("{}: {note}", path.display()));
    }
    if let Some(note) = rate_note(&clip, args.fps) {
        out.note(format_args!("{}: {note}", path.display()));
    }
    let sheet = draw(pictures, &id, files, &settings, &clip, &series, out)?;
    let joined = force.as_ref().map(|force| series.joined(force)).transpose()?;
    let run = depth_mm.zip(joined.as_ref()).map(|(depth_mm, joined)| Run {
        depth_mm,
        rows: joined.series.time_s.len(),
        rows_without_displacement: joined.dropped,
        start_s: series.first_s(),
        start_given: args.start_s.is_some(),
    });
    let document = Imported::new(to, &id, &path, files, &settings, &clip, &series, scale, run)?;
    match depth_mm.zip(joined) {
        Some((depth_mm, joined)) => {
            SessionWriter::open(to, setup)?.lateral_force(&id, 1e-3 * depth_mm, &joined.series)?;
            out.note(format_args!(
                "{id}.shape.csv has a header only: guide import ultrasound --force {} adds the shape to a run of its own",
                to.join(format!("{id}.force.csv")).display()
            ));
        }
        None => fs::create_dir_all(to).with_context(|| format!("{}: cannot create", to.display()))?,
    }
    write(&to.join(format!("{id}.camera.csv")), &series.csv())?;
    write(&to.join(format!("{id}.camera.json")), &serde_json::to_string_pretty(&document)?)?;
    frame_pictures::keep(to, &id, sheet.as_deref())?;
    out.result(&document, &document)
}

fn write(path: &Path, text: &str) -> anyhow::Result<()> {
    fs::write(path, text).with_context(|| format!("{}: cannot write", path.display()))
}

/// Depth of the run that the force series is of.
fn depth_mm(shapes: &ShapeArgs) -> anyhow::Result<f64> {
    let depth_mm = shapes.depth_mm.context(MISSING_DEPTH)?;
    let [least_mm, most_mm] = DEPTH_RANGE_MM;
    let is_depth = depth_mm == 0.0 || (least_mm..=most_mm).contains(&depth_mm);
    ensure!(is_depth, "--depth-mm: {depth_mm}, expected 0 or {least_mm} to {most_mm} mm");
    Ok(depth_mm)
}

/// Follows guide 2 with progress.
fn followed(files: &[PathBuf], path: &Path, settings: &Settings, out: &Output) -> anyhow::Result<Clip> {
    let mut sequence = open(files)?;
    let count = sequence.header().count;
    let progress = out.progress();
    let clip = measure(&mut sequence, settings, |frame| {
        progress.set_message(format!("{}: frame {} of {count}", path.display(), frame + 1));
    });
    progress.finish_and_clear();
    sequence.header().notes.iter().for_each(|note| out.note(format_args!("{}: {note}", path.display())));
    match clip {
        // Its message begins with the file.
        Err(CameraError::File(error)) => Err(error.into()),
        clip => clip.with_context(|| path.display().to_string()),
    }
}

/// Draws what is requested.
fn draw(
    args: &PictureArgs,
    id: &str,
    files: &[PathBuf],
    settings: &Settings,
    clip: &Clip,
    series: &Series,
    out: &Output,
) -> anyhow::Result<Option<Vec<u8>>> {
    let shown: Vec<Shown> = clip
        .frames
        .iter()
        .map(|frame| Shown {
            kind: kind(frame.state),
            state: frame.state.name(),
            is_used: frame.state == State::Used,
            place: frame.template.map_or_else(String::new, |found| {
                format!("{:.2}, {:.2} px", found.shift_px[0], found.shift_px[1])
            }),
        })
        .collect();
    let sheet = frame_pictures::draw(
        args,
        id,
        files,
        &shown,
        |number: usize, frame| match clip.frames.get(number) {
            Some(result) => Picture::of_camera(&frame, settings, result),
            None => Picture::of_sweep(&frame, imaging::sweep::State::Used, None),
        },
        out,
    )?;
    if let Some(folder) = args.plots.as_deref().and_then(|folder| out.figures_folder(Some(folder))) {
        let figure = figures::displacement(id, &series.figure(clip))?;
        figures_file(folder, &format!("{id}.displacement"), &figure, out)?;
    }
    Ok(sheet)
}

fn kind(state: State) -> usize {
    State::ALL.iter().position(|other| *other == state).unwrap_or(0)
}

fn scale(text: &str) -> Result<f64, String> {
    let mm = text.parse().ok().filter(|mm: &f64| (1e-4..=10.0).contains(mm));
    mm.ok_or_else(|| "expected a size of a pixel from 0.0001 to 10 mm".to_owned())
}

fn rate(text: &str) -> Result<f64, String> {
    let hz = text.parse().ok().filter(|hz: &f64| (1e-3..=1e6).contains(hz));
    hz.ok_or_else(|| "expected frames per second from 0.001 to 1000000".to_owned())
}

fn ruler(text: &str) -> Result<Ruler, String> {
    let numbers: Option<[f64; 5]> = numbers(text);
    numbers
        .map(|[x1, y1, x2, y2, mm]| Ruler { length_px: (x2 - x1).hypot(y2 - y1), mm })
        .filter(|ruler| ruler.length_px >= 10.0 && (0.01..=1e4).contains(&ruler.mm))
        .ok_or_else(|| {
            "expected two points at least 10 pixels apart and their distance, 0.01 to 10000 mm: X1,Y1,X2,Y2,MM".to_owned()
        })
}

fn direction(text: &str) -> Result<Direction, String> {
    numbers(text)
        .and_then(|[x, y]| {
            let length = x.hypot(y);
            (length > 1e-9).then(|| Direction([x / length, y / length]))
        })
        .ok_or_else(|| "expected a direction: DX,DY".to_owned())
}

#[cfg(test)]
mod tests;
