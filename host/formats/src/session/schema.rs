//! Content of the format: columns of its tables with the values that can be right, fields of its
//! documents.

use super::SHARED_ERRORS;
use crate::document::table::Column;

const MM: f64 = 1e-3;
const TIME_S: [f64; 2] = [-1e10, 1e10];
/// Insertion depths; the least is for files: a recorded insertion may start a little outside.
const DEPTH_MM: [f64; 2] = [0.0, 500.0];
const LATERAL_MM: [f64; 2] = [-200.0, 200.0];
const FORCE_N: [f64; 2] = [-200.0, 200.0];
/// Standard deviations of positions.
pub(super) const SD_MM: [f64; 2] = [1e-9, 50.0];
/// Radius of a punch, and Poisson's ratio of the tissue under it.
pub(super) const RADIUS_MM: [f64; 2] = [1e-4, 100.0];
/// Angle between axis and side of a cone.
pub(super) const HALF_ANGLE_DEG: [f64; 2] = [5.0, 89.0];
pub(super) const THICKNESS_MM: [f64; 2] = [1e-3, 1000.0];
pub(super) const POISSON: [f64; 2] = [0.0, 0.5];

pub(super) const FORCE_COLUMNS: [Column; 10] = [
    Column::required("time_s", 1.0, TIME_S).increasing(),
    Column::required("displacement_y_mm", MM, [-50.0, 50.0]),
    Column::required("force_y_n", 1.0, FORCE_N),
    Column::optional("displacement_x_mm", MM, [-50.0, 50.0]),
    Column::optional("force_x_n", 1.0, FORCE_N),
    Column::optional("displacement_y_sd_mm", MM, SD_MM),
    Column::optional("displacement_x_sd_mm", MM, SD_MM),
    Column::optional("lost_before", 1.0, [0.0, 1e12]).whole(),
    Column::optional("step", 1.0, [0.0, 4_294_967_295.0]).whole().blank(),
    Column::optional("moving", 1.0, [0.0, 1.0]).whole().blank(),
];
/// Columns of the errors that all points of a run share, of both planes.
pub(super) const SHARED_COLUMNS: [[&str; SHARED_ERRORS]; 2] = [
    ["deflection_y_shared_1_mm", "deflection_y_shared_2_mm", "deflection_y_shared_3_mm"],
    ["deflection_x_shared_1_mm", "deflection_x_shared_2_mm", "deflection_x_shared_3_mm"],
];
const SHARED_MM: [f64; 2] = [-50.0, 50.0];
pub(super) const SHAPE_COLUMNS: [Column; 15] = [
    Column::optional("time_s", 1.0, TIME_S),
    Column::required("z_mm", MM, [0.0, 2000.0]),
    Column::required("deflection_y_mm", MM, LATERAL_MM),
    Column::optional("deflection_x_mm", MM, LATERAL_MM),
    Column::optional("deflection_y_sd_mm", MM, SD_MM),
    Column::optional("deflection_x_sd_mm", MM, SD_MM),
    Column::optional("beam_deg", std::f64::consts::PI / 180.0, [-360.0, 360.0]),
    Column::optional("probe_mm_per_s", MM, [-1000.0, 1000.0]),
    Column::optional("z_shared_sd_mm", MM, [0.0, 50.0]),
    Column::optional(SHARED_COLUMNS[0][0], MM, SHARED_MM),
    Column::optional(SHARED_COLUMNS[0][1], MM, SHARED_MM),
    Column::optional(SHARED_COLUMNS[0][2], MM, SHARED_MM),
    Column::optional(SHARED_COLUMNS[1][0], MM, SHARED_MM),
    Column::optional(SHARED_COLUMNS[1][1], MM, SHARED_MM),
    Column::optional(SHARED_COLUMNS[1][2], MM, SHARED_MM),
];
/// Slope of the needle at the tip: beyond one in one no insertion is straight ahead.
const DIRECTION_MRAD: [f64; 2] = [-1000.0, 1000.0];
pub(super) const INSERTION_COLUMNS: [Column; 10] = [
    Column::required("depth_mm", MM, [-50.0, 500.0]),
    Column::required("tip_y_mm", MM, LATERAL_MM),
    Column::optional("tip_x_mm", MM, LATERAL_MM),
    Column::optional("time_s", 1.0, TIME_S).steady(),
    Column::optional("rotation_deg", std::f64::consts::PI / 180.0, [-1e6, 1e6]),
    Column::optional("guide2_y_mm", MM, [-50.0, 50.0]),
    Column::optional("guide2_x_mm", MM, [-50.0, 50.0]),
    Column::optional("base_force_y_n", 1.0, FORCE_N),
    Column::optional("tip_direction_y_mrad", 1e-3, DIRECTION_MRAD).blank(),
    Column::optional("tip_direction_x_mrad", 1e-3, DIRECTION_MRAD).blank(),
];
pub(super) const INDENTATION_COLUMNS: [Column; 2] =
    [Column::required("depth_mm", MM, [-50.0, 100.0]), Column::required("force_n", 1.0, FORCE_N)];
pub(super) const STEERING_COLUMNS: [Column; 5] = [
    Column::required("time_s", 1.0, TIME_S).increasing(),
    Column::required("depth_mm", MM, DEPTH_MM),
    Column::required("base_y_mm", MM, LATERAL_MM),
    Column::required("base_force_y_n", 1.0, FORCE_N),
    Column::required("tip_y_mm", MM, LATERAL_MM),
];

/// Fields of `[needle]`.
pub(super) const NEEDLE: [&str; 9] = [
    "id",
    "youngs_modulus_gpa",
    "outer_diameter_mm",
    "inner_diameter_mm",
    "outer_diameter_sd_mm",
    "inner_diameter_sd_mm",
    "bevel_angle_deg",
    "length_mm",
    "bending_stiffness",
];
/// Fields of `[rig]`.
pub(super) const RIG: [&str; 10] = [
    "id",
    "characterized",
    "guide2_mm",
    "entry_mm",
    "guide2_sd_mm",
    "entry_sd_mm",
    "fixture_mass_kg",
    "guides",
    "rear_rotation_y_n_m_per_rad",
    "rear_rotation_x_n_m_per_rad",
];
/// Fields of `[noise]`.
pub(super) const NOISE: [&str; 6] =
    ["force_n", "force_zero_n", "displacement_mm", "shape_mm", "tip_mm", "tip_direction_mrad"];
/// Fields of `[tissue]`.
pub(super) const TISSUE: [&str; 8] =
    ["id", "foundation", "poisson", "poisson_sd", "body_mm", "needle_at_mm", "sides", "far_side"];
