//! `guide completions` and `guide man`: what a shell and `man` need of this program, from the definition of its command line.

use super::Cli;
use super::output::{Output, write_file};
use anyhow::Context;
use clap::{Command, CommandFactory};
use clap_complete::Shell;
use serde::Serialize;
use std::fs;
use std::path::{Path, PathBuf};

/// Print the completion of sub-commands and options for a shell
#[derive(clap::Args)]
#[command(
    after_help = "Example:\n  guide completions bash > ~/.local/share/bash-completion/completions/guide\n  guide completions zsh > \
                  ~/.zfunc/_guide\n  guide completions fish > ~/.config/fish/completions/guide.fish"
)]
pub struct CompletionsArgs {
    /// The shell
    #[arg(value_enum)]
    shell: Shell,
}

/// Print a manual page, or write those of all sub-commands
#[derive(clap::Args)]
#[command(
    after_help = "Example:\n  guide man identify | man -l -\n  guide man --out ~/.local/share/man/man1 && man guide-identify"
)]
pub struct ManArgs {
    /// Sub-command whose page is printed (default: the page of the program)
    #[arg(value_name = "COMMAND", conflicts_with = "out")]
    command: Option<String>,
    /// Write guide.1 and a page per sub-command into this folder; pages that are there are replaced
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
}

#[derive(Serialize)]
struct Completions {
    schema: &'static str,
    shell: String,
    script: String,
}

#[derive(Serialize)]
struct Pages {
    schema: &'static str,
    /// The page that was requested, where no folder is given.
    #[serde(skip_serializing_if = "Option::is_none")]
    page: Option<String>,
    /// Files written.
    files: Vec<PathBuf>,
}

/// Runs `guide completions`.
pub fn completions(args: &CompletionsArgs, out: &mut Output) -> anyhow::Result<()> {
    let mut script = Vec::new();
    clap_complete::generate(args.shell, &mut Cli::command(), "guide", &mut script);
    let script = String::from_utf8(script).context("the completion script")?;
    let completions =
        Completions { schema: "guide.completions/1", shell: args.shell.to_string(), script: script.clone() };
    out.result(&completions, script)
}

/// Runs `guide man`.
pub fn man(args: &ManArgs, out: &mut Output) -> anyhow::Result<()> {
    let mut pages = Pages { schema: "guide.man/1", page: None, files: Vec::new() };
    let Some(folder) = &args.out else {
        let page = page(named(args.command.as_deref())?)?;
        pages.page = Some(page.clone());
        return out.result(&pages, page);
    };
    fs::create_dir_all(folder).with_context(|| format!("{}: cannot create", folder.display()))?;
    let mut command = Cli::command();
    command.build();
    write_pages(&command, "guide", folder, &mut pages.files)?;
    let lines: String = pages.files.iter().map(|path| format!("written      {}\n", path.display())).collect();
    out.result(&pages, lines)
}

/// The program, or its sub-command of this name.
fn named(name: Option<&str>) -> anyhow::Result<Command> {
    let mut program = Cli::command();
    let Some(name) = name else { return Ok(program) };
    // A sub-command has the options that all of them have once the program is built.
    program.build();
    let command = program
        .find_subcommand(name)
        .with_context(|| format!("COMMAND: {name}, expected one of {}", names(&program)))?;
    Ok(command.clone())
}

fn names(program: &Command) -> String {
    program.get_subcommands().map(Command::get_name).collect::<Vec<_>>().join(", ")
}

/// One page: name, synopsis, options, examples.
fn page(command: Command) -> anyhow::Result<String> {
    let mut bytes = Vec::new();
    clap_mangen::Man::new(command).render(&mut bytes).context("a manual page")?;
    String::from_utf8(bytes).context("a manual page")
}

/// The page of a command and those of its sub-commands, as `man` names them: `guide-identify.1`.
fn write_pages(command: &Command, name: &str, folder: &Path, files: &mut Vec<PathBuf>) -> anyhow::Result<()> {
    let path = folder.join(format!("{name}.1"));
    write_file(&path, &page(command.clone())?)?;
    files.push(path);
    for part in command.get_subcommands().filter(|part| part.get_name() != "help") {
        write_pages(part, &format!("{name}-{}", part.get_name()), folder, files)?;
    }
    Ok(())
}
