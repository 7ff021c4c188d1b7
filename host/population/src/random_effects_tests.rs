//! Against published numbers, closed forms and Monte Carlo.

use super::*;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

/// Vaccinated with and without tuberculosis, the same of the others, and latitude: 13 trials of BCG (Colditz and others 1994), the
/// documented example of `metafor`.
const BCG: [[f64; 5]; 13] = [
    [4.0, 119.0, 11.0, 128.0, 44.0],
    [6.0, 300.0, 29.0, 274.0, 55.0],
    [3.0, 228.0, 11.0, 209.0, 42.0],
    [62.0, 13536.0, 248.0, 12619.0, 52.0],
    [33.0, 5036.0, 47.0, 5761.0, 13.0],
    [180.0, 1361.0, 372.0, 1079.0, 44.0],
    [8.0, 2537.0, 10.0, 619.0, 19.0],
    [505.0, 87886.0, 499.0, 87892.0, 13.0],
    [29.0, 7470.0, 45.0, 7232.0, 27.0],
    [17.0, 1699.0, 65.0, 1600.0, 42.0],
    [186.0, 50448.0, 141.0, 27197.0, 18.0],
    [5.0, 2493.0, 3.0, 2338.0, 33.0],
    [27.0, 16886.0, 29.0, 17825.0, 33.0],
];

pub(crate) fn bcg(latitude: bool) -> Observations {
    let row = |[tp, tn, cp, cn, at]: &[f64; 5]| {
        let y = (tp / (tp + tn)).ln() - (cp / (cp + cn)).ln();
        let v = 1.0 / tp - 1.0 / (tp + tn) + 1.0 / cp - 1.0 / (cp + cn);
        (y, v, *at)
    };
    let rows: Vec<(f64, f64, f64)> = BCG.iter().map(row).collect();
    Observations {
        y: rows.iter().map(|row| row.0).collect(),
        v: rows.iter().map(|row| row.1).collect(),
        x: if latitude { rows.iter().map(|row| vec![row.2]).collect() } else { Vec::new() },
        levels: Vec::new(),
    }
}

fn near(value: f64, expected: f64, tolerance: f64) {
    assert!((value - expected).abs() < tolerance, "{value}, expected {expected}");
}

#[test]
fn agrees_with_metafor_and_statsmodels_on_their_example() {
    let found = random_effects(&bcg(false)).expect("fitted");
    near(found.tau_total.powi(2), 0.313_243, 1e-6);
    near(found.tau_paule_mandel.powi(2), 0.318_068_45, 1e-7);
    near(found.beta[0].0, -0.714_532, 1e-6);
    // Standard error 0.179782 times the root of Hartung and Knapp's factor 1.0112700.
    near(found.beta[0].1, 0.179_781_5 * 1.011_27f64.sqrt(), 2e-6);
    near(found.q.0, 152.233_008, 1e-5);
    let [low, high] = found.tau_ci95.expect("an interval");
    near(low.powi(2), 0.119_718_36, 1e-7);
    near(high.powi(2), 1.111_479_08, 1e-7);
    near(found.i_squared_percent, 92.22, 5e-3);
    let by_latitude = random_effects(&bcg(true)).expect("fitted");
    near(by_latitude.tau_total.powi(2), 0.076_348, 1e-6);
    near(by_latitude.beta[0].0, 0.251_468, 1e-5);
    near(by_latitude.beta[1].0, -0.029_101_7, 1e-7);
}

/// `subjects` subjects of `sessions` sessions each.
fn drawn(subjects: usize, sessions: usize, tau: [f64; 2], v: f64, seed: u64) -> Observations {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let mut normal = |sd: f64| {
        let draw: f64 = StandardNormal.sample(&mut random);
        sd * draw
    };
    let mut data = Observations { y: Vec::new(), v: Vec::new(), x: Vec::new(), levels: vec![Vec::new()] };
    for subject in 0..subjects {
        let shared = 2.0 + normal(tau[1]);
        for _ in 0..sessions {
            data.y.push(shared + normal(tau[0]) + normal(v.sqrt()));
            data.v.push(v);
            data.levels[0].push(subject);
        }
    }
    data
}

#[test]
fn nested_components_of_a_balanced_design_are_those_of_the_analysis_of_variance() {
    let (subjects, sessions, v) = (12, 4, 0.01);
    let data = drawn(subjects, sessions, [0.1, 0.3], v, 3);
    let found = random_effects(&data).expect("fitted");
    let means: Vec<f64> =
        data.y.chunks(sessions).map(|of| of.iter().sum::<f64>() / sessions as f64).collect();
    let grand = means.iter().sum::<f64>() / subjects as f64;
    let within: f64 = data
        .y
        .chunks(sessions)
        .zip(&means)
        .flat_map(|(of, mean)| of.iter().map(move |y| (y - mean).powi(2)))
        .sum();
    let within = within / (subjects * (sessions - 1)) as f64;
    let between = sessions as f64 * means.iter().map(|mean| (mean - grand).powi(2)).sum::<f64>()
        / (subjects - 1) as f64;
    near(found.tau[0].powi(2), within - v, 1e-6);
    near(found.tau[1].powi(2), (between - within) / sessions as f64, 1e-6);
    let total = found.tau_total.powi(2) + v;
    near(found.icc.expect("levels"), found.tau[1].powi(2) / total, 1e-6);
}

#[test]
fn intervals_have_their_coverage_for_few_sessions_of_unequal_precision() {
    let (mut mean, mut tau, mut new) = (0, 0, 0);
    let draws = 300;
    for seed in 0..draws {
        let mut random = ChaCha8Rng::seed_from_u64(900 + seed);
        let mut normal = || -> f64 { StandardNormal.sample(&mut random) };
        let v: Vec<f64> = (0..15).map(|number| (0.03 + 0.01 * f64::from(number)).powi(2)).collect();
        let y = v.iter().map(|v| 1.0 + 0.15 * normal() + v.sqrt() * normal()).collect();
        let next = 1.0 + 0.15 * normal();
        let found =
            random_effects(&Observations { y, v, x: Vec::new(), levels: Vec::new() }).expect("fitted");
        let holds = |[low, high]: [f64; 2], value: f64| usize::from((low..=high).contains(&value));
        mean += holds(found.beta[0].2, 1.0);
        tau += holds(found.tau_ci95.expect("an interval"), 0.15);
        new += holds(found.prediction95.expect("an interval"), next);
    }
    // Binomial standard deviation 1.3 %.
    for (name, held) in [("mean", mean), ("tau", tau), ("a new session", new)] {
        let percent = 100.0 * held as f64 / draws as f64;
        assert!((91.0..99.0).contains(&percent), "{name}: {percent} %");
    }
}

#[test]
fn one_session_gives_its_own_value_and_nothing_of_the_spread() {
    let one = Observations { y: vec![2.0], v: vec![0.04], x: Vec::new(), levels: Vec::new() };
    let found = random_effects(&one).expect("fitted");
    near(found.beta[0].0, 2.0, 1e-12);
    near(found.beta[0].1, 0.2, 1e-12);
    assert_eq!((found.tau_ci95, found.prediction95), (None, None));
    let two = Observations { x: vec![vec![1.0]], ..one };
    assert!(random_effects(&two).is_none(), "a slope from one session");
}
