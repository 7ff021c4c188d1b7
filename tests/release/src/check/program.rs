//! The program `guide` of a bundle, here or under Wine, with nothing of the caller's environment.

use anyhow::{Context, Result, ensure};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

/// A program, and the folder that it is run in.
pub struct Program {
    path: PathBuf,
    /// Wine's folder of settings.
    prefix: Option<PathBuf>,
    folder: PathBuf,
}

impl Program {
    /// One for this system.
    pub fn native(path: PathBuf, folder: &Path) -> Self {
        Self { path, prefix: None, folder: folder.to_owned() }
    }

    /// One for Windows.
    pub fn under_wine(path: PathBuf, prefix: &Path, folder: &Path) -> Self {
        Self { path, prefix: Some(prefix.to_owned()), folder: folder.to_owned() }
    }

    /// Name of the system that it is for.
    pub fn system(&self) -> &'static str {
        if self.prefix.is_some() { "Windows" } else { "Linux" }
    }

    /// A path as this program's users write it.
    pub fn path(&self, path: &Path) -> String {
        let path = path.to_string_lossy();
        // Wine has the root of this system as drive Z.
        if self.prefix.is_some() { format!("Z:{}", path.replace('/', "\\")) } else { path.into_owned() }
    }

    /// The command with these arguments, in a folder.
    pub fn command(&self, arguments: &[&str]) -> Command {
        let mut command = match &self.prefix {
            Some(_) => {
                let mut command = Command::new("wine");
                command.arg(&self.path);
                command
            }
            None => Command::new(&self.path),
        };
        command.args(arguments).current_dir(&self.folder).stdin(Stdio::null()).env_clear();
        command.env("PATH", "/usr/bin:/bin").env("HOME", &self.folder).env("LC_ALL", "C.UTF-8");
        if let Some(prefix) = &self.prefix {
            command.env("WINEPREFIX", prefix).env("WINEDEBUG", "-all");
        }
        command
    }

    /// Standard output of a call that succeeds.
    pub fn call(&self, arguments: &[&str]) -> Result<String> {
        let output = self.command(arguments).output().with_context(|| self.call_name(arguments))?;
        let errors = String::from_utf8_lossy(&output.stderr);
        ensure!(
            output.status.success(),
            "{}: {}: {}",
            self.call_name(arguments),
            output.status,
            errors.trim()
        );
        String::from_utf8(output.stdout).with_context(|| self.call_name(arguments))
    }

    fn call_name(&self, arguments: &[&str]) -> String {
        format!("guide {} ({})", arguments.join(" "), self.system())
    }

    /// The message of a call that fails as commands do: with 1 and one line.
    pub fn failure(&self, arguments: &[&str]) -> Result<String> {
        let output = self.command(arguments).output()?;
        let errors = String::from_utf8_lossy(&output.stderr).into_owned();
        ensure!(output.status.code() == Some(1), "guide {}: {}", arguments.join(" "), output.status);
        Ok(errors)
    }

    /// Checks that the program states its version.
    pub fn states(&self, version: &str) -> Result<()> {
        let stated = self.call(&["--version"])?;
        ensure!(stated.starts_with(&format!("guide {version}")), "it states `{}`", stated.trim());
        Ok(())
    }
}
