//! The result of a bring-up, for people, for the lab notebook and for programs.

use super::{Finding, Step};
use serde::Serialize;
use std::fmt;

/// Report of a bring-up.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Report {
    /// `guide.bringup/1`.
    pub schema: &'static str,
    /// Date and time in UTC, RFC 3339.
    pub date: String,
    /// The device.
    pub device: Device,
    /// Whether every step that ran passed, and none was blocked.
    pub passed: bool,
    /// The step during which it ended early.
    pub interrupted_in: Option<&'static str>,
    /// The steps, in order.
    pub steps: Vec<StepReport>,
}

/// The device that was tried.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize)]
pub struct Device {
    /// Board.
    pub board: String,
    /// Version of the firmware.
    pub firmware: String,
    /// Commit that it was built from.
    pub commit: String,
    /// Id of the calibration.
    pub calibration: String,
    /// Its checksum, hexadecimal.
    pub calibration_crc: String,
}

/// One step.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct StepReport {
    /// Its name.
    pub step: &'static str,
    /// Result of the step.
    pub result: StepResult,
    /// Reason for which it did not run.
    pub because: Option<String>,
    /// Measured values.
    pub measured: Vec<Measure>,
    /// Faults that were found.
    pub findings: Vec<Finding>,
}

/// Result of a step.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum StepResult {
    /// The step has no finding.
    Passed,
    /// The step found a fault.
    Failed,
    /// It did not run: a step that it depends on failed.
    Blocked,
    /// The operator skipped it.
    Skipped,
}

/// A measured value.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Measure {
    /// Name of the quantity, with its unit at the end.
    pub name: String,
    /// The value.
    pub value: f64,
}

impl Measure {
    pub(super) fn new(name: impl Into<String>, value: f64) -> Self {
        // Digits beyond these are noise, in documents that people read.
        Self { name: name.into(), value: (value * 1e5).round() / 1e5 }
    }
}

impl StepReport {
    pub(super) fn new(step: Step) -> Self {
        let (measured, findings) = (Vec::new(), Vec::new());
        Self { step: step.name(), result: StepResult::Passed, because: None, measured, findings }
    }

    pub(super) fn without(step: Step, result: StepResult, because: String) -> Self {
        Self { result, because: Some(because), ..Self::new(step) }
    }

    pub(super) fn measure(&mut self, name: impl Into<String>, value: f64) {
        self.measured.push(Measure::new(name, value));
    }

    pub(super) fn find(&mut self, finding: Finding) {
        self.findings.push(finding);
        self.result = StepResult::Failed;
    }

    /// Something that keeps other steps from running was found, or it did not run itself for such a reason.
    pub(super) fn blocks(&self) -> bool {
        self.result == StepResult::Blocked || self.findings.iter().any(Finding::blocks)
    }
}

impl Report {
    /// All faults.
    pub fn findings(&self) -> impl Iterator<Item = &Finding> {
        self.steps.iter().flat_map(|step| &step.findings)
    }
}

impl fmt::Display for Report {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Device { board, firmware, commit, calibration, calibration_crc } = &self.device;
        writeln!(
            f,
            "device     {board}, firmware {firmware} ({commit}), calibration {calibration} ({calibration_crc})"
        )?;
        for step in &self.steps {
            let result = match step.result {
                StepResult::Passed => "passed",
                StepResult::Failed => "FAILED",
                StepResult::Blocked => "blocked",
                StepResult::Skipped => "skipped",
            };
            write!(f, "{:15} {result}", step.step)?;
            match &step.because {
                Some(because) => writeln!(f, ": {because}")?,
                None => writeln!(f)?,
            }
            for finding in &step.findings {
                let axis = finding.axis.map_or(String::new(), |axis| format!(" ({axis})"));
                writeln!(f, "  {}{axis}: {}", finding.id, finding.what)?;
                writeln!(f, "    measured  {}", finding.measured)?;
                writeln!(f, "    remedy    {}", finding.remedy)?;
                if !finding.or_else.is_empty() {
                    writeln!(f, "    or        {}", finding.or_else.join(", "))?;
                }
            }
        }
        let ran = self
            .steps
            .iter()
            .filter(|step| !matches!(step.result, StepResult::Blocked | StepResult::Skipped));
        let count = self.findings().count();
        let verdict = if count > 0 {
            format!("{count} finding{}; correct it and repeat", if count == 1 { "" } else { "s" })
        } else {
            format!("{} of {} steps ran, nothing found", ran.count(), self.steps.len())
        };
        writeln!(f, "result     {verdict}")
    }
}
