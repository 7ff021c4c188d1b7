//! The converter ADC1: single conversions of the two potentiometer channels.
//!
//! Regulator, calibration, enable and conversion follow the chip's order and are immediate, unless the plant sets how long
//! a conversion takes: its flags then come when that device time has passed, or never. A conversion returns the plant's code of
//! the first channel of the sequence at its start. Averaging does not change a constant, so its settings are stored without an
//! effect. Sequences of more than one rank, other channels, injected conversions, stopping, DMA and interrupts are refused.

use crate::board::pins::emulated::CHANNELS;
use crate::qemu::{Registers, Unmodelled, time};
use emulation::plant::NEVER;
use emulation::thumb::Width;

const ISR: u32 = 0x00;
const CR: u32 = 0x08;
const CFGR: u32 = 0x0C;
const CFGR2: u32 = 0x10;
const SMPR1: u32 = 0x14;
const SMPR2: u32 = 0x18;
const SQR1: u32 = 0x30;
const DR: u32 = 0x40;

const ISR_ADRDY: u32 = 1 << 0;
const ISR_EOC: u32 = 1 << 2;
const ISR_EOS: u32 = 1 << 3;

const CR_ADEN: u32 = 1 << 0;
const CR_ADSTART: u32 = 1 << 2;
const CR_ADVREGEN: u32 = 1 << 28;
const CR_DEEPPWD: u32 = 1 << 29;
const CR_ADCAL: u32 = 1 << 31;
/// CFGR: DMA and continuous conversion.
const CFGR_REFUSED: u32 = 1 << 0 | 1 << 13;

/// The converter.
pub(crate) struct Adc {
    /// Codes of the potentiometers.
    pub(crate) potentiometer_codes: [u16; 2],
    /// Duration of a conversion, microseconds; [`NEVER`] for one that does not end.
    pub(crate) conversion_us: u16,
    /// Device time at which the running conversion ends, microseconds.
    due_us: Option<u64>,
    isr: u32,
    cr: u32,
    cfgr: u32,
    cfgr2: u32,
    smpr: [u32; 2],
    sqr1: u32,
    dr: u16,
}

impl Adc {
    pub(crate) const fn new() -> Self {
        Self {
            potentiometer_codes: [0; 2],
            conversion_us: 0,
            due_us: None,
            isr: 0,
            cr: CR_DEEPPWD,
            cfgr: 0x8000_0000,
            cfgr2: 0,
            smpr: [0; 2],
            sqr1: 0,
            dr: 0,
        }
    }

    /// A write to the control register: its commands take effect and are complete at once.
    fn control(&mut self, value: u32) -> Result<(), Unmodelled> {
        let known_bits = CR_ADEN | CR_ADSTART | CR_ADVREGEN | CR_DEEPPWD | CR_ADCAL;
        let regulated = value & (CR_ADVREGEN | CR_DEEPPWD) == CR_ADVREGEN;
        let acts = value & (CR_ADEN | CR_ADSTART | CR_ADCAL) != 0;
        if value & !known_bits != 0 || acts && !regulated {
            return Err(Unmodelled);
        }
        if value & CR_ADEN != 0 && self.cr & CR_ADEN == 0 {
            self.isr |= ISR_ADRDY;
        }
        // The enable bit is set by a one and not cleared by a zero.
        self.cr = value & !(CR_ADSTART | CR_ADCAL) | self.cr & (CR_ADSTART | CR_ADEN);
        // A start while a conversion runs does nothing.
        if value & CR_ADSTART != 0 && self.cr & CR_ADSTART == 0 {
            self.convert()?;
        }
        Ok(())
    }

    fn convert(&mut self) -> Result<(), Unmodelled> {
        let (further_ranks, channel) = (self.sqr1 & 0xF, self.sqr1 >> 6 & 0x1F);
        if self.cr & CR_ADEN == 0 || further_ranks != 0 {
            return Err(Unmodelled);
        }
        self.dr = match channel {
            _ if channel == CHANNELS[0] => self.potentiometer_codes[0],
            _ if channel == CHANNELS[1] => self.potentiometer_codes[1],
            _ => return Err(Unmodelled),
        };
        match self.conversion_us {
            0 => self.isr |= ISR_EOC | ISR_EOS,
            duration_us => {
                self.cr |= CR_ADSTART;
                self.due_us = (duration_us != NEVER).then(|| time::now_us() + u64::from(duration_us));
            }
        }
        Ok(())
    }

    /// Ends the running conversion when its time has come.
    fn settle(&mut self) {
        if self.cr & CR_ADSTART != 0 && self.due_us.is_some_and(|due_us| time::now_us() >= due_us) {
            self.cr &= !CR_ADSTART;
            self.isr |= ISR_EOC | ISR_EOS;
        }
    }
}

impl Registers for Adc {
    fn read(&mut self, offset: u32, width: Width) -> Result<u32, Unmodelled> {
        self.settle();
        match (width, offset) {
            (Width::Word, ISR) => Ok(self.isr),
            (Width::Word, CR) => Ok(self.cr),
            (Width::Word, CFGR) => Ok(self.cfgr),
            (Width::Word, CFGR2) => Ok(self.cfgr2),
            (Width::Word, SMPR1 | SMPR2) => Ok(self.smpr[(offset - SMPR1) as usize / 4]),
            (Width::Word, SQR1) => Ok(self.sqr1),
            (Width::Word | Width::Half, DR) => {
                self.isr &= !ISR_EOC;
                Ok(u32::from(self.dr))
            }
            _ => Err(Unmodelled),
        }
    }

    fn write(&mut self, offset: u32, width: Width, value: u32) -> Result<(), Unmodelled> {
        self.settle();
        match (width, offset) {
            (Width::Word, ISR) => self.isr &= !value,
            (Width::Word, CR) => self.control(value)?,
            (Width::Word, CFGR) if value & CFGR_REFUSED == 0 => self.cfgr = value,
            (Width::Word, CFGR2) => self.cfgr2 = value,
            (Width::Word, SMPR1 | SMPR2) => self.smpr[(offset - SMPR1) as usize / 4] = value,
            (Width::Word, SQR1) => self.sqr1 = value,
            _ => return Err(Unmodelled),
        }
        Ok(())
    }
}
