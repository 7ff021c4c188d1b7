//! The program `guide`: its commands, and what they show.
//!
//! Dependencies point one way: commands call workflows (`inference`, `device`, `simulation`), these call the forward model
//! (`mechanics`) and the readers and writers of files (`formats`). Inside the libraries every quantity is in SI units; names at the
//! surfaces (files, options, results) carry their unit.
//!
//! # Example
//!
//! `guide effects tissue.skin --json` as a function:
//!
//! ```
//! let called = host::cli::call(["effects", "tissue.skin"].map(Into::into), |_| {})?;
//! assert!(called.document.contains("\"schema\":\"guide.effects/1\"") || called.document.contains("\"schema\": \"guide.effects/1\""));
//! # Ok::<(), host::cli::CallError>(())
//! ```
#![forbid(unsafe_code)]
#![deny(missing_docs)]

pub mod cli;
pub mod follow;
pub mod foreign;
pub mod igtl;
pub mod report;
#[cfg(feature = "screen")]
pub mod screen;

pub use figures;
