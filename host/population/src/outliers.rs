//! Sessions and groups that are far from what all others predict of them (theory, eq. 72).
//!
//! The distance from the prediction follows Student's t with the degrees of freedom of its level, the unit itself left out of the variance.
//! The farthest one is taken out and the variances are estimated again, also where it is not far by itself: two that are far off hide each
//! other (Rosner 1983). Those up to the last that is far are listed. They keep the weight that Student's t of four degrees of freedom
//! gives them, and do not count in the spread of their level.
//!
//! One that is just far may be so by chance. The odds of that are at least `-e p ln p`, whatever else it may be (Sellke, Bayarri and
//! Berger 2001): in so many of the draws it is one like the others.

use crate::components::{freedom, moments};
use crate::nested::Nested;
use crate::predictive::{Predicted, predicted};
use crate::tree::{Excess, Tree};
use statrs::distribution::{ContinuousCDF, Normal, StudentsT};
use std::cmp::Ordering;

/// Probability, over all units of all levels, below which one is listed.
const FAR: f64 = 0.05;
/// Degrees of freedom of the weights.
const FREEDOM: f64 = 4.0;
/// Degrees of freedom from which a variance is worth a comparison.
const MIN_FREEDOM: usize = 3;
/// One of so many units is taken out without being far by itself, and so many at most.
const SHARE: usize = 10;
const MAX_HIDDEN: usize = 10;
/// Units beyond which one that is far stands out of the variance that it makes: then no more than this many are taken out so.
const MANY: usize = 200;
const HIDDEN_OF_MANY: usize = 2;
/// Share of the draws below which none is drawn.
const LEAST_SHARE: f64 = 1e-3;
/// Steps of the search.
const STEPS: usize = 60;
/// One of so many units of a parent is taken out at once.
const AT_ONCE: usize = 100;
/// Variance, as a multiple of a unit's, that leaves it without weight.
const WITHOUT_WEIGHT: f64 = 1e9;

/// A unit beside what all others predict of it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Judged {
    /// Distance in standard deviations of the prediction.
    pub residual: f64,
    /// Its degrees of freedom; infinite where the variance is that of stated errors.
    pub freedom: f64,
    /// Probability of a larger distance in at least one of the units of any level.
    pub p_adjusted: f64,
    /// Weight beside one that is not far: 1, or less where it is listed.
    pub weight: f64,
    /// Mean and standard deviation of a session: its true value, from its own and from what the others predict, less
    /// its own; and the standard deviation.
    pub shrunk: (f64, f64),
}

/// Weights without the outliers.
#[derive(Debug, Clone)]
pub(crate) struct Weighed {
    /// Without it, for what is typical.
    pub without: Tree,
    /// With the weight that it keeps.
    pub tree: Tree,
    /// Every unit of every stage, in the order of the tree; `None` where nothing predicts it.
    pub judged: Vec<Vec<Option<Judged>>>,
    /// Shares of probability, and the tree: first all that are listed have less weight, then those that may be listed by chance have
    /// their full one, the likeliest of them first.
    pub readings: Vec<(f64, Tree)>,
}

impl Weighed {
    /// Lists what is far, stage by stage.
    pub fn of(mut tree: Tree) -> Self {
        (0..tree.stages()).for_each(|stage| search(&mut tree, stage));
        let without = tree.clone();
        let judged = all_finished(&mut tree);
        let readings = readings(&tree, &judged);
        Self { without, tree, judged, readings }
    }
}

/// Judgements of all stages, with the weights of what was taken out.
fn all_finished(tree: &mut Tree) -> Vec<Vec<Option<Judged>>> {
    let (excesses, of_stages) = judged(tree);
    let levels = levels_compared(&freedom(tree));
    let of_stages = of_stages.into_iter().enumerate();
    of_stages.map(|(stage, units)| finished(tree, excesses[0], stage, (levels, units))).collect()
}

/// The tree with fewer and fewer of those that are listed, and the share of every one.
fn readings(tree: &Tree, judged: &[Vec<Option<Judged>>]) -> Vec<(f64, Tree)> {
    let mut listed: Vec<(f64, usize, usize)> = Vec::new();
    for (stage, units) in judged.iter().enumerate() {
        let out = units.iter().enumerate().filter(|(unit, _)| !tree.counts(stage, *unit));
        listed.extend(out.filter_map(|(unit, one)| Some(((*one)?.p_adjusted, stage, unit))));
    }
    listed.sort_by(|a, b| b.0.total_cmp(&a.0));
    let (mut odds, mut next) = (1.0, tree.clone());
    let mut readings = vec![(odds, tree.clone())];
    for (p, stage, unit) in listed {
        odds *= odds_of_chance(p);
        if odds < LEAST_SHARE {
            break;
        }
        next.widened[stage][unit] = 0.0;
        readings.push((odds, next.clone()));
    }
    let total: f64 = readings.iter().map(|(odds, _)| odds).sum();
    readings.iter_mut().for_each(|(odds, _)| *odds /= total);
    readings
}

/// Odds of chance for one that is far with this probability: the least over all that it may be otherwise.
fn odds_of_chance(p: f64) -> f64 {
    if p > 0.0 && p < (-1.0f64).exp() { -std::f64::consts::E * p * p.ln() } else { f64::from(p > 0.0) }
}

/// The units of a stage, each beside its prediction; `None` where nothing predicts it.
type Units = Vec<Option<(Predicted, Judged)>>;

/// A unit by how far it is.
#[derive(Debug, Clone, Copy)]
struct Far {
    p_adjusted: f64,
    residual: f64,
    unit: usize,
}

impl Far {
    /// The farthest first.
    fn order(&self, other: &Self) -> Ordering {
        self.p_adjusted.total_cmp(&other.p_adjusted).then(other.residual.total_cmp(&self.residual))
    }
}

/// Takes out the units of a stage that are far: they are left without weight.
fn search(tree: &mut Tree, stage: usize) {
    let count = tree.units(stage);
    let hidden = if count > MANY { HIDDEN_OF_MANY } else { (count / SHARE).clamp(1, MAX_HIDDEN) };
    let (mut removed, mut outlier_count, mut guesses) = (Vec::new(), 0, 0);
    for _ in 0..STEPS {
        let (_, mut of_stages) = judged(tree);
        let units = of_stages.swap_remove(stage);
        let mut next: Vec<Far> = Vec::new();
        let mut farthest: Option<Far> = None;
        for units_of_parent in tree.parents(stage) {
            let at_once = (units_of_parent.len() / AT_ONCE).max(1);
            // One that is alone in its group is compared with the group, at the next stage.
            let is_compared = units_of_parent.len() > 1;
            let compared = units_of_parent.filter(|unit| is_compared && tree.counts(stage, *unit));
            let mut of_parent: Vec<Far> = compared
                .filter_map(|unit| {
                    let judged = &units[unit].as_ref()?.1;
                    Some(Far { p_adjusted: judged.p_adjusted, residual: judged.residual.abs(), unit })
                })
                .collect();
            of_parent.sort_by(|a, b| a.order(b));
            farthest = farthest.into_iter().chain(of_parent.first().copied()).min_by(|a, b| a.order(b));
            next.extend(of_parent.into_iter().take(at_once).filter(|one| one.p_adjusted < FAR));
        }
        let is_far = !next.is_empty();
        guesses += usize::from(!is_far);
        if guesses > hidden {
            break;
        }
        let Some(farthest) = farthest else { break };
        if !is_far {
            next.push(farthest);
        }
        for Far { unit, .. } in next {
            let Some((outlier, _)) = units[unit] else { continue };
            tree.widened[stage][unit] = WITHOUT_WEIGHT * (outlier.own + outlier.variance);
            removed.push(unit);
        }
        if is_far {
            outlier_count = removed.len();
        }
    }
    for unit in removed.into_iter().skip(outlier_count) {
        tree.widened[stage][unit] = 0.0;
    }
}

/// Every unit beside its prediction, variances by moments of what counts.
fn judged(tree: &Tree) -> (Vec<Excess>, Vec<Units>) {
    let (excesses, of_stages) = (moments(tree), freedom(tree));
    let tau: Vec<f64> = tree.outwards().map(|stage| excesses[stage].variance.sqrt()).collect();
    let Some(fit) = Nested::at(tree, &tau) else {
        let no_predictions = (0..tree.stages()).map(|stage| vec![None; tree.units(stage)]).collect();
        return (excesses, no_predictions);
    };
    let predictions = predicted(tree, &excesses, &fit.beta);
    let levels = levels_compared(&of_stages);
    let judged_stages = predictions.into_iter().enumerate().map(|(stage, units)| {
        // Variance of the level that the units belong to: stated errors alone have none.
        let estimated = (excesses[stage].variance > 0.0).then_some(of_stages[stage]);
        let outer = (stage + 1..tree.stages()).filter(|outer| excesses[*outer].variance > 0.0);
        let outer = outer.map(|outer| of_stages[outer]).min();
        let is_comparable = estimated.is_none_or(|freedom| freedom >= MIN_FREEDOM);
        let count = levels * units.len();
        let judged_units = units.into_iter().enumerate().map(|(unit, one)| {
            let one = one?;
            // Those of its group scatter as it does: their variance is the same estimate, not a second one.
            let alike = one.own + one.variance - one.from_outer;
            let freedom = combined(&[(alike, estimated), (one.from_outer, outer)]);
            let standardised = one.standardised();
            let (residual, freedom) = match tree.counts(stage, unit) {
                true if freedom.is_finite() => without_itself(standardised, freedom),
                _ => (standardised, freedom),
            };
            let p_adjusted = if is_comparable { adjusted(residual, freedom, count) } else { 1.0 };
            Some((one, Judged { residual, freedom, p_adjusted, weight: 1.0, shrunk: (f64::NAN, f64::NAN) }))
        });
        judged_units.collect()
    });
    let judged_stages = judged_stages.collect();
    (excesses, judged_stages)
}

/// Levels whose units are compared with each other: one at least, as long as any are.
fn levels_compared(freedom: &[usize]) -> usize {
    freedom.iter().filter(|freedom| **freedom > 0).count().max(1)
}

/// Probability of a larger residual in at least one of so many units.
fn adjusted(residual: f64, freedom: f64, units: usize) -> f64 {
    // No t has a smaller tail than the normal distribution, which takes no time.
    let least = (2.0 * Normal::standard().sf(residual.abs()) * units as f64).min(1.0);
    match StudentsT::new(0.0, 1.0, freedom) {
        Ok(t) if freedom.is_finite() && least < 1.0 => (2.0 * t.sf(residual.abs()) * units as f64).min(1.0),
        _ => least,
    }
}

/// Degrees of freedom of a sum of variances (Satterthwaite 1946); those without are known.
fn combined(parts: &[(f64, Option<usize>)]) -> f64 {
    let total: f64 = parts.iter().map(|(variance, _)| variance).sum();
    total * total
        / parts
            .iter()
            .filter_map(|(variance, freedom)| freedom.map(|freedom| variance * variance / freedom as f64))
            .sum::<f64>()
}

/// A residual that is standardised with a variance to which it has contributed, and the one without it, with a degree of freedom less
/// (Cook and Weisberg 1982).
fn without_itself(standardised: f64, freedom: f64) -> (f64, f64) {
    let remaining_freedom = freedom - 1.0;
    if remaining_freedom <= 0.0 {
        return (standardised, 1.0);
    }
    let remaining_squares = freedom - standardised * standardised;
    let residual = if remaining_squares > 0.0 {
        standardised * (remaining_freedom / remaining_squares).sqrt()
    } else {
        f64::INFINITY.copysign(standardised)
    };
    (residual, remaining_freedom)
}

/// Judgements of a stage, with the weights of what was taken out.
fn finished(
    tree: &mut Tree,
    of_sessions: Excess,
    stage: usize,
    (levels, units): (usize, Units),
) -> Vec<Option<Judged>> {
    let count = levels * units.len();
    let judged_units = units.into_iter().enumerate().map(|(unit, one)| {
        let (mut judged_unit, mut judged) = one?;
        let widened = &mut tree.widened[stage][unit];
        if *widened > 0.0 {
            judged_unit.own -= *widened;
            judged.residual = judged_unit.standardised();
            judged.p_adjusted = adjusted(judged.residual, judged.freedom, count);
            judged.weight = (FREEDOM + 1.0) / (FREEDOM + judged.residual.powi(2));
            // One that is nearer than its weight is for keeps a variance that marks it.
            judged.weight = judged.weight.min(1.0 - f64::EPSILON);
            *widened = (judged.weight.recip() - 1.0) * (judged_unit.own + judged_unit.variance);
        }
        if stage == 0 {
            let variance_without = judged_unit.variance + of_sessions.variance + *widened;
            let weight_ratio = variance_without / (variance_without + tree.v[unit]);
            judged.shrunk = (
                (weight_ratio - 1.0) * (judged_unit.value - judged_unit.mean),
                (weight_ratio * tree.v[unit]).sqrt(),
            );
        }
        Some(judged)
    });
    judged_units.collect()
}
