//! Simulated rig of the needle guide.
//!
//! | module | has |
//! |---|---|
//! | [`rig`] | actuators, force sensor, needle and tissue as the firmware meets them, period by period |
//! | [`simulate`] | whole sessions as files, from a plan |
//!
//! What it computes comes from the same forward model as identification and prediction; worlds for tests of these two come from
//! elsewhere.
#![forbid(unsafe_code)]
#![deny(missing_docs)]

pub mod rig;
pub mod simulate;
