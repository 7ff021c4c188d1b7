//! `guide init`: a session to begin with, empty and explained, or simulated to play with.

use super::output::Output;
use super::simulate;
use anyhow::{Context, ensure};
use formats::files;
use formats::session::template;
use serde::Serialize;
use std::fmt::{self, Display};
use std::fs;
use std::path::{Path, PathBuf};

/// Make a session to begin with: an explained template, or a simulated example
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
    /// Seed of the example's noise
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
    let files_to_write: Vec<(PathBuf, &str)> = if args.example {
        vec![(args.dir.join(PLAN), template::EXAMPLE_PLAN)]
    } else {
        let tables = template::TABLES.iter().map(|(name, text)| (args.dir.join(name), *text));
        std::iter::once((session.clone(), template::SESSION)).chain(tables).collect()
    };
    for path in files_to_write.iter().map(|(path, _)| path).chain([&session]) {
        ensure!(!path.exists(), "{}: is there already, expected a folder without it", path.display());
    }
    let made_folder = !args.dir.exists();
    fs::create_dir_all(&args.dir).with_context(|| format!("{}: cannot create", args.dir.display()))?;
    let mut written_paths: Vec<&Path> = Vec::new();
    let begun = files_to_write.iter().try_for_each(|(path, text)| {
        // Never replaces a file, not even one that has come up since.
        files::write_new(path, text.as_bytes())
            .with_context(|| format!("{}: cannot write", path.display()))?;
        written_paths.push(path);
        Ok(())
    });
    let begun = begun.and_then(|()| {
        if args.example {
            simulate::make(&args.dir.join(PLAN), None, &args.dir, args.seed).map(drop)
        } else {
            Ok(())
        }
    });
    if let Err(error) = begun {
        // All of it or nothing, so that the same command works once there is room.
        written_paths.iter().for_each(|path| drop(fs::remove_file(path)));
        if made_folder {
            let _ = fs::remove_dir(&args.dir);
        }
        return Err(error);
    }
    let mut files: Vec<PathBuf> = files_to_write.into_iter().map(|(path, _)| path).collect();
    if args.example {
        files.push(session);
    }
    let begun = Begun { schema: "guide.init/1", session: args.dir.clone(), example: args.example, files };
    out.result(&begun, &begun)
}

impl Display for Begun {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let dir = self.session.display();
        for path in &self.files {
            writeln!(f, "written      {}", path.display())?;
        }
        if self.example {
            writeln!(f, "session      {dir}: simulated; its ground truth is in {PLAN} (read it last)")?;
            for command in ["check", "identify", "predict", "track", "diagnose", "report"] {
                writeln!(f, "try          guide {command} {dir}")?;
            }
            Ok(())
        } else {
            writeln!(f, "session      {dir}: no runs yet; its files explain how to add them")?;
            writeln!(f, "try          guide check {dir}")
        }
    }
}
