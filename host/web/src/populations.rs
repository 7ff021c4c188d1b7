//! Statistics over the records of many sessions, and the record of one.

use crate::answer::AnswerError;
use crate::drawing::Figure;
use crate::results::json;
use population::{Options, analyse, read_summaries};
use std::path::{Path, PathBuf};

/// Seed of a record's bootstraps: that of `guide summarize`.
const SEED: u64 = 1;

/// Record of a session, as `guide summarize` writes it.
pub fn summarize(dir: &Path) -> Result<String, AnswerError> {
    Ok(serde_json::to_string(&inference::summarize(dir, SEED))?)
}

/// Result of `guide population`.
pub fn population(files: &[PathBuf], by: &[String]) -> Result<String, AnswerError> {
    let options = Options { by: by.to_vec(), ..Options::default() };
    let analysed = analyse(read_summaries(files)?, &options)?;
    let drawn = figures::population(&analysed)?;
    let drawn = drawn.into_iter().map(|(name, svg)| {
        let title = title_of(&name);
        Figure::new(name, title, svg)
    });
    let drawn = drawn.collect();
    json(analysed, drawn)
}

fn title_of(name: &str) -> String {
    match (name, name.strip_prefix("time-")) {
        ("forest", _) => {
            "K of every session with its interval, and mean and prediction of every group".to_owned()
        }
        ("spread", _) => "K by group: sessions, mean and the interval of a new subject".to_owned(),
        ("funnel", _) => "Distance from the mean of the group against the error of the session".to_owned(),
        ("shrinkage", _) => "K of every session, and its estimate together with its group".to_owned(),
        (_, Some(rig)) => format!("Rig {rig}: K against the mean of the group over time"),
        (other, None) => other.to_owned(),
    }
}
