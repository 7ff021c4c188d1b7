//! Numbers with which predictions jump reading by reading: levels of steps.
//!
//! The likelihood of such a number is constant between two readings and falls at each by what that reading tells apart, so that neither a derivative finds its
//! greatest value nor a curvature its width. Both are those of the posterior over places around the fit, with all other numbers integrated over as the
//! linearised model has them.

use super::{Point, Start, columns, no_factor, whitened};
use crate::basis::Basis;
use crate::bench::{Bench, Coordinate, Law};
use crate::model::Error;
use nalgebra::DMatrix;

/// Distances from the fit, in ranges of the number: the least is a tenth of what two of a thousand readings are apart, and each is half as long again as the one
/// before, so that a jump is never further from one than a quarter of its distance.
const LEAST: f64 = 1e-4;
const FACTOR: f64 = 1.5;
/// Difference of log evidence that shows nowhere.
const MIN_DIFFERENCE: f64 = 0.01;

/// A fit at which the evidence of numbers that jump is looked at.
pub(super) struct Around<'a> {
    pub bench: &'a Bench<'a>,
    pub basis: &'a Basis,
    pub laws: &'a [Law],
    pub coordinates: &'a [Coordinate],
    pub start: &'a Start,
    pub point: &'a Point,
    pub jacobian: &'a [DMatrix<f64>],
}

/// A place of a number with minus the logarithm of its evidence but for a constant, and the point there.
struct Place {
    value: f64,
    minus_ln: f64,
    point: Point,
}

impl Around<'_> {
    fn numbers(&self) -> impl Iterator<Item = usize> {
        self.coordinates.iter().enumerate().filter(|(_, one)| one.jumps).map(|(number, _)| number)
    }

    /// The fit with a number at another place; nothing where the model has no prediction there.
    fn moved(&self, number: usize, value: f64) -> Result<Option<(f64, Point)>, Error> {
        let mut values = self.point.values.clone();
        if let Some(one) = values.get_mut(number) {
            *one = value;
        }
        match self.bench.residuals(self.laws, &values) {
            Ok(residuals) => Ok(Some((value, Point { values, residuals }))),
            Err(error) if error.is_of_these_values() => Ok(None),
            Err(error) => Err(error),
        }
    }

    /// Values of a number on both sides of the fit and there, in order.
    fn values(&self, number: usize) -> Vec<f64> {
        let (Some(centre), Some(coordinate)) =
            (self.point.values.get(number).copied(), self.coordinates.get(number))
        else {
            return Vec::new();
        };
        let range = coordinate.most - coordinate.least;
        let shares = std::iter::successors(Some(LEAST), |share| Some(FACTOR * share));
        let distances: Vec<f64> =
            shares.take_while(|share| *share < 1.0).map(|share| share * range).collect();
        let below = distances.iter().rev().map(|distance| centre - distance);
        let values = below.chain([centre]).chain(distances.iter().map(|distance| centre + distance));
        values.filter(|value| (coordinate.least..=coordinate.most).contains(value)).collect()
    }

    /// Places of a number.
    fn places(&self, number: usize) -> Result<Vec<Place>, Error> {
        let moved = self.bench.each(self.values(number), |value| self.moved(number, value))?;
        let moved: Vec<(f64, Point)> = moved.into_iter().flatten().collect();
        let mut others = self.jacobian.to_vec();
        for matrix in &mut others {
            matrix.column_mut(number).fill(0.0);
        }
        let count = self.coordinates.len();
        let mut joined = columns(self.coordinates, self.point, &others);
        for matrix in &mut joined {
            let taken = std::mem::replace(matrix, DMatrix::zeros(0, 0));
            *matrix = taken.resize_horizontally(count + moved.len(), 0.0);
        }
        for (place, (_, point)) in moved.iter().enumerate() {
            for (matrix, of_place) in joined.iter_mut().zip(columns(self.coordinates, point, &others)) {
                matrix.set_column(count + place, &of_place.column(count));
            }
        }
        let (patterns, products, _) = whitened(self.bench, self.basis, &self.start.noises, &joined);
        let metric = patterns.in_metric(&self.start.sizes, &products).ok_or_else(no_factor)?;
        let parameters = metric.view((0, 0), (count, count)) + DMatrix::identity(count, count);
        let cross = metric.view((0, count), (count, moved.len())).into_owned();
        let follow = parameters.cholesky().ok_or_else(no_factor)?.solve(&cross);
        let places = moved.into_iter().enumerate().map(|(place, (value, point))| {
            let square = metric[(count + place, count + place)];
            let minus_ln = 0.5 * (square - cross.column(place).dot(&follow.column(place)));
            Place { value, minus_ln, point }
        });
        Ok(places.collect())
    }

    /// The point where the evidence of one of these numbers is greatest, where it is greater than at the fit.
    pub fn likelier(&self) -> Result<Option<Point>, Error> {
        for number in self.numbers() {
            let Some(here) = self.point.values.get(number).copied() else { continue };
            let places = self.places(number)?;
            let own = places.iter().find(|place| place.value == here).map(|place| place.minus_ln);
            let best = places.into_iter().min_by(|a, b| a.minus_ln.total_cmp(&b.minus_ln));
            if let Some((own, best)) = own.zip(best)
                && best.minus_ln < own - MIN_DIFFERENCE
            {
                return Ok(Some(best.point));
            }
        }
        Ok(None)
    }

    /// Numbers that jump with the standard deviations of their posteriors about the fit.
    pub fn sds(&self) -> Result<Vec<(usize, f64)>, Error> {
        let mut sds = Vec::new();
        for number in self.numbers() {
            let places = self.places(number)?;
            let Some(here) = self.point.values.get(number).copied() else { continue };
            let least = places.iter().map(|place| place.minus_ln).fold(f64::INFINITY, f64::min);
            let density = |place: &Place| (least - place.minus_ln).exp();
            let (mut total, mut square) = (0.0, 0.0);
            for pair in places.windows(2) {
                let [one, other] = pair else { continue };
                let half_width = 0.5 * (other.value - one.value);
                for place in [one, other] {
                    let share = half_width * density(place);
                    total += share;
                    square += share * (place.value - here).powi(2);
                }
            }
            if total > 0.0 {
                sds.push((number, (square / total).sqrt()));
            }
        }
        Ok(sds)
    }
}
