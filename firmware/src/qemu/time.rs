//! Time in QEMU: SysTick, one plant exchange per millisecond.
//!
//! The SysTick handler first exchanges the commands for the sensed values, then wakes the tasks that are due. Device
//! time is the number of exchanges plus the part of the running period, so it advances with the plant's steps and not
//! with the computer's clock. Tasks are woken at whole milliseconds.
//!
//! (The `systick-timer` crate does almost this. Its scale is a rounded factor, so that a tick falls just before the whole
//! millisecond, and expired time-outs fill its fixed number of wake-up slots.)

use super::link::Link;
use super::{peripherals, with_machine};
use crate::board::pins::{CORE_CLOCK, SERIAL};
use core::cell::RefCell;
use core::sync::atomic::{AtomicU32, Ordering};
use core::task::Waker;
use cortex_m::interrupt::{CriticalSection, Mutex};
use cortex_m::peripheral::{SCB, SYST, syst::SystClkSource};
use embassy_time_driver::Driver;
use embassy_time_queue_utils::Queue;
use emulation::plant::PERIOD_US;

/// Core clocks per microsecond.
const CLOCKS_PER_US: u32 = CORE_CLOCK.0 / 1_000_000;
/// SysTick counts from this down to zero.
const RELOAD: u32 = PERIOD_US * CLOCKS_PER_US - 1;

/// More instructions than one clock of the counter lasts: 12.5 ns, at 4 ns for each.
const CLOCK_INSTRUCTIONS: u32 = 16;

/// The time driver.
struct SysTickTime {
    link: Mutex<RefCell<Option<Link>>>,
    queue: Mutex<RefCell<Queue>>,
}

embassy_time_driver::time_driver_impl!(static TIME: SysTickTime = SysTickTime {
    link: Mutex::new(RefCell::new(None)),
    queue: Mutex::new(RefCell::new(Queue::new())),
});

/// Exchanges so far. An atomic, because the fault handler reads it in any context.
static STEPS: AtomicU32 = AtomicU32::new(0);

/// Microseconds since the start; for code that the SysTick handler cannot interrupt: with interrupts masked, or in the
/// fault handler.
pub(super) fn now_us() -> u64 {
    let mut count = SYST::get_current();
    let mut steps = u64::from(STEPS.load(Ordering::Relaxed));
    if SCB::is_pendst_pending() {
        // The period ended before or after the first reading of the count, so that the count of the new period is read.
        count = SYST::get_current();
        steps += 1;
    }
    steps * u64::from(PERIOD_US) + u64::from((RELOAD - count) / CLOCKS_PER_US)
}

impl SysTickTime {
    /// One period ends.
    fn tick(&self, cs: &CriticalSection) {
        let step = STEPS.load(Ordering::Relaxed);
        STEPS.store(step + 1, Ordering::Relaxed);
        let mut link = self.link.borrow(cs).borrow_mut();
        let Some(link) = link.as_mut() else { return };
        // SAFETY: interrupts are masked, and the models' commands and inputs are not trapped registers.
        let request = unsafe { with_machine(|machine| machine.request(step)) };
        let reply = link.exchange(&request);
        // SAFETY: as above.
        let (expired, waiting) = unsafe {
            with_machine(|machine| {
                machine.latch(&reply);
                (machine.iwdg.elapse(PERIOD_US), machine.usart.refill(reply.line_bytes))
            })
        };
        if reply.panic {
            panic!("the plant requests a panic");
        }
        if reply.driver_panic {
            defmt::panic!("the plant requests a panic of a driver");
        }
        if reply.stack_overflow {
            use_up_the_stack(0);
        }
        if reply.brown_out {
            peripherals::brown_out_reset();
        }
        if expired {
            peripherals::watchdog_reset();
        }
        if let Some(byte) = waiting {
            // The register is trapped, so that the model counts this byte like any other.
            SERIAL.tdr().write(|w| w.0 = byte);
        }
    }
}

/// Calls itself until the stack overflows.
#[inline(never)]
#[allow(unconditional_recursion, reason = "its purpose is a stack overflow")]
fn use_up_the_stack(depth: u32) -> u32 {
    let block = core::hint::black_box([depth; 32]);
    use_up_the_stack(depth.wrapping_add(1)).wrapping_add(block[0])
}

impl Driver for SysTickTime {
    fn now(&self) -> u64 {
        cortex_m::interrupt::free(|_| now_us())
    }

    fn schedule_wake(&self, at: u64, waker: &Waker) {
        cortex_m::interrupt::free(|cs| {
            let mut queue = self.queue.borrow(cs).borrow_mut();
            if queue.schedule_wake(at, waker) {
                // Due alarms are woken now; the others at their tick.
                queue.next_expiration(now_us());
            }
        });
    }
}

/// Opens the link to the plant and starts time; call it after the clocks are set.
pub fn start_time() {
    cortex_m::interrupt::free(|cs| *TIME.link.borrow(cs).borrow_mut() = Some(Link::open()));
    // SAFETY: SysTick is used here only.
    let mut systick = unsafe { cortex_m::Peripherals::steal() }.SYST;
    systick.set_clock_source(SystClkSource::Core);
    systick.set_reload(RELOAD);
    systick.clear_current();
    systick.enable_interrupt();
    systick.enable_counter();
}

/// Ends the running period at once if no exception is pending; call it with interrupts masked.
///
/// In QEMU a sleeping core takes far more time than a running one: the main loop has to wake up, advance the clock and wake the
/// core's thread, which on a virtual machine is most of the time of a period. Only the end of the period could wake it anyway:
/// converters and bus are modelled without interrupts, and the computer decides when bytes of the serial line arrive.
pub fn end_period() {
    /// Exceptions are pending, SysTick's among them: ICSR.ISRPENDING and PENDSTSET.
    const PENDING: u32 = 1 << 22 | 1 << 26;
    // SAFETY: a read of a status register.
    let pending = unsafe { (*SCB::PTR).icsr.read() } & PENDING;
    if pending != 0 {
        return;
    }
    // SAFETY: SysTick belongs to this module, and no handler of it runs with interrupts masked.
    unsafe { cortex_m::Peripherals::steal() }.SYST.clear_current();
    SCB::set_pendst();
    // The counter is at zero until its next clock, which would be the end of a period.
    cortex_m::asm::delay(CLOCK_INSTRUCTIONS);
}

#[cortex_m_rt::exception]
fn SysTick() {
    cortex_m::interrupt::free(|cs| {
        TIME.tick(cs);
        TIME.queue.borrow(cs).borrow_mut().next_expiration(now_us());
    });
}
