//! Recorder of a link in use. Its own thread writes, so that a slow disk does not delay the link.
//!
//! Data are on the disk within a fifth of a second of their arrival, in whole chunks with their checksums. The queue
//! between the link and the thread is bounded; if the disk stalls for longer, the link's own queue holds the data
//! that arrive.

use super::error::RecordingError;
use super::transcript::Transcript;
use super::views::RecordingInfo;
use super::writer::Writer;
use crate::link::{Client, Tap};
use protocol::{Command, Envelope};
use std::path::{Path, PathBuf};
use std::sync::mpsc::{self, Receiver, RecvTimeoutError, SyncSender};
use std::thread::JoinHandle;
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

/// Longest time that a message waits for its chunk to be written.
const WRITE_INTERVAL: Duration = Duration::from_millis(150);
/// Most messages between link and thread: half a minute of a streaming device.
const QUEUE: usize = 2_048;

/// A raw recording under way.
#[derive(Debug)]
pub struct RawRecorder {
    path: PathBuf,
    sender: SyncSender<Entry>,
    worker: JoinHandle<Result<u64, RecordingError>>,
}

/// Message to the thread.
enum Entry {
    /// From the device, at this time of this machine's clock.
    Received(Box<Envelope>, u64),
    /// From this program.
    Sent(Command),
    /// End of the recording.
    End,
}

/// A recording that has ended.
#[derive(Debug, Clone, PartialEq, Eq, serde::Serialize)]
pub struct RawFile {
    /// The file.
    pub path: PathBuf,
    /// Its length.
    pub bytes: u64,
}

impl RawRecorder {
    /// Begins a file and records everything that goes over the link from now on, the device's hello first.
    ///
    /// # Errors
    /// [`RecordingError::Io`] where the file exists or cannot be made.
    pub fn start(path: &Path, about: RecordingInfo, client: &mut Client) -> Result<Self, RecordingError> {
        let transcript = Transcript::new(Writer::create(path, true)?, Some(about), None);
        let (sender, receiver) = mpsc::sync_channel(QUEUE);
        let worker = std::thread::Builder::new()
            .name("raw recording".into())
            .spawn(move || write(transcript, &receiver))
            .map_err(RecordingError::io(path, 0, "start writing"))?;
        client.attach_tap(Box::new(RecorderTap(sender.clone())));
        Ok(Self { path: path.to_owned(), sender, worker })
    }

    /// Ends the recording, whether the link is still there or not.
    ///
    /// # Errors
    /// What went wrong with the file since it was begun.
    pub fn finish(self) -> Result<RawFile, RecordingError> {
        // If the thread has ended with an error, it reports that error.
        let _ = self.sender.send(Entry::End);
        match self.worker.join() {
            Ok(outcome) => outcome.map(|bytes| RawFile { path: self.path, bytes }),
            Err(_) => Err(RecordingError::Writer { path: self.path }),
        }
    }
}

/// The end of the link.
struct RecorderTap(SyncSender<Entry>);

impl Tap for RecorderTap {
    fn received(&mut self, envelope: &Envelope) {
        let since_1970 = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
        let host_ns = u64::try_from(since_1970.as_nanos()).unwrap_or(u64::MAX);
        // A recording that has failed does not end what is recorded: its end reports why.
        let _ = self.0.send(Entry::Received(Box::new(envelope.clone()), host_ns));
    }

    fn sent(&mut self, command: &Command) {
        let _ = self.0.send(Entry::Sent(*command));
    }
}

/// Writes until nothing further comes.
fn write(mut transcript: Transcript, receiver: &Receiver<Entry>) -> Result<u64, RecordingError> {
    // When what waits must be written.
    let mut due: Option<Instant> = None;
    loop {
        let entry = match due {
            None => receiver.recv().unwrap_or(Entry::End),
            Some(due_at) => match receiver.recv_timeout(due_at.saturating_duration_since(Instant::now())) {
                Ok(entry) => entry,
                Err(RecvTimeoutError::Disconnected) => Entry::End,
                Err(RecvTimeoutError::Timeout) => {
                    transcript.flush()?;
                    due = None;
                    continue;
                }
            },
        };
        match entry {
            Entry::Received(envelope, host_ns) => transcript.envelope(&envelope, host_ns)?,
            Entry::Sent(command) => transcript.command(&command)?,
            Entry::End => return transcript.finish(),
        }
        let due_at = *due.get_or_insert_with(|| Instant::now() + WRITE_INTERVAL);
        if Instant::now() >= due_at {
            transcript.flush()?;
            due = None;
        }
    }
}
