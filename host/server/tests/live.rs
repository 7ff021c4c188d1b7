//! Pages that watch and move a device, over real sockets.

use device::link::{Batch, Client, Program};
use fake_device::{FakeDevice, Script};
use protocol::{EnvelopeReceiver, Message as FromDevice, Received, Request as ToDevice, SequenceTracker};
use serde_json::{Value, json};
use server::live::MAX_PAGES;
use server::sessions::Sessions;
use server::{Live, Page, ServedContent, Server};
use std::io::{Read, Write};
use std::net::TcpStream;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};
use tungstenite::client::IntoClientRequest;
use tungstenite::{Message, WebSocket};

/// When a test counts as hung.
const HANGS: Duration = Duration::from_secs(60);

struct Served {
    device: FakeDevice,
    server: Server,
    stop: Arc<AtomicBool>,
    supervision: Option<JoinHandle<()>>,
    _folder: tempfile::TempDir,
}

impl Drop for Served {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Release);
        if let Some(supervision) = self.supervision.take() {
            let _ = supervision.join();
        }
    }
}

fn served() -> Served {
    let device = FakeDevice::start(Script::default());
    let folder = tempfile::tempdir().expect("a folder");
    let client = Client::connect(&device.port).expect("connects");
    let programs = vec![Program::load("displace").expect("built in")];
    // The first samples no longer follow some model.
    let mut words = Some("the force along y no longer follows the model since 12:03:11 UTC".to_owned());
    let compare = move |batch: &Batch| words.take_if(|_| !batch.points.is_empty()).into_iter().collect();
    let mut live = Live::start(client, programs, compare).expect("a thread");
    let page = Page { text: String::new(), policy: String::new() };
    let sessions = Sessions::of(folder.path()).expect("a folder");
    let server =
        Server::start(ServedContent { page, sessions, feed: Some(live.feed()) }, 0).expect("a server");
    let stop = Arc::new(AtomicBool::new(false));
    let supervision = std::thread::spawn({
        let stop = Arc::clone(&stop);
        move || {
            while !stop.load(Ordering::Acquire) {
                live.supervise(Duration::from_millis(5));
            }
        }
    });
    Served { device, server, stop, supervision: Some(supervision), _folder: folder }
}

impl Served {
    /// Host and token of the address.
    fn parts(&self) -> (String, String) {
        let url = self.server.url();
        let (host, token) = url.trim_start_matches("http://").split_once('/').expect("a path");
        (host.to_owned(), token.trim_end_matches('/').to_owned())
    }

    fn page(&self) -> Tab {
        let (host, token) = self.parts();
        let mut request = format!("ws://{host}/{token}/live").into_client_request().expect("a request");
        let origin = format!("http://{host}").parse().expect("a value");
        request.headers_mut().insert("Origin", origin);
        let stream = TcpStream::connect(&host).expect("a connection");
        stream.set_read_timeout(Some(HANGS)).expect("a timeout");
        let (socket, _) = tungstenite::client(request, stream).expect("a socket");
        Tab { socket }
    }

    /// The first line of the answer to a request for a socket with these fields.
    fn upgrade(&self, fields: &str) -> String {
        let (host, token) = self.parts();
        let mut stream = TcpStream::connect(&host).expect("a connection");
        write!(stream, "GET /{token}/live HTTP/1.1\r\nHost: {host}\r\n{fields}\r\n").expect("sent");
        let mut answer = String::new();
        stream.read_to_string(&mut answer).expect("an answer");
        answer.lines().next().unwrap_or_default().to_owned()
    }

    fn count(&self, wanted: fn(&ToDevice) -> bool) -> usize {
        self.device.executed().iter().filter(|request| wanted(request)).count()
    }

    fn runs(&self) -> usize {
        self.count(|request| matches!(request, ToDevice::Run { .. }))
    }

    fn stops(&self) -> usize {
        self.count(|request| *request == ToDevice::Stop)
    }

    /// A page that has control, and has the device moved.
    fn moving(&self) -> Tab {
        let mut tab = self.page();
        let began = Instant::now();
        while self.runs() == 0 {
            assert!(began.elapsed() < HANGS, "nothing moves");
            tab.send(json!({"do": "take"}));
            tab.send(json!({"do": "home"}));
            tab.alive();
        }
        tab
    }
}

struct Tab {
    socket: WebSocket<TcpStream>,
}

impl Tab {
    fn send(&mut self, message: Value) {
        self.socket.send(Message::text(message.to_string())).expect("sent");
    }

    fn update(&mut self) -> Value {
        loop {
            if let Message::Text(text) = self.socket.read().expect("an update") {
                return serde_json::from_str(&text).expect("JSON");
            }
        }
    }

    /// Receives an update and answers it.
    fn alive(&mut self) -> Value {
        let update = self.update();
        self.send(json!({"do": "heartbeat", "update": update["update"]}));
        update
    }

    /// Receives updates until one is as wanted; answers them where the page is alive.
    fn until(&mut self, is_alive: bool, wanted: impl Fn(&Value) -> bool) -> Value {
        let began = Instant::now();
        loop {
            let update = if is_alive { self.alive() } else { self.update() };
            if wanted(&update) {
                return update;
            }
            assert!(began.elapsed() < HANGS, "{update}");
        }
    }

    /// Whether the server ends the connection.
    fn is_ended(&mut self) -> bool {
        let began = Instant::now();
        while began.elapsed() < HANGS {
            if self.socket.read().is_err() {
                return true;
            }
        }
        false
    }

    fn raw(&mut self, bytes: &[u8]) {
        self.socket.get_mut().write_all(bytes).expect("sent");
    }
}

#[test]
fn every_page_says_that_the_force_no_longer_follows_the_model() {
    let served = served();
    // The device sends samples of what it is made to do.
    let mover = served.moving();
    for mut tab in [mover, served.page()] {
        let update = tab.until(true, |update| update["device"]["parted"].is_array());
        let words = "the force along y no longer follows the model since 12:03:11 UTC";
        assert_eq!(update["device"]["parted"], json!([words]));
    }
}

fn notice(update: &Value) -> &str {
    update["notice"].as_str().unwrap_or_default()
}

fn wait_until(wanted: impl Fn() -> bool) {
    let began = Instant::now();
    while !wanted() {
        assert!(began.elapsed() < HANGS, "it does not happen");
        std::thread::sleep(Duration::from_millis(2));
    }
}

#[test]
fn a_page_receives_state_and_what_the_device_sends() {
    let served = served();
    let mut tab = served.moving();
    let update = tab.until(true, |update| update["device"]["state"].is_string());
    assert_eq!(update["schema"], "guide.live/2");
    assert_eq!(update["device"]["schema"], "guide.monitor/1");
    assert_eq!(update["programs"].as_array().map(Vec::len), Some(1));
    // The samples of the program that ran, for a page that comes later too.
    let mut second = served.page();
    let mut receiver = EnvelopeReceiver::new();
    let mut tracker = SequenceTracker::new();
    let (mut hellos, began) = (0, Instant::now());
    while tracker.totals().samples == 0 {
        assert!(began.elapsed() < HANGS, "{:?}", tracker.totals());
        let Message::Binary(bytes) = second.socket.read().expect("a message") else { continue };
        for found in receiver.feed(&bytes) {
            let Received::Frame(envelope) = found else { panic!("{found:?}") };
            hellos += usize::from(matches!(envelope.message, FromDevice::Hello(_)));
            assert!(tracker.observe(&envelope).is_clean(), "{envelope:?}");
        }
    }
    assert_eq!(hellos, 1, "how to read the samples comes first");
}

#[test]
fn a_page_without_heartbeat_loses_control_and_the_device_is_stopped() {
    let served = served();
    let mut tab = served.moving();
    // As a hidden or frozen tab: the socket is there, and read.
    let update = tab.until(false, |update| update["control"] == "none");
    assert_eq!(notice(&update), "stopped: no heartbeat of the page in control for 1000 ms");
    wait_until(|| served.stops() > 0);
    let runs = served.runs();
    tab.send(json!({"do": "home"}));
    let update = tab.until(true, |update| notice(update).starts_with("not done"));
    assert_eq!(notice(&update), "not done: the page has no control");
    assert_eq!(served.runs(), runs);
}

#[test]
fn a_heartbeat_for_what_was_never_sent_keeps_no_control() {
    let served = served();
    let mut tab = served.moving();
    let began = Instant::now();
    loop {
        let update = tab.update();
        if update["control"] == "none" {
            break;
        }
        tab.send(json!({"do": "heartbeat", "update": 1_000_000}));
        assert!(began.elapsed() < HANGS);
    }
    wait_until(|| served.stops() > 0);
}

#[test]
fn a_socket_that_is_cut_stops_the_device() {
    let served = served();
    let mut second = served.page();
    drop(served.moving());
    let update = second.until(false, |update| !notice(update).is_empty());
    assert_eq!(notice(&update), "stopped: the page in control has gone");
    wait_until(|| served.stops() > 0);
}

#[test]
fn one_page_has_control_and_every_page_may_stop() {
    let served = served();
    let mut first = served.page();
    first.send(json!({"do": "take"}));
    first.until(true, |update| update["control"] == "this");
    let mut second = served.page();
    second.send(json!({"do": "take"}));
    second.send(json!({"do": "run", "program": "displace by 1.2 mm"}));
    let update = second.until(false, |update| !notice(update).is_empty());
    assert_ne!(update["control"], "this");
    assert_eq!(served.runs(), 0);
    let stops = served.stops();
    second.send(json!({"do": "stop"}));
    wait_until(|| served.stops() > stops);
}

#[test]
fn a_program_is_run_by_its_name_and_shown_to_all() {
    let served = served();
    let mut tab = served.page();
    let began = Instant::now();
    while served.runs() == 0 {
        assert!(began.elapsed() < HANGS);
        tab.send(json!({"do": "take"}));
        tab.send(json!({"do": "run", "program": "displace by 1.2 mm"}));
        tab.alive();
    }
    let steps = Program::load("displace").expect("built in").steps.len();
    let mut second = served.page();
    let update = second.until(false, |update| update["program"].is_object() || update["control"] == "none");
    if update["control"] == "other" {
        assert_eq!(update["program"], json!({"name": "displace by 1.2 mm", "steps": steps}));
    }
    tab.send(json!({"do": "take"}));
    tab.send(json!({"do": "run", "program": "/etc/passwd"}));
    tab.until(true, |update| notice(update) == "not done: no program /etc/passwd");
}

#[test]
fn control_that_is_given_up_stops_the_device() {
    let served = served();
    let mut tab = served.moving();
    tab.send(json!({"do": "leave"}));
    tab.until(false, |update| update["control"] == "none" && notice(update).starts_with("stopped"));
    wait_until(|| served.stops() > 0);
}

#[test]
fn frames_that_break_the_rules_end_the_connection_and_stop_the_device() {
    let served = served();
    let long = [&[0x81, 0xFE, 0x40, 0x00, 0, 0, 0, 0][..], &[b' '; 0x4000][..]].concat();
    let endless = [0x81, 0xFF, 0x7F, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0, 0, 0, 0];
    for (what, bytes) in [
        ("not masked", &[0x81, 0x02, b'{', b'}'][..]),
        ("no request", &[0x81, 0x82, 0, 0, 0, 0, b'{', b'}'][..]),
        ("binary", &[0x82, 0x81, 0, 0, 0, 0, 1][..]),
        ("not UTF-8", &[0x81, 0x81, 0, 0, 0, 0, 0xFF][..]),
        ("reserved bits", &[0xF1, 0x80, 0, 0, 0, 0][..]),
        ("too long", &long),
        ("endless", &endless),
    ] {
        let stops = served.stops();
        let mut tab = served.page();
        let began = Instant::now();
        tab.send(json!({"do": "take"}));
        while tab.alive()["control"] != "this" {
            assert!(began.elapsed() < HANGS, "{what}");
            tab.send(json!({"do": "take"}));
        }
        tab.raw(bytes);
        assert!(tab.is_ended(), "{what}");
        wait_until(|| served.stops() > stops);
    }
}

#[test]
fn a_page_that_sends_without_end_is_disconnected() {
    let served = served();
    let mut tab = served.page();
    let text = json!({"do": "heartbeat", "update": 0}).to_string();
    let began = Instant::now();
    while tab.socket.send(Message::text(text.clone())).is_ok() {
        assert!(began.elapsed() < HANGS, "it is not disconnected");
    }
    assert!(served.page().update()["update"].is_number(), "others are served");
}

#[test]
fn a_socket_is_for_pages_of_the_server_alone() {
    let served = served();
    let key = "Upgrade: websocket\r\nConnection: Upgrade\r\nSec-WebSocket-Version: 13\r\nSec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\n";
    let (host, _) = served.parts();
    for (fields, status) in [
        (key.to_owned(), "HTTP/1.1 403 Forbidden"),
        (format!("{key}Origin: http://evil.example\r\n"), "HTTP/1.1 403 Forbidden"),
        (format!("Origin: http://{host}\r\n"), "HTTP/1.1 400 Bad Request"),
    ] {
        assert_eq!(served.upgrade(&fields), status, "{fields}");
    }
    let watching: Vec<Tab> = (0..MAX_PAGES).map(|_| served.page()).collect();
    assert_eq!(
        served.upgrade(&format!("{key}Origin: http://{host}\r\n")),
        "HTTP/1.1 503 Service Unavailable"
    );
    drop(watching);
}
