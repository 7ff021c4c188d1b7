//! A potentiometer's table from a gauge.
//!
//! Readings are taken in the order of the motion, up and down again. The difference between the gauge and the previous
//! table is fitted as a function of the converter's code that is linear between the knots of the table, with a further
//! constant on the way down if there are readings of it (the play). A weak penalty on second differences extrapolates linearly
//! to knots without readings nearby.

use super::{CalibrateError, Estimate, WorstReading};
use nalgebra::{DMatrix, DVector};
use protocol::{CalibrationRecord, KNOTS, PotentiometerTable};

/// Readings that a straight line and its noise need.
const LEAST_READINGS: usize = 4;
/// Readings in a direction from which its play is determined.
const LEAST_OF_DIRECTION: usize = 3;
/// Least distance between the outermost readings, millimetres.
const LEAST_RANGE_MM: f64 = 1.0;
/// Share of a reading's weight that holds second differences at zero: readings decide wherever there are some.
const STRAIGHT: f64 = 1e-6;
/// Motion that turns the direction, micrometres: more than the noise of a position.
const TURN_UM: f64 = 30.0;
/// Metres to micrometres.
const UM: f64 = 1e6;

/// One reading of the gauge and of the device.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GaugeReading {
    /// Position by the gauge, metres; 0 where the needle is straight.
    pub gauge_m: f64,
    /// Position that the device reported, metres.
    pub reported_m: f64,
}

/// Calibration that the readings determine.
#[derive(Debug, Clone, PartialEq)]
pub struct PositionFit {
    /// Largest difference between the gauge and the reported position, metres.
    pub largest_error_m: f64,
    /// Ratio of the gauge's to the reported displacements.
    pub scale: f64,
    /// Play: rising less falling position at the same code, metres; `None` without readings on the way back.
    pub play_m: Option<Estimate>,
    /// Standard deviation of a reading about the table, metres.
    pub residual_sd_m: f64,
    /// The reading that fits worst.
    pub worst: WorstReading,
    /// Range of positions with readings of the gauge, metres.
    pub covered_m: [f64; 2],
    /// The calibration that the device should have.
    pub record: CalibrationRecord,
}

/// The table of an axis (0: x, 1: y) from readings that were taken in this order with the calibration `before`.
///
/// # Errors
/// [`CalibrateError`] where the readings do not determine it, or it is none that a rig can have.
pub fn fit_position(
    readings: &[GaugeReading],
    axis: usize,
    before: &CalibrationRecord,
) -> Result<PositionFit, CalibrateError> {
    let count = readings.len();
    let too_few = CalibrateError::TooFew { count, least: LEAST_READINGS };
    let Some(table) = before.potentiometers.get(axis).filter(|_| count >= LEAST_READINGS) else {
        return Err(too_few);
    };
    let reported_um: Vec<f64> = readings.iter().map(|reading| UM * reading.reported_m).collect();
    let [lowest_um, highest_um] = range(reported_um.iter().copied());
    if highest_um - lowest_um < 1e3 * LEAST_RANGE_MM {
        let (lowest_mm, highest_mm) = (1e-3 * lowest_um, 1e-3 * highest_um);
        return Err(CalibrateError::ShortRange {
            from_mm: lowest_mm,
            to_mm: highest_mm,
            least_mm: LEAST_RANGE_MM,
        });
    }
    let rises = directions(&reported_um);
    let falling = rises.iter().filter(|rises| !**rises).count();
    let has_both_directions = falling.min(count - falling) >= LEAST_OF_DIRECTION;
    let unknowns = KNOTS + usize::from(has_both_directions);
    // One row per reading, then the second differences.
    let rows = count + KNOTS - 2;
    let (mut design, mut targets) = (DMatrix::zeros(rows, unknowns), DVector::zeros(rows));
    for (row, ((reading, rises), reported_um)) in readings.iter().zip(&rises).zip(&reported_um).enumerate() {
        let (knot, fraction) = place(if *rises { &table.rising_um } else { &table.falling_um }, *reported_um);
        design[(row, knot)] = 1.0 - fraction;
        design[(row, knot + 1)] = fraction;
        if has_both_directions && !rises {
            design[(row, KNOTS)] = 1.0;
        }
        targets[row] = UM * reading.gauge_m - reported_um;
    }
    for knot in 0..KNOTS - 2 {
        for (offset, weight) in [1.0, -2.0, 1.0].into_iter().enumerate() {
            design[(count + knot, knot + offset)] = STRAIGHT.sqrt() * weight;
        }
    }
    let inverse = (design.transpose() * &design).try_inverse().ok_or(too_few)?;
    let coefficients = &inverse * (design.transpose() * &targets);
    let residuals = (&targets - &design * &coefficients).rows(0, count).into_owned();
    // A straight line and the play are what every reading shares; knots between readings take up hardly more.
    let fitted_count = (design.rows(0, count) * &inverse * design.rows(0, count).transpose()).trace();
    let freedom = (count as f64 - fitted_count).round().max(0.0) as usize;
    let variance = residuals.norm_squared() / freedom.max(1) as f64;
    let (index, residual) = residuals
        .iter()
        .copied()
        .enumerate()
        .max_by(|a, b| a.1.abs().total_cmp(&b.1.abs()))
        .unwrap_or_default();

    let change = if has_both_directions { coefficients[KNOTS] } else { 0.0 };
    fn moved(knots_um: &[i16; KNOTS], more_um: f64, coefficients: &nalgebra::DVector<f64>) -> [i16; 9] {
        std::array::from_fn(|knot| (f64::from(knots_um[knot]) + coefficients[knot] + more_um).round() as i16)
    }
    let mut record = before.clone();
    record.potentiometers[axis] = PotentiometerTable {
        rising_um: moved(&table.rising_um, 0.0, &coefficients),
        falling_um: moved(&table.falling_um, change, &coefficients),
        ..*table
    };
    let new = &record.potentiometers[axis];
    let gauge_um = || readings.iter().map(|reading| UM * reading.gauge_m);
    let scale = slope(&reported_um, &gauge_um().collect::<Vec<_>>());
    if scale <= 0.0 {
        return Err(CalibrateError::Opposite);
    }
    record.check()?;
    let middle = KNOTS / 2;
    let play_um = f64::from(new.rising_um[middle]) - f64::from(new.falling_um[middle]);
    Ok(PositionFit {
        largest_error_m: targets.rows(0, count).amax() / UM,
        scale,
        play_m: has_both_directions
            .then(|| Estimate::new(play_um / UM, (variance * inverse[(KNOTS, KNOTS)]).sqrt() / UM, freedom)),
        residual_sd_m: variance.sqrt() / UM,
        worst: WorstReading { index, residual: residual / UM },
        covered_m: range(gauge_um()).map(|um| um / UM),
        record,
    })
}

/// Whether each reading was taken on the way up.
fn directions(reported_um: &[f64]) -> Vec<bool> {
    let mut turns: Vec<Option<bool>> = Vec::new();
    let mut turn_um = reported_um.first().copied().unwrap_or(0.0);
    let mut direction = None;
    for um in reported_um {
        if (um - turn_um).abs() > TURN_UM {
            (direction, turn_um) = (Some(*um > turn_um), *um);
        }
        turns.push(direction);
    }
    // The first readings belong to the motion that follows.
    let first = turns.iter().copied().flatten().next().unwrap_or(true);
    turns.into_iter().map(|direction| direction.unwrap_or(first)).collect()
}

/// The knot before a position in a monotonic table, and the share of the way to the next; beyond the ends along the outermost lines.
fn place(knots_um: &[i16; KNOTS], um: f64) -> (usize, f64) {
    let rises = knots_um.first() < knots_um.last();
    let knot = knots_um
        .iter()
        .take_while(|knot| (f64::from(**knot) <= um) == rises)
        .count()
        .saturating_sub(1)
        .min(KNOTS - 2);
    let (lower_um, upper_um) = (f64::from(knots_um[knot]), f64::from(knots_um[knot + 1]));
    (knot, (um - lower_um) / (upper_um - lower_um))
}

fn range(values: impl Iterator<Item = f64>) -> [f64; 2] {
    values
        .fold([f64::INFINITY, f64::NEG_INFINITY], |[least, most], value| [least.min(value), most.max(value)])
}

/// Slope of a straight line by least squares.
fn slope(x: &[f64], y: &[f64]) -> f64 {
    fn mean(values: &[f64]) -> f64 {
        values.iter().sum::<f64>() / values.len() as f64
    }
    let (mean_x, mean_y) = (mean(x), mean(y));
    let products = x.iter().zip(y).map(|(x, y)| [(x - mean_x) * (y - mean_y), (x - mean_x).powi(2)]);
    let [xy, xx] = products.fold([0.0; 2], |[a, b], [xy, xx]| [a + xy, b + xx]);
    xy / xx
}
