//! Zero of a displacement, and of a tip.
//!
//! No magnitude decides, but what the readings are elsewhere in the record, with the error probability [`CHANCE`]:
//!
//! * **The rest at the beginning.** `k` readings of a guide at rest are in any order: that the next `j` are all above or all below them has the
//!   chance `2 / C(k + j, j)`, at each of `n` places. The first place where that is below [`CHANCE`] ends the rest.
//! * **Positions.** Of two readings at rest the difference is as large as either's distance from its zero or larger, whatever the distribution
//!   is (symmetric, with one maximum), so that a reading is nearer to its zero than the median difference with a chance of a half
//!   or more. If all of a record are further away than that, its zero is not where the guide rests.
//! * **Passages.** A record that begins away from its zero and passes it later is one of a position, or begins with the guide displaced. The force is 0 at
//!   the zero of the displacement, and its line over the displacement says at which of the two places it is; an untared force says nothing.
//! * **Tips.** A needle that enters straight has its tip on the straight line at the surface. A tip that leaves it further and further is, at a depth `z0` of
//!   a record down to `z1`, at `z0 / (z1 - z0)` of what it moves in that record, or nearer.

use super::super::align::Correlation;
use super::super::dropouts::CHANCE;
use super::Zero;
use super::series::median;

/// Number of readings at the beginning that are those of a guide at rest: all where it never moves.
pub(super) fn rest(values: &[f64]) -> usize {
    let most_inverse = 2.0 * values.len() as f64 / CHANCE;
    let (mut least, mut greatest) = (f64::INFINITY, f64::NEG_INFINITY);
    for (before, value) in values.iter().enumerate() {
        let is_above = *value > greatest;
        if before > 0 && (is_above || *value < least) {
            // Readings that have to be beyond all before them, until the binomial coefficient is large enough.
            let (mut inverse, mut needed) = (1.0, 0usize);
            while inverse <= most_inverse && before + needed <= values.len() {
                needed += 1;
                inverse *= (before + needed) as f64 / needed as f64;
            }
            let is_beyond = |next: &f64| if is_above { *next > greatest } else { *next < least };
            let next = values.get(before..before + needed).unwrap_or_default();
            if next.len() == needed && next.iter().all(is_beyond) {
                return before;
            }
        }
        (least, greatest) = (least.min(*value), greatest.max(*value));
    }
    values.len()
}

/// Differences of neighbours without their signs, of which the middle one is that of readings at rest.
pub(super) fn usual_step(values: &[f64]) -> f64 {
    median(values.windows(2).map(|pair| (pair[1] - pair[0]).abs()).collect())
}

/// Zero of a displacement, with the reason.
enum Decision {
    AsWritten,
    AsWrittenFor(String),
    Begin(String),
}

/// Decides on the zero of a displacement that begins at `begin_m`.
fn decide(values_m: &[f64], force_n: &[f64], begin_m: f64) -> Decision {
    let [least, most] = range(values_m);
    let nearest = if least > 0.0 { least } else { (-most).max(0.0) };
    if nearest > usual_step(values_m) {
        let [least_mm, most_mm] = [1e3 * least, 1e3 * most];
        return Decision::Begin(format!(
            "is never near 0 ({least_mm:.3} to {most_mm:.3} mm) and taken as a position"
        ));
    }
    let at_rest = values_m.get(..rest(values_m)).filter(|rows| rows.len() > 1).unwrap_or(values_m);
    if begin_m.abs() <= usual_step(at_rest) {
        return Decision::AsWritten;
    }
    let pairs: Vec<(f64, f64)> = values_m.iter().copied().zip(force_n.iter().copied()).collect();
    let (at_zero_n, at_begin_n) = Correlation::of(&pairs).map_or((0.0, 0.0), |line| {
        let [moved_m, mean_n] = [mean(values_m), mean(force_n)];
        let at_zero_n = mean_n - line.slope * moved_m;
        (at_zero_n, at_zero_n + line.slope * begin_m)
    });
    let forces = format!("{at_begin_n:.3} N there and {at_zero_n:.3} N at 0");
    let begins = format!("begins at {:.4} mm and passes 0", 1e3 * begin_m);
    let half_n = 0.5 * (at_begin_n - at_zero_n).abs();
    if at_begin_n.abs() < half_n {
        return Decision::Begin(format!(
            "{begins}; by the force, {forces}, the needle is displaced at 0, so that these are positions"
        ));
    }
    let reason = if at_zero_n.abs() < half_n {
        "as the force says"
    } else {
        "and the force, which is not tared, does not tell which is right"
    };
    Decision::AsWrittenFor(format!(
        "{begins}: its zero is kept, {reason} ({forces}; --zero first takes where it begins)"
    ))
}

fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len() as f64
}

pub(super) fn range(values: &[f64]) -> [f64; 2] {
    values.iter().fold([f64::INFINITY, f64::NEG_INFINITY], |[least, most], value| {
        [least.min(*value), most.max(*value)]
    })
}

/// Counts a displacement from where the run begins, where that is its zero. Of `stride` rows one is a reading, and the others are
/// between readings: their differences are no measure of the readings' own.
pub(super) fn refer_to_zero(
    name: &str,
    values_m: &mut [f64],
    force_n: &[f64],
    (zero, stride): (Zero, usize),
    notes: &mut Vec<String>,
) {
    let readings_m: Vec<f64> = values_m.iter().step_by(stride).copied().collect();
    let begin_m = median(readings_m.iter().take(rest(&readings_m)).copied().collect());
    let decision = match zero {
        Zero::Auto => {
            let force_n: Vec<f64> = force_n.iter().step_by(stride).copied().collect();
            decide(&readings_m, &force_n, begin_m)
        }
        Zero::First => Decision::Begin("is counted from where it begins".to_owned()),
        Zero::Written => Decision::AsWritten,
    };
    match decision {
        Decision::AsWritten => {}
        Decision::AsWrittenFor(why) => notes.push(format!("{name} {why}")),
        Decision::Begin(why) => {
            values_m.iter_mut().for_each(|value| *value -= begin_m);
            notes.push(format!(
                "{name} {why}: its zero is where the run begins, {:.4} mm (--zero written keeps it)",
                1e3 * begin_m
            ));
        }
    }
}

/// Counts a tip from where it enters, where a needle that enters straight shows that it is a position; `is_displaced` where guide 2 is not at its
/// zero there.
pub(super) fn refer_tip(
    name: &str,
    depth_m: &[f64],
    tip_m: &mut [f64],
    (zero, is_displaced): (Zero, bool),
    notes: &mut Vec<String>,
) {
    let shallowest = depth_m.iter().copied().zip(tip_m.iter().copied()).min_by(|a, b| a.0.total_cmp(&b.0));
    let Some((entry_m, entry_tip_m)) = shallowest else { return };
    let first_tip_m = tip_m.first().copied().unwrap_or(0.0);
    let [least_m, most_m] = range(tip_m);
    let deepest_m = range(depth_m)[1];
    let begins_at_surface = entry_m <= usual_step(depth_m);
    let usual_fraction = if begins_at_surface { 0.0 } else { entry_m / (deepest_m - entry_m) };
    let is_absolute = entry_tip_m.abs() > usual_fraction * (most_m - least_m) + usual_step(tip_m);
    let statement = format!("is {:.4} mm at a depth of {:.3} mm", 1e3 * entry_tip_m, 1e3 * entry_m);
    let (zero_m, why) = match zero {
        Zero::Written => return,
        Zero::First => (first_tip_m, "is counted from where it begins".to_owned()),
        Zero::Auto if !is_absolute => return,
        Zero::Auto if begins_at_surface && !is_displaced => (
            entry_tip_m,
            format!("{statement}, where a needle that enters straight is at 0, and taken as a position"),
        ),
        Zero::Auto => {
            notes.push(format!(
                "{name} {statement}, farther from 0 than a needle that entered straight is at this depth: is it a position? It is taken as it is \
                 written (--zero first counts from where it begins)"
            ));
            return;
        }
    };
    tip_m.iter_mut().for_each(|value| *value -= zero_m);
    notes.push(format!("{name} {why}: {:.4} mm is subtracted (--zero written keeps it)", 1e3 * zero_m));
}

/// Whether guide 2 is away from its zero at first.
pub(super) fn is_displaced(guide2_m: Option<&[f64]>) -> bool {
    guide2_m.is_some_and(|values| values.first().is_some_and(|first| first.abs() > usual_step(values)))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Numbers that look random, from -1 to 1.
    fn noise(at: usize) -> f64 {
        ((at * 7919 + 13) * 104_729 % 2003) as f64 / 1001.0 - 1.0
    }

    #[test]
    fn the_rest_ends_where_readings_leave_it_for_good() {
        fn moved(rest: usize, per_row: f64) -> Vec<f64> {
            (0..120).map(|row| noise(row) + per_row * row.saturating_sub(rest) as f64).collect()
        }
        for (values, least, most) in [
            (moved(40, 20.0), 40, 41),
            (moved(40, -20.0), 40, 41),
            // A ramp as slow as the noise ends it some rows later.
            (moved(40, 0.4), 38, 48),
            (moved(6, 5.0), 6, 7),
            (moved(120, 1.0), 120, 120),
        ] {
            assert!((least..=most).contains(&rest(&values)), "{} of {least} to {most}", rest(&values));
        }
    }

    #[test]
    fn a_displacement_whose_zero_is_not_where_the_guide_rests_is_a_position() {
        fn zeroed(offset: f64, digit: f64) -> (usize, f64) {
            let mut values: Vec<f64> = (0..100)
                .map(|row| {
                    let exact =
                        offset + 4e-6 * noise(row) + 1.2e-3 * (0.05 * (row as f64 - 40.0)).clamp(0.0, 1.0);
                    if digit > 0.0 { (exact / digit).round() * digit } else { exact }
                })
                .collect();
            let mut notes = Vec::new();
            refer_to_zero("y", &mut values, &[0.0; 100], (Zero::Auto, 1), &mut notes);
            (notes.len(), values[0])
        }
        assert_eq!(zeroed(0.0, 0.0).0, 0);
        assert_eq!(zeroed(0.0, 1e-5).0, 0);
        assert_eq!(zeroed(-2e-6, 0.0).0, 0);
        for offset in [0.05e-3, 12.4e-3, -2.5e-3] {
            for digit in [0.0, 1e-5] {
                let (notes, first) = zeroed(offset, digit);
                assert!(notes == 1 && first.abs() <= 1e-5, "{offset} {digit}: {notes} {first}");
            }
        }
    }

    /// Staircase of the guide between these levels, millimetres.
    fn stairs(levels: &[f64]) -> Vec<f64> {
        let mut values = Vec::new();
        for pair in levels.windows(2) {
            values
                .extend((0..10).map(|step| 1e-3 * (pair[0] + (pair[1] - pair[0]) * f64::from(step) / 10.0)));
            values.extend([1e-3 * pair[1]; 30]);
        }
        values
    }

    /// Displacement of row 0 and of the last one after the import of positions, and what is noted.
    fn imported(positions_m: &[f64], force_n: impl Fn(f64) -> f64, digits_m: f64) -> ([f64; 2], Vec<String>) {
        let force: Vec<f64> =
            positions_m.iter().enumerate().map(|(at, y_m)| force_n(*y_m) + 0.01 * noise(at)).collect();
        let mut values: Vec<f64> =
            positions_m.iter().map(|y_m| (y_m / digits_m).round() * digits_m).collect();
        let mut notes = Vec::new();
        refer_to_zero("y", &mut values, &force, (Zero::Auto, 1), &mut notes);
        ([values[0], values[values.len() - 1]].map(|m| 1e3 * m), notes)
    }

    #[test]
    fn a_position_that_passes_its_zero_is_told_by_the_force() {
        fn is_near(values: [f64; 2], right: [f64; 2]) -> bool {
            values.iter().zip(right).all(|(a, b)| (a - b).abs() < 1e-6)
        }
        // Positions, where the force is 0, and the displacement of the first and the last row.
        for (levels, free_mm, right) in [
            (&[-1.2, -1.2, 1.8, -1.2][..], -1.2, [0.0, 0.0]),
            (&[1.5, 1.5, 4.5, 0.0], 1.5, [0.0, -1.5]),
            (&[-0.05, -0.05, 1.0, -2.0], -0.05, [0.0, -1.95]),
            // The record begins with the guide displaced.
            (&[1.2, 1.2, 0.0, -1.0], 0.0, [1.2, -1.0]),
            (&[-0.4, -0.4, 0.6, 0.0], 0.0, [-0.4, 0.0]),
        ] {
            let positions = stairs(levels);
            let (values, notes) = imported(&positions, |y_m| 600.0 * (y_m - 1e-3 * free_mm), 1e-9);
            assert!(is_near(values, right) && notes.len() == 1, "{levels:?}: {values:?} {notes:?}");
            // A force that was never tared decides nothing, and that is noted.
            let (values, notes) = imported(&positions, |y_m| 5.0 + 600.0 * (y_m - 1e-3 * free_mm), 1e-9);
            assert!(
                is_near(values, [levels[0], levels[3]]) && notes[0].contains("not tared"),
                "{levels:?}: {notes:?}"
            );
        }
        let (values, notes) = imported(&stairs(&[0.0, 0.0, 2.0, 0.0]), |y_m| 600.0 * y_m, 1e-5);
        assert!(is_near(values, [0.0, 0.0]) && notes.is_empty(), "{values:?} {notes:?}");
    }

    #[test]
    fn a_tip_that_is_off_the_line_where_the_needle_enters_is_a_position() {
        // First depth, constant in the tip, bow, whether guide 2 is displaced; the first tip afterwards and the number of notes.
        for (first_mm, constant_mm, bow, is_displaced, right_mm, count) in [
            (0.0, 12.4, 1.2e-3, false, 0.0, 1),
            (0.0, -0.8, 1.2e-3, false, 0.0, 1),
            (-5.0, 45.0, 1.2e-3, false, 0.0, 1),
            (0.0, 0.0, 1.2e-3, false, 0.0, 0),
            (0.0, 0.0, -1.2e-3, false, 0.0, 0),
            (20.0, 0.0, 1.2e-3, false, 0.48, 0),
            (20.0, 12.4, 1.2e-3, false, 12.88, 1),
            (0.0, 1.5, 1.2e-3, true, 1.5, 1),
        ] {
            let depth: Vec<f64> = (0..60).map(|row| 1e-3 * (first_mm + f64::from(row))).collect();
            let mut tip: Vec<f64> =
                depth.iter().map(|z_m| 1e-3 * (constant_mm + bow * (1e3 * z_m.max(0.0)).powi(2))).collect();
            let mut notes = Vec::new();
            refer_tip("tip_y_mm", &depth, &mut tip, (Zero::Auto, is_displaced), &mut notes);
            let is_right = (1e3 * tip[0] - right_mm).abs() < 1e-9 && notes.len() == count;
            assert!(is_right, "{first_mm} {constant_mm}: {} {notes:?}", 1e3 * tip[0]);
            let mut tip_written = [12.4e-3; 60];
            refer_tip("tip_y_mm", &depth, &mut tip_written, (Zero::Written, false), &mut notes);
            assert_eq!(tip_written[0], 12.4e-3);
        }
    }
}
