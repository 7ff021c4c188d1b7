//! Replaying a recording as the link received it: frames in order, with what is missing between them.

use super::channels::{COUNT, Channel};
use super::error::RecordingError;
use super::format::{Fields, op};
use super::reader::{Damage, ReadItem, Reader};
use super::transcript::StreamState;
use super::views::{HelloFrame, RecordingInfo};
use crate::link::Batch;
use crate::link::telemetry::to_batch;
use protocol::{Command, Envelope, EnvelopeReceiver, Hello, Message, Order, Received, Totals};
use std::collections::VecDeque;
use std::path::Path;

/// Most damaged places that are listed; the rest is counted.
const LISTED: usize = 20;

/// Something that went over the link.
#[derive(Debug)]
pub enum ReplayItem {
    /// An intact frame from the device.
    Frame {
        /// Its content.
        envelope: Box<Envelope>,
        /// Its place in the order.
        order: Order,
        /// Its samples, where it holds some that are to be used.
        batch: Option<Batch>,
        /// Nanoseconds from the device's clock to the host's, wrapping, where the recording states it.
        anchor_ns: Option<u64>,
    },
    /// A command to the device.
    Command(Command),
}

/// Damage of the file.
#[derive(Debug, Clone, Default, PartialEq, Eq, serde::Serialize)]
pub struct DamageSummary {
    /// Places, in order: the first of them.
    pub places: Vec<Damage>,
    /// Number of damaged places.
    pub count: u64,
    /// Their length altogether.
    pub bytes: u64,
    /// Frames that were saved from them.
    pub frames_saved: u64,
    /// The file does not end as a finished one does.
    pub unfinished: bool,
}

/// Meaning of a message of a chunk.
#[derive(Debug)]
enum Entry {
    Frame(Box<Envelope>, Option<u64>),
    Command(Command),
    Hello(Box<Envelope>, u64),
    RecordingInfo(RecordingInfo),
    OtherVersion(u16),
}

/// A recording being replayed.
pub struct Replay {
    reader: Reader,
    channels: Channels,
    waiting: VecDeque<Entry>,
    stream: StreamState,
    damages: DamageSummary,
    about: Option<RecordingInfo>,
    hello: Option<(Box<Envelope>, u64)>,
}

impl Replay {
    /// Opens a recording, clean or damaged, and finds which device it is.
    pub fn open(path: &Path) -> Result<Self, RecordingError> {
        let mut first = Self::from_start(path)?;
        let (mut info, mut hello, mut other_protocol, mut frames) = (None, None, None, false);
        while (info.is_none() || hello.is_none())
            && let Some(entry) = first.entry()?
        {
            match entry {
                Entry::RecordingInfo(found) => info = info.or(Some(found)),
                Entry::Hello(found, anchor_ns) => hello = hello.or(Some((found, anchor_ns))),
                Entry::Frame(..) => frames = true,
                Entry::OtherVersion(version) => other_protocol = other_protocol.or(Some(version)),
                Entry::Command(_) => {}
            }
        }
        let path = path.to_owned();
        match other_protocol {
            Some(theirs) if !frames => return Err(RecordingError::OtherVersion { path, theirs }),
            _ if !frames && hello.is_none() => {
                let bytes = first.reader.length();
                let is_mcap = first.reader.finished() || info.is_some() || first.reader.begins_well();
                return Err(if is_mcap {
                    RecordingError::NoFrames { path, bytes }
                } else {
                    RecordingError::NotMcap { path }
                });
            }
            _ => {}
        }
        let mut replay = Self::from_start(&path)?;
        if let Some((hello, _)) = &hello {
            replay.stream.prime(hello);
        }
        (replay.about, replay.hello) = (info, hello);
        Ok(replay)
    }

    fn from_start(path: &Path) -> Result<Self, RecordingError> {
        Ok(Self {
            reader: Reader::open(path)?,
            channels: Channels::default(),
            waiting: VecDeque::new(),
            stream: StreamState::default(),
            damages: DamageSummary::default(),
            about: None,
            hello: None,
        })
    }

    /// Description of the run, if the recording has one.
    pub fn about(&self) -> Option<&RecordingInfo> {
        self.about.as_ref()
    }

    /// The frame of the first hello, with the nanoseconds from the device's clock to the host's.
    pub fn first_hello(&self) -> Option<(&Envelope, u64)> {
        self.hello.as_ref().map(|(envelope, anchor_ns)| (&**envelope, *anchor_ns))
    }

    /// Who the device is.
    pub fn hello(&self) -> Option<&Hello> {
        self.stream.hello()
    }

    /// The file.
    pub fn path(&self) -> &Path {
        self.reader.path()
    }

    /// Length of the file.
    pub fn bytes(&self) -> u64 {
        self.reader.length()
    }

    /// Number of bytes that have been read.
    pub fn position(&self) -> u64 {
        self.reader.position()
    }

    /// Counts of the tracker so far, as it counts on the link.
    pub fn totals(&self) -> Totals {
        self.stream.totals()
    }

    /// Damage of the file. Known at the end.
    pub fn damages(&self) -> DamageSummary {
        DamageSummary { unfinished: !self.reader.finished(), ..self.damages.clone() }
    }

    /// Next item of the link; `None` at the end.
    pub fn next(&mut self) -> Result<Option<ReplayItem>, RecordingError> {
        while let Some(entry) = self.entry()? {
            match entry {
                Entry::Frame(envelope, anchor_ns) => {
                    let order = self.stream.observe(&envelope);
                    let is_used = !matches!(order, Order::Duplicate | Order::Late);
                    let batch = match (&envelope.message, self.stream.hello()) {
                        (Message::Samples(samples), Some(hello)) if is_used => {
                            to_batch(hello, samples, self.stream.lost_before)
                        }
                        _ => None,
                    };
                    return Ok(Some(ReplayItem::Frame { envelope, order, batch, anchor_ns }));
                }
                Entry::Command(command) => {
                    self.stream.command(&command);
                    return Ok(Some(ReplayItem::Command(command)));
                }
                Entry::Hello(..) | Entry::RecordingInfo(_) | Entry::OtherVersion(_) => {}
            }
        }
        Ok(None)
    }

    fn entry(&mut self) -> Result<Option<Entry>, RecordingError> {
        loop {
            if let Some(entry) = self.waiting.pop_front() {
                return Ok(Some(entry));
            }
            match self.reader.next()? {
                None => return Ok(None),
                Some(ReadItem::Chunk(records)) => self.channels.entries(&records, &mut self.waiting),
                Some(ReadItem::Saved(envelopes)) => {
                    self.damages.frames_saved += envelopes.len() as u64;
                    self.waiting
                        .extend(envelopes.into_iter().map(|saved| Entry::Frame(Box::new(saved), None)));
                }
                Some(ReadItem::Damage(damage)) => {
                    self.damages.count += 1;
                    self.damages.bytes += damage.bytes;
                    if self.damages.places.len() < LISTED {
                        self.damages.places.push(damage);
                    }
                }
            }
        }
    }
}

/// Number of a channel in this file: other tools number again.
#[derive(Debug)]
struct Channels {
    ids: [u16; COUNT],
}

impl Default for Channels {
    fn default() -> Self {
        Self { ids: Channel::ALL.map(Channel::id) }
    }
}

impl Channels {
    /// Entries of the messages of a chunk; messages of other channels have none.
    fn entries(&mut self, records: &[u8], entries: &mut VecDeque<Entry>) {
        let mut remaining = Fields(records);
        while let Some((opcode, mut fields)) = remaining.record() {
            match opcode {
                op::CHANNEL => {
                    self.channel(fields);
                }
                op::MESSAGE => {
                    let head = (fields.u16(), fields.u32(), fields.u64(), fields.u64());
                    let (Some(id), Some(_), Some(log_ns), Some(publish_ns)) = head else { continue };
                    let channel = Channel::ALL.into_iter().zip(self.ids).find(|(_, known)| *known == id);
                    let anchor_ns = log_ns.wrapping_sub(publish_ns);
                    if let Some((channel, _)) = channel
                        && let Some(entry) = entry(channel, anchor_ns, fields.0)
                    {
                        if let Entry::Frame(envelope, _) = &entry
                            && matches!(envelope.message, Message::Hello(_))
                        {
                            entries.push_back(Entry::Hello(envelope.clone(), anchor_ns));
                        }
                        entries.push_back(entry);
                    }
                }
                _ => {}
            }
        }
    }

    fn channel(&mut self, mut fields: Fields<'_>) -> Option<()> {
        let (id, _schema) = (fields.u16()?, fields.u16()?);
        let channel = Channel::of_topic(fields.sized()?)?;
        if let Some(channel_id) = self.ids.get_mut(channel.place()) {
            *channel_id = id;
        }
        Some(())
    }
}

fn entry(channel: Channel, anchor_ns: u64, data: &[u8]) -> Option<Entry> {
    match channel {
        Channel::Frames => match only_frame(data)? {
            Received::Frame(envelope) => Some(Entry::Frame(Box::new(envelope), Some(anchor_ns))),
            Received::Unreadable(version) => version.map(Entry::OtherVersion),
            Received::Corrupt | Received::Overlong => None,
        },
        Channel::Hello => {
            let bytes = serde_json::from_slice::<HelloFrame>(data).ok()?.bytes()?;
            match only_frame(&bytes)? {
                Received::Frame(envelope) if matches!(envelope.message, Message::Hello(_)) => {
                    Some(Entry::Hello(Box::new(envelope), anchor_ns))
                }
                _ => None,
            }
        }
        Channel::Command => serde_json::from_slice(data).ok().map(Entry::Command),
        Channel::RecordingInfo => serde_json::from_slice(data).ok().map(Entry::RecordingInfo),
        Channel::Sample | Channel::Event | Channel::Status => None,
    }
}

/// Message that a receiver finds in the bytes of one frame.
fn only_frame(bytes: &[u8]) -> Option<Received<Envelope>> {
    EnvelopeReceiver::new().feed(bytes).next()
}
