//! Compares flash and RAM of each board's image with committed figures, so that growth is noticed.

use crate::images::{self, Board, Image};
use anyhow::{Context, Result, bail};
use object::{Object, ObjectSection, SectionFlags, elf};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::PathBuf;

/// Growth beyond the committed figures that is let pass, percent: compilers differ a little.
const TOLERANCE_PERCENT: u64 = 2;
const FLASH_BYTES: u64 = 1 << 20;
const RAM_BYTES: u64 = 96 << 10;
/// Largest size of the image, so that it fits smaller parts of the family.
const FLASH_LIMIT_BYTES: u64 = 128 << 10;
const RAM_LIMIT_BYTES: u64 = 32 << 10;

/// Options of `cargo xtask size`.
#[derive(Default, clap::Args)]
pub struct Args {
    /// Write the figures instead of comparing with them
    #[arg(long)]
    save: bool,
}

/// Size of an image.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Size {
    /// Code, constants and initial values of variables.
    pub flash_bytes: u64,
    /// Variables; what is left is stack.
    pub ram_bytes: u64,
}

impl Size {
    /// Adds up the sections of an ELF file.
    ///
    /// # Errors
    /// Where it is none.
    pub fn of(image: &[u8]) -> Result<Self> {
        let file = object::File::parse(image).context("the image is no ELF file")?;
        let mut size = Self { flash_bytes: 0, ram_bytes: 0 };
        for section in file.sections() {
            let SectionFlags::Elf { sh_flags, .. } = section.flags() else { continue };
            if sh_flags & u64::from(elf::SHF_ALLOC) == 0 {
                continue;
            }
            let writable = sh_flags & u64::from(elf::SHF_WRITE) != 0;
            let stored = section.file_range().is_some_and(|(_, length)| length > 0);
            if stored {
                size.flash_bytes += section.size();
            }
            if writable {
                size.ram_bytes += section.size();
            }
        }
        Ok(size)
    }
}

fn committed() -> PathBuf {
    images::root().join("tests").join("image-size.json")
}

/// Measures, prints and compares.
///
/// # Errors
/// Where an image has grown beyond the committed figures.
pub fn run(args: &Args) -> Result<()> {
    let sizes = Board::ALL
        .iter()
        .map(|&board| Ok((board.name().to_owned(), measure(board)?)))
        .collect::<Result<BTreeMap<_, _>>>()?;
    let path = committed();
    if args.save {
        std::fs::write(&path, serde_json::to_string_pretty(&sizes)? + "\n")?;
        println!("saved to {}", path.display());
        return Ok(());
    }
    let text = std::fs::read_to_string(&path).with_context(|| format!("cannot read {}", path.display()))?;
    let committed: BTreeMap<String, Size> =
        serde_json::from_str(&text).with_context(|| format!("{} holds no sizes", path.display()))?;
    for (board, size) in &sizes {
        let board_size = committed.get(board).with_context(|| {
            format!("{} has no figures of {board}; commit those of `cargo xtask size --save`", path.display())
        })?;
        compare(board, size, board_size)?;
    }
    Ok(())
}

/// Builds and measures the image of a board.
fn measure(board: Board) -> Result<Size> {
    let elf = images::build_for(board, Image::Flash)?;
    let size = Size::of(&std::fs::read(&elf)?)?;
    let Size { flash_bytes, ram_bytes } = size;
    println!(
        "{}: flash {flash_bytes} bytes ({:.1} % of 1 MiB), RAM {ram_bytes} bytes ({:.1} % of 96 KiB, the rest is stack)",
        board.name(),
        percent(flash_bytes, FLASH_BYTES),
        percent(ram_bytes, RAM_BYTES)
    );
    println!("{}", elf.strip_prefix(images::root()).unwrap_or(&elf).display());
    if flash_bytes > FLASH_LIMIT_BYTES || ram_bytes > RAM_LIMIT_BYTES {
        bail!(
            "the image of {} exceeds {FLASH_LIMIT_BYTES} bytes of flash or {RAM_LIMIT_BYTES} bytes of RAM",
            board.name()
        );
    }
    Ok(size)
}

fn percent(used: u64, all: u64) -> f64 {
    100.0 * used as f64 / all as f64
}

/// Compares with what was committed.
fn compare(board: &str, now: &Size, before: &Size) -> Result<()> {
    for (what, now, before) in
        [("flash", now.flash_bytes, before.flash_bytes), ("RAM", now.ram_bytes, before.ram_bytes)]
    {
        if now * 100 > before * (100 + TOLERANCE_PERCENT) {
            bail!(
                "{board}: {what} has grown from {before} to {now} bytes; if that is meant, commit the figures of `cargo xtask size --save`"
            );
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn growth_of_more_than_the_tolerance_is_an_error_for_flash_and_for_memory() {
        let committed = Size { flash_bytes: 100_000, ram_bytes: 20_000 };
        assert!(grown(102_000, 20_400, committed).is_ok());
        assert!(grown(102_001, 20_000, committed).unwrap_err().to_string().contains("flash has grown"));
        assert!(grown(90_000, 20_401, committed).unwrap_err().to_string().contains("RAM has grown"));
    }

    fn grown(flash_bytes: u64, ram_bytes: u64, committed: Size) -> Result<()> {
        compare("a board", &Size { flash_bytes, ram_bytes }, &committed)
    }
}
