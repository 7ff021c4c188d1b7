//! The page as `guide web` serves it.

use crate::driver::Browser;
use anyhow::{Context, Result, ensure};
use serde_json::{Value, json};
use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::{Child, Command, Stdio};

/// The running program, which ends with this.
pub struct Serving(Child);

impl Serving {
    /// Starts `guide web` with this page on a folder, with further options; also the address that it prints.
    ///
    /// # Errors
    /// Where it does not start.
    pub fn start(page: &Path, folder: &Path, options: &[&str]) -> Result<(Self, String)> {
        let program = std::env::var_os("NEEDLE_GUIDE_PROGRAM")
            .context("NEEDLE_GUIDE_PROGRAM: expected the program guide")?;
        let mut command = Command::new(program);
        command.args(["web", "--json", "--page"]).arg(page).args(options).arg(folder);
        let mut serving = Self(command.stdin(Stdio::null()).stdout(Stdio::piped()).spawn()?);
        let mut line = String::new();
        BufReader::new(serving.0.stdout.take().context("no output")?).read_line(&mut line)?;
        let report: Value = serde_json::from_str(&line)?;
        let address = report["address"].as_str().context("no address")?.to_owned();
        Ok((serving, address))
    }
}

impl Drop for Serving {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// The sessions below the folder are listed and opened, an address opens one again, and nothing but the server can be reached.
///
/// # Errors
/// What is otherwise.
pub fn check(browser: &Browser, page: &Path, folder: &Path) -> Result<String> {
    let (_serving, address) = Serving::start(page, folder, &[])?;
    browser.open(&address)?;
    browser.until("document.querySelector('#served button')")?;
    ensure!(
        browser.run("return document.querySelector('#stop').hidden;", json!([]))? == json!(true),
        "without a device there is nothing to stop"
    );
    browser.press("#served button", "\u{e007}")?;
    let opened = "document.getElementById('session-name').textContent.includes('example') && document.querySelectorAll('#main .plot').length > 3";
    browser.until(opened)?;
    let again = browser.run("return location.href;", json!([]))?;
    browser.open(again.as_str().context("no address")?)?;
    browser.until(opened)?;
    let elsewhere = browser.wait_for("await fetch('http://127.0.0.1:1/');", json!([]));
    ensure!(elsewhere.is_err(), "another server could be reached");
    let log = browser.log()?;
    let blocked = log.iter().any(|line| line.contains("Content Security Policy"));
    ensure!(blocked, "the request was not blocked by the policy: {log:?}");
    Ok("listed, opened, opened again by its address; another server is blocked".to_owned())
}
