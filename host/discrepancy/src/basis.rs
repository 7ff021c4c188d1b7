//! The discrepancy that every model has: small smooth functions of every regressor at every site, and offsets of single runs.
//!
//! A law that may be found needs its small counterpart in what is called nothing, or small true laws are found everywhere. The counterpart of the
//! laws of a regressor is a function with `cos(k pi x)` of amplitudes that fall as `1 / k`: functions with kinks and jumps have such spectra.
//! Its size is that of its effect on the channels, in their scales, and is found by the evidence.

use super::bench::{Bench, Law, rms};
use super::evidence::Group;
use super::form::Form;
use super::model::Error;
use nalgebra::{DMatrix, DVector};

/// Cosines of one regressor: the shortest of them has a quarter of the range from peak to trough to peak, an eighth of the range is a kink.
const FUNCTIONS: u8 = 8;
/// A size above the everyday one is half-normal with half of it as standard deviation: 95 % of sizes are below twice the stated one.
const TAIL: f64 = 0.5;
/// A size below it is log-normal: 95 % of those are above a twentieth.
const SMALLER_SD_LN: f64 = 1.5;

/// Functions in the unit of the residuals; noise has not been made independent.
pub(crate) struct Basis {
    pub groups: Vec<Group>,
    /// Site and regressor of each group; nothing of the offsets of runs.
    pub sources: Vec<Option<(usize, usize)>>,
    pub shared_groups: Vec<usize>,
    /// Readings of each run by functions that runs share.
    pub shared: Vec<DMatrix<f64>>,
    /// Readings of each run by its own offsets, all of the last group.
    pub own: Vec<DMatrix<f64>>,
}

fn group(name: &'static str, everyday: f64) -> Group {
    Group { name, everyday, tail: Some(TAIL), smaller_sd_ln: SMALLER_SD_LN, multiple: 1.0 }
}

impl Basis {
    /// Around a fit, with effects of this size in the scale of the channels as everyday ones.
    ///
    /// # Errors
    /// Where the model fails for other reasons than these values.
    pub fn new(bench: &Bench<'_>, laws: &[Law], values: &[f64], everyday: f64) -> Result<Self, Error> {
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
        // In a single run an offset of the run is a constant law: held-out runs tell whether it is one.
        let channels = if bench.training.len() > 1 { bench.scales.len() } else { 0 };
        let offsets = bench.training.iter().map(|prepared| {
            let mut offsets = DMatrix::zeros(prepared.rows(), channels);
            for channel in 0..channels {
                let rows = prepared.rows_of(channel);
                offsets.view_mut((rows.start, channel), (rows.len(), 1)).fill(1.0);
            }
            offsets
        });
        Ok(Self { groups, sources, shared_groups, shared: shared.collect(), own: offsets.collect() })
    }

    /// Everyday sizes of all groups.
    pub fn everyday(&self) -> Vec<f64> {
        self.groups.iter().map(|group| group.everyday).collect()
    }
}
