//! SPI1 as a master in 16-bit words, with the force converter as the one device on it.
//!
//! A word written to the data register is shifted at once; its answer waits in a receive buffer of two words, as in the
//! chip. Other word lengths, DMA, interrupts and a receive overrun are refused. Chip select comes from the GPIO model.

use crate::qemu::{Registers, Unmodelled};
use emulation::ads131m02_model::Ads131m02Model;
use emulation::thumb::Width;

const CR1: u32 = 0x00;
const CR2: u32 = 0x04;
const SR: u32 = 0x08;
const DR: u32 = 0x0C;

const CR1_MASTER: u32 = 1 << 2;
const CR1_ENABLE: u32 = 1 << 6;
/// CR2: word length.
const CR2_LENGTH: u32 = 0xF << 8;
/// CR2: DMA and interrupt enables.
const CR2_REFUSED: u32 = 0b1110_0011;
const SR_RXNE: u32 = 1 << 0;
const SR_TXE: u32 = 1 << 1;

/// The bus and the device on it.
pub(crate) struct Spi {
    /// The force converter.
    pub(crate) converter: Ads131m02Model,
    cr1: u32,
    cr2: u32,
    received: [u16; 2],
    waiting: usize,
}

impl Spi {
    pub(crate) const fn new() -> Self {
        Self { converter: Ads131m02Model::new(), cr1: 0, cr2: 0x0700, received: [0; 2], waiting: 0 }
    }

    fn send(&mut self, word: u16) -> Result<(), Unmodelled> {
        let running = CR1_MASTER | CR1_ENABLE;
        if self.cr1 & running != running || self.cr2 & CR2_LENGTH != CR2_LENGTH || self.waiting == 2 {
            return Err(Unmodelled);
        }
        self.received[self.waiting] = self.converter.shift(word);
        self.waiting += 1;
        Ok(())
    }

    fn receive(&mut self) -> u16 {
        let word = self.received[0];
        self.received[0] = self.received[1];
        self.waiting = self.waiting.saturating_sub(1);
        word
    }
}

impl Registers for Spi {
    fn read(&mut self, offset: u32, width: Width) -> Result<u32, Unmodelled> {
        match (width, offset) {
            (Width::Word, CR1) => Ok(self.cr1),
            (Width::Word, CR2) => Ok(self.cr2),
            (Width::Word, SR) => Ok(SR_TXE | if self.waiting > 0 { SR_RXNE } else { 0 }),
            (Width::Half, DR) => Ok(u32::from(self.receive())),
            _ => Err(Unmodelled),
        }
    }

    fn write(&mut self, offset: u32, width: Width, value: u32) -> Result<(), Unmodelled> {
        match (width, offset) {
            (Width::Word, CR1) => self.cr1 = value,
            (Width::Word, CR2) if value & CR2_REFUSED == 0 => self.cr2 = value,
            (Width::Half, DR) => self.send(value as u16)?,
            _ => return Err(Unmodelled),
        }
        Ok(())
    }
}
