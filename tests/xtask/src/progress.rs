//! Long programs: their lines as they come, and a sign of life where none has come for a while.

use anyhow::{Context, Result};
use std::io::{BufRead, BufReader, IsTerminal, Read};
use std::process::{Command, ExitStatus, Stdio};
use std::sync::mpsc::{self, RecvTimeoutError};
use std::thread;
use std::time::{Duration, Instant};

/// After so long without a line one states what still runs: half of what a reader of a log waits before it seems to hang.
const QUIET: Duration = Duration::from_secs(15);

/// Output of a program that is read.
#[derive(Clone, Copy, PartialEq, Eq)]
pub enum Output {
    /// Its results.
    Standard,
    /// Its messages, such as cargo's progress. At a terminal cargo draws that itself, and it is left alone.
    Messages,
}

/// Runs a program to its end, shows each line of this output as it comes and hands it to `line`; the other output goes where this
/// program's does.
///
/// # Errors
/// Where the program cannot be started.
pub fn watched(command: &mut Command, output: Output, mut line: impl FnMut(&str)) -> Result<ExitStatus> {
    let name = command.get_program().to_string_lossy().into_owned();
    let cannot = || format!("cannot run {name}");
    command.stdin(Stdio::null());
    let draws_progress = output == Output::Messages && std::io::stderr().is_terminal();
    if draws_progress {
        return command.status().with_context(cannot);
    }
    match output {
        Output::Standard => command.stdout(Stdio::piped()),
        Output::Messages => command.stderr(Stdio::piped()),
    };
    let mut child = command.spawn().with_context(cannot)?;
    let source: Box<dyn Read + Send> = match (output, child.stdout.take(), child.stderr.take()) {
        (Output::Standard, Some(source), _) => Box::new(source),
        (Output::Messages, _, Some(source)) => Box::new(source),
        _ => Box::new(std::io::empty()),
    };
    let (sender, lines) = mpsc::channel();
    let reader = thread::spawn(move || {
        // A line that is no text is shown as far as it is.
        let mut source = BufReader::new(source);
        let mut bytes = Vec::new();
        while source.read_until(b'\n', &mut bytes).is_ok_and(|length| length > 0) {
            let text = String::from_utf8_lossy(&bytes).trim_end().to_owned();
            bytes.clear();
            if sender.send(text).is_err() {
                return;
            }
        }
    });
    let mut last = (Instant::now(), String::new());
    loop {
        match lines.recv_timeout(QUIET) {
            Ok(text) => {
                match output {
                    Output::Standard => println!("{text}"),
                    Output::Messages => eprintln!("{text}"),
                }
                line(&text);
                last = (Instant::now(), text);
            }
            Err(RecvTimeoutError::Timeout) => {
                eprintln!("xtask: still at work, {} s after `{}`", last.0.elapsed().as_secs(), last.1.trim());
            }
            Err(RecvTimeoutError::Disconnected) => break,
        }
    }
    drop(reader.join());
    child.wait().with_context(cannot)
}
