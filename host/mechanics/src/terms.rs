//! Terms: what may be missing from the plain model when no effect of the catalogue is it.
//!
//! A term is a triple: the **site** where it acts, the **regressor** it depends on, and the **form** of the function between them, with one
//! parameter or two. Every triple is an [`Effect`](super::effects::Effect) whose id says it, as `law.force.time.sine`; everything that takes an
//! effect takes a term. The catalogue is a dictionary of triples with names: those that are in it are not in [`grammar`].
//!
//! | | |
//! |---|---|
//! | [`Site`] | what is changed, in which unit, how much a careful laboratory would overlook |
//! | [`Regressor`] | what it depends on, in which unit, and its typical size |
//! | [`Form`] | the function, its parameters and its formula |
//! | [`Law`] | the three together, as an effect |

mod acting;
mod apply;
mod form;
mod formula;
mod law;
mod regressor;
mod site;

pub use acting::ActingLaw;
pub(crate) use acting::Shifts;
pub use form::Form;
pub use law::{DefineError, FunctionOf, Law, OwnFunction, OwnLaw, define, grammar, own, term};
pub use regressor::Regressor;
pub use site::{Scope, Site};

/// Conditions under which a needle is solved, beside rig and tissue.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Conditions {
    /// Length of the needle inside the tissue.
    pub depth_m: f64,
    /// Number of the run in its session, 0 for the first.
    pub order: f64,
}
