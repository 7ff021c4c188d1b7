//! Recording a lateral run: what the device streams and what the ultrasound sees, into a session.
//!
//! Rows reach the operating system several times a second, so a crash or a pulled cable costs a fraction of a second. Losses are
//! written where they happened (column `lost_before`), never smoothed over.

use crate::link::{Batch, Client, LinkError, LinkLosses, Program, RunOptions, Telemetry, run};
use crate::session::{ForceRow, LateralWriter, Provenance, SessionError};
use crate::sweep::{Sweep, SweepError, SweepTask};
use protocol::{EventKind, Hello, State};
use std::collections::HashSet;
use std::time::{Duration, Instant};

/// How often rows are handed to the operating system.
const FLUSH_INTERVAL: Duration = Duration::from_millis(200);
/// Time a hold has lasted before a sweep is taken: the guide has settled before, the tissue's quickest creep follows.
const SWEEP_DELAY_S: f64 = 0.3;

/// Why a recording ended early or failed. What was recorded until then is in the session.
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
    /// A hold that asks for a sweep was not seen at all.
    #[error("step {number}: no sweep was taken: no samples of this hold arrived")]
    HoldNotSeen {
        /// Number of the step, from 1.
        number: usize,
    },
}

/// What a recording holds.
#[derive(Debug, Clone, Copy, Default, PartialEq, serde::Serialize)]
pub struct Recorded {
    /// Samples written.
    pub samples: u64,
    /// Device time between the first and the last sample, seconds.
    pub duration_s: f64,
    /// Ultrasound sweeps written.
    pub sweeps: u64,
    /// Samples missing between the first and the last.
    pub samples_missing: u64,
    /// What the link lost.
    pub link: LinkLosses,
}

/// What a run of this device is recorded with.
pub fn provenance(hello: &Hello) -> Provenance {
    Provenance {
        calibration_id: Some(hello.calibration.id.as_str().to_owned()),
        calibration_crc: Some(hello.calibration.crc),
        device: Some(hello.board.as_str().to_owned()),
        firmware: Some(format!("{} ({})", hello.firmware_version, hello.commit)),
    }
}

/// Writes batches and sweeps into one lateral run.
pub struct Recorder<'w, 's> {
    writer: &'w mut LateralWriter<'s>,
    recorded: Recorded,
    first_s: Option<f64>,
    last_flush: Instant,
}

impl<'w, 's> Recorder<'w, 's> {
    /// A recorder for one run.
    pub fn new(writer: &'w mut LateralWriter<'s>) -> Self {
        Self { writer, recorded: Recorded::default(), first_s: None, last_flush: Instant::now() }
    }

    /// What has been written so far.
    pub fn recorded(&self) -> Recorded {
        self.recorded
    }

    /// Writes a batch.
    ///
    /// # Errors
    /// What the session's files say.
    pub fn batch(&mut self, batch: &Batch) -> Result<(), SessionError> {
        // What was lost before the first row lies outside the run.
        let mut lost_before = if self.first_s.is_some() { batch.lost_before } else { 0 };
        self.recorded.samples_missing += lost_before;
        for point in &batch.points {
            let first_s = *self.first_s.get_or_insert(point.time_s);
            let [displacement_x_m, displacement_y_m] = point.displacement_m;
            let [force_x_n, force_y_n] = point.force_n;
            self.writer.force(&ForceRow {
                time_s: point.time_s,
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
            self.recorded.duration_s = ((point.time_s - first_s) * 1e6).round() / 1e6;
        }
        if self.last_flush.elapsed() > FLUSH_INTERVAL {
            self.writer.flush()?;
            self.last_flush = Instant::now();
        }
        Ok(())
    }

    /// Writes a sweep taken at this device time, unless the sweep says when it was taken.
    ///
    /// # Errors
    /// What the session's files say.
    pub fn sweep(&mut self, sweep: &Sweep, time_s: f64) -> Result<(), SessionError> {
        for row in sweep.rows(time_s) {
            self.writer.shape(&row)?;
        }
        self.recorded.sweeps += 1;
        self.writer.flush()
    }
}

/// Runs a program and records it, taking a sweep in every hold that asks for one where there is an ultrasound to ask.
///
/// # Errors
/// [`RecordError`]; what was recorded until then has been written.
pub fn acquire(
    client: &mut Client,
    program: &Program,
    options: RunOptions,
    sweep_command: Option<&str>,
    recorder: &mut Recorder,
    mut progress: impl FnMut(usize),
) -> Result<Recorded, RecordError> {
    let mut sweeps = Sweeps::new(program, sweep_command);
    let outcome = run(client, program, options, |_, telemetry| {
        match telemetry {
            Telemetry::Samples(batch) => {
                // The time before the start and after the end is not part of the run.
                if !matches!(batch.state, State::Idle | State::Pending | State::Faulted) {
                    recorder.batch(batch)?;
                }
                sweeps.follow(batch, recorder)?;
            }
            Telemetry::Event(event) => {
                if let EventKind::StepStarted { index } = event.kind {
                    progress(usize::from(index));
                }
            }
            Telemetry::Status(_) => {}
        }
        Ok::<(), RecordError>(())
    });
    recorder.writer.flush()?;
    outcome?;
    sweeps.check_complete()?;
    Ok(Recorded { link: client.losses(), ..recorder.recorded() })
}

/// Takes the sweeps of a program, one per hold that asks for one.
struct Sweeps<'a> {
    command: Option<&'a str>,
    wanted: HashSet<u8>,
    entered: Option<(u8, f64)>,
    under_way: Option<(SweepTask, u8, f64)>,
}

impl<'a> Sweeps<'a> {
    fn new(program: &Program, command: Option<&'a str>) -> Self {
        let wanted = (0u8..).zip(&program.steps).filter(|(_, step)| step.sweep && command.is_some());
        Self { command, wanted: wanted.map(|(index, _)| index).collect(), entered: None, under_way: None }
    }

    fn follow(&mut self, batch: &Batch, recorder: &mut Recorder) -> Result<(), RecordError> {
        if let Some((task, step, time_s)) = self.under_way.take() {
            match task.finished() {
                Ok(sweep) => {
                    if batch.step != Some(step) {
                        return Err(RecordError::HoldTooShort { number: usize::from(step) + 1 });
                    }
                    recorder.sweep(&sweep?, time_s)?;
                }
                Err(task) if batch.step == Some(step) => self.under_way = Some((task, step, time_s)),
                Err(_) => return Err(RecordError::HoldTooShort { number: usize::from(step) + 1 }),
            }
        }
        let (Some(step), Some(first)) = (batch.step, batch.points.first()) else {
            return Ok(());
        };
        let (_, since_s) = *match &mut self.entered {
            Some(entered) if entered.0 == step => entered,
            entered => entered.insert((step, first.time_s)),
        };
        // The sample is chosen by its own time: where batches begin and end differs from run to run.
        let due = batch.points.iter().find(|point| point.time_s >= since_s + SWEEP_DELAY_S);
        if let (Some(command), Some(due)) = (self.command, due)
            && self.wanted.remove(&step)
        {
            self.under_way = Some((SweepTask::start(command)?, step, due.time_s));
        }
        Ok(())
    }

    fn check_complete(&self) -> Result<(), RecordError> {
        let number = |step: &u8| usize::from(*step) + 1;
        if let Some((_, step, _)) = &self.under_way {
            return Err(RecordError::HoldTooShort { number: number(step) });
        }
        match self.wanted.iter().min() {
            Some(step) => Err(RecordError::HoldNotSeen { number: number(step) }),
            None => Ok(()),
        }
    }
}

#[cfg(test)]
mod tests;
