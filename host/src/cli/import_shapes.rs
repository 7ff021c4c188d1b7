//! `guide import slicer` and `guide import fbg`: needle shapes as points in space, as a lateral run's shape.

mod times;

pub use times::{SweepTimes, last_hold_note, times_s};

use super::output::Output;
use anyhow::{Context, ensure};
use clap::ValueEnum;
use formats::session::import::{Axis, Frame, LengthUnit, NeedlePoints, Straight, id_of, poses, slicer};
use formats::session::{DEPTH_RANGE_MM, ForceSeries, SessionWriter, Setup, ShapeSeries};
use serde::Serialize;
use std::fmt::{self, Display};
use std::path::{Path, PathBuf};

/// Position of the needle, in the coordinates of the files.
#[derive(clap::Args)]
#[command(next_help_heading = "Shapes (slicer, fbg; the last four for ultrasound too)")]
pub struct ShapeArgs {
    /// A point of the straight needle, millimetres: right, anterior, superior for slicer, the file's own for fbg (default: the first
    /// point of the first file; 0,0,0 for fbg)
    #[arg(long, value_name = "X,Y,Z", value_parser = vector, allow_hyphen_values = true)]
    origin_mm: Option<[f64; 3]>,
    /// Position of that point along the needle from guide 1, millimetres (default: entry_mm, the tissue's surface)
    #[arg(long, value_name = "MM", value_parser = millimetres)]
    origin_z_mm: Option<f64>,
    /// Direction of the straight needle into the tissue (default: through the first 10 mm of the first file; 0,0,1 for fbg)
    #[arg(long, value_name = "X,Y,Z", value_parser = vector, allow_hyphen_values = true)]
    axis: Option<[f64; 3]>,
    /// Length of the first part of the first file to which the direction is fitted, millimetres, instead of --axis
    #[arg(long, value_name = "MM", value_parser = millimetres, conflicts_with = "axis")]
    straight_mm: Option<f64>,
    /// Direction that is up, the session's y (default: anterior, or superior where the needle goes that way; 0,1,0 for fbg)
    #[arg(long, value_name = "X,Y,Z", value_parser = vector, allow_hyphen_values = true)]
    up: Option<[f64; 3]>,
    /// Lengths in files of fbg (auto: as their header states, or as a needle of up to 2 m can be)
    #[arg(long, value_enum, default_value = "auto")]
    units: Units,
    /// Force series of the run: a CSV file as in a session
    #[arg(long, value_name = "FILE")]
    pub force: Option<PathBuf>,
    /// Length of the needle in the tissue, millimetres (default: to the deepest point of the shapes)
    #[arg(long, value_name = "MM", value_parser = millimetres)]
    pub depth_mm: Option<f64>,
    /// Name of the run (default: that of the first file)
    #[arg(long)]
    pub id: Option<String>,
    /// When each file was measured, on the clock of the force series (default: in its holds, one after the other)
    #[arg(long, value_name = "SECONDS", value_delimiter = ',', allow_hyphen_values = true)]
    time_s: Vec<f64>,
}

/// Lengths in a file.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Units {
    Auto,
    Mm,
    M,
}

/// Source of the points.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Source {
    /// Markups of 3D Slicer, in patient coordinates.
    Slicer,
    /// Poses of a shape-sensing fibre, in the frame of the needle's base.
    Fbg,
}

/// First part of a drawn needle that is taken as straight.
const STRAIGHT_M: f64 = 0.01;
/// Directions that may be up in a file: in a room with a lying patient, and in the frame of a needle.
const UP: [[f64; 3]; 2] = [[0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];

/// Result of the shapes.
#[derive(Serialize)]
pub struct Imported {
    schema: &'static str,
    session: PathBuf,
    lateral: Lateral,
    notes: Vec<String>,
}

#[derive(Serialize)]
struct Lateral {
    id: String,
    depth_mm: f64,
    sweeps: usize,
    points: usize,
    /// When the sweeps were measured; none where the shape belongs to the last hold.
    time_s: Option<Vec<f64>>,
    has_force: bool,
    origin_mm: [f64; 3],
    axis: [f64; 3],
    up: [f64; 3],
}

/// Whether an option is given that is for points in space.
pub fn is_placed(args: &ShapeArgs) -> bool {
    let vectors = [args.origin_mm, args.axis, args.up].iter().any(|given| given.is_some());
    let lengths = [args.origin_z_mm, args.straight_mm].iter().any(|given| given.is_some());
    vectors || lengths || args.units != Units::Auto
}

/// Whether an option is given that has no meaning for tables.
pub fn is_for_points(args: &ShapeArgs) -> bool {
    is_placed(args) || args.force.is_some() || !args.time_s.is_empty()
}

/// Whether any option is given that is for shapes alone.
pub fn is_requested(args: &ShapeArgs) -> bool {
    let ShapeArgs { force, depth_mm, id, time_s, .. } = args;
    is_placed(args) || depth_mm.is_some() || force.is_some() || id.is_some() || !time_s.is_empty()
}

/// Imports files of points as one lateral run.
pub fn run(
    source: Source,
    paths: &[PathBuf],
    args: &ShapeArgs,
    to: &Path,
    setup: &Setup,
    out: &mut Output,
) -> anyhow::Result<()> {
    let unit = match args.units {
        Units::Auto => None,
        Units::Mm => Some(LengthUnit::Millimetres),
        Units::M => Some(LengthUnit::Metres),
    };
    let needles: Vec<NeedlePoints> = paths
        .iter()
        .map(|path| match source {
            Source::Slicer => slicer(path),
            Source::Fbg => poses(path, unit),
        })
        .collect::<Result<_, _>>()?;
    let first = needles.first().context("PATH: no file, expected one or more")?;
    let entry_m = setup.rig.entry_m;
    let frame = Frame::new(&straight(source, args, entry_m), first)?;

    let mut notes: Vec<String> = needles.iter().flat_map(|needle| needle.notes.clone()).collect();
    if args.axis.is_none() && (source == Source::Slicer || args.straight_mm.is_some()) {
        notes.push(format!(
            "the straight needle is fitted to the first part of {}: where that is bent, give --axis and --origin-mm",
            first.path.display()
        ));
    }
    let mut shapes = Vec::new();
    for needle in &needles {
        let (shape, points_behind) = frame.shape(needle)?;
        if points_behind > 0 {
            notes.push(format!("{}: {points_behind} points behind guide 1: skipped", needle.path.display()));
        }
        shapes.push(shape);
    }
    let depth_m = args.depth_mm.map_or_else(|| deepest_m(&shapes) - entry_m, |mm| 1e-3 * mm);
    let [least_mm, most_mm] = DEPTH_RANGE_MM;
    ensure!(
        (least_mm..=most_mm).contains(&(1e3 * depth_m)),
        "{}: the needle is {:.1} mm in the tissue, expected {least_mm} to {most_mm} mm: do --origin-mm and --axis fit, or give --depth-mm",
        first.path.display(),
        1e3 * depth_m
    );
    let id = args.id.clone().unwrap_or_else(|| id_of(&first.path));
    let SweepTimes { times_s, note } = times_s(args, &id, depth_m, shapes.len())?;
    notes.extend(note);
    let shape = joined(&shapes, times_s.as_deref());
    notes.extend(doubts(source, args, &shape, setup.rig.guide2_m)?);
    let mut session = SessionWriter::open(to, setup)?;
    if let Err(error) = session.lateral_from(&id, depth_m, args.force.as_deref(), &shape) {
        session.undo();
        return Err(error.into());
    }
    if args.force.is_none() {
        let file = to.join(format!("{id}.force.csv"));
        notes.push(format!(
            "{}: has a header only: without a force series no modulus is identified",
            file.display()
        ));
    }
    let [origin_m, axis, up_axis] = frame.parts();
    let imported = Imported {
        schema: "guide.import/2",
        session: to.to_owned(),
        lateral: Lateral {
            id,
            depth_mm: 1e3 * depth_m,
            sweeps: shapes.len(),
            points: shape.z_m.len(),
            time_s: times_s,
            has_force: args.force.is_some(),
            origin_mm: origin_m.map(|m| 1e3 * m),
            axis,
            up: up_axis,
        },
        notes,
    };
    imported.notes.iter().for_each(|note| out.note(note));
    out.result(&imported, &imported)
}

/// Remark on a shape that cannot be the one of the needle: with the displacement, where it is known; without, one that is further from the
/// straight needle than it bends, of which nothing is stated.
fn doubts(
    source: Source,
    args: &ShapeArgs,
    shape: &ShapeSeries,
    guide2_m: f64,
) -> anyhow::Result<Option<String>> {
    let remedy = "(--origin-mm and --axis state where the straight needle is, --up what is up)";
    if let Some(path) = &args.force {
        let doubt = shape.doubt(&ForceSeries::read(path)?, guide2_m);
        return Ok(doubt.map(|doubt| format!("{}: {doubt} {remedy}", path.display())));
    }
    let distances = shape.y_m.iter().zip(shape.x_m.iter().flatten()).map(|(y_m, x_m)| y_m.hypot(*x_m));
    let [nearest_m, farthest_m] = distances
        .fold([f64::INFINITY, 0.0], |[nearest, farthest]: [f64; 2], m| [nearest.min(m), farthest.max(m)]);
    let is_far = nearest_m.is_finite() && nearest_m > farthest_m - nearest_m;
    Ok((is_far && source == Source::Fbg && args.origin_mm.is_none()).then(|| {
        format!(
            "the shape is {:.3} to {:.3} mm from the straight needle, further than it bends: are these coordinates of a tracker? {remedy}",
            1e3 * nearest_m,
            1e3 * farthest_m
        )
    }))
}

/// Straight needle by the user's statements, with usual values otherwise.
fn straight(source: Source, args: &ShapeArgs, entry_m: f64) -> Straight {
    let fitted = args.straight_mm.map(|mm| Axis::Fitted(1e-3 * mm));
    let usual = match source {
        Source::Slicer => Axis::Fitted(STRAIGHT_M),
        Source::Fbg => Axis::Given([0.0, 0.0, 1.0]),
    };
    let origin_m = args.origin_mm.map(|origin_mm| origin_mm.map(|mm| 1e-3 * mm));
    let usual_origin = (source == Source::Fbg).then_some([0.0; 3]);
    Straight {
        origin_m: origin_m.or(usual_origin),
        origin_z_m: args.origin_z_mm.map_or(entry_m, |mm| 1e-3 * mm),
        axis: args.axis.map(Axis::Given).or(fitted).unwrap_or(usual),
        // A stated direction is used as it is, along the needle or not.
        up: args.up.map_or(UP, |up| [up, up]),
    }
}

fn deepest_m(shapes: &[ShapeSeries]) -> f64 {
    shapes.iter().flat_map(|shape| &shape.z_m).copied().fold(f64::NEG_INFINITY, f64::max)
}

/// Several shapes as sweeps of one run.
pub fn joined(shapes: &[ShapeSeries], times_s: Option<&[f64]>) -> ShapeSeries {
    ShapeSeries {
        time_s: times_s.map(|times_s| -> Vec<f64> {
            let timed_shapes = shapes.iter().zip(times_s);
            timed_shapes.flat_map(|(shape, time_s)| std::iter::repeat_n(*time_s, shape.z_m.len())).collect()
        }),
        z_m: together(|shape| &shape.z_m, shapes),
        y_m: together(|shape| &shape.y_m, shapes),
        x_m: Some(together(|shape| shape.x_m.as_deref().unwrap_or_default(), shapes)),
        y_sd_m: both(shapes, |shape| &shape.y_sd_m),
        x_sd_m: both(shapes, |shape| &shape.x_sd_m),
        images: both(shapes, |shape| &shape.images),
        z_shared_sd_m: both(shapes, |shape| &shape.z_shared_sd_m),
        shared_m: [0, 1].map(|plane: usize| {
            [0, 1, 2].map(|error: usize| both(shapes, |shape| &shape.shared_m[plane][error]))
        }),
    }
}

fn together(column: fn(&ShapeSeries) -> &[f64], shapes: &[ShapeSeries]) -> Vec<f64> {
    shapes.iter().flat_map(|shape| column(shape).iter().copied()).collect()
}

/// An optional column of all sweeps; nothing where one has none.
fn both<T: Clone>(
    shapes: &[ShapeSeries],
    column: impl Fn(&ShapeSeries) -> &Option<Vec<T>>,
) -> Option<Vec<T>> {
    let columns: Option<Vec<&[T]>> = shapes.iter().map(|shape| column(shape).as_deref()).collect();
    columns.filter(|columns| !columns.is_empty()).map(|columns| columns.concat())
}

/// `1,0,-0.5`.
pub fn vector(text: &str) -> Result<[f64; 3], String> {
    let numbers: Result<Vec<f64>, _> = text.split(',').map(|number| number.trim().parse()).collect();
    let numbers = numbers.ok().filter(|numbers| numbers.iter().all(|number| number.is_finite()));
    numbers
        .and_then(|numbers| numbers.try_into().ok())
        .ok_or_else(|| "expected three numbers: X,Y,Z".to_owned())
}

pub fn millimetres(text: &str) -> Result<f64, String> {
    let number: Option<f64> = text.parse().ok();
    number.filter(|mm| (0.0..=2000.0).contains(mm)).ok_or_else(|| "expected 0 to 2000 mm".to_owned())
}

impl Display for Imported {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Lateral { id, depth_mm, sweeps, points, has_force, origin_mm, axis, up, .. } = &self.lateral;
        let plural = if *sweeps == 1 { "" } else { "s" };
        let force = if *has_force { "with force" } else { "without force" };
        writeln!(
            f,
            "lateral run  {id}: {sweeps} sweep{plural} of {points} points in all, {depth_mm:.1} mm deep, {force}"
        )?;
        writeln!(
            f,
            "frame        origin {} mm, axis {}, up {}",
            list(origin_mm, 2),
            list(axis, 4),
            list(up, 4)
        )?;
        writeln!(f, "session      {}", self.session.display())
    }
}

fn list(values: &[f64; 3], digits: usize) -> String {
    values.map(|value| format!("{value:.digits$}")).join(",")
}
