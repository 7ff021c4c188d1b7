//! Entering a lateral run that was recorded elsewhere: its force series as it is, its shape with the columns it has.

use super::super::schema::SHARED_COLUMNS;
use super::super::{ForceSeries, InsertionRun, LateralRun, Setup, ShapeSeries};
use super::insertion::insertion_entry;
use super::{SessionWriter, check_name, enter};
use crate::document::{Place, Problem, SessionError, number, read_text, replace};
use crate::foreign::zeros_among_forces;
use mechanics::ShapeImage;
use std::path::Path;

/// A force series of which there is nothing yet.
const NO_FORCE: &str = "time_s,displacement_y_mm,force_y_n\n";
/// A shape of which there is nothing yet.
const NO_SHAPE: &str = "z_mm,deflection_y_mm\n";

impl SessionWriter {
    /// Writes a whole lateral run: `<id>.force.csv`, a copy of `force` where it is given and else a header without rows, to be filled in;
    /// `<id>.shape.csv`; and its entry in `session.toml`.
    ///
    /// # Errors
    /// As [`Self::lateral`]; [`SessionError::NotFinite`]; where `force` cannot be read, or has zeros that are no readings.
    pub fn lateral_from(
        &mut self,
        id: &str,
        depth_m: f64,
        force: Option<&Path>,
        shape: &ShapeSeries,
    ) -> Result<(), SessionError> {
        self.check_id(id, &self.lateral_ids)?;
        let session_file = self.dir.join("session.toml");
        let depth_mm = number(&session_file, "depth_mm", 1e3 * depth_m)?;
        if let Some((path, (line, field, words))) =
            force.and_then(|path| Some((path, zeros_among_forces(path)?)))
        {
            return Err(SessionError::Field {
                place: Place { path: path.to_owned(), line, column: 1 },
                field,
                problem: Problem::Syntax(words),
                expected:
                    "readings: such zeros are marks of missing ones, which `guide import table` leaves out"
                        .to_owned(),
            });
        }
        let rows = force.map_or_else(|| Ok(NO_FORCE.to_owned()), read_text)?;
        let columns = shape_columns(shape);
        let entry = lateral_entry(id, &depth_mm);
        self.whole_run(|session| {
            session.whole(session.dir.join(format!("{id}.force.csv")), &rows)?;
            session.table(&format!("{id}.shape"), &columns)?;
            enter(&session.dir, &entry)
        })?;
        self.lateral_ids.push(id.to_owned());
        Ok(())
    }

    /// Gives a lateral run that the session has another shape: `<id>.shape.csv` is replaced as a whole.
    ///
    /// # Errors
    /// [`SessionError::NotFinite`], or an error of the operating system.
    pub fn reshape(&mut self, run: &LateralRun, shape: &ShapeSeries) -> Result<(), SessionError> {
        let rows = Self::rows(&run.shape_path, &shape_columns(shape))?;
        replace(&run.shape_path, &rows)
    }

    /// Writes a lateral run whose shape is not measured yet: `<id>.force.csv` with the columns that the series has,
    /// `<id>.shape.csv` with a header only, to be filled in, and its entry in `session.toml`.
    ///
    /// # Errors
    /// As [`Self::lateral`]; [`SessionError::NotFinite`].
    pub fn lateral_force(&mut self, id: &str, depth_m: f64, force: &ForceSeries) -> Result<(), SessionError> {
        self.lateral_series(id, depth_m, force, None)
    }

    /// As [`Self::lateral_force`], with the shape where it is measured.
    ///
    /// # Errors
    /// As [`Self::lateral`]; [`SessionError::NotFinite`].
    pub fn lateral_series(
        &mut self,
        id: &str,
        depth_m: f64,
        force: &ForceSeries,
        shape: Option<&ShapeSeries>,
    ) -> Result<(), SessionError> {
        self.check_id(id, &self.lateral_ids)?;
        let session_file = self.dir.join("session.toml");
        let depth_mm = number(&session_file, "depth_mm", 1e3 * depth_m)?;
        let columns = force_columns(force);
        let entry = lateral_entry(id, &depth_mm);
        self.whole_run(|session| {
            session.table(&format!("{id}.force"), &columns)?;
            match shape {
                Some(shape) => session.table(&format!("{id}.shape"), &shape_columns(shape))?,
                None => session.whole(session.dir.join(format!("{id}.shape.csv")), NO_SHAPE)?,
            }
            enter(&session.dir, &entry)
        })?;
        self.lateral_ids.push(id.to_owned());
        Ok(())
    }
}

/// Files of a session that is kept elsewhere than in a folder: names and texts.
pub type SessionFiles = Vec<(String, String)>;

impl Setup {
    /// The files of a new session with one lateral run, as [`SessionWriter::lateral_series`] writes them.
    ///
    /// # Errors
    /// [`SessionError::Id`] where the id cannot be part of a file name; [`SessionError::NotFinite`].
    pub fn with_lateral(
        &self,
        id: &str,
        depth_m: f64,
        force: &ForceSeries,
        shape: Option<&ShapeSeries>,
    ) -> Result<SessionFiles, SessionError> {
        let (session, force_file, shape_file) =
            (Path::new("session.toml"), format!("{id}.force.csv"), format!("{id}.shape.csv"));
        check_name(session, id)?;
        let depth_mm = number(session, "depth_mm", 1e3 * depth_m)?;
        let force_rows = SessionWriter::rows(Path::new(&force_file), &force_columns(force))?;
        let shape_rows = match shape {
            Some(shape) => SessionWriter::rows(Path::new(&shape_file), &shape_columns(shape))?,
            None => NO_SHAPE.to_owned(),
        };
        let text = self.to_toml(session)? + &lateral_entry(id, &depth_mm);
        Ok(vec![("session.toml".to_owned(), text), (force_file, force_rows), (shape_file, shape_rows)])
    }

    /// The files of a new session with one insertion, as [`SessionWriter::insertion`] writes them.
    ///
    /// # Errors
    /// As [`SessionWriter::insertion`].
    pub fn with_insertion(&self, run: &InsertionRun) -> Result<SessionFiles, SessionError> {
        let (session, file) = (Path::new("session.toml"), format!("{}.csv", run.id));
        check_name(session, &run.id)?;
        let rows = run.rows(Path::new(&file))?;
        let text = self.to_toml(session)? + &insertion_entry(&run.id);
        Ok(vec![("session.toml".to_owned(), text), (file, rows)])
    }
}

/// A column: name, values, factor into the file's unit.
type NamedColumn = (&'static str, Vec<f64>, f64);

/// The columns that a force series has.
fn force_columns(force: &ForceSeries) -> Vec<NamedColumn> {
    [
        Some(("time_s", force.time_s.clone(), 1.0)),
        Some(("displacement_y_mm", force.displacement_y_m.clone(), 1e3)),
        Some(("force_y_n", force.force_y_n.clone(), 1.0)),
        force.displacement_x_m.clone().map(|values| ("displacement_x_mm", values, 1e3)),
        force.force_x_n.clone().map(|values| ("force_x_n", values, 1.0)),
        force.displacement_y_sd_m.clone().map(|values| ("displacement_y_sd_mm", values, 1e3)),
        force.displacement_x_sd_m.clone().map(|values| ("displacement_x_sd_mm", values, 1e3)),
        force.lost_before.clone().map(|values| ("lost_before", values, 1.0)),
    ]
    .into_iter()
    .flatten()
    .collect()
}

/// The columns that a shape has.
fn shape_columns(shape: &ShapeSeries) -> Vec<NamedColumn> {
    let images = shape.images.as_ref();
    let of_images =
        |of: fn(&ShapeImage) -> f64| images.map(|images| images.iter().map(of).collect::<Vec<_>>());
    fn named(name: &'static str, values: Option<Vec<f64>>, factor: f64) -> Option<NamedColumn> {
        values.map(|values| (name, values, factor))
    }
    let shared = SHARED_COLUMNS.iter().flatten().zip(shape.shared_m.iter().flatten());
    let shared = shared.map(|(name, values)| named(name, values.clone(), 1e3));
    let columns = [
        named("time_s", shape.time_s.clone(), 1.0),
        named("z_mm", Some(shape.z_m.clone()), 1e3),
        named("deflection_y_mm", Some(shape.y_m.clone()), 1e3),
        named("deflection_x_mm", shape.x_m.clone(), 1e3),
        named("deflection_y_sd_mm", shape.y_sd_m.clone(), 1e3),
        named("deflection_x_sd_mm", shape.x_sd_m.clone(), 1e3),
        named("beam_deg", of_images(|image| image.beam_rad.to_degrees()), 1.0),
        named("probe_mm_per_s", of_images(|image| image.probe_m_per_s), 1e3),
        named("z_shared_sd_mm", shape.z_shared_sd_m.clone(), 1e3),
    ];
    columns.into_iter().chain(shared).flatten().collect()
}

/// Entry of a lateral run.
fn lateral_entry(id: &str, depth_mm: &str) -> String {
    format!(
        "\n[[lateral]]\nid = \"{id}\"\ndepth_mm = {depth_mm}\nforce = \"{id}.force.csv\"\nshape = \"{id}.shape.csv\"\n"
    )
}
