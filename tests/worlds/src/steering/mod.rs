//! A plant to be steered, with a needle of its own: cubic elements of one millimetre, tissue as single springs every half millimetre,
//! each with the place where it rests, a part that relaxes and a load at which it yields; actuators with offset and play; a tip sensor
//! with noise, delay and bad readings.
//!
//! Nothing here calls the forward model.

mod draw;
mod needle;
mod sensor;

pub use draw::{Kind, reachable_target, target_by_rotations, world};
pub use needle::{Needle, Tip, Tissue};
pub use sensor::{Flaws, SimulatedPlant};
