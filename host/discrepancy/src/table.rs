//! Runs as CSV files: a column `time_s`, the channels that a model predicts, and all others as known columns.

use super::data::{Channel, Column, Run, TIME};
use super::process::Predicted;
use std::path::{Path, PathBuf};

/// Suffix of a column with the standard deviations of a channel.
const SD: &str = "_sd";

/// Reason for which a file is not a run.
#[derive(Debug, thiserror::Error)]
pub enum TableError {
    /// It cannot be read as CSV.
    #[error("{}: {cause}", path.display())]
    Csv {
        /// The file.
        path: PathBuf,
        /// Reason, with the line.
        #[source]
        cause: csv::Error,
    },
    /// A column is missing.
    #[error("{}: no column {column:?}; its columns are {found}", path.display())]
    Missing {
        /// The file.
        path: PathBuf,
        /// The column.
        column: String,
        /// The columns of the file.
        found: String,
    },
    /// A cell is not a number.
    #[error("{}:{line}, column {column:?}: {cell:?}; expected a number{}", path.display(), if *may_be_empty { ", or nothing where there is no reading" } else { "" })]
    Cell {
        /// The file.
        path: PathBuf,
        /// Line, from 1.
        line: u64,
        /// The column.
        column: String,
        /// Its content.
        cell: String,
        /// Whether it may be empty.
        may_be_empty: bool,
    },
}

fn is_channel(channels: &[Predicted], name: &str) -> bool {
    channels.iter().any(|channel| channel.name == name)
}

impl Run {
    /// Reads a run, named by its path, from a CSV file. A column with the name of a channel and `_sd` has the channel's
    /// standard deviations.
    ///
    /// # Errors
    /// [`TableError`] with line and column.
    pub fn read(path: &Path, channels: &[Predicted], judges: bool) -> Result<Self, TableError> {
        let csv = |cause| TableError::Csv { path: path.to_owned(), cause };
        let mut reader = csv::ReaderBuilder::new()
            .trim(csv::Trim::All)
            .comment(Some(b'#'))
            .from_path(path)
            .map_err(csv)?;
        let names: Vec<String> = reader.headers().map_err(csv)?.iter().map(str::to_owned).collect();
        let required = std::iter::once(TIME).chain(channels.iter().map(|channel| channel.name.as_str()));
        for column in required {
            if !names.iter().any(|name| name == column) {
                return Err(TableError::Missing {
                    path: path.to_owned(),
                    column: column.to_owned(),
                    found: names.join(", "),
                });
            }
        }
        let mut values: Vec<Vec<f64>> = vec![Vec::new(); names.len()];
        for record in reader.records() {
            let record = record.map_err(csv)?;
            for ((cell, name), values) in record.iter().zip(&names).zip(&mut values) {
                let may_be_empty = is_channel(channels, name);
                let value = if cell.is_empty() && may_be_empty { Some(f64::NAN) } else { cell.parse().ok() };
                values.push(value.ok_or_else(|| TableError::Cell {
                    path: path.to_owned(),
                    line: record.position().map_or(0, csv::Position::line),
                    column: name.clone(),
                    cell: cell.to_owned(),
                    may_be_empty,
                })?);
            }
        }
        let mut run = Self {
            name: path.display().to_string(),
            time_s: Vec::new(),
            channels: Vec::new(),
            columns: Vec::new(),
            judges,
        };
        let mut sds: Vec<(String, Vec<f64>)> = Vec::new();
        for (name, values) in names.into_iter().zip(values) {
            if name == TIME {
                run.time_s = values;
            } else if let Some(channel) = channels.iter().find(|channel| channel.name == name) {
                let unit = channel.unit.clone();
                run.channels.push(Channel { name, unit, values, sds: None });
            } else if name.strip_suffix(SD).is_some_and(|stem| is_channel(channels, stem)) {
                sds.push((name, values));
            } else {
                run.columns.push(Column { name, unit: String::new(), values });
            }
        }
        for channel in &mut run.channels {
            let name = format!("{}{SD}", channel.name);
            channel.sds = sds.iter().find(|(one, _)| *one == name).map(|(_, values)| values.clone());
        }
        Ok(run)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs;

    fn read(text: &str) -> Result<Run, TableError> {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("run.csv");
        fs::write(&path, text).expect("written");
        Run::read(&path, &[Predicted { name: "level".to_owned(), unit: "m".to_owned() }], false)
    }

    #[test]
    fn channels_their_sds_and_known_columns_are_told_apart() {
        let run = read("time_s,pump,level,level_sd\n0,1.5,0.2,0.01\n1,1.6,,0.01\n").expect("a run");
        assert_eq!((run.time_s.as_slice(), run.column("pump")), (&[0.0, 1.0][..], Some(&[1.5, 1.6][..])));
        assert!(run.channels[0].values[1].is_nan());
        assert_eq!(run.channels[0].sds, Some(vec![0.01, 0.01]));
        assert_eq!(run.columns.len(), 1);
    }

    #[test]
    fn faults_have_line_and_column() {
        let error = read("time_s,level\n0,1\n1,high\n").expect_err("a word");
        assert!(error.to_string().contains("run.csv:3, column \"level\": \"high\""), "{error}");
        let error = read("time_s,pump\n0,1\n").expect_err("no channel");
        assert!(error.to_string().contains("no column \"level\""), "{error}");
    }
}
