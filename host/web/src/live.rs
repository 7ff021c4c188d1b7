//! Decodes the bytes of the device in the page: raw frames of the link become extremes of force and position per short
//! time, and losses are counted as the program counts them.

use crate::answer::AnswerError;
use protocol::{
    Command, EnvelopeReceiver, Fault, Hello, MAX_FRAME_TO_DEVICE, Message, Order, Received, Request, Sample,
    SequenceTracker, State, VERSION, encode_command,
};
use serde::Serialize;
use std::fs;
use std::path::Path;

/// Length of a column, seconds.
const COLUMN_S: f64 = 0.05;
/// From the last sample before a restart of the device to the first one after it, seconds: its clock begins again, the picture goes on.
const RESTART_GAP_S: f64 = 1.0;
const CHANNELS: usize = 4;

/// The frame that greets a device, or, with the token of its answer, has it send samples.
pub(crate) fn ask(id: u16, connection: Option<u32>) -> Result<String, AnswerError> {
    let request = if connection.is_some() { Request::Stream { enable: true } } else { Request::Hello };
    let mut buffer = [0; MAX_FRAME_TO_DEVICE];
    let command = Command { id, connection: connection.unwrap_or(0), request };
    let frame = encode_command(&command, &mut buffer).map_err(|cause| AnswerError::Value {
        name: "id",
        value: id.to_string(),
        expected: format!("one that a frame can hold ({cause})"),
    })?;
    Ok(serde_json::to_string(frame)?)
}

/// Follows the frames of one connection to the program. Its memory does not grow.
#[derive(Debug, Default)]
pub(crate) struct Follower {
    receiver: EnvelopeReceiver,
    tracker: SequenceTracker,
    hello: Option<Hello>,
    /// Token of the newest connection.
    connection: Option<u32>,
    /// Protocol version of the device, if it is not that of this program.
    other_version: Option<u16>,
    condition: Option<(State, Option<Fault>)>,
    /// Added to the device's time.
    offset_s: f64,
    latest_s: Option<f64>,
    open: Option<Column>,
    bytes: u64,
}

/// Extremes over a short time: force x, force y (N), position x, position y (mm).
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
struct Column {
    /// Number of the column: an incomplete column is sent again with the same number.
    index: i64,
    time_s: f64,
    low: [f64; CHANNELS],
    high: [f64; CHANNELS],
}

#[derive(Serialize)]
struct LatchedFault {
    number: u8,
    name: Fault,
}

#[derive(Serialize)]
struct Followed {
    columns: Vec<Column>,
    connection: Option<u32>,
    other_version: Option<u16>,
    state: Option<State>,
    fault: Option<LatchedFault>,
    bytes: u64,
    frames: u64,
    frames_missing: u64,
    frames_corrupt: u64,
    frames_unreadable: u64,
    samples: u64,
    samples_missing: u64,
}

impl Follower {
    /// Takes the bytes of a file.
    pub fn take(&mut self, file: &Path) -> Result<String, AnswerError> {
        let bytes = fs::read(file).map_err(|cause| AnswerError::Value {
            name: "file",
            value: file.display().to_string(),
            expected: format!("frames of the device ({cause})"),
        })?;
        let columns = self.columns(&bytes);
        let (totals, losses) = (self.tracker.totals(), self.receiver.losses());
        Ok(serde_json::to_string(&Followed {
            columns,
            connection: self.connection,
            other_version: self.other_version,
            state: self.condition.map(|(state, _)| state),
            fault: self
                .condition
                .and_then(|(_, fault)| fault)
                .map(|name| LatchedFault { number: name as u8, name }),
            bytes: self.bytes,
            frames: totals.frames,
            frames_missing: totals.frames_missing,
            frames_corrupt: losses.corrupt.into(),
            frames_unreadable: losses.overlong.saturating_add(losses.unreadable).into(),
            samples: totals.samples,
            samples_missing: totals.samples_missing,
        })?)
    }

    /// The columns that these bytes have changed, in order.
    fn columns(&mut self, bytes: &[u8]) -> Vec<Column> {
        self.bytes = self.bytes.saturating_add(bytes.len() as u64);
        let mut receiver = std::mem::take(&mut self.receiver);
        let mut changed = Vec::new();
        for received in receiver.feed(bytes) {
            let envelope = match received {
                Received::Frame(envelope) => envelope,
                Received::Unreadable(Some(version)) => {
                    self.other_version = Some(version);
                    continue;
                }
                _ => continue,
            };
            match &envelope.message {
                Message::Hello(hello) => self.greeted(hello),
                Message::Connected { connection } => self.connection = Some(*connection),
                Message::Status(status) => self.condition = Some((status.state, status.fault)),
                _ => {}
            }
            if matches!(self.tracker.observe(&envelope).order, Order::Duplicate | Order::Late) {
                continue;
            }
            let (Message::Samples(samples), Some(hello)) = (&envelope.message, &self.hello) else { continue };
            let (period_us, scales) = (hello.sample_period_us, hello.scales);
            for (t_us, Sample { position_counts, force_counts, .. }) in
                samples.unpack(period_us).into_iter().flatten()
            {
                let [force_x, force_y] =
                    force_counts.map(|count| f64::from(count) * f64::from(scales.force_nn_per_count) * 1e-9);
                let [x, y] = position_counts
                    .map(|count| f64::from(count) * f64::from(scales.position_nm_per_count) * 1e-6);
                self.push(t_us as f64 * 1e-6 + self.offset_s, [force_x, force_y, x, y], &mut changed);
            }
        }
        self.receiver = receiver;
        changed.extend(self.open);
        changed
    }

    fn greeted(&mut self, hello: &Hello) {
        if hello.protocol_version != VERSION {
            self.other_version = Some(hello.protocol_version);
        }
        let now_s = hello.now_us as f64 * 1e-6;
        // The clock of a device that has restarted begins again.
        if let Some(latest_s) = self.latest_s
            && now_s + self.offset_s < latest_s
        {
            self.offset_s = latest_s + RESTART_GAP_S - now_s;
        }
        // Samples are switched on after a greeting: the time without them is no loss.
        self.tracker.stream_begins();
        self.hello = Some(hello.clone());
    }

    fn push(&mut self, time_s: f64, values: [f64; CHANNELS], complete: &mut Vec<Column>) {
        let index = (time_s / COLUMN_S).floor() as i64;
        self.latest_s = Some(time_s);
        match &mut self.open {
            Some(open) if open.index == index => {
                for ((low, high), value) in open.low.iter_mut().zip(&mut open.high).zip(values) {
                    (*low, *high) = (low.min(value), high.max(value));
                }
            }
            open => {
                complete.extend(*open);
                let time_s = (index as f64 + 1.0) * COLUMN_S;
                *open = Some(Column { index, time_s, low: values, high: values });
            }
        }
    }
}
