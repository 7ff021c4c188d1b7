//! The flash interface and the last four pages of the flash, on the model that the host's tests use too.
//!
//! The pages' memory survives a reset of the core, as flash does. At power-on it is loaded from the file `flash.bin` in QEMU's
//! working folder, page after page, or is erased if there is no file; at power-off it is written to that file.

use crate::qemu::{Registers, Unmodelled};
use core::mem::MaybeUninit;
use core::ptr;
use emulation::flash_model::{ERASED, FlashModel, PAGE_BYTES, PAGES, Pages, STORED_BYTES, Unknown};
use emulation::thumb::Width;

/// Address of the first page.
pub(crate) const PAGE: u32 = 0x080F_E000;
/// Marks the pages' memory as valid.
const MAGIC: u32 = 0x7061_6765;

/// Content of the pages.
struct Memory {
    magic: u32,
    pages: Pages,
}

/// Survives a reset of the core.
#[unsafe(link_section = ".uninit.page")]
static mut MEMORY: MaybeUninit<Memory> = MaybeUninit::uninit();

/// Writes the pages to the file, at power-off.
pub(crate) fn power_off() {
    // SAFETY: as in `parts`; nothing else runs any more.
    let memory = unsafe { &*ptr::addr_of!(MEMORY).cast::<Memory>() };
    if memory.magic == MAGIC {
        crate::qemu::link::store(c"flash.bin", memory.pages.as_flattened());
    }
}

/// The interface. Accesses to the pages have their whole address as the offset.
pub(crate) struct Flash {
    model: FlashModel,
}

impl Flash {
    pub(crate) const fn new() -> Self {
        Self { model: FlashModel::new() }
    }

    /// Loads the file at power-on, which is a start at which the memory is not valid. Call it before any address is trapped.
    pub(crate) fn power_on(&mut self) {
        // SAFETY: as in `parts`.
        let memory = unsafe { &mut *ptr::addr_of_mut!(MEMORY).cast::<Memory>() };
        if memory.magic != MAGIC {
            let (_, pages) = self.parts();
            // Bytes that the file does not have stay erased.
            pages.as_flattened_mut().fill(ERASED);
            crate::qemu::link::load(c"flash.bin", pages.as_flattened_mut());
        }
    }

    fn parts(&mut self) -> (&mut FlashModel, &mut Pages) {
        // SAFETY: any bit pattern is a valid `Memory`. There is one `Flash`, in the machine, and only this method refers to
        // the memory, for as long as it borrows the interface.
        let memory = unsafe { &mut *ptr::addr_of_mut!(MEMORY).cast::<Memory>() };
        if memory.magic != MAGIC {
            memory.pages = [[ERASED; STORED_BYTES]; PAGES];
            memory.magic = MAGIC;
        }
        (&mut self.model, &mut memory.pages)
    }
}

impl From<Unknown> for Unmodelled {
    fn from(Unknown: Unknown) -> Self {
        Self
    }
}

/// The offset from the first page, if the address lies in one of them.
fn in_page(address: u32) -> Option<u32> {
    address.checked_sub(PAGE).filter(|&offset| offset < (PAGES * PAGE_BYTES) as u32)
}

impl Registers for Flash {
    fn read(&mut self, offset: u32, width: Width) -> Result<u32, Unmodelled> {
        let (model, pages) = self.parts();
        match in_page(offset) {
            Some(offset) => Ok(FlashModel::read_page(pages, offset, width)),
            None if width == Width::Word => Ok(model.read_register(offset)?),
            None => Err(Unmodelled),
        }
    }

    fn write(&mut self, offset: u32, width: Width, value: u32) -> Result<(), Unmodelled> {
        let (model, pages) = self.parts();
        match in_page(offset) {
            Some(offset) => model.write_page(pages, offset, width, value),
            None if width == Width::Word => model.write_register(pages, offset, value)?,
            None => return Err(Unmodelled),
        }
        Ok(())
    }
}
