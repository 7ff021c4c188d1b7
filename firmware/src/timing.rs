//! Instructions of a control period on the target, over programs, requests and faults.
//!
//! Controller and telemetry run against a small plant of two actuators on springs. A host sends a request in every third period, in
//! a fixed sequence of all requests except `AcknowledgeCalibration` and `Pulse`, with programs of every kind of step; sensors
//! fail now and then, and faults are cleared again. The count includes everything in the control interrupt except the drivers,
//! which differ between QEMU and the board.
#![no_std]
#![no_main]

use control::ads131m02::ForceFault;
use control::calibration::Calibration;
use control::hal::Readings;
use control::telemetry::{Item, Outbox, Telemetry};
use control::{Controller, Drive, Inputs, OutboundMessage, Outputs, PERIOD_S, PERIOD_US, Start};
use cortex_m::Peripherals;
use firmware::qemu::{ExitCode, Stopwatch, exit};
use heapless::Deque;
use protocol::{
    Command, Counters, Load, MAX_CALIBRATION, MAX_STEPS, PIECE_BYTES, Request, Step, calibration_crc,
    program_crc,
};

const BOOT: u32 = 1;
/// Periods that are measured: five minutes.
const PERIODS: u32 = 300_000;
/// Periods between two commands.
const COMMAND_PERIODS: u32 = 3;
/// Full speed of the actuators, micrometres per second.
const FULL_SPEED_UM_S: f32 = 20_000.0;

/// A linear congruential generator: the same numbers in every run.
struct Random(u32);

impl Random {
    fn below(&mut self, limit: u32) -> u32 {
        self.0 = self.0.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (self.0 >> 8) % limit
    }
}

/// An outbox that drains by an item in six periods.
struct Queue {
    items: Deque<Item, 24>,
}

impl Outbox for Queue {
    fn room(&self) -> usize {
        self.items.capacity() - self.items.len()
    }

    fn put(&mut self, item: Item) -> bool {
        self.items.push_back(item).is_ok()
    }
}

/// Two actuators on springs of 1.2 N/mm, which is 1,073.7 codes a micrometre.
struct Plant {
    position_um: [f32; 2],
}

impl Plant {
    fn step(&mut self, drive: Drive) {
        let Drive::Duty(duty) = drive else { return };
        for (position_um, duty) in self.position_um.iter_mut().zip(duty) {
            let drive_fraction = ((duty.abs() - 0.2) / 0.8).max(0.0).copysign(duty);
            *position_um += drive_fraction * FULL_SPEED_UM_S * PERIOD_S;
        }
    }

    fn read(&self, random: &mut Random) -> Readings {
        let noise = random.below(2_000) as i32;
        let fails = random.below(4_000);
        let codes = self.position_um.map(|um| (um / 12.207 + 2_048.0) as u16);
        let force = self.position_um.map(|um| (um * 1_073.7) as i32 + noise);
        Readings {
            potentiometer_codes: if fails == 1 { [0; 2] } else { codes },
            force_codes: match fails {
                2 => Err(ForceFault::Crc),
                3..=5 => Err(ForceFault::Saturated { channel: 0 }),
                _ => Ok(force),
            },
            emergency_stop: fails == 6,
        }
    }
}

/// The host, which sends requests in a fixed sequence.
struct Host {
    /// Whether the next request is a hello.
    greets: bool,
    turn: u32,
    steps: [Step; MAX_STEPS],
    calibration: [[u8; PIECE_BYTES]; MAX_CALIBRATION.div_ceil(PIECE_BYTES)],
    length: usize,
}

impl Host {
    fn new(random: &mut Random) -> Self {
        let mut steps = [Step::Hold { duration_ms: 20 }; MAX_STEPS];
        for step in &mut steps {
            let [x_um, y_um] = [0; 2].map(|_: i32| random.below(2_000) as i32 - 1_000);
            *step = match random.below(5) {
                0 => Step::Tare { duration_ms: 1 + random.below(40) },
                1 => Step::Hold { duration_ms: 1 + random.below(40) },
                2 => Step::Ramp { x_um, y_um, duration_ms: 200 + random.below(400) },
                _ => Step::Move { x_um, y_um, speed_um_s: 5_000 },
            };
        }
        let mut calibration = [[0; PIECE_BYTES]; MAX_CALIBRATION.div_ceil(PIECE_BYTES)];
        let mut buffer = [0; MAX_CALIBRATION];
        let bytes = Calibration::nominal_record().encode(&mut buffer);
        for (piece, bytes) in calibration.iter_mut().zip(bytes.chunks(PIECE_BYTES)) {
            piece[..bytes.len()].copy_from_slice(bytes);
        }
        Self { greets: true, turn: 0, steps, calibration, length: bytes.len() }
    }

    fn next_request(&mut self, random: &mut Random) -> Request {
        if core::mem::take(&mut self.greets) {
            return Request::Hello;
        }
        self.turn += 1;
        let turn = self.turn % 4_000;
        let pieces = self.calibration.len();
        match turn as usize {
            0 => Request::Stop,
            1 => Request::Limits { force_mn: 4_900, silence_ms: 2_000 },
            2 => Request::Stream { enable: true },
            at if at < 3 + pieces => {
                let piece = at - 3;
                Request::LoadCalibration { piece: piece as u8, bytes: self.calibration[piece] }
            }
            at if at == 3 + pieces => {
                let bytes = &self.calibration.as_flattened()[..self.length];
                Request::StoreCalibration { length: self.length as u8, crc: calibration_crc(bytes) }
            }
            at if at < 20 + MAX_STEPS => {
                let index = at.saturating_sub(20).min(MAX_STEPS - 1);
                Request::LoadStep { index: index as u8, step: self.steps[index] }
            }
            at if at % 200 == 150 => Request::ClearFault,
            at if at % 200 == 151 => {
                let steps = 1 + random.below(MAX_STEPS as u32) as usize;
                let crc = program_crc(&self.steps[..steps]);
                Request::Run { steps: steps as u8, crc, start_us: 0 }
            }
            at if at % 200 == 52 => Request::Hello,
            at if at % 200 == 54 => Request::Safety,
            at if at % 200 == 55 => Request::Describe,
            at if at % 200 == 152 => Request::Retreat { x_um: 300, y_um: -300 },
            at if at % 200 == 53 => Request::Calibration,
            _ => Request::Status,
        }
    }
}

#[cortex_m_rt::entry]
fn main() -> ! {
    let Some(mut peripherals) = Peripherals::take() else { exit(ExitCode::Fault) };
    let stopwatch = Stopwatch::start(&mut peripherals.SYST);
    let mut random = Random(7);
    let mut host = Host::new(&mut random);
    let mut plant = Plant { position_um: [0.0; 2] };
    let mut controller = Controller::new(Calibration::default(), Start::ordinary(BOOT));
    let (mut connection, mut id) = (0, 0);
    let mut telemetry = Telemetry::new();
    let mut queue = Queue { items: Deque::new() };
    let (mut sum, mut most, mut driven, mut notes, mut faults) = (0_u64, 0_u32, 0_u32, 0_u32, 0_u32);
    for period in 1..=PERIODS {
        let now_us = u64::from(period) * u64::from(PERIOD_US);
        let command = (period % COMMAND_PERIODS == 0).then(|| Command {
            id,
            connection,
            request: host.next_request(&mut random),
        });
        id = id.wrapping_add(command.is_some().into());
        let inputs = Inputs {
            now_us,
            late_us: 0,
            readings: plant.read(&mut random),
            command,
            counters: Counters::default(),
            load: Load::default(),
        };
        let (outputs, ticks): (Outputs, u32) = stopwatch.ticks(|| {
            let outputs = controller.step(&inputs);
            telemetry.send(now_us, &outputs, &mut queue);
            outputs
        });
        plant.step(outputs.drive);
        for note in &outputs.notes {
            if let OutboundMessage::Connected(token) = note {
                (connection, id) = (*token, 0);
            }
        }
        if outputs.store.is_some() {
            // The host starts again, as the device does.
            controller = Controller::new(Calibration::default(), Start::ordinary(BOOT));
            host.greets = true;
        }
        if period % 6 == 0 {
            queue.items.pop_front();
        }
        sum += u64::from(ticks);
        most = most.max(ticks);
        driven += u32::from(outputs.drive != Drive::Release);
        notes += outputs.notes.len() as u32;
        faults += u32::from(outputs.state == protocol::State::Faulted);
    }
    defmt::info!(
        "period {=u32} periods, {=u32} instructions on average, {=u32} at most; driven {=u32}, notes {=u32}, faulted {=u32}",
        PERIODS,
        stopwatch.instructions(sum / u64::from(PERIODS)),
        stopwatch.instructions(u64::from(most)),
        driven,
        notes,
        faults
    );
    exit(ExitCode::PowerOff)
}
