//! The control core under arbitrary commands and readings.
//!
//! Input: operations, each a byte that chooses it and its own bytes. One is a period or many; a plant that follows the duty stands in
//! for the rig as long as the readings are not given outright, so that whole programs can run.

use super::{Bytes, sealed};
use control::ads131m02::ForceFault;
use control::calibration::Calibration;
use control::hal::Readings;
use control::{Controller, Drive, Inputs, OutboundMessage, Outputs, PERIOD_S, PERIOD_US, Start};
use emulation::plant::FORCE_CODE_MAX;
use protocol::{
    CalibrationRecord, Command, CommandReceiver, Counters, Load, MAX_CALIBRATION, MAX_STEPS, PIECE_BYTES,
    Received, Request, State, Step, calibration_crc, program_crc,
};

const BOOT_ID: u32 = 42;
/// Numbers of commands that do not come from [`Bench::request`].
const FOREIGN: u16 = 1 << 15;
/// Most periods of one input: longer ones take time and find nothing new.
const MAX_PERIODS: u32 = 8_000;

/// Runs the operations.
///
/// # Panics
/// Where the bridges are on in a fault, a duty is none, a command has not one answer, or a target beyond the travel is taken.
pub fn run(data: &[u8]) {
    let mut bytes = Bytes(data);
    let mut bench = Bench::new(bytes.u8() & 1 != 0);
    while !bytes.is_empty() && bench.periods < MAX_PERIODS {
        bench.operation(&mut bytes);
    }
}

struct Bench {
    controller: Controller,
    calibration: Calibration,
    now_us: u64,
    late_us: u32,
    periods: u32,
    position_um: [f32; 2],
    /// What the readings are instead of the plant's.
    codes: Option<[u16; 2]>,
    force: Result<[i32; 2], ForceFault>,
    emergency_stop: bool,
    connection: u32,
    next_id: u16,
    last: Option<Command>,
    steps: [Step; MAX_STEPS],
}

impl Bench {
    fn new(restarted: bool) -> Self {
        let calibration = Calibration::default();
        Self {
            controller: Controller::new(calibration.clone(), Start { restarted, ..Start::ordinary(BOOT_ID) }),
            connection: 0,
            calibration,
            now_us: 0,
            late_us: 0,
            periods: 0,
            position_um: [0.0; 2],
            codes: None,
            force: Ok([0; 2]),
            emergency_stop: false,
            next_id: 0,
            last: None,
            steps: [Step::Hold { duration_ms: 0 }; MAX_STEPS],
        }
        .connected()
    }

    /// Sends a hello.
    fn connected(mut self) -> Self {
        self.request(Request::Hello);
        self
    }

    fn operation(&mut self, bytes: &mut Bytes) {
        match bytes.u8() % 10 {
            0 => {
                let periods = bytes.u16() % 2_048;
                (0..periods).for_each(|_| self.period(None));
            }
            // A request as it comes over the line, with its own identity.
            1 => {
                let received = CommandReceiver::new().feed(&sealed(bytes.sized())).next();
                if let Some(Received::Frame(command)) = received {
                    self.period(Some(Command { id: command.id | FOREIGN, ..command }));
                }
            }
            // The same with the identity that is due, so that it is carried out.
            2 => {
                let payload = [&[0, 0][..], bytes.sized()].concat();
                let received = CommandReceiver::new().feed(&sealed(&payload)).next();
                if let Some(Received::Frame(command)) = received {
                    self.request(command.request);
                }
            }
            3 => self.period(self.last),
            4 => {
                let steps = bytes.u8() % (MAX_STEPS as u8 + 1);
                let crc = program_crc(&self.steps[..steps.into()]);
                let start_us = if bytes.u8() & 1 == 0 { 0 } else { self.now_us + u64::from(bytes.u16()) };
                self.request(Request::Run { steps, crc, start_us });
            }
            5 => self.codes = Some([bytes.u16() & 0xFFF, bytes.u16() & 0xFFF]),
            6 => {
                self.codes = None;
                let position_um = [bytes.u16(), bytes.u16()].map(|um| f32::from(um as i16));
                self.position_um = position_um;
            }
            7 => {
                self.force = match bytes.u8() % 6 {
                    0 => Err(ForceFault::Bus),
                    1 => Err(ForceFault::Crc),
                    2 => Err(ForceFault::DeviceReset),
                    3 => Err(ForceFault::NotReady),
                    4 => Err(ForceFault::Saturated { channel: bytes.u8() & 1 }),
                    _ => Ok([bytes.i32() >> 8, bytes.i32() >> 8]),
                }
            }
            8 => {
                let flags = bytes.u8();
                self.emergency_stop = flags & 1 != 0;
                self.late_us = if flags & 2 != 0 { bytes.u16().into() } else { 0 };
                if flags & 4 != 0 {
                    self.now_us += u64::from(bytes.u16()) * u64::from(PERIOD_US);
                }
            }
            _ => self.calibrate(bytes.sized()),
        }
    }

    /// Loads and stores a calibration: the designed one with these bytes from a place of it on.
    fn calibrate(&mut self, changes: &[u8]) {
        let mut buffer = [0; MAX_CALIBRATION];
        let mut record = Calibration::nominal_record().encode(&mut buffer).to_vec();
        if let Some((&at, changes)) = changes.split_first() {
            record.truncate(at.into());
            record.extend(changes);
            record.truncate(MAX_CALIBRATION);
        }
        for (piece, part) in (0..).zip(record.chunks(PIECE_BYTES)) {
            let mut bytes = [0; PIECE_BYTES];
            bytes[..part.len()].copy_from_slice(part);
            self.request(Request::LoadCalibration { piece, bytes });
        }
        self.request(Request::StoreCalibration { length: record.len() as u8, crc: calibration_crc(&record) });
    }

    fn request(&mut self, request: Request) {
        self.next_id = self.next_id.wrapping_add(1);
        self.period(Some(Command { id: self.next_id, connection: self.connection, request }));
    }

    fn period(&mut self, command: Option<Command>) {
        self.periods += 1;
        self.now_us += u64::from(PERIOD_US);
        let code = |um: f32| (um / 12.207_031 + 2_048.0).round().clamp(0.0, 4_095.0) as u16;
        // A sound converter never gives the same code twice.
        let dither = (self.periods % 7) as i32;
        let readings = Readings {
            potentiometer_codes: self.codes.unwrap_or(self.position_um.map(code)),
            force_codes: self.force.map(|codes| codes.map(|code| (code + dither).min(FORCE_CODE_MAX))),
            emergency_stop: self.emergency_stop,
        };
        let outputs = self.controller.step(&Inputs {
            now_us: self.now_us,
            late_us: self.late_us,
            readings,
            command,
            counters: Counters::default(),
            load: Load::default(),
        });
        self.judge(&outputs, command.as_ref());
        for note in &outputs.notes {
            if let OutboundMessage::Connected(connection) = note {
                (self.connection, self.next_id) = (*connection, 0);
            }
        }
        if let Drive::Duty(duty) = outputs.drive {
            for (position_um, duty) in self.position_um.iter_mut().zip(duty) {
                let share = ((duty.abs() - 0.2) / 0.8).max(0.0).copysign(duty);
                *position_um += share * 20_000.0 * PERIOD_S;
            }
        }
        self.last = command.or(self.last);
        if let Some(record) = outputs.store {
            self.restart(record);
        }
    }

    fn judge(&mut self, outputs: &Outputs, command: Option<&Command>) {
        match outputs.drive {
            Drive::Release => {}
            Drive::Duty(duty) => {
                assert!(duty.iter().all(|duty| (-1.0..=1.0).contains(duty)), "no duty: {duty:?}");
                assert!(outputs.state != State::Faulted, "driven in a fault");
            }
        }
        let answers: Vec<_> = outputs
            .notes
            .iter()
            .filter_map(|note| match note {
                OutboundMessage::Ack(id) => Some((*id, true)),
                OutboundMessage::Refused(id, _) => Some((*id, false)),
                _ => None,
            })
            .collect();
        let Some(command) = command else {
            assert_eq!(answers, [], "an answer to nothing");
            return;
        };
        assert!(matches!(answers[..], [(id, _)] if id == command.id), "one answer: {answers:?}");
        let taken = matches!(answers[..], [(_, true)]);
        // What has a foreign number may be a repeat, which has the answer of what came first, not of its own request.
        if let Request::LoadStep { index, step } = command.request
            && command.id == self.next_id
            && taken
        {
            self.steps[usize::from(index)] = step;
            if let Step::Move { x_um, y_um, .. } | Step::Ramp { x_um, y_um, .. } = step {
                let travel_um = self.calibration.travel_um();
                assert!(x_um.unsigned_abs() <= travel_um && y_um.unsigned_abs() <= travel_um, "{step:?}");
            }
        }
    }

    /// Starts again with the calibration that was to be kept.
    fn restart(&mut self, record: CalibrationRecord) {
        let calibration = Calibration::new(record).expect("only a sound calibration is kept");
        let retained = Some(self.controller.retained_state());
        self.controller =
            Controller::new(calibration.clone(), Start { retained, ..Start::ordinary(BOOT_ID) });
        self.calibration = calibration;
        self.last = None;
        self.request(Request::Hello);
    }
}
