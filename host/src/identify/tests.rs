//! The workflow on sessions made from the forward model: truth, scatter, coverage, and every way it can fail.

use super::*;
use crate::continuum::Contact;
use crate::inference::modulus::{mean_and_sd, punch_modulus_pa};
use crate::model::effects::effect;
use crate::session::{IndentationRun, ShapeSeries};
use crate::testing::Noise;

mod body;
mod recipe;

use recipe::{K_KPA, Recipe, session};

/// Springs, of which the recipes are made, and noise alone, which is all that is wrong with them: what an elastic body gives, and model
/// error, are other matters, and take longer.
fn on_springs() -> Options {
    Options { foundation: Some(FoundationChoice::Springs), model_error: false, ..Options::default() }
}

fn identified(session: &Session) -> Identification {
    identify(session, &on_springs()).expect("identifies")
}

fn only_error(run: LateralRun) -> RunError {
    match identify(&session(vec![run]), &Options::default()) {
        Err(IdentifyError::AllFailed { mut reasons, .. }) => reasons.remove(0).1,
        other => panic!("{other:?}"),
    }
}

/// Bias, scatter against what is stated, and coverage, with noise that the session does not state.
#[test]
fn estimates_are_unbiased_scatter_as_stated_and_cover() {
    const SESSIONS: usize = 150;
    let mut noise = Noise::new(11);
    let (mut found, mut stated, mut covered) = (Vec::new(), 0.0, 0);
    for _ in 0..SESSIONS {
        let result = identified(&session(vec![Recipe::default().run("a", &mut noise)]));
        let [low, high] = result.pooled.ci95_kpa;
        covered += usize::from((low..=high).contains(&K_KPA));
        stated += result.pooled.sd_kpa / SESSIONS as f64;
        found.push(result.pooled.k_kpa);
    }
    let (mean, sd) = mean_and_sd(&found).expect("many");
    println!("{mean:.3} kPa, scatter {sd:.3}, stated {stated:.3}, {covered} of {SESSIONS} covered");
    assert!((mean - K_KPA).abs() < 3.5 * sd / (SESSIONS as f64).sqrt(), "{mean} +- {sd}");
    assert!((stated / sd - 1.0).abs() < 0.2, "stated {stated}, real {sd}");
    // 95 % of 150 is 142.5; the binomial's standard deviation is 2.7.
    assert!((134..=149).contains(&covered), "{covered} of {SESSIONS}");
}

/// Rigs that differ as the priors say: with the nuisances modelled the intervals cover, without them they do not.
#[test]
fn nuisances_in_the_truth_are_covered_when_they_are_modelled() {
    const SESSIONS: usize = 500;
    let ids = ["rig.clamp_compliance", "sensor.shape_offset", "sensor.depth_shift"];
    let modelled =
        Options { nuisances: ids.iter().map(|id| effect(id).expect("an effect")).collect(), ..on_springs() };
    let mut noise = Noise::new(21);
    let (mut covered, mut covered_plain, mut clamp_pulls) = (0, 0, Vec::new());
    for _ in 0..SESSIONS {
        let recipe = Recipe {
            clamp_rad_per_n_m: (0.1 * noise.normal()).abs(),
            shape_offset_mm: 0.5 * noise.normal(),
            shape_shift_mm: 0.5 * noise.normal(),
            ..Recipe::default()
        };
        let mut session = session(vec![recipe.run("a", &mut noise)]);
        session.noise = recipe.stated();
        let result = identify(&session, &modelled).expect("identifies").pooled;
        let covers = |pooled: &Pooled| (pooled.ci95_kpa[0]..=pooled.ci95_kpa[1]).contains(&K_KPA);
        covered += usize::from(covers(&result));
        covered_plain += usize::from(covers(&identified(&session).pooled));
        let clamp = &result.nuisances[0];
        assert_eq!((clamp.effect, clamp.parameter), (ids[0], "compliance_rad_per_n_m"));
        assert!(clamp.sd <= 1.001 * clamp.prior_sd);
        clamp_pulls.push((clamp.value - recipe.clamp_rad_per_n_m) / clamp.sd);
    }
    println!("{covered} of {SESSIONS} covered, {covered_plain} without the nuisances");
    // 92 % and more: the clamp's bound at zero makes the intervals a little too wide, never too narrow.
    assert!(covered >= 460, "{covered} of {SESSIONS}");
    assert!(covered_plain < 300, "{covered_plain} of {SESSIONS}");
    let (_, spread) = mean_and_sd(&clamp_pulls).expect("many");
    assert!((0.6..1.3).contains(&spread), "{spread}");
}

#[test]
fn without_force_the_modulus_is_found_with_a_wider_interval_that_covers() {
    const SESSIONS: usize = 100;
    let mut noise = Noise::new(31);
    let mut covered = 0;
    for _ in 0..SESSIONS {
        // The force cell is off by a factor: without force that does not matter.
        let recipe = Recipe { force_sd_n: 0.005, ..Recipe::default() };
        let mut run = recipe.run("a", &mut noise);
        run.force.force_y_n.iter_mut().for_each(|force_n| *force_n *= 3.0);
        let methods = identified(&session(vec![run])).runs.remove(0).methods;
        let [low, high] = methods.likelihood_without_force.ci95_kpa.expect("an interval");
        covered += usize::from((low..=high).contains(&K_KPA));
    }
    assert!((89..=99).contains(&covered), "{covered} of {SESSIONS}");
    let methods = identified(&session(vec![Recipe::default().run("a", &mut noise)])).runs.remove(0).methods;
    assert!(methods.likelihood_without_force.sd_kpa > methods.likelihood.sd_kpa);
}

#[test]
fn directions_are_told_apart() {
    let mut noise = Noise::new(41);
    let oblique = Recipe { direction: [0.8, 0.6], ..Recipe::default() };
    let same = identified(&session(vec![oblique.run("xy", &mut noise)])).directions.expect("both planes");
    let [low, high] = same.ratio_ci95;
    assert!(low < 1.0 && 1.0 < high && high < 1.3, "{same:?}");

    let stiff_x = Recipe { k_kpa: 1.5 * K_KPA, direction: [0.0, 1.0], ..Recipe::default() };
    let runs = vec![Recipe::default().run("y", &mut noise), stiff_x.run("x", &mut noise)];
    let apart = identified(&session(runs)).directions.expect("both planes");
    let [low, high] = apart.ratio_ci95;
    assert!(low > 1.2 && (low..=high).contains(&1.5), "{apart:?}");
    assert_eq!(identified(&session(vec![Recipe::default().run("y", &mut noise)])).directions, None);
}

#[test]
fn pooling_runs_narrows_the_interval_as_their_number_says() {
    let mut noise = Noise::new(5);
    let mut recipe = Recipe::default();
    let runs: Vec<_> = (0..4).map(|i| recipe.run(&format!("r{i}"), &mut noise)).collect();
    let mut session = session(runs);
    session.noise = recipe.stated();
    let result = identified(&session);
    let single: f64 = result.runs.iter().filter_map(|run| run.methods.likelihood.sd_kpa).sum::<f64>() / 4.0;
    assert!((2.0 * result.pooled.sd_kpa / single - 1.0).abs() < 0.05, "{result:?}");
    assert!((result.pooled.k_kpa - K_KPA).abs() < 3.0 * result.pooled.sd_kpa);
    let agreement = result.pooled.heterogeneity.expect("four runs");
    assert!(agreement.p > 0.01 && agreement.degrees_of_freedom == 3, "{agreement:?}");

    // A fifth run in tissue of twice the modulus: the runs disagree, and the interval says so.
    recipe.k_kpa = 2.0 * K_KPA;
    session.lateral.push(recipe.run("other", &mut noise));
    let mixed = identified(&session);
    assert!(mixed.pooled.heterogeneity.expect("five runs").p < 1e-6);
    assert!(mixed.pooled.sd_kpa > 5.0 * result.pooled.sd_kpa);
    assert!(mixed.warnings.iter().any(|warning| warning.contains("disagree")), "{:?}", mixed.warnings);
}

#[test]
fn both_planes_count() {
    let oblique = Recipe { direction: [0.8, -0.6], ..Recipe::default() };
    let result = identified(&session(vec![oblique.run("xy", &mut Noise::new(3))]));
    let [low, high] = result.pooled.ci95_kpa;
    assert!((low..=high).contains(&K_KPA), "{low} to {high}");
    // Displacement, force and shape of three levels in two planes.
    let counts: Vec<usize> = result.runs[0].fit.iter().map(|channel| channel.count).collect();
    assert_eq!(counts, [6, 6, 180]);
    let energy = &result.runs[0].methods.energy;
    let (k_kpa, [low, high]) = (energy.k_kpa.expect("a modulus"), energy.ci95_kpa.expect("an interval"));
    // The energy balance with an exact shape gives 15.0 kPa here: biased, scattered around that.
    assert!(low < 15.0 && 15.0 < high && low < k_kpa && k_kpa < high, "{energy:?}");
    assert!(result.runs[0].methods.energy_as_printed.k_kpa.expect("a modulus") > 2.0 * K_KPA);
}

#[test]
fn noise_that_is_not_stated_is_found() {
    let recipe = Recipe::default();
    let result = identified(&session(vec![recipe.run("a", &mut Noise::new(8))]));
    let noise = result.runs[0].noise.clone().expect("noise");
    assert!((noise.force_n / recipe.force_sd_n - 1.0).abs() < 0.15, "{noise:?}");
    assert!((noise.displacement_mm / recipe.displacement_sd_mm - 1.0).abs() < 0.15, "{noise:?}");
    assert!((noise.shape_mm / recipe.shape_sd_mm - 1.0).abs() < 0.25, "{noise:?}");
    assert_eq!((noise.force_source, noise.shape_source), ("estimated", "estimated"));
}

/// Noise stated much too small: the residuals show it, and the interval is widened by as much.
#[test]
fn residuals_beyond_the_stated_noise_widen_the_interval() {
    let recipe = Recipe::default();
    let mut session = session(vec![recipe.run("a", &mut Noise::new(8))]);
    session.noise = recipe.stated();
    let honest = identified(&session).pooled.sd_kpa;
    session.noise.shape_m = Some(1e-3 * recipe.shape_sd_mm / 5.0);
    let result = identified(&session);
    assert!(result.warnings.iter().any(|w| w.contains("times the stated noise")), "{:?}", result.warnings);
    let ratio = result.pooled.sd_kpa / honest;
    assert!((1.0..5.0).contains(&ratio), "{ratio}");
}

/// A shape in the wrong scale, and a force in the wrong scale: numbers come out, and warnings with them.
#[test]
fn what_does_not_fit_together_is_said() {
    let warned = |run: LateralRun, words: &str| {
        let warnings = identified(&session(vec![run])).warnings;
        assert!(warnings.iter().any(|warning| warning.contains(words)), "{words}: {warnings:?}");
    };
    let mut small = Recipe::default().run("a", &mut Noise::new(2));
    small.shape.y_m.iter_mut().for_each(|y_m| *y_m *= 0.3);
    warned(small, "off the fitted beam");
    let mut strong = Recipe { force_sd_n: 0.005, ..Recipe::default() }.run("a", &mut Noise::new(2));
    strong.force.force_y_n.iter_mut().for_each(|force_n| *force_n *= 1.5);
    warned(strong, "force and shape disagree");
    let sound = identified(&session(vec![Recipe::default().run("a", &mut Noise::new(2))])).warnings;
    assert!(!sound.iter().any(|w| w.contains("disagree") || w.contains("off the fitted")), "{sound:?}");
}

#[test]
fn a_hold_with_lost_samples_is_not_used() {
    let levels_mm = vec![0.0, 0.8, 1.2];
    let mut run = Recipe { levels_mm, ..Recipe::default() }.run("a", &mut Noise::new(2));
    let mut lost = vec![0.0; run.force.time_s.len()];
    lost[250] = 4.0;
    run.force.lost_before = Some(lost);
    let result = identified(&session(vec![run]));
    let used: Vec<bool> = result.runs[0].holds.iter().map(|hold| hold.used).collect();
    assert_eq!(used, [true, false, true]);
    assert!(result.warnings.iter().any(|warning| warning.contains("lost 4 samples")));
}

#[test]
fn every_reason_why_a_run_cannot_be_identified_is_named() {
    let make = |recipe: Recipe| recipe.run("a", &mut Noise::new(4));
    let mut empty = make(Recipe::default());
    (empty.force, empty.shape) = Default::default();
    assert!(matches!(only_error(empty), RunError::NoHold { duration_s: 0.0, .. }));

    let mut lossy = make(Recipe::default());
    lossy.force.lost_before = Some(vec![1.0; lossy.force.time_s.len()]);
    assert!(matches!(only_error(lossy), RunError::AllLost { holds: 3, .. }));

    let still = make(Recipe { levels_mm: vec![0.0], ..Recipe::default() });
    let why = only_error(still);
    assert!(matches!(why, RunError::NoDisplacement { .. }), "{why}");

    let mut unseen = make(Recipe::default());
    unseen.shape = ShapeSeries::default();
    assert!(matches!(only_error(unseen), RunError::TooFewPoints { found: 0, .. }));

    let mut pulled = make(Recipe::default());
    pulled.force.force_y_n.iter_mut().for_each(|force_n| *force_n *= -1.0);
    assert!(matches!(only_error(pulled), RunError::ForceSign { .. }));

    let mut mirrored = make(Recipe::default());
    mirrored.shape.y_m.iter_mut().for_each(|y_m| *y_m *= -1.0);
    let why = only_error(mirrored);
    assert!(matches!(why, RunError::ShapeSign { .. }) && why.to_string().contains("sign"), "{why}");

    // A hundredth of the needle's own stiffness: no tissue is soft enough.
    let mut limp = make(Recipe { shape_sd_mm: 0.001, ..Recipe::default() });
    limp.shape.y_m.iter_mut().zip(&limp.shape.z_m).for_each(|(y_m, z_m)| *y_m = (z_m - 0.04) * 0.1);
    limp.force.force_y_n.iter_mut().for_each(|force_n| *force_n *= 1e-3);
    assert!(matches!(only_error(limp), RunError::AtBound { .. } | RunError::Fit { .. }));

    let none = identify(&session(Vec::new()), &Options::default());
    assert!(matches!(none, Err(IdentifyError::NoRuns { .. })));
}

#[test]
fn a_run_that_fails_is_left_out_and_said_so() {
    let mut noise = Noise::new(9);
    let good = Recipe::default().run("good", &mut noise);
    let mut bad = Recipe::default().run("bad", &mut noise);
    bad.shape = ShapeSeries::default();
    let alone = identified(&session(vec![good.clone()]));
    let both = identified(&session(vec![good, bad]));
    assert_eq!(both.pooled, alone.pooled);
    assert!(both.runs[1].error.as_ref().expect("a reason").contains("bad.shape.csv"));
    assert_eq!(both.runs[1].methods.likelihood.k_kpa, None);
    assert!(both.warnings.iter().any(|warning| warning.starts_with("run bad is left out")));
}

/// A run whose shape belongs to another depth does not move the pooled modulus of the others.
#[test]
fn a_run_that_cannot_belong_is_left_out_by_rule() {
    for is_stated in [true, false] {
        let mut noise = Noise::new(13);
        let good: Vec<_> = (0..4).map(|i| Recipe::default().run(&format!("r{i}"), &mut noise)).collect();
        let mut odd = Recipe::default().run("odd", &mut noise);
        // A shape in centimetres for millimetres.
        odd.shape.y_m.iter_mut().for_each(|y_m| *y_m *= 10.0);
        let mut alone = session(good.clone());
        let mut both = session([good, vec![odd]].concat());
        if is_stated {
            alone.noise = Recipe::default().stated();
            both.noise = alone.noise;
        }
        let (alone, both) = (identified(&alone), identified(&both));
        assert!(both.runs[4].left_out.is_some() || both.runs[4].error.is_some(), "{:?}", both.warnings);
        assert_eq!(both.pooled, alone.pooled);
        let unused = both.unused.iter().find(|unused| unused.run == "odd").expect("listed");
        assert_eq!(unused.part, "run");
        assert!(both.warnings.iter().any(|what| what.contains("odd") && what.contains("left out")));
        assert!(alone.unused.is_empty() && alone.runs.iter().all(|run| run.left_out.is_none()));
    }
    // Two that differ: none is the odd one.
    let mut noise = Noise::new(14);
    let rough = Recipe { shape_sd_mm: 0.3, ..Recipe::default() }.run("rough", &mut noise);
    let pair = identified(&session(vec![Recipe::default().run("fine", &mut noise), rough]));
    assert!(pair.runs.iter().all(|run| run.left_out.is_none()));
}

/// What `check` suspects of units comes with the numbers, and before the reasons where there are none.
#[test]
fn suspected_units_come_first() {
    let mut session = session(vec![Recipe::default().run("a", &mut Noise::new(15))]);
    session.indentation = vec![IndentationRun {
        id: "ref".to_owned(),
        path: "ref.csv".into(),
        indenter: Default::default(),
        indenter_radius_m: 2.1e-3,
        tissue_thickness_m: None,
        poisson: 0.5,
        depth_m: vec![1e-6, 2e-6, 3e-6],
        force_n: vec![0.1, 0.2, 0.3],
    }];
    let found = identified(&session);
    assert!(found.warnings[0].contains("is this in metres?"), "{:?}", found.warnings);
    assert_eq!(found.reference, None);
    session.lateral[0].force.displacement_y_m.iter_mut().for_each(|m| *m *= 1e-3);
    let why = identify(&session, &Options::default()).expect_err("not displaced").to_string();
    let (units, physics) = (why.find("is this in metres?"), why.find("no hold is displaced"));
    assert!(units.is_some() && units < physics, "{why}");
}

#[test]
fn indentation_is_compared_by_welch() {
    let mut noise = Noise::new(6);
    let runs: Vec<_> = (0..3).map(|i| Recipe::default().run(&format!("r{i}"), &mut noise)).collect();
    let mut session = session(runs);
    let punch = |id: &str, modulus_pa: f64| {
        let depth_m = vec![1e-3, 2e-3, 3e-3];
        let unit_n = 1.0 / punch_modulus_pa(2.1e-3, 0.5, 1.0, 1.0);
        let force_n = depth_m.iter().map(|depth_m| modulus_pa * unit_n * depth_m).collect();
        let (id, path) = (id.to_owned(), "ref.csv".into());
        IndentationRun {
            id,
            path,
            indenter: Default::default(),
            indenter_radius_m: 2.1e-3,
            tissue_thickness_m: None,
            poisson: 0.5,
            depth_m,
            force_n,
        }
    };
    session.indentation = vec![punch("1", 15e3), punch("2", 17e3), punch("3", 18e3)];
    let result = identified(&session);
    let reference = result.reference.expect("a reference");
    assert!((reference.k_kpa - 50.0 / 3.0).abs() < 1e-9 && reference.runs == 3);
    assert!((reference.sd_kpa.expect("three") - (7.0f64 / 3.0).sqrt()).abs() < 1e-9);
    let [low, high] = reference.ci95_kpa.expect("three");
    // 4.303 standard errors of three values.
    assert!((high - low - 2.0 * 4.302_652_7 * (7.0f64 / 9.0).sqrt()).abs() < 1e-6, "{low} to {high}");
    let [table] = reference.depths.as_slice() else { panic!("{:?}", reference.depths) };
    assert_eq!((table.depth_mm, table.runs), (30.0, 3));
    let (of_depth, of_all) = (table.t_test_p.expect("p"), reference.t_test_p.expect("p"));
    assert!((of_depth - of_all).abs() < 1e-9, "{of_depth} {of_all}");
    assert!(reference.indentations.iter().all(|one| one.indenter == "flat"));
    assert!(reference.t_test_p.expect("a p-value") > 0.05, "16 against 16.7 +- 1.5");
    // Young's modulus of this K is three times as large by the default relation.
    assert!(reference.t_test_p_youngs.expect("a p-value") < 0.05);
    assert!(result.youngs_modulus_kpa.value.expect("E") > 2.5 * K_KPA);
}

#[test]
fn two_layers_are_found_from_runs_at_four_depths() {
    const SESSIONS: usize = 30;
    let mut noise = Noise::new(61);
    let asked = Options { layers: true, ..Options::default() };
    let mut covered = [0; 3];
    for _ in 0..SESSIONS {
        let run = |depth_mm: f64, noise: &mut Noise| {
            let recipe =
                Recipe { depth_mm, k_kpa: 8.0, second_layer: Some((18.0, 24.0)), ..Recipe::default() };
            recipe.run(&format!("d{depth_mm}"), noise)
        };
        let runs = [10.0, 20.0, 30.0, 40.0].map(|depth_mm| run(depth_mm, &mut noise)).to_vec();
        let found = identify(&session(runs), &asked).expect("identifies").layers.expect("two layers");
        assert!(found.chi_square_gain > 30.0, "{found:?}");
        let intervals = [
            found.upper.ci95_kpa.expect("an interval"),
            found.lower.ci95_kpa.expect("an interval"),
            found.boundary_ci95_mm,
        ];
        for ((covered, [low, high]), truth) in covered.iter_mut().zip(intervals).zip([8.0, 24.0, 18.0]) {
            *covered += usize::from((low..=high).contains(&truth));
        }
    }
    // 95 % of 30 is 28.5, with a standard deviation of 1.2.
    assert!(covered.iter().all(|covered| *covered >= 25), "{covered:?} of {SESSIONS}");
    let one_depth =
        session(vec![Recipe::default().run("a", &mut noise), Recipe::default().run("b", &mut noise)]);
    let result = identify(&one_depth, &asked).expect("identifies");
    assert!(result.layers.is_none() && result.warnings.iter().any(|warning| warning.contains("two layers")));
}

#[test]
fn youngs_modulus_by_the_continuum_lies_between_the_published_ones() {
    let asked = Options { relation: YoungsBy::Continuum(Contact::Bonded), ..Options::default() };
    let session = session(vec![Recipe::default().run("a", &mut Noise::new(71))]);
    let result = identify(&session, &asked).expect("identifies");
    let youngs = &result.youngs_modulus_kpa;
    assert_eq!(youngs.relation, "continuum");
    // The reference's K/E of this needle at 16 kPa and 30 mm is 0.867.
    assert!((0.75..1.0).contains(&(result.pooled.k_kpa / youngs.value.expect("E"))), "{youngs:?}");
    let [low, high] = youngs.ci95.expect("an interval");
    let [k_low, k_high] = result.pooled.ci95_kpa;
    assert!(high / low > k_high / k_low && high / low > 1.039, "the relation's own uncertainty is in it");
    let by = |name: &str| {
        let found = youngs.relations.iter().find(|relation| relation.relation == name);
        found.expect("the relation").youngs_modulus_kpa
    };
    assert!((1.4..1.65).contains(&(by("continuum-one-sided") / by("continuum"))));
    assert!(Some(by("rigid-cylinder")) < youngs.value && youngs.value < Some(by("vesic")));
}

#[test]
fn profile_bootstrap_and_figures_come_on_request() {
    let session = session(vec![Recipe::default().run("a & b", &mut Noise::new(51))]);
    assert_eq!(identified(&session).pooled.profile, None);
    let asked = Options { profile: true, bootstrap: 100, seed: 7, ..Options::default() };
    let result = identify(&session, &asked).expect("identifies");
    let pooled = &result.pooled;
    let noise = pooled.noise_alone.expect("noise alone");
    assert!(pooled.sd_kpa > noise.sd_kpa, "{pooled:?}");
    let half = 0.5 * (noise.ci95_kpa[1] - noise.ci95_kpa[0]);
    let profile = pooled.profile.as_ref().expect("a profile");
    let bootstrap = pooled.bootstrap.as_ref().expect("a bootstrap");
    assert_eq!((bootstrap.count, bootstrap.seed), (100, 7));
    for (end, stated) in noise.ci95_kpa.iter().enumerate() {
        assert!((profile.ci95_kpa[end].expect("an end") - stated).abs() < 0.15 * half, "{pooled:?}");
        assert!((bootstrap.ci95_kpa[end] - stated).abs() < 0.5 * half, "{pooled:?}");
    }
    let lowest = profile.delta_chi_square.iter().copied().fold(f64::INFINITY, f64::min);
    assert!(lowest > -1e-6 && lowest < 0.05, "{lowest}");

    let figure = crate::figures::shape(&result.runs[0]).expect("a figure");
    assert!(figure.contains("<svg") && figure.contains("a &amp; b"), "text is escaped");
    // 30 points of three holds, twice, and one in the legend of each hold.
    assert_eq!(figure.matches("<circle").count(), 2 * 90 + 3);
    let curve = crate::figures::likelihood(pooled).expect("a figure").expect("a profile");
    assert!(curve.contains("<polyline"));
    assert_eq!(crate::figures::likelihood(&identified(&session).pooled).expect("no figure"), None);
}

#[test]
fn the_json_form_has_what_was_promised() {
    let result = identified(&session(vec![Recipe::default().run("a", &mut Noise::new(1))]));
    let json = serde_json::to_value(&result).expect("serialises");
    assert_eq!(json["schema"], "guide.identify/1");
    for pointer in [
        "/runs/0/depth_mm",
        "/runs/0/methods/energy_as_printed/k_kpa",
        "/runs/0/methods/energy/k_kpa",
        "/runs/0/methods/energy/sd_kpa",
        "/runs/0/methods/likelihood/k_kpa",
        "/runs/0/methods/likelihood/sd_kpa",
        "/runs/0/methods/likelihood/ci95_kpa/1",
        "/pooled/k_kpa",
        "/pooled/sd_kpa",
        "/pooled/ci95_kpa/0",
        "/youngs_modulus_kpa/value",
        "/youngs_modulus_kpa/ci95/0",
    ] {
        assert!(json.pointer(pointer).is_some_and(serde_json::Value::is_number), "{pointer} in {json}");
    }
    assert_eq!((&json["runs"][0]["id"], &json["reference"]), (&"a".into(), &serde_json::Value::Null));
    assert_eq!(json["youngs_modulus_kpa"]["relation"], "vesic");
}
