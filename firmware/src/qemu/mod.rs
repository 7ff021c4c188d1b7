//! Runs the board's own drivers in stock QEMU (`-machine b-l475e-iot01a`), against a simulated plant. The NUCLEO-L476RG runs on the same
//! machine: its STM32L476 differs from the STM32L475 in an LCD controller and in pins, which QEMU does not model.
//!
//! QEMU models the core, the clocks, GPIO and the serial port of this board, but no timers, converters, SPI, power
//! control or watchdog. No-access regions of the memory protection unit cover the registers that it lacks. Every access to them
//! faults; the fault handler decodes the instruction, performs it on a software model of the peripheral and returns to the next
//! instruction ([`trap`]). The drivers need no change. One exchange per millisecond sends their commands to the plant and
//! returns its sensor values ([`time`], [`link`]).
//!
//! One [`Machine`] holds all models. It is reached from the fault handler and from the SysTick handler only; the latter
//! masks interrupts and touches no trapped register meanwhile, so the two never overlap.

mod link;
mod peripherals;
mod stopwatch;
mod time;
mod trap;

pub use crate::exit::{ExitCode, exit};
pub use link::Recording;
pub use stopwatch::Stopwatch;
pub use time::{end_period, start_time};

use crate::board::pins::emulated;
use core::cell::UnsafeCell;
use emulation::plant::{PlantReply, PlantRequest};
use emulation::thumb::Width;
use peripherals::{Adc, Flash, Gpio, Iwdg, PwmTimer, Pwr, Rcc, Spi, UniqueId, Usart};

/// A register access that the models do not cover.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Unmodelled;

/// Register access to one peripheral; offsets count from its base.
pub(crate) trait Registers {
    /// Returns the value that a load reads.
    fn read(&mut self, offset: u32, width: Width) -> Result<u32, Unmodelled>;
    /// Carries out a store.
    fn write(&mut self, offset: u32, width: Width, value: u32) -> Result<(), Unmodelled>;
}

/// All modelled peripherals.
struct Machine {
    pwr: Pwr,
    rcc: Rcc,
    flash: Flash,
    bridge_x: PwmTimer,
    bridge_y: PwmTimer,
    adc: Adc,
    spi: Spi,
    iwdg: Iwdg,
    usart: Usart,
    gpio: Gpio,
    unique_id: UniqueId,
}

impl Machine {
    const fn new() -> Self {
        Self {
            pwr: Pwr::new(),
            rcc: Rcc::new(),
            flash: Flash::new(),
            bridge_x: PwmTimer::new(),
            bridge_y: PwmTimer::new(),
            adc: Adc::new(),
            spi: Spi::new(),
            iwdg: Iwdg::new(),
            usart: Usart::new(),
            gpio: Gpio::new(),
            unique_id: UniqueId::new(),
        }
    }

    /// The peripheral at an address, and the offset in it.
    fn find(&mut self, address: u32) -> Option<(&mut dyn Registers, u32)> {
        let offset = address & 0x3FF;
        let peripheral: &mut dyn Registers = match address & !0x3FF {
            0x4000_0000 => &mut self.bridge_y,
            0x4000_0400 => &mut self.bridge_x,
            0x4000_3000 => &mut self.iwdg,
            0x4000_7000 => &mut self.pwr,
            0x4001_3000 => &mut self.spi,
            emulated::SERIAL_BASE => &mut self.usart,
            0x1FFF_7400 => &mut self.unique_id,
            0x4002_1000 => &mut self.rcc,
            0x4002_2000 => &mut self.flash,
            0x4800_0400 => &mut self.gpio,
            0x5004_0000 => &mut self.adc,
            _ if address & !0x1FFF == peripherals::PAGE => return Some((&mut self.flash, address)),
            _ => return None,
        };
        Some((peripheral, offset))
    }

    fn read(&mut self, address: u32, width: Width) -> Result<u32, Unmodelled> {
        let (peripheral, offset) = self.find(address).ok_or(Unmodelled)?;
        peripheral.read(offset, width)
    }

    fn write(&mut self, address: u32, width: Width, value: u32) -> Result<(), Unmodelled> {
        let (peripheral, offset) = self.find(address).ok_or(Unmodelled)?;
        peripheral.write(offset, width, value)?;
        // The one wire between two peripherals: the chip select of the force converter.
        match self.gpio.take_chip_select_edge() {
            Some(true) => self.spi.converter.deselect(),
            Some(false) => self.spi.converter.select(),
            None => {}
        }
        Ok(())
    }

    /// Commands of the program, for the plant.
    fn request(&mut self, step: u32) -> PlantRequest {
        // Bridge X is on the channels 3 and 4 of its timer.
        let [y_in1, y_in2] = emulated::BRIDGE_Y;
        let outputs = [
            self.bridge_x.output(2),
            self.bridge_x.output(3),
            self.bridge_y.output(y_in1),
            self.bridge_y.output(y_in2),
        ];
        PlantRequest {
            step,
            compare: outputs.map(|output| output.unwrap_or(0)),
            led: self.gpio.led(),
            watchdog_fed: self.iwdg.take_fed(),
            bridges_enabled: outputs.iter().all(Option::is_some),
        }
    }

    /// Sensor values of the plant, for the program.
    fn latch(&mut self, reply: &PlantReply) {
        self.adc.potentiometer_codes = reply.potentiometer_codes;
        self.adc.conversion_us = reply.potentiometer_conversion_us;
        if reply.reset_force_converter {
            self.spi.converter.reset();
        }
        if reply.corrupt_force_crc {
            self.spi.converter.corrupt_next_crc();
        }
        self.spi.converter.sample(reply.force_codes, reply.force_ready);
        peripherals::drive_inputs(reply.emergency_stop, !reply.force_ready);
    }
}

/// The machine; the documentation of this module states who may use it.
struct Shared(UnsafeCell<Machine>);

// SAFETY: `with_machine` is the only access, and its callers never overlap.
unsafe impl Sync for Shared {}

static MACHINE: Shared = Shared(UnsafeCell::new(Machine::new()));

/// Gives access to the machine.
///
/// # Safety
/// Only the fault handler may call this, or code with interrupts masked; `work` must not touch a trapped register.
unsafe fn with_machine<R>(work: impl FnOnce(&mut Machine) -> R) -> R {
    // SAFETY: the fault handler preempts everything but itself, and runs only when a trapped register is touched; with
    // interrupts masked nothing else runs. So there is one reference at a time.
    work(unsafe { &mut *MACHINE.0.get() })
}

/// Puts the models in place; call it before the first access to any peripheral.
pub fn install() {
    let reset_flags = peripherals::take_reset_flags();
    // SAFETY: nothing else runs yet, and the flags are no trapped register.
    unsafe {
        with_machine(|machine| {
            machine.rcc.reset_flags = reset_flags;
            machine.flash.power_on();
            machine.unique_id.power_on();
        });
    }
    trap::protect();
}
