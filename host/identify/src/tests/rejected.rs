//! Runs and holds that are not used: by which rule, and how that is reported.

use super::*;
use formats::session::{IndentationRun, ShapeSeries};

fn only_error(run: LateralRun) -> RunError {
    match identify(&session(vec![run]), &Options::default()) {
        Err(IdentifyError::AllFailed { mut reasons, .. }) => reasons.remove(0).1,
        other => panic!("{other:?}"),
    }
}

/// A shape in the wrong scale, and a force in the wrong scale: numbers come out, and warnings with them.
#[test]
fn what_does_not_fit_together_is_reported() {
    let mut small = Recipe::default().run("a", &mut Noise::new(2));
    small.shape.y_m.iter_mut().for_each(|y_m| *y_m *= 0.3);
    assert_warned(small, "deviates from the fitted beam");
    let mut strong = Recipe { force_sd_n: 0.005, ..Recipe::default() }.run("a", &mut Noise::new(2));
    strong.force.force_y_n.iter_mut().for_each(|force_n| *force_n *= 1.5);
    assert_warned(strong, "force and shape disagree");
    let sound = identified(&session(vec![Recipe::default().run("a", &mut Noise::new(2))])).warnings;
    assert!(
        !sound.iter().any(|w| w.contains("disagree") || w.contains("deviates from the fitted")),
        "{sound:?}"
    );
}

fn assert_warned(run: LateralRun, words: &str) {
    let warnings = identified(&session(vec![run])).warnings;
    assert!(warnings.iter().any(|warning| warning.contains(words)), "{words}: {warnings:?}");
}

#[test]
fn a_hold_with_lost_samples_is_not_used() {
    let levels_mm = vec![0.0, 0.8, 1.2];
    let mut run = Recipe { levels_mm, ..Recipe::default() }.run("a", &mut Noise::new(2));
    let mut lost = vec![0.0; run.force.time_s.len()];
    lost[250] = 4.0;
    run.force.lost_before = Some(lost);
    let result = identified(&session(vec![run]));
    let hold_used: Vec<bool> = result.runs[0].holds.iter().map(|hold| hold.used).collect();
    assert_eq!(hold_used, [true, false, true]);
    assert!(result.warnings.iter().any(|warning| warning.contains("lost 4 samples")));
}

#[test]
fn every_reason_why_a_run_cannot_be_identified_is_named() {
    let mut empty = made(Recipe::default());
    (empty.force, empty.shape) = Default::default();
    assert!(matches!(only_error(empty), RunError::NoHold { duration_s: 0.0, .. }));

    let mut lossy = made(Recipe::default());
    lossy.force.lost_before = Some(vec![1.0; lossy.force.time_s.len()]);
    assert!(matches!(only_error(lossy), RunError::AllLost { holds: 3, .. }));

    let still = made(Recipe { levels_mm: vec![0.0], ..Recipe::default() });
    let why = only_error(still);
    assert!(matches!(why, RunError::NoDisplacement { .. }), "{why}");

    let mut unmeasured = made(Recipe::default());
    unmeasured.shape = ShapeSeries::default();
    assert!(matches!(only_error(unmeasured), RunError::TooFewPoints { found: 0, .. }));

    let mut pulled = made(Recipe::default());
    pulled.force.force_y_n.iter_mut().for_each(|force_n| *force_n *= -1.0);
    assert!(matches!(only_error(pulled), RunError::ForceSign { .. }));

    let mut mirrored = made(Recipe::default());
    mirrored.shape.y_m.iter_mut().for_each(|y_m| *y_m *= -1.0);
    let why = only_error(mirrored);
    assert!(matches!(why, RunError::ShapeSign { .. }) && why.to_string().contains("sign"), "{why}");

    // A hundredth of the needle's own stiffness: no tissue is soft enough.
    let mut limp = made(Recipe { shape_sd_mm: 0.001, ..Recipe::default() });
    limp.shape.y_m.iter_mut().zip(&limp.shape.z_m).for_each(|(y_m, z_m)| *y_m = (z_m - 0.04) * 0.1);
    limp.force.force_y_n.iter_mut().for_each(|force_n| *force_n *= 1e-3);
    assert!(matches!(only_error(limp), RunError::AtBound { .. } | RunError::Fit { .. }));

    let empty_result = identify(&session(Vec::new()), &Options::default());
    assert!(matches!(empty_result, Err(IdentifyError::NoRuns { .. })));
}

fn made(recipe: Recipe) -> LateralRun {
    recipe.run("a", &mut Noise::new(4))
}

#[test]
fn a_run_that_fails_is_skipped_with_a_warning() {
    let mut noise = Noise::new(9);
    let good = Recipe::default().run("good", &mut noise);
    let mut bad = Recipe::default().run("bad", &mut noise);
    bad.shape = ShapeSeries::default();
    let alone = identified(&session(vec![good.clone()]));
    let both_runs = identified(&session(vec![good, bad]));
    assert_eq!(both_runs.pooled, alone.pooled);
    assert!(both_runs.runs[1].error.as_ref().expect("a reason").contains("bad.shape.csv"));
    assert_eq!(both_runs.runs[1].methods.likelihood.k_kpa, None);
    assert!(both_runs.warnings.iter().any(|warning| warning.starts_with("run bad is skipped")));
}

/// A run whose shape belongs to another depth does not move the pooled modulus of the others.
#[test]
fn a_run_that_cannot_belong_is_excluded_by_rule() {
    for is_stated in [true, false] {
        let mut noise = Noise::new(13);
        let good: Vec<_> = (0..4).map(|i| Recipe::default().run(&format!("r{i}"), &mut noise)).collect();
        let mut outlying = Recipe::default().run("outlying", &mut noise);
        // A shape in centimetres for millimetres.
        outlying.shape.y_m.iter_mut().for_each(|y_m| *y_m *= 10.0);
        let mut alone = session(good.clone());
        let mut both_runs = session([good, vec![outlying]].concat());
        if is_stated {
            alone.noise = Recipe::default().stated();
            both_runs.noise = alone.noise;
        }
        let (alone, with_outlier) = (identified(&alone), identified(&both_runs));
        assert!(
            with_outlier.runs[4].skipped.is_some() || with_outlier.runs[4].error.is_some(),
            "{:?}",
            with_outlier.warnings
        );
        assert_eq!(with_outlier.pooled, alone.pooled);
        let unused = with_outlier.unused.iter().find(|unused| unused.run == "outlying").expect("listed");
        assert_eq!(unused.part, "run");
        assert!(
            with_outlier.warnings.iter().any(|what| {
                ["skipped", "excluded"].iter().any(|how| what.contains(&format!("run outlying is {how}")))
            }),
            "{:?}",
            with_outlier.warnings
        );
        assert!(alone.unused.is_empty() && alone.runs.iter().all(|run| run.skipped.is_none()));
    }
    // Two that differ: neither is the outlying one.
    let mut noise = Noise::new(14);
    let rough = Recipe { shape_sd_mm: 0.3, ..Recipe::default() }.run("rough", &mut noise);
    let pair = identified(&session(vec![Recipe::default().run("fine", &mut noise), rough]));
    assert!(pair.runs.iter().all(|run| run.skipped.is_none()));
}

/// Suspected units that `check` reports come with the numbers, and before the reasons if there are
/// none.
#[test]
fn suspected_units_come_first() {
    let mut session = session(vec![Recipe::default().run("a", &mut Noise::new(15))]);
    session.indentation = vec![IndentationRun {
        id: "ref".to_owned(),
        path: "ref.csv".into(),
        indenter: Default::default(),
        half_angle_rad: None,
        indenter_radius_m: 2.1e-3,
        tissue_thickness_m: None,
        poisson: 0.5,
        depth_m: vec![1e-6, 2e-6, 3e-6],
        force_n: vec![0.1, 0.2, 0.3],
    }];
    let identification = identified(&session);
    assert!(identification.warnings[0].contains("is this in metres?"), "{:?}", identification.warnings);
    assert_eq!(identification.reference, None);
    session.lateral[0].force.displacement_y_m.iter_mut().for_each(|m| *m *= 1e-3);
    let why = identify(&session, &Options::default()).expect_err("not displaced").to_string();
    let (units, physics) = (why.find("is this in metres?"), why.find("no hold is displaced"));
    assert!(units.is_some() && units < physics, "{why}");
}
