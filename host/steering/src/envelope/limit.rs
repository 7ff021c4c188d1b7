//! Names of the limits of a plan.

use std::fmt;

/// Limit of a plan.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum Limit {
    /// Bending strain of the needle.
    Strain,
    /// Lateral force of guide 2.
    Force,
    /// Compression of the tissue by the needle.
    Compression,
    /// Travel of guide 2.
    Travel,
    /// The largest move at one stop.
    LargestMove,
}

impl Limit {
    /// Its name in results.
    pub fn name(self) -> &'static str {
        match self {
            Self::Strain => "strain",
            Self::Force => "force",
            Self::Compression => "compression",
            Self::Travel => "travel",
            Self::LargestMove => "largest_move",
        }
    }
}

impl fmt::Display for Limit {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Strain => "the limit of the needle's strain",
            Self::Force => "the force limit of guide 2",
            Self::Compression => "the limit of the tissue's compression",
            Self::Travel => "the travel of guide 2",
            Self::LargestMove => "the largest move at one stop",
        })
    }
}
