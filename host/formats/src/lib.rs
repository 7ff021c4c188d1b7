//! Files of the needle guide: what a measurement session holds, what is known of a rig, and how both are read and written.
//!
//! | module | files |
//! |---|---|
//! | [`session`] | a folder of `session.toml` and CSV tables: what was measured, and with what; imports from elsewhere |
//! | [`model_file`] | `model.toml`: effects and sizes of discrepancy of a rig, from one diagnosis to the next |
//! | [`effect_file`] | effects that a person has written, as formulas |
//! | [`prior_file`] | `prior.toml`: what many sessions predict of the next one |
//! | [`foreign`] | tables of other laboratories, of which a run is taken |
//! | [`document`] | what they have in common: fields, tables, errors with places |
//! | [`files`] | files that are written as a whole or not at all |
//! | [`calibration_file`] | `calibration.toml`: the constants that the device works with |
//! | [`calibration_readings`] | known loads and gauges, from which they are computed |
//! | [`image_calibration`] | `image.toml`: where an ultrasound image plane is on its probe |
//!
//! Every error names file, line, column and field, and what is valid.
//!
//! # Example
//!
//! ```
//! use formats::session::Session;
//! use std::path::Path;
//!
//! // An error states where, what, and what is valid.
//! match Session::read(Path::new("no-such-session")) {
//!     Err(error) => assert!(error.to_string().contains("no-such-session")),
//!     Ok(_) => unreachable!("there is no such session"),
//! }
//! ```
#![forbid(unsafe_code)]
#![deny(missing_docs)]

/// Half-width of a 95 % interval of a normal distribution, in standard deviations: its 97.5 % quantile.
pub const NORMAL_975: f64 = 1.959_963_984_540_054;

pub mod calibration_file;
pub mod calibration_readings;
pub mod document;
pub mod effect_file;
pub mod files;
pub mod foreign;
pub mod image_calibration;
pub mod model_file;
pub mod prior_file;
pub mod session;
