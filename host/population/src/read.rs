//! Records of sessions from files of lines.

use crate::error::PopulationError;
use crate::records::Records;
use crate::summary::{SUMMARY_SCHEMA, Summary};
use rayon::prelude::*;
use std::collections::HashSet;
use std::fs::File;
use std::io::{BufRead, BufReader};
use std::path::Path;

/// Lines that are parsed at once, on all cores.
const AT_ONCE: usize = 512;
/// Bytes that are read at once.
const READ_BYTES: usize = 1 << 20;

/// Passes the records of files on, in order, a few at a time, so that not all of them are in memory: some are parsed while those before them
/// are passed on and those after them are read.
///
/// # Errors
/// [`PopulationError`] for the first line that is no record, or is of a session that was there already.
pub fn read_lines(
    paths: &[impl AsRef<Path> + Sync],
    mut pass: impl FnMut(Summary) + Send,
) -> Result<(), PopulationError> {
    let mut known: HashSet<String> = HashSet::new();
    for path in paths {
        let path = path.as_ref();
        let failed = |cause| PopulationError::Io { path: path.to_owned(), cause };
        let file = BufReader::with_capacity(READ_BYTES, File::open(path).map_err(failed)?);
        let mut lines = file.lines().enumerate();
        let mut next = || -> Result<Vec<(usize, String)>, PopulationError> {
            let some = lines.by_ref().take(AT_ONCE);
            some.map(|(number, line)| line.map(|line| (number + 1, line)).map_err(failed)).collect()
        };
        let mut pass_on = |records: Vec<(usize, Summary)>| {
            for (line, summary) in records {
                if !known.insert(summary.session.clone()) {
                    return Err(PopulationError::Twice { path: path.to_owned(), line, id: summary.session });
                }
                pass(summary);
            }
            Ok(())
        };
        let mut part = next()?;
        let mut parsed = Vec::new();
        while !part.is_empty() {
            let before = parsed;
            let (now, after) = rayon::join(
                || parse_all(path, part),
                || {
                    pass_on(before)?;
                    next()
                },
            );
            // Of two errors the one of the line that comes first.
            match (now, after) {
                (Ok(now), Ok(after)) => (parsed, part) = (now, after),
                (_, Err(error @ PopulationError::Twice { .. })) | (Err(error), _) | (_, Err(error)) => {
                    return Err(error);
                }
            }
        }
        pass_on(parsed)?;
    }
    Ok(())
}

/// Parses numbered lines, without those that are empty.
fn parse_all(path: &Path, lines: Vec<(usize, String)>) -> Result<Vec<(usize, Summary)>, PopulationError> {
    let filled = lines.into_par_iter().filter(|(_, text)| !text.trim().is_empty());
    filled.map(|(line, text)| parse(path, line, &text).map(|summary| (line, summary))).collect()
}

/// All records of files.
///
/// # Errors
/// As [`read_lines`].
pub fn read_summaries(paths: &[impl AsRef<Path> + Sync]) -> Result<Records, PopulationError> {
    let mut all = Records::default();
    read_lines(paths, |summary| all.push(summary))?;
    Ok(all)
}

fn parse(path: &Path, line: usize, text: &str) -> Result<Summary, PopulationError> {
    let wrong =
        |column: usize, what: String| PopulationError::Line { path: path.to_owned(), line, column, what };
    let summary: Summary = serde_json::from_str(text).map_err(|error| {
        let what = error.to_string();
        // The place is stated beside it.
        let what = what.rsplit_once(" at line").map_or(what.as_str(), |(what, _)| what);
        wrong(error.column(), what.to_owned())
    })?;
    if summary.schema != SUMMARY_SCHEMA {
        return Err(wrong(1, format!("schema is \"{}\"", summary.schema)));
    }
    let numbers = summary.result.iter().flat_map(|result| [result.ln_k_kpa, result.ln_k_sd]);
    if numbers.clone().any(|number| !number.is_finite())
        || summary.result.iter().any(|result| result.ln_k_sd <= 0.0)
    {
        return Err(wrong(1, "ln_k_sd is not a positive number".to_owned()));
    }
    Ok(summary)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::summary::Value;
    use std::path::PathBuf;

    /// More than are parsed at once, with empty lines between them.
    #[test]
    fn records_are_passed_on_in_their_order_and_the_first_fault_is_named() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("all.jsonl");
        let written = |ids: &[String]| {
            let record = |id: &String| match id.as_str() {
                "wrong" => "{".to_owned(),
                _ => serde_json::to_string(&Summary::empty(id.clone())).expect("written"),
            };
            let lines = ids.iter().map(|id| record(id) + "\n\n");
            std::fs::write(&path, lines.collect::<String>()).expect("a file");
            let mut found = Vec::new();
            let outcome = read_lines(&[&path], |summary| found.push(summary.session));
            (found, outcome)
        };
        let mut ids: Vec<String> = (0..1500).map(|number| format!("session {number}")).collect();
        let (found, outcome) = written(&ids);
        outcome.expect("read");
        assert_eq!(found, ids);
        // A session that is there twice, before a line that is no record.
        ids[700] = ids[3].clone();
        ids[1200] = "wrong".to_owned();
        let (found, outcome) = written(&ids);
        let error = outcome.expect_err("twice").to_string();
        assert!(error.contains(":1401: session: \"session 3\" is there twice"), "{error}");
        assert_eq!(found, ids[..700]);
    }

    #[test]
    fn records_survive_a_line_of_text_and_wrong_ones_name_their_place() {
        let summary = Summary {
            rig: Some("r1".to_owned()),
            error: Some("no run".to_owned()),
            covariates: [
                ("age".to_owned(), Value::Number(54.5)),
                ("sex".to_owned(), Value::Text("f".to_owned())),
            ]
            .into(),
            ..Summary::empty("a".to_owned())
        };
        let text = serde_json::to_string(&summary).expect("written");
        let path = PathBuf::from("all.jsonl");
        assert_eq!(parse(&path, 1, &text).expect("read"), summary);
        for (text, begin) in [
            ("{", "all.jsonl:3:1: EOF while parsing an object"),
            ("{\"schema\":3}", "all.jsonl:3:11: invalid type"),
            (&text.replace("54.5", "[1]"), "all.jsonl:3:"),
            (&text.replace("/1", "/9"), "all.jsonl:3:1: schema is \"needle.summary/9\""),
        ] {
            let error = parse(&path, 3, text).expect_err(text).to_string();
            assert!(error.starts_with(begin), "{error}, expected {begin}");
        }
    }
}
