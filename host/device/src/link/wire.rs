//! The port as a stream of frames: a reader thread on one side, counted losses on the other.

use super::error::LinkError;
use super::port::{self, Ends};
use protocol::{
    Command, Envelope, EnvelopeReceiver, MAX_FRAME_TO_DEVICE, Order, Received as Frame, SequenceTracker,
    encode_command,
};
use std::io::{self, ErrorKind, Read, Write};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::mpsc::{self, RecvTimeoutError};
use std::thread::JoinHandle;
use std::time::Duration;

/// Losses on the way from the device.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, serde::Serialize)]
pub struct LinkLosses {
    /// Frames that did not arrive, by the sequence numbers.
    pub frames_missing: u64,
    /// Frames that arrived damaged: checksum or byte stuffing wrong.
    pub frames_corrupt: u64,
    /// Frames that arrived over-long, or intact but unreadable.
    pub frames_unreadable: u64,
    /// Samples that are missing for any reason, the device's own drops included.
    pub samples_missing: u64,
}

/// Messages of the reader thread.
enum Incoming {
    Frame(Box<Envelope>),
    HelloOfVersion(u16),
    Closed(io::Error),
}

/// Result of [`OpenPort::receive`].
#[derive(Debug)]
pub enum Received {
    /// A frame.
    Frame {
        /// Its boot and content.
        frame: Box<Envelope>,
        /// Samples that went missing directly before it.
        lost_before: u64,
    },
    /// A hello of a device that speaks this other version of the protocol.
    HelloOfVersion(u16),
    /// No message came in time.
    Nothing,
}

/// Receives all frames of a link, in the order in which the host handles them.
pub trait Tap: Send {
    /// An intact frame from the device, at any place in the order.
    fn received(&mut self, envelope: &Envelope);
    /// A command that was sent.
    fn sent(&mut self, command: &Command);
}

#[derive(Default)]
struct Counters {
    stop: AtomicBool,
    bytes: AtomicU64,
    corrupt: AtomicU64,
    unreadable: AtomicU64,
}

/// An open port.
pub struct OpenPort {
    name: String,
    writer: Box<dyn Write + Send>,
    incoming: mpsc::Receiver<Incoming>,
    reader: Option<JoinHandle<()>>,
    counters: Arc<Counters>,
    tracker: SequenceTracker,
    tap: Option<Box<dyn Tap>>,
}

impl OpenPort {
    /// Opens a port and starts reading it.
    pub fn open(name: &str) -> Result<Self, LinkError> {
        let Ends { reader: reading, writer } = port::open(name)?;
        let counters = Arc::new(Counters::default());
        let (sender, incoming) = mpsc::channel();
        let reader = std::thread::Builder::new()
            .name("serial reader".into())
            .spawn({
                let counters = Arc::clone(&counters);
                move || read_frames(reading, &sender, &counters)
            })
            .map_err(|cause| LinkError::Gone { port: name.to_owned(), cause })?;
        Ok(Self {
            name: name.to_owned(),
            writer,
            incoming,
            reader: Some(reader),
            counters,
            tracker: SequenceTracker::new(),
            tap: None,
        })
    }

    /// Passes all further frames of the link to a tap; `None` ends that.
    pub fn set_tap(&mut self, tap: Option<Box<dyn Tap>>) {
        self.tap = tap;
    }

    /// Name of the port.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Sends a command. If the port does not accept it in time, it is lost, and no answer will come.
    pub fn send(&mut self, command: &Command) -> Result<(), LinkError> {
        let mut buffer = [0; MAX_FRAME_TO_DEVICE];
        let frame = encode_command(command, &mut buffer)?;
        if let Some(tap) = &mut self.tap {
            tap.sent(command);
        }
        match self.writer.write_all(frame) {
            Err(cause) if cause.kind() != ErrorKind::TimedOut => {
                Err(LinkError::Gone { port: self.name.clone(), cause })
            }
            _ => Ok(()),
        }
    }

    /// Waits for a frame.
    pub fn receive(&mut self, timeout: Duration) -> Result<Received, LinkError> {
        match self.incoming.recv_timeout(timeout) {
            Ok(Incoming::Frame(frame)) => {
                if let Some(tap) = &mut self.tap {
                    tap.received(&frame);
                }
                let arrival = self.tracker.observe(&frame);
                if matches!(arrival.order, Order::Duplicate | Order::Late) {
                    return Ok(Received::Nothing);
                }
                Ok(Received::Frame { frame, lost_before: arrival.samples_missing })
            }
            Ok(Incoming::HelloOfVersion(version)) => Ok(Received::HelloOfVersion(version)),
            Ok(Incoming::Closed(cause)) => Err(LinkError::Gone { port: self.name.clone(), cause }),
            Err(RecvTimeoutError::Timeout) => Ok(Received::Nothing),
            Err(RecvTimeoutError::Disconnected) => {
                let cause = io::Error::from(ErrorKind::BrokenPipe);
                Err(LinkError::Gone { port: self.name.clone(), cause })
            }
        }
    }

    /// Notes that telemetry will be switched on, so that the time without it is no loss.
    pub fn stream_begins(&mut self) {
        self.tracker.stream_begins();
    }

    /// Bytes that have arrived.
    pub fn bytes(&self) -> u64 {
        self.counters.bytes.load(Ordering::Relaxed)
    }

    /// Losses so far.
    pub fn losses(&self) -> LinkLosses {
        let totals = self.tracker.totals();
        LinkLosses {
            frames_missing: totals.frames_missing,
            frames_corrupt: self.counters.corrupt.load(Ordering::Relaxed),
            frames_unreadable: self.counters.unreadable.load(Ordering::Relaxed),
            samples_missing: totals.samples_missing,
        }
    }
}

impl Drop for OpenPort {
    fn drop(&mut self) {
        self.counters.stop.store(true, Ordering::Release);
        if let Some(reader) = self.reader.take() {
            let _ = reader.join();
        }
    }
}

fn read_frames(mut port: Box<dyn Read + Send>, sender: &mpsc::Sender<Incoming>, counters: &Counters) {
    let mut receiver = EnvelopeReceiver::new();
    let mut buffer = [0; 4096];
    while !counters.stop.load(Ordering::Acquire) {
        let bytes = match port.read(&mut buffer) {
            Ok(length) => buffer.get(..length).unwrap_or_default(),
            Err(error) if matches!(error.kind(), ErrorKind::TimedOut | ErrorKind::Interrupted) => &[],
            Err(error) => {
                let _ = sender.send(Incoming::Closed(error));
                return;
            }
        };
        counters.bytes.fetch_add(bytes.len() as u64, Ordering::Relaxed);
        for frame in receiver.feed(bytes) {
            let incoming = match frame {
                Frame::Frame(frame) => Incoming::Frame(Box::new(frame)),
                Frame::Unreadable(Some(version)) => Incoming::HelloOfVersion(version),
                Frame::Corrupt | Frame::Overlong | Frame::Unreadable(None) => continue,
            };
            if sender.send(incoming).is_err() {
                return;
            }
        }
        let losses = receiver.losses();
        counters.corrupt.store(losses.corrupt.into(), Ordering::Relaxed);
        counters
            .unreadable
            .store((losses.overlong.saturating_add(losses.unreadable)).into(), Ordering::Relaxed);
    }
}
