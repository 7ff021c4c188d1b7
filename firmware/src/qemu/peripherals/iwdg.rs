//! The independent watchdog, and the reset flags that report its resets.
//!
//! Counts plant time; when it is not fed in time, the core is reset, and a mark in memory that survives the reset
//! becomes the watchdog's flag in CSR at the next start; brown-outs work the same way. The window function is refused.

use crate::qemu::{Registers, Unmodelled};
use core::mem::MaybeUninit;
use core::ptr;
use embassy_stm32::pac::rcc::regs::Csr;
use emulation::thumb::Width;

const KR: u32 = 0x00;
const PR: u32 = 0x04;
const RLR: u32 = 0x08;
const SR: u32 = 0x0C;

const KEY_UNLOCK: u32 = 0x5555;
const KEY_FEED: u32 = 0xAAAA;
const KEY_START: u32 = 0xCCCC;

/// Frequency of the low-speed oscillator in kHz.
const CLOCK_KHZ: u32 = 32;

/// The watchdog.
pub(crate) struct Iwdg {
    running: bool,
    unlocked: bool,
    fed: bool,
    prescaler: u32,
    reload: u32,
    elapsed_us: u32,
}

impl Iwdg {
    pub(crate) const fn new() -> Self {
        Self { running: false, unlocked: false, fed: false, prescaler: 0, reload: 0xFFF, elapsed_us: 0 }
    }

    /// Time passes; true if the watchdog resets the chip.
    pub(crate) fn elapse(&mut self, period_us: u32) -> bool {
        let timeout_us = (self.reload + 1) * (4 << self.prescaler) * 1000 / CLOCK_KHZ;
        self.elapsed_us = if self.running { self.elapsed_us + period_us } else { 0 };
        self.elapsed_us > timeout_us
    }

    /// Whether it was fed since the last call.
    pub(crate) fn take_fed(&mut self) -> bool {
        core::mem::take(&mut self.fed)
    }
}

impl Registers for Iwdg {
    fn read(&mut self, offset: u32, width: Width) -> Result<u32, Unmodelled> {
        match (width, offset) {
            (Width::Word, PR) => Ok(self.prescaler),
            (Width::Word, RLR) => Ok(self.reload),
            // No update is ever under way.
            (Width::Word, SR) => Ok(0),
            _ => Err(Unmodelled),
        }
    }

    fn write(&mut self, offset: u32, width: Width, value: u32) -> Result<(), Unmodelled> {
        match (width, offset, value) {
            (Width::Word, KR, KEY_UNLOCK) => self.unlocked = true,
            (Width::Word, KR, KEY_FEED | KEY_START) => {
                self.unlocked = false;
                self.running |= value == KEY_START;
                self.fed = true;
                self.elapsed_us = 0;
            }
            (Width::Word, PR, _) if self.unlocked => self.prescaler = (value & 7).min(6),
            (Width::Word, RLR, _) if self.unlocked => self.reload = value & 0xFFF,
            _ => return Err(Unmodelled),
        }
        Ok(())
    }
}

/// Left in memory before a watchdog reset.
const WATCHDOG_MARK: u32 = 0x7764_6F67;
/// Left in memory before a brown-out reset.
const BROWN_OUT_MARK: u32 = 0x6272_6F77;
/// Left in memory by every start: a start that finds it follows a reset by software.
const RUNNING_MARK: u32 = 0x7275_6E6E;

/// Survives a reset of the core.
#[unsafe(link_section = ".uninit.mark")]
static mut MARK: MaybeUninit<u32> = MaybeUninit::uninit();

/// Exchanges the mark.
fn replace_mark(new: u32) -> u32 {
    let mark = ptr::addr_of_mut!(MARK).cast::<u32>();
    // SAFETY: volatile accesses to a word that only this function uses, at start-up and with interrupts masked; any bit
    // pattern is valid.
    unsafe {
        let old = mark.read_volatile();
        mark.write_volatile(new);
        old
    }
}

/// Resets the core as the watchdog does.
pub(crate) fn watchdog_reset() -> ! {
    defmt::error!("watchdog: not fed in time, reset");
    replace_mark(WATCHDOG_MARK);
    cortex_m::peripheral::SCB::sys_reset()
}

/// Resets the core as a sagging supply does that recovers before the memory loses its content.
pub(crate) fn brown_out_reset() -> ! {
    defmt::error!("brown-out: reset");
    replace_mark(BROWN_OUT_MARK);
    cortex_m::peripheral::SCB::sys_reset()
}

/// The flags of the last reset; call it once per start. Power-on and brown-out share a flag, as in the chip.
pub(crate) fn take_reset_flags() -> Csr {
    let mark = replace_mark(RUNNING_MARK);
    let mut flags = Csr(0);
    flags.set_borrstf(mark != WATCHDOG_MARK && mark != RUNNING_MARK);
    flags.set_iwdgrstf(mark == WATCHDOG_MARK);
    flags.set_sftrstf(mark == RUNNING_MARK);
    // Every reset drives the pin too.
    flags.set_pinrstf(true);
    flags
}
