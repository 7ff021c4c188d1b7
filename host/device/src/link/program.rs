//! Motion programs of guide 2, from a TOML file or built in.
//!
//! ```toml
//! name = "displace"
//! [[step]]
//! move_y_mm = 1.2        # and/or move_x_mm; an axis without a target moves to 0
//! speed_mm_s = 1.0
//! [[step]]
//! hold_s = 3.0
//! sweep = true           # take an ultrasound sweep during this hold
//! [[step]]
//! tare_s = 1.0
//! [[step]]
//! ramp_y_mm = -0.5       # and/or ramp_x_mm: at constant speed, arriving after
//! duration_s = 20.0      # this time; then the next step begins, settled or not
//! [[step]]
//! staircase_y_mm = 1.0   # and/or staircase_x_mm: from the previous target (or 0) to this one
//! levels = 5             # in this many equal steps, each a move and a hold
//! hold_s = 2.0
//! speed_mm_s = 1.0
//! sweep = true           # in each of the holds
//! ```
//!
//! The device has moves, ramps, holds and tares, [`MAX_STEPS`] of them; staircases become moves and holds here.

use formats::document::Fields;
use formats::session::{Place, SessionError, read_text};
use protocol::{MAX_STEPS, Step};
use std::path::Path;

/// Names and texts of the built-in programs.
const BUILT_IN: [(&str, &str); 3] = [
    ("displace", include_str!("programs/displace.toml")),
    ("staircase", include_str!("programs/staircase.toml")),
    ("quick-staircase", include_str!("programs/quick-staircase.toml")),
];

/// One step, and the host's task during it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PlannedStep {
    /// Step that the device carries out.
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
    #[error("{fault}; nor is it a built-in program ({known})", known = known())]
    Read {
        /// The operating system's error.
        fault: SessionError,
    },
    /// The file is not a program.
    #[error(transparent)]
    File(#[from] SessionError),
    /// An invalid step.
    #[error("{place}: step {number}: {problem}")]
    Step {
        /// Position at which the step begins.
        place: Place,
        /// Number of the step, from 1.
        number: usize,
        /// Problem, and the expected text.
        problem: &'static str,
    },
    /// No steps or too many, with staircases as the moves and holds that they stand for.
    #[error("{place}: {count} steps{}, expected 1 to {MAX_STEPS}", expanded(*count, *written))]
    Length {
        /// Position of the first step beyond the limit; the file if there is none.
        place: Place,
        /// Number of steps for the device.
        count: usize,
        /// Number of steps in the file.
        written: usize,
    },
}

fn expanded(count: usize, written: usize) -> String {
    if count == written {
        String::new()
    } else {
        format!(" on the device ({written} in the file; each level of a staircase is a move and a hold)")
    }
}

fn known() -> String {
    BUILT_IN.map(|(name, _)| name).join(", ")
}

/// Positions of guide 2 that a program may require; a device has its own travel.
const TARGET_MM: [f64; 2] = [-1_000.0, 1_000.0];
const SPEED_MM_S: [f64; 2] = [0.001, 1_000.0];
const DURATION_S: [f64; 2] = [0.001, 86_400.0];
/// Largest number of levels of a staircase: each is a move and a hold.
const MAX_LEVELS: f64 = MAX_STEPS as f64 / 2.0;

/// A step as the file has it.
#[derive(Clone, Copy)]
struct FileStep {
    move_x_mm: Option<f64>,
    move_y_mm: Option<f64>,
    ramp_x_mm: Option<f64>,
    ramp_y_mm: Option<f64>,
    duration_s: Option<f64>,
    staircase_x_mm: Option<f64>,
    staircase_y_mm: Option<f64>,
    levels: Option<u32>,
    speed_mm_s: Option<f64>,
    hold_s: Option<f64>,
    tare_s: Option<f64>,
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
                let text = read_text(Path::new(name)).map_err(|fault| match fault {
                    SessionError::Io { .. } => ProgramError::Read { fault },
                    other => other.into(),
                })?;
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
        let (title, written) = Fields::parse(Path::new(name), text, |file| {
            file.only(&["name", "step"])?;
            let steps = file.tables("step")?;
            let steps = steps.iter().map(|fields| Ok((fields.place(), FileStep::read(fields)?)));
            Ok((file.text("name")?, steps.collect::<Result<Vec<_>, SessionError>>()?))
        })?;
        let mut steps: Vec<PlannedStep> = Vec::new();
        let mut target_um = [0; 2];
        let mut count = 0;
        let mut too_many = None;
        for (number, (place, step)) in (1..).zip(&written) {
            let planned = step.plan(target_um).map_err(|problem| ProgramError::Step {
                place: place.clone(),
                number,
                problem,
            })?;
            let mut targets = planned.iter().filter_map(|planned| target(planned.step));
            target_um = targets.next_back().unwrap_or(target_um);
            count += planned.len();
            if count > MAX_STEPS {
                too_many.get_or_insert(place);
            }
            // Steps that the device cannot hold are only counted.
            steps.extend(planned.into_iter().take(MAX_STEPS.saturating_sub(steps.len())));
        }
        if (1..=MAX_STEPS).contains(&count) {
            Ok(Self { name: title, steps })
        } else {
            let location = too_many.cloned().unwrap_or_else(|| Place::at(Path::new(name), "", 0));
            Err(ProgramError::Length { place: location, count, written: written.len() })
        }
    }
}

/// Target of a step, micrometres.
fn target(step: Step) -> Option<[i32; 2]> {
    match step {
        Step::Move { x_um, y_um, .. } | Step::Ramp { x_um, y_um, .. } => Some([x_um, y_um]),
        Step::Hold { .. } | Step::Tare { .. } => None,
    }
}

impl FileStep {
    fn read(fields: &Fields<'_>) -> Result<Self, SessionError> {
        fields.only(&[
            "move_x_mm",
            "move_y_mm",
            "ramp_x_mm",
            "ramp_y_mm",
            "duration_s",
            "staircase_x_mm",
            "staircase_y_mm",
            "levels",
            "speed_mm_s",
            "hold_s",
            "tare_s",
            "sweep",
        ])?;
        let target = |field: &str| fields.optional_number(field, TARGET_MM);
        Ok(Self {
            move_x_mm: target("move_x_mm")?,
            move_y_mm: target("move_y_mm")?,
            ramp_x_mm: target("ramp_x_mm")?,
            ramp_y_mm: target("ramp_y_mm")?,
            duration_s: fields.optional_number("duration_s", DURATION_S)?,
            staircase_x_mm: target("staircase_x_mm")?,
            staircase_y_mm: target("staircase_y_mm")?,
            levels: fields.optional_whole("levels", [1.0, MAX_LEVELS])?.map(|levels| levels as u32),
            speed_mm_s: fields.optional_number("speed_mm_s", SPEED_MM_S)?,
            hold_s: fields.optional_number("hold_s", DURATION_S)?,
            tare_s: fields.optional_number("tare_s", DURATION_S)?,
            sweep: fields.flag("sweep")?,
        })
    }

    /// The device's steps for this one, after a step that led to `from_um`.
    fn plan(self, from_um: [i32; 2]) -> Result<Vec<PlannedStep>, &'static str> {
        fn pair(x: Option<f64>, y: Option<f64>) -> Option<[f64; 2]> {
            (x.is_some() || y.is_some()).then(|| [x.unwrap_or(0.0), y.unwrap_or(0.0)])
        }
        let move_mm = pair(self.move_x_mm, self.move_y_mm);
        let ramp_mm = pair(self.ramp_x_mm, self.ramp_y_mm);
        let staircase_mm = pair(self.staircase_x_mm, self.staircase_y_mm);
        if self.speed_mm_s.is_some() && move_mm.is_none() && staircase_mm.is_none() {
            return Err("`speed_mm_s` belongs to a move or a staircase");
        }
        if self.duration_s.is_some() && ramp_mm.is_none() {
            return Err("`duration_s` belongs to a ramp");
        }
        if self.levels.is_some() && staircase_mm.is_none() {
            return Err("`levels` belongs to a staircase");
        }
        if self.sweep && self.hold_s.is_none() {
            return Err("`sweep` belongs to a hold: the guide must be at rest");
        }
        let speed_mm_s = self.speed_mm_s.unwrap_or(1.0);
        let step = match (move_mm, ramp_mm, staircase_mm, self.hold_s, self.tare_s) {
            (Some(target_mm), None, None, None, None) => move_to(target_mm, speed_mm_s)?,
            (None, Some(target_mm), None, None, None) => {
                let [x_um, y_um] = micrometres(target_mm)?;
                let duration_s = self.duration_s.ok_or("a ramp needs `duration_s`")?;
                Step::Ramp { x_um, y_um, duration_ms: milliseconds(duration_s)? }
            }
            (None, None, Some(target_mm), Some(hold_s), None) => {
                return self.staircase(from_um, target_mm, speed_mm_s, hold_s);
            }
            (None, None, Some(_), None, None) => return Err("a staircase needs `hold_s`"),
            (None, None, None, Some(hold_s), None) => Step::Hold { duration_ms: milliseconds(hold_s)? },
            (None, None, None, None, Some(tare_s)) => Step::Tare { duration_ms: milliseconds(tare_s)? },
            _ => {
                return Err("expected exactly one of `move_x_mm`/`move_y_mm`, `ramp_x_mm`/`ramp_y_mm`, \
                            `staircase_x_mm`/`staircase_y_mm`, `hold_s`, `tare_s`");
            }
        };
        Ok(vec![PlannedStep { step, sweep: self.sweep }])
    }

    fn staircase(
        self,
        from_um: [i32; 2],
        target_mm: [f64; 2],
        speed_mm_s: f64,
        hold_s: f64,
    ) -> Result<Vec<PlannedStep>, &'static str> {
        let levels = self.levels.ok_or("a staircase needs `levels`")?;
        if micrometres(target_mm)? == from_um {
            return Err("a staircase must lead to another place than it starts from");
        }
        let hold = PlannedStep { step: Step::Hold { duration_ms: milliseconds(hold_s)? }, sweep: self.sweep };
        let start_mm = from_um.map(|um| f64::from(um) * 1e-3);
        let mut steps = Vec::new();
        for level in 1..=levels {
            let fraction = f64::from(level) / f64::from(levels);
            let level_mm = [0, 1].map(|axis| start_mm[axis] + fraction * (target_mm[axis] - start_mm[axis]));
            steps.push(PlannedStep { step: move_to(level_mm, speed_mm_s)?, sweep: false });
            steps.push(hold);
        }
        Ok(steps)
    }
}

/// A position (x, y) as the device takes it.
fn micrometres(target_mm: [f64; 2]) -> Result<[i32; 2], &'static str> {
    if target_mm.iter().all(|target| (TARGET_MM[0]..=TARGET_MM[1]).contains(target)) {
        Ok(target_mm.map(|target| (target * 1e3).round() as i32))
    } else {
        Err("the target must be a number of millimetres within 1000")
    }
}

/// A move to a position (x, y) in millimetres at a speed in millimetres per second.
///
/// # Errors
/// A message with the valid range, for a value that no rig accepts; the device checks its own limits.
pub fn move_to(target_mm: [f64; 2], speed_mm_s: f64) -> Result<Step, &'static str> {
    let [x_um, y_um] = micrometres(target_mm)?;
    if !(SPEED_MM_S[0]..=SPEED_MM_S[1]).contains(&speed_mm_s) {
        return Err("`speed_mm_s` must lie between 0.001 and 1000");
    }
    Ok(Step::Move { x_um, y_um, speed_um_s: (speed_mm_s * 1e3).round() as u32 })
}

/// A duration in seconds as the device takes it.
///
/// # Errors
/// A message with the valid range, for a value that is no duration.
pub fn milliseconds(duration_s: f64) -> Result<u32, &'static str> {
    if (DURATION_S[0]..=DURATION_S[1]).contains(&duration_s) {
        Ok((duration_s * 1e3).round() as u32)
    } else {
        Err("a duration must lie between 0.001 s and a day")
    }
}

#[cfg(test)]
mod tests;
