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
    1e6 * (plane_cost(0, now_m, at_m, squares) + plane_cost(1, now_m, at_m, squares))
}

fn plane_cost(plane: usize, now_m: [f64; 2], at_m: &[[f64; 2]], squares: &[Square; 2]) -> f64 {
    let mut previous = now_m[plane];
    let moves: Vec<f64> =
        at_m.iter().map(|at| at[plane] - std::mem::replace(&mut previous, at[plane])).collect();
    let Square { quadratic, linear } = &squares[plane];
    let rows = quadratic.iter().zip(&moves).zip(linear);
    rows.map(|((row, own), linear)| {
        own * (linear + 0.5 * row.iter().zip(&moves).map(|(q, m)| q * m).sum::<f64>())
    })
    .sum::<f64>()
}

/// A limit at a stop that moves up to there take part in, the earlier the less: of a mean that is there anyway.
fn cone(stop: usize, stay: [f64; 2]) -> Cone {
    let per_move = (0..12).map(|j| if j <= stop { 600.0 * 0.9_f64.powi((stop - j) as i32) } else { 0.0 });
    Cone::new(Limit::Strain, (stop, 1), stay, per_move.collect(), 0.9)
}

fn plan_of(error_mm: [f64; 2], now_m: [f64; 2], bounds: &Bounds) -> Option<Vec<[f64; 2]>> {
    within(&squares(error_mm), now_m, bounds).map(|(guide_m, _)| guide_m)
}

#[test]
fn the_plan_costs_least_among_neighbours_within_travel_and_limits() {
    let now_m = [0.3e-3, 0.1e-3];
    let start_cones: Vec<Cone> = (0..12).map(|stop| cone(stop, [0.3, -0.1])).collect();
    for (error_mm, cones, largest_move_m) in [
        ([0.5, -0.3], &start_cones[..0], None),
        ([9.0, -7.0], &start_cones[..0], Some(3e-3)),
        ([6.0, 5.0], &start_cones[..], Some(0.4e-3)),
        ([2.0, -3.0], &start_cones[..], None),
    ] {
        let bounds = Bounds { travel_m: 2e-3, largest_move_m, cones, deviation_m: 0.0 };
        let squares = squares(error_mm);
        let (optimum, limits) = within(&squares, now_m, &bounds).expect("solved");
        assert_eq!(limits.iter().any(|(limit, _)| *limit == Limit::Strain), !cones.is_empty(), "{limits:?}");
        let allowed = |at_m: &[[f64; 2]], slack: f64| {
            at_m.iter().flatten().all(|m| m.abs() <= bounds.travel_m + 1e-3 * slack)
                && cones.iter().all(|cone| cone.used(&moves(now_m, at_m)) <= 1.0 + slack)
                && bounds
                    .largest_move_m
                    .is_none_or(|most| distance_between(at_m[0], now_m) <= most + 1e-3 * slack)
        };
        assert!(allowed(&optimum, 2.0 * SOLVED), "{optimum:?}");
        let best = cost(&squares, now_m, &optimum);
        for hold in 0..12 {
            for tail in [false, true] {
                for angle in 0..24 {
                    let (sin, cos) = (0.2618 * f64::from(angle)).sin_cos();
                    let mut neighbour = optimum.clone();
                    let moved = if tail { &mut neighbour[hold..] } else { &mut neighbour[hold..=hold] };
                    moved.iter_mut().for_each(|at| *at = [at[0] + 0.02e-3 * cos, at[1] + 0.02e-3 * sin]);
                    assert!(!allowed(&neighbour, 0.0) || cost(&squares, now_m, &neighbour) >= best - 1e-3);
                }
            }
        }
    }
}

fn distance_between(a: [f64; 2], b: [f64; 2]) -> f64 {
    (a[0] - b[0]).hypot(a[1] - b[1])
}

/// A needle that is bent beyond its limit already, however it is moved: the plan is the one that bends it least beyond, and not none.
#[test]
fn a_limit_that_is_exceeded_anyway_is_exceeded_as_little_as_can_be() {
    let cones = [cone(0, [3.0, 0.0])];
    let bounds = Bounds { travel_m: 1e-3, largest_move_m: None, cones: &cones, deviation_m: 0.0 };
    let optimum = plan_of([1.0, 1.0], [0.0; 2], &bounds).expect("solved");
    assert!(optimum[0][0] < -0.99e-3, "back as far as it goes: {optimum:?}");
}

/// Capacity for later corrections is kept free: the guide goes earlier where later the limit will be needed for
/// corrections.
#[test]
fn with_a_deviation_to_come_the_later_part_of_the_way_is_less_loaded() {
    let mut cones: Vec<Cone> = (0..12).map(|stop| cone(stop, [0.2, 0.0])).collect();
    cones.iter_mut().skip(4).for_each(|cone| cone.per_correction = 250.0);
    let (free_plan, reserved_plan) = (loaded_fraction(0.0, &cones), loaded_fraction(1.5e-3, &cones));
    assert!(reserved_plan < 0.95 * free_plan, "{reserved_plan} of the limit, {free_plan} without");
}

fn loaded_fraction(deviation_m: f64, cones: &[Cone]) -> f64 {
    let bounds = Bounds { travel_m: 6e-3, largest_move_m: None, cones, deviation_m };
    let guide_m = plan_of([-4.0, 0.0], [0.0; 2], &bounds).expect("solved");
    let moves_m = moves([0.0; 2], &guide_m);
    cones.iter().skip(4).map(|cone| cone.used(&moves_m)).fold(0.0, f64::max)
}

#[test]
fn a_program_that_is_not_finite_is_not_solved() {
    let bounds = Bounds { travel_m: 2e-3, largest_move_m: None, cones: &[], deviation_m: 0.0 };
    assert_eq!(plan_of([f64::NAN, 0.0], [0.0; 2], &bounds), None);
}
