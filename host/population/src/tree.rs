//! Sessions in nested groups, and the sums over them that every estimator here is made of (theory, eq. 70).
//!
//! Units of a stage are the sessions at first, then the groups of the innermost level, and so on outwards; their parents are the groups of
//! the next level, at last the whole. The products `[1, x, y]^T V^-1 [1, x, y]` of a group follow from those of its units: what the
//! units of a group share with variance `t` is one update of rank one (Woodbury), and a mean of the group that is a free parameter is
//! the same update with infinite `t`. The work is linear in the number of sessions.

use crate::nested::Observations;
use std::ops::Range;

/// Pivot, relative to what it was, below which a covariate is a combination of others.
const SINGULAR: f64 = 1e-10;

/// Lower triangle of products, row by row.
pub(crate) type Products = [f64];

/// Place of an entry of a lower triangle.
fn triangular(row: usize, column: usize) -> usize {
    row * (row + 1) / 2 + column
}

/// An entry of the symmetric products; not a number outside them.
pub(crate) fn product(products: &Products, i: usize, j: usize) -> f64 {
    products.get(triangular(i.max(j), i.min(j))).copied().unwrap_or(f64::NAN)
}

/// By how much the units of a stage differ beyond their own errors, or by how much less than these.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Excess {
    /// Factor of the variance of the units' own errors: 1 or less.
    pub scale: f64,
    /// Variance between units.
    pub variance: f64,
}

impl Excess {
    /// As their own errors state.
    pub const NONE: Self = Self { scale: 1.0, variance: 0.0 };

    /// Units that differ with this variance.
    pub fn of(variance: f64) -> Self {
        Self { variance, ..Self::NONE }
    }
}

/// The sessions of a population in the order of their groups.
#[derive(Debug, Clone)]
pub(crate) struct Tree {
    /// Columns of a row `[1, x, y]`.
    size: usize,
    /// Sessions by their numbers in the data.
    pub order: Vec<usize>,
    rows: Vec<f64>,
    /// Variance of the own error of every session.
    pub v: Vec<f64>,
    /// Ends of the units of every stage: end of the units of every parent. The last has one parent.
    pub ends: Vec<Vec<usize>>,
    /// Widened errors of every stage and unit: variance in addition to what is estimated; nothing where the unit has
    /// its full weight.
    pub widened: Vec<Vec<f64>>,
}

impl Tree {
    /// Sorts the sessions into their groups.
    pub fn new(data: &Observations) -> Self {
        let mut order: Vec<usize> = (0..data.len()).collect();
        order.sort_by_cached_key(|index| data.levels.iter().map(|level| level[*index]).collect::<Vec<_>>());
        let depth = data.levels.len();
        let mut ends: Vec<Vec<usize>> = vec![Vec::new(); depth + 1];
        // Stage 0 has the innermost level, which is the last one of the data.
        for place in 1..=order.len() {
            let (last, next) = (order[place - 1], order.get(place));
            let outermost =
                next.map_or(Some(0), |next| data.levels.iter().position(|level| level[last] != level[*next]));
            let Some(outermost) = outermost else { continue };
            for stage in 0..depth - outermost.min(depth) {
                let end = if stage == 0 { place } else { ends[stage - 1].len() };
                ends[stage].push(end);
            }
        }
        let whole = if depth == 0 { order.len() } else { ends[depth - 1].len() };
        ends[depth].push(whole);
        let size = data.parameters() + 1;
        let rows = order.iter().flat_map(|index| data.row(*index)).collect();
        let v = order.iter().map(|index| data.v[*index]).collect();
        let mut widened = vec![vec![0.0; order.len()]];
        widened.extend((0..depth).map(|stage| vec![0.0; ends[stage].len()]));
        Self { size, order, rows, v, ends, widened }
    }

    /// Number of stages: levels and that of the sessions.
    pub fn stages(&self) -> usize {
        self.ends.len()
    }

    /// Units of a stage.
    pub fn units(&self, stage: usize) -> usize {
        self.widened[stage].len()
    }

    /// Parameters of the mean.
    pub fn parameters(&self) -> usize {
        self.size - 1
    }

    /// Numbers in the products of a group.
    pub fn width(&self) -> usize {
        self.size * (self.size + 1) / 2
    }

    /// Whether a unit counts in the spread of its stage.
    pub fn counts(&self, stage: usize, unit: usize) -> bool {
        self.widened[stage][unit] == 0.0
    }

    /// Row of a session in this order.
    pub fn row(&self, session: usize) -> &[f64] {
        &self.rows[session * self.size..(session + 1) * self.size]
    }

    /// Units of a parent of a stage.
    pub fn content(&self, stage: usize, parent: usize) -> Range<usize> {
        let ends = &self.ends[stage];
        parent.checked_sub(1).map_or(0, |before| ends[before])..ends[parent]
    }

    /// Sessions of a unit of a stage, by their places in this order.
    pub fn sessions(&self, stage: usize, unit: usize) -> Range<usize> {
        (0..stage).rev().fold(unit..unit + 1, |units, stage| {
            self.content(stage, units.start).start..self.content(stage, units.end - 1).end
        })
    }

    /// Units of every parent of a stage.
    pub fn parents(&self, stage: usize) -> impl Iterator<Item = Range<usize>> {
        (0..self.ends[stage].len()).map(move |parent| self.content(stage, parent))
    }

    /// Stages in the order of results: that of the sessions, then levels from the outermost.
    pub fn outwards(&self) -> impl Iterator<Item = usize> + use<> {
        std::iter::once(0).chain((1..self.stages()).rev())
    }

    /// Adds a unit of a stage to its parent's products; `below` are the units' own products, of sessions nothing. Returns its factor of
    /// the determinant.
    fn add(&self, stage: usize, unit: usize, excess: Excess, below: &Products, sum: &mut Products) -> f64 {
        let Excess { scale, variance } = excess;
        let more = variance + self.widened[stage][unit];
        if stage == 0 {
            let variance = scale * self.v[unit] + more;
            let row = self.row(unit);
            let mut offset = 0;
            for i in 0..self.size {
                let scaled = row[i] / variance;
                for other in &row[..=i] {
                    sum[offset] += scaled * other;
                    offset += 1;
                }
            }
            return variance;
        }
        let width = self.width();
        let subtotal = &below[unit * width..(unit + 1) * width];
        let gain = scale + more * subtotal[0];
        subtract(subtotal, (gain - 1.0) / (gain * subtotal[0]), sum);
        gain
    }

    /// Products of the parents of a stage; `ln_determinant` grows by theirs where it is wanted: logarithms take as long as all else.
    pub fn sums(
        &self,
        stage: usize,
        excess: Excess,
        below: &Products,
        sums: &mut Vec<f64>,
        mut ln_determinant: Option<&mut f64>,
    ) {
        let width = self.width();
        sums.clear();
        sums.resize(self.ends[stage].len() * width, 0.0);
        for (parent, units) in self.parents(stage).enumerate() {
            let sum = &mut sums[parent * width..(parent + 1) * width];
            for unit in units {
                let factor = self.add(stage, unit, excess, below, sum);
                if let Some(ln_determinant) = &mut ln_determinant {
                    **ln_determinant += factor.ln();
                }
            }
        }
    }

    /// Squares of the units of a stage about the free means of their parents, in the metric of their variances: chi-square
    /// with [`Self::freedom`] degrees of freedom where the variances are right, and independent of those of the stages below.
    /// `scratch` has room for the products of a group three times.
    pub fn squares(&self, stage: usize, excess: Excess, below: &Products, scratch: &mut Vec<f64>) -> f64 {
        let (squares_above, base, ..) = self.residual(stage, excess, below, scratch);
        (squares_above - base).max(0.0)
    }

    /// Degrees of freedom of [`Self::squares`]; `below` are products of the units at any variances.
    pub fn freedom(&self, stage: usize, below: &Products) -> usize {
        let (_, _, of_covariates, units) = self.residual(stage, Excess::NONE, below, &mut Vec::new());
        units.saturating_sub(of_covariates)
    }

    /// Squares about free parents and about free units; parameters of covariates that the parents' have beyond the units'; units less
    /// parents.
    fn residual(
        &self,
        stage: usize,
        excess: Excess,
        below: &Products,
        scratch: &mut Vec<f64>,
    ) -> (f64, f64, usize, usize) {
        let width = self.width();
        scratch.clear();
        scratch.resize(3 * width, 0.0);
        let (group, group_sums) = scratch.split_at_mut(width);
        let (tail, base) = group_sums.split_at_mut(width);
        let mut count = 0;
        for units in self.parents(stage) {
            group.fill(0.0);
            let earlier_count = count;
            for unit in units {
                if self.counts(stage, unit) {
                    count += 1;
                    self.add(stage, unit, excess, below, group);
                    if stage > 0 {
                        let subtotal = &below[unit * width..(unit + 1) * width];
                        subtract(subtotal, subtotal[0].recip(), base);
                    }
                }
            }
            if count > earlier_count {
                count -= 1;
                subtract(group, group[0].recip(), tail);
            }
        }
        let (squares, rank) = self.rest(tail);
        let (of_units, rank_of_units) = self.rest(base);
        (squares, of_units, rank.saturating_sub(rank_of_units), count)
    }

    /// Squares that are left of `y` once the covariates are free, and how many of them are determined.
    fn rest(&self, products: &mut Products) -> (f64, usize) {
        let mut rank = 0;
        let last = self.size - 1;
        let first: Vec<f64> = (1..last).map(|column| products[triangular(column, column)]).collect();
        for column in 1..last {
            let pivot = products[triangular(column, column)];
            if pivot <= SINGULAR * first[column - 1] || pivot <= 0.0 {
                continue;
            }
            rank += 1;
            for i in column + 1..=last {
                let ratio = products[triangular(i, column)] / pivot;
                for j in column + 1..=i {
                    products[triangular(i, j)] -= ratio * products[triangular(j, column)];
                }
            }
        }
        (products[triangular(last, last)], rank)
    }
}

/// Adds products less their share that goes with the constant: `M - share M_1 M_1^T`.
fn subtract(own: &Products, share: f64, sum: &mut Products) {
    let mut offset = 0;
    let mut i = 0;
    while offset < own.len() {
        let scaled = share * own[i * (i + 1) / 2];
        for j in 0..=i {
            sum[offset] += own[offset] - scaled * own[j * (j + 1) / 2];
            offset += 1;
        }
        i += 1;
    }
}
