//! Models survive the disk, and faulty files are refused with the place of the fault.

use super::*;
use proptest::prelude::*;
use std::fs;

const GOOD: &str = r#"[model]
format = 1
learned_from = "phantom-a"
[tissue]
k_kpa = 12.1
k_ci95_kpa = [11.8, 12.4]
[tip]
load_n = 0.2
[[effect]]
id = "sensor.force_bias"
parameters = { bias_x_n = { value = 0.1 } }
[[effect]]
id = "tissue.layers"
log_evidence_gain = 57.1
[effect.parameters.k_ratio]
value = 2.1
ci95 = [1.8, 2.4]
[effect.parameters.boundary_mm]
value = 14.8
"#;

fn read(text: &str) -> Result<ModelFile, SessionError> {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("model.toml");
    fs::write(&path, text).expect("written");
    ModelFile::read(&path)
}

#[test]
fn a_model_has_the_values_of_its_file() {
    let model = read(GOOD).expect("reads");
    assert_eq!(model.learned_from.as_deref(), Some("phantom-a"));
    assert_eq!((model.modulus_pa, model.modulus_ci95_pa), (Some(12_100.0), Some([11_800.0, 12_400.0])));
    assert_eq!((model.tip_load_n, model.tip_load_ci95_n), (Some(0.2), None));
    // In the catalogue layers come before the force sensor.
    let effects = model.effects();
    let effect_values: Vec<_> =
        effects.iter().map(|(effect, values)| (effect.id(), values.as_slice())).collect();
    assert_eq!(effect_values, [("tissue.layers", &[2.1, 14.8][..]), ("sensor.force_bias", &[0.0, 0.1])]);
    assert_eq!(model.effects[1].ci95, [Some([1.8, 2.4]), None]);
    assert_eq!(model.effects[1].log_evidence_gain, Some(57.1));
    assert_eq!(read("[model]\nformat = 1\n").expect("reads"), ModelFile::default());
}

#[test]
fn one_model_replaces_the_values_of_another_that_it_states() {
    let stated = read(
        "[model]\nformat = 1\n[tip]\nload_n = 0.3\n[[effect]]\nid = \"tissue.skin\"\n[effect.parameters]\nstiffness_n_per_mm = { value = 1 }\n",
    );
    let stated_model = stated.expect("reads");
    let replaced = read(GOOD).expect("reads").replaced_by(&stated_model);
    assert_eq!((replaced.modulus_pa, replaced.tip_load_n), (Some(12_100.0), Some(0.3)));
    assert_eq!(replaced.effects.len(), 3);
    assert_eq!(stated_model.clone().replaced_by(&stated_model), stated_model);
}

#[test]
fn faults_are_named_with_their_place() {
    fn fails(text: String, place: &str, words: &[&str]) {
        let message = read(&text).expect_err("a fault").to_string();
        assert!(message.contains(&format!("model.toml:{place}")), "{place} in {message}");
        for word in words {
            assert!(message.contains(word), "{word} in {message}");
        }
    }
    fn with(from: &str, to: &str) -> String {
        assert!(GOOD.contains(from), "{from}");
        GOOD.replacen(from, to, 1)
    }
    fails(
        with("tissue.layers", "tissue.layer"),
        "13:6",
        &["effect.id: \"tissue.layer\" is not known", "expected one of tissue.layers"],
    );
    fails(with("tissue.layers", "layers"), "13:6", &["expected one of tissue.layers"]);
    fails(with("tissue.layers", "fog"), "13:6", &["one of tissue.layers, tissue.gradient", "tip.rate"]);
    fails(
        with("boundary_mm]", "boundary_cm]"),
        "18:20",
        &["effect.parameters.boundary_cm", "k_ratio, boundary_mm"],
    );
    fails(
        with("value = 14.8", "value = 0.5"),
        "19:9",
        &["effect.parameters.boundary_mm.value: 0.5 is out of range", "1 to 200"],
    );
    fails(with("value = 14.8", "value = inf"), "19:9", &["not a finite number"]);
    fails(with("value = 14.8", "value = \"deep\""), "19:9", &["this is a string", "a number from 1 to 200"]);
    fails(with("value = 14.8", "valeu = 14.8"), "19:1", &["\"valeu\" is not known", "value, ci95"]);
    // A ratio without a boundary means nothing; a boundary without a ratio means that there is no second layer.
    let incomplete = with("[effect.parameters.boundary_mm]\nvalue = 14.8\n", "");
    fails(incomplete, "", &["effect.parameters.boundary_mm: missing, expected a table with value, 1 to 200"]);
    let incomplete = with("[effect.parameters.k_ratio]\nvalue = 2.1\nci95 = [1.8, 2.4]\n", "");
    assert_eq!(read(&incomplete).expect("reads").effects[1].values, [1.0, 14.8]);
    fails(with("bias_x_n = { value = 0.1 }", ""), "11:14", &["empty, expected bias_n, bias_x_n"]);
    fails(with("parameters = { bias_x_n = { value = 0.1 } }\n", ""), "", &["effect.parameters: missing"]);
    let twice = "[[effect]]\nid = \"tissue.layers\"\nparameters = { boundary_mm = { value = 3 } }\n";
    fails(GOOD.to_owned() + twice, "21:6", &["\"tissue.layers\" appears twice"]);
    fails(with("[1.8, 2.4]", "[2.4, 1.8]"), "17:8", &["2.4 is more than the second number"]);
    fails(with("[11.8, 12.4]", "[11.8]"), "6:14", &["tissue.k_ci95_kpa: a list of 1", "[low, high]"]);
    fails(with("[11.8, 12.4]", "[11.8, \"x\"]"), "6:21", &["this is a string"]);
    fails(
        with("k_kpa = 12.1", "k_kpa = 0"),
        "5:9",
        &["tissue.k_kpa: 0 is out of range, expected a number from 0.01"],
    );
    fails(with("load_n", "load_kg"), "8:1", &["tip.load_kg", "load_n, load_ci95_n"]);
    fails(with("format = 1", "format = 2"), "2:10", &["model.format: 2 is not known, expected 1"]);
    fails(
        with("[model]", "[modle]"),
        "1:2",
        &["\"modle\" is not known", "model, tissue, tip, discrepancy, effect"],
    );
    fails("[tissue]\nk_kpa = 1".to_owned(), "1:1", &["model: missing"]);
    fails(with("12.1", ""), "5:", &["syntax"]);
}

#[test]
fn alternatives_have_effects_of_their_own_and_share_one_probability() {
    fn other(probability: &str) -> String {
        format!(
            "[[alternative]]\nprobability = {probability}\n[alternative.tissue]\nk_kpa = 9.5\n[[alternative.effect]]\nid = \"tissue.gradient\"\n\
             parameters = {{ gradient_per_mm = {{ value = 0.04 }} }}\n"
        )
    }
    let model = read(&format!("{GOOD}{}", other("0.4"))).expect("reads");
    let [alternative] = model.alternatives.as_slice() else { panic!("one alternative") };
    assert_eq!((alternative.probability, alternative.model.modulus_pa), (0.4, Some(9_500.0)));
    assert_eq!(alternative.model.effects().first().map(|(effect, values)| (effect.id(), values.clone())), {
        Some(("tissue.gradient", vec![0.04]))
    });
    assert_eq!(model.effects.len(), 2);
    fn fails(more: &str, words: &str) {
        let message = read(&format!("{GOOD}{more}")).expect_err("a fault").to_string();
        assert!(message.contains(words), "{words} in {message}");
    }
    fails(
        &other("1.1"),
        "21:15: alternative.probability: 1.1 is out of range, expected a number from 0 to 1",
    );
    fails(
        &(other("0.6") + &other("0.6")),
        "28:15: alternative.probability: 0.6 is out of range, expected probabilities of all",
    );
    fails(&other("0.4").replace("probability = 0.4\n", ""), "alternative.probability: missing");
    fails(&other("0.4").replace("alternative.tissue", "alternative.rig"), "alternative.rig");
}

#[test]
fn reports_what_cannot_be_written() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("model.toml");
    let model = ModelFile { modulus_pa: Some(f64::NAN), ..ModelFile::default() };
    let message = model.write(&path).expect_err("not finite").to_string();
    assert!(message.contains("k_kpa") && !path.exists(), "{message}");
    assert!(ModelFile::read(&path).expect_err("no file").to_string().contains("model.toml: cannot read"));
    // Plain numbers stay plain.
    let model = ModelFile { modulus_pa: Some(12_100.0), ..ModelFile::default() };
    assert_eq!(model.text(&path).expect("text"), "[model]\nformat = 1\n\n[tissue]\nk_kpa = 12.1\n");
}

fn interval() -> impl Strategy<Value = Option<[f64; 2]>> {
    proptest::option::of((-1e6..1e6f64, 0.0..1e6f64).prop_map(|(low, width)| [low, low + width]))
}

fn learned(index: usize) -> impl Strategy<Value = LearnedEffect> {
    let effect = EFFECTS[index];
    let count = effect.parameters().len();
    let probabilities = proptest::collection::vec(0.0..=1.0f64, count);
    let intervals = proptest::collection::vec(interval(), count);
    (probabilities, intervals, proptest::option::of(-1e3..1e3f64)).prop_map(
        move |(probabilities, ci95, log_evidence_gain)| {
            let values = effect
                .parameters()
                .iter()
                .zip(probabilities)
                .map(|(info, share)| {
                    let [least, most] = info.range;
                    (least + share * (most - least)).clamp(least, most)
                })
                .collect();
            LearnedEffect { effect, values, ci95, log_evidence_gain }
        },
    )
}

prop_compose! {
    fn of_one()(
        learned_from in proptest::option::of("[ -~\\n\u{e4}]{1,20}x"),
        modulus_pa in proptest::option::of(10.0..1e7f64),
        modulus_ci95_pa in interval(),
        support in proptest::option::of(proptest::option::of(0.0..0.5f64)),
        youngs_pa in proptest::option::of(10.0..1e7f64),
        youngs_ci95_pa in interval(),
        tip_load_n in proptest::option::of(-50.0..50.0f64),
        tip_load_ci95_n in interval(),
        discrepancy in proptest::collection::btree_map(
            proptest::sample::select(DISCREPANCY_NAMES.map(str::to_owned).to_vec()), 0.0..100.0f64, 0..4),
        effects in proptest::sample::subsequence((0..EFFECTS.len()).collect::<Vec<_>>(), 0..5)
            .prop_flat_map(|indices| indices.into_iter().map(learned).collect::<Vec<_>>()),
    ) -> ModelFile {
        let support = support.map(|of| of.map_or(Support::Springs, Support::half_space));
        ModelFile {
            learned_from,
            modulus_pa,
            modulus_ci95_pa,
            support,
            youngs_pa,
            youngs_ci95_pa,
            tip_load_n,
            tip_load_ci95_n,
            discrepancy,
            effects,
            alternatives: Vec::new(),
        }
    }
}

prop_compose! {
    /// The source is stated for a file, not for each of its models.
    fn model()(own in of_one(), others in proptest::collection::vec((of_one(), 0.0..0.3f64), 0..3)) -> ModelFile {
        let alternatives = others.into_iter().map(|(model, probability)| {
            Alternative { probability, model: ModelFile { learned_from: None, ..model } }
        });
        ModelFile { alternatives: alternatives.collect(), ..own }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(200))]

    #[test]
    fn what_is_written_is_read_to_the_last_bit(model in model()) {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("model.toml");
        model.write(&path).expect("written");
        prop_assert_eq!(ModelFile::read(&path).expect("reads"), model);
    }
}
