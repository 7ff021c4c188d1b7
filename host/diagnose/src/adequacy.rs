//! Adequacy of a model, and the regions in which it is inadequate (theory, eq. 67).
//!
//! The missing part of a model is assumed to be smooth in the coordinates of the data: depth, displacement, direction of motion,
//! time. Two tests are applied to the residuals of a fit, with the sensitivities to the parameters projected out:
//!
//! * the sum of squares in smooth functions of the coordinates, channel by channel ([`Adequacy`]): a chi-square with as many
//!   degrees of freedom as functions, sensitive to any missing effect;
//! * the most significant interval of a coordinate, in one channel, with equal or opposite signs on both sides of zero
//!   ([`regions`]): a scan statistic relative to noise and typical imperfections, corrected for the number of intervals tried.

mod regions;

pub use regions::region_coordinates;
pub(super) use regions::{Region, allowed_sizes, has_regions_beyond_prior, regions};

use super::data::{Channel, Datum, Kind};
use super::evidence::Patterns;
use super::layout::Prepared;
use super::posterior::Fitted;
use super::score::{NOISE_TOLERANCE, stacked};
use nalgebra::{DMatrix, DVector};
use readings::FitError;
use statrs::distribution::{ChiSquared, ContinuousCDF};

/// A model is inadequate if the p-value of the smooth structure in its residuals is below this.
pub(super) const LEVEL: f64 = 1e-4;
/// Smallest eigenvalue of the functions' scalar products, relative to the largest: a smaller one belongs to a combination of functions that
/// is zero but for rounding.
const MIN_DIRECTION: f64 = 1e-9;

/// Chi-square in smooth functions of the coordinates.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Structure {
    pub chi_square: f64,
    /// Number of the functions.
    pub functions: usize,
    /// p-value.
    pub p: f64,
}

/// Remaining smooth structure.
#[derive(Debug, Clone)]
pub(super) struct Adequacy {
    /// Structure relative to noise alone.
    pub noise: Structure,
    /// Structure relative to noise and the typical discrepancy of a rig.
    pub everyday: Structure,
    /// Sum of the squared whitened residuals of every channel, and their number.
    pub channels: Vec<(Channel, f64, usize)>,
    /// Standard deviation of the smooth discrepancy per channel, SI.
    pub discrepancy: Vec<(Channel, f64)>,
}

impl Adequacy {
    /// Adequacy of a fit.
    ///
    /// # Errors
    /// Where the model cannot be evaluated.
    pub fn of(fitted: &Fitted, runs: &[Prepared], patterns: &Patterns) -> Result<Self, FitError> {
        let residuals = stacked(&fitted.residuals);
        let plain = smooth_functions(runs);
        let channels = channel_squares(runs, &residuals);
        let no_structure = Structure { chi_square: 0.0, functions: 0, p: 1.0 };
        if plain.is_empty() {
            return Ok(Self {
                noise: no_structure,
                everyday: no_structure,
                channels,
                discrepancy: Vec::new(),
            });
        }
        let mut columns: Vec<DVector<f64>> = plain.iter().map(|column| whitened(runs, column)).collect();
        // The functions have very different sizes, and are scaled to unit length.
        let scale: Vec<f64> =
            columns.iter().map(|column| 1.0 / column.norm().max(f64::MIN_POSITIVE)).collect();
        columns.iter_mut().zip(&scale).for_each(|(column, scale)| *column *= *scale);
        columns.push(residuals);
        let of_runs = by_run(runs, &columns);
        let products = fitted.products_beside_parameters(patterns, &of_runs);
        let beside_noise = fitted.eliminated(patterns, &vec![0.0; patterns.groups.len()], &products);
        let (noise, coefficients) = structure(&beside_noise.ok_or(FitError::Undetermined)?.0);
        let beside_everyday = fitted.eliminated(patterns, &patterns.everyday(), &products);
        let (everyday, _) = structure(&beside_everyday.ok_or(FitError::Undetermined)?.0);
        // The sensitivities to the parameters are projected out of the discrepancy, and the whitening is undone.
        let smooth: Vec<DVector<f64>> =
            of_runs.iter().map(|columns| columns.columns(0, plain.len()) * &coefficients).collect();
        let free_of_parameters = fitted.less_parameters(&smooth).ok_or(FitError::Undetermined)?;
        let undone = runs.iter().zip(free_of_parameters).map(|(run, mut free_of_parameters)| {
            run.whitener.undo(&mut free_of_parameters);
            free_of_parameters
        });
        let discrepancy: Vec<f64> = undone.flatten().collect();
        let discrepancy = Channel::ALL
            .into_iter()
            .filter_map(|channel| {
                let of_channel = all_data(runs).zip(&discrepancy);
                let of_channel = of_channel.filter(|((run, d), _)| d.channel == channel && is_tested(run));
                let (sum, count) =
                    of_channel.fold((0.0, 0), |(sum, n), (_, value)| (sum + value * value, n + 1));
                (count > 0).then(|| (channel, (sum / f64::from(count)).sqrt()))
            })
            .collect();
        Ok(Self { noise, everyday, channels, discrepancy })
    }

    /// Whether the residuals are consistent with noise and the typical discrepancy of a rig.
    pub fn is_adequate(&self) -> bool {
        self.everyday.p >= LEVEL
    }

    /// Whether the residuals are consistent with noise alone.
    pub fn is_within_noise(&self) -> bool {
        self.noise.p >= LEVEL
    }
}

/// Structure in the residuals along the functions, and the functions' coefficients, shrunk by the expected contribution of the noise. The
/// scalar products are those of the functions and, as the last column, of the residuals.
fn structure(products: &DMatrix<f64>) -> (Structure, DVector<f64>) {
    let count = products.ncols() - 1;
    let eigen = products.view((0, 0), (count, count)).into_owned().symmetric_eigen();
    let projections = products.view((0, count), (count, 1)).column(0).into_owned();
    let largest = eigen.eigenvalues.max();
    let (mut chi_square, mut functions) = (0.0, 0);
    let mut coefficients = DVector::zeros(count);
    for (value, vector) in eigen.eigenvalues.iter().zip(eigen.eigenvectors.column_iter()) {
        if *value > MIN_DIRECTION * largest {
            let projected = vector.dot(&projections);
            chi_square += projected * projected / value;
            functions += 1;
            // The discrepancy is the excess over the noise.
            let shrunk = (1.0 - value / (projected * projected)).max(0.0);
            coefficients.axpy(shrunk * projected / value, &vector, 1.0);
        }
    }
    let p = ChiSquared::new(functions as f64)
        .map_or(1.0, |distribution| distribution.sf(chi_square / NOISE_TOLERANCE));
    (Structure { chi_square, functions, p }, coefficients)
}

/// Whether a run is tested for adequacy. The runs of the reference are not: the diagnosis is about the session.
fn is_tested(run: &Prepared) -> bool {
    !run.run.is_reference
}

/// Every datum with its run.
fn all_data(runs: &[Prepared]) -> impl Iterator<Item = (&Prepared, &Datum)> {
    runs.iter().flat_map(|run| run.run.data.iter().map(move |datum| (run, datum)))
}

fn channel_squares(runs: &[Prepared], residuals: &DVector<f64>) -> Vec<(Channel, f64, usize)> {
    Channel::ALL
        .into_iter()
        .map(|channel| {
            let squares = all_data(runs).zip(residuals.iter());
            let squares = squares.filter(|((run, d), _)| d.channel == channel && is_tested(run));
            let (sum, count) = squares.fold((0.0, 0), |(sum, n), (_, r)| (sum + r * r, n + 1));
            (channel, sum, count)
        })
        .filter(|(_, _, count)| *count > 0)
        .collect()
}

/// A column in SI, whitened.
fn whitened(runs: &[Prepared], column: &[f64]) -> DVector<f64> {
    let mut values = column.to_vec();
    let mut start = 0;
    for run in runs {
        let end = start + run.run.data.len();
        if values[start..end].iter().any(|v| *v != 0.0) {
            run.whitener.apply(&mut values[start..end]);
        }
        start = end;
    }
    DVector::from_vec(values)
}

/// A function of a datum.
type Function<'a> = Box<dyn Fn(&Datum) -> f64 + 'a>;

/// Ranges of the coordinates over the data, by which the coordinates are scaled to order one.
struct Ranges {
    level_m: f64,
    depth_m: f64,
    /// Depths of the shallowest and the deepest lateral run.
    run_depths_m: (f64, f64),
    /// Duration of the longest lateral run.
    length_s: f64,
}

impl Ranges {
    fn of(runs: &[Prepared]) -> Self {
        let lateral = runs.iter().map(|run| &run.run).filter(|run| run.kind == Kind::Lateral);
        let times_s = lateral.clone().flat_map(|run| &run.data).map(|datum| datum.place.time_s);
        Self {
            level_m: all_data(runs).map(|(_, datum)| datum.place.level_m.abs()).fold(1e-9, f64::max),
            depth_m: all_data(runs).map(|(_, datum)| datum.place.depth_m.abs()).fold(1e-9, f64::max),
            length_s: times_s.fold(1e-9, f64::max),
            run_depths_m: lateral
                .map(|run| run.depth_m)
                .fold((f64::MAX, f64::MIN), |(least, most), depth_m| (least.min(depth_m), most.max(depth_m))),
        }
    }

    fn has_several_depths(&self) -> bool {
        self.run_depths_m.1 - self.run_depths_m.0 > 1e-3
    }

    fn run_depth(&self, run: &Prepared) -> f64 {
        let (least_m, most_m) = self.run_depths_m;
        (run.run.depth_m - least_m) / (most_m - least_m).max(1e-9) - 0.5
    }

    fn level(&self, datum: &Datum) -> f64 {
        datum.place.level_m / self.level_m
    }

    fn depth(&self, datum: &Datum) -> f64 {
        2.0 * datum.place.depth_m / self.depth_m - 1.0
    }

    fn legendre_of_level(&self, n: usize, datum: &Datum) -> f64 {
        legendre(n, self.level(datum))
    }

    fn legendre_of_depth(&self, n: usize, datum: &Datum) -> f64 {
        legendre(n, self.depth(datum))
    }
}

/// Legendre's polynomial of a degree.
fn legendre(degree: usize, x: f64) -> f64 {
    let (mut previous, mut now) = (0.0, 1.0);
    for k in 0..degree {
        (previous, now) = (now, ((2 * k + 1) as f64 * x * now - k as f64 * previous) / (k + 1) as f64);
    }
    now
}

/// Smooth functions of the coordinates, in SI, each for one channel and one axis of the lateral runs, or for insertions.
fn smooth_functions(runs: &[Prepared]) -> Vec<Vec<f64>> {
    let ranges = &Ranges::of(runs);
    let mut columns = Vec::new();
    for channel in Channel::ALL {
        for axis in 0..2 {
            let of_force = matches!(channel, Channel::ForceY | Channel::ForceX);
            let of_tip = channel.is_of_insertions();
            let active = channel.plane() == axis;
            let mut functions: Vec<Function<'_>> = Vec::new();
            if of_tip {
                if axis == 0 {
                    functions.extend(
                        (0..8).map(|n| -> Function<'_> { Box::new(move |d| ranges.legendre_of_depth(n, d)) }),
                    );
                }
            } else if of_force {
                functions.extend(
                    (0..if active { 5 } else { 3 })
                        .map(|n| -> Function<'_> { Box::new(move |d| ranges.legendre_of_level(n, d)) }),
                );
                functions.push(Box::new(move |d| d.place.direction));
                functions.push(Box::new(move |d| d.place.direction * ranges.level(d)));
                functions.push(Box::new(move |d| ranges.level(d).abs()));
                // The first function decays within holds, and the second is zero in holds.
                functions.push(Box::new(move |d| {
                    d.place.hold_s.map_or(1.0, |s| (-s / 0.7).exp()) * d.place.direction
                }));
                functions
                    .push(Box::new(move |d| if d.place.hold_s.is_none() { d.place.direction } else { 0.0 }));
                let harmonics = if active { 4 } else { 2 };
                for harmonic in 1..=harmonics {
                    let turn = std::f64::consts::TAU * f64::from(harmonic) / ranges.length_s;
                    functions.push(Box::new(move |d| (turn * d.place.time_s).sin()));
                    functions.push(Box::new(move |d| (turn * d.place.time_s).cos()));
                }
                functions.push(Box::new(move |d| d.place.time_s / ranges.length_s - 0.5));
            } else {
                let powers = if active { 5 } else { 3 };
                for n in 0..powers {
                    functions.push(Box::new(move |d| ranges.legendre_of_depth(n, d)));
                    functions.push(Box::new(move |d| ranges.legendre_of_depth(n, d) * ranges.level(d)));
                    if active {
                        functions
                            .push(Box::new(move |d| ranges.legendre_of_depth(n, d) * ranges.level(d).abs()));
                    }
                }
                if active {
                    functions.push(Box::new(move |d| d.place.direction));
                    functions.push(Box::new(move |d| d.place.direction * ranges.depth(d)));
                }
            }
            let belongs = all_data(runs).map(|(run, d)| {
                d.channel == channel
                    && is_tested(run)
                    && (of_tip || (run.run.kind == Kind::Lateral && run.run.axis == axis))
            });
            let belongs: Vec<bool> = belongs.collect();
            if !belongs.contains(&true) {
                continue;
            }
            for function in &functions {
                let values = all_data(runs).zip(&belongs);
                let values: Vec<f64> =
                    values.map(|((_, d), belongs)| if *belongs { function(d) } else { 0.0 }).collect();
                columns.push(values.clone());
                // The same functions with opposite signs for turned and unturned insertions, or in proportion to the depth of lateral runs.
                if of_tip || (active && ranges.has_several_depths()) {
                    let factors = all_data(runs)
                        .map(|(run, _)| if of_tip { run.run.turned() } else { ranges.run_depth(run) });
                    columns.push(values.iter().zip(factors).map(|(value, factor)| factor * value).collect());
                }
            }
        }
    }
    columns
}

/// Columns over all runs, as one matrix per run.
fn by_run(runs: &[Prepared], columns: &[DVector<f64>]) -> Vec<DMatrix<f64>> {
    let combined = DMatrix::from_columns(columns);
    let mut start = 0;
    runs.iter()
        .map(|run| {
            let rows = run.run.data.len();
            start += rows;
            combined.rows(start - rows, rows).into_owned()
        })
        .collect()
}
