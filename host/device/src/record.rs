//! Recording a lateral run: what the device streams and what the ultrasound measures, into a session.
//!
//! Rows reach the operating system several times a second, so a crash or a pulled cable costs a fraction of a second. Losses are
//! written where they happened (column `lost_before`), never smoothed over.

mod sweeps;

use crate::igtl::Channel;
use crate::igtl::channel::Observation;
use crate::link::{Batch, Client, LinkError, LinkLosses, Program, RunOptions, Telemetry, run};
use crate::sweep::{Sweep, SweepError};
use formats::session::{ForceRow, FrameSweep, LateralWriter, Provenance, SessionError};
use protocol::{EventKind, Hello, State};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};
use sweeps::Sweeps;

/// Interval at which rows are handed to the operating system.
const FLUSH_INTERVAL: Duration = Duration::from_millis(200);

/// Why a recording ended early or failed. The session keeps the rows that were recorded until then.
#[derive(Debug, thiserror::Error)]
pub enum RecordError {
    /// The link or the device.
    #[error(transparent)]
    Link(#[from] LinkError),
    /// The session's files.
    #[error(transparent)]
    Session(#[from] SessionError),
    /// The ultrasound.
    #[error(transparent)]
    Sweep(#[from] SweepError),
    /// A hold was over before its sweep was.
    #[error("step {number}: the hold ended before its ultrasound sweep was complete: make the hold longer")]
    HoldTooShort {
        /// Number of the step, from 1.
        number: usize,
    },
    /// No samples arrived of a hold that requires a sweep.
    #[error("step {number}: no sweep was taken: no samples of this hold arrived")]
    HoldWithoutSamples {
        /// Number of the step, from 1.
        number: usize,
    },
    /// The tracker was silent in a hold that requires a sweep.
    #[error("step {number}: no sweep was taken: the tracker sent no shape in this hold")]
    HoldNotTracked {
        /// Number of the step, from 1.
        number: usize,
    },
}

/// Source of sweeps.
#[derive(Debug)]
pub enum Ultrasound<'a> {
    /// From nowhere: displacement and force alone are recorded.
    Absent,
    /// From a command that is run in every hold that requires one.
    Command(&'a str),
    /// As frames from such a command, which saves them: the shape is measured later.
    Frames(&'a str),
    /// From a tracker that sends shapes by itself, all of which are recorded.
    Tracker(Box<Channel>),
}

/// Observes a run while it is recorded.
pub trait AcquisitionObserver {
    /// A step of the program has begun.
    fn step(&mut self, _step: usize) {}
    /// Samples have arrived, of the run or of the time around it.
    fn samples(&mut self, _batch: &Batch) {}
    /// A sweep has been recorded, taken at this device time unless it has times of its own.
    fn sweep(&mut self, _sweep: &Sweep, _time_s: f64) {}
    /// Frames have been saved, taken at this device time.
    fn frames(&mut self, _frames: &Path, _time_s: f64) {}
    /// A remark for the user.
    fn note(&mut self, _text: &str) {}
}

/// No observer.
impl AcquisitionObserver for () {}

/// Contents of a recording.
#[derive(Debug, Clone, Copy, Default, PartialEq, serde::Serialize)]
pub struct Recorded {
    /// Samples written.
    pub samples: u64,
    /// Device time between the first and the last sample, seconds.
    pub duration_s: f64,
    /// Ultrasound sweeps written, or saved as frames.
    pub sweeps: u64,
    /// Samples missing between the first and the last.
    pub samples_missing: u64,
    /// Samples without a valid reading of the force, which are left out.
    pub samples_without_force: u64,
    /// Number of times the device's clock has stepped back without a restart: what follows is a segment of its own,
    /// whose times go on from those of the one before.
    pub clock_steps: u64,
    /// Losses of the link.
    pub link: LinkLosses,
}

/// Provenance of a run of this device; `tared` is whether its force has a zero that was measured, if that is known.
pub fn provenance(hello: &Hello, tared: Option<bool>) -> Provenance {
    Provenance {
        calibration_id: Some(hello.calibration.id.as_str().to_owned()),
        calibration_crc: Some(hello.calibration.crc),
        device: Some(hello.board.as_str().to_owned()),
        firmware: Some(format!("{} ({})", hello.firmware_version, hello.commit)),
        tared,
    }
}

/// Writes batches and sweeps into one lateral run.
pub struct Recorder<'w, 's> {
    writer: &'w mut LateralWriter<'s>,
    recorded: Recorded,
    first_s: Option<f64>,
    /// Time of the latest row, and between it and the one before, seconds.
    last_s: f64,
    step_s: f64,
    /// Time that is added to the device's times since its clock has stepped back, seconds.
    ahead_s: f64,
    last_flush: Instant,
}

/// Time between two rows before it is known, seconds: a control period.
const STEP_S: f64 = 1e-3;

impl<'w, 's> Recorder<'w, 's> {
    /// A recorder for one run.
    pub fn new(writer: &'w mut LateralWriter<'s>) -> Self {
        Self {
            writer,
            recorded: Recorded::default(),
            first_s: None,
            last_s: f64::NEG_INFINITY,
            step_s: STEP_S,
            ahead_s: 0.0,
            last_flush: Instant::now(),
        }
    }

    /// Counts of the rows written so far.
    pub fn recorded(&self) -> Recorded {
        self.recorded
    }

    /// Writes a batch.
    ///
    /// # Errors
    /// Errors of the session's files.
    pub fn batch(&mut self, batch: &Batch) -> Result<(), SessionError> {
        // Losses before the first row lie outside the run.
        let mut lost_before = if self.first_s.is_some() { batch.lost_before } else { 0 };
        self.recorded.samples_missing += lost_before;
        for point in &batch.points {
            if point.repeats_force {
                self.recorded.samples_without_force += 1;
                continue;
            }
            let time_s = self.time_s(point.time_s)?;
            let first_s = *self.first_s.get_or_insert(time_s);
            let [displacement_x_m, displacement_y_m] = point.displacement_m;
            let [force_x_n, force_y_n] = point.force_n;
            self.writer.force(&ForceRow {
                time_s,
                displacement_y_m,
                force_y_n,
                displacement_x_m,
                force_x_n,
                step: batch.step.map(u32::from),
                moving: batch.step.map(|_| batch.state == State::Moving),
                lost_before: std::mem::take(&mut lost_before),
            })?;
            self.recorded.samples += 1;
            // Sample times are whole microseconds.
            self.recorded.duration_s = ((time_s - first_s) * 1e6).round() / 1e6;
        }
        if self.last_flush.elapsed() > FLUSH_INTERVAL {
            self.writer.flush()?;
            self.last_flush = Instant::now();
        }
        Ok(())
    }

    /// Time of a row, of the device's. If its clock has stepped back, a remark among the rows states that a new segment
    /// begins.
    fn time_s(&mut self, device_s: f64) -> Result<f64, SessionError> {
        let mut time_s = device_s + self.ahead_s;
        if time_s <= self.last_s {
            let next_s = self.last_s + self.step_s;
            self.writer.remark(&format!(
                "a new segment: the device's clock has stepped back, from {:.6} to {device_s:.6} s",
                self.last_s - self.ahead_s
            ))?;
            self.recorded.clock_steps += 1;
            self.ahead_s = next_s - device_s;
            time_s = next_s;
        } else if self.last_s.is_finite() {
            self.step_s = time_s - self.last_s;
        }
        if self.ahead_s != 0.0 {
            // Whole microseconds, as the device's.
            time_s = (time_s * 1e6).round() / 1e6;
        }
        self.last_s = time_s;
        Ok(time_s)
    }

    /// Writes what a tracker has sent of the time since the first sample.
    ///
    /// # Errors
    /// Errors of the session's files.
    pub fn track(
        &mut self,
        tracker: &mut Channel,
        observer: &mut dyn AcquisitionObserver,
    ) -> Result<Vec<f64>, SessionError> {
        let mut times_s = Vec::new();
        for observation in tracker.poll() {
            match observation {
                Observation::Note(text) => observer.note(&text),
                Observation::Shape(sweep) => {
                    let time_s = sweep.rows(0.0).next().map(|row| row.time_s);
                    let first_s = self.first_s.unwrap_or(f64::INFINITY);
                    if let Some(time_s) = time_s.filter(|time_s| *time_s >= first_s) {
                        self.sweep(&sweep, time_s)?;
                        observer.sweep(&sweep, time_s);
                        times_s.push(time_s);
                    }
                }
            }
        }
        Ok(times_s)
    }

    /// Writes a sweep taken at this device time, unless the sweep has times of its own.
    ///
    /// # Errors
    /// Errors of the session's files.
    pub fn sweep(&mut self, sweep: &Sweep, time_s: f64) -> Result<(), SessionError> {
        for mut row in sweep.rows(time_s) {
            row.time_s += self.ahead_s;
            self.writer.shape(&row)?;
        }
        self.recorded.sweeps += 1;
        Ok(())
    }
}

impl Recorder<'_, '_> {
    /// Lists frames that were taken at this device time.
    ///
    /// # Errors
    /// Errors of the session's files.
    pub fn frames(&mut self, frames: PathBuf, time_s: f64) -> Result<(), SessionError> {
        self.writer.frames(FrameSweep { time_s, frames })?;
        self.recorded.sweeps += 1;
        Ok(())
    }
}

/// Runs a program and records it, with the sweeps that its holds require where there is an ultrasound.
///
/// # Errors
/// [`RecordError`]; what was recorded until then has been written.
pub fn acquire(
    client: &mut Client,
    program: &Program,
    options: RunOptions,
    ultrasound: Ultrasound<'_>,
    recorder: &mut Recorder,
    observer: &mut dyn AcquisitionObserver,
) -> Result<Recorded, RecordError> {
    let mut sweeps = Sweeps::new(program, ultrasound);
    let outcome = run(client, program, options, |_, telemetry| {
        match telemetry {
            Telemetry::Samples(batch) => {
                observer.samples(batch);
                // The time before the start and after the end is not part of the run.
                if !matches!(batch.state, State::Idle | State::Pending | State::Faulted | State::Retreating) {
                    recorder.batch(batch)?;
                }
                sweeps.follow(batch, recorder, observer)?;
            }
            Telemetry::Event(event) => {
                if let EventKind::StepStarted { index } = event.kind {
                    observer.step(usize::from(index));
                }
            }
            Telemetry::Status(_) => {}
        }
        Ok::<(), RecordError>(())
    });
    recorder.writer.flush()?;
    sweeps.remarks().iter().for_each(|remark| observer.note(remark));
    outcome?;
    sweeps.check_complete()?;
    Ok(Recorded { link: client.losses(), ..recorder.recorded() })
}

#[cfg(test)]
mod tests;
