//! Plant that is steered: a plant of any kind, and what can go wrong with it.

use crate::protocol::{Answer, Command, End, Statement, VERSION};
use serde::{Deserialize, Serialize};
use std::borrow::Cow;

/// Something that takes commands step by step and answers each.
pub trait Plant {
    /// Statement of the plant about itself; called once, first.
    ///
    /// # Errors
    /// [`PlantError`].
    fn start(&mut self) -> Result<Statement, PlantError>;

    /// Carries out one step.
    ///
    /// # Errors
    /// [`PlantError`].
    fn step(&mut self, command: &Command) -> Result<Answer, PlantError>;

    /// Ends the run at the depth reached.
    ///
    /// # Errors
    /// [`PlantError`].
    fn end(&mut self) -> Result<End, PlantError>;
}

/// Fault of the device that moves guide 2.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum DeviceFault {
    /// It does not answer any more: the cable was pulled, or its supply is off.
    Gone,
    /// It has started again.
    Restarted,
    /// Its emergency stop was pressed.
    EmergencyStop,
    /// One of its other interlocks has stopped it.
    Interlock,
    /// A motion was ended by a stop from elsewhere.
    Stopped,
    /// Guide 2 is not where a run begins.
    NotHome,
    /// Guide 2 is not where it was left.
    Slipped,
    /// Anything else.
    Other,
}

impl DeviceFault {
    /// Name of the fault in results.
    pub fn name(self) -> &'static str {
        match self {
            Self::Gone => "device_gone",
            Self::Restarted => "device_restarted",
            Self::EmergencyStop => "emergency_stop",
            Self::Interlock => "device_fault",
            Self::Stopped => "device_stopped",
            Self::NotHome => "guide_not_home",
            Self::Slipped => "guide_slipped",
            Self::Other => "device_error",
        }
    }
}

/// Why a plant cannot be steered any further. No further request is sent to it. An error that its lines do not
/// state is recorded, so that a replay ends by the same.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, thiserror::Error)]
#[serde(rename_all = "snake_case")]
pub enum PlantError {
    /// It could not be started.
    #[error(
        "the plant does not start: {0}: is the program installed and executable? A path counts from the current folder"
    )]
    NotStarted(String),
    /// It reports an error of its own.
    #[error("the plant reports an error: {0}")]
    Reported(String),
    /// Its output ended before its last line.
    #[error("the plant's output ended, expected {expected}: {how}")]
    Ended {
        /// Expected answer.
        expected: Cow<'static, str>,
        /// End of the program, and the remedy.
        how: Cow<'static, str>,
    },
    /// The user interrupted the run.
    #[error("the run was interrupted: nothing more is commanded, the needle stays where it is")]
    Interrupted,
    /// No line came in time.
    #[error("no {expected} within {limit_s} s")]
    Silent {
        /// Expected answer.
        expected: Cow<'static, str>,
        /// Within which time of the wall's clock.
        limit_s: f64,
    },
    /// A line is not what it should be: no JSON object, a field missing or of another type.
    #[error("line {line} of the plant is no {expected}: {problem}")]
    Malformed {
        /// Its number.
        line: u64,
        /// Expected content.
        expected: Cow<'static, str>,
        /// Problem of the content.
        problem: String,
    },
    /// A number is not finite or out of range.
    #[error("{field} of the plant is {value}, expected {expected}")]
    Value {
        /// Field.
        field: Cow<'static, str>,
        /// Its value.
        value: f64,
        /// Valid content.
        expected: Cow<'static, str>,
    },
    /// Another protocol.
    #[error("the plant states protocol `{0}`, expected `{VERSION}`")]
    Version(String),
    /// The answer is to another step.
    #[error("the answer's t_s is {answered} s, expected the step's {commanded} s")]
    Time {
        /// Answered value.
        answered: f64,
        /// Commanded value.
        commanded: f64,
    },
    /// The device that moves guide 2.
    #[error("{cause}")]
    Device {
        /// Fault of the device.
        fault: DeviceFault,
        /// Cause and remedy.
        cause: String,
    },
    /// A recording goes on differently.
    #[error("step {step} of the recording was commanded differently: {difference}")]
    Differs {
        /// Number of the step, from 1.
        step: usize,
        /// Difference.
        difference: String,
    },
}

impl PlantError {
    /// Name of the fault in results.
    pub fn name(&self) -> &'static str {
        match self {
            Self::NotStarted(_) => "plant_not_started",
            Self::Reported(_) => "plant_error",
            Self::Ended { .. } => "plant_ended",
            Self::Interrupted => "interrupted",
            Self::Silent { .. } => "plant_silent",
            Self::Malformed { .. } => "plant_line_malformed",
            Self::Value { .. } => "plant_value",
            Self::Version(_) => "plant_protocol",
            Self::Time { .. } => "plant_time",
            Self::Device { fault, .. } => fault.name(),
            Self::Differs { .. } => "replay_differs",
        }
    }
}

fn check(field: &'static str, value: f64, expected: &'static str, good: bool) -> Result<(), PlantError> {
    if good && value.is_finite() {
        Ok(())
    } else {
        Err(PlantError::Value { field: field.into(), value, expected: expected.into() })
    }
}

impl Statement {
    /// Checks protocol and numbers.
    ///
    /// # Errors
    /// [`PlantError::Version`], [`PlantError::Value`].
    pub fn check(&self) -> Result<(), PlantError> {
        if self.plant != VERSION {
            return Err(PlantError::Version(self.plant.clone()));
        }
        check_optional("EI_n_m2", self.needle.ei_n_m2)?;
        check_optional("outer_diameter_mm", self.needle.outer_diameter_mm)?;
        check_optional("guide1_to_guide2_mm", self.rig.guide1_to_guide2_mm)?;
        check_positive("guide2_to_surface_mm", self.rig.guide2_to_surface_mm)?;
        check_not_negative("guide_travel_mm", self.limits.guide_travel_mm)?;
        if self.limits.guide_travel_mm > 0.0 {
            check_positive("guide_speed_mm_s", self.limits.guide_speed_mm_s)?;
        }
        check_optional("guide_force_n", self.limits.guide_force_n)?;
        check_positive("push_speed_mm_s", self.limits.push_speed_mm_s)?;
        if self.rig.can_rotate {
            check_positive("rotation_speed_deg_s", self.limits.rotation_speed_deg_s)?;
        }
        check_optional("needle_strain", self.limits.needle_strain)?;
        check_optional("tissue_compression_mm", self.limits.tissue_compression_mm)?;
        check_positive("max_depth_mm", self.max_depth_mm)?;
        check_positive("depth_step_mm", self.depth_step_mm)?;
        check_not_negative("tip_noise_mm", self.tip_noise_mm)?;
        check_not_negative("tip_delay_s", self.tip_delay_s)?;
        check_positive("tip_rate_hz", self.tip_rate_hz)?;
        check_not_negative("guide_error_mm", self.guide_error_mm)?;
        check("bevel_deg", self.bevel_deg, "a finite number", true)?;
        if let Some(prior) = &self.prior {
            check_optional("foundation_kpa", prior.foundation_kpa)?;
            check_range("foundation_range", prior.foundation_range)?;
            check_range("tip_load_range", prior.tip_load_range)?;
            if let Some(load_n) = prior.tip_load_n {
                check("tip_load_n", load_n, "a finite number", true)?;
            }
            if let Some(slope) = prior.slope_mrad {
                check_not_negative("slope_mrad", slope)?;
            }
        }
        Ok(())
    }
}

fn check_range(field: &'static str, range: Option<[f64; 2]>) -> Result<(), PlantError> {
    match range {
        Some([low, high]) => {
            check(field, low, "0 or more", low >= 0.0)?;
            check(field, high, "the lower end or more", high >= low)
        }
        None => Ok(()),
    }
}

fn check_optional(field: &'static str, value: Option<f64>) -> Result<(), PlantError> {
    value.map_or(Ok(()), |value| check_positive(field, value))
}

fn check_not_negative(field: &'static str, value: f64) -> Result<(), PlantError> {
    check(field, value, "0 or more", value >= 0.0)
}

fn check_positive(field: &'static str, value: f64) -> Result<(), PlantError> {
    check(field, value, "more than 0", value > 0.0)
}

impl Answer {
    /// Checks numbers, and that it answers this command.
    ///
    /// # Errors
    /// [`PlantError::Time`], [`PlantError::Value`].
    pub fn check(&self, command: &Command) -> Result<(), PlantError> {
        check_finite("t_s", self.t_s)?;
        if (self.t_s - command.t_s).abs() > 1e-6 {
            return Err(PlantError::Time { answered: self.t_s, commanded: command.t_s });
        }
        check_finite("depth_mm", self.depth_mm)?;
        check_finite("guide_x_mm", self.guide_x_mm)?;
        check_finite("guide_y_mm", self.guide_y_mm)?;
        check_finite("bevel_deg", self.bevel_deg)?;
        check_finite("tip_x_mm", self.tip_x_mm)?;
        check_finite("tip_y_mm", self.tip_y_mm)?;
        let optional = [
            ("force_x_n", self.force_x_n),
            ("force_y_n", self.force_y_n),
            ("tip_t_s", self.tip_t_s),
            ("tip_slope_x_mrad", self.tip_slope_x_mrad),
            ("tip_slope_y_mrad", self.tip_slope_y_mrad),
        ];
        optional
            .into_iter()
            .try_for_each(|(field, value)| value.map_or(Ok(()), |value| check_finite(field, value)))
    }
}

fn check_finite(field: &'static str, value: f64) -> Result<(), PlantError> {
    check(field, value, "a finite number", true)
}
