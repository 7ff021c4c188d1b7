//! The registers that the image of each board sets up, as the drivers have set them in QEMU: the quantities that they mean, computed from
//! their bits by the formulas of the reference manual (RM0351), against what the rig needs.

use std::collections::BTreeMap;
use system::bench::Bench;
use system::images::Board;

/// The registers that the firmware's log names.
pub fn registers(board: Board) -> BTreeMap<String, u32> {
    let bench = Bench::on(board, system::readme::rig::quiet(), 61, f64::INFINITY).unwrap();
    super::library::eventually("the registers are read back", || {
        bench.log().iter().any(|line| line.contains("register FLASH.OPTR"))
    });
    let log = bench.stop().unwrap();
    log.iter()
        .filter_map(|line| {
            let (name, value) = line.split_once("register ")?.1.split_once(" 0x")?;
            let digits = value.get(..8)?;
            Some((name.to_owned(), u32::from_str_radix(digits, 16).ok()?))
        })
        .collect()
}

#[test]
#[ignore = "needs QEMU: cargo xtask test runs it"]
fn the_registers_mean_the_rates_and_modes_that_the_first_board_needs() {
    let registers = registers(Board::BL475eIot01a);
    let bits = |name: &str, low: u32, count: u32| bits(&registers, name, low, count);
    shared(&bits);
    // The potentiometers: channels 13 and 14 of the converter, on PC4 and PC5.
    sampling(bits("ADC1.SMPR2", 9, 3));
    sampling(bits("ADC1.SMPR2", 12, 3));
    assert_eq!(bits("GPIOC.ASCR", 4, 2), 0b11, "the analog switches of PC4 and PC5 are closed");
    // Bridge Y: channels 1 and 3 of its timer, PWM mode 1, active high.
    assert_eq!((bits("TIM2.CCMR1", 4, 3), bits("TIM2.CCMR2", 4, 3)), (6, 6));
    assert_eq!((bits("TIM2.CCER", 1, 1), bits("TIM2.CCER", 9, 1)), (0, 0), "Y is active high");
    assert_eq!((bits("GPIOB.AFRL", 0, 4), bits("GPIOB.AFRL", 4, 4)), (2, 2), "PB0 and PB1 are TIM3's");
    assert_eq!(bits("GPIOA.AFRH", 28, 4), 1, "PA15 is TIM2's");
    baud(bits("USART1.BRR", 0, 16));
}

/// Bits of a register that the log names.
pub fn bits(registers: &BTreeMap<String, u32>, name: &str, low: u32, count: u32) -> u32 {
    let value = registers.get(name).unwrap_or_else(|| panic!("{name} is not in {registers:x?}"));
    value >> low & (u32::MAX >> (32 - count))
}

/// Core clock, as the test of the clock tree asserts.
const CORE_HZ: f64 = 80e6;

/// The sampling time of a potentiometer's channel: the capacitor of 5 pF settles to a quarter of a code through 1 kOhm of its switch and
/// 4 kOhm of a potentiometer of 16 kOhm in its middle: 14 bits, or 9.7 time constants; the data sheet allows 92.5 cycles at 80 MHz up to
/// 15 kOhm and more.
pub fn sampling(code: u32) {
    const CYCLES: [f64; 8] = [2.5, 6.5, 12.5, 24.5, 47.5, 92.5, 247.5, 640.5];
    let cycles = CYCLES[code as usize];
    let (settles_s, takes_s) = (14.0 * 2f64.ln() * 5e3 * 5e-12, cycles / CORE_HZ);
    assert!(takes_s > 4.0 * settles_s, "{takes_s} s, {settles_s} s to settle");
    // Eight of both, averaged, leave most of the period to control.
    assert!(2.0 * 8.0 * (cycles + 12.5) / CORE_HZ < 0.05e-3);
}

/// The serial port's rate: a receiver takes 3.75 % together with the other end's error.
pub fn baud(divider: u32) {
    let baud = CORE_HZ / f64::from(divider);
    assert!((baud / 460_800.0 - 1.0).abs() < 0.005, "{baud}");
}

/// Contents that are the same on every board.
pub fn shared(bits: &dyn Fn(&str, u32, u32) -> u32) {
    // Clock tree: HSI16 / M * N / R; the system clock is the PLL's, undivided; range 1 and four wait states carry it.
    assert_eq!(bits("RCC.PLLCFGR", 0, 2), 0b10, "the PLL runs from the 16 MHz oscillator");
    let [m, n] = [bits("RCC.PLLCFGR", 4, 3) + 1, bits("RCC.PLLCFGR", 8, 7)];
    let r = 2 * (bits("RCC.PLLCFGR", 25, 2) + 1);
    assert_eq!(bits("RCC.PLLCFGR", 24, 1), 1, "its output R is on");
    let [vco_in_mhz, vco_mhz] = [16 / m, 16 / m * n];
    assert!((4..=16).contains(&vco_in_mhz) && (64..=344).contains(&vco_mhz), "{vco_in_mhz}, {vco_mhz} MHz");
    let core_hz = f64::from(vco_mhz / r) * 1e6;
    assert_eq!(core_hz, CORE_HZ);
    assert_eq!(bits("RCC.CFGR", 2, 2), 0b11, "the PLL is the system clock");
    for (low, count) in [(4, 4), (8, 3), (11, 3)] {
        assert!(bits("RCC.CFGR", low, count) < 1 << (count - 1), "a bus is divided");
    }
    assert_eq!(bits("PWR.CR1", 9, 2), 0b01, "voltage range 1: up to 80 MHz");
    // One wait state for every 16 MHz in range 1.
    assert_eq!(f64::from(bits("FLASH.ACR", 0, 3)), (core_hz / 16e6).ceil() - 1.0);

    assert_eq!(bits("RCC.CCIPR", 28, 2), 0b11, "the converter runs from the system clock");
    assert_eq!(bits("ADC1.CFGR", 3, 2), 0, "twelve bits");
    let (oversampling, ratio, shift) =
        (bits("ADC1.CFGR2", 0, 1), 2 << bits("ADC1.CFGR2", 2, 3), bits("ADC1.CFGR2", 5, 4));
    assert_eq!(
        (oversampling, ratio >> shift),
        (1, 1),
        "the sum of {ratio} conversions is shifted to their mean"
    );

    // Bridges: 20 kHz, edge-aligned, counting up, PWM mode 1, active high: a pin that is low or floating is off.
    for timer in ["TIM3", "TIM2"] {
        let period = f64::from(
            (bits(&register("PSC", timer), 0, 16) + 1) * (bits(&register("ARR", timer), 0, 16) + 1),
        );
        assert_eq!(core_hz / period, 20e3, "{timer}");
        assert_eq!(
            (bits(&register("CR1", timer), 0, 1), bits(&register("CR1", timer), 4, 3)),
            (1, 0),
            "{timer} counts up"
        );
    }
    assert_eq!((bits("TIM3.CCMR2", 4, 3), bits("TIM3.CCMR2", 12, 3)), (6, 6));
    assert_eq!((bits("TIM3.CCER", 9, 1), bits("TIM3.CCER", 13, 1)), (0, 0), "X is active high");

    // The force converter takes data on the falling edge of a clock that idles low, 25 MHz at most.
    assert_eq!((bits("SPI1.CR1", 0, 1), bits("SPI1.CR1", 1, 1)), (1, 0), "mode 1");
    assert_eq!((bits("SPI1.CR1", 2, 1), bits("SPI1.CR1", 7, 1)), (1, 0), "master, highest bit first");
    assert_eq!(core_hz / f64::from(2 << bits("SPI1.CR1", 3, 3)), 5e6);

    // The watchdog is slower than a control period and faster than a motor runs away: 32 kHz within 10 %.
    let timeout_s = f64::from(bits("IWDG.RLR", 8, 12) + 1) * f64::from(4 << bits("IWDG.RLR", 0, 3)) / 32e3;
    assert!((timeout_s - 4e-3).abs() < 0.1e-3, "{timeout_s} s");
    assert_eq!(bits("FLASH.OPTR", 8, 3), 4, "the simulated board has its brown-out level set");
}

fn register(name: &str, timer: &str) -> String {
    format!("{timer}.{name}")
}
