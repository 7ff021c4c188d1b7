//! OpenIGTLink clients of `guide serve`: one that receives, and strangers that speak half messages, nonsense or nothing.

use super::worker::Worker;
use anyhow::{Context, Result, bail};
use device::igtl::wire::{Arrival, Decoder};
use device::igtl::{Content, Message};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::io::{ErrorKind, Read, Write};
use std::net::{SocketAddr, TcpStream};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread;
use std::time::Duration;

/// The message that every update of the device has.
const UPDATE: &str = "GuideToReference";
/// Interval at which a client checks whether it is to end.
const TIMEOUT: Duration = Duration::from_millis(50);

/// Values that a viewer has received.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Received {
    /// Updates of the device.
    pub(super) updates: u64,
    /// Stamp of the last.
    pub(super) stamp: Duration,
}

/// A client that receives everything.
pub(super) struct Viewer {
    received: Arc<Mutex<Received>>,
    worker: Worker<Result<()>>,
}

impl Viewer {
    pub(super) fn connect(address: SocketAddr) -> Result<Self> {
        let stream = TcpStream::connect(address).context("guide serve takes no client")?;
        stream.set_read_timeout(Some(TIMEOUT))?;
        let received = Arc::new(Mutex::new(Received::default()));
        let worker = Worker::start({
            let received = Arc::clone(&received);
            move |stop| view(stream, &received, stop)
        });
        Ok(Self { received, worker })
    }

    pub(super) fn last(&self) -> Received {
        *self.received.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Updates in all.
    pub(super) fn end(self) -> Result<u64> {
        let received = self.received;
        self.worker.end().context("the viewer panicked")??;
        Ok(received.lock().unwrap_or_else(PoisonError::into_inner).updates)
    }
}

fn view(mut stream: TcpStream, received: &Mutex<Received>, stop: &AtomicBool) -> Result<()> {
    let (mut decoder, mut buffer) = (Decoder::default(), [0; 4096]);
    while !stop.load(Ordering::Acquire) {
        let count = match stream.read(&mut buffer) {
            Ok(0) => bail!("guide serve has disconnected a client that reads"),
            Ok(count) => count,
            Err(error) if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut) => continue,
            Err(error) => return Err(error.into()),
        };
        let mut wrong = None;
        decoder.feed(&buffer[..count], |arrival| match arrival {
            Arrival::Message(message) if message.device == UPDATE => {
                let mut received = received.lock().unwrap_or_else(PoisonError::into_inner);
                if message.stamp <= received.stamp {
                    wrong = Some(format!("a stamp of {:?} after {:?}", message.stamp, received.stamp));
                }
                *received = Received { updates: received.updates + 1, stamp: message.stamp };
            }
            Arrival::Unreadable(error) => wrong = Some(format!("a message that cannot be read: {error}")),
            Arrival::Invalid(kind, device, _) => {
                wrong = Some(format!("{kind} of {device} that is no measurement"))
            }
            Arrival::Message(_) | Arrival::Skipped(..) => {}
        })?;
        if let Some(wrong) = wrong {
            bail!(wrong);
        }
    }
    Ok(())
}

/// Clients that speak no sense, one after the other.
pub(super) struct Stranger(Worker<u64>);

impl Stranger {
    pub(super) fn start(address: SocketAddr, seed: u64) -> Self {
        Self(Worker::start(move |stop| {
            let mut random = ChaCha8Rng::seed_from_u64(seed);
            let mut connections = 0;
            while !stop.load(Ordering::Acquire) {
                // A server that has just turned one away may refuse the next: it is tried again.
                if TcpStream::connect(address).is_ok_and(|stream| disturb(stream, &mut random).is_ok()) {
                    connections += 1;
                }
                thread::sleep(Duration::from_millis(random.random_range(1..60)));
            }
            connections
        }))
    }

    /// Connections in all.
    pub(super) fn end(self) -> u64 {
        self.0.end().unwrap_or(0)
    }
}

fn disturb(mut stream: TcpStream, random: &mut ChaCha8Rng) -> std::io::Result<()> {
    let text = "x".repeat(random.random_range(0..2_000));
    let message =
        Message { device: "Stranger".into(), stamp: Duration::from_secs(1), content: Content::Text(text) };
    let mut bytes = message.to_bytes();
    match random.random_range(0..6) {
        // A part of a message, of its header or its body.
        0 | 1 => bytes.truncate(random.random_range(0..bytes.len())),
        // Nonsense.
        2 => bytes.iter_mut().for_each(|byte| *byte = random.random()),
        // A size that nothing has.
        3 => bytes.iter_mut().skip(42).take(8).for_each(|byte| *byte = 0xFF),
        // A bit that has flipped.
        4 => {
            let byte_index = random.random_range(0..bytes.len());
            if let Some(byte) = bytes.get_mut(byte_index) {
                *byte ^= 1 << random.random_range(0..8);
            }
        }
        // The update is valid.
        _ => {}
    }
    // A disconnection in between is a valid answer.
    let _ = stream.write_all(&bytes);
    thread::sleep(Duration::from_millis(random.random_range(0..300)));
    Ok(())
}
