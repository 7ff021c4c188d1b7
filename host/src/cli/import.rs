//! `guide import`: recordings of others into a session.

use super::frame_pictures::PictureArgs;
use super::import_camera::{self, CameraArgs};
use super::import_shapes::{self, ShapeArgs, Source};
use super::import_table::{self, TableArgs};
use super::import_ultrasound::{self, FrameArgs};
use super::output::Output;
use anyhow::{bail, ensure};
use formats::session::import::{Recording, Skipped};
use formats::session::{Noise, SessionWriter, Setup, import};
use inference::insertion::TipPath;
use mechanics::{Needle, Rig};
use serde::Serialize;
use std::fmt::{self, Display};
use std::fs;
use std::path::{Path, PathBuf};

/// Command lines for the help.
const EXAMPLES: &str = "Example:\n  guide import trajcontrol recordings/ --out phantom-b\n  guide import trajcontrol run_1.csv run_2.csv \
                        --rig rig.toml --out phantom-b\n  guide import slicer needle.mrk.json --axis 0,0,1 --origin-mm 12,-40,-85 --force push.csv \
                        --out phantom-b\n  guide import fbg hold-1.csv hold-2.csv --force push.csv --rig rig.toml --out phantom-b\n  guide import ultrasound hold.mha --straight zero.mha \
                        --speed-mm-per-s 1 --force push.csv --rig rig.toml --out phantom-b\n  guide import table load.csv stage.csv --map 'Force [g]=force_y_n:g' --map 'Stage X=displacement_y_mm:mm' \\\n    \
                        --depth-mm 30 --rig rig.toml --out phantom-b";

/// Convert recordings of other programs to a session
#[derive(clap::Args)]
#[command(
    after_long_help = what_is_read(),
    after_help = EXAMPLES
)]
pub struct Args {
    /// Layout of the recordings
    #[arg(value_enum)]
    kind: Kind,
    /// Recordings, or folders of them
    #[arg(required_unless_present = "run", value_name = "PATH")]
    paths: Vec<PathBuf>,
    /// Session folder to write, or to add to
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    /// Needle, guides and noise: a TOML file with `[needle]`, `[rig]`, `[noise]` as in a session (default: those of the session that is
    /// added to; for a new one an 18 gauge needle, guide 2 at 60 mm, tissue at 70 mm)
    #[arg(long, value_name = "FILE")]
    rig: Option<PathBuf>,
    /// Name of the session
    #[arg(long)]
    name: Option<String>,
    #[command(flatten)]
    pub shapes: ShapeArgs,
    #[command(flatten)]
    pub frames: FrameArgs,
    #[command(flatten)]
    tables: TableArgs,
    #[command(flatten)]
    clip: CameraArgs,
    #[command(flatten)]
    pictures: PictureArgs,
}

/// Examples, and what is read of frames and tables.
fn what_is_read() -> String {
    let (frames, tables) = (list(imaging::read::READ), list(formats::foreign::READ));
    format!("{EXAMPLES}\n\nFrames (ultrasound, camera):\n{frames}\nTables (table):\n{tables}")
}

fn list(rows: &[[&str; 2]]) -> String {
    rows.iter().map(|[names, what]| format!("  {names}: {what}\n")).collect()
}

#[derive(Debug, Clone, Copy, clap::ValueEnum)]
enum Kind {
    /// CSV of a needle under a laterally actuated guide with an electromagnetic tip sensor (columns `Tip x`, `Robot x`, ...)
    Trajcontrol,
    /// Curves drawn along the needle in 3D Slicer (`.mrk.json`): the shape of a lateral run, a sweep per file
    Slicer,
    /// Needle shapes of a shape-sensing fibre, a pose per line (x y z, with a quaternion or as a matrix): a sweep per file
    Fbg,
    /// Transverse ultrasound frames along the needle (`.mha`, `.mhd`, `.nrrd`, PNG or TIFF stacks): a sweep per file or folder
    Ultrasound,
    /// Any table of force and displacement, shape or insertion (CSV, Excel, MATLAB, ROS 2 bag): columns are named by --map, or found
    Table,
    /// Frames of a camera on guide 2 (AVI, `.mha`, PNG, TIFF or JPEG stacks): displacement of guide 2 of one run
    Camera,
}

/// Imported run.
#[derive(Serialize)]
struct Imported {
    schema: &'static str,
    session: PathBuf,
    insertions: Vec<One>,
    skipped: Vec<SkippedFile>,
}

#[derive(Serialize)]
struct One {
    id: String,
    rows: usize,
    deepest_mm: f64,
    guide2_moves: bool,
    tip_direction: bool,
    skipped: Vec<SkippedRows>,
    remarks: Vec<String>,
}

/// Rows of a recording that are no readings.
#[derive(Serialize)]
struct SkippedRows {
    #[serde(flatten)]
    rows: Skipped,
    meaning: String,
}

#[derive(Serialize)]
struct SkippedFile {
    path: PathBuf,
    reason: String,
}

impl Args {
    /// Refuses options of other kinds than the one that is imported.
    fn check_options(&self) -> anyhow::Result<()> {
        let (shapes, frames) = (import_shapes::is_requested(&self.shapes), self.frames.is_requested());
        let (clip, pictures) = (self.clip.is_requested(), self.pictures.is_requested());
        let kind = self.kind;
        let has_frames = matches!(kind, Kind::Ultrasound | Kind::Camera);
        ensure!(
            !shapes || !matches!(kind, Kind::Trajcontrol),
            "trajcontrol: has options that are for shapes, expected them with slicer, fbg, ultrasound or camera only"
        );
        ensure!(
            !frames || matches!(kind, Kind::Ultrasound),
            "{}: has options that are for frames, expected them with ultrasound only",
            kind.name()
        );
        ensure!(
            !self.tables.is_requested() || matches!(kind, Kind::Table),
            "{}: has options that are for tables, expected them with table only",
            kind.name()
        );
        ensure!(
            !import_shapes::is_for_points(&self.shapes) || !matches!(kind, Kind::Table),
            "table: has options that are for shapes, expected --map, --depth-mm and --id"
        );
        ensure!(
            !clip || matches!(kind, Kind::Camera),
            "{}: has options that are for clips, expected them with camera only",
            kind.name()
        );
        ensure!(
            !pictures || has_frames,
            "{}: has options for pictures, expected them with ultrasound or camera only",
            kind.name()
        );
        Ok(())
    }
}

impl Kind {
    /// As it is given.
    fn name(self) -> String {
        clap::ValueEnum::to_possible_value(&self).map(|value| value.get_name().to_owned()).unwrap_or_default()
    }
}

/// Runs the sub-command.
pub fn run(args: &Args, out: &mut Output) -> anyhow::Result<()> {
    args.check_options()?;
    match args.kind {
        Kind::Slicer => return shapes(Source::Slicer, args, out),
        Kind::Fbg => return shapes(Source::Fbg, args, out),
        Kind::Ultrasound => {
            let setup = setup(args, out)?;
            let Args { paths, shapes, frames, pictures, out: output_dir, .. } = args;
            return import_ultrasound::run(paths, shapes, frames, pictures, output_dir, &setup, out);
        }
        Kind::Camera => {
            let setup = setup(args, out)?;
            let Args { paths, shapes, clip, pictures, out: output_dir, .. } = args;
            return import_camera::run(paths, shapes, clip, pictures, output_dir, &setup, out);
        }
        Kind::Table => {
            let setup = setup(args, out)?;
            let Args { paths, shapes, tables, out: output_dir, rig, .. } = args;
            return import_table::run(paths, shapes, tables, output_dir, rig.as_deref(), &setup, out);
        }
        Kind::Trajcontrol => {}
    }
    let mut imported = Imported {
        schema: "guide.import/2",
        session: args.out.clone(),
        insertions: Vec::new(),
        skipped: Vec::new(),
    };
    let mut recordings: Vec<Recording> = Vec::new();
    for path in files(&args.paths, &mut imported.skipped) {
        match read(&path) {
            Ok(recording) => recordings.push(recording),
            Err(reason) => imported.skipped.push(SkippedFile { path, reason }),
        }
    }
    ensure!(!recordings.is_empty(), "no recording is an insertion: {}", reasons(&imported));
    let mut session = SessionWriter::open(&args.out, &setup(args, out)?)?;
    for recording in recordings {
        // One that cannot be written costs itself only.
        match session.insertion(&recording.run) {
            Ok(()) => imported.insertions.push(One::new(recording)),
            Err(why) => {
                imported.skipped.push(SkippedFile { path: recording.run.path, reason: why.to_string() });
            }
        }
    }
    if imported.insertions.is_empty() {
        session.undo();
        bail!("no recording can be written: {}", reasons(&imported));
    }
    out.result(&imported, Text(&imported))
}

fn reasons(imported: &Imported) -> String {
    imported.skipped.iter().map(|left| left.reason.clone()).collect::<Vec<_>>().join("; ")
}

/// A recording that is an insertion, or why it is none.
fn read(path: &Path) -> Result<Recording, String> {
    let recording = import::trajcontrol(path).map_err(|error| error.to_string())?;
    match TipPath::new(&recording.run) {
        Ok(_) => Ok(recording),
        Err(why) => {
            let skipped: String =
                recording.skipped.iter().map(|skipped| format!("; skipped {skipped}")).collect();
            Err(format!("{}: {why}{skipped}", path.display()))
        }
    }
}

impl One {
    fn new(Recording { run, skipped, remarks }: Recording) -> Self {
        Self {
            rows: run.depth_m.len(),
            deepest_mm: 1e3 * run.depth_m.iter().copied().fold(f64::NEG_INFINITY, f64::max),
            guide2_moves: moves(&run.guide2_x_m) || moves(&run.guide2_y_m),
            tip_direction: run.tip_direction_y_rad.is_some(),
            skipped: skipped
                .into_iter()
                .map(|rows| SkippedRows { meaning: rows.reason.to_string(), rows })
                .collect(),
            remarks,
            id: run.id,
        }
    }
}

fn moves(column: &Option<Vec<f64>>) -> bool {
    column.iter().flatten().any(|m| m.abs() > 1e-4)
}

/// Files as given, and the CSV files in folders, in order of their names.
fn files(paths: &[PathBuf], skipped: &mut Vec<SkippedFile>) -> Vec<PathBuf> {
    let mut files_found = Vec::new();
    for path in paths {
        if !path.is_dir() {
            files_found.push(path.clone());
            continue;
        }
        let mut entries_found: Vec<_> = match fs::read_dir(path) {
            Ok(entries) => {
                entries.filter_map(Result::ok).map(|entry| entry.path()).filter(|file| is_csv(file)).collect()
            }
            Err(cause) => {
                let reason = format!("{}: cannot read: {cause}", path.display());
                skipped.push(SkippedFile { path: path.clone(), reason });
                continue;
            }
        };
        if entries_found.is_empty() {
            let reason = format!("{}: no CSV files, expected recordings", path.display());
            skipped.push(SkippedFile { path: path.clone(), reason });
        }
        entries_found.sort();
        files_found.extend(entries_found);
    }
    files_found
}

fn is_csv(file: &Path) -> bool {
    let is_hidden = file.file_name().is_none_or(|name| name.to_string_lossy().starts_with('.'));
    !is_hidden && file.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("csv"))
}

/// Imports files of points as one lateral run.
fn shapes(source: Source, args: &Args, out: &mut Output) -> anyhow::Result<()> {
    let setup = setup(args, out)?;
    import_shapes::run(source, &args.paths, &args.shapes, &args.out, &setup, out)
}

/// Needle and rig: as stated, as in the session that is added to, or usual ones.
fn setup(args: &Args, out: &Output) -> anyhow::Result<Setup> {
    let session_file = args.out.join("session.toml");
    let file = args.rig.clone().or_else(|| session_file.exists().then_some(session_file));
    let mut setup = match &file {
        Some(path) => Setup::read(path)?,
        None => {
            out.note("needle and rig are assumed: 18 gauge, guide 2 at 60 mm, tissue at 70 mm (--rig states others)");
            Setup {
                name: String::new(),
                rig: Rig::two_guides(Needle::gauge_18(), 0.06, 0.07),
                fixture_mass_kg: None,
                noise: Noise::default(),
                tissue: Default::default(),
            }
        }
    };
    if let Some(name) = &args.name {
        setup.name = name.clone();
    } else if setup.name.is_empty() {
        setup.name = args.out.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
    }
    Ok(setup)
}

struct Text<'a>(&'a Imported);

impl Display for Text<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for One { id, rows, deepest_mm, guide2_moves, tip_direction, skipped, remarks } in &self.0.insertions
        {
            let moves = if *guide2_moves { ", guide 2 moves" } else { "" };
            let direction = if *tip_direction { ", tip direction" } else { "" };
            writeln!(f, "insertion    {id}: {rows} rows to {deepest_mm:.1} mm{moves}{direction}")?;
            for SkippedRows { rows, .. } in skipped {
                writeln!(f, "skipped      {id}: {rows}")?;
            }
            for remark in remarks {
                writeln!(f, "note         {id}: {remark}")?;
            }
        }
        for SkippedFile { reason, .. } in &self.0.skipped {
            writeln!(f, "skipped      {reason}")?;
        }
        writeln!(f, "session      {}", self.0.session.display())
    }
}
