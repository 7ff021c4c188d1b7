//! The command line of `cargo xtask`.

use std::process::{Command, Output};

fn xtask(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_xtask")).args(arguments).output().expect("runs")
}

#[test]
fn help_names_the_tasks() {
    let help = String::from_utf8(xtask(&["--help"]).stdout).expect("text");
    for task in
        ["demo", "test", "lint", "setup", "study", "readme", "rig", "wheel", "cluster", "release", "flash"]
    {
        assert!(help.contains(&format!("  {task} ")), "{task}: {help}");
    }
}

#[test]
fn an_unknown_task_is_refused() {
    let output = xtask(&["dance"]);
    assert_eq!(output.status.code(), Some(2));
    assert!(String::from_utf8_lossy(&output.stderr).contains("there is no task `dance`"));
}
