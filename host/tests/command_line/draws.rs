//! Draws from the posteriors of commands, beside the intervals that the same commands print.

use super::{add_insertions, add_lateral_run, failure, folder, guide, json, path, text, writer};
use serde_json::Value;
use std::fs;
use std::path::Path;

/// Four standard deviations of the share that 4000 draws have within an interval of 95 %.
const SHARE_TOLERANCE: f64 = 0.014;
/// Possible further difference of a mixture that is printed as the normal distribution of its moments.
const OF_MOMENTS: f64 = 0.02;

/// The result of a command, and its draws.
fn drawn(folder: &Path, command: &str, more: &[&str]) -> (Value, Value) {
    let file = folder.join(format!("{command}.draws.json"));
    let arguments = [command, path(folder), "--draws", path(&file), "--draws-per-chain", "1000", "--json"];
    let result_json = json(&[&arguments, more].concat());
    let document = serde_json::from_slice(&fs::read(&file).expect("written")).expect("JSON");
    (result_json, document)
}

/// Values of a variable, draw after draw; of a list those at a place.
fn values(document: &Value, group: &str, name: &str, place: Option<usize>) -> Vec<f64> {
    let chains = document[group][name].as_array().unwrap_or_else(|| panic!("{group}: {name} is missing"));
    assert_eq!(chains.len(), 4);
    let all_draws: Vec<f64> = chains
        .iter()
        .flat_map(|chain| chain.as_array().expect("draws"))
        .map(|draw| place.map_or(draw, |place| &draw[place]).as_f64().expect("a number"))
        .collect();
    assert_eq!(all_draws.len(), 4000);
    all_draws
}

fn interval(ends: &Value) -> [f64; 2] {
    [&ends[0], &ends[1]].map(|end| end.as_f64().expect("an end"))
}

fn assert_share(values: &[f64], [low, high]: [f64; 2], tolerance: f64, what: &str) {
    let inside_count = values.iter().filter(|value| (low..=high).contains(*value)).count();
    let coverage = inside_count as f64 / values.len() as f64;
    assert!((coverage - 0.95).abs() < tolerance, "{what}: {coverage} within {low} to {high}");
}

#[test]
fn draws_of_an_identification_have_the_coverage_of_its_intervals() {
    let folder = folder();
    add_lateral_run(&mut writer(folder.path()));
    let (result_json, draws) = drawn(folder.path(), "identify", &[]);
    let of = |name: &str, place| values(&draws, "posterior", name, place);
    let pooled = interval(&result_json["pooled"]["ci95_kpa"]);
    assert_share(&of("k_kpa", None), pooled, SHARE_TOLERANCE, "K");
    let youngs = interval(&result_json["youngs_modulus_kpa"]["ci95"]);
    assert_share(&of("youngs_modulus_kpa", None), youngs, SHARE_TOLERANCE, "E");
    let run = interval(&result_json["runs"][0]["methods"]["likelihood"]["ci95_kpa"]);
    assert_share(&of("k_of_run_kpa", Some(0)), run, SHARE_TOLERANCE, "K of the run");
    assert_eq!(draws["coords"]["run"][0], result_json["runs"][0]["id"]);
    assert_eq!(draws["attrs"]["schema"], "guide.draws/1");
    // Every reading that was taken lies about where the draws expect it.
    let observed = draws["observed_data"].as_object().expect("channels");
    assert!(observed.keys().any(|name| name.ends_with(".force_y_n")), "{:?}", observed.keys());
    for (name, readings) in observed {
        let readings = readings.as_array().expect("a list");
        let tried = || readings.iter().enumerate().step_by(5);
        let covered = tried().filter(|(place, reading)| {
            let mut predicted = values(&draws, "posterior_predictive", name, Some(*place));
            predicted.sort_by(f64::total_cmp);
            let reading = reading.as_f64().expect("a number");
            (predicted[100]..=predicted[3899]).contains(&reading)
        });
        let coverage = covered.count() as f64 / tried().count() as f64;
        assert!(coverage > 0.85, "{name}: {coverage} of {} readings", tried().count());
    }
}

#[test]
fn the_same_seed_gives_the_same_draws_and_another_one_others() {
    let folder = folder();
    add_insertions(&mut writer(folder.path()));
    let file = folder.path().join("draws.json");
    let bytes = |seed: &str| {
        json(&["predict", path(folder.path()), "--draws", path(&file), "--seed", seed, "--json"]);
        fs::read(&file).expect("written")
    };
    let first = bytes("1");
    assert!(bytes("1") == first);
    assert!(bytes("2") != first);
}

#[test]
fn draws_of_a_prediction_have_the_coverage_of_its_intervals_and_bands() {
    let folder = folder();
    let mut session = writer(folder.path());
    add_lateral_run(&mut session);
    add_insertions(&mut session);
    let (result_json, draws) = drawn(folder.path(), "predict", &[]);
    for one in result_json["insertions"].as_array().expect("insertions") {
        let of = |of: &str| values(&draws, "posterior", &name_of(of, one), None);
        let tolerance = SHARE_TOLERANCE + OF_MOMENTS;
        assert_share(&of("tip_force_y_n"), interval(&one["tip_force_ci95_n"]), tolerance, "tip load");
        let learned = &one["learned"];
        assert_share(&of("k_kpa"), interval(&learned["k_ci95_kpa"]), tolerance, "K");
        // The band where it was measured, and beyond.
        let depths = draws["coords"][name_of("tip_y.depth_mm", one)].as_array().expect("depths");
        assert!(depths.len() > 20);
        for (place, depth) in depths.iter().enumerate().step_by(7) {
            let depth_index = depth.as_f64().expect("a depth") as usize;
            let band = [&one["lo95_y_mm"][depth_index], &one["hi95_y_mm"][depth_index]]
                .map(|end| end.as_f64().expect("an end"));
            let predicted = values(&draws, "posterior_predictive", &name_of("tip_y_mm", one), Some(place));
            assert_share(&predicted, band, tolerance, &format!("the band at {depth_index} mm"));
        }
    }
}

fn name_of(of: &str, one: &Value) -> String {
    format!("{}.{of}", one["id"].as_str().expect("a name"))
}

#[test]
fn draws_of_a_diagnosis_have_the_coverage_of_its_intervals() {
    let folder = folder();
    let mut session = writer(folder.path());
    add_lateral_run(&mut session);
    add_insertions(&mut session);
    let (result_json, draws) = drawn(folder.path(), "diagnose", &[]);
    // The interval also holds the value of the model that is reported: it may be wider than 95 %.
    let k = values(&draws, "posterior", "k_kpa", None);
    let [low, high] = interval(&result_json["k_ci95_kpa"]);
    let coverage = k.iter().filter(|k| (low..=high).contains(*k)).count() as f64 / 4000.0;
    assert!(coverage > 0.95 - SHARE_TOLERANCE && coverage < 0.98, "{coverage} within {low} to {high}");
    let load = values(&draws, "posterior", "tip_load_n", None);
    assert_share(&load, interval(&result_json["tip_load_ci95_n"]), SHARE_TOLERANCE, "tip load");
    assert!(draws["attrs"]["models"].as_str().expect("names").starts_with("0: "));
    assert!(spread("posterior", &draws) < spread("prior", &draws));
}

/// The posterior is narrower than the prior.
fn spread(group: &str, draws: &Value) -> f64 {
    let mut k_draws = values(draws, group, "k_kpa", None);
    k_draws.sort_by(f64::total_cmp);
    k_draws[3899] / k_draws[100]
}

#[test]
fn draws_need_lateral_runs_and_a_file_that_can_be_written() {
    let folder = folder();
    add_lateral_run(&mut writer(folder.path()));
    let nowhere = folder.path().join("none").join("draws.json");
    let line = failure(&["identify", path(folder.path()), "--draws", path(&nowhere)]);
    assert!(line.contains("draws.json: cannot write"), "{line}");
    let output = guide(&["identify", path(folder.path()), "--draws-per-chain", "5"]);
    assert!(text(&output.stderr).contains("10..=100000"), "{}", text(&output.stderr));
}
