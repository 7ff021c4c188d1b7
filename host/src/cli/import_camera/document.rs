//! Report of `guide import camera`, which is kept beside the run.

use super::super::import_ultrasound::checksum;
use super::Scale;
use super::series::{Reading, Row, Series};
use imaging::camera::{Clip, Directions, FrameResult, Settings, State};
use imaging::frame::Region;
use serde::Serialize;
use std::collections::BTreeMap;
use std::fmt::{self, Display};
use std::path::{Path, PathBuf};

/// Result of the frames.
#[derive(Serialize)]
pub struct Imported {
    schema: &'static str,
    session: PathBuf,
    camera: Camera,
    lateral: Option<Lateral>,
    notes: Vec<String>,
}

/// A run that was written, before it has a name.
pub struct Run {
    pub depth_mm: f64,
    pub rows: usize,
    pub rows_without_displacement: usize,
    pub start_s: f64,
    pub start_given: bool,
}

#[derive(Serialize)]
struct Lateral {
    id: String,
    depth_mm: f64,
    rows: usize,
    rows_without_displacement: usize,
    /// When the first frame was taken, on the clock of the force series.
    start_s: f64,
}

#[derive(Serialize)]
struct Camera {
    id: String,
    path: PathBuf,
    /// SHA-256 of every file of the clip.
    files: Vec<FileEntry>,
    frames: usize,
    /// Frames in each state.
    states: BTreeMap<&'static str, usize>,
    template_px: [usize; 4],
    mark_px: Option<[usize; 4]>,
    template_frame: usize,
    directions: &'static str,
    mm_per_px: f64,
    mm_per_px_sd: Option<f64>,
    /// Median standard deviations of a displacement.
    sd_y_mm: f64,
    sd_x_mm: Option<f64>,
    largest_y_mm: f64,
    largest_x_mm: Option<f64>,
    /// Displacement in the last frame.
    last_y_mm: f64,
    last_x_mm: Option<f64>,
    mark: Option<MarkMotion>,
    per_frame: Vec<FrameEntry>,
}

/// Motion of the fixed mark, which is the camera's.
#[derive(Serialize)]
struct MarkMotion {
    largest_mm: f64,
    last_y_mm: f64,
    last_x_mm: f64,
}

#[derive(Serialize)]
struct FileEntry {
    path: PathBuf,
    sha256: Option<String>,
}

#[derive(Serialize)]
struct FrameEntry {
    state: &'static str,
    time_s: f64,
    shift_x_px: Option<f64>,
    shift_y_px: Option<f64>,
    sd_x_px: Option<f64>,
    sd_y_px: Option<f64>,
    score: Option<f64>,
    gain: Option<f64>,
}

/// Share of rejected frames from which the user is warned.
const MANY_REJECTED: f64 = 0.3;
/// Motion of the mark that is worth a line, millimetres.
const MARK_MOVED_MM: f64 = 0.01;

impl Imported {
    #[expect(clippy::too_many_arguments, reason = "each is one part of the document")]
    pub fn new(
        session: &Path,
        id: &str,
        path: &Path,
        files: &[PathBuf],
        settings: &Settings,
        clip: &Clip,
        series: &Series,
        scale: Scale,
        run: Option<Run>,
    ) -> anyhow::Result<Self> {
        let states = State::ALL.into_iter().map(|state| (state.name(), clip.count(state)));
        let camera = Camera {
            id: id.to_owned(),
            path: path.to_owned(),
            files: files
                .iter()
                .map(|path| {
                    let sha256 = path.is_file().then(|| checksum(path)).transpose()?;
                    Ok(FileEntry { path: path.clone(), sha256 })
                })
                .collect::<anyhow::Result<_>>()?,
            frames: clip.frames.len(),
            states: states.filter(|(_, count)| *count > 0).collect(),
            template_px: corners(settings.template),
            mark_px: settings.mark.map(corners),
            template_frame: clip.template_frame,
            directions: match clip.directions {
                Directions::Both => "both",
                Directions::Horizontal => "horizontal",
                Directions::Vertical => "vertical",
            },
            mm_per_px: scale.mm_per_px,
            mm_per_px_sd: scale.sd,
            sd_y_mm: median(series, y, |of| of.sd_mm).unwrap_or(f64::NAN),
            sd_x_mm: median(series, x, |of| of.sd_mm),
            largest_y_mm: largest(series, y).unwrap_or(f64::NAN),
            largest_x_mm: largest(series, x),
            last_y_mm: series.rows.last().map_or(f64::NAN, |row| row.y.mm),
            last_x_mm: series.rows.last().and_then(|row| Some(row.x?.mm)),
            mark: series.mark_mm.last().map(|[last_y_mm, last_x_mm]| MarkMotion {
                largest_mm: series.mark_mm.iter().map(|[y, x]| y.hypot(*x)).fold(0.0, f64::max),
                last_y_mm: *last_y_mm,
                last_x_mm: *last_x_mm,
            }),
            per_frame: clip
                .frames
                .iter()
                .zip(&series.times_s)
                .map(|(frame, time_s)| FrameEntry::new(frame, *time_s))
                .collect(),
        };
        let notes = notes(&camera, clip, run.as_ref());
        let lateral = run.map(|run| Lateral {
            id: id.to_owned(),
            depth_mm: run.depth_mm,
            rows: run.rows,
            rows_without_displacement: run.rows_without_displacement,
            start_s: run.start_s,
        });
        Ok(Self { schema: "guide.import/2", session: session.to_owned(), camera, lateral, notes })
    }
}

fn y(row: &Row) -> Option<Reading> {
    Some(row.y)
}

fn x(row: &Row) -> Option<Reading> {
    row.x
}

fn corners(region: Region) -> [usize; 4] {
    [region.x, region.y, region.width, region.height]
}

fn median(
    series: &Series,
    of: impl Fn(&Row) -> Option<Reading>,
    value: impl Fn(Reading) -> f64,
) -> Option<f64> {
    let mut sorted: Vec<f64> = series.rows.iter().filter_map(|row| Some(value(of(row)?))).collect();
    sorted.sort_by(f64::total_cmp);
    sorted.get(sorted.len() / 2).copied()
}

/// The displacement that is farthest from zero, with its sign.
fn largest(series: &Series, of: impl Fn(&Row) -> Option<Reading>) -> Option<f64> {
    series.rows.iter().filter_map(|row| Some(of(row)?.mm)).max_by(|a, b| a.abs().total_cmp(&b.abs()))
}

fn notes(camera: &Camera, clip: &Clip, run: Option<&Run>) -> Vec<String> {
    let mut notes = Vec::new();
    let (used_count, frame_count) = (clip.count(State::Used), clip.frames.len());
    if ((frame_count - used_count) as f64) > MANY_REJECTED * frame_count as f64 {
        notes.push(format!(
            "{used_count} of {frame_count} frames are used: see the states, and --overlay for pictures"
        ));
    }
    if camera.directions != "both" {
        notes.push(
            "the template has texture in one direction only: horizontal displacement is not identifiable and is not reported".to_owned(),
        );
    }
    if let Some(([x, y], score)) = clip.alike {
        notes.push(format!(
            "{x} pixels right and {y} below the template the frame looks the same (correlation {score:.2}): guide 2 may be confused with it \
             when it is lost; a larger --template is safer"
        ));
    }
    match &camera.mark {
        None => notes.push("no fixed mark (--mark): motion of the camera is in the displacement".to_owned()),
        Some(mark) if mark.largest_mm > MARK_MOVED_MM => notes.push(format!(
            "the mark moved by up to {:.3} mm (at the end {:.3} mm vertically, {:.3} mm horizontally): subtracted; a camera that turns is not \
             corrected by one mark",
            mark.largest_mm, mark.last_y_mm, mark.last_x_mm
        )),
        Some(_) => {}
    }
    if let Some(sd) = camera.mm_per_px_sd {
        notes.push(format!(
            "the scale is known to {:.2} % (sd, points of the ruler to half a pixel): all displacements are wrong by the same factor, and K by \
             more than that",
            100.0 * sd / camera.mm_per_px
        ));
    }
    if let Some(run) = run {
        if !run.start_given {
            notes.push(format!(
                "the first frame is taken as simultaneous with the first row of the force series, {:.3} s: --start-s states another time",
                run.start_s
            ));
        }
        if run.rows_without_displacement > 0 {
            notes.push(format!(
                "{} rows of the force series have no frame near them and are skipped",
                run.rows_without_displacement
            ));
        }
    }
    notes
}

impl FrameEntry {
    fn new(frame: &FrameResult, time_s: f64) -> Self {
        Self {
            state: frame.state.name(),
            time_s,
            shift_x_px: template_value(|found| found.shift_px[0], &frame.template),
            shift_y_px: template_value(|found| found.shift_px[1], &frame.template),
            sd_x_px: template_value(|found| found.covariance_px2[0][0].sqrt(), &frame.template),
            sd_y_px: template_value(|found| found.covariance_px2[1][1].sqrt(), &frame.template),
            score: template_value(|found| found.score, &frame.template),
            gain: template_value(|found| found.gain, &frame.template),
        }
    }
}

fn template_value(
    value: fn(&imaging::camera::Translation) -> f64,
    template: &Option<imaging::camera::Translation>,
) -> Option<f64> {
    template.as_ref().map(value)
}

impl Display for Imported {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let camera = &self.camera;
        let states: Vec<String> =
            camera.states.iter().map(|(state, count)| format!("{count} {state}")).collect();
        writeln!(
            f,
            "clip         {}: {} frames: {}",
            camera.path.display(),
            camera.frames,
            states.join(", ")
        )?;
        writeln!(
            f,
            "displacement largest y {:.4}{} mm, last y {:.4}{} mm, sd y {:.5}{} mm",
            camera.largest_y_mm,
            x_text(camera.largest_x_mm),
            camera.last_y_mm,
            x_text(camera.last_x_mm),
            camera.sd_y_mm,
            camera.sd_x_mm.map_or_else(String::new, |value| format!(" x {value:.5}"))
        )?;
        let sd = camera.mm_per_px_sd.map_or_else(String::new, |sd| format!(" (sd {sd:.6})"));
        writeln!(f, "scale        {:.6} mm per pixel{sd}", camera.mm_per_px)?;
        if let Some(lateral) = &self.lateral {
            writeln!(
                f,
                "lateral run  {}: {} rows, {:.1} mm deep, without shape",
                lateral.id, lateral.rows, lateral.depth_mm
            )?;
        }
        for note in &self.notes {
            writeln!(f, "note         {note}")?;
        }
        writeln!(f, "written      {}", self.session.join(format!("{}.camera.csv", camera.id)).display())?;
        writeln!(f, "session      {}", self.session.display())
    }
}

fn x_text(value: Option<f64>) -> String {
    value.map_or_else(String::new, |value| format!(" x {value:.4}"))
}
