//! Estimates of a fit, in their own units and with their intervals.

use super::round::{from_prior, prior_sd, products};
use super::{Fitted, Point};
use crate::Multiples;
use crate::data::Kind;
use crate::evidence::Patterns;
use crate::layout::{NORMAL_975, Scale};
use nalgebra::{DMatrix, DVector};

const MM: f64 = 1e-3;
/// Steps of the numerical derivatives, in posterior standard deviations. They are long because the mean modulus changes in
/// jumps when a boundary of layers moves.
const SLOPE_SD: f64 = 0.5;
/// A discrepancy counts as larger than that of an ordinary rig if it exceeds this multiple of it.
const LARGER: f64 = 1.1;

impl Fitted {
    /// A parameter in its own unit with its interval of 95 %. The depth of an event in insertions is uncertain by the spacing
    /// of the readings, which are means over cells of depth.
    pub fn estimate(&self, effect: usize, parameter: usize) -> (f64, [f64; 2]) {
        let effect_of = self.layout.effects.get(effect);
        let Some((of, info)) = effect_of.and_then(|of| Some((of, of.parameters().get(parameter)?))) else {
            return (f64::NAN, [f64::NAN; 2]);
        };
        let scale = Scale::of(info);
        let parameter_index = self.layout.first_of(effect) + parameter;
        let (value, sd) = (self.values[parameter_index], self.sd(parameter_index));
        let [least, most] = info.range;
        let outside_value = scale.outside(value);
        let is_depth = !info.nodes.is_empty() && info.name == "depth_mm" && !of.info().observable_in.lateral;
        let spacing =
            if is_depth { self.layout.spacing_m(MM * outside_value).unwrap_or(0.0) / MM } else { 0.0 };
        let ends = [-NORMAL_975, NORMAL_975].map(|sds| {
            let end = scale.outside(value + sds * sd);
            let wider = outside_value + (end - outside_value).hypot(spacing).copysign(sds);
            if spacing > 0.0 { wider } else { end }.clamp(least, most)
        });
        (outside_value, ends)
    }

    /// Estimate of the modulus, Pa.
    pub fn modulus_pa(&self) -> (f64, [f64; 2]) {
        of_logarithm(self.values[0], self.sd(0))
    }

    /// Logarithm of the modulus, Pa.
    pub fn ln_modulus(&self) -> f64 {
        self.values[0]
    }

    /// Logarithm of the mean modulus, Pa, over the tissue down to a depth, and its standard deviation; `None` if the model is
    /// invalid around the fit. With effects of the tissue the modulus itself is that of a place or a layer, while the mean is
    /// comparable between effects that explain the data equally well.
    pub fn ln_mean_modulus(&self, depth_m: f64) -> Option<(f64, f64)> {
        let (value, slopes) = self.ln_mean_modulus_slopes(depth_m)?;
        Some((value, slopes.dot(&(&self.covariance * &slopes)).max(0.0).sqrt()))
    }

    /// The same with its derivatives with respect to the parameters.
    pub fn ln_mean_modulus_slopes(&self, depth_m: f64) -> Option<(f64, DVector<f64>)> {
        let mut slopes = DVector::zeros(self.values.len());
        for i in 0..self.values.len() {
            let step = SLOPE_SD * self.sd(i);
            let [lower, upper] = [-step, step].map(|change| {
                let mut values = self.values.clone();
                values[i] += change;
                self.ln_mean_modulus_at(&values, depth_m)
            });
            slopes[i] = (upper? - lower?) / (2.0 * step);
        }
        Some((self.ln_mean_modulus_at(&self.values, depth_m)?, slopes))
    }

    /// Logarithm of the mean modulus under other values.
    fn ln_mean_modulus_at(&self, values: &[f64], depth_m: f64) -> Option<f64> {
        let kind = if self.layout.kinds[0] { Kind::Lateral } else { Kind::Insertion };
        let problem = self.layout.model(values, kind).and_then(|model| model.problem(depth_m)).ok()?;
        Some(problem.foundation.mean_pa(depth_m).ln()).filter(|ln| ln.is_finite())
    }

    /// The tip load, N, with its derivatives with respect to the parameters.
    pub fn tip_load_slopes(&self) -> Option<(f64, DVector<f64>)> {
        self.layout.tip_load_slopes(&self.values)
    }

    /// Estimate of the tip load, N, if there are insertions.
    pub fn tip_load_n(&self) -> Option<(f64, [f64; 2])> {
        let (value, sd) = self.layout.tip_load_n(&self.values, &self.covariance)?;
        Some((value, [-NORMAL_975, NORMAL_975].map(|sds| value + sds * sd)))
    }

    /// Groups of the discrepancy that are larger than in an ordinary rig, as multiples of the ordinary size.
    pub fn multiples(&self, patterns: &Patterns) -> Multiples {
        let tailed_groups = patterns.groups.iter().zip(&self.sizes).filter(|(group, _)| group.tail.is_some());
        let multiples = tailed_groups
            .map(|(group, size)| (group.name.to_owned(), group.multiple * size / group.everyday));
        multiples.filter(|(_, multiple)| *multiple > LARGER).collect()
    }

    /// Ratio of the modulus to that of the reference, and the reference's modulus, Pa; each with its interval of 95 %.
    pub fn beside_reference(&self) -> Option<[(f64, [f64; 2]); 2]> {
        let ratio_parameter = self.layout.ratio()?;
        let [of_modulus, of_ratio] = [0, ratio_parameter].map(|i| self.covariance[(i, i)]);
        let variance = of_modulus + of_ratio - 2.0 * self.covariance[(0, ratio_parameter)];
        let of_reference =
            of_logarithm(self.values[0] - self.values[ratio_parameter], variance.max(0.0).sqrt());
        Some([of_logarithm(self.values[ratio_parameter], of_ratio.sqrt()), of_reference])
    }

    /// Change of the logarithm of the modulus if the discrepancy is omitted, to first order.
    pub fn change_without_discrepancy(&self, patterns: &Patterns) -> Option<f64> {
        let parameters = self.layout.parameters(&self.values);
        let point = Point { values: self.values.clone(), residuals: self.residuals.clone() };
        let products = products(patterns, &parameters, &point, &self.jacobian);
        let evidence = patterns.evidence(&vec![0.0; patterns.groups.len()], &products)?;
        let first = parameters.first()?;
        Some((evidence.mean[0] - from_prior(first, self.values[0])) * prior_sd(first))
    }

    /// Standard deviation of that change under a discrepancy of these sizes. The estimate with noise alone is a less efficient
    /// one of the same modulus, so that the two differ by chance (theory, eq. 67; Hausman 1978): in units of the priors, with
    /// `G = J^T J`, `u = (G + 1)^-1 e_1`, `S` the covariance of noise and discrepancy and `v` the variance with the discrepancy, it
    /// is the root of `u^T J^T S J u + |G u|^2 - 2 (G u)_1 + 1 - v`.
    pub fn sd_of_change_without_discrepancy(&self, patterns: &Patterns, sizes: &[f64]) -> Option<f64> {
        let parameters = self.layout.parameters(&self.values);
        let no_columns: Vec<DMatrix<f64>> =
            self.residuals.iter().map(|residuals| DMatrix::zeros(residuals.len(), 0)).collect();
        let products = self.products_beside_parameters(patterns, &no_columns);
        let information = &products.among;
        let identity = DMatrix::identity(information.nrows(), information.ncols());
        let factors = (information + &identity).cholesky()?.inverse().column(0).into_owned();
        let felt = information * &factors;
        let in_metric = patterns.in_metric(sizes, &products)?;
        let variance = (in_metric + identity).cholesky()?.inverse()[(0, 0)];
        let spread = patterns.variance_of_sum(sizes, &products, &factors) + felt.norm_squared();
        let first = parameters.first()?;
        Some(prior_sd(first) * (spread - 2.0 * felt[0] + 1.0 - variance).max(0.0).sqrt())
    }
}

/// A quantity and its interval of 95 % by its logarithm.
fn of_logarithm(ln: f64, sd: f64) -> (f64, [f64; 2]) {
    (ln.exp(), [-NORMAL_975, NORMAL_975].map(|sds| (ln + sds * sd).exp()))
}
