//! K of one group of sessions.

use super::{Options, Row, modulus, observations};
use crate::error::PopulationError;
use crate::levels::Levels;
use crate::outliers::Judged;
use crate::random_effects::{RandomEffects, random_effects};
use crate::results::*;
use crate::summary::Interval;
use std::collections::{BTreeMap, BTreeSet};

/// Result of one group of sessions.
pub(super) struct OfGroup {
    pub result: GroupResult,
    pub judged: Vec<(usize, Judged)>,
    pub listed: Vec<ListedSession>,
    pub warnings: Vec<String>,
}

pub(super) fn of_group(
    rows: &[Row],
    group: &str,
    members: &[usize],
    used: &[usize],
    options: &Options,
) -> Result<OfGroup, PopulationError> {
    let (levels, mut warnings) = Levels::choose(rows, group, used, options);
    let fit = (!used.is_empty()).then(|| random_effects(&observations(rows, used, &levels))).flatten();
    let determined_fit = fit.ok_or_else(|| PopulationError::Undetermined {
        group: group.to_owned(),
        sessions: used.len(),
        covariates: options.covariates.len(),
    })?;
    if let Some(sd) = determined_fit.common_sd {
        warnings.push(format!(
            "group {group}: the sessions scatter less than their errors state (p below 0.025): these errors are taken to be common to \
             the sessions of a rig, and add {:.1} % (sd) to the mean's error",
            100.0 * sd
        ));
    }
    let with_listed = (members.len() > used.len()).then(|| {
        let (levels, _) = Levels::choose(rows, group, members, options);
        let group_fit = random_effects(&observations(rows, members, &levels))?;
        let k_kpa = modulus(&group_fit.mean);
        Some(WithListed { sessions: members.len(), k_kpa, tau: group_fit.tau_total })
    });
    let judged =
        used.iter().zip(&determined_fit.judged).filter_map(|(index, judged)| Some((*index, (*judged)?)));
    let judged: Vec<(usize, Judged)> = judged.collect();
    let mut reasons: BTreeMap<usize, String> = BTreeMap::new();
    for (stage, sessions, judged) in &determined_fit.far {
        for index in sessions.iter().map(|session| used[*session]) {
            let (name, value) = levels.group(rows, index, levels.names.len() - stage);
            let text =
                format!("{name} {value} is far from what the others predict: {:+.1} sd", judged.residual);
            reasons.insert(index, text);
        }
    }
    let outlying = judged.iter().filter(|(_, judged)| judged.weight < 1.0);
    let mut listed: Vec<ListedSession> = outlying
        .map(|(index, judged)| {
            let reason = reasons.get(index).cloned().unwrap_or_else(|| {
                format!("K is far from what the other sessions predict: {:+.1} sd", judged.residual)
            });
            ListedSession { session: rows[*index].session.clone(), reason, weight: judged.weight }
        })
        .collect();
    listed.sort_by(|a, b| a.session.cmp(&b.session));
    let result = group_result(rows, group, used, options, &levels, &determined_fit, with_listed.flatten());
    Ok(OfGroup { result, judged, listed, warnings })
}

fn group_result(
    rows: &[Row],
    group: &str,
    used: &[usize],
    options: &Options,
    levels: &Levels,
    found: &RandomEffects,
    with_listed: Option<WithListed>,
) -> GroupResult {
    let subjects: BTreeSet<&String> =
        used.iter().filter_map(|index| rows[*index].labels.get("subject")).collect();
    let names = levels.names.iter().map(String::as_str).chain(["session"]);
    let slopes = options.covariates.iter().cloned().zip(found.beta.iter().skip(1));
    let draws = options.draws.then(|| {
        let taus = names.clone().map(|name| format!("tau_{name}")).zip(found.tau_draws.iter().cloned());
        std::iter::once(("ln_k_kpa".to_owned(), found.mean_draws.clone())).chain(taus).collect()
    });
    GroupResult {
        group: group.to_owned(),
        sessions: used.len(),
        subjects: subjects.len(),
        k_kpa: modulus(&found.mean),
        ln_k: [found.mean.value, found.mean.se],
        degrees_of_freedom: found.degrees_of_freedom.min(used.len() as f64),
        tau: found.tau_total,
        tau_ci95: found.tau_ci95,
        tau_paule_mandel: found.tau_paule_mandel,
        levels: names
            .zip(&found.levels)
            .map(|(name, level)| LevelResult {
                level: name.to_owned(),
                groups: level.groups,
                tau: level.tau,
                tau_ci95: level.ci95,
                degrees_of_freedom: level.degrees_of_freedom,
                icc: level.icc.map(|(icc, _)| icc),
                icc_ci95: level.icc.map(|(_, ends)| ends),
            })
            .collect(),
        new_subject95_kpa: found.new_subject95.map(|ends| ends.map(f64::exp)),
        new_session95_kpa: found.new_session95.map(|(ends, _)| ends.map(f64::exp)),
        new_session_degrees_of_freedom: found
            .new_session95
            .map(|(_, freedom)| freedom.min(used.len() as f64)),
        i_squared_percent: found.i_squared_percent,
        q: found.q.0,
        q_degrees_of_freedom: found.q.1,
        q_p: found.q.2,
        common_sd: found.common_sd,
        slopes: slopes
            .map(|(name, slope)| (name, Interval { value: slope.value, ci95: slope.ci95 }))
            .collect(),
        with_listed,
        draws,
    }
}
