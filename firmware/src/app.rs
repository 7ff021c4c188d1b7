//! The program: three tasks around the controller, the same on the board and in QEMU.
//!
//! | task | priority | owns | does |
//! |---|---|---|---|
//! | control | interrupt | sensors, actuators, panel, controller | one control period every millisecond |
//! | receive | background | receiving half of the serial port | bytes to commands |
//! | send | background | sending half of the serial port, packer | what the control task has to say to frames |
//!
//! Commands go to the control task through [`COMMANDS`], everything it has to say goes to the send task through [`OUTBOX`], in
//! order. The control task never waits for either: when the link is slow, samples are dropped and counted, the last places
//! of the outbox being kept for answers and events. The watchdog is fed by the control task, and only while the background
//! tasks have shown that they run, so that neither side can hang unnoticed.

use crate::board::{Board, BoardActuators, BoardPanel, BoardSensors, BootInfo, pins};
use crate::calibration::{Calibration, FORCE_NN_PER_COUNT, POSITION_NM_PER_COUNT};
use crate::control::{Controller, Drive, Inputs, Note, PERIOD_US};
use crate::hal::{Actuators, Panel, Sensors};
use core::cell::Cell;
use core::sync::atomic::{AtomicBool, Ordering};
use defmt::{Debug2Format, error, info, warn};
use embassy_stm32::usart::{BufferedUartRx, BufferedUartTx};
use embassy_sync::blocking_mutex::Mutex;
use embassy_sync::blocking_mutex::raw::CriticalSectionRawMutex;
use embassy_sync::channel::Channel;
use embassy_time::{Duration, Instant, Timer};
use embedded_io_async::{Read, Write};
use protocol::{
    Command, CommandReceiver, Counters, Envelope, EventKind, Hello, MAX_FRAME_TO_HOST, Message, Packer,
    Received, Refusal, Sample, Scales, State, Text, encode_envelope,
};

/// One thing the control task has to say.
enum Item {
    Note(Note),
    Sample { t_us: u64, state: State, step: u8, dropped: u32, sample: Sample },
}

/// Places of the outbox that samples may not take.
const RESERVED_FOR_NOTES: usize = 16;
const PERIOD: Duration = Duration::from_micros(PERIOD_US as u64);
/// How often the background tasks must have run for the watchdog to be fed, control periods.
const CHECK_IN_PERIODS: u32 = 100;

static COMMANDS: Channel<CriticalSectionRawMutex, Command, 4> = Channel::new();
static OUTBOX: Channel<CriticalSectionRawMutex, Item, 112> = Channel::new();
/// What the receive task counts.
static RECEIVE_COUNTERS: Mutex<CriticalSectionRawMutex, Cell<Counters>> = Mutex::new(Cell::new(Counters {
    samples_dropped: 0,
    messages_dropped: 0,
    frames_corrupt: 0,
    frames_overlong: 0,
    frames_unreadable: 0,
    force_readings_bad: 0,
    control_overruns: 0,
}));
/// Set by the background executor, taken by the control task.
static BACKGROUND_RUNS: AtomicBool = AtomicBool::new(false);

/// Starts the tasks.
pub fn start(board: Board) {
    let Board { sensors, actuators, panel, serial, store: _, boot, control: control_spawner, background } =
        board;
    info!(
        "needle guide {=str} ({=str}), boot {=u32:08x} after {}",
        env!("CARGO_PKG_VERSION"),
        env!("FIRMWARE_GIT"),
        boot.boot_id,
        Debug2Format(&boot.reset_reason)
    );
    let (sending, receiving) = serial.split();
    let once = "each task is spawned once";
    control_spawner.spawn(control(sensors, actuators, panel, boot.boot_id).expect(once));
    background.spawn(receive(receiving).expect(once));
    background.spawn(send(sending, boot).expect(once));
    background.spawn(check_in().expect(once));
}

/// Shows that the background executor runs.
#[embassy_executor::task]
async fn check_in() {
    loop {
        BACKGROUND_RUNS.store(true, Ordering::Relaxed);
        Timer::after(PERIOD * (CHECK_IN_PERIODS / 4)).await;
    }
}

#[embassy_executor::task]
async fn control(
    mut sensors: BoardSensors,
    mut actuators: BoardActuators,
    mut panel: BoardPanel,
    boot_id: u32,
) {
    let mut controller = Controller::new(Calibration::nominal(), boot_id);
    let mut own = Counters::default();
    let mut streaming = false;
    let mut led = false;
    let mut periods = 0_u32;

    // Whole periods since start, so that sample times are multiples of the period.
    let mut due = Instant::from_micros(Instant::now().as_micros().next_multiple_of(PERIOD_US.into()));
    loop {
        due += PERIOD;
        Timer::at(due).await;
        let late = Instant::now().saturating_duration_since(due);
        if late > PERIOD / 2 {
            own.control_overruns = own.control_overruns.saturating_add(1);
            // Skip what can no longer be caught up; the host sees the gap in the sample times.
            due += PERIOD * (late.as_micros() / u64::from(PERIOD_US)) as u32;
        }
        periods = periods.wrapping_add(1);

        let received = RECEIVE_COUNTERS.lock(Cell::get);
        let outputs = controller.step(&Inputs {
            now_us: due.as_micros(),
            readings: sensors.read(),
            command: COMMANDS.try_receive().ok(),
            counters: Counters {
                samples_dropped: own.samples_dropped,
                messages_dropped: own.messages_dropped,
                control_overruns: own.control_overruns,
                ..received
            },
        });
        match outputs.drive {
            Drive::Release => actuators.release(),
            Drive::Duty(duty) => actuators.drive(duty),
        }
        if outputs.led != led {
            led = outputs.led;
            panel.led(led);
        }
        if periods.is_multiple_of(CHECK_IN_PERIODS) && BACKGROUND_RUNS.swap(false, Ordering::Relaxed) {
            panel.feed_watchdog();
        }

        for note in outputs.notes {
            log(&note);
            if let Note::Stream(enable) = note {
                streaming = enable;
            }
            if OUTBOX.try_send(Item::Note(note)).is_err() {
                own.messages_dropped = own.messages_dropped.saturating_add(1);
            }
        }
        if streaming {
            let item = Item::Sample {
                t_us: due.as_micros(),
                state: outputs.state,
                step: outputs.step,
                dropped: own.samples_dropped,
                sample: outputs.sample,
            };
            if OUTBOX.free_capacity() <= RESERVED_FOR_NOTES || OUTBOX.try_send(item).is_err() {
                own.samples_dropped = own.samples_dropped.saturating_add(1);
            }
        }
    }
}

fn log(note: &Note) {
    match note {
        Note::Event(event) => match event.kind {
            EventKind::Faulted { fault } => error!("fault {} at {} us", fault as u8, event.t_us),
            EventKind::ProgramEnded { .. } => info!("program ended at {} us", event.t_us),
            EventKind::Tared { .. } => info!("tared at {} us", event.t_us),
            EventKind::StepStarted { index } => info!("step {} at {} us", index, event.t_us),
            EventKind::StepEnded { .. } => {}
        },
        Note::Refused(id, _) => warn!("command {} refused", id),
        Note::Hello | Note::Stream(_) | Note::Ack(_) | Note::Status(_) => {}
    }
}

#[embassy_executor::task]
async fn receive(mut port: BufferedUartRx<'static>) {
    let mut receiver = CommandReceiver::new();
    let mut buffer = [0; 64];
    let mut line_errors = 0_u32;
    loop {
        match port.read(&mut buffer).await {
            Ok(length) => {
                for frame in receiver.feed(buffer.get(..length).unwrap_or_default()) {
                    match frame {
                        Received::Frame(command) => COMMANDS.send(command).await,
                        Received::Unreadable(Some(id)) => {
                            OUTBOX.send(Item::Note(Note::Refused(id, Refusal::Unreadable))).await;
                        }
                        Received::Corrupt | Received::Overlong | Received::Unreadable(None) => {}
                    }
                }
            }
            // Overrun, framing or noise: the frame it hit fails its checksum.
            Err(_) => line_errors = line_errors.saturating_add(1),
        }
        let losses = receiver.losses();
        RECEIVE_COUNTERS.lock(|counters| {
            counters.set(Counters {
                frames_corrupt: losses.corrupt.saturating_add(line_errors),
                frames_overlong: losses.overlong,
                frames_unreadable: losses.unreadable,
                ..Counters::default()
            });
        });
    }
}

#[embassy_executor::task]
async fn send(port: BufferedUartTx<'static>, boot: BootInfo) {
    let mut link = Link { port, boot, sequence: 0 };
    let mut packer = Packer::new(PERIOD_US);
    loop {
        match OUTBOX.receive().await {
            Item::Sample { t_us, state, step, dropped, sample } => {
                if let Some(batch) = packer.push(t_us, state, step, dropped, sample) {
                    link.send(Message::Samples(batch)).await;
                }
            }
            Item::Note(note) => {
                // What was sampled before goes out before.
                if let Some(batch) = packer.flush() {
                    link.send(Message::Samples(batch)).await;
                }
                match note {
                    Note::Hello => link.send(Message::Hello(hello(&boot))).await,
                    Note::Ack(id) => link.send(Message::Ack { id }).await,
                    Note::Refused(id, refusal) => link.send(Message::Refused { id, refusal }).await,
                    Note::Event(event) => link.send(Message::Event(event)).await,
                    Note::Status(status) => link.send(Message::Status(status)).await,
                    Note::Stream(_) => {}
                }
            }
        }
    }
}

/// The way out: numbers the frames and writes them.
struct Link {
    port: BufferedUartTx<'static>,
    boot: BootInfo,
    sequence: u32,
}

impl Link {
    async fn send(&mut self, message: Message) {
        let envelope = Envelope { boot_id: self.boot.boot_id, sequence: self.sequence, message };
        self.sequence = self.sequence.wrapping_add(1);
        let mut buffer = [0; MAX_FRAME_TO_HOST];
        match encode_envelope(&envelope, &mut buffer) {
            // A frame that the port did not take is a gap in the sequence, which the host counts.
            Ok(frame) => {
                if self.port.write_all(frame).await.is_err() {
                    warn!("the serial port refused a frame");
                }
            }
            Err(_) => error!("a message is longer than the longest frame"),
        }
    }
}

fn hello(boot: &BootInfo) -> Hello {
    let calibration = Calibration::nominal();
    Hello {
        protocol_version: protocol::VERSION,
        schema_hash: protocol::schema_hash(),
        firmware_version: Text::new(env!("CARGO_PKG_VERSION")),
        commit: Text::new(env!("FIRMWARE_GIT")),
        board: Text::new(pins::BOARD_NAME),
        reset_reason: boot.reset_reason,
        tick_hz: 1_000_000,
        now_us: Instant::now().as_micros(),
        sample_period_us: PERIOD_US,
        scales: Scales {
            position_nm_per_count: POSITION_NM_PER_COUNT,
            force_nn_per_count: FORCE_NN_PER_COUNT,
            travel_um: calibration.travel_um,
            force_range_mn: calibration.force_range_mn,
        },
    }
}
