//! Session files, format 1: a folder with `session.toml` and CSV files, readable with any tool.
//!
//! Files carry millimetres and newtons in the names of their fields; here everything is SI. Comments and column order
//! are free, unknown columns and fields are left alone, and every error names file, line, column, field and what was
//! expected.

mod block;
mod frames;
mod hardware;
pub mod import;
mod indenter;
mod labels;
mod lock;
mod read;
mod rig_model;
mod schema;
mod setup;
mod shape_doubt;
mod survey;
pub mod template;
mod tissue;
mod write;

pub use crate::document::{Place, Problem, SessionError, read_text};
pub use block::{WALL_FIELDS, Walls};
pub use frames::{FrameSweep, sweeps_file};
pub use indenter::Indenter;
pub use labels::{Covariate, Labels};
pub use setup::Setup;
pub use shape_doubt::ShapeDoubt;
pub use survey::Survey;
pub use tissue::{FoundationKind, Tissue};
pub use write::{FILE_NAME, ForceRow, LateralWriter, SessionFiles, SessionWriter, ShapeRow, is_file_name};

use mechanics::{Rig, ShapeImage};
use std::path::PathBuf;

/// Stretches of readings, of one each at least, in which a hold is found, and cut off at its two ends.
pub const HOLD_STRETCHES: [usize; 2] = [8, 2];
/// Rows of the shortest hold.
pub const LEAST_HOLD: usize = HOLD_STRETCHES[0] + HOLD_STRETCHES[1];
/// Insertion depths that a lateral run in tissue can have, least and greatest, millimetres. A run in air has depth 0.
pub const DEPTH_RANGE_MM: [f64; 2] = [0.5, 500.0];

/// Everything recorded with one needle, one rig and one piece of tissue.
#[derive(Debug, Clone, PartialEq)]
pub struct Session {
    /// Folder it was read from.
    pub dir: PathBuf,
    /// Its name, where it has one.
    pub name: Option<String>,
    /// Needle, guides and tissue surface.
    pub rig: Rig,
    /// Mass of the fixture that moves the needle's base in steering runs, where it is stated.
    pub fixture_mass_kg: Option<f64>,
    /// Standard deviations of the sensors, where they are stated.
    pub noise: Noise,
    /// Statements about the tissue.
    pub tissue: Tissue,
    /// Lateral runs.
    pub lateral: Vec<LateralRun>,
    /// Insertions.
    pub insertion: Vec<InsertionRun>,
    /// Independent indentation measurements.
    pub indentation: Vec<IndentationRun>,
    /// Dynamic runs.
    pub steering: Vec<SteeringRun>,
}

/// Stated standard deviation of a single reading of each sensor.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Noise {
    /// Lateral force.
    pub force_n: Option<f64>,
    /// Zero of the lateral force where no hold at zero displacement measures it.
    pub force_zero_n: Option<f64>,
    /// Displacement of guide 2.
    pub displacement_m: Option<f64>,
    /// Deflection of the needle in the tissue.
    pub shape_m: Option<f64>,
    /// Position of the tip.
    pub tip_m: Option<f64>,
    /// Slope of the needle at the tip.
    pub tip_direction_rad: Option<f64>,
}

/// A lateral run at one depth: guide 2 pushed sideways, force and shape measured.
#[derive(Debug, Clone, PartialEq)]
pub struct LateralRun {
    /// Its name.
    pub id: String,
    /// Length of the needle inside the tissue; 0 in air.
    pub depth_m: f64,
    /// File of the force series, for messages.
    pub force_path: PathBuf,
    /// File of the shape, for messages.
    pub shape_path: PathBuf,
    /// Recorder and rig, if they are stated.
    pub provenance: Provenance,
    /// Displacement and force against time.
    pub force: ForceSeries,
    /// Shape sweeps.
    pub shape: ShapeSeries,
}

impl LateralRun {
    /// Whether the needle is in nothing: such a run is about the rig alone.
    pub fn is_in_air(&self) -> bool {
        self.depth_m <= 0.0
    }
}

/// Recorder and rig of a run.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Provenance {
    /// Name of the device's calibration.
    pub calibration_id: Option<String>,
    /// Checksum of the device's calibration.
    pub calibration_crc: Option<u32>,
    /// Board of the device.
    pub device: Option<String>,
    /// Version of its firmware and the commit that was built.
    pub firmware: Option<String>,
    /// The force had been tared since the device started, or the run tared it.
    pub tared: Option<bool>,
}

impl Session {
    /// Its stated noise; that of shapes and displacements from the standard deviations of their points where runs have them, the largest of
    /// all runs.
    pub fn stated_noise(&self) -> Noise {
        let of_points_m = self.lateral.iter().filter_map(|run| run.shape.typical_sd_m()).reduce(f64::max);
        let of_rows_m =
            self.lateral.iter().filter_map(|run| run.force.typical_displacement_sd_m()).reduce(f64::max);
        Noise {
            shape_m: of_points_m.or(self.noise.shape_m),
            displacement_m: of_rows_m.or(self.noise.displacement_m),
            ..self.noise
        }
    }

    /// Number of a lateral run among those of the session, or of an insertion among the insertions, in the order of the file: 0 for the
    /// first, and for one that is not of this session.
    pub fn order_of(&self, id: &str) -> f64 {
        let lateral = self.lateral.iter().position(|run| run.id == id);
        lateral.or_else(|| self.insertion.iter().position(|run| run.id == id)).unwrap_or_default() as f64
    }

    /// The calibrations with which its lateral runs were recorded, each with its runs' ids, in order of appearance.
    pub fn calibrations(&self) -> Vec<(u32, Vec<&str>)> {
        let mut calibrations: Vec<(u32, Vec<&str>)> = Vec::new();
        for run in &self.lateral {
            let Some(crc) = run.provenance.calibration_crc else { continue };
            match calibrations.iter_mut().find(|(known, _)| *known == crc) {
                Some((_, ids)) => ids.push(&run.id),
                None => calibrations.push((crc, vec![&run.id])),
            }
        }
        calibrations
    }
}

/// Displacement of guide 2 and lateral force against increasing time; columns of equal length.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct ForceSeries {
    /// Time.
    pub time_s: Vec<f64>,
    /// Vertical displacement of guide 2.
    pub displacement_y_m: Vec<f64>,
    /// Vertical force.
    pub force_y_n: Vec<f64>,
    /// Horizontal displacement; there together with the horizontal force.
    pub displacement_x_m: Option<Vec<f64>>,
    /// Horizontal force.
    pub force_x_n: Option<Vec<f64>>,
    /// Standard deviation of each vertical displacement, where the file has it.
    pub displacement_y_sd_m: Option<Vec<f64>>,
    /// Standard deviation of each horizontal displacement.
    pub displacement_x_sd_m: Option<Vec<f64>>,
    /// Samples lost just before each row, where the recorder counted them.
    pub lost_before: Option<Vec<f64>>,
    /// State of the device at each row, if the recorder has it of any.
    pub marks: Option<Vec<Mark>>,
}

impl ForceSeries {
    /// Root mean square of the standard deviations of the displacements; nothing where the file has none.
    pub fn typical_displacement_sd_m(&self) -> Option<f64> {
        root_mean_square(self.displacement_y_sd_m.iter().chain(&self.displacement_x_sd_m).flatten())
    }
}

/// Root mean square; nothing of nothing.
fn root_mean_square<'a>(values: impl Iterator<Item = &'a f64>) -> Option<f64> {
    let (count, squares) =
        values.fold((0.0, 0.0), |(count, squares), value| (count + 1.0, squares + value * value));
    (count > 0.0).then(|| (squares / count).sqrt())
}

/// State of the device when a row was taken.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Mark {
    /// Step of the motion program; none outside a program.
    pub step: Option<u32>,
    /// Whether that step moves guide 2, where it is known.
    pub moving: Option<bool>,
}

/// Deflection of the needle at points of the shape sweeps; columns of equal length.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct ShapeSeries {
    /// Time of each point; without it the shape belongs to the last hold.
    pub time_s: Option<Vec<f64>>,
    /// Position along the needle from guide 1.
    pub z_m: Vec<f64>,
    /// Vertical deflection.
    pub y_m: Vec<f64>,
    /// Horizontal deflection.
    pub x_m: Option<Vec<f64>>,
    /// Standard deviation of each vertical deflection, where the file has it; points are independent.
    pub y_sd_m: Option<Vec<f64>>,
    /// Standard deviation of each horizontal deflection.
    pub x_sd_m: Option<Vec<f64>>,
    /// Image of each point, if the file has it.
    pub images: Option<Vec<ShapeImage>>,
    /// Standard deviation of an error of the positions that all points of the run share, at each point, where the file has it.
    pub z_shared_sd_m: Option<Vec<f64>>,
    /// Errors that all points of the run share, independent of each other: what one standard deviation of each does to the deflection at
    /// each point, vertical and horizontal, where the file has it. The straight needle, which is measured with an error itself, is in
    /// every deflection.
    pub shared_m: [[Option<Vec<f64>>; SHARED_ERRORS]; 2],
}

/// Errors in each plane that all points of a shape may share.
pub const SHARED_ERRORS: usize = 3;

impl ShapeSeries {
    /// Standard deviation of the shared error of the position of a point; 0 where none is stated.
    pub fn shared_sd_m(&self, index: usize) -> f64 {
        self.z_shared_sd_m.as_ref().and_then(|sd_m| sd_m.get(index)).copied().unwrap_or(0.0)
    }

    /// Deflection of a point by one standard deviation of each shared error, in each plane; 0 if none is stated.
    pub fn shared_errors_m(&self, index: usize) -> [[f64; SHARED_ERRORS]; 2] {
        fn value_at(column: Option<&Vec<f64>>, index: usize) -> f64 {
            column.and_then(|of| of.get(index)).copied().unwrap_or(0.0)
        }
        self.shared_m.each_ref().map(|plane| plane.each_ref().map(|column| value_at(column.as_ref(), index)))
    }

    /// Image of a point, if it is known.
    pub fn image(&self, index: usize) -> Option<ShapeImage> {
        self.images.as_ref()?.get(index).copied()
    }

    /// Root mean square of the standard deviations of the points; nothing where the file has none.
    pub fn typical_sd_m(&self) -> Option<f64> {
        root_mean_square(self.y_sd_m.iter().chain(&self.x_sd_m).flatten())
    }
}

/// An insertion: where the tip was at each depth; columns of equal length.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct InsertionRun {
    /// Its name.
    pub id: String,
    /// Its file, for messages.
    pub path: PathBuf,
    /// Insertion depth, in the order of recording.
    pub depth_m: Vec<f64>,
    /// Vertical tip position.
    pub tip_y_m: Vec<f64>,
    /// Horizontal tip position.
    pub tip_x_m: Option<Vec<f64>>,
    /// Time.
    pub time_s: Option<Vec<f64>>,
    /// Axial rotation of the needle.
    pub rotation_rad: Option<Vec<f64>>,
    /// Vertical displacement of guide 2.
    pub guide2_y_m: Option<Vec<f64>>,
    /// Horizontal displacement of guide 2.
    pub guide2_x_m: Option<Vec<f64>>,
    /// Vertical force at the base.
    pub base_force_y_n: Option<Vec<f64>>,
    /// Vertical slope of the needle at the tip, `du_y/dz`, as a direction sensor in the tip measures it; a constant tilt of the sensor in
    /// the needle is part of it. NaN in rows without a reading.
    pub tip_direction_y_rad: Option<Vec<f64>>,
    /// Horizontal slope of the needle at the tip.
    pub tip_direction_x_rad: Option<Vec<f64>>,
}

/// An indentation with a flat cylindrical punch, a sphere or a cone.
#[derive(Debug, Clone, PartialEq)]
pub struct IndentationRun {
    /// Its name.
    pub id: String,
    /// Its file, for messages.
    pub path: PathBuf,
    /// Form of the indenter.
    pub indenter: Indenter,
    /// Radius of the punch or the sphere; 0 for a cone of which none is stated.
    pub indenter_radius_m: f64,
    /// Angle between the axis of a cone and its side.
    pub half_angle_rad: Option<f64>,
    /// Thickness of the tissue on a rigid base, where it is stated.
    pub tissue_thickness_m: Option<f64>,
    /// Poisson's ratio of the tissue.
    pub poisson: f64,
    /// Indentation depth.
    pub depth_m: Vec<f64>,
    /// Axial force.
    pub force_n: Vec<f64>,
}

/// A dynamic run of the online estimator; columns of equal length.
#[derive(Debug, Clone, PartialEq)]
pub struct SteeringRun {
    /// Its name.
    pub id: String,
    /// Its file, for messages.
    pub path: PathBuf,
    /// Increasing time.
    pub time_s: Vec<f64>,
    /// Insertion depth.
    pub depth_m: Vec<f64>,
    /// Lateral position of the base.
    pub base_y_m: Vec<f64>,
    /// Lateral force at the base.
    pub base_force_y_n: Vec<f64>,
    /// Lateral position of the tip.
    pub tip_y_m: Vec<f64>,
}

#[cfg(test)]
mod tests;
