//! Maximization of the evidence over the sizes of the discrepancy's groups (theory, eq. 61).
//!
//! The method is Newton's in the logarithms of the sizes, with the second derivatives of [`super::integrated`]: a diagnosis needs
//! these sizes thousands of times, and a quasi-Newton method takes three times as many evaluations. Far below the optimum of a
//! size that the data determine, `-ln Z` falls as `1 / s_g^2`, and Newton's step in the logarithm is only one half. There one step of
//! expectation and maximization, `s_g^2 <- mean of the second moments of the group's amplitudes`, reaches the optimum nearly at
//! once (Dempster, Laird and Rubin, "Maximum likelihood from incomplete data via the EM algorithm", 1977).

use super::{Evidence, Patterns, Products, Reduced};
use nalgebra::{DVector, Dyn, SymmetricEigen};

/// Largest numbers of steps, and of trials of a step.
const MAX_STEPS: usize = 20;
const MAX_TRIALS: usize = 8;
/// Largest first step of the logarithm of a size: it changes the variance by a factor of e^2, beyond which the second derivatives are
/// not valid.
const LONGEST_STEP: f64 = 1.0;

/// A point of the search: logarithms of the free sizes.
struct Point {
    logarithms: DVector<f64>,
    sizes: Vec<f64>,
    reduced: Reduced,
    evidence: Evidence,
}

/// The objective: minus the log evidence as a function of the free sizes; the others have the values of `sizes`.
struct Objective<'a> {
    patterns: &'a Patterns,
    products: &'a Products,
    free: &'a [usize],
    sizes: &'a [f64],
}

impl Objective<'_> {
    /// The objective at a point; `None` for invalid sizes.
    fn at(&self, logarithms: DVector<f64>) -> Option<Point> {
        let mut sizes = self.sizes.to_vec();
        for (group, logarithm) in self.free.iter().zip(logarithms.iter()) {
            sizes[*group] = logarithm.exp();
        }
        let reduced = self.patterns.reduced_beside_residuals(&sizes, self.products)?;
        let evidence = self.patterns.evidence_of(&sizes, &reduced);
        let is_finite =
            evidence.minus_ln.is_finite() && evidence.gradient.iter().all(|slope| slope.is_finite());
        is_finite.then_some(Point { logarithms, sizes, reduced, evidence })
    }

    fn slopes(&self, point: &Point) -> DVector<f64> {
        DVector::from_iterator(self.free.len(), self.free.iter().map(|group| point.evidence.gradient[*group]))
    }

    /// Step of expectation and maximization.
    fn expected_step(&self, point: &Point) -> DVector<f64> {
        let (_, prior_slopes) = self.patterns.size_prior(&point.sizes);
        let steps = self.free.iter().map(|group| {
            let count = self.patterns.count_of(*group);
            let second_moment = count - (point.evidence.gradient[*group] - prior_slopes[*group]);
            if count > 0.0 && second_moment > 0.0 { 0.5 * (second_moment / count).ln() } else { 0.0 }
        });
        DVector::from_iterator(self.free.len(), steps)
    }

    fn curvature(&self, point: &Point) -> SymmetricEigen<f64, Dyn> {
        self.patterns.curvature_of(&point.sizes, &point.reduced, self.free).symmetric_eigen()
    }

    /// Newton's step, and the gain of log evidence that it promises. Along an axis of negative curvature the step uses the absolute
    /// value of the curvature, so that it goes downhill; no step along an axis is longer than `longest`.
    fn newton_step(
        &self,
        point: &Point,
        curvature: &SymmetricEigen<f64, Dyn>,
        longest: f64,
    ) -> (DVector<f64>, f64) {
        let axis_slopes = curvature.eigenvectors.tr_mul(&self.slopes(point));
        let mut promised = 0.0;
        let steps = axis_slopes.zip_map(&curvature.eigenvalues, |slope, curvature| {
            let steepness = curvature.abs().max(slope.abs() / longest);
            let step = if steepness > 0.0 { -slope / steepness } else { 0.0 };
            promised -= step * (slope + 0.5 * step * curvature.abs());
            step
        });
        (&curvature.eigenvectors * steps, promised)
    }

    /// The point after the step, or after the longest fraction of it that lowers the objective, with this fraction.
    fn behind(&self, point: &Point, step: &DVector<f64>) -> Option<(Point, f64)> {
        (0..MAX_TRIALS).find_map(|trial| {
            let share = 0.25_f64.powi(trial as i32);
            let next = self.at(&point.logarithms + step * share)?;
            (next.evidence.minus_ln < point.evidence.minus_ln).then_some((next, share))
        })
    }
}

/// Minimizes the objective from these sizes, of which all but the free ones stay, until a step promises less than `least_gain`. Returns the
/// sizes, the evidence and the eigenvalues of the second derivatives there; `None` where the evidence does not exist at the start.
pub(super) fn search(
    patterns: &Patterns,
    products: &Products,
    free: &[usize],
    sizes: &[f64],
    least_gain: f64,
) -> Option<(Vec<f64>, Evidence, DVector<f64>)> {
    let objective = Objective { patterns, products, free, sizes };
    let start = DVector::from_iterator(free.len(), free.iter().map(|group| sizes[*group].ln()));
    let mut point = objective.at(start)?;
    let expected = objective.expected_step(&point);
    if expected.amax() > LONGEST_STEP
        && let Some(next) = objective.at(&point.logarithms + expected)
        && next.evidence.minus_ln < point.evidence.minus_ln
    {
        point = next;
    }
    let mut longest = LONGEST_STEP;
    let mut curvature = objective.curvature(&point);
    for _ in 0..MAX_STEPS {
        let (step, promised) = objective.newton_step(&point, &curvature, longest);
        if promised < least_gain {
            break;
        }
        let Some((next, share)) = objective.behind(&point, &step) else { break };
        longest = if share < 1.0 { longest * share } else { 2.0 * longest };
        point = next;
        curvature = objective.curvature(&point);
    }
    Some((point.sizes, point.evidence, curvature.eigenvalues))
}
