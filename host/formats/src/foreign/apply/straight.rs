//! The straight needle of a shape in a table: a shape that is given by positions is counted from its sweep at rest.

use super::{Options, Zero, zero};
use crate::foreign::TableError;
use crate::session::{ForceSeries, ShapeDoubt, ShapeSeries};

/// The straight needle: deflections over positions along it, in their order.
struct Straight(Vec<(f64, f64)>);

impl Straight {
    /// Of the points of these rows; those of one position are one.
    fn of(z_m: &[f64], deflection_m: &[f64], rows: &[usize]) -> Self {
        let mut points: Vec<(f64, f64)> =
            rows.iter().filter_map(|row| Some((*z_m.get(*row)?, *deflection_m.get(*row)?))).collect();
        points.sort_by(|a, b| a.0.total_cmp(&b.0));
        let of_one_place = points.chunk_by(|a, b| a.0 == b.0);
        Self(
            of_one_place
                .filter_map(|same| {
                    Some((same.first()?.0, same.iter().map(|(_, m)| m).sum::<f64>() / same.len() as f64))
                })
                .collect(),
        )
    }

    /// Its deflection at a position, linearly between its points; none beyond them.
    fn at(&self, z_m: f64) -> Option<f64> {
        let next = self.0.partition_point(|(of_m, _)| *of_m < z_m);
        let (later_m, later) = *self.0.get(next)?;
        if later_m == z_m {
            return Some(later);
        }
        let (earlier_m, earlier) = *self.0.get(next.checked_sub(1)?)?;
        Some(earlier + (later - earlier) * (z_m - earlier_m) / (later_m - earlier_m))
    }
}

/// Counts a shape from its sweep at the beginning, where guide 2 rests, if it is one of positions or the user wants that; notes one that is
/// bent against the displacement.
pub(super) fn refer_shape(
    shape: &mut ShapeSeries,
    force: &ForceSeries,
    options: &Options,
    notes: &mut Vec<String>,
) -> Result<(), TableError> {
    let is_position = match (options.zero, shape.doubt(force, options.guide2_m)) {
        (Zero::Written, _) => return Ok(()),
        (_, Some(doubt @ ShapeDoubt::Position { .. })) => Some(doubt),
        _ => None,
    };
    let at_rest = at_rest(shape, force);
    let is_counted = !at_rest.is_empty() && at_rest.len() < shape.z_m.len();
    match is_position {
        Some(doubt) if !is_counted => return Err(no_straight(&doubt)),
        Some(doubt) => {
            count_from(shape, &at_rest)?;
            notes.push(format!(
                "deflection_y_mm is {doubt}; they are counted from the {} points of the shape before guide 2 moves (--zero written keeps them)",
                at_rest.len()
            ));
        }
        None if options.zero == Zero::First && is_counted => {
            count_from(shape, &at_rest)?;
            notes.push(format!(
                "deflection_y_mm is counted from the {} points of the shape before guide 2 moves",
                at_rest.len()
            ));
        }
        None => {}
    }
    match shape.doubt(force, options.guide2_m) {
        Some(doubt @ ShapeDoubt::Position { .. }) => Err(no_straight(&doubt)),
        Some(doubt @ ShapeDoubt::Against) => {
            notes.push(format!(
                "{doubt} A minus before the unit reverses it (--map '...=deflection_y_mm:-mm')"
            ));
            Ok(())
        }
        None => Ok(()),
    }
}

/// Rows of the shape that were measured before guide 2 moved.
fn at_rest(shape: &ShapeSeries, force: &ForceSeries) -> Vec<usize> {
    let rest = zero::rest(&force.displacement_y_m);
    let end_s = rest.checked_sub(1).and_then(|last| force.time_s.get(last)).copied();
    let times_s = shape.time_s.iter().flatten().enumerate();
    times_s.filter(|(_, time_s)| end_s.is_some_and(|end_s| **time_s <= end_s)).map(|(row, _)| row).collect()
}

/// Takes the straight needle off, and leaves its points out.
fn count_from(shape: &mut ShapeSeries, at_rest: &[usize]) -> Result<(), TableError> {
    let kept: Vec<usize> = (0..shape.z_m.len()).filter(|row| at_rest.binary_search(row).is_err()).collect();
    let z_m = shape.z_m.clone();
    let mut without_straight = |deflection_m: &mut Vec<f64>| -> Result<(), TableError> {
        let straight = Straight::of(&z_m, deflection_m, at_rest);
        *deflection_m = kept
            .iter()
            .filter_map(|row| Some((*z_m.get(*row)?, *deflection_m.get(*row)?)))
            .map(|(z_m, m)| straight.at(z_m).map(|of_m| m - of_m).ok_or_else(|| beyond(z_m, &straight)))
            .collect::<Result<_, _>>()?;
        Ok(())
    };
    without_straight(&mut shape.y_m)?;
    shape.x_m.as_mut().map_or(Ok(()), &mut without_straight)?;
    shape.z_m = at_rows(&z_m, &kept);
    shape.time_s = shape.time_s.as_deref().map(|times_s| at_rows(times_s, &kept));
    Ok(())
}

fn at_rows(values: &[f64], rows: &[usize]) -> Vec<f64> {
    rows.iter().filter_map(|row| values.get(*row).copied()).collect()
}

/// A point that the straight needle was not measured at.
fn beyond(z_m: f64, straight: &Straight) -> TableError {
    let [from_mm, to_mm] =
        [straight.0.first(), straight.0.last()].map(|end| end.map_or(0.0, |(m, _)| 1e3 * m));
    TableError::Map {
        choice: "z_mm".to_owned(),
        problem: format!(
            "{:.3} mm from guide 1, and the shape before guide 2 moves is from {from_mm:.3} to {to_mm:.3} mm",
            1e3 * z_m
        ),
        expected: "the straight needle at all places of the shape".to_owned(),
    }
}

fn no_straight(doubt: &ShapeDoubt) -> TableError {
    TableError::Map {
        choice: "deflection_y_mm".to_owned(),
        problem: doubt.to_string(),
        expected: "distances from the straight needle: the shape at zero displacement subtracted, or that shape in the same table with its time \
                   (time_s before guide 2 moves), which is then subtracted; --zero written keeps them as they are"
            .to_owned(),
    }
}
