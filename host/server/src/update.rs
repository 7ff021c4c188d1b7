//! Updates of the device for a page, about twenty times a second.

use device::monitor::State;
use device::monitor::report::Report;
use serde::Serialize;
use std::time::Duration;

/// Time between two updates.
pub const UPDATE_INTERVAL: Duration = Duration::from_millis(50);
/// Who has control, as one page is concerned.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum ControlHolder {
    /// Nobody.
    None,
    /// This page.
    This,
    /// Another page.
    Other,
}

/// A program that was started from a page.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct RunningProgram {
    /// Its name.
    pub name: String,
    /// Number of its steps on the device.
    pub steps: usize,
}

/// One update, schema `guide.live/2`.
#[derive(Debug, Serialize)]
pub struct Update {
    pub(crate) schema: &'static str,
    /// Its number, which the page's heartbeat names.
    pub(crate) update: u64,
    pub(crate) control: ControlHolder,
    /// Last action of supervision.
    pub(crate) notice: Option<String>,
    /// Outcome of the last command.
    pub(crate) outcome: Option<Outcome>,
    pub(crate) program: Option<RunningProgram>,
    /// Programs that can be run.
    pub(crate) programs: Vec<String>,
    pub(crate) heartbeat_limit_s: f64,
    /// The device, as `guide monitor --json` has it.
    pub(crate) device: Report,
}

#[derive(Debug, Serialize)]
pub(crate) struct Outcome {
    text: String,
    good: bool,
}

impl Outcome {
    pub(crate) fn of(state: &State) -> Option<Self> {
        state.outcome().map(|outcome| Self { text: outcome.text.clone(), good: outcome.good })
    }
}
