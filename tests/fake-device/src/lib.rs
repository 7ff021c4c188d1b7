//! A device for tests: speaks the protocol at the far end of a pseudo terminal or of a TCP connection, and misbehaves as scripted.
#![forbid(unsafe_code)]
#![deny(missing_docs)]

use line::Line;
use protocol::{
    CalibrationId, CalibrationRecord, CalibrationSource, Command, CommandReceiver, Envelope, Event,
    EventKind, Fault, Hello, MAX_CALIBRATION, MAX_FRAME_TO_HOST, Message, Outcome, PIECE_BYTES, Packer,
    Received, Refusal, Request, RetreatOutcome, Safety, Sample, State, Status, encode_envelope,
};
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

mod line;
mod messages;
mod script;

pub use messages::{calibration, hello, status};
pub use script::{Act, Script};

const PERIOD_US: u32 = 1_000;
/// Token of its first connection; the next ones follow.
const FIRST_CONNECTION: u32 = 0xC0FF_EE00;
/// Number of connections that a device has at once, as the firmware.
const CONNECTIONS: u32 = 4;
/// The boot that a new fake claims.
pub const BOOT_ID: u32 = 77;

/// The running device. Dropping it ends it.
pub struct FakeDevice {
    /// Name of the port that leads to it.
    pub port: String,
    executed: Arc<Mutex<Vec<Request>>>,
    questions: Arc<AtomicUsize>,
    stop: Arc<AtomicBool>,
    worker: Option<JoinHandle<()>>,
}

impl FakeDevice {
    /// Starts a device: at a pseudo terminal, and where the system has none at a TCP port of this machine.
    pub fn start(script: Script) -> Self {
        Self::on(line::usual(), script)
    }

    /// Starts a device behind a TCP address; port 0 is a free one.
    pub fn start_at(address: &str, script: Script) -> Self {
        Self::on(line::tcp(address), script)
    }

    fn on((far, port): (Box<dyn Line>, String), script: Script) -> Self {
        let (executed, questions) = (Arc::default(), Arc::default());
        let stop = Arc::new(AtomicBool::new(false));
        let script_silence_ms = script.silence_limit_ms;
        let worker = std::thread::spawn({
            let device = Device {
                script,
                sequence: 0,
                boot_id: BOOT_ID,
                connection: FIRST_CONNECTION,
                answered: None,
                executed: Arc::clone(&executed),
                questions: Arc::clone(&questions),
                receiver: CommandReceiver::new(),
                last_command_us: 0,
                calibration: calibration(),
                loaded: [0; MAX_CALIBRATION + PIECE_BYTES],
                limits: [4_000, script_silence_ms],
                packer: Packer::new(PERIOD_US),
                t_us: 1_000_000,
                dropped: 0,
                is_saturated: false,
                state: State::Idle,
                fault: None,
            };
            let stop = Arc::clone(&stop);
            move || device.serve(far, &stop)
        });
        Self { port, executed, questions, stop, worker: Some(worker) }
    }

    /// The commands carried out so far, without hellos and status.
    pub fn executed(&self) -> Vec<Request> {
        self.executed.lock().expect("the device runs").clone()
    }

    /// Number of requests of the status, without repeated frames.
    pub fn questions(&self) -> usize {
        self.questions.load(Ordering::Acquire)
    }
}

impl Drop for FakeDevice {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Release);
        if let Some(worker) = self.worker.take() {
            let _ = worker.join();
        }
    }
}

struct Device {
    script: Script,
    sequence: u32,
    boot_id: u32,
    connection: u32,
    answered: Option<(u16, Message)>,
    executed: Arc<Mutex<Vec<Request>>>,
    questions: Arc<AtomicUsize>,
    receiver: CommandReceiver,
    /// Device time of the last command.
    last_command_us: u64,
    calibration: CalibrationRecord,
    loaded: [u8; MAX_CALIBRATION + PIECE_BYTES],
    /// Force in mN and silence in ms.
    limits: [u32; 2],
    packer: Packer,
    t_us: u64,
    dropped: u32,
    /// Its samples repeat the force.
    is_saturated: bool,
    state: State,
    fault: Option<Fault>,
}

impl Device {
    fn serve(mut self, mut far: Box<dyn Line>, stop: &AtomicBool) {
        while !stop.load(Ordering::Acquire) {
            let commands = self.receive(&mut *far);
            if commands.is_empty() {
                // The near end is not open yet, or nothing came.
                std::thread::sleep(Duration::from_millis(1));
            }
            for command in commands {
                self.handle_command(&command, &mut *far);
                if self.vanishes(&command) {
                    return;
                }
            }
        }
    }

    /// Commands that have arrived.
    fn receive(&mut self, far: &mut dyn Line) -> Vec<Command> {
        let mut bytes = [0; 256];
        let length = far.receive(&mut bytes);
        let received = self.receiver.feed(&bytes[..length]);
        let commands = received.filter_map(|received| match received {
            Received::Frame(command) if !self.script.mute => Some(command),
            _ => None,
        });
        commands.collect()
    }

    fn vanishes(&self, command: &Command) -> bool {
        matches!(command.request, Request::Run { .. }) && self.script.program.contains(&Act::Vanish)
    }

    fn handle_command(&mut self, command: &Command, far: &mut dyn Line) {
        // A repeated frame and a hello are no keepalives, as with the firmware.
        let is_repeated = self.answered.as_ref().is_some_and(|(id, _)| *id == command.id);
        if !is_repeated && command.request != Request::Hello {
            self.last_command_us = self.t_us;
        }
        std::thread::sleep(Duration::from_millis(std::mem::take(&mut self.script.first_answer_after_ms)));
        match command.request {
            Request::Hello => {
                let hello = self.hello();
                self.send(far, Message::Hello(hello));
                self.connection += 1;
                self.answered = None;
                let connection = self.connection;
                self.send(far, Message::Connected { connection });
                return self.send(far, Message::Ack { id: command.id });
            }
            Request::Status => {
                self.questions.fetch_add(usize::from(!is_repeated), Ordering::AcqRel);
                let status = Status { t_us: self.t_us, state: self.state, fault: self.fault, ..status() };
                let [force_limit_mn, silence_limit_ms] = self.limits;
                let status = Status { force_limit_mn, silence_limit_ms, ..status };
                if self.script.lost_statuses > 0 {
                    self.script.lost_statuses -= 1;
                    self.send(far, Message::Status(Status { position_counts: [8, 9], ..status }));
                    self.sequence += 1;
                } else {
                    self.send(far, Message::Status(status));
                }
            }
            Request::Calibration => {
                let record = self.calibration.clone();
                self.send(far, Message::Calibration(record));
            }
            Request::Safety => {
                let safety = Safety {
                    t_us: self.t_us,
                    calibration: self.script.source,
                    tared: self.script.tared,
                    zero_counts: [0; 2],
                    cools_in_s: [0; 2],
                    proven: [true; 2],
                };
                self.send(far, Message::Safety(safety));
            }
            Request::LoadStep { .. } if self.script.late_end => {
                self.event(far, EventKind::ProgramEnded { outcome: Outcome::Stopped });
            }
            _ => {}
        }
        let answer = match &self.answered {
            Some((id, answer)) if *id == command.id => answer.clone(),
            _ => self.execute(command),
        };
        self.answered = Some((command.id, answer.clone()));
        if self.script.lost_answers > 0 {
            self.script.lost_answers -= 1;
            self.sequence += 1;
            return;
        }
        let accepted = matches!(answer, Message::Ack { .. });
        self.send(far, answer);
        if accepted && matches!(command.request, Request::StoreCalibration { .. }) {
            (self.boot_id, self.sequence, self.answered) = (self.boot_id + 1, 0, None);
        }
        if accepted && matches!(command.request, Request::Retreat { .. }) {
            self.event(far, EventKind::RetreatEnded { outcome: RetreatOutcome::Unloaded });
        }
        if accepted && matches!(command.request, Request::Run { .. }) {
            self.state = State::Pending;
            for act in self.script.program.clone() {
                self.act(act, far);
                let silent_us = self.t_us.saturating_sub(self.last_command_us);
                let is_over = silent_us > 1_000 * u64::from(self.limits[1]) && !self.script.is_patient;
                if self.state == State::Holding && is_over {
                    return self.act(Act::Fail(Fault::HostSilent), far);
                }
            }
        }
    }

    /// Whether a connection is among the last ones: a hello that is sent twice ends none.
    fn is_open(&self, connection: u32) -> bool {
        connection > FIRST_CONNECTION
            && connection <= self.connection
            && self.connection - connection < CONNECTIONS
    }

    fn execute(&mut self, command: &Command) -> Message {
        if !self.is_open(command.connection) && command.request != Request::Stop {
            return Message::Refused { id: command.id, refusal: Refusal::OtherBoot };
        }
        if let Some(refusal) = self.script.refusal {
            return Message::Refused { id: command.id, refusal };
        }
        match command.request {
            Request::Limits { force_mn, silence_ms } => self.limits = [force_mn, silence_ms],
            Request::LoadCalibration { piece, bytes } => {
                let piece_start = usize::from(piece) * PIECE_BYTES;
                self.loaded[piece_start..piece_start + PIECE_BYTES].copy_from_slice(&bytes);
            }
            Request::StoreCalibration { length, crc } => {
                let meant = CalibrationRecord::decode(&self.loaded[..usize::from(length)]);
                match meant.filter(|record| record.crc() == crc) {
                    Some(_) if self.script.keeps_no_calibration => {}
                    Some(record) => self.calibration = record,
                    None => {
                        let refusal = Refusal::CalibrationInvalid;
                        return Message::Refused { id: command.id, refusal };
                    }
                }
            }
            _ => {}
        }
        if command.request == Request::AcknowledgeCalibration {
            self.script.source = CalibrationSource::NominalAcknowledged;
        }
        if !matches!(command.request, Request::Status | Request::Safety) {
            self.executed.lock().expect("the test runs").push(command.request);
        }
        Message::Ack { id: command.id }
    }

    fn act(&mut self, act: Act, far: &mut dyn Line) {
        match act {
            Act::Batch(count) => {
                let batch = self.batch(count);
                self.send(far, batch);
            }
            Act::Corrupt(count) => {
                let batch = self.batch(count);
                let mut buffer = [0; MAX_FRAME_TO_HOST];
                let frame = self.encode(&mut buffer, batch);
                let middle = frame.len() / 2;
                // Never a delimiter.
                frame[middle] = if frame[middle] == 0x55 { 0x56 } else { 0x55 };
                far.send(frame);
            }
            Act::Lost(count) => {
                let batch = self.batch(count);
                let mut buffer = [0; MAX_FRAME_TO_HOST];
                self.encode(&mut buffer, batch);
            }
            Act::Dropped(count) => {
                self.t_us += count * u64::from(PERIOD_US);
                self.dropped += u32::try_from(count).expect("few");
            }
            Act::Wait(pause_ms) => {
                let pause_end = Instant::now() + Duration::from_millis(pause_ms);
                while Instant::now() < pause_end {
                    for command in self.receive(far) {
                        self.handle_command(&command, far);
                    }
                    std::thread::sleep(Duration::from_millis(1));
                }
            }
            Act::Complete => {
                self.state = State::Idle;
                self.event(far, EventKind::ProgramEnded { outcome: Outcome::Completed });
            }
            Act::CompleteWithoutEvent => {
                self.state = State::Idle;
                self.sequence += 1;
            }
            Act::Fail(fault) => {
                (self.state, self.fault) = (State::Faulted, Some(fault));
                self.event(far, EventKind::Faulted { fault });
                self.event(far, EventKind::ProgramEnded { outcome: Outcome::Faulted });
            }
            Act::Restart => {
                (self.boot_id, self.sequence) = (self.boot_id + 1, 0);
                self.event(far, EventKind::StepStarted { index: 0 });
            }
            Act::Question => {
                let (asked, limit) = (self.questions.load(Ordering::Acquire), Duration::from_secs(5));
                let began = Instant::now();
                while self.questions.load(Ordering::Acquire) == asked && began.elapsed() < limit {
                    for command in self.receive(far) {
                        self.handle_command(&command, far);
                    }
                    std::thread::sleep(Duration::from_millis(1));
                }
            }
            Act::LoseAnswers(count) => self.script.lost_answers = count,
            Act::ClockBack(ms) => self.t_us = self.t_us.saturating_sub(1_000 * ms),
            Act::Saturated(is_saturated) => self.is_saturated = is_saturated,
            Act::Vanish => {}
        }
    }

    fn event(&mut self, far: &mut dyn Line, kind: EventKind) {
        let event = Event { t_us: self.t_us, kind };
        self.send(far, Message::Event(event));
    }

    /// Samples of a hold; the position counts up by one per sample, so that a test can identify each sample.
    fn batch(&mut self, count: usize) -> Message {
        self.state = State::Holding;
        let mut closed = None;
        for _ in 0..count {
            assert!(closed.is_none(), "more samples than a batch holds");
            self.t_us += u64::from(PERIOD_US);
            let elapsed_ms = i32::try_from(self.t_us / 1_000).expect("a short test");
            let sample = Sample {
                position_counts: [0, elapsed_ms],
                force_counts: [0, 10 * elapsed_ms],
                repeats_force: self.is_saturated,
            };
            closed = self.packer.push(self.t_us, State::Holding, 0, self.dropped, sample);
        }
        Message::Samples(closed.or_else(|| self.packer.flush()).expect("a batch of at least one sample"))
    }

    fn send(&mut self, far: &mut dyn Line, message: Message) {
        let mut buffer = [0; MAX_FRAME_TO_HOST];
        let frame = self.encode(&mut buffer, message);
        far.send(frame);
    }

    fn encode<'b>(&mut self, buffer: &'b mut [u8], message: Message) -> &'b mut [u8] {
        let envelope = Envelope { boot_id: self.boot_id, sequence: self.sequence, message };
        self.sequence += 1;
        let length = encode_envelope(&envelope, buffer).expect("fits").len();
        &mut buffer[..length]
    }

    fn hello(&self) -> Hello {
        Hello {
            protocol_version: self.script.version,
            schema_hash: self.script.schema_hash,
            now_us: self.t_us,
            calibration: CalibrationId { id: self.calibration.id.clone(), crc: self.calibration.crc() },
            ..hello()
        }
    }
}
