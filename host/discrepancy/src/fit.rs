//! Joint fit of a set of laws: parameters, noise, sizes of the discrepancy, and the evidence.
//!
//! The method is Gauss-Newton in the metric of noise and discrepancy. Every iteration takes a step that is halved until the
//! objective does not grow. The first iterations and the last one also maximize the evidence of the linearised model over sizes and
//! noise. At the end Laplace's method gives the evidence.

use super::basis::Basis;
use super::bench::{Bench, Coordinate, Law};
use super::evidence::{Evidence, Patterns, Products, RunPatterns};
use super::model::Error;
use super::noise::{Noise, likeliest, whiten};
use nalgebra::{DMatrix, DVector};

/// A fit has converged once a step is shorter than this, in posterior standard deviations.
const SETTLED_SD: f64 = 0.05;
/// Longest step, in standard deviations of the priors.
const MAX_STEP_SD: f64 = 1.2;
const MAX_HALVINGS: usize = 8;
const MAX_ROUNDS: usize = 20;
/// Sizes of the discrepancy are found to this gain of log evidence: differences between models matter from about 1 on.
const LEAST_GAIN: f64 = 1e-3;
/// First rounds in which noise and sizes are estimated again; later rounds refine the parameters alone, except for the last one.
const ROUNDS_OF_NOISE: usize = 4;
/// Steps of the numerical derivatives: in prior standard deviations in the first round, then in posterior ones, with a lower limit in
/// prior ones.
const FIRST_STEP: f64 = 1e-4;
const STEP: f64 = 0.05;
const MIN_STEP: f64 = 1e-7;
/// Shortest memory of the correlated noise, in distances of readings, and longest, as a fraction of a run: a shorter one does not differ
/// from white noise, and a longer one not from an offset of the run.
const SHORTEST_MEMORY: f64 = 1.0;
const LONGEST_MEMORY: f64 = 0.25;

/// A fitted set of laws.
#[derive(Clone)]
pub(crate) struct Fitted {
    pub laws: Vec<Law>,
    pub values: Vec<f64>,
    /// Covariance of the parameters, integrated over the sizes of the discrepancy.
    pub covariance: DMatrix<f64>,
    pub residuals: Vec<DVector<f64>>,
    pub jacobian: Vec<DMatrix<f64>>,
    pub noises: Vec<Noise>,
    pub sizes: Vec<f64>,
    pub log_evidence: f64,
    pub settled: bool,
}

/// Whitened patterns, their products with the columns, and the sum of the logarithms of the noise's standard deviations.
struct Whitened {
    patterns: Patterns,
    products: Products,
    ln_sds: f64,
}

/// Start of a fit.
#[derive(Clone)]
pub(crate) struct Start {
    pub values: Vec<f64>,
    pub noises: Vec<Noise>,
    pub sizes: Vec<f64>,
}

impl Start {
    /// Start at the prior means, with noise of about a third of each channel's scale.
    pub fn plain(bench: &Bench<'_>, basis: &Basis) -> Self {
        let values = bench.coordinates(&[]).iter().map(|coordinate| coordinate.mean).collect();
        let noises = memories(bench).into_iter().map(|[shortest_s, longest_s]| Noise {
            sd: 0.3,
            correlated: 0.5,
            memory_s: (shortest_s * longest_s).sqrt(),
        });
        Self { values, noises: noises.collect(), sizes: basis.everyday() }
    }
}

fn duration(times: &[f64]) -> f64 {
    times.last().zip(times.first()).map_or(0.0, |(last, first)| last - first)
}

/// Range of the memory of each channel's noise.
fn memories(bench: &Bench<'_>) -> Vec<[f64; 2]> {
    (0..bench.scales.len())
        .map(|channel| {
            let (mut longest, mut shortest_step) = (0.0, f64::INFINITY);
            let segments = bench.training.iter().flat_map(|run| &run.segments);
            for segment in segments.filter(|segment| segment.channel == channel) {
                let duration_s = duration(&segment.time_s);
                let steps = segment.time_s.len().saturating_sub(1).max(1);
                longest = f64::max(longest, duration_s);
                shortest_step = f64::min(shortest_step, duration_s / steps as f64);
            }
            let shortest = SHORTEST_MEMORY * shortest_step.clamp(1e-12, 1e12);
            [shortest, (LONGEST_MEMORY * longest).max(2.0 * shortest)]
        })
        .collect()
}

/// Whitened patterns, products of columns (one matrix per run) with them, and the sum of the logarithms of the standard deviations by
/// which whitening divides.
pub(crate) fn whitened(
    bench: &Bench<'_>,
    basis: &Basis,
    noises: &[Noise],
    columns: &[DMatrix<f64>],
) -> (Patterns, Products, f64) {
    let (mut runs, mut right, mut ln_sds) = (Vec::new(), Vec::new(), 0.0);
    for (((prepared, own), shared), columns) in
        bench.training.iter().zip(&basis.own).zip(&basis.shared).zip(columns)
    {
        let (first, second) = (own.ncols(), shared.ncols());
        let mut joined = own.clone().resize_horizontally(first + second + columns.ncols(), 0.0);
        joined.columns_mut(first, second).copy_from(shared);
        joined.columns_mut(first + second, columns.ncols()).copy_from(columns);
        ln_sds += whiten(&prepared.segments, noises, &mut joined);
        let groups = vec![basis.groups.len() - 1; first];
        let (own_patterns, shared_patterns) =
            (joined.columns(0, first).into_owned(), joined.columns(first, second).into_owned());
        runs.push(RunPatterns::new(groups, own_patterns, shared_patterns));
        right.push(joined.columns(first + second, columns.ncols()).into_owned());
    }
    let patterns = Patterns::new(basis.groups.clone(), basis.shared_groups.clone(), runs);
    let products = patterns.products(&right);
    (patterns, products, ln_sds)
}

/// A point with the residuals there.
struct Point {
    values: Vec<f64>,
    residuals: Vec<DVector<f64>>,
}

impl Point {
    /// The residuals with another value of one parameter, and this value; those of the point itself if the model has no prediction there.
    fn moved(
        &self,
        bench: &Bench<'_>,
        laws: &[Law],
        number: usize,
        to: f64,
    ) -> Result<(f64, Vec<DVector<f64>>), Error> {
        let mut values = self.values.clone();
        let value = values.get_mut(number).map_or(to, |value| std::mem::replace(value, to));
        match bench.residuals(laws, &values) {
            Ok(residuals) => Ok((to, residuals)),
            Err(error) if error.is_of_these_values() => Ok((value, self.residuals.clone())),
            Err(error) => Err(error),
        }
    }
}

/// Sensitivities in units of the priors, and in the last column the residuals at the prior means according to the linearised model.
fn columns(coordinates: &[Coordinate], point: &Point, jacobian: &[DMatrix<f64>]) -> Vec<DMatrix<f64>> {
    let count = coordinates.len();
    jacobian
        .iter()
        .zip(&point.residuals)
        .map(|(jacobian, residuals)| {
            let mut columns = jacobian.clone().resize_horizontally(count + 1, 0.0);
            let mut last = residuals.clone();
            for (j, (coordinate, value)) in coordinates.iter().zip(&point.values).enumerate() {
                let mut column = columns.column_mut(j);
                column *= coordinate.sd;
                last.axpy((value - coordinate.mean) / coordinate.sd, &column, 1.0);
            }
            columns.set_column(count, &last);
            columns
        })
        .collect()
}

/// Sum of the squared residuals in the metric and of the squared distances from the prior means.
fn squares(
    bench: &Bench<'_>,
    basis: &Basis,
    start: &Start,
    coordinates: &[Coordinate],
    point: &Point,
) -> Option<f64> {
    let residuals: Vec<DMatrix<f64>> = point
        .residuals
        .iter()
        .map(|part| DMatrix::from_column_slice(part.len(), 1, part.as_slice()))
        .collect();
    let (patterns, products, _) = whitened(bench, basis, &start.noises, &residuals);
    let misfit = patterns.in_metric(&start.sizes, &products)?[(0, 0)];
    let standardised = coordinates
        .iter()
        .zip(&point.values)
        .map(|(coordinate, value)| (value - coordinate.mean) / coordinate.sd);
    Some(misfit + standardised.map(|distance| distance.powi(2)).sum::<f64>())
}

/// Derivatives of the predictions with respect to all parameters, by central differences where the range allows it.
fn jacobian(
    bench: &Bench<'_>,
    laws: &[Law],
    coordinates: &[Coordinate],
    point: &Point,
    steps: &[f64],
) -> Result<Vec<DMatrix<f64>>, Error> {
    let numbered = coordinates.iter().zip(steps).enumerate().collect();
    let derivatives: Vec<Vec<DVector<f64>>> = bench.each(numbered, |(number, (coordinate, step))| {
        let value = point.values.get(number).copied().unwrap_or(coordinate.mean);
        let (least, lower) = point.moved(bench, laws, number, (value - step).max(coordinate.least))?;
        let (most, upper) = point.moved(bench, laws, number, (value + step).min(coordinate.most))?;
        if most > least {
            let pairs = lower.iter().zip(&upper);
            return Ok(pairs.map(|(lower, upper)| (lower - upper) / (most - least)).collect());
        }
        Ok(point.residuals.iter().map(|part| DVector::zeros(part.len())).collect())
    })?;
    Ok((0..point.residuals.len())
        .map(|run| {
            let rows = point.residuals.get(run).map_or(0, DVector::len);
            let mut matrix = DMatrix::zeros(rows, derivatives.len());
            for (number, by_run) in derivatives.iter().enumerate() {
                if let Some(column) = by_run.get(run) {
                    matrix.set_column(number, column);
                }
            }
            matrix
        })
        .collect())
}

fn no_factor() -> Error {
    Error::Undetermined("the covariance has no factor".to_owned())
}

impl Fitted {
    /// Fits laws.
    ///
    /// # Errors
    /// If the model has no prediction at the start, or a covariance has no factor.
    pub fn new(bench: &Bench<'_>, basis: &Basis, laws: &[Law], start: &Start) -> Result<Self, Error> {
        let coordinates = bench.coordinates(laws);
        let values: Vec<f64> = start
            .values
            .iter()
            .zip(&coordinates)
            .map(|(value, coordinate)| value.clamp(coordinate.least, coordinate.most))
            .collect();
        let mut point = Point { residuals: bench.residuals(laws, &values)?, values };
        let mut start = start.clone();
        let mut steps: Vec<f64> = coordinates.iter().map(|one| FIRST_STEP * one.sd).collect();
        let mut settled = false;
        let mut round = 0;
        loop {
            let jacobian = jacobian(bench, laws, &coordinates, &point, &steps)?;
            let columns = columns(&coordinates, &point, &jacobian);
            round += 1;
            let is_last = settled || round > MAX_ROUNDS;
            if round <= ROUNDS_OF_NOISE || is_last {
                improve(bench, basis, &columns, &mut start);
            }
            let (patterns, products, ln_sds) = whitened(bench, basis, &start.noises, &columns);
            let evidence = patterns.evidence(&start.sizes, &products).ok_or_else(no_factor)?;
            if is_last {
                let whitened = Whitened { patterns, products, ln_sds };
                let squares = squares(bench, basis, &start, &coordinates, &point).ok_or_else(no_factor)?;
                return finish(
                    laws,
                    &coordinates,
                    point,
                    jacobian,
                    start,
                    &whitened,
                    &evidence,
                    squares,
                    settled,
                )
                .ok_or_else(no_factor);
            }
            let sds: Vec<f64> = coordinates
                .iter()
                .enumerate()
                .map(|(i, one)| evidence.covariance[(i, i)].max(0.0).sqrt() * one.sd)
                .collect();
            steps =
                sds.iter().zip(&coordinates).map(|(sd, one)| (STEP * sd).max(MIN_STEP * one.sd)).collect();
            let step = step(&coordinates, &point.values, &evidence);
            let is_short = step.iter().zip(&sds).all(|(step, sd)| step.abs() <= SETTLED_SD * sd);
            match descend(bench, basis, laws, &start, &coordinates, &point, &step)? {
                Some(next) => {
                    point = next;
                    settled = is_short && round >= 2;
                }
                None => settled = true,
            }
        }
    }

    /// Standard deviation of a parameter.
    pub fn sd(&self, number: usize) -> f64 {
        self.covariance[(number, number)].max(0.0).sqrt()
    }

    /// Values, noise and sizes as the start of a fit with more or fewer laws.
    pub fn start(&self) -> Start {
        Start { values: self.values.clone(), noises: self.noises.clone(), sizes: self.sizes.clone() }
    }
}

/// Estimates sizes and noise again for the linearised model.
fn improve(bench: &Bench<'_>, basis: &Basis, columns: &[DMatrix<f64>], start: &mut Start) {
    let (patterns, products, _) = whitened(bench, basis, &start.noises, columns);
    if let Some(likeliest) = patterns.likeliest_sizes(&start.sizes, &products, LEAST_GAIN) {
        start.sizes = likeliest.sizes;
    }
    start.noises = likeliest(&start.noises, &memories(bench), |noises| {
        let (patterns, products, ln_sds) = whitened(bench, basis, noises, columns);
        patterns.evidence(&start.sizes, &products).map(|evidence| evidence.minus_ln + ln_sds)
    });
}

/// The step to the most probable point of the linearised model, clipped to the ranges, and shortened if it is longer than [`MAX_STEP_SD`].
fn step(coordinates: &[Coordinate], values: &[f64], evidence: &Evidence) -> Vec<f64> {
    let numbers = coordinates.iter().zip(values).zip(evidence.mean.iter());
    let full_step: Vec<f64> = numbers.map(|((one, value), mean)| one.mean + one.sd * mean - value).collect();
    let longest =
        full_step.iter().zip(coordinates).map(|(step, one)| step.abs() / one.sd).fold(0.0, f64::max);
    let factor = (MAX_STEP_SD / longest.max(MAX_STEP_SD)).min(1.0);
    full_step
        .iter()
        .zip(coordinates)
        .zip(values)
        .map(|((step, one), value)| (value + factor * step).clamp(one.least, one.most) - value)
        .collect()
}

/// The point after the step, its half, its quarter and so on: the first at which the objective does not grow; `None` if there is none.
fn descend(
    bench: &Bench<'_>,
    basis: &Basis,
    laws: &[Law],
    start: &Start,
    coordinates: &[Coordinate],
    from: &Point,
    step: &[f64],
) -> Result<Option<Point>, Error> {
    let start_squares = squares(bench, basis, start, coordinates, from);
    let mut fraction = 1.0;
    for _ in 0..=MAX_HALVINGS {
        let values: Vec<f64> =
            from.values.iter().zip(step).map(|(value, step)| value + fraction * step).collect();
        fraction *= 0.5;
        let residuals = match bench.residuals(laws, &values) {
            Ok(residuals) => residuals,
            Err(error) if error.is_of_these_values() => continue,
            Err(error) => return Err(error),
        };
        let point = Point { values, residuals };
        let moved_squares = squares(bench, basis, start, coordinates, &point);
        if start_squares.zip(moved_squares).is_some_and(|(start, moved)| moved <= start) {
            return Ok(Some(point));
        }
    }
    Ok(None)
}

#[expect(clippy::too_many_arguments, reason = "the parts of one result")]
fn finish(
    laws: &[Law],
    coordinates: &[Coordinate],
    point: Point,
    jacobian: Vec<DMatrix<f64>>,
    start: Start,
    whitened: &Whitened,
    evidence: &Evidence,
    squares: f64,
    settled: bool,
) -> Option<Fitted> {
    let Whitened { patterns, products, ln_sds } = whitened;
    let volume = patterns.ln_volume_of_sizes(&start.sizes, products)?;
    let log_evidence = -0.5 * squares - evidence.half_ln_determinant - evidence.size_prior + volume - ln_sds;
    let inner = patterns.integrated_covariance(&start.sizes, products)?;
    let count = coordinates.len();
    let sds: Vec<f64> = coordinates.iter().map(|one| one.sd).collect();
    let covariance = DMatrix::from_fn(count, count, |i, j| sds[i] * inner[(i, j)] * sds[j]);
    log_evidence.is_finite().then(|| Fitted {
        laws: laws.to_vec(),
        values: point.values,
        covariance,
        residuals: point.residuals,
        jacobian,
        noises: start.noises,
        sizes: start.sizes,
        log_evidence,
        settled,
    })
}
