//! In place of the live screen, in a program that is built without it.

use crate::cli::output::Output;
use crate::follow::Parted;
use anyhow::ensure;
use steering::{Event, Run, SteerError};

/// Live view without a screen: a run prints only lines of text.
pub struct Live;

impl Live {
    /// For any run.
    ///
    /// # Errors
    /// Where the screen is requested.
    pub fn new(shown: bool, _: [f64; 3], _: &Output) -> anyhow::Result<Self> {
        ensure!(
            !shown,
            "--screen: this program was built without its feature `screen`, expected no --screen"
        );
        Ok(Self)
    }

    /// Takes no terminal.
    ///
    /// # Errors
    /// Never.
    pub fn begin(&mut self) -> anyhow::Result<()> {
        Ok(())
    }

    /// Whether the screen stands for lines of text.
    pub fn is_shown(&self) -> bool {
        false
    }

    /// Draws nothing.
    pub fn take(&mut self, _: &Event) {}

    /// Draws nothing.
    pub fn parted(&mut self, _: &Parted) {}

    /// Prints nothing.
    ///
    /// # Errors
    /// Never.
    pub fn end(self, _: &Result<Run, SteerError>, _: &mut Output) -> anyhow::Result<()> {
        Ok(())
    }
}
