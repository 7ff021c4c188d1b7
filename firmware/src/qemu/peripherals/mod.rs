//! Software models of the peripherals that QEMU lacks, or models differently from the chip.
//!
//! Each model has the functions that the drivers of this project need, which its documentation lists, and refuses all others, so
//! that a driver that uses another function ends with an error instead of reading zeros.

mod adc;
mod flash;
mod gpio;
mod iwdg;
mod plain;
mod pwm_timer;
mod rcc;
mod spi;
mod usart;

pub(super) use adc::Adc;
pub(super) use flash::{Flash, PAGE, power_off};
pub(super) use gpio::{Gpio, drive_inputs};
pub(super) use iwdg::{Iwdg, brown_out_reset, take_reset_flags, watchdog_reset};
pub(super) use plain::{Pwr, UniqueId};
pub(super) use pwm_timer::PwmTimer;
pub(super) use rcc::Rcc;
pub(super) use spi::Spi;
pub(super) use usart::Usart;
