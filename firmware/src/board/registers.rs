//! Registers that determine speed, accuracy and safety, read back after the start.
//!
//! Their required contents are stated here in bits, from the chip's reference manual (RM0351, sections in brackets);
//! the drivers set them from frequencies and modes. The log states every value at the start, and a test converts it to
//! frequencies and times and compares these. If a register has another content, the device restarts, and its next hello
//! names the register.

use super::pins;
use embassy_stm32::pac::{ADC1, FLASH, IWDG, PWR, RCC, SPI1, TIM2, TIM3};

/// A register with its relevant bits.
pub(crate) struct Register {
    name: &'static str,
    read: fn() -> u32,
    /// Mask of the relevant bits.
    mask: u32,
    /// Required content.
    expected: u32,
}

/// A register with its name, its relevant bits and their required content.
pub(crate) const fn register(name: &'static str, read: fn() -> u32, mask: u32, expected: u32) -> Register {
    Register { name, read, mask, expected }
}

/// Registers that are the same on every board. The others are in the board's file of pins.
const REGISTERS: [Register; 17] = [
    // Voltage range 1, without which 80 MHz is too fast [5.4.1].
    register("PWR.CR1", || PWR.cr1().read().0, 0b11 << 9, 0b01 << 9),
    // Four wait states at 80 MHz in range 1 [3.3.3].
    register("FLASH.ACR", || FLASH.acr().read().0, 0b111, 4),
    // 16 MHz oscillator, divided by 1, times 10, divided by 2, output R on [6.4.4].
    register("RCC.PLLCFGR", || RCC.pllcfgr().read().0, 0x0700_7F73, 0x0100_0A02),
    // System clock from the PLL; core, APB1 and APB2 undivided [6.4.3].
    register("RCC.CFGR", || RCC.cfgr().read().0, 0x3FFC, 0b11 << 2),
    // The converter of the potentiometers runs from the system clock [6.4.28].
    register("RCC.CCIPR", || RCC.ccipr().read().0, 0b11 << 28, 0b11 << 28),
    // Eight conversions averaged: oversampling on, ratio 8, shifted by 3 [18.6.5].
    register("ADC1.CFGR2", || ADC1.cfgr2().read().0, 0x1FF, 3 << 5 | 2 << 2 | 1),
    // Twelve bits, right-aligned, single conversions [18.6.4].
    register("ADC1.CFGR", || ADC1.cfgr().read().0, 0x2038, 0),
    // Bridges: 80 MHz / 4000 = 20 kHz, counting up, PWM mode 1, active high [31.4].
    register("TIM3.PSC", || u32::from(TIM3.psc().read()), 0xFFFF, 0),
    register("TIM3.ARR", || TIM3.arr().read().0, 0xFFFF, 3_999),
    register("TIM3.CR1", || TIM3.cr1().read().0, 0x71, 1),
    register("TIM3.CCMR2", || TIM3.ccmr_output(1).read().0, 0x7373, 0x6060),
    register("TIM3.CCER", || TIM3.ccer().read().0, 0x2200, 0),
    register("TIM2.PSC", || u32::from(TIM2.psc().read()), 0xFFFF, 0),
    register("TIM2.ARR", || TIM2.arr().read(), 0xFFFF_FFFF, 3_999),
    register("TIM2.CR1", || TIM2.cr1().read().0, 0x71, 1),
    // Master in mode 1 (clock idles low, data on its second edge) at 80 MHz / 16 = 5 MHz, highest bit first [42.6.1].
    register("SPI1.CR1", || SPI1.cr1().read().0, 0xBF, 0b0001_1101),
    // 32 counts of 32 kHz / 4: 4 ms [32.4].
    register(
        "IWDG.RLR",
        || u32::from(IWDG.rlr().read().rl()) << 8 | IWDG.pr().read().0 & 7,
        0xF_FFFF,
        31 << 8,
    ),
];

/// Brown-out reset level in the option bytes [3.4.1]: a supply below it resets the chip.
const fn brown_out_level(options: u32) -> u32 {
    options >> 8 & 0b111
}

/// The highest level that a supply of 3.3 V allows: reset below 2.8 V. New chips have level 0, 1.7 V.
const BROWN_OUT_LEVEL: u32 = 4;

/// Reads all registers back. Call it when everything runs.
///
/// # Panics
/// If a register does not have its required content.
pub fn verify() {
    for register in REGISTERS.iter().chain(&pins::REGISTERS) {
        let value = (register.read)();
        defmt::info!("register {=str} {=u32:#010x}", register.name, value);
        if value & register.mask != register.expected {
            panic!("{} reads {value:#010x}, expected {:#010x}", register.name, register.expected);
        }
    }
    let options = FLASH.optr().read().0;
    defmt::info!("register FLASH.OPTR {=u32:#010x}", options);
    let level = brown_out_level(options);
    if level < BROWN_OUT_LEVEL {
        defmt::warn!(
            "brown-out reset at level {=u32}, expected {=u32} (2.8 V): set the option bytes",
            level,
            BROWN_OUT_LEVEL
        );
    }
}
