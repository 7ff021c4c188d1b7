//! One ultrasound sweep from any program that a lab has: a command whose standard output is the sweep, or ends with the path of its frames.
//!
//! The output is CSV with a header: `z_mm` and `deflection_y_mm`, and where they are known `deflection_x_mm` and `time_s` (on
//! the device's clock); other columns are ignored.

use crate::words;
use formats::session::{SessionError, ShapeRow, ShapeSeries};
use std::io::Read;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::Arc;
use std::sync::mpsc::{self, TryRecvError};

/// Largest output of a sweep command, bytes.
const OUTPUT_LIMIT: u64 = 16 << 20;

/// Reason for which there is no sweep.
#[derive(Debug, Clone, thiserror::Error)]
pub enum SweepError {
    /// The command cannot be started.
    #[error("cannot run the sweep command `{command}`: {cause}")]
    Start {
        /// The command.
        command: String,
        /// The system's error.
        cause: String,
    },
    /// The command failed.
    #[error("the sweep command `{command}` failed ({status}): {last_line}")]
    Failed {
        /// The command.
        command: String,
        /// Its exit status.
        status: String,
        /// The last line of its standard error.
        last_line: String,
    },
    /// Its output is not a sweep.
    #[error(transparent)]
    Output(Arc<SessionError>),
    /// A frames command did not print where its frames are.
    #[error(
        "the frames command printed \"{line}\", expected the path of the sequence that it has saved as its last line"
    )]
    NoFrames {
        /// Its last line.
        line: String,
    },
    /// Its output could not be read.
    #[error("the sweep command's output: {0}")]
    Read(String),
}

/// One sweep along the needle.
#[derive(Debug, Clone, PartialEq)]
pub struct Sweep {
    rows: Vec<(Option<f64>, ShapeRow)>,
}

impl Sweep {
    /// Reads the CSV text of a sweep.
    ///
    /// # Errors
    /// [`SweepError::Output`] with line, column and field.
    pub fn parse(text: &str) -> Result<Self, SweepError> {
        let text = text.strip_prefix('\u{feff}').unwrap_or(text);
        let shape = ShapeSeries::parse(Path::new("the sweep command's output"), text)
            .map_err(|fault| SweepError::Output(Arc::new(fault)))?;
        fn own(column: &Option<Vec<f64>>, row: usize) -> Option<f64> {
            column.as_ref().and_then(|c| c.get(row)).copied()
        }
        Ok(Self {
            rows: shape
                .z_m
                .iter()
                .zip(&shape.y_m)
                .enumerate()
                .map(|(row, (z_m, deflection_y_m))| {
                    let deflection_x_m = own(&shape.x_m, row).unwrap_or(0.0);
                    let (z_m, deflection_y_m) = (*z_m, *deflection_y_m);
                    (
                        own(&shape.time_s, row),
                        ShapeRow { time_s: 0.0, z_m, deflection_y_m, deflection_x_m, image: None },
                    )
                })
                .collect(),
        })
    }

    /// Samples with times of their own.
    pub fn at_own_times(rows: Vec<ShapeRow>) -> Self {
        Self { rows: rows.into_iter().map(|row| (Some(row.time_s), row)).collect() }
    }

    /// The samples; those without times of their own were taken at this time.
    pub fn rows(&self, time_s: f64) -> impl Iterator<Item = ShapeRow> {
        self.rows.iter().map(move |(own, row)| ShapeRow { time_s: own.unwrap_or(time_s), ..*row })
    }
}

/// Path at which a frames command has saved its sequence: the last line of its output, a file or a
/// folder.
///
/// # Errors
/// [`SweepError::NoFrames`] where there is no such file.
pub fn saved_frames(text: &str) -> Result<PathBuf, SweepError> {
    let line = text.lines().rev().map(str::trim).find(|line| !line.is_empty()).unwrap_or_default();
    let path = PathBuf::from(line);
    let is_there = !line.is_empty() && path.exists();
    is_there.then_some(path).ok_or_else(|| SweepError::NoFrames { line: line.chars().take(200).collect() })
}

/// A sweep command that runs beside the recording, and what is made of its output.
pub struct SweepTask<T = Sweep>(mpsc::Receiver<Result<T, SweepError>>);

impl<T: Send + 'static> SweepTask<T> {
    /// Starts a command, split into words ([`words`]); `parse` reads its output.
    ///
    /// # Errors
    /// [`SweepError::Start`].
    pub fn start(command: &str, parse: fn(&str) -> Result<T, SweepError>) -> Result<Self, SweepError> {
        fn cannot(cause: String, command: &str) -> SweepError {
            SweepError::Start { command: command.to_owned(), cause }
        }
        let words = words::split(command).filter(|words| !words.is_empty());
        let words = words
            .ok_or_else(|| cannot("a quotation mark is not closed, or it is empty".to_owned(), command))?;
        let (program, arguments) =
            words.split_first().ok_or_else(|| cannot("it is empty".to_owned(), command))?;
        let mut child = Command::new(program)
            .args(arguments)
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .map_err(|error| cannot(error.to_string(), command))?;
        let (sender, receiver) = mpsc::channel();
        let command = command.to_owned();
        std::thread::spawn(move || {
            // Both pipes are emptied: a command that prints a lot must not wait for its reader.
            let errors = child.stderr.take().map(|stderr| std::thread::spawn(move || tail(stderr)));
            let mut text = String::new();
            let read = child.stdout.take().map(|stdout| stdout.take(OUTPUT_LIMIT).read_to_string(&mut text));
            let outcome = match (read, child.wait()) {
                (Some(Ok(_)), Ok(status)) if status.success() => parse(&text),
                (Some(Err(error)), _) => Err(SweepError::Read(error.to_string())),
                (_, Ok(status)) => {
                    let errors = errors.and_then(|errors| errors.join().ok()).unwrap_or_default();
                    let last_line = errors.lines().last().unwrap_or_default().to_owned();
                    Err(SweepError::Failed { command, status: status.to_string(), last_line })
                }
                (_, Err(error)) => Err(SweepError::Start { command, cause: error.to_string() }),
            };
            // A recording that has ended meanwhile does not want it any more.
            let _ = sender.send(outcome);
        });
        Ok(Self(receiver))
    }

    /// The sweep if it is complete, else the running task.
    pub fn finished(self) -> Result<Result<T, SweepError>, Self> {
        match self.0.try_recv() {
            Ok(outcome) => Ok(outcome),
            Err(TryRecvError::Empty) => Err(self),
            Err(TryRecvError::Disconnected) => Ok(Err(SweepError::Read("its reader stopped".to_owned()))),
        }
    }
}

/// The last words of a stream.
fn tail(mut stream: impl Read) -> String {
    const KEPT: usize = 2048;
    let mut kept_bytes = Vec::new();
    let mut chunk = [0; 1024];
    while let Ok(length @ 1..) = stream.read(&mut chunk) {
        kept_bytes.extend_from_slice(&chunk[..length]);
        kept_bytes.drain(..kept_bytes.len().saturating_sub(KEPT));
    }
    String::from_utf8_lossy(&kept_bytes).into_owned()
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::time::{Duration, Instant};

    fn complete(command: &str) -> Result<Sweep, SweepError> {
        let mut task = SweepTask::start(command, Sweep::parse)?;
        let deadline = Instant::now() + Duration::from_secs(20);
        loop {
            task = match task.finished() {
                Ok(outcome) => return outcome,
                Err(task) => task,
            };
            assert!(Instant::now() < deadline, "the command does not end");
            std::thread::sleep(Duration::from_millis(5));
        }
    }

    #[test]
    fn columns_are_free_and_times_are_kept() {
        let text = "# probe 3\nquality,z_mm,deflection_y_mm,time_s\n9,71, 0.5 ,12.5\n9,72,0.25,12.6\n";
        let rows: Vec<ShapeRow> = Sweep::parse(text).unwrap().rows(99.0).collect();
        let row = rows[0];
        assert_eq!((row.time_s, row.deflection_x_m, rows.len()), (12.5, 0.0, 2));
        assert!((row.z_m - 0.071).abs() < 1e-12 && (row.deflection_y_m - 5e-4).abs() < 1e-12);
        let untimed = Sweep::parse("z_mm,deflection_y_mm\n71,0.5\n").unwrap();
        assert_eq!(untimed.rows(99.0).next().unwrap().time_s, 99.0);
    }

    #[test]
    fn faults_name_the_line() {
        fn message(text: &str) -> String {
            Sweep::parse(text).unwrap_err().to_string()
        }
        for (text, expected) in [
            ("z_mm,u\n1,2\n", ":1:1: deflection_y_mm: missing, expected a header with z_mm, deflection_y_mm"),
            ("z_mm,deflection_y_mm\n1,2\n3,x\n", ":3:3: deflection_y_mm: \"x\" is not a number"),
            ("z_mm,deflection_y_mm\n1,nan\n", ":2:3: deflection_y_mm: not a finite number"),
            ("z_mm,deflection_y_mm\n", ":1:1: rows: no rows"),
            ("z_mm,deflection_y_mm\n1,2,3\n", ":2:5: row: 3 cells, expected 2"),
            // Rows with which no session could be read afterwards.
            ("z_mm,deflection_y_mm\n-1,0\n", ":2:1: z_mm: -1 is out of range"),
        ] {
            let message = message(text);
            assert!(message.starts_with(&format!("the sweep command's output{expected}")), "{message}");
        }
    }

    #[test]
    fn a_frames_command_ends_with_where_they_are() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("sweep 1.mha");
        std::fs::write(&path, "frames").unwrap();
        assert_eq!(saved_frames(&format!("saving\n{}\n\n", path.display())).unwrap(), path);
        for text in ["", "\n", "nowhere.mha\n"] {
            let message = saved_frames(text).unwrap_err().to_string();
            assert!(message.contains("expected the path of the sequence"), "{message}");
        }
    }

    /// More words than a pipe holds, before the first of the sweep.
    #[cfg(unix)]
    #[test]
    fn a_command_that_prints_a_lot_waits_for_no_reader() {
        let chatty = "sh -c 'head -c 300000 /dev/zero >&2; echo z_mm,deflection_y_mm; echo 71,0.5'";
        assert_eq!(complete(chatty).unwrap().rows(1.0).count(), 1);
    }

    #[test]
    fn a_command_gives_a_sweep_or_an_error() {
        let [good, failing] = if cfg!(windows) {
            [r#"cmd /c "echo z_mm,deflection_y_mm& echo 71,0.5""#, r#"cmd /c "echo probe is off>&2& exit 3""#]
        } else {
            [r"printf 'z_mm,deflection_y_mm\n71,0.5\n'", "sh -c 'echo probe is off >&2; exit 3'"]
        };
        assert_eq!(complete(good).unwrap().rows(1.0).count(), 1);
        let failed = complete(failing).unwrap_err().to_string();
        assert!(failed.contains(": 3)") && failed.contains("probe is off"), "{failed}");
        let missing = complete("no-such-program-here").unwrap_err().to_string();
        assert!(missing.contains("cannot run the sweep command"), "{missing}");
        assert!(complete("a 'b").unwrap_err().to_string().contains("quotation mark"));
    }
}
