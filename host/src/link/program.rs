//! Motion programs: what guide 2 does in one acquisition, from a TOML file or built in.
//!
//! ```toml
//! name = "displace"
//! [[step]]
//! move_y_mm = 1.2        # and/or move_x_mm; an axis not named goes to 0
//! speed_mm_s = 1.0
//! [[step]]
//! hold_s = 3.0
//! sweep = true           # take an ultrasound sweep during this hold
//! [[step]]
//! tare_s = 1.0
//! ```

use protocol::{MAX_STEPS, Step};
use serde::Deserialize;
use std::path::Path;

/// Names and texts of the programs that come with the tool.
const BUILT_IN: [(&str, &str); 3] = [
    ("displace", include_str!("programs/displace.toml")),
    ("staircase", include_str!("programs/staircase.toml")),
    ("quick-staircase", include_str!("programs/quick-staircase.toml")),
];

/// One step with what the host does during it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PlannedStep {
    /// What the device does.
    pub step: Step,
    /// Take an ultrasound sweep.
    pub sweep: bool,
}

/// A motion program that the device can hold.
#[derive(Debug, Clone, PartialEq)]
pub struct Program {
    /// Its name, for people.
    pub name: String,
    /// At least one step, at most [`MAX_STEPS`].
    pub steps: Vec<PlannedStep>,
}

/// Why a program cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum ProgramError {
    /// The file cannot be read, and no built-in program has that name.
    #[error("{name}: {cause}; it is no built-in program either ({known})", known = known())]
    Read {
        /// File or name.
        name: String,
        /// Why.
        cause: std::io::Error,
    },
    /// The file is not a program.
    #[error("{name}: {cause}")]
    Parse {
        /// File or name.
        name: String,
        /// Where and why.
        cause: Box<toml::de::Error>,
    },
    /// A step makes no sense.
    #[error("{name}: step {number}: {problem}")]
    Step {
        /// File or name.
        name: String,
        /// Number of the step, from 1.
        number: usize,
        /// What is wrong and what was expected.
        problem: &'static str,
    },
    /// No steps or too many.
    #[error("{name}: {count} steps, expected 1 to {MAX_STEPS}")]
    Length {
        /// File or name.
        name: String,
        /// How many there are.
        count: usize,
    },
}

fn known() -> String {
    BUILT_IN.map(|(name, _)| name).join(", ")
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct File {
    name: String,
    #[serde(default)]
    step: Vec<FileStep>,
}

#[derive(Deserialize, Clone, Copy)]
#[serde(deny_unknown_fields)]
struct FileStep {
    move_x_mm: Option<f64>,
    move_y_mm: Option<f64>,
    speed_mm_s: Option<f64>,
    hold_s: Option<f64>,
    tare_s: Option<f64>,
    #[serde(default)]
    sweep: bool,
}

impl Program {
    /// Reads a file, or takes the built-in program of that name.
    ///
    /// # Errors
    /// [`ProgramError`] naming the file and the step.
    pub fn load(name: &str) -> Result<Self, ProgramError> {
        match BUILT_IN.iter().find(|(known, _)| *known == name) {
            Some((_, text)) => Self::parse(name, text),
            None => {
                let text = std::fs::read_to_string(Path::new(name))
                    .map_err(|cause| ProgramError::Read { name: name.to_owned(), cause })?;
                Self::parse(name, &text)
            }
        }
    }

    /// A program of one step.
    pub fn single(name: &str, step: Step) -> Self {
        Self { name: name.to_owned(), steps: vec![PlannedStep { step, sweep: false }] }
    }

    /// The device's part of the steps.
    pub fn device_steps(&self) -> Vec<Step> {
        self.steps.iter().map(|planned| planned.step).collect()
    }

    fn parse(name: &str, text: &str) -> Result<Self, ProgramError> {
        let file: File = toml::from_str(text)
            .map_err(|cause| ProgramError::Parse { name: name.to_owned(), cause: Box::new(cause) })?;
        if !(1..=MAX_STEPS).contains(&file.step.len()) {
            return Err(ProgramError::Length { name: name.to_owned(), count: file.step.len() });
        }
        let steps = file.step.iter().enumerate().map(|(index, step)| {
            step.plan().map_err(|problem| ProgramError::Step {
                name: name.to_owned(),
                number: index + 1,
                problem,
            })
        });
        Ok(Self { name: file.name, steps: steps.collect::<Result<_, _>>()? })
    }
}

impl FileStep {
    fn plan(self) -> Result<PlannedStep, &'static str> {
        let is_move = self.move_x_mm.is_some() || self.move_y_mm.is_some();
        if self.speed_mm_s.is_some() && !is_move {
            return Err("`speed_mm_s` belongs to a move");
        }
        if self.sweep && self.hold_s.is_none() {
            return Err("`sweep` belongs to a hold: the guide must stand still");
        }
        let step = match (is_move, self.hold_s, self.tare_s) {
            (true, None, None) => move_to(
                [self.move_x_mm.unwrap_or(0.0), self.move_y_mm.unwrap_or(0.0)],
                self.speed_mm_s.unwrap_or(1.0),
            )?,
            (false, Some(hold_s), None) => Step::Hold { duration_ms: milliseconds(hold_s)? },
            (false, None, Some(tare_s)) => Step::Tare { duration_ms: milliseconds(tare_s)? },
            _ => return Err("expected exactly one of `move_x_mm`/`move_y_mm`, `hold_s`, `tare_s`"),
        };
        Ok(PlannedStep { step, sweep: self.sweep })
    }
}

/// A move to a position (x, y) in millimetres at a speed in millimetres per second.
///
/// # Errors
/// Says what was expected of a value that no rig could take; the device checks against its own limits.
pub fn move_to(target_mm: [f64; 2], speed_mm_s: f64) -> Result<Step, &'static str> {
    if !target_mm.iter().all(|target| target.abs() <= 1_000.0) {
        return Err("the target must be a number of millimetres within 1000");
    }
    if !(0.001..=1_000.0).contains(&speed_mm_s) {
        return Err("`speed_mm_s` must lie between 0.001 and 1000");
    }
    let [x_um, y_um] = target_mm.map(|target| (target * 1e3).round() as i32);
    Ok(Step::Move { x_um, y_um, speed_um_s: (speed_mm_s * 1e3).round() as u32 })
}

/// A duration in seconds as the device takes it.
///
/// # Errors
/// Says what was expected of a value that is no duration.
pub fn milliseconds(duration_s: f64) -> Result<u32, &'static str> {
    if (0.001..=86_400.0).contains(&duration_s) {
        Ok((duration_s * 1e3).round() as u32)
    } else {
        Err("a duration must lie between 0.001 s and a day")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_built_in_programs_are_sound() {
        for (name, _) in BUILT_IN {
            let program = Program::load(name).unwrap();
            assert!(program.steps.iter().any(|step| step.sweep), "{name} takes no sweep");
            // Whatever is held at the end is held at rest.
            let mut steps = program.steps.iter().rev().map(|planned| planned.step);
            let last = steps.find(|step| matches!(step, Step::Move { .. }));
            assert!(matches!(last, Some(Step::Move { x_um: 0, y_um: 0, .. })), "{name}");
        }
    }

    #[test]
    fn a_move_names_its_axes_and_speed() {
        let program = Program::parse("p", "name = 'p'\n[[step]]\nmove_x_mm = -0.5\nspeed_mm_s = 2").unwrap();
        assert_eq!(program.device_steps(), [Step::Move { x_um: -500, y_um: 0, speed_um_s: 2_000 }]);
    }

    #[test]
    fn mistakes_name_the_step_or_the_line() {
        let message = |text: &str| Program::parse("p.toml", text).unwrap_err().to_string();
        let both = "name = 'p'\n[[step]]\nhold_s = 1\n[[step]]\nhold_s = 1\ntare_s = 1\n";
        assert_eq!(
            message(both),
            "p.toml: step 2: expected exactly one of `move_x_mm`/`move_y_mm`, `hold_s`, `tare_s`"
        );
        assert_eq!(message("name = 'p'"), "p.toml: 0 steps, expected 1 to 64");
        assert!(message("name = 'p'\n[[step]]\nhold_ms = 1").contains("line 3"));
        let sweep = "name = 'p'\n[[step]]\nmove_y_mm = 1\nsweep = true\n";
        assert!(message(sweep).contains("belongs to a hold"));
        assert!(message("name = 'p'\n[[step]]\nhold_s = nan").contains("between 0.001 s"));
        assert!(message("name = 'p'\n[[step]]\nmove_y_mm = inf").contains("within 1000"));
        assert!(
            Program::load("no-such")
                .unwrap_err()
                .to_string()
                .contains("displace, staircase, quick-staircase")
        );
    }
}
