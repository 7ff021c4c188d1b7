//! The workflow on blind sessions: a small part of `cargo xtask study diagnose`.

use super::whiten::Whitener;
use super::*;
use mechanics::effects::effect;
use worlds::{Design, Foreign, LateralPlan, Truth, session};

pub(super) fn truth(effects: Vec<(&'static str, Vec<f64>)>) -> Truth {
    Truth { k_kpa: 12.0, tip_load_n: 0.2, effects, foreign: None }
}

fn diagnosed(truth: &Truth, design: &Design, seed: u64) -> Diagnosis {
    let found = diagnose(&session(truth, design, seed), &Options::default(), |_| {}).expect("a diagnosis");
    assert!(found.effects.iter().all(|effect| effect.class.contains(&effect.id)), "{:#?}", found.effects);
    found
}

#[track_caller]
fn assert_named(found: &Diagnosis, id: &str, values: &[f64]) {
    let ids: Vec<&str> = found.effects.iter().map(|effect| effect.id.as_str()).collect();
    assert_eq!((found.verdict, ids.as_slice()), (Verdict::Named, [id].as_slice()), "{found:#?}");
    let effect = effect(id).expect("an effect");
    for (info, value) in effect.parameters().iter().zip(values) {
        let Estimate { ci95: [low, high], .. } = found.effects[0].parameters[info.name];
        // Twice as wide as the interval: nearly all truths lie in it.
        let half = 0.5 * (high - low);
        assert!((low - half..=high + half).contains(value), "{id} {}: {low} to {high}", info.name);
    }
    let gap = found.gap.as_ref().expect("a gap");
    assert!(gap.after.chi2_reduced < 1.2, "{gap:?}");
    assert!(gap.removed.is_none_or(|removed| removed > 0.9), "{gap:?}");
}

#[test]
fn a_session_that_lacks_nothing_is_adequate() {
    for (design, seed) in [(Design::four_runs(), 1), (Design::nine_runs(), 2)] {
        let diagnosis = diagnosed(&truth(vec![]), &design, seed);
        assert_eq!(diagnosis.verdict, Verdict::Adequate, "{diagnosis:#?}");
        assert!(diagnosis.effects.is_empty() && diagnosis.next_measurement.is_none());
        let [low, high] = diagnosis.k_ci95_kpa;
        assert!((low - 0.1..=high + 0.1).contains(&12.0), "{low} to {high}");
        assert!((0.7..1.3).contains(&diagnosis.gap.expect("a gap").before.chi2_reduced));
    }
}

#[test]
fn effects_of_every_family_are_named() {
    for (id, values) in [
        ("tissue.stiffening", vec![0.5]),
        ("rig.backlash", vec![0.06]),
        ("sensor.delay", vec![0.12]),
        ("needle.prebend", vec![0.1, -0.05]),
    ] {
        assert_named(&diagnosed(&truth(vec![(id, values.clone())]), &Design::four_runs(), 3), id, &values);
    }
}

/// Only an insertion in which the needle is turned distinguishes a rolled bevel from a tilted tracker; therefore one such insertion has to be
/// held out.
#[test]
fn a_rolled_bevel_is_confirmed_by_an_insertion_in_which_the_needle_is_turned() {
    let rolled = truth(vec![("tip.bevel_roll", vec![-0.14])]);
    assert_named(&diagnosed(&rolled, &Design::insertions(), 3), "tip.bevel_roll", &[-0.14]);
}

/// More effects than are fitted are not identifiable from insertions alone; they must not displace others among the fitted ones.
#[test]
fn effects_that_the_runs_cannot_show_take_no_place_among_those_that_are_fitted() {
    let mut design = Design::insertions();
    design.lateral.clear();
    let diagnosis = diagnosed(&truth(vec![("tip.load_slope", vec![0.001])]), &design, 3);
    let load_slope = diagnosis.ranking.iter().find(|ranked| ranked.id == "tip.load_slope");
    assert!(diagnosis.not_identifiable.len() > 5, "{:?}", diagnosis.not_identifiable);
    assert!(load_slope.is_some_and(|ranked| ranked.refitted), "{:?}", diagnosis.ranking);
}

#[test]
fn the_diagnosis_does_not_depend_on_the_number_of_threads() {
    let session = session(&truth(vec![("rig.backlash", vec![0.06])]), &Design::four_runs(), 3);
    let [with_one, with_four] = [1, 4].map(|threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads");
        // The texts of two numbers differ if any of their bits does.
        pool.install(|| {
            format!("{:?}", diagnose(&session, &Options::default(), |_| {}).expect("a diagnosis"))
        })
    });
    assert_eq!(with_one, with_four);
}

#[test]
fn an_effect_of_the_tip_is_named_beside_lateral_runs() {
    let values = vec![0.02];
    let diagnosis = diagnosed(&truth(vec![("tip.rate", values.clone())]), &Design::insertions(), 4);
    assert_named(&diagnosis, "tip.rate", &values);
    let [low, high] = diagnosis.tip_load_ci95_n.expect("a tip load");
    assert!(low < 0.21 && high > 0.19, "{low} to {high}");
}

#[test]
fn errors_of_imaging_are_found_where_it_is_stated_how_the_shape_was_imaged() {
    for (id, value) in [("imaging.sound_speed", 0.06), ("imaging.lag", 0.3), ("imaging.echo_offset", 0.08)] {
        let diagnosis = diagnosed(&truth(vec![(id, vec![value])]), &Design::imaged(), 8);
        assert_eq!(diagnosis.effects.len(), 1, "{id}: {diagnosis:#?}");
        assert!(diagnosis.effects[0].class.iter().any(|member| member == id), "{id}: {diagnosis:#?}");
    }
    // If it is not stated, these effects are not available.
    let unstated = diagnosed(&truth(vec![("sensor.shape_scale", vec![0.1])]), &Design::four_runs(), 8);
    assert!(unstated.effects.iter().flat_map(|effect| &effect.class).all(|id| !id.starts_with("imaging.")));
}

/// If guide 2 moves along the beam only, a wrong speed of sound equals a wrong scale of the shape; motion across the beam separates them. A
/// probe turned by 90 degrees would separate them, too, but has to be turned by hand.
#[test]
fn motion_across_the_beam_separates_the_speed_of_sound_from_the_scale_of_the_image() {
    let mut design = Design::imaged();
    design.lateral.retain(|plan| plan.axis == 0);
    let diagnosis = diagnosed(&truth(vec![("imaging.sound_speed", vec![0.1])]), &design, 9);
    let class = &diagnosis.effects.first().expect("an effect").class;
    for id in ["imaging.sound_speed", "sensor.shape_scale"] {
        assert!(class.iter().any(|member| member == id), "{diagnosis:#?}");
    }
    let next = diagnosis.next_measurement.expect("a measurement");
    assert_eq!(next.kind, "other_axis", "{next:#?}");
}

#[test]
fn effects_with_equal_evidence_are_a_class_and_a_known_weight_separates_them() {
    let diagnosis = diagnosed(&truth(vec![("needle.stiffness", vec![0.2])]), &Design::four_runs(), 5);
    assert_eq!(diagnosis.verdict, Verdict::Ambiguous, "{diagnosis:#?}");
    let mut class = diagnosis.effects[0].class.clone();
    class.sort();
    assert_eq!(class, ["needle.stiffness", "sensor.force_gain"]);
    assert_eq!(diagnosis.next_measurement.expect("a measurement").kind, "known_weight");
}

/// Whether both of two effects are named.
fn has_both(seed: u64) -> bool {
    let two_effects = vec![("tissue.skin", vec![0.25]), ("rig.friction", vec![0.05])];
    let diagnosis = diagnosed(&truth(two_effects), &Design::four_runs(), seed);
    let members: Vec<&String> = diagnosis.effects.iter().flat_map(|effect| &effect.class).collect();
    let is_named = |id: &str| members.iter().any(|member| *member == id);
    diagnosis.effects.len() == 2 && is_named("rig.friction") && is_named("tissue.skin")
}

#[test]
fn two_effects_are_both_named() {
    assert!((6..8).any(has_both));
}

/// With the intended rate of 85 %, fewer than 7 of 12 have a probability of 5 in 1000.
#[test]
#[ignore = "a minute of searches: cargo xtask test --all runs it"]
fn two_effects_are_both_named_at_a_rate() {
    let named = (6..18).filter(|seed| has_both(*seed)).count();
    assert!(named >= 7, "{named} of 12");
}

/// A session with a sinusoidal drift whose phase differs from run to run, so that no law is common to all runs.
fn session_that_no_law_describes() -> formats::session::Session {
    let hidden = Truth { foreign: Some(Foreign::SinusoidalDrift), ..truth(vec![]) };
    session(&hidden, &Design::four_runs(), 7)
}

fn assert_unexplained(options: &Options) {
    let diagnosis = diagnose(&session_that_no_law_describes(), options, |_| {}).expect("a diagnosis");
    assert_eq!((diagnosis.verdict, diagnosis.effects.len()), (Verdict::Unexplained, 0), "{diagnosis:#?}");
    assert!(!diagnosis.regions.is_empty() && !diagnosis.discrepancy.is_empty());
}

#[test]
fn what_has_no_name_is_not_named() {
    assert_unexplained(&Options { discovery: false, ..Options::default() });
}

#[test]
#[ignore = "a search that tries every law, a minute: cargo xtask test --all runs it"]
fn what_no_law_describes_gets_no_law() {
    assert_unexplained(&Options::default());
}

/// A dependence that no effect of the catalogue describes is found as a law, with its site, regressor and formula, and the held-out runs
/// confirm it.
#[test]
fn laws_of_an_independent_generator_are_found() {
    law_is_found(Foreign::OneSidedTissue, "law.modulus.displacement");
}

/// Further laws: of a nonlinear sensor, of damaged tissue and of a warped image.
#[test]
#[ignore = "a minute of searches: cargo xtask test --all runs it"]
fn further_laws_of_an_independent_generator_are_found() {
    law_is_found(Foreign::QuadraticSensor, "law.force.force");
    law_is_found(Foreign::Damage, "law.modulus.use");
    law_is_found(Foreign::ImageWarp, "law.shape.share");
}

/// Laws of the needle's supports: a hard object at the tip, and a guide 2 that is a sleeve.
#[test]
fn further_supports_of_the_needle_are_found() {
    law_is_found(Foreign::HeldTip, "law.tip_support.");
    law_is_found(Foreign::Sleeve, "law.guide_turn.");
}

fn law_is_found(foreign: Foreign, site: &str) {
    let hidden = Truth { foreign: Some(foreign), ..truth(vec![]) };
    let diagnosis = diagnosed(&hidden, &Design::four_runs(), 7);
    let class = diagnosis.effects.iter().flat_map(|effect| &effect.class);
    assert!(class.into_iter().any(|id| id.starts_with(site)), "{foreign:?} {:?}", diagnosis.effects);
    assert!(diagnosis.effects.iter().any(|effect| effect.formula.is_some()), "{:?}", diagnosis.effects);
    let removed = diagnosis.gap.and_then(|gap| gap.removed);
    assert!(removed.is_none_or(|share| share > 0.8), "{foreign:?} {removed:?}");
}

/// With a single hold no data can be held out: nothing is named, and the limits state remedies.
#[test]
fn a_session_that_cannot_serve_reports_its_limits() {
    let plan = LateralPlan {
        id: "only".to_owned(),
        depth_mm: 30.0,
        axis: 0,
        levels_mm: vec![1.0],
        hold_s: 3.0,
        ramp_mm_per_s: 1.0,
    };
    let design = Design { lateral: vec![plan], ..Design::four_runs() };
    let diagnosis = diagnosed(&truth(vec![("rig.backlash", vec![0.12])]), &design, 8);
    assert!(diagnosis.effects.is_empty() && diagnosis.gap.is_none(), "{diagnosis:#?}");
    assert!(diagnosis.limits.iter().any(|limit| limit.contains("repeat")), "{:?}", diagnosis.limits);
    assert!(
        diagnosis.limits.iter().any(|limit| limit.contains("one depth"))
            && !diagnosis.not_identifiable.is_empty()
    );
}

/// No fit, size, score or threshold of the search depends on the held-out runs: they may refuse a name, and change nothing else. Values,
/// intervals and noise are those of all runs.
#[test]
fn held_out_runs_refuse_names_and_change_nothing_else() {
    let session = session(&truth(vec![("rig.friction", vec![0.1])]), &Design::four_runs(), 9);
    let plain = diagnose(&session, &Options::default(), |_| {}).expect("a diagnosis");
    // Hysteresis of the force sensor, which also follows the direction of motion, does not absorb the friction.
    let [low, high] = plain.effects[0].parameters["force_n"].ci95;
    assert!(low <= 0.1 && 0.1 <= high && high - low < 0.02, "{low} to {high}");
    let held_ids = plain.gap.as_ref().expect("a gap").heldout_runs.clone();
    let mut changed_session = session.clone();
    // Holds of the run along x, which has no repeat, are held out; the others are training.
    let runs = changed_session.lateral.iter_mut();
    for run in runs.filter(|run| held_ids.contains(&run.id) && !run.id.starts_with('x')) {
        run.force.force_y_n.iter_mut().for_each(|force_n| *force_n = 0.3 - *force_n);
        run.shape.y_m.iter_mut().for_each(|u_m| *u_m *= 2.0);
    }
    let spoilt = diagnose(&changed_session, &Options::default(), |_| {}).expect("a diagnosis");
    assert_ne!(plain.gap, spoilt.gap);
    let [of_plain, of_spoilt] = [&plain, &spoilt].map(|d| {
        let ranking: Vec<_> = d.ranking.iter().map(|r| (r.id.clone(), r.log_evidence_gain)).collect();
        (d.regions.clone(), d.margin, ranking, d.adequacy[0].clone())
    });
    assert_eq!(of_plain, of_spoilt);
    assert_eq!((plain.verdict, spoilt.verdict), (Verdict::Named, Verdict::Unexplained));
}

/// The model with the effect explains the session, and the model file contains it.
#[test]
fn a_model_with_the_effect_is_adequate() {
    let session = session(&truth(vec![("tissue.relaxation", vec![0.35, 1.5])]), &Design::four_runs(), 10);
    let first = diagnose(&session, &Options::default(), |_| {}).expect("a diagnosis");
    assert_named(&first, "tissue.relaxation", &[0.35, 1.5]);
    let options = Options { given: first.model().effects(), ..Options::default() };
    let second = diagnose(&session, &options, |_| {}).expect("a diagnosis");
    assert_eq!(
        (second.verdict, second.given.as_slice()),
        (Verdict::Adequate, ["tissue.relaxation".to_owned()].as_slice())
    );
    assert!((second.k_kpa / first.k_kpa - 1.0).abs() < 0.01);
    assert_eq!(second.model().effects.len(), 1);
}

/// Partly correlated noise is recovered from holds and sweeps, and raised to the stated noise.
#[test]
fn noise_is_estimated_from_the_scatter() {
    let mut design = Design::nine_runs();
    design.noise.stated = false;
    let session = session(&truth(vec![]), &design, 11);
    let (runs, _) = runs_of(&session).expect("runs");
    let noise = Noise::of(&runs, &session.noise);
    assert!((noise.force.sd() / 0.02 - 1.0).abs() < 0.1, "{noise:?}");
    assert!((0.3..0.8).contains(&(noise.force.correlated / noise.force.sd().powi(2))), "{noise:?}");
    assert!((noise.displacement.sd() / 10e-6 - 1.0).abs() < 0.1, "{noise:?}");
    assert!((noise.shape.sd() / 24.7e-6 - 1.0).abs() < 0.15, "{noise:?}");
    let stated = formats::session::Noise { shape_m: Some(30e-6), ..session.noise };
    assert!((Noise::of(&runs, &stated).shape.sd() / 30e-6 - 1.0).abs() < 1e-6);
}

/// The readings of a fast sensor are averaged in cells. The stated noise is that of a single reading, and noise that averages out is not
/// taken for a lasting error.
#[test]
fn a_stated_deviation_is_that_of_single_readings_at_any_rate() {
    for rate_hz in [20.0, 100.0, 200.0] {
        let mut design = Design::four_runs();
        design.noise.rate_hz = rate_hz;
        let session = session(&truth(vec![]), &design, 11);
        assert!(session.noise.force_n.is_some() && session.noise.displacement_m.is_some());
        let (runs, _) = runs_of(&session).expect("runs");
        let (noise, disagreements) = Noise::with_disagreements(&runs, &session.noise);
        assert_eq!(disagreements, Vec::<String>::new(), "{rate_hz} Hz");
        for (sensor, stated) in
            [(noise.force, session.noise.force_n), (noise.displacement, session.noise.displacement_m)]
        {
            assert_eq!(sensor.lasting, 0.0, "{rate_hz} Hz");
            let ratio = sensor.reading_sd() / stated.expect("stated");
            assert!((0.9..1.25).contains(&ratio), "{rate_hz} Hz: {ratio}");
        }
        // The excess of a stated noise five times too large is taken for an error that does not scatter.
        let stated = formats::session::Noise {
            force_n: session.noise.force_n.map(|sd_n| 5.0 * sd_n),
            ..session.noise
        };
        let lasting = Noise::of(&runs, &stated).force.lasting.sqrt();
        let expected = 24f64.sqrt() * session.noise.force_n.expect("stated");
        assert!((lasting / expected - 1.0).abs() < 0.1, "{rate_hz} Hz: {lasting}");
    }
}

/// The points of a tracker at one place are one datum with the noise of their mean; the stated noise is that of a single point.
#[test]
fn a_trackers_points_at_one_place_are_one_datum() {
    const TIMES: usize = 40;
    const SD_M: f64 = 0.1e-3;
    let mut session = session(&truth(vec![]), &Design::nine_runs(), 11);
    let plain = runs_of(&session).expect("runs").0;
    let mut added = ::noise::Noise::new(1);
    for run in &mut session.lateral {
        let shape = &mut run.shape;
        let columns = [Some(&mut shape.z_m), Some(&mut shape.y_m), shape.x_m.as_mut(), shape.time_s.as_mut()];
        columns.into_iter().flatten().for_each(|column| *column = column.repeat(TIMES));
        shape.y_m.iter_mut().chain(shape.x_m.iter_mut().flatten()).for_each(|u| *u += SD_M * added.normal());
    }
    let (runs, _) = runs_of(&session).expect("runs");
    // With more noise fewer points are outliers.
    let [count, plain_count] =
        [&runs, &plain].map(|runs| runs.iter().map(|run| run.data.len()).sum::<usize>());
    let ratio = count as f64 / plain_count as f64;
    assert!((0.95..1.05).contains(&ratio), "{ratio}");
    session.noise.shape_m = None;
    let noise = Noise::of(&runs, &session.noise);
    // All points at a place share its original noise.
    let expected_m = 24.7e-6_f64.hypot(SD_M / (TIMES as f64).sqrt());
    assert!((noise.shape.sd() / expected_m - 1.0).abs() < 0.2, "{noise:?}, expected {expected_m}");
    let stated = formats::session::Noise { shape_m: Some(0.3e-3), ..session.noise };
    let of_mean_m = 0.3e-3 / (TIMES as f64).sqrt();
    assert!((Noise::of(&runs, &stated).shape.sd() / of_mean_m - 1.0).abs() < 0.05);
}

/// An effect that both sessions share, even one without a name, is not reported as a difference between them.
#[test]
fn beside_a_reference_only_what_differs_is_named() {
    let shared =
        |k_kpa: f64, effects| Truth { k_kpa, foreign: Some(Foreign::OneSidedTissue), ..truth(effects) };
    let design = Design::four_runs();
    let reference = session(&shared(12.0, vec![]), &design, 15);
    let diagnosed_against = |session: &Session| {
        let options = Options { reference: Some(reference.clone()), ..Options::default() };
        diagnose(session, &options, |_| {}).expect("a diagnosis")
    };
    let same_rig = diagnosed_against(&session(&shared(15.0, vec![]), &design, 16));
    assert!(same_rig.effects.is_empty(), "{same_rig:#?}");
    let ratio = same_rig.reference.expect("a reference").modulus_ratio;
    assert!(ratio.ci95[0] < 1.25 && ratio.ci95[1] > 1.25 && ratio.ci95[1] - ratio.ci95[0] < 0.1, "{ratio:?}");
    let changed_rig = session(&shared(15.0, vec![("rig.backlash", vec![0.08])]), &design, 17);
    let diagnosis = diagnosed_against(&changed_rig);
    let ids: Vec<&str> = diagnosis.effects.iter().map(|effect| effect.id.as_str()).collect();
    assert_eq!(ids, ["rig.backlash"], "{diagnosis:#?}");
    let backlash = diagnosis.effects[0].parameters["clearance_mm"];
    assert!(backlash.ci95[0] < 0.08 && backlash.ci95[1] > 0.08, "{backlash:?}");
}

#[test]
fn a_session_without_runs_is_an_error() {
    let mut empty = session(&truth(vec![]), &Design::four_runs(), 12);
    empty.lateral.clear();
    assert!(matches!(diagnose(&empty, &Options::default(), |_| {}), Err(DiagnoseError::NoRuns { .. })));
}

#[test]
fn independent_residuals_go_back_to_what_they_were() {
    let session = session(&truth(vec![]), &Design::insertions(), 13);
    let (runs, _) = runs_of(&session).expect("runs");
    let noise = Noise::of(&runs, &session.noise);
    let layout = Layout::new(&session.rig, &runs, Vec::new());
    for run in &runs {
        let model = layout.model(&layout.first_values(), run.kind).expect("a model");
        let whitener = Whitener::new(run, &noise, &model).expect("regular");
        let plain: Vec<f64> = run.data.iter().map(|datum| datum.measured).collect();
        let mut there_and_back = plain.clone();
        whitener.apply(&mut there_and_back);
        whitener.undo(&mut there_and_back);
        let largest = plain.iter().fold(0.0, |most: f64, value| most.max(value.abs()));
        for (a, b) in plain.iter().zip(&there_and_back) {
            assert!((a - b).abs() < 1e-9 * largest, "{} {a} {b}", run.id);
        }
    }
}

/// A session whose shapes have a wave along the needle, the same in every sweep.
fn session_with_a_wave() -> formats::session::Session {
    let mut session = session(&truth(vec![]), &Design::nine_runs(), 14);
    for run in &mut session.lateral {
        for (z_m, y_m) in run.shape.z_m.iter().zip(&mut run.shape.y_m) {
            *y_m += 0.12e-3 * (std::f64::consts::TAU * z_m / 8e-3).sin();
        }
    }
    session
}

/// A pattern that is the same in every sweep is misfit, not noise; and a scatter above the stated noise gives a warning.
#[test]
fn what_repeats_is_misfit_and_unstated_scatter_is_warned_of() {
    let session = session_with_a_wave();
    let (runs, _) = runs_of(&session).expect("runs");
    let stated = formats::session::Noise { shape_m: Some(24.7e-6), ..session.noise };
    let (noise, disagreements) = Noise::with_disagreements(&runs, &stated);
    assert!(noise.shape.sd() < 1.25 * 24.7e-6, "{noise:?}");
    assert!(disagreements.is_empty(), "{disagreements:?}");
    let stated = formats::session::Noise { shape_m: Some(10e-6), ..session.noise };
    let (_, disagreements) = Noise::with_disagreements(&runs, &stated);
    assert_eq!(disagreements.len(), 1, "{disagreements:?}");
    assert!(disagreements[0].starts_with("noise of the shape: 0.010 mm is stated"), "{disagreements:?}");
}

#[test]
#[ignore = "nine runs and every law, a minute: cargo xtask test --all runs it"]
fn a_wave_that_repeats_is_a_law_with_its_period() {
    let diagnosis = diagnose(&session_with_a_wave(), &Options::default(), |_| {}).expect("a diagnosis");
    let mut members = diagnosis.effects.iter().flat_map(|effect| &effect.class);
    assert!(members.any(|id| id.starts_with("law.shape_y.place.sine")), "{:?}", diagnosis.effects);
    let period = diagnosis.effects.iter().find_map(|effect| effect.parameters.get("period_mm"));
    let [low, high] = period.expect("a period").ci95;
    assert!(low < 8.0 && high > 8.0 && high - low < 0.2, "{period:?}");
}

/// The imperfections that a model file may state are those whose sizes are estimated.
#[test]
fn imperfections_of_a_model_file_are_those_of_the_fits() {
    let design = Design { insertion: Design::insertions().insertion, ..Design::nine_runs() };
    let session = session(&truth(vec![]), &design, 2);
    let (runs, _) = runs_of(&session).expect("runs");
    let noise = Noise::of(&runs, &session.noise);
    let layout = Layout::new(&session.rig, &runs, Vec::new());
    let noises = Noises { session: noise, reference: noise };
    let start = |multiples: &Multiples| fit_start(&layout, &runs, &noises, &[], multiples).expect("a fit");
    let plain = start(&Multiples::new());
    let tailed_groups = plain.patterns.groups.iter().filter(|group| group.tail.is_some());
    let names: Vec<&str> = tailed_groups.map(|group| group.name).collect();
    assert!(names.iter().all(|name| DISCREPANCY_NAMES.contains(name)), "{names:?}");
    // Directions are not measured in this session.
    let expected = DISCREPANCY_NAMES.iter().filter(|name| !name.contains("direction"));
    let missing: Vec<_> = expected.filter(|name| !names.contains(name)).collect();
    assert!(missing.is_empty(), "{missing:?}");

    // A rig with larger known imperfections determines the modulus less precisely.
    let wider = start(&DISCREPANCY_NAMES.iter().map(|name| ((*name).to_owned(), 5.0)).collect());
    assert!(wider.fitted.sd(0) > 1.2 * plain.fitted.sd(0));
    assert!(wider.patterns.groups.iter().all(|group| group.multiple == 5.0 || group.tail.is_none()));
}
