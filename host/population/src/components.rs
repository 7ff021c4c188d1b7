//! Variances of all levels with their uncertainty, and what follows for means and predictions (theory, eq. 71).
//!
//! From the innermost stage outwards, the squares of the units of a stage about the free means of their parents are
//! chi-square and independent of those of the stages below. So a draw of chi-square for every stage gives, one after
//! the other, the variances with which the squares have these values: a draw of all variances together, and of the mean
//! given them (generalised pivotal quantities: Weerahandi 1993; Iyer, Wang and Mathew 2004). For balanced designs the
//! interval of the mean is that of Student's t with the degrees of freedom of the outermost level, and those of the
//! variances are exact; nothing is assumed beforehand. If the units differ by less than their own errors state, these
//! are scaled down, and the variance between units is zero.
//!
//! Draws are the points of a lattice of low discrepancy (Roberts' generalised golden ratio): the same data give the same intervals.

use crate::nested::Mean;
use crate::tree::{Excess, Products, Tree};
use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;
use statrs::distribution::{ChiSquared, ContinuousCDF, Normal};
use statrs::function::erf::erfc;

/// Draws for few sessions and for many, and sessions times draws that are worth their time.
const DRAWS: [usize; 2] = [1000, 300];
const WORK: usize = 8_000_000;
/// Nodes of a table of quantiles, in standard deviations of the normal distribution.
const NODES: usize = 81;
const NODES_FROM: f64 = -4.0;
const NODES_STEP: f64 = 0.1;
/// Least factor of stated errors.
const LEAST_SCALE: f64 = 1e-12;
/// Relative difference of squares from what they should be.
const TOLERANCE: f64 = 1e-8;
const ROUNDS: usize = 100;
/// Bisections of an end of an interval: to a millionth of its width.
const BISECTIONS: usize = 22;
/// Variance between units, as a multiple of their own, beyond which none is searched.
const FARTHEST: f64 = 1e15;

/// One draw.
#[derive(Debug, Clone)]
pub(crate) struct Draw {
    /// Variance between the units of every stage; negative where they differ by less than their own errors.
    pub signed: Vec<f64>,
    /// The mean under these variances.
    pub beta: DVector<f64>,
    /// Its covariance.
    pub covariance: DMatrix<f64>,
    /// A draw of the standard normal distribution, for one of the mean.
    pub normal: f64,
}

impl Draw {
    /// Variance of all stages together.
    pub fn total(&self) -> f64 {
        self.signed.iter().sum()
    }
}

/// Degrees of freedom of every stage.
pub(crate) fn freedom(tree: &Tree) -> Vec<usize> {
    let (mut subtotals, mut sums) = (Vec::new(), Vec::new());
    (0..tree.stages())
        .map(|stage| {
            let freedom = tree.freedom(stage, &subtotals);
            tree.sums(stage, Excess::NONE, &subtotals, &mut sums, None);
            std::mem::swap(&mut subtotals, &mut sums);
            freedom
        })
        .collect()
}

/// The variances with which the squares of every stage are what is wanted; `None` for a stage that determines nothing. The products of
/// all sessions are left in `room.below`.
fn solved(tree: &Tree, wanted: &[Option<f64>], room: &mut Room) -> (Vec<Excess>, Vec<f64>) {
    room.below.clear();
    let mut signed = Vec::with_capacity(wanted.len());
    let excesses = wanted.iter().enumerate().map(|(stage, wanted)| {
        let own_part = own_variance(tree, stage, &room.below);
        let excess = wanted.map_or(Excess::NONE, |wanted| {
            let (subtotals, scratch) = (&room.below, &mut room.scratch);
            excess_of(|excess| tree.squares(stage, excess, subtotals, scratch), wanted, own_part)
        });
        signed.push((excess.scale - 1.0) * own_part + excess.variance);
        tree.sums(stage, excess, &room.below, &mut room.sums, None);
        std::mem::swap(&mut room.below, &mut room.sums);
        excess
    });
    let excess_list = excesses.collect();
    (excess_list, signed)
}

/// Memory that draws use one after the other.
#[derive(Debug, Default)]
struct Room {
    below: Vec<f64>,
    sums: Vec<f64>,
    scratch: Vec<f64>,
}

/// The harmonic mean of the units' own variances.
fn own_variance(tree: &Tree, stage: usize, below: &Products) -> f64 {
    let units = tree.units(stage);
    units as f64
        / (0..units)
            .map(|unit| if stage == 0 { tree.v[unit].recip() } else { below[unit * tree.width()] })
            .sum::<f64>()
}

/// Excess at which the sum of squares, which falls with the excess, has a value. Their inverse is nearly linear in the
/// variance, and is so where all units have the same own variance; `own` is a typical one.
fn excess_of(mut squares: impl FnMut(Excess) -> f64, wanted: f64, own: f64) -> Excess {
    let at_none = squares(Excess::NONE);
    if at_none <= wanted {
        return Excess { scale: (at_none / wanted).max(LEAST_SCALE), variance: 0.0 };
    }
    let (mut low, mut at_low) = (0.0, at_none.recip() - wanted.recip());
    // Excess of units with the same errors.
    let mut step = own * (at_none / wanted - 1.0);
    let (mut high, mut at_high) = loop {
        let difference = squares(Excess::of(low + step)).recip() - wanted.recip();
        if difference >= 0.0 || !difference.is_finite() || step > FARTHEST * own {
            break (low + step, difference);
        }
        (low, at_low, step) = (low + step, difference, 2.0 * step);
    };
    for _ in 0..ROUNDS {
        // Regula falsi, the end that stays halved (Illinois); bisection where it does not help.
        let mut next = (low * at_high - high * at_low) / (at_high - at_low);
        if !(next > low && next < high) {
            next = 0.5 * (low + high);
        }
        let difference = squares(Excess::of(next)).recip() - wanted.recip();
        if (difference * wanted).abs() < TOLERANCE || high - low < TOLERANCE * high {
            return Excess::of(next);
        }
        if difference < 0.0 {
            (low, at_low) = (next, difference);
            at_high *= 0.5;
        } else {
            (high, at_high) = (next, difference);
            at_low *= 0.5;
        }
    }
    Excess::of(0.5 * (low + high))
}

/// Variances by moments: the squares of every stage have their expectation.
pub(crate) fn moments(tree: &Tree) -> Vec<Excess> {
    let target_squares: Vec<Option<f64>> =
        freedom(tree).into_iter().map(|freedom| (freedom > 0).then_some(freedom as f64)).collect();
    let mut excesses = solved(tree, &target_squares, &mut Room::default()).0;
    excesses.iter_mut().for_each(|excess| excess.scale = 1.0);
    excesses
}

/// Draws of all variances and of the mean given them, from every reading of what is far with its share; empty where the mean is not
/// determined.
pub(crate) fn draws(readings: &[(f64, Tree)]) -> Vec<Draw> {
    readings
        .iter()
        .flat_map(|(share, tree)| {
            let count = (WORK / tree.order.len().max(1)).clamp(DRAWS[1], DRAWS[0]);
            drawn(tree, &freedom(tree), (share * count as f64).round() as usize)
        })
        .collect()
}

/// So many draws of one reading.
fn drawn(tree: &Tree, freedom: &[usize], count: usize) -> Vec<Draw> {
    let of_stage: Vec<Option<Quantiles>> = freedom.iter().map(|freedom| Quantiles::new(*freedom)).collect();
    let steps = lattice(of_stage.len() + 1);
    let last = steps.last().copied().unwrap_or(0.5);
    let standard = Normal::standard();
    (0..count)
        .into_par_iter()
        .map_init(Room::default, |room: &mut Room, number: usize| {
            let target_squares: Vec<Option<f64>> = of_stage
                .iter()
                .zip(&steps)
                .map(|(chi, step)| Some(chi.as_ref()?.at(lattice_point(number, *step))))
                .collect();
            let (_, signed) = solved(tree, &target_squares, room);
            let Mean { beta, covariance, .. } = Mean::of(&room.below, tree.parameters())?;
            let normal = standard.inverse_cdf(lattice_point(number, last));
            Some(Draw { signed, beta, covariance, normal })
        })
        .flatten()
        .collect()
}

/// Quantiles of chi-square from a table: their cube root is nearly linear in the normal quantile (Wilson and Hilferty 1931).
struct Quantiles {
    normal: Normal,
    roots: Vec<f64>,
}

impl Quantiles {
    /// `None` without degrees of freedom.
    fn new(freedom: usize) -> Option<Self> {
        let (chi, normal) = (ChiSquared::new(freedom as f64).ok()?, Normal::standard());
        Some(Self {
            normal,
            roots: (0..NODES)
                .map(|node| chi.inverse_cdf(normal.cdf(NODES_FROM + NODES_STEP * node as f64)).cbrt())
                .collect(),
        })
    }

    fn at(&self, probability: f64) -> f64 {
        let node_position = (self.normal.inverse_cdf(probability) - NODES_FROM) / NODES_STEP;
        let clamped_position =
            node_position.clamp(0.0, (NODES - 2) as f64 + 1.0 - f64::EPSILON * NODES as f64);
        let [low, high] =
            [0, 1].map(|more| self.roots.get(clamped_position as usize + more).copied().unwrap_or(0.0));
        (low + clamped_position.fract() * (high - low)).powi(3)
    }
}

/// Steps of the lattice in so many dimensions: powers of the inverse root of `x^(d+1) = x + 1`.
fn lattice(dimensions: usize) -> Vec<f64> {
    let mut root: f64 = 1.5;
    for _ in 0..ROUNDS {
        root = (1.0 + root).powf(1.0 / (dimensions as f64 + 1.0));
    }
    (1..=dimensions as i32).map(|power| root.powi(-power)).collect()
}

/// Coordinate of a point of the lattice.
fn lattice_point(number: usize, step: f64) -> f64 {
    (0.5 + (number as f64 + 1.0) * step).fract()
}

/// Products of the units of a stage, each stage within it with the variances that it has by moments.
fn units_of(tree: &Tree, stage: usize) -> Vec<f64> {
    let (mut subtotals, mut sums) = (Vec::new(), Vec::new());
    for (stage, excess) in moments(tree).into_iter().enumerate().take(stage) {
        tree.sums(stage, excess, &subtotals, &mut sums, None);
        std::mem::swap(&mut subtotals, &mut sums);
    }
    subtotals
}

/// The variance between the units of a stage that its 95 % interval would reach in one of six populations without any: intervals end no
/// lower, so that units which agree by chance prove nothing (power-constrained limits, Cowan and others 2011).
pub(crate) fn sensitivity(tree: &Tree, stage: usize, freedom: usize) -> f64 {
    let Ok(chi) = ChiSquared::new(freedom as f64) else { return 0.0 };
    let ratio = chi.inverse_cdf(0.025) / chi.inverse_cdf(0.16);
    let unit_totals = units_of(tree, stage);
    let units = tree.units(stage);
    let unit_variances: Vec<f64> = (0..units)
        .map(|unit| if stage == 0 { tree.v[unit] } else { unit_totals[unit * tree.width()].recip() })
        .collect();
    excess_of(
        |excess: Excess| unit_variances.iter().map(|v| v / (v + excess.variance)).sum::<f64>(),
        ratio * units as f64,
        own_variance(tree, stage, &unit_totals),
    )
    .variance
}

/// Ends of the 95 % interval of the innermost variance that is determined: those with which the squares are quantiles of chi-square
/// (Viechtbauer 2007).
pub(crate) fn profile(tree: &Tree, freedom: &[usize]) -> Option<[f64; 2]> {
    let stage = freedom.iter().position(|freedom| *freedom > 0)?;
    let chi = ChiSquared::new(freedom[stage] as f64).ok()?;
    let (unit_totals, mut scratch) = (units_of(tree, stage), Vec::new());
    let own_part = own_variance(tree, stage, &unit_totals);
    Some([0.975, 0.025].map(|probability| {
        let squares = |excess| tree.squares(stage, excess, &unit_totals, &mut scratch);
        excess_of(squares, chi.inverse_cdf(probability), own_part).variance
    }))
}

/// Squares of the innermost stage that determines a variance, by stated errors alone; its degrees of freedom; a typical variance of its
/// units.
pub(crate) fn determined(tree: &Tree, freedom: &[usize]) -> Option<(f64, usize, f64)> {
    let stage = freedom.iter().position(|freedom| *freedom > 0)?;
    let unit_totals = units_of(tree, stage);
    let squares = tree.squares(stage, Excess::NONE, &unit_totals, &mut Vec::new());
    Some((squares, freedom[stage], own_variance(tree, stage, &unit_totals)))
}

/// A quantile of sorted values.
pub(crate) fn quantile(sorted: &[f64], share: f64) -> f64 {
    let rank = (share * sorted.len() as f64 - 0.5).max(0.0);
    let last = sorted.len().saturating_sub(1);
    let [low, high] = [0, 1].map(|more| sorted.get((rank as usize + more).min(last)).copied().unwrap_or(0.0));
    low + rank.fract() * (high - low)
}

/// Ends of the 95 % interval of a mixture of normal distributions with these means and variances, and a variance common to all.
pub(crate) fn quantile_of_normals(parts: &[(f64, f64)], common: f64) -> [f64; 2] {
    let components: Vec<(f64, f64)> =
        parts.iter().map(|(mean, variance)| (*mean, (variance + common).sqrt())).collect();
    let mut means: Vec<f64> = components.iter().map(|(mean, _)| *mean).collect();
    let mut sds: Vec<f64> = components.iter().map(|(_, sd)| *sd).collect();
    means.sort_by(f64::total_cmp);
    sds.sort_by(f64::total_cmp);
    let (middle, sd) = (quantile(&means, 0.5), quantile(&sds, 0.5));
    [(0.025, -1.0), (0.975, 1.0)].map(|(share, side)| {
        let is_beyond = |value: f64| side * (mixture_cdf(&components, value) - share) > 0.0;
        let mut step = 2.0 * sd;
        while !is_beyond(middle + side * step) && step < 1e9 * sd {
            step *= 2.0;
        }
        let (mut inner, mut outer) = (0.0, step);
        for _ in 0..BISECTIONS {
            let half = 0.5 * (inner + outer);
            if is_beyond(middle + side * half) {
                outer = half;
            } else {
                inner = half;
            }
        }
        middle + side * outer
    })
}

/// Probability that a mixture of normal distributions, each with a mean and a standard deviation, is below a value.
fn mixture_cdf(components: &[(f64, f64)], value: f64) -> f64 {
    components
        .iter()
        .map(|(mean, sd)| 0.5 * erfc((mean - value) / (sd * std::f64::consts::SQRT_2)))
        .sum::<f64>()
        / components.len() as f64
}
