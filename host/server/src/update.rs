//! What a page receives of the device, about twenty times a second.

use device::monitor::State;
use device::monitor::report::Report;
use device::monitor::traces::{CHANNELS, Traces};
use serde::Serialize;
use std::time::Duration;

/// Time between two updates.
pub const UPDATE_INTERVAL: Duration = Duration::from_millis(50);
/// What a page that connects receives of the past, seconds, and in how many columns.
const HISTORY_S: f64 = 30.0;
const HISTORY_COLUMNS: usize = 300;

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

/// One update, schema `guide.live/1`.
#[derive(Debug, Serialize)]
pub struct Update {
    pub(crate) schema: &'static str,
    /// Its number, which the page's heartbeat names.
    pub(crate) update: u64,
    pub(crate) control: ControlHolder,
    /// What supervision has done last.
    pub(crate) notice: Option<String>,
    /// Outcome of the last command.
    pub(crate) outcome: Option<Outcome>,
    pub(crate) program: Option<RunningProgram>,
    /// Programs that can be run.
    pub(crate) programs: Vec<String>,
    pub(crate) heartbeat_limit_s: f64,
    /// The device, as `guide monitor --json` has it.
    pub(crate) device: Report,
    /// Extremes since the last update.
    pub(crate) trace: Vec<Column>,
}

#[derive(Debug, Serialize)]
pub(crate) struct Outcome {
    text: String,
    good: bool,
}

/// Extremes over a short time: force x, force y (N), position x, position y (mm).
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(crate) struct Column {
    pub(crate) time_s: f64,
    pub(crate) low: [f64; CHANNELS],
    pub(crate) high: [f64; CHANNELS],
}

impl Outcome {
    pub(crate) fn of(state: &State) -> Option<Self> {
        state.outcome().map(|outcome| Self { text: outcome.text.clone(), good: outcome.good })
    }
}

/// What was measured after `from_s`, and up to when; for a page that has nothing yet the last half minute.
pub(crate) fn trace(traces: &Traces, from_s: Option<f64>) -> (Vec<Column>, Option<f64>) {
    let Some(to_s) = traces.latest_s() else { return (Vec::new(), from_s) };
    match from_s {
        // Nothing new.
        Some(from_s) if from_s >= to_s => (Vec::new(), Some(from_s)),
        Some(from_s) if to_s - from_s < HISTORY_S => (columns(traces, from_s, to_s, 1), Some(to_s)),
        _ => (columns(traces, to_s - HISTORY_S, to_s, HISTORY_COLUMNS), Some(to_s)),
    }
}

fn columns(traces: &Traces, from_s: f64, to_s: f64, count: usize) -> Vec<Column> {
    let width_s = (to_s - from_s) / count as f64;
    let empty = |place: usize| Column {
        time_s: from_s + (place as f64 + 1.0) * width_s,
        low: [f64::NAN; CHANNELS],
        high: [f64::NAN; CHANNELS],
    };
    let mut all: Vec<Column> = (0..count).map(empty).collect();
    // Newtons as they are, metres in millimetres.
    for (channel, scale) in [1.0, 1.0, 1e3, 1e3].into_iter().enumerate() {
        for found in traces.runs(channel, from_s, to_s, count).into_iter().flatten() {
            let Some(column) = all.get_mut(found.place) else { continue };
            if let (Some(low), Some(high)) = (column.low.get_mut(channel), column.high.get_mut(channel)) {
                (*low, *high) = (scale * found.low, scale * found.high);
            }
        }
    }
    all.retain(|column| column.low.iter().all(|low| low.is_finite()));
    all
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn updates_have_every_extreme_and_a_new_page_has_the_past() {
        let mut traces = Traces::default();
        let mut reached = None;
        let mut highest = Vec::new();
        for ms in 0..2_000u32 {
            // A spike of one sample each second.
            let force_n = if ms % 1_000 == 503 { 3.0 } else { 0.1 };
            traces.push(f64::from(ms) * 1e-3, [0.0, force_n, 0.0, 1e-3]);
            if ms % 50 == 49 {
                let (columns, to_s) = trace(&traces, reached);
                reached = to_s;
                highest.extend(columns.iter().map(|column| column.high[1]));
                assert!(columns.iter().all(|column| (column.high[3] - 1.0).abs() < 1e-9), "in millimetres");
            }
        }
        let spikes = highest.iter().filter(|force_n| **force_n > 2.0).count();
        assert!((2..=4).contains(&spikes), "{spikes}: each in one column, or in two that share a bin");
        let (past, _) = trace(&traces, None);
        assert!((15..=25).contains(&past.len()), "{}: two seconds in tenths", past.len());
        assert_eq!(trace(&traces, reached).0, Vec::new());
    }
}
