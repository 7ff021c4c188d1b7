//! Comparison of the force with a model (`--follow`): its options, and the agreement as results state it.

use super::record::depth_mm;
use crate::follow::{Follower, Parted};
use anyhow::Context;
use formats::model_file::ModelFile;
use formats::session::Setup;
use mechanics::Rig;
use serde::Serialize;
use std::fmt::{self, Display};
use std::path::{Path, PathBuf};

/// Comparison of the force with a model, where no session states needle and depth.
#[derive(clap::Args)]
pub(super) struct FollowArgs {
    /// Compare the force with this model (model.toml of `guide diagnose --out`) and say since when it no longer follows
    #[arg(long, value_name = "FILE", requires_all = ["port", "rig", "depth_mm"])]
    follow: Option<PathBuf>,
    /// Needle and guides of --follow: a TOML file with `[needle]`, `[rig]` as in a session
    #[arg(long, value_name = "FILE", requires = "follow")]
    rig: Option<PathBuf>,
    /// Insertion depth of --follow, millimetres
    #[arg(long, value_name = "MM", value_parser = depth_mm, requires = "follow")]
    depth_mm: Option<f64>,
}

impl FollowArgs {
    /// The comparison, if a model is given.
    pub(super) fn follower(&self) -> anyhow::Result<Option<Follower>> {
        let (Some(path), Some(rig), Some(depth_mm)) = (&self.follow, &self.rig, self.depth_mm) else {
            return Ok(None);
        };
        follower(path, &Setup::read(rig)?.rig, depth_mm).map(Some)
    }
}

/// Comparison of the force with the model of a file, for a needle at a depth.
pub(super) fn follower(path: &Path, rig: &Rig, depth_mm: f64) -> anyhow::Result<Follower> {
    let model = ModelFile::read(path)?;
    Follower::new(&model, rig, 1e-3 * depth_mm)
        .with_context(|| format!("{}: cannot be followed", path.display()))
}

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
