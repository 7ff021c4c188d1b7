//! `cargo xtask bench`: run times of the guide's programs, beside those of alternative libraries, and how they scale, on one page.
//!
//! References of the comparison are built here and nowhere else: the package has a workspace of its own, and the peers
//! in Python an environment in the target folder. Without Python or a network they are skipped, with the reason.

use crate::images;
use anyhow::{Context, Result, ensure};

/// Options of `cargo xtask bench`.
#[derive(clap::Args)]
pub struct Args {
    /// Seed of what is measured with
    #[arg(long, default_value_t = 1)]
    seed: u32,
}

/// Builds, measures and writes `host/benches/README.md`.
///
/// # Errors
/// Where something cannot be built, or a peer comes to another result.
pub fn run(args: &Args) -> Result<()> {
    let benches = images::root().join("host").join("benches");
    let target = images::target_dir();
    let status = images::cargo()
        .args(["run", "--quiet", "--release", "--manifest-path"])
        .arg(benches.join("beside").join("Cargo.toml"))
        .arg("--target-dir")
        .arg(&target)
        .arg("--")
        .arg(target.join("beside"))
        .arg(benches.join("README.md"))
        .arg(args.seed.to_string())
        .status()
        .context("cannot run cargo")?;
    ensure!(status.success(), "the benches failed");
    Ok(())
}
