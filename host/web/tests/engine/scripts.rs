//! Texts of the page's scripts: names and labels that the program's answers need.

use std::fs;
use std::path::Path;

/// Names for people, in the page's scripts.
#[test]
fn every_effect_has_a_plain_name() {
    let words = include_str!("../../page/words.js");
    for effect in mechanics::effects::EFFECTS {
        assert!(words.contains(&format!("  '{}': ", effect.id())), "words.js has no {}", effect.id());
    }
}

/// The table of regions has a label for every coordinate that a diagnosis scans, and none for another one.
#[test]
fn every_coordinate_of_a_region_has_a_label() {
    let script = include_str!("../../page/diagnose.js");
    let (_, after) = script.split_once("const COORDINATES = { ").expect("the labels");
    let (labels, _) = after.split_once(" };").expect("their end");
    // A label may contain a comma, but no colon.
    let words: Vec<&str> = labels.split(": '").filter_map(|text| text.split_whitespace().last()).collect();
    let (_, names) = words.split_last().expect("labels");
    let mut expected = inference::diagnose::region_coordinates().to_vec();
    let mut names = names.to_vec();
    expected.sort_unstable();
    names.sort_unstable();
    assert_eq!(names, expected);
}

/// A log evidence may be negative: its sign is that of the number.
#[test]
fn no_script_puts_a_fixed_plus_before_a_number() {
    let page = Path::new(env!("CARGO_MANIFEST_DIR")).join("page");
    for entry in fs::read_dir(page).expect("the page's folder") {
        let path = entry.expect("an entry").path();
        if path.extension().is_some_and(|ending| ending == "js") {
            let script = fs::read_to_string(&path).expect("a script");
            assert!(!script.contains("+${number("), "{}", path.display());
        }
    }
}
