//! The needle's shape from ultrasound frames, and the motion of guide 2 from the frames of a camera.
//!
//! | module | has |
//! |---|---|
//! | [`read`] | sequences as laboratories record them, frame by frame in bounded memory |
//! | [`detect`] | candidates for the needle's cross-section in a frame, with their covariance |
//! | [`pose`] | where the image plane is: frame number, speed, a field of the file, transforms |
//! | [`track`], [`curve`] | which candidates are the needle, decided by the sequence as a whole |
//! | [`sweep`] | all of it: every frame with its state, points of the shape, deflection from the straight needle |
//! | [`camera`] | guide 2 and a fixed mark followed through a clip, to hundredths of a pixel, with covariance and state of every frame |
//! | [`overlay`], [`sheet`] | pictures of frames with what was found, one by one and together |
//!
//! No result here depends on a tissue: inference does.
//!
//! # Example
//!
//! Forty frames 1 mm apart, in which an echo moves:
//!
//! ```
//! use imaging::pose::Place;
//! use imaging::read::Sequence;
//! use imaging::sweep::{Settings, State, measure};
//! use std::io::Write;
//!
//! let folder = tempfile::tempdir()?;
//! let path = folder.path().join("sweep.mha");
//! let mut file = std::fs::File::create(&path)?;
//! writeln!(file, "DimSize = 120 90 40\nElementSpacing = 0.1 0.1\nElementType = MET_UCHAR\nElementDataFile = LOCAL")?;
//! for frame in 0..40 {
//!     let (x, y) = (60.0 + 0.5 * f64::from(frame), 50.0);
//!     let pixel = |i: i32| {
//!         let (dx, dy) = (f64::from(i % 120) - x, f64::from(i / 120) - y);
//!         20.0 + 200.0 * (-0.5 * ((dx / 5.0).powi(2) + (dy / 3.0).powi(2))).exp()
//!     };
//!     file.write_all(&(0..120 * 90).map(|i| pixel(i) as u8).collect::<Vec<_>>())?;
//! }
//! let settings = Settings {
//!     needle_mm: 1.27,
//!     spacing_mm: None,
//!     orientation: None,
//!     region: None,
//!     place: Place::Step { start_mm: 70.0, step_mm: 1.0 },
//!     lag_s: None,
//! };
//! let sweep = measure(&mut Sequence::open(&path)?, &settings, |_| {})?;
//! assert_eq!(sweep.count(State::Used), 40);
//! let last = sweep.points().last().copied().expect("a point");
//! let expected_mm = 6.0 + 0.05 * (last.z_mm - 70.0);
//! assert!((last.across_mm[0] - expected_mm).abs() < 0.01);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
#![forbid(unsafe_code)]
#![deny(missing_docs)]

pub mod calibrate;
pub mod camera;
pub mod curve;
pub mod detect;
pub mod error;
pub mod frame;
pub mod overlay;
pub mod places;
pub mod pose;
pub mod read;
pub mod sheet;
pub mod sweep;
pub mod track;

pub use error::ImagingError;
