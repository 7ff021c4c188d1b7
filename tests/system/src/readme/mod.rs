//! `cargo xtask readme`: the outputs and pictures of README.md, made by the commands that it shows, or compared with them.
//!
//! A comment before a block says where its text comes from; without one a block is left alone:
//!
//! * `<!-- readme: quick -->`: a console block. Its `$ guide ...` lines are run in the order of the page, all in one folder.
//! * `<!-- readme: file NAME -->`: a file that this folder gets at that place.
//! * `<!-- readme: rig PART -->`: what a rig in QEMU is needed for, see [`rig`].
//! * `<!-- readme: long COMMAND -->`: what takes minutes to hours, made only when asked for.
//!
//! Pictures of the page that lie in [`PICTURES`] are those that the quick commands draw into `figures`.
//!
//! Not `trycmd`: it runs all blocks of a page inside `cargo test`, and knows no groups, no files written on the page, no tables, no
//! pictures, and no text that comes from a demonstration which a test runs anyway.

pub mod page;
mod pictures;
pub mod rig;
pub mod same;
pub mod shell;

use crate::images;
use anyhow::{Context, Result, bail};
use page::{Block, Made, Page};
use shell::Shell;
use std::path::PathBuf;
use std::process::Stdio;

/// Where the pictures of the page are, from the root.
pub const PICTURES: &str = "host/pictures";

/// Options of `cargo xtask readme`.
#[derive(clap::Args)]
pub struct Args {
    /// Compare only, and fail where anything differs
    #[arg(long)]
    check: bool,
    /// Only this group (default: quick and rig)
    #[arg(long, value_enum)]
    group: Option<Group>,
    /// Only blocks whose command holds this
    #[arg(long, default_value = "", value_name = "TEXT")]
    only: String,
}

/// Blocks that are made together.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub enum Group {
    /// `guide` on made-up data: seconds
    Quick,
    /// What needs the firmware in QEMU: minutes
    Rig,
    /// Tables of studies, stress, soak and timing: up to hours
    Long,
}

/// Text for a block of the page.
type Fresh<'a> = (&'a Block, String);

/// Makes the blocks anew, or compares them.
///
/// # Errors
/// Where a command fails, or with `--check` anything differs.
pub fn run(args: &Args) -> Result<()> {
    let mut page = Page::read(path())?;
    let blocks = page.blocks()?;
    let wants = |group| args.group.map_or(group != Group::Long, |only| only == group);
    let folder = tempfile::tempdir()?;
    let mut fresh = Vec::new();
    let mut drawn = None;
    if wants(Group::Quick) {
        fresh.extend(quick(&blocks, &Shell::new(images::build_guide()?, folder.path()))?);
        drawn = Some(folder.path().join("figures"));
    }
    if wants(Group::Rig) {
        let parts = rig::all(&blocks)?;
        for block in &blocks {
            if let Made::Rig(part) = &block.made {
                let text = parts.get(part).with_context(|| format!("{}: no part {part}", block.place()))?;
                fresh.push((block, text.clone()));
            }
        }
    }
    if wants(Group::Long) {
        fresh.extend(long(&blocks, &args.only)?);
    }
    // What takes long says when it was made last, though it is the same.
    fresh.retain(|(block, text)| {
        matches!(block.made, Made::Long(_)) && !args.check || !same::same(block, text)
    });
    if args.check {
        let mut complaints: Vec<String> = fresh.iter().map(|(block, text)| same::told(block, text)).collect();
        complaints.extend(drawn.iter().flat_map(|drawn| pictures::differing(&page, drawn)));
        if !complaints.is_empty() {
            bail!("{}\n`cargo xtask readme` makes it anew", complaints.join("\n"));
        }
        println!("README.md says what the commands say");
        return Ok(());
    }
    for (block, _) in &fresh {
        println!("made anew: {}", block.place());
    }
    let fresh: Vec<(Block, String)> =
        fresh.into_iter().map(|(block, text)| (block.clone(), same::shown(&text))).collect();
    page.replace(fresh, &time::OffsetDateTime::now_utc().date().to_string());
    if let Some(drawn) = drawn {
        pictures::take(&page, &drawn)?;
    }
    page.write(path())
}

/// Compares the quick blocks and the pictures with what the commands say now.
///
/// # Errors
/// Where they differ or a command fails.
pub fn check_quick() -> Result<()> {
    run(&Args { check: true, group: Some(Group::Quick), only: String::new() })
}

/// Compares a part that needs the rig with what a run of it said.
///
/// # Errors
/// Where they differ, or the page has no such part.
pub fn check_part(part: &str, said: &str) -> Result<()> {
    let block = part_of_page(part)?;
    if !same::same(&block, said) {
        bail!("{}", same::told(&block, said));
    }
    Ok(())
}

/// Runs the console block of a part and compares it.
///
/// # Errors
/// Where they differ, a command fails, or the page has no such part.
pub fn check_console(part: &str, shell: &Shell) -> Result<()> {
    check_part(part, &shell.run(&part_of_page(part)?)?)
}

fn part_of_page(part: &str) -> Result<Block> {
    let blocks = Page::read(path())?.blocks()?;
    let found = blocks.into_iter().find(|block| block.made == Made::Rig(part.to_owned()));
    found.with_context(|| format!("README.md has no block `<!-- readme: rig {part} -->`"))
}

/// The page.
pub fn path() -> PathBuf {
    images::root().join("README.md")
}

fn quick<'a>(blocks: &'a [Block], shell: &Shell) -> Result<Vec<Fresh<'a>>> {
    let mut fresh = Vec::new();
    for block in blocks {
        match &block.made {
            Made::File(name) => std::fs::write(shell.folder().join(name), block.text())?,
            Made::Quick => fresh.push((block, shell.run(block)?)),
            Made::Rig(_) | Made::Long(_) => {}
        }
    }
    Ok(fresh)
}

/// Runs the long commands one after the other. A table is the first one that its command prints.
fn long<'a>(blocks: &'a [Block], only: &str) -> Result<Vec<Fresh<'a>>> {
    let mut fresh = Vec::new();
    for block in blocks {
        let Made::Long(command) = &block.made else { continue };
        if !command.contains(only) {
            continue;
        }
        eprintln!("{}: {command}", block.place());
        let said = cargo(command).with_context(|| block.place())?;
        let text = if block.is_table() {
            let is_row = |line: &&str| line.starts_with('|');
            said.lines().skip_while(|line| !is_row(line)).take_while(is_row).collect::<Vec<_>>().join("\n")
        } else {
            format!("$ {command}\n{}", said.trim_end())
        };
        fresh.push((block, text));
    }
    Ok(fresh)
}

/// What a cargo command prints.
fn cargo(command: &str) -> Result<String> {
    let words = shlex::split(command).unwrap_or_default();
    let [program, arguments @ ..] = words.as_slice() else { bail!("no command") };
    if program != "cargo" {
        bail!("`{command}`: expected a command of cargo");
    }
    let output = images::cargo().args(arguments).stdin(Stdio::null()).stderr(Stdio::inherit()).output()?;
    if !output.status.success() {
        bail!("`{command}` failed");
    }
    Ok(String::from_utf8(output.stdout)?)
}
