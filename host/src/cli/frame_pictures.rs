//! Pictures of the frames that were imported: one by one (`--overlay`), and together (`--plots`, the session and its report).

use super::output::{Output, figures_file};
use anyhow::Context;
use imaging::frame::Frame;
use imaging::overlay::Picture;
use imaging::read::Sequence;
use imaging::sheet::{Sheet, choose};
use std::fs;
use std::path::{Path, PathBuf};

/// Folder of pictures.
#[derive(clap::Args)]
#[command(next_help_heading = "Pictures (ultrasound, camera)")]
pub struct PictureArgs {
    /// Folder for pictures of all frames with what was found in them
    #[arg(long, value_name = "DIR")]
    pub overlay: Option<PathBuf>,
    /// Folder for figures: a contact sheet of the frames with their states, and what was measured
    #[arg(long, value_name = "DIR")]
    pub plots: Option<PathBuf>,
}

impl PictureArgs {
    /// Whether any of its options is given.
    pub fn is_requested(&self) -> bool {
        self.overlay.is_some() || self.plots.is_some()
    }
}

/// Result of a frame, for its picture.
pub struct Shown {
    /// Number of its state.
    pub kind: usize,
    /// Name of its state.
    pub state: &'static str,
    /// Whether it is used.
    pub is_used: bool,
    /// Its place in words.
    pub place: String,
}

/// Opens one file or folder, or several files as one sequence.
pub fn open(files: &[PathBuf]) -> anyhow::Result<Sequence> {
    Ok(match files {
        [one] => Sequence::open(one)?,
        many => Sequence::open_stack(many)?,
    })
}

/// Image files that are given one by one are one sequence; everything else is one of its own.
pub fn sequences(paths: &[PathBuf]) -> Vec<Vec<PathBuf>> {
    if paths.len() > 1
        && paths.iter().all(|path| path.extension().is_some_and(|e| e.eq_ignore_ascii_case("png")))
    {
        return vec![paths.to_vec()];
    }
    paths.iter().map(|path| vec![path.clone()]).collect()
}

/// Draws what is requested of a sequence named `name`; returns the contact sheet without its text, as PNG.
pub fn draw(
    args: &PictureArgs,
    name: &str,
    files: &[PathBuf],
    frames: &[Shown],
    mut picture: impl FnMut(usize, Frame) -> Picture,
    out: &Output,
) -> anyhow::Result<Option<Vec<u8>>> {
    if !args.is_requested() {
        return Ok(None);
    }
    if let Some(folder) = &args.overlay {
        fs::create_dir_all(folder).with_context(|| format!("{}: cannot create", folder.display()))?;
    }
    let kinds: Vec<usize> = frames.iter().map(|frame| frame.kind).collect();
    let chosen = choose(&kinds);
    let mut sequence = open(files)?;
    let mut sheet = Sheet::default();
    let progress = out.progress();
    for (number, shown) in frames.iter().enumerate() {
        let Some(frame) = sequence.next_frame()? else { break };
        let is_chosen = chosen.binary_search(&number).is_ok();
        if args.overlay.is_none() && !is_chosen {
            continue;
        }
        progress.set_message(format!("{name}: picture of frame {} of {}", number + 1, frames.len()));
        let drawn = picture(number, frame);
        if let Some(folder) = &args.overlay {
            drawn.write(&folder.join(format!("{name}-{number:05}-{}.png", shown.state)))?;
        }
        if is_chosen {
            let lines = [format!("{} {}", number + 1, shown.state.replace('_', " ")), shown.place.clone()];
            sheet.add(&drawn, shown.is_used, lines);
        }
    }
    progress.finish_and_clear();
    if let Some(folder) = &args.overlay {
        out.note(format_args!("{} pictures in {}", frames.len(), folder.display()));
    }
    if let Some(folder) = out.figures_folder(args.plots.as_deref()) {
        let used_count = frames.iter().filter(|frame| frame.is_used).count();
        let title =
            format!("{name}: {used_count} of {} frames are used; {} are shown", frames.len(), sheet.len());
        figures_file(folder, &format!("{name}.frames"), &sheet.svg(&title)?, out)?;
    }
    Ok(Some(sheet.picture().png()?))
}

/// Keeps a contact sheet beside the run, where the report finds it.
pub fn keep(session: &Path, id: &str, sheet: Option<&[u8]>) -> anyhow::Result<()> {
    let Some(sheet) = sheet else { return Ok(()) };
    let path = session.join(format!("{id}.frames.png"));
    formats::files::replace(&path, sheet).with_context(|| format!("{}: cannot write", path.display()))
}
