//! Two quantities of the sum of a site's laws: the offset, and half of the change on reversal.
//!
//! A friction of `F+` in one direction and `F-` in the other is a dry friction of `(F+ + F-) / 2` and an offset of `(F+ - F-) /
//! 2`, whichever laws express it: a sign and a constant, a sign and an asymmetry, or a step. Such a quantity is named if laws
//! that contribute to it are missing, even if the data cannot distinguish these laws.

use super::bench::{Bench, Law};
use super::data::Run;
use super::fit::Fitted;
use super::form::Form;
use super::made::{estimate, first_of, law_name, models, moments};
use super::model::Site;
use super::report::PartReport;
use super::search::{Found, Member};
use super::weights::STATED_PROBABILITY;
use nalgebra::DVector;

/// A quantity to which laws of a site contribute.
trait Part {
    /// Whether a law contributes.
    fn is_of(&self, bench: &Bench<'_>, law: &Law) -> bool;

    /// Contribution of a law with these parameter values, in their own units.
    fn value(&self, bench: &Bench<'_>, law: &Law, numbers: &[f64]) -> f64;
}

/// Mean over the data of the even parts of laws.
struct Offset;

/// Half of the change of a site's sum on reversal.
struct Reversal;

/// Name of the column on which a law of a site depends.
fn column_name<'b>(bench: &'b Bench<'_>, law: &Law) -> Option<&'b str> {
    let site = bench.model.sites().get(law.site)?;
    law.regressor.and_then(|number| site.regressors.get(number)).map(|regressor| regressor.name.as_str())
}

/// Indices of the readings of the channel to which a site adds.
fn readings<'r>(run: &'r Run, site: &Site) -> impl Iterator<Item = usize> + use<'r> {
    let channel = run.channels.iter().find(|channel| Some(&channel.name) == site.adds_to.as_ref());
    let values = channel.map_or(&[][..], |channel| channel.values.as_slice());
    values.iter().enumerate().filter(|(_, value)| value.is_finite()).map(|(i, _)| i)
}

impl Part for Offset {
    fn is_of(&self, bench: &Bench<'_>, law: &Law) -> bool {
        let is_added = bench.model.sites().get(law.site).is_some_and(|site| site.adds_to.is_some());
        let is_even = match law.form {
            Form::Constant => true,
            Form::Asymmetry
            | Form::Square
            | Form::Step
            | Form::AboveLevel
            | Form::BelowLevel
            | Form::Sine => law.span.has_both_signs(),
            _ => false,
        };
        is_added && is_even
    }

    fn value(&self, bench: &Bench<'_>, law: &Law, numbers: &[f64]) -> f64 {
        let Some(site) = bench.model.sites().get(law.site) else { return 0.0 };
        let amplitudes = law.form.amplitudes().len();
        let shape = numbers.get(amplitudes).copied().unwrap_or(1.0);
        let (mut sum, mut count) = (0.0, 0);
        for prepared in &bench.training {
            let column = column_name(bench, law).and_then(|name| prepared.run.column(name));
            for reading in readings(prepared.run, site) {
                let x = column.and_then(|values| values.get(reading)).copied().unwrap_or(0.0);
                for (number, amplitude) in numbers.iter().take(amplitudes).enumerate() {
                    sum += amplitude * law.form.even_part(number, x, shape, &law.span);
                }
                count += 1;
            }
        }
        sum / f64::from(count.max(1))
    }
}

impl Part for Reversal {
    fn is_of(&self, bench: &Bench<'_>, law: &Law) -> bool {
        let site = bench.model.sites().get(law.site);
        let regressor = law.regressor.and_then(|number| site?.regressors.get(number));
        // The sign of a position does not change on reversal.
        let is_of_a_rate = regressor.is_some_and(|regressor| !regressor.history);
        law.form == Form::Bristle || (law.form == Form::Sign && is_of_a_rate)
    }

    fn value(&self, _: &Bench<'_>, _: &Law, numbers: &[f64]) -> f64 {
        numbers.first().copied().unwrap_or(0.0)
    }
}

/// Value and variance of a part in a model. The derivatives with respect to the parameters of laws are differences over one standard
/// deviation to either side: over smaller steps a law with a level changes in jumps, by single readings.
fn in_model(bench: &Bench<'_>, fitted: &Fitted, part: &dyn Part, site: usize) -> (f64, f64) {
    let coordinates = bench.coordinates(&fitted.laws);
    let mut gradient = DVector::zeros(fitted.values.len());
    for number in first_of(bench, &fitted.laws, 0)..fitted.values.len() {
        let Some(coordinate) = coordinates.get(number) else { continue };
        let sd = fitted.sd(number);
        let [(least, lower), (most, upper)] = [-sd, sd].map(|step| {
            let mut values = fitted.values.clone();
            values[number] = (values[number] + step).clamp(coordinate.least, coordinate.most);
            (values[number], total(bench, &fitted.laws, &values, part, site))
        });
        if most > least {
            gradient[number] = (upper - lower) / (most - least);
        }
    }
    let value = total(bench, &fitted.laws, &fitted.values, part, site);
    (value, (gradient.transpose() * &fitted.covariance * &gradient)[(0, 0)])
}

/// Value of a part, summed over the laws of a site.
fn total(bench: &Bench<'_>, laws: &[Law], values: &[f64], part: &dyn Part, site: usize) -> f64 {
    let terms = bench.terms(laws, values);
    let contributing = laws.iter().zip(&terms).filter(|(law, _)| law.site == site && part.is_of(bench, law));
    contributing.map(|(law, term)| part.value(bench, law, &term.values)).sum()
}

/// Probability of a part by one law of the final model and its rivals: the sum over those explanations that have the part.
fn probability(bench: &Bench<'_>, found: &Found, number: usize, member: &Member, part: &dyn Part) -> f64 {
    let kept = found.fitted.laws.len().saturating_sub(1);
    let of_law = found
        .fitted
        .laws
        .get(number)
        .filter(|law| part.is_of(bench, law))
        .map_or(0.0, |_| member.probability);
    let of_rivals = member
        .rivals
        .iter()
        .filter(|(rival, _)| rival.laws.iter().skip(kept).any(|law| part.is_of(bench, law)));
    of_law + of_rivals.map(|(_, probability)| probability).sum::<f64>()
}

/// A part for each site at which a law of the final model has it, averaged over the final model and its rivals.
fn reports(bench: &Bench<'_>, found: &Found, part: &dyn Part) -> Vec<PartReport> {
    let models = models(found);
    let reports = bench.model.sites().iter().enumerate().filter_map(|(number, site)| {
        let laws = found.fitted.laws.iter().filter(|law| law.site == number && part.is_of(bench, law));
        let laws: Vec<String> = laws.map(|law| law_name(bench, law).id()).collect();
        if laws.is_empty() {
            return None;
        }
        let members = found.members.iter().enumerate();
        let of_site = members
            .filter(|(member, _)| found.fitted.laws.get(*member).is_some_and(|law| law.site == number));
        let probabilities =
            of_site.map(|(member, found_law)| probability(bench, found, member, found_law, part));
        // The probability is at least that by the most certain law.
        let probability = probabilities.fold(0.0, f64::max);
        let (mean, variance) = moments(&models, |fitted| in_model(bench, fitted, part, number));
        let estimate = estimate(&site.name, site.unit.clone(), mean, variance);
        let [low, high] = estimate.ci95;
        let is_named = probability >= STATED_PROBABILITY && (low > 0.0 || high < 0.0);
        Some(PartReport { estimate, is_named, probability, laws })
    });
    reports.collect()
}

/// Sums of the even parts of the laws of each site, averaged over the data.
pub(crate) fn offsets(bench: &Bench<'_>, found: &Found) -> Vec<PartReport> {
    reports(bench, found, &Offset)
}

/// Sums of the signs and bristles of each site: if friction builds up over a short distance, both contribute to the change on reversal.
pub(crate) fn reversals(bench: &Bench<'_>, found: &Found) -> Vec<PartReport> {
    reports(bench, found, &Reversal)
}
