//! Errors as exceptions of the module `needle_guide._errors`.

use device::link::LinkError;
use device::link::program::ProgramError;
use host::cli::{CallError, FailedAt, Kind};
use pyo3::prelude::*;

/// A failed command.
pub fn raise(py: Python<'_>, error: &CallError) -> PyErr {
    let class = match error.kind {
        Kind::Usage => "UsageError",
        Kind::File => "FileError",
        Kind::Device => "DeviceError",
        Kind::Analysis => "AnalysisError",
    };
    new(py, class, &error.message, &error.place, &error.called.document)
}

/// A value that is out of range.
pub fn usage(py: Python<'_>, message: &str) -> PyErr {
    new(py, "UsageError", message, &FailedAt::default(), "")
}

/// A failure of the data or of a model.
pub fn analysis(py: Python<'_>, message: &str) -> PyErr {
    new(py, "AnalysisError", message, &FailedAt::default(), "")
}

/// A failed operation on the device.
pub fn device(py: Python<'_>, error: &anyhow::Error) -> PyErr {
    let is_link = error.chain().any(|cause| cause.is::<LinkError>());
    let is_program = error.chain().any(|cause| cause.is::<ProgramError>());
    let class = match (is_link, is_program) {
        (true, _) => "DeviceError",
        (false, true) => "FileError",
        (false, false) => "UsageError",
    };
    new(py, class, &format!("{error:#}"), &FailedAt::default(), "")
}

/// The device is closed, or used by another thread.
pub fn unavailable(py: Python<'_>, message: &str) -> PyErr {
    new(py, "DeviceError", message, &FailedAt::default(), "")
}

/// A fault of this program.
pub fn internal(py: Python<'_>, message: &str) -> PyErr {
    new(py, "InternalError", message, &FailedAt::default(), "")
}

fn new(py: Python<'_>, class: &str, message: &str, place: &FailedAt, document: &str) -> PyErr {
    let constructed = py.import("needle_guide._errors").and_then(|module| {
        let FailedAt { path, line, column, field } = place;
        module.getattr(class)?.call1((message, path.as_deref(), *line, *column, field.as_deref(), document))
    });
    match constructed {
        Ok(exception) => PyErr::from_value(exception),
        Err(error) => error,
    }
}
