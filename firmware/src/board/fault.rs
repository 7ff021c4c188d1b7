//! Fatal errors: panics, hard faults and a stack overflow drive the bridges' inputs low, leave a message for the next run and
//! reset the chip.

use core::sync::atomic::{AtomicBool, Ordering};
use embassy_stm32::pac::FLASH;

/// Whether a panic restarts the program. A test program ends instead.
static RESTARTS: AtomicBool = AtomicBool::new(cfg!(not(any(feature = "qemu", feature = "conformance"))));

/// Whether a message was left. A panic while a panic is reported, or inside a log message, must not report again.
static REPORTED: AtomicBool = AtomicBool::new(false);

/// From here on a panic restarts the program, in QEMU too.
pub fn restart_on_panic() {
    RESTARTS.store(true, Ordering::Relaxed);
}

/// Ends this run.
fn stop() -> ! {
    #[cfg(any(feature = "qemu", feature = "conformance"))]
    if !RESTARTS.load(Ordering::Relaxed) {
        crate::exit::exit(crate::exit::ExitCode::Panic);
    }
    // Time for the probe to fetch the message: about 100 ms.
    #[cfg(not(feature = "qemu"))]
    cortex_m::asm::delay(super::pins::CORE_CLOCK.0 / 10);
    cortex_m::peripheral::SCB::sys_reset()
}

#[panic_handler]
fn panic(info: &core::panic::PanicInfo) -> ! {
    cortex_m::interrupt::disable();
    super::bridges::hold_off();
    if !REPORTED.swap(true, Ordering::Relaxed) {
        leave(info);
        defmt::error!("{}", defmt::Display2Format(info));
    }
    stop()
}

/// Leaves location and message for the next run: the location first, as a long message is cut off.
fn leave(info: &core::panic::PanicInfo) {
    match info.location() {
        Some(place) => super::retained::leave_panic(&format_args!("{place}: {}", info.message())),
        None => super::retained::leave_panic(&info.message()),
    }
}

/// An assertion of defmt, which has logged its text, ends the run too. The drivers' own panics are such assertions. The text is not
/// available here, but without a message the next run would take the reset for a requested one, and would report no fault.
#[defmt::panic_handler]
fn defmt_panic() -> ! {
    cortex_m::interrupt::disable();
    super::bridges::hold_off();
    if !REPORTED.swap(true, Ordering::Relaxed) {
        super::retained::leave_panic(&"an assertion of a driver failed: its text is in the log");
    }
    stop()
}

/// Flash whose programming was interrupted has an uncorrectable ECC error, which the chip reports here on reading. The flag is
/// cleared; the reader rejects the data by its own checksum.
#[cortex_m_rt::exception]
unsafe fn NonMaskableInt() {
    let damaged = FLASH.eccr().read().eccd();
    FLASH.eccr().modify(|w| w.set_eccd(true));
    if !damaged {
        panic!("unexpected non-maskable interrupt");
    }
}

/// A hard fault that ends the run. After a stack overflow its exception frame may be missing.
pub(crate) fn hard_fault(status: u32, address: u32, pc: u32) -> ! {
    super::bridges::hold_off();
    if super::guard::is_hit(status, address) {
        super::retained::leave_panic(&"stack overflow");
        defmt::error!("stack overflow");
    } else {
        super::retained::leave_panic(&format_args!("hard fault at {pc:#010x}, status {status:#010x}"));
        defmt::error!("hard fault at {=u32:#010x}, status {=u32:#010x}", pc, status);
    }
    stop()
}

#[cfg(not(feature = "qemu"))]
#[cortex_m_rt::exception]
unsafe fn HardFault(frame: &cortex_m_rt::ExceptionFrame) -> ! {
    // SAFETY: fault status registers, which nothing else reads.
    let (status, address) = unsafe {
        let scb = &*cortex_m::peripheral::SCB::PTR;
        (scb.cfsr.read(), scb.mmfar.read())
    };
    hard_fault(status, address, frame.pc())
}
