//! The controller against a small plant, and over arbitrary inputs.

use super::axis::REENGAGE_ERROR_UM;
use super::*;
use crate::ads131m02::ForceFault;
use crate::hal::Readings;
use noise::Noise;
use proptest::prelude::*;
use protocol::{
    CalibrationRecord, Command, Counters, Load, Refusal, Request, RetreatOutcome, State, Step, TareProblem,
    program_crc,
};

mod evidence;
mod faults;
mod findings;
mod matrix;

const BOOT: u32 = 42;
/// Greatest code of the force converter.
const CODE_MAX: i32 = 0x7F_FFFF;

/// A controller to which a host has just connected, and the token of the connection.
fn connected(calibration: Calibration, start: Start) -> (Controller, u32) {
    let mut controller = Controller::new(calibration, start);
    let token = controller.conversation.begin();
    (controller, token)
}

/// Two actuators that follow the duty with a dead band, and a spring of 1 N/mm on each axis.
struct Bench {
    controller: Controller,
    position_um: [f32; 2],
    now_us: u64,
    late_us: u32,
    emergency_stop: bool,
    force_fault: Option<ForceFault>,
    stiffness_n_per_um: f32,
    /// Force added to that of the springs, newtons.
    push_n: [f32; 2],
    force_stuck: bool,
    /// Noise of a reading, and amplitude of the hum, newtons.
    noise_n: f32,
    hum_n: f32,
    potentiometer_codes: Option<[u16; 2]>,
    /// Speed of the motors as a fraction of the nominal one.
    strength: f32,
    /// The bridge of y is stuck at this duty.
    runaway: Option<f32>,
    /// Periods between two status requests of the host; 0 for a silent host.
    request_periods: u64,
    connection: u32,
    next_id: u16,
    notes: std::vec::Vec<OutboundMessage>,
    last: Option<Outputs>,
}

impl Bench {
    fn new() -> Self {
        let (controller, connection) = connected(Calibration::default(), Start::ordinary(BOOT));
        Self {
            controller,
            connection,
            position_um: [300.0, -800.0],
            now_us: 0,
            late_us: 0,
            emergency_stop: false,
            force_fault: None,
            stiffness_n_per_um: 1e-3,
            push_n: [0.0; 2],
            force_stuck: false,
            noise_n: 0.4e-3,
            hum_n: 0.0,
            potentiometer_codes: None,
            strength: 1.0,
            runaway: None,
            request_periods: 500,
            next_id: 1,
            notes: vec![],
            last: None,
        }
    }

    fn period(&mut self, command: Option<Command>) -> Outputs {
        self.now_us += u64::from(PERIOD_US);
        let due = self.request_periods > 0 && (self.now_us / 1_000).is_multiple_of(self.request_periods);
        let command = command.or_else(|| {
            let id = self.next_id;
            self.next_id = self.next_id.wrapping_add(due.into());
            due.then_some(Command { id, connection: self.connection, request: Request::Status })
        });
        let code = |um: f32| (um / 12.207_031 + 2_048.0).round().clamp(0.0, 4_095.0) as u16;
        // 1 N/mm; a code is 1.12 uN, and the converter has its own noise.
        let period = self.now_us / 1_000;
        let mut noise = Noise::new(if self.force_stuck { 0 } else { period });
        let hum_n = self.hum_n * (std::f32::consts::TAU * 0.05 * (period % 20) as f32).sin();
        let force = [0, 1].map(|axis| {
            let force_n = self.position_um[axis] * self.stiffness_n_per_um + self.push_n[axis] + hum_n;
            ((force_n + noise.normal() as f32 * self.noise_n) / 1_117.587e-9) as i32
        });
        let at_its_end = force.iter().position(|code| *code >= CODE_MAX);
        let saturated = at_its_end.map(|channel| ForceFault::Saturated { channel: channel as u8 });
        let readings = Readings {
            potentiometer_codes: self.potentiometer_codes.unwrap_or(self.position_um.map(code)),
            force_codes: self.force_fault.or(saturated).map_or(Ok(force), Err),
            emergency_stop: self.emergency_stop,
        };
        let inputs = Inputs {
            now_us: self.now_us,
            late_us: self.late_us,
            readings,
            command,
            counters: Counters::default(),
            load: Load::default(),
        };
        let outputs = self.controller.step(&inputs);
        if let Drive::Duty(duty) = outputs.drive {
            for (position_um, duty) in self.position_um.iter_mut().zip(duty) {
                let drive_fraction = ((duty.abs() - 0.2) / 0.8).max(0.0).copysign(duty);
                *position_um += drive_fraction * 20_000.0 * self.strength * PERIOD_S;
            }
        }
        if let Some(duty) = self.runaway {
            self.position_um[1] += duty * 20_000.0 * PERIOD_S;
        }
        self.notes.extend(outputs.notes.iter().copied());
        self.last = Some(outputs.clone());
        outputs
    }

    fn periods(&mut self, count: u32) -> Outputs {
        (0..count).map(|_| self.period(None)).last().expect("at least one period")
    }

    fn command(&mut self, request: Request) -> Result<(), Refusal> {
        let id = self.next_id;
        self.next_id += 1;
        self.answer(Command { id, connection: self.connection, request })
    }

    fn answer(&mut self, command: Command) -> Result<(), Refusal> {
        let outputs = self.period(Some(command));
        let answer = outputs.notes.iter().find_map(|note| match *note {
            OutboundMessage::Ack(id) if id == command.id => Some(Ok(())),
            OutboundMessage::Refused(id, refusal) if id == command.id => Some(Err(refusal)),
            _ => None,
        });
        answer.expect("every command is answered in its period")
    }

    fn run(&mut self, steps: &[Step]) {
        for (index, step) in steps.iter().enumerate() {
            self.command(Request::LoadStep { index: index as u8, step: *step }).expect("loads");
        }
        let run = Request::Run { steps: steps.len() as u8, crc: program_crc(steps), start_us: 0 };
        self.command(run).expect("runs");
    }

    fn finish(&mut self) -> Outcome {
        for _ in 0..60_000 {
            self.period(None);
            let ended = self.notes.iter().find_map(|note| match note {
                OutboundMessage::Event(Event { kind: EventKind::ProgramEnded { outcome }, .. }) => {
                    Some(*outcome)
                }
                _ => None,
            });
            if let Some(outcome) = ended {
                return outcome;
            }
        }
        panic!("the program does not end");
    }
}

#[test]
fn homes_tares_displaces_and_holds() {
    let mut bench = Bench::new();
    bench.run(&[
        Step::Move { x_um: 0, y_um: 0, speed_um_s: 2_000 },
        Step::Tare { duration_ms: 200 },
        Step::Move { x_um: 0, y_um: 1_200, speed_um_s: 1_000 },
        Step::Hold { duration_ms: 500 },
    ]);
    assert_eq!(bench.finish(), Outcome::Completed);
    assert!(bench.position_um[0].abs() < REENGAGE_ERROR_UM, "{:?}", bench.position_um);
    assert!((bench.position_um[1] - 1_200.0).abs() < REENGAGE_ERROR_UM, "{:?}", bench.position_um);
    let outputs = bench.periods(1);
    assert_eq!((outputs.state, outputs.step, outputs.drive), (State::Idle, NO_STEP, Drive::Release));
    // After the tare at home the force is that of the displacement alone: 20 counts per micrometre.
    let [_, force] = outputs.sample.force_counts;
    assert!((force as f32 - 24_000.0).abs() < 20.0 * 2.0 * REENGAGE_ERROR_UM, "{force}");
    let order: std::vec::Vec<u8> = bench
        .notes
        .iter()
        .filter_map(|note| match note {
            OutboundMessage::Event(Event { kind: EventKind::StepEnded { index }, .. }) => Some(*index),
            _ => None,
        })
        .collect();
    assert_eq!(order, [0, 1, 2, 3]);
}

#[test]
fn a_program_waits_for_its_time() {
    let mut bench = Bench::new();
    let steps = [Step::Hold { duration_ms: 10 }];
    bench.command(Request::LoadStep { index: 0, step: steps[0] }).expect("loads");
    let run = Request::Run { steps: 1, crc: program_crc(&steps), start_us: 500_000 };
    bench.command(run).expect("accepted");
    while bench.now_us < 499_000 {
        assert_eq!(bench.period(None).state, State::Pending);
    }
    assert_eq!(bench.period(None).state, State::Holding);
    assert_eq!(bench.now_us, 500_000);
}

#[test]
fn the_emergency_stop_releases_at_once_and_latches() {
    let mut bench = Bench::new();
    bench.run(&[Step::Move { x_um: 0, y_um: 5_000, speed_um_s: 2_000 }]);
    assert!(matches!(bench.periods(200).drive, Drive::Duty(_)));
    bench.emergency_stop = true;
    let outputs = bench.periods(1);
    assert_eq!((outputs.drive, outputs.state), (Drive::Release, State::Faulted));
    assert_eq!(bench.command(Request::ClearFault), Err(Refusal::CauseRemains));
    bench.emergency_stop = false;
    assert_eq!(bench.periods(100).state, State::Faulted);
    let run = Request::Run { steps: 1, crc: 0, start_us: 0 };
    assert_eq!(bench.command(run), Err(Refusal::Faulted { fault: Fault::EmergencyStop }));
    bench.command(Request::ClearFault).expect("the cause is gone");
    assert_eq!(bench.periods(1).state, State::Idle);
    assert_eq!(bench.finish(), Outcome::Faulted);
}

#[test]
fn a_repeated_command_is_carried_out_once() {
    let mut bench = Bench::new();
    let steps = [Step::Hold { duration_ms: 5 }];
    bench.command(Request::LoadStep { index: 0, step: steps[0] }).expect("loads");
    let request = Request::Run { steps: 1, crc: program_crc(&steps), start_us: 0 };
    let run = Command { id: 900, connection: bench.connection, request };
    bench.next_id = 901;
    assert_eq!(bench.answer(run), Ok(()));
    bench.periods(50);
    assert_eq!(bench.answer(run), Ok(()));
    bench.periods(50);
    assert_eq!(
        bench
            .notes
            .iter()
            .filter(|note| {
                matches!(note, OutboundMessage::Event(Event { kind: EventKind::StepStarted { .. }, .. }))
            })
            .count(),
        1
    );
}

#[test]
fn stop_ends_a_program_even_with_the_token_of_an_earlier_boot() {
    let mut bench = Bench::new();
    bench.run(&[Step::Move { x_um: 0, y_um: 5_000, speed_um_s: 1_000 }]);
    bench.periods(100);
    assert_eq!(bench.answer(Command { id: 800, connection: BOOT - 1, request: Request::Stop }), Ok(()));
    assert_eq!(bench.last.as_ref().map(|last| last.drive), Some(Drive::Release));
    assert_eq!(bench.finish(), Outcome::Stopped);
}

#[test]
fn a_repeated_status_request_is_answered_again() {
    let mut bench = Bench::new();
    let status = Command { id: 5, connection: bench.connection, request: Request::Status };
    for _ in 0..2 {
        let outputs = bench.period(Some(status));
        assert!(
            matches!(outputs.notes.as_slice(), [OutboundMessage::Status(_), OutboundMessage::Ack(5)]),
            "{:?}",
            outputs.notes
        );
    }
}

fn any_step() -> impl Strategy<Value = Step> {
    prop_oneof![
        (any::<i32>(), any::<i32>(), any::<u32>()).prop_map(|(x_um, y_um, speed_um_s)| Step::Move {
            x_um,
            y_um,
            speed_um_s
        }),
        (-9_000..9_000, -9_000..9_000, 1_u32..9_000).prop_map(|(x_um, y_um, speed_um_s)| Step::Move {
            x_um,
            y_um,
            speed_um_s
        }),
        (0_u32..20).prop_map(|duration_ms| Step::Hold { duration_ms }),
        (0_u32..20).prop_map(|duration_ms| Step::Tare { duration_ms }),
        (-9_000..9_000, any::<i32>(), 0_u32..2_000).prop_map(|(x_um, y_um, duration_ms)| Step::Ramp {
            x_um,
            y_um,
            duration_ms
        }),
    ]
}

fn any_request() -> impl Strategy<Value = Request> {
    prop_oneof![
        Just(Request::Hello),
        Just(Request::Status),
        any::<bool>().prop_map(|enable| Request::Stream { enable }),
        any_step().prop_map(|step| Request::LoadStep { index: 0, step }),
        any_step().prop_map(|step| Request::Run { steps: 1, crc: program_crc(&[step]), start_us: 0 }),
        Just(Request::Stop),
        Just(Request::ClearFault),
        Just(Request::Calibration),
        Just(Request::Safety),
        Just(Request::Describe),
        Just(Request::AcknowledgeCalibration),
        (-1_100_i32..1_100, -1_100_i32..1_100).prop_map(|(x_um, y_um)| Request::Retreat { x_um, y_um }),
        (0_u8..3, -400_i16..400, 0_u8..60).prop_map(|(axis, duty_permille, duration_ms)| Request::Pulse {
            axis,
            duty_permille,
            duration_ms
        }),
        any::<(u32, u32)>().prop_map(|(force_mn, silence_ms)| Request::Limits { force_mn, silence_ms }),
        any::<(u8, [u8; 16])>().prop_map(|(piece, bytes)| Request::LoadCalibration { piece, bytes }),
        any::<(u8, u32)>().prop_map(|(length, crc)| Request::StoreCalibration { length, crc }),
    ]
}

fn any_readings() -> impl Strategy<Value = Readings> {
    let force = prop_oneof![
        any::<[i32; 2]>().prop_map(Ok),
        (-100_i32..100, -100_i32..100).prop_map(|(x, y)| Ok([x, y])),
        Just(Err(ForceFault::NotReady)),
        Just(Err(ForceFault::Saturated { channel: 0 })),
    ];
    (any::<[u16; 2]>(), force, proptest::bool::weighted(0.05)).prop_map(
        |(potentiometer_codes, force_codes, emergency_stop)| Readings {
            potentiometer_codes,
            force_codes,
            emergency_stop,
        },
    )
}

proptest! {
    #[test]
    fn no_input_panics_and_a_fault_never_drives(
        periods in prop::collection::vec((any_readings(), prop::option::of(any_request())), 1..120),
    ) {
        let (mut controller, connection) = connected(Calibration::default(), Start::ordinary(BOOT));
        for (index, (readings, request)) in periods.into_iter().enumerate() {
            let now_us = index as u64 * u64::from(PERIOD_US);
            let command = request.map(|request| Command { id: index as u16, connection, request });
            let counters = Counters::default();
            let load = Load::default();
            let outputs = controller.step(&Inputs { now_us, late_us: 0, readings, command, counters, load });
            match outputs.drive {
                Drive::Release => {}
                Drive::Duty(duty) => {
                    prop_assert!(duty.iter().all(|duty| (-1.0..=1.0).contains(duty)));
                    prop_assert!(!readings.emergency_stop);
                    prop_assert!(outputs.state != State::Faulted);
                }
            }
        }
    }
}

/// The token of the first connection of this boot.
fn first_token() -> u32 {
    commands::CommandSession::new(BOOT).begin()
}

/// An intact frame of any command.
fn any_frame() -> impl Strategy<Value = std::vec::Vec<u8>> {
    (any::<u16>(), prop_oneof![Just(first_token()), any::<u32>()], any_request()).prop_map(
        |(id, connection, request)| {
            let mut buffer = [0; protocol::MAX_FRAME_TO_DEVICE];
            let command = Command { id, connection, request };
            protocol::encode_command(&command, &mut buffer).expect("the bound suffices").to_vec()
        },
    )
}

/// Bytes of a faulty host or a bad line.
fn any_bytes() -> impl Strategy<Value = std::vec::Vec<u8>> {
    let damaged =
        (any_frame(), any::<prop::sample::Index>(), any::<u8>()).prop_map(|(mut bytes, at, flip)| {
            let byte_index = at.index(bytes.len());
            bytes[byte_index] ^= flip;
            bytes
        });
    let noise = prop::collection::vec(any::<u8>(), 0..80);
    prop::collection::vec(prop_oneof![3 => any_frame(), 1 => damaged, 1 => noise], 1..40)
        .prop_map(|parts| parts.concat())
}

struct Sink(u32);

impl telemetry::Outbox for Sink {
    fn room(&self) -> usize {
        20
    }

    fn put(&mut self, item: telemetry::Item) -> bool {
        self.0 += u32::from(matches!(item, telemetry::Item::Batch(_)));
        true
    }
}

proptest! {
    /// From the bytes on the line to the duty of the bridges: no bytes cause a panic, or a drive in a fault.
    #[test]
    fn no_bytes_panic_and_no_bytes_drive_in_a_fault(bytes in any_bytes(), readings in any_readings()) {
        let mut receiver = protocol::CommandReceiver::new();
        let (mut controller, _) = connected(Calibration::default(), Start::ordinary(BOOT));
        let (mut telemetry, mut sink) = (telemetry::Telemetry::new(), Sink(0));
        let mut now_us = 0;
        let mut period = |command: Option<Command>, emergency_stop: bool| {
            now_us += u64::from(PERIOD_US);
            let readings = Readings { emergency_stop, ..readings };
            let (counters, load) = (Counters::default(), Load::default());
            let outputs = controller.step(&Inputs { now_us, late_us: 0, readings, command, counters, load });
            telemetry.send(now_us, &outputs, &mut sink);
            outputs
        };
        for received in receiver.feed(&bytes) {
            let protocol::Received::Frame(command) = received else { continue };
            for outputs in [period(Some(command), false), period(None, false), period(None, true)] {
                let faulted = outputs.state == State::Faulted;
                prop_assert!(!faulted || outputs.drive == Drive::Release);
            }
        }
    }
}
