//! Studies of the estimators on synthetic worlds: how far they are off, and how often their intervals cover the truth.
//!
//! | module | of | worlds from |
//! |---|---|---|
//! | [`relation`] | foundation modulus against Young's modulus | the continuum solution |
//! | [`plan`] | what `guide plan` promises | the forward model |
//! | [`predict`] | the path of insertions | the forward model |
//! | [`recorded`] | what guide moves do to the tip | recordings of others, read from a session |
//! | [`track`], [`layers`] | online estimators | the simulated steering rig |
//! | [`population`] | statistics over many sessions | `worlds`, by way of records |
//! | [`nesting`] | intervals of nested sessions | drawn values |
//! | [`mod@steer`] | steering to a target | a needle of its own, `worlds::steering` |
//! | [`diagnose`] | the diagnosis | an independent generator, `worlds` |
//! | [`calibration`] | posteriors: whether the truth lies among draws as chance has it | independent generators |
#![forbid(unsafe_code)]
#![deny(missing_docs)]

pub mod calibration;
pub mod diagnose;
pub mod layers;
pub mod nesting;
pub mod plan;
pub mod population;
pub mod predict;
pub mod recorded;
pub mod relation;
pub mod steer;
pub mod track;
