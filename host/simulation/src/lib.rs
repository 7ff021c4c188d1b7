//! Simulated rig of the needle guide.
//!
//! | module | has |
//! |---|---|
//! | [`rig`] | actuators, force sensor, needle and tissue at the interface of the firmware, period by period |
//! | [`simulate`] | whole sessions as files, from a plan |
//!
//! It computes with the same forward model as identification and prediction. The generators that test those two are independent of it
//! (`tests/worlds`).
//!
//! # Example
//!
//! ```
//! use simulation::rig::config::RigConfig;
//! use simulation::rig::SimulatedRig;
//!
//! let rig = SimulatedRig::new(RigConfig::default(), 7)?;
//! assert!(rig.truth().modulus_pa > 1e3);
//! assert_eq!(rig.force_n().len(), 2);
//! # Ok::<(), simulation::rig::RigError>(())
//! ```
#![forbid(unsafe_code)]
#![deny(missing_docs)]

pub mod rig;
pub mod simulate;
