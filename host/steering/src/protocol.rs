//! The messages of a plant: what it states about itself, what it is commanded, what it answers.
//!
//! One JSON object a line (`needle/1`). Lengths in mm, times in s, forces in N, angles in degrees or mrad as the fields' names state; a
//! field that may be absent or `null` is an [`Option`]. Frame: z along the needle's axis from guide 1, x and y across, right-handed,
//! origin where the axis meets the surface.

use serde::{Deserialize, Serialize};

/// Version of the protocol.
pub const VERSION: &str = "needle/1";

/// Statement of a plant at the start.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Statement {
    /// [`VERSION`].
    pub plant: String,
    /// The needle.
    pub needle: NeedleStatement,
    /// Guides and surface.
    pub rig: RigStatement,
    /// Limits that must not be exceeded.
    pub limits: Limits,
    /// Depth that can be reached, mm.
    pub max_depth_mm: f64,
    /// Largest growth of depth in one step, mm.
    pub depth_step_mm: f64,
    /// Noise of the tip sensor, one standard deviation per axis, mm.
    pub tip_noise_mm: f64,
    /// Age of a tip reading when it arrives, s.
    pub tip_delay_s: f64,
    /// Tip readings a second.
    pub tip_rate_hz: f64,
    /// Noise of the tip's slope, mrad.
    #[serde(default)]
    pub tip_slope_noise_mrad: Option<f64>,
    /// Noise of the force at guide 2, N.
    #[serde(default)]
    pub force_noise_n: Option<f64>,
    /// Largest difference of true and reported guide position, mm.
    pub guide_error_mm: f64,
    /// Direction of the tip's sideways load, from +x towards +y, degrees.
    pub bevel_deg: f64,
    /// Prior of tissue and tip.
    #[serde(default)]
    pub prior: Option<PriorStatement>,
}

/// The needle of a plant.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct NeedleStatement {
    /// Bending stiffness, N m^2.
    #[serde(default, rename = "EI_n_m2")]
    pub ei_n_m2: Option<f64>,
    /// Outer diameter, mm.
    #[serde(default)]
    pub outer_diameter_mm: Option<f64>,
}

/// Guides of a plant.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct RigStatement {
    /// From guide 1, which clamps the needle, to guide 2, mm.
    #[serde(default)]
    pub guide1_to_guide2_mm: Option<f64>,
    /// From guide 2 to the tissue's surface, mm.
    pub guide2_to_surface_mm: f64,
    /// Whether guide 2 may move while the needle is pushed.
    pub move_while_pushing: bool,
    /// Whether the needle can be turned about its axis.
    pub can_rotate: bool,
    /// Whether a guide move is commanded as one step, because the rig makes each move to its end: nothing else happens in it.
    #[serde(default)]
    pub guide_moves_in_one_step: bool,
}

/// Limits of a plant: travel and speed for each axis, force for the vector's length.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Limits {
    /// Travel of guide 2 to either side, mm; 0 where it is not actuated.
    pub guide_travel_mm: f64,
    /// Speed of guide 2, mm/s.
    pub guide_speed_mm_s: f64,
    /// Lateral force of guide 2, N.
    #[serde(default)]
    pub guide_force_n: Option<f64>,
    /// Speed of the needle into the tissue, mm/s.
    pub push_speed_mm_s: f64,
    /// Speed of the needle about its axis, degrees/s.
    pub rotation_speed_deg_s: f64,
    /// Bending strain of the needle.
    #[serde(default)]
    pub needle_strain: Option<f64>,
    /// Largest distance by which the needle may press the tissue aside, from the path that the tip
    /// has cut, mm.
    #[serde(default)]
    pub tissue_compression_mm: Option<f64>,
}

/// Prior of the plant: values, and ranges as factors of the value before them.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct PriorStatement {
    /// Foundation modulus K, kPa.
    #[serde(default)]
    pub foundation_kpa: Option<f64>,
    /// Its range.
    #[serde(default)]
    pub foundation_range: Option<[f64; 2]>,
    /// Lateral load at the tip, N.
    #[serde(default)]
    pub tip_load_n: Option<f64>,
    /// Its range.
    #[serde(default)]
    pub tip_load_range: Option<[f64; 2]>,
    /// Angle between needle and axis, one standard deviation per axis, mrad.
    #[serde(default)]
    pub slope_mrad: Option<f64>,
}

/// The state commanded for the end of a step.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
pub struct Command {
    /// End of the step, s.
    pub t_s: f64,
    /// Depth of the tip beyond the surface, mm.
    pub depth_mm: f64,
    /// Displacement of guide 2, mm.
    pub guide_x_mm: f64,
    /// Displacement of guide 2, mm.
    pub guide_y_mm: f64,
    /// Direction of the tip's load, degrees.
    pub bevel_deg: f64,
}

/// A plant's answer to a [`Command`].
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Answer {
    /// End of the step, s.
    pub t_s: f64,
    /// Depth reached, mm.
    pub depth_mm: f64,
    /// Guide 2 by its encoder, mm.
    pub guide_x_mm: f64,
    /// Guide 2 by its encoder, mm.
    pub guide_y_mm: f64,
    /// Direction of the tip's load, degrees.
    pub bevel_deg: f64,
    /// Force of guide 2 on the needle, N.
    #[serde(default)]
    pub force_x_n: Option<f64>,
    /// Force of guide 2 on the needle, N.
    #[serde(default)]
    pub force_y_n: Option<f64>,
    /// Number of the tip reading.
    pub tip_seq: i64,
    /// Tip, mm.
    pub tip_x_mm: f64,
    /// Tip, mm.
    pub tip_y_mm: f64,
    /// When the tip was there, s.
    #[serde(default)]
    pub tip_t_s: Option<f64>,
    /// Whether the sensor reports the reading as good.
    pub valid: bool,
    /// Slope of the needle at its tip, mrad.
    #[serde(default)]
    pub tip_slope_x_mrad: Option<f64>,
    /// Slope of the needle at its tip, mrad.
    #[serde(default)]
    pub tip_slope_y_mrad: Option<f64>,
}

/// The controller's last line.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Done {
    /// Always true.
    pub done: bool,
}

/// A plant's last line.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct End {
    /// True position of the tip, mm; `None` if the plant has no truth.
    #[serde(default)]
    pub true_tip_x_mm: Option<f64>,
    /// True position of the tip, mm.
    #[serde(default)]
    pub true_tip_y_mm: Option<f64>,
    /// Depth reached, mm.
    pub depth_mm: f64,
    /// Number of times each limit was exceeded.
    #[serde(default)]
    pub limits_broken: Option<LimitViolations>,
    /// Rotations made.
    #[serde(default)]
    pub rotations: Option<f64>,
    /// Largest force of guide 2, N.
    #[serde(default)]
    pub peak_force_n: Option<f64>,
    /// Largest bending strain of the needle.
    #[serde(default)]
    pub peak_strain: Option<f64>,
}

/// Number of times each limit was exceeded.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct LimitViolations {
    /// Travel of guide 2.
    pub travel: u64,
    /// Speed of guide 2.
    pub speed: u64,
    /// Force of guide 2.
    pub force: u64,
    /// Speed of the needle into the tissue.
    pub push_speed: u64,
    /// Speed of the needle about its axis.
    pub rotation_speed: u64,
    /// Guide moved while the needle was pushed.
    pub moved_while_pushed: u64,
    /// Bending strain of the needle.
    pub strain: u64,
}

impl LimitViolations {
    /// Sum of all kinds.
    pub fn total(&self) -> u64 {
        self.travel
            + self.speed
            + self.force
            + self.push_speed
            + self.rotation_speed
            + self.moved_while_pushed
            + self.strain
    }
}
