//! Model files, plans and the list of effects.

use super::{failure, folder, guide, json, path, text};
use serde_json::Value;
use std::fs;
use std::path::Path;

const PLAN: &str = r#"
[needle]
youngs_modulus_gpa = 200.0
outer_diameter_mm = 1.27
inner_diameter_mm = 1.0

[rig]
guide2_mm = 60.0
entry_mm = 70.0

[tissue]
k_kpa = 9.0

[tip]
load_n = 0.2

[[effect]]
id = "tissue.gradient"
parameters = { gradient_per_mm = { value = 0 } }

[[lateral]]
id = "y25"
depth_mm = 25

[[insertion]]
id = "i1"
depth_mm = 80
"#;

const MODEL: &str = r#"
[model]
format = 1
[tissue]
k_kpa = 12.0
k_ci95_kpa = [11.5, 12.5]
[[effect]]
id = "tissue.layers"
[effect.parameters.k_ratio]
value = 2.5
[effect.parameters.boundary_mm]
value = 12
"#;

fn k_kpa(found: &Value) -> [f64; 2] {
    [0, 1].map(|end| found["pooled"]["ci95_kpa"][end].as_f64().expect("an interval"))
}

#[test]
fn a_model_file_is_simulated_identified_and_predicted_with() {
    let folder = folder();
    let [config, model, dir] =
        ["plan.toml", "model.toml", "made"].map(|name| path(&folder.path().join(name)).to_owned());
    fs::write(&config, PLAN).expect("written");
    fs::write(&model, MODEL).expect("written");
    let simulated = json(&["simulate", "--config", &config, "--model", &model, "--out", &dir, "--json"]);
    assert_eq!(simulated["schema"], "guide.simulate/1");
    let truth = &simulated["truth"];
    assert_eq!((&truth["k_kpa"], &truth["tip_load_n"]), (&12.0.into(), &0.2.into()));
    let ids: Vec<_> = truth["effects"].as_array().expect("a list").iter().map(|one| &one["id"]).collect();
    assert_eq!(ids, ["tissue.layers", "tissue.gradient"]);
    assert_eq!(truth["effects"][0]["parameters"]["boundary_mm"], 12.0);
    assert_eq!(
        (&simulated["lateral"][0]["id"], &simulated["insertion"][0]["id"]),
        (&"y25".into(), &"i1".into())
    );
    assert_eq!(simulated["runs"].as_array().map(Vec::len), Some(0));
    let again = path(&folder.path().join("again")).to_owned();
    let printed = guide(&["simulate", "--config", &config, "--model", &model, "--out", &again]);
    let printed = text(&printed.stdout);
    for part in
        ["lateral      y25: ", "K 12 kPa, tip load 0.2 N", "tissue.layers: boundary_mm 12, k_ratio 2.5"]
    {
        assert!(printed.contains(part), "{part} is not in {printed}");
    }
    assert_eq!(csv(&dir), csv(&again), "the same seed");

    let with_model = json(&["identify", &dir, "--model", &model, "--json", "--relation", "vesic"]);
    assert_eq!(with_model["effects"], serde_json::json!(["tissue.layers"]));
    let [low, high] = k_kpa(&with_model);
    assert!(low < 12.0 && 12.0 < high, "{low} to {high}");
    let without_model = json(&["identify", &dir, "--json", "--relation", "vesic"]);
    assert!(without_model.get("effects").is_none());
    assert!(k_kpa(&without_model)[0] > 12.5, "{without_model}");
    let printed = text(&guide(&["identify", &dir, "--model", &model, "--relation", "vesic"]).stdout);
    assert!(
        printed.contains("model with   tissue.layers") && printed.contains("models no effects"),
        "{printed}"
    );
    for wrong in [&["--nuisance", "tissue.layers"][..], &["--layers"]] {
        let printed = failure(&[&["identify", &dir, "--model", &model], wrong].concat());
        assert!(printed.contains("in the model already"), "{printed}");
    }

    // Insertions alone: the modulus is that of the file, unless it is given.
    let alone = path(&folder.path().join("alone")).to_owned();
    fs::write(
        &config,
        PLAN.split("[[lateral]]").next().expect("text").to_owned()
            + "[[insertion]]\nid = \"i1\"\ndepth_mm = 80\n",
    )
    .expect("written");
    json(&["simulate", "--config", &config, "--model", &model, "--out", &alone, "--json"]);
    let by_file = json(&["predict", &alone, "--model", &model, "--json"]);
    let sd = (0.5f64 / formats::NORMAL_975).to_string();
    let layers = "tissue.layers=2.5,12";
    let by_option = json(&["predict", &alone, "--k-kpa", "12", &sd, "--effect", layers, "--json"]);
    assert!(path_of(&by_file).iter().zip(path_of(&by_option)).all(|(a, b)| (a - b).abs() < 1e-6));
    let other_prediction =
        json(&["predict", &alone, "--model", &model, "--effect", "tissue.layers=1,12", "--json"]);
    assert_ne!(path_of(&by_file), path_of(&other_prediction));
    assert!(failure(&["predict", &alone, "--model", &model, "--layers"]).contains("in the model already"));

    fs::write(&model, MODEL.replace("tissue.layers", "tissue.layer")).expect("written");
    for command in
        [&["identify", &dir][..], &["predict", &dir], &["simulate", "--config", &config, "--out", &dir]]
    {
        let printed = failure(&[command, &["--model", &model]].concat());
        assert!(printed.contains("model.toml:8:6: effect.id: \"tissue.layer\" is not known"), "{printed}");
    }
}

fn path_of(found: &Value) -> Vec<f64> {
    let tip = found["insertions"][0]["tip_y_mm"].as_array().expect("a list");
    tip.iter().map(|mm| mm.as_f64().expect("a number")).collect()
}

fn csv(dir: &str) -> String {
    fs::read_to_string(Path::new(dir).join("y25.force.csv")).expect("written")
}

#[test]
fn plan_faults_name_their_place() {
    let folder = folder();
    let config = folder.path().join("plan.toml");
    let output_path = folder.path().join("out");
    let fails = |text: &str, expected: &str| {
        fs::write(&config, text).expect("written");
        let printed = failure(&["simulate", "--config", path(&config), "--out", path(&output_path)]);
        assert!(printed.contains(expected), "{printed}");
        assert!(!output_path.exists(), "nothing is left behind");
    };
    fails(&PLAN.replace("k_kpa = 9.0", ""), "plan.toml:11:1: tissue.k_kpa: missing");
    fails(&PLAN.replace("depth_mm = 25", "depth_cm = 2.5"), "lateral.depth_cm: \"depth_cm\" is not known");
    fails(&PLAN.replace("depth_mm = 80", "depth_mm = -80"), "insertion.depth_mm: -80 is out of range");
    fails(&PLAN.replace("gradient_per_mm", "gradient"), "gradient_per_mm");
    fails(PLAN.split("[[lateral]]").next().expect("text"), "expected at least one [[lateral]]");
    fails(&PLAN.replace("\"y25\"", "\"../y\""), "cannot be part of a file name");
}

#[test]
fn effects_are_listed() {
    let all_effects = json(&["effects", "--json"]);
    assert_eq!(all_effects["schema"], "guide.effects/1");
    let effects = all_effects["effects"].as_array().expect("a list");
    assert_eq!(effects.len(), mechanics::effects::EFFECTS.len());
    for parameter in effects.iter().flat_map(|one| one["parameters"].as_array().expect("a list")) {
        // A name without a unit at its end is a ratio, a share, a logarithm, or the like.
        let (name, unit) = (parameter["name"].as_str().expect("text"), &parameter["unit"]);
        let ends = ["ratio", "fraction", "gain", "scale", "relative", "ln_y", "ln_x"];
        let bare = ends.iter().any(|end| name.ends_with(end));
        assert_eq!(bare, unit == "1", "{name} {unit}");
    }
    let layers_effect = json(&["effects", "tissue.layers", "--json"]);
    assert_eq!(layers_effect["effects"].as_array().map(Vec::len), Some(1));
    let [ratio, boundary] = [0, 1].map(|i| layers_effect["effects"][0]["parameters"][i].clone());
    assert_eq!(
        (&ratio["neutral"], &ratio["unit"], &ratio["range"][1]),
        (&1.0.into(), &"1".into(), &50.0.into())
    );
    assert!(boundary["neutral"].is_null() && boundary["nodes"].is_array() && boundary["unit"] == "mm");
    let printed = text(&guide(&["effects"]).stdout);
    assert!(
        printed.contains("tissue.layers\n  physics")
            && printed.contains("tip.rate")
            && !printed.contains("likely"),
        "{printed}"
    );
    assert!(text(&guide(&["effects", "rig.backlash"]).stdout).contains("likely 0 to 0.4"));
    let printed = failure(&["effects", "tissue.layer"]);
    assert!(printed.contains("\"tissue.layer\" is not known, expected one of tissue.layers"), "{printed}");
}

/// Simulated with a layer hidden from the estimator, diagnosed, explained; the model file serves the next commands.
#[test]
fn a_missing_layer_is_named_and_its_model_explains_the_session() {
    let folder = folder();
    let (config, dir, model, plots) = (
        path_in("plan.toml", &folder),
        path_in("made", &folder),
        path_in("found.toml", &folder),
        path_in("plots", &folder),
    );
    let rig = PLAN.split("[tissue]").next().expect("the rig");
    let mut plan = format!(
        "{rig}[tissue]\nk_kpa = 9\n[[effect]]\nid = \"tissue.layers\"\nparameters = {{ k_ratio = {{ value = 2.5 }}, \
         boundary_mm = {{ value = 15 }} }}\n"
    );
    for (id, depth_mm) in [("a", 20), ("b", 30), ("c", 40), ("d", 30)] {
        plan += &format!("[[lateral]]\nid = \"{id}\"\ndepth_mm = {depth_mm}\n");
    }
    fs::write(&config, plan).expect("written");
    guide(&["simulate", "--config", &config, "--out", &dir]);
    let diagnosis = json(&["diagnose", &dir, "--out", &model, "--plots", &plots, "--json"]);
    assert_eq!(diagnosis["schema"], "guide.diagnose/2");
    // At three depths a gradient or a gap may stand for a layer; nothing else.
    assert!(
        diagnosis["verdict"] == "named" || diagnosis["verdict"] == "ambiguous",
        "{}",
        diagnosis["verdict"]
    );
    assert_eq!(diagnosis["effects"][0]["id"], "tissue.layers");
    let class = diagnosis["effects"][0]["class"].as_array().expect("a class");
    assert!(class.iter().all(|id| id.as_str().is_some_and(|id| id.starts_with("tissue."))), "{class:?}");
    assert_eq!(diagnosis["gap"]["heldout_runs"], serde_json::json!(["d"]));
    // The share is null where the held-out misfit was not above chance.
    assert!(diagnosis["gap"]["removed"].as_f64().is_none_or(|share| share > 0.9), "{}", diagnosis["gap"]);
    assert!(misfit("after", &diagnosis) < misfit("before", &diagnosis), "{}", diagnosis["gap"]);
    for figure in ["residuals", "gap", "ranking"] {
        let svg = fs::read_to_string(Path::new(&plots).join(format!("{figure}.svg"))).expect("a figure");
        assert!(svg.contains("</svg>"), "{figure}");
    }
    let explained = json(&["diagnose", &dir, "--model", &model, "--json"]);
    assert_eq!(
        (&explained["verdict"], &explained["given"][0]),
        (&"adequate".into(), &"tissue.layers".into())
    );
    let printed = text(&guide(&["diagnose", &dir]).stdout);
    assert!(printed.contains("missing      tissue.layers") && printed.contains("remaining    "), "{printed}");
}

fn misfit(side: &str, diagnosis: &Value) -> f64 {
    diagnosis["gap"][side]["chi2_reduced"].as_f64().expect("a chi-square")
}

fn path_in(name: &str, folder: &tempfile::TempDir) -> String {
    path(&folder.path().join(name)).to_owned()
}
