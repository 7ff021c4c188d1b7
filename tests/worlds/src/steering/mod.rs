//! A plant to be steered, with a needle of its own: cubic elements of one millimetre, tissue as single springs every half
//! millimetre,
//! each with the place where it rests, a part that relaxes and a load at which it yields; actuators with offset and play; a tip
//! sensor
//! with noise, delay and bad readings.
//!
//! [`TiedNeedle`] is a second needle by another method, drawn by [`tied_world`] with a strain limit that matters and a load that
//! wanders.
//!
//! No part of this module calls the forward model.

mod draw;
mod needle;
mod sensor;
mod tied;
mod tied_draw;

pub use draw::{Kind, reachable_target, reachable_within, target_by_rotations, world};
pub use needle::{Needle, Tip, Tissue};
pub use sensor::{Body, Flaws, SimulatedPlant};
pub use tied::{TiedNeedle, Ties};
pub use tied_draw::{Tissues, far_target, tied_sibling, tied_world};
