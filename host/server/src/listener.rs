//! Connections: at most so many at a time, each on its own thread, each with one request.
//!
//! Every peer is a program of this machine, which can open as many as it likes. So a connection without the head of a request has no place
//! of its own: where all are taken, the one that has waited longest gives way to the next one.

use crate::access::{Access, Token};
use crate::http::{self, Head, RequestError, Status};
use crate::live::{PageConnection, SharedState};
use crate::page::Page;
use crate::sessions::{List, MAX_FILE_BYTES, Sessions};
use crate::socket;
use serde::Serialize;
use std::collections::VecDeque;
use std::io::{self, Read, Write};
use std::net::{Ipv4Addr, SocketAddr, TcpListener, TcpStream};
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::Duration;

/// Connections at a time; more are rejected.
pub const MAX_CONNECTIONS: usize = 32;
/// Interval at which the listener checks whether it is to end.
const POLL_INTERVAL: Duration = Duration::from_millis(10);
const HTML: &str = "text/html; charset=utf-8";
const JSON: &str = "application/json";
const TEXT: &str = "text/plain; charset=utf-8";

/// Served content.
#[derive(Debug)]
pub struct ServedContent {
    /// The page.
    pub page: Page,
    /// The sessions that it can open.
    pub sessions: Sessions,
    /// The device, where there is one.
    pub feed: Option<Arc<SharedState>>,
}

/// First answer to the page.
#[derive(Serialize)]
struct Listed {
    #[serde(flatten)]
    list: List,
    /// Whether there is a live view.
    device: bool,
}

/// The running server. Dropping it ends it.
#[derive(Debug)]
pub struct Server {
    access: Access,
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

/// State that all connections share.
struct Shared {
    site: ServedContent,
    access: Access,
    connections: AtomicUsize,
    /// Connections without a head so far, the oldest first, by their number.
    headless: Mutex<VecDeque<(u64, TcpStream)>>,
    stop: Arc<AtomicBool>,
}

impl Shared {
    /// Ends the connection that has waited longest for its head; false where none waits.
    fn make_room(&self) -> bool {
        let oldest = self.headless.lock().unwrap_or_else(PoisonError::into_inner).pop_front();
        // Its thread reads the end of it, and frees its place.
        oldest.is_some_and(|(_, stream)| stream.shutdown(std::net::Shutdown::Both).is_ok())
    }

    /// A connection has its head, or has ended.
    fn has_head(&self, number: u64) {
        let mut headless = self.headless.lock().unwrap_or_else(PoisonError::into_inner);
        headless.retain(|(waiting, _)| *waiting != number);
    }
}

impl Server {
    /// Begins to serve at a port of loopback; 0 lets the system choose a free one.
    ///
    /// # Errors
    /// Where the port is in use, or the system gives no thread or no randomness.
    pub fn start(site: ServedContent, port: u16) -> io::Result<Self> {
        let listener = TcpListener::bind(SocketAddr::from((Ipv4Addr::LOCALHOST, port)))?;
        listener.set_nonblocking(true)?;
        let access = Access::new(Token::random()?, listener.local_addr()?);
        let stop = Arc::new(AtomicBool::new(false));
        let (connections, shared_stop) = (AtomicUsize::new(0), Arc::clone(&stop));
        let headless = Mutex::default();
        let shared =
            Arc::new(Shared { site, access: access.clone(), connections, headless, stop: shared_stop });
        let thread =
            std::thread::Builder::new().name("web".into()).spawn(move || listen(&listener, &shared))?;
        Ok(Self { access, stop, thread: Some(thread) })
    }

    /// The address to open, with the token.
    pub fn url(&self) -> String {
        self.access.url()
    }

    /// Whether it still serves.
    pub fn is_running(&self) -> bool {
        self.thread.as_ref().is_some_and(|thread| !thread.is_finished())
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Release);
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

fn listen(listener: &TcpListener, shared: &Arc<Shared>) {
    let mut number = 0;
    while !shared.stop.load(Ordering::Acquire) {
        // A connection that has gone before it was accepted is no reason to end.
        let Ok((mut stream, _)) = listener.accept() else {
            std::thread::sleep(POLL_INTERVAL);
            continue;
        };
        if stream.set_nonblocking(false).is_err() {
            continue;
        }
        if shared.connections.fetch_add(1, Ordering::AcqRel) >= MAX_CONNECTIONS && !shared.make_room() {
            shared.connections.fetch_sub(1, Ordering::AcqRel);
            // A few bytes, which always fit.
            let _ = http::refuse(&mut stream, Status::Unavailable);
            continue;
        }
        let slot = Place(Arc::clone(shared));
        let Ok(copy) = stream.try_clone() else { continue };
        number += 1;
        shared.headless.lock().unwrap_or_else(PoisonError::into_inner).push_back((number, copy));
        // Without a thread the connection is closed and its slot is free again.
        let _ = std::thread::Builder::new().name("web-client".into()).spawn(move || {
            // A client that has gone needs no answer.
            let _ = answer(stream, &slot.0, number);
            slot.0.has_head(number);
        });
    }
}

/// One of the connections.
struct Place(Arc<Shared>);

impl Drop for Place {
    fn drop(&mut self) {
        self.0.connections.fetch_sub(1, Ordering::AcqRel);
    }
}

fn answer(mut connection: TcpStream, shared: &Shared, number: u64) -> io::Result<()> {
    let stream = &mut connection;
    let head = Head::read(stream, http::HEAD_TIME);
    shared.has_head(number);
    let head = match head {
        Ok(head) => head,
        Err(RequestError::Malformed) => return http::refuse(stream, Status::BadRequest),
        Err(RequestError::Io(error)) => return Err(error),
    };
    let path = match shared.access.admit(&head) {
        Ok(path) => path,
        Err(status) => return http::refuse(stream, status),
    };
    let site = &shared.site;
    match path {
        "" => send(stream, HTML, site.page.text.as_bytes(), Some(&site.page.policy)),
        "sessions" => {
            let listed = Listed { list: site.sessions.list(), device: site.feed.is_some() };
            send(stream, JSON, &serde_json::to_vec(&listed)?, None)
        }
        "live" => {
            let Some(feed) = &site.feed else { return http::refuse(stream, Status::NotFound) };
            let Some(key) = &head.websocket_key else { return http::refuse(stream, Status::BadRequest) };
            // Browsers state it for every socket; what states none is no page.
            if !shared.access.is_own_origin(&head) {
                return http::refuse(stream, Status::Forbidden);
            }
            let Some(watcher) = PageConnection::join(feed) else {
                return http::refuse(stream, Status::Unavailable);
            };
            http::switch(stream, key)?;
            socket::serve(connection, watcher, &shared.stop)
        }
        _ => {
            let named = path.strip_prefix("file/").and_then(http::decoded);
            match named.and_then(|named| site.sessions.open(&named)) {
                Some((_, length)) if length > MAX_FILE_BYTES => http::refuse(stream, Status::TooLarge),
                Some((file, length)) => {
                    http::begin(stream, Status::Ok, TEXT, length, None)?;
                    // A file that grows meanwhile ends where it did.
                    io::copy(&mut file.take(length), stream).map(|_| ())
                }
                None => http::refuse(stream, Status::NotFound),
            }
        }
    }
}

fn send(stream: &mut TcpStream, kind: &str, content: &[u8], policy: Option<&str>) -> io::Result<()> {
    http::begin(stream, Status::Ok, kind, content.len() as u64, policy)?;
    stream.write_all(content)
}

#[cfg(test)]
#[path = "listener_tests.rs"]
mod tests;
