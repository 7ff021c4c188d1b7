//! To begin with: `guide init`, `guide check`, and every workflow on the example.

use super::{failure, folder, guide, json, path, text};
use std::fs;

#[test]
fn a_template_is_checked_and_never_overwritten() {
    let folder = folder();
    let dir = folder.path().join("new");
    let begun = json(&["init", path(&dir), "--json"]);
    assert_eq!(begun["schema"], "guide.init/1");
    assert_eq!(begun["files"].as_array().map(Vec::len), Some(6));
    let report = json(&["check", path(&dir), "--json"]);
    assert_eq!(report["schema"], "guide.check/2");
    assert_eq!((&report["usable"], &report["empty"]), (&true.into(), &true.into()));
    assert!(report["findings"].as_array().expect("a list").is_empty());
    assert!(failure(&["init", path(&dir)]).contains("session.toml: is there already"));
    assert!(failure(&["init", path(&dir), "--example"]).contains("session.toml: is there already"));
    assert_eq!(guide(&["init", path(&dir), "--seed", "2"]).status.code(), Some(2));

    // A file of the user's is as safe as a session.
    let other_path = folder.path().join("other");
    fs::create_dir(&other_path).expect("a folder");
    fs::write(other_path.join("i1.csv"), "mine").expect("written");
    assert!(failure(&["init", path(&other_path)]).contains("i1.csv: is there already"));
    assert_eq!(fs::read_to_string(other_path.join("i1.csv")).expect("there"), "mine");
    assert!(!other_path.join("session.toml").exists());
}

#[test]
fn the_example_has_something_for_every_command() {
    let folder = folder();
    let dir = folder.path().join("playground");
    let begun = json(&["init", "--example", path(&dir), "--json"]);
    assert_eq!(begun["example"], true);
    let report = json(&["check", path(&dir), "--json"]);
    assert!(report["findings"].as_array().expect("a list").is_empty(), "{}", report["findings"]);
    for ability in report["abilities"].as_array().expect("a list") {
        assert_eq!(ability["usable"], true, "{ability}");
    }
    let shown = text(&guide(&["check", path(&dir)]).stdout);
    assert!(shown.contains("identify     yes, 4 runs: d20-1, d20-2, d40-1, d40-2"), "{shown}");

    let identified = json(&["identify", path(&dir), "--json"]);
    assert!(identified["pooled"]["k_kpa"].as_f64().expect("a modulus") > 10.0);
    assert_eq!(json(&["predict", path(&dir), "--json"])["insertions"].as_array().map(Vec::len), Some(4));
    assert_eq!(json(&["track", path(&dir), "--json"])["runs"].as_array().map(Vec::len), Some(1));
    let diagnosed = json(&["diagnose", path(&dir), "--json"]);
    // Layers and a gradient are one class in so few runs.
    let class = diagnosed["effects"][0]["class"].as_array().expect("a class");
    assert!(class.contains(&serde_json::json!("tissue.layers")), "{}", diagnosed["effects"]);

    // The same seed makes the same session.
    let again = folder.path().join("again");
    json(&["init", "--example", path(&again), "--json"]);
    for file in ["session.toml", "d20-1.force.csv", "i3.csv", "s1.csv"] {
        let [a, b] = [&dir, &again].map(|dir| fs::read_to_string(dir.join(file)).expect("there"));
        assert_eq!(a, b, "{file}");
    }

    // Two faults, both reported, each on a line with its place.
    fs::write(dir.join("i2.csv"), "depth_mm,tip_y_mm\n1,x\n").expect("written");
    fs::write(dir.join("d20-1.shape.csv"), "z_mm\n").expect("written");
    let output = guide(&["check", path(&dir)]);
    assert_eq!(output.status.code(), Some(1));
    let shown = text(&output.stdout);
    assert!(
        shown.contains("d20-1.shape.csv:1:1: deflection_y_mm: missing, expected a header with"),
        "{shown}"
    );
    assert!(shown.contains("i2.csv:2:3: tip_y_mm: \"x\" is not a number, expected a number from"), "{shown}");
    assert!(text(&output.stderr).ends_with("2 errors\n"), "{}", text(&output.stderr));
}
