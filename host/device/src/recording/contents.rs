//! Contents and damage of a recording.

use super::error::RecordingError;
use super::replay::{DamageSummary, Replay, ReplayItem};
use crate::link::error::explain_fault;
use protocol::{EventKind, Fault, Hello, Message, Order};
use serde::Serialize;
use std::path::{Path, PathBuf};

/// Most faults that are listed.
const LISTED_FAULTS: usize = 50;

/// Contents of a recording.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Contents {
    /// The file.
    pub file: PathBuf,
    /// Its length.
    pub bytes: u64,
    /// The sub-command that recorded, where that is known.
    pub command: Option<String>,
    /// Name of the run in its session.
    pub run: Option<String>,
    /// Insertion depth of the needle, millimetres.
    pub depth_mm: Option<f64>,
    /// The device.
    pub device: Option<Device>,
    /// Device time of the first sample, seconds.
    pub first_s: Option<f64>,
    /// Device time of the last sample, seconds.
    pub last_s: Option<f64>,
    /// Time from the first sample to the last, seconds.
    pub duration_s: f64,
    /// Frames from the device.
    pub frames: u64,
    /// Frames missing between them.
    pub frames_missing: u64,
    /// Frames that follow later ones and are not used, because another program has reordered the messages.
    pub frames_late: u64,
    /// Samples.
    pub samples: u64,
    /// Samples missing between them.
    pub samples_missing: u64,
    /// Restarts of the device.
    pub restarts: u64,
    /// Faults that were latched: the first of them.
    pub faults: Vec<RecordedFault>,
    /// Damage of the file.
    pub damage: DamageSummary,
}

/// The device of a recording.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Device {
    /// Number of the device's start.
    pub boot_id: u32,
    /// Board.
    pub board: String,
    /// Firmware version and commit.
    pub firmware: String,
    /// Name of its calibration.
    pub calibration_id: String,
    /// Checksum of its calibration.
    pub calibration_crc: String,
    /// Time between samples, microseconds.
    pub sample_period_us: u32,
}

/// A fault.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct RecordedFault {
    /// Device time at which it was latched or first reported, seconds.
    pub time_s: f64,
    /// Its number.
    pub number: u8,
    /// Its cause.
    pub cause: String,
}

impl Contents {
    /// Goes through a recording. `progress` is called with the bytes read.
    ///
    /// # Errors
    /// [`RecordingError`]; damage is none, it is among the contents.
    pub fn read(path: &Path, progress: &mut dyn FnMut(u64)) -> Result<Self, RecordingError> {
        let mut replay = Replay::open(path)?;
        let mut survey = Survey::default();
        while let Some(item) = replay.next()? {
            progress(replay.position());
            survey.observe(&item);
        }
        Ok(survey.contents(&replay))
    }
}

/// Collects the contents on the way through a recording.
#[derive(Debug, Default)]
pub struct Survey {
    times_s: Option<[f64; 2]>,
    late: u64,
    fault: Option<Fault>,
    faults: Vec<RecordedFault>,
}

impl Survey {
    /// Takes the next item.
    pub fn observe(&mut self, item: &ReplayItem) {
        let ReplayItem::Frame { envelope, order, batch, .. } = item else { return };
        if matches!(order, Order::Duplicate | Order::Late) {
            self.late += u64::from(*order == Order::Late);
            return;
        }
        if let Some(batch) = batch
            && let (Some(first), Some(last)) = (batch.points.first(), batch.points.last())
        {
            let [start_s, _] = self.times_s.unwrap_or([first.time_s; 2]);
            self.times_s = Some([start_s, last.time_s]);
        }
        let (t_us, fault) = match &envelope.message {
            Message::Event(event) => match event.kind {
                EventKind::Faulted { fault } => (event.t_us, Some(fault)),
                _ => return,
            },
            Message::Status(status) => (status.t_us, status.fault),
            _ => return,
        };
        if let Some(fault) = fault.filter(|_| fault != self.fault)
            && self.faults.len() < LISTED_FAULTS
        {
            let cause = explain_fault(fault);
            self.faults.push(RecordedFault { time_s: t_us as f64 * 1e-6, number: fault as u8, cause });
        }
        self.fault = fault;
    }

    /// The contents, once all items were taken.
    pub fn contents(self, replay: &Replay) -> Contents {
        let totals = replay.totals();
        let device = replay.first_hello().and_then(|(envelope, _)| match &envelope.message {
            Message::Hello(hello) => Some(Device::new(envelope.boot_id, hello)),
            _ => None,
        });
        let info = replay.about();
        let [first_s, last_s] = self.times_s.unwrap_or_default();
        Contents {
            file: replay.path().to_owned(),
            bytes: replay.bytes(),
            command: info.map(|info| info.command.clone()),
            run: info.map(|info| info.run.clone()),
            depth_mm: info.map(|info| info.depth_mm),
            device,
            first_s: self.times_s.map(|_| first_s),
            last_s: self.times_s.map(|_| last_s),
            // Sample times are whole microseconds.
            duration_s: ((last_s - first_s) * 1e6).round() / 1e6,
            frames: totals.frames,
            frames_missing: totals.frames_missing,
            frames_late: self.late,
            samples: totals.samples,
            samples_missing: totals.samples_missing,
            restarts: totals.restarts,
            faults: self.faults,
            damage: replay.damages(),
        }
    }
}

impl Device {
    fn new(boot_id: u32, hello: &Hello) -> Self {
        Self {
            boot_id,
            board: hello.board.as_str().to_owned(),
            firmware: format!("{} ({})", hello.firmware_version, hello.commit),
            calibration_id: hello.calibration.id.as_str().to_owned(),
            calibration_crc: format!("{:08x}", hello.calibration.crc),
            sample_period_us: hello.sample_period_us,
        }
    }
}
