//! Records of sessions from files of lines.

use crate::error::PopulationError;
use crate::records::{Parts, Records};
use crate::summary::{SUMMARY_SCHEMA, Summary};
use rayon::prelude::*;
use serde::Deserialize;
use std::borrow::Cow;
use std::collections::HashSet;
use std::fs::File;
use std::io::{BufRead, BufReader};
use std::path::Path;

/// Lines that are parsed at once, on all cores.
const AT_ONCE: usize = 512;
/// Bytes that are read at once.
const BUFFER: usize = 1 << 20;

/// A name that stays in the text: sixty parameters of a hundred thousand records have the same few.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Deserialize)]
#[serde(transparent)]
struct Name<'a>(#[serde(borrow)] Cow<'a, str>);

impl AsRef<str> for Name<'_> {
    fn as_ref(&self) -> &str {
        &self.0
    }
}

/// All records of files, read a few at a time, so that their texts are not all in memory.
///
/// # Errors
/// [`PopulationError`] for the first line that is no record, or is of a session that was there already.
pub fn read_summaries(paths: &[impl AsRef<Path>]) -> Result<Records, PopulationError> {
    let mut records = Records::default();
    let mut names: HashSet<String> = HashSet::new();
    for path in paths {
        let path = path.as_ref();
        let failed = |cause| PopulationError::Io { path: path.to_owned(), cause };
        let mut file = BufReader::with_capacity(BUFFER, File::open(path).map_err(failed)?);
        let (mut text, mut ends, mut previous_end) = (Vec::new(), Vec::new(), 0);
        loop {
            text.clear();
            ends.clear();
            while ends.len() < AT_ONCE && file.read_until(b'\n', &mut text).map_err(failed)? > 0 {
                ends.push(text.len());
            }
            if ends.is_empty() {
                break;
            }
            let parsed: Result<Vec<_>, PopulationError> = (0..ends.len())
                .into_par_iter()
                .map(|index| {
                    let begin = index.checked_sub(1).map_or(0, |previous_end| ends[previous_end]);
                    let session_summary = &text[begin..ends[index]];
                    if session_summary.trim_ascii().is_empty() {
                        return Ok(None);
                    }
                    let line = previous_end + index + 1;
                    parse(path, line, session_summary).map(|summary| Some((line, Parts::from(summary))))
                })
                .collect();
            previous_end += ends.len();
            for (line, parts) in parsed?.into_iter().flatten() {
                if !names.insert(parts.session().to_owned()) {
                    let id = parts.session().to_owned();
                    return Err(PopulationError::Twice { path: path.to_owned(), line, id });
                }
                records.push_parts(parts);
            }
        }
    }
    Ok(records)
}

fn parse<'a>(path: &Path, line: usize, text: &'a [u8]) -> Result<Summary<Name<'a>>, PopulationError> {
    let wrong =
        |column: usize, what: String| PopulationError::Line { path: path.to_owned(), line, column, what };
    let summary: Summary<Name> = serde_json::from_slice(text).map_err(|error| {
        let message = error.to_string();
        // The place is stated beside it.
        let problem = message.rsplit_once(" at line").map_or(message.as_str(), |(message, _)| message);
        wrong(error.column(), problem.to_owned())
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
    use crate::summary::{Amplitude, SessionResult, Value};
    use std::path::PathBuf;

    fn record(session: &str, score: f64) -> Summary {
        let amplitude = |effect: &str, at: Option<f64>| Amplitude {
            effect: effect.to_owned(),
            parameter: "size".to_owned(),
            at: at.map(|at| ("depth_mm".to_owned(), at)),
            scale: "linear".to_owned(),
            neutral: 0.0,
            two_sided: true,
            prior_sd: 0.1,
            score,
            information: 30.0 + score,
            ln_k_slope: 0.2,
        };
        let result = SessionResult {
            verdict: "adequate".to_owned(),
            foundation: "springs".to_owned(),
            k_kpa: 12.0,
            k_ci95_kpa: [11.0, 13.0],
            ln_k_kpa: 12f64.ln(),
            ln_k_sd: 0.04,
            ln_modulus_without_effects: [12f64.ln(), 0.04],
            youngs_modulus_kpa: None,
            tip_load_n: Some(0.2),
            tip_load_ci95_n: Some([0.1, 0.3]),
            discrepancy: [("force".to_owned(), 1.5 + score)].into(),
            noise: [("force_y_n".to_owned(), 0.01)].into(),
            named: Vec::new(),
            log_evidence: [("rig.play".to_owned(), -1.0)].into(),
            amplitudes: vec![amplitude("rig.play", None), amplitude("an \"odd\" name", Some(12.0))],
            correlation_per_mille: vec![250],
        };
        Summary {
            rig: Some("r1".to_owned()),
            covariates: [
                ("age".to_owned(), Value::Number(54.5)),
                ("sex".to_owned(), Value::Text("f".to_owned())),
            ]
            .into(),
            result: Some(result),
            ..Summary::empty(session.to_owned())
        }
    }

    /// Content of records that an analysis uses.
    fn taken(records: Records) -> String {
        let sizes = records.median_sizes();
        let (summaries, data) = records.by_session().likelihoods();
        format!("{sizes:?} {summaries:?} {:?} {:?}", data.sessions, data.hypotheses)
    }

    #[test]
    fn records_are_the_same_from_a_file_as_from_memory() {
        let failed = Summary { error: Some("no run".to_owned()), ..Summary::empty("c".to_owned()) };
        let all_records = vec![record("a", 3.0), record("b", -2.0), failed];
        let lines: Vec<String> =
            all_records.iter().map(|one| serde_json::to_string(one).expect("written")).collect();
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("all.jsonl");
        // Blank lines, the ends of lines of another system, and none at the end.
        std::fs::write(&path, format!("{}\n\n{}\r\n{}", lines[0], lines[1], lines[2])).expect("written");
        assert_eq!(taken(read_summaries(&[&path]).expect("read")), taken(all_records.into()));
        let error = read_summaries(&[&path, &path]).expect_err("each session is there twice").to_string();
        assert!(error.contains("all.jsonl:1: session: \"a\" is there twice"), "{error}");
    }

    #[test]
    fn wrong_lines_name_their_place() {
        let text = serde_json::to_string(&record("a", 1.0)).expect("written");
        let path = PathBuf::from("all.jsonl");
        for (text, begin) in [
            ("{".to_owned(), "all.jsonl:3:1: EOF while parsing an object"),
            ("{\"schema\":3}".to_owned(), "all.jsonl:3:11: invalid type"),
            (text.replace("54.5", "[1]"), "all.jsonl:3:"),
            (text.replace("\"effect\":\"rig.play\"", "\"effect\":7"), "all.jsonl:3:"),
            (text.replace("/1", "/9"), "all.jsonl:3:1: schema is \"needle.summary/9\""),
            (text.replace("\"ln_k_sd\":0.04", "\"ln_k_sd\":-1.0"), "all.jsonl:3:1: ln_k_sd"),
        ] {
            let error = parse(&path, 3, text.as_bytes()).expect_err(&text).to_string();
            assert!(error.starts_with(begin), "{error}, expected {begin}");
        }
        let not_text = [b"{\"schema\":\"", &[0xFF][..], b"\"}"].concat();
        let error = parse(&path, 3, &not_text).expect_err("no text").to_string();
        assert!(error.starts_with("all.jsonl:3:1"), "{error}");
    }
}
