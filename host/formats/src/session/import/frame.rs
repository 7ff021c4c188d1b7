//! From a needle's points in some frame of space to the session's: along the straight needle, and away from it.

use crate::session::write::is_device;
use crate::session::{ShapeSeries, is_file_name};
use nalgebra::{Matrix3, Vector3};
use std::path::{Path, PathBuf};

/// Fewest points of a shape.
const MIN_POINTS: usize = 3;
/// The vertical has to differ from the needle's direction by this, as the sine of the angle.
const MIN_SINE: f64 = 0.1;
/// Limits of a session's shape: position along the needle and deflection, metres.
const Z_M: [f64; 2] = [0.0, 2.0];
const MAX_DEFLECTION_M: f64 = 0.2;

/// A needle's points, in the order of the file, from the base to the tip.
#[derive(Debug, Clone, PartialEq)]
pub struct NeedlePoints {
    /// The file, for messages.
    pub path: PathBuf,
    /// Positions in the frame of the file, metres.
    pub points_m: Vec<[f64; 3]>,
    /// Notes for people on assumed or skipped content.
    pub notes: Vec<String>,
}

/// Why points are no shape of a needle under a guide.
#[derive(Debug, thiserror::Error)]
pub enum FrameError {
    /// A line has no direction.
    #[error("{}: {found} different points to take the needle's direction from, expected 2 or more", path.display())]
    NoDirection {
        /// The file.
        path: PathBuf,
        /// Points there.
        found: usize,
    },
    /// A direction of no length.
    #[error("{name}: {given:?}, expected a direction: three numbers that are not all zero")]
    Zero {
        /// Name of the option.
        name: &'static str,
        /// Text that was given.
        given: [f64; 3],
    },
    /// The vertical along the needle.
    #[error("up: {up:?} is along the needle, expected a direction across it")]
    UpAlongAxis {
        /// Text that was given.
        up: [f64; 3],
    },
    /// Hardly any point.
    #[error("{}: {found} points beyond guide 1, expected {MIN_POINTS} or more", path.display())]
    TooFew {
        /// The file.
        path: PathBuf,
        /// Points there.
        found: usize,
    },
    /// No needle is there.
    #[error("{}: point {number} is {off_mm:.1} mm off the straight needle, {z_mm:.1} mm from guide 1, expected at most 200 mm off and \
             2000 mm from it: do origin and axis fit this file?", path.display())]
    FarOff {
        /// The file.
        path: PathBuf,
        /// Number of the point, from 1.
        number: usize,
        /// Distance from the axis.
        off_mm: f64,
        /// Position along it.
        z_mm: f64,
    },
}

/// Position and direction of the straight needle in the frame of the file.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Straight {
    /// A point of it, metres; the first point of the shape where there is none.
    pub origin_m: Option<[f64; 3]>,
    /// Position of that point along the needle from guide 1, metres.
    pub origin_z_m: f64,
    /// Its direction, from base to tip.
    pub axis: Axis,
    /// The directions that may be up, best first: the first one that is not along the needle is.
    pub up: [[f64; 3]; 2],
}

/// Direction of the straight needle.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Axis {
    /// Known.
    Given([f64; 3]),
    /// Direction of a line through the first part of the shape, of this length, metres.
    Fitted(f64),
}

/// The session's frame in that of a file.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Frame {
    origin_m: Vector3<f64>,
    origin_z_m: f64,
    z: Vector3<f64>,
    y: Vector3<f64>,
    x: Vector3<f64>,
}

impl Frame {
    /// The frame in which `first`, and all other shapes of the same needle in the same place, are given.
    ///
    /// # Errors
    /// [`FrameError`] where there is no such frame.
    pub fn new(straight: &Straight, first: &NeedlePoints) -> Result<Self, FrameError> {
        let begins = Vector3::from(*first.points_m.first().ok_or_else(|| FrameError::NoDirection {
            path: first.path.clone(),
            found: first.points_m.len(),
        })?);
        let (z, on_line) = match straight.axis {
            Axis::Given(axis) => {
                let unit = Vector3::from(axis).try_normalize(1e-12);
                (unit.ok_or(FrameError::Zero { name: "axis", given: axis })?, begins)
            }
            Axis::Fitted(length_m) => line(first, length_m)?,
        };
        let origin_m = straight.origin_m.map_or_else(
            // The point of the line nearest to where the shape begins.
            || on_line + z * z.dot(&(begins - on_line)),
            Vector3::from,
        );
        Self::along(origin_m, straight.origin_z_m, z, &straight.up)
    }

    /// The frame of a straight needle that is known: a point of it and where that is along the needle from guide 1, its direction,
    /// and the direction that is up.
    ///
    /// # Errors
    /// [`FrameError::Zero`], [`FrameError::UpAlongAxis`].
    pub fn given(
        origin_m: [f64; 3],
        origin_z_m: f64,
        axis: [f64; 3],
        up: [f64; 3],
    ) -> Result<Self, FrameError> {
        let unit = Vector3::from(axis).try_normalize(1e-12);
        let z = unit.ok_or(FrameError::Zero { name: "axis", given: axis })?;
        Self::along(origin_m.into(), origin_z_m, z, &[up])
    }

    fn along(
        origin_m: Vector3<f64>,
        origin_z_m: f64,
        z: Vector3<f64>,
        ups: &[[f64; 3]],
    ) -> Result<Self, FrameError> {
        let stated_up = ups.first().copied().unwrap_or_default();
        let y = ups
            .iter()
            .find_map(|stated_up| {
                let unit = Vector3::from(*stated_up).try_normalize(1e-12)?;
                let perpendicular = unit - z * z.dot(&unit);
                (perpendicular.norm() > MIN_SINE).then(|| perpendicular.normalize())
            })
            .ok_or(FrameError::UpAlongAxis { up: stated_up })?;
        Ok(Self { origin_m, origin_z_m, z, y, x: y.cross(&z) })
    }

    /// A point in the session's frame: along the needle from guide 1, and its deflection along y and x, metres.
    pub fn point(&self, point_m: [f64; 3]) -> [f64; 3] {
        let from_origin = Vector3::from(point_m) - self.origin_m;
        [self.origin_z_m + self.z.dot(&from_origin), self.y.dot(&from_origin), self.x.dot(&from_origin)]
    }

    /// Whether a point in the session's frame can be one of a needle under a guide, be it behind guide 1.
    pub fn is_near([z_m, y_m, x_m]: [f64; 3]) -> bool {
        z_m <= Z_M[1] && y_m.abs() <= MAX_DEFLECTION_M && x_m.abs() <= MAX_DEFLECTION_M
    }

    /// A shape in the session's frame, and how many of its points are behind guide 1 and skipped.
    ///
    /// # Errors
    /// [`FrameError`] where these points are on no needle under this guide.
    pub fn shape(&self, needle: &NeedlePoints) -> Result<(ShapeSeries, usize), FrameError> {
        let (mut shape, mut x_m, mut points_behind) = (ShapeSeries::default(), Vec::new(), 0);
        for (index, point_m) in needle.points_m.iter().enumerate() {
            let [z_m, off_y_m, off_x_m] = self.point(*point_m);
            if !Self::is_near([z_m, off_y_m, off_x_m]) {
                return Err(FrameError::FarOff {
                    path: needle.path.clone(),
                    number: index + 1,
                    off_mm: 1e3 * off_y_m.hypot(off_x_m),
                    z_mm: 1e3 * z_m,
                });
            }
            if z_m < Z_M[0] {
                points_behind += 1;
                continue;
            }
            shape.z_m.push(z_m);
            shape.y_m.push(off_y_m);
            x_m.push(off_x_m);
        }
        if shape.z_m.len() < MIN_POINTS {
            return Err(FrameError::TooFew { path: needle.path.clone(), found: shape.z_m.len() });
        }
        shape.x_m = Some(x_m);
        Ok((shape, points_behind))
    }

    /// Origin in metres, axis, up, in the frame of the file.
    pub fn parts(&self) -> [[f64; 3]; 3] {
        [self.origin_m, self.z, self.y].map(Into::into)
    }
}

/// Direction of, and a point on, the line through the first part of a shape.
fn line(needle: &NeedlePoints, length_m: f64) -> Result<(Vector3<f64>, Vector3<f64>), FrameError> {
    let points: Vec<Vector3<f64>> = needle.points_m.iter().copied().map(Vector3::from).collect();
    let mut path_length_m = 0.0;
    let mut count = points.len().min(1);
    for (from, to) in points.iter().zip(points.iter().skip(1)) {
        path_length_m += (to - from).norm();
        // The two first points always count: a curve may have long steps.
        if path_length_m > length_m * (1.0 + 1e-9) && count >= 2 {
            break;
        }
        count += 1;
    }
    let used_points = points.get(..count).unwrap_or_default();
    let mean = used_points.iter().sum::<Vector3<f64>>() / count.max(1) as f64;
    let spread: Matrix3<f64> =
        used_points.iter().map(|point| (point - mean) * (point - mean).transpose()).sum();
    let eigen = spread.symmetric_eigen();
    let longest = eigen.eigenvectors.column(eigen.eigenvalues.imax()).into_owned();
    let chord =
        used_points.last().zip(used_points.first()).map_or_else(Vector3::zeros, |(last, first)| last - first);
    let towards_tip = longest * longest.dot(&chord).signum();
    let unit = towards_tip
        .try_normalize(1e-12)
        .filter(|_| chord.norm() > 1e-9)
        .ok_or_else(|| FrameError::NoDirection { path: needle.path.clone(), found: count })?;
    Ok((unit, mean))
}

/// Id of a run made from a file: the name of the file without its ending, with letters, digits, `-`, `_` and `.` for what else is in it.
pub fn id_of(path: &Path) -> String {
    let mut id = String::new();
    for letter in name_of(path).chars() {
        match letter {
            'ä' => id.push_str("ae"),
            'ö' => id.push_str("oe"),
            'ü' => id.push_str("ue"),
            'Ä' => id.push_str("Ae"),
            'Ö' => id.push_str("Oe"),
            'Ü' => id.push_str("Ue"),
            'ß' => id.push_str("ss"),
            letter if is_file_name(letter.encode_utf8(&mut [0; 4])) || letter == '.' => id.push(letter),
            _ if id.ends_with('-') => {}
            _ => id.push('-'),
        }
    }
    let id: String = id.trim_matches(['-', '.']).chars().take(100).collect();
    match id.as_str() {
        "" => "run".to_owned(),
        device if is_device(device) => format!("run-{device}").chars().take(100).collect(),
        _ => id,
    }
}

/// Name of a file without its ending.
pub fn name_of(path: &Path) -> String {
    let name = path.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
    let stem = name.strip_suffix(".mrk.json").or_else(|| name.rsplit_once('.').map(|(stem, _)| stem));
    stem.filter(|stem| !stem.is_empty()).unwrap_or(&name).to_owned()
}
