//! The force sensor's matrix from known loads.
//!
//! The loads are known and the readings have noise, so that reported forces are regressed on loads: `reported = B load +
//! offset`. The new matrix is `B^-1` times the former one. The offset is the untared part of the zero.

use super::{CalibrateError, Estimate, WorstReading};
use nalgebra::{DMatrix, Matrix2, Matrix3, SymmetricEigen, Vector2};
use protocol::CalibrationRecord;

/// Unknowns of a channel: a response to each load, and an offset.
const UNKNOWNS: usize = 3;
/// Least share of the loads' variation that lies across their main direction.
const ACROSS_SHARE: f64 = 0.05;
/// Least determinant of reported over true forces.
const LEAST_DETERMINANT: f64 = 1e-3;

/// One known load and the force that the device reported under it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ForceReading {
    /// True force on the sensor along x and y, newtons.
    pub load_n: [f64; 2],
    /// Reported force along x and y, newtons.
    pub reported_n: [f64; 2],
}

/// Calibration that the readings determine.
#[derive(Debug, Clone, PartialEq)]
pub struct ForceFit {
    /// Reported over true force; rows: reported x, y; columns: load along x, y. The unit matrix for an exact sensor.
    pub response: [[Estimate; 2]; 2],
    /// Force that is reported without load, newtons.
    pub offset_n: [Estimate; 2],
    /// Rotation of the sensor, degrees, from x towards y.
    pub turned_deg: f64,
    /// Standard deviation of a reading about the fit, newtons; `None` with as many unknowns as readings.
    pub residual_sd_n: Option<f64>,
    /// The reading that fits worst.
    pub worst: WorstReading,
    /// The calibration that the device should have.
    pub record: CalibrationRecord,
}

/// The matrix from readings under the calibration `before`.
///
/// # Errors
/// [`CalibrateError`] where the readings do not determine it, or it is none that a rig can have.
pub fn fit_force(readings: &[ForceReading], before: &CalibrationRecord) -> Result<ForceFit, CalibrateError> {
    let count = readings.len();
    if count < UNKNOWNS {
        return Err(CalibrateError::TooFew { count, least: UNKNOWNS });
    }
    check_directions(readings)?;
    let design = DMatrix::from_fn(count, UNKNOWNS, |row, column| match column {
        0 | 1 => readings[row].load_n[column],
        _ => 1.0,
    });
    let reported = DMatrix::from_fn(count, 2, |row, column| readings[row].reported_n[column]);
    let normal: Matrix3<f64> = (design.transpose() * &design).fixed_view::<3, 3>(0, 0).into_owned();
    let inverse = normal.try_inverse().ok_or(CalibrateError::TooFew { count, least: UNKNOWNS })?;
    let coefficients = inverse * (design.transpose() * &reported).fixed_view::<3, 2>(0, 0);
    let residuals =
        reported - &design * DMatrix::from_fn(UNKNOWNS, 2, |row, column| coefficients[(row, column)]);
    let freedom = 2 * (count - UNKNOWNS);
    let variance = if freedom > 0 { residuals.norm_squared() / freedom as f64 } else { 0.0 };
    let of = |unknown: usize, channel: usize| {
        Estimate::new(
            coefficients[(unknown, channel)],
            (variance * inverse[(unknown, unknown)]).sqrt(),
            freedom,
        )
    };
    let response = [[of(0, 0), of(1, 0)], [of(0, 1), of(1, 1)]];
    let matrix = Matrix2::from_fn(|row, column| coefficients[(column, row)]);
    let determinant = matrix.determinant();
    let correction = matrix.try_inverse().filter(|_| determinant.abs() > LEAST_DETERMINANT);
    let correction = correction.ok_or(CalibrateError::Unrelated { determinant })?;
    let (index, residual) = residuals
        .row_iter()
        .map(|row| row.norm())
        .enumerate()
        .max_by(|a, b| a.1.total_cmp(&b.1))
        .unwrap_or_default();
    let mut record = before.clone();
    let old = Matrix2::from_fn(|row, column| f64::from(before.force_pn_per_code[row][column]));
    let new = correction * old;
    record.force_pn_per_code =
        std::array::from_fn(|row| std::array::from_fn(|column| new[(row, column)].round() as i32));
    record.check()?;
    Ok(ForceFit {
        response,
        offset_n: [of(2, 0), of(2, 1)],
        turned_deg: (matrix[(1, 0)] - matrix[(0, 1)]).atan2(matrix.trace()).to_degrees(),
        residual_sd_n: (freedom > 0).then(|| variance.sqrt()),
        worst: WorstReading { index, residual },
        record,
    })
}

/// The loads have to vary in two directions.
fn check_directions(readings: &[ForceReading]) -> Result<(), CalibrateError> {
    let count = readings.len() as f64;
    let loads = || readings.iter().map(|reading| Vector2::from(reading.load_n));
    let mean = loads().sum::<Vector2<f64>>() / count;
    let scatter = loads().map(|load| (load - mean) * (load - mean).transpose()).sum::<Matrix2<f64>>() / count;
    let eigen = SymmetricEigen::new(scatter);
    let main = eigen.eigenvalues.imax();
    let sds_n = eigen.eigenvalues.map(|value| value.max(0.0).sqrt());
    let (main_n, cross_n) = (sds_n[main], sds_n[1 - main]);
    if cross_n <= ACROSS_SHARE * main_n {
        let direction = eigen.eigenvectors.column(main);
        let main_deg = direction[1].atan2(direction[0]).to_degrees().rem_euclid(180.0);
        return Err(CalibrateError::OneDirection { along_n: main_n, across_n: cross_n, main_deg });
    }
    Ok(())
}
