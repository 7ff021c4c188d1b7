//! The WebSocket of one page: updates and the frames of the device to it, its requests from it, all bounded.

use crate::live::PageConnection;
use crate::request::Request;
use crate::update::UPDATE_INTERVAL;
use std::collections::VecDeque;
use std::io::{self, ErrorKind};
use std::net::TcpStream;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};
use tungstenite::protocol::{Role, WebSocketConfig};
use tungstenite::{Error, Message, WebSocket};

/// Longest message of a page, bytes.
pub const MAX_MESSAGE_BYTES: usize = 1_024;
/// Messages of a page in a second; more end the connection.
pub const MAX_MESSAGES_PER_S: usize = 100;
/// Time for which one reading waits: requests are handled and updates sent within this.
const POLL_INTERVAL: Duration = Duration::from_millis(10);
/// Time for which a page may leave an update unread; the system's buffers hold seconds of them
/// before.
const WRITE_TIME: Duration = Duration::from_millis(1_000);
/// Updates whose heartbeat still counts: more than fit into the heartbeat's limit.
const MAX_REMEMBERED: usize = 64;

/// Serves a page until it goes, breaks a rule, or the server ends. The page's place is freed with it.
///
/// # Errors
/// Where the connection cannot be set up.
pub fn serve(stream: TcpStream, mut watcher: PageConnection, stop: &AtomicBool) -> io::Result<()> {
    stream.set_nodelay(true)?;
    stream.set_read_timeout(Some(POLL_INTERVAL))?;
    stream.set_write_timeout(Some(WRITE_TIME))?;
    let config = WebSocketConfig::default()
        .max_message_size(Some(MAX_MESSAGE_BYTES))
        .max_frame_size(Some(MAX_MESSAGE_BYTES))
        .write_buffer_size(0);
    let mut socket = WebSocket::from_raw_socket(stream, Role::Server, Some(config));
    let mut remembered: VecDeque<(u64, Instant)> = VecDeque::new();
    let mut update_at = Instant::now();
    let (mut second, mut messages) = (Instant::now(), 0usize);
    while !stop.load(Ordering::Acquire) {
        let received = socket.read();
        messages += usize::from(received.is_ok());
        match received {
            Ok(Message::Text(text)) => {
                let Some(request) = Request::read(&text) else { break };
                let is_passed_on = match request {
                    Request::Heartbeat(update) => {
                        // One that was never sent, or long ago, counts for nothing.
                        let sent = remembered.iter().find(|(number, _)| *number == update);
                        sent.is_none_or(|(_, at)| watcher.heartbeat(*at))
                    }
                    request => watcher.request(request),
                };
                if !is_passed_on {
                    break;
                }
            }
            Ok(Message::Ping(_) | Message::Pong(_)) => {}
            Ok(Message::Binary(_) | Message::Close(_) | Message::Frame(_)) => break,
            Err(Error::Io(error)) if is_pause(&error) => {}
            Err(_) => break,
        }
        if second.elapsed() >= Duration::from_secs(1) {
            (second, messages) = (Instant::now(), 0);
        } else if messages > MAX_MESSAGES_PER_S {
            break;
        }
        if Instant::now() >= update_at {
            update_at = Instant::now() + UPDATE_INTERVAL;
            let text = serde_json::to_string(&watcher.update())?;
            remembered.push_back((watcher.sent(), Instant::now()));
            if remembered.len() > MAX_REMEMBERED {
                remembered.pop_front();
            }
            let frames = watcher.frames();
            let is_sent = socket.send(Message::text(text)).is_ok()
                && (frames.is_empty() || socket.send(Message::binary(frames)).is_ok());
            if !is_sent {
                break;
            }
        }
    }
    // The page before its connection: what it moved is stopped first. Whether the page learns the end does not matter.
    drop(watcher);
    let _ = socket.close(None);
    let _ = socket.flush();
    Ok(())
}

/// Whether no data have arrived for the moment.
fn is_pause(error: &io::Error) -> bool {
    matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut | ErrorKind::Interrupted)
}
