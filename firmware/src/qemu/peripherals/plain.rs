//! Registers that only have to keep what is written, or hold a constant: power control, unique number.
//!
//! The drivers set the write permission of the backup domain and the supply of the second I/O group, and read them
//! back. The bits have no further effect here.

use crate::qemu::{Registers, Unmodelled};
use emulation::thumb::Width;

/// Power control: CR1 to CR4.
pub(crate) struct Pwr {
    control: [u32; 4],
}

impl Pwr {
    pub(crate) const fn new() -> Self {
        // Range 1 is the voltage scale after reset.
        Self { control: [0x0200, 0, 0x8000, 0] }
    }
}

impl Registers for Pwr {
    fn read(&mut self, offset: u32, width: Width) -> Result<u32, Unmodelled> {
        match (width, offset) {
            (Width::Word, 0x00..=0x0C) => Ok(self.control[offset as usize / 4]),
            _ => Err(Unmodelled),
        }
    }

    fn write(&mut self, offset: u32, width: Width, value: u32) -> Result<(), Unmodelled> {
        match (width, offset) {
            (Width::Word, 0x00..=0x0C) => self.control[offset as usize / 4] = value,
            _ => return Err(Unmodelled),
        }
        Ok(())
    }
}

/// The chip's unique number, which QEMU does not map at all. The simulation of the board sets it in the file `unique-id.bin`, so
/// that no two boards have the same boot ids.
pub(crate) struct UniqueId {
    bytes: [u8; 12],
}

impl UniqueId {
    pub(crate) const fn new() -> Self {
        Self { bytes: *b"QEMU no file" }
    }

    /// Loads the file; call it before any address is trapped.
    pub(crate) fn power_on(&mut self) {
        crate::qemu::link::load(c"unique-id.bin", &mut self.bytes);
    }
}

/// Offset of the number in its page.
const UNIQUE_ID: u32 = 0x190;

impl Registers for UniqueId {
    fn read(&mut self, offset: u32, width: Width) -> Result<u32, Unmodelled> {
        match (width, offset.wrapping_sub(UNIQUE_ID)) {
            (Width::Word, word @ (0x00 | 0x04 | 0x08)) => {
                let (words, _) = self.bytes.as_chunks();
                words.get(word as usize / 4).copied().map(u32::from_le_bytes).ok_or(Unmodelled)
            }
            _ => Err(Unmodelled),
        }
    }

    fn write(&mut self, _: u32, _: Width, _: u32) -> Result<(), Unmodelled> {
        Err(Unmodelled)
    }
}
