//! The Python module `needle_guide._core`: commands of `guide` as functions, the forward model over arrays, and a connected device.
//!
//! The module that users import is written in Python (`python/needle_guide`) on these few functions. Every result is
//! the JSON document that the command prints (`host::cli::call`), so that Python and command line cannot differ. Long
//! work runs in a thread of its own while the calling thread waits for it and for signals (`work`). The manual's page
//! on Python has the examples.
#![forbid(unsafe_code)]
#![deny(missing_docs)]
#![cfg(feature = "extension")]

mod discrepancy;
mod failure;
mod forward;
mod link;
mod threads;
mod work;

use failure::raise;
use host::cli::{Called, call as call_command, exit_code, readable as read_session};
use pyo3::prelude::*;
use std::ffi::OsString;
use std::path::PathBuf;
use work::{Message, computed};

/// Functions behind the module `needle_guide`.
#[pymodule]
mod _core {
    #[pymodule_export]
    const PARAMETERS: [&str; 9] = super::forward::PARAMETERS;
    #[pymodule_export]
    use super::discrepancy::{DiscrepancyTerms, discrepancy};
    #[pymodule_export]
    use super::forward::forward;
    #[pymodule_export]
    use super::link::Link;
    #[pymodule_export]
    use super::{call, program, readable, summarize};
}

/// Document, remarks and figures of a command.
type Result3 = (String, Vec<String>, Vec<(String, String)>);

/// Runs a command of `guide` and returns its JSON document, its remarks and its figures.
#[pyfunction]
fn call(py: Python<'_>, arguments: Vec<OsString>, on_step: Option<Py<PyAny>>) -> PyResult<Result3> {
    let called = computed(
        py,
        move |messages, interrupted| {
            call_command(arguments, move |step| {
                // The only way out of a computation that is under way: it holds nothing but memory.
                if interrupted.is_set() {
                    std::panic::resume_unwind(Box::new(work::Interrupted));
                }
                messages.send(Message::Step(step.to_owned()));
            })
        },
        |message| match (message, &on_step) {
            (Message::Step(step), Some(on_step)) => on_step.call1(py, (step,)).map(drop),
            _ => Ok(()),
        },
    )?;
    let Called { document, notes, figures } = called.map_err(|error| raise(py, &error))?;
    Ok((document, notes, figures))
}

/// Reads a session and drops it: an exception with the place where it cannot be read.
#[pyfunction]
fn readable(py: Python<'_>, folder: PathBuf) -> PyResult<()> {
    let read = computed(py, move |_, _| read_session(&folder), |_| Ok(()))?;
    read.map_err(|error| raise(py, &error))
}

/// The record of a session, `needle.summary/1`, as `guide summarize` writes it.
#[pyfunction]
fn summarize(py: Python<'_>, folder: PathBuf, seed: u64) -> PyResult<String> {
    let summary =
        computed(py, move |_, _| serde_json::to_string(&inference::summarize(&folder, seed)), |_| Ok(()))?;
    summary.map_err(|error| failure::internal(py, &error.to_string()))
}

/// The program `guide`: runs a command line, whose first argument is the program's name, and returns the exit code.
#[pyfunction]
fn program(py: Python<'_>, arguments: Vec<OsString>) -> u8 {
    py.detach(|| exit_code(arguments))
}
