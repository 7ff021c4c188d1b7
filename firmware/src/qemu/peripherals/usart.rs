//! The registers of USART1 that QEMU treats differently from the chip; they are passed on to QEMU's own model.
//!
//! QEMU takes words only, where drivers use bytes for the data registers. And its ICR clears whatever status bit is
//! written, where the chip ignores the bits that ICR does not have: drivers acknowledge by writing the whole status,
//! which would clear "transmit register empty" and stop the transmission.

use crate::qemu::{Registers, Unmodelled};
use crate::thumb::Width;
use embassy_stm32::pac::USART1;

const ICR: u32 = 0x20;
const RDR: u32 = 0x24;
const TDR: u32 = 0x28;
/// The bits that ICR has.
const ICR_BITS: u32 = 0x0012_1B5F;

/// The three registers.
pub(crate) struct Usart;

impl Registers for Usart {
    fn read(&mut self, offset: u32, width: Width) -> Result<u32, Unmodelled> {
        match offset {
            RDR => Ok(USART1.rdr().read().0 & width.mask()),
            _ => Err(Unmodelled),
        }
    }

    fn write(&mut self, offset: u32, _width: Width, value: u32) -> Result<(), Unmodelled> {
        match offset {
            ICR => USART1.icr().write(|w| w.0 = value & ICR_BITS),
            TDR => USART1.tdr().write(|w| w.0 = value),
            _ => return Err(Unmodelled),
        }
        Ok(())
    }
}
