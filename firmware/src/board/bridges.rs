//! The bridges' inputs without any driver, for the end of a run.

use super::pins::BRIDGES;
use embassy_stm32::pac::gpio::vals::Moder;

/// Makes the pins of both bridges plain outputs and drives them low, in any state of the drivers.
pub(super) fn hold_off() {
    for (port, pin) in BRIDGES {
        port.bsrr().write(|w| w.set_br(pin, true));
        port.moder().modify(|w| w.set_moder(pin, Moder::OUTPUT));
    }
}
