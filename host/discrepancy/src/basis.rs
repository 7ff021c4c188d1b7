//! The discrepancy that every model has: small smooth functions of every regressor at every site, and offsets of single runs.
//!
//! The null hypothesis has to contain a small counterpart of every law, because no model is exact and small true laws would
//! otherwise be named everywhere. The counterpart of the laws of a regressor is a sum of `cos(k pi x)` with amplitudes that fall
//! as `1 / k`, the spectrum of functions with jumps. Its size, the effect on the channels in units of their standard
//! deviations, maximizes the evidence.

use super::bench::{Bench, Law, rms};
use super::evidence::Group;
use super::fit::Fitted;
use super::form::Form;
use super::model::Error;
use super::score::{ALL_ELIMINATED, no_covariance};
use nalgebra::{DMatrix, DVector};

/// Number of cosines of one regressor: the period of the shortest is a quarter of the range.
const FUNCTIONS: u8 = 8;
/// The prior of a size above the everyday one is half-normal with half of it as standard deviation: 95 % of these sizes are below
/// twice the everyday one.
const TAIL: f64 = 0.5;
/// The prior of a size below the everyday one is log-normal: 95 % of these sizes are above a twentieth of it.
const SMALLER_SD_LN: f64 = 1.5;

/// Offsets of runs in the discrepancy.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Offsets {
    None,
    Everyday,
}

impl Offsets {
    /// If only one run is fitted, an offset of the run and a constant law are the same function, and held-out runs decide whether
    /// there is a law. Therefore the basis of the search then has no offsets.
    fn of_search(bench: &Bench<'_>) -> Self {
        if bench.training.len() > 1 { Self::Everyday } else { Self::None }
    }
}

/// Basis functions of the discrepancy in the unit of the residuals, before whitening.
pub(crate) struct Basis {
    pub groups: Vec<Group>,
    /// Site and regressor of each group; `None` for the offsets of runs.
    pub sources: Vec<Option<(usize, usize)>>,
    pub shared_groups: Vec<usize>,
    /// For each run, readings by shared functions.
    pub shared: Vec<DMatrix<f64>>,
    /// For each run, readings by its own offsets, all in the last group.
    pub own: Vec<DMatrix<f64>>,
    /// Error of each parameter of a fit (rows) per unit of each basis function (columns), by the part of the function that was
    /// projected out.
    absorbed: DMatrix<f64>,
}

fn group(name: &'static str, everyday: f64) -> Group {
    Group { name, everyday, tail: Some(TAIL), smaller_sd_ln: SMALLER_SD_LN, multiple: 1.0 }
}

impl Basis {
    /// Basis around the prior means, for a first fit.
    ///
    /// # Errors
    /// Where the model fails for other reasons than these values.
    pub fn of_start(bench: &Bench<'_>, start: &[f64], everyday: f64) -> Result<Self, Error> {
        let offsets = Offsets::of_search(bench);
        Self::new(bench, &[], start, everyday, offsets)
    }

    /// Basis around a model with these laws and parameter values; `everyday` is the typical size of every group.
    fn new(
        bench: &Bench<'_>,
        laws: &[Law],
        values: &[f64],
        everyday: f64,
        offsets: Offsets,
    ) -> Result<Self, Error> {
        let terms = bench.terms(laws, values);
        let plain = bench.residuals(laws, values)?;
        let (mut groups, mut sources, mut shared_groups) = (Vec::new(), Vec::new(), Vec::new());
        let mut columns: Vec<Vec<DVector<f64>>> = vec![Vec::new(); plain.len()];
        for (site, spans) in bench.spans.iter().enumerate() {
            for (regressor, span) in spans.iter().enumerate() {
                let mut functions = Vec::new();
                for k in 1..=FUNCTIONS {
                    let (form, amplitude_sds) = (Form::Cosine(k), vec![1.0]);
                    let law = Law { site, regressor: Some(regressor), form, span: *span, amplitude_sds };
                    let Some(run_columns) = bench.columns(&law, None, values, &terms, &plain)? else {
                        continue;
                    };
                    functions.push(
                        run_columns.iter().map(|column| column.column(0) / f64::from(k)).collect::<Vec<_>>(),
                    );
                }
                let squares = functions.iter().map(|run_columns| rms(run_columns.iter().cloned()).powi(2));
                let size = squares.sum::<f64>().sqrt();
                if size.is_finite() && size > 0.0 {
                    shared_groups.extend(std::iter::repeat_n(groups.len(), functions.len()));
                    groups.push(group("function", everyday));
                    sources.push(Some((site, regressor)));
                    for run_columns in functions {
                        for (run_list, column) in columns.iter_mut().zip(run_columns) {
                            run_list.push(column / size);
                        }
                    }
                }
            }
        }
        groups.push(group("offset of a run", everyday));
        sources.push(None);
        let shared = columns.iter().zip(&plain).map(|(columns, residuals)| {
            if columns.is_empty() {
                DMatrix::zeros(residuals.len(), 0)
            } else {
                DMatrix::from_columns(columns)
            }
        });
        let shared = shared.collect();
        let channels = if offsets == Offsets::Everyday { bench.scales.len() } else { 0 };
        let offsets = bench.training.iter().map(|prepared| {
            let mut offsets = DMatrix::zeros(prepared.rows(), channels);
            for channel in 0..channels {
                let rows = prepared.rows_of(channel);
                offsets.view_mut((rows.start, channel), (rows.len(), 1)).fill(1.0);
            }
            offsets
        });
        let absorbed = DMatrix::zeros(0, shared_groups.len());
        Ok(Self { groups, sources, shared_groups, shared, own: offsets.collect(), absorbed })
    }

    /// Basis around a fit for the search, with the directions of the model's parameters projected out. The directions of the laws
    /// are not projected out, because otherwise small remainders of a law would be found again as further laws.
    ///
    /// # Errors
    /// If the model fails for other reasons than these values, or the parameters have no covariance.
    pub fn of_search(bench: &Bench<'_>, fitted: &Fitted, everyday: f64) -> Result<Self, Error> {
        let offsets = Offsets::of_search(bench);
        let mut basis = Self::new(bench, &fitted.laws, &fitted.values, everyday, offsets)?;
        basis.take_off(bench, fitted, bench.model.parameters().len())?;
        Ok(basis)
    }

    /// Basis around a fit for estimates and intervals, with the directions of parameters and laws projected out, so that these
    /// have the values that predict best without the discrepancy. Here a run has its offset even if it is the only run.
    ///
    /// # Errors
    /// If the model fails for other reasons than these values, or the parameters have no covariance.
    pub fn of_values(bench: &Bench<'_>, fitted: &Fitted, everyday: f64) -> Result<Self, Error> {
        let mut basis = Self::new(bench, &fitted.laws, &fitted.values, everyday, Offsets::Everyday)?;
        basis.take_off(bench, fitted, fitted.values.len())?;
        Ok(basis)
    }

    /// Projects the sensitivities to the first `numbers` parameters of a fit out of the basis functions, as far as the data determine
    /// these parameters better than their priors do (Plumlee, "Bayesian calibration of inexact computer models", J. Am. Stat. Assoc.
    /// 112:1274, 2017).
    fn take_off(&mut self, bench: &Bench<'_>, fitted: &Fitted, numbers: usize) -> Result<(), Error> {
        let coordinates = bench.coordinates(&fitted.laws);
        let noise = rms(fitted.residuals.iter().cloned()).max(f64::MIN_POSITIVE);
        let mut directions: Vec<DMatrix<f64>> = Vec::with_capacity(fitted.jacobian.len());
        for jacobian in &fitted.jacobian {
            let mut columns = jacobian.columns(0, numbers.min(jacobian.ncols())).into_owned();
            for (mut column, coordinate) in columns.column_iter_mut().zip(&coordinates) {
                column *= coordinate.sd / noise;
            }
            directions.push(columns);
        }
        let mut gram = DMatrix::identity(numbers, numbers);
        let mut products = DMatrix::zeros(numbers, self.shared_groups.len());
        for (columns, shared) in directions.iter().zip(&self.shared) {
            gram.gemm_tr(1.0, columns, columns, 1.0);
            products.gemm_tr(1.0, columns, shared, 1.0);
        }
        let amounts = gram.cholesky().ok_or_else(no_covariance)?.solve(&products);
        for (columns, shared) in directions.iter().zip(&mut self.shared) {
            shared.gemm(-1.0, columns, &amounts, 1.0);
        }
        self.absorbed = DMatrix::from_fn(numbers, amounts.ncols(), |number, function| {
            coordinates.get(number).map_or(0.0, |one| one.sd / noise * amounts[(number, function)])
        });
        self.normalise();
        Ok(())
    }

    /// Covariance of the parameters' errors by the discrepancy that they absorb, for groups of these sizes: the value that predicts
    /// best differs from the true one by the absorbed part.
    pub fn covariance_of_absorbed(&self, sizes: &[f64]) -> DMatrix<f64> {
        let mut scaled = self.absorbed.clone();
        for (mut column, group) in scaled.column_iter_mut().zip(&self.shared_groups) {
            column *= sizes.get(*group).copied().unwrap_or(0.0);
        }
        &scaled * scaled.transpose()
    }

    /// Scales every group of functions so that size 1 has effect 1 on the channels; a group that was projected out entirely stays as
    /// it is.
    fn normalise(&mut self) {
        for group in 0..self.groups.len() {
            let of_group = self.shared_groups.iter().enumerate().filter(|(_, one)| **one == group);
            let columns: Vec<usize> = of_group.map(|(column, _)| column).collect();
            let square: f64 = columns
                .iter()
                .map(|column| {
                    rms(self.shared.iter().map(|shared| shared.column(*column).into_owned())).powi(2)
                })
                .sum();
            if square > ALL_ELIMINATED {
                for shared in &mut self.shared {
                    for column in &columns {
                        let mut column = shared.column_mut(*column);
                        column /= square.sqrt();
                    }
                }
            }
        }
    }

    /// Effect on a channel that counts as negligible, in units of the channel's standard deviation.
    pub fn everyday_effect(&self) -> f64 {
        self.groups.iter().map(|group| group.everyday).fold(0.0, f64::max)
    }

    /// Typical sizes of all groups.
    pub fn everyday(&self) -> Vec<f64> {
        self.groups.iter().map(|group| group.everyday).collect()
    }
}
