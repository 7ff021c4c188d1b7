//! Pins of the B-L475E-IOT01A (STM32L475VG): the one file to change for another wiring.
//!
//! | signal | pin | header | peripheral | wired to |
//! |---|---|---|---|---|
//! | serial TX / RX | PB6 / PB7 | ST-LINK | USART1 | virtual COM port of the ST-LINK |
//! | bridge X IN1 / IN2 | PB0 / PB1 | D3 / D6 | TIM3 CH3 / CH4 | H-bridge of the X actuator |
//! | bridge Y IN1 / IN2 | PA15 / PA2 | D9 / D10 | TIM2 CH1 / CH3 | H-bridge of the Y actuator |
//! | potentiometer X / Y | PC5 / PC4 | A0 / A1 | ADC1 IN14 / IN13 | wipers; supply and ground from the board's 3.3 V |
//! | converter SCK / MISO / MOSI | PA5 / PA6 / PA7 | D13 / D12 / D11 | SPI1 | ADS131M02 |
//! | converter CS | PB2 | D8 | GPIO | ADS131M02, low selects |
//! | converter data ready | PD14 | D2 | GPIO | ADS131M02, low is ready |
//! | emergency stop | PC2 | A3 | GPIO, pull-up | normally closed switch to ground: open, or a cut wire, is high and stops |
//! | status LED | PB14 | LD2 | GPIO | on the board, high lights |
//!
//! PA15 is also a pin of the debug port, which the chip pulls up by 25 to 55 kOhm in reset [8.4.1]: against a pull-down of 100 kOhm
//! in a bridge's input that is a high level, so that this input needs a pull-down of 4.7 kOhm of its own.

use super::{BRIDGE_OUTPUT, clocks_without_crystal, pwm};
use crate::board::registers::{Register, register};
use assign_resources::assign_resources;
use embassy_stm32::interrupt::Interrupt;
use embassy_stm32::pac::gpio::Gpio;
use embassy_stm32::pac::{ADC1, GPIOA, GPIOB, GPIOC, TIM2, usart::Usart};
use embassy_stm32::timer::simple_pwm::{PwmPin, SimplePwmChannel};
use embassy_stm32::{Config, Peri, Peripherals, bind_interrupts, peripherals, usart};

/// The board's name in the hello.
pub const BOARD_NAME: &str = "B-L475E-IOT01A";

assign_resources! {
    bridges: BridgePins {
        timer_x: TIM3,
        x_in1: PB0,
        x_in2: PB1,
        timer_y: TIM2,
        y_in1: PA15,
        y_in2: PA2,
    }
    potentiometers: PotentiometerPins {
        adc: ADC1,
        x: PC5,
        y: PC4,
    }
    converter: ConverterPins {
        spi: SPI1,
        sck: PA5,
        miso: PA6,
        mosi: PA7,
        cs: PB2,
        data_ready: PD14,
    }
    stop: StopPins {
        emergency_stop: PC2,
    }
    serial: SerialPins {
        port: USART1,
        tx: PB6,
        rx: PB7,
    }
    panel: PanelPins {
        led: PB14,
        watchdog: IWDG,
    }
    store: StorePins {
        flash: FLASH,
    }
}

bind_interrupts!(pub(crate) struct Interrupts {
    USART1 => usart::BufferedInterruptHandler<peripherals::USART1>;
});

/// The serial port's interrupt.
pub const SERIAL_INTERRUPT: Interrupt = Interrupt::USART1;

/// The serial port's registers.
pub(crate) const SERIAL: Usart = embassy_stm32::pac::USART1;

/// The pins of both bridges, to be made low in any state.
pub(crate) const BRIDGES: [(Gpio, usize); 4] = [(GPIOB, 0), (GPIOB, 1), (GPIOA, 15), (GPIOA, 2)];

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
    let y = pwm(pins.timer_y, Some(in1), Some(in2), None);
    ([x.ch3, x.ch4], [y.ch1, y.ch3])
}

/// The registers whose contents depend on this board's pins.
pub(crate) const REGISTERS: [Register; 8] = [
    // 92.5 cycles for channels 13 and 14 [18.6.7], which the analog switches connect [8.5.12].
    register("ADC1.SMPR2", || ADC1.smpr(1).read().0, 0b11_1111 << 9, 0b10_1101 << 9),
    register("GPIOC.ASCR", || GPIOC.ascr().read().0, 0b11 << 4, 0b11 << 4),
    // Bridge Y: PWM mode 1, active high [31.4].
    register("TIM2.CCMR1", || TIM2.ccmr_output(0).read().0, 0x0073, 0x0060),
    register("TIM2.CCMR2", || TIM2.ccmr_output(1).read().0, 0x0073, 0x0060),
    register("TIM2.CCER", || TIM2.ccer().read().0, 0x0202, 0),
    // Pins of the bridges on their timers: PB0 and PB1 on TIM3 (AF2), PA15 and PA2 on TIM2 (AF1) [8.5.9, 8.5.10].
    register("GPIOB.AFRL", || GPIOB.afr(0).read().0, 0xFF, 0x22),
    register("GPIOA.AFRH", || GPIOA.afr(1).read().0, 0xF << 28, 1 << 28),
    // 80 MHz / 460.8 kBaud, oversampled 16 times [40.8.4].
    register("USART1.BRR", || SERIAL.brr().read().0, 0xFFFF, 174),
];

/// Pins at which the emulation in QEMU finds the signals.
#[cfg(feature = "qemu")]
pub(crate) mod emulated {
    use embassy_stm32::pac::gpio::Gpio;
    use embassy_stm32::pac::{GPIOC, GPIOD};

    /// Address of the serial port.
    pub(crate) const SERIAL_BASE: u32 = 0x4001_3800;
    /// Channels of the potentiometers.
    pub(crate) const CHANNELS: [u32; 2] = [14, 13];
    /// Channels of the timer of bridge Y, counted from 0.
    pub(crate) const BRIDGE_Y: [u32; 2] = [0, 2];
    /// Chip select of the force converter in port B.
    pub(crate) const CHIP_SELECT: u32 = 1 << 2;
    /// The emergency stop's pin.
    pub(crate) const EMERGENCY_STOP: (Gpio, usize) = (GPIOC, 2);
    /// The converter's data-ready pin.
    pub(crate) const DATA_READY: (Gpio, usize) = (GPIOD, 14);

    /// Whether the LED is lit: its pin is high in port B, whose output is given.
    pub(crate) fn led(port_b: u32) -> bool {
        port_b & 1 << 14 != 0
    }
}
