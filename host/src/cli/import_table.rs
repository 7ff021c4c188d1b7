//! `guide import table`: any laboratory's tables as a run, with a statement of what was taken for what.

mod echo;

use super::import_shapes::ShapeArgs;
use super::output::Output;
use anyhow::{Context, ensure};
use device::words::join;
use echo::{Imported, ImportedRun, TakenTable};
use formats::foreign::{
    Choice, ENDINGS, Mapping, Options, RawTable, TableError, Taken, ZOrigin, Zero, of_other_format, take,
};
use formats::session::import::id_of;
use formats::session::{SessionWriter, Setup};
use mechanics::Rig;
use std::fs;
use std::io::{self, BufRead, IsTerminal, Write as _};
use std::path::{Path, PathBuf};

/// Meaning of the columns of tables.
#[derive(clap::Args)]
#[command(next_help_heading = "Tables (table)")]
pub struct TableArgs {
    /// Quantity of a column, and its unit if the header does not state it: 'Force [g]=force_y_n:g'; a minus before the
    /// unit turns the direction round; `#3` is the third column. Quantities: time_s, displacement_y_mm, force_y_n,
    /// displacement_x_mm, force_x_n; z_mm, deflection_y_mm, deflection_x_mm of a shape; depth_mm, tip_y_mm, tip_x_mm,
    /// rotation_deg, guide2_y_mm, guide2_x_mm of an insertion (default: found by names and units)
    #[arg(long = "map", value_name = "COLUMN=QUANTITY[:UNIT]", value_parser = choice)]
    maps: Vec<Choice>,
    /// Columns as a file states them that --save-map has written, or another hand
    #[arg(long, value_name = "FILE", conflicts_with = "maps")]
    map_file: Option<PathBuf>,
    /// Write what the columns are, for further tables of this kind
    #[arg(long, value_name = "FILE")]
    save_map: Option<PathBuf>,
    /// From where positions along the needle are: guide 1, or the tissue's surface (entry_mm)
    #[arg(long, value_enum)]
    z_from: Option<ZFrom>,
    /// Column of times that all files share: their clocks are one (default: clocks of the day and since 1970 are one; others are brought
    /// together by the ramps of force and displacement)
    #[arg(long, value_name = "COLUMN", conflicts_with = "offset_s")]
    merge_on: Option<String>,
    /// To be added to the displacement's times for those of the force, where the files have clocks of their own
    #[arg(long, value_name = "SECONDS", allow_negative_numbers = true)]
    offset_s: Option<f64>,
    /// Bring the clocks of force and displacement together by their ramps, offset and drift, also where both are clocks of the day or since 1970
    #[arg(long, conflicts_with_all = ["merge_on", "offset_s"])]
    by_ramps: bool,
    /// Rows a second, where there is no column of times
    #[arg(long, value_name = "HZ", value_parser = rate)]
    rate_hz: Option<f64>,
    /// Zero of the displacement, of a shape with its sweep at rest, and of depth and tip of an insertion (auto: where the run begins, if the column
    /// is a position)
    #[arg(long, value_enum, default_value = "auto")]
    zero: ZeroArg,
    /// Every file is a run of its own (as the files of a folder are); otherwise all are parts of one
    #[arg(long)]
    each: bool,
    /// Do not ask whether the columns are right
    #[arg(long)]
    yes: bool,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum ZFrom {
    Guide1,
    Surface,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum ZeroArg {
    Auto,
    First,
    Written,
}

fn choice(text: &str) -> Result<Choice, String> {
    Choice::parse(text).map_err(|error| error.to_string())
}

fn rate(text: &str) -> Result<f64, String> {
    let hz = text.parse().ok().filter(|hz: &f64| (1e-3..=1e6).contains(hz));
    hz.ok_or_else(|| "expected rows a second from 0.001 to 1000000".to_owned())
}

impl TableArgs {
    /// Whether any of its options is given.
    pub fn is_requested(&self) -> bool {
        let Self { maps, map_file, save_map, z_from, merge_on, offset_s, by_ramps, rate_hz, zero, each, yes } =
            self;
        let files = map_file.is_some() || save_map.is_some();
        let clocks = merge_on.is_some() || offset_s.is_some() || *by_ramps || rate_hz.is_some();
        !maps.is_empty() || files || clocks || z_from.is_some() || *zero != ZeroArg::Auto || *each || *yes
    }

    fn mapping(&self) -> anyhow::Result<Mapping> {
        Ok(match &self.map_file {
            Some(path) => Mapping::read(path)?,
            None => Mapping { choices: self.maps.clone() },
        })
    }

    fn options(&self, rig: &Rig) -> Options {
        Options {
            rate_hz: self.rate_hz,
            merge_on: self.merge_on.clone(),
            offset_s: self.offset_s,
            by_ramps: self.by_ramps,
            zero: match self.zero {
                ZeroArg::Auto => Zero::Auto,
                ZeroArg::First => Zero::First,
                ZeroArg::Written => Zero::Written,
            },
            z_from: self.z_from.map(|from| match from {
                ZFrom::Guide1 => ZOrigin::Guide1,
                ZFrom::Surface => ZOrigin::Surface,
            }),
            entry_m: rig.entry_m,
            guide2_m: rig.guide2_m,
        }
    }
}

/// Imports tables as runs.
pub fn run(
    paths: &[PathBuf],
    shapes: &ShapeArgs,
    args: &TableArgs,
    to: &Path,
    rig: Option<&Path>,
    setup: &Setup,
    out: &mut Output,
) -> anyhow::Result<()> {
    let (mapping, options) = (args.mapping()?, args.options(&setup.rig));
    let groups = groups(paths, args.each)?;
    ensure!(
        groups.len() == 1 || shapes.id.is_none(),
        "--id: has no meaning for {} runs, expected it for one: their names are those of the files",
        groups.len()
    );
    let mut imported_runs: Vec<(ImportedRun, Taken)> = Vec::new();
    for group in &groups {
        let columns_used = taken(group, &mapping, &options)
            .map_err(|error| with_missing_depth(error, &mapping, shapes.depth_mm))?;
        let first = group.first().context("PATH: no file, expected one or more")?;
        let id = shapes.id.clone().unwrap_or_else(|| id_of(first));
        imported_runs
            .push((ImportedRun::new(id, &columns_used, shapes.depth_mm, setup.rig.entry_m)?, columns_used));
    }
    let chosen = imported_runs.first().map(|(_, taken)| taken.mapping.clone()).unwrap_or_default();
    let again = again(paths, shapes, args, &chosen, to, rig);
    for (run, _) in &imported_runs {
        out.note(format_args!("{}", TakenTable(run)));
    }
    out.note(format_args!("again: {again}"));
    if !args.yes {
        confirm()?;
    }
    if let Some(path) = &args.save_map {
        fs::write(path, chosen.to_toml()).with_context(|| format!("{}: cannot write", path.display()))?;
    }
    let mut session = SessionWriter::open(to, setup)?;
    for (run, taken) in &imported_runs {
        if let Err(error) = write(&mut session, run, taken) {
            session.undo();
            return Err(error);
        }
    }
    let runs = imported_runs.into_iter().map(|(run, _)| run).collect();
    let imported = Imported { schema: "guide.import/2", session: to.to_owned(), runs, again };
    out.result(&imported, &imported)
}

/// Files that are one run each: all together, or each by itself.
fn groups(paths: &[PathBuf], each: bool) -> anyhow::Result<Vec<Vec<PathBuf>>> {
    let (folders, files): (Vec<PathBuf>, Vec<PathBuf>) =
        paths.iter().cloned().partition(|path| path.is_dir());
    let mut groups: Vec<Vec<PathBuf>> = match (each, files.is_empty()) {
        (_, true) => Vec::new(),
        (true, false) => files.into_iter().map(|file| vec![file]).collect(),
        (false, false) => vec![files],
    };
    for folder in folders {
        let entries = fs::read_dir(&folder).with_context(|| format!("{}: cannot read", folder.display()))?;
        let mut files: Vec<PathBuf> = entries
            .filter_map(Result::ok)
            .map(|entry| entry.path())
            .filter(|path| !is_hidden(path))
            .collect();
        let other = files.iter().find_map(|path| of_other_format(path));
        files.retain(|path| {
            path.extension()
                .is_some_and(|ending| ENDINGS.iter().any(|known| ending.eq_ignore_ascii_case(known)))
        });
        if let Some(error) = other.filter(|_| files.is_empty()) {
            return Err(error.into());
        }
        ensure!(
            !files.is_empty(),
            "{}: no tables, expected files with one of the endings {}",
            folder.display(),
            ENDINGS.join(", ")
        );
        files.sort();
        groups.extend(files.into_iter().map(|file| vec![file]));
    }
    Ok(groups)
}

fn is_hidden(path: &Path) -> bool {
    path.file_name().is_none_or(|name| name.to_string_lossy().starts_with('.'))
}

fn taken(files: &[PathBuf], mapping: &Mapping, options: &Options) -> anyhow::Result<Taken> {
    let mut tables = Vec::new();
    for file in files {
        tables.extend(RawTable::read(file)?);
    }
    Ok(take(&tables, mapping, options)?)
}

/// Adds the depth to other things that are missing, so that all are named at once.
fn with_missing_depth(error: anyhow::Error, mapping: &Mapping, depth_mm: Option<f64>) -> anyhow::Error {
    let is_missing = error
        .downcast_ref::<TableError>()
        .is_some_and(|of| matches!(of, TableError::Map { .. } | TableError::Several(_)));
    let is_insertion = mapping.choices.iter().any(|choice| choice.target.name == "depth_mm");
    if is_missing && !is_insertion && depth_mm.is_none() {
        return anyhow::anyhow!("{error}; {MISSING_DEPTH}");
    }
    error
}

/// A lateral run without its depth.
const MISSING_DEPTH: &str = "--depth-mm: missing, expected the length of the needle in the tissue (0 in air)";

/// Writes a run into the session.
fn write(session: &mut SessionWriter, run: &ImportedRun, taken: &Taken) -> anyhow::Result<()> {
    match (&taken.force, &taken.insertion) {
        (Some(force), _) => {
            let depth_m = 1e-3 * run.depth_mm.unwrap_or(0.0);
            Ok(session.lateral_series(&run.id, depth_m, force, taken.shape.as_ref())?)
        }
        (None, Some(insertion)) => {
            let insertion = formats::session::InsertionRun { id: run.id.clone(), ..insertion.clone() };
            Ok(session.insertion(&insertion)?)
        }
        (None, None) => Ok(()),
    }
}

/// Asks on a terminal; in a script the answer is an option.
fn confirm() -> anyhow::Result<()> {
    ensure!(
        io::stdin().is_terminal() && io::stderr().is_terminal(),
        "nothing is written: this is no terminal on which you could confirm the columns, expected --yes"
    );
    let mut stderr = io::stderr();
    let _ = write!(stderr, "Is this right? [y/N] ");
    let _ = stderr.flush();
    let mut answer = String::new();
    io::stdin().lock().read_line(&mut answer).context("standard input: cannot read")?;
    let is_yes = ["y", "yes"].iter().any(|yes| answer.trim().eq_ignore_ascii_case(yes));
    ensure!(is_yes, "nothing is written: --map states other columns");
    Ok(())
}

/// The command line that takes the same columns without a question.
fn again(
    paths: &[PathBuf],
    shapes: &ShapeArgs,
    args: &TableArgs,
    mapping: &Mapping,
    to: &Path,
    rig: Option<&Path>,
) -> String {
    let mut words = vec!["guide".to_owned(), "import".to_owned(), "table".to_owned()];
    fn text(path: &Path) -> String {
        path.to_string_lossy().into_owned()
    }
    words.extend(paths.iter().map(|path| text(path)));
    mapping.choices.iter().for_each(|choice| words.extend(["--map".to_owned(), choice.text()]));
    let z_from = args.z_from.map(|from| if from == ZFrom::Guide1 { "guide1" } else { "surface" }.to_owned());
    push_option("--z-from", z_from, &mut words);
    push_option("--merge-on", args.merge_on.clone(), &mut words);
    push_option("--offset-s", args.offset_s.map(|s| s.to_string()), &mut words);
    words.extend(args.by_ramps.then(|| "--by-ramps".to_owned()));
    push_option("--rate-hz", args.rate_hz.map(|hz| hz.to_string()), &mut words);
    push_option(
        "--zero",
        match args.zero {
            ZeroArg::Auto => None,
            ZeroArg::First => Some("first".to_owned()),
            ZeroArg::Written => Some("written".to_owned()),
        },
        &mut words,
    );
    push_option("--depth-mm", shapes.depth_mm.map(|mm| mm.to_string()), &mut words);
    push_option("--id", shapes.id.clone(), &mut words);
    push_option("--rig", rig.map(text), &mut words);
    push_option("--out", Some(text(to)), &mut words);
    words.extend(args.each.then(|| "--each".to_owned()));
    words.push("--yes".to_owned());
    join(words.iter().map(String::as_str))
}

fn push_option(name: &str, value: Option<String>, words: &mut Vec<String>) {
    words.extend(value.into_iter().flat_map(|value| [name.to_owned(), value]));
}
