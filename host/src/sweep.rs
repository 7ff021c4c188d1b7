//! One ultrasound sweep from whatever program a lab has: a command whose standard output is the sweep.
//!
//! The output is CSV with a header: `z_mm` and `deflection_y_mm`, and where they are known `deflection_x_mm` and `time_s` (on
//! the device's clock); other columns are ignored.

use crate::session::ShapeRow;
use std::io::Read;
use std::process::{Command, Stdio};
use std::sync::mpsc::{self, TryRecvError};

/// Largest output of a sweep command, bytes.
const OUTPUT_LIMIT: u64 = 16 << 20;

/// Why there is no sweep.
#[derive(Debug, Clone, thiserror::Error)]
pub enum SweepError {
    /// The command cannot be started.
    #[error("cannot run the sweep command `{command}`: {cause}")]
    Start {
        /// The command.
        command: String,
        /// What the system says.
        cause: String,
    },
    /// The command failed.
    #[error("the sweep command `{command}` failed ({status}): {said}")]
    Failed {
        /// The command.
        command: String,
        /// Its exit status.
        status: String,
        /// The last line it said.
        said: String,
    },
    /// Its output is no sweep.
    #[error("the sweep command's output: line {line}: {problem}")]
    Output {
        /// Line of the output, from 1.
        line: u64,
        /// What is wrong and what was expected.
        problem: String,
    },
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
    /// [`SweepError::Output`] with the line.
    pub fn parse(text: &str) -> Result<Self, SweepError> {
        let fault = |line: u64, problem: String| SweepError::Output { line, problem };
        let mut reader =
            csv::ReaderBuilder::new().comment(Some(b'#')).trim(csv::Trim::All).from_reader(text.as_bytes());
        let headers = reader.headers().map_err(|error| fault(1, error.to_string()))?.clone();
        let column = |name: &str| headers.iter().position(|header| header == name);
        let required =
            |name: &str| column(name).ok_or_else(|| fault(1, format!("no column `{name}`, expected one")));
        let (z, y) = (required("z_mm")?, required("deflection_y_mm")?);
        let (x, time) = (column("deflection_x_mm"), column("time_s"));
        let mut rows = Vec::new();
        for record in reader.records() {
            let record = record
                .map_err(|error| fault(error.position().map_or(1, csv::Position::line), error.to_string()))?;
            let line = record.position().map_or(1, csv::Position::line);
            let number = |column: usize| {
                let cell = record.get(column).unwrap_or_default();
                let value = cell.parse::<f64>().ok().filter(|value| value.is_finite());
                value.ok_or_else(|| fault(line, format!("`{cell}`, expected a number")))
            };
            let optional = |column: Option<usize>| column.map(number).transpose();
            let row = ShapeRow {
                time_s: 0.0,
                z_m: number(z)? * 1e-3,
                deflection_y_m: number(y)? * 1e-3,
                deflection_x_m: optional(x)?.unwrap_or(0.0) * 1e-3,
            };
            rows.push((optional(time)?, row));
        }
        if rows.is_empty() {
            return Err(fault(1, "no samples, expected at least one".to_owned()));
        }
        Ok(Self { rows })
    }

    /// Samples that say when they were taken.
    pub fn at_own_times(rows: Vec<ShapeRow>) -> Self {
        Self { rows: rows.into_iter().map(|row| (Some(row.time_s), row)).collect() }
    }

    /// The samples; those that do not say when they were taken were taken at this time.
    pub fn rows(&self, time_s: f64) -> impl Iterator<Item = ShapeRow> {
        self.rows.iter().map(move |(own, row)| ShapeRow { time_s: own.unwrap_or(time_s), ..*row })
    }
}

/// A sweep command that runs beside the recording.
pub struct SweepTask(mpsc::Receiver<Result<Sweep, SweepError>>);

impl SweepTask {
    /// Starts a command, with the shell's splitting of words.
    ///
    /// # Errors
    /// [`SweepError::Start`].
    pub fn start(command: &str) -> Result<Self, SweepError> {
        let cannot = |cause: String| SweepError::Start { command: command.to_owned(), cause };
        let words = shlex::split(command).filter(|words| !words.is_empty());
        let words =
            words.ok_or_else(|| cannot("a quotation mark is not closed, or it is empty".to_owned()))?;
        let (program, arguments) = words.split_first().ok_or_else(|| cannot("it is empty".to_owned()))?;
        let mut child = Command::new(program)
            .args(arguments)
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .map_err(|error| cannot(error.to_string()))?;
        let (sender, receiver) = mpsc::channel();
        let command = command.to_owned();
        std::thread::spawn(move || {
            // Both pipes are emptied: a command that says a lot must not wait for its reader.
            let said = child.stderr.take().map(|stderr| std::thread::spawn(move || tail(stderr)));
            let mut text = String::new();
            let read = child.stdout.take().map(|stdout| stdout.take(OUTPUT_LIMIT).read_to_string(&mut text));
            let outcome = match (read, child.wait()) {
                (Some(Ok(_)), Ok(status)) if status.success() => Sweep::parse(&text),
                (Some(Err(error)), _) => Err(SweepError::Output { line: 1, problem: error.to_string() }),
                (_, Ok(status)) => {
                    let said = said.and_then(|said| said.join().ok()).unwrap_or_default();
                    let said = said.lines().last().unwrap_or_default().to_owned();
                    Err(SweepError::Failed { command, status: status.to_string(), said })
                }
                (_, Err(error)) => Err(SweepError::Start { command, cause: error.to_string() }),
            };
            // A recording that has ended meanwhile does not want it any more.
            let _ = sender.send(outcome);
        });
        Ok(Self(receiver))
    }

    /// The sweep if it is complete, else the task again.
    pub fn finished(self) -> Result<Result<Sweep, SweepError>, Self> {
        match self.0.try_recv() {
            Ok(outcome) => Ok(outcome),
            Err(TryRecvError::Empty) => Err(self),
            Err(TryRecvError::Disconnected) => {
                Ok(Err(SweepError::Output { line: 1, problem: "the reader stopped".to_owned() }))
            }
        }
    }
}

/// The last words of a stream.
fn tail(mut stream: impl Read) -> String {
    const KEPT: usize = 2048;
    let mut kept = Vec::new();
    let mut chunk = [0; 1024];
    while let Ok(length @ 1..) = stream.read(&mut chunk) {
        kept.extend_from_slice(&chunk[..length]);
        kept.drain(..kept.len().saturating_sub(KEPT));
    }
    String::from_utf8_lossy(&kept).into_owned()
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::time::{Duration, Instant};

    fn complete(command: &str) -> Result<Sweep, SweepError> {
        let mut task = SweepTask::start(command)?;
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
        let message = |text: &str| Sweep::parse(text).unwrap_err().to_string();
        assert!(message("z_mm,u\n1,2\n").contains("no column `deflection_y_mm`"));
        assert!(message("z_mm,deflection_y_mm\n1,2\n3,x\n").contains("line 3: `x`, expected a number"));
        assert!(message("z_mm,deflection_y_mm\n1,nan\n").contains("line 2"));
        assert!(message("z_mm,deflection_y_mm\n").contains("no samples"));
        assert!(message("z_mm,deflection_y_mm\n1,2,3\n").contains("line 2"));
    }

    #[test]
    fn a_command_gives_a_sweep_or_says_why_not() {
        let good = complete(r#"printf 'z_mm,deflection_y_mm\n71,0.5\n'"#).unwrap();
        assert_eq!(good.rows(1.0).count(), 1);
        let failed = complete("sh -c 'echo probe is off >&2; exit 3'").unwrap_err().to_string();
        assert!(failed.contains("exit status: 3") && failed.contains("probe is off"), "{failed}");
        // More words than a pipe holds, before the first of the sweep.
        let chatty = "sh -c 'head -c 300000 /dev/zero >&2; echo z_mm,deflection_y_mm; echo 71,0.5'";
        assert_eq!(complete(chatty).unwrap().rows(1.0).count(), 1);
        let missing = complete("no-such-program-here").unwrap_err().to_string();
        assert!(missing.contains("cannot run the sweep command"), "{missing}");
        assert!(complete("a 'b").unwrap_err().to_string().contains("quotation mark"));
    }
}
