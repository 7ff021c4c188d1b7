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

/// Passes the records of files on, in order, a few at a time, so that not all of them are in memory.
///
/// # Errors
/// [`PopulationError`] for the first line that is no record, or is of a session that was there already.
pub fn read_lines(paths: &[impl AsRef<Path>], mut pass: impl FnMut(Summary)) -> Result<(), PopulationError> {
    let mut known: HashSet<String> = HashSet::new();
    for path in paths {
        let path = path.as_ref();
        let failed = |cause| PopulationError::Io { path: path.to_owned(), cause };
        let mut lines = BufReader::new(File::open(path).map_err(failed)?).lines().enumerate();
        loop {
            let part: Result<Vec<(usize, String)>, PopulationError> = lines
                .by_ref()
                .take(AT_ONCE)
                .map(|(number, line)| line.map(|line| (number + 1, line)).map_err(failed))
                .collect();
            let part = part?;
            if part.is_empty() {
                break;
            }
            let parsed: Result<Vec<Option<(usize, Summary)>>, PopulationError> = part
                .into_par_iter()
                .map(|(line, text)| {
                    if text.trim().is_empty() {
                        return Ok(None);
                    }
                    parse(path, line, &text).map(|summary| Some((line, summary)))
                })
                .collect();
            for (line, summary) in parsed?.into_iter().flatten() {
                if !known.insert(summary.session.clone()) {
                    return Err(PopulationError::Twice { path: path.to_owned(), line, id: summary.session });
                }
                pass(summary);
            }
        }
    }
    Ok(())
}

/// All records of files.
///
/// # Errors
/// As [`read_lines`].
pub fn read_summaries(paths: &[impl AsRef<Path>]) -> Result<Records, PopulationError> {
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
