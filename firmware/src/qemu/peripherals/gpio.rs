//! GPIO: observes port B for the chip select and the LED, and sets two inputs to the plant's levels.
//!
//! QEMU models GPIO, so accesses to port B are passed on and only observed. The inputs need no trap: QEMU gives an input
//! that nothing drives the level of its pull resistor, so the model sets the level by the pin's pull.

use crate::board::pins::emulated;
use crate::qemu::{Registers, Unmodelled};
use embassy_stm32::pac::gpio::vals::Pupdr;
use embassy_stm32::pac::{GPIOB, gpio};
use emulation::thumb::Width;

/// Registers of a port: MODER to ASCR.
const LAST: u32 = 0x2C;

/// Port B.
pub(crate) struct Gpio {
    /// Output data register as last read.
    output: u32,
    /// Level of the chip select after its last change, until taken.
    edge: Option<bool>,
}

impl Gpio {
    pub(crate) const fn new() -> Self {
        Self { output: 0, edge: None }
    }

    /// Whether the LED is lit.
    pub(crate) fn led(&self) -> bool {
        emulated::led(self.output)
    }

    /// Takes the level to which the chip select has changed since the last call, if it has.
    pub(crate) fn take_chip_select_edge(&mut self) -> Option<bool> {
        self.edge.take()
    }
}

/// A register of port B in QEMU's model.
fn port_b(offset: u32) -> *mut u32 {
    GPIOB.as_ptr().cast::<u32>().wrapping_add(offset as usize / 4)
}

impl Registers for Gpio {
    fn read(&mut self, offset: u32, width: Width) -> Result<u32, Unmodelled> {
        if width != Width::Word || offset > LAST {
            return Err(Unmodelled);
        }
        // SAFETY: a register of port B; reading one has no effect.
        Ok(unsafe { port_b(offset).read_volatile() })
    }

    fn write(&mut self, offset: u32, width: Width, value: u32) -> Result<(), Unmodelled> {
        if width != Width::Word || offset > LAST {
            return Err(Unmodelled);
        }
        // SAFETY: the program writes this register of port B, and the write is carried out for it.
        unsafe { port_b(offset).write_volatile(value) };
        let output = GPIOB.odr().read().0;
        if (output ^ self.output) & emulated::CHIP_SELECT != 0 {
            self.edge = Some(output & emulated::CHIP_SELECT != 0);
        }
        self.output = output;
        Ok(())
    }
}

/// Puts the levels on the emergency-stop line and the data-ready line.
pub(crate) fn drive_inputs(emergency_stop_high: bool, data_ready_high: bool) {
    pull(emulated::EMERGENCY_STOP, emergency_stop_high);
    pull(emulated::DATA_READY, data_ready_high);
}

/// Pulls a pin.
fn pull((port, pin): (gpio::Gpio, usize), high: bool) {
    let pull = if high { Pupdr::PULL_UP } else { Pupdr::PULL_DOWN };
    if port.pupdr().read().pupdr(pin) != pull {
        port.pupdr().modify(|w| w.set_pupdr(pin, pull));
    }
}
