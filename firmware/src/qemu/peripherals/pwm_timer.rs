//! A general-purpose timer (TIM2, TIM3) as a PWM generator.
//!
//! All registers keep what is written; the counter does not run, and there are no interrupts. The output of a channel follows from
//! its compare value in PWM mode 1, from the next exchange with the plant on (in the chip from the next PWM period on).
//! Interrupts, DMA and other modes are refused.

use crate::qemu::{Registers, Unmodelled};
use emulation::plant::FULL_SCALE;
use emulation::thumb::Width;

const CR1: u32 = 0x00;
const DIER: u32 = 0x0C;
const EGR: u32 = 0x14;
const CCMR1: u32 = 0x18;
const CCER: u32 = 0x20;
const ARR: u32 = 0x2C;
const CCR1: u32 = 0x34;
const CCR4: u32 = 0x40;

/// CR1: the counter runs.
const CR1_CEN: u32 = 1;
/// CCMR: PWM mode 1 in the mode field of a channel.
const PWM_MODE_1: u32 = 6;

/// The timer.
pub(crate) struct PwmTimer {
    /// CR1 to CCR4.
    registers: [u32; CCR4 as usize / 4 + 1],
}

impl PwmTimer {
    pub(crate) const fn new() -> Self {
        Self { registers: [0; CCR4 as usize / 4 + 1] }
    }

    fn register(&self, offset: u32) -> u32 {
        self.registers[offset as usize / 4]
    }

    /// Fraction of the period for which the output of a channel (0 to 3) is high, if the timer drives it.
    pub(crate) fn output(&self, channel: u32) -> Option<u16> {
        let enabled = self.register(CCER) >> (4 * channel) & 1 != 0;
        let mode = self.register(CCMR1 + 4 * (channel / 2)) >> (8 * (channel % 2) + 4) & 7;
        if self.register(CR1) & CR1_CEN == 0 || !enabled || mode != PWM_MODE_1 {
            return None;
        }
        let period = u64::from(self.register(ARR)) + 1;
        let high = u64::from(self.register(CCR1 + 4 * channel)).min(period);
        Some(((high * u64::from(FULL_SCALE) + period / 2) / period) as u16)
    }
}

/// Whether an access covers a register: as a word, or as the lower half of one, which is all of a 16-bit register.
fn covers(offset: u32, width: Width) -> bool {
    offset.is_multiple_of(4) && width != Width::Byte
}

impl Registers for PwmTimer {
    fn read(&mut self, offset: u32, width: Width) -> Result<u32, Unmodelled> {
        match offset {
            CR1..=CCR4 if covers(offset, width) => Ok(self.register(offset)),
            _ => Err(Unmodelled),
        }
    }

    fn write(&mut self, offset: u32, width: Width, value: u32) -> Result<(), Unmodelled> {
        match offset {
            _ if !covers(offset, width) => return Err(Unmodelled),
            // The update event loads preloaded registers, which take effect at once here.
            EGR => {}
            DIER if value != 0 => return Err(Unmodelled),
            CR1..=CCR4 => self.registers[offset as usize / 4] = value,
            _ => return Err(Unmodelled),
        }
        Ok(())
    }
}
