//! `cargo xtask readme`: the outputs and pictures of README.md and of the manual, made by the commands that they show, or compared
//! with them.
//!
//! A comment before a block states where its text comes from; without one a block is left alone:
//!
//! * `<!-- readme: quick -->`: a console block. Its `$ guide ...` lines are run in the order of the pages, all in one folder.
//! * `<!-- readme: file NAME -->`: a file that this folder gets at that place.
//! * `<!-- readme: assumptions SECTION -->`: a section of the table of unknowns.
//! * `<!-- readme: rig PART -->`: what a rig in QEMU is needed for, see [`rig`].
//! * `<!-- readme: long COMMAND -->`: what takes minutes to hours, made only on request.
//! * `<!-- readme: excerpt -->`, `<!-- readme: excerpt PART -->`: lines of an output that stands in full elsewhere, see [`excerpt`].
//!
//! `<!-- readme: numbers within 0.5 % -->` states how far the decimal numbers of the blocks below it may be from what the commands print,
//! see [`tolerance`].
//!
//! With `fails` at its end (`<!-- readme: quick fails -->`) the commands have to fail, and the block shows what they print on standard
//! error too.
//!
//! Pictures that lie in [`PICTURES`] are those that the quick commands draw into `figures`.
//!
//! Not `trycmd`: it runs all blocks of a page inside `cargo test`, and has no groups, no files written on the page, no tables, no
//! pictures, and no text that comes from a demonstration which a test runs anyway.

mod assumptions;
pub mod book;
mod excerpt;
#[cfg(test)]
mod links;
pub mod page;
mod pictures;
#[cfg(test)]
mod priors;
pub mod rig;
pub mod same;
pub mod shell;
#[cfg(test)]
mod sources;
mod tolerance;

use crate::images;
use anyhow::{Context, Result, bail, ensure};
use book::Book;
use page::{Block, Made};
use shell::Shell;
use std::process::Stdio;

/// Folder of the pages' pictures, from the root.
pub const PICTURES: &str = "host/manual/src/pictures";

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
    /// `guide` on simulated data: seconds
    Quick,
    /// The group of blocks that need the firmware in QEMU: minutes
    Rig,
    /// Tables of studies and timing: up to hours
    Long,
}

/// Text for a block.
type Fresh<'a> = (&'a Block, String);

/// Regenerates the blocks, or compares them.
///
/// # Errors
/// Where a command fails, or with `--check` anything differs.
pub fn run(args: &Args) -> Result<()> {
    let root = images::root();
    let mut book = Book::read(root)?;
    let blocks = book.blocks()?;
    let folder = tempfile::tempdir()?;
    let mut fresh = Vec::new();
    let mut drawn = None;
    if is_selected(Group::Quick, &args.group) {
        fresh.extend(quick(&blocks, &Shell::new(images::build_guide()?, folder.path()))?);
        drawn = Some(folder.path().join("figures"));
    }
    if is_selected(Group::Rig, &args.group) {
        fresh.extend(rig::all(&blocks)?);
    }
    if is_selected(Group::Long, &args.group) {
        fresh.extend(long(&blocks, &args.only)?);
    }
    // A long output has the date of its last run, though it is the same.
    fresh.retain(|(block, text)| {
        matches!(block.made, Made::Long(_)) && !args.check || !same::same(block, text)
    });
    if args.check {
        let mut complaints: Vec<String> =
            fresh.iter().map(|(block, text)| same::difference(block, text)).collect();
        complaints.extend(drawn.iter().flat_map(|drawn| pictures::differing(&book, drawn)));
        complaints.extend(excerpt::complaints(&blocks));
        ensure!(complaints.is_empty(), "{}\n`cargo xtask readme` regenerates it", complaints.join("\n"));
        println!("README.md and the manual show what the commands print");
        return Ok(());
    }
    for (block, _) in &fresh {
        println!("regenerated: {}", block.place());
    }
    let fresh: Vec<(Block, String)> =
        fresh.into_iter().map(|(block, text)| (block.clone(), same::shown(&text))).collect();
    book.replace(root, fresh, &time::OffsetDateTime::now_utc().date().to_string())?;
    if let Some(drawn) = drawn {
        pictures::take(&book, &drawn)?;
    }
    let complaints = excerpt::complaints(&book.blocks()?);
    ensure!(complaints.is_empty(), "excerpts to be changed by hand:\n{}", complaints.join("\n"));
    Ok(())
}

fn is_selected(group: Group, args_group: &Option<Group>) -> bool {
    args_group.map_or(group != Group::Long, |only| only == group)
}

/// Compares the quick blocks and the pictures with what the commands print now.
///
/// # Errors
/// Where they differ or a command fails.
pub fn check_quick() -> Result<()> {
    run(&Args { check: true, group: Some(Group::Quick), only: String::new() })
}

/// Compares a part that needs the rig with what a run of it printed.
///
/// # Errors
/// Where they differ, or no page has such a part.
pub fn check_part(part: &str, printed: &str) -> Result<()> {
    parts(part)?.iter().try_for_each(|block| compare(block, printed))
}

/// Runs the console blocks of a part in the order of the pages and compares them.
///
/// # Errors
/// Where they differ, a command fails, or no page has such a part.
pub fn check_console(part: &str, shell: &Shell) -> Result<()> {
    write_files(&Book::read(images::root())?.blocks()?, shell)?;
    parts(part)?.iter().try_for_each(|block| compare(block, &shell.run(block)?))
}

fn compare(block: &Block, printed: &str) -> Result<()> {
    ensure!(same::same(block, printed), "{}", same::difference(block, printed));
    Ok(())
}

/// The blocks of a part that needs the rig.
fn parts(part: &str) -> Result<Vec<Block>> {
    let mut blocks = Book::read(images::root())?.blocks()?;
    blocks.retain(|block| block.made == Made::Rig(part.to_owned()));
    ensure!(!blocks.is_empty(), "no page has a block `<!-- readme: rig {part} -->`");
    Ok(blocks)
}

fn quick<'a>(blocks: &'a [Block], shell: &Shell) -> Result<Vec<Fresh<'a>>> {
    let mut fresh = Vec::new();
    std::fs::write(shell.folder().join("guide.html"), page_stub())?;
    for block in blocks {
        match &block.made {
            Made::File(_) => write_files(std::slice::from_ref(block), shell)?,
            Made::Quick => fresh.push((block, shell.run(block)?)),
            Made::Assumptions(section) => fresh.push((block, assumptions::table(section)?)),
            Made::Rig(_) | Made::Long(_) | Made::Excerpt(_) => {}
        }
    }
    Ok(fresh)
}

/// In place of the page for `guide web`: the whole one needs the compiler's target for WebAssembly.
pub fn page_stub() -> String {
    let version = env!("CARGO_PKG_VERSION");
    format!(
        "<!doctype html><meta http-equiv=\"Content-Security-Policy\" content=\"default-src 'none'; base-uri 'none'\">\
         <meta name=\"generator\" content=\"guide {version}\"><title>Needle guide</title>"
    )
}

/// Puts the files that stand on the pages into the folder of the commands.
fn write_files(blocks: &[Block], shell: &Shell) -> Result<()> {
    for block in blocks {
        if let Made::File(name) = &block.made {
            let path = shell.folder().join(name);
            path.parent().map_or(Ok(()), std::fs::create_dir_all)?;
            std::fs::write(path, block.text())?;
        }
    }
    Ok(())
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
        let printed = cargo(command).with_context(|| block.place())?;
        let text = if block.is_table() {
            printed.lines().skip_while(|line| !is_row(line)).take_while(is_row).collect::<Vec<_>>().join("\n")
        } else {
            format!("$ {command}\n{}", printed.trim_end())
        };
        fresh.push((block, text));
    }
    Ok(fresh)
}

fn is_row(line: &&str) -> bool {
    line.starts_with('|')
}

/// Output of a cargo command.
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_excerpt_is_a_part_of_an_output() {
        let blocks = Book::read(images::root()).unwrap().blocks().unwrap();
        let complaints = excerpt::complaints(&blocks);
        assert!(complaints.is_empty(), "{}", complaints.join("\n"));
    }
}
