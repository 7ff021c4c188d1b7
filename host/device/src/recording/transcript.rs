//! From envelopes to messages: every frame as it is, and the views of it.
//!
//! Publish times are the device's clock, nanoseconds since its start. Log times are the same clock put to this machine's once,
//! when the device sends its hello (or anything first after a restart): between two messages there lies what the device measured.
//! A frame without a time of its own (an answer, a command) has the latest time received.

use super::channels::Channel;
use super::error::RecordingError;
use super::views::{self, EventView, HelloView, RecordingInfo, StatusView};
use super::writer::Writer;
use crate::link::telemetry::to_batch;
use protocol::{
    Command, Envelope, Hello, MAX_FRAME_TO_HOST, Message, Order, Request, SequenceTracker, Totals,
};

/// Channels, hello and what is recorded are repeated every few chunks: at most 40 s are without them.
const ANNOUNCE_CHUNKS: u32 = 256;

/// Follows one device and writes what it sends.
pub struct Transcript {
    writer: Writer,
    about: Option<RecordingInfo>,
    stream: StreamState,
    /// Nanoseconds from the device's clock to this machine's, wrapping.
    anchor_ns: Option<u64>,
    device_us: u64,
    announced: Option<u32>,
    scratch: Vec<u8>,
}

impl Transcript {
    /// A recording into this file. `anchor_ns`: nanoseconds from the device's clock to the host's, where they are known before the
    /// device sends anything.
    pub fn new(writer: Writer, about: Option<RecordingInfo>, anchor_ns: Option<u64>) -> Self {
        Self {
            writer,
            about,
            stream: StreamState::default(),
            anchor_ns,
            device_us: 0,
            announced: None,
            scratch: Vec::new(),
        }
    }

    /// Sets what the counts of a boot mean, whose own hello is lost.
    pub fn prime(&mut self, hello: &Envelope) {
        self.stream.prime(hello);
    }

    /// Writes an envelope with a known offset of the device's clock to the host's, nanoseconds.
    pub fn anchored(&mut self, envelope: &Envelope, anchor_ns: u64) -> Result<(), RecordingError> {
        self.anchor_ns = Some(anchor_ns);
        self.write_envelope(envelope)
    }

    /// Writes an envelope that arrived at this time of this machine's clock.
    pub fn envelope(&mut self, envelope: &Envelope, host_ns: u64) -> Result<(), RecordingError> {
        let restarted = self.stream.boot_id.is_some_and(|boot_id| boot_id != envelope.boot_id);
        if restarted || self.anchor_ns.is_none() {
            let device_us = device_us(&envelope.message).unwrap_or_default();
            self.anchor_ns = Some(host_ns.wrapping_sub(nanoseconds(device_us)));
        }
        self.write_envelope(envelope)
    }

    fn write_envelope(&mut self, envelope: &Envelope) -> Result<(), RecordingError> {
        if self.stream.boot_id.is_some_and(|boot_id| boot_id != envelope.boot_id) {
            self.device_us = 0;
        }
        let order = self.stream.observe(envelope);
        let time_us = device_us(&envelope.message).unwrap_or(self.device_us);
        self.device_us = self.device_us.max(time_us);
        self.begin()?;
        let mut buffer = [0; MAX_FRAME_TO_HOST];
        let frame = views::frame(envelope, &mut buffer)?;
        self.write(Channel::Frames, time_us, frame)?;
        if matches!(order, Order::Duplicate | Order::Late) {
            return Ok(());
        }
        match &envelope.message {
            Message::Hello(hello) => {
                let view = views::json(&HelloView::new(envelope.boot_id, hello, frame))?;
                self.write(Channel::Hello, time_us, &view)
            }
            Message::Samples(samples) => self.samples(samples),
            Message::Event(event) => {
                let view = views::json(&EventView::new(event, self.stream.hello()))?;
                self.write(Channel::Event, time_us, &view)
            }
            Message::Status(status) => match self.stream.hello() {
                Some(hello) => {
                    let view = views::json(&StatusView::new(status, hello))?;
                    self.write(Channel::Status, time_us, &view)
                }
                None => Ok(()),
            },
            Message::Ack { .. }
            | Message::Refused { .. }
            | Message::Calibration(_)
            | Message::Connected { .. }
            | Message::Safety(_)
            | Message::Description(_) => Ok(()),
        }
    }

    /// Writes a command that was sent.
    pub fn command(&mut self, command: &Command) -> Result<(), RecordingError> {
        self.stream.command(command);
        self.begin()?;
        let view = views::json(command)?;
        self.write(Channel::Command, self.device_us, &view)
    }

    /// Writes what waits.
    pub fn flush(&mut self) -> Result<(), RecordingError> {
        self.writer.flush()
    }

    /// Ends the file; its length.
    pub fn finish(self) -> Result<u64, RecordingError> {
        self.writer.finish()
    }

    /// Bytes of memory that it holds for what it writes.
    #[cfg(test)]
    pub fn held(&self) -> usize {
        self.writer.held()
    }

    fn samples(&mut self, samples: &protocol::Samples) -> Result<(), RecordingError> {
        let lost_before = self.stream.lost_before;
        let batch = self.stream.hello().and_then(|hello| to_batch(hello, samples, lost_before));
        let Some(batch) = batch else { return Ok(()) };
        let mut lost_before = lost_before;
        for point in &batch.points {
            let mut data = std::mem::take(&mut self.scratch);
            data.clear();
            let lost = std::mem::take(&mut lost_before);
            views::sample(point, batch.step, batch.state, lost, &mut data);
            self.write(Channel::Sample, (point.time_s * 1e6).round() as u64, &data)?;
            self.scratch = data;
        }
        Ok(())
    }

    /// States channels, hello and what is recorded, where that is due.
    fn begin(&mut self) -> Result<(), RecordingError> {
        let chunk = self.writer.chunks();
        let due = self.announced.is_none_or(|announced| chunk >= announced.saturating_add(ANNOUNCE_CHUNKS));
        if !due || !self.writer.is_empty() {
            return Ok(());
        }
        self.announced = Some(chunk);
        self.writer.announce();
        if let Some(info) = &self.about {
            let view = views::json(info)?;
            self.write(Channel::RecordingInfo, self.device_us, &view)?;
        }
        if let Some(Envelope { boot_id, message: Message::Hello(hello), .. }) = &self.stream.hello {
            let mut buffer = [0; MAX_FRAME_TO_HOST];
            let frame = match &self.stream.hello {
                Some(envelope) => views::frame(envelope, &mut buffer)?,
                None => &[],
            };
            let view = views::json(&HelloView::new(*boot_id, hello, frame))?;
            self.write(Channel::Hello, self.device_us, &view)?;
        }
        Ok(())
    }

    fn write(&mut self, channel: Channel, time_us: u64, data: &[u8]) -> Result<(), RecordingError> {
        let publish_ns = nanoseconds(time_us);
        let log_ns = self.anchor_ns.unwrap_or_default().wrapping_add(publish_ns);
        self.writer.message(channel, log_ns, publish_ns, data)
    }
}

/// State of the stream on the link: order, losses, and what the counts mean.
#[derive(Debug, Default)]
pub struct StreamState {
    tracker: SequenceTracker,
    boot_id: Option<u32>,
    hello: Option<Envelope>,
    /// The hello was given beforehand; its own frame is not the second of its number.
    primed: bool,
    /// Id of the command that switched the stream on last: sent again it is the same command.
    stream_command: Option<u16>,
    /// Samples missing directly before the latest envelope.
    pub lost_before: u64,
}

impl StreamState {
    /// Takes a hello that is known from elsewhere than its own frame.
    pub fn prime(&mut self, hello: &Envelope) {
        if self.boot_id.is_none() {
            self.observe(hello);
            self.primed = true;
        }
    }

    /// Takes the next envelope.
    pub fn observe(&mut self, envelope: &Envelope) -> Order {
        if std::mem::take(&mut self.primed) && self.hello.as_ref() == Some(envelope) {
            return Order::First;
        }
        if self.boot_id != Some(envelope.boot_id) {
            (self.boot_id, self.hello) = (Some(envelope.boot_id), None);
        }
        let arrival = self.tracker.observe(envelope);
        self.lost_before = arrival.samples_missing;
        if matches!(envelope.message, Message::Hello(_)) {
            self.hello = Some(envelope.clone());
        }
        arrival.order
    }

    /// Takes a command that was sent.
    pub fn command(&mut self, command: &Command) {
        if matches!(command.request, Request::Stream { enable: true })
            && self.stream_command.replace(command.id) != Some(command.id)
        {
            self.tracker.stream_begins();
        }
    }

    /// Who the device is, if it has sent a hello since its start.
    pub fn hello(&self) -> Option<&Hello> {
        match &self.hello {
            Some(Envelope { message: Message::Hello(hello), .. }) => Some(hello),
            _ => None,
        }
    }

    /// Everything counted so far.
    pub fn totals(&self) -> Totals {
        self.tracker.totals()
    }
}

/// The device time of a message.
fn device_us(message: &Message) -> Option<u64> {
    match message {
        Message::Hello(hello) => Some(hello.now_us),
        Message::Samples(samples) => Some(samples.t_us),
        Message::Event(event) => Some(event.t_us),
        Message::Status(status) => Some(status.t_us),
        Message::Safety(safety) => Some(safety.t_us),
        Message::Ack { .. }
        | Message::Refused { .. }
        | Message::Calibration(_)
        | Message::Connected { .. }
        | Message::Description(_) => None,
    }
}

fn nanoseconds(us: u64) -> u64 {
    us.saturating_mul(1_000)
}
