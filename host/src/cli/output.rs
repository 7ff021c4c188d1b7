//! Output of a sub-command: results to standard output, remarks to standard error.

use super::call::CallError;
use super::colour;
use crate::foreign::{Form, printable};
use anyhow::{Context, bail};
use formats::files;
use indicatif::{ProgressBar, ProgressStyle};
use serde::Serialize;
use std::cell::RefCell;
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
    /// Whether a result has been printed.
    has_printed: bool,
    sink: Sink,
}

/// Destination of results, remarks and figures.
enum Sink {
    /// To the streams of this process, figures to files.
    Process(BufWriter<Stdout>),
    /// To the caller.
    Memory(Memory),
}

/// Output of a sub-command for its caller.
pub struct Memory {
    pub document: Vec<u8>,
    pub notes: RefCell<Vec<String>>,
    /// Names and SVG texts.
    pub figures: RefCell<Vec<(String, String)>>,
    /// Called with the name of every step of a long computation.
    pub on_step: Box<dyn Fn(&str)>,
}

impl Output {
    /// Streams of this process; `json` is the user's choice of form, `coloured` whether remarks are.
    pub fn new(json: bool, coloured: bool) -> Self {
        Self { json, coloured, has_printed: false, sink: Sink::Process(BufWriter::new(io::stdout())) }
    }

    /// Everything is kept for the caller, the result as JSON.
    pub fn to_memory(on_step: Box<dyn Fn(&str)>) -> Self {
        let memory = Memory { on_step, ..Memory::empty() };
        Self { json: true, coloured: false, has_printed: false, sink: Sink::Memory(memory) }
    }

    /// Output that was kept for the caller.
    pub fn into_memory(self) -> Option<Memory> {
        match self.sink {
            Sink::Process(_) => None,
            Sink::Memory(memory) => Some(memory),
        }
    }

    fn stdout(&mut self) -> &mut dyn Write {
        match &mut self.sink {
            Sink::Process(stdout) => stdout,
            Sink::Memory(memory) => &mut memory.document,
        }
    }

    /// Whether figures are drawn: the folder requested for them; for a caller always, without a folder.
    pub fn figures_folder<'a>(&self, requested: Option<&'a Path>) -> Option<&'a Path> {
        match self.sink {
            Sink::Process(_) => requested,
            Sink::Memory(_) => Some(requested.unwrap_or(Path::new(""))),
        }
    }

    /// Reports the steps of a long computation: on a terminal's standard error, or to the caller.
    pub fn progress(&self) -> Progress<'_> {
        match &self.sink {
            Sink::Process(_) => Progress::Bar(spinner()),
            Sink::Memory(memory) => Progress::Call(&*memory.on_step),
        }
    }

    /// Whether the user wants documents for machines.
    pub fn is_json(&self) -> bool {
        self.json
    }

    /// Prints the result in the form that was requested.
    pub fn result(&mut self, result: &impl Serialize, text: impl Display) -> anyhow::Result<()> {
        let document = self.json.then(|| serde_json::to_string_pretty(result));
        self.print(document, text).map_err(closed)
    }

    /// Prints one of many results at once: a line of text, or a document on one line.
    pub fn line(&mut self, result: &impl Serialize, text: impl Display) -> anyhow::Result<()> {
        let document = self.json.then(|| serde_json::to_string(result));
        self.print(document, text).and_then(|()| self.stdout().flush()).map_err(closed)
    }

    /// The document where there is one, else the text; whatever names of others are in them.
    fn print(&mut self, document: Option<serde_json::Result<String>>, text: impl Display) -> io::Result<()> {
        self.has_printed = true;
        match document.transpose()? {
            Some(document) => writeln!(self.stdout(), "{}", printable(&document, Form::Json)),
            None => write!(self.stdout(), "{}", printable(&text.to_string(), Form::Text)),
        }
    }

    /// Prints the document of a failure where the user wants documents and none was printed, so that standard output always has one.
    pub fn failure(&mut self, error: &CallError) -> anyhow::Result<()> {
        if self.json && !self.has_printed {
            self.result(&error.document(), "")?;
        }
        self.finish()
    }

    /// Prints a note beside the result; a closed standard error is ignored.
    pub fn note(&self, text: impl Display) {
        match &self.sink {
            Sink::Process(_) => remark(&text.to_string(), self.coloured),
            Sink::Memory(memory) => memory.notes.borrow_mut().push(text.to_string()),
        }
    }

    /// Writes out what is still buffered.
    pub fn finish(&mut self) -> anyhow::Result<()> {
        self.stdout().flush().map_err(closed)
    }
}

impl Memory {
    /// Memory without output.
    pub fn empty() -> Self {
        Self {
            document: Vec::new(),
            notes: RefCell::default(),
            figures: RefCell::default(),
            on_step: Box::new(|_| {}),
        }
    }
}

/// Steps of a long computation.
pub enum Progress<'a> {
    /// A line on standard error.
    Bar(ProgressBar),
    /// Calls of the caller's function.
    Call(&'a dyn Fn(&str)),
}

impl Progress<'_> {
    /// Reports what is under way now.
    pub fn set_message(&self, step: String) {
        match self {
            Self::Bar(bar) => bar.set_message(printable(&step, Form::Text).into_owned()),
            Self::Call(call) => call(&step),
        }
    }

    /// Removes the line.
    pub fn finish_and_clear(&self) {
        if let Self::Bar(bar) = self {
            bar.finish_and_clear();
        }
    }
}

/// Writes a figure and reports its path, or keeps it for the caller. The name may hold anything; a file name may not.
pub fn figures_file(folder: &Path, name: &str, svg: &str, out: &Output) -> anyhow::Result<()> {
    if let Sink::Memory(memory) = &out.sink {
        memory.figures.borrow_mut().push((name.to_owned(), svg.to_owned()));
        return Ok(());
    }
    fs::create_dir_all(folder).with_context(|| format!("{}: cannot create", folder.display()))?;
    let name: String = name.chars().map(|c| if is_plain(c) { c } else { '_' }).collect();
    let path = folder.join(format!("{name}.svg"));
    out.note(format_args!("drawing {}", path.display()));
    write_file(&path, svg)
}

fn is_plain(c: char) -> bool {
    c.is_ascii_alphanumeric() || matches!(c, '-' | '_' | '.')
}

/// Writes a whole file, in place of one that is there: after a failure the old one is. A link to a file is neither followed nor replaced:
/// another program may have put it there, and what it leads to was not named.
pub fn write_file(path: &Path, content: &str) -> anyhow::Result<()> {
    write_bytes(path, content.as_bytes())
}

/// The same of bytes.
pub fn write_bytes(path: &Path, content: &[u8]) -> anyhow::Result<()> {
    let is_link = path.symlink_metadata().is_ok_and(|named| named.is_symlink());
    // `/dev/stdout` is a link too, to what the caller's shell has opened.
    if is_link && !path.starts_with("/dev") && fs::metadata(path).map_or(true, |target| target.is_file()) {
        bail!("{}: cannot write: it is a link; name the file that it leads to", path.display());
    }
    files::replace(path, content).with_context(|| format!("{}: cannot write", path.display()))
}

/// Writes a result as the document that `--json` prints.
pub fn write_json(path: &Path, result: &impl Serialize) -> anyhow::Result<()> {
    let document =
        serde_json::to_string_pretty(result).with_context(|| format!("{}: cannot write", path.display()))?;
    write_file(path, &format!("{}\n", printable(&document, Form::Json)))
}

/// A line on standard error that reports progress, on terminals only.
fn spinner() -> ProgressBar {
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
    let line = &*printable(line, Form::Text);
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
