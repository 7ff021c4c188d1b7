//! Learning from earlier insertions of the same rig and tissue: empirical Bayes.
//!
//! The unknowns of an insertion are what all insertions share plus its own part. How large the parts are ([`Scales`]) is found by
//! maximising the evidence of the earlier insertions; what is shared, and which candidates of modulus and gap are how likely, is
//! then their posterior, which is the prior of the next insertion. The evidence is that of a linear model with normal unknowns: per
//! insertion its own part is integrated out, then the shared part; no step costs more than the cube of the number of unknowns.

use super::basis::{Basis, Candidates, Layout};
use super::belief::{Normal, rows};
use super::path::TipPath;
use super::scales::{COUNT, Scales};
use argmin::core::{CostFunction, Executor, Gradient, State};
use argmin::solver::linesearch::MoreThuenteLineSearch;
use argmin::solver::quasinewton::LBFGS;
use nalgebra::{Cholesky, DMatrix, Dyn};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

/// What earlier insertions tell about the next.
#[derive(Debug, Clone)]
pub struct Learned {
    /// Possible sizes of the unknowns.
    pub scales: Vec<Scales>,
    /// Possible combinations of candidate and sizes.
    pub(super) parts: Vec<Part>,
}

impl Learned {
    /// How many combinations there are, and how many different candidates are among them: what a prediction costs.
    pub fn counts(&self) -> [usize; 2] {
        let mut candidates: Vec<_> = self.parts.iter().map(|part| part.candidate).collect();
        candidates.sort_unstable();
        candidates.dedup();
        [self.parts.len(), candidates.len()]
    }
}

/// One candidate with one set of sizes, and what then is believed of the next insertion.
#[derive(Debug, Clone)]
pub(super) struct Part {
    /// Number among the candidates.
    pub candidate: usize,
    /// Number among the scales.
    pub scales: usize,
    /// Logarithm of its weight, up to a constant.
    pub ln_weight: f64,
    /// Of the unknowns of an insertion.
    pub normal: Normal,
}

/// Learns from the recordings `earlier` (numbers among `paths`).
///
/// Where there are none, the sizes of the unknowns are looked for near those that suit what is seen of the insertion itself,
/// `only_seen`; nothing else is taken from it. `paths` are those the candidates were made for, each seen as far as it may be.
pub fn learn(
    candidates: &Candidates,
    paths: &[TipPath],
    earlier: &[usize],
    only_seen: usize,
    reading_m: f64,
) -> Learned {
    let alone = earlier.is_empty();
    let training: Vec<usize> = if alone { vec![only_seen] } else { earlier.to_vec() };
    let layout = &candidates.layout;
    let of_candidate = |bases: &Vec<Basis>| {
        training.iter().map(|i| Design::new(&bases[*i], &paths[*i], layout)).collect::<Vec<_>>()
    };
    let designs: Vec<_> = candidates.bases.iter().map(of_candidate).collect();
    let posterior = |scales: &Scales, candidate: usize| {
        candidates.list[candidate].ln_prior + Evidence::new(layout, &designs[candidate], scales).ln
    };
    let all =
        |scales: &Scales| (0..candidates.list.len()).map(|i| posterior(scales, i)).collect::<Vec<f64>>();
    let best = |all: &[f64]| (0..all.len()).max_by(|a, b| all[*a].total_cmp(&all[*b])).unwrap_or_default();

    let mut likeliest = vec![0.0; COUNT];
    let mut weights = all(&Scales::typical(reading_m));
    for _ in 0..2 {
        let candidate = best(&weights);
        let cost = Cost { evidence: &|scales: &Scales| posterior(scales, candidate), reading_m };
        likeliest = search(cost, &likeliest).unwrap_or(likeliest);
        weights = all(&Scales::from_logarithms(&likeliest, reading_m));
        if best(&weights) == candidate {
            break;
        }
    }
    let candidate = best(&weights);
    let cost = Cost { evidence: &|scales: &Scales| posterior(scales, candidate), reading_m };
    let mut learned = Learned { scales: Vec::new(), parts: Vec::new() };
    let shares = cumulative_shares(&weights);
    for (number, (draw, ln_drawn)) in draws(&cost, &likeliest).into_iter().enumerate() {
        let scales = Scales::from_logarithms(&draw, reading_m);
        let ln_prior = -0.5 * draw.iter().map(|x| x * x).sum::<f64>();
        // Candidates in proportion to their weight, evenly among the draws: multiples of the golden ratio.
        let place = (number as f64 * GOLDEN_RATIO).fract();
        let candidate = shares.partition_point(|(end, _)| *end <= place).min(shares.len() - 1);
        let used = if alone { &[][..] } else { &designs[candidate] };
        let Evidence { ln, next } = Evidence::new(layout, used, &scales);
        let ln_weight = candidates.list[candidate].ln_prior + ln_prior + ln - ln_drawn - shares[candidate].1;
        let normal = next.mapped(&scales.map(layout));
        learned.parts.push(Part { candidate, scales: learned.scales.len(), ln_weight, normal });
        learned.scales.push(scales);
    }
    // What a part weighs before the insertion is seen says little where it was drawn to suit what is seen.
    if !alone {
        let most = learned.parts.iter().map(|part| part.ln_weight).fold(f64::NEG_INFINITY, f64::max);
        learned.parts.retain(|part| part.ln_weight > most - LEAST_LN_WEIGHT);
    }
    learned
}

/// Steps of the search for the scales.
const MOST_STEPS: u64 = 40;
/// Parts further behind than this (natural logarithm) before an insertion begins are given up.
const LEAST_LN_WEIGHT: f64 = 6.0;
/// Draws of scales and candidate, in pairs on both sides of the likeliest scales.
const PAIRS: usize = 64;
/// The draws are always the same.
const SEED: u64 = 20;
const GOLDEN_RATIO: f64 = 0.618_033_988_749_894_8;

/// For each candidate, the sum of the shares up to and including it, and the logarithm of its own.
fn cumulative_shares(ln_weights: &[f64]) -> Vec<(f64, f64)> {
    let most = ln_weights.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    let total: f64 = ln_weights.iter().map(|weight| (weight - most).exp()).sum();
    let mut end = 0.0;
    let share = |weight: &f64| {
        let ln = weight - most - total.ln();
        end += ln.exp();
        (end, ln)
    };
    ln_weights.iter().map(share).collect()
}

/// Draws about the likeliest scales from a normal distribution as wide as the posterior along each scale, with the logarithm of its
/// density: points of an integration over the scales by importance sampling.
fn draws(cost: &Cost<'_>, likeliest: &[f64]) -> Vec<(Vec<f64>, f64)> {
    const STEP: f64 = 0.3;
    let at = |i: usize, step: f64| {
        let mut moved = likeliest.to_vec();
        moved[i] += step;
        cost.cost(&moved).unwrap_or(f64::MAX)
    };
    let least = cost.cost(&likeliest.to_vec()).unwrap_or(f64::MAX);
    let sds: Vec<f64> = (0..likeliest.len())
        .map(|i| {
            let bend = (at(i, STEP) - 2.0 * least + at(i, -STEP)) / (STEP * STEP);
            // The prior has unit width; a posterior may not seem wider.
            1.0 / bend.max(1.0).sqrt()
        })
        .collect();
    let mut rng = ChaCha8Rng::seed_from_u64(SEED);
    let mut draws = Vec::with_capacity(2 * PAIRS);
    for _ in 0..PAIRS {
        let z: Vec<f64> = likeliest.iter().map(|_| StandardNormal.sample(&mut rng)).collect();
        let ln = -0.5 * z.iter().map(|z: &f64| z * z).sum::<f64>();
        for sign in [-1.0, 1.0] {
            let draw = likeliest.iter().zip(&sds).zip(&z).map(|((x, sd), z)| x + sign * sd * z);
            draws.push((draw.collect(), ln));
        }
    }
    draws
}

/// One recording's measured values as a linear function of its unknowns, summed up: rows with as many readings have the same
/// variance, and all that is ever asked of them is their sum of squares.
struct Design {
    groups: Vec<Group>,
}

/// Rows with the same number of readings, at rest or not.
struct Group {
    readings: f64,
    moving: bool,
    count: usize,
    /// `B^T B`, `B^T y` and `y^T y` of the rows.
    squares: DMatrix<f64>,
    told: DMatrix<f64>,
    measured: f64,
}

impl Design {
    fn new(basis: &Basis, path: &TipPath, layout: &Layout) -> Self {
        let mut bins: Vec<_> = path.bins.iter().collect();
        bins.sort_by(|a, b| a.rows.total_cmp(&b.rows).then(a.moving.cmp(&b.moving)));
        let groups = bins.chunk_by(|a, b| (a.rows, a.moving) == (b.rows, b.moving)).map(|bins| {
            let all: Vec<_> = bins.iter().flat_map(|bin| rows(basis, bin, layout.planes)).collect();
            let design = DMatrix::from_fn(all.len(), layout.unknowns(), |i, j| all[i].0[j]);
            let measured = DMatrix::from_fn(all.len(), layout.sides(), |i, j| all[i].1[j]);
            Group {
                readings: bins.first().map_or(1.0, |bin| bin.rows),
                moving: bins.first().is_some_and(|bin| bin.moving),
                count: all.len(),
                squares: design.transpose() * &design,
                told: design.transpose() * &measured,
                measured: measured.norm_squared(),
            }
        });
        Self { groups: groups.collect() }
    }
}

/// Log evidence of a set of recordings, and what they say about the next one.
struct Evidence {
    ln: f64,
    /// In standard normal numbers of an insertion's own part.
    next: Normal,
}

impl Evidence {
    fn new(layout: &Layout, designs: &[Design], scales: &Scales) -> Self {
        let (map, ratios) = (scales.map(layout), scales.shared_ratios(layout));
        let (unknowns, sides) = (map.ncols(), layout.sides());
        let mut information = DMatrix::<f64>::zeros(unknowns, unknowns);
        let mut pull = DMatrix::<f64>::zeros(unknowns, sides);
        let mut ln = 0.0;
        let map_t = map.transpose();
        for design in designs {
            let mut squares = DMatrix::<f64>::zeros(layout.unknowns(), layout.unknowns());
            let mut told = DMatrix::<f64>::zeros(layout.unknowns(), sides);
            let mut measured = 0.0;
            for group in &design.groups {
                let variance = scales.variance_m2(group.readings, group.moving);
                squares.zip_apply(&group.squares, |sum, square| *sum += square / variance);
                told.zip_apply(&group.told, |sum, told| *sum += told / variance);
                measured += group.measured / variance;
                ln -= 0.5 * (sides * group.count) as f64 * variance.ln();
            }
            // In standard normal numbers: the own part has unit variance.
            let told = &map_t * told;
            let squares = &map_t * squares * &map;
            let Some(total) = Cholesky::new(squares + DMatrix::identity(unknowns, unknowns)) else {
                return Self::impossible(unknowns, sides);
            };
            let inverse = total.inverse();
            let own = &inverse * &told;
            ln -= sides as f64 * half_ln_determinant(&total) + 0.5 * (measured - told.dot(&own));
            // With the own part integrated out, (A^-1 + I)^-1 = I - (I + A)^-1 is left of the information A.
            information += DMatrix::identity(unknowns, unknowns) - inverse;
            pull += own;
        }
        let scale = |matrix: &DMatrix<f64>| {
            DMatrix::from_fn(matrix.nrows(), matrix.ncols(), |i, j| ratios[i] * matrix[(i, j)])
        };
        let scaled = scale(&scale(&information).transpose()) + DMatrix::identity(unknowns, unknowns);
        let pull = scale(&pull);
        let Some(shared) = Cholesky::new(scaled) else { return Self::impossible(unknowns, sides) };
        let mean = shared.solve(&pull);
        ln += 0.5 * pull.dot(&mean) - sides as f64 * half_ln_determinant(&shared);
        let covariance = scale(&scale(&shared.inverse()).transpose()) + DMatrix::identity(unknowns, unknowns);
        Self { ln, next: Normal { mean: scale(&mean), covariance } }
    }

    fn impossible(unknowns: usize, sides: usize) -> Self {
        let next = Normal {
            mean: DMatrix::zeros(unknowns, sides),
            covariance: DMatrix::identity(unknowns, unknowns),
        };
        Self { ln: f64::NEG_INFINITY, next }
    }
}

/// Half the logarithm of the determinant of the factored matrix.
fn half_ln_determinant(factor: &Cholesky<f64, Dyn>) -> f64 {
    factor.l_dirty().diagonal().iter().map(|value| value.ln()).sum()
}

/// Minus the log posterior of the scales.
struct Cost<'e> {
    evidence: &'e dyn Fn(&Scales) -> f64,
    reading_m: f64,
}

impl CostFunction for Cost<'_> {
    type Param = Vec<f64>;
    type Output = f64;

    fn cost(&self, x: &Vec<f64>) -> Result<f64, argmin::core::Error> {
        let prior = 0.5 * x.iter().map(|x| x * x).sum::<f64>();
        let cost = prior - (self.evidence)(&Scales::from_logarithms(x, self.reading_m));
        Ok(if cost.is_finite() { cost } else { f64::MAX })
    }
}

impl Gradient for Cost<'_> {
    type Param = Vec<f64>;
    type Gradient = Vec<f64>;

    fn gradient(&self, x: &Vec<f64>) -> Result<Vec<f64>, argmin::core::Error> {
        const STEP: f64 = 1e-3;
        let here = self.cost(x)?;
        let slope = |i: usize| {
            let mut moved = x.clone();
            moved[i] += STEP;
            Ok((self.cost(&moved)? - here) / STEP)
        };
        (0..x.len()).map(slope).collect()
    }
}

/// The likeliest scales, by a quasi-Newton method; nothing where it fails.
fn search(cost: Cost<'_>, start: &[f64]) -> Option<Vec<f64>> {
    let line = MoreThuenteLineSearch::new().with_bounds(1e-3, 8.0).ok()?;
    let solver = LBFGS::new(line, 7).with_tolerance_cost(1e-3).ok()?.with_tolerance_grad(1e-2).ok()?;
    let run = Executor::new(cost, solver)
        .configure(|state| state.param(start.to_vec()).max_iters(MOST_STEPS))
        .run();
    run.ok()?.state().get_best_param().cloned()
}

#[cfg(test)]
#[path = "learn_tests.rs"]
mod tests;
