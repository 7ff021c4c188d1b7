//! `guide web` on the firmware: the page in control goes silent, and the guide stops.

use serde_json::{Value, json};
use simulation::rig::config::RigConfig;
use std::io::{BufRead, BufReader};
use std::net::TcpStream;
use std::process::{Command, Stdio};
use std::time::Instant;
use system::bench::Bench;
use system::images::build_guide;
use system::peers::Running;
use system::qemu::HANGS;
use system::readme::page_stub;
use tungstenite::client::IntoClientRequest;
use tungstenite::{Message, WebSocket};

/// A motion that takes far longer than the heartbeat may be missing.
const SLOW: &str = "name = \"slow\"\n[[step]]\nmove_y_mm = 3.0\nspeed_mm_s = 0.1\n";
const TARGET_MM: f64 = 3.0;
/// The device's own limit of a silent host, seconds.
const SILENCE_LIMIT_S: f64 = 2.0;

struct Tab(WebSocket<TcpStream>);

impl Tab {
    fn open(address: &str) -> Self {
        let address_tail = address.strip_prefix("http://").unwrap();
        let (host, _) = address_tail.split_once('/').unwrap();
        let mut request = format!("ws://{address_tail}live").into_client_request().unwrap();
        request.headers_mut().insert("Origin", format!("http://{host}").parse().unwrap());
        let stream = TcpStream::connect(host).unwrap();
        stream.set_read_timeout(Some(HANGS)).unwrap();
        Self(tungstenite::client(request, stream).unwrap().0)
    }

    fn send(&mut self, message: Value) {
        self.0.send(Message::text(message.to_string())).unwrap();
    }

    fn update(&mut self) -> Value {
        loop {
            if let Message::Text(text) = self.0.read().unwrap() {
                return serde_json::from_str(&text).unwrap();
            }
        }
    }

    /// The first update that is as wanted.
    fn until(&mut self, is_alive: bool, wanted: impl Fn(&Value) -> bool) -> Value {
        let began = Instant::now();
        loop {
            let update = self.update();
            if is_alive {
                self.send(json!({"do": "heartbeat", "update": update["update"]}));
            }
            if wanted(&update) {
                return update;
            }
            assert!(began.elapsed() < HANGS, "{update}");
        }
    }

    /// Takes control and has the guide move; the device as it moves.
    fn moves(&mut self) -> Value {
        let start_update = self.until(true, |update| update["device"]["state"] == "idle");
        let start_mm = start_update["device"]["position_y_mm"].as_f64().unwrap();
        self.send(json!({"do": "take"}));
        self.send(json!({"do": "run", "program": "slow"}));
        let update = self.until(true, |update: &Value| {
            let device = &update["device"];
            device["state"] == "moving"
                && device["position_y_mm"].as_f64().is_some_and(|y_mm| (y_mm - start_mm).abs() > 0.1)
        });
        assert_eq!(update["control"], "this");
        update["device"].clone()
    }
}

/// The guide has stopped in time and short of its target, by supervision and without a fault.
fn check_stopped(moving: &Value, update: &Value, notice: &str) {
    let device = &update["device"];
    assert_eq!(update["notice"], notice);
    assert_eq!(device["fault"], Value::Null);
    assert!(device["position_y_mm"].as_f64().unwrap() < TARGET_MM - 1.0, "{device}");
    let took_s = device["time_s"].as_f64().unwrap() - moving["time_s"].as_f64().unwrap();
    assert!(took_s < SILENCE_LIMIT_S, "{took_s} s, later than for a silent host");
}

#[test]
#[ignore = "needs QEMU: cargo xtask test --all runs it"]
fn the_guide_stops_when_the_page_in_control_is_frozen_or_cut_off() {
    let bench = Bench::start(RigConfig::default(), 31, 1.0, HANGS).unwrap();
    let (page, program) = (bench.folder().join("guide.html"), bench.folder().join("slow.toml"));
    std::fs::write(&page, page_stub()).unwrap();
    std::fs::write(&program, SLOW).unwrap();
    let child = Command::new(build_guide().unwrap())
        .args(["web", "--json", "--port", &bench.port(), "--page"])
        .arg(&page)
        .arg("--program")
        .arg(&program)
        .arg(bench.folder())
        .stdin(Stdio::null())
        .stdout(Stdio::piped())
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    let mut guide = Running(child);
    let mut line = String::new();
    BufReader::new(guide.0.stdout.take().unwrap()).read_line(&mut line).unwrap();
    let report: Value = serde_json::from_str(&line).unwrap();
    let address = report["address"].as_str().unwrap();

    // The socket stays, the page draws nothing: a hidden tab, a debugger.
    let mut tab = Tab::open(address);
    let moving = tab.moves();
    let update = tab.until(false, |update| update["device"]["state"] == "idle");
    check_stopped(&moving, &update, "stopped: no heartbeat of the page in control for 1000 ms");
    assert_eq!(update["control"], "none");

    // The socket goes: a closed tab.
    let mut watching = Tab::open(address);
    let moving = tab.moves();
    drop(tab);
    let update = watching.until(false, |update| {
        update["device"]["state"] == "idle"
            && update["notice"].as_str().is_some_and(|text| text.contains("gone"))
    });
    check_stopped(&moving, &update, "stopped: the page in control has gone");
}
