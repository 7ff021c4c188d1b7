//! Holds and levels on generated series.

use super::*;
use formats::session::{ForceSeries, Mark, ShapeSeries};
use noise::Noise;
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
    let (mut time_s, mut position_mm) = (0.0, levels_mm[0]);
    let mut force = ForceSeries::default();
    let mut push = |time_s: f64, position_mm: f64| {
        let measured = position_mm + noise_mm * noise.normal();
        let measured = if step_mm > 0.0 { (measured / step_mm).round() * step_mm } else { measured };
        force.time_s.push(time_s);
        force.displacement_y_m.push(1e-3 * measured);
        force.force_y_n.push(0.8 * position_mm + 0.05 * noise.normal());
    };
    for level_mm in levels_mm {
        while (level_mm - position_mm).abs() > 1e-9 {
            position_mm += (level_mm - position_mm).clamp(-speed_mm_s / rate_hz, speed_mm_s / rate_hz);
            push(time_s, position_mm);
            time_s += 1.0 / rate_hz;
        }
        for _ in 0..(hold_s * rate_hz) as usize {
            push(time_s, position_mm);
            time_s += 1.0 / rate_hz;
        }
    }
    LateralRun {
        id: "simulated".to_owned(),
        depth_m: 0.03,
        force_path: PathBuf::new(),
        shape_path: PathBuf::new(),
        provenance: Default::default(),
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
                let detected = holds(&run, &HoldCriteria::default());
                let case = format!("{rate_hz} Hz, {speed_mm_s} mm/s, noise {noise_mm}, rounding {step_mm}");
                let means: Vec<f64> = detected.iter().map(|l| 1e3 * l.displacement_y_m.value).collect();
                assert_eq!(detected.len(), steps.len(), "{case}: {means:.3?}");
                for (level, expected_mm) in detected.iter().zip(steps) {
                    let error_mm = 1e3 * level.displacement_y_m.value - expected_mm;
                    assert!(
                        error_mm.abs() < 0.015 + 0.5 * step_mm,
                        "{case}: {expected_mm} off by {error_mm}"
                    );
                    let length_s = level.time_s[1] - level.time_s[0];
                    assert!((2.2..=3.7).contains(&length_s), "{case}: {expected_mm} held {length_s} s");
                }
                use Path::{Loading, Unloading, Zero};
                let paths: Vec<Path> = detected.iter().map(|level| level.path).collect();
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
            let detected = holds(&run, &HoldCriteria::default());
            assert!(detected.is_empty(), "{speed_mm_s} mm/s at {rate_hz} Hz: {} holds", detected.len());
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

/// Readings of which half of the variance is correlated over three samples, in holds of 60 samples.
#[test]
fn means_of_short_holds_err_as_much_as_stated() {
    let mut noise = Noise::new(5);
    let neighbours = (-1.0f64 / 3.0).exp();
    // With each hold's own correlation it is 1.4; three holds leave a part of it.
    for (holds, most) in [(3, 1.25), (9, 1.15)] {
        let (mut squares, mut count) = (0.0, 0.0);
        for _ in 0..300 {
            let stretches: Vec<Vec<f64>> = (0..holds)
                .map(|_| {
                    let mut slow = noise.normal();
                    (0..60)
                        .map(|_| {
                            slow =
                                neighbours * slow + (1.0 - neighbours * neighbours).sqrt() * noise.normal();
                            0.5f64.sqrt() * (slow + noise.normal())
                        })
                        .collect()
                })
                .collect();
            let slices: Vec<&[f64]> = stretches.iter().map(Vec::as_slice).collect();
            let hold_means = means(&slices);
            let freedom = hold_means.len() as f64;
            let scatter = (hold_means.iter().map(|mean| mean.scatter.powi(2)).sum::<f64>() / freedom).sqrt();
            squares += hold_means.iter().map(|m| (m.value / m.standard_error(scatter)).powi(2)).sum::<f64>();
            count += freedom;
        }
        let ratio = squares / count;
        assert!((0.75..most).contains(&ratio), "{holds} holds: {ratio}");
    }
}

#[test]
fn a_hold_that_drifts_has_fewer_independent_samples_than_the_others() {
    let mut noise = Noise::new(6);
    let quiet: Vec<f64> = (0..400).map(|_| noise.normal()).collect();
    let drifting: Vec<f64> = (0..400).map(|i| 0.02 * f64::from(i) + noise.normal()).collect();
    let hold_means = means(&[&quiet, &quiet, &quiet, &drifting]);
    assert!(hold_means[3].effective_samples < 0.2 * hold_means[0].effective_samples, "{hold_means:?}");
    assert_eq!(hold_means[3].value, mean(&drifting).value);
    assert_eq!(means(&[&[2.0, 2.0], &[]])[0].effective_samples, 2.0);
}

#[test]
fn shape_points_go_to_their_holds() {
    let mut run = staircase(&[0.0, 1.2, 0.0], 3.0, 2.0, 50.0, 0.01, 0.0);
    run.shape = ShapeSeries {
        time_s: Some(vec![1.0, 3.3, 5.0, 5.0, 8.0]),
        z_m: vec![0.08; 5],
        y_m: vec![0.0; 5],
        ..ShapeSeries::default()
    };
    let points: Vec<_> = holds(&run, &HoldCriteria::default()).into_iter().map(|level| level.shape).collect();
    assert_eq!(points, [vec![0], vec![2, 3], vec![4]]);

    run.shape.time_s = None;
    let points: Vec<_> = holds(&run, &HoldCriteria::default()).into_iter().map(|level| level.shape).collect();
    assert_eq!(points, [vec![], vec![0, 1, 2, 3, 4], vec![]]);
}

#[test]
fn lost_samples_are_counted_inside_holds_only() {
    let mut run = staircase(&[0.0, 1.2, 0.0], 3.0, 2.0, 50.0, 0.01, 0.0);
    let mut lost = vec![0.0; run.force.time_s.len()];
    lost[160] = 5.0;
    lost[250] = 3.0;
    run.force.lost_before = Some(lost);
    let counts: Vec<_> = holds(&run, &HoldCriteria::default()).into_iter().map(|l| l.lost_samples).collect();
    assert_eq!(counts, [0, 3, 0]);
}

#[test]
fn empty_and_tiny_series_have_no_levels() {
    for rate_hz in [1.0, 10.0] {
        let mut run = staircase(&[0.0], 0.3, 1.0, rate_hz, 0.0, 0.0);
        assert!(holds(&run, &HoldCriteria::default()).is_empty());
        run.force = ForceSeries::default();
        assert!(holds(&run, &HoldCriteria::default()).is_empty());
    }
}

/// Marks of the rows of [`staircase`]: moves and holds in turn, from a hold.
fn marks(levels_mm: &[f64], hold_s: f64, speed_mm_s: f64, rate_hz: f64, kinds: bool) -> Vec<Mark> {
    let mut marks = Vec::new();
    let mut push = |step: u32, moving: bool, rows: usize| {
        marks.extend(std::iter::repeat_n(Mark { step: Some(step), moving: kinds.then_some(moving) }, rows));
    };
    let mut position_mm = levels_mm[0];
    for (level_mm, step) in levels_mm.iter().zip(0..) {
        let move_rows = ((level_mm - position_mm).abs() / speed_mm_s * rate_hz - 1e-6).ceil() as usize;
        push(2 * step, true, move_rows);
        push(2 * step + 1, false, (hold_s * rate_hz) as usize);
        position_mm = *level_mm;
    }
    marks
}

#[test]
fn marked_holds_lie_within_their_steps() {
    let steps = [0.0, 0.4, 0.8, 1.2, 0.8, 0.0, -0.6, -1.2, 0.0];
    for kinds in [true, false] {
        for (rate_hz, speed_mm_s, noise_mm) in [(1000.0, 1.0, 0.002), (200.0, 0.2, 0.02), (100.0, 5.0, 0.0)] {
            let mut run = staircase(&steps, 1.2, speed_mm_s, rate_hz, noise_mm, 0.0);
            let marks = marks(&steps, 1.2, speed_mm_s, rate_hz, kinds);
            assert_eq!(marks.len(), run.force.time_s.len());
            run.force.marks = Some(marks.clone());
            let planes = [run.force.displacement_y_m.as_slice()];
            let spans = find_marked_holds(&run.force.time_s, &planes, &marks, &HoldCriteria::default());
            assert_eq!(spans.len(), steps.len(), "{rate_hz} Hz, {speed_mm_s} mm/s");
            for (hold, step) in spans.iter().zip(0..) {
                let is_within_step =
                    marks[hold.rows.clone()].iter().all(|mark| mark.step == Some(2 * step + 1));
                assert!(is_within_step, "{rate_hz} Hz, {speed_mm_s} mm/s: {hold:?}");
            }
            let detected = holds(&run, &HoldCriteria::default());
            for (level, expected_mm) in detected.iter().zip(steps) {
                assert!((1e3 * level.displacement_y_m.value - expected_mm).abs() < 0.01, "{expected_mm}");
            }
        }
    }
}

#[test]
fn two_steps_at_one_place_are_two_holds_and_a_move_is_none() {
    let mut run = staircase(&[0.5], 6.0, 1.0, 100.0, 0.002, 0.0);
    assert_eq!(holds(&run, &HoldCriteria::default()).len(), 1);
    let marks = [[mark(0, false); 200], [mark(1, true); 200], [mark(2, false); 200]].concat();
    run.force.marks = Some(marks);
    let detected = holds(&run, &HoldCriteria::default());
    let times: Vec<[f64; 2]> = detected.iter().map(|level| level.time_s).collect();
    assert_eq!(times.len(), 2, "{times:?}");
    assert!(times[0][1] < 2.0 && times[1][0] >= 4.0, "{times:?}");
}

fn mark(step: u32, moving: bool) -> Mark {
    Mark { step: Some(step), moving: Some(moving) }
}

#[test]
fn rows_outside_a_program_are_searched_as_ever() {
    let mut run = staircase(&[0.0, 1.2, 0.0], 3.0, 2.0, 50.0, 0.01, 0.0);
    let plain = holds(&run, &HoldCriteria::default());
    run.force.marks = Some(vec![Mark::default(); run.force.time_s.len()]);
    assert_eq!(holds(&run, &HoldCriteria::default()), plain);
}

#[test]
fn a_hold_after_a_ramp_that_has_not_settled_is_found() {
    // The guide arrives 0.3 s after the step has begun.
    let mut run = staircase(&[0.0, 1.0], 2.0, 1.0, 100.0, 0.001, 0.0);
    run.force.marks =
        Some([vec![mark(0, false); 200], vec![mark(1, true); 70], vec![mark(2, false); 230]].concat());
    let detected = holds(&run, &HoldCriteria::default());
    assert_eq!(detected.len(), 2);
    assert!((1e3 * detected[1].displacement_y_m.value - 1.0).abs() < 0.002, "{:?}", detected[1]);
}

/// Time of the last row of every hold of [`staircase`].
fn hold_ends_s(levels_mm: &[f64], hold_s: f64, speed_mm_s: f64, rate_hz: f64) -> Vec<f64> {
    let marks = marks(levels_mm, hold_s, speed_mm_s, rate_hz, true);
    let ends =
        (0..marks.len()).filter(|row| marks.get(row + 1).is_none_or(|next| next.step != marks[*row].step));
    ends.filter(|row| marks[*row].moving == Some(false)).map(|row| row as f64 / rate_hz).collect()
}

#[test]
fn a_sweep_stamped_within_the_last_sample_of_a_hold_belongs_to_it() {
    let steps = [0.0, 0.4, 1.2, 0.0, -1.2, 0.0];
    for rate_hz in [10.0, 20.0, 50.0, 1000.0] {
        for speed_mm_s in [0.2, 1.0, 5.0] {
            let mut run = staircase(&steps, 3.0, speed_mm_s, rate_hz, 0.01, 0.0);
            let ends_s = hold_ends_s(&steps, 3.0, speed_mm_s, rate_hz);
            for share in [-1.0, 0.0, 0.5, 0.9] {
                // If a move takes less than a sample the stamp is that of the next hold as well.
                if share > 0.5 && 0.4 / speed_mm_s * rate_hz < 1.0 {
                    continue;
                }
                let stamps = ends_s.iter().flat_map(|end_s| [end_s + share / rate_hz; 4]);
                run.shape = ShapeSeries {
                    time_s: Some(stamps.collect()),
                    z_m: (0..4 * steps.len()).map(|i| 0.075 + 0.005 * (i % 4) as f64).collect(),
                    y_m: vec![0.0; 4 * steps.len()],
                    ..ShapeSeries::default()
                };
                let (detected, strays) = survey(&run, &HoldCriteria::default());
                let case = format!("{rate_hz} Hz, {speed_mm_s} mm/s, {share} samples after the last");
                assert_eq!(strays, [], "{case}");
                for (number, level) in detected.iter().enumerate() {
                    assert_eq!(level.shape, (4 * number..4 * number + 4).collect::<Vec<_>>(), "{case}");
                    let observed_s = level.observed_s(ends_s[number] + share / rate_hz);
                    // A slow ramp is still within the tolerance of a hold for a while.
                    assert!(
                        observed_s <= ends_s[number] + 0.05 / speed_mm_s,
                        "{case}: the needle moves at {observed_s} s"
                    );
                }
            }
        }
    }
}

#[test]
fn sweeps_that_no_hold_takes_are_listed_with_their_reasons() {
    let steps = [0.0, 1.2, 0.0];
    let mut run = staircase(&steps, 3.0, 0.5, 50.0, 0.01, 0.0);
    // A scan that starts in the first hold and goes on while guide 2 moves, a sweep on the way back, one after the end, and in the
    // second hold a point beyond the tip.
    let ends_s = hold_ends_s(&steps, 3.0, 0.5, 50.0);
    let scan = (0..8).map(|i| ends_s[0] - 0.85 + 0.2 * f64::from(i));
    let stamps = scan.chain([ends_s[1] + 1.0, 40.0, ends_s[1] - 1.0]);
    let z_m = [0.072, 0.075, 0.078, 0.081, 0.084, 0.087, 0.090, 0.093, 0.080, 0.080, 0.150];
    run.shape = ShapeSeries {
        time_s: Some(stamps.collect()),
        z_m: z_m.to_vec(),
        y_m: vec![0.0; 11],
        ..ShapeSeries::default()
    };
    let mut lost = vec![0.0; run.force.time_s.len()];
    let last = lost.len() - 40;
    lost[last] = 2.0;
    run.force.lost_before = Some(lost);
    let rig = mechanics::Rig::two_guides(mechanics::Needle::gauge_18(), 0.06, 0.07);
    let unused_parts = unused(&run, &rig, &HoldCriteria::default());
    let counts: Vec<(&str, usize)> = unused_parts.iter().map(|part| (part.part, part.count)).collect();
    let hold = holds(&run, &HoldCriteria::default())[2].displacement_y_m.samples;
    assert_eq!(
        counts,
        [("hold", hold), ("points", 3), ("sweep", 1), ("sweep", 1), ("points", 1)],
        "{unused_parts:#?}"
    );
    let reasons =
        ["lost 2 samples", "guide 2 moves", "guide 2 moves", "both clocks", "100.0 mm from guide 1"];
    for (part, reason) in unused_parts.iter().zip(reasons) {
        assert!(part.reason.contains(reason), "{part}");
    }
    assert_eq!(summary(&unused_parts).len(), 5);
    assert_eq!(
        summary(&[unused_parts[2].clone(), unused_parts[2].clone()])[0].split(" (").next(),
        Some("2 sweeps")
    );
}

#[test]
fn noise_of_a_displacement_is_no_motion_and_a_small_step_is() {
    for (rate_hz, noise_mm) in [(20.0, 0.01), (200.0, 0.01), (1000.0, 0.002), (20.0, 0.03)] {
        let still = staircase(&[0.0], 60.0, 1.0, rate_hz, noise_mm, 0.0);
        let readings_m = &still.force.displacement_y_m;
        let threshold_m = reversal_m(readings_m, &[]);
        let span_m = readings_m.iter().fold(0.0_f64, |most, m| most.max(*m))
            - readings_m.iter().fold(0.0_f64, |least, m| least.min(*m));
        assert!(span_m < threshold_m && threshold_m < 12e-3 * noise_mm, "{rate_hz} Hz: {threshold_m}");
    }
    // Rounding to steps that toggle, and an exact staircase.
    let hold = std::iter::once(0..300).collect::<Vec<_>>();
    let coarse = staircase(&[0.004, 1.2, 0.004], 3.0, 1.0, 100.0, 0.003, 0.01);
    let threshold_m = reversal_m(&coarse.force.displacement_y_m, &hold);
    assert!((0.01e-3..0.06e-3).contains(&threshold_m), "{threshold_m}");
    let exact = staircase(&[0.0, 1.2, 0.0], 3.0, 1.0, 100.0, 0.0, 0.0);
    assert!(reversal_m(&exact.force.displacement_y_m, &hold) < 0.05e-3);
    // One that was computed has nothing between its levels, which are no grid of a sensor.
    let computed: Vec<f64> = [0.0, 0.4e-3, 0.8e-3, 0.0].into_iter().flat_map(|m| [m; 60]).collect();
    assert!(reading_sd_m(&computed, &hold) < 1e-9);
    // On the way from level to level a coarse sensor shows its grid.
    let passed: Vec<f64> =
        computed.chunks(60).flat_map(|level| [&[level[0] - 0.1e-3; 7], level].concat()).collect();
    assert!((reading_sd_m(&passed, &[]) / (0.1e-3 / 12f64.sqrt()) - 1.0).abs() < 1e-6);
}

/// Levels four standard deviations of a reading apart, read twenty times a second: no single reading tells them apart, their means do.
#[test]
fn levels_that_no_single_reading_tells_apart_are_holds_of_their_own() {
    let levels_mm = [0.0, 0.4, 0.8, 1.2, 0.8, 0.4, 0.0];
    let run = staircase(&levels_mm, 3.0, 1.0, 20.0, 0.1, 0.0);
    let found_mm: Vec<f64> =
        holds(&run, &HoldCriteria::default()).iter().map(|hold| 1e3 * hold.displacement_y_m.value).collect();
    assert_eq!(found_mm.len(), levels_mm.len(), "{found_mm:?}");
    assert!(
        found_mm.iter().zip(levels_mm).all(|(found, level)| (found - level).abs() < 0.06),
        "{found_mm:?}"
    );
}
