//! Reading a session.

use super::hardware::{fixture_mass_kg, noise, rig};
use super::schema::{
    FORCE_COLUMNS, HALF_ANGLE_DEG, INDENTATION_COLUMNS, INSERTION_COLUMNS, POISSON, RADIUS_MM, SHAPE_COLUMNS,
    SHARED_COLUMNS, STEERING_COLUMNS, THICKNESS_MM,
};
use super::{
    DEPTH_RANGE_MM, ForceSeries, IndentationRun, Indenter, InsertionRun, Labels, LateralRun, Mark,
    Provenance, Session, ShapeSeries, SteeringRun, Tissue,
};
use crate::document::table::{Clock, Table};
use crate::document::{Fields, Place, Problem, SessionError, read_text};
use crate::foreign::{ONE_ZERO, new_zero_among_forces};
use mechanics::ShapeImage;
use std::collections::HashSet;
use std::path::Path;

const MM: f64 = 1e-3;

impl Session {
    /// Reads `session.toml` in `dir` and all files it names.
    ///
    /// # Errors
    /// [`SessionError`] for the first fault found, with its place.
    pub fn read(dir: &Path) -> Result<Self, SessionError> {
        let path = dir.join("session.toml");
        let text = read_text(&path)?;
        Fields::parse(&path, &text, |file| {
            let session = file.table("session")?;
            session.format()?;
            Labels::of(file)?;
            Ok(Self {
                dir: dir.to_owned(),
                name: session.optional_text("name")?,
                rig: rig(file)?,
                fixture_mass_kg: fixture_mass_kg(file)?,
                noise: noise(file)?,
                tissue: Tissue::read(file)?,
                lateral: runs(file, "lateral", |fields, id| lateral(dir, fields, id))?,
                insertion: runs(file, "insertion", |fields, id| insertion(dir, fields, id))?,
                indentation: runs(file, "indentation", |fields, id| indentation(dir, fields, id))?,
                steering: runs(file, "steering", |fields, id| steering(dir, fields, id))?,
            })
        })
    }
}

/// The runs of one kind; their ids are unique.
fn runs<T>(
    file: &Fields<'_>,
    kind: &'static str,
    read: impl Fn(&Fields<'_>, String) -> Result<T, SessionError>,
) -> Result<Vec<T>, SessionError> {
    let mut ids = HashSet::new();
    let mut runs = Vec::new();
    for fields in file.tables(kind)? {
        let id = fields.text("id")?;
        if !ids.insert(id.clone()) {
            return Err(fields.field_fault("id", Problem::Duplicate(id), "one run per id"));
        }
        runs.push(read(&fields, id)?);
    }
    Ok(runs)
}

/// Depth of a lateral run; 0 in air.
pub(super) fn depth_mm(fields: &Fields<'_>) -> Result<f64, SessionError> {
    fields.number_or_zero("depth_mm", DEPTH_RANGE_MM)
}

pub(super) fn lateral(dir: &Path, fields: &Fields<'_>, id: String) -> Result<LateralRun, SessionError> {
    let depth_m = MM * depth_mm(fields)?;
    // The shape is on the clock of the force.
    let (force_path, (force, origin_s)) = fields.file(dir, "force", |path| {
        let table = Table::read_recording_on(path, &FORCE_COLUMNS, Clock::FromFirst)?;
        let origin_s = table.origin_s;
        Ok((ForceSeries::of(path, table)?, origin_s))
    })?;
    let (shape_path, shape) = fields.file(dir, "shape", |path| {
        ShapeSeries::of(path, Table::read_recording_on(path, &SHAPE_COLUMNS, Clock::From(origin_s))?)
    })?;
    let provenance = provenance(fields)?;
    Ok(LateralRun { id, depth_m, force_path, shape_path, provenance, force, shape })
}

impl ForceSeries {
    /// Reads the force series of a lateral run.
    ///
    /// # Errors
    /// [`SessionError`] for the first fault found, with its place.
    pub fn read(path: &Path) -> Result<Self, SessionError> {
        Self::of(path, Table::read_recording(path, &FORCE_COLUMNS)?)
    }

    /// Whole seconds that are subtracted from the times of a run with this force series where a session is read: those of its first row where
    /// it is on a computer's clock, else 0.
    ///
    /// # Errors
    /// As [`Self::read`].
    pub fn clock_origin_s(path: &Path) -> Result<f64, SessionError> {
        Ok(Table::read_recording_on(path, &FORCE_COLUMNS, Clock::FromFirst)?.origin_s as f64)
    }

    /// Reads the series of a force sensor alone: a file as of a lateral run whose columns of displacement may be missing, and are 0 then.
    ///
    /// # Errors
    /// As [`Self::read`].
    pub fn read_without_displacement(path: &Path) -> Result<Self, SessionError> {
        let mut columns = FORCE_COLUMNS;
        for column in &mut columns {
            column.required &= column.name != "displacement_y_mm";
        }
        let mut table = Table::read_recording(path, &columns)?;
        let rows = table.rows();
        for (displacement, force) in [("displacement_y_mm", "force_y_n"), ("displacement_x_mm", "force_x_n")]
        {
            if table.has(force) && !table.has(displacement) {
                table.add(displacement, vec![0.0; rows]);
            }
        }
        Self::of(path, table)
    }

    fn of(path: &Path, mut table: Table) -> Result<Self, SessionError> {
        if let Some((line, field, words)) = new_zero_among_forces(path) {
            return Err(SessionError::Field {
                place: Place { path: path.to_owned(), line, column: 1 },
                field,
                problem: Problem::Syntax(words),
                expected: ONE_ZERO.to_owned(),
            });
        }
        let marks = marks(table.take("step"), table.take("moving"));
        let force = Self {
            time_s: table.take_required("time_s"),
            displacement_y_m: table.take_required("displacement_y_mm"),
            force_y_n: table.take_required("force_y_n"),
            displacement_x_m: table.take("displacement_x_mm"),
            force_x_n: table.take("force_x_n"),
            displacement_y_sd_m: table.take("displacement_y_sd_mm"),
            displacement_x_sd_m: table.take("displacement_x_sd_mm"),
            lost_before: table.take("lost_before"),
            marks,
        };
        let (missing, present) = match (&force.displacement_x_m, &force.force_x_n) {
            (None, Some(_)) => ("displacement_x_mm", "force_x_n"),
            (Some(_), None) => ("force_x_n", "displacement_x_mm"),
            _ => return Ok(force),
        };
        Err(without_partner(path, &table, missing, present))
    }
}

impl ShapeSeries {
    /// Reads the shape of a lateral run.
    ///
    /// # Errors
    /// [`SessionError`] for the first fault found, with its place.
    pub fn read(path: &Path) -> Result<Self, SessionError> {
        Self::of(path, Table::read_recording(path, &SHAPE_COLUMNS)?)
    }

    /// Reads a shape of at least one point from a text; `name` is what messages call it.
    ///
    /// # Errors
    /// As [`Self::read`].
    pub fn parse(name: &Path, text: &str) -> Result<Self, SessionError> {
        Self::of(name, Table::parse(name, text, &SHAPE_COLUMNS, 1)?)
    }

    fn of(path: &Path, mut shape: Table) -> Result<Self, SessionError> {
        let images = match (shape.take("beam_deg"), shape.take("probe_mm_per_s")) {
            (Some(beam), Some(probe)) => {
                let both_bendings = beam.into_iter().zip(probe);
                Some(
                    both_bendings
                        .map(|(beam_rad, probe_m_per_s)| ShapeImage { beam_rad, probe_m_per_s })
                        .collect(),
                )
            }
            (None, None) => None,
            (None, _) => return Err(without_partner(path, &shape, "beam_deg", "probe_mm_per_s")),
            (_, None) => return Err(without_partner(path, &shape, "probe_mm_per_s", "beam_deg")),
        };
        Ok(Self {
            time_s: shape.take("time_s"),
            z_m: shape.take_required("z_mm"),
            y_m: shape.take_required("deflection_y_mm"),
            x_m: shape.take("deflection_x_mm"),
            y_sd_m: shape.take("deflection_y_sd_mm"),
            x_sd_m: shape.take("deflection_x_sd_mm"),
            images,
            z_shared_sd_m: shape.take("z_shared_sd_mm"),
            shared_m: SHARED_COLUMNS.map(|of_plane| of_plane.map(|name| shape.take(name))),
        })
    }
}

/// A column is missing that has a meaning only beside another one, or is the meaning of it.
fn without_partner(path: &Path, table: &Table, missing: &str, beside: &str) -> SessionError {
    SessionError::Field {
        place: super::Place { path: path.to_owned(), line: table.header_line, column: 1 },
        field: missing.to_owned(),
        problem: Problem::Missing,
        expected: format!("both columns or none, as there is {beside}"),
    }
}

/// Marks of the rows; none where no row has a step.
fn marks(step: Option<Vec<f64>>, moving: Option<Vec<f64>>) -> Option<Vec<Mark>> {
    let step = step.filter(|step| !step.iter().all(|step| step.is_nan()))?;
    let moving = moving.unwrap_or_default().into_iter().map(Some).chain(std::iter::repeat(None));
    let marks = step.into_iter().zip(moving).map(|(step, moving)| Mark {
        step: (!step.is_nan()).then_some(step as u32),
        moving: moving.filter(|moving| !moving.is_nan()).map(|moving| moving != 0.0),
    });
    Some(marks.collect())
}

pub(super) fn provenance(fields: &Fields<'_>) -> Result<Provenance, SessionError> {
    const CRC: &str = "calibration_crc";
    let crc = fields.optional_text(CRC)?.map(|text| {
        let digits = text.len() == 8 && text.bytes().all(|byte| byte.is_ascii_hexdigit());
        let crc = digits.then(|| u32::from_str_radix(&text, 16).ok()).flatten();
        crc.ok_or_else(|| {
            let problem = Problem::Syntax(format!("\"{}\"", text.chars().take(40).collect::<String>()));
            fields.field_fault(CRC, problem, "eight hexadecimal digits")
        })
    });
    Ok(Provenance {
        calibration_id: fields.optional_text("calibration_id")?,
        calibration_crc: crc.transpose()?,
        device: fields.optional_text("device")?,
        firmware: fields.optional_text("firmware")?,
        tared: fields.optional_flag("tared")?,
    })
}

pub(super) fn insertion(dir: &Path, fields: &Fields<'_>, id: String) -> Result<InsertionRun, SessionError> {
    let (path, mut table) = fields.file(dir, "path", |path| Table::read(path, &INSERTION_COLUMNS))?;
    Ok(InsertionRun {
        id,
        path,
        depth_m: table.take_required("depth_mm"),
        tip_y_m: table.take_required("tip_y_mm"),
        tip_x_m: table.take("tip_x_mm"),
        time_s: table.take("time_s"),
        rotation_rad: table.take("rotation_deg"),
        guide2_y_m: table.take("guide2_y_mm"),
        guide2_x_m: table.take("guide2_x_mm"),
        base_force_y_n: table.take("base_force_y_n"),
        tip_direction_y_rad: table.take("tip_direction_y_mrad"),
        tip_direction_x_rad: table.take("tip_direction_x_mrad"),
    })
}

pub(super) fn indentation(
    dir: &Path,
    fields: &Fields<'_>,
    id: String,
) -> Result<IndentationRun, SessionError> {
    let indenter = match fields.optional_text("indenter")? {
        None => Indenter::default(),
        Some(name) => {
            Indenter::ALL.into_iter().find(|indenter| indenter.name() == name).ok_or_else(|| {
                fields.field_fault("indenter", Problem::Unknown(name), "\"flat\", \"sphere\" or \"cone\"")
            })?
        }
    };
    // A cone has an angle in place of a radius.
    let half_angle_deg = match indenter {
        Indenter::Cone => Some(fields.number("indenter_half_angle_deg", HALF_ANGLE_DEG)?),
        Indenter::Flat | Indenter::Sphere => None,
    };
    let indenter_radius_m = MM
        * match half_angle_deg {
            None => fields.number("indenter_radius_mm", RADIUS_MM)?,
            Some(_) => fields.optional_number("indenter_radius_mm", RADIUS_MM)?.unwrap_or(0.0),
        };
    let tissue_thickness_m =
        fields.optional_number("tissue_thickness_mm", THICKNESS_MM)?.map(|thickness_mm| MM * thickness_mm);
    let poisson = fields.number("poisson", POISSON)?;
    let (path, mut table) = fields.file(dir, "data", |path| Table::read(path, &INDENTATION_COLUMNS))?;
    let (depth_m, force_n) = (table.take_required("depth_mm"), table.take_required("force_n"));
    Ok(IndentationRun {
        id,
        path,
        indenter,
        indenter_radius_m,
        half_angle_rad: half_angle_deg.map(f64::to_radians),
        tissue_thickness_m,
        poisson,
        depth_m,
        force_n,
    })
}

pub(super) fn steering(dir: &Path, fields: &Fields<'_>, id: String) -> Result<SteeringRun, SessionError> {
    let (path, mut table) = fields.file(dir, "data", |path| Table::read(path, &STEERING_COLUMNS))?;
    Ok(SteeringRun {
        id,
        path,
        time_s: table.take_required("time_s"),
        depth_m: table.take_required("depth_mm"),
        base_y_m: table.take_required("base_y_mm"),
        base_force_y_n: table.take_required("base_force_y_n"),
        tip_y_m: table.take_required("tip_y_mm"),
    })
}
