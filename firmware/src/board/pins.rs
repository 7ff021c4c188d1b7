//! Pins, rates and priorities of the B-L475E-IOT01A (STM32L475VG): the one file to change for another wiring.
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
//! The bridges' inputs need pull-downs (integrated in the usual drivers): they hold the bridges off while the
//! microcontroller is in reset. Control runs in the interrupt of a peripheral that is not used, UART5, the tasks around it in
//! that of UART4.

use embassy_stm32::interrupt::Priority;
use embassy_stm32::time::Hertz;

/// Core, AHB and APB clock.
pub const CORE_CLOCK: Hertz = Hertz(80_000_000);
/// The board's name in the hello.
pub const BOARD_NAME: &str = "B-L475E-IOT01A";
/// Speed of the serial port, 8N1.
pub const SERIAL_BAUD: u32 = 460_800;
/// Frequency of the bridges' PWM: above hearing, below the limit of the usual bridges.
pub const PWM_FREQUENCY: Hertz = Hertz(20_000);
/// Clock of the converter's SPI; the chip takes 25 MHz, wires to a header less.
pub const SPI_FREQUENCY: Hertz = Hertz(5_000_000);
/// Time without feeding after which the watchdog resets: a few control periods, as a control task that hangs leaves the
/// bridges as they are.
pub const WATCHDOG_TIMEOUT_US: u32 = 4_000;

/// Priority of the serial port. It is above control: at this speed a byte comes every 22 us and the receiver holds one.
pub const SERIAL_PRIORITY: Priority = Priority::P2;
/// Priority of the control task, below time and serial port.
pub const CONTROL_PRIORITY: Priority = Priority::P4;
/// Priority of the tasks around it.
pub const BACKGROUND_PRIORITY: Priority = Priority::P6;

/// Room for bytes to be sent.
pub const SERIAL_SEND_BYTES: usize = 2048;
/// Room for bytes received.
pub const SERIAL_RECEIVE_BYTES: usize = 512;
