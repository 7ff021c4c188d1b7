//! The server as programs of the same machine reach it.

use super::*;
use std::fs;

struct Served {
    _folder: tempfile::TempDir,
    server: Server,
}

fn served() -> Served {
    let folder = tempfile::tempdir().expect("a folder");
    fs::create_dir(folder.path().join("one")).expect("a folder");
    fs::write(folder.path().join("one/session.toml"), "[session]\n").expect("a file");
    fs::write(folder.path().join("one/a b.csv"), "x\n1\n").expect("a file");
    let page =
        Page { text: "<p>the page".to_owned(), policy: "default-src 'none'; connect-src 'self'".to_owned() };
    let sessions = Sessions::of(folder.path()).expect("a folder");
    let server = Server::start(ServedContent { page, sessions, feed: None }, 0).expect("a server");
    Served { _folder: folder, server }
}

impl Served {
    /// Host and token of the address.
    fn parts(&self) -> (String, String) {
        let url = self.server.url();
        let address = url.strip_prefix("http://").expect("an address");
        let (host, remaining_path) = address.split_once('/').expect("a path");
        (host.to_owned(), remaining_path.trim_end_matches('/').to_owned())
    }

    fn connect(&self) -> TcpStream {
        TcpStream::connect(self.parts().0).expect("a connection")
    }

    /// The answer to these bytes, which the server ends.
    fn raw(&self, request: &str) -> String {
        let mut stream = self.connect();
        stream.write_all(request.as_bytes()).expect("sent");
        let mut answer = String::new();
        stream.read_to_string(&mut answer).expect("an answer");
        answer
    }

    fn get(&self, path: &str, more: &str) -> String {
        let (host, token) = self.parts();
        self.raw(&format!("GET /{token}/{path} HTTP/1.1\r\nHost: {host}\r\n{more}\r\n"))
    }
}

fn status(answer: &str) -> &str {
    answer.split(' ').nth(1).expect("a status")
}

#[test]
fn the_page_its_sessions_and_their_files_are_served() {
    let served = served();
    let page = served.get("", "");
    assert_eq!(status(&page), "200");
    assert!(page.contains("Content-Security-Policy: default-src 'none'; connect-src 'self'\r\n"), "{page}");
    assert!(page.contains("X-Content-Type-Options: nosniff\r\n") && page.ends_with("\r\n\r\n<p>the page"));
    assert!(!page.contains("Access-Control"), "no other origin may read it");
    let (_, list) = served
        .get("sessions", "")
        .split_once("\r\n\r\n")
        .map(|(a, b)| (a.to_owned(), b.to_owned()))
        .expect("a body");
    let list: serde_json::Value = serde_json::from_str(&list).expect("JSON");
    assert_eq!(list["sessions"][0]["path"], "one");
    assert_eq!(list["sessions"][0]["files"], serde_json::json!(["a b.csv", "session.toml"]));
    assert_eq!(list["device"], false);
    let file = served.get("file/one/a%20b.csv", "");
    assert!(file.ends_with("\r\n\r\nx\n1\n") && file.contains("sandbox"), "{file}");
}

#[test]
fn everything_else_is_rejected() {
    let served = served();
    let (host, token) = served.parts();
    for path in [
        "file/one/none.csv",
        "file/../one/session.toml",
        "file/one/%2e%2e/one/session.toml",
        "file/one%2fsession.toml%00",
        "file/%",
        "sessions/",
        "live",
        "other",
    ] {
        assert_eq!(status(&served.get(path, "")), "404", "{path}");
    }
    assert_eq!(status(&served.raw(&format!("GET / HTTP/1.1\r\nHost: {host}\r\n\r\n"))), "404");
    let guessed = format!("GET /{}/ HTTP/1.1\r\nHost: {host}\r\n\r\n", "0".repeat(32));
    assert_eq!(status(&served.raw(&guessed)), "404");
    let rebound = format!("GET /{token}/ HTTP/1.1\r\nHost: evil.example\r\n\r\n");
    assert_eq!(status(&served.raw(&rebound)), "403");
    assert_eq!(status(&served.get("", "Origin: http://evil.example\r\n")), "403");
    let posted = format!("POST /{token}/ HTTP/1.1\r\nHost: {host}\r\n\r\n");
    assert_eq!(status(&served.raw(&posted)), "405");
    assert_eq!(status(&served.raw("nonsense\r\n\r\n")), "400");
}

#[test]
fn a_head_that_does_not_end_is_rejected() {
    let served = served();
    let (host, token) = served.parts();
    let long = format!("GET /{token}/{} HTTP/1.1\r\nHost: {host}\r\n", "a".repeat(http::MAX_HEAD_BYTES));
    let mut stream = served.connect();
    stream.write_all(long.as_bytes()).expect("sent");
    let mut answer = Vec::new();
    // Bytes that were not read make the end of the connection a reset on some systems.
    let _ = stream.read_to_end(&mut answer);
    assert!(answer.starts_with(b"HTTP/1.1 400"), "{}", String::from_utf8_lossy(&answer));
}

#[test]
fn connections_without_a_request_do_not_keep_the_page_from_its_own() {
    let served = served();
    let silent: Vec<_> = (0..4 * MAX_CONNECTIONS).map(|_| served.connect()).collect();
    assert_eq!(status(&served.get("", "")), "200");
    // Half a head is none.
    let mut half = served.connect();
    half.write_all(b"GET / HTTP/1.1\r\n").expect("sent");
    assert_eq!(status(&served.get("sessions", "")), "200");
    drop(silent);
    assert_eq!(status(&served.get("", "")), "200");
}

#[test]
fn more_requests_than_there_are_places_for_are_rejected_and_places_are_freed() {
    let served = served();
    // More than a socket holds, of which nothing is read: each keeps its place.
    let file = fs::File::create(served._folder.path().join("one/long.csv")).expect("a file");
    file.set_len(64 << 20).expect("a long file");
    let (host, token) = served.parts();
    let request = format!("GET /{token}/file/one/long.csv HTTP/1.1\r\nHost: {host}\r\n\r\n");
    let mut slow = Vec::new();
    for _ in 0..MAX_CONNECTIONS {
        let mut stream = served.connect();
        stream.write_all(request.as_bytes()).expect("sent");
        // It has its place when its answer begins.
        stream.read_exact(&mut [0; 15]).expect("an answer");
        slow.push(stream);
    }
    let mut answer = String::new();
    served.connect().read_to_string(&mut answer).expect("an answer");
    assert_eq!(status(&answer), "503");
    drop(slow);
    let mut tries = 0;
    while status(&served.get("", "")) != "200" {
        tries += 1;
        assert!(tries < 1_000, "no place was freed");
        std::thread::sleep(POLL_INTERVAL);
    }
}
