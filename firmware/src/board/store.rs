//! Non-volatile store of a few hundred bytes in each of the last pages of the flash. Two pages hold calibrations
//! ([`control::slots`]); the two before them count the starts ([`control::starts`]).
//!
//! The pages lie in the second bank and the program in the first, so the core continues while a page is erased (about 25 ms)
//! and programmed, and only the writer waits. An interrupted write leaves arbitrary content in its page and does not change the
//! others. Therefore stored data have their own check, and a new record replaces the older one of the two
//! ([`control::slots`]).

use embassy_stm32::Peri;
use embassy_stm32::flash::{Blocking, Error, Flash, WRITE_SIZE};
use embassy_stm32::pac;
use embassy_stm32::peripherals::FLASH;

use control::slots::SLOTS;
use control::starts;

/// Largest number of bytes that are stored in a page.
pub const STORE_BYTES: usize = 512;
/// Size of a page.
const PAGE_BYTES: u32 = 2048;
/// Pages of the store.
const PAGES: usize = SLOTS + starts::PAGES;
/// Start of the first page, from the beginning of the flash.
const FIRST_OFFSET: u32 = 1024 * 1024 - PAGES as u32 * PAGE_BYTES;
/// Byte of erased flash.
const ERASED: u8 = 0xFF;

/// Reason for which the bytes were not stored.
#[derive(Clone, Copy, Debug, PartialEq, Eq, defmt::Format)]
pub enum StoreError {
    /// More than [`STORE_BYTES`].
    TooLong,
    /// The flash reported an error.
    Flash(Error),
    /// The flash does not hold the bytes that were written.
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

    /// Reads a page from its beginning. Bytes that were never written, and those beyond [`STORE_BYTES`], are `0xFF`.
    pub fn read(&mut self, slot: usize, bytes: &mut [u8]) {
        let (stored, page_tail) = bytes.split_at_mut(bytes.len().min(STORE_BYTES));
        page_tail.fill(ERASED);
        if self.flash.blocking_read(offset_of(slot), stored).is_err() {
            stored.fill(ERASED);
        }
    }

    /// Replaces the content of a page and reads it back.
    ///
    /// # Errors
    /// [`StoreError`]. The old content is lost then, unless the new one was too long.
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

    /// Writes into the erased part of a page, from the beginning of a flash unit on, and reads it back.
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

    fn program(&mut self, begins: u32, bytes: &[u8]) -> Result<(), StoreError> {
        for (offset, chunk) in (begins..).step_by(WRITE_SIZE).zip(bytes.chunks(WRITE_SIZE)) {
            let mut cell = [ERASED; WRITE_SIZE];
            cell[..chunk.len()].copy_from_slice(chunk);
            self.flash.blocking_write(offset, &cell)?;
        }
        Ok(())
    }

    fn compare(&mut self, begins: u32, bytes: &[u8]) -> Result<(), StoreError> {
        for (offset, chunk) in (begins..).step_by(WRITE_SIZE).zip(bytes.chunks(WRITE_SIZE)) {
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

/// Start of a page. The pages of the calibrations are the last ones of the flash.
const fn offset_of(slot: usize) -> u32 {
    let page_index = match slot.checked_sub(SLOTS) {
        Some(of_starts) => of_starts % starts::PAGES,
        None => slot % SLOTS + starts::PAGES,
    };
    FIRST_OFFSET + page_index as u32 * PAGE_BYTES
}

/// Switches the flash's data cache off. While one bank is written and the other one read, wrong data may enter the cache
/// (errata of the L47x), and the erasure of a page does not invalidate it.
fn pause_data_cache() -> bool {
    let caching = pac::FLASH.acr().read().dcen();
    pac::FLASH.acr().modify(|w| w.set_dcen(false));
    caching
}

/// Resets the cache, which is possible only while it is off, and switches it on again if it was on.
fn resume_data_cache(caching: bool) {
    pac::FLASH.acr().modify(|w| w.set_dcrst(true));
    pac::FLASH.acr().modify(|w| w.set_dcrst(false));
    pac::FLASH.acr().modify(|w| w.set_dcen(caching));
}
