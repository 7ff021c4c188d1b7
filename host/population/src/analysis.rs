//! The whole analysis of a population: shared effects first, then K corrected for them.

use crate::NORMAL_975;
use crate::agreement::agreement;
use crate::error::PopulationError;
use crate::nested::{Nested, Observations};
use crate::patterns::Places;
use crate::random_effects::{RandomEffects, random_effects};
use crate::records::Records;
use crate::residuals::{Residual, residuals};
use crate::results::*;
use crate::search::{Found, search};
use crate::sharing::Likelihoods;
use crate::spread::{Names, spread};
use crate::summary::{Interval, Summary, Value};
use std::collections::{BTreeMap, BTreeSet};

/// Adjusted probability below which a session is listed as far from the others.
const FAR: f64 = 0.05;
/// Standard deviation of ln K beyond which a session's K is what its estimator assumes beforehand (1 to 1.5), and no measurement.
const MAX_LN_K_SD: f64 = 0.7;
/// Rounds of listing.
const ROUNDS: usize = 5;
/// Sessions of a group from which residuals are computed.
const MIN_SESSIONS: usize = 4;
/// Labels between which agreement is computed.
const AGREEMENT: [&str; 3] = ["rig", "needle", "site"];

/// What the user may choose.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Options {
    /// Labels or covariates that the groups are formed by; none: one group.
    pub by: Vec<String>,
    /// Labels of nested random effects, outermost first, such as `site`, `subject`.
    pub nested: Vec<String>,
    /// Covariates of the mean of ln K.
    pub covariates: Vec<String>,
}

/// What is kept of a record beside its likelihood.
struct Row {
    session: String,
    labels: BTreeMap<String, String>,
    rig: Option<String>,
    date: Option<String>,
    group: String,
    nested: Vec<String>,
    x: Vec<f64>,
    ln_k: f64,
    variance: f64,
    recorded_kpa: f64,
    listed: Option<String>,
}

/// Analyses records of sessions; the same result whatever their order.
///
/// # Errors
/// [`PopulationError`] where nothing can be computed.
pub fn analyse(records: impl Into<Records>, options: &Options) -> Result<Population, PopulationError> {
    let (summaries, mut data) = records.into().by_session().likelihoods();
    let known = known_names(&summaries);
    for (option, names) in
        [("--by", &options.by), ("--nested", &options.nested), ("--covariate", &options.covariates)]
    {
        if let Some(name) = names.iter().find(|name| !known.contains(name.as_str())) {
            let known = known.iter().map(|name| (*name).to_owned()).collect();
            return Err(PopulationError::UnknownName { option, name: name.clone(), known });
        }
    }
    let mut warnings = Vec::new();
    let label = |name: &str| summaries.iter().map(|summary| summary.label(name)).collect();
    let places = Places {
        labels: ["rig", "needle", "tissue", "day"].map(label),
        days: summaries.iter().map(Summary::day).collect(),
    };
    let (found, tests) = search(&mut data, &places);
    let names: Vec<Names> = summaries.iter().map(Names::of).collect();
    let spread = spread(&data, &names).into_iter().filter(|one| one.kind != SpreadKind::Absent).collect();
    let mut rows = Vec::new();
    let mut listed = Vec::new();
    for (index, summary) in summaries.iter().enumerate() {
        match row(summary, options, &mut warnings)? {
            Ok(mut row) => {
                correct(&mut row, &found, &data, index);
                if row.variance.sqrt() > MAX_LN_K_SD {
                    row.listed = Some("K is not identifiable from the session".to_owned());
                }
                rows.push(row);
            }
            Err(reason) => listed.push(ListedSession { session: summary.session.clone(), reason }),
        }
    }
    if rows.is_empty() {
        let reason = listed.first().map_or_else(|| "there are none".to_owned(), |one| one.reason.clone());
        return Err(PopulationError::Empty { sessions: summaries.len(), reason });
    }
    let mut groups: BTreeMap<String, Vec<usize>> = BTreeMap::new();
    rows.iter().enumerate().for_each(|(index, row)| groups.entry(row.group.clone()).or_default().push(index));
    let mut results = Vec::new();
    let mut residuals: BTreeMap<usize, Residual> = BTreeMap::new();
    for (group, members) in &groups {
        list_far(&mut rows, members);
        let used: Vec<usize> =
            members.iter().copied().filter(|index| rows[*index].listed.is_none()).collect();
        match of_group(&rows, group, members, &used, options) {
            Ok((result, of_members)) => {
                results.push(result);
                residuals.extend(of_members);
            }
            Err(PopulationError::Undetermined { .. }) if groups.len() > 1 || used.is_empty() => warnings
                .push(format!(
                    "group {group}: {} sessions that count do not determine a mean; it is skipped",
                    used.len()
                )),
            Err(error) => return Err(error),
        }
    }
    let of_row =
        |row: &Row| Some(ListedSession { session: row.session.clone(), reason: row.listed.clone()? });
    listed.extend(rows.iter().filter_map(of_row));
    listed.sort_by(|a, b| a.session.cmp(&b.session));
    Ok(Population {
        schema: POPULATION_SCHEMA,
        sessions: Counts {
            given: summaries.len(),
            with_modulus: rows.len(),
            used: rows.iter().filter(|row| row.listed.is_none()).count(),
        },
        by: options.by.clone(),
        covariates: options.covariates.clone(),
        groups: results,
        shared_effects: found.into_iter().map(|one| one.result).collect(),
        spread,
        tests,
        listed,
        agreement: AGREEMENT.iter().flat_map(|label| agreement_of(label, &rows)).collect(),
        tip_load: tip_loads(&summaries),
        discrepancy: discrepancy(&summaries),
        rows: rows.iter().enumerate().map(|(index, row)| session_row(row, residuals.get(&index))).collect(),
        warnings,
    })
}

fn known_names(summaries: &[Summary]) -> BTreeSet<&str> {
    let mut known: BTreeSet<&str> = BTreeSet::new();
    for summary in summaries {
        let labels = ["site", "subject", "rig", "needle", "tissue", "day", "month"];
        known.extend(labels.into_iter().filter(|name| summary.label(name).is_some()));
        known.extend(summary.covariates.keys().map(String::as_str));
    }
    known
}

/// What a record is in the analysis of K, or why it is not.
fn row(
    summary: &Summary,
    options: &Options,
    warnings: &mut Vec<String>,
) -> Result<Result<Row, String>, PopulationError> {
    let Some(result) = &summary.result else {
        return Ok(Err(format!("failed: {}", summary.error.as_deref().unwrap_or("no result"))));
    };
    let value = |name: &String| summary.label(name).unwrap_or_else(|| format!("no {name}"));
    let mut x = Vec::new();
    for name in &options.covariates {
        match summary.covariates.get(name) {
            Some(Value::Number(number)) => x.push(*number),
            Some(Value::Text(_)) => {
                return Err(PopulationError::NotANumber {
                    name: name.clone(),
                    session: summary.session.clone(),
                });
            }
            None => {
                warnings.push(format!(
                    "session {}: covariate {name} is missing; the session is skipped",
                    summary.session
                ));
                return Ok(Err(format!("covariate {name} is missing")));
            }
        }
    }
    let labels = AGREEMENT
        .iter()
        .chain(&["subject"])
        .filter_map(|name| Some(((*name).to_owned(), summary.label(name)?)));
    Ok(Ok(Row {
        session: summary.session.clone(),
        labels: labels.collect(),
        rig: summary.rig.clone(),
        date: summary.date.clone(),
        group: if options.by.is_empty() {
            "all".to_owned()
        } else {
            options.by.iter().map(value).collect::<Vec<_>>().join(" / ")
        },
        nested: options.nested.iter().map(value).collect(),
        x,
        ln_k: result.ln_k_kpa,
        variance: result.ln_k_sd.powi(2),
        recorded_kpa: result.k_kpa,
        listed: (result.verdict == "unexplained")
            .then(|| "the misfit of the session is unexplained".to_owned()),
    }))
}

/// Takes off what shared effects do to a session's K; their errors widen its own. A misfit that the session alone leaves unexplained is
/// explained by them.
fn correct(row: &mut Row, found: &[Found], data: &Likelihoods, index: usize) {
    for one in found {
        let Ok(place) = one.members.binary_search_by(|(member, _)| member.cmp(&index)) else { continue };
        if let Some((shift, variance)) = one.ln_k_shift(data, index, one.members[place].1) {
            row.ln_k -= shift;
            row.variance += variance;
            row.listed = None;
        }
    }
}

fn observations<'a>(rows: &'a [Row], members: &[usize]) -> Observations {
    let levels = rows.first().map_or(0, |row| row.nested.len());
    let mut numbers: BTreeMap<Vec<&'a str>, usize> = BTreeMap::new();
    // An inner group is another one in every outer group.
    let mut number = |path: Vec<&'a str>| -> usize {
        let next = numbers.len();
        *numbers.entry(path).or_insert(next)
    };
    let mut all = Vec::new();
    for depth in 0..levels {
        let of =
            members.iter().map(|index| rows[*index].nested[..=depth].iter().map(String::as_str).collect());
        all.push(of.map(&mut number).collect());
    }
    Observations {
        y: members.iter().map(|index| rows[*index].ln_k).collect(),
        v: members.iter().map(|index| rows[*index].variance).collect(),
        x: members.iter().map(|index| rows[*index].x.clone()).collect(),
        levels: all,
    }
}

/// Lists the sessions of a group that are far from the others, until none is.
fn list_far(rows: &mut [Row], members: &[usize]) {
    for _ in 0..ROUNDS {
        let used: Vec<usize> =
            members.iter().copied().filter(|index| rows[*index].listed.is_none()).collect();
        let data = Observations { levels: Vec::new(), ..observations(rows, &used) };
        let enough = used.len() >= MIN_SESSIONS + data.parameters();
        let Some(fit) = Nested::fit(&data).filter(|_| enough) else { return };
        let mut any = false;
        for (index, residual) in used.iter().zip(residuals(&data, &fit)) {
            if residual.p_adjusted < FAR {
                any = true;
                rows[*index].listed = Some(format!(
                    "K is far from the group: residual {:+.1} sd, {:+.1} sd from the robust fit",
                    residual.standardised, residual.robust
                ));
            }
        }
        if !any {
            return;
        }
    }
}

fn interval(ln: f64, ends: [f64; 2]) -> Interval {
    Interval { value: ln.exp(), ci95: ends.map(f64::exp) }
}

/// Mean at the mean of the covariates with its interval, and its standard error.
fn mean(data: &Observations, found: &RandomEffects) -> ([f64; 2], Interval) {
    let (ln, variance) = found.mean_at(&data.mean_row());
    let [(_, se, [_, high]), ..] = found.beta.as_slice() else { return ([ln, 0.0], interval(ln, [ln; 2])) };
    // The factor of Hartung and Knapp and the quantile are those of the parameters.
    let (_, plain) =
        found.mean_at(&std::iter::once(1.0).chain(vec![0.0; data.parameters() - 1]).collect::<Vec<_>>());
    let quantile = (high - found.beta[0].0) / se;
    let se = (variance / plain).sqrt() * se;
    ([ln, se], interval(ln, [ln - quantile * se, ln + quantile * se]))
}

type OfMembers = Vec<(usize, Residual)>;

fn of_group(
    rows: &[Row],
    group: &str,
    members: &[usize],
    used: &[usize],
    options: &Options,
) -> Result<(GroupResult, OfMembers), PopulationError> {
    let undetermined = || PopulationError::Undetermined {
        group: group.to_owned(),
        sessions: used.len(),
        covariates: options.covariates.len(),
    };
    let data = observations(rows, used);
    let found = if used.is_empty() { None } else { random_effects(&data) }.ok_or_else(undetermined)?;
    let ([ln, se], k_kpa) = mean(&data, &found);
    let fit = Nested::at(&data, &data.order(), &found.tau).ok_or_else(undetermined)?;
    let of_members = used.iter().copied().zip(residuals(&data, &fit)).collect();
    let with_listed = (members.len() > used.len()).then(|| {
        let all = observations(rows, members);
        let found = random_effects(&all)?;
        Some(WithListed { sessions: members.len(), k_kpa: mean(&all, &found).1, tau: found.tau_total })
    });
    let subjects: BTreeSet<&String> =
        used.iter().filter_map(|index| rows[*index].labels.get("subject")).collect();
    let levels = options.nested.iter().cloned().zip(found.tau.iter().skip(1).copied());
    let result = GroupResult {
        group: group.to_owned(),
        sessions: used.len(),
        subjects: subjects.len(),
        k_kpa,
        ln_k: [ln, se],
        tau: found.tau_total,
        tau_ci95: found.tau_ci95,
        tau_paule_mandel: found.tau_paule_mandel,
        levels: levels.chain([("session".to_owned(), found.tau[0])]).collect(),
        prediction95_kpa: found.prediction95.map(|ends| ends.map(f64::exp)),
        i_squared_percent: found.i_squared_percent,
        q: found.q.0,
        degrees_of_freedom: found.q.1,
        p: found.q.2,
        icc: found.icc,
        slopes: options
            .covariates
            .iter()
            .cloned()
            .zip(found.beta.iter().skip(1))
            .map(|(name, (value, _, ci95))| (name, Interval { value: *value, ci95: *ci95 }))
            .collect(),
        with_listed: with_listed.flatten(),
    };
    Ok((result, of_members))
}

fn agreement_of(label: &str, rows: &[Row]) -> Vec<crate::agreement::Agreement> {
    let of = |row: &Row| Some((row.labels.get("subject")?.clone(), row.labels.get(label)?.clone(), row.ln_k));
    let used: Vec<_> = rows.iter().filter(|row| row.listed.is_none()).filter_map(of).collect();
    agreement(label, &used)
}

/// Needle and tissue, where they are stated.
type NeedleAndTissue<'a> = (Option<&'a String>, Option<&'a String>);

/// Tip load by needle and tissue: random effects between sessions.
fn tip_loads(summaries: &[Summary]) -> Vec<TipLoadResult> {
    let mut groups: BTreeMap<NeedleAndTissue<'_>, (Vec<f64>, Vec<f64>)> = BTreeMap::new();
    for summary in summaries {
        let Some(result) = summary.result.as_ref().filter(|result| result.verdict != "unexplained") else {
            continue;
        };
        let (Some(load), Some([low, high])) = (result.tip_load_n, result.tip_load_ci95_n) else { continue };
        let sd = (high - low) / (2.0 * NORMAL_975);
        if sd > 0.0 && load.is_finite() && sd.is_finite() {
            let group = groups.entry((summary.needle.as_ref(), summary.tissue.as_ref())).or_default();
            group.0.push(load);
            group.1.push(sd * sd);
        }
    }
    let of = |((needle, tissue), (y, v)): (NeedleAndTissue<'_>, (Vec<f64>, Vec<f64>))| {
        let found = random_effects(&Observations { y, v, x: Vec::new(), levels: Vec::new() })?;
        let (value, _, ci95) = *found.beta.first()?;
        Some(TipLoadResult {
            needle: needle.cloned(),
            tissue: tissue.cloned(),
            sessions: found.sessions,
            load_n: Interval { value, ci95 },
            between_n: (found.sessions > 1).then_some(found.tau_total),
        })
    };
    groups.into_iter().filter_map(of).collect()
}

/// Median over sessions of every size.
fn discrepancy(summaries: &[Summary]) -> BTreeMap<String, f64> {
    let mut all: BTreeMap<&String, Vec<f64>> = BTreeMap::new();
    for (name, multiple) in
        summaries.iter().filter_map(|summary| summary.result.as_ref()).flat_map(|result| &result.discrepancy)
    {
        all.entry(name).or_default().push(*multiple);
    }
    let median = |mut values: Vec<f64>| {
        values.sort_by(f64::total_cmp);
        values[values.len() / 2]
    };
    all.into_iter().map(|(name, values)| (name.clone(), median(values))).collect()
}

fn session_row(row: &Row, residual: Option<&Residual>) -> SessionRow {
    let sd = row.variance.sqrt();
    let around = |ln: f64, sd: f64| interval(ln, [ln - NORMAL_975 * sd, ln + NORMAL_975 * sd]);
    SessionRow {
        session: row.session.clone(),
        group: row.group.clone(),
        rig: row.rig.clone(),
        date: row.date.clone(),
        k_kpa: around(row.ln_k, sd),
        k_recorded_kpa: row.recorded_kpa,
        k_shrunk_kpa: residual.map(|residual| around(residual.shrunk.0, residual.shrunk.1)),
        residual: residual.map(|residual| residual.standardised),
        residual_robust: residual.map(|residual| residual.robust),
        used: row.listed.is_none(),
    }
}

#[cfg(test)]
#[path = "analysis_tests.rs"]
mod tests;
