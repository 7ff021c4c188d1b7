//! The end of the road: panics and, on the board, hard faults put the bridges' inputs low and reset.

use core::sync::atomic::{AtomicBool, Ordering};
use embassy_stm32::pac::gpio::vals::Moder;
use embassy_stm32::pac::{GPIOA, GPIOB};

/// Makes the pins of both bridges plain outputs and drives them low, whatever state the drivers are in.
pub(crate) fn hold_bridges_off() {
    for (port, pin) in [(GPIOB, 0), (GPIOB, 1), (GPIOA, 15), (GPIOA, 2)] {
        port.bsrr().write(|w| w.set_br(pin, true));
        port.moder().modify(|w| w.set_moder(pin, Moder::OUTPUT));
    }
}

/// Stops for good: in QEMU with exit code 101, on the board with a reset.
fn stop() -> ! {
    #[cfg(feature = "qemu")]
    crate::qemu::exit(crate::qemu::ExitCode::Panic);
    #[cfg(not(feature = "qemu"))]
    {
        // Time for the probe to fetch the message: about 100 ms.
        cortex_m::asm::delay(super::pins::CORE_CLOCK.0 / 10);
        cortex_m::peripheral::SCB::sys_reset()
    }
}

#[panic_handler]
fn panic(info: &core::panic::PanicInfo) -> ! {
    cortex_m::interrupt::disable();
    hold_bridges_off();
    // A panic while reporting a panic, or inside a log message, must not report again.
    static REPORTED: AtomicBool = AtomicBool::new(false);
    if !REPORTED.swap(true, Ordering::Relaxed) {
        defmt::error!("{}", defmt::Display2Format(info));
    }
    stop()
}

/// The panic of defmt's assertions is the panic.
#[defmt::panic_handler]
fn defmt_panic() -> ! {
    cortex_m::interrupt::disable();
    hold_bridges_off();
    stop()
}

#[cfg(not(feature = "qemu"))]
#[cortex_m_rt::exception]
unsafe fn HardFault(frame: &cortex_m_rt::ExceptionFrame) -> ! {
    hold_bridges_off();
    defmt::error!("hard fault at {=u32:#010x}", frame.pc());
    stop()
}
