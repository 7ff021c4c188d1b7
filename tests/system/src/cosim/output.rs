//! What the device sends on its serial line, in step with its periods.
//!
//! QEMU copies each byte that leaves the serial port into a named pipe before the firmware goes on. So when the firmware requests
//! the next period, all that it sent before has arrived here, whether a host has the port open or not, and however much
//! the host has read of it.

use crate::qemu::OUTPUT_PIPE;
use anyhow::{Context, Result};
use protocol::{EnvelopeReceiver, Message, Received};
use rustix::fs::{FileType, Mode, OFlags};
use std::fs::{File, OpenOptions};
use std::io::Read;
use std::os::unix::fs::OpenOptionsExt;
use std::path::Path;

/// The device's words as they leave it.
#[derive(Debug)]
pub(super) struct Output {
    pipe: File,
    receiver: EnvelopeReceiver,
}

impl Output {
    /// Makes the pipe in a folder; QEMU opens its other end.
    pub(super) fn open(folder: &Path) -> Result<Self> {
        let path = folder.join(OUTPUT_PIPE);
        make_pipe(&path)?;
        // Not blocking: QEMU waits for this end where it opens its own, and not the other way round.
        let flags = OFlags::NONBLOCK.bits() as i32;
        let pipe = OpenOptions::new().read(true).custom_flags(flags).open(path)?;
        Ok(Self { pipe, receiver: EnvelopeReceiver::new() })
    }

    /// Hands out the messages since the last call, in order; returns of how many bytes. What is no message is skipped.
    pub(super) fn drain(&mut self, mut take: impl FnMut(&Message)) -> u64 {
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
pub(super) fn make_pipe(path: &Path) -> Result<()> {
    rustix::fs::mknodat(rustix::fs::CWD, path, FileType::Fifo, Mode::RUSR | Mode::WUSR, 0)
        .with_context(|| format!("cannot make the pipe {}", path.display()))
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
        let mut drained = || {
            let mut found = Vec::new();
            let bytes = output.drain(|message| found.push(message.clone()));
            (found, bytes)
        };
        assert_eq!(drained(), (vec![], 0), "no writer yet");
        let mut device = OpenOptions::new().write(true).open(folder.path().join(OUTPUT_PIPE)).unwrap();
        let frames: Vec<u8> = [3, 4]
            .into_iter()
            .flat_map(|id| {
                let mut buffer = [0; MAX_FRAME_TO_HOST];
                let envelope = Envelope { boot_id: 1, sequence: 0, message: Message::Ack { id } };
                encode_envelope(&envelope, &mut buffer).unwrap().to_vec()
            })
            .collect();
        let (first, rest) = frames.split_at(5);
        device.write_all(first).unwrap();
        assert_eq!(drained(), (vec![], 5), "a part of a message");
        device.write_all(rest).unwrap();
        let (messages, bytes) = drained();
        assert_eq!(messages, [Message::Ack { id: 3 }, Message::Ack { id: 4 }]);
        assert_eq!(bytes, rest.len() as u64);
        drop(device);
        assert_eq!(drained(), (vec![], 0), "no writer any more");
    }
}
