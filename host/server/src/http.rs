//! Requests and answers: one request per connection, without a body, of bounded size and time.

use std::io::{self, Read, Write};
use std::net::TcpStream;
use std::time::{Duration, Instant};

/// Longest head of a request, bytes.
pub const MAX_HEAD_BYTES: usize = 8 * 1024;
/// Most header fields of a request.
const MAX_FIELDS: usize = 48;
/// Time within which a request has to arrive.
pub const HEAD_TIME: Duration = Duration::from_secs(5);
/// Time for which one part of an answer may wait for its reader.
pub const WRITE_TIME: Duration = Duration::from_secs(10);

/// Status of an answer.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[expect(missing_docs, reason = "each is the status of HTTP of that name")]
pub enum Status {
    Ok,
    BadRequest,
    Forbidden,
    NotFound,
    MethodNotAllowed,
    TooLarge,
    Unavailable,
}

impl Status {
    fn line(self) -> &'static str {
        match self {
            Self::Ok => "200 OK",
            Self::BadRequest => "400 Bad Request",
            Self::Forbidden => "403 Forbidden",
            Self::NotFound => "404 Not Found",
            Self::MethodNotAllowed => "405 Method Not Allowed",
            Self::TooLarge => "413 Content Too Large",
            Self::Unavailable => "503 Service Unavailable",
        }
    }
}

/// Parts of a request that are used.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Head {
    /// Its method.
    pub method: String,
    /// Its path, as it was sent.
    pub path: String,
    /// The host that it was made for.
    pub host: Option<String>,
    /// The origin of the page that made it.
    pub origin: Option<String>,
    /// The key of a request for a WebSocket.
    pub websocket_key: Option<String>,
}

/// Why there is no request.
#[derive(Debug, thiserror::Error)]
pub enum RequestError {
    /// The connection failed, ended or took too long.
    #[error(transparent)]
    Io(#[from] io::Error),
    /// It is not a request that is answered.
    #[error("not a request that is answered")]
    Malformed,
}

impl Head {
    /// Reads a request, whose head has to be complete within a time: bytes that keep coming one by one do not prolong it.
    ///
    /// # Errors
    /// [`RequestError`].
    pub fn read(stream: &mut TcpStream, within: Duration) -> Result<Self, RequestError> {
        let deadline = Instant::now() + within;
        let mut bytes = Vec::new();
        let mut chunk = [0; 1024];
        loop {
            let remaining = deadline.saturating_duration_since(Instant::now());
            if remaining.is_zero() {
                return Err(io::Error::from(io::ErrorKind::TimedOut).into());
            }
            stream.set_read_timeout(Some(remaining))?;
            let count = stream.read(&mut chunk)?;
            if count == 0 {
                return Err(io::Error::from(io::ErrorKind::UnexpectedEof).into());
            }
            bytes.extend_from_slice(chunk.get(..count).unwrap_or_default());
            if let Some(head) = Self::parse(&bytes)? {
                return Ok(head);
            }
            if bytes.len() > MAX_HEAD_BYTES {
                return Err(RequestError::Malformed);
            }
        }
    }

    /// The request in these bytes; none where it is not complete.
    ///
    /// # Errors
    /// [`RequestError::Malformed`], also where bytes follow it.
    pub fn parse(bytes: &[u8]) -> Result<Option<Self>, RequestError> {
        let mut fields = [httparse::EMPTY_HEADER; MAX_FIELDS];
        let mut request = httparse::Request::new(&mut fields);
        let parsed = request.parse(bytes).map_err(|_| RequestError::Malformed)?;
        let httparse::Status::Complete(length) = parsed else { return Ok(None) };
        let (Some(method), Some(path), Some(1)) = (request.method, request.path, request.version) else {
            return Err(RequestError::Malformed);
        };
        if length != bytes.len() {
            return Err(RequestError::Malformed);
        }
        let all = |name: &str| {
            let named = request.headers.iter().filter(|field| field.name.eq_ignore_ascii_case(name));
            named.map(|field| std::str::from_utf8(field.value)).collect::<Result<Vec<_>, _>>()
        };
        // A field that is there twice could be read in two ways.
        let one = |name: &str| match all(name).map_err(|_| RequestError::Malformed)?.as_slice() {
            [] => Ok(None),
            [value] => Ok(Some((*value).to_owned())),
            _ => Err(RequestError::Malformed),
        };
        let has_body =
            one("content-length")?.is_some_and(|length| length != "0") || one("transfer-encoding")?.is_some();
        if has_body {
            return Err(RequestError::Malformed);
        }
        let is_upgrade = one("upgrade")?.is_some_and(|kind| kind.eq_ignore_ascii_case("websocket"))
            && one("sec-websocket-version")?.as_deref() == Some("13");
        let websocket_key = one("sec-websocket-key")?.filter(|_| is_upgrade);
        let (method, path) = (method.to_owned(), path.to_owned());
        Ok(Some(Self { method, path, host: one("host")?, origin: one("origin")?, websocket_key }))
    }
}

/// Header fields of every answer: nothing is kept, nothing is guessed, nothing is shown to other origins.
const COMMON: &str = "Cache-Control: no-store\r\nX-Content-Type-Options: nosniff\r\nReferrer-Policy: no-referrer\r\n\
                      Cross-Origin-Resource-Policy: same-origin\r\nCross-Origin-Opener-Policy: same-origin\r\n\
                      X-Frame-Options: DENY\r\nConnection: close\r\n";
/// Policy of an answer that is opened as a page but is not the page.
const NOTHING: &str = "default-src 'none'; frame-ancestors 'none'; sandbox";

/// Begins an answer.
///
/// # Errors
/// As the stream has them.
pub fn begin(
    stream: &mut TcpStream,
    status: Status,
    kind: &str,
    length: u64,
    policy: Option<&str>,
) -> io::Result<()> {
    stream.set_write_timeout(Some(WRITE_TIME))?;
    let policy = policy.unwrap_or(NOTHING);
    write!(
        stream,
        "HTTP/1.1 {}\r\nContent-Type: {kind}\r\nContent-Length: {length}\r\nContent-Security-Policy: {policy}\r\n{COMMON}\r\n",
        status.line()
    )
}

/// Answers with a status alone.
///
/// # Errors
/// As the stream has them.
pub fn refuse(stream: &mut TcpStream, status: Status) -> io::Result<()> {
    let text = format!("{}\n", status.line());
    begin(stream, status, "text/plain; charset=utf-8", text.len() as u64, None)?;
    stream.write_all(text.as_bytes())
}

/// Accepts a request for a WebSocket.
///
/// # Errors
/// As the stream has them.
pub fn switch(stream: &mut TcpStream, key: &str) -> io::Result<()> {
    let accept = tungstenite::handshake::derive_accept_key(key.as_bytes());
    stream.set_write_timeout(Some(WRITE_TIME))?;
    write!(
        stream,
        "HTTP/1.1 101 Switching Protocols\r\nUpgrade: websocket\r\nConnection: Upgrade\r\nSec-WebSocket-Accept: {accept}\r\n\r\n"
    )
}

/// A path with its percent signs decoded; none where it is not UTF-8 or a sign stands alone.
pub fn decoded(path: &str) -> Option<String> {
    let mut bytes = Vec::with_capacity(path.len());
    let mut encoded_bytes = path.bytes();
    while let Some(byte) = encoded_bytes.next() {
        if byte != b'%' {
            bytes.push(byte);
            continue;
        }
        let digit = |byte: Option<u8>| char::from(byte?).to_digit(16);
        let (high, low) = (digit(encoded_bytes.next())?, digit(encoded_bytes.next())?);
        bytes.push(u8::try_from(16 * high + low).ok()?);
    }
    String::from_utf8(bytes).ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_request_is_read_when_it_is_complete() {
        let text = b"GET /t/ HTTP/1.1\r\nhost: localhost:1\r\nOrigin: http://localhost:1\r\n\r\n";
        for length in 0..text.len() {
            assert!(matches!(Head::parse(&text[..length]), Ok(None)), "{length}");
        }
        let head = Head::parse(text).expect("a request").expect("complete");
        assert_eq!((head.method.as_str(), head.path.as_str()), ("GET", "/t/"));
        assert_eq!(head.host.as_deref(), Some("localhost:1"));
        assert_eq!(head.origin.as_deref(), Some("http://localhost:1"));
        assert_eq!(head.websocket_key, None);
    }

    #[test]
    fn a_head_that_comes_byte_by_byte_ends_at_its_time() {
        let listener = std::net::TcpListener::bind("127.0.0.1:0").expect("a port");
        let mut peer = TcpStream::connect(listener.local_addr().expect("an address")).expect("a connection");
        let (mut stream, _) = listener.accept().expect("a connection");
        let drips = std::thread::spawn(move || {
            // Until the other end has closed.
            while peer.write_all(b"G").is_ok() {
                std::thread::sleep(Duration::from_millis(1));
            }
        });
        let ended = Head::read(&mut stream, Duration::from_millis(50));
        assert!(matches!(ended, Err(RequestError::Io(_) | RequestError::Malformed)), "{ended:?}");
        drop(stream);
        drips.join().expect("it ends");
    }

    #[test]
    fn what_could_be_read_in_two_ways_is_rejected() {
        for text in [
            "GET / HTTP/1.1\r\nHost: a\r\nHost: b\r\n\r\n",
            "GET / HTTP/1.1\r\nOrigin: a\r\norigin: b\r\n\r\n",
            "GET / HTTP/1.1\r\nContent-Length: 4\r\n\r\n",
            "GET / HTTP/1.1\r\nTransfer-Encoding: chunked\r\n\r\n",
            "GET / HTTP/1.1\r\n\r\nGET / HTTP/1.1\r\n\r\n",
            "GET / HTTP/1.0\r\n\r\n",
            "GET /\r\n\r\n",
            "GET / HTTP/1.1\r\nHost: \u{fffd}\r\nnonsense\r\n\r\n",
            "\u{16}\u{3}\u{1} a greeting of TLS",
        ] {
            assert!(matches!(Head::parse(text.as_bytes()), Err(RequestError::Malformed)), "{text}");
        }
        let many = format!("GET / HTTP/1.1\r\n{}\r\n", "a: b\r\n".repeat(MAX_FIELDS + 1));
        assert!(matches!(Head::parse(many.as_bytes()), Err(RequestError::Malformed)));
    }

    #[test]
    fn percent_signs_are_decoded_once() {
        assert_eq!(decoded("a%20b%2Fc").as_deref(), Some("a b/c"));
        assert_eq!(decoded("%252e").as_deref(), Some("%2e"));
        for wrong in ["%", "%4", "%g0", "%ff", "%+1"] {
            assert_eq!(decoded(wrong), None, "{wrong}");
        }
    }
}
