//! The whole analysis of a population: shared effects first, then K corrected for them.

mod groups;

use crate::agreement::agreement;
use crate::error::PopulationError;
use crate::levels::Levels;
use crate::nested::Observations;
use crate::normal_975;
use crate::outliers::Judged;
use crate::patterns::Places;
use crate::random_effects::{Estimate, random_effects};
use crate::records::Records;
use crate::results::*;
use crate::search::{Found, search};
use crate::sharing::Likelihoods;
use crate::spread::{Names, spread};
use crate::summary::{Interval, Summary, Value};
use groups::of_group;
use std::collections::{BTreeMap, BTreeSet};

/// Standard deviation of ln K beyond which a session's K is what its estimator assumes beforehand (1 to 1.5), and no measurement.
const MAX_LN_K_SD: f64 = 0.7;
/// Labels between which agreement is computed.
const AGREEMENT: [&str; 3] = ["rig", "needle", "site"];

/// Choices of the user.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Options {
    /// Labels or covariates that the groups are formed by; none: one group.
    pub by: Vec<String>,
    /// Labels of nested random effects, outermost first, such as `site`, `subject`; none: those that the labels state.
    pub nested: Vec<String>,
    /// Takes all sessions for independent, whatever their labels state.
    pub independent: bool,
    /// Covariates of the mean of ln K.
    pub covariates: Vec<String>,
    /// Adds the draws of mean and spreads to the result.
    pub draws: bool,
}

/// Content of a record that is kept beside its likelihood.
pub(crate) struct Row {
    pub session: String,
    pub labels: BTreeMap<String, String>,
    rig: Option<String>,
    date: Option<String>,
    group: String,
    /// Values of the levels that were chosen.
    pub nested: Vec<Option<String>>,
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
    let records: Records = records.into();
    let discrepancy = records.median_sizes();
    let (summaries, mut data) = records.by_session().likelihoods();
    let label_names = known_names(&summaries);
    for (option, names) in
        [("--by", &options.by), ("--nested", &options.nested), ("--covariate", &options.covariates)]
    {
        if let Some(name) = names.iter().find(|name| !label_names.contains(name.as_str())) {
            let owned_names = label_names.iter().map(|name| (*name).to_owned()).collect();
            return Err(PopulationError::UnknownName { option, name: name.clone(), known: owned_names });
        }
    }
    let mut warnings = Vec::new();
    let group_labels = Places {
        labels: ["rig", "needle", "tissue", "day"]
            .map(|name| summaries.iter().map(|summary| summary.label(name)).collect()),
        days: summaries.iter().map(Summary::day).collect(),
    };
    let (shared_effects, tests) = search(&mut data, &group_labels);
    let names: Vec<Names> = summaries.iter().map(Names::of).collect();
    let spread = spread(&data, &names).into_iter().filter(|one| one.kind != SpreadKind::Absent).collect();
    let mut rows = Vec::new();
    let mut listed = Vec::new();
    for (index, summary) in summaries.iter().enumerate() {
        match row(summary, options, &mut warnings)? {
            Ok(mut row) => {
                correct(&mut row, &shared_effects, &data, index);
                if row.variance.sqrt() > MAX_LN_K_SD {
                    row.listed = Some("K is not identifiable from the session".to_owned());
                }
                rows.push(row);
            }
            Err(reason) => {
                listed.push(ListedSession { session: summary.session.clone(), reason, weight: 0.0 });
            }
        }
    }
    if rows.is_empty() {
        let reason = listed.first().map_or_else(|| "there are none".to_owned(), |one| one.reason.clone());
        return Err(PopulationError::Empty { sessions: summaries.len(), reason });
    }
    let mut groups: BTreeMap<String, Vec<usize>> = BTreeMap::new();
    rows.iter().enumerate().for_each(|(index, row)| groups.entry(row.group.clone()).or_default().push(index));
    let mut results = Vec::new();
    let mut judged: BTreeMap<usize, Judged> = BTreeMap::new();
    for (group, members) in &groups {
        let used_rows: Vec<usize> =
            members.iter().copied().filter(|index| rows[*index].listed.is_none()).collect();
        match of_group(&rows, group, members, &used_rows, options) {
            Ok(of_group) => {
                results.push(of_group.result);
                judged.extend(of_group.judged);
                listed.extend(of_group.listed);
                warnings.extend(of_group.warnings);
            }
            Err(PopulationError::Undetermined { .. }) if groups.len() > 1 || used_rows.is_empty() => warnings
                .push(format!(
                    "group {group} is skipped: the sessions that count ({}) do not determine a mean",
                    used_rows.len()
                )),
            Err(error) => return Err(error),
        }
    }
    listed.extend(rows.iter().filter_map(|row| {
        Some(ListedSession { session: row.session.clone(), reason: row.listed.clone()?, weight: 0.0 })
    }));
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
        shared_effects: shared_effects.into_iter().map(|one| one.result).collect(),
        spread,
        tests,
        listed,
        agreement: AGREEMENT.iter().flat_map(|label| agreement_of(label, &rows)).collect(),
        tip_load: tip_loads(&summaries),
        discrepancy,
        rows: rows.iter().enumerate().map(|(index, row)| session_row(row, judged.get(&index))).collect(),
        warnings,
    })
}

fn known_names(summaries: &[Summary]) -> BTreeSet<&str> {
    let mut names: BTreeSet<&str> = BTreeSet::new();
    for summary in summaries {
        let labels = ["site", "subject", "rig", "needle", "tissue", "day", "month"];
        names.extend(labels.into_iter().filter(|name| summary.label(name).is_some()));
        names.extend(summary.covariates.keys().map(String::as_str));
    }
    names
}

/// Row of a record in the analysis of K, or the reason for leaving it out.
fn row(
    summary: &Summary,
    options: &Options,
    warnings: &mut Vec<String>,
) -> Result<Result<Row, String>, PopulationError> {
    let Some(result) = &summary.result else {
        return Ok(Err(format!("failed: {}", summary.error.as_deref().unwrap_or("no result"))));
    };
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
            options
                .by
                .iter()
                .map(|name| summary.label(name).unwrap_or_else(|| format!("no {name}")))
                .collect::<Vec<_>>()
                .join(" / ")
        },
        nested: options.nested.iter().map(|name| summary.label(name)).collect(),
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
        let Ok(member_index) = one.members.binary_search_by(|(member, _)| member.cmp(&index)) else {
            continue;
        };
        if let Some((shift, variance)) = one.ln_k_shift(data, index, one.members[member_index].1) {
            row.ln_k -= shift;
            row.variance += variance;
            row.listed = None;
        }
    }
}

fn observations(rows: &[Row], members: &[usize], levels: &Levels) -> Observations {
    let mut rig_numbers: BTreeMap<Option<&String>, usize> = BTreeMap::new();
    let mut rig = Vec::with_capacity(members.len());
    for index in members {
        let next = rig_numbers.len();
        rig.push(*rig_numbers.entry(rows[*index].rig.as_ref()).or_insert(next));
    }
    Observations {
        y: members.iter().map(|index| rows[*index].ln_k).collect(),
        v: members.iter().map(|index| rows[*index].variance).collect(),
        x: members.iter().map(|index| rows[*index].x.clone()).collect(),
        levels: levels.of(rows, members),
        rig,
    }
}

fn interval(ln: f64, ends: [f64; 2]) -> Interval {
    Interval { value: ln.exp(), ci95: ends.map(f64::exp) }
}

fn normal_interval(ln: f64, sd: f64) -> Interval {
    let half = normal_975() * sd;
    interval(ln, [ln - half, ln + half])
}

fn modulus(mean: &Estimate) -> Interval {
    interval(mean.value, mean.ci95)
}

fn agreement_of(label: &str, rows: &[Row]) -> Vec<crate::agreement::Agreement> {
    let subject_rows: Vec<_> = rows
        .iter()
        .filter(|row| row.listed.is_none())
        .filter_map(|row| {
            Some((row.labels.get("subject")?.clone(), row.labels.get(label)?.clone(), row.ln_k))
        })
        .collect();
    agreement(label, &subject_rows)
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
        let sd = (high - low) / (2.0 * normal_975());
        if sd > 0.0 && load.is_finite() && sd.is_finite() {
            let group = groups.entry((summary.needle.as_ref(), summary.tissue.as_ref())).or_default();
            group.0.push(load);
            group.1.push(sd * sd);
        }
    }
    groups
        .into_iter()
        .filter_map(|((needle, tissue), (y, v))| {
            let load_fit = random_effects(&Observations { y, v, ..Observations::default() })?;
            let Estimate { value, ci95, .. } = *load_fit.beta.first()?;
            Some(TipLoadResult {
                needle: needle.cloned(),
                tissue: tissue.cloned(),
                sessions: load_fit.sessions,
                load_n: Interval { value, ci95 },
                between_n: (load_fit.sessions > 1).then_some(load_fit.tau_total),
            })
        })
        .collect()
}

fn session_row(row: &Row, judged: Option<&Judged>) -> SessionRow {
    SessionRow {
        session: row.session.clone(),
        group: row.group.clone(),
        rig: row.rig.clone(),
        date: row.date.clone(),
        k_kpa: normal_interval(row.ln_k, row.variance.sqrt()),
        k_recorded_kpa: row.recorded_kpa,
        k_shrunk_kpa: judged.map(|judged| normal_interval(row.ln_k + judged.shrunk.0, judged.shrunk.1)),
        residual: judged.map(|judged| judged.residual),
        residual_degrees_of_freedom: judged
            .map(|judged| judged.freedom)
            .filter(|freedom| freedom.is_finite()),
        p_adjusted: judged.map(|judged| judged.p_adjusted),
        weight: if row.listed.is_some() { 0.0 } else { judged.map_or(1.0, |judged| judged.weight) },
        used: row.listed.is_none(),
    }
}

#[cfg(test)]
#[path = "analysis_tests.rs"]
mod tests;
