//! The flash interface and the last page of the flash, on the model that the host's tests know too.
//!
//! The page's memory survives a reset of the core, as flash does; after power-on it is erased.

use crate::flash_model::{ERASED, FlashModel, PAGE_BYTES, STORED_BYTES, Unknown};
use crate::qemu::{Registers, Unmodelled};
use crate::thumb::Width;
use core::mem::MaybeUninit;
use core::ptr;

/// Address of the page.
pub(crate) const PAGE: u32 = 0x080F_F800;
/// Marks the page's memory as valid.
const MAGIC: u32 = 0x7061_6765;

/// What the page keeps.
struct Memory {
    magic: u32,
    page: [u8; STORED_BYTES],
}

/// Survives a reset of the core.
#[unsafe(link_section = ".uninit.page")]
static mut MEMORY: MaybeUninit<Memory> = MaybeUninit::uninit();

/// The interface. Accesses to the page have their whole address as the offset.
pub(crate) struct Flash {
    model: FlashModel,
}

impl Flash {
    pub(crate) const fn new() -> Self {
        Self { model: FlashModel::new() }
    }

    fn parts(&mut self) -> (&mut FlashModel, &mut [u8; STORED_BYTES]) {
        // SAFETY: any bit pattern is a valid `Memory`. There is one `Flash`, in the machine, and only this method refers to
        // the memory, for as long as it borrows the interface.
        let memory = unsafe { &mut *ptr::addr_of_mut!(MEMORY).cast::<Memory>() };
        if memory.magic != MAGIC {
            memory.page.fill(ERASED);
            memory.magic = MAGIC;
        }
        (&mut self.model, &mut memory.page)
    }
}

impl From<Unknown> for Unmodelled {
    fn from(Unknown: Unknown) -> Self {
        Self
    }
}

/// The offset in the page, if the address lies in it.
fn in_page(address: u32) -> Option<u32> {
    address.checked_sub(PAGE).filter(|&offset| offset < PAGE_BYTES as u32)
}

impl Registers for Flash {
    fn read(&mut self, offset: u32, width: Width) -> Result<u32, Unmodelled> {
        let (model, page) = self.parts();
        match in_page(offset) {
            Some(offset) => Ok(FlashModel::read_page(page, offset, width)),
            None if width == Width::Word => Ok(model.read_register(offset)?),
            None => Err(Unmodelled),
        }
    }

    fn write(&mut self, offset: u32, width: Width, value: u32) -> Result<(), Unmodelled> {
        let (model, page) = self.parts();
        match in_page(offset) {
            Some(offset) => model.write_page(page, offset, width, value),
            None if width == Width::Word => model.write_register(page, offset, value)?,
            None => return Err(Unmodelled),
        }
        Ok(())
    }
}
