//! `guide init`: a session to begin with, empty and explained, or simulated to play with.

use super::output::Output;
use super::simulate;
use anyhow::{Context, ensure};
use formats::session::template;
use serde::Serialize;
use std::fmt::{self, Display};
use std::fs::{self, OpenOptions};
use std::io::Write;
use std::path::{Path, PathBuf};

/// Make a session to begin with: an explained template, or an example to play with
#[derive(clap::Args)]
#[command(
    after_help = "Example:\n  guide init phantom-a\n  guide init --example playground && guide identify playground"
)]
pub struct Args {
    /// Folder of the session; nothing in it is overwritten
    dir: PathBuf,
    /// Make a small complete session from the simulator: lateral runs, insertions, a steering run, and something for `guide diagnose` to
    /// find
    #[arg(long)]
    example: bool,
    /// What the example's noise is drawn from
    #[arg(long, default_value_t = 1, requires = "example")]
    seed: u64,
}

#[derive(Serialize)]
struct Begun {
    schema: &'static str,
    session: PathBuf,
    example: bool,
    files: Vec<PathBuf>,
}

/// File from which the example is made.
const PLAN: &str = "plan.toml";

/// Runs the sub-command.
pub fn run(args: &Args, out: &mut Output) -> anyhow::Result<()> {
    let session = args.dir.join("session.toml");
    let wanted: Vec<(PathBuf, &str)> = if args.example {
        vec![(args.dir.join(PLAN), template::EXAMPLE_PLAN)]
    } else {
        let tables = template::TABLES.iter().map(|(name, text)| (args.dir.join(name), *text));
        std::iter::once((session.clone(), template::SESSION)).chain(tables).collect()
    };
    for path in wanted.iter().map(|(path, _)| path).chain([&session]) {
        ensure!(!path.exists(), "{}: is there already, expected a folder without it", path.display());
    }
    fs::create_dir_all(&args.dir).with_context(|| format!("{}: cannot create", args.dir.display()))?;
    for (path, text) in &wanted {
        write_new(path, text)?;
    }
    let mut files: Vec<PathBuf> = wanted.into_iter().map(|(path, _)| path).collect();
    if args.example {
        simulate::make(&args.dir.join(PLAN), None, &args.dir, args.seed)?;
        files.push(session);
    }
    let begun = Begun { schema: "guide.init/1", session: args.dir.clone(), example: args.example, files };
    out.result(&begun, &begun)
}

/// Never replaces a file, not even one that has come up since.
fn write_new(path: &Path, text: &str) -> anyhow::Result<()> {
    let mut open = OpenOptions::new();
    let file = open.write(true).create_new(true).open(path);
    let written = file.and_then(|mut file| file.write_all(text.as_bytes()));
    written.with_context(|| format!("{}: cannot write", path.display()))
}

impl Display for Begun {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let dir = self.session.display();
        for path in &self.files {
            writeln!(f, "written      {}", path.display())?;
        }
        if self.example {
            writeln!(f, "session      {dir}: simulated; its ground truth is in {PLAN}, to be read last")?;
            for command in ["check", "identify", "predict", "track", "diagnose", "report"] {
                writeln!(f, "try          guide {command} {dir}")?;
            }
            Ok(())
        } else {
            writeln!(f, "session      {dir}: no runs yet; its files say how to add them")?;
            writeln!(f, "try          guide check {dir}")
        }
    }
}
