//! The flash interface and the last four pages of the flash, as far as a store of a few hundred bytes needs them. The flash
//! driver runs on this model in unit tests and in QEMU.
//!
//! Models the unlock keys, the erasure of these pages, the programming of erased double words and the error flags. Only the
//! first [`STORED_BYTES`] of a page can be programmed; the rest stays erased and is write-protected. Everything is done at
//! once: the busy flag is never set. Other pages, mass erasure, fast programming, option bytes and interrupts are refused.

use crate::thumb::Width;

/// Bytes of a page.
pub const PAGE_BYTES: usize = 2048;
/// Pages that are modelled.
pub const PAGES: usize = 4;
/// Content of the pages.
pub type Pages = [[u8; STORED_BYTES]; PAGES];
/// Number of bytes at the start of a page that can be programmed.
pub const STORED_BYTES: usize = 512;
/// Byte of erased flash.
pub const ERASED: u8 = 0xFF;
/// The first of the pages among those of its bank, which is the one of BKER.
const FIRST_PAGE: u32 = 252;

const ACR: u32 = 0x00;
const KEYR: u32 = 0x08;
const SR: u32 = 0x10;
const CR: u32 = 0x14;
const OPTR: u32 = 0x20;

/// The option bytes of a prepared board: those of a new chip, with brown-out reset at level 4 (2.8 V).
const OPTIONS: u32 = 0xFFEF_FCAA;

const KEYS: [u32; 2] = [0x4567_0123, 0xCDEF_89AB];

const SR_PROGERR: u32 = 1 << 3;
const SR_WRPERR: u32 = 1 << 4;
const SR_PGAERR: u32 = 1 << 5;
const SR_SIZERR: u32 = 1 << 6;
const SR_PGSERR: u32 = 1 << 7;

const CR_PG: u32 = 1 << 0;
const CR_PER: u32 = 1 << 1;
const CR_BKER: u32 = 1 << 11;
const CR_STRT: u32 = 1 << 16;
const CR_OPTLOCK: u32 = 1 << 30;
const CR_LOCK: u32 = 1 << 31;
/// PNB: number of the page.
const CR_PAGE_SHIFT: u32 = 3;
const CR_PAGE_MASK: u32 = 0xFF;
/// The bits that are modelled.
const CR_KNOWN: u32 =
    CR_PG | CR_PER | CR_PAGE_MASK << CR_PAGE_SHIFT | CR_BKER | CR_STRT | CR_OPTLOCK | CR_LOCK;

/// An access that the model does not cover.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Unknown;

/// The interface. The page's memory is the caller's: it outlives a reset, the interface does not.
#[derive(Debug)]
pub struct FlashModel {
    access_control: u32,
    status: u32,
    control: u32,
    /// Keys given so far.
    keys: usize,
    /// The first word of a double word, and its offset in the page.
    first_word: Option<(u32, u32)>,
}

impl Default for FlashModel {
    fn default() -> Self {
        Self::new()
    }
}

impl FlashModel {
    /// After a reset: locked.
    pub const fn new() -> Self {
        Self { access_control: 0x0600, status: 0, control: CR_LOCK | CR_OPTLOCK, keys: 0, first_word: None }
    }

    /// A load from a register of the interface.
    pub fn read_register(&self, offset: u32) -> Result<u32, Unknown> {
        match offset {
            ACR => Ok(self.access_control),
            SR => Ok(self.status),
            CR => Ok(self.control),
            OPTR => Ok(OPTIONS),
            _ => Err(Unknown),
        }
    }

    /// A store to a register of the interface.
    pub fn write_register(&mut self, pages: &mut Pages, offset: u32, value: u32) -> Result<(), Unknown> {
        match offset {
            ACR => self.access_control = value,
            KEYR => self.unlock(value)?,
            // Writing a one clears a flag.
            SR => self.status &= !value,
            // A locked register ignores stores.
            CR if self.control & CR_LOCK != 0 => {}
            CR => self.command(pages, value)?,
            _ => return Err(Unknown),
        }
        Ok(())
    }

    /// The chip locks the register until the next reset after a wrong key; no driver should ever need that.
    fn unlock(&mut self, key: u32) -> Result<(), Unknown> {
        if self.control & CR_LOCK == 0 || key != KEYS[self.keys] {
            return Err(Unknown);
        }
        self.keys += 1;
        if self.keys == KEYS.len() {
            self.keys = 0;
            self.control &= !CR_LOCK;
        }
        Ok(())
    }

    fn command(&mut self, pages: &mut Pages, value: u32) -> Result<(), Unknown> {
        let starts = value & CR_STRT != 0;
        let erases = value & (CR_PER | CR_BKER | CR_PG) == CR_PER | CR_BKER;
        let number = (value >> CR_PAGE_SHIFT & CR_PAGE_MASK).checked_sub(FIRST_PAGE);
        let page = number.and_then(|number| pages.get_mut(number as usize)).filter(|_| erases);
        if value & !CR_KNOWN != 0 || starts && page.is_none() {
            return Err(Unknown);
        }
        self.control = value & !CR_STRT;
        self.first_word = None;
        match (starts, self.status) {
            (true, 0) => page.into_iter().for_each(|page| page.fill(ERASED)),
            (true, _) => self.status |= SR_PGSERR,
            (false, _) => {}
        }
        Ok(())
    }

    /// A load from the pages, at an offset from the first of them.
    pub fn read_page(pages: &Pages, offset: u32, width: Width) -> u32 {
        (0..4).fold(0, |word, at| word | byte_at(offset + at, pages) << (8 * at)) & width.mask()
    }

    /// A store to the pages: one half of a double word, the lower first. Errors show in the status.
    pub fn write_page(&mut self, pages: &mut Pages, offset: u32, width: Width, value: u32) {
        let pending = self.first_word.take();
        let error = if self.control & (CR_PG | CR_PER | CR_LOCK) != CR_PG || self.status != 0 {
            SR_PGSERR
        } else if width != Width::Word {
            SR_SIZERR
        } else if offset as usize % PAGE_BYTES >= STORED_BYTES || offset as usize >= PAGES * PAGE_BYTES {
            SR_WRPERR
        } else {
            match pending {
                None if offset.is_multiple_of(8) => {
                    self.first_word = Some((offset, value));
                    0
                }
                Some((first, low)) if offset == first + 4 => {
                    let (page, first) = (first as usize / PAGE_BYTES, first as usize % PAGE_BYTES);
                    pages.get_mut(page).map_or(SR_WRPERR, |page| program(page, first, [low, value]))
                }
                _ => SR_PGAERR,
            }
        };
        self.status |= error;
    }
}

fn byte_at(at: u32, pages: &[[u8; 512]; 4]) -> u32 {
    let (page, offset) = (at as usize / PAGE_BYTES, at as usize % PAGE_BYTES);
    u32::from(pages.get(page).and_then(|page| page.get(offset)).copied().unwrap_or(ERASED))
}

/// Programs a double word. It is an error unless the double word is erased or is programmed to zeros, which is always allowed.
fn program(page: &mut [u8; STORED_BYTES], offset: usize, words: [u32; 2]) -> u32 {
    let cells = &mut page[offset..offset + 8];
    if words != [0; 2] && cells.iter().any(|&byte| byte != ERASED) {
        return SR_PROGERR;
    }
    for (cells, word) in cells.chunks_exact_mut(4).zip(words) {
        cells.copy_from_slice(&word.to_le_bytes());
    }
    0
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Interface and page, unlocked.
    fn unlocked() -> (FlashModel, Pages) {
        let (mut flash, mut page) = (FlashModel::new(), [[ERASED; STORED_BYTES]; PAGES]);
        for key in KEYS {
            flash.write_register(&mut page, KEYR, key).unwrap();
        }
        (flash, page)
    }

    fn write(flash: &mut FlashModel, page: &mut Pages, offset: u32, words: [u32; 2]) -> u32 {
        flash.write_page(page, offset, Width::Word, words[0]);
        flash.write_page(page, offset + 4, Width::Word, words[1]);
        flash.read_register(SR).unwrap()
    }

    #[test]
    fn an_erased_double_word_takes_what_is_programmed() {
        let (mut flash, mut page) = unlocked();
        flash.write_register(&mut page, CR, CR_PG).unwrap();
        assert_eq!(write(&mut flash, &mut page, 8, [0x0403_0201, 0x0807_0605]), 0);
        assert_eq!(page[0][7..17], [ERASED, 1, 2, 3, 4, 5, 6, 7, 8, ERASED]);
        assert_eq!(FlashModel::read_page(&page, 9, Width::Half), 0x0302);
        assert_eq!(FlashModel::read_page(&page, 12, Width::Word), 0x0807_0605);
        assert_eq!(FlashModel::read_page(&page, 510, Width::Word), 0xFFFF_FFFF);
        assert_eq!(FlashModel::read_page(&page, 4095, Width::Byte), 0xFF);
    }

    #[test]
    fn a_programmed_double_word_takes_only_zeros() {
        let (mut flash, mut page) = unlocked();
        flash.write_register(&mut page, CR, CR_PG).unwrap();
        assert_eq!(write(&mut flash, &mut page, 0, [1, 2]), 0);
        assert_eq!(write(&mut flash, &mut page, 0, [1, 2]), SR_PROGERR);
        assert_eq!(
            write(&mut flash, &mut page, 8, [1, 2]),
            SR_PROGERR | SR_PGSERR,
            "the error must be cleared first"
        );
        flash.write_register(&mut page, SR, SR_PROGERR | SR_PGSERR).unwrap();
        assert_eq!(write(&mut flash, &mut page, 0, [0, 0]), 0);
        assert_eq!(page[0][..9], [0, 0, 0, 0, 0, 0, 0, 0, ERASED]);
    }

    #[test]
    fn erasing_takes_the_page_in_its_bank_and_no_other() {
        let (mut flash, mut page) = unlocked();
        page[0][3] = 0;
        page[1][3] = 0;
        assert_eq!(
            flash.write_register(&mut page, CR, erase_request(FIRST_PAGE + 1)),
            Err(Unknown),
            "that is the first bank"
        );
        assert_eq!(
            flash.write_register(&mut page, CR, erase_request(FIRST_PAGE - 1) | CR_BKER),
            Err(Unknown)
        );
        assert_eq!((page[0][3], page[1][3]), (0, 0));
        flash.write_register(&mut page, CR, erase_request(FIRST_PAGE + 1) | CR_BKER).unwrap();
        assert_eq!((page[0][3], page[1]), (0, [ERASED; STORED_BYTES]));
        assert_eq!(write(&mut flash, &mut page, 2048, [1, 2]), SR_PGSERR, "programming was not switched on");
        assert_eq!(flash.read_register(CR).unwrap() & CR_STRT, 0, "done");
    }

    fn erase_request(page: u32) -> u32 {
        CR_PER | CR_STRT | page << CR_PAGE_SHIFT
    }

    #[test]
    fn a_locked_interface_changes_nothing() {
        let (mut flash, mut page) = (FlashModel::new(), [[7; STORED_BYTES]; PAGES]);
        flash
            .write_register(&mut page, CR, CR_PER | CR_STRT | FIRST_PAGE << CR_PAGE_SHIFT | CR_BKER)
            .unwrap();
        assert_eq!(write(&mut flash, &mut page, 0, [0, 0]), SR_PGSERR);
        assert_eq!(page, [[7; STORED_BYTES]; PAGES]);
        assert_eq!(flash.write_register(&mut page, KEYR, KEYS[1]), Err(Unknown), "the wrong key first");
    }

    #[test]
    fn locking_holds_until_the_keys_are_given_again() {
        let (mut flash, mut page) = unlocked();
        flash.write_register(&mut page, CR, CR_LOCK).unwrap();
        flash.write_register(&mut page, CR, CR_PG).unwrap();
        assert_eq!(flash.read_register(CR), Ok(CR_LOCK));
        assert_eq!(write(&mut flash, &mut page, 0, [1, 2]), SR_PGSERR);
    }

    #[test]
    fn wrong_programming_shows_its_error() {
        for (offset, width, error) in [
            (0, Width::Half, SR_SIZERR),
            (1, Width::Byte, SR_SIZERR),
            (4, Width::Word, SR_PGAERR),
            (512, Width::Word, SR_WRPERR),
        ] {
            let (mut flash, mut page) = unlocked();
            flash.write_register(&mut page, CR, CR_PG).unwrap();
            flash.write_page(&mut page, offset, width, 0);
            assert_eq!(flash.read_register(SR), Ok(error), "{width:?} at {offset}");
            assert_eq!(page, [[ERASED; STORED_BYTES]; PAGES]);
        }
        let (mut flash, mut page) = unlocked();
        assert_eq!(write(&mut flash, &mut page, 0, [1, 2]), SR_PGSERR, "programming was not switched on");
    }
}
