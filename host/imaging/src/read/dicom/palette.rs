//! Palettes of DICOM images (PS3.3, C.7.6.3.1.5): samples are places in tables of red, green and blue.

use super::super::grey;
use super::{Attributes, PALETTE, PALETTE_SIZES};
use crate::error::ImagingError;

/// Brightness of every index of 8 bit, black where its colour is one.
pub(super) fn brightness(header: &Attributes) -> Result<Vec<u8>, ImagingError> {
    let mut channels: Vec<Vec<u8>> = Vec::new();
    for ((colour, sizes), tag) in ["Red", "Green", "Blue"].into_iter().zip(PALETTE_SIZES).zip(PALETTE) {
        let field = format!("{colour}PaletteColorLookupTable");
        let numbers: Vec<u16> = words(header, header.values.get(&sizes).map_or(&[], Vec::as_slice));
        let &[count, first, bits] = numbers.as_slice() else {
            return invalid(
                format!("{} numbers in its descriptor", numbers.len()),
                "count, first index, bits",
                &field,
                header.path,
            );
        };
        let count = if count == 0 { 1 << 16 } else { usize::from(count) };
        let bytes = header.values.get(&tag).map_or(&[][..], Vec::as_slice);
        let entries: Vec<u8> = match bits {
            16 => words(header, bytes).into_iter().map(|entry| (entry >> 8) as u8).collect(),
            // An entry of 8 bit may have a word of its own.
            8 if bytes.len() >= 2 * count => {
                words(header, bytes).into_iter().map(|entry| entry as u8).collect()
            }
            8 if header.is_big => words(header, bytes).into_iter().flat_map(u16::to_le_bytes).collect(),
            8 => bytes.to_vec(),
            _ => return invalid(format!("{bits} bits"), "8 or 16", &field, header.path),
        };
        if entries.len() < count {
            return invalid(
                format!("{} of {count} colours", entries.len()),
                "all of them, not in segments",
                &field,
                header.path,
            );
        }
        let last = count.saturating_sub(1);
        // Indices before the first colour have that one, and those behind the last one have the last.
        let places =
            (0..=usize::from(u8::MAX)).map(|index| index.saturating_sub(usize::from(first)).min(last));
        channels.push(places.map(|place| entries.get(place).copied().unwrap_or(0)).collect());
    }
    let pixels: Vec<u8> = (0..=usize::from(u8::MAX))
        .flat_map(|index| {
            [0, 1, 2].map(|channel: usize| {
                channels.get(channel).and_then(|entries| entries.get(index)).copied().unwrap_or(0)
            })
        })
        .collect();
    Ok(grey(pixels, 3))
}

fn invalid(
    problem: String,
    expected: &str,
    field: &str,
    path: &std::path::Path,
) -> Result<Vec<u8>, ImagingError> {
    Err(ImagingError::invalid(path, field, problem, expected))
}

/// Words of 16 bit in the order of the file.
fn words(header: &Attributes, bytes: &[u8]) -> Vec<u16> {
    let pairs = bytes.as_chunks::<2>().0.iter();
    pairs
        .map(|pair| if header.is_big { u16::from_be_bytes(*pair) } else { u16::from_le_bytes(*pair) })
        .collect()
}
