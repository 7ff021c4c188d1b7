//! Pins of the NUCLEO-L476RG (STM32L476RG): the one file to change for another wiring.
//!
//! | signal | pin | header | peripheral | wired to |
//! |---|---|---|---|---|
//! | serial TX / RX | PA2 / PA3 | ST-LINK | USART2 | virtual COM port of the ST-LINK |
//! | bridge X IN1 / IN2 | PB0 / PB1 | A3 / CN10-24 | TIM3 CH3 / CH4 | H-bridge of the X actuator |
//! | bridge Y IN1 / IN2 | PB10 / PB11 | D6 / CN10-18 | TIM2 CH3 / CH4 | H-bridge of the Y actuator |
//! | potentiometer X / Y | PA0 / PA1 | A0 / A1 | ADC1 IN5 / IN6 | wipers; supply and ground from the board's 3.3 V |
//! | converter SCK / MISO / MOSI | PB3 / PB4 / PB5 | D3 / D5 / D4 | SPI1 | ADS131M02 |
//! | converter CS | PB6 | D10 | GPIO | ADS131M02, low selects |
//! | converter data ready | PA10 | D2 | GPIO | ADS131M02, low is ready |
//! | emergency stop | PA4 | A2 | GPIO, pull-up | normally closed switch to ground: open, or a cut wire, is high and stops |
//! | status LED | PA5 | LD2 | GPIO | on the board, high lights |
//!
//! The SPI is not on D11 to D13, as D13 is the LED's pin. No input of a bridge is on a pin of the debug port (PA13 to PA15, PB3, PB4), which
//! the chip pulls up or down in reset.

use super::{BRIDGE_OUTPUT, clocks_without_crystal, pwm};
use crate::board::registers::{Register, register};
use assign_resources::assign_resources;
use embassy_stm32::interrupt::Interrupt;
use embassy_stm32::pac::gpio::Gpio;
use embassy_stm32::pac::{ADC1, GPIOA, GPIOB, TIM2, usart::Usart};
use embassy_stm32::timer::simple_pwm::{PwmPin, SimplePwmChannel};
use embassy_stm32::{Config, Peri, Peripherals, bind_interrupts, peripherals, usart};

/// The board's name in the hello.
pub const BOARD_NAME: &str = "NUCLEO-L476RG";

assign_resources! {
    bridges: BridgePins {
        timer_x: TIM3,
        x_in1: PB0,
        x_in2: PB1,
        timer_y: TIM2,
        y_in1: PB10,
        y_in2: PB11,
    }
    potentiometers: PotentiometerPins {
        adc: ADC1,
        x: PA0,
        y: PA1,
    }
    converter: ConverterPins {
        spi: SPI1,
        sck: PB3,
        miso: PB4,
        mosi: PB5,
        cs: PB6,
        data_ready: PA10,
    }
    stop: StopPins {
        emergency_stop: PA4,
    }
    serial: SerialPins {
        port: USART2,
        tx: PA2,
        rx: PA3,
    }
    panel: PanelPins {
        led: PA5,
        watchdog: IWDG,
    }
    store: StorePins {
        flash: FLASH,
    }
}

bind_interrupts!(pub(crate) struct Interrupts {
    USART2 => usart::BufferedInterruptHandler<peripherals::USART2>;
});

/// The serial port's interrupt.
pub const SERIAL_INTERRUPT: Interrupt = Interrupt::USART2;

/// The serial port's registers.
pub(crate) const SERIAL: Usart = embassy_stm32::pac::USART2;

/// The pins of both bridges, to be made low in any state.
pub(crate) const BRIDGES: [(Gpio, usize); 4] = [(GPIOB, 0), (GPIOB, 1), (GPIOB, 10), (GPIOB, 11)];

/// The peripherals by purpose.
pub(crate) fn assign(p: Peripherals) -> AssignedResources {
    split_resources!(p)
}

/// Clocks.
pub(crate) fn clocks() -> Config {
    clocks_without_crystal()
}

/// IN1 and IN2 of a bridge.
type Inputs<T> = [SimplePwmChannel<'static, T>; 2];

/// The inputs of both bridges.
pub(crate) fn bridges(pins: BridgePins) -> (Inputs<peripherals::TIM3>, Inputs<peripherals::TIM2>) {
    let (in1, in2) = (PwmPin::new(pins.x_in1, BRIDGE_OUTPUT), PwmPin::new(pins.x_in2, BRIDGE_OUTPUT));
    let x = pwm(pins.timer_x, None, Some(in1), Some(in2));
    let (in1, in2) = (PwmPin::new(pins.y_in1, BRIDGE_OUTPUT), PwmPin::new(pins.y_in2, BRIDGE_OUTPUT));
    let y = pwm(pins.timer_y, None, Some(in1), Some(in2));
    ([x.ch3, x.ch4], [y.ch3, y.ch4])
}

/// The registers whose contents depend on this board's pins.
pub(crate) const REGISTERS: [Register; 9] = [
    // 92.5 cycles for channels 5 and 6 [18.6.6], which the analog switches connect [8.5.12].
    register("ADC1.SMPR1", || ADC1.smpr(0).read().0, 0b11_1111 << 15, 0b10_1101 << 15),
    register("GPIOA.ASCR", || GPIOA.ascr().read().0, 0b11, 0b11),
    // Bridge Y: PWM mode 1, active high [31.4].
    register("TIM2.CCMR2", || TIM2.ccmr_output(1).read().0, 0x7373, 0x6060),
    register("TIM2.CCER", || TIM2.ccer().read().0, 0x2200, 0),
    // Pins of the bridges on their timers: PB0 and PB1 on TIM3 (AF2), PB10 and PB11 on TIM2 (AF1); PB3 to PB5 on SPI1 (AF5)
    // [8.5.9, 8.5.10].
    register("GPIOB.AFRL", || GPIOB.afr(0).read().0, 0xFF_F0FF, 0x55_5022),
    register("GPIOB.AFRH", || GPIOB.afr(1).read().0, 0xFF << 8, 0x11 << 8),
    // The serial port's pins, PA2 and PA3, on USART2 (AF7).
    register("GPIOA.AFRL", || GPIOA.afr(0).read().0, 0xFF << 8, 0x77 << 8),
    // The serial port runs from the undivided bus clock, as no other clock is chosen [6.4.28].
    register("RCC.CCIPR/USART2", || embassy_stm32::pac::RCC.ccipr().read().0, 0b11 << 2, 0),
    // 80 MHz / 460.8 kBaud, oversampled 16 times [40.8.4].
    register("USART2.BRR", || SERIAL.brr().read().0, 0xFFFF, 174),
];

/// Pins at which the emulation in QEMU finds the signals.
#[cfg(feature = "qemu")]
pub(crate) mod emulated {
    use embassy_stm32::pac::GPIOA;
    use embassy_stm32::pac::gpio::Gpio;

    /// Address of the serial port.
    pub(crate) const SERIAL_BASE: u32 = 0x4000_4400;
    /// Channels of the potentiometers.
    pub(crate) const CHANNELS: [u32; 2] = [5, 6];
    /// Channels of the timer of bridge Y, counted from 0.
    pub(crate) const BRIDGE_Y: [u32; 2] = [2, 3];
    /// Chip select of the force converter in port B.
    pub(crate) const CHIP_SELECT: u32 = 1 << 6;
    /// The emergency stop's pin.
    pub(crate) const EMERGENCY_STOP: (Gpio, usize) = (GPIOA, 4);
    /// The converter's data-ready pin.
    pub(crate) const DATA_READY: (Gpio, usize) = (GPIOA, 10);

    /// Whether the LED is lit: its pin is high, in a port that the emulation does not observe.
    pub(crate) fn led(_port_b: u32) -> bool {
        GPIOA.odr().read().odr(5) == embassy_stm32::pac::gpio::vals::Odr::HIGH
    }
}
