//! The registers of the second board, whose image the first tier does not build.

use crate::in_minutes::registers::{baud, bits, registers, sampling, shared};
use system::images::Board;

#[test]
#[ignore = "needs QEMU: cargo xtask test --all runs it"]
fn the_registers_mean_the_rates_and_modes_that_the_nucleo_needs() {
    let registers = registers(Board::NucleoL476rg);
    let bits = |name: &str, low: u32, count: u32| bits(&registers, name, low, count);
    shared(&bits);
    // The potentiometers: channels 5 and 6 of the converter, on PA0 and PA1.
    sampling(bits("ADC1.SMPR1", 15, 3));
    sampling(bits("ADC1.SMPR1", 18, 3));
    assert_eq!(bits("GPIOA.ASCR", 0, 2), 0b11, "the analog switches of PA0 and PA1 are closed");
    // Bridge Y: channels 3 and 4 of its timer.
    assert_eq!((bits("TIM2.CCMR2", 4, 3), bits("TIM2.CCMR2", 12, 3)), (6, 6));
    assert_eq!((bits("TIM2.CCER", 9, 1), bits("TIM2.CCER", 13, 1)), (0, 0), "Y is active high");
    assert_eq!((bits("GPIOB.AFRL", 0, 4), bits("GPIOB.AFRL", 4, 4)), (2, 2), "PB0 and PB1 are TIM3's");
    assert_eq!((bits("GPIOB.AFRH", 8, 4), bits("GPIOB.AFRH", 12, 4)), (1, 1), "PB10 and PB11 are TIM2's");
    for pin in 3..6 {
        assert_eq!(bits("GPIOB.AFRL", 4 * pin, 4), 5, "PB{pin} is SPI1's");
    }
    assert_eq!((bits("GPIOA.AFRL", 8, 4), bits("GPIOA.AFRL", 12, 4)), (7, 7), "PA2 and PA3 are USART2's");
    assert_eq!(bits("RCC.CCIPR/USART2", 2, 2), 0, "the serial port runs from its bus");
    baud(bits("USART2.BRR", 0, 16));
}
