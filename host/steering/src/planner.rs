//! Guide moves that minimise the expected squared miss at the target, under limits (theory, eq. 79).
//!
//! The tip at the target is `a + sum_j g_j (p_j - p_(j-1))` for positions `p_j` of the guide at the rests to come, linear in them, with
//! `a` and `g` normally distributed by the posterior of each law. The expected squared miss is a quadratic function of the positions:
//! its uncertain part grows with the moves, so that a large move whose gain is not known costs what it may miss. Travel bounds each
//! position, the force of guide 2 and the largest move bound the length of a vector: a program with second-order cones, solved by the
//! interior-point method of `clarabel`.

use crate::estimator::AtTarget;
use crate::unknowns::TISSUE;
use clarabel::algebra::CscMatrix;
use clarabel::solver::{
    DefaultSettings, DefaultSolver, IPSolver, NonnegativeConeT, SecondOrderConeT, SolverStatus,
    SupportedConeT,
};
use nalgebra::DVector;

/// One law with its weight.
pub(crate) struct Weighted<'a> {
    pub weight: f64,
    pub at: &'a AtTarget,
}

/// How it is planned.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Weights {
    /// How many times the uncertain part of the squared miss counts.
    pub caution: f64,
    /// Squared miss per squared move.
    pub effort: f64,
}

/// Where the guide may be.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Bounds {
    /// Largest displacement along either axis, m.
    pub travel_m: f64,
    /// Largest move at the first rest, m.
    pub largest_move_m: Option<f64>,
    /// Per rest the circle within which the force stays below its limit.
    pub circles: Vec<Option<Circle>>,
}

/// A circle of guide positions.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Circle {
    /// Where the guide carries no force, m.
    pub centre_m: [f64; 2],
    /// How far from there it may be, m.
    pub radius_m: f64,
}

/// A plan: what is to be moved at every rest, and what comes of it.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Plan {
    /// Position of the guide from each rest on, per plane, m.
    pub guide_m: Vec<[f64; 2]>,
    /// Expected tip at the target, m.
    pub tip_m: [f64; 2],
    /// Covariance of the tip there: xx, xy, yy, m^2.
    pub covariance_m2: [f64; 3],
}

/// The plan from where the guide is now, m. Where the program is not solved the guide stays.
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
            let at = law.at;
            let error_m = at.tip_m[plane] - target_m[plane];
            // Covariance of what is now predicted with the gains, and of the gains.
            let spread: Vec<DVector<f64>> = at.gain_rows.iter().map(|row| spread_of(at, row)).collect();
            for j in 0..holds {
                let own = weights.caution * at.rows[plane].dot(&spread[j]);
                linear[j] += law.weight * (at.gains[j] * error_m + own);
                for ((to, gain_row), gain) in quadratic[j].iter_mut().zip(&at.gain_rows).zip(&at.gains) {
                    let both: f64 = (0..TISSUE).map(|i| gain_row[i] * spread[j][i]).sum();
                    *to += law.weight * (at.gains[j] * gain + weights.caution * both);
                }
            }
        }
        for (j, row) in quadratic.iter_mut().enumerate() {
            row[j] += weights.effort;
        }
        Square { quadratic, linear }
    });
    let guide_m = solve(&squares, now_m, bounds).unwrap_or_else(|| vec![now_m; holds]);
    let (tip_m, covariance_m2) = outcome(laws, now_m, &guide_m);
    Plan { guide_m, tip_m, covariance_m2 }
}

/// `1/2 m' Q m + q' m` of the moves of one plane, SI.
struct Square {
    quadratic: Vec<Vec<f64>>,
    linear: Vec<f64>,
}

impl Square {
    /// The same of positions: raising position `j` raises move `j` and lowers move `j + 1`.
    fn of_positions(&self, now_m: f64, i: usize, j: usize) -> (f64, f64) {
        let entry = |i: usize, j: usize| {
            self.quadratic.get(i).and_then(|row| row.get(j)).copied().unwrap_or_default()
        };
        let both = entry(i, j) - entry(i, j + 1) - entry(i + 1, j) + entry(i + 1, j + 1);
        let linear = |i: usize| self.linear.get(i).map_or(0.0, |linear| linear - entry(i, 0) * now_m);
        (both, linear(i) - linear(i + 1))
    }
}

/// Positions that minimise the sum of both planes' squares within bounds, m. Solved in millimetres, in which all is of the size of one.
fn solve(squares: &[Square; 2], now_m: [f64; 2], bounds: &Bounds) -> Option<Vec<[f64; 2]>> {
    const MM: f64 = 1e3;
    let holds = squares[0].linear.len();
    if holds == 0 {
        return Some(Vec::new());
    }
    let variable = |hold: usize, plane: usize| plane * holds + hold;
    let count = 2 * holds;
    let (mut rows, mut columns, mut values, mut cost) =
        (Vec::new(), Vec::new(), Vec::new(), vec![0.0; count]);
    for (plane, square) in squares.iter().enumerate() {
        for i in 0..holds {
            for j in i..holds {
                rows.push(variable(i, plane));
                columns.push(variable(j, plane));
                values.push(square.of_positions(now_m[plane], i, j).0);
            }
            cost[variable(i, plane)] = MM * square.of_positions(now_m[plane], i, i).1;
        }
    }
    let objective = CscMatrix::new_from_triplets(count, count, rows, columns, values);
    // Rows of A p + s = b with s in a cone.
    let (mut rows, mut columns, mut values, mut right) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
    let mut entry = |row: usize, column: usize, value: f64| {
        rows.push(row);
        columns.push(column);
        values.push(value);
    };
    for column in 0..count {
        for sign in [1.0, -1.0] {
            entry(right.len(), column, sign);
            right.push(MM * bounds.travel_m);
        }
    }
    let mut cones: Vec<SupportedConeT<f64>> = vec![NonnegativeConeT(right.len())];
    let mut within = |hold: usize, circle: Circle| {
        right.push(MM * circle.radius_m);
        for plane in 0..2 {
            entry(right.len(), variable(hold, plane), -1.0);
            right.push(-MM * circle.centre_m[plane]);
        }
        cones.push(SecondOrderConeT(3));
    };
    if let Some(radius_m) = bounds.largest_move_m {
        within(0, Circle { centre_m: now_m, radius_m });
    }
    for (hold, circle) in bounds.circles.iter().enumerate().take(holds) {
        if let Some(circle) = circle {
            within(hold, *circle);
        }
    }
    let constraints = CscMatrix::new_from_triplets(right.len(), count, rows, columns, values);
    let settings = DefaultSettings { verbose: false, ..DefaultSettings::default() };
    let mut solver = DefaultSolver::new(&objective, &cost, &constraints, &right, &cones, settings).ok()?;
    solver.solve();
    let solution = &solver.solution;
    let solved = matches!(solution.status, SolverStatus::Solved | SolverStatus::AlmostSolved);
    let at = |hold: usize| {
        [0, 1].map(|plane: usize| {
            let mm = solution.x.get(variable(hold, plane)).copied().unwrap_or(f64::NAN);
            (mm / MM).clamp(-bounds.travel_m, bounds.travel_m)
        })
    };
    let positions: Vec<[f64; 2]> = (0..holds).map(at).collect();
    (solved && positions.iter().flatten().all(|m| m.is_finite())).then_some(positions)
}

fn spread_of(at: &AtTarget, row: &[f64; TISSUE]) -> DVector<f64> {
    let tissue = DVector::from_column_slice(row);
    at.covariance.columns(0, TISSUE) * tissue
}

/// Tip at the target and its covariance if the guide is moved like this.
pub(crate) fn outcome(laws: &[Weighted], now_m: [f64; 2], guide_m: &[[f64; 2]]) -> ([f64; 2], [f64; 3]) {
    let (mut mean, mut square) = ([0.0; 2], [0.0; 3]);
    for law in laws {
        let at = law.at;
        let mut rows = at.rows.clone();
        let mut tip_m = at.tip_m;
        let mut before_m = now_m;
        for (hold, to_m) in guide_m.iter().enumerate() {
            for plane in 0..2 {
                let moved_m = to_m[plane] - before_m[plane];
                tip_m[plane] += at.gains[hold] * moved_m;
                (0..TISSUE).for_each(|i| rows[plane][i] += at.gain_rows[hold][i] * moved_m);
            }
            before_m = *to_m;
        }
        let spread = [0, 1].map(|plane: usize| &at.covariance * &rows[plane]);
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

/// Probability that a normally distributed point lies within a radius of the target.
pub(crate) fn probability_within(miss_m: [f64; 2], covariance_m2: [f64; 3], radius_m: f64) -> f64 {
    let [xx, xy, yy] = covariance_m2;
    // Along the axes of the ellipse.
    let half = 0.5 * (xx - yy);
    let root = half.hypot(xy);
    let middle = 0.5 * (xx + yy);
    let sds = [(middle + root).max(1e-16).sqrt(), (middle - root).max(1e-16).sqrt()];
    let turn = 0.5 * xy.atan2(half);
    let (sin, cos) = turn.sin_cos();
    let at = [cos * miss_m[0] + sin * miss_m[1], -sin * miss_m[0] + cos * miss_m[1]];
    // Midpoints over the first axis, exactly over the second.
    let count = 400;
    let [low, high] = [(-radius_m).max(at[0] - 8.0 * sds[0]), radius_m.min(at[0] + 8.0 * sds[0])];
    if high <= low {
        return 0.0;
    }
    let width = (high - low) / f64::from(count);
    (0..count)
        .map(|i| {
            let x = low + width * (f64::from(i) + 0.5);
            let half_chord = (radius_m * radius_m - x * x).max(0.0).sqrt();
            let density =
                (-0.5 * ((x - at[0]) / sds[0]).powi(2)).exp() / (sds[0] * std::f64::consts::TAU.sqrt());
            let below = |y: f64| normal_cdf((y - at[1]) / sds[1]);
            width * density * (below(half_chord) - below(-half_chord))
        })
        .sum::<f64>()
        .clamp(0.0, 1.0)
}

fn normal_cdf(x: f64) -> f64 {
    0.5 * statrs::function::erf::erfc(-x / std::f64::consts::SQRT_2)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Two planes whose tips miss by so much, of gains as of a needle.
    fn squares(error_mm: [f64; 2]) -> [Square; 2] {
        let gains: Vec<f64> = (0..12).map(|i| -2.0 * (1.0 - f64::from(i) / 12.0) - 0.1).collect();
        error_mm.map(|error_mm| {
            let mut quadratic: Vec<Vec<f64>> =
                gains.iter().map(|a| gains.iter().map(|b| a * b).collect()).collect();
            quadratic.iter_mut().enumerate().for_each(|(i, row)| row[i] += 0.2);
            Square { quadratic, linear: gains.iter().map(|gain| 1e-3 * gain * error_mm).collect() }
        })
    }

    fn cost(squares: &[Square; 2], now_m: [f64; 2], at_m: &[[f64; 2]]) -> f64 {
        let of = |plane: usize| {
            let mut before = now_m[plane];
            let moves: Vec<f64> =
                at_m.iter().map(|at| at[plane] - std::mem::replace(&mut before, at[plane])).collect();
            let Square { quadratic, linear } = &squares[plane];
            let rows = quadratic.iter().zip(&moves).zip(linear);
            rows.map(|((row, own), linear)| {
                own * (linear + 0.5 * row.iter().zip(&moves).map(|(q, m)| q * m).sum::<f64>())
            })
            .sum::<f64>()
        };
        1e6 * (of(0) + of(1))
    }

    #[test]
    fn the_plan_costs_least_among_neighbours_within_travel_and_circles() {
        let circle = Circle { centre_m: [0.2e-3, -0.1e-3], radius_m: 0.9e-3 };
        let now_m = [0.3e-3, 0.1e-3];
        for (error_mm, circles, largest_move_m) in [
            ([0.5, -0.3], vec![None; 12], None),
            ([9.0, -7.0], vec![None; 12], Some(3e-3)),
            ([6.0, 5.0], vec![Some(circle); 12], Some(0.4e-3)),
        ] {
            let bounds = Bounds { travel_m: 2e-3, largest_move_m, circles };
            let squares = squares(error_mm);
            let found = solve(&squares, now_m, &bounds).expect("solved");
            let allowed = |at_m: &[[f64; 2]], slack_m: f64| {
                let far = |a: [f64; 2], b: [f64; 2]| (a[0] - b[0]).hypot(a[1] - b[1]);
                at_m.iter().zip(&bounds.circles).all(|(at, circle)| {
                    at.iter().all(|m| m.abs() <= bounds.travel_m + slack_m)
                        && circle.is_none_or(|circle| far(*at, circle.centre_m) <= circle.radius_m + slack_m)
                }) && bounds.largest_move_m.is_none_or(|most| far(at_m[0], now_m) <= most + slack_m)
            };
            assert!(allowed(&found, 1e-9), "{found:?}");
            let best = cost(&squares, now_m, &found);
            for hold in 0..12 {
                for tail in [false, true] {
                    for angle in 0..24 {
                        let (sin, cos) = (0.2618 * f64::from(angle)).sin_cos();
                        let mut other = found.clone();
                        let moved = if tail { &mut other[hold..] } else { &mut other[hold..=hold] };
                        moved.iter_mut().for_each(|at| *at = [at[0] + 0.02e-3 * cos, at[1] + 0.02e-3 * sin]);
                        assert!(!allowed(&other, 0.0) || cost(&squares, now_m, &other) >= best - 1e-6);
                    }
                }
            }
        }
    }

    #[test]
    fn a_program_that_is_not_finite_is_not_solved() {
        let bounds = Bounds { travel_m: 2e-3, largest_move_m: None, circles: vec![None; 12] };
        assert_eq!(solve(&squares([f64::NAN, 0.0]), [0.0; 2], &bounds), None);
    }
}
