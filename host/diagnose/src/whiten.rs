//! Whitening of the residuals of one run (theory, eq. 59).
//!
//! The covariance of a run's data has blocks (forces of a plane; one sweep; one path) from the sensors' noise, and a few
//! low-rank terms: the position of guide 2 in a hold has the error of the mean of its readings, which changes force and shape
//! of that hold together; the zero of a tip sensor, and the position of an imaged shape along the needle, are uncertain; and
//! rounding of a shape causes a common error where the needle is straight ([`rounding`]). With `C = L L^T + V V^T` and the
//! singular values s of `L^-1 V = U S W^T`, the residual r becomes `x - U (1 - 1/sqrt(1 + s^2)) U^T x`, `x = L^-1 r`.

use super::data::{Channel, Run, Source};
use super::noise::Noise;
use super::predicted::predicted;
use super::rounding;
use formats::session::SHARED_ERRORS;
use mechanics::unknowns::{rig, sensors};
use mechanics::{Experiment, Model, ModelError, Plane, predict};
use nalgebra::{DMatrix, DVector};
use pulp::{Arch, Simd, WithSimd};
use std::ops::Range;

/// Step of the numerical derivative of the deflection along the needle.
const SLOPE_STEP_M: f64 = 1e-4;
/// Correlations over more correlation times than this are neglected.
const REACH: f64 = 8.0;

/// Transformation that makes a run's residuals independent.
#[derive(Debug, Clone)]
pub(super) struct Whitener {
    /// Range of each block, and the lower triangle of its Cholesky factor, row after row, with the diagonal inverted.
    blocks: Vec<(Range<usize>, Vec<f64>)>,
    /// `U` of the module's description.
    patterns: DMatrix<f64>,
    /// `1 - 1/sqrt(1 + s^2)` for each column of `patterns`.
    shrink: DVector<f64>,
}

/// Force and shape of the plain model per unit displacement of guide 2, in each plane.
struct Slopes {
    force_n_per_m: [f64; 2],
    shape: Vec<[f64; 2]>,
}

impl Whitener {
    /// Whitener of a run, linearised around an approximate model of it.
    ///
    /// # Errors
    /// Where the model cannot be evaluated.
    pub fn new(run: &Run, noise: &Noise, model: &Model) -> Result<Self, ModelError> {
        let slopes = slopes(run, model)?;
        let mut blocks = Vec::new();
        let mut start = 0;
        while start < run.data.len() {
            let first = &run.data[start];
            let is_shape = matches!(first.source, Source::Shape(_));
            let end = start
                + run.data[start..]
                    .iter()
                    .take_while(|d| d.channel == first.channel && (!is_shape || d.part == first.part))
                    .count();
            let covariance = block(run, start..end, noise, &slopes);
            let factor = covariance.cholesky().ok_or(ModelError::Singular)?.unpack();
            let row = |i: usize| (0..i).map(move |j| (i, j)).chain([(i, i)]);
            let entry = |(i, j): (usize, usize)| if i == j { 1.0 / factor[(i, i)] } else { factor[(i, j)] };
            blocks.push((start..end, (0..end - start).flat_map(row).map(entry).collect()));
            start = end;
        }
        let mut whitener =
            Self { blocks, patterns: DMatrix::zeros(run.data.len(), 0), shrink: DVector::zeros(0) };
        let mut columns = patterns(run, noise, &slopes);
        columns.extend(shared_positions(run, model)?);
        columns.extend(shared_deflections(run));
        columns.extend(rounding::patterns(run, noise, model)?);
        let columns: Vec<DVector<f64>> = columns
            .into_iter()
            .map(|mut column| {
                whitener.apply(&mut column);
                DVector::from_vec(column)
            })
            .collect();
        if !columns.is_empty() {
            let columns = DMatrix::from_columns(&columns);
            let eigen = (columns.transpose() * &columns).symmetric_eigen();
            let kept_vectors: Vec<usize> =
                (0..eigen.eigenvalues.len()).filter(|i| eigen.eigenvalues[*i] > 1e-12).collect();
            let squares = kept_vectors.iter().map(|i| eigen.eigenvalues[*i]);
            whitener.shrink = DVector::from_iterator(
                kept_vectors.len(),
                squares.map(|square| 1.0 - 1.0 / (1.0 + square).sqrt()),
            );
            let unit: Vec<DVector<f64>> = kept_vectors
                .iter()
                .map(|i| &columns * eigen.eigenvectors.column(*i) / eigen.eigenvalues[*i].sqrt())
                .collect();
            if !unit.is_empty() {
                whitener.patterns = DMatrix::from_columns(&unit);
            }
        }
        Ok(whitener)
    }

    /// Whitens residuals in SI, in place.
    pub fn apply(&self, residuals: &mut [f64]) {
        Arch::new().dispatch(Application { whitener: self, residuals });
    }

    #[inline(always)]
    fn applied(&self, residuals: &mut [f64]) {
        for (range, rows) in &self.blocks {
            // Forward substitution.
            let block_residuals = &mut residuals[range.clone()];
            let mut start = 0;
            for i in 0..block_residuals.len() {
                let solved_sum = dot(&rows[start..start + i], &block_residuals[..i]);
                block_residuals[i] = (block_residuals[i] - solved_sum) * rows[start + i];
                start += i + 1;
            }
        }
        for (pattern, shrink) in self.patterns.column_iter().zip(self.shrink.iter()) {
            let projection = dot(pattern.as_slice(), residuals);
            residuals.iter_mut().zip(pattern.iter()).for_each(|(x, p)| *x -= shrink * projection * p);
        }
    }

    /// The reverse of [`Whitener::apply`].
    pub fn undo(&self, residuals: &mut [f64]) {
        for (pattern, shrink) in self.patterns.column_iter().zip(self.shrink.iter()) {
            let projection: f64 = pattern.iter().zip(residuals.iter()).map(|(p, x)| p * x).sum();
            let restoring = shrink / (1.0 - shrink) * projection;
            residuals.iter_mut().zip(pattern.iter()).for_each(|(x, p)| *x += restoring * p);
        }
        for (range, rows) in &self.blocks {
            let block_residuals = &mut residuals[range.clone()];
            let mut start = rows.len();
            for i in (0..block_residuals.len()).rev() {
                start -= i + 1;
                let product_sum: f64 =
                    rows[start..start + i].iter().zip(&block_residuals[..i]).map(|(l, x)| l * x).sum();
                block_residuals[i] = block_residuals[i] / rows[start + i] + product_sum;
            }
        }
    }
}

/// Whitening that is compiled for several instruction sets; the processor's own is chosen at run time.
struct Application<'a> {
    whitener: &'a Whitener,
    residuals: &'a mut [f64],
}

impl WithSimd for Application<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        self.whitener.applied(self.residuals);
    }
}

/// Scalar product, in independent lanes so that the additions do not wait for each other.
#[inline(always)]
fn dot(a: &[f64], b: &[f64]) -> f64 {
    const LANES: usize = 8;
    let (a, b) = (a.chunks_exact(LANES), b.chunks_exact(LANES));
    let tail_sum: f64 = a.remainder().iter().zip(b.remainder()).map(|(a, b)| a * b).sum();
    let mut sums = [0.0; LANES];
    for (a, b) in a.zip(b) {
        sums.iter_mut().zip(a.iter().zip(b)).for_each(|(sum, (a, b))| *sum += a * b);
    }
    tail_sum + sums.iter().sum::<f64>()
}

fn slopes(run: &Run, model: &Model) -> Result<Slopes, ModelError> {
    let Experiment::Lateral(lateral) = &run.experiment else {
        return Ok(Slopes { force_n_per_m: [0.0; 2], shape: Vec::new() });
    };
    let beam = |plane: Plane| model.problem_in(plane, lateral.depth_m)?.solve();
    let beams = [beam(Plane::Y)?, beam(Plane::X)?];
    let deflections_at = |z_m: f64| beams.each_ref().map(|beam| beam.deflection_m(1.0, z_m));
    Ok(Slopes {
        force_n_per_m: beams.each_ref().map(|beam| beam.lateral_stiffness_n_per_m()),
        shape: lateral.shape.iter().map(|point| deflections_at(point.z_m)).collect(),
    })
}

/// Covariance of the sensors' noise for data of one channel.
fn block(run: &Run, range: Range<usize>, noise: &Noise, slopes: &Slopes) -> DMatrix<f64> {
    let data = &run.data[range];
    let n = data.len();
    let plane = data.first().map_or(0, |d| d.channel.plane());
    let reading_variance = noise.displacement.white + noise.displacement.correlated;
    DMatrix::from_fn(n, n, |i, j| {
        if j > i {
            return 0.0;
        }
        match (&data[i].source, &data[j].source) {
            (Source::Force(a), Source::Force(b)) => {
                let times_s = &run.cells.time_s;
                let (first, last) = (times_s[a[0]], times_s[b[b.len() - 1]]);
                let mut sum = 0.0;
                if i == j || first - last < REACH * noise.force.memory {
                    for p in a {
                        for q in b {
                            sum += noise.force.covariance(times_s[*p] - times_s[*q]);
                        }
                    }
                }
                let mut covariance = sum / (a.len() * b.len()) as f64;
                if data[i].part == data[j].part {
                    covariance += noise.force.lasting;
                }
                if i == j {
                    covariance += noise.force.white / a.len() as f64;
                }
                // The error of the trajectory of guide 2 between holds changes the forces.
                let window_covariance: f64 =
                    run.cells.windows[plane].iter().map(|window| window.covariance_of(a, b)).sum();
                covariance += slopes.force_n_per_m[plane].powi(2) * reading_variance * window_covariance;
                covariance
            }
            (Source::Shape(_), Source::Shape(_)) => {
                along_line(&noise.shape, data[i].place.depth_m - data[j].place.depth_m, i == j)
            }
            (Source::Tip(_), Source::Tip(_)) => {
                along_line(&noise.tip, data[i].place.depth_m - data[j].place.depth_m, i == j)
            }
            (Source::Direction(_), Source::Direction(_)) => {
                along_line(&noise.direction, data[i].place.depth_m - data[j].place.depth_m, i == j)
            }
            _ => 0.0,
        }
    })
    .map_with_upper()
}

/// Fills the upper triangle from the lower one.
trait Symmetric {
    fn map_with_upper(self) -> Self;
}

impl Symmetric for DMatrix<f64> {
    fn map_with_upper(mut self) -> Self {
        self.fill_upper_triangle_with_lower_triangle();
        self
    }
}

fn along_line(sensor: &super::noise::Sensor, apart_m: f64, same: bool) -> f64 {
    sensor.covariance(apart_m) + sensor.lasting + if same { sensor.white } else { 0.0 }
}

/// Patterns of shared errors, each for one standard deviation: position of guide 2 in holds, zero of a tip sensor.
fn patterns(run: &Run, noise: &Noise, slopes: &Slopes) -> Vec<Vec<f64>> {
    let mut patterns = Vec::new();
    match &run.experiment {
        Experiment::Lateral(_) => {
            for plane in 0..2 {
                for part in 0..run.parts() {
                    let (count, length_s) = hold_size(run, part);
                    let sd_m =
                        noise.displacement.of_mean(count, length_s).sqrt().hypot(rig::GUIDE2_PLACE.sd());
                    let pattern: Vec<f64> = run
                        .data
                        .iter()
                        .map(|d| {
                            let is_same_part =
                                d.part == part && d.channel.plane() == plane && d.place.hold_s.is_some();
                            match &d.source {
                                _ if !is_same_part => 0.0,
                                Source::Force(_) => sd_m * slopes.force_n_per_m[plane],
                                Source::Shape(point) => sd_m * slopes.shape[*point][plane],
                                Source::Tip(_) | Source::Direction(_) => 0.0,
                            }
                        })
                        .collect();
                    if pattern.iter().any(|v| *v != 0.0) {
                        patterns.push(pattern);
                    }
                }
            }
        }
        _ => {
            for channel in [Channel::TipY, Channel::TipX] {
                let pattern_of = |value: &dyn Fn(usize) -> f64| -> Vec<f64> {
                    run.data
                        .iter()
                        .map(|d| match d.source {
                            Source::Tip(index) if d.channel == channel => value(index),
                            _ => 0.0,
                        })
                        .collect()
                };
                if run.data.iter().any(|d| d.channel == channel) {
                    patterns.push(pattern_of(&|_| sensors::SHARED_TIP_ZERO.sd()));
                }
            }
        }
    }
    patterns
}

/// Pattern of the error of the positions that all points of a shape share, for one standard deviation; `None` if it is not stated.
fn shared_positions(run: &Run, model: &Model) -> Result<Option<Vec<f64>>, ModelError> {
    if run.z_shared_sd_m.iter().all(|sd_m| *sd_m == 0.0) {
        return Ok(None);
    }
    let (mut lower_experiment, mut upper_experiment) = (run.experiment.clone(), run.experiment.clone());
    for (experiment, step_m) in
        [(&mut lower_experiment, -SLOPE_STEP_M), (&mut upper_experiment, SLOPE_STEP_M)]
    {
        if let Experiment::Lateral(lateral) = experiment {
            lateral.shape.iter_mut().for_each(|point| point.z_m += 0.5 * step_m);
        }
    }
    let predicted_under =
        |experiment: &Experiment| Ok::<_, ModelError>(predicted(run, &predict(model, experiment)?));
    let (lower_values, upper_values) =
        (predicted_under(&lower_experiment)?, predicted_under(&upper_experiment)?);
    let moved = |(datum, (upper_values, lower_values)): (&super::data::Datum, (f64, f64))| match datum.source
    {
        Source::Shape(point) => {
            run.z_shared_sd_m.get(point).copied().unwrap_or(0.0) * (upper_values - lower_values)
                / SLOPE_STEP_M
        }
        Source::Force(_) | Source::Tip(_) | Source::Direction(_) => 0.0,
    };
    Ok(Some(run.data.iter().zip(upper_values.into_iter().zip(lower_values)).map(moved).collect()))
}

/// Patterns of the errors of the deflections that all points of a shape share, each for one standard deviation; none if they are not
/// stated.
fn shared_deflections(run: &Run) -> impl Iterator<Item = Vec<f64>> {
    let planes = (0..2).flat_map(|plane| (0..SHARED_ERRORS).map(move |error| (plane, error)));
    planes
        .map(|(plane, error)| {
            run.data
                .iter()
                .map(|datum| match datum.source {
                    Source::Shape(point) if datum.channel.plane() == plane => {
                        run.shared_m.get(point).map_or(0.0, |of| of[plane][error])
                    }
                    _ => 0.0,
                })
                .collect()
        })
        .filter(|pattern: &Vec<f64>| pattern.iter().any(|value| *value != 0.0))
}

/// Number of cells of a hold, and its length in seconds.
fn hold_size(run: &Run, part: usize) -> (usize, f64) {
    let of_hold = || run.cells.time_s.iter().zip(&run.cells.hold).filter(|(_, hold)| **hold == Some(part));
    let length_s = of_hold().next_back().zip(of_hold().next()).map_or(0.0, |((b, _), (a, _))| b - a);
    (of_hold().count(), length_s)
}
