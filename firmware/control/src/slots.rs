//! Non-volatile storage of a calibration, in one of two slots, each with a flash page of its own.
//!
//! A new record goes into the slot that is not in use, with the next sequence number; the device uses the newest valid record.
//! Wherever power fails during a write, one slot is unchanged. A slot with content that is neither valid nor erased means that a
//! calibration was lost. That holds beside a valid slot too, because the damaged one may have been the newer one.
//!
//! | bytes | what |
//! |---|---|
//! | 0 to 2 | `ca2` |
//! | 3 | length of the record |
//! | 4 to 7 | CRC-32 of all that follows, up to the record's end |
//! | 8 to 11 | sequence number, from 1 |
//! | from 12 | the record |
//!
//! A slot that begins with `cal` has the previous format, without a sequence number, and counts as the oldest.

#![cfg_attr(
    not(test),
    deny(clippy::indexing_slicing, clippy::unwrap_used, clippy::expect_used, clippy::panic)
)]

use crate::Origin;
use crate::calibration::Calibration;
use protocol::{CalibrationRecord, MAX_CALIBRATION, calibration_crc};

/// Number of slots.
pub const SLOTS: usize = 2;
/// Bytes of a slot, filled up to whole units of the flash.
pub const STORED_BYTES: usize = (HEAD_BYTES + SEQUENCE_BYTES + MAX_CALIBRATION).next_multiple_of(8);
/// Byte of erased flash.
pub const ERASED: u8 = 0xFF;
const HEAD_BYTES: usize = 8;
const SEQUENCE_BYTES: usize = 4;
const MARK: [u8; 3] = *b"ca2";
/// The mark of the previous format.
const OLD_MARK: [u8; 3] = *b"cal";

/// Bytes of a slot with this record.
pub fn to_stored(record: &CalibrationRecord, sequence: u32) -> [u8; STORED_BYTES] {
    let mut buffer = [0; MAX_CALIBRATION];
    let bytes = record.encode(&mut buffer);
    let mut stored = [ERASED; STORED_BYTES];
    let (head, body) = stored.split_at_mut(HEAD_BYTES);
    for (kept, byte) in body.iter_mut().zip(sequence.to_le_bytes().iter().chain(bytes)) {
        *kept = *byte;
    }
    let crc = calibration_crc(body.get(..SEQUENCE_BYTES + bytes.len()).unwrap_or_default());
    let ([a, b, c], [d, e, f, g]) = (MARK, crc.to_le_bytes());
    head.copy_from_slice(&[a, b, c, bytes.len() as u8, d, e, f, g]);
    stored
}

/// The record of a slot and its sequence number; `None` where the slot is empty or damaged.
pub fn from_stored(stored: &[u8; STORED_BYTES]) -> Option<(CalibrationRecord, u32)> {
    let (&[a, b, c, length, d, e, f, g], body) = stored.split_first_chunk::<HEAD_BYTES>()?;
    let crc = u32::from_le_bytes([d, e, f, g]);
    let numbered = match [a, b, c] {
        MARK => true,
        OLD_MARK => false,
        _ => return None,
    };
    let covered = body.get(..usize::from(length) + if numbered { SEQUENCE_BYTES } else { 0 })?;
    if calibration_crc(covered) != crc {
        return None;
    }
    if !numbered {
        return Some((CalibrationRecord::decode(covered)?, 0));
    }
    let (sequence, record) = covered.split_first_chunk::<SEQUENCE_BYTES>()?;
    Some((CalibrationRecord::decode(record)?, u32::from_le_bytes(*sequence)))
}

/// Calibration that the device uses, and the slot of the next one.
#[derive(Debug, Clone)]
pub struct SlotChoice {
    /// The calibration.
    pub calibration: Calibration,
    /// Source of the record.
    pub origin: Origin,
    /// Slot and sequence number for the next record.
    pub next: NextSlot,
}

/// Slot and content of a record that is to be written.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct NextSlot {
    /// The slot.
    pub slot: usize,
    /// The sequence number.
    pub sequence: u32,
}

fn is_erased(stored: &[u8; STORED_BYTES]) -> bool {
    stored.iter().all(|byte| *byte == ERASED)
}

/// Sequence number and calibration of a slot, if both are valid.
fn read(stored: &[u8; STORED_BYTES]) -> Option<(u32, Calibration)> {
    let (record, sequence) = from_stored(stored)?;
    Some((sequence, Calibration::new(record).ok()?))
}

/// Chooses the newest valid calibration; without one, that of the rig as designed.
pub fn choose(slots: &[[u8; STORED_BYTES]; SLOTS]) -> SlotChoice {
    let valid = slots.iter().enumerate().filter_map(|(slot, stored)| {
        let (sequence, calibration) = read(stored)?;
        Some((slot, sequence, calibration))
    });
    if let Some((slot, sequence, calibration)) = valid.max_by_key(|(_, sequence, _)| *sequence) {
        let next = NextSlot { slot: (slot + 1) % SLOTS, sequence: sequence.saturating_add(1) };
        let is_intact = slots.iter().all(|stored| is_erased(stored) || read(stored).is_some());
        let origin = if is_intact { Origin::Stored } else { Origin::Earlier };
        return SlotChoice { calibration, origin, next };
    }
    let damaged = slots.iter().position(|stored| !is_erased(stored));
    let origin = if damaged.is_none() { Origin::Nominal } else { Origin::Lost };
    // The next record replaces the damaged one, because a damaged record beside it would count as a loss.
    let next = NextSlot { slot: damaged.unwrap_or(0), sequence: 1 };
    SlotChoice { calibration: Calibration::default(), origin, next }
}

/// The slots where they are kept.
pub trait StoredSlots {
    /// Contents of the slots.
    fn contents(&mut self) -> [[u8; STORED_BYTES]; SLOTS];
    /// Replaces the content of a slot, which may fail.
    fn replace(&mut self, slot: usize, stored: &[u8; STORED_BYTES]);
}

/// Stores a record, and chooses the calibration from then on. Where both slots were damaged, the record replaces both, one after
/// the other, because a damaged one beside it would still count as a loss. No slot is replaced that is valid and in use.
pub fn store(slots: &mut impl StoredSlots, record: &CalibrationRecord) -> SlotChoice {
    let mut choice = choose(&slots.contents());
    for _ in 0..SLOTS {
        slots.replace(choice.next.slot, &to_stored(record, choice.next.sequence));
        choice = choose(&slots.contents());
        if choice.origin != Origin::Earlier {
            break;
        }
    }
    choice
}

#[cfg(test)]
mod tests {
    use super::*;
    use protocol::Text;
    use std::vec::Vec;

    fn named(id: &str) -> CalibrationRecord {
        CalibrationRecord { id: Text::new(id), ..Calibration::nominal_record() }
    }

    fn id(slots: &[[u8; STORED_BYTES]; SLOTS]) -> (std::string::String, Origin) {
        let choice = choose(slots);
        (choice.calibration.record().id.as_str().into(), choice.origin)
    }

    #[test]
    fn a_record_stored_after_a_loss_replaces_what_was_lost() {
        let mut lost = to_stored(&named("unit-7"), 3);
        lost[60] ^= 4;
        for slot in 0..SLOTS {
            let mut slots = [[ERASED; STORED_BYTES]; SLOTS];
            slots[slot] = lost;
            let next = choose(&slots).next;
            slots[next.slot] = to_stored(&named("unit-8"), next.sequence);
            assert_eq!(id(&slots), ("unit-8".into(), Origin::Stored), "slot {slot}");
        }
    }

    /// Slots in memory, of which some cannot be written.
    struct InMemory {
        slots: [[u8; STORED_BYTES]; SLOTS],
        fails: [bool; SLOTS],
    }

    impl StoredSlots for InMemory {
        fn contents(&mut self) -> [[u8; STORED_BYTES]; SLOTS] {
            self.slots
        }

        fn replace(&mut self, slot: usize, stored: &[u8; STORED_BYTES]) {
            self.slots[slot] = if self.fails[slot] { [0x5A; STORED_BYTES] } else { *stored };
        }
    }

    #[test]
    fn a_record_stored_after_the_loss_of_both_slots_ends_the_loss() {
        let (damaged, erased) = ([0x5A; STORED_BYTES], [ERASED; STORED_BYTES]);
        let valid = to_stored(&named("unit-7"), 3);
        for slots in [
            [damaged; 2],
            [damaged, erased],
            [erased, damaged],
            [damaged, valid],
            [valid, damaged],
            [erased; 2],
        ] {
            let mut stored = InMemory { slots, fails: [false; SLOTS] };
            let choice = store(&mut stored, &named("unit-8"));
            assert_eq!((choice.calibration.record().id.as_str(), choice.origin), ("unit-8", Origin::Stored));
            assert_eq!(id(&stored.slots), ("unit-8".into(), Origin::Stored));
        }
        // A slot that cannot be written any more takes no valid one with it.
        let mut stored = InMemory { slots: [valid, erased], fails: [false, true] };
        let choice = store(&mut stored, &named("unit-8"));
        assert_eq!((choice.calibration.record().id.as_str(), choice.origin), ("unit-7", Origin::Earlier));
    }

    #[test]
    fn a_stored_record_is_read_back_and_a_damaged_one_is_not() {
        let record = named("unit-7");
        let stored = to_stored(&record, 77);
        assert_eq!(from_stored(&stored), Some((record.clone(), 77)));
        assert_eq!(from_stored(&[ERASED; STORED_BYTES]), None);
        let length = record.encode(&mut [0; MAX_CALIBRATION]).len();
        for byte in 0..HEAD_BYTES + SEQUENCE_BYTES + length {
            for bit in 0..8 {
                let mut damaged = stored;
                damaged[byte] ^= 1 << bit;
                assert_eq!(from_stored(&damaged), None, "bit {bit} of byte {byte}");
            }
        }
    }

    /// A record of the previous version, in its only page, which is the second slot.
    #[test]
    fn the_previous_format_is_read_and_is_the_older_one() {
        let mut buffer = [0; MAX_CALIBRATION];
        let record = named("unit-6");
        let bytes = record.encode(&mut buffer);
        let mut old = [ERASED; STORED_BYTES];
        old[..4].copy_from_slice(&[b'c', b'a', b'l', bytes.len() as u8]);
        old[4..8].copy_from_slice(&calibration_crc(bytes).to_le_bytes());
        old[8..8 + bytes.len()].copy_from_slice(bytes);
        let erased = [ERASED; STORED_BYTES];
        let choice = choose(&[erased, old]);
        assert_eq!((choice.origin, choice.next), (Origin::Stored, NextSlot { slot: 0, sequence: 1 }));
        assert_eq!(id(&[erased, old]).0, "unit-6");
        assert_eq!(id(&[to_stored(&named("unit-7"), 1), old]).0, "unit-7");
    }

    #[test]
    fn erased_slots_give_the_nominal_calibration_and_any_other_content_is_a_loss() {
        let erased = [ERASED; STORED_BYTES];
        assert_eq!(id(&[erased, erased]), ("nominal".into(), Origin::Nominal));
        let mut damaged = to_stored(&named("unit-7"), 1);
        damaged[40] ^= 1;
        assert_eq!(id(&[damaged, erased]), ("nominal".into(), Origin::Lost));
        // Constants that no rig has, which an earlier firmware accepted.
        let mut implausible = named("unit-7");
        implausible.force_pn_per_code = [[931, 0], [0, 931]];
        assert_eq!(id(&[erased, to_stored(&implausible, 1)]), ("nominal".into(), Origin::Lost));
        let earlier = [to_stored(&named("unit-5"), 1), to_stored(&implausible, 2)];
        assert_eq!(id(&earlier), ("unit-5".into(), Origin::Earlier));
    }

    #[test]
    fn a_damaged_bit_of_the_newest_calibration_is_reported() {
        let slots = [to_stored(&named("unit-5"), 1), to_stored(&named("unit-7"), 2)];
        assert_eq!(id(&slots), ("unit-7".into(), Origin::Stored));
        for byte in 0..STORED_BYTES {
            let mut damaged = slots;
            damaged[1][byte] ^= 4;
            let (loaded_id, origin) = id(&damaged);
            // Bytes beyond the record have no meaning.
            let expected = if loaded_id == "unit-7" { Origin::Stored } else { Origin::Earlier };
            assert_eq!(origin, expected, "byte {byte}: {loaded_id}");
        }
    }

    /// Power fails before, after and in the middle of every erase and write, which leaves a page that is erased in part, or a double
    /// word of arbitrary content.
    #[test]
    fn wherever_power_fails_the_old_or_the_new_calibration_is_there() {
        let mut slots = [[ERASED; STORED_BYTES]; SLOTS];
        let mut old = named("unit-0");
        slots[0] = to_stored(&old, 1);
        for round in 1..=3 {
            let new = named(&std::format!("unit-{round}"));
            let next = choose(&slots).next;
            let target = to_stored(&new, next.sequence);
            let mut states = Vec::new();
            let old_slot = slots[next.slot];
            let mut page = old_slot;
            for cut in [8, 64, 100, STORED_BYTES] {
                // Erasing may begin with any part of the page.
                let (mut head, mut tail) = (old_slot, old_slot);
                head[..cut].fill(ERASED);
                tail[STORED_BYTES - cut..].fill(ERASED);
                states.extend([head, tail]);
            }
            page.fill(ERASED);
            states.push(page);
            for (at, word) in target.chunks(8).enumerate() {
                for garbage in [0x00, 0x55, 0xA5] {
                    let mut half = page;
                    half[8 * at..8 * at + 8].fill(garbage);
                    half[8 * at..8 * at + 4].copy_from_slice(&word[..4]);
                    states.push(half);
                }
                page[8 * at..8 * at + 8].copy_from_slice(word);
                states.push(page);
            }
            let mut found_new = 0;
            for (cut, state) in states.iter().enumerate() {
                let mut cut_off = slots;
                cut_off[next.slot] = *state;
                let choice = choose(&cut_off);
                assert!(matches!(choice.origin, Origin::Stored | Origin::Earlier), "cut {cut}");
                let loaded_record = choice.calibration.record();
                assert!(
                    *loaded_record == old || *loaded_record == new,
                    "cut {cut}: {}",
                    loaded_record.id.as_str()
                );
                found_new += u32::from(*loaded_record == new);
                // A record that is stored after the cut is the one that is read.
                cut_off[choice.next.slot] = to_stored(&new, choice.next.sequence);
                assert_eq!(*choose(&cut_off).calibration.record(), new, "cut {cut}");
            }
            assert!(found_new >= 1);
            slots[next.slot] = target;
            old = new;
        }
    }
}
