//! The groups of sessions in which an effect may be shared: every value of every label, and the dates of every rig (theory, eq. 73).

use crate::results::SharedKind;
use crate::sharing::{Likelihoods, groups};

/// Sessions of a group, and on either side of a step.
pub(crate) const MIN_SESSIONS: usize = 3;
/// Labels whose groups may share an effect, the most specific cause first.
pub(crate) const LABELS: [&str; 4] = ["rig", "needle", "tissue", "day"];

/// A session's labels for the search.
#[derive(Debug, Clone, Default)]
pub(crate) struct Places {
    /// Values of `LABELS` of every session.
    pub labels: [Vec<Option<String>>; 4],
    /// Day of every session.
    pub days: Vec<Option<f64>>,
}

impl Places {
    /// Day of a session, where it is stated.
    pub fn day(&self, session: usize) -> Option<f64> {
        self.days.get(session).copied().flatten()
    }
}

/// Sessions that are tested together and how much of the effect each has.
#[derive(Debug, Clone)]
pub(crate) struct Pattern {
    pub label: &'static str,
    pub group: String,
    pub kind: SharedKind,
    /// Sessions in order of their dates, and how much of the effect each has.
    pub members: Vec<(usize, f64)>,
    /// For a step: first members of the dates that it may begin on.
    pub starts: Vec<usize>,
}

/// Every group that is tested, as a whole and, for rigs, along its dates.
pub(crate) fn patterns(data: &Likelihoods, places: &Places) -> Vec<Pattern> {
    let mut patterns = Vec::new();
    for (label, values) in LABELS.into_iter().zip(&places.labels) {
        for (group, all) in groups(values) {
            let mut sessions = usable(data, all, label != "day");
            if sessions.len() < MIN_SESSIONS {
                continue;
            }
            sessions.sort_by(|a, b| {
                let [day_a, day_b] = [a, b].map(|index| places.day(*index).unwrap_or(f64::NEG_INFINITY));
                day_a.total_cmp(&day_b)
            });
            let all_sessions = sessions.iter().map(|index| (*index, 1.0)).collect();
            let mut kinds = vec![(SharedKind::Shared, all_sessions, Vec::new())];
            if label == "rig" {
                let dated: Vec<(usize, f64)> =
                    sessions.iter().filter_map(|index| Some((*index, places.day(*index)?))).collect();
                kinds.extend(drift(&dated));
            }
            patterns.extend(kinds.into_iter().map(|(kind, members, starts)| Pattern {
                label,
                group: group.to_owned(),
                kind,
                members,
                starts,
            }));
        }
    }
    let usable_sessions = usable(data, (0..data.sessions.len()).collect(), true);
    let weighted_sessions: Vec<(usize, f64)> =
        usable_sessions.into_iter().map(|index| (index, 1.0)).collect();
    if weighted_sessions.len() >= MIN_SESSIONS {
        let group = "all sessions".to_owned();
        patterns.push(Pattern {
            label: "all",
            group,
            kind: SharedKind::Shared,
            members: weighted_sessions,
            starts: Vec::new(),
        });
    }
    patterns
}

/// The sessions of a group that are tested together: those that leave no misfit unexplained, and the others too where they are the
/// majority, which is what an effect of the group does that each of them measures and none can name.
fn usable(data: &Likelihoods, group: Vec<usize>, with_majority: bool) -> Vec<usize> {
    let explained: Vec<(usize, bool)> = group
        .into_iter()
        .filter_map(|index| Some((index, data.sessions.get(index)?.as_ref()?.is_explained)))
        .collect();
    let unexplained = explained.iter().filter(|(_, is_explained)| !is_explained).count();
    let with_all = with_majority && unexplained >= MIN_SESSIONS && 2 * unexplained > explained.len();
    explained
        .into_iter()
        .filter(|(_, is_explained)| with_all || *is_explained)
        .map(|(index, _)| index)
        .collect()
}

/// Kind of a drift, how much of it each session has, and for a step the sessions that it may begin with.
type Drift = (SharedKind, Vec<(usize, f64)>, Vec<usize>);

/// Step and trend over the dates of a rig's sessions, which are in order.
fn drift(dated: &[(usize, f64)]) -> Vec<Drift> {
    let (Some((_, first)), Some((_, last))) = (dated.first(), dated.last()) else { return Vec::new() };
    let span = last - first;
    let starts: Vec<usize> = (MIN_SESSIONS..dated.len().saturating_sub(MIN_SESSIONS - 1))
        .filter(|start| dated[*start].1 > dated[start - 1].1)
        .collect();
    if starts.is_empty() || span <= 0.0 {
        return Vec::new();
    }
    let step = dated.iter().map(|(index, _)| (*index, 1.0)).collect();
    let trend = dated.iter().map(|(index, day)| (*index, (day - first) / span)).collect();
    vec![(SharedKind::Step, step, starts), (SharedKind::Trend, trend, Vec::new())]
}

/// The sessions that have something of the effect.
pub(crate) fn members(pattern: &Pattern, start: usize) -> Vec<(usize, f64)> {
    pattern.members.iter().skip(start).filter(|(_, x)| *x != 0.0).copied().collect()
}
