//! Image that is flashed: the image as probes read it and as plain bytes, the calibration that it starts with, and
//! instructions.

use anyhow::{Context, Result, ensure};
use control::calibration::Calibration;
use formats::calibration_file;
use object::Endianness;
use object::elf::PT_LOAD;
use object::read::elf::{ElfFile32, ProgramHeader};
use release::archive::{self, Entry};
use std::path::Path;

/// Start of the flash, and its length: STM32L47x with 1 MiB.
const FLASH: u64 = 0x0800_0000;
const FLASH_BYTES: u64 = 1 << 20;
/// Both memories that a stack can be in begin with these.
const MEMORIES: [u32; 2] = [0x2000_0000, 0x1000_0000];
/// Byte of erased flash.
const ERASED: u8 = 0xff;
const INSTRUCTIONS: &str = include_str!("../../texts/FLASHING.txt");
const CALIBRATION: &str = "calibration-nominal.toml";

/// The files of the archive.
///
/// # Errors
/// Where an image is none of a board, or something cannot be read or written.
pub fn entries(folder: &Path, version: &str) -> Result<Vec<Entry>> {
    let mut entries = Vec::new();
    for elf in archive::entries(folder)? {
        let board =
            elf.name.strip_suffix(".elf").with_context(|| format!("{}: expected an ELF file", elf.name))?;
        let bytes = flashed(&elf.content).with_context(|| format!("the image of {board}"))?;
        entries.push(entry(format!("{board}.bin"), bytes));
        entries.push(entry(format!("{board}.elf"), elf.content));
    }
    ensure!(!entries.is_empty(), "{}: no images", folder.display());
    let scratch = tempfile::tempdir().context("no folder for temporary files")?;
    let path = scratch.path().join(CALIBRATION);
    calibration_file::write(&path, &Calibration::nominal_record())?;
    entries.push(entry(CALIBRATION.to_owned(), std::fs::read(&path)?));
    entries.push(entry("FLASHING.txt".to_owned(), INSTRUCTIONS.replace("{version}", version).into_bytes()));
    entries.sort_by(|a, b| a.name.cmp(&b.name));
    Ok(entries)
}

fn entry(name: String, content: Vec<u8>) -> Entry {
    Entry { name, content, is_program: false }
}

/// Content of the flash from its first byte on.
fn flashed(elf: &[u8]) -> Result<Vec<u8>> {
    let file = ElfFile32::<Endianness>::parse(elf).context("no ELF file of a 32-bit processor")?;
    let order = file.endian();
    let mut bytes = Vec::new();
    for header in file.elf_program_headers() {
        if header.p_type(order) != PT_LOAD || header.p_filesz(order) == 0 {
            continue;
        }
        let content = header.data(order, elf).ok().context("a segment lies outside the file")?;
        let begin =
            u64::from(header.p_paddr(order)).checked_sub(FLASH).context("a segment before the flash")?;
        let end = begin + content.len() as u64;
        ensure!(end <= FLASH_BYTES, "a segment ends {} bytes behind the flash", end - FLASH_BYTES);
        let (begin, end) = (usize::try_from(begin)?, usize::try_from(end)?);
        if bytes.len() < end {
            bytes.resize(end, ERASED);
        }
        bytes.get_mut(begin..end).context("a segment")?.copy_from_slice(content);
    }
    // The processor reads its stack and its first instruction, in Thumb code, from there.
    let word = |begin: usize| {
        bytes.get(begin..begin + 4).and_then(|word| word.try_into().ok()).map(u32::from_le_bytes)
    };
    let (stack, reset) = (word(0).context("no vectors")?, word(4).context("no vectors")?);
    ensure!(MEMORIES.iter().any(|memory| stack >> 28 == memory >> 28), "the stack would be at {stack:#010x}");
    let in_flash = FLASH..FLASH + bytes.len() as u64;
    ensure!(reset & 1 == 1 && in_flash.contains(&u64::from(reset)), "it would start at {reset:#010x}");
    Ok(bytes)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// An ELF file for ARM with one segment at an address of the flash.
    fn elf(address: u32, content: &[u8]) -> Vec<u8> {
        const HEADERS: u32 = 52 + 32;
        let mut file = vec![0x7f, b'E', b'L', b'F', 1, 1, 1, 0, 0, 0, 0, 0, 0, 0, 0, 0];
        push_half(&mut file, 2);
        push_half(&mut file, 40);
        for number in [1, address, 52, 0, 0] {
            push_word(&mut file, number);
        }
        for number in [52, 32, 1, 40, 0, 0] {
            push_half(&mut file, number);
        }
        let length = u32::try_from(content.len()).unwrap();
        for number in [PT_LOAD, HEADERS, address, address, length, length, 5, 1] {
            push_word(&mut file, number);
        }
        file.extend(content);
        file
    }

    fn push_word(file: &mut Vec<u8>, number: u32) {
        file.extend(number.to_le_bytes())
    }

    fn push_half(file: &mut Vec<u8>, number: u16) {
        file.extend(number.to_le_bytes())
    }

    fn vectors(stack: u32, reset: u32) -> Vec<u8> {
        [stack.to_le_bytes(), reset.to_le_bytes(), [1, 2, 3, 4]].concat()
    }

    #[test]
    fn the_bytes_begin_with_the_flash() {
        let content = vectors(0x2001_8000, 0x0800_0009);
        assert_eq!(flashed(&elf(0x0800_0000, &content)).unwrap(), content);
    }

    #[test]
    fn what_a_board_could_not_start_is_refused() {
        let good = vectors(0x2001_8000, 0x0800_0009);
        for (file, part) in [
            (elf(0x0800_0000, &vectors(0x4000_0000, 0x0800_0009)), "the stack would be"),
            (elf(0x0800_0000, &vectors(0x2001_8000, 0x0800_0008)), "it would start"),
            (elf(0x0800_0000, &vectors(0x2001_8000, 0x2000_0001)), "it would start"),
            (elf(0x2000_0000, &good), "behind the flash"),
            (elf(0x0700_0000, &good), "before the flash"),
            (elf(0x0800_0100, &good), "the stack would be"),
            (b"nothing".to_vec(), "no ELF file"),
        ] {
            let error = format!("{:#}", flashed(&file).unwrap_err());
            assert!(error.contains(part), "{error}, expected {part}");
        }
    }

    #[test]
    fn the_archive_has_both_forms_the_calibration_and_instructions() {
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("a.elf"), elf(0x0800_0000, &vectors(0x2001_8000, 0x0800_0009)))
            .unwrap();
        let entries = entries(folder.path(), "1.2.3").unwrap();
        let names: Vec<&str> = entries.iter().map(|entry| entry.name.as_str()).collect();
        assert_eq!(names, ["FLASHING.txt", "a.bin", "a.elf", CALIBRATION]);
        assert!(text(0, &entries).contains("1.2.3") && !text(0, &entries).contains('{'));
        std::fs::write(folder.path().join(CALIBRATION), &entries[3].content).unwrap();
        let read = calibration_file::read(&folder.path().join(CALIBRATION)).unwrap();
        assert_eq!(read, Calibration::nominal_record());
    }

    fn text(number: usize, entries: &[Entry]) -> String {
        String::from_utf8(entries[number].content.clone()).unwrap()
    }
}
