//! The distribution of a quantity between sessions once each session's own error is taken out (theory, eq. 70 to 72).
//!
//! Variances by restricted likelihood; their intervals, that of the mean and that of a new subject from the draws of `components`, so that
//! the degrees of freedom are those of the level that counts. Sessions and groups that are far from the others have less weight.

use crate::components::{
    Draw, determined, draws, freedom, moments, profile, quantile, quantile_of_normals, sensitivity,
};
use crate::nested::{Nested, Observations};
use crate::normal_975;
use crate::outliers::{Judged, Weighed};
use crate::tree::{Excess, Tree};
use nalgebra::{DMatrix, DVector};
use statrs::distribution::{ChiSquared, ContinuousCDF, StudentsT};

/// Degrees of freedom of the outermost level from which a new subject is predicted.
const MIN_FREEDOM: usize = 2;
/// Probability of so little scatter, below which stated errors are taken to be common to the sessions of a rig.
const TOO_NEAR: f64 = 0.025;

/// A value with its standard error and its 95 % interval.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Estimate {
    /// The value.
    pub value: f64,
    /// Its standard error.
    pub se: f64,
    /// Its interval.
    pub ci95: [f64; 2],
}

/// The spread of one level.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Spread {
    /// Its groups; of the last level sessions.
    pub groups: usize,
    /// Standard deviation by restricted likelihood; `None` where the level cannot be told from the one within it.
    pub tau: Option<f64>,
    /// Its 95 % interval.
    pub ci95: Option<[f64; 2]>,
    /// Degrees of freedom.
    pub degrees_of_freedom: usize,
    /// Intraclass correlation of two sessions of a group of this level as measured, and its 95 % interval; not of sessions.
    pub icc: Option<(f64, [f64; 2])>,
}

/// The result for one group of sessions.
#[derive(Debug, Clone, PartialEq)]
pub struct RandomEffects {
    /// Number of sessions.
    pub sessions: usize,
    /// Parameters of the mean: the constant, then covariates.
    pub beta: Vec<Estimate>,
    /// The mean at the mean of the covariates.
    pub mean: Estimate,
    /// Its degrees of freedom (Satterthwaite 1946); infinite where it has no error but stated ones.
    pub degrees_of_freedom: f64,
    /// Every level from the outermost; last the sessions.
    pub levels: Vec<Spread>,
    /// Standard deviation between sessions of all levels together.
    pub tau_total: f64,
    /// Its 95 % interval; nothing where nothing is determined.
    pub tau_ci95: Option<[f64; 2]>,
    /// By Paule and Mandel.
    pub tau_paule_mandel: f64,
    /// Prediction interval of the true value of a new group of the innermost level (a new session where there is none).
    pub new_subject95: Option<[f64; 2]>,
    /// Prediction interval of the true value of a session of such a group, and the degrees of freedom of it.
    pub new_session95: Option<([f64; 2], f64)>,
    /// Cochran's Q, its degrees of freedom and p.
    pub q: (f64, usize, f64),
    /// Share of the variance that is between sessions, percent.
    pub i_squared_percent: f64,
    /// Typical variance of a session's own error (Higgins and Thompson 2002).
    pub typical_variance: f64,
    /// Standard deviation of what stated errors have in common, where sessions scatter less than these; it is part of the mean's error.
    pub common_sd: Option<f64>,
    /// Draws of the mean at the mean of the covariates.
    pub mean_draws: Vec<f64>,
    /// Draws of the standard deviation of every level, in the order of `levels`; those of a level that is not determined are 0.
    pub tau_draws: Vec<Vec<f64>>,
    /// Every session beside what the others predict of it; `None` where nothing does.
    pub(crate) judged: Vec<Option<Judged>>,
    /// Groups that are far from the others of their level: stage, sessions, and how far.
    pub(crate) far: Vec<(usize, Vec<usize>, Judged)>,
}

/// Analyses one group; `None` where the mean is not determined.
pub fn random_effects(data: &Observations) -> Option<RandomEffects> {
    let weighed = Weighed::of(Tree::new(data));
    let freedom = freedom(&weighed.without);
    let tau = Nested::fit_tree(&weighed.without, &freedom)?.tau;
    let fit = Nested::at(&weighed.tree, &tau)?;
    let stated = Nested::at(&weighed.tree, &vec![0.0; tau.len()])?;
    let tau_draws = draws(&weighed.readings);
    let common = common_variance(&weighed.tree, &freedom) / data.rigs();
    let outer: Vec<usize> = (1..weighed.tree.stages()).collect();
    let is_flat = outer.is_empty();
    let center = data.mean_row();
    let estimate = |row: &DVector<f64>| {
        let value = row.dot(&fit.beta);
        let components: Vec<(f64, f64)> = tau_draws.iter().map(|draw| at(draw, row)).collect();
        let constant = row.iter().next().copied().unwrap_or(0.0).powi(2);
        let ends = quantile_of_normals(&components, constant * common);
        // Values that agree by chance are not known better than their errors state.
        let stated = normal_975() * row.dot(&(&stated.covariance * row)).sqrt();
        let (low, high) = (ends[0].min(value - stated), ends[1].max(value + stated));
        let degrees_of_freedom = satterthwaite(&components);
        (
            Estimate { value, se: 0.5 * (high - low) / t_975(degrees_of_freedom), ci95: [low, high] },
            degrees_of_freedom,
        )
    };
    let (mean, degrees_of_freedom) = estimate(&center);
    let new = |stages: &[usize]| {
        let least = stages.iter().filter(|stage| freedom[**stage] > 0).map(|stage| freedom[*stage]).min()?;
        (least >= MIN_FREEDOM).then(|| {
            let components: Vec<(f64, f64)> = tau_draws
                .iter()
                .map(|draw| {
                    let (mean, variance) = at(draw, &center);
                    (mean, variance + sum(draw, stages))
                })
                .collect();
            (quantile_of_normals(&components, common), satterthwaite(&components))
        })
    };
    let units = DMatrix::identity(fit.beta.len(), fit.beta.len());
    let beta = units.column_iter().map(|unit| estimate(&unit.into_owned()).0).collect();
    let every: Vec<usize> = (0..weighed.tree.stages()).collect();
    let typical_variance = typical(data);
    let is_certain = weighed.readings.len() == 1;
    let tree = &weighed.without;
    let spread = Spreads { tree, freedom: &freedom, draws: &tau_draws, typical_variance, is_certain };
    let (tau_total, tau_ci95) = spread.total(&tau);
    let levels = spread.levels(&tau);
    let flat = Tree::new(&Observations { levels: Vec::new(), ..data.clone() });
    let q = flat.squares(0, Excess::NONE, &[], &mut Vec::new());
    let q_freedom = data.len().saturating_sub(data.parameters());
    let total_variance = tau_total * tau_total;
    let mut judged = vec![None; data.len()];
    for (place, one) in weighed.judged.first().into_iter().flatten().enumerate() {
        judged[weighed.tree.order[place]] = *one;
    }
    let outliers = far(&weighed);
    for (_, sessions, group) in &outliers {
        for session in sessions {
            if let Some(judged_session) = &mut judged[*session] {
                judged_session.weight *= group.weight;
            }
        }
    }
    Some(RandomEffects {
        sessions: data.len(),
        beta,
        mean,
        degrees_of_freedom,
        levels,
        tau_total,
        tau_ci95,
        tau_paule_mandel: moments(&flat).first().map_or(0.0, |excess| excess.variance.sqrt()),
        new_subject95: new(if is_flat { &every } else { &outer }).map(|(ends, _)| ends),
        new_session95: new(&every),
        q: (q, q_freedom, ChiSquared::new(q_freedom as f64).map_or(1.0, |chi| chi.sf(q))),
        i_squared_percent: 100.0 * total_variance / (total_variance + typical_variance),
        typical_variance,
        common_sd: (common > 0.0).then(|| common.sqrt()),
        mean_draws: tau_draws.iter().map(|draw| drawn_mean(draw, &center, common)).collect(),
        tau_draws: spread.draws(),
        judged,
        far: outliers,
    })
}

impl RandomEffects {
    /// Sessions that are far from what the others predict, and have less weight.
    pub fn listed(&self) -> usize {
        self.judged.iter().flatten().filter(|judged| judged.weight < 1.0).count()
    }
}

/// Mean at a row and its variance in a draw.
fn at(draw: &Draw, row: &DVector<f64>) -> (f64, f64) {
    (row.dot(&draw.beta), row.dot(&(&draw.covariance * row)))
}

/// A draw of the mean.
fn drawn_mean(draw: &Draw, row: &DVector<f64>, common: f64) -> f64 {
    let (mean, variance) = at(draw, row);
    mean + draw.normal * (variance + common).sqrt()
}

/// Variance between units of some stages together; 0 where they differ by less than their errors.
fn sum(draw: &Draw, stages: &[usize]) -> f64 {
    stages.iter().map(|stage| draw.signed[*stage]).sum::<f64>().max(0.0)
}

/// Degrees of freedom of a variance from its draws: their inverses are chi-square.
fn satterthwaite(parts: &[(f64, f64)]) -> f64 {
    let n = parts.len() as f64;
    let mean = parts.iter().map(|(_, variance)| variance.recip()).sum::<f64>() / n;
    let squares = parts.iter().map(|(_, variance)| (variance.recip() - mean).powi(2)).sum::<f64>() / n;
    2.0 * mean * mean / squares
}

fn t_975(freedom: f64) -> f64 {
    let t = StudentsT::new(0.0, 1.0, freedom).ok().filter(|_| freedom < 1e6);
    t.map_or_else(normal_975, |t| t.inverse_cdf(0.975))
}

/// Variance that stated errors have in common: what they state beyond how much the sessions scatter, where that is too little for chance.
fn common_variance(tree: &Tree, freedom: &[usize]) -> f64 {
    let Some((q, freedom, own_variance)) = determined(tree, freedom) else { return 0.0 };
    let is_too_little = ChiSquared::new(freedom as f64).is_ok_and(|chi| chi.cdf(q) < TOO_NEAR);
    if is_too_little { own_variance * (1.0 - q / freedom as f64) } else { 0.0 }
}

/// Groups that are far from the others, with their stages and sessions.
fn far(weighed: &Weighed) -> Vec<(usize, Vec<usize>, Judged)> {
    let mut outliers = Vec::new();
    for (stage, units) in weighed.judged.iter().enumerate().skip(1) {
        for (unit, judged) in units.iter().enumerate() {
            if let Some(judged) = judged.filter(|judged| judged.weight < 1.0) {
                let sessions = weighed.tree.order[weighed.tree.sessions(stage, unit)].to_vec();
                outliers.push((stage, sessions, judged));
            }
        }
    }
    outliers
}

/// Inputs of the levels' spreads.
struct Spreads<'a> {
    tree: &'a Tree,
    freedom: &'a [usize],
    draws: &'a [Draw],
    typical_variance: f64,
    /// Whether none that is listed may be so by chance.
    is_certain: bool,
}

impl Spreads<'_> {
    /// Standard deviations at the ends of an interval of variances, which holds the estimate and is never without width.
    fn interval(&self, mut variances: Vec<f64>, tau: f64, least_high: f64) -> [f64; 2] {
        variances.iter_mut().for_each(|variance| *variance = variance.max(0.0));
        variances.sort_by(f64::total_cmp);
        let [low, high] = match variances[..] {
            [low, high] => [low, high],
            _ => [0.025, 0.975].map(|share| quantile(&variances, share)),
        };
        [low.sqrt().min(tau), high.max(least_high).sqrt().max(tau)]
    }

    /// Likelihood of all levels together.
    fn total(&self, tau: &[f64]) -> (f64, Option<[f64; 2]>) {
        let tau = tau.iter().map(|tau| tau * tau).sum::<f64>().sqrt();
        let stages: Vec<usize> = (0..self.tree.stages()).collect();
        let least = stages.iter().map(|stage| self.sensitivity(*stage)).fold(0.0, f64::max);
        let determined = self.freedom.iter().filter(|freedom| **freedom > 0).count();
        if determined == 0 {
            return (tau, None);
        }
        let variances = match profile(self.tree, self.freedom) {
            Some(ends) if determined == 1 && self.is_certain => ends.to_vec(),
            _ => self.draws.iter().map(|draw| sum(draw, &stages)).collect(),
        };
        (tau, Some(self.interval(variances, tau, least)))
    }

    /// Draws of the standard deviation of every level from the outermost, last the sessions.
    fn draws(&self) -> Vec<Vec<f64>> {
        let mut total_draws: Vec<Vec<f64>> = self
            .tree
            .outwards()
            .map(|stage| self.draws.iter().map(|draw| sum(draw, &[stage]).sqrt()).collect())
            .collect();
        total_draws.rotate_left(1);
        total_draws
    }

    fn sensitivity(&self, stage: usize) -> f64 {
        sensitivity(self.tree, stage, self.freedom[stage])
    }

    /// Every level from the outermost, last the sessions.
    fn levels(&self, tau: &[f64]) -> Vec<Spread> {
        let mut spreads: Vec<Spread> = self
            .tree
            .outwards()
            .zip(tau)
            .map(|(stage, of_stage)| self.level(stage, *of_stage, tau))
            .collect();
        spreads.rotate_left(1);
        spreads
    }

    fn level(&self, stage: usize, tau: f64, all: &[f64]) -> Spread {
        let degrees_of_freedom = self.freedom[stage];
        // A level has no more than all together.
        let ci95 = (degrees_of_freedom > 0).then(|| {
            self.interval(
                self.draws.iter().map(|draw| draw.signed[stage].min(draw.total())).collect(),
                tau,
                self.sensitivity(stage),
            )
        });
        let shared: Vec<usize> = (stage..self.tree.stages()).collect();
        let icc = (stage > 0 && degrees_of_freedom > 0).then(|| {
            let taus: Vec<f64> = all.iter().map(|tau| tau * tau).collect();
            let of_shared: f64 = self
                .tree
                .outwards()
                .zip(&taus)
                .filter(|(outer, _)| *outer >= stage)
                .map(|(_, tau2)| tau2)
                .sum();
            let value = of_shared / (taus.iter().sum::<f64>() + self.typical_variance);
            let mut draws: Vec<f64> = self
                .draws
                .iter()
                .map(|draw| {
                    let total_variance = (draw.total() + self.typical_variance).max(f64::MIN_POSITIVE);
                    (sum(draw, &shared) / total_variance).min(1.0)
                })
                .collect();
            draws.sort_by(f64::total_cmp);
            let [low, high] = [0.025, 0.975].map(|share| quantile(&draws, share));
            (value, [low.min(value), high.max(value)])
        });
        let tau = (degrees_of_freedom > 0).then_some(tau);
        Spread { groups: self.tree.units(stage), tau, ci95, degrees_of_freedom, icc }
    }
}

impl Observations {
    /// Mean of the rows `[1, x]`.
    pub(crate) fn mean_row(&self) -> DVector<f64> {
        let mut sum = DVector::zeros(self.parameters());
        for index in 0..self.len() {
            sum.iter_mut().zip(self.row(index)).for_each(|(sum, x)| *sum += x);
        }
        sum / self.len().max(1) as f64
    }

    /// Number of rigs that would share out an error that is common to the sessions of a rig as these do.
    fn rigs(&self) -> f64 {
        let mut counts: std::collections::BTreeMap<usize, f64> = std::collections::BTreeMap::new();
        self.rig.iter().for_each(|rig| *counts.entry(*rig).or_default() += 1.0);
        let session_count: f64 = counts.values().sum();
        if session_count > 0.0 {
            session_count * session_count / counts.values().map(|count| count * count).sum::<f64>()
        } else {
            1.0
        }
    }
}

/// The typical variance of Higgins and Thompson: `(n - p) / tr(P)` with `P = W - W X (X^T W X)^-1 X^T W`, `W` the precisions.
fn typical(data: &Observations) -> f64 {
    let p = data.parameters();
    let mut normal = DMatrix::zeros(p, p);
    let mut squared = DMatrix::zeros(p, p);
    let mut trace = 0.0;
    for index in 0..data.len() {
        let row = DVector::from_iterator(p, data.row(index).into_iter().take(p));
        let weight = data.v[index].recip();
        normal.ger(weight, &row, &row, 1.0);
        squared.ger(weight * weight, &row, &row, 1.0);
        trace += weight;
    }
    let Some(factor) = normal.cholesky() else { return 0.0 };
    let trace = trace - factor.solve(&squared).trace();
    let freedom = data.len().saturating_sub(p) as f64;
    if trace > 0.0 && freedom > 0.0 { freedom / trace } else { data.v.first().copied().unwrap_or(0.0) }
}

#[cfg(test)]
#[path = "random_effects_tests.rs"]
mod tests;
