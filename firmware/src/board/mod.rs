//! The board: clocks, drivers and start-up. A feature chooses the board ([`pins`]).
//!
//! [`take`] starts the board once and returns the parts; the drivers are those of `embassy-stm32` and are the same on the board
//! and in QEMU. The image for QEMU has a layer below the drivers that emulates the peripherals which QEMU lacks, and takes the
//! time from SysTick instead of TIM5.

mod actuators;
mod boot;
mod bridges;
pub(crate) mod fault;
pub(crate) mod guard;
mod panel;
pub(crate) mod pins;
mod registers;
mod retained;
mod sensors;
mod store;

pub use actuators::BoardActuators;
pub use boot::BootInfo;
pub use fault::restart_on_panic;
pub use panel::BoardPanel;
pub use registers::verify as verify_registers;
pub use retained::{keep, restart_with, runs};
pub use sensors::BoardSensors;
pub use store::{STORE_BYTES, Store, StoreError};

use control::Origin;
use control::calibration::Calibration;
use control::slots::{self, SLOTS, STORED_BYTES, StoredSlots};
use control::starts;
use embassy_executor::{InterruptExecutor, SendSpawner};
use embassy_stm32::interrupt::{self, InterruptExt};
use embassy_stm32::usart::{self, BufferedUart};
use protocol::CalibrationRecord;
use static_cell::StaticCell;

/// The serial port to the host.
pub type Serial = BufferedUart<'static>;

/// The parts of the board that the program uses.
pub struct Board {
    /// Potentiometers, force converter, emergency stop.
    pub sensors: BoardSensors,
    /// The two bridges, released.
    pub actuators: BoardActuators,
    /// LED and watchdog; the watchdog runs.
    pub panel: BoardPanel,
    /// Serial port to the host.
    pub serial: Serial,
    /// Constants of the rig: the stored ones, or those of the rig as designed.
    pub calibration: Calibration,
    /// Source of the calibration.
    pub origin: Origin,
    /// Identity of this boot, and its cause.
    pub boot: BootInfo,
    /// Runs tasks at control priority.
    pub control: SendSpawner,
    /// Runs tasks at the lowest priority.
    pub background: SendSpawner,
}

/// Runs the control task in the interrupt of UART5, which is otherwise unused.
static CONTROL: InterruptExecutor = InterruptExecutor::new();

#[cortex_m_rt::interrupt]
fn UART5() {
    // SAFETY: this is the executor's interrupt, enabled by `CONTROL.start` only.
    unsafe { CONTROL.on_interrupt() }
}

/// Runs everything else in the interrupt of UART4, which is unused too, so that thread mode only runs [`crate::app::idle`]. (The
/// idle loop of a thread-mode executor waits for an event, at which QEMU does not sleep.)
static BACKGROUND: InterruptExecutor = InterruptExecutor::new();

#[cortex_m_rt::interrupt]
fn UART4() {
    // SAFETY: this is the executor's interrupt, enabled by `BACKGROUND.start` only.
    unsafe { BACKGROUND.on_interrupt() }
}

/// Starts the board; call it once.
pub fn take() -> Board {
    #[cfg(feature = "qemu")]
    crate::qemu::install();
    let (mut boot, to_store) = boot::read();
    // Painted while the stack is nearly empty: its depth is measured from here.
    cortex_m_stack::repaint_stack();
    guard::close();
    let mut pins = pins::assign(embassy_stm32::init(pins::clocks()));
    #[cfg(feature = "qemu")]
    crate::qemu::start_time();

    // The watchdog does not run yet, so that writing to the flash may take longer than the watchdog's limit.
    let mut store = Store::new(pins.store.flash);
    boot.boot_id = boot::boot_id(count_start(&mut store));
    let (calibration, origin) = calibration(store, to_store);
    panel::watch_start(&mut pins.panel.watchdog);
    let actuators = BoardActuators::new(pins.bridges);
    let sensors = BoardSensors::new(pins.potentiometers, pins.converter, pins.stop, boot.is_blind);

    static SEND: StaticCell<[u8; pins::SERIAL_SEND_BYTES]> = StaticCell::new();
    static RECEIVE: StaticCell<[u8; pins::SERIAL_RECEIVE_BYTES]> = StaticCell::new();
    let mut serial_config = usart::Config::default();
    serial_config.baudrate = pins::SERIAL_BAUD;
    // Wake the reader at every byte: QEMU never reports an idle line, and commands are short.
    serial_config.eager_reads = Some(1);
    pins::SERIAL_INTERRUPT.set_priority(pins::SERIAL_PRIORITY);
    let serial = BufferedUart::new(
        pins.serial.port,
        pins.serial.rx,
        pins.serial.tx,
        SEND.init([0; pins::SERIAL_SEND_BYTES]),
        RECEIVE.init([0; pins::SERIAL_RECEIVE_BYTES]),
        pins::Interrupts,
        serial_config,
    )
    .expect("the serial port's rate is reachable");

    interrupt::UART5.set_priority(pins::CONTROL_PRIORITY);
    let control = CONTROL.start(interrupt::UART5);
    interrupt::UART4.set_priority(pins::BACKGROUND_PRIORITY);
    let background = BACKGROUND.start(interrupt::UART4);
    let panel = BoardPanel::new(pins.panel);
    Board { sensors, actuators, panel, serial, calibration, origin, boot, control, background }
}

/// Counts this start in the flash and returns its number.
fn count_start(store: &mut Store) -> u32 {
    let mut pages = [[0; STORE_BYTES]; starts::PAGES];
    for (page, bytes) in (SLOTS..).zip(&mut pages) {
        store.read(page, bytes);
    }
    let next = starts::next(&pages);
    let counted = if next.erases { store.erase(SLOTS + next.page) } else { Ok(()) }
        .and_then(|()| store.append(SLOTS + next.page, next.offset, &starts::to_stored(next.count)));
    if let Err(error) = counted {
        defmt::error!("the start was not counted: {}", error);
    }
    next.count
}

/// Stores a new calibration, if there is one, and reads the stored one. Without a valid record the constants are those of the
/// rig as designed, which the hello reports.
fn calibration(mut store: Store, to_store: Option<CalibrationRecord>) -> (Calibration, Origin) {
    // A new record goes into the page that is not in use, so that a power cut at any time leaves one record intact.
    let choice = match to_store {
        Some(record) => slots::store(&mut store, &record),
        None => slots::choose(&store.contents()),
    };
    match choice.origin {
        Origin::Stored => {}
        Origin::Earlier => defmt::error!("a calibration beside the one that is used cannot be read any more"),
        Origin::Nominal => defmt::warn!("no calibration is stored: that of the rig as designed is used"),
        Origin::Lost => {
            defmt::error!("the stored calibration cannot be used: that of the rig as designed is used")
        }
    }
    (choice.calibration, choice.origin)
}

impl StoredSlots for Store {
    fn contents(&mut self) -> [[u8; STORED_BYTES]; SLOTS] {
        let mut stored = [[0; STORED_BYTES]; SLOTS];
        for (slot, stored) in stored.iter_mut().enumerate() {
            self.read(slot, stored);
        }
        stored
    }

    fn replace(&mut self, slot: usize, stored: &[u8; STORED_BYTES]) {
        if let Err(error) = self.write(slot, stored) {
            defmt::error!("the calibration was not stored: {}", error);
        }
    }
}
