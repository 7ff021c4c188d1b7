//! `bringup.toml`: what each step found last. It is written before each step, so that one that ends early is named when the next begins.

use anyhow::Context;
use device::bringup::{Report, Step};
use formats::files;
use std::fs;
use std::io::{self, ErrorKind};
use std::path::{Path, PathBuf};
use toml::{Table, Value};

/// Result of a step that has not ended.
const INTERRUPTED: &str = "interrupted";

/// The file, and what it held.
pub struct Record {
    path: PathBuf,
    earlier: Table,
}

impl Record {
    /// Reads what an earlier bring-up has left; nothing where there is none.
    ///
    /// # Errors
    /// Where the file cannot be read, or is not of a bring-up: it is not overwritten then.
    pub fn read(path: &Path) -> anyhow::Result<Self> {
        let earlier = match fs::read_to_string(path) {
            Ok(text) => text
                .parse::<Table>()
                .ok()
                .filter(|table| table.get("schema").and_then(Value::as_str) == Some("guide.bringup/1"))
                .with_context(|| {
                    format!(
                        "{}: not a result of `guide bringup`; expected schema = \"guide.bringup/1\"",
                        path.display()
                    )
                })?,
            Err(error) if error.kind() == ErrorKind::NotFound => Table::new(),
            Err(error) => return Err(error).with_context(|| format!("{}: cannot read", path.display())),
        };
        Ok(Self { path: path.to_owned(), earlier })
    }

    /// The step in which it ended early, and the date.
    pub fn interrupted(&self) -> Option<(&str, &str)> {
        let step = self.earlier.get("interrupted_in")?.as_str()?;
        Some((step, self.earlier.get("date").and_then(Value::as_str).unwrap_or("unknown date")))
    }

    /// Steps that found something, were kept from running by one that did, or ended early.
    pub fn failed(&self) -> Vec<Step> {
        Step::ALL
            .into_iter()
            .filter(|step| {
                let result = self.steps().find(|kept| name_of(kept) == Some(step.name()));
                let result = result.and_then(|kept| kept.get("result")?.as_str());
                matches!(result, Some("failed" | "blocked" | INTERRUPTED))
            })
            .collect()
    }

    fn steps(&self) -> impl Iterator<Item = &Value> {
        self.earlier.get("steps").and_then(Value::as_array).into_iter().flatten()
    }

    /// Writes the steps of this bring-up so far, and of the earlier ones those that it has not repeated.
    ///
    /// # Errors
    /// Where the file cannot be written; the one before is left then.
    pub fn keep(&mut self, report: &Report) -> io::Result<()> {
        let mut table = Table::try_from(report).map_err(io::Error::other)?;
        let earlier_steps = table.get("steps").and_then(Value::as_array).cloned().unwrap_or_default();
        let earlier: Vec<Value> = self.steps().cloned().collect();
        // It counts as interrupted until its own result takes its place.
        let under_way = report.interrupted_in.map(|name| {
            let fields = [("step".to_owned(), name.into()), ("result".to_owned(), INTERRUPTED.into())];
            Value::from(Table::from_iter(fields))
        });
        let under_way: Vec<Value> = under_way.into_iter().collect();
        let names = Step::ALL.into_iter().map(Step::name);
        let steps: Vec<Value> = names
            .filter_map(|name| {
                [&earlier_steps, &under_way, &earlier].into_iter().find_map(|steps| find(steps, name))
            })
            .collect();
        let passed = steps
            .iter()
            .all(|kept| matches!(kept.get("result").and_then(Value::as_str), Some("passed" | "skipped")));
        table.insert("passed".to_owned(), passed.into());
        table.insert("steps".to_owned(), steps.into());
        let text = toml::to_string_pretty(&table).map_err(io::Error::other)?;
        files::replace(&self.path, text.as_bytes())?;
        self.earlier = table;
        Ok(())
    }
}

fn find(steps: &[Value], name: &str) -> Option<Value> {
    steps.iter().find(|kept| name_of(kept) == Some(name)).cloned()
}

fn name_of(step: &Value) -> Option<&str> {
    step.get("step")?.as_str()
}

#[cfg(test)]
mod tests {
    use super::*;
    use device::bringup::{Device, StepReport, StepResult};

    fn step(step: &'static str, result: StepResult) -> StepReport {
        StepReport { step, result, because: None, measured: Vec::new(), findings: Vec::new() }
    }

    fn report(interrupted_in: Option<&'static str>, steps: Vec<StepReport>) -> Report {
        let date = "2026-11-23T20:00:00Z".to_owned();
        let device = Device::default();
        Report { schema: "guide.bringup/1", date, device, passed: false, interrupted_in, steps }
    }

    #[test]
    fn a_step_that_ended_early_is_named_and_keeps_others_from_running_until_it_is_repeated() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("bringup.toml");
        let mut record = Record::read(&path).unwrap();
        assert_eq!((record.interrupted(), record.failed()), (None, Vec::new()));
        record.keep(&report(Some("motors"), vec![step("link", StepResult::Passed)])).unwrap();
        let mut record = Record::read(&path).unwrap();
        assert_eq!(record.interrupted(), Some(("motors", "2026-11-23T20:00:00Z")));
        assert_eq!(record.failed(), [Step::Motors]);
        // Another step does not make that one good.
        record.keep(&report(None, vec![step("supply", StepResult::Passed)])).unwrap();
        let mut record = Record::read(&path).unwrap();
        assert_eq!((record.interrupted(), record.failed()), (None, vec![Step::Motors]));
        record.keep(&report(None, vec![step("motors", StepResult::Passed)])).unwrap();
        let record = Record::read(&path).unwrap();
        assert_eq!((record.interrupted(), record.failed()), (None, Vec::new()));
        let names: Vec<_> = record.steps().filter_map(name_of).collect();
        assert_eq!(names, ["link", "supply", "motors"]);
        assert_eq!(record.earlier["passed"].as_bool(), Some(true));
    }

    #[test]
    fn what_a_step_found_is_kept_until_it_is_repeated_and_another_file_is_not_overwritten() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("bringup.toml");
        let mut record = Record::read(&path).unwrap();
        record
            .keep(&report(
                None,
                vec![step("converter", StepResult::Failed), step("motors", StepResult::Blocked)],
            ))
            .unwrap();
        record.keep(&report(None, vec![step("link", StepResult::Passed)])).unwrap();
        let record = Record::read(&path).unwrap();
        assert_eq!(record.failed(), [Step::Converter, Step::Motors]);
        assert_eq!(record.earlier["passed"].as_bool(), Some(false));
        fs::write(&path, "title = \"mine\"\n").unwrap();
        assert!(Record::read(&path).is_err());
    }
}
