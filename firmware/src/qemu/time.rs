//! Time in QEMU: SysTick, one plant exchange per millisecond.
//!
//! The SysTick handler first exchanges the commands for the sensed values, then wakes the tasks that are due. Device
//! time is the number of exchanges plus the part of the running period, so it advances with the plant's steps and not
//! with the computer's clock. Tasks are woken at whole milliseconds.
//!
//! (The `systick-timer` crate does almost this. It scales by a rounded factor, which puts the time at a tick just short
//! of the whole millisecond, and has a fixed number of wake-up slots that stale time-outs fill.)

use super::link::Link;
use super::{peripherals, with_machine};
use crate::board::pins::CORE_CLOCK;
use crate::plant::PERIOD_US;
use core::cell::{Cell, RefCell};
use core::task::Waker;
use cortex_m::interrupt::{CriticalSection, Mutex};
use cortex_m::peripheral::{SCB, SYST, syst::SystClkSource};
use embassy_time_driver::Driver;
use embassy_time_queue_utils::Queue;

/// Core clocks per microsecond.
const CLOCKS_PER_US: u32 = CORE_CLOCK.0 / 1_000_000;
/// SysTick counts from this down to zero.
const RELOAD: u32 = PERIOD_US * CLOCKS_PER_US - 1;

/// The time driver.
struct SysTickTime {
    /// Exchanges so far.
    steps: Mutex<Cell<u32>>,
    link: Mutex<RefCell<Option<Link>>>,
    queue: Mutex<RefCell<Queue>>,
}

embassy_time_driver::time_driver_impl!(static TIME: SysTickTime = SysTickTime {
    steps: Mutex::new(Cell::new(0)),
    link: Mutex::new(RefCell::new(None)),
    queue: Mutex::new(RefCell::new(Queue::new())),
});

impl SysTickTime {
    /// Microseconds since the start, interrupts masked.
    fn now_masked(&self, cs: &CriticalSection) -> u64 {
        let mut count = SYST::get_current();
        let mut steps = u64::from(self.steps.borrow(cs).get());
        if SCB::is_pendst_pending() {
            // The period ended, before or after the count was read; the count of the new one is.
            count = SYST::get_current();
            steps += 1;
        }
        steps * u64::from(PERIOD_US) + u64::from((RELOAD - count) / CLOCKS_PER_US)
    }

    /// One period ends.
    fn tick(&self, cs: &CriticalSection) {
        let step = self.steps.borrow(cs).get();
        self.steps.borrow(cs).set(step + 1);
        let mut link = self.link.borrow(cs).borrow_mut();
        let Some(link) = link.as_mut() else { return };
        // SAFETY: interrupts are masked, and the models' commands and inputs are not trapped registers.
        let request = unsafe { with_machine(|machine| machine.request(step)) };
        let reply = link.exchange(&request);
        // SAFETY: as above.
        let expired = unsafe {
            with_machine(|machine| {
                machine.latch(&reply);
                machine.iwdg.elapse(PERIOD_US)
            })
        };
        if expired {
            peripherals::watchdog_reset();
        }
    }
}

impl Driver for SysTickTime {
    fn now(&self) -> u64 {
        cortex_m::interrupt::free(|cs| self.now_masked(cs))
    }

    fn schedule_wake(&self, at: u64, waker: &Waker) {
        cortex_m::interrupt::free(|cs| {
            let mut queue = self.queue.borrow(cs).borrow_mut();
            if queue.schedule_wake(at, waker) {
                // What is due already is woken now; the rest at its tick.
                queue.next_expiration(self.now_masked(cs));
            }
        });
    }
}

/// Opens the link to the plant and starts time; after the clocks are set.
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

#[cortex_m_rt::exception]
fn SysTick() {
    cortex_m::interrupt::free(|cs| {
        TIME.tick(cs);
        TIME.queue.borrow(cs).borrow_mut().next_expiration(TIME.now_masked(cs));
    });
}
