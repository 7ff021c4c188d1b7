//! `guide plan-path`, and the live screen of `guide steer` where the output is no terminal.

use super::{failure, folder, guide, json, path, text};
use std::fs;

const PLANT: &str = r#"{"plant": "needle/1", "needle": {"EI_n_m2": 0.0157, "outer_diameter_mm": 1.27},
 "rig": {"guide1_to_guide2_mm": 60, "guide2_to_surface_mm": 20, "move_while_pushing": false, "can_rotate": true},
 "limits": {"guide_travel_mm": 6, "guide_speed_mm_s": 4, "guide_force_n": 8, "push_speed_mm_s": 5, "rotation_speed_deg_s": 90},
 "max_depth_mm": 120, "depth_step_mm": 1, "tip_noise_mm": 0.15, "tip_delay_s": 0.2, "tip_rate_hz": 10, "guide_error_mm": 0.2, "bevel_deg": 0,
 "prior": {"foundation_kpa": 20, "foundation_range": [0.5, 1.5], "tip_load_n": 0.2, "tip_load_range": [0.5, 1.5], "slope_mrad": 10}}"#;

const SESSION: &str = r#"
[needle]
youngs_modulus_gpa = 200.0
outer_diameter_mm = 1.27
inner_diameter_mm = 1.0
[rig]
guide2_mm = 60.0
entry_mm = 80.0
[tissue]
k_kpa = 20.0
[tip]
load_n = 0.2
[[lateral]]
id = "y25"
depth_mm = 25
"#;

#[test]
fn the_way_to_a_target_is_planned_from_a_statement_and_from_a_session() {
    let folder = folder();
    let [plant, config, dir, figures] =
        ["plant.json", "plan.toml", "made", "figures"].map(|name| path(&folder.path().join(name)).to_owned());
    fs::write(&plant, PLANT).expect("written");
    let target = "--target-mm=3,-2,100";
    let plan = json(&["plan-path", &plant, target, "--json"]);
    assert_eq!((&plan["schema"], &plan["is_reachable"]), (&"guide.plan_path/1".into(), &true.into()));
    let stops = plan["plan"]["plan_guide_mm"].as_array().expect("stops").len();
    assert_eq!(stops, 19);
    assert!(plan["within"][0]["probability"].as_f64().expect("a probability") > 0.2, "{}", plan["within"]);
    let printed = text(&guide(&["plan-path", &plant, target, "--plots", &figures]).stdout);
    for part in [
        "reach        the target can be reached",
        "\nbefore ",
        "reachable    x ",
        "unsteered ",
        "guide 2 from there on",
    ] {
        assert!(printed.contains(part), "{part} is not in {printed}");
    }
    for name in ["plan.path.svg", "plan.target.svg"] {
        let svg = fs::read_to_string(folder.path().join("figures").join(name)).expect("drawn");
        assert!(svg.starts_with("<svg") && !svg.contains(">tip<"), "{name}");
    }
    let rotated_plan = text(&guide(&["plan-path", &plant, target, "--rotations", "2"]).stdout);
    assert!(
        rotated_plan.contains("turn         by ") && !rotated_plan.contains("\nbefore "),
        "{rotated_plan}"
    );

    fs::write(&config, SESSION).expect("written");
    json(&["simulate", "--config", &config, "--out", &dir, "--json"]);
    let of_session = json(&["plan-path", &dir, target, "--json"]);
    let prior = &of_session["statement"]["prior"];
    let k_kpa = prior["foundation_kpa"].as_f64().expect("K of the runs");
    assert!((k_kpa - 20.0).abs() < 2.0, "{prior}");
    assert_eq!(of_session["warnings"], serde_json::json!([]));
    let weak = json(&["plan-path", &dir, target, "--guide-force-n", "2", "--json"]);
    assert!(extent(&weak) < 0.8 * extent(&of_session), "{} {}", extent(&weak), extent(&of_session));
}

/// Less force reaches less.
fn extent(plan: &serde_json::Value) -> f64 {
    let corners = plan["reachable_mm"].as_array().expect("corners").iter();
    corners.filter_map(|corner| corner[0].as_f64()).fold(f64::NEG_INFINITY, f64::max)
}

#[test]
fn what_cannot_be_planned_is_rejected_in_one_line() {
    let folder = folder();
    let plant = path(&folder.path().join("plant.json")).to_owned();
    fs::write(&plant, PLANT.replace("\"bevel_deg\": 0,", "")).expect("written");
    let printed = failure(&["plan-path", &plant, "--target-mm=3,-2,100"]);
    assert!(
        printed.contains("expected what a plant states (needle/1)") && printed.contains("bevel_deg"),
        "{printed}"
    );
    fs::write(&plant, PLANT).expect("written");
    for (arguments, part) in [
        (vec!["--target-mm=3,-2,130"], "expected 5 to 120 mm"),
        (vec!["--target-mm=3,-2,1"], "target depth: 1, expected 5 to 200"),
        (vec!["--target-mm=3,-2,100", "--rotations", "3"], "--rotations: 3, expected 0 to 2"),
        (vec!["--target-mm=3,-2,100", "--guide-force-n", "0"], "--guide-force-n: 0, expected 0.01 to 1000"),
    ] {
        let printed = failure(&[vec!["plan-path", &plant], arguments].concat());
        assert!(printed.contains(part), "{part} is not in {printed}");
    }
    // Out of reach is a result, with the nearest point.
    let unreachable = guide(&["plan-path", &plant, "--target-mm=80,0,100"]);
    let printed = text(&unreachable.stdout);
    assert!(
        unreachable.status.success() && printed.contains("out of reach") && printed.contains("nearest point"),
        "{printed}"
    );
}

#[test]
fn the_last_screen_of_a_run_is_printed_where_there_is_no_terminal() {
    let folder = folder();
    let dir = path(&folder.path().join("run")).to_owned();
    let statement = PLANT.replace('\n', "");
    let plant =
        format!("sh -c 'echo \"$1\"; read line; echo \"$2\"' plant '{statement}' '{{\"depth_mm\": 0}}'");
    let output = guide(&["steer", &dir, "--plant", &plant, "--target-mm=80,0,100", "--screen"]);
    let printed = text(&output.stdout);
    assert_eq!(output.status.code(), Some(1), "{printed} {}", text(&output.stderr));
    for part in [
        "guide steer   target +80.00, +0.00 mm at 100.0 mm",
        "next         refused: the target is ",
        " mm out of reach",
    ] {
        assert!(printed.contains(part), "{part} is not in {printed}");
    }
    let record = format!("{dir}/steer.jsonl");
    let again = text(&guide(&["steer", "--replay", &record, "--screen"]).stdout);
    assert_eq!(again.lines().take(24).collect::<Vec<_>>(), printed.lines().take(24).collect::<Vec<_>>());
    let output = guide(&["steer", "--replay", &record, "--screen", "--json"]);
    let conflict: serde_json::Value = serde_json::from_slice(&output.stdout).expect("a document");
    let reason = conflict["error"].as_str().expect("a reason");
    assert!(reason.contains("--screen: drawn for the eye, expected without --json"), "{conflict}");
}
