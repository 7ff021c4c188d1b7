//! Sequences of ultrasound frames that belong to a run: `<id>.sweeps.toml`, one entry per hold in which frames were taken.

use crate::document::{Fields, Problem, SessionError, read_text};
use crate::files::with_slashes;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};

/// Frames that were taken in a hold.
#[derive(Debug, Clone, PartialEq)]
pub struct FrameSweep {
    /// When, on the clock of the force series.
    pub time_s: f64,
    /// The sequence: a file or a folder.
    pub frames: PathBuf,
}

/// Path of the list of a run's sweeps.
pub fn sweeps_file(session: &Path, id: &str) -> PathBuf {
    session.join(format!("{id}.sweeps.toml"))
}

impl FrameSweep {
    /// Reads the sweeps of a run; sequences inside the session's folder are listed relative to it.
    ///
    /// # Errors
    /// [`SessionError`] for the first fault found, with its place; where there are none.
    pub fn read(session: &Path, id: &str) -> Result<Vec<Self>, SessionError> {
        let path = sweeps_file(session, id);
        let text = read_text(&path)?;
        Fields::parse(&path, &text, |file| {
            let sweeps: Vec<Self> = file
                .tables("sweep")?
                .iter()
                .map(|fields| {
                    fields.only(&["time_s", "frames"])?;
                    let time_s = fields.number("time_s", [-1e10, 1e10])?;
                    Ok(Self { time_s, frames: session.join(fields.text("frames")?) })
                })
                .collect::<Result<_, _>>()?;
            if sweeps.is_empty() {
                return Err(file.field_fault(
                    "sweep",
                    Problem::Missing,
                    "a table [[sweep]] for every sequence",
                ));
            }
            Ok(sweeps)
        })
    }

    /// The text that lists sweeps.
    pub(super) fn to_toml(session: &Path, id: &str, sweeps: &[Self]) -> String {
        let mut text = format!(
            "# Ultrasound frames of run {id}. Its shape: guide import ultrasound --run {id} --out DIR\n"
        );
        for Self { time_s, frames } in sweeps {
            let _ = write!(
                text,
                "\n[[sweep]]\ntime_s = {time_s:.6}\nframes = {}\n",
                toml::Value::from(inside(session, frames))
            );
        }
        text
    }
}

/// A path relative to the session's folder where it lies in it, so that the folder can be moved as a whole, with the separator that every system
/// reads; else from the root.
fn inside(session: &Path, frames: &Path) -> String {
    let (Ok(session), Ok(from_root)) = (session.canonicalize(), frames.canonicalize()) else {
        return frames.to_string_lossy().into_owned();
    };
    match from_root.strip_prefix(&session) {
        Ok(below) => with_slashes(below),
        Err(_) => plain(&from_root.to_string_lossy()).to_owned(),
    }
}

/// An absolute path as a user of Windows writes it: without the prefix of its longest form, where the short one means the same.
fn plain(path: &str) -> &str {
    let drive = path.strip_prefix(r"\\?\").filter(|short| short.get(1..3) == Some(r":\"));
    drive.filter(|short| short.len() < LONGEST).unwrap_or(path)
}

/// Longest path of Windows without that prefix.
const LONGEST: usize = 260;

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs;

    #[test]
    fn sweeps_are_listed_relative_to_the_session_and_read_again() {
        let (session, elsewhere) =
            (tempfile::tempdir().expect("a folder"), tempfile::tempdir().expect("a folder"));
        let [session_sweep, other_sweep] =
            [session.path(), elsewhere.path()].map(|folder| folder.join("sweep '1'.mha"));
        for file in [&session_sweep, &other_sweep] {
            fs::write(file, "frames").expect("a file");
        }
        let sweeps = [
            FrameSweep { time_s: 1.25, frames: session_sweep.clone() },
            FrameSweep { time_s: 7.5, frames: other_sweep },
        ];
        let text = FrameSweep::to_toml(session.path(), "d30-1", &sweeps);
        assert!(text.contains("frames = \"sweep '1'.mha\""), "{text}");
        fs::write(sweeps_file(session.path(), "d30-1"), text).expect("a file");
        let read = FrameSweep::read(session.path(), "d30-1").expect("reads");
        assert_eq!((read.len(), read[0].time_s, &read[0].frames), (2, 1.25, &session_sweep));
        assert!(read[1].frames.is_absolute());
    }

    #[test]
    fn what_is_below_the_session_is_listed_with_slashes_on_every_system() {
        let session = tempfile::tempdir().expect("a folder");
        let frame_folder = session.path().join("frames").join("d30-1");
        fs::create_dir_all(&frame_folder).expect("a folder");
        assert_eq!(inside(session.path(), &frame_folder), "frames/d30-1");
    }

    #[test]
    fn an_absolute_path_of_windows_is_written_as_its_users_write_it() {
        assert_eq!(plain(r"\\?\C:\data\a.mha"), r"C:\data\a.mha");
        for kept in ["/data/a.mha", r"\\?\UNC\server\a.mha", &format!(r"\\?\C:\{}", "a".repeat(LONGEST))] {
            assert_eq!(plain(kept), kept);
        }
    }

    #[test]
    fn faults_name_their_place() {
        let session = tempfile::tempdir().expect("a folder");
        let message = |text: &str| {
            fs::write(sweeps_file(session.path(), "a"), text).expect("a file");
            FrameSweep::read(session.path(), "a").expect_err("refused").to_string()
        };
        for (text, expected) in [
            ("", "a.sweeps.toml:1:1: sweep: missing"),
            ("[[sweep]]\ntime_s = 1\n", "a.sweeps.toml:1:1: sweep.frames: missing"),
            ("[[sweep]]\ntime_s = \"x\"\nframes = \"b\"\n", "a.sweeps.toml:2:10: sweep.time_s: "),
        ] {
            let message = message(text);
            assert!(message.contains(expected), "{message}");
        }
        assert!(FrameSweep::read(session.path(), "b").is_err());
    }
}
