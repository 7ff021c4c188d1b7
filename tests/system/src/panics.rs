//! Finds places at which the board's image can panic, and functions that can call themselves: both are read from the
//! linked image, so that nothing that the compiler has removed counts, and nothing that a library brings is overlooked.
//!
//! A panic names its place: `core::panic::Location`, four words among the constants (address and length of the file's name, line,
//! column). Direct calls and jumps of Thumb-2 code are decoded (Arm Architecture Reference Manual ARMv7-M, A7.7.12, A7.7.18); calls
//! through pointers are not: the executor's to its tasks, and formatting's to what it prints.

use anyhow::{Context, Result};
use object::{Object, ObjectSection, ObjectSymbol, SectionKind, SymbolKind};
use std::collections::{BTreeMap, BTreeSet};

/// Longest name of a source file, and most lines and columns of one.
const LIMITS: [u32; 3] = [300, 50_000, 400];

/// Number of places in which the image can panic, by source: a file of this project from its root, or a library by its name.
///
/// # Errors
/// Where the image is no ELF file.
pub fn sources(image: &[u8]) -> Result<BTreeMap<String, usize>> {
    let file = object::File::parse(image).context("the image is no ELF file")?;
    let mut constants = Vec::new();
    for section in file.sections() {
        if section.address() != 0 && section.kind() != SectionKind::UninitializedData {
            constants.push((section.address(), section.data()?));
        }
    }
    let text_at = |address: u32, length: u32| {
        let (start, data) = constants
            .iter()
            .find(|(start, data)| (*start..start + data.len() as u64).contains(&u64::from(address)))?;
        let byte_offset = (u64::from(address) - start) as usize;
        std::str::from_utf8(data.get(byte_offset..byte_offset + length as usize)?).ok()
    };
    let mut locations = BTreeSet::new();
    for (_, data) in &constants {
        let words: Vec<u32> =
            data.as_chunks::<4>().0.iter().map(|bytes| u32::from_le_bytes(*bytes)).collect();
        for location in words.windows(4) {
            let &[address, length, line, column] = location else { continue };
            let is_possible =
                [length, line, column].iter().zip(LIMITS).all(|(value, most)| (1..most).contains(value));
            // Newer compilers end the name with a zero, as C does.
            let name = is_possible.then(|| text_at(address, length)).flatten();
            if let Some(name) = name.map(|name| name.trim_end_matches('\0'))
                && name.ends_with(".rs")
            {
                locations.insert((name, line, column));
            }
        }
    }
    let mut functions = BTreeMap::new();
    for (name, ..) in locations {
        *functions.entry(source(name)).or_default() += 1;
    }
    Ok(functions)
}

/// A file of this project as it is; of a library its name without its version.
fn source(file: &str) -> String {
    if let Some((_, library_path)) = file.split_once("/library/") {
        return library_path.split('/').next().unwrap_or(library_path).to_owned();
    }
    let Some((_, registry_path)) = file.split_once("/registry/src/") else { return file.to_owned() };
    let package = registry_path.split('/').nth(1).unwrap_or(registry_path);
    package.rsplit_once('-').map_or(package, |(name, _)| name).to_owned()
}

/// Functions that can call themselves, through others or directly.
///
/// # Errors
/// Where the image is no ELF file.
pub fn recursive(image: &[u8]) -> Result<BTreeSet<String>> {
    let file = object::File::parse(image).context("the image is no ELF file")?;
    let mut functions = BTreeMap::new();
    for symbol in file.symbols().filter(|symbol| symbol.kind() == SymbolKind::Text && symbol.size() > 0) {
        // The lowest bit states the instruction set.
        let (start, size) = (symbol.address() & !1, symbol.size());
        let Some(section) = symbol.section_index() else { continue };
        let code = file.section_by_index(section)?.data_range(start, size)?.unwrap_or_default();
        let name = symbol.name()?.to_owned();
        functions.entry(start).or_insert((name, code));
    }
    let called: BTreeMap<u64, BTreeSet<u64>> = functions
        .iter()
        .map(|(start, (_, code))| {
            (
                *start,
                targets(*start, code)
                    .into_iter()
                    .filter(|target| *target == *start || owner(*target, &functions) != Some(*start))
                    .filter_map(|address| owner(address, &functions))
                    .collect(),
            )
        })
        .collect();
    Ok(functions
        .iter()
        .filter(|(start, _)| reaches_itself(start, &called))
        .map(|(_, (name, _))| name.clone())
        .collect())
}

fn reaches_itself(start: &u64, called: &BTreeMap<u64, BTreeSet<u64>>) -> bool {
    let (mut reached, mut pending) = (BTreeSet::new(), vec![*start]);
    while let Some(next) = pending.pop() {
        let unreached = called.get(&next).into_iter().flatten().filter(|target| reached.insert(**target));
        pending.extend(unreached.copied().collect::<Vec<_>>());
    }
    reached.contains(start)
}

fn owner(address: u64, functions: &BTreeMap<u64, (String, &[u8])>) -> Option<u64> {
    let (start, (_, code)) = functions.range(..=address).next_back()?;
    (address < start + code.len() as u64).then_some(*start)
}

/// Targets of a function's direct calls and unconditional jumps.
fn targets(start: u64, code: &[u8]) -> Vec<u64> {
    let halves: Vec<u32> =
        code.as_chunks::<2>().0.iter().map(|bytes| u16::from_le_bytes(*bytes).into()).collect();
    let mut branch_targets = Vec::new();
    let mut offset = 0;
    while let Some(&first) = halves.get(offset) {
        let next = start + 2 * offset as u64 + 4;
        let second = halves.get(offset + 1).copied().filter(|_| matches!(first >> 11, 0b11101..=0b11111));
        match second {
            // BL (T1) and B.W (T4).
            Some(second) if first & 0xF800 == 0xF000 && matches!(second & 0xD000, 0xD000 | 0x9000) => {
                let sign = first >> 10 & 1;
                let [i1, i2] = [second >> 13, second >> 11].map(|j| 1 ^ (j & 1) ^ sign);
                let bits = sign << 24 | i1 << 23 | i2 << 22 | (first & 0x3FF) << 12 | (second & 0x7FF) << 1;
                branch_targets.push(next.wrapping_add_signed(signed(bits, 25)));
            }
            Some(_) => {}
            // B (T2).
            None if first >> 11 == 0b11100 => {
                branch_targets.push(next.wrapping_add_signed(signed((first & 0x7FF) << 1, 12)));
            }
            None => {}
        }
        offset += if second.is_some() { 2 } else { 1 };
    }
    branch_targets
}

/// The number that so many bits are in two's complement.
fn signed(bits: u32, count: u32) -> i64 {
    i64::from((bits << (32 - count)).cast_signed() >> (32 - count))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sources_are_named_without_versions_and_places() {
        assert_eq!(source("/a/registry/src/index-1/embassy-stm32-0.6.0/src/flash/l.rs"), "embassy-stm32");
        assert_eq!(source("/rustc/59807616/library/core/src/num/f32.rs"), "core");
        assert_eq!(source("firmware/control/src/tare.rs"), "firmware/control/src/tare.rs");
    }

    #[test]
    fn calls_and_jumps_are_decoded() {
        // bl +8, nop, b.w -6 (from 0x0a), b -4 (itself).
        let code = [0x00, 0xF0, 0x04, 0xF8, 0x00, 0xBF, 0xFF, 0xF7, 0xFB, 0xBF, 0xFE, 0xE7];
        assert_eq!(targets(0x1000, &code), [0x100C, 0x1000, 0x100A]);
    }
}
