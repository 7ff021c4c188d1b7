//! Completions, manual pages, colours.

use super::{folder, guide, json, path, text};
use std::fs;
use std::io::Write;
use std::process::{Command, Stdio};

/// Every sub-command, as the help lists them.
fn commands() -> Vec<String> {
    let help = text(&guide(&["--help"]).stdout);
    let listed = help.split("Commands:").nth(1).and_then(|rest| rest.split("\n\n").next()).expect("a list");
    // Descriptions go on in lines that are further in.
    let lines = listed.lines().filter(|line| line.starts_with("  ") && !line.starts_with("   "));
    lines.filter_map(|line| line.split_whitespace().next()).map(str::to_owned).collect()
}

#[test]
fn completions_know_every_sub_command() {
    let commands = commands();
    assert!(commands.len() > 20 && commands.contains(&"identify".to_owned()), "{commands:?}");
    for shell in ["bash", "zsh", "fish", "powershell", "elvish"] {
        let output = guide(&["completions", shell]);
        assert!(output.status.success(), "{shell}");
        let script = text(&output.stdout);
        for command in &commands {
            assert!(script.contains(command.as_str()), "{shell} has no {command}");
        }
        if shell == "bash" {
            is_bash(&script);
        }
    }
    assert_eq!(json(&["completions", "fish", "--json"])["schema"], "guide.completions/1");
    assert_eq!(guide(&["completions", "cmd.exe"]).status.code(), Some(2));
}

/// A bash, if there is one, reads the script.
fn is_bash(script: &str) {
    let bash = Command::new("bash").arg("-n").stdin(Stdio::piped()).stderr(Stdio::piped()).spawn();
    let Ok(mut bash) = bash else { return };
    bash.stdin.take().expect("piped").write_all(script.as_bytes()).expect("written");
    let output = bash.wait_with_output().expect("ends");
    assert!(output.status.success() && output.stderr.is_empty(), "{}", text(&output.stderr));
}

#[test]
fn every_sub_command_has_a_manual_page_with_an_example() {
    let page = text(&guide(&["man"]).stdout);
    assert!(page.contains(".TH") && page.contains("Example:") && page.contains("identify"), "{page}");
    let folder = folder();
    let pages = folder.path().join("man1");
    let written = json(&["man", "--out", path(&pages), "--json"]);
    let names = commands();
    assert_eq!(
        written["files"].as_array().map(Vec::len),
        Some(names.iter().filter(|c| *c != "help").count() + 1)
    );
    for command in names.iter().filter(|command| *command != "help") {
        let page = fs::read_to_string(pages.join(format!("guide-{command}.1"))).expect("a page");
        let page = page.replace("\\-", "-");
        assert!(page.contains("Example:") && page.contains(&format!("guide {command}")), "{command}: {page}");
    }
    assert!(super::failure(&["man", "--out", path(&pages.join("guide.1"))]).contains("cannot create"));
    // One page alone is the one of the folder.
    let page = text(&guide(&["man", "identify"]).stdout);
    assert_eq!(page, fs::read_to_string(pages.join("guide-identify.1")).expect("a page"));
    assert!(super::failure(&["man", "identfy"]).contains("COMMAND: identfy, expected one of"));
}

#[test]
fn colours_are_for_terminals_and_those_who_ask() {
    // Help, a result, wrong use, a failure: what clap prints, and what guide prints.
    let commands: [&[&str]; 4] =
        [&["identify", "--help"], &["effects"], &["effects", "--jason"], &["identify", "no/such/folder"]];
    for arguments in commands {
        for variable in [None, Some(("NO_COLOR", "1")), Some(("TERM", "xterm-256color"))] {
            assert!(!is_coloured(&printed(arguments, variable)), "{arguments:?} {variable:?}");
        }
        let never = [arguments, &["--color", "never"]].concat();
        assert!(!is_coloured(&printed(&never, None)), "{arguments:?}");
        let always = [arguments, &["--color=always"]].concat();
        // Results are for machines as well, and stay plain.
        let is_result = arguments == ["effects"];
        assert_eq!(is_coloured(&printed(&always, Some(("NO_COLOR", "1")))), !is_result, "{arguments:?}");
    }
    assert_eq!(guide(&["effects", "--color", "mauve"]).status.code(), Some(2));
}

fn is_coloured(bytes: &[u8]) -> bool {
    bytes.contains(&0x1b)
}

fn printed(arguments: &[&str], variable: Option<(&str, &str)>) -> Vec<u8> {
    let mut command = Command::new(env!("CARGO_BIN_EXE_guide"));
    command.args(arguments).env_remove("NO_COLOR").env_remove("CLICOLOR_FORCE").envs(variable);
    let output = command.output().expect("guide starts");
    [output.stdout, output.stderr].concat()
}
