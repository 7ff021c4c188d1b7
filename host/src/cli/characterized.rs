//! Knowledge of the rig: the file that a session names, or that the command line gives.

use formats::model_file::ModelFile;
use formats::session::SessionError;
use std::path::{Path, PathBuf};

/// The file of a characterised rig.
#[derive(clap::Args)]
pub struct CharacterizedArgs {
    /// Characterized rig (characterized.toml of `guide characterize --out`): its effects are in the model with their
    /// intervals (default: the file that `characterized` in the session's [rig] names, if any)
    #[arg(long, value_name = "FILE")]
    characterized: Option<PathBuf>,
}

impl CharacterizedArgs {
    /// The file that the command line gives.
    pub fn file(&self) -> Option<&Path> {
        self.characterized.as_deref()
    }

    /// The file and what it has, for the session in a folder.
    pub fn read(&self, dir: &Path) -> Result<Option<(PathBuf, ModelFile)>, SessionError> {
        match &self.characterized {
            Some(path) => Ok(Some((path.clone(), ModelFile::read(path)?))),
            None => ModelFile::of_session_rig(dir),
        }
    }
}
