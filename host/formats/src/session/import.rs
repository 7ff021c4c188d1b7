//! Recordings of others as parts of a session.
//!
//! [`trajcontrol`]: insertions with an electromagnetic tip sensor; rows that are no readings are skipped, each for a stated reason
//! ([`SkipReason`]).
//!
//! [`slicer`] and [`poses`]: a needle's shape as points in space, from 3D Slicer and from shape-sensing fibres; [`Frame`] makes them
//! positions along the needle and deflections.

mod fiducials;
mod frame;
mod matrices;
mod poses;
mod screen;
mod slicer;
mod trajcontrol;

pub use frame::{Axis, Frame, FrameError, NeedlePoints, Straight, id_of, name_of};
pub use poses::{LengthUnit, poses};
pub(crate) use screen::{Reading, count, screen_positions};
pub use screen::{SkipReason, Skipped};
pub use slicer::slicer;
pub use trajcontrol::{Recording, trajcontrol};

#[cfg(test)]
mod shape_tests;
