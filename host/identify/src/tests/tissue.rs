//! Directions, layers, Young's modulus, and indentation of the same tissue.

use super::*;
use formats::session::{IndentationRun, Indenter};
use mechanics::continuum::Contact;
use modulus::punch_modulus_pa;

#[test]
fn directions_are_distinguished() {
    let mut noise = Noise::new(41);
    let oblique = Recipe { direction: [0.8, 0.6], ..Recipe::default() };
    let same_tissue =
        identified(&session(vec![oblique.run("xy", &mut noise)])).directions.expect("both planes");
    let [low, high] = same_tissue.ratio_ci95;
    assert!(low < 1.0 && 1.0 < high && high < 1.3, "{same_tissue:?}");

    let stiff_x = Recipe { k_kpa: 1.5 * K_KPA, direction: [0.0, 1.0], ..Recipe::default() };
    let runs = vec![Recipe::default().run("y", &mut noise), stiff_x.run("x", &mut noise)];
    let anisotropic = identified(&session(runs)).directions.expect("both planes");
    let [low, high] = anisotropic.ratio_ci95;
    assert!(low > 1.2 && (low..=high).contains(&1.5), "{anisotropic:?}");
    assert_eq!(identified(&session(vec![Recipe::default().run("y", &mut noise)])).directions, None);
}

#[test]
fn indentation_is_compared_by_welch() {
    let mut noise = Noise::new(6);
    let runs: Vec<_> = (0..3).map(|i| Recipe::default().run(&format!("r{i}"), &mut noise)).collect();
    let mut session = session(runs);
    session.indentation = vec![punch("1", 15e3), punch("2", 17e3), punch("3", 18e3)];
    let result = identified(&session);
    let reference = result.reference.expect("a reference");
    // Contact point and drift are integrated out of curves of three readings: values are those of the curves to a hundredth.
    assert!((reference.k_kpa - 50.0 / 3.0).abs() < 0.17 && reference.runs == 3, "{}", reference.k_kpa);
    let sd_kpa = reference.sd_kpa.expect("three");
    assert!((sd_kpa - (7.0f64 / 3.0).sqrt()).abs() < 0.1, "{sd_kpa}");
    let [low, high] = reference.ci95_kpa.expect("three");
    // 4.303 standard errors of three values, and what each curve leaves open.
    assert!(high - low > 0.95 * 2.0 * 4.302_652_7 * (7.0f64 / 9.0).sqrt(), "{low} to {high}");
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

fn punch(id: &str, modulus_pa: f64) -> IndentationRun {
    let depth_m = vec![1e-3, 2e-3, 3e-3];
    let unit_n = 1.0 / punch_modulus_pa(2.1e-3, 0.5, 1.0, 1.0);
    let force_n = depth_m.iter().map(|depth_m| modulus_pa * unit_n * depth_m).collect();
    let (id, path) = (id.to_owned(), "ref.csv".into());
    IndentationRun {
        id,
        path,
        indenter: Default::default(),
        half_angle_rad: None,
        indenter_radius_m: 2.1e-3,
        tissue_thickness_m: None,
        poisson: 0.5,
        depth_m,
        force_n,
    }
}

#[test]
fn two_layers_are_found_from_runs_at_four_depths() {
    const SESSIONS: usize = 30;
    let mut noise = Noise::new(61);
    // These sessions have noise alone.
    let options = Options { layers: true, model_error: false, ..Options::default() };
    let mut covered = [0; 4];
    for _ in 0..SESSIONS {
        let runs = [10.0, 20.0, 30.0, 40.0].map(|depth_mm| two_layer_run(depth_mm, &mut noise)).to_vec();
        let layers = identify(&session(runs), &options).expect("identifies").layers.expect("two layers");
        assert!(layers.chi_square_gain > 30.0, "{layers:?}");
        let intervals = [
            layers.upper.ci95_kpa.expect("an interval"),
            layers.lower.ci95_kpa.expect("an interval"),
            layers.k_ratio_ci95,
            layers.boundary_ci95_mm,
        ];
        assert!(layers.log_evidence_gain.is_none());
        for ((covered, [low, high]), truth) in covered.iter_mut().zip(intervals).zip([8.0, 24.0, 3.0, 18.0]) {
            *covered += usize::from((low..=high).contains(&truth));
        }
    }
    // 95 % of 30 is 28.5, with a standard deviation of 1.2.
    assert!(covered.iter().all(|covered| *covered >= 25), "{covered:?} of {SESSIONS}");
    let one_depth =
        session(vec![Recipe::default().run("a", &mut noise), Recipe::default().run("b", &mut noise)]);
    let result = identify(&one_depth, &options).expect("identifies");
    assert!(result.layers.is_none() && result.warnings.iter().any(|warning| warning.contains("two layers")));
}

fn two_layer_run(depth_mm: f64, noise: &mut Noise) -> LateralRun {
    let recipe = Recipe { depth_mm, k_kpa: 8.0, second_layer: Some((18.0, 24.0)), ..Recipe::default() };
    recipe.run(&format!("d{depth_mm}"), noise)
}

/// If imperfections are allowed for, intervals are wider than those of noise and hold the truth; in tissue of one layer
/// the evidence is against a second.
#[test]
fn model_error_is_in_the_intervals_of_layers() {
    let mut noise = Noise::new(62);
    let layered = runs_at_three_depths(Some((18.0, 24.0)), &mut noise);
    let [by_noise, by_evidence] = [false, true].map(|model_error| identified_layers(&layered, model_error));
    // A single Young's modulus is no result where two layers are established, and springs or body is what the layers are.
    let (youngs, foundation) = (&by_evidence.youngs_modulus_kpa, &by_evidence.foundation);
    assert_eq!((foundation.used, foundation.by), ("springs", "layers"));
    let refused = youngs.refused.as_deref().unwrap_or_default();
    assert!(youngs.value.is_none() && youngs.ci95.is_none(), "{youngs:?}");
    assert!(refused.contains("two layers explain") && refused.contains("--foundation body"), "{refused}");
    let [alone, wide] = [by_noise, by_evidence].map(|found| found.layers.expect("two layers"));
    assert!(wide.established && !alone.established && alone.log_evidence_over_single.is_none());
    assert!(wide.log_evidence_gain.expect("compared") > 5.0, "{wide:?}");
    // Springs, though of one modulus a body may be ahead of them.
    assert!(wide.foundation == "springs" && wide.body_log_evidence_gain.expect("compared") < 0.0, "{wide:?}");
    for (of, truth) in [
        ([alone.k_ratio_ci95, wide.k_ratio_ci95], 3.0),
        ([alone.boundary_ci95_mm, wide.boundary_ci95_mm], 18.0),
    ] {
        let [[low, high], [least, most]] = of;
        assert!(most / least > high / low && (least..=most).contains(&truth), "{of:?} {truth}");
    }
    let uniform = identified_layers(&runs_at_three_depths(None, &mut noise), true);
    assert!(uniform.youngs_modulus_kpa.value.is_some() && uniform.foundation.by == "evidence");
    assert!(
        uniform
            .layers
            .is_none_or(|found| { !found.established && found.log_evidence_gain.expect("compared") < 2.0 })
    );
}

fn identified_layers(session: &Session, model_error: bool) -> Identification {
    let options = Options { layers: true, model_error, ..Options::default() };
    identify(session, &options).expect("identifies")
}

fn runs_at_three_depths(second_layer: Option<(f64, f64)>, noise: &mut Noise) -> Session {
    session(
        [10.0, 20.0, 40.0]
            .map(|depth_mm| {
                let recipe = Recipe { depth_mm, k_kpa: 8.0, second_layer, ..Recipe::default() };
                recipe.run(&format!("d{depth_mm}"), noise)
            })
            .to_vec(),
    )
}

#[test]
fn youngs_modulus_by_the_continuum_lies_between_the_published_ones() {
    let options = Options { relation: YoungsMethod::Continuum(Contact::Bonded), ..Options::default() };
    let session = session(vec![Recipe::default().run("a", &mut Noise::new(71))]);
    let result = identify(&session, &options).expect("identifies");
    let youngs = &result.youngs_modulus_kpa;
    assert_eq!(youngs.relation, "continuum");
    // The reference's K/E of this needle at 16 kPa and 30 mm is 0.867.
    assert!((0.75..1.0).contains(&(result.pooled.k_kpa / youngs.value.expect("E"))), "{youngs:?}");
    let [low, high] = youngs.ci95.expect("an interval");
    let [k_low, k_high] = result.pooled.ci95_kpa;
    assert!(high / low > k_high / k_low && high / low > 1.039, "the relation's own uncertainty is in it");
    assert!((1.4..1.65).contains(
        &(youngs_by("continuum-one-sided", &youngs.relations) / youngs_by("continuum", &youngs.relations))
    ));
    assert!(
        Some(youngs_by("rigid-cylinder", &youngs.relations)) < youngs.value
            && youngs.value < Some(youngs_by("vesic", &youngs.relations))
    );
}

fn youngs_by(name: &str, relations: &[RelationResult]) -> f64 {
    let continuum = relations.iter().find(|relation| relation.relation == name);
    continuum.expect("the relation").youngs_modulus_kpa
}

/// A bio-indenter: a sphere of half a millimetre, 14 um deep, in a session without anything else.
#[test]
fn indentations_alone_give_youngs_modulus_at_any_scale() {
    let (radius_m, youngs_pa) = (0.5e-3f64, 8e3);
    let mut noise = Noise::new(31);
    let mut session = session(Vec::new());
    session.indentation =
        vec![probe("1", youngs_pa, radius_m, &mut noise), probe("2", youngs_pa, radius_m, &mut noise)];
    let youngs = indentations(&session).expect("a modulus");
    let [low, high] = youngs.ci95_kpa.expect("an interval");
    // Student's t of two values.
    assert!((low..=high).contains(&(1e-3 * youngs_pa)) && high < 1.4 * low, "{youngs:?}");
    assert!(!youngs.warnings.iter().any(|what| what.contains("metres")), "{:?}", youngs.warnings);
    session.indentation = session
        .indentation
        .into_iter()
        .map(|run| IndentationRun { depth_m: run.depth_m.iter().map(|d| 1e-3 * d).collect(), ..run })
        .collect();
    let why = indentations(&session).expect_err("refused").to_string();
    assert!(why.contains("is this in metres?"), "{why}");
    session.indentation.clear();
    assert!(matches!(indentations(&session), Err(IdentifyError::NoRuns { .. })));
}

fn probe(id: &str, youngs_pa: f64, radius_m: f64, noise: &mut Noise) -> IndentationRun {
    let depth_m: Vec<f64> = (0..140).map(|i| 1e-7 * f64::from(i - 40)).chain([14e-6]).collect();
    let force_n = |d: &f64| {
        let force_n = 16.0 / 9.0 * youngs_pa * (radius_m * d.max(0.0).powi(3)).sqrt();
        1e-5 + force_n + 2e-7 * noise.normal()
    };
    IndentationRun {
        id: id.to_owned(),
        path: format!("{id}.csv").into(),
        indenter: Indenter::Sphere,
        half_angle_rad: None,
        indenter_radius_m: radius_m,
        tissue_thickness_m: None,
        poisson: 0.5,
        force_n: depth_m.iter().map(force_n).collect(),
        depth_m,
    }
}
