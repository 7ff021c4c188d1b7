//! Laws that are sums of simpler ones.
//!
//! If the regressor has both signs, a law with level zero is a sum of laws without a level: a step is half a constant plus half
//! a sign, and a ramp above or below zero is half an asymmetry plus or minus half a proportional law. At another level it is a
//! different explanation; at zero it is the same function as the sum, which replaces it.

use super::bench::{Bench, Law, rms};
use super::fit::Fitted;
use super::form::Form;
use super::made::half_width95;
use super::model::Error;
use super::score::{TOGETHER, no_covariance, scores};
use super::search::Search;
use nalgebra::{DMatrix, DVector};

/// Forms whose sum is equal to a form with a level, if the level is zero.
fn simpler(form: Form) -> &'static [Form] {
    match form {
        Form::Step => &[Form::Constant, Form::Sign],
        Form::AboveLevel | Form::BelowLevel => &[Form::Asymmetry, Form::Proportional],
        _ => &[],
    }
}

impl Search<'_> {
    /// The same model, in which laws beyond those of `base` that are sums of simpler laws are replaced by these. `None` if the simpler laws
    /// are already in `base`, are too many, or are not determined by the data.
    pub(super) fn in_simplest_laws(&self, base: &Fitted, fitted: Fitted) -> Result<Option<Fitted>, Error> {
        let mut laws: Vec<Law> = Vec::new();
        let mut has_sum = false;
        for (member, law) in fitted.laws.iter().enumerate().skip(base.laws.len()) {
            let sum = self.simpler_laws(&fitted, member)?;
            has_sum |= sum.is_some();
            for part in sum.unwrap_or_else(|| vec![law.clone()]) {
                if !base.laws.iter().chain(&laws).any(|other| other.is_like(&part)) {
                    laws.push(part);
                }
            }
        }
        if !has_sum {
            return Ok(Some(fitted));
        }
        if laws.is_empty() { Ok(None) } else { self.with_laws(base, &laws) }
    }

    /// The same model, in which a law that has become a sum of simpler laws since it was added is replaced by these; `None` if there is no
    /// such law.
    pub(super) fn without_sums(&self, current: &Fitted) -> Result<Option<Fitted>, Error> {
        for member in 0..current.laws.len() {
            let Some(mut laws) = self.simpler_laws(current, member)? else { continue };
            let base = self.without(current, member)?;
            laws.retain(|part| !base.laws.iter().any(|other| other.is_like(part)));
            return if laws.is_empty() { Ok(Some(base)) } else { self.with_laws(&base, &laws) };
        }
        Ok(None)
    }

    /// Fit of a base with further laws, without those that its parameters can produce: the proportional half of a ramp is often one of
    /// these. `None` if no law remains, or more than [`TOGETHER`]: each of them is then found as a candidate of its own.
    fn with_laws(&self, base: &Fitted, laws: &[Law]) -> Result<Option<Fitted>, Error> {
        let (scores, _) = scores(self.bench, self.basis, base, laws)?;
        let scores: Vec<_> = scores.iter().collect();
        if scores.is_empty() || scores.len() > TOGETHER { Ok(None) } else { self.extended(base, &scores) }
    }

    /// The simpler laws whose sum is a law of a model; `None` if it is not a sum, or one of them is not among the candidates.
    fn simpler_laws(&self, fitted: &Fitted, member: usize) -> Result<Option<Vec<Law>>, Error> {
        let Some(law) = fitted.laws.get(member) else { return Ok(None) };
        if !is_sum(self.bench, fitted, member, self.basis.everyday_effect())? {
            return Ok(None);
        }
        Ok(simpler(law.form)
            .iter()
            .map(|form| {
                let regressor = law.regressor.filter(|_| *form != Form::Constant);
                self.candidates
                    .iter()
                    .find(|one| (one.site, one.regressor, one.form) == (law.site, regressor, *form))
                    .cloned()
            })
            .collect())
    }
}

/// Fraction of the range of a level at which the level is zero; `None` for other laws, and if zero is not in the range.
fn fraction_of_zero(law: &Law) -> Option<f64> {
    let is_sum = !simpler(law.form).is_empty() && law.span.has_both_signs();
    let [least, most] = law.shape().filter(|_| is_sum)?.range;
    let fraction = -least / (most - least);
    (0.0..=1.0).contains(&fraction).then_some(fraction)
}

/// Whether a law of a fit is a sum of simpler ones: the 95 % interval of its level contains zero, and at both ends of the interval the
/// predictions differ from those at zero by less than the everyday effect, after the other parameters of the fit are projected out.
///
/// # Errors
/// Where the model fails for other reasons than its values.
fn is_sum(bench: &Bench<'_>, fitted: &Fitted, member: usize, everyday: f64) -> Result<bool, Error> {
    let Some((law, zero)) = fitted.laws.get(member).and_then(|law| Some((law, fraction_of_zero(law)?)))
    else {
        return Ok(false);
    };
    let number = super::made::first_of(bench, &fitted.laws, member) + law.form.amplitudes().len();
    let Some(fraction) = fitted.values.get(number).copied() else { return Ok(false) };
    let half_width = half_width95(fitted.sd(number));
    if (fraction - zero).abs() > half_width {
        return Ok(false);
    }
    let Some(at_zero) = residuals_with(bench, fitted, number, zero)? else { return Ok(false) };
    for end in [fraction - half_width, fraction + half_width] {
        let Some(at_end) = residuals_with(bench, fitted, number, end.clamp(0.0, 1.0))? else {
            return Ok(false);
        };
        let difference: Vec<DVector<f64>> =
            at_end.iter().zip(&at_zero).map(|(end, zero)| end - zero).collect();
        if rms(without_other_numbers(fitted, number, &difference)?.into_iter()) >= everyday {
            return Ok(false);
        }
    }
    Ok(true)
}

/// Residuals with another value of a parameter; `None` if the model has no prediction there.
fn residuals_with(
    bench: &Bench<'_>,
    fitted: &Fitted,
    number: usize,
    value: f64,
) -> Result<Option<Vec<DVector<f64>>>, Error> {
    let mut values = fitted.values.clone();
    if let Some(one) = values.get_mut(number) {
        *one = value;
    }
    match bench.residuals(&fitted.laws, &values) {
        Ok(residuals) => Ok(Some(residuals)),
        Err(error) if error.is_of_these_values() => Ok(None),
        Err(error) => Err(error),
    }
}

/// A change of the predictions with the other parameters of a fit projected out.
fn without_other_numbers(
    fitted: &Fitted,
    number: usize,
    change: &[DVector<f64>],
) -> Result<Vec<DVector<f64>>, Error> {
    let mut columns: Vec<DMatrix<f64>> = Vec::with_capacity(fitted.jacobian.len());
    for jacobian in &fitted.jacobian {
        let mut others = jacobian.clone();
        others.column_mut(number).fill(0.0);
        columns.push(others);
    }
    let count = fitted.values.len();
    let (mut gram, mut products) = (DMatrix::zeros(count, count), DVector::zeros(count));
    for (columns, change) in columns.iter().zip(change) {
        gram.gemm_tr(1.0, columns, columns, 1.0);
        products.gemv_tr(1.0, columns, change, 1.0);
    }
    // Parameters without effect have a zero on the diagonal, and so has this parameter, whose column was set to zero.
    let scales = gram.diagonal().map(|square| if square > 0.0 { square.sqrt().recip() } else { 1.0 });
    let scaled = DMatrix::from_fn(count, count, |i, j| scales[i] * gram[(i, j)] * scales[j]);
    let inverse = scaled.pseudo_inverse(f64::EPSILON * count as f64).map_err(|_| no_covariance())?;
    let amounts = (inverse * products.component_mul(&scales)).component_mul(&scales);
    Ok(columns.iter().zip(change).map(|(columns, change)| change - columns * &amounts).collect())
}
