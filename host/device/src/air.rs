//! Motion programs of the runs in air with which `guide characterize` measures the rig; each moves one axis.

use crate::link::program::{PlannedStep, Program, milliseconds, move_to};
use protocol::Step;

/// Levels of a run as shares of its reach: the small ones determine play and clearance, the large ones the compliances. Each is reached
/// from both sides, on both sides of zero, and the run begins and ends at zero.
const SHARES: [f64; 16] =
    [0.0, 0.05, 0.15, 0.5, 1.0, 0.5, 0.15, 0.05, 0.0, -0.05, -0.15, -0.5, -1.0, -0.5, -0.15, -0.05];
/// Range of a run's largest level, millimetres: the smallest level has to lie within the play of a rig, and the largest has to
/// load the rig.
pub const REACH_MM: [f64; 2] = [1.0, 6.0];
/// Force at the largest level, newtons, where the reach follows from the needle.
const FORCE_N: f64 = 1.0;
/// Largest reach that follows from the needle, millimetres.
const LARGEST_MM: f64 = 4.0;
const SPEED_MM_S: f64 = 2.0;
const HOLD_S: f64 = 2.0;
const TARE_S: f64 = 1.0;
/// Time in which the force settles before it is averaged.
const SETTLING_S: f64 = 0.5;
/// Time that a move may take beyond that at its speed, and that lies between two programs for the host, seconds.
const MOVE_EXTRA_S: f64 = 1.0;
const BETWEEN_S: f64 = 2.0;
/// Largest distance of guide 2 from zero before the first tare, millimetres.
const FARTHEST_MM: f64 = 10.0;

/// Axis of a run.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Axis {
    /// Horizontal.
    X,
    /// Vertical.
    Y,
}

impl Axis {
    /// Its name in the ids of runs.
    pub fn name(self) -> &'static str {
        match self {
            Self::X => "x",
            Self::Y => "y",
        }
    }
}

/// Largest level for a needle of this stiffness at guide 2 (newtons per metre), millimetres: the displacement at which it
/// presses with 1 N, within bounds.
pub fn reach_mm(stiffness_n_per_m: f64) -> f64 {
    let [least_mm, _] = REACH_MM;
    // `max` and `min` pass a number by where the stiffness is none.
    (1e3 * FORCE_N / stiffness_n_per_m).min(LARGEST_MM).max(least_mm)
}

/// Program before each run, which is not recorded: home, and a tare there.
///
/// # Errors
/// A message with the valid range, for a constant that the device does not accept.
pub fn tare_program() -> Result<Program, &'static str> {
    let steps = [
        move_to([0.0; 2], SPEED_MM_S)?,
        Step::Hold { duration_ms: milliseconds(SETTLING_S)? },
        Step::Tare { duration_ms: milliseconds(TARE_S)? },
    ];
    let steps = steps.map(|step| PlannedStep { step, sweep: false });
    Ok(Program { name: "tare at zero".to_owned(), steps: steps.to_vec() })
}

/// A run along one axis: a hold at each level, with a sweep of the shape at zero and at the extremes.
///
/// # Errors
/// A message with the valid range, for a level that the device does not accept.
pub fn run_program(axis: Axis, reach_mm: f64) -> Result<Program, &'static str> {
    let hold = Step::Hold { duration_ms: milliseconds(HOLD_S)? };
    let mut steps = Vec::new();
    for share in SHARES.into_iter().chain([0.0]) {
        let at_mm = share * reach_mm;
        let target_mm = match axis {
            Axis::X => [at_mm, 0.0],
            Axis::Y => [0.0, at_mm],
        };
        steps.push(PlannedStep { step: move_to(target_mm, SPEED_MM_S)?, sweep: false });
        steps.push(PlannedStep { step: hold, sweep: share == 0.0 || share.abs() == 1.0 });
    }
    Ok(Program { name: format!("in air, {}", axis.name()), steps })
}

/// Start times of consecutive programs, if the first one has a stated time.
///
/// A program that starts at a stated time of the device's clock makes the same motion at the same time whenever the host sends it. Each
/// start is a whole second, late enough for the program before it to have ended.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Timetable {
    next_s: Option<f64>,
    from_mm: f64,
}

impl Timetable {
    /// Starts at this time of the device's clock, seconds; `None`: each program starts at once.
    pub fn new(at_s: Option<f64>) -> Self {
        Self { next_s: at_s, from_mm: FARTHEST_MM }
    }

    /// Start time of the next program, seconds; `None` for at once.
    pub fn start_s(&mut self, program: &Program) -> Option<f64> {
        let start_s = self.next_s?;
        let longest_s: f64 = program.steps.iter().map(|planned| self.longest_s(&planned.step)).sum();
        self.next_s = Some((start_s + longest_s + BETWEEN_S).ceil());
        Some(start_s)
    }

    /// Longest time of a step, seconds, and where it ends.
    fn longest_s(&mut self, step: &Step) -> f64 {
        match *step {
            Step::Move { x_um, y_um, speed_um_s } => {
                let target_mm = 1e-3 * f64::from(if x_um == 0 { y_um } else { x_um });
                let distance_mm = (target_mm - std::mem::replace(&mut self.from_mm, target_mm)).abs();
                distance_mm / (1e-3 * f64::from(speed_um_s)) + MOVE_EXTRA_S
            }
            Step::Hold { duration_ms } | Step::Tare { duration_ms } | Step::Ramp { duration_ms, .. } => {
                1e-3 * f64::from(duration_ms)
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use protocol::MAX_STEPS;

    fn targets_um(program: &Program) -> Vec<[i32; 2]> {
        program
            .device_steps()
            .iter()
            .filter_map(|step| match *step {
                Step::Move { x_um, y_um, .. } => Some([x_um, y_um]),
                _ => None,
            })
            .collect()
    }

    #[test]
    fn a_run_reaches_each_level_of_its_axis_from_both_sides_and_begins_and_ends_at_zero() {
        let program = run_program(Axis::Y, 4.0).unwrap();
        assert!(program.steps.len() <= MAX_STEPS, "{} steps", program.steps.len());
        let targets_um = targets_um(&program);
        assert!(targets_um.iter().all(|[x_um, _]| *x_um == 0));
        assert_eq!((targets_um.first(), targets_um.last()), (Some(&[0, 0]), Some(&[0, 0])));
        for level_um in [200, 600, 2_000] {
            for level_um in [level_um, -level_um] {
                let outwards =
                    |pair: &[[i32; 2]]| pair[1][1] == level_um && pair[0][1].abs() < level_um.abs();
                let back = |pair: &[[i32; 2]]| pair[1][1] == level_um && pair[0][1].abs() > level_um.abs();
                assert!(targets_um.windows(2).any(outwards) && targets_um.windows(2).any(back), "{level_um}");
            }
        }
        for extreme_um in [4_000, -4_000] {
            assert!(targets_um.contains(&[0, extreme_um]));
        }
        let x_program = run_program(Axis::X, 4.0).unwrap();
        assert!(super::tests::targets_um(&x_program).iter().all(|[_, y_um]| *y_um == 0));
    }

    #[test]
    fn sweeps_are_taken_in_holds_at_zero_and_at_the_extremes() {
        let program = run_program(Axis::X, 2.0).unwrap();
        let mut position_um = 0;
        let mut swept_um = Vec::new();
        for planned in &program.steps {
            match planned.step {
                Step::Move { x_um, .. } => position_um = x_um,
                Step::Hold { .. } if planned.sweep => swept_um.push(position_um),
                _ => assert!(!planned.sweep),
            }
        }
        assert_eq!(swept_um, [0, 2_000, 0, -2_000, 0]);
    }

    #[test]
    fn the_reach_follows_from_the_needle_within_bounds() {
        assert_eq!(reach_mm(500.0), 2.0);
        assert_eq!(reach_mm(10.0), 4.0);
        assert_eq!(reach_mm(1e5), 1.0);
    }

    #[test]
    fn each_program_starts_at_a_whole_second_after_the_longest_time_of_the_one_before() {
        let mut timetable = Timetable::new(Some(4.0));
        // 5 s for 10 mm at 2 mm/s, 1 s beyond, 0.5 s and 1 s of hold and tare, 2 s between: 9.5 s.
        assert_eq!(timetable.start_s(&tare_program().unwrap()), Some(4.0));
        let run = run_program(Axis::X, 2.0).unwrap();
        assert_eq!(timetable.start_s(&run), Some(14.0));
        // 17 moves and holds and 8 mm of way: 17 s, 34 s, 4 s; the first move stays at zero.
        assert_eq!(timetable.start_s(&tare_program().unwrap()), Some(71.0));
        assert_eq!(timetable.start_s(&run), Some(76.0));
    }

    #[test]
    fn without_a_time_each_program_starts_at_once() {
        let mut timetable = Timetable::new(None);
        assert_eq!(timetable.start_s(&tare_program().unwrap()), None);
        assert_eq!(timetable.start_s(&run_program(Axis::Y, 1.0).unwrap()), None);
    }
}
