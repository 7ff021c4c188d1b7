//! Records of many sessions.

use super::{failure, json};
use std::fs;

#[test]
fn what_is_no_session_is_skipped_and_what_is_not_there_is_a_failed_record() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = |name: &str| folder.path().join(name).display().to_string();
    fs::create_dir(path("broken")).expect("created");
    fs::write(format!("{}/session.toml", path("broken")), "[session]\n").expect("written");
    fs::create_dir(path("empty")).expect("created");
    fs::write(path("notes.txt"), "no session").expect("written");
    let given_paths = ["broken", "empty", "gone", "notes.txt"].map(path);
    let mut arguments = vec!["summarize"];
    arguments.extend(given_paths.iter().map(String::as_str));
    let output_path = path("all.jsonl");
    arguments.extend(["--out", &output_path, "--json"]);
    let population = json(&arguments);
    assert_eq!(population["skipped"], serde_json::json!([path("empty"), path("notes.txt")]));
    let records: Vec<&str> = population["records"]
        .as_array()
        .expect("records")
        .iter()
        .filter_map(|one| one["session"].as_str())
        .collect();
    assert_eq!(records, [path("broken"), path("gone")]);
    assert_eq!(population["failed"], 2);
    assert_eq!(fs::read_to_string(&output_path).expect("records").lines().count(), 2);
    let error = failure(&["summarize", &path("notes.txt"), "--out", &output_path]);
    assert!(
        error.contains("notes.txt: no session, expected at least one folder that holds session.toml"),
        "{error}"
    );
}
