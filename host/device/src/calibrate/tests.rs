//! Readings of rigs whose constants are known.

use super::*;
use formats::calibration_file::knot_codes;
use protocol::{CalibrationRecord, KNOTS, PotentiometerTable, Text};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

fn before() -> CalibrationRecord {
    let table = PotentiometerTable {
        track_codes: [40, 4055],
        rising_um: knot_codes().map(|code| ((f64::from(code) - 2048.0) * 12.207_031).round() as i16),
        falling_um: knot_codes().map(|code| ((f64::from(code) - 2048.0) * 12.207_031).round() as i16),
    };
    CalibrationRecord {
        id: Text::new("unit-7"),
        potentiometers: [table, table],
        travel_um: 10_000,
        force_pn_per_code: [[931_323, 0], [0, 931_323]],
        force_range_mn: 5_000,
    }
}

/// Box-Muller: the tests' own noise.
fn normal(random: &mut ChaCha8Rng) -> f64 {
    let (u, v): (f64, f64) = (1.0 - random.random::<f64>(), random.random());
    (-2.0 * u.ln()).sqrt() * (std::f64::consts::TAU * v).cos()
}

const RESPONSE: [[f64; 2]; 2] = [[1.04, -0.03], [0.05, 0.97]];
const OFFSET_N: [f64; 2] = [0.02, -0.01];

fn loaded(load_n: [f64; 2], noise_n: f64, random: &mut ChaCha8Rng) -> ForceReading {
    let reported_n = std::array::from_fn(|row| {
        RESPONSE[row][0] * load_n[0] + RESPONSE[row][1] * load_n[1] + OFFSET_N[row] + noise_n * normal(random)
    });
    ForceReading { load_n, reported_n }
}

const LOADS_N: [[f64; 2]; 6] =
    [[0.0, 0.0], [0.981, 0.0], [-1.962, 0.0], [0.0, 0.981], [0.0, -1.962], [1.0, 1.0]];

#[test]
fn known_loads_give_the_matrix_that_reports_them() {
    let mut random = ChaCha8Rng::seed_from_u64(1);
    let readings: Vec<_> = LOADS_N.iter().map(|load_n| loaded(*load_n, 0.0, &mut random)).collect();
    let fit = fit_force(&readings, &before()).unwrap();
    let [[a, b], [c, d]] = fit.record.force_pn_per_code.map(|row| row.map(f64::from));
    for reading in &readings {
        // Codes that correspond to the reported forces by the old matrix, times the new one.
        let codes = [0, 1].map(|axis| (reading.reported_n[axis] - OFFSET_N[axis]) / 931_323e-12);
        let now_n = [a * codes[0] + b * codes[1], c * codes[0] + d * codes[1]].map(|pn| 1e-12 * pn);
        for (now_n, load_n) in now_n.into_iter().zip(reading.load_n) {
            assert!((now_n - load_n).abs() < 5e-6, "{now_n} N for {load_n} N");
        }
    }
    assert!((fit.offset_n[0].value - 0.02).abs() < 1e-9 && fit.residual_sd_n.unwrap() < 1e-9);
}

#[test]
fn intervals_of_the_response_hold_the_truth_as_often_as_stated() {
    let mut random = ChaCha8Rng::seed_from_u64(2);
    let (mut covered, repeats) = (0, 1_000);
    for _ in 0..repeats {
        let readings: Vec<_> = LOADS_N.iter().map(|load_n| loaded(*load_n, 0.01, &mut random)).collect();
        let fit = fit_force(&readings, &before()).unwrap();
        for (row, truth) in fit.response.iter().zip(RESPONSE) {
            for (estimate, truth) in row.iter().zip(truth) {
                let [low, high] = estimate.ci95.unwrap();
                covered += u32::from((low..=high).contains(&truth));
            }
        }
    }
    let coverage = f64::from(covered) / f64::from(4 * repeats);
    assert!((0.93..0.97).contains(&coverage), "{coverage}");
}

#[test]
fn loads_along_one_line_and_too_few_are_refused_with_what_is_missing() {
    let mut random = ChaCha8Rng::seed_from_u64(3);
    fn of(loads: &[[f64; 2]], random: &mut ChaCha8Rng) -> Result<Option<f64>, CalibrateError> {
        let readings: Vec<_> = loads.iter().map(|load_n| loaded(*load_n, 1e-3, random)).collect();
        fit_force(&readings, &before()).map(|fit| fit.residual_sd_n)
    }
    assert_eq!(of(&LOADS_N[..2], &mut random), Err(CalibrateError::TooFew { count: 2, least: 3 }));
    let error = of(&[[0.0, 0.0], [1.0, 0.0], [2.0, 0.0], [-1.0, 0.0]], &mut random).unwrap_err();
    assert!(matches!(error, CalibrateError::OneDirection { main_deg, .. } if main_deg < 1.0), "{error}");
    // Three readings determine it, and nothing remains for an interval.
    assert_eq!(of(&[[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]], &mut random), Ok(None));
}

#[test]
fn forces_a_thousand_times_too_small_are_no_rig() {
    let mut random = ChaCha8Rng::seed_from_u64(4);
    let readings = LOADS_N.map(|load_n| {
        let ForceReading { reported_n, .. } = loaded(load_n, 0.0, &mut random);
        ForceReading { load_n, reported_n: reported_n.map(|n| 1e-2 * n) }
    });
    let error = fit_force(&readings, &before()).unwrap_err();
    assert!(matches!(error, CalibrateError::Implausible(_) | CalibrateError::Unrelated { .. }), "{error}");
}

/// An actuator that is longer than its table states, bends, and has play.
fn true_um(reported_um: f64, rises: bool) -> f64 {
    1.02 * reported_um + 4e-6 * reported_um.powi(2) - if rises { 0.0 } else { 80.0 }
}

fn gauged(noise_um: f64, both_ways: bool, random: &mut ChaCha8Rng) -> Vec<GaugeReading> {
    let upward = (-10..=10).map(|step| (1_000.0 * f64::from(step), true));
    let downward = (-10..=10).rev().map(|step| (1_000.0 * f64::from(step) - 50.0, false));
    upward
        .chain(downward.filter(|_| both_ways))
        .map(|(reported_um, rises)| GaugeReading {
            gauge_m: 1e-6 * (true_um(reported_um, rises) + noise_um * normal(random)),
            reported_m: 1e-6 * reported_um,
        })
        .collect()
}

#[test]
fn a_gauge_gives_the_table_within_its_travel_and_the_play() {
    let mut random = ChaCha8Rng::seed_from_u64(5);
    let fit = fit_position(&gauged(8.0, true, &mut random), 1, &before()).unwrap();
    assert_eq!(fit.record.potentiometers[0], before().potentiometers[0], "x stays");
    let table = &fit.record.potentiometers[1];
    // Knots within the travel; the bend between them is what straight lines leave.
    for knot in 3..KNOTS - 3 {
        let old_um = f64::from(before().potentiometers[1].rising_um[knot]);
        let error_um = f64::from(table.rising_um[knot]) - true_um(old_um, true);
        assert!(error_um.abs() < 45.0, "{error_um} um at {old_um}");
        let error_um = f64::from(table.falling_um[knot]) - true_um(old_um, false);
        assert!(error_um.abs() < 45.0, "{error_um} um at {old_um}, falling");
    }
    let play = fit.play_m.unwrap();
    let [low_m, high_m] = play.ci95.unwrap();
    assert!((play.value - 80e-6).abs() < 20e-6 && (low_m..=high_m).contains(&80e-6), "{play:?}");
    assert!((fit.scale - 1.02).abs() < 2e-3 && (fit.largest_error_m - 640e-6).abs() < 60e-6, "{fit:?}");
}

#[test]
fn intervals_of_the_play_hold_the_truth_as_often_as_stated() {
    let mut random = ChaCha8Rng::seed_from_u64(6);
    let (mut covered, repeats) = (0, 600);
    for _ in 0..repeats {
        let readings: Vec<_> = gauged(10.0, true, &mut random)
            .into_iter()
            // Without the bend, which lines between knots do not follow exactly.
            .map(|reading| GaugeReading {
                gauge_m: reading.gauge_m - 4e-6 * 1e6 * reading.reported_m.powi(2),
                ..reading
            })
            .collect();
        let fit = fit_position(&readings, 0, &before()).unwrap();
        let [low_m, high_m] = fit.play_m.unwrap().ci95.unwrap();
        // The table holds whole micrometres.
        covered += u32::from((low_m - 1e-6..=high_m + 1e-6).contains(&80e-6));
    }
    let coverage = f64::from(covered) / f64::from(repeats);
    assert!((0.92..=0.99).contains(&coverage), "{coverage}");
}

#[test]
fn one_way_gives_no_play_and_a_gauge_of_the_wrong_sign_no_table() {
    let mut random = ChaCha8Rng::seed_from_u64(7);
    let readings = gauged(5.0, false, &mut random);
    assert_eq!(fit_position(&readings, 0, &before()).unwrap().play_m, None);
    let reversed: Vec<_> =
        readings.iter().map(|reading| GaugeReading { gauge_m: -reading.gauge_m, ..*reading }).collect();
    assert_eq!(fit_position(&reversed, 0, &before()).unwrap_err(), CalibrateError::Opposite);
    let repeated: Vec<_> =
        readings.iter().filter(|reading| reading.reported_m.abs() < 1e-9).cycle().take(5).copied().collect();
    assert!(matches!(fit_position(&repeated, 0, &before()), Err(CalibrateError::ShortRange { .. })));
    assert!(matches!(
        fit_position(&readings[..3], 0, &before()),
        Err(CalibrateError::TooFew { count: 3, .. })
    ));
}
