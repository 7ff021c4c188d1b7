//! Reset and clock control, for the flags of the last reset; all else is passed on to QEMU's own model.
//!
//! QEMU has none of these flags and no way to set them. In CSR they are above the bit that clears them.

use crate::qemu::{Registers, Unmodelled};
use embassy_stm32::pac::RCC;
use embassy_stm32::pac::rcc::regs::Csr;
use emulation::thumb::Width;

/// Registers: CR to CCIPR2.
const LAST: u32 = 0x9C;
const CSR: u32 = 0x94;
/// The flags in CSR.
const FLAGS: u32 = 0xFF << 24;

/// The registers.
pub(crate) struct Rcc {
    /// The flags of the last reset, nothing else.
    pub(crate) reset_flags: Csr,
}

impl Rcc {
    pub(crate) const fn new() -> Self {
        Self { reset_flags: Csr(0) }
    }
}

/// A register in QEMU's model.
fn register(offset: u32) -> *mut u32 {
    RCC.as_ptr().cast::<u32>().wrapping_add(offset as usize / 4)
}

impl Registers for Rcc {
    fn read(&mut self, offset: u32, width: Width) -> Result<u32, Unmodelled> {
        if width != Width::Word || offset > LAST {
            return Err(Unmodelled);
        }
        // SAFETY: a register of reset and clock control; reading one has no effect.
        let value = unsafe { register(offset).read_volatile() };
        Ok(if offset == CSR { value & !FLAGS | self.reset_flags.0 } else { value })
    }

    fn write(&mut self, offset: u32, width: Width, value: u32) -> Result<(), Unmodelled> {
        if width != Width::Word || offset > LAST {
            return Err(Unmodelled);
        }
        if offset == CSR && Csr(value).rmvf() {
            self.reset_flags = Csr(0);
        }
        // SAFETY: the program writes this register, and the write is carried out for it.
        unsafe { register(offset).write_volatile(value) };
        Ok(())
    }
}
