//! The registers of the serial port that QEMU treats differently from the chip; they are passed on to QEMU's own model.
//!
//! QEMU accepts words only, but drivers use bytes for the data registers. QEMU's ICR also clears any status bit that is written,
//! whereas the chip ignores the bits that ICR does not have: drivers acknowledge by writing the whole status, which would
//! clear "transmit register empty" and stop the transmission.
//!
//! The same flags limit the speed of the line. QEMU transmits at once; here the plant sets the number of bytes that the line
//! carries per period. After these the next byte is held back, and "transmit register empty" and "transmission complete" are
//! cleared, as in the chip while a byte waits. The driver waits for its interrupt; the byte goes to QEMU in the next period,
//! which sets both flags again.

use crate::board::pins::SERIAL;
use crate::qemu::{Registers, Unmodelled};
use emulation::plant::UNLIMITED;
use emulation::thumb::Width;

const ICR: u32 = 0x20;
const RDR: u32 = 0x24;
const TDR: u32 = 0x28;
/// Bits that exist in ICR.
const ICR_BITS: u32 = 0x0012_1B5F;
/// ISR: transmission complete, transmit register empty.
const TRANSMITTED: u32 = 1 << 6 | 1 << 7;

/// The three registers, and the line towards the host.
pub(crate) struct Usart {
    /// Bytes that the line still carries in this period.
    budget: u16,
    /// The byte that waits for the next period.
    waiting: Option<u32>,
}

impl Usart {
    pub(crate) const fn new() -> Self {
        Self { budget: UNLIMITED, waiting: None }
    }

    /// Begins a period in which the line carries this number of bytes. Returns the byte to write to TDR, if one was held back
    /// and may be sent.
    pub(crate) fn refill(&mut self, line_bytes: u16) -> Option<u32> {
        self.budget = line_bytes;
        if line_bytes > 0 { self.waiting.take() } else { None }
    }

    fn send(&mut self, byte: u32) {
        if self.budget == 0 {
            self.waiting = Some(byte);
            SERIAL.icr().write(|w| w.0 = TRANSMITTED);
            return;
        }
        if self.budget != UNLIMITED {
            self.budget -= 1;
        }
        SERIAL.tdr().write(|w| w.0 = byte);
    }
}

impl Registers for Usart {
    fn read(&mut self, offset: u32, width: Width) -> Result<u32, Unmodelled> {
        match offset {
            RDR => Ok(SERIAL.rdr().read().0 & width.mask()),
            _ => Err(Unmodelled),
        }
    }

    fn write(&mut self, offset: u32, _width: Width, value: u32) -> Result<(), Unmodelled> {
        match offset {
            ICR => {
                let acknowledged = value & ICR_BITS;
                SERIAL.icr().write(|w| w.0 = acknowledged);
            }
            TDR => self.send(value),
            _ => return Err(Unmodelled),
        }
        Ok(())
    }
}
