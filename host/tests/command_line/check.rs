//! Tests of the expected uses of sessions and plans.

use super::{add_lateral_run, folder, guide, json, path, text, writer};
use serde_json::Value;
use std::fs;

fn value(check: &Value, id: &str) -> Option<f64> {
    let effects = check["effects"].as_array().expect("a list");
    effects.iter().find(|one| one["effect"] == id).and_then(|one| one["value"].as_f64())
}

#[test]
fn a_session_states_from_which_size_on_it_would_name_each_effect() {
    let folder = folder();
    add_lateral_run(&mut writer(folder.path()));
    let check = json(&["diagnose", path(folder.path()), "--check", "--json"]);
    assert_eq!(check["schema"], "guide.diagnose_check/1");
    assert_eq!(check["probability"], 0.9);
    let skin = value(&check, "tissue.skin").expect("a size");
    assert!(skin > 0.0 && skin < 5.0, "{skin}");
    // Effects that lateral runs never show are not promised.
    let not_shown = check["not_shown"].as_array().expect("a list");
    assert!(not_shown.contains(&"tip.load_slope".into()), "{not_shown:?}");
    let output = guide(&["diagnose", path(folder.path()), "--check"]);
    let output_text = text(&output.stdout);
    assert!(output_text.contains("named with 90 % probability from this size on"), "{output_text}");
    assert!(output_text.lines().any(|line| line.trim_start().starts_with("tissue.skin ")), "{output_text}");
}

#[test]
fn a_plan_states_the_same_of_its_best_run() {
    let folder = folder();
    let rig = folder.path().join("rig.toml");
    let of_noise = |force_n: f64| {
        let rig_text = format!(
            "[needle]\nyoungs_modulus_gpa = 200.0\nouter_diameter_mm = 1.27\ninner_diameter_mm = 1.0\nlength_mm = 130.0\n\
             [rig]\nguide2_mm = 60.0\nentry_mm = 70.0\n[noise]\nforce_n = {force_n}\ndisplacement_mm = 0.01\nshape_mm = 0.025\n"
        );
        fs::write(&rig, rig_text).expect("written");
        let planned = [
            "plan",
            "--rig",
            path(&rig),
            "--k-kpa",
            "8",
            "16",
            "--depth-mm",
            "30",
            "--displacement-mm",
            "0.8",
        ];
        let levels = ["--levels", "0", "0.5", "1", "0", "-1", "0", "--check", "--json"];
        let plan = json(&[&planned[..], &levels[..]].concat());
        assert_eq!(plan["schema"], "guide.plan/1");
        assert!(plan["check"]["held_out"].as_u64().expect("a number") > 0);
        value(&plan["check"], "rig.friction").expect("a size")
    };
    // A better sensor shows less friction.
    let (better, worse) = (of_noise(0.01), of_noise(0.2));
    assert!(better < worse, "{better} {worse}");
}
