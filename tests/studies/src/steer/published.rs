//! Controllers that have no model of the tissue, beside which the one of `guide steer` is measured.

use super::{DEPTH_MM, Ended};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use steering::{Command, Plant, PlantError};
use worlds::steering::SimulatedPlant;

/// Distance of stops, mm.
const EVERY_MM: usize = 5;
/// Readings at a stop, of which the median is taken, and steps of a guide move, 0.1 s each.
const READINGS: usize = 12;
const MOVE_STEPS: u32 = 30;

/// A plant that is pushed and held.
struct Pushed {
    plant: SimulatedPlant,
    at: Command,
}

impl Pushed {
    fn new(plant: SimulatedPlant) -> Self {
        let command = Command { bevel_deg: plant.stated.bevel_deg, ..Command::default() };
        Self { plant, at: command }
    }

    fn push_to(&mut self, depth_mm: usize) -> Result<(), PlantError> {
        while self.at.depth_mm < depth_mm as f64 {
            self.at = Command { t_s: self.at.t_s + 0.25, depth_mm: self.at.depth_mm + 1.0, ..self.at };
            self.plant.step(&self.at)?;
        }
        Ok(())
    }

    /// Median of the readings of a stop, mm.
    fn tip_mm(&mut self) -> Result<[f64; 2], PlantError> {
        let mut tips = Vec::new();
        for _ in 0..READINGS {
            self.at.t_s += 0.1;
            let answer = self.plant.step(&self.at)?;
            tips.push([answer.tip_x_mm, answer.tip_y_mm]);
        }
        Ok([0, 1].map(|plane: usize| {
            let mut values: Vec<f64> = tips.iter().map(|tip| tip[plane]).collect();
            values.sort_by(f64::total_cmp);
            values[values.len() / 2]
        }))
    }

    /// Largest displacement of the guide that is used, mm.
    fn travel_mm(&self) -> f64 {
        0.98 * self.plant.stated.limits.guide_travel_mm
    }

    fn guide_mm(&self) -> [f64; 2] {
        [self.at.guide_x_mm, self.at.guide_y_mm]
    }

    fn move_guide(&mut self, to_mm: [f64; 2]) -> Result<(), PlantError> {
        let start_mm = self.guide_mm();
        for step in 1..=MOVE_STEPS {
            let fraction = f64::from(step) / f64::from(MOVE_STEPS);
            self.at.t_s += 0.1;
            self.at.guide_x_mm = start_mm[0] + fraction * (to_mm[0] - start_mm[0]);
            self.at.guide_y_mm = start_mm[1] + fraction * (to_mm[1] - start_mm[1]);
            self.plant.step(&self.at)?;
        }
        Ok(())
    }

    fn end(mut self, target_mm: [f64; 3]) -> Result<Ended, PlantError> {
        self.push_to(DEPTH_MM as usize)?;
        let end = self.plant.end()?;
        let [x, y] = self.plant.tip_mm();
        let miss_mm = (x - target_mm[0]).hypot(y - target_mm[1]);
        Ok(Ended::with_miss(Some(miss_mm), end.limits_broken.map_or(0, |broken| broken.total())))
    }
}

/// Stops every 5 mm, and moves the guide by a share of the distance between the last reading and the straight way to the target: far
/// beyond the surface, the tip ends on the other side.
pub(super) fn proportional(
    plant: SimulatedPlant,
    target_mm: [f64; 3],
    seed: u64,
    number: u64,
) -> Result<Ended, PlantError> {
    const SHARE: f64 = 0.5;
    let mut rng = ChaCha8Rng::seed_from_u64(seed ^ 0x9a);
    rng.set_stream(number);
    // Its stops begin anywhere in the first 5 mm.
    let first_mm: usize = rng.random_range(2..=5);
    let mut pushed = Pushed::new(plant);
    for depth in (10..=80).filter(|depth| (depth - first_mm).is_multiple_of(EVERY_MM)) {
        pushed.push_to(depth)?;
        let tip_mm = pushed.tip_mm()?;
        let (now_mm, travel_mm) = (pushed.guide_mm(), pushed.travel_mm());
        let command_mm = [0, 1].map(|plane: usize| {
            let line_mm = target_mm[plane] * depth as f64 / DEPTH_MM;
            (now_mm[plane] + SHARE * (tip_mm[plane] - line_mm)).clamp(-travel_mm, travel_mm)
        });
        pushed.move_guide(command_mm)?;
    }
    pushed.end(target_mm)
}

/// Aim of the published controller on the way.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Aim {
    /// The target's x and y from the first step on, as published: its targets lay straight ahead.
    Target,
    /// The straight line from the entry point to the target, which is the same where the target lies straight ahead.
    Line,
}

/// Quantity that is not learned but taken from the plant itself: where the published controller fails, which of its
/// parts does.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Given {
    /// No quantity.
    Nothing,
    /// Effect of a guide move on the tip at the next stop: the Jacobian that it learns, without error.
    NextStop,
    /// Effect at the target's depth, and the tip's end there by the learned Jacobian if the guide stays.
    AtTarget,
    /// Both.
    AtTargetWithPath,
}

/// Guide move by which a plant's response is found, mm.
const PROBE_MM: f64 = 0.2;

/// Tip of a copy of the plant at a depth if the guide is moved by so much now, mm.
fn ahead_mm(pushed: &Pushed, moved_mm: f64, depth_mm: usize) -> Result<[f64; 2], PlantError> {
    let mut copy = Pushed { plant: pushed.plant.clone(), at: pushed.at };
    let now_mm = copy.guide_mm();
    copy.move_guide(now_mm.map(|mm| mm + moved_mm))?;
    copy.push_to(depth_mm)?;
    Ok(copy.plant.tip_mm())
}

/// The published controller (Bernardes 2023): a Jacobian of the tip with respect to guide and depth, updated by Broyden's rule (weight
/// 0.65) after every push and after every guide move, each by itself as in its published program, at stops every 5 mm, and the guide positions of the next four stops, within the guide's travel, that minimise the predicted
/// squared distances. It begins with the Jacobian that its published recordings begin with. Its cost of the tip's direction is
/// omitted: these plants have no sensor of it, and with angles in radians it is a hundredth of the cost of the distances. With one
/// Jacobian for all four steps and no cost of moves the program is separable and solved exactly, step by step.
pub(super) fn broyden(
    plant: SimulatedPlant,
    target_mm: [f64; 3],
    aim: Aim,
    given: Given,
) -> Result<Ended, PlantError> {
    /// Tip per guide displacement before the first update.
    const START: f64 = -0.5;
    let mut pushed = Pushed::new(plant);
    // Rows: x and y of the tip; columns: guide x, guide y, depth.
    let mut jacobian = Jacobian::new([[START, 0.0, 0.0], [0.0, START, 0.0]]);
    let mut last = (pushed.tip_mm()?, [0.0, 0.0, 0.0]);
    for depth in (EVERY_MM..DEPTH_MM as usize).step_by(EVERY_MM) {
        pushed.push_to(depth)?;
        let tip_mm = pushed.tip_mm()?;
        let [x_mm, y_mm] = pushed.guide_mm();
        let input = [x_mm, y_mm, depth as f64];
        jacobian.update(last, (tip_mm, input));
        last = (tip_mm, input);
        // Position of the tip at the next stop if the guide stays.
        let change_ahead = jacobian.change([0.0, 0.0, EVERY_MM as f64]);
        let [of_x, of_y] = [gain(0, &jacobian), gain(1, &jacobian)];
        let (ahead_depth, is_known) = match given {
            Given::Nothing => (depth + EVERY_MM, false),
            Given::NextStop => (depth + EVERY_MM, true),
            Given::AtTarget | Given::AtTargetWithPath => (DEPTH_MM as usize, true),
        };
        if is_known {
            // Both planes at once: what a move along one does across it is small.
            let still_mm = self::ahead_mm(&pushed, 0.0, ahead_depth)?;
            let moved_mm = self::ahead_mm(&pushed, PROBE_MM, ahead_depth)?;
            let gain = [0, 1].map(|plane: usize| (moved_mm[plane] - still_mm[plane]) / PROBE_MM);
            let remaining_mm = (ahead_depth - depth) as f64;
            let still_mm = match given {
                Given::AtTargetWithPath => still_mm,
                _ => {
                    let change_ahead = jacobian.change([0.0, 0.0, remaining_mm]);
                    [0, 1].map(|plane: usize| tip_mm[plane] + change_ahead[plane])
                }
            };
            let command_mm = [0, 1].map(|plane: usize| {
                let missing_mm = target_mm[plane] - still_mm[plane];
                let now_mm = [x_mm, y_mm][plane];
                let move_mm = if gain[plane].abs() > 1e-3 { missing_mm / gain[plane] } else { 0.0 };
                (now_mm + move_mm).clamp(-pushed.travel_mm(), pushed.travel_mm())
            });
            pushed.move_guide(command_mm)?;
            let tip_mm = pushed.tip_mm()?;
            let input = [command_mm[0], command_mm[1], depth as f64];
            jacobian.update(last, (tip_mm, input));
            last = (tip_mm, input);
            continue;
        }
        let aim_fraction = match aim {
            Aim::Target => 1.0,
            Aim::Line => (depth + EVERY_MM) as f64 / DEPTH_MM,
        };
        let missing = [0, 1].map(|plane: usize| {
            let still_mm = tip_mm[plane] + change_ahead[plane];
            aim_fraction * target_mm[plane] - still_mm + of_x[plane] * x_mm + of_y[plane] * y_mm
        });
        let guide = [0, 1].map(|plane: usize| [of_x[plane], of_y[plane]]);
        pushed.move_guide(nearest(guide, missing, pushed.travel_mm()))?;
        let tip_mm = pushed.tip_mm()?;
        let [x_mm, y_mm] = pushed.guide_mm();
        let input = [x_mm, y_mm, depth as f64];
        jacobian.update(last, (tip_mm, input));
        last = (tip_mm, input);
    }
    pushed.end(target_mm)
}

fn gain(input: usize, jacobian: &Jacobian<2>) -> [f64; 2] {
    jacobian.change([0, 1, 2].map(|i: usize| f64::from(u8::from(i == input))))
}

/// Share of the last step's error that an update takes in.
const WEIGHT: f64 = 0.65;

/// A Jacobian by Broyden's rule, as published: what `N` readings do per guide displacement (two planes) and depth.
#[derive(Debug, Clone, PartialEq)]
pub struct Jacobian<const N: usize>([[f64; 3]; N]);

impl<const N: usize> Jacobian<N> {
    /// Before the first update.
    pub fn new(rows: [[f64; 3]; N]) -> Self {
        Self(rows)
    }

    /// Change of the readings for such changes of guide and depth.
    pub fn change(&self, moved: [f64; 3]) -> [f64; N] {
        self.0.map(|row| row.iter().zip(moved).map(|(slope, moved)| slope * moved).sum())
    }

    /// Broyden's rule: the smallest change of the Jacobian that explains so large a share of the last step. States are readings and input,
    /// in mm: lengths of very different units would make the smallest change another.
    pub fn update(&mut self, before: ([f64; N], [f64; 3]), after: ([f64; N], [f64; 3])) {
        let moved = [0, 1, 2].map(|i: usize| after.1[i] - before.1[i]);
        let square: f64 = moved.iter().map(|value| value * value).sum();
        let predicted = self.change(moved);
        for (i, row) in self.0.iter_mut().enumerate() {
            let missing = after.0[i] - before.0[i] - predicted[i];
            // A step in which nothing was moved explains nothing.
            row.iter_mut()
                .zip(moved)
                .for_each(|(slope, moved)| *slope += WEIGHT * missing * moved / (square + 1e-9));
        }
    }
}

/// The guide position within its travel whose effect is nearest to what is requested: a quadratic program of two variables, by
/// coordinate descent.
fn nearest(gain: [[f64; 2]; 2], requested: [f64; 2], travel_mm: f64) -> [f64; 2] {
    let mut guide_mm = [0.0; 2];
    for _ in 0..200 {
        for i in 0..2 {
            let other_axis = 1 - i;
            let residual =
                [0, 1].map(|plane: usize| requested[plane] - gain[plane][other_axis] * guide_mm[other_axis]);
            let square = gain[0][i].powi(2) + gain[1][i].powi(2);
            let gradient = gain[0][i] * residual[0] + gain[1][i] * residual[1];
            guide_mm[i] = if square > 0.0 { (gradient / square).clamp(-travel_mm, travel_mm) } else { 0.0 };
        }
    }
    guide_mm
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn broydens_rule_explains_its_share_of_the_last_step_and_changes_nothing_across_it() {
        let initial = [[-0.5, 0.1, 0.0], [0.0, -0.4, 0.02]];
        let mut jacobian = Jacobian::new(initial);
        let (earlier_state, later_state) =
            (([0.1, 0.2], [1.0, -1.0, 10.0]), ([0.5, -0.3], [2.0, -1.5, 15.0]));
        jacobian.update(earlier_state, later_state);
        let moved = [1.0, -0.5, 5.0];
        for (plane, row) in jacobian.0.iter().enumerate() {
            let predicted: f64 = row.iter().zip(moved).map(|(slope, moved)| slope * moved).sum();
            let predicted_mm: f64 =
                initial[plane].iter().zip(moved).map(|(slope, moved)| slope * moved).sum();
            let missing_mm = later_state.0[plane] - earlier_state.0[plane] - predicted_mm;
            assert!((predicted - predicted_mm - 0.65 * missing_mm).abs() < 1e-9);
            assert!((product(row) - product(&initial[plane])).abs() < 1e-12);
        }
    }

    /// Across the step: (0.5, 1, 0) is perpendicular to it.
    fn product(row: &[f64; 3]) -> f64 {
        0.5 * row[0] + row[1]
    }

    #[test]
    fn the_nearest_guide_position_is_exact_inside_and_on_the_edge() {
        let gain = [[-0.5, 0.1], [0.05, -0.4]];
        let [x, y] = nearest(gain, [-1.0, 0.6], 6.0);
        assert!((gain[0][0] * x + gain[0][1] * y + 1.0).abs() < 1e-9);
        assert!((gain[1][0] * x + gain[1][1] * y - 0.6).abs() < 1e-9);
        // Out of reach: no point of a grid within the travel is nearer.
        let requested = [-9.0, 1.0];
        let best = distance_from(nearest(gain, requested, 6.0), gain, requested);
        for i in -60..=60 {
            for j in -60..=60 {
                assert!(
                    distance_from([0.1 * f64::from(i), 0.1 * f64::from(j)], gain, requested) >= best - 1e-9
                );
            }
        }
    }

    fn distance_from(at: [f64; 2], gain: [[f64; 2]; 2], requested: [f64; 2]) -> f64 {
        (0..2).map(|i| (gain[i][0] * at[0] + gain[i][1] * at[1] - requested[i]).powi(2)).sum::<f64>()
    }
}
