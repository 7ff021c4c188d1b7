//! Requests of the page, answered natively: documents of the program, trials, the needle to play with, and every kind of wrong request.

use formats::session::{SessionWriter, Setup, template};
use serde_json::{Value, json};
use simulation::simulate::{Sensors, SimulationPlan};
use std::fs;
use std::path::Path;
use web::Engine;

fn answer(engine: &mut Engine, request: &Value) -> Value {
    serde_json::from_str(&engine.answer(&request.to_string(), |_| {})).expect("an answer is JSON")
}

fn ok(engine: &mut Engine, request: &Value) -> Value {
    let mut answer = answer(engine, request);
    assert!(answer.get("error").is_none(), "{answer}");
    answer["ok"].take()
}

fn error(request: &Value) -> String {
    answer(&mut Engine::default(), request)["error"].as_str().expect("an error").to_owned()
}

/// The example of `guide init --example`, with two lateral runs and two insertions.
fn example(folder: &Path) -> String {
    let plan_file = folder.join("plan.toml");
    fs::write(&plan_file, template::EXAMPLE_PLAN).expect("written");
    let setup = Setup::read(&plan_file).expect("a set-up");
    let mut plan = SimulationPlan::read(&plan_file, None).expect("a plan");
    plan.lateral = vec![plan.lateral[0].clone(), plan.lateral[2].clone()];
    plan.insertion.truncate(2);
    let made = plan.carry_out(&setup.rig, Sensors::new(&setup.noise), 1).expect("simulated");
    let dir = folder.join("example");
    let mut session = SessionWriter::open(&dir, &setup).expect("a session");
    made.write(&mut session).expect("written");
    dir.display().to_string()
}

#[test]
fn documents_are_those_of_the_program_with_figures() {
    let folder = tempfile::tempdir().expect("a folder");
    let dir = example(folder.path());
    let engine = &mut Engine::default();
    let check = ok(engine, &json!({"do": "check", "dir": dir}));
    assert_eq!(check["document"]["schema"], "guide.check/2");
    assert_eq!(check["document"]["usable"], true);
    let found = ok(engine, &json!({"do": "identify", "dir": dir, "relation": "vesic"}));
    assert_eq!(found["document"]["pooled"]["runs"], 2);
    assert_eq!(found["figures"].as_array().map(Vec::len), Some(6));
    let path = ok(engine, &json!({"do": "predict", "dir": dir, "until_mm": 50}));
    assert_eq!(path["document"]["insertions"].as_array().map(Vec::len), Some(2));
    assert!(path["figures"][0]["svg"].as_str().is_some_and(|svg| svg.contains("<svg")));
    let series = ok(engine, &json!({"do": "session", "dir": dir}));
    assert_eq!(series["lateral"][1]["depth_mm"], 40.0);
    let drawn = series["lateral"][0]["time_s"].as_array().map_or(0, Vec::len);
    assert!((2..=600).contains(&drawn), "{drawn}");
}

#[test]
fn switching_the_hidden_effect_on_shrinks_the_misfit() {
    let folder = tempfile::tempdir().expect("a folder");
    let dir = example(folder.path());
    let engine = &mut Engine::default();
    let request =
        |effects: Value| json!({"do": "try", "dir": dir, "foundation": "springs", "effects": effects});
    let plain = ok(engine, &request(json!([])));
    let layers = ok(engine, &request(json!(["tissue.layers"])));
    let of = |trial: &Value| trial["learned"][1]["chi2_reduced"].as_f64().expect("a number");
    assert!(of(&layers) < 0.7 * of(&plain), "{} {}", of(&plain), of(&layers));
    assert!(layers["log_evidence_gain"].as_f64().is_some_and(|gain| gain > 5.0));
    assert!(layers["held_out_points"].as_array().is_some_and(|points| !points.is_empty()));
    assert_eq!(ok(engine, &request(json!([]))), plain);
}

/// The numbers of the closed form: 1.2 mm at 16 kPa and 30 mm, 10 mm behind guide 2, take 1.3096 N.
#[test]
fn the_needle_to_play_with_is_that_of_the_forward_model() {
    let engine = &mut Engine::default();
    let mut request = json!({
        "do": "play", "k_kpa": 16, "depth_mm": 30, "displacement_mm": 1.2, "gap_mm": 10, "tip_load_n": 0.0
    });
    let plain = ok(engine, &request);
    let force_n = |side: &Value| side["force_n"].as_f64().expect("a force");
    assert!((force_n(&plain["with"]) / 1.309_563_697_895_257 - 1.0).abs() < 1e-9);
    assert!(plain["without"].is_null());
    // With play of 0.3 mm the needle follows over 0.9 mm.
    request["effects"] = json!({"rig.backlash": {"clearance_mm": 0.3}});
    let loose = ok(engine, &request);
    assert!((force_n(&loose["with"]) / force_n(&plain["with"]) - 0.75).abs() < 1e-9);
    assert_eq!(loose["without"], plain["with"]);
}

#[test]
fn every_effect_of_the_catalogue_can_be_played_with() {
    let engine = &mut Engine::default();
    let catalogue = ok(engine, &json!({"do": "effects"}));
    for effect in catalogue.as_array().expect("a list") {
        let parameters = effect["parameters"].as_array().expect("a list").iter();
        let values: serde_json::Map<String, Value> = parameters
            .map(|info| (info["name"].as_str().unwrap_or_default().to_owned(), info["neutral"].clone()))
            .collect();
        let id = effect["id"].as_str().expect("an id");
        let request = json!({
            "do": "play", "k_kpa": 12, "depth_mm": 50, "displacement_mm": 1.5, "gap_mm": 10, "tip_load_n": 0.2,
            "effects": {id: values}
        });
        let made = ok(engine, &request);
        assert!(
            made["with"]["force_n"].as_f64().is_some_and(f64::is_finite),
            "{id}: {}",
            made["with"]["force_n"]
        );
    }
}

#[test]
fn wrong_requests_are_answered_with_one_line_that_names_what_is_valid() {
    let play = json!({"do": "play", "k_kpa": 0, "depth_mm": 30, "displacement_mm": 1, "gap_mm": 10, "tip_load_n": 0});
    for (request, expected) in [
        (json!({"do": "nothing"}), "unknown variant `nothing`"),
        (json!({"dir": "gone"}), "expected the name of a request in the field `do`"),
        (json!({"do": "check"}), "missing field `dir`"),
        (json!({"do": "identify", "dir": "gone"}), "gone/session.toml"),
        (json!({"do": "identify", "dir": "gone", "relation": "hooke"}), "gone/session.toml"),
        (json!({"do": "predict", "dir": "gone", "until_mm": 1}), "until_mm: 1, expected 5 to 500 mm"),
        (
            json!({"do": "try", "dir": "gone", "foundation": "sand", "effects": []}),
            "expected springs or body",
        ),
        (
            json!({"do": "try", "dir": "gone", "foundation": "body", "effects": ["x"]}),
            "expected the id of an effect",
        ),
        (play, "k_kpa: 0, expected 0.1 to 1000"),
    ] {
        let line = error(&request);
        assert!(line.contains(expected) && !line.contains('\n'), "{request}: {line}");
    }
}
