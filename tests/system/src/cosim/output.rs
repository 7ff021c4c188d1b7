//! Sends the device's bytes on its serial line, in step with its periods.
//!
//! QEMU copies each byte that leaves the serial port into a named pipe before the firmware goes on. So when the firmware requests
//! the next period, all that it sent before has arrived here, whether a host has the port open or not, and however much
//! the host has read of it.

use crate::qemu::{HANGS, OUTPUT_PIPE};
use anyhow::{Context, Result, bail};
use emulation::plant::{REPLY_PIPE, REQUEST_PIPE};
use protocol::{EnvelopeReceiver, Message, Received};
use rustix::fs::{FileType, Mode, OFlags};
use std::fs::{File, OpenOptions};
use std::io::Read;
use std::os::unix::fs::OpenOptionsExt;
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::{Duration, Instant};

/// The device's words as they leave it.
#[derive(Debug)]
pub(crate) struct Output {
    pipe: File,
    receiver: EnvelopeReceiver,
}

impl Output {
    /// Makes the pipes of a firmware in a folder, and opens the one of its words; QEMU opens the other ends.
    pub(crate) fn open(folder: &Path) -> Result<Self> {
        for name in [REQUEST_PIPE, REPLY_PIPE] {
            make_pipe(&folder.join(name))?;
        }
        let path = folder.join(OUTPUT_PIPE);
        make_pipe(&path)?;
        // Not blocking: QEMU waits for this end where it opens its own, and not the other way round.
        let flags = OFlags::NONBLOCK.bits() as i32;
        let pipe = OpenOptions::new().read(true).custom_flags(flags).open(path)?;
        Ok(Self { pipe, receiver: EnvelopeReceiver::new() })
    }

    /// Hands out the messages since the last call, in order; returns of how many bytes. Bytes that are no message are
    /// skipped.
    pub(crate) fn drain(&mut self, mut take: impl FnMut(&Message)) -> u64 {
        let (mut bytes, mut count) = ([0; 1024], 0);
        while let Ok(length @ 1..) = self.pipe.read(&mut bytes) {
            count += length as u64;
            for received in self.receiver.feed(bytes.get(..length).unwrap_or_default()) {
                if let Received::Frame(envelope) = received {
                    take(&envelope.message);
                }
            }
        }
        count
    }
}

/// Makes a named pipe.
fn make_pipe(path: &Path) -> Result<()> {
    rustix::fs::mknodat(rustix::fs::CWD, path, FileType::Fifo, Mode::RUSR | Mode::WUSR, 0)
        .with_context(|| format!("cannot make the pipe {}", path.display()))
}

/// Opens both pipes without ever hanging on a firmware that does not come. `None` when stopped meanwhile.
pub(crate) fn open_pipes(
    folder: &Path,
    stop: &AtomicBool,
    deadline: Instant,
) -> Result<Option<(File, File)>> {
    let flags = OFlags::NONBLOCK.bits() as i32;
    let requests = OpenOptions::new().read(true).custom_flags(flags).open(folder.join(REQUEST_PIPE))?;
    loop {
        // Opening for writing succeeds once the firmware has the other end.
        match OpenOptions::new().write(true).custom_flags(flags).open(folder.join(REPLY_PIPE)) {
            Ok(replies) => {
                for pipe in [&requests, &replies] {
                    let flags = rustix::fs::fcntl_getfl(pipe)?;
                    rustix::fs::fcntl_setfl(pipe, flags - OFlags::NONBLOCK)?;
                }
                return Ok(Some((requests, replies)));
            }
            Err(_) if stop.load(Ordering::Acquire) => return Ok(None),
            Err(_) if Instant::now() < deadline => thread::sleep(Duration::from_millis(2)),
            Err(error) => bail!("the firmware did not open the plant pipes in {HANGS:?}: {error}"),
        }
    }
}

/// Reads one record; false at the end of the pipe.
pub(crate) fn read_record(pipe: &mut File, record: &mut [u8], stop: &AtomicBool) -> Result<bool> {
    match pipe.read_exact(record) {
        Ok(()) => Ok(true),
        Err(error) if error.kind() == std::io::ErrorKind::UnexpectedEof => Ok(false),
        Err(_) if stop.load(Ordering::Acquire) => Ok(false),
        Err(error) => Err(error).context("the plant pipe broke"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use protocol::{Envelope, MAX_FRAME_TO_HOST, encode_envelope};
    use std::io::Write;

    #[test]
    fn messages_are_handed_out_once_and_in_order_however_they_are_cut() {
        let folder = tempfile::tempdir().unwrap();
        let mut output = Output::open(folder.path()).unwrap();
        assert_eq!(drained(&mut output), (vec![], 0), "no writer yet");
        let mut device = OpenOptions::new().write(true).open(folder.path().join(OUTPUT_PIPE)).unwrap();
        let frames: Vec<u8> = [3, 4]
            .into_iter()
            .flat_map(|id| {
                let mut buffer = [0; MAX_FRAME_TO_HOST];
                let envelope = Envelope { boot_id: 1, sequence: 0, message: Message::Ack { id } };
                encode_envelope(&envelope, &mut buffer).unwrap().to_vec()
            })
            .collect();
        let (first, later_frames) = frames.split_at(5);
        device.write_all(first).unwrap();
        assert_eq!(drained(&mut output), (vec![], 5), "a part of a message");
        device.write_all(later_frames).unwrap();
        let (messages, bytes) = drained(&mut output);
        assert_eq!(messages, [Message::Ack { id: 3 }, Message::Ack { id: 4 }]);
        assert_eq!(bytes, later_frames.len() as u64);
        drop(device);
        assert_eq!(drained(&mut output), (vec![], 0), "no writer any more");
    }

    fn drained(output: &mut Output) -> (Vec<Message>, u64) {
        let mut messages = Vec::new();
        let bytes = output.drain(|message| messages.push(message.clone()));
        (messages, bytes)
    }
}
