//! The sub-commands by what they are for, as `guide --help` lists them.

use clap::Command;
use std::fmt::Write as _;

/// Groups in the order of a new user's needs, with their sub-commands.
const GROUPS: [(&str, &[&str]); 5] = [
    ("Start", &["init", "check", "import", "simulate", "web"]),
    (
        "Analyse",
        &[
            "identify",
            "predict",
            "track",
            "diagnose",
            "investigate",
            "discrepancy",
            "plan",
            "plan-path",
            "relation",
            "effects",
            "report",
            "summarize",
            "population",
        ],
    ),
    ("Rig: set up", &["ports", "bringup", "calibration", "calibrate", "calibrate-image", "characterize"]),
    (
        "Rig: operate",
        &[
            "status", "monitor", "home", "tare", "move", "stop", "limits", "retreat", "clear", "record",
            "acquire", "capture", "steer",
        ],
    ),
    ("Files and connections", &["info", "recover", "export", "serve", "completions", "man", "help"]),
];

/// Columns of a line.
const WIDTH: usize = 100;
/// Column at which descriptions begin: behind the longest name.
const INDENT: usize = 19;

/// The command line with its sub-commands in groups.
pub fn grouped(command: Command) -> Command {
    let list = list(&command);
    command.help_template(format!(
        "{{about-with-newline}}\n{{usage-heading}} {{usage}}\n\nCommands:\n{list}\nOptions:\n{{options}}{{after-help}}"
    ))
}

fn list(command: &Command) -> String {
    let mut text = String::new();
    for (group, names) in GROUPS {
        let _ = writeln!(text, "{group}:");
        for name in names {
            // Some are there with a feature only.
            let about = match command.find_subcommand(name).and_then(Command::get_about) {
                Some(about) => about.to_string(),
                None if *name == "help" => "Print this message or the help of a command".to_owned(),
                None => continue,
            };
            let _ = writeln!(text, "  {name:<width$}{}", wrapped(&about), width = INDENT - 2);
        }
    }
    text
}

/// A description in lines, all but the first indented.
fn wrapped(about: &str) -> String {
    let mut text = String::new();
    let mut column = INDENT;
    for word in about.split_whitespace() {
        let length = word.chars().count();
        if column > INDENT && column + 1 + length > WIDTH {
            let _ = write!(text, "\n{:INDENT$}", "");
            column = INDENT;
        } else if column > INDENT {
            text.push(' ');
            column += 1;
        }
        text.push_str(word);
        column += length;
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cli::Cli;
    use clap::CommandFactory;
    use std::collections::BTreeSet;

    #[test]
    fn every_sub_command_is_in_one_group() {
        let grouped: Vec<&str> = GROUPS.iter().flat_map(|(_, names)| names.iter().copied()).collect();
        let distinct: BTreeSet<&str> = grouped.iter().copied().collect();
        assert_eq!(grouped.len(), distinct.len(), "one is in two groups");
        let command = Cli::command();
        let missing: Vec<&str> = command
            .get_subcommands()
            .map(Command::get_name)
            .filter(|name| !distinct.contains(name))
            .collect();
        assert!(missing.is_empty(), "{missing:?} are in no group");
    }

    #[test]
    fn the_list_has_every_description_within_its_width() {
        let mut command = grouped(Cli::command());
        let help = command.render_help().to_string();
        let start = help.find("Start:").expect("the first group");
        assert!(start < help.find("Analyse:").expect("the second"), "{help}");
        assert!(help.lines().all(|line| line.chars().count() <= WIDTH), "{help}");
        for part in ["  init ", "  identify ", "Options:", "--json", "Example:"] {
            assert!(help.contains(part), "{part}: {help}");
        }
    }
}
