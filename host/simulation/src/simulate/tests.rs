//! Plans carried out: what is written is what the forward model predicts, with the noise it was given.

use super::*;
use formats::session::{Session, Setup};
use inference::identify::{Options, identify};
use mechanics::Needle;
use mechanics::effects::{Effect, effect};
use std::fs;

const LATERAL: &str = "[tissue]\nk_kpa = 12\n[[lateral]]\nid = \"a\"\ndepth_mm = 30\n";

fn rig() -> Rig {
    Rig::two_guides(Needle::gauge_18(), 0.06, 0.07)
}

fn plan(text: &str) -> Result<SimulationPlan, SessionError> {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("plan.toml");
    fs::write(&path, text).expect("written");
    SimulationPlan::read(&path, None)
}

fn made(text: &str, sensors: Sensors, seed: u64) -> Simulated {
    plan(text).expect("a plan").carry_out(&rig(), sensors, seed).expect("carried out")
}

const NONE: Sensors =
    Sensors { force_n: 0.0, displacement_m: 0.0, shape_m: 0.0, tip_m: 0.0, tip_direction_rad: None };

#[test]
fn a_lateral_plan_goes_through_its_levels() {
    let run = made(LATERAL, NONE, 1).lateral.remove(0);
    // Nine holds of 3 s, and 4.8 mm between them at 1 mm/s.
    assert_eq!(run.force.time_s.len(), 20 * 27 + 96 + 1);
    for (time_s, level_mm) in
        [(0.0, 0.0), (3.0, 0.0), (3.2, 0.2), (3.4, 0.4), (6.4, 0.4), (13.0, 1.2), (31.0, 0.0)]
    {
        assert!(
            (displacement_mm(time_s, &run.force.time_s, &run.force.displacement_y_m) - level_mm).abs() < 1e-9,
            "{time_s}: {}",
            displacement_mm(time_s, &run.force.time_s, &run.force.displacement_y_m)
        );
    }
    assert!(run.force.displacement_x_m.expect("both planes").iter().all(|x_m| *x_m == 0.0));
    // 30 points in the holds at 0 (three), at 1.2 and at -1.2 mm; at the tip too.
    assert_eq!(run.shape.z_m.len(), 5 * 30);
    assert!((run.shape.z_m[29] - 0.1).abs() < 1e-12);
    let all_levels =
        made(&(LATERAL.to_owned() + "sweep_levels = \"all\"\naxis = \"x\"\n"), NONE, 1).lateral.remove(0);
    assert_eq!(all_levels.shape.z_m.len(), 9 * 30);
    assert_eq!(all_levels.force.force_x_n.expect("both planes"), run.force.force_y_n);
    assert!(all_levels.force.force_y_n.iter().all(|force_n| *force_n == 0.0));
}

fn displacement_mm(time_s: f64, run_force_time_s: &[f64], displacement_y_m: &[f64]) -> f64 {
    let row = run_force_time_s.iter().position(|row_s| (row_s - time_s).abs() < 1e-9).expect("a row");
    1e3 * displacement_y_m[row]
}

#[test]
fn an_insertion_plan_is_carried_out() {
    let text = "[tissue]\nk_kpa = 12\n[tip]\nload_n = 0.2\n[[insertion]]\nid = \"i\"\ndepth_mm = 20.2\nturn_at_mm = 10.3\n";
    let run = made(text, NONE, 1).insertion.remove(0);
    // Every half millimetre, the turn and the end.
    assert_eq!(run.depth_m.len(), 43);
    let rotation_rad = run.rotation_rad.as_deref().expect("turned");
    let count = run
        .depth_m
        .iter()
        .zip(rotation_rad)
        .filter(|(m, turn)| (**m > 0.0103 + 1e-9) == (**turn > 3.0))
        .count();
    assert_eq!(count, 43);
    assert!((run.time_s.as_deref().expect("times")[42] - 4.04).abs() < 1e-9);
    let straight = made(&text.replace("turn_at_mm = 10.3\n", ""), NONE, 1).insertion.remove(0);
    assert_eq!(straight.rotation_rad, None);
    assert!(straight.tip_y_m[41] > 1e-4 && straight.tip_y_m[41] > run.tip_y_m[42], "the load turned back");
}

#[test]
fn noise_is_as_stated_and_repeats() {
    let sensors = Sensors::new(&Noise { shape_m: Some(0.1e-3), ..Noise::default() });
    let (clean, noisy) = (made(LATERAL, NONE, 1), made(LATERAL, sensors, 1));
    let (clean, noisy) = (&clean.lateral[0], &noisy.lateral[0]);
    for (found, stated) in [
        (scatter(&clean.force.force_y_n, &noisy.force.force_y_n), 0.02),
        (scatter(&clean.force.displacement_y_m, &noisy.force.displacement_y_m), 0.01e-3),
        (scatter(&clean.shape.y_m, &noisy.shape.y_m), 0.1e-3),
    ] {
        assert!((found / stated - 1.0).abs() < 0.2, "{found} {stated}");
    }
    assert_eq!(made(LATERAL, sensors, 1).lateral[0], *noisy);
    assert_ne!(made(LATERAL, sensors, 2).lateral[0], *noisy);
    // Another run changes nothing in this one, and has noise of its own.
    let two = LATERAL.to_owned() + "[[lateral]]\nid = \"b\"\ndepth_mm = 30\n";
    let two = made(&two, sensors, 1).lateral;
    assert_eq!(two[0], *noisy);
    assert_ne!(two[1].force, two[0].force);
}

fn scatter(a: &[f64], b: &[f64]) -> f64 {
    (a.iter().zip(b).map(|(a, b)| (a - b).powi(2)).sum::<f64>() / a.len() as f64).sqrt()
}

#[test]
fn what_is_written_is_read() {
    let text = LATERAL.to_owned() + "[[insertion]]\nid = \"i\"\ndepth_mm = 10\nturn_at_mm = 5\n";
    let simulated = made(&text, Sensors::new(&Noise::default()), 4);
    let folder = tempfile::tempdir().expect("a folder");
    let setup = Setup {
        name: String::new(),
        rig: rig(),
        fixture_mass_kg: None,
        noise: Noise::default(),
        tissue: Default::default(),
    };
    let mut writer = SessionWriter::open(folder.path(), &setup).expect("a session");
    simulated.write(&mut writer).expect("written");
    let read = Session::read(folder.path()).expect("reads");
    let (read_run, simulated_run) = (&read.lateral[0], &simulated.lateral[0]);
    assert!(
        are_close(&read_run.force.force_y_n, &simulated_run.force.force_y_n)
            && are_close(&read_run.shape.y_m, &simulated_run.shape.y_m)
    );
    assert!(are_close(
        read_run.shape.x_m.as_deref().expect("x"),
        simulated_run.shape.x_m.as_deref().expect("x")
    ));
    let (read_run, simulated_run) = (&read.insertion[0], &simulated.insertion[0]);
    assert!(
        are_close(&read_run.tip_y_m, &simulated_run.tip_y_m)
            && are_close(&read_run.depth_m, &simulated_run.depth_m)
    );
    assert!(are_close(
        read_run.rotation_rad.as_deref().expect("turned"),
        simulated_run.rotation_rad.as_deref().expect("turned")
    ));
}

fn are_close(a: &[f64], b: &[f64]) -> bool {
    a.len() == b.len() && a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-9)
}

#[test]
fn faults_in_a_plan_are_named_with_their_place() {
    assert_fails(
        &plan_with("depth = 3"),
        &["plan.toml:6:1: lateral.depth: \"depth\" is not known", "id, depth_mm, axis"],
    );
    assert_fails(
        &plan_with("axis = \"z\""),
        &["plan.toml:6:8: lateral.axis: \"z\" is not known", "\"y\" or \"x\""],
    );
    assert_fails(&plan_with("levels_mm = []"), &["6:13: lateral.levels_mm: empty"]);
    assert_fails(
        &plan_with("levels_mm = [0, 99]"),
        &["6:17: lateral.levels_mm: 99 is out of range", "-50 to 50"],
    );
    assert_fails(&plan_with("levels_mm = 1"), &["this is an integer", "a list of numbers"]);
    assert_fails(
        &plan_with("hold_s = 0.6"),
        &["lateral.hold_s: 0.6 is out of range, expected 20 rows or more: 1 s"],
    );
    assert_fails(
        &plan_with("rate_hz = 1000\nhold_s = 3600"),
        &["lateral.rate_hz: ", " rows, expected at most 1000000 in a run"],
    );
    assert_fails(
        &plan_with("[[lateral]]\nid = \"a\"\ndepth_mm = 2"),
        &["7:6: lateral.id: \"a\" appears twice"],
    );
    assert_fails(
        &plan_with("[[insertion]]\nid = \"a\"\ndepth_mm = 20"),
        &["insertion.id: \"a\" appears twice"],
    );
    assert_fails(
        &plan_with("[[insertion]]\nid = \"i\"\ndepth_mm = 20\nturn_at_mm = 21"),
        &["9:14: insertion.turn_at_mm: 21"],
    );
    assert_fails(&LATERAL.replace("k_kpa = 12", "layers = []"), &["1:1: tissue.k_kpa: missing"]);
    assert_fails(&LATERAL.replace("[tissue]\nk_kpa = 12\n", ""), &["tissue.k_kpa: missing"]);
    assert_fails(
        &LATERAL.replace("k_kpa", "k_pa"),
        &["2:1: tissue.k_pa", "k_kpa, k_ci95_kpa, foundation, poisson"],
    );
}

fn plan_with(line: &str) -> String {
    format!("{LATERAL}{line}\n")
}

fn assert_fails(text: &str, words: &[&str]) {
    let message = plan(text).expect_err("a fault").to_string();
    for word in words {
        assert!(message.contains(word), "{word} in {message}");
    }
}

/// Lateral runs as planned, with ordinary noise.
fn session(text: &str) -> Session {
    Session {
        dir: "made".into(),
        name: None,
        rig: rig(),
        fixture_mass_kg: None,
        noise: Noise::default(),
        tissue: Default::default(),
        lateral: made(text, Sensors::new(&Noise::default()), 5).lateral,
        insertion: Vec::new(),
        indentation: Vec::new(),
        steering: Vec::new(),
    }
}

/// The modulus is found by a model that has the effect, and missed by one that has not.
#[track_caller]
fn needs(id: &str, values: &[f64], lateral: &str) {
    let tested = effect(id).expect("an effect");
    let parameters: Vec<String> = tested
        .parameters()
        .iter()
        .zip(values)
        .map(|(info, value)| format!("{} = {{ value = {value} }}", info.name))
        .collect();
    let text = format!(
        "[tissue]\nk_kpa = 12\n[[effect]]\nid = \"{id}\"\nparameters = {{ {} }}\n{lateral}",
        parameters.join(", ")
    );
    let session = session(&text);
    let found = |fixed: Vec<(&'static dyn Effect, Vec<f64>)>| {
        let options = Options { fixed, model_error: false, ..Options::default() };
        identify(&session, &options).expect("identified")
    };
    let with_effect = found(vec![(tested, values.to_vec())]);
    let [low, high] = with_effect.pooled.ci95_kpa;
    assert!(low < 12.0 && 12.0 < high && high / low < 1.25, "{id}: {low} to {high} with it");
    assert_eq!(with_effect.effects, [id]);
    assert!(with_effect.warnings.iter().any(|warning| warning.contains("energy method models no effects")));
    let without_effect = found(Vec::new());
    let [low, high] = without_effect.pooled.ci95_kpa;
    assert!(high < 12.0 || low > 12.0, "{id}: {low} to {high} without it");
    assert!(
        without_effect.effects.is_empty()
            && !without_effect.warnings.iter().any(|w| w.contains("models no effects"))
    );
}

const DEEP: &str = "[[lateral]]\nid = \"a\"\ndepth_mm = 30\n";
const HORIZONTAL: &str = "[[lateral]]\nid = \"a\"\ndepth_mm = 30\naxis = \"x\"\n";

#[test]
fn layers_in_the_model_give_the_modulus() {
    needs("tissue.layers", &[2.5, 12.0], DEEP);
}

#[test]
fn clearance_in_the_model_gives_the_modulus() {
    needs("rig.backlash", &[0.15], DEEP);
}

/// The force of a hold decays with time: this needs the course of the run, not its levels.
#[test]
fn relaxation_in_the_model_gives_the_modulus() {
    needs("tissue.relaxation", &[0.5, 4.0], DEEP);
    // Many rows: the course is thinned.
    needs("tissue.relaxation", &[0.5, 4.0], &(DEEP.to_owned() + "rate_hz = 130\n"));
}

/// Along the course of a run, a model whose effect does nothing predicts what the plain model predicts at the levels.
#[test]
fn an_effect_that_does_nothing_changes_nothing() {
    let session = session(LATERAL);
    let k_kpa = |fixed: Vec<(&'static dyn Effect, Vec<f64>)>| {
        let identification = identify(&session, &Options { fixed, model_error: false, ..Options::default() })
            .expect("identified");
        [identification.pooled.k_kpa, identification.pooled.sd_kpa]
    };
    let gradient = effect("tissue.gradient").expect("an effect");
    let (k_with_kpa, k_without_kpa) = (k_kpa(vec![(gradient, vec![0.0])]), k_kpa(Vec::new()));
    for (k_with_kpa, k_without_kpa) in k_with_kpa.iter().zip(k_without_kpa) {
        assert!((k_with_kpa / k_without_kpa - 1.0).abs() < 1e-6, "{k_with_kpa} {k_without_kpa}");
    }
}

#[test]
fn a_horizontal_run_has_the_effects_of_its_plane() {
    needs("tissue.anisotropy", &[2.0], HORIZONTAL);
}
