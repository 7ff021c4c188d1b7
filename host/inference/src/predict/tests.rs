//! The workflow on simulated sessions whose truth is known, and on what is wrong with sessions.

mod one_guide;

use super::*;
use formats::prior_file::ModulusPrior;
use mechanics::Rig;
use mechanics::effects::Effect;
use noise::Noise;
use proptest::prelude::*;
use std::f64::consts::PI;
use worlds::reciprocal::{STEPS_PER_MM, insertion_session, truth};

const UNTIL_50: Options = Options {
    until_m: 0.05,
    to_m: None,
    learn: true,
    modulus_pa: None,
    layers: false,
    effects: Vec::new(),
    others: Vec::new(),
    known: Vec::new(),
    discrepancy: diagnose::Multiples::new(),
    prior: None,
    draws: None,
    published_from_m: 0.03,
};

fn rig() -> Rig {
    Rig::two_guides(mechanics::Needle::gauge_18(), 0.06, 0.085)
}

/// Three insertions to 120 mm with a constant load each, both planes, without noise; K = 11 kPa.
fn steady() -> (Session, Vec<[f64; 2]>) {
    let loads = vec![[0.2, 0.03], [0.21, 0.02], [0.19, 0.035]];
    let paths = loads.iter().map(|[y, x]| (path_under(*y), Some(path_under(*x)), None));
    (insertion_session(rig(), Some(0.02e-3), paths.collect()), loads)
}

fn path_under(n: f64) -> Vec<f64> {
    truth(&rig(), 11e3, 120, |_| n).expect("solves")
}

#[test]
fn a_constant_load_and_its_path_are_found() {
    let (session, loads) = steady();
    let options = Options { modulus_pa: Some([11e3, 0.5e3]), ..UNTIL_50 };
    let prediction = predict(&session, &options).expect("predicts");
    for (one, [y, x]) in prediction.insertions.iter().zip(loads) {
        assert_eq!(one.depth_mm.len(), 121);
        assert!(one.mae_mm.expect("measured") < 0.1, "{:?}", one.mae_mm);
        for (prediction, sd, expected) in
            [(one.tip_force_n, one.tip_force_sd_n, y), (one.tip_force_x_n, one.tip_force_x_sd_n, x)]
        {
            let (load, sd) = (prediction.expect("a load"), sd.expect("its sd"));
            assert!((load - expected).abs() < 3.0 * sd + 1e-3, "{load} +- {sd} is not {expected}");
        }
    }
}

#[test]
fn an_insertion_is_observed_no_further_than_its_deepest_reading() {
    let (session, _) = steady();
    let options =
        Options { modulus_pa: Some([11e3, 0.5e3]), until_m: 0.5, to_m: Some(0.15), learn: false, ..UNTIL_50 };
    for one in &predict(&session, &options).expect("predicts").insertions {
        assert!((one.identified_until_mm - 120.0).abs() < 1e-9, "{}", one.identified_until_mm);
        assert_eq!(one.depth_mm.len(), 151);
    }
}

/// With nothing known of modulus and gap beforehand, both and the tip load are found between the points of any grid, each insertion with
/// its own interval.
#[test]
fn load_modulus_and_gap_are_found_together() {
    for (modulus_pa, gap_m) in [(11.7e3, 0.025), (18.4e3, 0.031)] {
        let rig = Rig { entry_m: 0.06 + gap_m, ..rig() };
        let mut noise = Noise::new(11);
        let paths = (0..6).map(|_| {
            let exact = truth(&rig, modulus_pa, 120, |_| 0.2).expect("solves");
            (exact.iter().map(|u_m| u_m + 0.05e-3 * noise.normal()).collect(), None, None)
        });
        let mut session = insertion_session(rig.clone(), Some(0.05e-3), paths.collect());
        session.rig.entry_m = 0.085;
        let prediction = predict(&session, &UNTIL_50).expect("predicts");
        for one in &prediction.insertions {
            let (load_n, sd_n) = (one.tip_force_n.expect("a load"), one.tip_force_sd_n.expect("its sd"));
            assert!((load_n - 0.2).abs() < 2.5 * sd_n && sd_n < 0.05, "{load_n} +- {sd_n} N");
            let learned = one.learned.as_ref().expect("learned");
            assert_eq!((learned.k_status, learned.gap_status), ("identified", "identified"));
            for ([low, high], value) in
                [(learned.k_ci95_kpa, 1e-3 * modulus_pa), (learned.gap_ci95_mm, 1e3 * gap_m)]
            {
                assert!(low < value && value < high && high < 25.0 * low, "{low} to {high} for {value}");
            }
        }
    }
}

/// If the path does not determine the modulus, no estimate of it is reported.
#[test]
fn what_is_not_identifiable_is_not_given_as_found() {
    let mut noise = Noise::new(12);
    let session = insertion_session(
        rig(),
        Some(0.3e-3),
        (0..4).map(|_| ((0..=60).map(|_| 0.3e-3 * noise.normal()).collect(), None, None)).collect(),
    );
    let prediction = predict(&session, &UNTIL_50).expect("predicts");
    for one in &prediction.insertions {
        let learned = one.learned.as_ref().expect("learned");
        assert_ne!(learned.k_status, "identified", "{:?}", learned.k_ci95_kpa);
        assert!(!learned.modulus_text().starts_with(|c: char| c.is_ascii_digit()));
    }
}

#[test]
fn a_message_is_given_once_with_its_insertions() {
    let insertions =
        vec![insertion_with("a", &["x", "y"]), insertion_with("b", &["x"]), insertion_with("c", &["x"])];
    let prediction = Prediction {
        schema: "",
        session: None,
        prior: None,
        models: Vec::new(),
        insertions,
        warnings: vec!["first".to_owned()],
        draws: None,
    };
    assert_eq!(prediction.messages(), ["first", "all 3 insertions: x", "a: y"]);
}

fn insertion_with(id: &str, warnings: &[&str]) -> InsertionResult {
    InsertionResult {
        id: id.to_owned(),
        warnings: warnings.iter().map(|text| (*text).to_owned()).collect(),
        ..InsertionResult::default()
    }
}

/// Not a digit of the prediction depends on where this insertion went beyond the observed part.
#[test]
fn nothing_beyond_is_used() {
    let (mut session, _) = steady();
    let short_prediction = predict(&session, &UNTIL_50).expect("predicts");
    let run = &mut session.insertion[1];
    for (depth_m, tip_m) in run.depth_m.iter().zip(&mut run.tip_y_m) {
        if *depth_m > 0.05 {
            *tip_m += 5e-3;
        }
    }
    let long_prediction = predict(&session, &UNTIL_50).expect("predicts");
    let (a, b) = (&short_prediction.insertions[1], &long_prediction.insertions[1]);
    assert!((&a.tip_y_mm, &a.lo95_y_mm, &a.tip_x_mm) == (&b.tip_y_mm, &b.lo95_y_mm, &b.tip_x_mm));
    assert_ne!(a.measured_y_mm, b.measured_y_mm);
    assert_ne!(
        short_prediction.insertions[0].tip_y_mm, long_prediction.insertions[0].tip_y_mm,
        "the others learn from it"
    );
}

/// Two half turns, one before and one after the prediction starts: the truth is inside the band.
#[test]
fn a_needle_turned_twice_stays_inside_its_band() {
    let mut noise = Noise::new(5);
    let paths = (0..4).map(|_| {
        let load_n = 0.2 + 0.01 * noise.normal();
        let exact = truth(&rig(), 11e3, 140, |step: usize| if is_rotated(step) { -load_n } else { load_n })
            .expect("solves");
        let measured: Vec<f64> = exact.iter().map(|u_m| u_m + 0.1e-3 * noise.normal()).collect();
        let rotation = (0..=140).map(|mm| if mm > 40 && mm <= 90 { PI } else { 0.0 }).collect();
        (exact, (measured, None, Some(rotation)))
    });
    let (exact, recorded): (Vec<_>, Vec<_>) = paths.unzip();
    let session = insertion_session(rig(), Some(0.1e-3), recorded);
    for learn in [true, false] {
        let options = Options { modulus_pa: Some([12e3, 2e3]), learn, ..UNTIL_50 };
        let prediction = predict(&session, &options).expect("predicts");
        let (mut inside_count, mut point_count) = (0, 0);
        for (one, exact) in prediction.insertions.iter().zip(&exact) {
            for (mm, exact_m) in exact.iter().enumerate().skip(51) {
                point_count += 1;
                inside_count +=
                    usize::from((one.lo95_y_mm[mm]..=one.hi95_y_mm[mm]).contains(&(1e3 * exact_m)));
            }
            let wide = one.hi95_y_mm[140] - one.lo95_y_mm[140];
            assert!(wide < if learn { 2.0 } else { 5.0 }, "a band of {wide} mm is of no use");
        }
        assert!(inside_count as f64 > 0.9 * f64::from(point_count), "{inside_count} of {point_count}");
    }
}

/// The needle is turned at rest, after the tip was measured.
fn is_rotated(step: usize) -> bool {
    step > 40 * STEPS_PER_MM && step <= 90 * STEPS_PER_MM
}

#[test]
fn what_cannot_be_predicted_is_reported() {
    let (mut session, _) = steady();
    let keep = session.insertion.split_off(0);
    let no_insertion = predict(&session, &UNTIL_50).expect_err("no insertion").to_string();
    assert!(no_insertion.contains("session.toml: insertion: missing"), "{no_insertion}");

    // One sample, depths in metres, nothing before the depth requested: each is reported; the good one is predicted.
    let mut bad = keep.clone();
    bad[0].depth_m.truncate(1);
    bad[0].tip_y_m.truncate(1);
    bad[1].depth_m.iter_mut().for_each(|depth_m| *depth_m *= 1e-3);
    session.insertion = bad;
    let two_predictions = predict(&session, &UNTIL_50).expect("one is good");
    assert!(
        error_of(0, &two_predictions.insertions).contains("i1.csv: depth_mm: 1 of 1 rows advance"),
        "{}",
        error_of(0, &two_predictions.insertions)
    );
    assert!(
        error_of(1, &two_predictions.insertions).contains("is this in millimetres?"),
        "{}",
        error_of(1, &two_predictions.insertions)
    );
    assert!(two_predictions.insertions[2].error.is_none() && two_predictions.warnings.len() == 2);

    session.insertion.truncate(2);
    let all_failed = predict(&session, &UNTIL_50).expect_err("none is good").to_string();
    assert!(all_failed.contains("no insertion can be predicted: i1.csv"), "{all_failed}");

    session.insertion = keep;
    session.insertion[0].depth_m.iter_mut().for_each(|depth_m| *depth_m += 0.06);
    let prediction = predict(&session, &UNTIL_50).expect("two are good");
    let error = prediction.insertions[0].error.clone().unwrap_or_default();
    assert!(error.contains("0 depths up to 50 mm, expected 3 or more"), "{error}");
}

fn error_of(i: usize, insertions: &[InsertionResult]) -> String {
    insertions[i].error.clone().unwrap_or_default()
}

/// Columns of a recording as the reader lets them pass: any depth, tip, rotation and guide position in range.
fn columns() -> impl Strategy<Value = Vec<[f64; 5]>> {
    let small_range = |most: f64| prop_oneof![3 => -0.1 * most..most, 1 => -most..most, 1 => Just(0.0)];
    let row = (
        small_range(0.1),
        small_range(0.01),
        small_range(0.2),
        prop_oneof![Just(0.0), Just(PI), -1e5..1e5],
        small_range(0.05),
    );
    let advancing = (0usize..60).prop_flat_map(move |rows| proptest::collection::vec(row.clone(), rows));
    (advancing, any::<bool>()).prop_map(|(rows, sorted)| {
        let mut rows: Vec<[f64; 5]> =
            rows.into_iter().map(|(d, y, x, turn, guide)| [d, y, x, turn, guide]).collect();
        if sorted {
            rows.sort_by(|a, b| a[0].total_cmp(&b[0]));
        }
        rows
    })
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    /// For any recording: a prediction of finite numbers, or a reason.
    #[test]
    fn any_recording_is_predicted_or_refused(
        first in columns(), second in columns(), planes in 0u8..4, until_m in 0.005f64..0.15, learn in any::<bool>(),
    ) {
        let mut session = insertion_session(rig(), None, Vec::new());
        session.insertion = [first, second].into_iter().enumerate().map(|(number, rows)| {
            let column = |i: usize| rows.iter().map(|row| row[i]).collect::<Vec<f64>>();
            formats::session::InsertionRun {
                id: format!("i{number}"),
                path: "i.csv".into(),
                depth_m: column(0),
                tip_y_m: column(1),
                tip_x_m: (planes & 1 == 1).then(|| column(2)),
                time_s: None,
                rotation_rad: (planes & 2 == 2).then(|| column(3)),
                guide2_y_m: Some(column(4)),
                guide2_x_m: None,
                base_force_y_n: None,
                tip_direction_y_rad: None,
                tip_direction_x_rad: None,
            }
        }).collect();
        let options = Options { until_m, learn, modulus_pa: Some([1e4, 1e3]), ..UNTIL_50 };
        if let Ok(prediction) = predict(&session, &options) {
            for one in prediction.insertions.iter().filter(|one| one.error.is_none()) {
                let numbers = one.tip_y_mm.iter().chain(&one.lo95_y_mm).chain(&one.hi95_y_mm).chain(&one.tip_force_n);
                prop_assert!(numbers.into_iter().all(|number| number.is_finite()));
            }
        }
    }
}

/// A clearance or a bent needle in a model file is part of the prediction: the paths were made by another solution of
/// the same physics.
#[test]
fn clearance_and_bend_of_the_model_are_in_the_path() {
    use worlds::{Design, Truth, session};
    let known_effects = [("rig.backlash", vec![0.3]), ("needle.prebend", vec![0.5, 0.2])];
    for (id, values) in known_effects {
        let truth =
            Truth { k_kpa: 12.0, tip_load_n: 0.2, effects: vec![(id, values.clone())], foreign: None };
        let session = session(&truth, &Design::moved_insertions(), 3);
        let effect = mechanics::effects::effect(id).expect("an effect");
        let (error_with, error_without) =
            (error_mm(vec![(effect, values)], &session), error_mm(Vec::new(), &session));
        assert!(
            error_with < 0.7 * error_without,
            "{id}: {error_with} mm with it, {error_without} mm without"
        );
    }
}

fn error_mm(effects: Vec<(&'static dyn Effect, Vec<f64>)>, session: &Session) -> f64 {
    let options = Options { modulus_pa: Some([12e3, 0.6e3]), learn: false, effects, ..UNTIL_50 };
    let prediction = predict(session, &options).expect("predicts");
    let errors_mm = prediction.insertions.iter().map(|one| one.mae_mm.expect("measured"));
    errors_mm.sum::<f64>() / prediction.insertions.len() as f64
}

/// Paths through one guide that rests, with a rear of which nothing is known, determine no modulus, however smooth they are; where guide 2
/// moves they do.
#[test]
fn a_guide_that_rests_leaves_the_modulus_as_it_was_assumed() {
    let guides = mechanics::Guides::One { rear_rotation_n_m_per_rad: [None; 2] };
    let one_guide = |rig: Rig| Rig { guides, ..rig };
    let mut session = steady().0;
    session.rig = one_guide(Rig { guide2_m: 0.0, entry_m: 0.025, ..session.rig });
    let prediction = predict(&session, &UNTIL_50).expect("predicts");
    for one in &prediction.insertions {
        let learned = one.learned.as_ref().expect("learned");
        assert_eq!((learned.k_status, learned.gap_status), ("not_identified", "not_identified"));
        let [low, high] = learned.k_ci95_kpa;
        assert!(high / low > 40.0 && low < 11.0 && 11.0 < high, "{:?}", learned.k_ci95_kpa);
        assert!(learned.modulus_text().starts_with("not identifiable"));
        // The load is that over all these moduli.
        let [least, most] = one.tip_force_ci95_n.expect("an interval");
        assert!(least < 0.2 && 0.2 < most && most - least > 0.1, "{least} to {most} N");
        assert!(one.warnings.iter().any(|warning| warning.contains("guide 2 rests")), "{:?}", one.warnings);
        assert!(one.mae_mm.expect("measured") < 0.3, "{:?}", one.mae_mm);
    }
    // A modulus that is stated is another matter.
    let stated = Options { modulus_pa: Some([11e3, 1e3]), ..UNTIL_50 };
    let stated = predict(&session, &stated).expect("predicts");
    let learned = stated.insertions[0].learned.as_ref().expect("learned");
    assert!(learned.k_status == "identified" && stated.insertions[0].warnings.is_empty());
    // So is a guide that moves.
    for run in &mut session.insertion {
        let moved = run.depth_m.iter().map(|depth_m| if *depth_m < 0.03 { 0.0 } else { 1e-3 });
        run.guide2_y_m = Some(moved.collect());
    }
    let moved = predict(&session, &UNTIL_50).expect("predicts");
    assert!(!moved.messages().iter().any(|message| message.contains("guide 2 rests")));
}

#[test]
fn a_prior_near_the_truth_is_used_with_the_prediction_without_it_beside_and_one_that_contradicts_is_not() {
    let (session, _) = steady();
    let plain = predict(&session, &UNTIL_50).expect("predicted");
    let learned = plain.insertions[0].learned.as_ref().expect("learned");
    let near_prior = predicted_with_prior(learned.k_kpa, &session);
    let applied_prior = near_prior.prior.as_ref().expect("a prior");
    assert!(applied_prior.modulus.used, "{applied_prior:?}");
    assert_eq!(applied_prior.without.len(), plain.insertions.len());
    assert_eq!(applied_prior.without[0].last_error_mm, plain.insertions[0].last_error_mm);
    let [low, high] = near_prior.insertions[0].learned.as_ref().expect("learned").k_ci95_kpa;
    let [wide_low, wide_high] = learned.k_ci95_kpa;
    assert!(high / low < wide_high / wide_low, "{low} to {high}, without {wide_low} to {wide_high}");
    if learned.k_status == "identified" {
        let far_prior = predicted_with_prior(100.0 * learned.k_kpa, &session);
        assert!(far_prior.prior.as_ref().is_some_and(|prior| !prior.modulus.used));
        assert_eq!(far_prior.insertions, plain.insertions);
    }
}

fn predicted_with_prior(k_kpa: f64, session: &Session) -> Prediction {
    predict(session, &Options { prior: Some(stated_prior(k_kpa)), ..UNTIL_50 }).expect("predicted")
}

fn stated_prior(k_kpa: f64) -> ModulusPrior {
    ModulusPrior {
        file: "prior.toml".to_owned(),
        group: "all".to_owned(),
        sessions: 20,
        modulus_pa: 1e3 * k_kpa,
        scale_ln: 0.05,
        degrees_of_freedom: 30.0,
    }
}
