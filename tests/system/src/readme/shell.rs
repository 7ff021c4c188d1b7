//! Console blocks: the commands in them, run in one folder.

use super::page::Block;
use anyhow::{Context, Result, bail, ensure};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

/// The port of a running rig, as the pages show it.
const PORT: &str = "/tmp/needle-guide-AbCdEf/serial";

/// Working folder of the commands of console blocks, and replacements of the page's names.
#[derive(Debug, Clone)]
pub struct Shell {
    guide: PathBuf,
    folder: PathBuf,
    port: Option<String>,
}

impl Shell {
    /// Runs this `guide` in this folder.
    pub fn new(guide: PathBuf, folder: &Path) -> Self {
        Self { guide, folder: folder.to_owned(), port: None }
    }

    /// With this port in place of the pages'.
    #[must_use]
    pub fn with_port(self, port: String) -> Self {
        Self { port: Some(port), ..self }
    }

    /// Folder that the commands run in.
    pub fn folder(&self) -> &Path {
        &self.folder
    }

    /// The block with what its commands print now.
    ///
    /// # Errors
    /// Where a command fails that should not or the other way round, or is none of `guide`; the error names its line.
    pub fn run(&self, block: &Block) -> Result<String> {
        let mut text = String::new();
        let mut printed_before = false;
        for command in commands(block.lines()) {
            let printed = self
                .output(&command.joined, block.fails)
                .with_context(|| format!("{}: `{}`", block.place_of(command.line), command.joined))?;
            if printed_before {
                text.push('\n');
            }
            printed_before = !printed.is_empty();
            for line in command.shown.iter().map(String::as_str).chain(printed.lines()) {
                text.push_str(line.trim_end());
                text.push('\n');
            }
        }
        ensure!(!text.is_empty(), "{}: no line begins with `$ `", block.place());
        Ok(text)
    }

    fn output(&self, command: &str, fails: bool) -> Result<String> {
        let words = shlex::split(command).context("quotes without an end")?;
        let [program, arguments @ ..] = words.as_slice() else { bail!("no command") };
        ensure!(program == "guide", "only commands of `guide` are run");
        let arguments = arguments.iter().map(|argument| match &self.port {
            Some(port) if argument == PORT => port.clone(),
            _ => argument.clone(),
        });
        let output = Command::new(&self.guide)
            .args(arguments)
            .current_dir(&self.folder)
            .stdin(Stdio::null())
            // The width of help and the colours are those of no terminal, for every caller.
            .env_remove("COLUMNS")
            .env("NO_COLOR", "1")
            .output()
            .context("cannot start")?;
        let complaint = String::from_utf8_lossy(&output.stderr);
        if fails {
            ensure!(!output.status.success(), "succeeds");
            return Ok(String::from_utf8(output.stdout)? + &complaint);
        }
        ensure!(output.status.success(), "fails: {}", complaint.trim());
        Ok(String::from_utf8(output.stdout)?)
    }
}

struct Typed {
    /// Line of the block, counted from 0.
    line: usize,
    shown: Vec<String>,
    joined: String,
}

/// The commands of a console block: lines after `$ `, with those that a backslash continues.
fn commands(lines: &[String]) -> Vec<Typed> {
    let mut commands: Vec<Typed> = Vec::new();
    let mut goes_on = false;
    for (number, line) in lines.iter().enumerate() {
        let typed = line.strip_prefix("$ ");
        if let Some(text) = typed {
            commands.push(Typed { line: number, shown: vec![line.clone()], joined: text.to_owned() });
        } else if goes_on && let Some(last) = commands.last_mut() {
            last.shown.push(line.clone());
            last.joined = format!("{} {}", last.joined.trim_end_matches('\\').trim_end(), line.trim_start());
        }
        goes_on = (typed.is_some() || goes_on) && line.ends_with('\\');
    }
    commands
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn commands_are_joined_over_their_lines() {
        let text = ["$ guide a \\", "    --b 'c d' \\", "    --e", "printed \\", "printed", "$ guide f"];
        let commands = commands(&text.map(str::to_owned));
        let joined: Vec<(usize, &str)> =
            commands.iter().map(|typed| (typed.line, typed.joined.as_str())).collect();
        assert_eq!(joined, [(0, "guide a --b 'c d' --e"), (5, "guide f")]);
        assert_eq!(commands[0].shown.len(), 3);
    }
}
