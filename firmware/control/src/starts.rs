//! Counts the starts of a chip in its flash, so that no token of one start is valid in another.
//!
//! Each start writes its number behind that of the previous start, in one of two flash pages; when a page is full, the other one
//! is erased. A number is stored with its complement, so that one which a power cut has damaged is recognized and skipped.
//! Wherever power fails, the largest number so far is in the page that is not being erased. A page holds 64 numbers and endures 10,000
//! erasures, so that the two pages count 1.28 million starts.
//!
//! The largest number counts as the latest, so that numbers must only grow. There are tokens for 2^20 starts
//! ([`crate::commands::first_token`]): start 2^20 has those of start 0 again, start 2^20 + 1 those of start 1, and so on.

/// Number of pages.
pub const PAGES: usize = 2;
/// Number of used bytes of a page.
pub const PAGE_BYTES: usize = 512;
/// Bytes of a number: the unit in which the flash is written.
const ENTRY_BYTES: usize = 8;
/// Byte of erased flash.
const ERASED: u8 = 0xFF;

/// The number of a start, and where it is written.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct NextStart {
    /// The number.
    pub count: u32,
    /// The page, 0 or 1.
    pub page: usize,
    /// Byte in the page.
    pub offset: usize,
    /// Whether the page has to be erased first.
    pub erases: bool,
}

/// Bytes of a number in a page.
pub fn to_stored(count: u32) -> [u8; ENTRY_BYTES] {
    let mut stored = [0; ENTRY_BYTES];
    for (kept, byte) in stored.iter_mut().zip(count.to_le_bytes().into_iter().chain((!count).to_le_bytes())) {
        *kept = byte;
    }
    stored
}

fn from_stored(stored: &[u8]) -> Option<u32> {
    let [a, b, c, d, e, f, g, h] = *stored.first_chunk()?;
    let (count, complement) = (u32::from_le_bytes([a, b, c, d]), u32::from_le_bytes([e, f, g, h]));
    (complement == !count).then_some(count)
}

/// The largest number in a page.
fn largest(page: &[u8; PAGE_BYTES]) -> Option<u32> {
    page.chunks_exact(ENTRY_BYTES).filter_map(from_stored).max()
}

/// The number of this start.
pub fn next(pages: &[[u8; PAGE_BYTES]; PAGES]) -> NextStart {
    let [first, second] = pages;
    // The flash is worn out long before the numbers reach their end.
    let count = largest(first).max(largest(second)).map_or(0, |count| count.saturating_add(1));
    let (page, bytes) = if largest(second) > largest(first) { (1, second) } else { (0, first) };
    // The number is written behind all used entries, including those that a power cut has damaged.
    let used_entries = bytes
        .chunks_exact(ENTRY_BYTES)
        .rposition(|entry| entry.iter().any(|byte| *byte != ERASED))
        .map_or(0, |last| last + 1);
    if used_entries < PAGE_BYTES / ENTRY_BYTES {
        return NextStart { count, page, offset: used_entries * ENTRY_BYTES, erases: false };
    }
    NextStart { count, page: 1 - page, offset: 0, erases: true }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::commands::first_token;

    type Pages = [[u8; PAGE_BYTES]; PAGES];

    /// Writes a number. `cut`: power fails in the erasure (0), which clears a part of the page, or in the write (1), which leaves a part
    /// of the entry.
    fn write(pages: &mut Pages, next: NextStart, cut: Option<usize>) {
        if next.erases {
            if cut == Some(0) {
                pages[next.page][..200].fill(ERASED);
                return;
            }
            pages[next.page].fill(ERASED);
        }
        let stored = to_stored(next.count);
        let whole = if cut == Some(1) { 3 } else { ENTRY_BYTES };
        pages[next.page][next.offset..next.offset + whole].copy_from_slice(&stored[..whole]);
    }

    #[test]
    fn every_start_has_the_next_number() {
        let mut pages = [[ERASED; PAGE_BYTES]; PAGES];
        for count in 0..1_000 {
            let next = next(&pages);
            assert_eq!(next.count, count);
            write(&mut pages, next, None);
        }
    }

    /// No number of an earlier completed start is repeated, wherever power fails at a start.
    #[test]
    fn no_number_is_repeated_after_a_power_cut() {
        let mut pages = [[ERASED; PAGE_BYTES]; PAGES];
        let mut greatest = None;
        for round in 0..2_000 {
            let next = next(&pages);
            assert!(Some(next.count) > greatest, "{} after {greatest:?}, round {round}", next.count);
            // Power fails in some starts, before the device has answered any host.
            match round % 7 {
                3 => write(&mut pages, next, Some(0)),
                5 => write(&mut pages, next, Some(1)),
                _ => {
                    write(&mut pages, next, None);
                    greatest = Some(next.count);
                }
            }
        }
    }

    #[test]
    fn pages_with_arbitrary_content_are_usable() {
        let mut pages = [[0x5A; PAGE_BYTES]; PAGES];
        let first = next(&pages);
        assert_eq!((first.count, first.offset, first.erases), (0, 0, true));
        write(&mut pages, first, None);
        assert_eq!(next(&pages).count, 1);
    }

    /// A start that had the number of another one would have its tokens, and an erasure at every start would wear the flash out.
    #[test]
    fn starts_after_the_last_block_of_tokens_differ_too_and_erase_no_more_often() {
        let last = (1 << 20) - 1;
        let mut pages = [[ERASED; PAGE_BYTES]; PAGES];
        write(&mut pages, NextStart { count: last, page: 0, offset: 0, erases: false }, None);
        let mut erasures = 0;
        for start in 1..=1_000 {
            let next = next(&pages);
            assert_eq!(next.count, last + start);
            assert_eq!(
                first_token(7, next.count),
                first_token(7, start - 1),
                "the tokens of 2^20 starts before"
            );
            erasures += u32::from(next.erases);
            write(&mut pages, next, None);
        }
        assert_eq!(erasures, 1_000 / (PAGE_BYTES / ENTRY_BYTES) as u32);
    }
}
