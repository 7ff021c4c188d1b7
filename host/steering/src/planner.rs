//! Guide moves that minimise the expected squared miss at the target, under limits (theory, eq. 79).
//!
//! The tip at the target is `a + sum_j g_j (p_j - p_(j-1))` for positions `p_j` of the guide at the rests to come,
//! linear in them, with `a` and `g` normally distributed by the posterior of each law. The expected squared miss is a
//! quadratic function of the positions: its uncertain part grows with the moves, so that a large move whose gain is not
//! known costs what it may miss. Travel bounds each position; the largest move, and strain, force and compression at
//! every stop to come ([`Cone`]), bound the length of a vector: a program with second-order cones, solved by the
//! interior-point method of `clarabel`. Only a few of the hundreds of cones are active: those that a solution exceeds
//! are added, and it is solved again. A cone may be exceeded at a price above any that a target has, where nothing
//! within it can be reached any more.

use crate::envelope::{Cone, Limit, SOLVED, moves};
use crate::estimator::AtTarget;
use crate::unknowns::TISSUE;
use clarabel::algebra::CscMatrix;
use clarabel::solver::{
    DefaultSettings, DefaultSolver, IPSolver, NonnegativeConeT, SecondOrderConeT, SolverStatus,
    SupportedConeT,
};
use nalgebra::DVector;
use std::collections::BTreeMap;

/// One law with its weight.
pub(crate) struct Weighted<'a> {
    pub weight: f64,
    pub at: &'a AtTarget,
}

/// Weights of the plan.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Weights {
    /// Weight of the uncertain part of the squared miss.
    pub caution: f64,
    /// Squared miss per squared move.
    pub effort: f64,
}

/// Range of the guide.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Bounds<'a> {
    /// Largest displacement along either axis, m.
    pub travel_m: f64,
    /// Largest move at the first rest, m.
    pub largest_move_m: Option<f64>,
    /// Limited quantities at the stops to come.
    pub cones: &'a [Cone],
    /// Deviation of the tip at the target that later moves shall be able to correct, m: as much of it as limits leave.
    pub deviation_m: f64,
}

/// Share of the deviations that point to where a limit keeps the needle from being corrected: two of the four points of a
/// cubature of the plane.
const OUTWARD: f64 = 0.5;

/// Rounds in which exceeded cones are added.
const ROUNDS: usize = 6;
/// Price of a limit exceeded by its whole, as a half squared miss, mm^2: a hundredth more would have to bring a tip nearer by
/// centimetres.
const PRICE_MM2: f64 = 1e5;
/// A limit is named where a tenth more of it would bring the squared miss down by more than this, mm^2.
const MATTERS_MM2: f64 = 2.5e-3;

/// A plan: what is to be moved at every rest, and what comes of it.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Plan {
    /// Position of the guide from each rest on, per plane, m.
    pub guide_m: Vec<[f64; 2]>,
    /// Expected tip at the target, m.
    pub tip_m: [f64; 2],
    /// Covariance of the tip there: xx, xy, yy, m^2.
    pub covariance_m2: [f64; 3],
    /// Limits that keep the plan from coming nearer to the target, and the reduction of the squared miss by a tenth
    /// more of each, mm^2; the largest first.
    pub limited_by: Vec<(Limit, f64)>,
}

impl Plan {
    /// A guide that stays where it is.
    pub fn staying(laws: &[Weighted], now_m: [f64; 2], rests: usize) -> Self {
        let guide_m = vec![now_m; rests];
        let (tip_m, covariance_m2) = outcome(laws, now_m, &guide_m);
        Self { guide_m, tip_m, covariance_m2, limited_by: Vec::new() }
    }
}

/// The plan from where the guide is now, m. If the program has no solution, the guide stays.
pub(crate) fn plan(
    laws: &[Weighted],
    now_m: [f64; 2],
    target_m: [f64; 2],
    bounds: &Bounds,
    weights: Weights,
) -> Plan {
    let holds = laws.first().map_or(0, |law| law.at.gains.len());
    let squares = [0, 1].map(|plane: usize| {
        // In moves: squared miss 1/2 m' Q m + q' m.
        let mut quadratic = vec![vec![0.0; holds]; holds];
        let mut linear = vec![0.0; holds];
        for law in laws {
            let law_posterior = law.at;
            let error_m = law_posterior.tip_m[plane] - target_m[plane];
            // Covariance of what is now predicted with the gains, and of the gains.
            let spread: Vec<DVector<f64>> =
                law_posterior.gain_rows.iter().map(|row| spread_of(law_posterior, row)).collect();
            for j in 0..holds {
                let tip_spread = weights.caution * law_posterior.rows[plane].dot(&spread[j]);
                linear[j] += law.weight * (law_posterior.gains[j] * error_m + tip_spread);
                for ((to, gain_row), gain) in
                    quadratic[j].iter_mut().zip(&law_posterior.gain_rows).zip(&law_posterior.gains)
                {
                    let gain_spread: f64 = (0..TISSUE).map(|i| gain_row[i] * spread[j][i]).sum();
                    *to += law.weight * (law_posterior.gains[j] * gain + weights.caution * gain_spread);
                }
            }
        }
        for (j, row) in quadratic.iter_mut().enumerate() {
            row[j] += weights.effort;
        }
        Square { quadratic, linear }
    });
    let (guide_m, limited_by) =
        within(&squares, now_m, bounds).unwrap_or_else(|| (vec![now_m; holds], Vec::new()));
    let (tip_m, covariance_m2) = outcome(laws, now_m, &guide_m);
    Plan { guide_m, tip_m, covariance_m2, limited_by }
}

/// Limits of a plan, and the fraction of each that is used.
type Limited = Vec<(Limit, f64)>;

/// Positions within all cones, and what limits them.
fn within(squares: &[Square; 2], now_m: [f64; 2], bounds: &Bounds) -> Option<(Vec<[f64; 2]>, Limited)> {
    let mut active: Vec<&Cone> = Vec::new();
    let mut solved = solve(squares, now_m, bounds, &active)?;
    for _ in 0..ROUNDS {
        let moves_m = moves(now_m, &solved.0);
        // Largest excess of a limited quantity at each location.
        let mut worst: BTreeMap<(usize, usize, Limit), (f64, &Cone)> = BTreeMap::new();
        for cone in bounds.cones {
            let cone_excess = cone.excess(&moves_m, bounds.deviation_m - solved.2);
            if cone_excess > SOLVED && !active.iter().any(|one| std::ptr::eq(*one, cone)) {
                let entry = worst.entry(cone.group()).or_insert((cone_excess, cone));
                if cone_excess > entry.0 {
                    *entry = (cone_excess, cone);
                }
            }
        }
        if worst.is_empty() {
            break;
        }
        active.extend(worst.into_values().map(|(_, cone)| cone));
        solved = solve(squares, now_m, bounds, &active)?;
    }
    Some((solved.0, solved.1))
}

/// Positions, m, what limits them, and what of the deviation is left uncorrected, m.
type Solved = (Vec<[f64; 2]>, Vec<(Limit, f64)>, f64);

/// `1/2 m' Q m + q' m` of the moves of one plane, SI.
struct Square {
    quadratic: Vec<Vec<f64>>,
    linear: Vec<f64>,
}

impl Square {
    /// The same of positions: raising position `j` raises move `j` and lowers move `j + 1`.
    fn of_positions(&self, now_m: f64, i: usize, j: usize) -> (f64, f64) {
        let interaction =
            self.entry(i, j) - self.entry(i, j + 1) - self.entry(i + 1, j) + self.entry(i + 1, j + 1);
        (interaction, self.linear_term(i, now_m) - self.linear_term(i + 1, now_m))
    }

    fn linear_term(&self, i: usize, now_m: f64) -> f64 {
        self.linear.get(i).map_or(0.0, |linear| linear - self.entry(i, 0) * now_m)
    }

    fn entry(&self, i: usize, j: usize) -> f64 {
        self.quadratic.get(i).and_then(|row| row.get(j)).copied().unwrap_or_default()
    }
}

/// Positions that minimise the sum of both planes' squares within bounds, m. Solved in millimetres, in which all is of the size
/// of one.
fn solve(squares: &[Square; 2], now_m: [f64; 2], bounds: &Bounds, active: &[&Cone]) -> Option<Solved> {
    const MM: f64 = 1e3;
    let holds = squares[0].linear.len();
    if holds == 0 {
        return Some((Vec::new(), Vec::new(), 0.0));
    }
    // Behind the positions, what of the deviation is not corrected, mm, and by how much each cone is exceeded.
    let uncorrected = 2 * holds;
    let (slacks, count) = (uncorrected + 1, uncorrected + 1 + active.len());
    let mut cost = vec![PRICE_MM2; count];
    let mut quadratic = Entries::default();
    cost[uncorrected] = 0.0;
    quadratic.add(uncorrected, uncorrected, OUTWARD);
    for (plane, square) in squares.iter().enumerate() {
        for i in 0..holds {
            for j in i..holds {
                quadratic.add(
                    variable(i, plane, holds),
                    variable(j, plane, holds),
                    square.of_positions(now_m[plane], i, j).0,
                );
            }
            cost[variable(i, plane, holds)] = MM * square.of_positions(now_m[plane], i, i).1;
        }
    }
    // Rows of A p + s = b with s in a cone.
    let (mut rows, mut right) = (Entries::default(), Vec::new());
    let mut limits: Vec<(Limit, usize, f64)> = Vec::new();
    for column in 0..uncorrected {
        for sign in [1.0, -1.0] {
            limits.push((Limit::Travel, right.len(), MM * bounds.travel_m));
            rows.add(right.len(), column, sign);
            right.push(MM * bounds.travel_m);
        }
    }
    for column in uncorrected..count {
        rows.add(right.len(), column, -1.0);
        right.push(0.0);
    }
    rows.add(right.len(), uncorrected, 1.0);
    // The solver wants room inside of all bounds.
    right.push((MM * bounds.deviation_m).max(1e-3));
    let mut cones: Vec<SupportedConeT<f64>> = vec![NonnegativeConeT(right.len())];
    if let Some(radius_m) = bounds.largest_move_m {
        limits.push((Limit::LargestMove, right.len(), MM * radius_m));
        right.push(MM * radius_m);
        for (plane, now_m) in now_m.iter().enumerate() {
            rows.add(right.len(), variable(0, plane, holds), -1.0);
            right.push(-MM * now_m);
        }
        cones.push(SecondOrderConeT(3));
    }
    for (slack, cone) in active.iter().enumerate() {
        limits.push((cone.limit, right.len(), cone.bound));
        rows.add(right.len(), slacks + slack, -1.0);
        rows.add(right.len(), uncorrected, -cone.per_correction / MM);
        right.push(cone.bound - cone.per_correction * bounds.deviation_m);
        for (plane, (now_m, mut stay)) in now_m.iter().zip(cone.stay).enumerate() {
            // A position raises its own move and lowers the next.
            for (hold, per_move) in cone.per_move.iter().enumerate().take(holds) {
                let next = cone.per_move.get(hold + 1).copied().unwrap_or(0.0);
                rows.add(right.len(), variable(hold, plane, holds), -(per_move - next) / MM);
                if hold == 0 {
                    stay -= per_move * now_m;
                }
            }
            right.push(stay);
        }
        cones.push(SecondOrderConeT(3));
    }
    let objective = quadratic.matrix(count, count);
    let constraints = rows.matrix(right.len(), count);
    let settings = DefaultSettings { verbose: false, ..DefaultSettings::default() };
    let mut solver = DefaultSolver::new(&objective, &cost, &constraints, &right, &cones, settings).ok()?;
    solver.solve();
    let solution = &solver.solution;
    let solved = matches!(solution.status, SolverStatus::Solved | SolverStatus::AlmostSolved);
    let guide_m: Vec<[f64; 2]> = (0..holds)
        .map(|hold| {
            [0, 1].map(|plane: usize| {
                let mm = solution.x.get(variable(hold, plane, holds)).copied().unwrap_or(f64::NAN);
                (mm / MM).clamp(-bounds.travel_m, bounds.travel_m)
            })
        })
        .collect();
    // The multiplier of a bound is what half of the squared miss falls by per unit of it.
    let mut limited: BTreeMap<Limit, f64> = BTreeMap::new();
    for (limit, row, bound) in limits {
        let per_unit = solution.z.get(row).copied().unwrap_or(0.0);
        *limited.entry(limit).or_default() += 0.1 * bound * 2.0 * per_unit;
    }
    let mut limited: Vec<(Limit, f64)> = limited.into_iter().filter(|(_, mm2)| *mm2 > MATTERS_MM2).collect();
    limited.sort_by(|a, b| b.1.total_cmp(&a.1));
    (solved && guide_m.iter().flatten().all(|m| m.is_finite())).then(|| {
        let uncorrected_mm = solution.x.get(uncorrected).copied().unwrap_or(0.0);
        (guide_m, limited, uncorrected_mm / MM)
    })
}

fn variable(hold: usize, plane: usize, holds: usize) -> usize {
    plane * holds + hold
}

/// Entries of a sparse matrix.
#[derive(Default)]
struct Entries {
    rows: Vec<usize>,
    columns: Vec<usize>,
    values: Vec<f64>,
}

impl Entries {
    fn add(&mut self, row: usize, column: usize, value: f64) {
        self.rows.push(row);
        self.columns.push(column);
        self.values.push(value);
    }

    fn matrix(self, rows: usize, columns: usize) -> CscMatrix<f64> {
        CscMatrix::new_from_triplets(rows, columns, self.rows, self.columns, self.values)
    }
}

fn spread_of(at: &AtTarget, row: &[f64; TISSUE]) -> DVector<f64> {
    let tissue = DVector::from_column_slice(row);
    at.covariance.columns(0, TISSUE) * tissue
}

/// Tip at the target and its covariance if the guide is moved like this.
pub(crate) fn outcome(laws: &[Weighted], now_m: [f64; 2], guide_m: &[[f64; 2]]) -> ([f64; 2], [f64; 3]) {
    let (mut mean, mut square) = ([0.0; 2], [0.0; 3]);
    for law in laws {
        let law_posterior = law.at;
        let mut rows = law_posterior.rows.clone();
        let mut tip_m = law_posterior.tip_m;
        let mut previous_m = now_m;
        for (hold, to_m) in guide_m.iter().enumerate() {
            for plane in 0..2 {
                let moved_m = to_m[plane] - previous_m[plane];
                tip_m[plane] += law_posterior.gains[hold] * moved_m;
                (0..TISSUE).for_each(|i| rows[plane][i] += law_posterior.gain_rows[hold][i] * moved_m);
            }
            previous_m = *to_m;
        }
        let spread = [0, 1].map(|plane: usize| &law_posterior.covariance * &rows[plane]);
        let covariance = [rows[0].dot(&spread[0]), rows[0].dot(&spread[1]), rows[1].dot(&spread[1])];
        for (i, [a, b]) in [[0, 0], [0, 1], [1, 1]].into_iter().enumerate() {
            square[i] += law.weight * (covariance[i] + tip_m[a] * tip_m[b]);
        }
        (0..2).for_each(|plane| mean[plane] += law.weight * tip_m[plane]);
    }
    let covariance =
        [square[0] - mean[0] * mean[0], square[1] - mean[0] * mean[1], square[2] - mean[1] * mean[1]];
    (mean, covariance)
}

#[cfg(test)]
#[path = "planner_tests.rs"]
mod tests;
