//! `guide check`: everything that is wrong with a session, and what can be done with it.

use super::output::Output;
use anyhow::ensure;
use inference::check::{Capability, Check, Severity, Skipped, check};
use std::fmt::{self, Display};
use std::path::PathBuf;

/// Check a session: errors, warnings, and what each command can do with it
#[derive(clap::Args)]
#[command(
    after_help = "Example:\n  guide check phantom-a\n  guide check phantom-a --json\n\nExit code 0 where the session can be used (warnings \
                  or not), 1 where it cannot, or where identify can use none of its lateral runs."
)]
pub struct Args {
    /// Session folder (holds session.toml)
    dir: PathBuf,
}

/// Runs the sub-command.
pub fn run(args: &Args, out: &mut Output) -> anyhow::Result<()> {
    let report = check(&args.dir);
    out.result(&report, Text(&report))?;
    out.finish()?;
    let dir = args.dir.display();
    let errors = report.errors();
    ensure!(errors == 0, "{dir}: {errors} {}", if errors == 1 { "error" } else { "errors" });
    ensure!(report.usable, "{dir}: no command can use any of its runs");
    let refused = report.abilities.iter().find(|ability| {
        ability.command == "identify"
            && !ability.usable
            && ability.skipped.iter().any(|skipped| skipped.id.is_some())
    });
    ensure!(refused.is_none(), "{dir}: identify can use none of its lateral runs, for the reasons above");
    Ok(())
}

struct Text<'a>(&'a Check);

/// Remarks shown of each command.
const REMARKS: usize = 6;

impl Display for Text<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let report = self.0;
        for finding in &report.findings {
            let name = match finding.severity {
                Severity::Error => "error",
                Severity::Warning => "warning",
            };
            writeln!(f, "{name:<13}{finding}")?;
        }
        if report.errors() > 0 && !report.abilities.is_empty() {
            writeln!(f, "with what could be read, once the errors are corrected:")?;
        }
        for ability in &report.abilities {
            write_ability(f, ability)?;
        }
        if report.empty {
            writeln!(f, "session      valid, without runs")?;
        }
        Ok(())
    }
}

fn write_ability(f: &mut fmt::Formatter<'_>, ability: &Capability) -> fmt::Result {
    let Capability { command, usable, runs, skipped, remarks } = ability;
    let able = match (usable, runs.len()) {
        (false, _) => "no".to_owned(),
        (true, 0) => "yes".to_owned(),
        (true, 1) => format!("yes, 1 run: {}", runs.join(", ")),
        (true, count) => format!("yes, {count} runs: {}", runs.join(", ")),
    };
    writeln!(f, "{command:<13}{able}")?;
    for Skipped { id, reason } in skipped {
        let id = id.as_ref().map_or(String::new(), |id| format!("without {id}: "));
        writeln!(f, "             {id}{reason}")?;
    }
    for remark in remarks.iter().take(REMARKS) {
        writeln!(f, "             {remark}")?;
    }
    if remarks.len() > REMARKS {
        writeln!(f, "             and {} more remarks (--json has all)", remarks.len() - REMARKS)?;
    }
    Ok(())
}
