//! The simulated rig on the far side of the firmware's drivers, in lockstep with its control period.
//!
//! Once per millisecond of device time the firmware in QEMU writes one record into a named pipe (what the PWM outputs are) and
//! waits for one (what the converters read): device time passes exactly as the rig does, however fast the machine is. A
//! firmware that resets goes on with the same rig.
//!
//! | part | does |
//! |---|---|
//! | [`wiring`] | what is wired wrong from the start |
//! | [`injection`] | what goes wrong between rig and firmware, and how soon the firmware reacts |
//! | [`history`] | what passed between them in each of the last periods |
//! | [`sweeps`] | the rig's ultrasound |
//! | [`needle`] | a needle that another program pushes into its tissue, and that loads the rig's guide 2 |
//! | [`output`] | what the device sends on its serial line |
//! | [`gate`] | where device time waits for a host that is not given processor time |
//! | [`allowance`] | how far device time may go for a host that allows it step by step |
//! | [`pace`] | how fast device time runs otherwise |

mod allowance;
mod gate;
mod history;
mod injection;
mod line;
mod needle;
pub(crate) mod output;
mod pace;
mod sweeps;
mod wiring;

pub use gate::Appointment;
pub use history::{History, KEPT_PERIODS, Period};
pub use injection::{Injection, Reaction, Trigger};
pub use line::{BITS_PER_BYTE, LINE_BAUD};
pub use needle::GuideSocket;
pub use sweeps::{take_frames, take_sweep};
pub use wiring::{Fault, Kind};

use crate::qemu::HANGS;
use allowance::Allowance;
use anyhow::{Context, Result, bail};
use emulation::plant::{FORCE_CODE_MAX, PERIOD_US, PlantReply, PlantRequest, RECORD_BYTES};
use gate::Gate;
use injection::Electronics;
use output::{Output, open_pipes, read_record};
use pace::Pace;
use simulation::rig::SimulatedRig;
use simulation::rig::config::RigConfig;
use std::io::Write;
use std::os::unix::net::UnixStream;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};
use wiring::Wiring;

/// Length of one lockstep period, seconds.
const PERIOD_S: f64 = 1e-3;
/// Names of the sockets on which sweeps and scans are served.
const SWEEPS: &str = "ultrasound";
const SCANS: &str = "scanner";
/// Interval at which the waiting rig checks whether its event has come.
const POLL_INTERVAL: Duration = Duration::from_millis(2);

#[derive(Debug)]
struct State {
    rig: SimulatedRig,
    electronics: Electronics,
    /// Periods since the start.
    steps: u64,
    /// Starts of the firmware after the first.
    resets: u64,
    /// Period in which the firmware started last.
    started: u64,
    /// Largest true distance of guide 2 from the middle, and largest load on it, since this was last read.
    reach: Reach,
    /// Motion of each axis from its start, and change of its force, if they are watched.
    watched: Option<Watched>,
    /// Exchange in each of the last periods, if it is to be kept.
    history: Option<History>,
    gate: Gate,
    /// Time to which the host lets device time advance, if it does so step by step.
    allowance: Option<Allowance>,
    /// Bytes that the device had sent over its line before the period.
    sent_bytes: u64,
}

/// The most of both axes.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Reach {
    /// Distance from the middle, metres.
    pub position_m: f64,
    /// Force, newtons.
    pub force_n: f64,
}

/// Motion that is watched from a moment on: where the guide stood then, and the most of its motion and of the force's
/// change since.
#[derive(Debug, Clone, Copy)]
struct Watched {
    from_m: [f64; 2],
    from_n: [f64; 2],
    most: Reach,
}

impl Watched {
    fn new(rig: &SimulatedRig) -> Self {
        Self { from_m: rig.position_m(), from_n: rig.force_n(), most: Reach::default() }
    }

    fn see(&mut self, rig: &SimulatedRig) {
        self.most.position_m = self.most.position_m.max(largest_difference(rig.position_m(), self.from_m));
        self.most.force_n = self.most.force_n.max(largest_difference(rig.force_n(), self.from_n));
    }
}

fn largest_difference(now: [f64; 2], from: [f64; 2]) -> f64 {
    now.into_iter().zip(from).map(|(now, from)| (now - from).abs()).fold(0.0, f64::max)
}

/// The running rig.
#[derive(Debug)]
pub struct Cosim {
    state: Arc<Mutex<State>>,
    stop: Arc<AtomicBool>,
    folder: PathBuf,
    worker: Option<JoinHandle<Result<()>>>,
}

impl Cosim {
    /// Makes the pipes and the socket in a folder and waits there for the firmware. `speed`: how many times faster than the
    /// wall clock the rig may run; infinite for as fast as it can. It never runs ahead of a host: see [`gate`].
    ///
    /// # Errors
    /// Where the rig makes no sense, or pipes or socket cannot be made.
    pub fn start(config: RigConfig, seed: u64, folder: &Path, speed: f64) -> Result<Self> {
        Self::start_wired(config, seed, folder, speed, Vec::new())
    }

    /// The same with these faults of wiring, mounting and sensors.
    ///
    /// # Errors
    /// As [`Self::start`].
    pub fn start_wired(
        config: RigConfig,
        seed: u64,
        folder: &Path,
        speed: f64,
        faults: Vec<Fault>,
    ) -> Result<Self> {
        let force = &config.simulation.force;
        let codes_per_n = force.share_of_full_scale * f64::from(FORCE_CODE_MAX) / force.range_n;
        let wiring = Wiring::new(faults, seed, codes_per_n, force.noise_n);
        let rig = SimulatedRig::new(config, seed)?;
        let output = Output::open(folder)?;
        let state = Arc::new(Mutex::new(State {
            rig,
            electronics: Electronics::new(codes_per_n, wiring),
            steps: 0,
            resets: 0,
            started: 0,
            reach: Reach::default(),
            watched: None,
            history: None,
            gate: Gate::new(),
            allowance: None,
            sent_bytes: 0,
        }));
        let stop = Arc::new(AtomicBool::new(false));
        for (name, taken) in
            [(SWEEPS, sweeps::sweep_csv as fn(&mut SimulatedRig) -> String), (SCANS, sweeps::scan_json)]
        {
            sweeps::serve(&folder.join(name), Arc::clone(&state), Arc::clone(&stop), taken)?;
        }
        needle::serve(&folder.join("needle"), Arc::clone(&state), Arc::clone(&stop))?;
        let worker = thread::Builder::new().name("rig".into()).spawn({
            let (state, stop, folder) = (Arc::clone(&state), Arc::clone(&stop), folder.to_owned());
            move || serve(&state, &stop, &folder, output, speed)
        })?;
        Ok(Self { state, stop, folder: folder.to_owned(), worker: Some(worker) })
    }

    /// Announces motion programs that a host is going to start: device time waits for each to be accepted and for its sweeps.
    pub fn expect(&self, appointments: impl IntoIterator<Item = Appointment>) {
        lock(&self.state).gate.expect(appointments);
    }

    /// Whether a host may be silent on purpose from now on: device time does not wait for it.
    pub fn host_may_be_silent(&self, may: bool) {
        lock(&self.state).gate.host_may_be_silent(may);
    }

    /// From now on device time advances as far as the host allows: to this period since the start ([`Self::steps`]), and where a command is
    /// named, no further than its answer. Beyond that it crawls, until more is allowed.
    pub fn allow(&self, until_step: u64, or_answer_to: Option<u16>) {
        lock(&self.state).allowance = Some(Allowance::new(until_step, or_answer_to));
    }

    /// When the device answered a command last, milliseconds of its clock.
    pub fn answered_ms(&self) -> u64 {
        lock(&self.state).gate.answered_ms()
    }

    /// Gives access to the rig.
    pub fn rig<T>(&self, access: impl FnOnce(&mut SimulatedRig) -> T) -> T {
        access(&mut lock(&self.state).rig)
    }

    /// Changes what is injected, from the next period on; what waited for a trigger is forgotten.
    pub fn inject(&self, injection: Injection) {
        self.inject_when(Trigger::Now, injection);
    }

    /// Changes what is injected in the very period in which something comes true; what waited for another trigger is
    /// forgotten.
    pub fn inject_when(&self, trigger: Trigger, injection: Injection) {
        lock(&self.state).electronics.inject_when(trigger, injection);
    }

    /// Presses the emergency stop, or releases it.
    pub fn press_stop(&self, pressed: bool) {
        lock(&self.state).electronics.press(pressed);
    }

    /// Reaction of the firmware to the last injection; `None` if there was none yet.
    pub fn reaction(&self) -> Option<Reaction> {
        lock(&self.state).electronics.reaction()
    }

    /// Periods since the firmware first started.
    pub fn steps(&self) -> u64 {
        lock(&self.state).steps
    }

    /// Periods since the firmware first started, and bytes that it had sent over its line by then.
    pub fn sent(&self) -> (u64, u64) {
        let state = lock(&self.state);
        (state.steps, state.sent_bytes)
    }

    /// From now on what passes is kept, for the last [`KEPT_PERIODS`].
    pub fn keep_history(&self) {
        let mut state = lock(&self.state);
        let first_step = state.steps;
        state.history.get_or_insert_with(|| History::new(first_step));
    }

    /// Exchange in a period since the start; `None` if the period is still to come, or is not kept.
    pub fn period(&self, step: u64) -> Option<Period> {
        lock(&self.state).history.as_ref()?.get(step)
    }

    /// Period in which the firmware started last: zero of its clock.
    pub fn started(&self) -> u64 {
        lock(&self.state).started
    }

    /// The period from whose request on no input of a bridge has been high; `None` while one is.
    pub fn released_since(&self) -> Option<u64> {
        lock(&self.state).electronics.released_since()
    }

    /// Motion of the guide and load on it since this was last read.
    pub fn take_reach(&self) -> Reach {
        std::mem::take(&mut lock(&self.state).reach)
    }

    /// From now on the guide's motion from where it stands and the change of its force are watched, in every period.
    pub fn watch(&self) {
        let mut state = lock(&self.state);
        state.watched = Some(Watched::new(&state.rig));
    }

    /// The most of one axis since [`Self::watch`], which ends with this; nothing where nothing is watched.
    pub fn take_watched(&self) -> Option<Reach> {
        lock(&self.state).watched.take().map(|watched| watched.most)
    }

    /// Number of times the firmware has started again.
    pub fn resets(&self) -> u64 {
        lock(&self.state).resets
    }

    /// Whether a bridge drove its motor in the last period.
    pub fn bridges_driven(&self) -> bool {
        lock(&self.state).electronics.bridges_driven()
    }

    /// Socket on which sweeps are served.
    pub fn ultrasound(&self) -> PathBuf {
        self.folder.join(SWEEPS)
    }

    /// Socket on which scans are served, from which frames are rendered.
    pub fn scanner(&self) -> PathBuf {
        self.folder.join(SCANS)
    }

    /// Socket on which a needle of another program is joined to guide 2.
    pub fn needle(&self) -> PathBuf {
        self.folder.join("needle")
    }

    /// Has the firmware powered off and waits for the end.
    ///
    /// # Errors
    /// What went wrong in the lockstep.
    pub fn stop(mut self) -> Result<()> {
        self.shut_down()
    }

    fn shut_down(&mut self) -> Result<()> {
        self.stop.store(true, Ordering::Release);
        // The sweep servers wait for a connection; these make them check the flag.
        let _ = UnixStream::connect(self.ultrasound());
        let _ = UnixStream::connect(self.scanner());
        let _ = UnixStream::connect(self.needle());
        match self.worker.take().map(JoinHandle::join) {
            Some(Ok(outcome)) => outcome,
            Some(Err(_)) => bail!("the rig's thread panicked"),
            None => Ok(()),
        }
    }
}

impl Drop for Cosim {
    fn drop(&mut self) {
        let _ = self.shut_down();
    }
}

fn lock(state: &Mutex<State>) -> MutexGuard<'_, State> {
    state.lock().unwrap_or_else(PoisonError::into_inner)
}

fn serve(
    state: &Mutex<State>,
    stop: &AtomicBool,
    folder: &Path,
    mut output: Output,
    speed: f64,
) -> Result<()> {
    let deadline = Instant::now() + HANGS;
    let Some((mut requests, mut replies)) = open_pipes(folder, stop, deadline)? else { return Ok(()) };
    let mut record = [0; RECORD_BYTES];
    let mut pace = Pace::new(Duration::from_micros(PERIOD_US.into()), speed, Instant::now());
    while read_record(&mut requests, &mut record, stop)? {
        let request = PlantRequest::from_bytes(&record).context("the firmware sent no plant record")?;
        while lock(state).electronics.freezes() && !stop.load(Ordering::Acquire) {
            thread::sleep(POLL_INTERVAL);
        }
        let now_ms = u64::from(request.step);
        {
            let State { gate, allowance, sent_bytes, steps, .. } = &mut *lock(state);
            *sent_bytes += output.drain(|message| {
                gate.receive(now_ms, message);
                if let Some(allowance) = allowance {
                    allowance.receive(*steps, message);
                }
            });
            if request.step == 0 {
                // Earlier messages are of the start before.
                gate.restarted();
            }
        }
        hold_back(state, stop, now_ms);
        let reply = step(&mut lock(state), &request, stop.load(Ordering::Acquire));
        if replies.write_all(&reply.to_bytes()).is_err() {
            break;
        }
        match pace.period(Instant::now()) {
            Duration::ZERO => {}
            ahead => thread::sleep(ahead),
        }
    }
    Ok(())
}

/// Keeps the device in a period while it has to wait for its host.
fn hold_back(state: &Mutex<State>, stop: &AtomicBool, now_ms: u64) {
    let began = Instant::now();
    while !stop.load(Ordering::Acquire) {
        let now = Instant::now();
        let waiting = {
            let State { gate, allowance, steps, .. } = &mut *lock(state);
            gate.waiting(now_ms, now).or_else(|| allowance.as_ref()?.waiting(*steps))
        };
        let Some(waiting) = waiting else { return };
        match waiting.crawl().checked_sub(now - began) {
            None | Some(Duration::ZERO) => return,
            Some(left) => thread::sleep(left.min(waiting.poll_interval())),
        }
    }
}

/// One period.
fn step(state: &mut State, request: &PlantRequest, power_off: bool) -> PlantReply {
    let State { rig, electronics, steps, resets, started, reach, watched, history, .. } = state;
    if request.step == 0 && *steps > 0 {
        *resets += 1;
        *started = *steps;
    }
    let inputs = electronics.command(*steps, request, rig.position_m());
    let codes = rig.step(inputs, PERIOD_S);
    *steps += 1;
    let reply = electronics.sense(request.step, codes, power_off);
    if let Some(watched) = watched {
        watched.see(rig);
    }
    if let Some(history) = history {
        // Only needed where the history is kept, and they take time.
        for (position_m, force_n) in rig.position_m().into_iter().zip(rig.force_n()) {
            reach.position_m = reach.position_m.max(position_m.abs());
            reach.force_n = reach.force_n.max(force_n.abs());
        }
        history.push(Period {
            potentiometer_codes: reply.potentiometer_codes,
            force_codes: reply.force_codes,
            released: request.compare == [0; 4],
            slow: reply.potentiometer_conversion_us > 0,
            force_repeats: !reply.force_ready || reply.corrupt_force_crc || reply.reset_force_converter,
        });
    }
    reply
}
