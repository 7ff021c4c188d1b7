//! The sizes of a rig's discrepancy in a model file.

use std::collections::BTreeMap;

/// Groups whose sizes are found: as in a model file.
pub const DISCREPANCY_NAMES: [&str; 30] = [
    "modulus from run to run",
    "modulus changing from run to run",
    "modulus over depth",
    "repeating shape pattern",
    "smooth shape error",
    "shape error proportional to deflection",
    "shape error proportional to deflection, of one run",
    "shape offset of one run",
    "axes not square",
    "force zero of one run",
    "force gain of one run",
    "nonlinear force sensor",
    "hysteresis of the force",
    "creep of the force sensor",
    "force of one hold",
    "force on the way",
    "drift of the force in one run",
    "modulus from insertion to insertion",
    "tip load from insertion to insertion",
    "angle of entry from insertion to insertion",
    "surface from insertion to insertion",
    "roll from insertion to insertion",
    "tip load over depth of one insertion",
    "tip load over depth",
    "drift of the path of one insertion",
    "smooth error of the path",
    "drift of the direction of one insertion",
    "smooth error of the direction",
    "direction proportional to itself",
    "direction proportional to itself, of one insertion",
];

/// Sizes of groups by name, as multiples of what an ordinary rig has: found in another session, or stated in a model
/// file. A multiple above 1 applies to this session.
pub type Multiples = BTreeMap<String, f64>;
