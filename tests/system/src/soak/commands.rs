//! Random commands and programs, sound ones and others.

use super::PATIENT_MS;
use super::answers::{Answer, is_active};
use super::device::Device;
use anyhow::{Result, ensure};
use device::link::LinkError;
use protocol::{MAX_STEPS, PIECE_BYTES, Refusal, Request, Step, program_crc};
use rand::RngExt;
use std::time::Duration;

/// Force that the soak's own moves may need along either axis, newtons: twice that is less than any limit it sets.
const PUSH_N: f64 = 2.0;
/// Furthest that it moves, micrometres.
const FURTHEST_UM: f64 = 2_500.0;
/// Speeds of moves, micrometres per second.
const SPEEDS_UM_S: std::ops::Range<u32> = 500..4_000;
/// Time beyond one and a half times its own that a move may take, milliseconds: the firmware's three seconds, and a margin for its
/// ramps.
const SETTLES_MS: u64 = 4_000;

/// A program to be tried.
struct Plan {
    name: &'static str,
    steps: Vec<Step>,
    /// Steps to run, where that is another number.
    count: Option<u8>,
    wrong_crc: bool,
    start_us: u64,
    /// What loading the last step is answered with.
    loads: Result<(), Refusal>,
    /// What running it is.
    runs: Result<(), Refusal>,
}

impl Plan {
    fn new(name: &'static str, steps: Vec<Step>) -> Self {
        Self { name, steps, count: None, wrong_crc: false, start_us: 0, loads: Ok(()), runs: Ok(()) }
    }
}

impl Device<'_> {
    /// One command or program.
    pub fn command(&mut self) -> Result<()> {
        match self.random.random_range(0..100) {
            0..45 => self.program(),
            45..50 => self.order(Request::Hello, Ok(()), None).map(drop),
            50..54 => self.calibration(),
            54..61 => self.limits(),
            61..71 => {
                self.deadline_ms = None;
                self.insist(Request::Stop)
            }
            71..76 => self.order(Request::ClearFault, Ok(()), None).map(drop),
            76..82 => self.samples_off_and_on(),
            82..88 => self.reopen(),
            88..91 => self.in_a_cut(),
            91..95 => self.wrong_calibration(),
            _ => self.status().map(drop),
        }
    }

    fn reach_um(&self) -> i32 {
        let stiffness_n_per_m = self.rig().rig(|rig| rig.truth().stiffness_n_per_m);
        (PUSH_N / stiffness_n_per_m * 1e6).min(FURTHEST_UM) as i32
    }

    fn target(&mut self) -> (i32, i32) {
        let reach_um = self.reach_um();
        (self.random.random_range(-reach_um..=reach_um), self.random.random_range(-reach_um..=reach_um))
    }

    fn step_to_anywhere(&mut self) -> Step {
        let ((x_um, y_um), speed_um_s) = (self.target(), self.random.random_range(SPEEDS_UM_S));
        Step::Move { x_um, y_um, speed_um_s }
    }

    fn hold(&mut self) -> Step {
        Step::Hold { duration_ms: self.random.random_range(100..1_500) }
    }

    fn plan(&mut self, t_us: u64, cool: bool) -> Plan {
        let kinds = if cool { 0..15 } else { 8..15 };
        match self.random.random_range(kinds) {
            0 | 1 => Plan::new("move", vec![self.step_to_anywhere(), self.hold()]),
            2 => Plan::new("jog", vec![self.step_to_anywhere()]),
            3 | 4 => {
                let ((x_um, y_um), duration_ms) = (self.target(), self.random.random_range(4_000..6_000));
                Plan::new("ramp", vec![Step::Ramp { x_um, y_um, duration_ms }, self.hold()])
            }
            5 | 6 => {
                let ((x_um, _), reach_um) = (self.target(), self.reach_um());
                let rungs = self.random.random_range(3..6);
                let rung = |rung| -reach_um + 2 * reach_um * rung / rungs;
                let moves = (0..=rungs).map(|k| Step::Move { x_um, y_um: rung(k), speed_um_s: 2_000 });
                let hold = Step::Hold { duration_ms: 200 };
                Plan::new("staircase", moves.flat_map(|step| [step, hold]).collect())
            }
            7 => Plan {
                start_us: t_us + 5_000_000,
                ..Plan::new("later", vec![self.step_to_anywhere(), self.hold()])
            },
            8 => Plan::new("hold", vec![self.hold(), self.hold()]),
            9 => {
                let duration_ms = self.random.random_range(100..1_000);
                Plan::new("tare", vec![Step::Tare { duration_ms }])
            }
            10 => Plan {
                wrong_crc: true,
                runs: Err(Refusal::ProgramMismatch),
                ..Plan::new("wrong checksum", vec![self.step_to_anywhere()])
            },
            11 => {
                let count = self.random.random_range(MAX_STEPS as u8 + 1..=u8::MAX);
                let count = if self.random.random_bool(0.2) { 0 } else { count };
                let runs = Err(Refusal::OutOfRange);
                Plan { count: Some(count), runs, ..Plan::new("too many steps, or none", vec![self.hold()]) }
            }
            12 => Plan {
                start_us: 1,
                runs: Err(Refusal::TooLate),
                ..Plan::new("too late", vec![self.step_to_anywhere()])
            },
            13 => {
                let far = Step::Move { x_um: 0, y_um: -10_001, speed_um_s: 1_000 };
                Plan { loads: Err(Refusal::OutOfTravel), ..Plan::new("beyond travel", vec![far]) }
            }
            _ => {
                let slow = Step::Ramp { x_um: 0, y_um: 0, duration_ms: 4_000 };
                let fast = Step::Ramp { x_um: 0, y_um: 1_500, duration_ms: 100 };
                let runs = Err(Refusal::OutOfRange);
                Plan { runs, ..Plan::new("ramp too fast", vec![slow, fast]) }
            }
        }
    }

    fn program(&mut self) -> Result<()> {
        let status = self.status()?;
        let plan = self.plan(status.t_us, Self::motors_are_cool(&status));
        // Beside one that runs, nothing else may be loaded.
        self.tally.program(if is_active(status.state) { "while busy" } else { plan.name });
        self.start(&plan).map(drop)
    }

    fn start(&mut self, plan: &Plan) -> Result<Answer> {
        let last = plan.steps.len() - 1;
        for (index, step) in plan.steps.iter().enumerate() {
            let sound = if index == last { plan.loads } else { Ok(()) };
            let answer = self.order(Request::LoadStep { index: index as u8, step: *step }, sound, None)?;
            if answer != Answer::Accepted {
                return Ok(answer);
            }
        }
        let tares = plan.steps.iter().filter(|step| matches!(step, Step::Tare { .. })).count();
        self.books.tares_begin(tares as u32);
        let from_ms = self.now_ms();
        let crc = program_crc(&plan.steps) ^ u32::from(plan.wrong_crc);
        let steps = plan.count.unwrap_or(plan.steps.len() as u8);
        // On a bad line the start may come too late.
        let or = (plan.start_us > 0).then_some(Refusal::TooLate);
        let before = self.deadline_ms.take();
        let answer = self.order(Request::Run { steps, crc, start_us: plan.start_us }, plan.runs, or)?;
        self.deadline_ms = match answer {
            // A lost answer may have been one.
            Answer::Accepted | Answer::Unanswered => {
                let waits_ms = if plan.start_us > 0 { 5_000 } else { 0 };
                let duration_ms: u64 = plan.steps.iter().map(|step| self.longest_ms(step)).sum();
                Some(self.now_ms().max(from_ms) + waits_ms + duration_ms)
            }
            Answer::Refused(_) => before,
        };
        Ok(answer)
    }

    /// How long a step may take.
    fn longest_ms(&self, step: &Step) -> u64 {
        match *step {
            Step::Hold { duration_ms } | Step::Tare { duration_ms } | Step::Ramp { duration_ms, .. } => {
                u64::from(duration_ms) + 10
            }
            Step::Move { speed_um_s, .. } => {
                let path_um = 3.0 * f64::from(self.reach_um());
                SETTLES_MS + (1.5 * path_um / f64::from(speed_um_s) * 1e3) as u64
            }
        }
    }

    /// To the middle, and waits for the end.
    pub fn home(&mut self) -> Result<()> {
        let plan = Plan::new("home", vec![Step::Move { x_um: 0, y_um: 0, speed_um_s: 1_500 }]);
        while self.start(&plan)? != Answer::Accepted {}
        self.until("the guide is home", 30_000, |device| Ok(!is_active(device.status()?.state))).map(drop)
    }

    /// A move along y that takes a second or more and a hold; whether it was begun.
    pub fn move_for_a_fault(&mut self, position_um: [i32; 2], hold_ms: u32) -> Result<bool> {
        let [x_um, at_um] = position_um;
        let reach_um = self.reach_um();
        let y_um = if at_um > 0 { -reach_um } else { reach_um };
        let speed_um_s = u32::try_from(reach_um).unwrap_or(1_000).min(1_800);
        let steps = vec![Step::Move { x_um, y_um, speed_um_s }, Step::Hold { duration_ms: hold_ms }];
        let plan = Plan::new("fault", steps);
        let answer = self.start(&plan)?;
        Ok(answer == Answer::Accepted)
    }

    fn calibration(&mut self) -> Result<()> {
        self.until("the cable is mended", u64::MAX, |device| Ok(!device.line.is_cut()))?;
        let answer = match self.client()?.calibration() {
            Ok(record) => {
                ensure!(record.id.as_str() == "nominal", "another calibration: {}", record.id.as_str());
                Answer::Accepted
            }
            Err(LinkError::Unanswered { .. }) if self.line.is_bad() => Answer::Unanswered,
            Err(error) => return Err(error.into()),
        };
        self.tally.command("calibration", answer);
        self.drain()
    }

    fn limits(&mut self) -> Result<()> {
        let (force_mn, silence_ms, sound) = match self.random.random_range(0..6) {
            0 => (0, PATIENT_MS, Err(Refusal::OutOfRange)),
            1 => (5_001, PATIENT_MS, Err(Refusal::OutOfRange)),
            2 => (self.force_mn, 199, Err(Refusal::OutOfRange)),
            3 => (self.force_mn, 60_001, Err(Refusal::OutOfRange)),
            _ => (self.random.random_range(4_200..4_500), PATIENT_MS, Ok(())),
        };
        let answer = self.order(Request::Limits { force_mn, silence_ms }, sound, None)?;
        if answer == Answer::Accepted {
            self.force_mn = force_mn;
        }
        let status = self.status()?;
        if answer != Answer::Unanswered {
            let reported = (status.force_limit_mn, status.silence_limit_ms);
            ensure!(reported == (self.force_mn, self.silence_ms), "the limits are {reported:?}");
        }
        self.force_mn = status.force_limit_mn;
        Ok(())
    }

    fn samples_off_and_on(&mut self) -> Result<()> {
        self.insist(Request::Stream { enable: false })?;
        let pause_ms = self.random.random_range(0..1_000);
        self.pass(pause_ms)?;
        self.resume_stream()
    }

    fn reopen(&mut self) -> Result<()> {
        let boot_id = self.client()?.boot_id();
        self.close()?;
        std::thread::sleep(Duration::from_millis(self.random.random_range(0..500)));
        self.connect()?;
        self.books.reopen(true);
        self.tally.reopened += 1;
        let now_id = self.client()?.boot_id();
        ensure!(now_id == boot_id, "the device has restarted while the port was closed");
        Ok(())
    }

    /// A question while the cable is cut is not answered, and what comes afterwards is not taken for its answer.
    fn in_a_cut(&mut self) -> Result<()> {
        if !self.line.is_cut() {
            return self.status().map(drop);
        }
        let answer = self.client()?.request(Request::Calibration);
        ensure!(
            matches!(answer, Err(LinkError::Unanswered { .. })),
            "{answer:?} through a cable that is cut"
        );
        self.tally.command("calibration", Answer::Unanswered);
        Ok(())
    }

    fn wrong_calibration(&mut self) -> Result<()> {
        let bytes = [0x5A; PIECE_BYTES];
        if self.random.random() {
            let piece = Request::LoadCalibration { piece: 200, bytes };
            return self.order(piece, Err(Refusal::OutOfRange), None).map(drop);
        }
        self.order(Request::LoadCalibration { piece: 0, bytes }, Ok(()), None)?;
        let store = Request::StoreCalibration { length: PIECE_BYTES as u8, crc: 1 };
        self.order(store, Err(Refusal::CalibrationInvalid), None).map(drop)
    }
}
