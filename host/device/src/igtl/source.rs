//! A tracker or PLUS server that sends where the needle is: a thread of its own reads, and connects again when the connection is lost.

use super::message::{Message, MessageError};
use super::server::is_pause;
use super::wire::{Arrival, Decoder, StreamError};
use super::{IgtlError, host_and_port};
use std::io::{self, Read};
use std::net::{TcpStream, ToSocketAddrs};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::mpsc::{self, Receiver, SyncSender, TrySendError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// Time within which a connection has to be made.
const CONNECT: Duration = Duration::from_secs(3);
/// Time between two attempts.
const RECONNECT: Duration = Duration::from_secs(1);
/// Time for which a peer may stop in the middle of a message.
const TIMEOUT: Duration = Duration::from_secs(5);
/// Interval at which the thread checks whether it is to end.
const POLL_INTERVAL: Duration = Duration::from_millis(100);
/// Most that waits to be taken: seconds of a quick tracker.
const QUEUE: usize = 256;
/// The same of images, each of up to 16 MB: half a second of a quick scanner.
const IMAGE_QUEUE: usize = 16;

/// Event of the connection.
#[derive(Debug)]
pub enum ConnectionEvent {
    /// A message, and when it had arrived.
    Message(Message, Instant),
    /// One that cannot be read.
    Unreadable(MessageError),
    /// One of a type that is not read: type and device name.
    Skipped(String, String),
    /// One whose metadata state that it is no measurement: type, device name, and what they state.
    Invalid(String, String, String),
    /// The connection is gone, and why; it is tried again.
    Lost(String),
    /// It is there again.
    Back,
}

/// A connection. Dropping it ends it.
#[derive(Debug)]
pub struct Source {
    address: String,
    news: Receiver<ConnectionEvent>,
    shared: Arc<Shared>,
    thread: Option<JoinHandle<()>>,
}

#[derive(Debug, Default)]
struct Shared {
    ended: AtomicBool,
    /// Messages that were not taken in time.
    dropped: AtomicU64,
}

/// The connection cannot be used any more.
#[derive(Debug, thiserror::Error)]
enum Gone {
    #[error("the peer has closed the connection")]
    Closed,
    #[error("the peer stopped in the middle of a message")]
    Stalled,
    #[error(transparent)]
    StreamError(#[from] StreamError),
    #[error(transparent)]
    Io(#[from] io::Error),
    #[error("the receiver is gone")]
    Unwanted,
}

impl Source {
    /// Connects to `HOST[:PORT]`. The first connection must succeed; later ones are tried until they do.
    ///
    /// # Errors
    /// [`IgtlError`].
    pub fn connect(address: &str) -> Result<Self, IgtlError> {
        Self::connect_as(address, false)
    }

    /// The same with images, which are passed over otherwise.
    ///
    /// # Errors
    /// As [`Self::connect`].
    pub fn connect_images(address: &str) -> Result<Self, IgtlError> {
        Self::connect_as(address, true)
    }

    fn connect_as(address: &str, has_images: bool) -> Result<Self, IgtlError> {
        let (host, port) = host_and_port(address)?;
        let address = if host.contains(':') { format!("[{host}]:{port}") } else { format!("{host}:{port}") };
        let stream =
            open(&host, port).map_err(|cause| IgtlError::Connect { address: address.clone(), cause })?;
        let (sender, news) = mpsc::sync_channel(if has_images { IMAGE_QUEUE } else { QUEUE });
        let shared = Arc::new(Shared::default());
        let thread_state = shared.clone();
        let thread = std::thread::Builder::new()
            .name("igtl source".into())
            .spawn(move || run(stream, (&host, port), has_images, &sender, &thread_state))
            .map_err(IgtlError::Thread)?;
        Ok(Self { address, news, shared, thread: Some(thread) })
    }

    /// Who it is.
    pub fn address(&self) -> &str {
        &self.address
    }

    /// Events since the last poll. Never waits.
    pub fn news(&self) -> impl Iterator<Item = ConnectionEvent> + '_ {
        self.news.try_iter()
    }

    /// Messages that were dropped because they were not taken in time.
    pub fn dropped(&self) -> u64 {
        self.shared.dropped.load(Ordering::Relaxed)
    }
}

impl Drop for Source {
    fn drop(&mut self) {
        self.shared.ended.store(true, Ordering::Release);
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

/// Opens a connection to the first address of the host that answers.
fn open(host: &str, port: u16) -> io::Result<TcpStream> {
    let mut last = io::Error::new(io::ErrorKind::NotFound, "no such host");
    for address in (host, port).to_socket_addrs()? {
        match TcpStream::connect_timeout(&address, CONNECT) {
            Ok(stream) => return Ok(stream),
            Err(error) => last = error,
        }
    }
    Err(last)
}

/// Until it is not wanted any more.
fn run(
    stream: TcpStream,
    (host, port): (&str, u16),
    has_images: bool,
    sender: &SyncSender<ConnectionEvent>,
    shared: &Shared,
) {
    let send = |news: ConnectionEvent| match sender.try_send(news) {
        Ok(()) => {}
        Err(TrySendError::Full(_) | TrySendError::Disconnected(_)) => {
            shared.dropped.fetch_add(1, Ordering::Relaxed);
        }
    };
    let mut connection = Some(stream);
    while let Some(stream) = connection.take() {
        let decoder = if has_images { Decoder::with_images() } else { Decoder::default() };
        match receive(stream, decoder, &send, shared) {
            Err(Gone::Unwanted) | Ok(()) => return,
            Err(gone) => send(ConnectionEvent::Lost(gone.to_string())),
        }
        while connection.is_none() && !shared.ended.load(Ordering::Acquire) {
            let next = Instant::now() + RECONNECT;
            while Instant::now() < next && !shared.ended.load(Ordering::Acquire) {
                std::thread::sleep(POLL_INTERVAL);
            }
            connection = open(host, port).ok();
            if connection.is_some() {
                send(ConnectionEvent::Back);
            }
        }
    }
}

/// One connection, to its end.
fn receive(
    mut stream: TcpStream,
    mut decoder: Decoder,
    send: &impl Fn(ConnectionEvent),
    shared: &Shared,
) -> Result<(), Gone> {
    stream.set_read_timeout(Some(POLL_INTERVAL))?;
    let mut bytes = vec![0; 1 << 16];
    let mut received = Instant::now();
    while !shared.ended.load(Ordering::Acquire) {
        match stream.read(&mut bytes) {
            Ok(0) => return Err(Gone::Closed),
            Ok(count) => {
                received = Instant::now();
                decoder.feed(bytes.get(..count).unwrap_or_default(), |arrival| {
                    send(match arrival {
                        Arrival::Message(message) => ConnectionEvent::Message(message, received),
                        Arrival::Unreadable(why) => ConnectionEvent::Unreadable(why),
                        Arrival::Skipped(kind, device) => ConnectionEvent::Skipped(kind, device),
                        Arrival::Invalid(kind, device, stated) => {
                            ConnectionEvent::Invalid(kind, device, stated)
                        }
                    });
                })?;
            }
            Err(error) if is_pause(&error) => {
                if decoder.is_inside() && received.elapsed() > TIMEOUT {
                    return Err(Gone::Stalled);
                }
            }
            Err(error) => return Err(error.into()),
        }
    }
    Err(Gone::Unwanted)
}
