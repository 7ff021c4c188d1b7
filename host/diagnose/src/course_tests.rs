//! Known trajectories of guide 2, read with noise.

use super::*;
use noise::Noise;

const MM: f64 = 1e-3;
const CELL_S: f64 = 0.05;

/// A guide that stands until `start_s`, moves by a millimetre within a second, and stands again. The cells of `gap` belong to no hold.
struct Ramp {
    time_s: Vec<f64>,
    truth_m: Vec<f64>,
    hold: Vec<Option<usize>>,
}

impl Ramp {
    fn new(start_s: f64, gap: Range<usize>) -> Self {
        let time_s: Vec<f64> = (0..60).map(|cell| CELL_S * f64::from(cell)).collect();
        let truth_m = time_s.iter().map(|s| MM * (s - start_s).clamp(0.0, 1.0)).collect();
        let hold =
            (0..60).map(|cell| if gap.contains(&cell) { None } else { Some(usize::from(cell >= gap.end)) });
        Self { time_s, truth_m, hold: hold.collect() }
    }

    fn read(&self, random: &mut Noise, sd_m: f64) -> Vec<f64> {
        self.truth_m.iter().map(|m| m + sd_m * random.normal()).collect()
    }

    fn course(&self, read_m: &[f64], sd_m: f64) -> (Vec<f64>, Vec<Window>) {
        let length_s = vec![0.0; read_m.len()];
        let track = Track { time_s: &self.time_s, length_s: &length_s, read_m, hold: &self.hold, sd_m };
        course(&track, &[0.0, MM])
    }
}

/// For ramps that begin anywhere in a cell the noise is reduced, the remaining error has the stated covariance, and there is no delay.
#[test]
fn noise_is_taken_off_as_far_as_stated_and_leaves_no_delay() {
    let mut random = Noise::new(7);
    for (sd_m, gap) in [(0.02 * MM, 17..43), (0.1 * MM, 17..43), (0.1 * MM, 24..36)] {
        let (mut squares, mut stated, mut of_readings) = (0.0, 0.0, 0.0);
        let mut delays = Vec::new();
        for number in 0..100 {
            let ramp = Ramp::new(1.0 + CELL_S * f64::from(number) / 100.0, gap.clone());
            let read_m = ramp.read(&mut random, sd_m);
            let (positions_m, windows) = ramp.course(&read_m, sd_m);
            let [Window { cells, covariance }] = windows.as_slice() else { panic!("{windows:?}") };
            // Motion at both ends of the gap is hidden in the noise.
            assert!(cells.start <= gap.start && cells.end >= gap.end && cells.len() < 60, "{cells:?}");
            assert!(covariance.symmetric_eigenvalues().min() > 0.0, "{covariance}");
            let (mut projection, mut slopes) = (0.0, 0.0);
            for cell in 1..60 {
                let error_m = positions_m[cell] - ramp.truth_m[cell];
                squares += error_m * error_m;
                of_readings +=
                    (read_m[cell] - ramp.truth_m[cell]).powi(2) * f64::from(u8::from(cells.contains(&cell)));
                let speed_m_per_s = (positions_m[cell] - positions_m[cell - 1]) / CELL_S;
                projection += error_m * speed_m_per_s;
                slopes += speed_m_per_s.powi(2);
            }
            stated += covariance.trace() * sd_m * sd_m;
            delays.push(projection / slopes);
        }
        assert!(squares < 0.4 * of_readings, "{}", squares / of_readings);
        assert!((0.5..1.3).contains(&(squares / stated)), "{}", squares / stated);
        let count = delays.len() as f64;
        let mean_s = delays.iter().sum::<f64>() / count;
        let error_s = (delays.iter().map(|s| (s - mean_s).powi(2)).sum::<f64>() / count / count).sqrt();
        assert!(mean_s.abs() < 4.0 * error_s, "{} ms, standard error {} ms", 1e3 * mean_s, 1e3 * error_s);
    }
}

#[test]
fn a_sensor_without_noise_is_followed() {
    let ramp = Ramp::new(1.013, 17..43);
    for sd_m in [0.0, 1e-9, 1e-6] {
        let (positions_m, _) = ramp.course(&ramp.truth_m, sd_m);
        assert!(
            positions_m.iter().zip(&ramp.truth_m).all(|(a, b)| (a - b).abs() < 1.5 * sd_m + 1e-12),
            "{sd_m}"
        );
    }
}

#[test]
fn single_readings_beyond_a_hold_are_noise_and_several_in_a_row_are_motion() {
    let time_s: Vec<f64> = (0..30).map(|i| CELL_S * f64::from(i)).collect();
    let followed = |readings: &[f64]| {
        let mut read_m = vec![0.0; 10];
        read_m.extend_from_slice(readings);
        read_m.resize(30, 1.0);
        let gap = 10..10 + readings.len();
        let hold: Vec<Option<usize>> =
            (0..30).map(|i| (!gap.contains(&i)).then_some(usize::from(i >= gap.end))).collect();
        let track = Track { time_s: &time_s, length_s: &[0.0; 30], read_m: &read_m, hold: &hold, sd_m: 0.01 };
        course(&track, &[0.0, 1.0]).0[gap].to_vec()
    };
    let noisy = followed(&[0.0, 0.25, 0.5, 0.75, 1.0, 1.0, 1.03, 1.0, 1.0, 1.0]);
    assert!(noisy[6] < 1.018, "{noisy:?}");
    let overshoot = [0.2, 0.5, 0.9, 1.05, 1.06, 1.06, 1.05, 1.04, 1.02, 1.0];
    let motion = followed(&overshoot);
    assert!(motion.iter().zip(overshoot).all(|(a, b)| (a - b).abs() < 0.03), "{motion:?}");
}

/// Before the first hold and after the last one guide 2 may come from anywhere.
#[test]
fn an_end_of_a_recording_is_followed_as_far_as_it_is_no_noise() {
    let mut random = Noise::new(3);
    let sd_m = 0.05 * MM;
    let hold: Vec<Option<usize>> = (0..40).map(|cell| (20..30).contains(&cell).then_some(0)).collect();
    let time_s: Vec<f64> = (0..40).map(|cell| CELL_S * f64::from(cell)).collect();
    let (mut squares, mut of_readings) = (0.0, 0.0);
    for _ in 0..20 {
        // Guide 2 moves into the hold, and stays there.
        let truth_m: Vec<f64> = time_s.iter().map(|s| MM * (s - 0.8).min(0.0)).collect();
        let read_m: Vec<f64> = truth_m.iter().map(|m| m + sd_m * random.normal()).collect();
        let track = Track { time_s: &time_s, length_s: &[0.0; 40], read_m: &read_m, hold: &hold, sd_m };
        let (positions_m, windows) = course(&track, &[0.0]);
        assert_eq!(windows.iter().map(|window| window.cells.clone()).collect::<Vec<_>>(), [0..25, 25..40]);
        for ((position_m, reading_m), truth_m) in positions_m.iter().zip(&read_m).zip(&truth_m) {
            squares += (position_m - truth_m).powi(2);
            of_readings += (reading_m - truth_m).powi(2);
        }
    }
    assert!(squares < 0.4 * of_readings, "{}", squares / of_readings);
}

#[test]
fn positions_of_stretches_share_the_error_of_their_window() {
    let window = Window { cells: 2..4, covariance: DMatrix::from_row_slice(2, 2, &[4.0, 1.0, 1.0, 2.0]) };
    assert_eq!(window.covariance_of(&[2, 3], &[2, 3]), 2.0);
    // Cells outside the window share no error.
    assert_eq!(window.covariance_of(&[1, 2], &[3, 4]), 0.25);
    assert_eq!(window.covariance_of(&[0], &[2]), 0.0);
}

/// For a motion between two readings of a sensor without noise the trajectory is that of the readings.
#[test]
fn a_step_between_two_exact_readings_is_followed() {
    for [from_m, to_m] in [[0.0, 0.4e-3], [0.4e-3, 0.8e-3], [1.2e-3, 0.0]] {
        let time_s: Vec<f64> = (0..40).map(|i| 0.05 * f64::from(i)).collect();
        let read_m: Vec<f64> = (0..40).map(|i| if i < 20 { from_m } else { to_m }).collect();
        let hold: Vec<Option<usize>> = (0..40)
            .map(|i| match i {
                0..18 => Some(0),
                18..22 => None,
                _ => Some(1),
            })
            .collect();
        for sd_m in [1e-7, 1e-6, 1e-5] {
            let track = Track { time_s: &time_s, length_s: &[0.0; 40], read_m: &read_m, hold: &hold, sd_m };
            let (positions_m, _) = course(&track, &[from_m, to_m]);
            for (position_m, read_m) in positions_m.iter().zip(&read_m) {
                assert!((position_m - read_m).abs() < 3.0 * sd_m, "{sd_m}: {position_m} {read_m}");
            }
        }
    }
}
