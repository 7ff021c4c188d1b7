//! Further rigs: what they are or hide is found from what the firmware records.

use std::path::Path;
use system::demo::hidden::{AFTER_AIR, AS_STATED, RigKnown, diagnosis};
use system::demo::investigated::investigated;
use system::demo::procedure;
use system::readme;

const XTASK: &str = env!("CARGO_BIN_EXE_system");

/// Another seed is another rig, and its modulus is found too.
#[test]
#[ignore = "needs QEMU: cargo xtask test --all runs it"]
fn the_procedure_finds_the_modulus_of_another_rig() {
    let [first, first_run] = [readme::rig::SEED, 4].map(|seed| {
        let folder = tempfile::tempdir().unwrap();
        procedure(Path::new(XTASK), seed, &folder.path().join("demo"), &mut |_| {}).unwrap()
    });
    assert_ne!(first.truth, first_run.truth);
    assert_ne!(first.identified["pooled"], first_run.identified["pooled"]);
    assert!(first_run.error().unwrap().abs() < 0.1, "{:?}", first_run.identified);
}

/// Seeds of rigs whose hidden effect has to be found, beside the one that the pages show: each of another effect.
const HIDING_SEEDS: [u64; 3] = [53_003, 53_012, 53_019];

#[test]
#[ignore = "needs QEMU: cargo xtask test --all runs it"]
fn a_hidden_effect_is_found_from_what_the_firmware_records() {
    let folder = tempfile::tempdir().unwrap();
    let (output_dir, mut printed) = (readme::rig::out(folder.path()), String::new());
    let seed = readme::rig::SEED;
    let mut show = |text: &str| printed.push_str(text);
    let start_step = diagnosis(Path::new(XTASK), seed, &output_dir, AFTER_AIR, &mut show).unwrap();
    printed.push_str(&start_step.summary(seed));
    readme::check_part("hidden", &readme::rig::as_shown(&printed, folder.path(), Path::new(XTASK))).unwrap();
    assert!(start_step.is_in_class(), "{start_step:#?}");
    assert!(start_step.removed().unwrap() > 0.9, "{start_step:#?}");
    assert!(output_dir.join("model.toml").exists() && output_dir.join("figures/residuals.svg").exists());
}

#[test]
#[ignore = "needs QEMU: cargo xtask test --all runs it"]
fn hidden_effects_are_found_from_what_is_stated_of_the_rig() {
    let folder = tempfile::tempdir().unwrap();
    let out = readme::rig::out(folder.path());
    for seed in HIDING_SEEDS {
        let found = diagnosis(Path::new(XTASK), seed, &out, AS_STATED, &mut |_| {}).unwrap();
        assert!(found.is_in_class(), "{}\n{found:#?}", found.summary(seed));
        assert!(found.further().is_empty(), "{}\n{found:#?}", found.summary(seed));
    }
}

/// `guide investigate` chooses the runs, the firmware makes them: every step has its reason, and in the end what is hidden has its name.
#[test]
#[ignore = "needs QEMU: cargo xtask test --all runs it"]
fn an_investigation_through_the_firmware_ends_with_the_name_of_what_is_hidden() {
    let folder = tempfile::tempdir().unwrap();
    let out = readme::rig::out(folder.path());
    let seed = HIDING_SEEDS[0];
    let result = investigated(Path::new(XTASK), seed, &out, RigKnown::AsStated, &mut |_| {}).unwrap();
    assert!(result.found.is_in_class(), "{}\n{:#}", result.summary(seed), result.log);
    assert!(result.found.further().is_empty(), "{}", result.summary(seed));
    let steps = result.log["steps"].as_array().unwrap();
    assert!(steps.len() > 1 && result.runs() <= 6, "{:#}", result.log);
    for (number, step) in steps.iter().enumerate() {
        let is_last = number + 1 == steps.len();
        assert_eq!(step["realised_nats"].is_null(), number == 0, "{step:#}");
        assert!(is_last || step["next"]["information_nats"].as_f64().unwrap() > 0.0, "{step:#}");
    }
}
