//! Writing a session: a new folder, or one more run into an existing one.
//!
//! Rows go to the run's CSV files as they come; the run is entered in `session.toml` when it is finished. Text that
//! others wrote into `session.toml` stays as it is: a run is appended, through a temporary file that replaces the old
//! one.

mod imported;
mod insertion;
mod lateral;

pub use imported::SessionFiles;
pub use lateral::{ForceRow, LateralWriter, ShapeRow};

use super::lock::SessionLock;
use super::{Session, Setup, SteeringRun};
use crate::document::{SessionError, io, number, replace};
use crate::files;
use mechanics::{Guides, Rig};
use std::fs;
use std::path::{Path, PathBuf};

/// A session folder that takes runs, from this writer alone until it is dropped: no other one has its ids.
#[derive(Debug)]
pub struct SessionWriter {
    dir: PathBuf,
    lock: SessionLock,
    lateral_ids: Vec<String>,
    insertion_ids: Vec<String>,
    steering_ids: Vec<String>,
    /// Files that this has made.
    made: Vec<PathBuf>,
    /// `session.toml` as it was; nothing where this has made it.
    before: Option<String>,
    /// The folder was made for it.
    made_folder: bool,
}

impl SessionWriter {
    /// Creates the session, or opens an existing one recorded with the same needle and rig.
    ///
    /// # Errors
    /// [`SessionError::Locked`] while another writer has it, [`SessionError::OtherRig`] where an existing session has another needle
    /// or rig, [`SessionError::OtherTissue`] where it states another tissue; otherwise as
    /// [`Session::read`], or an error of the operating system.
    pub fn open(dir: &Path, setup: &Setup) -> Result<Self, SessionError> {
        let path = dir.join("session.toml");
        let text = if path.exists() { None } else { Some(setup.to_toml(&path)?) };
        let made_folder = !dir.exists();
        fs::create_dir_all(dir).map_err(io(dir, "create"))?;
        // A folder in which not even the lock can be written is not left behind.
        let unmade = |_: &SessionError| {
            if made_folder {
                let _ = fs::remove_dir(dir);
            }
        };
        let lock = SessionLock::take(dir).inspect_err(unmade)?;
        // Another writer may have made it meanwhile.
        if path.exists() {
            let session = Session::read(dir)?;
            same_rig(&path, &session.rig, &setup.rig)?;
            if let Some((field, [stated, new])) = session.tissue.contradicts(setup.tissue) {
                return Err(SessionError::OtherTissue { path, field, there: stated, new });
            }
            let lateral_ids = session.lateral.into_iter().map(|run| run.id).collect();
            let insertion_ids = session.insertion.into_iter().map(|run| run.id).collect();
            let steering_ids = session.steering.into_iter().map(|run| run.id).collect();
            let previous_text = Some(fs::read_to_string(&path).map_err(io(&path, "read"))?);
            let dir = dir.to_owned();
            return Ok(Self {
                dir,
                lock,
                lateral_ids,
                insertion_ids,
                steering_ids,
                made: Vec::new(),
                before: previous_text,
                made_folder: false,
            });
        }
        let text = text.map_or_else(|| setup.to_toml(&path), Ok)?;
        if let Err(error) = replace(&path, &text) {
            drop(lock);
            unmade(&error);
            return Err(error);
        }
        Ok(Self {
            dir: dir.to_owned(),
            lock,
            lateral_ids: Vec::new(),
            insertion_ids: Vec::new(),
            steering_ids: Vec::new(),
            made: Vec::new(),
            before: None,
            made_folder,
        })
    }

    /// Folder of the session, where this has made it.
    pub(super) fn new_dir(&self) -> Option<PathBuf> {
        self.before.is_none().then(|| self.dir.clone())
    }

    /// Notes a file that this has made.
    pub(super) fn has_made(&mut self, file: PathBuf) {
        self.made.push(file);
    }

    /// Ids of the lateral runs the session has.
    pub fn lateral_ids(&self) -> &[String] {
        &self.lateral_ids
    }

    /// Starts a lateral run. Its files `<id>.force.csv` and `<id>.shape.csv` and its entry in `session.toml` are made with the
    /// first rows, so that a run of which nothing was recorded leaves nothing behind.
    ///
    /// # Errors
    /// [`SessionError::Id`] where the id is taken or cannot be part of a file name; an existing file is never
    /// overwritten.
    pub fn lateral(&mut self, id: &str, depth_m: f64) -> Result<LateralWriter<'_>, SessionError> {
        self.check_id(id, &self.lateral_ids)?;
        Ok(LateralWriter::new(self, id, depth_m))
    }

    /// Writes a whole steering run: `<id>.csv` and its entry in `session.toml`.
    ///
    /// # Errors
    /// As [`Self::lateral`]; [`SessionError::NotFinite`].
    pub fn steering(&mut self, run: &SteeringRun) -> Result<(), SessionError> {
        self.check_id(&run.id, &self.steering_ids)?;
        self.whole_run(|session| {
            session.table(
                &run.id,
                &[
                    ("time_s", run.time_s.clone(), 1.0),
                    ("depth_mm", run.depth_m.clone(), 1e3),
                    ("base_y_mm", run.base_y_m.clone(), 1e3),
                    ("base_force_y_n", run.base_force_y_n.clone(), 1.0),
                    ("tip_y_mm", run.tip_y_m.clone(), 1e3),
                ],
            )?;
            enter(&session.dir, &format!("\n[[steering]]\nid = \"{0}\"\ndata = \"{0}.csv\"\n", run.id))
        })?;
        self.steering_ids.push(run.id.clone());
        Ok(())
    }

    /// Writes `<id>.csv` with columns of equal length: name, values, factor into the file's unit.
    fn table(&mut self, id: &str, columns: &[(&'static str, Vec<f64>, f64)]) -> Result<(), SessionError> {
        let path = self.dir.join(format!("{id}.csv"));
        let rows = Self::rows(&path, columns)?;
        self.whole(path, &rows)
    }

    /// The text of such a file.
    fn rows(path: &Path, columns: &[(&'static str, Vec<f64>, f64)]) -> Result<String, SessionError> {
        let names: Vec<_> = columns.iter().map(|(name, ..)| *name).collect();
        let mut rows = format!("{}\n", names.join(","));
        for row in 0..columns.first().map_or(0, |(_, values, _)| values.len()) {
            let cells: Result<Vec<_>, _> = columns
                .iter()
                .map(|(name, values, factor)| (*name, factor * values.get(row).copied().unwrap_or(f64::NAN)))
                .map(|(name, value)| number(path, name, value))
                .collect();
            rows.push_str(&cells?.join(","));
            rows.push('\n');
        }
        Ok(rows)
    }

    /// Writes a run of which everything is there: files and entry, or none of them.
    fn whole_run(
        &mut self,
        write: impl FnOnce(&mut Self) -> Result<(), SessionError>,
    ) -> Result<(), SessionError> {
        let made_count = self.made.len();
        let outcome = write(self);
        if outcome.is_err() {
            for path in self.made.drain(made_count..) {
                let _ = fs::remove_file(path);
            }
        }
        outcome
    }

    /// Writes a file of a run, whole or not at all.
    fn whole(&mut self, path: PathBuf, rows: &str) -> Result<(), SessionError> {
        files::write_new(&path, rows.as_bytes()).map_err(io(&path, "write"))?;
        self.made.push(path);
        Ok(())
    }

    /// Takes back everything that was written since the session was opened, after a failure: files of runs, entries,
    /// and the folder where this made it. A file that cannot be removed stays.
    pub fn undo(self) {
        // The entries go first, so that none of them names a file that is gone.
        let session = self.dir.join("session.toml");
        let undone = match &self.before {
            Some(text) if !self.made.is_empty() => replace(&session, text).is_ok(),
            Some(_) => true,
            None => fs::remove_file(&session).is_ok(),
        };
        if undone {
            for path in &self.made {
                let _ = fs::remove_file(path);
            }
        }
        drop(self.lock);
        if self.made_folder {
            // Only where nothing else has come into it.
            let _ = fs::remove_dir(&self.dir);
        }
    }

    /// Refuses an id that is taken or cannot be part of a file name.
    fn check_id(&self, id: &str, taken: &[String]) -> Result<(), SessionError> {
        let path = self.dir.join("session.toml");
        check_name(&path, id)?;
        if taken.iter().any(|taken| taken == id) {
            let (problem, expected) = ("is taken", "an id the session does not have");
            return Err(SessionError::Id { path, id: id.to_owned(), problem, expected });
        }
        Ok(())
    }
}

/// Refuses an id that cannot be part of a file name.
fn check_name(path: &Path, id: &str) -> Result<(), SessionError> {
    if is_file_name(id) {
        return Ok(());
    }
    let (problem, expected) = ("cannot be part of a file name", FILE_NAME);
    Err(SessionError::Id { path: path.to_owned(), id: id.to_owned(), problem, expected })
}

/// Valid form of an id.
pub const FILE_NAME: &str =
    "up to 100 of letters, digits, - _ ., and no device of Windows (con, nul, com1, ...)";

/// Whether an id can be part of a file name, on every system that a session may go to.
pub fn is_file_name(id: &str) -> bool {
    !id.is_empty()
        && !id.starts_with('.')
        && id.len() <= 100
        && id.chars().all(|c| c.is_ascii_alphanumeric() || matches!(c, '-' | '_' | '.'))
        && !is_device(id)
}

/// Whether a file of this name is a device on Windows, whatever follows behind a dot.
pub(super) fn is_device(id: &str) -> bool {
    let stem = id.split('.').next().unwrap_or(id).to_ascii_lowercase();
    match stem.strip_suffix(|last: char| matches!(last, '1'..='9')) {
        Some(port) => matches!(port, "com" | "lpt"),
        None => matches!(stem.as_str(), "con" | "prn" | "aux" | "nul"),
    }
}

/// Adds an entry to `session.toml`.
fn enter(dir: &Path, entry: &str) -> Result<(), SessionError> {
    let path = dir.join("session.toml");
    let mut text = fs::read_to_string(&path).map_err(io(&path, "read"))?;
    if !text.ends_with('\n') {
        text.push('\n');
    }
    text.push_str(entry);
    replace(&path, &text)
}

/// Refuses another needle or rig; differences below a part in a million are rounding.
fn same_rig(path: &Path, there: &Rig, new: &Rig) -> Result<(), SessionError> {
    let (a, b) = (&there.needle, &new.needle);
    fn guides(rig: &Rig) -> f64 {
        if rig.has_one_guide() { 1.0 } else { 2.0 }
    }
    // 0 where it is not known.
    fn rear(rig: &Rig, plane: usize) -> f64 {
        match rig.guides {
            Guides::One { rear_rotation_n_m_per_rad: stiffness } => stiffness[plane].unwrap_or_default(),
            Guides::Two => 0.0,
        }
    }
    for (field, there, new) in [
        ("youngs_modulus_gpa", 1e-9 * a.youngs_modulus_pa, 1e-9 * b.youngs_modulus_pa),
        ("outer_diameter_mm", 1e3 * a.outer_diameter_m, 1e3 * b.outer_diameter_m),
        ("inner_diameter_mm", 1e3 * a.inner_diameter_m, 1e3 * b.inner_diameter_m),
        ("guide2_mm", 1e3 * there.guide2_m, 1e3 * new.guide2_m),
        ("entry_mm", 1e3 * there.entry_m, 1e3 * new.entry_m),
        ("guides", guides(there), guides(new)),
        ("rear_rotation_y_n_m_per_rad", rear(there, 0), rear(new, 0)),
        ("rear_rotation_x_n_m_per_rad", rear(there, 1), rear(new, 1)),
    ] {
        if (there - new).abs() > 1e-6 * there.abs().max(new.abs()) {
            return Err(SessionError::OtherRig { path: path.to_owned(), field, there, new });
        }
    }
    Ok(())
}
