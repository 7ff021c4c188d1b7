//! Holds and levels on made-up series.

use super::*;
use crate::session::ForceSeries;
use crate::testing::Noise;
use std::path::PathBuf;

/// A staircase: ramps at `speed` between the levels, each held for `hold_s`; displacement and force 800 N/m.
fn staircase(
    levels_mm: &[f64],
    hold_s: f64,
    speed_mm_s: f64,
    rate_hz: f64,
    noise_mm: f64,
    step_mm: f64,
) -> LateralRun {
    let mut noise = Noise::new(7);
    let (mut time_s, mut at_mm) = (0.0, levels_mm[0]);
    let mut force = ForceSeries::default();
    let mut push = |time_s: f64, at_mm: f64| {
        let seen = at_mm + noise_mm * noise.normal();
        let seen = if step_mm > 0.0 { (seen / step_mm).round() * step_mm } else { seen };
        force.time_s.push(time_s);
        force.displacement_y_m.push(1e-3 * seen);
        force.force_y_n.push(0.8 * at_mm + 0.05 * noise.normal());
    };
    for level_mm in levels_mm {
        while (level_mm - at_mm).abs() > 1e-9 {
            at_mm += (level_mm - at_mm).clamp(-speed_mm_s / rate_hz, speed_mm_s / rate_hz);
            push(time_s, at_mm);
            time_s += 1.0 / rate_hz;
        }
        for _ in 0..(hold_s * rate_hz) as usize {
            push(time_s, at_mm);
            time_s += 1.0 / rate_hz;
        }
    }
    LateralRun {
        id: "made-up".to_owned(),
        depth_m: 0.03,
        force_path: PathBuf::new(),
        shape_path: PathBuf::new(),
        force,
        shape: ShapeSeries::default(),
    }
}

#[test]
fn staircases_are_found_at_any_rate_speed_and_rounding() {
    let steps = [0.0, 0.4, 0.8, 1.2, 0.8, 0.0, -0.6, -1.2, 0.0];
    for rate_hz in [10.0, 20.0, 50.0, 200.0, 2000.0] {
        for speed_mm_s in [0.2, 1.0, 5.0] {
            for (noise_mm, step_mm) in [(0.0, 0.0), (0.02, 0.0), (0.005, 0.01), (0.002, 0.05), (0.02, 0.02)] {
                let run = staircase(&steps, 3.0, speed_mm_s, rate_hz, noise_mm, step_mm);
                let found = levels(&run, &HoldCriteria::default());
                let case = format!("{rate_hz} Hz, {speed_mm_s} mm/s, noise {noise_mm}, rounding {step_mm}");
                let means: Vec<f64> = found.iter().map(|l| 1e3 * l.displacement_y_m.value).collect();
                assert_eq!(found.len(), steps.len(), "{case}: {means:.3?}");
                for (level, expected_mm) in found.iter().zip(steps) {
                    let error_mm = 1e3 * level.displacement_y_m.value - expected_mm;
                    assert!(
                        error_mm.abs() < 0.015 + 0.5 * step_mm,
                        "{case}: {expected_mm} off by {error_mm}"
                    );
                    let length_s = level.time_s[1] - level.time_s[0];
                    assert!((2.2..=3.7).contains(&length_s), "{case}: {expected_mm} held {length_s} s");
                }
                use Path::{Loading, Unloading, Zero};
                let paths: Vec<Path> = found.iter().map(|level| level.path).collect();
                let expected = [Zero, Loading, Loading, Loading, Unloading, Zero, Loading, Loading, Zero];
                assert_eq!(paths, expected, "{case}");
            }
        }
    }
}

#[test]
fn a_ramp_is_no_hold() {
    for speed_mm_s in [0.2, 0.5, 1.0] {
        for rate_hz in [10.0, 100.0, 1000.0] {
            let run = staircase(&[0.0, 3.0], 0.0, speed_mm_s, rate_hz, 0.02, 0.0);
            let found = levels(&run, &HoldCriteria::default());
            assert!(found.is_empty(), "{speed_mm_s} mm/s at {rate_hz} Hz: {} holds", found.len());
        }
    }
}

#[test]
fn standard_error_accounts_for_correlation() {
    let mut noise = Noise::new(3);
    let white: Vec<f64> = (0..4000).map(|_| noise.normal()).collect();
    let effective = mean(&white).effective_samples;
    assert!(effective > 3000.0, "{effective}");
    // First-order autoregression with coefficient 0.9: n (1 - 0.9) / (1 + 0.9) independent samples.
    let mut state = 0.0;
    let red: Vec<f64> = (0..4000)
        .map(|_| {
            state = 0.9 * state + noise.normal();
            state
        })
        .collect();
    let effective = mean(&red).effective_samples;
    assert!((140.0..320.0).contains(&effective), "{effective}");
    assert_eq!(mean(&[2.0, 2.0]).scatter, 0.0);
    assert_eq!(mean(&[2.0]).effective_samples, 1.0);
}

#[test]
fn shape_points_go_to_their_holds() {
    let mut run = staircase(&[0.0, 1.2, 0.0], 3.0, 2.0, 50.0, 0.01, 0.0);
    run.shape = ShapeSeries {
        time_s: Some(vec![1.0, 3.3, 5.0, 5.0, 8.0]),
        z_m: vec![0.08; 5],
        y_m: vec![0.0; 5],
        x_m: None,
    };
    let points: Vec<_> =
        levels(&run, &HoldCriteria::default()).into_iter().map(|level| level.shape).collect();
    assert_eq!(points, [vec![0], vec![2, 3], vec![4]]);

    run.shape.time_s = None;
    let points: Vec<_> =
        levels(&run, &HoldCriteria::default()).into_iter().map(|level| level.shape).collect();
    assert_eq!(points, [vec![], vec![0, 1, 2, 3, 4], vec![]]);
}

#[test]
fn lost_samples_are_counted_inside_holds_only() {
    let mut run = staircase(&[0.0, 1.2, 0.0], 3.0, 2.0, 50.0, 0.01, 0.0);
    let mut lost = vec![0.0; run.force.time_s.len()];
    lost[160] = 5.0;
    lost[250] = 3.0;
    run.force.lost_before = Some(lost);
    let counts: Vec<_> = levels(&run, &HoldCriteria::default()).into_iter().map(|l| l.lost_samples).collect();
    assert_eq!(counts, [0, 3, 0]);
}

#[test]
fn empty_and_tiny_series_have_no_levels() {
    for rate_hz in [1.0, 10.0] {
        let mut run = staircase(&[0.0], 0.3, 1.0, rate_hz, 0.0, 0.0);
        assert!(levels(&run, &HoldCriteria::default()).is_empty());
        run.force = ForceSeries::default();
        assert!(levels(&run, &HoldCriteria::default()).is_empty());
    }
}
