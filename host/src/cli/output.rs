//! Where a sub-command's words go: results to standard output, remarks to standard error.

use super::colour;
use anyhow::Context;
use formats::files;
use indicatif::{ProgressBar, ProgressStyle};
use serde::Serialize;
use std::fmt::Display;
use std::fs;
use std::io::{self, BufWriter, ErrorKind, Stdout, Write};
use std::path::Path;
use std::time::Duration;

/// Standard output was closed by its reader, as `guide ... | head` does: no reason for a message.
#[derive(Debug, thiserror::Error)]
#[error("standard output is closed")]
pub struct StdoutClosed;

/// The two streams of a sub-command.
pub struct Output {
    json: bool,
    /// Whether standard error is coloured; results never are.
    coloured: bool,
    stdout: BufWriter<Stdout>,
}

impl Output {
    /// Streams of this process; `json` is the user's choice of form, `coloured` whether remarks are.
    pub fn new(json: bool, coloured: bool) -> Self {
        Self { json, coloured, stdout: BufWriter::new(io::stdout()) }
    }

    /// Whether the user wants documents for machines.
    pub fn is_json(&self) -> bool {
        self.json
    }

    /// Prints the result in the form that was requested.
    pub fn result(&mut self, result: &impl Serialize, text: impl Display) -> anyhow::Result<()> {
        let written = if self.json {
            serde_json::to_writer_pretty(&mut self.stdout, result)
                .map_err(io::Error::from)
                .and_then(|()| writeln!(self.stdout))
        } else {
            write!(self.stdout, "{text}")
        };
        written.map_err(closed)
    }

    /// Prints one of many results at once: a line of text, or a document on one line.
    pub fn line(&mut self, result: &impl Serialize, text: impl Display) -> anyhow::Result<()> {
        let written = if self.json {
            serde_json::to_writer(&mut self.stdout, result)
                .map_err(io::Error::from)
                .and_then(|()| writeln!(self.stdout))
        } else {
            write!(self.stdout, "{text}")
        };
        written.and_then(|()| self.stdout.flush()).map_err(closed)
    }

    /// Prints a note beside the result; a closed standard error is ignored.
    pub fn note(&self, text: impl Display) {
        remark(&text.to_string(), self.coloured);
    }

    /// Writes out what is still buffered.
    pub fn finish(&mut self) -> anyhow::Result<()> {
        self.stdout.flush().map_err(closed)
    }
}

/// Writes a figure and reports its path. The name may hold anything; a file name may not.
pub fn figures_file(folder: &Path, name: &str, svg: &str, out: &Output) -> anyhow::Result<()> {
    fs::create_dir_all(folder).with_context(|| format!("{}: cannot create", folder.display()))?;
    let plain = |c: char| c.is_ascii_alphanumeric() || matches!(c, '-' | '_' | '.');
    let name: String = name.chars().map(|c| if plain(c) { c } else { '_' }).collect();
    let path = folder.join(format!("{name}.svg"));
    out.note(format_args!("drawing {}", path.display()));
    write_file(&path, svg)
}

/// Writes a whole file, in place of one that is there: after a failure the old one is.
pub fn write_file(path: &Path, content: &str) -> anyhow::Result<()> {
    files::replace(path, content.as_bytes()).with_context(|| format!("{}: cannot write", path.display()))
}

/// A line on standard error that reports progress, on terminals only.
pub fn spinner() -> ProgressBar {
    let bar = ProgressBar::new_spinner();
    if let Ok(style) = ProgressStyle::with_template("{spinner} {msg}") {
        bar.set_style(style);
    }
    bar.enable_steady_tick(Duration::from_millis(100));
    bar
}

/// Prints an error and its causes as one line on standard error.
pub fn report(error: &anyhow::Error, coloured: bool) {
    let line = format!("{error:#}").split_whitespace().collect::<Vec<_>>().join(" ");
    remark(&format!("error: {line}"), coloured);
}

/// A line on standard error; where that is closed, none.
fn remark(line: &str, coloured: bool) {
    let _ = if coloured {
        writeln!(io::stderr(), "{}", colour::label(line))
    } else {
        writeln!(io::stderr(), "{line}")
    };
}

fn closed(error: io::Error) -> anyhow::Error {
    if error.kind() == ErrorKind::BrokenPipe {
        StdoutClosed.into()
    } else {
        anyhow::Error::new(error).context("cannot write to standard output")
    }
}
