//! The command line of the studies.

use std::process::{Command, Output};

fn studies(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_studies")).args(arguments).output().expect("runs")
}

#[test]
fn an_unknown_study_and_impossible_numbers_are_refused() {
    let unknown = studies(&["dance"]);
    assert_eq!(unknown.status.code(), Some(2));
    assert!(String::from_utf8_lossy(&unknown.stderr).contains("possible values: modulus-relation"));
    let unknown_study = studies(&["plan", "--sessions", "1"]);
    assert_eq!(unknown_study.status.code(), Some(1));
    assert!(String::from_utf8_lossy(&unknown_study.stderr).contains("--sessions is 1, expected 2 to 100000"));
}

#[test]
fn a_small_study_of_the_plan_prints_its_table() {
    let output = studies(&["plan", "--sessions", "2", "--seed", "5"]);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let table = String::from_utf8(output.stdout).expect("text");
    assert_eq!(table.lines().filter(|line| line.starts_with("| ")).count(), 8, "{table}");
    assert!(table.contains("2 sessions of each protocol, seed 5"), "{table}");
}
