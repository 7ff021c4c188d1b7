//! Finds effects that groups of sessions share, and effects that drift (theory, eq. 73).
//!
//! Every effect is tested in every group of every label, along every rig's dates as a step at each of them and as a trend. The one with
//! the largest evidence is taken, its part of all scores is subtracted, and the search repeats; at the end all that were found are
//! fitted beside each other. An effect is named where its probability by chance, times the number of tests, is below 1 %, where it is
//! not too small to matter, and where its value from each half of the sessions shrinks the misfit of the other half.

use crate::normal_975;
use crate::patterns::{MIN_SESSIONS, Pattern, Places, members, patterns};
use crate::results::{Competing, HeldOut, SharedEffect, SharedKind, SharedParameter};
use crate::sharing::{Hypothesis, Likelihoods, MAX_PARAMETERS, Sum, Test, Vector};
use crate::summary::{Interval, date_of};
use rayon::prelude::*;
use std::collections::{BTreeMap, HashSet};

/// Probability that anything is named where nothing is shared.
pub(crate) const FALSE_ALARMS: f64 = 0.01;
/// Log evidence without which nothing is named, whatever its probability.
const MIN_EVIDENCE: f64 = 3.0;
/// Least size, in standard deviations of the prior: a fraction of what a careful laboratory overlooks.
pub(crate) const LEAST_SIZE: f64 = 0.05;
/// Information on a parameter, in units of its prior, below which an effect is not tested.
const MIN_INFORMATION: f64 = 1.0;
/// Effects that are named at most, and rounds in which they are fitted beside each other.
const MAX_FOUND: usize = 40;
const SWEEPS: usize = 20;
/// Hypotheses whose sums are made together.
const AT_ONCE: usize = 16;
/// A competing effect or group is within these odds.
const COMPETING: f64 = 4.0;

/// An effect in a pattern.
#[derive(Debug, Clone)]
struct Candidate {
    pattern: usize,
    hypothesis: usize,
    /// For a step its first member, and the log evidence of every start.
    start: usize,
    of_starts: Vec<f64>,
    test: Test,
    log_evidence: f64,
    p: f64,
}

/// A found effect as later steps need it.
#[derive(Debug, Clone)]
pub(crate) struct Found {
    pub result: SharedEffect,
    hypothesis: usize,
    pattern: usize,
    /// Its sessions in order of their numbers, and how much of the effect each has.
    pub members: Vec<(usize, f64)>,
    mean: Vector,
    sd: Vector,
}

impl Found {
    /// By how much the effect moves ln K of one of its sessions, and the variance of that; `None` where the session names it by itself.
    pub fn ln_k_shift(&self, data: &Likelihoods, session: usize, x: f64) -> Option<(f64, f64)> {
        let likelihood = data.sessions.get(session)?.as_ref()?;
        let hypothesis = data.hypotheses.get(self.hypothesis)?;
        if likelihood.named.contains(&hypothesis.effect) {
            return None;
        }
        Some(likelihood.ln_k_shift(hypothesis, &(self.mean * x), &(self.sd * x)))
    }
}

/// Finds what groups share; scores of `data` are left without what was found. Also gives the number of tests.
pub(crate) fn search(data: &mut Likelihoods, places: &Places) -> (Vec<Found>, usize) {
    let patterns = patterns(data, places);
    let mut named_effects: Vec<Found> = Vec::new();
    let mut tests = 0;
    while named_effects.len() < MAX_FOUND {
        let mut candidates: Vec<Candidate> = patterns
            .par_iter()
            .enumerate()
            .flat_map(|(number, pattern)| candidates(data, number, pattern))
            .collect();
        tests = tests.max(candidates.len());
        // A remainder of an effect in the same sessions is no second one: its size shrinks towards the prior.
        candidates.retain(|candidate| {
            named_effects.iter().all(|one| {
                one.pattern != candidate.pattern
                    || data.hypotheses[one.hypothesis].effect != data.hypotheses[candidate.hypothesis].effect
            })
        });
        candidates.sort_by(|a, b| b.log_evidence.total_cmp(&a.log_evidence));
        let accepted = candidates.iter().find_map(|candidate| {
            let held_out = accepted(data, &patterns, candidate, tests)?;
            Some((candidate.clone(), held_out))
        });
        let Some((candidate, held_out)) = accepted else { break };
        let class = class(data, &patterns, &candidates, &candidate);
        let mut members = members(&patterns[candidate.pattern], candidate.start);
        // They come in order of their dates.
        members.sort_unstable_by_key(|(index, _)| *index);
        subtract(data, candidate.hypothesis, &members, &candidate.test.mean);
        named_effects.push(Found {
            result: result(data, &patterns[candidate.pattern], places, &candidate, tests, held_out, class),
            hypothesis: candidate.hypothesis,
            pattern: candidate.pattern,
            mean: candidate.test.mean,
            sd: candidate.test.sd,
            members,
        });
    }
    beside_each_other(data, &mut named_effects);
    (named_effects, tests)
}

fn sum(data: &Likelihoods, hypothesis: &Hypothesis, members: impl Iterator<Item = (usize, f64)>) -> Sum {
    let mut sum = Sum::default();
    for (index, x) in members {
        if let Some(Some(likelihood)) = data.sessions.get(index) {
            sum.add(&likelihood.block(hypothesis), x);
        }
    }
    sum
}

/// Every effect in a pattern, at its best place and start.
fn candidates(data: &Likelihoods, number: usize, pattern: &Pattern) -> Vec<Candidate> {
    let mut of_effects: BTreeMap<&str, Vec<Candidate>> = BTreeMap::new();
    let all_candidates: Vec<Vec<Candidate>> = data
        .hypotheses
        .par_chunks(AT_ONCE)
        .enumerate()
        .map(|(part, hypotheses)| of_hypotheses(data, (number, pattern), (part * AT_ONCE, hypotheses)))
        .collect();
    for candidate in all_candidates.into_iter().flatten() {
        of_effects.entry(&data.hypotheses[candidate.hypothesis].effect).or_default().push(candidate);
    }
    of_effects
        .into_values()
        .filter_map(|of_places| {
            let count = of_places.len() as f64;
            let log_evidence = ln_mean_exp(of_places.iter().map(|one| one.log_evidence));
            let p = of_places.iter().map(|one| one.p).fold(1.0, f64::min) * count;
            let best = of_places.into_iter().max_by(|a, b| a.log_evidence.total_cmp(&b.log_evidence))?;
            Some(Candidate { log_evidence, p: p.min(1.0), ..best })
        })
        .collect()
}

/// Some hypotheses in a pattern, each at its best start. Sessions are gone through once for all of them: a hundred thousand are more than
/// a processor's cache has, and the numbers of one are beside each other.
fn of_hypotheses(
    data: &Likelihoods,
    (number, pattern): (usize, &Pattern),
    (first, hypotheses): (usize, &[Hypothesis]),
) -> Vec<Candidate> {
    let mut sums: Vec<Sum> = vec![Sum::default(); hypotheses.len()];
    let mut tests: Vec<Vec<(usize, Test)>> = vec![Vec::new(); hypotheses.len()];
    let add = |sums: &mut [Sum], session: usize, x: f64| {
        if let Some(Some(likelihood)) = data.sessions.get(session) {
            let hypothesis_sums = sums.iter_mut().zip(hypotheses);
            hypothesis_sums.for_each(|(sum, hypothesis)| sum.add(&likelihood.block(hypothesis), x));
        }
    };
    if pattern.starts.is_empty() {
        pattern.members.iter().for_each(|(session, x)| add(&mut sums, *session, *x));
        let numbered_sums = sums.iter().zip(hypotheses).zip(first..);
        return numbered_sums
            .filter_map(|((sum, hypothesis), index)| whole(number, index, sum, hypothesis))
            .collect();
    }
    // From the last session backwards, so that every start's sum is one more addition.
    for (place, (session, x)) in pattern.members.iter().enumerate().rev() {
        add(&mut sums, *session, *x);
        if pattern.starts.binary_search(&place).is_ok() {
            for ((sum, hypothesis), tests) in sums.iter().zip(hypotheses).zip(&mut tests) {
                if sum.information() >= MIN_INFORMATION {
                    tests.push((place, sum.test(hypothesis)));
                }
            }
        }
    }
    let numbered_tests = tests.iter().zip(first..);
    numbered_tests.filter_map(|(tests, index)| from_a_start(number, index, &pattern.starts, tests)).collect()
}

/// A hypothesis in all sessions of a pattern.
fn whole(pattern: usize, index: usize, sum: &Sum, hypothesis: &Hypothesis) -> Option<Candidate> {
    if sum.sessions < MIN_SESSIONS || sum.information() < MIN_INFORMATION {
        return None;
    }
    let test = sum.test(hypothesis);
    let (log_evidence, p) = (test.log_evidence, test.p);
    Some(Candidate { pattern, hypothesis: index, start: 0, of_starts: Vec::new(), test, log_evidence, p })
}

/// A hypothesis from its best start on; tests are from the last start backwards.
fn from_a_start(
    pattern: usize,
    index: usize,
    starts: &[usize],
    tests: &[(usize, Test)],
) -> Option<Candidate> {
    let (start, test) = tests.iter().max_by(|a, b| a.1.log_evidence.total_cmp(&b.1.log_evidence)).copied()?;
    let of_starts = starts.iter().map(|start| {
        let start_test =
            tests.binary_search_by(|(place, _)| start.cmp(place)).ok().and_then(|of| tests.get(of));
        start_test.map_or(f64::NEG_INFINITY, |(_, test)| test.log_evidence)
    });
    let of_starts: Vec<f64> = of_starts.collect();
    let log_evidence = ln_mean_exp(of_starts.iter().copied());
    let p = (tests.iter().map(|(_, test)| test.p).fold(1.0, f64::min) * tests.len() as f64).min(1.0);
    Some(Candidate { pattern, hypothesis: index, start, of_starts, test, log_evidence, p })
}

/// The held-out check of a candidate that may be named.
fn accepted(
    data: &Likelihoods,
    patterns: &[Pattern],
    candidate: &Candidate,
    tests: usize,
) -> Option<HeldOut> {
    let large = candidate.test.mean.iter().any(|size| size.abs() > LEAST_SIZE);
    if candidate.log_evidence < MIN_EVIDENCE || candidate.p * tests as f64 > FALSE_ALARMS || !large {
        return None;
    }
    let members = members(patterns.get(candidate.pattern)?, candidate.start);
    let hypothesis = data.hypotheses.get(candidate.hypothesis)?;
    let [even, odd] = [0, 1].map(|parity| {
        let half_members = members.iter().enumerate().filter(move |(number, _)| number % 2 == parity);
        sum(data, hypothesis, half_members.map(|(_, member)| *member))
    });
    let gain = odd.gain(&even.test(hypothesis).mean) + even.gain(&odd.test(hypothesis).mean);
    (gain > 0.0).then_some(HeldOut { sessions: members.len(), misfit_change_chi2: -2.0 * gain })
}

/// Effects and groups that explain the same sessions about as well.
fn class(data: &Likelihoods, patterns: &[Pattern], all: &[Candidate], best: &Candidate) -> Vec<Competing> {
    let member_sessions: HashSet<usize> =
        members(&patterns[best.pattern], best.start).into_iter().map(|(index, _)| index).collect();
    let competitors = all.iter().take_while(|other| other.log_evidence > best.log_evidence - COMPETING);
    competitors
        .filter(|other| {
            let theirs = members(&patterns[other.pattern], other.start);
            let shared = theirs.iter().filter(|(index, _)| member_sessions.contains(index)).count();
            (other.pattern, other.hypothesis) != (best.pattern, best.hypothesis)
                && 2 * shared > member_sessions.len().max(theirs.len())
        })
        .map(|other| Competing {
            effect: data.hypotheses[other.hypothesis].effect.clone(),
            label: patterns[other.pattern].label.to_owned(),
            group: patterns[other.pattern].group.clone(),
            kind: patterns[other.pattern].kind,
            log_evidence: other.log_evidence,
        })
        .collect()
}

fn subtract(data: &mut Likelihoods, hypothesis: usize, members: &[(usize, f64)], size: &Vector) {
    let Likelihoods { hypotheses, sessions, .. } = data;
    let Some(hypothesis) = hypotheses.get(hypothesis) else { return };
    for (index, x) in members {
        if let Some(Some(likelihood)) = sessions.get_mut(*index) {
            likelihood.subtract(hypothesis, &(size * *x));
        }
    }
}

/// Fits all found effects beside each other: each again to what the others leave, until they settle.
fn beside_each_other(data: &mut Likelihoods, found: &mut [Found]) {
    for _ in 0..if found.len() > 1 { SWEEPS } else { 0 } {
        let mut moved: f64 = 0.0;
        for one in found.iter_mut() {
            subtract(data, one.hypothesis, &one.members, &-one.mean);
            let Some(hypothesis) = data.hypotheses.get(one.hypothesis) else { continue };
            let test = sum(data, hypothesis, one.members.iter().copied()).test(hypothesis);
            if test.log_evidence.is_finite() {
                moved = moved.max((test.mean - one.mean).amax());
                (one.mean, one.sd) = (test.mean, test.sd);
            }
            subtract(data, one.hypothesis, &one.members, &one.mean);
        }
        if moved < 1e-6 {
            break;
        }
    }
    for one in found.iter_mut() {
        if let Some(hypothesis) = data.hypotheses.get(one.hypothesis) {
            one.result.parameters = parameters(hypothesis, &one.mean, &one.sd);
        }
    }
}

fn parameters(hypothesis: &Hypothesis, mean: &Vector, sd: &Vector) -> Vec<SharedParameter> {
    hypothesis
        .parameters
        .iter()
        .take(MAX_PARAMETERS)
        .enumerate()
        .map(|(number, one)| {
            let [value, low, high] = [0.0, -normal_975(), normal_975()].map(|sds| {
                let value = one.prior_sd * (mean[number] + sds * sd[number]);
                if one.is_log { one.neutral * value.exp() } else { one.neutral + value }
            });
            SharedParameter { name: one.name.clone(), estimate: Interval { value, ci95: [low, high] } }
        })
        .collect()
}

fn result(
    data: &Likelihoods,
    pattern: &Pattern,
    places: &Places,
    candidate: &Candidate,
    tests: usize,
    held_out: HeldOut,
    class: Vec<Competing>,
) -> SharedEffect {
    let hypothesis = &data.hypotheses[candidate.hypothesis];
    let date = |place: usize| {
        let (session, _) = pattern.members.get(place)?;
        date_of(places.day(*session)?)
    };
    let (began, began_ci95) = match pattern.kind {
        SharedKind::Step => (
            date(candidate.start),
            dates95(candidate, pattern).and_then(|[a, b]| Some([date(a.checked_sub(1)?)?, date(b)?])),
        ),
        SharedKind::Trend => (date(0), None),
        SharedKind::Shared => (None, None),
    };
    SharedEffect {
        effect: hypothesis.effect.clone(),
        at: hypothesis.at.clone(),
        label: pattern.label.to_owned(),
        group: pattern.group.clone(),
        kind: pattern.kind,
        sessions: members(pattern, candidate.start).len(),
        parameters: parameters(hypothesis, &candidate.test.mean, &candidate.test.sd),
        log_evidence: candidate.log_evidence,
        p_adjusted: (candidate.p * tests as f64).min(1.0),
        began,
        began_ci95,
        held_out,
        class,
    }
}

/// First and last start of the smallest set with 95 % of the probability. An effect began after the session before the
/// first of them.
fn dates95(candidate: &Candidate, pattern: &Pattern) -> Option<[usize; 2]> {
    let largest = candidate.of_starts.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    let mut weights: Vec<(usize, f64)> = pattern
        .starts
        .iter()
        .copied()
        .zip(candidate.of_starts.iter().map(|log| (log - largest).exp()))
        .collect();
    let total: f64 = weights.iter().map(|(_, weight)| weight).sum();
    weights.sort_by(|a, b| b.1.total_cmp(&a.1));
    let mut sum = 0.0;
    let mut outlying_steps: Vec<usize> = Vec::new();
    for (start, weight) in weights {
        outlying_steps.push(start);
        sum += weight;
        if sum >= 0.95 * total {
            break;
        }
    }
    Some([*outlying_steps.iter().min()?, *outlying_steps.iter().max()?])
}

/// `ln mean exp`.
pub(crate) fn ln_mean_exp(logs: impl Iterator<Item = f64> + Clone) -> f64 {
    let largest = logs.clone().fold(f64::NEG_INFINITY, f64::max);
    if !largest.is_finite() {
        return largest;
    }
    let (sum, count) = logs.fold((0.0, 0.0), |(sum, count), log| (sum + (log - largest).exp(), count + 1.0));
    largest + (sum / count).ln()
}

#[cfg(test)]
#[path = "search_tests.rs"]
mod tests;
