//! Posterior of all unknowns from the tip readings so far, by Gauss-Newton steps on the forward model, for each law of the tip
//! (theory, eq. 77 and 78).
//!
//! Readings are gathered into bins (one rest at a node, or the way between two nodes): ten readings a second at one place are not
//! ten
//! independent tests of the model. A bin's residual is weighted as Student's t, so that a jump that slipped through counts
//! little.

use crate::history::{History, Place};
use crate::readings::Bin;
use crate::tables::{self, Columns, Tables};
use crate::unknowns::{CuttingLaw, TISSUE, Unknowns};
use mechanics::ModelError;
use mechanics::unknowns::tip::ROUGHNESS;
use nalgebra::{DMatrix, DVector};
use std::sync::Arc;

/// Degrees of freedom of a bin's residual.
const FREEDOM: f64 = 5.0;
/// Step of finite differences, in standard deviations.
const DIFFERENCE: f64 = 0.1;
const ROUNDS: usize = 2;
/// Responses per unknown of the tissue are computed again where the tissue is this far from where they were, in standard
/// deviations.
const STALE: f64 = 0.3;

/// Error of the model in the stiffness that guide 2 feels, a share: what yielding and relaxing of tissue make of it. It is alike at all stops, so that many moves together are no
/// better a witness than one.
pub(crate) const STIFFNESS_ERROR: f64 = 0.15;

/// The stiffness that guide 2 has felt in a move at rest.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Felt {
    /// Number of the node.
    pub node: usize,
    /// Logarithm of the force per displacement, N/m.
    pub ln_n_per_m: f64,
    /// Its standard deviation by noise and play.
    pub sd: f64,
}

/// The needle's responses at some values of the tissue's unknowns, and with each of them raised by a difference.
struct Linearised {
    at: [f64; TISSUE],
    base: Arc<Tables>,
    raised: Vec<Arc<Tables>>,
    /// Gains at all nodes, at the base and with each unknown raised.
    gains: Vec<Vec<f64>>,
}

/// Posterior of one law.
#[derive(Clone)]
pub(crate) struct Hypothesis {
    pub unknowns: Unknowns,
    /// Likeliest values, in standard deviations of the prior.
    pub values: Vec<f64>,
    /// Logarithm of the prior's weight.
    ln_prior: f64,
    /// Logarithm of the evidence, weight included.
    pub ln_evidence: f64,
    /// Squared residuals per degree of freedom, where they exceed one.
    pub misfit: f64,
    /// Whether the tissue stays at the prior's mean.
    pub tissue_known: bool,
    /// Stiffness felt by guide 2 so far.
    pub felt: Vec<Felt>,
    /// Responses as last computed, and those with which the path is linearised.
    current: Option<([f64; TISSUE], Arc<Tables>)>,
    linearised: Option<Arc<Linearised>>,
}

/// Posterior of the tip at the target.
pub(crate) struct AtTarget {
    /// Tip of both planes if nothing more is moved, m.
    pub tip_m: [f64; 2],
    /// Its derivatives with respect to all unknowns, per plane.
    pub rows: [DVector<f64>; 2],
    /// Tip at the target per guide motion at rest at each requested node, kept from there on.
    pub gains: Vec<f64>,
    /// The derivatives of these gains with respect to the tissue's unknowns.
    pub gain_rows: Vec<[f64; TISSUE]>,
    /// Derivatives of the tip on leaving each requested node, per plane, while the guide stays as it is.
    pub way_rows: Vec<[DVector<f64>; 2]>,
    /// Covariance of the unknowns.
    pub covariance: DMatrix<f64>,
}

impl Hypothesis {
    pub fn new(unknowns: Unknowns, weight: f64) -> Self {
        let values = vec![0.0; unknowns.count()];
        Self {
            unknowns,
            values,
            ln_prior: weight.ln(),
            ln_evidence: weight.ln(),
            misfit: 1.0,
            tissue_known: false,
            felt: Vec::new(),
            current: None,
            linearised: None,
        }
    }

    fn tissue(&self) -> [f64; TISSUE] {
        std::array::from_fn(|place| self.values.get(place).copied().unwrap_or_default())
    }

    /// Responses at the likeliest values.
    pub fn tables(&self, history: &History) -> Result<Arc<Tables>, ModelError> {
        match &self.current {
            Some((at, tables)) if *at == self.tissue() => Ok(tables.clone()),
            _ => Ok(Arc::new(Tables::new(&self.unknowns, &self.values, &history.depths_m)?)),
        }
    }

    /// The same per unknown: those of before as long as the tissue is near them, since they take most of a replan's time.
    fn linearise(&mut self, history: &History, here: &Arc<Tables>) -> Result<Arc<Linearised>, ModelError> {
        let tissue = self.tissue();
        if let Some(linearised) = &self.linearised
            && tissue.iter().zip(&linearised.at).all(|(now, then)| (now - then).abs() <= STALE)
        {
            return Ok(linearised.clone());
        }
        let unknown = if self.tissue_known { 0 } else { TISSUE };
        let mut raised = Vec::with_capacity(unknown);
        for place in 0..unknown {
            let mut values = self.values.clone();
            values[place] += DIFFERENCE;
            raised.push(Arc::new(Tables::new(&self.unknowns, &values, &history.depths_m)?));
        }
        let gains = std::iter::once(here)
            .chain(&raised)
            .map(|tables| (0..history.depths_m.len()).map(|node| gain(tables, node, history)).collect())
            .collect();
        let linearised = Arc::new(Linearised { at: tissue, base: here.clone(), raised, gains });
        self.linearised = Some(linearised.clone());
        Ok(linearised)
    }

    /// Takes in all bins so far, and predicts the tip at the target with its gains for motion at the nodes `holds`.
    pub fn update(
        &mut self,
        bins: &[Bin],
        history: &History,
        holds: &[usize],
    ) -> Result<AtTarget, ModelError> {
        let count = self.unknowns.count();
        let last = Place::Rest(history.depths_m.len() - 1, 0);
        let target_m = history.depths_m[history.depths_m.len() - 1];
        let mut round = 0;
        loop {
            let tables = self.tables(history)?;
            self.current = Some((self.tissue(), tables.clone()));
            let linearised = self.linearise(history, &tables)?;
            let columns = Columns::new(&tables, &self.unknowns, history);
            let paths = tables::paths(&tables, &self.unknowns, &self.values, history);
            let last_round = round >= ROUNDS || bins.is_empty();
            let base = if Arc::ptr_eq(&linearised.base, &tables) {
                paths.clone()
            } else {
                self.paths_by(&linearised.base, history)
            };
            let changed: Vec<[tables::Path; 2]> =
                linearised.raised.iter().map(|raised| self.paths_by(raised, history)).collect();
            let row = |place: Place, depth_m: f64, plane: usize| {
                let mut row = DVector::zeros(count);
                columns.fill(&self.unknowns, place, depth_m, plane, row.as_mut_slice());
                let tip_here = tables::at(&base[plane], place);
                for (tissue, moved) in changed.iter().enumerate() {
                    row[tissue] = (tables::at(&moved[plane], place) - tip_here) / DIFFERENCE;
                }
                row
            };
            let mut information = self.unknowns.precision.clone();
            let now = DVector::from_column_slice(&self.values);
            let mut right = -(&self.unknowns.precision * &now);
            let (mut ln_likelihood, mut squares, mut weights) = (0.0, 0.0, 0.0);
            for bin in bins {
                for (plane, path) in paths.iter().enumerate() {
                    let row = row(bin.place, bin.depth_m, plane);
                    let residual = bin.tip_m[plane] - tables::at(path, bin.place);
                    let variance = bin.variance_m2 + ROUGHNESS.sd() * ROUGHNESS.sd();
                    let ratio = residual * residual / variance;
                    let weight = (FREEDOM + 1.0) / (FREEDOM + ratio);
                    ln_likelihood -= 0.5 * (FREEDOM + 1.0) * (ratio / FREEDOM).ln_1p() + 0.5 * variance.ln();
                    squares += weight * ratio;
                    weights += 1.0;
                    let precision = weight / variance;
                    information.ger(precision, &row, &row, 1.0);
                    right.axpy(precision * residual, &row, 1.0);
                }
            }
            for felt in self.felt.iter().filter(|_| !self.tissue_known) {
                let (Some(tip_here), Some(base)) =
                    (ln_stiffness(&tables, felt.node), ln_stiffness(&linearised.base, felt.node))
                else {
                    continue;
                };
                let mut row = DVector::zeros(count);
                for (unknown, raised) in linearised.raised.iter().enumerate() {
                    row[unknown] =
                        ln_stiffness(raised, felt.node).map_or(0.0, |raised| (raised - base) / DIFFERENCE);
                }
                let variance = STIFFNESS_ERROR.powi(2) * self.felt.len() as f64 + felt.sd * felt.sd;
                let residual = felt.ln_n_per_m - tip_here;
                ln_likelihood -= 0.5 * residual * residual / variance + 0.5 * variance.ln();
                information.ger(1.0 / variance, &row, &row, 1.0);
                right.axpy(residual / variance, &row, 1.0);
            }
            let cholesky = information.cholesky().ok_or(ModelError::Singular)?;
            if !last_round {
                let step = cholesky.solve(&right);
                // A long step of the tissue is not linear.
                let furthest = step.rows(0, TISSUE).amax();
                let step_fraction = if furthest > 1.0 { 1.0 / furthest } else { 1.0 };
                self.values
                    .iter_mut()
                    .zip(step.iter())
                    .for_each(|(value, step)| *value += step_fraction * step);
                // Near the top one step is enough.
                round = if furthest < 0.1 { ROUNDS } else { round + 1 };
                continue;
            }
            let prior = 0.5 * now.dot(&(&self.unknowns.precision * &now));
            let ln_determinant: f64 = cholesky.l_dirty().diagonal().iter().map(|d| 2.0 * d.ln()).sum();
            let occam = 0.5 * (self.unknowns.ln_determinant - ln_determinant);
            self.ln_evidence = self.ln_prior + ln_likelihood - prior + occam;
            self.misfit = if weights > 0.0 { (squares / weights).max(1.0) } else { 1.0 };
            let rows = [0, 1].map(|plane| row(last, target_m, plane));
            let gains: Vec<f64> = holds.iter().map(|node| gain(&tables, *node, history)).collect();
            let (still, moved) = linearised.gains.split_first().ok_or(ModelError::Singular)?;
            let gain_rows = holds
                .iter()
                .map(|node| {
                    let mut row = [0.0; TISSUE];
                    for (to, moved) in row.iter_mut().zip(moved) {
                        *to = (moved[*node] - still[*node]) / DIFFERENCE;
                    }
                    row
                })
                .collect();
            return Ok(AtTarget {
                tip_m: [0, 1].map(|plane: usize| tables::at(&paths[plane], last)),
                rows,
                way_rows: holds
                    .iter()
                    .map(|node| {
                        [0, 1].map(|plane| row(Place::Rest(*node, 1), history.depths_m[*node], plane))
                    })
                    .collect(),
                gains,
                gain_rows,
                covariance: cholesky.inverse() * self.misfit,
            });
        }
    }

    /// Differences for the tissue, where it was linearised.
    fn paths_by(&self, tables: &Tables, history: &History) -> [Vec<[f64; 2]>; 2] {
        tables::paths(tables, &self.unknowns, &self.values, history)
    }

    /// Derivatives of quantities with respect to all unknowns, one column for each: those of the tissue with the responses with
    /// which the path is linearised.
    pub fn derivatives(
        &self,
        history: &History,
        quantities: impl Fn(&Tables, &[f64]) -> Result<Vec<f64>, ModelError>,
    ) -> Result<DMatrix<f64>, ModelError> {
        let tables = self.tables(history)?;
        let base_quantities = quantities(&tables, &self.values)?;
        let mut rows = DMatrix::zeros(self.values.len(), base_quantities.len());
        let mut fill = |unknown: usize, raised: Vec<f64>, base: &[f64]| {
            for (column, (raised, base)) in raised.iter().zip(base).enumerate() {
                rows[(unknown, column)] = (raised - base) / DIFFERENCE;
            }
        };
        if let Some(linearised) = &self.linearised {
            let base = quantities(&linearised.base, &self.values)?;
            for (unknown, raised) in linearised.raised.iter().enumerate() {
                fill(unknown, quantities(raised, &self.values)?, &base);
            }
        }
        // Slope and irregularity carry the needle and its path along and load neither.
        let count = self.unknowns.irregularity(0, 0);
        let mut values = self.values.clone();
        for unknown in self.unknowns.guide_offset()..count {
            values[unknown] += DIFFERENCE;
            fill(unknown, quantities(&tables, &values)?, &base_quantities);
            values[unknown] = self.values[unknown];
        }
        Ok(rows)
    }

    /// The path as it is now expected, per plane, m.
    pub fn paths(&self, history: &History) -> Result<[tables::Path; 2], ModelError> {
        let tables = self.tables(history)?;
        Ok(tables::paths(&tables, &self.unknowns, &self.values, history))
    }

    /// Effect at the target of what is fixed to the needle from each node on, in the needle's frame, m.
    pub fn after(&self, history: &History, nodes: &[usize]) -> Result<Vec<[f64; 2]>, ModelError> {
        let tables = self.tables(history)?;
        Ok(nodes
            .iter()
            .map(|node| tables::after(&tables, &self.unknowns, &self.values, history, *node))
            .collect())
    }

    /// Its law.
    pub fn law(&self) -> CuttingLaw {
        self.unknowns.law
    }
}

fn ln_stiffness(tables: &Tables, node: usize) -> Option<f64> {
    tables.stiffness_n_per_m(node).map(f64::ln)
}

/// Tip at the target per motion of the guide at rest at a node, kept from there on.
pub(crate) fn gain(tables: &Tables, node: usize, history: &History) -> f64 {
    let last = history.depths_m.len() - 1;
    tables.moved_at(node).get(last).map_or(f64::NAN, |state| state.tip_m[0])
}
