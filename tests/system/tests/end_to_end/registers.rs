//! The registers that the image for the board sets up, as the drivers have set them in QEMU: the quantities that they mean, computed from
//! their bits by the formulas of the reference manual (RM0351), against what the board needs.

use std::collections::BTreeMap;
use system::bench::Bench;
use system::qemu::HANGS;

/// The registers that the firmware's log names.
fn registers() -> BTreeMap<String, u32> {
    let bench = Bench::start(system::readme::rig::quiet(), 61, f64::INFINITY, HANGS).unwrap();
    super::library::eventually("the registers are read back", || {
        bench.log().iter().any(|line| line.contains("register FLASH.OPTR"))
    });
    let log = bench.stop().unwrap();
    let named = |line: &String| {
        let (name, value) = line.split_once("register ")?.1.split_once(" 0x")?;
        let digits = value.get(..8)?;
        Some((name.to_owned(), u32::from_str_radix(digits, 16).ok()?))
    };
    log.iter().filter_map(named).collect()
}

#[test]
#[ignore = "needs QEMU: cargo xtask test runs it"]
fn the_registers_mean_the_rates_and_modes_that_the_board_needs() {
    let registers = registers();
    let bits = |name: &str, low: u32, count: u32| {
        let value = registers.get(name).unwrap_or_else(|| panic!("{name} is not in {registers:x?}"));
        value >> low & (u32::MAX >> (32 - count))
    };
    // Clock tree: HSI16 / M * N / R; the system clock is the PLL's, undivided; range 1 and four wait states carry it.
    assert_eq!(bits("RCC.PLLCFGR", 0, 2), 0b10, "the PLL runs from the 16 MHz oscillator");
    let [m, n] = [bits("RCC.PLLCFGR", 4, 3) + 1, bits("RCC.PLLCFGR", 8, 7)];
    let r = 2 * (bits("RCC.PLLCFGR", 25, 2) + 1);
    assert_eq!(bits("RCC.PLLCFGR", 24, 1), 1, "its output R is on");
    let [vco_in_mhz, vco_mhz] = [16 / m, 16 / m * n];
    assert!((4..=16).contains(&vco_in_mhz) && (64..=344).contains(&vco_mhz), "{vco_in_mhz}, {vco_mhz} MHz");
    let core_hz = f64::from(vco_mhz / r) * 1e6;
    assert_eq!(core_hz, 80e6);
    assert_eq!(bits("RCC.CFGR", 2, 2), 0b11, "the PLL is the system clock");
    for (low, count) in [(4, 4), (8, 3), (11, 3)] {
        assert!(bits("RCC.CFGR", low, count) < 1 << (count - 1), "a bus is divided");
    }
    assert_eq!(bits("PWR.CR1", 9, 2), 0b01, "voltage range 1: up to 80 MHz");
    // One wait state for every 16 MHz in range 1.
    assert_eq!(f64::from(bits("FLASH.ACR", 0, 3)), (core_hz / 16e6).ceil() - 1.0);

    // The converter: the capacitor of 5 pF settles to a quarter of a code through 1 kOhm of its switch and 4 kOhm of a potentiometer of
    // 16 kOhm in its middle: 14 bits, or 9.7 time constants; the data sheet allows 92.5 cycles at 80 MHz up to 15 kOhm and more.
    const CYCLES: [f64; 8] = [2.5, 6.5, 12.5, 24.5, 47.5, 92.5, 247.5, 640.5];
    assert_eq!(bits("RCC.CCIPR", 28, 2), 0b11, "the converter runs from the system clock");
    for channel in [13, 14] {
        let cycles = CYCLES[bits("ADC1.SMPR2", 3 * (channel - 10), 3) as usize];
        let (settles_s, takes_s) = (14.0 * 2f64.ln() * 5e3 * 5e-12, cycles / core_hz);
        assert!(takes_s > 4.0 * settles_s, "{takes_s} s, {settles_s} s to settle");
        // Eight of both, averaged, leave most of the period to control.
        assert!(2.0 * 8.0 * (cycles + 12.5) / core_hz < 0.05e-3);
    }
    assert_eq!(bits("ADC1.CFGR", 3, 2), 0, "twelve bits");
    let (on, ratio, shift) =
        (bits("ADC1.CFGR2", 0, 1), 2 << bits("ADC1.CFGR2", 2, 3), bits("ADC1.CFGR2", 5, 4));
    assert_eq!((on, ratio >> shift), (1, 1), "the sum of {ratio} conversions is shifted to their mean");

    // Bridges: 20 kHz, edge-aligned, counting up, PWM mode 1, active high: a pin that is low or floating is off.
    for (timer, modes) in [("TIM3", [("CCMR2", 4), ("CCMR2", 12)]), ("TIM2", [("CCMR1", 4), ("CCMR2", 4)])] {
        let of = |name: &str| format!("{timer}.{name}");
        let period = f64::from((bits(&of("PSC"), 0, 16) + 1) * (bits(&of("ARR"), 0, 16) + 1));
        assert_eq!(core_hz / period, 20e3, "{timer}");
        assert_eq!((bits(&of("CR1"), 0, 1), bits(&of("CR1"), 4, 3)), (1, 0), "{timer} counts up");
        for (register, low) in modes {
            assert_eq!(bits(&of(register), low, 3), 6, "{timer}.{register}");
        }
    }
    assert_eq!((bits("TIM3.CCER", 9, 1), bits("TIM3.CCER", 13, 1)), (0, 0), "X is active high");
    assert_eq!((bits("TIM2.CCER", 1, 1), bits("TIM2.CCER", 9, 1)), (0, 0), "Y is active high");
    assert_eq!((bits("GPIOB.AFRL", 0, 4), bits("GPIOB.AFRL", 4, 4)), (2, 2), "PB0 and PB1 are TIM3's");
    assert_eq!(bits("GPIOA.AFRH", 28, 4), 1, "PA15 is TIM2's");

    // The force converter takes data on the falling edge of a clock that idles low, 25 MHz at most.
    assert_eq!((bits("SPI1.CR1", 0, 1), bits("SPI1.CR1", 1, 1)), (1, 0), "mode 1");
    assert_eq!((bits("SPI1.CR1", 2, 1), bits("SPI1.CR1", 7, 1)), (1, 0), "master, highest bit first");
    assert_eq!(core_hz / f64::from(2 << bits("SPI1.CR1", 3, 3)), 5e6);

    // A receiver takes 3.75 % together with the other end's error.
    let baud = core_hz / f64::from(bits("USART1.BRR", 0, 16));
    assert!((baud / 460_800.0 - 1.0).abs() < 0.005, "{baud}");

    // The watchdog is slower than a control period and faster than a motor runs away: 32 kHz within 10 %.
    let timeout_s = f64::from(bits("IWDG.RLR", 8, 12) + 1) * f64::from(4 << bits("IWDG.RLR", 0, 3)) / 32e3;
    assert!((timeout_s - 4e-3).abs() < 0.1e-3, "{timeout_s} s");
    assert_eq!(bits("FLASH.OPTR", 8, 3), 4, "the simulated board has its brown-out level set");
}
