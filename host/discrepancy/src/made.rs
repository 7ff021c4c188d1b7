//! Assembles the report from the result of a search.

use super::basis::Basis;
use super::bench::{Bench, Law, Prepared};
use super::fit::Fitted;
use super::judge::held_out_residuals;
use super::model::{Error, Parameter};
use super::regions::regions;
use super::report::{
    ChannelReport, DiscrepancyReport, Estimate, LawName, Misfit, NoiseReport, ParameterReport, RefusedReport,
    Report, Rival, TermReport, Verdict,
};
use super::score::no_covariance;
use super::search::{Found, Member, Refusal, Refused};
use super::weights::STATED_PROBABILITY;
use nalgebra::DVector;
use statrs::distribution::{ContinuousCDF, Normal};

pub(crate) fn estimate(name: &str, unit: String, value: f64, variance: f64) -> Estimate {
    let sd = variance.max(0.0).sqrt();
    let half = half_width95(sd);
    Estimate { name: name.to_owned(), unit, value, sd, ci95: [value - half, value + half] }
}

/// Half-width of the 95 % interval of a normal distribution.
pub(crate) fn half_width95(sd: f64) -> f64 {
    Normal::standard().inverse_cdf(0.975) * sd
}

pub(crate) fn law_name(bench: &Bench<'_>, law: &Law) -> LawName {
    let site = bench.model.sites().get(law.site);
    let regressor = law.regressor.and_then(|number| site?.regressors.get(number));
    let regressor = regressor.map(|regressor| regressor.name.clone());
    let formula = regressor.as_ref().map_or(law.form.formula().to_owned(), |name| {
        law.form.formula().split(' ').map(|word| named(word, name)).collect::<Vec<_>>().join(" ")
    });
    LawName {
        site: site.map_or_else(String::new, |site| site.name.clone()),
        regressor,
        form: law.form.name(),
        formula,
    }
}

/// A word of a formula with the regressor's name in place of `x`.
fn named(word: &str, name: &str) -> String {
    let mut text = String::new();
    for (i, c) in word.char_indices() {
        let previous = word[..i].chars().next_back();
        let next = word[i + c.len_utf8()..].chars().next();
        let is_in_word = [previous, next].into_iter().flatten().any(char::is_alphanumeric);
        if c == 'x' && !is_in_word { text.push_str(name) } else { text.push(c) }
    }
    text
}

/// Unit of a parameter of a law.
fn unit_of(bench: &Bench<'_>, law: &Law, number: usize) -> String {
    let Some(site) = bench.model.sites().get(law.site) else { return String::new() };
    let regressor = law.regressor.and_then(|number| site.regressors.get(number));
    let unit = regressor.map_or("", |regressor| regressor.unit.as_str());
    if number >= law.form.amplitudes().len() {
        return unit.to_owned();
    }
    match law.form.power() {
        0 => site.unit.clone(),
        _ if unit.is_empty() => site.unit.clone(),
        1 => format!("{}/({unit})", site.unit),
        power => format!("{}/({unit})^{power}", site.unit),
    }
}

/// Position of the first parameter of a law among those of a fit.
pub(crate) fn first_of(bench: &Bench<'_>, laws: &[Law], member: usize) -> usize {
    bench.model.parameters().len() + laws.iter().take(member).map(Law::len).sum::<usize>()
}

fn term_report(bench: &Bench<'_>, fitted: &Fitted, number: usize, member: &Member) -> Option<TermReport> {
    let law = fitted.laws.get(number)?;
    let first = first_of(bench, &fitted.laws, number);
    let values = bench.terms(&fitted.laws, &fitted.values).get(number)?.values.clone();
    let amplitudes = law.form.amplitudes();
    let values = values.iter().enumerate().map(|(i, value)| {
        let (variance, unit) = (fitted.sd(first + i).powi(2), unit_of(bench, law, i));
        match (amplitudes.get(i), law.shape()) {
            (Some(name), _) => estimate(name, unit, *value, variance),
            (None, Some(shape)) => {
                let [least, most] = shape.range;
                let slope = if shape.is_logarithmic { value * (most / least).ln() } else { most - least };
                estimate(shape.name, unit, *value, slope * slope * variance)
            }
            (None, None) => estimate("", unit, *value, variance),
        }
    });
    let mut sum = member.probability;
    let mut rivals = Vec::new();
    for (rival, probability) in &member.rivals {
        if sum >= STATED_PROBABILITY {
            break;
        }
        sum += probability;
        let mut added = rival.laws.iter().skip(fitted.laws.len() - 1).map(|law| law_name(bench, law));
        rivals.push(Rival { law: added.next()?, with: added.next(), probability: *probability });
    }
    Some(TermReport {
        law: law_name(bench, law),
        is_named: member.probability >= STATED_PROBABILITY,
        probability: member.probability,
        ln_odds: member.ln_odds,
        values: values.collect(),
        rivals,
        held_out: member.judgement,
    })
}

/// The final model and its rivals, with their weights, which sum to one.
pub(crate) fn models(found: &Found) -> Vec<(f64, &Fitted)> {
    let mut models: Vec<(f64, &Fitted)> = vec![(1.0, &found.fitted)];
    for member in &found.members {
        let most = member.probability.max(f64::MIN_POSITIVE);
        models.extend(member.rivals.iter().map(|(rival, probability)| (probability / most, rival)));
    }
    let total: f64 = models.iter().map(|(weight, _)| weight).sum();
    models.iter_mut().for_each(|(weight, _)| *weight /= total);
    models
}

/// Mean and variance over the models of a quantity that has a mean and a variance in each model.
pub(crate) fn moments(models: &[(f64, &Fitted)], quantity: impl Fn(&Fitted) -> (f64, f64)) -> (f64, f64) {
    let each: Vec<(f64, f64, f64)> = models
        .iter()
        .map(|(weight, fitted)| {
            let (value, variance) = quantity(fitted);
            (*weight, value, variance)
        })
        .collect();
    let mean = each.iter().map(|(weight, value, _)| weight * value).sum::<f64>();
    (mean, each.iter().map(|(weight, value, variance)| weight * (variance + (value - mean).powi(2))).sum())
}

/// Estimates of the model's parameters, averaged over the final model and its rivals.
fn parameter_reports(bench: &Bench<'_>, plain: &Fitted, found: &Found) -> Vec<ParameterReport> {
    let models = models(found);
    let reports = bench.model.parameters().iter().enumerate().map(|(number, parameter)| {
        let of_model = |fitted: &Fitted| {
            let value = fitted.values.get(number).copied().unwrap_or(parameter.mean);
            (value, fitted.sd(number).powi(2))
        };
        let (mean, variance) = moments(&models, of_model);
        let (before, before_variance) = of_model(plain);
        let Parameter { name, unit, .. } = parameter;
        ParameterReport {
            estimate: estimate(name, unit.clone(), mean, variance),
            before: estimate(name, unit.clone(), before, before_variance),
        }
    });
    reports.collect()
}

fn refused_reports(bench: &Bench<'_>, refused: &[Refused]) -> Vec<RefusedReport> {
    let mut reports: Vec<RefusedReport> = refused
        .iter()
        .map(|refused| {
            let (reason, held_out) = match refused.reason {
                Refusal::Unlikely => ("too unlikely beside the model without it", None),
                Refusal::NotConfirmed(judgement) => ("not confirmed by held-out runs", Some(judgement)),
            };
            let law = law_name(bench, &refused.law);
            RefusedReport { law, ln_odds: refused.ln_odds, reason: reason.to_owned(), held_out }
        })
        .collect();
    reports.sort_by(|a, b| b.ln_odds.total_cmp(&a.ln_odds));
    reports
}

/// Root mean squares of a channel's residuals and of its measured values, in the channel's unit; `None` without runs.
fn misfit(
    bench: &Bench<'_>,
    runs: &[Prepared<'_>],
    [before, after]: [&[DVector<f64>]; 2],
    channel: usize,
) -> Option<Misfit> {
    let scale = *bench.scales.get(channel)?;
    let measured: Vec<DVector<f64>> = runs.iter().map(|run| run.measured().clone()).collect();
    let [before, after, measured] = [before, after, &measured].map(|by_run| {
        scale
            * super::bench::rms(runs.iter().zip(by_run).map(|(prepared, values)| {
                let rows = prepared.rows_of(channel);
                values.rows(rows.start, rows.len()).into_owned()
            }))
    });
    (!runs.is_empty()).then_some(Misfit { before, after, measured })
}

fn channel_reports(bench: &Bench<'_>, plain: &Fitted, fitted: &Fitted) -> Result<Vec<ChannelReport>, Error> {
    let judged = held_out_residuals(bench, plain)?.zip(held_out_residuals(bench, fitted)?);
    let reports = bench.data.channels().iter().enumerate().filter_map(|(number, channel)| {
        let (scale, noise) = (*bench.scales.get(number)?, *fitted.noises.get(number)?);
        let judged = judged.as_ref().and_then(|(before, after)| {
            misfit(bench, &bench.held_out, [before.as_slice(), after.as_slice()], number)
        });
        Some(ChannelReport {
            name: channel.name.clone(),
            unit: channel.unit.clone(),
            noise: NoiseReport {
                sd: scale * noise.sd,
                correlated: noise.correlated,
                memory_s: noise.memory_s,
            },
            training: misfit(bench, &bench.training, [&plain.residuals, &fitted.residuals], number)?,
            held_out: judged,
        })
    });
    Ok(reports.collect())
}

/// The report of a search; the two bases are those of the search and of the final values.
pub(crate) fn report(
    bench: &Bench<'_>,
    [search_basis, basis]: [&Basis; 2],
    plain: &Fitted,
    found: &Found,
    candidates: usize,
) -> Result<Report, Error> {
    let fitted = &found.fitted;
    // Both use the noise of the final model, because the noise of the plain model has absorbed part of the misfit.
    let plain_regions = regions(bench, search_basis, plain, &fitted.noises).ok_or_else(no_covariance)?;
    let remaining = regions(bench, basis, fitted, &fitted.noises).ok_or_else(no_covariance)?;
    let members = found.members.iter().enumerate();
    let terms: Vec<TermReport> =
        members.filter_map(|(number, member)| term_report(bench, fitted, number, member)).collect();
    let verdict = match (terms.is_empty(), remaining.is_empty()) {
        (true, true) => Verdict::Adequate,
        (true, false) => Verdict::Unexplained,
        (false, false) => Verdict::Partial,
        (false, true) if terms.iter().all(|term| term.is_named) => Verdict::Explained,
        (false, true) => Verdict::Ambiguous,
    };
    let mut notes = Vec::new();
    if bench.held_out.is_empty() {
        notes.push("no run is held out: laws rest on the evidence alone".to_owned());
    }
    if !fitted.settled {
        notes.push("the last fit has not converged: values and intervals are approximate".to_owned());
    }
    let discrepancy = basis.sources.iter().zip(&fitted.sizes).map(|(source, size)| {
        let site = source.and_then(|(site, _)| bench.model.sites().get(site));
        let regressor = source.and_then(|(_, regressor)| site?.regressors.get(regressor));
        DiscrepancyReport {
            site: site.map(|site| site.name.clone()),
            regressor: regressor.map(|regressor| regressor.name.clone()),
            size: *size,
        }
    });
    Ok(Report {
        schema: "discrepancy.diagnosis/1",
        verdict,
        regions: plain_regions,
        terms,
        offsets: super::parts::offsets(bench, found),
        reversals: super::parts::reversals(bench, found),
        parameters: parameter_reports(bench, plain, found),
        channels: channel_reports(bench, plain, fitted)?,
        refused: refused_reports(bench, &found.refused),
        remaining,
        discrepancy: discrepancy.collect(),
        candidates,
        is_settled: fitted.settled && plain.settled,
        notes,
    })
}
