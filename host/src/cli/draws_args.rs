//! Draws from posteriors: the same options wherever an interval is stated.

use super::output::{Output, write_file};
use crate::foreign::{Form, printable};
use anyhow::Context;
use clap::value_parser;
use inference::draws::{DrawOptions, Draws};
use std::path::PathBuf;

/// Chains of a file of draws: as many as samplers usually have.
const CHAINS: usize = 4;

/// File and number of draws.
#[derive(clap::Args)]
pub struct DrawsArgs {
    /// Write draws from the posterior into this file, in the layout of ArviZ (InferenceData as JSON): four chains
    #[arg(long, value_name = "FILE")]
    draws: Option<PathBuf>,
    /// Number of draws in each of these chains
    #[arg(long, value_name = "DRAWS", default_value_t = 250, value_parser = value_parser!(u32).range(10..=100_000))]
    draws_per_chain: u32,
}

impl DrawsArgs {
    /// Number of draws; `None` if there is no file for them.
    pub fn options(&self, seed: u64) -> Option<DrawOptions> {
        let draws = self.draws_per_chain as usize;
        self.draws.as_ref().map(|_| DrawOptions { chains: CHAINS, draws, seed })
    }

    /// Writes the draws that were taken.
    pub fn write(&self, draws: Option<&Draws>, out: &Output) -> anyhow::Result<()> {
        let (Some(path), Some(draws)) = (&self.draws, draws) else { return Ok(()) };
        let document =
            serde_json::to_string(draws).with_context(|| format!("{}: cannot write", path.display()))?;
        write_file(path, &format!("{}\n", printable(&document, Form::Json)))?;
        out.note(format_args!("wrote {}", path.display()));
        Ok(())
    }
}
