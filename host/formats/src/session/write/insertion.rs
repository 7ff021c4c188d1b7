//! Writing an insertion: never one that reading would refuse.

use super::super::InsertionRun;
use super::super::schema::INSERTION_COLUMNS;
use super::{SessionWriter, enter};
use crate::document::table::Column;
use crate::document::{SessionError, number};
use std::path::Path;

impl SessionWriter {
    /// Writes a whole insertion: `<id>.csv` with the columns it has, and its entry in `session.toml`.
    ///
    /// # Errors
    /// As [`Self::lateral`]; [`SessionError::NotFinite`] and [`SessionError::OutOfRange`] for values that
    /// [`Session::read`](super::super::Session::read) would refuse: nothing is written then.
    pub fn insertion(&mut self, run: &InsertionRun) -> Result<(), SessionError> {
        self.check_id(&run.id, &self.insertion_ids)?;
        let path = self.dir.join(format!("{}.csv", run.id));
        let rows = run.rows(&path)?;
        self.whole_run(|session| {
            session.whole(path, &rows)?;
            enter(&session.dir, &insertion_entry(&run.id))
        })?;
        self.insertion_ids.push(run.id.clone());
        Ok(())
    }
}

/// Entry of an insertion.
pub(super) fn insertion_entry(id: &str) -> String {
    format!("\n[[insertion]]\nid = \"{id}\"\npath = \"{id}.csv\"\n")
}

impl InsertionRun {
    /// The text of its file, which is meant for this path.
    pub(super) fn rows(&self, path: &Path) -> Result<String, SessionError> {
        let columns: Vec<(&Column, &[f64])> =
            INSERTION_COLUMNS.iter().filter_map(|column| Some((column, self.column(column.name)?))).collect();
        let names: Vec<_> = columns.iter().map(|(column, _)| column.name).collect();
        let mut rows = format!("{}\n", names.join(","));
        for row in 0..self.depth_m.len() {
            self.check_row(row, path)?;
            for (at, (column, values)) in columns.iter().enumerate() {
                let value = values.get(row).copied().unwrap_or(f64::NAN);
                rows.push_str(if at > 0 { "," } else { "" });
                // A reading that is missing is an empty cell.
                if !(column.blank && value.is_nan()) {
                    rows.push_str(&number(path, column.name, value / column.to_si)?);
                }
            }
            rows.push('\n');
        }
        Ok(rows)
    }

    /// The values of a column of its file, in SI; `None` where it does not have them.
    fn column(&self, name: &str) -> Option<&[f64]> {
        match name {
            "depth_mm" => Some(&self.depth_m),
            "tip_y_mm" => Some(&self.tip_y_m),
            "tip_x_mm" => self.tip_x_m.as_deref(),
            "time_s" => self.time_s.as_deref(),
            "rotation_deg" => self.rotation_rad.as_deref(),
            "guide2_y_mm" => self.guide2_y_m.as_deref(),
            "guide2_x_mm" => self.guide2_x_m.as_deref(),
            "base_force_y_n" => self.base_force_y_n.as_deref(),
            "tip_direction_y_mrad" => self.tip_direction_y_rad.as_deref(),
            "tip_direction_x_mrad" => self.tip_direction_x_rad.as_deref(),
            _ => None,
        }
    }

    /// Rejects a row that would be invalid in the file at `path`.
    pub(in crate::session) fn check_row(&self, row: usize, path: &Path) -> Result<(), SessionError> {
        for column in &INSERTION_COLUMNS {
            let Some(values) = self.column(column.name) else { continue };
            let value = values.get(row).copied().unwrap_or(f64::NAN) / column.to_si;
            let [least, most] = column.range;
            if column.blank && value.is_nan() {
                continue;
            }
            let (path, field) = (path.to_owned(), column.name);
            if !value.is_finite() {
                return Err(SessionError::NotFinite { path, field });
            }
            // As it will be read: with the decimals it is written with.
            let value = (value * 1e9).round() / 1e9;
            if !(least..=most).contains(&value) {
                return Err(SessionError::OutOfRange { path, field, value, range: column.range });
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use crate::session::{InsertionRun, Noise, Session, SessionError, SessionWriter, Setup};
    use mechanics::{Needle, Rig};

    fn setup() -> Setup {
        let rig = Rig::two_guides(Needle::gauge_18(), 0.06, 0.07);
        let noise = Noise { tip_direction_rad: Some(0.8e-3), ..Noise::default() };
        Setup { name: String::new(), rig, fixture_mass_kg: None, noise, tissue: Default::default() }
    }

    fn run(depth_m: Vec<f64>) -> InsertionRun {
        let zeros = vec![0.0; depth_m.len()];
        InsertionRun { id: "i".to_owned(), tip_y_m: zeros, depth_m, ..InsertionRun::default() }
    }

    /// A depth of 50.5 mm before the surface cannot be read, and so it is not written either.
    #[test]
    fn rejects_a_row_that_reading_would_refuse_and_writes_nothing() {
        let dir = tempfile::tempdir().expect("a folder");
        let mut writer = SessionWriter::open(dir.path(), &setup()).expect("opens");
        let refused = writer.insertion(&run(vec![0.0, -50.5e-3]));
        assert!(
            matches!(refused, Err(SessionError::OutOfRange { field: "depth_mm", value, .. }) if value == -50.5),
            "{refused:?}"
        );
        let refused = writer.insertion(&run(vec![0.0, f64::NAN]));
        assert!(matches!(refused, Err(SessionError::NotFinite { field: "depth_mm", .. })), "{refused:?}");
        assert!(!dir.path().join("i.csv").exists());
        assert!(Session::read(dir.path()).expect("reads").insertion.is_empty());
    }

    #[test]
    fn tip_directions_and_their_noise_read_back_with_readings_missing() {
        let dir = tempfile::tempdir().expect("a folder");
        let mut writer = SessionWriter::open(dir.path(), &setup()).expect("opens");
        let mut single_run = run(vec![0.0, 1e-3, 2e-3]);
        single_run.tip_direction_x_rad = Some(vec![-0.0125, f64::NAN, 0.25]);
        writer.insertion(&single_run).expect("writes");
        let session = Session::read(dir.path()).expect("reads");
        assert_eq!(session.noise.tip_direction_rad, Some(0.8e-3));
        let read = &session.insertion[0];
        assert_eq!(read.tip_direction_y_rad, None);
        let x = read.tip_direction_x_rad.as_ref().expect("the horizontal direction");
        assert!((x[0] + 0.0125).abs() < 1e-12 && x[1].is_nan() && (x[2] - 0.25).abs() < 1e-12, "{x:?}");
    }
}
