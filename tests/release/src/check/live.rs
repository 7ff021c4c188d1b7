//! Programs that run until they are ended: the page in the browser, and the live view of a device behind a
//! TCP address.

use crate::Checks;
use crate::program::Program;
use anyhow::{Context, Result, ensure};
use fake_device::{FakeDevice, Script};
use protocol::Request;
use serde_json::Value;
use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpStream;
use std::process::{Child, Stdio};
use std::thread;
use std::time::{Duration, Instant};

/// When a program counts as hung.
const HANGS: Duration = Duration::from_secs(60);

/// Runs all of it.
///
/// # Errors
/// None of its own; what the program does wrong is counted.
pub fn check(checks: &mut Checks, program: &Program) -> Result<()> {
    let system = program.system();
    checks.report(&format!("guide web serves the page and the sessions ({system})"), web(program));
    checks
        .report(&format!("guide status and guide monitor of a device over tcp ({system})"), monitor(program));
    checks.report(&format!("Ctrl-C ends guide web in an orderly way ({system})"), interrupt(program));
    Ok(())
}

/// `guide web` on the folder, and its address.
fn serving(program: &Program, duration_s: &str) -> Result<(Child, String)> {
    let mut command = program.command(&["web", ".", "--json", "--duration-s", duration_s]);
    let mut child =
        command.stdout(Stdio::piped()).stderr(Stdio::inherit()).spawn().context("cannot run guide web")?;
    let mut line = String::new();
    BufReader::new(child.stdout.take().context("no output")?).read_line(&mut line)?;
    let stated: Value = serde_json::from_str(&line).with_context(|| format!("guide web --json: `{line}`"))?;
    let address = stated["address"].as_str().context("guide web states no address")?.to_owned();
    Ok((child, address))
}

fn web(program: &Program) -> Result<()> {
    let (mut child, address) = serving(program, "600")?;
    let outcome = (|| {
        let page = get(&address, "")?;
        ensure!(
            page.contains("<!doctype html>") && page.len() > 1_000_000,
            "the page has {} bytes",
            page.len()
        );
        let listed = get(&address, "sessions")?;
        let body = listed.split_once("\r\n\r\n").context("no head")?.1;
        let listed: Value = serde_json::from_str(body).with_context(|| format!("`{body}`"))?;
        let sessions = listed["sessions"].as_array().context("no list")?;
        ensure!(sessions.iter().any(|one| one["path"] == "Linux"), "{listed}");
        let file = get(&address, "file/Linux/session.toml")?;
        ensure!(file.contains("[rig]"), "the session's file: {file}");
        Ok(())
    })();
    let _ = child.kill();
    let _ = child.wait();
    outcome
}

/// Head and body of the answer at an address.
fn get(address: &str, below: &str) -> Result<String> {
    let (host, path) =
        address.strip_prefix("http://").and_then(|rest| rest.split_once('/')).context("no address")?;
    let mut stream = TcpStream::connect(host).with_context(|| format!("{host}: no server"))?;
    stream.set_read_timeout(Some(HANGS))?;
    write!(stream, "GET /{path}{below} HTTP/1.1\r\nHost: {host}\r\n\r\n")?;
    let mut answer = Vec::new();
    stream.read_to_end(&mut answer)?;
    let answer = String::from_utf8_lossy(&answer).into_owned();
    ensure!(answer.starts_with("HTTP/1.1 200"), "{below}: {}", answer.lines().next().unwrap_or_default());
    Ok(answer)
}

fn monitor(program: &Program) -> Result<()> {
    let device = FakeDevice::start_at("127.0.0.1:0", Script::default());
    let status: Value =
        serde_json::from_str(&program.call(&["status", "--port", &device.port, "--json"])?)?;
    ensure!(status["schema"].as_str().is_some_and(|schema| schema.starts_with("guide.status/")), "{status}");
    let lines = program.call(&["monitor", "--port", &device.port, "--json", "--duration-s", "3"])?;
    let last = lines.lines().last().context("guide monitor has printed nothing")?;
    let last: Value = serde_json::from_str(last).with_context(|| format!("`{last}`"))?;
    ensure!(last["state"] == "idle", "{last}");
    let executed = device.executed();
    ensure!(executed.contains(&Request::Stream { enable: true }), "{executed:?}");
    let nobody = device.port.clone();
    drop(device);
    let message = program.failure(&["status", "--port", &nobody])?;
    ensure!(message.contains("no server can be reached"), "{message}");
    Ok(())
}

fn interrupt(program: &Program) -> Result<()> {
    let (mut child, _) = serving(program, "600")?;
    let sent = std::process::Command::new("kill").args(["-INT", &child.id().to_string()]).status();
    ensure!(sent.is_ok_and(|status| status.success()), "cannot send the interrupt");
    let began = Instant::now();
    while began.elapsed() < HANGS {
        if let Some(status) = child.try_wait()? {
            ensure!(status.success(), "{status}");
            return Ok(());
        }
        thread::sleep(Duration::from_millis(20));
    }
    let _ = child.kill();
    anyhow::bail!("it goes on")
}
