//! Score of every candidate law around a fit, without fitting the candidate.
//!
//! Around a fit a law of amplitude a changes the predictions by `a d`. The part of d in the span of the parameters'
//! sensitivities is projected out, and the residuals are projected on the remainder (Rao's efficient score). With a normal prior
//! of the amplitude the evidence has a closed form, which is averaged over the shapes. The standard deviation of that prior is
//! the amplitude that changes a channel by the channel's own standard deviation.

use super::basis::Basis;
use super::bench::{Bench, Law};
use super::fit::{Fitted, whitened};
use super::form::{Form, Shape};
use super::model::Error;
use super::noise::Noise;
use super::weights::ln_sum;
use nalgebra::{DMatrix, DVector};

/// A law is not identifiable if less than this fraction of the square of its direction remains after the parameters are projected out,
/// that is, a thousandth of its length.
pub(crate) const ALL_ELIMINATED: f64 = 1e-6;

/// The score of a law.
#[derive(Debug, Clone)]
pub(crate) struct Score {
    /// The law, with the priors of its amplitudes at the best shape.
    pub law: Law,
    /// Most probable amplitudes, then the shape as a fraction of its range.
    pub numbers: Vec<f64>,
    /// Log evidence over the fit, computed with the noise of the fit and with white noise of the same variance.
    pub log_evidence: [f64; 2],
}

/// Largest number of laws that are added at once. Two laws may be weak alone and strong together. Three laws are found one after the other
/// or as a law and a pair, unless each of them shows only together with both others.
pub(crate) const TOGETHER: usize = 2;

/// Two laws together: each may be weak alone because the other compensates it, for example an offset and an asymmetry.
#[derive(Debug, Clone)]
pub(crate) struct Pair {
    /// Both laws, with their amplitudes in a joint estimate.
    pub scores: [Score; TOGETHER],
    /// Log evidence over the fit, as in [`Score`].
    pub log_evidence: [f64; 2],
}

/// A law at its best shape with the positions of its columns.
struct Best {
    score: Score,
    columns: Vec<usize>,
    sds: Vec<f64>,
    fraction: Option<f64>,
}

/// A law at one shape.
struct Direction {
    fraction: Option<f64>,
    sds: Vec<f64>,
    /// One matrix per run, in prior standard deviations.
    columns: Vec<DMatrix<f64>>,
}

/// All laws that the sites allow, before the priors of their amplitudes are known.
pub(crate) fn candidates(bench: &Bench<'_>, effects: &[Effect]) -> Vec<Law> {
    let mut laws = Vec::new();
    for (site, (declared, spans)) in bench.model.sites().iter().zip(&bench.spans).enumerate() {
        let is_tried = |form: Form, regressor: Option<&str>| {
            let is_declared = declared.forms.is_empty() || declared.forms.contains(&form);
            let is_chosen = effects.iter().any(|effect| effect.is_like(&declared.name, regressor, form));
            is_declared && (effects.is_empty() || is_chosen)
        };
        let law = |regressor, form, span| Law { site, regressor, form, span, amplitude_sds: Vec::new() };
        if is_tried(Form::Constant, None) {
            let span = super::form::Span::between(0.0, 1.0);
            laws.push(law(None, Form::Constant, span));
        }
        for (number, (regressor, span)) in declared.regressors.iter().zip(spans).enumerate() {
            for form in Form::ALL.into_iter().filter(|form| *form != Form::Constant) {
                let is_possible = form.applies_to(span) && (!form.has_history() || regressor.history);
                if is_possible && is_tried(form, Some(&regressor.name)) {
                    laws.push(law(Some(number), form, *span));
                }
            }
        }
    }
    laws
}

/// An effect to be tried: `site/regressor/form`, of which any part may be `*`; a constant is `site/constant`.
#[derive(Debug, Clone, PartialEq)]
pub struct Effect {
    site: String,
    regressor: Option<String>,
    form: Option<Form>,
}

impl Effect {
    /// Reads its text.
    ///
    /// # Errors
    /// [`Error::Declaration`] where it names no form.
    pub fn parse(text: &str) -> Result<Self, Error> {
        let words: Vec<&str> = text.split('/').collect();
        let (site, regressor, form) = match words.as_slice() {
            [site, "constant"] => (site, None, Some(Form::Constant)),
            [site, regressor, "*"] => (site, Some(regressor), None),
            [site, regressor, name] => {
                let form = Form::named(name)
                    .ok_or_else(|| not_an_effect(text, format!("{name:?} is none of the forms")))?;
                (site, Some(regressor), Some(form))
            }
            [_, name] => {
                let problem =
                    format!("names no form: a law without a regressor is \"constant\", not {name:?}");
                return Err(not_an_effect(text, problem));
            }
            _ => return Err(not_an_effect(text, "is not two or three names between slashes".to_owned())),
        };
        let regressor = regressor.map(|name| (*name).to_owned());
        Ok(Self { site: (*site).to_owned(), regressor, form })
    }

    fn is_like(&self, site: &str, regressor: Option<&str>, form: Form) -> bool {
        let is_regressor = match (self.regressor.as_deref(), regressor) {
            (None, None) | (Some("*"), _) => true,
            (Some(own), Some(other)) => own == other,
            _ => false,
        };
        (self.site == "*" || self.site == site) && is_regressor && self.form.is_none_or(|own| own == form)
    }
}

fn not_an_effect(text: &str, problem: String) -> Error {
    let names: Vec<&str> = Form::ALL.iter().map(|form| form.name()).collect();
    Error::Declaration {
        what: "effect",
        name: text.to_owned(),
        problem,
        expected: format!(
            "site/regressor/form, each of them or *, or site/constant; forms are {}",
            names.join(", ")
        ),
    }
}

/// Standard deviation of the prior of an amplitude: the amplitude that changes some channel by the channel's own standard deviation.
fn prior_sd(bench: &Bench<'_>, columns: &[DMatrix<f64>], number: usize) -> Option<f64> {
    let largest = (0..bench.scales.len())
        .map(|channel| {
            let run_columns = bench.training.iter().zip(columns).map(|(prepared, columns)| {
                let rows = prepared.rows_of(channel);
                columns.view((rows.start, number), (rows.len(), 1)).column(0).into_owned()
            });
            super::bench::rms(run_columns)
        })
        .fold(0.0, f64::max);
    (largest.is_finite() && largest > 0.0).then(|| largest.recip())
}

/// The directions of a law over its shapes.
fn directions(bench: &Bench<'_>, fitted: &Fitted, law: &Law) -> Result<Vec<Direction>, Error> {
    let terms = bench.terms(&fitted.laws, &fitted.values);
    let fractions: Vec<Option<f64>> =
        if law.shape().is_some() { Shape::grid().map(Some).collect() } else { vec![None] };
    let mut directions = Vec::new();
    for fraction in fractions {
        let shape = law.shape().zip(fraction).map(|(shape, fraction)| shape.at(fraction));
        let columns = bench.columns(law, shape, &fitted.values, &terms, &fitted.residuals)?;
        let Some(mut columns) = columns else { continue };
        let count = law.form.amplitudes().len();
        let sds: Option<Vec<f64>> = (0..count).map(|number| prior_sd(bench, &columns, number)).collect();
        let Some(sds) = sds else { continue };
        for matrix in &mut columns {
            for (mut column, sd) in matrix.column_iter_mut().zip(&sds) {
                column *= *sd;
            }
        }
        directions.push(Direction { fraction, sds, columns });
    }
    Ok(directions)
}

pub(crate) fn no_covariance() -> Error {
    Error::Undetermined("no covariance around the fit".to_owned())
}

/// Scores of laws around a fit, and of pairs of laws, without those that are not identifiable.
pub(crate) fn scores(
    bench: &Bench<'_>,
    basis: &Basis,
    fitted: &Fitted,
    laws: &[Law],
) -> Result<(Vec<Score>, Vec<Pair>), Error> {
    let law_directions: Vec<Vec<Direction>> =
        bench.each(laws.iter().collect(), |law| directions(bench, fitted, law))?;
    let coordinates = bench.coordinates(&fitted.laws);
    let count = coordinates.len();
    let columns = (0..fitted.residuals.len()).map(|run| {
        let directions = law_directions.iter().flatten().filter_map(|direction| direction.columns.get(run));
        let width: usize = directions.clone().map(DMatrix::ncols).sum();
        let jacobian = fitted.jacobian.get(run).cloned().unwrap_or_else(|| DMatrix::zeros(0, 0));
        let mut joined = jacobian.resize_horizontally(count + width + 1, 0.0);
        for (j, coordinate) in coordinates.iter().enumerate() {
            let mut column = joined.column_mut(j);
            column *= coordinate.sd;
        }
        let mut first = count;
        for columns in directions {
            joined.columns_mut(first, columns.ncols()).copy_from(columns);
            first += columns.ncols();
        }
        if let Some(residuals) = fitted.residuals.get(run) {
            joined.set_column(first, residuals);
        }
        joined
    });
    let columns: Vec<DMatrix<f64>> = columns.collect();
    let white: Vec<Noise> = fitted.noises.iter().map(|noise| noise.white()).collect();
    let (as_coloured, as_white) = (
        projected(bench, basis, fitted, &fitted.noises, &columns),
        projected(bench, basis, fitted, &white, &columns),
    );
    let metrics = [as_coloured.ok_or_else(no_covariance)?, as_white.ok_or_else(no_covariance)?];
    let mut first = 0;
    let mut all_best: Vec<Best> = Vec::new();
    for (law, directions) in laws.iter().zip(&law_directions) {
        let mut best: Option<(f64, Best)> = None;
        let mut sums = [Vec::new(), Vec::new()];
        for direction in directions {
            let columns: Vec<usize> = (first..first + direction.sds.len()).collect();
            first += direction.sds.len();
            let evidences = metrics.each_ref().map(|metric| evidence_of(metric, &columns));
            let [Some((log_evidence, amplitudes)), Some((as_white, _))] = evidences else { continue };
            sums[0].push(log_evidence);
            sums[1].push(as_white);
            if best.as_ref().is_none_or(|(other, _)| log_evidence > *other) {
                let law = Law { amplitude_sds: direction.sds.clone(), ..law.clone() };
                let numbers = numbers(amplitudes.as_slice(), &direction.sds, direction.fraction);
                let score = Score { law, numbers, log_evidence: [0.0; 2] };
                let (sds, fraction) = (direction.sds.clone(), direction.fraction);
                best = Some((log_evidence, Best { score, columns, sds, fraction }));
            }
        }
        if let Some((_, mut best)) = best {
            best.score.log_evidence =
                sums.map(|sums| ln_sum(sums.iter().copied()) - (sums.len() as f64).ln());
            all_best.push(best);
        }
    }
    let pairs = pairs(&metrics, &all_best);
    Ok((all_best.into_iter().map(|best| best.score).collect(), pairs))
}

/// Amplitudes in their own units, then the fraction of the range of a shape.
fn numbers(amplitudes: &[f64], sds: &[f64], fraction: Option<f64>) -> Vec<f64> {
    amplitudes.iter().zip(sds).map(|(a, sd)| a * sd).chain(fraction).collect()
}

/// Pairs of laws whose joint log evidence exceeds the sum of their single ones, each law at the shape that is best alone. The laws of other
/// pairs are found one by one.
fn pairs(metrics: &[DMatrix<f64>; 2], all: &[Best]) -> Vec<Pair> {
    let mut pairs = Vec::new();
    for (i, one) in all.iter().enumerate() {
        for other in all.iter().skip(i + 1) {
            let columns: Vec<usize> = one.columns.iter().chain(&other.columns).copied().collect();
            let evidences = metrics.each_ref().map(|metric| evidence_of(metric, &columns));
            let [Some((log_evidence, amplitudes)), Some((as_white, _))] = evidences else { continue };
            let are_hidden = metrics.iter().zip([log_evidence, as_white]).any(|(metric, together)| {
                let alone =
                    [one, other].map(|best| evidence_of(metric, &best.columns).map_or(0.0, |found| found.0));
                together > alone[0] + alone[1]
            });
            if !are_hidden {
                continue;
            }
            let (first, second) = amplitudes.as_slice().split_at(one.columns.len());
            let scores = [(one, first), (other, second)].map(|(best, amplitudes)| Score {
                numbers: numbers(amplitudes, &best.sds, best.fraction),
                ..best.score.clone()
            });
            pairs.push(Pair { scores, log_evidence: [log_evidence, as_white] });
        }
    }
    pairs
}

/// Scalar products in the metric of noise and discrepancy (of the fitted sizes, at most the everyday ones), with the parameters projected
/// out; zero for directions that the parameters can produce alone.
fn projected(
    bench: &Bench<'_>,
    basis: &Basis,
    fitted: &Fitted,
    noises: &[Noise],
    columns: &[DMatrix<f64>],
) -> Option<DMatrix<f64>> {
    let (patterns, products, _) = whitened(bench, basis, noises, columns);
    let sizes: Vec<f64> =
        fitted.sizes.iter().zip(basis.everyday()).map(|(size, most)| size.min(most)).collect();
    let metric = patterns.in_metric(&sizes, &products)?;
    let count = fitted.values.len();
    let remaining_count = metric.nrows() - count;
    let parameter_block = metric.view((0, 0), (count, count)) + DMatrix::identity(count, count);
    let cross_block = metric.view((0, count), (count, remaining_count)).into_owned();
    let follow = parameter_block.cholesky()?.solve(&cross_block);
    let measured_block = metric.view((count, count), (remaining_count, remaining_count)).into_owned();
    let mut reduced = measured_block.clone();
    reduced.gemm_tr(-1.0, &cross_block, &follow, 1.0);
    for i in 0..remaining_count {
        if reduced[(i, i)] < ALL_ELIMINATED * measured_block[(i, i)] {
            reduced.row_mut(i).fill(0.0);
            reduced.column_mut(i).fill(0.0);
        }
    }
    Some(reduced)
}

/// Log evidence and amplitudes of directions, from scalar products whose last column is that of the residuals; `None` if the directions are
/// not identifiable.
fn evidence_of(metric: &DMatrix<f64>, columns: &[usize]) -> Option<(f64, DVector<f64>)> {
    let width = columns.len();
    let gram = DMatrix::from_fn(width, width, |i, j| metric[(columns[i], columns[j])]);
    if gram.diagonal().iter().any(|square| *square <= 0.0) {
        return None;
    }
    let projections = DVector::from_fn(width, |i, _| metric[(columns[i], metric.ncols() - 1)]);
    let factor = (gram + DMatrix::identity(width, width)).cholesky()?;
    let amplitudes = factor.solve(&projections);
    let ln_determinant: f64 = factor.l_dirty().diagonal().iter().map(|value| value.ln()).sum();
    Some((0.5 * projections.dot(&amplitudes) - ln_determinant, amplitudes))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_effect_without_a_form_is_told_which_forms_there_are() {
        for (text, problem) in [
            ("balance/x", "names no form: a law without a regressor is \"constant\", not \"x\""),
            ("balance/level/x", "\"x\" is none of the forms"),
            ("balance", "is not two or three names"),
            ("a/b/sign/d", "is not two or three names"),
        ] {
            let message = Effect::parse(text).expect_err(text).to_string();
            assert!(message.contains(problem), "{message}");
            assert!(message.contains("site/regressor/form") && message.contains("above_level"), "{message}");
        }
    }

    #[test]
    fn a_star_stands_for_any_part() {
        let effect = Effect::parse("*/speed/*").expect("an effect");
        assert!(effect.is_like("rail", Some("speed"), Form::Sign));
        assert!(
            !effect.is_like("rail", Some("place"), Form::Sign)
                && !effect.is_like("rail", None, Form::Constant)
        );
        let constant = Effect::parse("rail/constant").expect("an effect");
        assert!(
            constant.is_like("rail", None, Form::Constant)
                && !constant.is_like("rail", Some("speed"), Form::Sign)
        );
    }
}
