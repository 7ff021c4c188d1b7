//! Steering a needle to a target: estimate while pushing, plan guide moves, supervise, record.
//!
//! [`steer()`] pushes the needle of a [`Plant`] and lets it rest every few millimetres. At each rest the tip readings so far give the
//! posterior of tissue, gap, angle, guide errors and tip (Gauss-Newton steps on the one forward model, [`mechanics::growth`]); from it
//! follow the guide positions at all rests to come that minimise the expected squared miss at the target's depth, within travel, force
//! and strain; the first is carried out. Two laws of the tip are averaged by their evidence: it takes a load, or it cuts at an angle to
//! the needle.
//!
//! [`plan_path()`] states and plans the same without a plant, before anything moves.
//!
//! A plant is anything that answers steps ([`Plant`]): a program over its standard input and output ([`ProcessPlant`]), a record
//! ([`ReplayPlant`]), or code of your own. Units are in the names of fields: mm, s, N, degrees at this surface, SI inside.
//!
//! # Example
//!
//! A needle in a tissue that holds it straight, and a sensor without noise:
//!
//! ```
//! use steering::{Answer, Command, End, Options, Plant, PlantError, Statement, steer};
//!
//! /// The tip moves against guide 2, in proportion to the depth that is pushed.
//! #[derive(Default)]
//! struct Toy {
//!     tip_mm: [f64; 2],
//!     depth_mm: f64,
//!     steps: i64,
//! }
//!
//! impl Plant for Toy {
//!     fn start(&mut self) -> Result<Statement, PlantError> {
//!         let text = r#"{"plant": "needle/1", "needle": {}, "rig": {"guide2_to_surface_mm": 20, "move_while_pushing": false,
//!             "can_rotate": false}, "limits": {"guide_travel_mm": 6, "guide_speed_mm_s": 4, "push_speed_mm_s": 5,
//!             "rotation_speed_deg_s": 0}, "max_depth_mm": 80, "depth_step_mm": 1, "tip_noise_mm": 0.1, "tip_delay_s": 0,
//!             "tip_rate_hz": 10, "guide_error_mm": 0.1, "bevel_deg": 0}"#;
//!         serde_json::from_str(text).map_err(|error| PlantError::NotStarted(error.to_string()))
//!     }
//!
//!     fn step(&mut self, to: &Command) -> Result<Answer, PlantError> {
//!         let pushed_mm = to.depth_mm - self.depth_mm;
//!         self.tip_mm[0] -= 0.02 * pushed_mm * to.guide_x_mm;
//!         self.tip_mm[1] -= 0.02 * pushed_mm * to.guide_y_mm;
//!         self.depth_mm = to.depth_mm;
//!         self.steps += 1;
//!         // Readings that repeat to the digit count as those of a frozen sensor.
//!         let noise_mm = 1e-3 * (self.steps % 7) as f64;
//!         Ok(Answer {
//!             t_s: to.t_s, depth_mm: to.depth_mm, guide_x_mm: to.guide_x_mm, guide_y_mm: to.guide_y_mm,
//!             bevel_deg: to.bevel_deg, force_x_n: None, force_y_n: None, tip_seq: self.steps,
//!             tip_x_mm: self.tip_mm[0] + noise_mm, tip_y_mm: self.tip_mm[1], tip_t_s: None, valid: true,
//!             tip_slope_x_mrad: None, tip_slope_y_mrad: None,
//!         })
//!     }
//!
//!     fn end(&mut self) -> Result<End, PlantError> {
//!         Ok(End { depth_mm: self.depth_mm, ..End::default() })
//!     }
//! }
//!
//! let run = steer(&mut Toy::default(), &Options::new([1.0, -0.5, 40.0]), &mut |_| {})?;
//! assert_eq!(run.depth_mm, 40.0);
//! assert!(run.miss_is_measured && run.decisions.len() == 7);
//! # Ok::<(), steering::SteerError>(())
//! ```
#![forbid(unsafe_code)]
#![deny(missing_docs)]

mod clamp;
mod controller;
mod envelope;
mod estimator;
mod history;
mod known;
mod line;
mod planner;
mod plant;
mod probability;
mod process;
mod protocol;
mod readings;
mod record;
mod results;
mod tables;
mod unknowns;

pub use controller::{GUIDE_SETTLING_S, Options, SteerError, plan_path, steer};
pub use known::KnownEffect;
pub use plant::{DeviceFault, Plant, PlantError};
pub use process::ProcessPlant;
pub use protocol::{
    Answer, Command, Done, End, LimitViolations, Limits, NeedleStatement, PriorStatement, RigStatement,
    Statement, VERSION,
};
pub use record::{Record, Recorded, ReplayPlant};
pub use results::{
    ComparedChannel, Comparison, Cue, Decision, Event, LimitRisk, Outcome, PathPlan, PathPoint,
    PlannedRotation, Probability, Run, Spread,
};
