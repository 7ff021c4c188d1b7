//! Pins and clocks: a file for each board, chosen by a feature of its name, and what all boards share.
//!
//! A board's file states its pins by purpose, its serial port, the channels of its bridges, the registers whose contents depend on
//! the board, and the pins at which the emulation in QEMU finds the signals. The rest of the firmware is the same on every board.
//!
//! The bridges' inputs need pull-downs (integrated in the usual drivers): they hold the bridges off while the
//! microcontroller is in reset. Control runs in the interrupt of UART5, the background tasks in that of UART4; both peripherals
//! are unused.

#[cfg(all(feature = "b-l475e-iot01a", feature = "nucleo-l476rg"))]
compile_error!("an image is for one board: choose either `b-l475e-iot01a` or `nucleo-l476rg`");
#[cfg(not(any(feature = "b-l475e-iot01a", feature = "nucleo-l476rg")))]
compile_error!("choose the board by a feature: `b-l475e-iot01a` or `nucleo-l476rg`");

#[cfg(feature = "b-l475e-iot01a")]
mod b_l475e_iot01a;
#[cfg(all(feature = "nucleo-l476rg", not(feature = "b-l475e-iot01a")))]
mod nucleo_l476rg;

#[cfg(feature = "b-l475e-iot01a")]
pub use b_l475e_iot01a::*;
#[cfg(all(feature = "nucleo-l476rg", not(feature = "b-l475e-iot01a")))]
pub use nucleo_l476rg::*;

use embassy_stm32::gpio::OutputType;
use embassy_stm32::interrupt::Priority;
use embassy_stm32::time::Hertz;
use embassy_stm32::timer::GeneralInstance4Channel;
use embassy_stm32::timer::low_level::CountingMode;
use embassy_stm32::timer::simple_pwm::{PwmPin, SimplePwm, SimplePwmChannels};
use embassy_stm32::{Config, Peri, rcc};

/// Core, AHB and APB clock.
pub const CORE_CLOCK: Hertz = Hertz(80_000_000);
/// Speed of the serial port, 8N1.
pub const SERIAL_BAUD: u32 = 460_800;
/// Frequency of the bridges' PWM: above hearing, below the limit of the usual bridges.
pub const PWM_FREQUENCY: Hertz = Hertz(20_000);
/// Clock of the converter's SPI. The chip accepts 25 MHz, but jumper wires to a header do not carry that frequency.
pub const SPI_FREQUENCY: Hertz = Hertz(5_000_000);
/// Time without feeding after which the watchdog resets: a few control periods only, as a control task that hangs leaves the
/// bridges driven.
pub const WATCHDOG_TIMEOUT_US: u32 = 4_000;

/// Priority of the serial port. It is above control: at this speed a byte comes every 22 us and the receiver holds one.
pub const SERIAL_PRIORITY: Priority = Priority::P2;
/// Priority of the control task, below time and serial port.
pub const CONTROL_PRIORITY: Priority = Priority::P4;
/// Priority of the background tasks.
pub const BACKGROUND_PRIORITY: Priority = Priority::P6;

/// Size of the transmit buffer, bytes.
pub const SERIAL_SEND_BYTES: usize = 2048;
/// Size of the receive buffer, bytes.
pub const SERIAL_RECEIVE_BYTES: usize = 512;

/// Clocks without a crystal: the 16 MHz oscillator, multiplied to 80 MHz for everything; the converter runs from the system clock.
fn clocks_without_crystal() -> Config {
    let mut config = Config::default();
    config.rcc.hsi = true;
    config.rcc.pll = Some(rcc::Pll {
        source: rcc::PllSource::HSI,
        prediv: rcc::PllPreDiv::DIV1,
        mul: rcc::PllMul::MUL10,
        divp: None,
        divq: None,
        divr: Some(rcc::PllRDiv::DIV2),
    });
    config.rcc.sys = rcc::Sysclk::PLL1_R;
    config.rcc.mux.adcsel = rcc::mux::Adcsel::SYS;
    config
}

/// Pin of a bridge by its channel; none for an unused channel.
type Output<T, C> = Option<PwmPin<'static, T, C>>;

/// A timer at the bridges' frequency on its pins.
fn pwm<T: GeneralInstance4Channel>(
    timer: Peri<'static, T>,
    ch1: Output<T, embassy_stm32::timer::Ch1>,
    ch3: Output<T, embassy_stm32::timer::Ch3>,
    ch4: Output<T, embassy_stm32::timer::Ch4>,
) -> SimplePwmChannels<'static, T> {
    SimplePwm::new(timer, ch1, None, ch3, ch4, PWM_FREQUENCY, CountingMode::EdgeAlignedUp).split()
}

/// Output type of the bridges' inputs.
const BRIDGE_OUTPUT: OutputType = OutputType::PushPull;
