//! The store: the last pages of the flash, each of which keeps a few hundred bytes without power: two for calibrations
//! ([`control::slots`]), and before them two that count the starts ([`control::starts`]).
//!
//! The pages lie in the second bank and the program in the first, so the core goes on while one is erased (about 25 ms) and
//! programmed; the writer waits. A write that is cut off leaves anything in its page, and the other one as it was: what is
//! stored must carry its own check, and the older of two is erased for the new one ([`control::slots`]).

use embassy_stm32::Peri;
use embassy_stm32::flash::{Blocking, Error, Flash, WRITE_SIZE};
use embassy_stm32::pac;
use embassy_stm32::peripherals::FLASH;

use control::slots::SLOTS;
use control::starts;

/// Most that a page takes.
pub const STORE_BYTES: usize = 512;
/// Size of a page.
const PAGE_BYTES: u32 = 2048;
/// Pages of the store.
const PAGES: usize = SLOTS + starts::PAGES;
/// Start of the first page, from the beginning of the flash.
const FIRST_OFFSET: u32 = 1024 * 1024 - PAGES as u32 * PAGE_BYTES;
/// Byte of erased flash.
const ERASED: u8 = 0xFF;

/// Why nothing was stored.
#[derive(Clone, Copy, Debug, PartialEq, Eq, defmt::Format)]
pub enum StoreError {
    /// More than [`STORE_BYTES`].
    TooLong,
    /// The flash refused.
    Flash(Error),
    /// The flash holds something else than what was written.
    Differs,
}

impl From<Error> for StoreError {
    fn from(error: Error) -> Self {
        Self::Flash(error)
    }
}

/// The store.
pub struct Store {
    flash: Flash<'static, Blocking>,
}

impl Store {
    pub(super) fn new(flash: Peri<'static, FLASH>) -> Self {
        Self { flash: Flash::new_blocking(flash) }
    }

    /// Reads a page from its beginning; what was never written reads `0xFF`, as does all beyond [`STORE_BYTES`].
    pub fn read(&mut self, slot: usize, bytes: &mut [u8]) {
        let (stored, page_tail) = bytes.split_at_mut(bytes.len().min(STORE_BYTES));
        page_tail.fill(ERASED);
        if self.flash.blocking_read(offset_of(slot), stored).is_err() {
            stored.fill(ERASED);
        }
    }

    /// Replaces what a page has stored and reads it back.
    ///
    /// # Errors
    /// [`StoreError`]; nothing of the old is left in this page then, unless the new was too long.
    pub fn write(&mut self, slot: usize, bytes: &[u8]) -> Result<(), StoreError> {
        if bytes.len() > STORE_BYTES {
            return Err(StoreError::TooLong);
        }
        self.erase(slot)?;
        self.append(slot, 0, bytes)
    }

    /// Erases a page.
    ///
    /// # Errors
    /// [`StoreError`].
    pub fn erase(&mut self, slot: usize) -> Result<(), StoreError> {
        let page = offset_of(slot);
        let caching = pause_data_cache();
        let erased = self.flash.blocking_erase(page, page + PAGE_BYTES);
        resume_data_cache(caching);
        Ok(erased?)
    }

    /// Writes into what is erased of a page, from a whole unit of the flash on, and reads it back.
    ///
    /// # Errors
    /// [`StoreError`].
    pub fn append(&mut self, slot: usize, offset: usize, bytes: &[u8]) -> Result<(), StoreError> {
        let begins = offset_of(slot) + offset as u32;
        let caching = pause_data_cache();
        let written = self.program(begins, bytes);
        resume_data_cache(caching);
        written?;
        self.compare(begins, bytes)
    }

    fn program(&mut self, page: u32, bytes: &[u8]) -> Result<(), StoreError> {
        for (offset, chunk) in (page..).step_by(WRITE_SIZE).zip(bytes.chunks(WRITE_SIZE)) {
            let mut cell = [ERASED; WRITE_SIZE];
            cell[..chunk.len()].copy_from_slice(chunk);
            self.flash.blocking_write(offset, &cell)?;
        }
        Ok(())
    }

    fn compare(&mut self, page: u32, bytes: &[u8]) -> Result<(), StoreError> {
        for (offset, chunk) in (page..).step_by(WRITE_SIZE).zip(bytes.chunks(WRITE_SIZE)) {
            let mut buffer = [0; WRITE_SIZE];
            let page_bytes = &mut buffer[..chunk.len()];
            self.flash.blocking_read(offset, page_bytes)?;
            if page_bytes != chunk {
                return Err(StoreError::Differs);
            }
        }
        Ok(())
    }
}

/// Start of a page: those of the calibrations are the last of the flash.
const fn offset_of(slot: usize) -> u32 {
    let page_index = match slot.checked_sub(SLOTS) {
        Some(of_starts) => of_starts % starts::PAGES,
        None => slot % SLOTS + starts::PAGES,
    };
    FIRST_OFFSET + page_index as u32 * PAGE_BYTES
}

/// Switches the cache of data read from flash off. While one bank is written and the other read, the chip may put wrong data
/// into it (errata of the L47x), and it does not notice that a page was erased.
fn pause_data_cache() -> bool {
    let caching = pac::FLASH.acr().read().dcen();
    pac::FLASH.acr().modify(|w| w.set_dcen(false));
    caching
}

/// Empties the cache, which it can only be while it is off, and switches it on again if it was on.
fn resume_data_cache(caching: bool) {
    pac::FLASH.acr().modify(|w| w.set_dcrst(true));
    pac::FLASH.acr().modify(|w| w.set_dcrst(false));
    pac::FLASH.acr().modify(|w| w.set_dcen(caching));
}
