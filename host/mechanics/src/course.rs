//! Separates motion of guide 2 from noise of its sensor in the readings.

/// Motion that is rounding of the numbers.
const MIN_REVERSAL_M: f64 = 1e-9;
/// Share of a reversal from which on the way back is distinguished from noise.
const NOTICED: f64 = 0.25;

/// Position of guide 2, from readings one after the other: it goes on where a reading is further in the direction of
/// the last motion, and stays where one is further back by less than a reversal. It has turned round once it has come
/// back by more than `reversal_m`, and it has done so when it came back by a quarter of that: two standard deviations
/// of its noise.
pub(crate) fn course_m(readings_m: &[f64], reversal_m: f64) -> Vec<f64> {
    let reversal_m = reversal_m.max(MIN_REVERSAL_M);
    let mut direction = 0.0;
    let mut extreme_m = readings_m.first().copied().unwrap_or_default();
    let mut course: Vec<f64> = Vec::with_capacity(readings_m.len());
    for at_m in readings_m {
        let moved_m = at_m - extreme_m;
        if moved_m * direction > 0.0 {
            extreme_m = *at_m;
        } else if moved_m.abs() > reversal_m {
            direction = moved_m.signum();
            let on_the_way = |m: &&f64| (*m - extreme_m) * direction > NOTICED * reversal_m;
            let previous_m = readings_m.get(..course.len()).unwrap_or_default();
            let first = course.len() - previous_m.iter().rev().take_while(on_the_way).count();
            for (place, reading_m) in course.iter_mut().zip(previous_m).skip(first) {
                if (reading_m - extreme_m) * direction > 0.0 {
                    extreme_m = *reading_m;
                }
                *place = extreme_m;
            }
            if (at_m - extreme_m) * direction > 0.0 {
                extreme_m = *at_m;
            }
        }
        course.push(extreme_m);
    }
    course
}

/// Sign of the last motion at every reading; 0 before the first.
pub(crate) fn directions(readings_m: &[f64], reversal_m: f64) -> Vec<f64> {
    let course_m = course_m(readings_m, reversal_m);
    let mut previous_m = course_m.first().copied().unwrap_or_default();
    let mut direction = 0.0;
    course_m
        .iter()
        .map(|at_m| {
            if *at_m != previous_m {
                direction = (at_m - previous_m).signum();
            }
            previous_m = *at_m;
            direction
        })
        .collect()
}

/// Speed at every reading, m/s, with the sign of the last motion, which it keeps at rest. Readings that are no further off than noise from one of them are
/// one way with its mean speed, which ends before the first that is.
pub(crate) fn speeds_m_per_s(times_s: &[f64], readings_m: &[f64], reversal_m: f64) -> Vec<f64> {
    let readings: Vec<(f64, f64)> = times_s.iter().copied().zip(readings_m.iter().copied()).collect();
    let mut speeds = vec![0.0; readings_m.len().min(1)];
    let mut first = 0;
    for (number, (_, at_m)) in readings.iter().enumerate().skip(1) {
        if readings.get(first).is_some_and(|(_, first_m)| (at_m - first_m).abs() > reversal_m) {
            speeds.resize(number, speed_between(first, number - 1, &readings));
            speeds.push(speed_between(number - 1, number, &readings));
            first = number;
        }
    }
    speeds.resize(readings_m.len(), speed_between(first, readings.len().saturating_sub(1), &readings));
    let directed = directions(readings_m, reversal_m).into_iter().zip(speeds);
    // At rest no number but the sign is left of it.
    directed.map(|(direction, speed)| direction * speed.max(f64::MIN_POSITIVE)).collect()
}

/// Mean speed between two readings.
fn speed_between(from: usize, to: usize, readings: &[(f64, f64)]) -> f64 {
    match (readings.get(from), readings.get(to)) {
        (Some((from_s, from_m)), Some((to_s, to_m))) if to_s > from_s => {
            (to_m - from_m).abs() / (to_s - from_s)
        }
        _ => 0.0,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_speed_is_that_of_a_way_and_keeps_its_sign_at_rest() {
        let times_s: Vec<f64> = (0..9).map(|i| 0.5 * f64::from(i)).collect();
        let readings_m = [0.0, 1.0, 2.0, 2.01, 1.99, 2.0, 1.0, 0.0, 0.01];
        let speeds = speeds_m_per_s(&times_s, &readings_m, 0.1);
        assert_eq!(speeds[..3], [0.0, 2.0, 2.0]);
        assert!(speeds[3..6].iter().all(|speed| (0.0..0.02).contains(speed) && *speed > 0.0), "{speeds:?}");
        assert_eq!(speeds[6..8], [-2.0, -2.0]);
        assert!(speeds[8] < 0.0 && speeds[8] > -0.03, "{speeds:?}");
        assert!(speeds_m_per_s(&[], &[], 0.1).is_empty());
    }

    #[test]
    fn noise_is_no_motion_and_a_way_back_begins_where_it_began() {
        let readings_m = [0.0, 0.02, -0.03, 0.5, 0.48, 1.0, 1.03, 0.97, 1.01, 0.95, 0.6, 0.62, 0.0];
        let course = course_m(&readings_m, 0.1);
        assert_eq!(course, [0.0, 0.0, 0.0, 0.5, 0.5, 1.0, 1.03, 1.03, 1.03, 0.95, 0.6, 0.6, 0.0]);
        let directions = directions(&readings_m, 0.1);
        assert_eq!(directions, [0.0, 0.0, 0.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, -1.0, -1.0, -1.0, -1.0]);
    }

    #[test]
    fn without_noise_every_reading_is_motion() {
        let readings_m = [0.3, 0.3, 0.1, 0.2, 0.2, -0.1];
        assert_eq!(course_m(&readings_m, 0.0), readings_m);
        assert_eq!(directions(&readings_m, 0.0), [0.0, 0.0, -1.0, 1.0, 1.0, -1.0]);
        assert!(course_m(&[], 0.1).is_empty());
    }
}
