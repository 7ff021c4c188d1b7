//! Young's modulus with everything else integrated out: contact point, offset and drift of the force, and the noise
//! (theory, eq. 32).
//!
//! For a contact point the curve is linear in offset, modulus and drift, and their posterior with unknown noise is Student's; the contact
//! point is integrated numerically. Before the first row every order of magnitude of the way to contact is as likely as the
//! next; the modulus is likewise flat in its logarithm. Drift is known to [`DRIFT`] of the curve's span.

use super::Curve;
use nalgebra::{Matrix3, Vector3};
use statrs::distribution::{ContinuousCDF, StudentsT};

/// Drift of the force over the indentation, as a share of its span: standard deviation.
const DRIFT: f64 = 0.01;
/// Readings are no better than this share of the span: what an exact curve leaves is no information.
const RESOLVED: f64 = 1e-5;
/// Contact points of a round, and rounds that close in on those which are possible.
const POINTS: usize = 81;
const ROUNDS: usize = 5;
/// A contact point whose probability is less than that of the best by this (logarithm) does not count.
const NOT_POSSIBLE: f64 = 14.0;
/// Standard deviations of one contact point's modulus within which its quantiles are, at two degrees of freedom too.
const REACH: f64 = 12.0;
/// Halvings of an interval in which a quantile lies, and probabilities of contact points that move none.
const HALVINGS: usize = 26;
const IMPROBABLE: f64 = 1e-5;

/// Posterior of the modulus for one contact point.
#[derive(Clone)]
pub(super) struct Given {
    pub contact_m: f64,
    pub slope_pa: f64,
    pub offset_n: f64,
    drift_n: f64,
    slope_sd_pa: f64,
    freedom: f64,
    squares: f64,
    /// Logarithm of the probability of the contact point, with that of the modulus that it gives.
    ln_weight: f64,
}

/// The rows that are fitted.
pub(super) struct Rows<'a> {
    pub rows: &'a [[f64; 2]],
    pub curve: &'a Curve,
    /// So many readings are worth one: those of a sweep are correlated.
    pub worth: f64,
    /// Whether the contact point is unknown, or changes nothing.
    pub has_contact: bool,
}

impl Rows<'_> {
    /// Offset, modulus and drift for a contact point; nothing where no force grows with depth.
    pub fn given(&self, contact_m: f64) -> Option<Given> {
        let n = self.rows.len();
        let [least_n, most_n] = self
            .rows
            .iter()
            .fold([f64::INFINITY, f64::NEG_INFINITY], |[a, b], [_, f]| [a.min(*f), b.max(*f)]);
        let span_n = (most_n - least_n).max(f64::MIN_POSITIVE);
        // Sums of offset, curve and drift, each of order one, and the force from its middle, so that squares keep their digits.
        let scale = self.rows.iter().map(|[d, _]| self.curve.at(d - contact_m)).fold(0.0, f64::max);
        if scale <= 0.0 {
            return None;
        }
        let middle_n = 0.5 * (least_n + most_n);
        let (mut normal, mut right, mut total) = (Matrix3::zeros(), Vector3::zeros(), 0.0);
        for (i, [d, f]) in self.rows.iter().enumerate() {
            let when = i as f64 / (n - 1).max(1) as f64 - 0.5;
            let row = Vector3::new(1.0, self.curve.at(d - contact_m) / scale, when);
            let y = (f - middle_n) / span_n;
            normal += row * row.transpose();
            right += row * y;
            total += y * y;
        }
        let unknowns = if self.has_contact { 3.0 } else { 2.0 };
        let freedom = (n as f64 - unknowns).max(1.0);
        // The weight of the drift's prior needs the noise: once as if the readings were as good as they can be, then with it.
        let (_, _, squares, _) = solve(RESOLVED, &normal, &right, total)?;
        let noise = (squares / freedom * self.worth).sqrt().max(RESOLVED);
        let (solution, inverse, squares, determinant) = solve(noise, &normal, &right, total)?;
        let slope_pa = solution[1] * span_n / scale;
        if !(slope_pa > 0.0 && slope_pa.is_finite() && determinant > 0.0) {
            return None;
        }
        let floor = freedom * RESOLVED.powi(2);
        let effective = (freedom / self.worth).max(2.0);
        // Weight of a modulus that is flat in its logarithm: the scale of the curve drops out.
        let ln_weight = -0.5 * effective * (squares + floor).ln() - 0.5 * determinant.ln() - solution[1].ln();
        Some(Given {
            contact_m,
            slope_pa,
            offset_n: middle_n + span_n * (solution[0] - 0.5 * solution[2]),
            drift_n: span_n * solution[2],
            slope_sd_pa: noise * inverse[(1, 1)].max(0.0).sqrt() * span_n / scale,
            freedom: effective,
            squares,
            ln_weight,
        })
    }

    /// Residual of every row.
    pub fn residuals_n(&self, given: &Given) -> Vec<f64> {
        let last = (self.rows.len() - 1).max(1) as f64;
        self.rows
            .iter()
            .enumerate()
            .map(|(i, [d, f])| {
                let force_n = given.slope_pa * self.curve.at(d - given.contact_m);
                f - given.offset_n - force_n - given.drift_n * i as f64 / last
            })
            .collect()
    }

    /// The best contact point between two, by squares.
    pub fn best(&self, [mut from_m, mut to_m]: [f64; 2]) -> Option<Given> {
        let mut best: Option<Given> = None;
        for _ in 0..ROUNDS {
            let step_m = (to_m - from_m) / (POINTS - 1) as f64;
            let candidates = (0..POINTS).filter_map(|i| self.given(from_m + i as f64 * step_m));
            let best_fit = candidates.min_by(|a, b| a.squares.total_cmp(&b.squares))?;
            (from_m, to_m) = (best_fit.contact_m - 2.0 * step_m, best_fit.contact_m + 2.0 * step_m);
            best = Some(best_fit);
        }
        best
    }

    /// The posterior over contact points between the earliest and the latest; `first_m` is the depth of the first row.
    pub fn posterior(
        &self,
        [earliest_m, latest_m]: [f64; 2],
        first_m: f64,
        span_m: f64,
    ) -> Option<Posterior> {
        if !self.has_contact {
            let earliest_fit = self.given(earliest_m)?;
            return Some(Posterior { parts: vec![(1.0, earliest_fit)] });
        }
        let [mut from_position, mut to_position] = [0.0, contact_coordinate(earliest_m, latest_m, span_m)];
        let mut components: Vec<(f64, Given)> = Vec::new();
        for _ in 0..ROUNDS {
            let step = (to_position - from_position) / (POINTS - 1) as f64;
            let grid_fits: Vec<(f64, f64, Given)> = (0..POINTS)
                .filter_map(|i| {
                    let grid_position = from_position + i as f64 * step;
                    let contact_fit = self.given(contact_at_m(grid_position, latest_m, span_m))?;
                    let before_ratio = ((first_m - contact_fit.contact_m) / span_m).max(0.0);
                    // Uniform in depth within the curve, in the logarithm before it.
                    let prior = (grid_position.cosh() / (1.0 + before_ratio)).ln();
                    Some((grid_position, contact_fit.ln_weight + prior, contact_fit))
                })
                .collect();
            let most = grid_fits.iter().map(|(_, weight, _)| *weight).fold(f64::NEG_INFINITY, f64::max);
            let possible: Vec<f64> =
                grid_fits.iter().filter(|(_, w, _)| most - w < NOT_POSSIBLE).map(|(at, ..)| *at).collect();
            let (least, greatest) = (possible.first().copied()?, possible.last().copied()?);
            let total: f64 = grid_fits.iter().map(|(_, weight, _)| (weight - most).exp()).sum();
            components = grid_fits
                .into_iter()
                .map(|(_, weight, given)| ((weight - most).exp() / total, given))
                .collect();
            let is_resolved = greatest - least > 0.5 * (to_position - from_position);
            [from_position, to_position] = [
                (least - step).max(0.0),
                (greatest + step).min(contact_coordinate(earliest_m, latest_m, span_m)),
            ];
            if is_resolved {
                break;
            }
        }
        components.retain(|(weight, _)| *weight > IMPROBABLE);
        Some(Posterior { parts: components })
    }
}

fn contact_at_m(at: f64, latest_m: f64, span_m: f64) -> f64 {
    latest_m - span_m * at.sinh()
}

/// As a way from the latest one, in orders of magnitude where it is longer than the curve.
fn contact_coordinate(contact_m: f64, latest_m: f64, span_m: f64) -> f64 {
    ((latest_m - contact_m) / span_m).asinh()
}

fn solve(
    noise: f64,
    normal: &Matrix3<f64>,
    right: &Vector3<f64>,
    total: f64,
) -> Option<(Vector3<f64>, Matrix3<f64>, f64, f64)> {
    let mut with_prior = *normal;
    with_prior[(2, 2)] += (noise / DRIFT).powi(2);
    let inverse = with_prior.try_inverse()?;
    // Drift and a straight curve differ by the prior alone: the residual gives the digits back.
    let mut coefficients = inverse * right;
    coefficients += inverse * (right - with_prior * coefficients);
    let squares = (total - right.dot(&coefficients)).max(0.0);
    Some((coefficients, inverse, squares, with_prior.determinant()))
}

/// Young's modulus over all contact points: a mixture of Student's distributions.
pub(super) struct Posterior {
    /// Probability, and the modulus there.
    parts: Vec<(f64, Given)>,
}

impl Posterior {
    fn below(&self, youngs_pa: f64) -> f64 {
        self.parts
            .iter()
            .map(|(weight, given)| {
                let sd_pa = given.slope_sd_pa.max(1e-12 * given.slope_pa);
                let distribution = StudentsT::new(given.slope_pa, sd_pa, given.freedom);
                weight * distribution.map_or(f64::NAN, |of| of.cdf(youngs_pa))
            })
            .sum()
    }

    /// The modulus below which it is with a probability.
    pub fn quantile_pa(&self, probability: f64) -> f64 {
        if let ([(_, only_fit)], true) = (self.parts.as_slice(), probability == 0.5) {
            return only_fit.slope_pa;
        }
        let [mut low, mut high] =
            self.parts.iter().fold([f64::INFINITY, 0.0f64], |[low, high], (_, given)| {
                let reach_pa = REACH * given.slope_sd_pa;
                [low.min(given.slope_pa - reach_pa), high.max(given.slope_pa + reach_pa)]
            });
        low = low.max(0.0);
        for _ in 0..HALVINGS {
            let middle = 0.5 * (low + high);
            if self.below(middle) < probability { low = middle } else { high = middle }
        }
        0.5 * (low + high)
    }

    /// 95 % interval of the contact point, from its probabilities alone.
    pub fn contact_m(&self) -> [f64; 2] {
        let mut ordered: Vec<(f64, f64)> = self.parts.iter().map(|(w, g)| (g.contact_m, *w)).collect();
        ordered.sort_by(|a, b| a.0.total_cmp(&b.0));
        [weighted_quantile(0.025, &ordered), weighted_quantile(0.975, &ordered)]
    }
}

fn weighted_quantile(wanted: f64, ordered: &[(f64, f64)]) -> f64 {
    let mut sum = 0.0;
    let quantile_row = ordered.iter().find(|(_, weight)| {
        sum += weight;
        sum >= wanted
    });
    quantile_row.or(ordered.last()).map_or(f64::NAN, |(contact_m, _)| *contact_m)
}
