//! A server that sends all its clients the same, and waits for none of them.
//!
//! Every client has a thread that writes and one that reads. Live messages wait in a short queue per client: where a
//! client is slow, the oldest is dropped. Messages that stay true (results) are kept, and sent to those who come later.
//! A client that does not take a message within [`TIMEOUT`], or sends what is no OpenIGTLink, is left.

use super::IgtlError;
use super::message::Message;
use super::wire::Decoder;
use std::collections::{BTreeMap, VecDeque};
use std::io::{self, ErrorKind, Read, Write};
use std::net::{SocketAddr, TcpListener, TcpStream, ToSocketAddrs};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// Most clients at a time.
pub const MAX_CLIENTS: usize = 16;
/// Connections that are taken in a second at most, so that one peer that connects and leaves cannot keep the program busy.
const ACCEPTED_PER_S: u32 = 20;
/// Bytes that a client may send in a second: nothing that it sends is needed.
const RECEIVED_PER_S: usize = 256 << 10;
/// Changes of connections that are kept until they are taken.
const MAX_CHANGES: usize = 64;
/// Updates that wait for a client.
const QUEUE: usize = 16;
/// Time for which a client may take no data.
const TIMEOUT: Duration = Duration::from_secs(5);
/// Interval at which threads check whether they are to end.
const POLL_INTERVAL: Duration = Duration::from_millis(50);

/// A server under way. Dropping it closes every connection.
#[derive(Debug)]
pub struct Publisher {
    address: SocketAddr,
    shared: Arc<Shared>,
    accepting: Option<JoinHandle<()>>,
}

/// Change of a client's connection.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ClientChange {
    /// It is connected.
    Connected,
    /// It has left, or has been left: [`Publisher::bind`].
    Left,
    /// It was rejected: the largest number of clients is connected.
    Rejected,
}

/// State that server and clients share.
#[derive(Debug, Default)]
struct Shared {
    state: Mutex<PublisherState>,
    news: Condvar,
    ended: AtomicBool,
    dropped: AtomicU64,
}

/// Messages for the clients.
#[derive(Debug, Default)]
struct PublisherState {
    /// Results by device name, as bytes.
    kept: BTreeMap<String, Arc<[u8]>>,
    /// Messages that wait for each client, by its number.
    queues: BTreeMap<u64, VecDeque<Arc<[u8]>>>,
    next: u64,
    /// Connections that were opened and closed since they were last taken.
    changes: VecDeque<(SocketAddr, ClientChange)>,
}

impl Shared {
    fn state(&self) -> MutexGuard<'_, PublisherState> {
        // A thread that panicked has left whole entries.
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn changed(&self, address: SocketAddr, change: ClientChange) {
        let changes = &mut self.state().changes;
        if changes.len() >= MAX_CHANGES {
            changes.pop_front();
        }
        changes.push_back((address, change));
    }

    fn has_ended(&self) -> bool {
        self.ended.load(Ordering::Acquire)
    }
}

impl Publisher {
    /// Listens at an address, for so many clients at a time ([`MAX_CLIENTS`] at most); port 0 for any that is free. A client is left when
    /// it sends what is no message or too much of it, or takes nothing for a while.
    ///
    /// # Errors
    /// [`IgtlError::Serve`], [`IgtlError::Thread`].
    pub fn bind(address: SocketAddr, max_clients: usize) -> Result<Self, IgtlError> {
        let cannot = |cause| IgtlError::Serve { address: address.to_string(), cause };
        let listener = TcpListener::bind(address).map_err(cannot)?;
        listener.set_nonblocking(true).map_err(cannot)?;
        let address = listener.local_addr().map_err(cannot)?;
        let shared = Arc::new(Shared::default());
        let thread_state = shared.clone();
        let accepting = std::thread::Builder::new()
            .name("igtl server".into())
            .spawn(move || accept(&listener, &thread_state, max_clients.min(MAX_CLIENTS)))
            .map_err(IgtlError::Thread)?;
        Ok(Self { address, shared, accepting: Some(accepting) })
    }

    /// Address at which it listens.
    pub fn address(&self) -> SocketAddr {
        self.address
    }

    /// Clients that are connected.
    pub fn clients(&self) -> usize {
        self.shared.state().queues.len()
    }

    /// Who has connected, left or been rejected since the last call; of very many the latest.
    pub fn client_changes(&self) -> Vec<(SocketAddr, ClientChange)> {
        self.shared.state().changes.drain(..).collect()
    }

    /// Updates that clients were too slow for.
    pub fn dropped(&self) -> u64 {
        self.shared.dropped.load(Ordering::Relaxed)
    }

    /// Sends live values. Never waits.
    pub fn publish(&self, messages: &[Message]) {
        let bytes: Arc<[u8]> = messages.iter().flat_map(Message::to_bytes).collect();
        let mut state = self.shared.state();
        for queue in state.queues.values_mut() {
            self.enqueue(queue, bytes.clone());
        }
        drop(state);
        self.shared.news.notify_all();
    }

    /// Sends what is kept until a message of the same type and device name is sent, also to clients who come later.
    pub fn keep(&self, messages: &[Message]) {
        let mut state = self.shared.state();
        for message in messages {
            let bytes: Arc<[u8]> = message.to_bytes().into();
            state.kept.insert(format!("{} {}", message.content.kind(), message.device), bytes.clone());
            for queue in state.queues.values_mut() {
                self.enqueue(queue, bytes.clone());
            }
        }
        drop(state);
        self.shared.news.notify_all();
    }

    fn enqueue(&self, queue: &mut VecDeque<Arc<[u8]>>, bytes: Arc<[u8]>) {
        if queue.len() >= QUEUE {
            queue.pop_front();
            self.shared.dropped.fetch_add(1, Ordering::Relaxed);
        }
        queue.push_back(bytes);
    }
}

impl Drop for Publisher {
    fn drop(&mut self) {
        self.shared.ended.store(true, Ordering::Release);
        self.shared.news.notify_all();
        if let Some(accepting) = self.accepting.take() {
            let _ = accepting.join();
        }
    }
}

/// Takes clients until the server ends, and waits for their threads then.
fn accept(listener: &TcpListener, shared: &Arc<Shared>, max_clients: usize) {
    let mut threads: Vec<JoinHandle<()>> = Vec::new();
    while !shared.has_ended() {
        threads.retain(|thread| !thread.is_finished());
        match listener.accept() {
            Ok((stream, address)) if threads.len() < max_clients => {
                let thread_state = shared.clone();
                let named = std::thread::Builder::new().name("igtl client".into());
                // Without a thread there is no client.
                threads.extend(named.spawn(move || {
                    thread_state.changed(address, ClientChange::Connected);
                    serve(stream, &thread_state);
                    thread_state.changed(address, ClientChange::Left);
                }));
                std::thread::sleep(Duration::from_secs(1) / ACCEPTED_PER_S);
            }
            // More than that are rejected; the connection closes here.
            Ok((stream, address)) => {
                drop(stream);
                shared.changed(address, ClientChange::Rejected);
                std::thread::sleep(Duration::from_secs(1) / ACCEPTED_PER_S);
            }
            // Also where a client was gone before it was taken.
            Err(_) => std::thread::sleep(POLL_INTERVAL),
        }
    }
    for thread in threads {
        let _ = thread.join();
    }
}

/// One client, from its first message to its last.
fn serve(stream: TcpStream, shared: &Shared) {
    let number = {
        let mut state = shared.state();
        let number = state.next;
        state.next += 1;
        let kept_messages = state.kept.values().cloned().collect();
        state.queues.insert(number, kept_messages);
        number
    };
    let gone = AtomicBool::new(false);
    std::thread::scope(|scope| {
        scope.spawn(|| {
            // Ends with the connection; nothing that a client sends is needed.
            let _ = receive(&stream, shared, &gone);
            gone.store(true, Ordering::Release);
            shared.news.notify_all();
        });
        let _ = send(&stream, number, shared, &gone);
        gone.store(true, Ordering::Release);
        let _ = stream.shutdown(std::net::Shutdown::Both);
    });
    shared.state().queues.remove(&number);
}

/// Writes what waits for a client.
fn send(mut stream: &TcpStream, number: u64, shared: &Shared, gone: &AtomicBool) -> io::Result<()> {
    stream.set_nonblocking(false)?;
    stream.set_nodelay(true)?;
    stream.set_write_timeout(Some(TIMEOUT))?;
    loop {
        let bytes = {
            let mut state = shared.state();
            loop {
                if shared.has_ended() || gone.load(Ordering::Acquire) {
                    return Ok(());
                }
                if let Some(bytes) = state.queues.get_mut(&number).and_then(VecDeque::pop_front) {
                    break bytes;
                }
                state =
                    shared.news.wait_timeout(state, POLL_INTERVAL).unwrap_or_else(PoisonError::into_inner).0;
            }
        };
        stream.write_all(&bytes)?;
    }
}

/// Reads what a client sends, so that it is never blocked and its end is noticed. Requests are not answered: everything is sent anyway.
fn receive(mut stream: &TcpStream, shared: &Shared, gone: &AtomicBool) -> io::Result<()> {
    stream.set_read_timeout(Some(POLL_INTERVAL))?;
    let mut decoder = Decoder::default();
    let mut bytes = [0; 4096];
    let (mut last_byte, mut received) = (Instant::now(), 0);
    while !shared.has_ended() && !gone.load(Ordering::Acquire) {
        match stream.read(&mut bytes) {
            Ok(0) => return Ok(()),
            Ok(count) => {
                let new = bytes.get(..count).unwrap_or_default();
                if last_byte.elapsed() >= Duration::from_secs(1) {
                    (last_byte, received) = (Instant::now(), 0);
                }
                received += count;
                if received > RECEIVED_PER_S {
                    return Err(io::Error::new(ErrorKind::InvalidData, "more than a client may send"));
                }
                decoder.feed(new, |_| {}).map_err(|broken| io::Error::new(ErrorKind::InvalidData, broken))?;
            }
            Err(error) if is_pause(&error) => {}
            Err(error) => return Err(error),
        }
    }
    Ok(())
}

/// Whether nothing has arrived, rather than anything being wrong.
pub(super) fn is_pause(error: &io::Error) -> bool {
    matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut | ErrorKind::Interrupted)
}

/// The address to serve at: `HOST[:PORT]`, this machine alone where no host is given.
///
/// # Errors
/// [`IgtlError::Address`].
pub fn address(text: &str) -> Result<SocketAddr, IgtlError> {
    let (host, port) = match text.strip_prefix(':') {
        Some(port) => super::host_and_port(&format!("127.0.0.1:{port}"))?,
        None => super::host_and_port(text)?,
    };
    fn fault(problem: String, text: &str) -> IgtlError {
        IgtlError::Address { text: text.to_owned(), problem }
    }
    let mut addresses =
        (host.as_str(), port).to_socket_addrs().map_err(|error| fault(error.to_string(), text))?;
    addresses.next().ok_or_else(|| fault("no such host".to_owned(), text))
}
