//! Agreement of a run's force with a model (`--follow`), as results state it.

use crate::follow::{Follower, Parted};
use serde::Serialize;
use std::fmt::{self, Display};

/// Agreement of the force with a model.
#[derive(Serialize)]
pub(super) struct Followed {
    /// Whether guide 2 rested long enough for noise and zero to be known: without, nothing was compared.
    compared: bool,
    /// Points at which it no longer agreed.
    parted: Vec<Parted>,
}

impl From<Follower> for Followed {
    fn from(follower: Follower) -> Self {
        Self { compared: follower.is_following(), parted: follower.parted().to_vec() }
    }
}

impl Display for Followed {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if !self.compared {
            writeln!(
                f,
                "warning    not compared with the model: guide 2 did not rest for three seconds before"
            )?;
        } else if self.parted.is_empty() {
            writeln!(f, "model      the force follows it")?;
        }
        self.parted.iter().try_for_each(|parted| {
            let start_text = format!("{:.1} s of the device's clock", parted.since_s);
            writeln!(f, "warning    {}", parted.sentence(start_text))
        })
    }
}
