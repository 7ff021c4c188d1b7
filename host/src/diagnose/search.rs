//! The search: score, refit, accept, add, repeat; and which rivals explain the data as well.

use super::believed::{Fitted, Layout, NORMAL_975, Prepared, Scale};
use super::score::{Score, Scores, jacobian, stacked};
use crate::inference::FitError;
use crate::model::effects::Effect;
use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;

/// Share of parametric draws of a session that lacks nothing in which something may be named: well below the one in a hundred that is
/// promised, because sessions have outliers and rounding that the draws do not have.
const FALSE_ALARMS: f64 = 0.001;
/// Parametric draws for the margin.
const DRAWS: usize = 4000;
/// Leaders that are refitted, in the search and among rivals of what was found, and how far behind the best they may be by score.
pub(super) const MOST_LEADERS: usize = 6;
const MOST_RIVALS: usize = 4;
const BEHIND: f64 = 15.0;
const BEHIND_SHARE: f64 = 0.3;
/// No tissue and no sensor follows the law of an effect more closely than this: what it leaves of itself is not to be named.
const LAW: f64 = 0.03;
/// Effects that may be missing at once; more explain anything.
const MOST_EFFECTS: usize = 3;
/// A rival within these odds of the best is as good, and, if its predictions are the same within noise, within the second ones.
const CLASS: f64 = 3.0;
const CLASS_ALIKE: f64 = 6.0;
/// Squared distance of predictions within noise.
const ALIKE: f64 = 6.0;
/// Folds of the cross-validation.
const FOLDS: usize = 5;

/// An effect tried beside a model.
#[derive(Debug, Clone)]
pub(super) struct Candidate {
    pub score: Score,
    /// The fit with it, and its log evidence over the fit without; nothing where it was not refitted.
    pub refit: Option<(Fitted, f64)>,
}

impl Candidate {
    pub fn id(&self) -> &'static str {
        self.score.effect.id()
    }

    fn gain(&self) -> f64 {
        self.refit.as_ref().map_or(f64::NEG_INFINITY, |(_, gain)| *gain)
    }
}

/// One effect of the final model.
#[derive(Debug, Clone)]
pub(super) struct Member {
    pub effect: &'static dyn Effect,
    /// Log evidence over the model without it.
    pub gain: f64,
    /// Fits with a rival in its place; itself first.
    pub class: Vec<(&'static dyn Effect, Fitted)>,
}

/// What the search found.
#[derive(Debug)]
pub(super) struct Found {
    pub fitted: Fitted,
    pub members: Vec<Member>,
    /// All effects beside the starting model.
    pub first: Vec<Candidate>,
    pub margin: f64,
}

/// Tries all effects beside a fit, best first.
pub(super) fn weigh(base: &Fitted, runs: &[Prepared], scores: &Scores, most: usize) -> Vec<Candidate> {
    let ranked = scores.ranked();
    let best = ranked.first().map_or(0.0, |score| score.log_evidence);
    let mut candidates: Vec<Candidate> = ranked
        .into_par_iter()
        .enumerate()
        .map(|(rank, score)| {
            let behind = BEHIND.max(BEHIND_SHARE * best);
            let leads = rank < most && score.log_evidence > (best - behind).max(-2.0);
            let refit = if leads { refit(base, runs, &score) } else { None };
            Candidate { score, refit }
        })
        .collect();
    candidates.sort_by(|a, b| b.gain().total_cmp(&a.gain()));
    candidates
}

fn refit(base: &Fitted, runs: &[Prepared], score: &Score) -> Option<(Fitted, f64)> {
    let layout = base.layout.with(score.effect);
    let from = |values: &Vec<f64>| {
        let mut starts = base.values().to_vec();
        let infos = score.effect.parameters().iter().zip(values);
        starts.extend(infos.map(|(info, value)| Scale::of(info).inside(*value)));
        Fitted::new(&layout, runs, &starts).ok()
    };
    let fits = score.starts.iter().filter_map(from);
    let fitted = fits.max_by(|a, b| a.log_evidence.total_cmp(&b.log_evidence))?;
    let gain = fitted.log_evidence - base.log_evidence + one_sided(score.effect);
    Some((fitted, gain))
}

/// A parameter that cannot be on one side of its neutral value has all of its prior on the other.
pub(super) fn one_sided(effect: &dyn Effect) -> f64 {
    let sides = effect.parameters().iter().filter(|info| info.nodes.is_empty() && !info.is_two_sided());
    sides.count() as f64 * std::f64::consts::LN_2
}

/// Adds what is missing to a fit, one effect after the other.
///
/// # Errors
/// Where the model cannot be evaluated.
pub(super) fn search(
    start: &Fitted,
    runs: &[Prepared],
    seed: u64,
    mut tell: impl FnMut(&str),
) -> Result<Found, FitError> {
    let given = start.layout.effects.len();
    let mut current = start.clone();
    let mut first = Vec::new();
    let mut margin = 0.0;
    while current.layout.effects.len() < given + MOST_EFFECTS {
        let scores = Scores::new(&current, runs)?;
        // With every step the search looks again; the margin is that of its own directions.
        let explained = (current.log_evidence - start.log_evidence).max(0.0);
        let needed = scores.margin(FALSE_ALARMS, DRAWS, seed).max(0.0) + LAW * LAW * explained;
        let candidates = weigh(&current, runs, &scores, MOST_LEADERS);
        let chosen = candidates.iter().find(|candidate| is_accepted(candidate, &current, runs, needed));
        let chosen = chosen
            .and_then(|candidate| candidate.refit.clone().map(|(fit, gain)| (candidate.id(), fit, gain)));
        if first.is_empty() {
            (first, margin) = (candidates, needed);
        }
        let Some((id, fitted, gain)) = chosen else { break };
        tell(&format!("{id} is missing: log evidence + {gain:.1}, needed {needed:.1}"));
        current = without_needless(fitted, given, runs, needed);
    }
    let mut found = Found { fitted: current, members: Vec::new(), first, margin };
    // A better effect in the place of one that was taken early shows only once the others are there.
    for _ in 0..2 {
        found.members = members(&found, start, given, runs)?;
        let better = found.members.iter().enumerate().find_map(|(index, member)| {
            let (best, fitted) = member.class.first()?;
            (best.id() != found.fitted.layout.effects[given + index].id()).then(|| fitted.clone())
        });
        match better {
            Some(fitted) => found.fitted = fitted,
            None => break,
        }
    }
    Ok(found)
}

/// Whether an effect may be added: its evidence, its interval, its range, cross-validation.
fn is_accepted(candidate: &Candidate, current: &Fitted, runs: &[Prepared], margin: f64) -> bool {
    let Some((fitted, gain)) = &candidate.refit else { return false };
    if *gain <= margin {
        return false;
    }
    let index = fitted.layout.effects.len() - 1;
    let first = fitted.layout.first_of(index);
    let infos = candidate.score.effect.parameters();
    let excludes_neutral = infos.iter().enumerate().any(|(number, info)| {
        let (value, sd) =
            (fitted.values()[first + number], fitted.fit.covariance[(first + number, first + number)].sqrt());
        info.nodes.is_empty() && (value - Scale::of(info).inside(info.neutral)).abs() > NORMAL_975 * sd
    });
    let at_bound = (first..first + infos.len()).any(|i| fitted.fit.at_bound[i]);
    excludes_neutral && !at_bound && cross_validates(fitted, current, runs)
}

/// Whether what is left out is predicted better with the effect: linearised about both fits, holds and sweeps left out in folds.
fn cross_validates(with: &Fitted, without: &Fitted, runs: &[Prepared]) -> bool {
    match (left_out_squares(with, runs), left_out_squares(without, runs)) {
        (Some(with), Some(without)) => with < without,
        _ => false,
    }
}

fn left_out_squares(fitted: &Fitted, runs: &[Prepared]) -> Option<f64> {
    let mut jacobian = jacobian(fitted, runs).ok()?;
    let residuals = stacked(&fitted.fit.residuals);
    let priors = fitted.layout.parameters(fitted.values());
    // Places and times stay where they are: far from linear, they would be thrown about by what is left out.
    let infos = fitted.layout.effects.iter().flat_map(|effect| effect.parameters());
    for (index, _) in infos.enumerate().filter(|(_, info)| !info.nodes.is_empty()) {
        jacobian.column_mut(fitted.layout.own() + index).fill(0.0);
    }
    let mut normal = jacobian.transpose() * &jacobian;
    for (i, parameter) in priors.iter().enumerate() {
        normal[(i, i)] += parameter.prior.map_or(0.0, |prior| prior.sd.powi(-2));
    }
    let folds: Vec<usize> = runs
        .iter()
        .enumerate()
        .flat_map(|(number, run)| run.run.data.iter().map(move |datum| (7 * number + datum.part) % FOLDS))
        .collect();
    let mut squares = 0.0;
    for fold in 0..FOLDS {
        let rows: Vec<usize> = (0..folds.len()).filter(|row| folds[*row] == fold).collect();
        let of_fold = DMatrix::from_fn(rows.len(), jacobian.ncols(), |i, j| jacobian[(rows[i], j)]);
        let left = DVector::from_fn(rows.len(), |i, _| residuals[rows[i]]);
        let rest = (&normal - of_fold.transpose() * &of_fold).cholesky()?;
        let step = rest.solve(&(of_fold.transpose() * &left));
        squares += (left + of_fold * step).norm_squared();
    }
    Some(squares)
}

/// Leaves out what is no longer needed once something better is there.
fn without_needless(fitted: Fitted, given: usize, runs: &[Prepared], margin: f64) -> Fitted {
    let count = fitted.layout.effects.len();
    for index in given..count.saturating_sub(1) {
        if let Some(less) = refitted_without(&fitted, index, runs) {
            let gain = fitted.log_evidence - less.log_evidence + one_sided(fitted.layout.effects[index]);
            if gain < margin {
                return less;
            }
        }
    }
    fitted
}

fn refitted_without(fitted: &Fitted, index: usize, runs: &[Prepared]) -> Option<Fitted> {
    let layout: Layout = fitted.layout.without(index);
    let first = fitted.layout.first_of(index);
    let count = fitted.layout.effects[index].parameters().len();
    let mut starts = fitted.values().to_vec();
    starts.drain(first..first + count);
    Fitted::new(&layout, runs, &starts).ok()
}

/// For every effect that was added, its evidence and its class.
fn members(found: &Found, start: &Fitted, given: usize, runs: &[Prepared]) -> Result<Vec<Member>, FitError> {
    let final_fit = &found.fitted;
    let count = final_fit.layout.effects.len();
    let mut members = Vec::new();
    for index in given..count {
        let effect = final_fit.layout.effects[index];
        let (base, candidates) = if count == given + 1 {
            (start.clone(), found.first.clone())
        } else {
            let Some(base) = refitted_without(final_fit, index, runs) else { continue };
            let scores = Scores::new(&base, runs)?;
            let candidates = weigh(&base, runs, &scores, MOST_RIVALS + 1);
            (base, candidates)
        };
        let own = final_fit.log_evidence - base.log_evidence + one_sided(effect);
        let mut class = vec![(effect, final_fit.clone(), own)];
        for candidate in &candidates {
            let Some((fitted, gain)) = &candidate.refit else { continue };
            // What this session cannot tell is as good as any other; it is no rival.
            let is_rival = candidate.score.is_told && *gain > 0.5 * found.margin;
            if candidate.id() == effect.id() || !is_rival || fitted.fit.at_bound.iter().any(|at| *at) {
                continue;
            }
            let apart = (stacked(&fitted.fit.residuals) - stacked(&final_fit.fit.residuals)).norm_squared();
            let behind = own - gain;
            if behind < CLASS || (behind < CLASS_ALIKE && apart < ALIKE) {
                class.push((candidate.score.effect, fitted.clone(), *gain));
            }
        }
        class.sort_by(|a, b| b.2.total_cmp(&a.2));
        // A rival counts as better only where it is clearly so.
        if class[0].0.id() != effect.id() && class[0].2 - own < 0.5 {
            let at = class.iter().position(|(rival, ..)| rival.id() == effect.id()).unwrap_or(0);
            class.swap(0, at);
        }
        let class = class.into_iter().map(|(effect, fitted, _)| (effect, fitted)).collect();
        members.push(Member { effect, gain: own, class });
    }
    Ok(members)
}
