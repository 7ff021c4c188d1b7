//! The sweeps of a motion program: one per hold that requires one, or all that a tracker sends.

use super::{AcquisitionObserver, RecordError, Recorder, Ultrasound};
use crate::link::{Batch, Program};
use crate::sweep::{Sweep, SweepTask, saved_frames};
use std::collections::BTreeMap;
use std::path::PathBuf;

/// Time a hold has lasted before a sweep is taken: the guide has settled before, the tissue's quickest creep follows.
const SWEEP_DELAY_S: f64 = 0.3;
/// Largest lead of a tracker's shape over the samples that have arrived.
const AHEAD_S: f64 = 0.1;

/// Follows a program and takes its sweeps.
pub(super) struct Sweeps<'a> {
    ultrasound: Ultrasound<'a>,
    /// Steps that still need a sweep, with the device times of their first and their last sample so far.
    wanted: BTreeMap<u8, Option<[f64; 2]>>,
    under_way: Option<(SweepTask<Taken>, u8, f64)>,
}

/// Result of a command that takes a sweep.
enum Taken {
    Sweep(Sweep),
    Frames(PathBuf),
}

impl<'a> Sweeps<'a> {
    pub fn new(program: &Program, ultrasound: Ultrasound<'a>) -> Self {
        let has_one = !matches!(ultrasound, Ultrasound::Absent);
        let sweep_steps = (0u8..).zip(&program.steps).filter(|(_, step)| step.sweep && has_one);
        Self { wanted: sweep_steps.map(|(index, _)| (index, None)).collect(), ultrasound, under_way: None }
    }

    /// Takes samples, after they have been recorded.
    pub fn follow(
        &mut self,
        batch: &Batch,
        recorder: &mut Recorder,
        observer: &mut dyn AcquisitionObserver,
    ) -> Result<(), RecordError> {
        if let (Some(first), Some(last)) = (batch.points.first(), batch.points.last())
            && let Some(span) = batch.step.and_then(|step| self.wanted.get_mut(&step))
        {
            let [start_s, _] = span.unwrap_or([first.time_s, first.time_s]);
            *span = Some([start_s, last.time_s]);
        }
        match &mut self.ultrasound {
            Ultrasound::Absent => Ok(()),
            Ultrasound::Command(_) | Ultrasound::Frames(_) => self.run_command(batch, recorder, observer),
            Ultrasound::Tracker(tracker) => {
                tracker.samples(batch);
                let times_s = recorder.track(tracker, observer)?;
                fn is_tracked(span: &Option<[f64; 2]>, times_s: &[f64]) -> bool {
                    let [start_s, end_s] = span.unwrap_or([f64::INFINITY; 2]);
                    times_s.iter().any(|time_s| (start_s..=end_s + AHEAD_S).contains(time_s))
                }
                self.wanted.retain(|_, span| !is_tracked(span, &times_s));
                Ok(())
            }
        }
    }

    /// Starts the command in a hold that needs a sweep, and takes what it has printed.
    fn run_command(
        &mut self,
        batch: &Batch,
        recorder: &mut Recorder,
        observer: &mut dyn AcquisitionObserver,
    ) -> Result<(), RecordError> {
        if let Some((task, step, time_s)) = self.under_way.take() {
            match task.finished() {
                Ok(sweep) => {
                    if batch.step != Some(step) {
                        return Err(RecordError::HoldTooShort { number: usize::from(step) + 1 });
                    }
                    match sweep? {
                        Taken::Sweep(sweep) => {
                            recorder.sweep(&sweep, time_s)?;
                            observer.sweep(&sweep, time_s);
                        }
                        Taken::Frames(frames) => {
                            observer.frames(&frames, time_s);
                            recorder.frames(frames, time_s)?;
                        }
                    }
                }
                Err(task) if batch.step == Some(step) => self.under_way = Some((task, step, time_s)),
                Err(_) => return Err(RecordError::HoldTooShort { number: usize::from(step) + 1 }),
            }
        }
        let Some((step, [start_s, _])) =
            batch.step.and_then(|step| Some((step, (*self.wanted.get(&step)?)?)))
        else {
            return Ok(());
        };
        // The sample is chosen by its own time: where batches begin and end differs from run to run.
        let due = batch.points.iter().find(|point| point.time_s >= start_s + SWEEP_DELAY_S);
        let Some(due) = due else { return Ok(()) };
        let task = match &self.ultrasound {
            Ultrasound::Command(command) => {
                SweepTask::start(command, |text| Sweep::parse(text).map(Taken::Sweep))?
            }
            Ultrasound::Frames(command) => {
                SweepTask::start(command, |text| saved_frames(text).map(Taken::Frames))?
            }
            Ultrasound::Absent | Ultrasound::Tracker(_) => return Ok(()),
        };
        self.wanted.remove(&step);
        self.under_way = Some((task, step, due.time_s));
        Ok(())
    }

    /// Remarks for the end of a recording.
    pub fn remarks(&self) -> Vec<String> {
        match &self.ultrasound {
            Ultrasound::Tracker(tracker) => tracker.unused(),
            Ultrasound::Command(_) | Ultrasound::Frames(_) | Ultrasound::Absent => Vec::new(),
        }
    }

    /// Whether every hold that wanted a sweep had one.
    pub fn check_complete(&self) -> Result<(), RecordError> {
        fn number(step: &u8) -> usize {
            usize::from(*step) + 1
        }
        if let Some((_, step, _)) = &self.under_way {
            return Err(RecordError::HoldTooShort { number: number(step) });
        }
        match self.wanted.first_key_value() {
            Some((step, Some(_))) => Err(match self.ultrasound {
                Ultrasound::Tracker(_) => RecordError::HoldNotTracked { number: number(step) },
                Ultrasound::Command(_) | Ultrasound::Frames(_) | Ultrasound::Absent => {
                    RecordError::HoldTooShort { number: number(step) }
                }
            }),
            Some((step, None)) => Err(RecordError::HoldWithoutSamples { number: number(step) }),
            None => Ok(()),
        }
    }
}
