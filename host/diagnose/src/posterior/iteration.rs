//! A fit under way: Gauss and Newton's method in the metric of noise and discrepancy.
//!
//! At every point the model is linearised and the most probable sizes of the discrepancy are found for it; the step that follows is halved
//! until the objective at these sizes falls. At the end Laplace's method gives the evidence.

use super::round::{Metric, descend, in_units, jacobian, prior_sd, products, residuals, step, stepped};
use super::{Fitted, Point};
use crate::evidence::{Likeliest, Patterns};
use crate::layout::{Layout, Prepared};
use crate::weights::same;
use nalgebra::DMatrix;
use readings::{FitError, Parameter};

/// A fit has come to its end once a step is shorter than this, in posterior standard deviations: the log evidence of a point so near is lower by
/// a thousandth (`0.05^2 / 2`) per parameter, as much as the sizes of the discrepancy leave.
const SETTLED_SD: f64 = 0.05;
/// Sizes of the discrepancy are found to these gains of log evidence: at the end of a fit to a thousandth, because differences between models
/// matter from about 1 on; on the way to it within 0.3 of their posterior standard deviations (`0.3^2 / 2`), as the parameters move on.
const LEAST_GAIN: f64 = 1e-3;
const LEAST_GAIN_ON_THE_WAY: f64 = 0.045;

/// The model that is fitted, and the data.
#[derive(Clone, Copy)]
pub(crate) struct Problem<'a> {
    pub layout: &'a Layout,
    pub runs: &'a [Prepared],
    pub patterns: &'a Patterns,
    /// Known sensitivities to the first parameters, run by run, from a fit without the further parameters; empty where none are known.
    pub known: &'a [DMatrix<f64>],
}

/// The model linearised at a point.
struct Linearised {
    /// Parameters with the normal priors that stand for heavy-tailed ones at this point.
    parameters: Vec<Parameter>,
    sensitivities: Vec<DMatrix<f64>>,
    likeliest: Likeliest,
}

/// A fit at a point on its way.
pub(crate) struct Iteration<'a> {
    problem: Problem<'a>,
    point: Point,
    linearised: Linearised,
    settled: bool,
    /// The fit at the place from which it has jumped.
    before_jump: Option<Fitted>,
}

impl<'a> Iteration<'a> {
    /// Begins at these values and sizes of the discrepancy.
    ///
    /// # Errors
    /// [`FitError`] where the model has no solution there.
    pub fn new(problem: Problem<'a>, starts: &[f64], sizes: &[f64]) -> Result<Self, FitError> {
        let parameters = problem.layout.parameters(starts);
        let values: Vec<f64> = parameters.iter().map(|p| p.start.clamp(p.least, p.most)).collect();
        let point = Point { residuals: residuals(problem.layout, problem.runs, &values)?, values };
        let linearised = linearised(&problem, &point, sizes, None)?;
        Ok(Self { problem, point, linearised, settled: false, before_jump: None })
    }

    /// The same after at most so many rounds.
    ///
    /// # Errors
    /// As for [`Self::advance`].
    pub fn after(mut self, rounds: usize) -> Result<Self, FitError> {
        for _ in 0..rounds {
            self.advance()?;
        }
        Ok(self)
    }

    /// One round: a step, after which the model is linearised again. A fit that has settled stays.
    ///
    /// # Errors
    /// [`FitError`] if there is no step, or the model has no derivatives after it.
    pub fn advance(&mut self) -> Result<(), FitError> {
        if self.settled {
            return Ok(());
        }
        let Problem { layout, runs, patterns, .. } = self.problem;
        let Linearised { parameters, likeliest: Likeliest { evidence, sizes, .. }, .. } = &self.linearised;
        let step = step(parameters, &self.point.values, evidence).ok_or(FitError::Undetermined)?;
        let is_short = step.iter().zip(parameters).enumerate().all(|(i, (step, p))| {
            step.abs() <= SETTLED_SD * evidence.covariance[(i, i)].sqrt() * prior_sd(p)
        });
        let metric = Metric::new(patterns, sizes).ok_or(FitError::Undetermined)?;
        if let Some(next) = descend(layout, runs, &metric, parameters, &self.point, &step) {
            // After a short step the sensitivities are as before.
            let same_sensitivities = is_short.then(|| self.linearised.sensitivities.clone());
            self.linearised = linearised(&self.problem, &next, sizes, same_sensitivities)?;
            (self.point, self.settled) = (next, is_short);
            return Ok(());
        }
        // No fraction of the step lowers the objective. If the linearised model promises more, the objective may have a jump on the way,
        // where the depth or time of an effect passes that of a reading: the fit continues once from the end of the whole step.
        let there = if self.before_jump.is_none() && !is_short {
            stepped(layout, runs, &self.point, &step)
        } else {
            None
        };
        let Some(there) = there else { return self.settle() };
        let here = self.fitted(true)?;
        let is_between = 2.0 * (here.promised - here.log_evidence) > same();
        self.before_jump = Some(here);
        if !is_between {
            return self.settle();
        }
        self.linearised = linearised(&self.problem, &there, &self.linearised.likeliest.sizes, None)?;
        self.point = there;
        Ok(())
    }

    /// Ends at the present point.
    fn settle(&mut self) -> Result<(), FitError> {
        let Linearised { sensitivities, likeliest, .. } = &self.linearised;
        let same_sensitivities = Some(sensitivities.clone());
        self.linearised = linearised(&self.problem, &self.point, &likeliest.sizes, same_sensitivities)?;
        self.settled = true;
        Ok(())
    }

    /// Logarithm of the evidence at the point, up to the volume of the sizes of the discrepancy, which points of one model share.
    pub fn reached(&self) -> Option<f64> {
        let Linearised { parameters, likeliest: Likeliest { sizes, evidence, .. }, .. } = &self.linearised;
        let squares = Metric::new(self.problem.patterns, sizes)?.squares(parameters, &self.point);
        Some(self.tails() - 0.5 * squares - evidence.half_ln_determinant - evidence.size_prior)
    }

    /// The same at the optimum of the model linearised here: the expected value at convergence.
    pub fn promised(&self) -> f64 {
        self.tails() - self.linearised.likeliest.evidence.minus_ln
    }

    fn tails(&self) -> f64 {
        self.problem.layout.ln_prior_over_normal(&self.point.values)
    }

    /// The fit as it is.
    ///
    /// # Errors
    /// [`FitError::NotFinite`] where it has no evidence.
    pub fn finish(mut self) -> Result<Fitted, FitError> {
        let last = self.fitted(self.settled)?;
        Ok(match self.before_jump.take() {
            Some(before) if before.log_evidence > last.log_evidence => before,
            _ => last,
        })
    }

    fn fitted(&self, settled: bool) -> Result<Fitted, FitError> {
        let Linearised { parameters, sensitivities, likeliest, .. } = &self.linearised;
        let reached = self.reached().ok_or(FitError::Undetermined)?;
        let log_evidence = reached + likeliest.ln_volume;
        if !log_evidence.is_finite() {
            return Err(FitError::NotFinite);
        }
        let at_bound = self.point.values.iter().zip(parameters).map(|(value, p)| {
            let slack = 1e-9 * (p.most - p.least).min(1.0);
            *value <= p.least + slack || *value >= p.most - slack
        });
        Ok(Fitted {
            layout: self.problem.layout.clone(),
            at_bound: at_bound.collect(),
            values: self.point.values.clone(),
            residuals: self.point.residuals.clone(),
            covariance: in_units(&likeliest.evidence.covariance, parameters),
            jacobian: sensitivities.clone(),
            sizes: likeliest.sizes.clone(),
            log_evidence,
            promised: self.promised() + likeliest.ln_volume,
            settled,
        })
    }
}

/// The model linearised at a point, with sensitivities that are known or computed.
fn linearised(
    problem: &Problem<'_>,
    point: &Point,
    sizes: &[f64],
    known: Option<Vec<DMatrix<f64>>>,
) -> Result<Linearised, FitError> {
    let Problem { layout, runs, patterns, .. } = problem;
    let parameters = layout.parameters(&point.values);
    let least_gain = if known.is_some() { LEAST_GAIN } else { LEAST_GAIN_ON_THE_WAY };
    let sensitivities = match known {
        Some(known) => known,
        None => jacobian(layout, runs, &point.values, &parameters, &point.residuals, problem.known)?,
    };
    let products = products(patterns, &parameters, point, &sensitivities);
    let likeliest = patterns.likeliest_sizes(sizes, &products, least_gain).ok_or(FitError::Undetermined)?;
    Ok(Linearised { parameters, sensitivities, likeliest })
}
