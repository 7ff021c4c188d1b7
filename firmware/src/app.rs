//! The program: four tasks around the controller, the same on the board and in QEMU.
//!
//! | task | priority | owns | does |
//! |---|---|---|---|
//! | control | interrupt | sensors, actuators, panel, controller | one control period every millisecond |
//! | receive | background | receiving half of the serial port | bytes to commands |
//! | send | background | sending half of the serial port | the control task's output to frames |
//! | housekeep | background | nothing | reads the registers back; measures the stack; restarts with a new calibration |
//!
//! Commands go to the control task through [`COMMANDS`], everything it sends goes to the send task through [`OUTBOX`], in
//! order. The control task never waits for either: when the link is slow, whole batches of samples are dropped and counted
//! ([`control::telemetry`]). It feeds the watchdog as long as all background tasks check in at least once in
//! [`CHECK_IN_LIMIT_PERIODS`], so that no task can hang unnoticed.

mod link;

use crate::board::{self, Board, BoardActuators, BoardPanel, BoardSensors};
use control::calibration::Calibration;
use control::hal::{Actuators, Panel, Sensors};
use control::telemetry::{Item, Outbox, Telemetry};
use control::{Controller, Drive, Inputs, OutboundMessage, PERIOD_US, REPORT_PERIODS, Start};
use core::cell::Cell;
use core::sync::atomic::{AtomicU8, AtomicU32, Ordering};
use defmt::{Debug2Format, error, info, warn};
use embassy_sync::blocking_mutex::Mutex;
use embassy_sync::blocking_mutex::raw::CriticalSectionRawMutex;
use embassy_sync::channel::Channel;
use embassy_sync::signal::Signal;
use embassy_time::{Duration, Instant, Timer, with_timeout};
use protocol::{CalibrationRecord, Command, Counters, EventKind, Load};
use static_cell::StaticCell;

/// Number of entries of the outbox: half a second of batches, and some for answers and events.
const OUTBOX_PLACES: usize = 24;
const PERIOD: Duration = Duration::from_micros(PERIOD_US as u64);
/// Part of every period that is reserved for the background tasks: three times the time that they need while a host sends requests
/// without a pause.
const RESERVED: Duration = Duration::from_micros(200);
/// Longest interval between two check-ins of a background task.
const CHECK_IN: Duration = Duration::from_millis(25);
/// Longest time without a check-in of every background task for which the watchdog is still fed, periods.
pub const CHECK_IN_LIMIT_PERIODS: u32 = 100;

static COMMANDS: Channel<CriticalSectionRawMutex, Command, 4> = Channel::new();
static OUTBOX: Channel<CriticalSectionRawMutex, Item, OUTBOX_PLACES> = Channel::new();
/// A calibration to restart with.
static RESTART: Signal<CriticalSectionRawMutex, CalibrationRecord> = Signal::new();
/// Counters of the receive task; its other counters are zero.
static RECEIVE_COUNTERS: Mutex<CriticalSectionRawMutex, Cell<Counters>> = Mutex::new(Cell::new(NO_COUNTERS));
const NO_COUNTERS: Counters = Counters {
    samples_dropped: 0,
    messages_dropped: 0,
    frames_corrupt: 0,
    frames_overlong: 0,
    frames_unreadable: 0,
    force_readings_bad: 0,
    control_overruns: 0,
    line_errors: 0,
    force_corrupt: 0,
    force_missing: 0,
    force_resets: 0,
    force_saturated: 0,
    faults: 0,
};
/// Idle time since it was last read, microseconds.
static IDLE_US: AtomicU32 = AtomicU32::new(0);
/// Number of bytes of the stack that were never used.
static STACK_FREE_BYTES: AtomicU32 = AtomicU32::new(0);
/// Background tasks that have checked in since the control task last looked.
static CHECKED_IN: AtomicU8 = AtomicU8::new(0);

/// A background task; the value is the bit with which it checks in.
#[derive(Clone, Copy)]
#[repr(u8)]
enum Background {
    Receive = 1,
    Send = 2,
    Housekeep = 4,
}

const EVERY_BACKGROUND: u8 = Background::Receive as u8 | Background::Send as u8 | Background::Housekeep as u8;

impl Background {
    fn checks_in(self) {
        CHECKED_IN.fetch_or(self as u8, Ordering::Relaxed);
    }
}

/// Starts the tasks.
pub fn start(board: Board) {
    let Board {
        sensors,
        actuators,
        panel,
        serial,
        calibration,
        origin,
        boot,
        control: control_spawner,
        background,
    } = board;
    board::restart_on_panic();
    info!(
        "needle guide {=str} ({=str}), boot {=u32:08x} after {}, calibration {=str}",
        env!("CARGO_PKG_VERSION"),
        env!("FIRMWARE_GIT"),
        boot.boot_id,
        Debug2Format(&boot.reset_reason),
        calibration.record().id.as_str()
    );
    if boot.is_blind {
        error!("the watchdog has ended several consecutive starts: no sensor is read");
    }
    if let Some(panic) = &boot.last_panic {
        error!("the previous run ended in a panic: {=str}", panic.as_str());
    }
    static CALIBRATION: StaticCell<Calibration> = StaticCell::new();
    let calibration = CALIBRATION.init(calibration);
    let start = Start {
        boot_id: boot.boot_id,
        restarted: boot.is_unexpected(),
        origin,
        retained: boot.retained.clone(),
    };
    let controller = Controller::new(calibration.clone(), start);
    let (sending, receiving) = serial.split();
    let once = "each task is spawned once";
    control_spawner.spawn(control(sensors, actuators, panel, controller).expect(once));
    background.spawn(link::receive(receiving).expect(once));
    background.spawn(housekeep(boot.is_blind).expect(once));
    background.spawn(link::send(sending, boot, calibration).expect(once));
}

/// Runs in thread mode: sleeps until an interrupt comes, and counts the idle time.
pub fn idle() {
    // With interrupts masked, an interrupt wakes the core but is served only afterwards, so that its time does not count as idle.
    cortex_m::interrupt::free(|_| {
        let sleep_start = Instant::now();
        #[cfg(not(feature = "qemu"))]
        cortex_m::asm::wfi();
        #[cfg(feature = "qemu")]
        crate::qemu::end_period();
        let slept_us = Instant::now().saturating_duration_since(sleep_start).as_micros() as u32;
        IDLE_US.fetch_add(slept_us, Ordering::Relaxed);
    });
}

/// Reads the registers back, measures the stack now and then, and restarts the device with a new calibration.
#[embassy_executor::task]
async fn housekeep(is_blind: bool) {
    const STACK_EVERY: u32 = 40;
    /// Round after the start in which the registers are read back, after a quarter of a second: everything runs by then, and a host
    /// has had time to read the previous panic.
    const REGISTERS_AT: u32 = 10;
    /// Time for the answer to be sent before the restart.
    const ANSWER_TIME: Duration = Duration::from_millis(100);
    let mut round = 0_u32;
    let mut verified = false;
    loop {
        Background::Housekeep.checks_in();
        round = (round + 1) % STACK_EVERY;
        if round == REGISTERS_AT && !verified {
            verified = true;
            // The registers of a converter that is not read have no required value.
            if !is_blind {
                board::verify_registers();
            }
            board::runs();
        }
        if round == 1 {
            STACK_FREE_BYTES.store(cortex_m_stack::stack_painted(), Ordering::Relaxed);
        }
        if let Ok(record) = with_timeout(CHECK_IN, RESTART.wait()).await {
            Timer::after(ANSWER_TIME / 2).await;
            Background::Housekeep.checks_in();
            Timer::after(ANSWER_TIME / 2).await;
            board::restart_with(&record);
        }
    }
}

/// The outbox as the queue of the telemetry.
struct Queue;

impl Outbox for Queue {
    fn room(&self) -> usize {
        OUTBOX.free_capacity()
    }

    fn put(&mut self, item: Item) -> bool {
        OUTBOX.try_send(item).is_ok()
    }
}

/// Accumulates the load of the processor.
struct Meter {
    load: Load,
    periods: u32,
}

impl Meter {
    /// Takes the delay and the duration of a period.
    fn period(&mut self, late: Duration, worked: Duration) {
        // A microsecond is added, as the clock rounds down and a duration must not be reported shorter than it was.
        let ceil_us = |duration: Duration| u16::try_from(duration.as_micros() + 1).unwrap_or(u16::MAX);
        let load = &mut self.load;
        load.longest_period_us = load.longest_period_us.max(ceil_us(worked));
        load.latest_start_us = load.latest_start_us.max(ceil_us(late));
        load.outbox_most = load.outbox_most.max((OUTBOX_PLACES - OUTBOX.free_capacity()) as u8);
        load.stack_free_bytes = STACK_FREE_BYTES.load(Ordering::Relaxed);
        self.periods += 1;
        if self.periods == REPORT_PERIODS {
            self.periods = 0;
            let window_us = REPORT_PERIODS * PERIOD_US;
            let idle_us = IDLE_US.swap(0, Ordering::Relaxed).min(window_us);
            load.cpu_permille = ((window_us - idle_us) / (window_us / 1_000)) as u16;
        }
    }
}

#[embassy_executor::task]
async fn control(
    mut sensors: BoardSensors,
    mut actuators: BoardActuators,
    mut panel: BoardPanel,
    mut controller: Controller,
) {
    let mut telemetry = Telemetry::new();
    let mut meter = Meter { load: Load::default(), periods: 0 };
    let mut led = false;
    let mut silent_periods = 0_u32;
    let mut skips_next = false;

    // The first period begins at a whole number of periods since start, so that sample times are multiples of the period.
    let mut due = Instant::from_micros(Instant::now().as_micros().next_multiple_of(PERIOD_US.into()));
    loop {
        due += PERIOD;
        Timer::at(due).await;
        let began = Instant::now();
        let mut late = began.saturating_duration_since(due);
        // Periods that can no longer be caught up are skipped; the host finds the gap in the sample
        // times.
        due += PERIOD * (late.as_micros() / u64::from(PERIOD_US)) as u32;
        // If the period before took so long that one was skipped, this one counts as late.
        late = late.max(PERIOD * u32::from(core::mem::take(&mut skips_next)));

        let received = RECEIVE_COUNTERS.lock(Cell::get);
        let outputs = controller.step(&Inputs {
            now_us: due.as_micros(),
            late_us: u32::try_from(late.as_micros()).unwrap_or(u32::MAX),
            readings: sensors.read(),
            command: COMMANDS.try_receive().ok(),
            counters: Counters {
                samples_dropped: telemetry.samples_dropped(),
                messages_dropped: telemetry.messages_dropped().saturating_add(received.messages_dropped),
                ..received
            },
            load: meter.load,
        });
        match outputs.drive {
            Drive::Release => actuators.release(),
            Drive::Duty(duty) => actuators.drive(duty),
        }
        if outputs.led != led {
            led = outputs.led;
            panel.led(led);
        }
        silent_periods = silent_periods.saturating_add(1);
        if CHECKED_IN.load(Ordering::Relaxed) == EVERY_BACKGROUND {
            CHECKED_IN.store(0, Ordering::Relaxed);
            silent_periods = 0;
        }
        if silent_periods < CHECK_IN_LIMIT_PERIODS {
            panel.feed_watchdog();
        }
        outputs.notes.iter().for_each(log);
        if outputs.keep {
            board::keep(&controller.retained_state());
        }
        telemetry.send(due.as_micros(), &outputs, &mut Queue);
        if let Some(record) = outputs.store {
            RESTART.signal(record);
        }
        meter.period(late, began.elapsed());
        // Without a reserve, control periods that take too long would starve the background tasks: no host would be answered,
        // and the watchdog would not be fed.
        let late_us = (Instant::now().saturating_duration_since(due) + RESERVED).as_micros();
        skips_next = late_us > u64::from(PERIOD_US);
        due += PERIOD * (late_us / u64::from(PERIOD_US)) as u32;
    }
}

fn log(note: &OutboundMessage) {
    match note {
        OutboundMessage::Event(event) => match event.kind {
            EventKind::Faulted { fault } => error!("fault {} at {} us", fault as u8, event.t_us),
            EventKind::ProgramEnded { .. } => info!("program ended at {} us", event.t_us),
            EventKind::Tared(_) => info!("tared at {} us", event.t_us),
            EventKind::StepStarted { index } => info!("step {} at {} us", index, event.t_us),
            EventKind::TareRejected { .. } => warn!("tare rejected at {} us", event.t_us),
            EventKind::RetreatEnded { .. } => info!("retreat ended at {} us", event.t_us),
            EventKind::PulseEnded(_) => info!("pulse ended at {} us", event.t_us),
            EventKind::StepEnded { .. } => {}
        },
        OutboundMessage::Refused(id, _) => warn!("command {} refused", id),
        OutboundMessage::Hello
        | OutboundMessage::Stream(_)
        | OutboundMessage::Ack(_)
        | OutboundMessage::Status(_)
        | OutboundMessage::Report(_)
        | OutboundMessage::Calibration
        | OutboundMessage::Connected(_)
        | OutboundMessage::Safety(_)
        | OutboundMessage::SafetyReport(_)
        | OutboundMessage::Description => {}
    }
}
