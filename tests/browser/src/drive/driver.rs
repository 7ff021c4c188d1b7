//! A browser under WebDriver: the few commands that the test needs, as JSON over HTTP to the driver on this machine.

use anyhow::{Context, Result, anyhow, bail, ensure};
use serde_json::{Value, json};
use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpStream;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

/// Time limit of the page.
const TIMEOUT: Duration = Duration::from_secs(240);
const POLL_INTERVAL: Duration = Duration::from_millis(50);
/// Name by which the browser lists the threads of workers.
const WORKER: &str = "DedicatedWorker";
/// Switches off activity of the browser that the page does not request.
const ARGUMENTS: [&str; 9] = [
    "--headless",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--hide-scrollbars",
];

/// A browser with one page.
pub struct Browser {
    driver: Child,
    port: u16,
    session: String,
}

impl Browser {
    /// Starts the driver and a browser with a profile of its own in this folder.
    ///
    /// # Errors
    /// Where one of them does not start.
    pub fn start(profile: &Path) -> Result<Self> {
        let mut driver = Command::new("chromedriver")
            .arg("--port=0")
            .stdout(Stdio::piped())
            .spawn()
            .context("cannot start chromedriver")?;
        let output = driver.stdout.take().context("chromedriver has no output")?;
        let port = BufReader::new(output).lines().map_while(Result::ok).find_map(|line| {
            let (_, port_text) = line.split_once("successfully on port ")?;
            port_text.trim_end_matches('.').parse().ok()
        });
        let mut browser = Self { driver, port: port.unwrap_or(0), session: String::new() };
        ensure!(port.is_some(), "chromedriver ended without a port");
        let mut arguments: Vec<String> = ARGUMENTS.map(str::to_owned).to_vec();
        arguments.push(format!("--user-data-dir={}", profile.display()));
        let capabilities = json!({"capabilities": {"alwaysMatch": {
            "goog:chromeOptions": {"args": arguments},
            "goog:loggingPrefs": {"browser": "ALL"},
            "timeouts": {"script": TIMEOUT.as_millis() as u64},
        }}});
        let session_reply = browser.send("POST", "/session", &capabilities)?;
        let id = session_reply["sessionId"].as_str().context("the driver gave no session")?;
        browser.session = format!("/session/{id}");
        Ok(browser)
    }

    /// Opens an address.
    ///
    /// # Errors
    /// Where the browser reports one.
    pub fn open(&self, address: &str) -> Result<()> {
        // An address that differs by its mark alone is not loaded again.
        self.post("url", &json!({"url": "about:blank"}))?;
        self.post("url", &json!({"url": address})).map(drop)
    }

    /// Runs the body of a function in the page; `arguments[i]` are these.
    ///
    /// # Errors
    /// What the script throws.
    pub fn run(&self, script: &str, arguments: Value) -> Result<Value> {
        self.post("execute/sync", &json!({"script": script, "args": arguments}))
    }

    /// Runs the body of an asynchronous function and returns its result.
    ///
    /// # Errors
    /// What it throws.
    pub fn wait_for(&self, script: &str, arguments: Value) -> Result<Value> {
        let body = format!(
            "const [done, values] = [arguments[arguments.length - 1], arguments]; \
             (async () => {{ {} }})().then((value) => done({{ value }}), (error) => done({{ error: String(error.message || error) }}));",
            script.replace("arguments[", "values[")
        );
        let answer = self.post("execute/async", &json!({"script": body, "args": arguments}))?;
        match answer["error"].as_str() {
            Some(error) => bail!("{error}"),
            None => Ok(answer["value"].clone()),
        }
    }

    /// Waits until an expression is true.
    ///
    /// # Errors
    /// Where that takes too long; with what the page shows.
    pub fn until(&self, expression: &str) -> Result<()> {
        let start = Instant::now();
        while self.run(&format!("return Boolean({expression});"), json!([]))? != json!(true) {
            ensure!(
                start.elapsed() < TIMEOUT,
                "{expression}: not within {} s; the page: {}",
                TIMEOUT.as_secs(),
                self.shown_text()?
            );
            std::thread::sleep(POLL_INTERVAL);
        }
        Ok(())
    }

    fn shown_text(&self) -> Result<Value> {
        self.run("return document.body.innerText.slice(0, 600);", json!([]))
    }

    /// Presses keys on the element of this selector.
    ///
    /// # Errors
    /// Where there is none.
    pub fn press(&self, selector: &str, keys: &str) -> Result<()> {
        let element = self.post("element", &json!({"using": "css selector", "value": selector}))?;
        let id = element.as_object().and_then(|element| element.values().next()).and_then(Value::as_str);
        let id = id.with_context(|| format!("{selector}: not on the page"))?;
        self.post(&format!("element/{id}/value"), &json!({"text": keys})).map(drop)
    }

    /// Sets the size of the page, and light or dark.
    ///
    /// # Errors
    /// Where the browser reports one.
    pub fn appear(&self, width: u32, height: u32, scheme: &str) -> Result<()> {
        let metrics = json!({"width": width, "height": height, "deviceScaleFactor": 1, "mobile": false});
        self.devtools("Emulation.setDeviceMetricsOverride", metrics)?;
        let features = json!({"features": [{"name": "prefers-color-scheme", "value": scheme}]});
        self.devtools("Emulation.setEmulatedMedia", features).map(drop)
    }

    /// A picture of the page as PNG in base 64.
    ///
    /// # Errors
    /// Where the browser reports one.
    pub fn picture(&self) -> Result<Vec<u8>> {
        let screenshot = self.devtools("Page.captureScreenshot", json!({"format": "png"}))?;
        let text = screenshot["data"].as_str().context("no picture")?;
        decoded(text).context("a picture that is no base 64")
    }

    /// Memory that the page's scripts keep, after garbage collection.
    ///
    /// # Errors
    /// Where the browser reports one.
    pub fn heap_bytes(&self) -> Result<u64> {
        self.devtools("HeapProfiler.collectGarbage", json!({}))?;
        let usage = self.devtools("Runtime.getHeapUsage", json!({}))?;
        usage["usedSize"].as_f64().map(|bytes| bytes as u64).context("no size of the heap")
    }

    /// Memory of all processes of the browser and its driver.
    pub fn resident_bytes(&self) -> u64 {
        self.family().iter().map(|process| process.2).sum()
    }

    /// Processor time of the workers in which the engine runs, s: it depends less than the time that passes on what
    /// else the machine does. Time of the browser's other work, as compiling and drawing, is not included.
    pub fn engine_s(&self) -> f64 {
        self.family()
            .iter()
            .map(|process| -> f64 {
                let threads = std::fs::read_dir(format!("/proc/{}/task", process.0)).into_iter().flatten();
                threads.filter_map(|thread| worker_s(&thread.ok()?.path())).sum()
            })
            .sum()
    }

    /// All processes of the browser and its driver, as [`process`] has them.
    fn family(&self) -> Vec<(u32, u32, u64)> {
        let processes: Vec<(u32, u32, u64)> = std::fs::read_dir("/proc")
            .into_iter()
            .flatten()
            .filter_map(|entry| process(&entry.ok()?.path().join("status")))
            .collect();
        let mut family = vec![self.driver.id()];
        let mut process_index = 0;
        while let Some(parent) = family.get(process_index).copied() {
            family.extend(processes.iter().filter(|process| process.1 == parent).map(|process| process.0));
            process_index += 1;
        }
        processes.into_iter().filter(|process| family.contains(&process.0)).collect()
    }

    /// Log of the page since the last call.
    ///
    /// # Errors
    /// Where the browser reports one.
    pub fn log(&self) -> Result<Vec<String>> {
        let entries = self.post("se/log", &json!({"type": "browser"}))?;
        let lines = entries.as_array().into_iter().flatten();
        Ok(lines.map(|entry| entry["message"].as_str().unwrap_or_default().to_owned()).collect())
    }

    fn devtools(&self, command: &str, parameters: Value) -> Result<Value> {
        self.post("goog/cdp/execute", &json!({"cmd": command, "params": parameters}))
    }

    fn post(&self, command: &str, body: &Value) -> Result<Value> {
        self.send("POST", &format!("{}/{command}", self.session), body)
    }

    fn send(&self, method: &str, path: &str, body: &Value) -> Result<Value> {
        let body = body.to_string();
        let mut stream =
            TcpStream::connect(("127.0.0.1", self.port)).context("the driver does not answer")?;
        write!(
            stream,
            "{method} {path} HTTP/1.1\r\nHost: 127.0.0.1:{}\r\nContent-Type: application/json\r\nContent-Length: {}\r\nConnection: close\r\n\r\n{body}",
            self.port,
            body.len()
        )?;
        let mut answer = BufReader::new(stream);
        let mut length = 0;
        loop {
            let mut line = String::new();
            answer.read_line(&mut line)?;
            if line.trim().is_empty() {
                break;
            }
            if let Some((name, value)) = line.split_once(':')
                && name.eq_ignore_ascii_case("content-length")
            {
                length = value.trim().parse()?;
            }
        }
        let mut content = vec![0; length];
        answer.read_exact(&mut content)?;
        let answer: Value = serde_json::from_slice(&content)?;
        match answer["value"]["error"].as_str() {
            Some(error) => {
                Err(anyhow!("{path}: {error}: {}", answer["value"]["message"].as_str().unwrap_or_default()))
            }
            None => Ok(answer["value"].clone()),
        }
    }
}

impl Drop for Browser {
    fn drop(&mut self) {
        let _ = self.send("DELETE", &self.session, &json!({}));
        let _ = self.driver.kill();
        let _ = self.driver.wait();
    }
}

/// Processor time of a thread that is a worker of a page, s.
fn worker_s(thread: &Path) -> Option<f64> {
    if !thread_file("comm", thread)?.starts_with(WORKER) {
        return None;
    }
    let on_processor_ns: f64 = thread_file("schedstat", thread)?.split_whitespace().next()?.parse().ok()?;
    Some(1e-9 * on_processor_ns)
}

fn thread_file(name: &str, thread: &Path) -> Option<String> {
    std::fs::read_to_string(thread.join(name)).ok()
}

/// Number, parent's number and resident bytes of a process, from its status as Linux states it.
fn process(status: &Path) -> Option<(u32, u32, u64)> {
    let text = std::fs::read_to_string(status).ok()?;
    Some((number("Pid:", &text)?, number("PPid:", &text)?, 1024 * field("VmRSS:", &text)?))
}

fn number(name: &str, text: &str) -> Option<u32> {
    field(name, text).and_then(|value| u32::try_from(value).ok())
}

fn field(name: &str, text: &str) -> Option<u64> {
    let line = text.lines().find_map(|line| line.strip_prefix(name))?;
    line.split_whitespace().next()?.parse::<u64>().ok()
}

/// Bytes of base 64.
fn decoded(text: &str) -> Option<Vec<u8>> {
    let mut bytes = Vec::with_capacity(text.len() / 4 * 3);
    let (mut word, mut bits) = (0u32, 0);
    for letter in text.bytes().take_while(|letter| *letter != b'=') {
        let value = match letter {
            b'A'..=b'Z' => letter - b'A',
            b'a'..=b'z' => letter - b'a' + 26,
            b'0'..=b'9' => letter - b'0' + 52,
            b'+' => 62,
            b'/' => 63,
            _ => return None,
        };
        word = (word << 6) | u32::from(value);
        bits += 6;
        if bits >= 8 {
            bits -= 8;
            bytes.push((word >> bits) as u8);
        }
    }
    Some(bytes)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn base64_is_decoded() {
        assert_eq!(decoded("Zm9vYmE="), Some(b"fooba".to_vec()));
        assert_eq!(decoded("Zm9v!"), None);
    }
}
