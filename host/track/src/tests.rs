//! Estimators on simulated runs whose tissue is known.

use super::kalman::{FilterConfig, Kalman, Kind};
use super::method::{Method, Report, samples};
use super::online::{OnlineEstimator, OnlineTracker, settings};
use super::published::{Forgetting, Published, PublishedSettings};
use estimator::{Identifiability, Sample, SampleError};
use formats::session::SteeringRun;
use mechanics::{BaseDrive, Dynamics, Experiment, Foundation, Model, Needle, Rig, Steering, predict};
use simulation::rig::steering::{Plan, Sensors, SteeringRig, Tissue, TissueLayer};

const ORDINARY: Sensors = Sensors { base_m: 2e-5, force_n: 0.05, tip_m: 2e-4 };

fn rig() -> Rig {
    Rig::two_guides(Needle::gauge_18(), 0.06, 0.07)
}

fn dynamics() -> Dynamics {
    Dynamics::steel(&rig().needle, 0.13, 0.3)
}

fn plan(speed_mm_s: f64, lateral_mm: f64, straight_mm: f64) -> Plan {
    Plan {
        id: "s".to_owned(),
        speed_mm_s,
        depth_mm: 80.0,
        lateral_mm,
        straight_mm,
        wobble_mm: 0.0,
        wobble_hz: 0.5,
        period_ms: 20.0,
        disturbances: 0,
    }
}

fn tissue() -> Tissue {
    Tissue { layers: vec![layer(40.0, 1.5e4, 1e3), layer(80.0, 3e4, 2e3)], inclusions: Vec::new() }
}

fn layer(bottom_mm: f64, stiffness_n_per_m2: f64, damping_n_s_per_m2: f64) -> TissueLayer {
    TissueLayer { bottom_mm, stiffness_n_per_m2, damping_n_s_per_m2 }
}

fn run(plan: &Plan, sensors: Sensors, seed: u64) -> SteeringRun {
    run_in(&tissue(), plan, sensors, seed)
}

fn run_in(tissue: &Tissue, plan: &Plan, sensors: Sensors, seed: u64) -> SteeringRun {
    let steering = SteeringRig::new(rig(), 0.13, 0.3, tissue).expect("a rig");
    steering.carry_out(plan).expect("a plan").measure(sensors, seed, 0)
}

/// A run of the model that an estimator itself has: so many modes, uniform tissue.
fn matching(modes: usize, period_s: f64) -> SteeringRun {
    let time_s: Vec<f64> = (0..(16.0 / period_s) as usize).map(|i| i as f64 * period_s).collect();
    let depth_m: Vec<f64> = time_s.iter().map(|time_s| 0.005 * time_s).collect();
    // To and fro, so that springs and dampers differ.
    let drive =
        BaseDrive::Position(time_s.iter().map(|time_s| 2e-3 * (1.0 - (1.5 * time_s).cos())).collect());
    let mut model = Model::uniform(rig(), 2e4).expect("valid");
    let damping = Foundation::uniform(2e3).expect("valid");
    // A twentieth of the period follows a motion of seconds.
    let step_s = (0.05 * period_s).max(2e-4);
    model.dynamics = Some(Dynamics { modes, damping, step_s, ..dynamics() });
    let steering = Steering { time_s: time_s.clone(), depth_m: depth_m.clone(), drive };
    let channels = predict(&model, &Experiment::Steering(steering)).expect("simulates");
    SteeringRun {
        id: "m".to_owned(),
        path: "m.csv".into(),
        time_s,
        depth_m,
        base_y_m: channels.base_m.y,
        base_force_y_n: channels.force_n.y,
        tip_y_m: channels.tip_m.y,
    }
}

fn last(method: &mut dyn Method, run: &SteeringRun) -> Report {
    samples(run).filter_map(|sample| method.update(&sample)).last().expect("reports")
}

fn near(found: Option<f64>, expected: f64, share: f64) {
    let identified = found.expect("identified");
    assert!((identified / expected - 1.0).abs() < share, "{identified} is not {expected}");
}

/// Without noise, and on its own model, the printed regression finds what is there.
#[test]
fn the_published_regression_is_right() {
    let run = matching(1, 1e-3);
    for forgetting in [Forgetting::Constant(0.999), Forgetting::Variable(1e-9)] {
        let printed = PublishedSettings {
            order: 0,
            segment_m: 1.0,
            forgetting,
            filter_hz: 50.0,
            ..PublishedSettings::default()
        };
        let mut method = Published::new(&rig().needle, &dynamics(), printed).expect("a needle");
        let report = last(&mut method, &run);
        near(report.stiffness, 2e4, 0.02);
        near(report.damping, 2e3, 0.05);
    }
}

#[test]
fn kalman_filters_find_uniform_tissue() {
    let run = matching(3, 10e-3);
    let config = FilterConfig { start: [5e3, 5e2], base_sd_m: 1e-5, force_sd_n: 2e-3, tip_sd_m: 1e-5 };
    for kind in [Kind::Extended, Kind::Unscented] {
        let mut method = Kalman::new(kind, &rig().needle, &dynamics(), config).expect("a needle");
        let report = last(&mut method, &run);
        near(report.stiffness, 2e4, 0.1);
        near(report.damping, 2e3, 0.5);
    }
}

/// The base moved to and fro, without noise: what is left are the rows of a fifth of a second.
#[test]
fn motion_to_and_fro_identifies_both() {
    let run = matching(10, 20e-3);
    let mut tracker =
        OnlineTracker::new(settings::<f64>(&rig().needle, &dynamics()).expect("a needle")).expect("fits");
    samples(&run).for_each(|sample| {
        tracker.update(&sample).expect("taken");
    });
    let estimate = tracker.finish().expect("rows");
    assert!((estimate.stiffness.value / 2e4 - 1.0).abs() < 0.03, "{estimate:?}");
    assert!((estimate.damping.value / 2e3 - 1.0).abs() < 0.2, "{estimate:?}");
    assert_eq!(estimate.damping.identifiability, Identifiability::Identified);
}

/// Starts a hundred times too high and too low end at the same.
#[test]
fn the_start_is_forgotten() {
    let run = run(&plan(4.0, 20.0, 0.0), ORDINARY, 2);
    let (high, low) = (estimate_at_end([2e6, 3e5], &run), estimate_at_end([2e2, 10.0], &run));
    assert!((high.stiffness.value / low.stiffness.value - 1.0).abs() < 0.02, "{high:?} {low:?}");
    let mean = tissue().mean(high.depth_m);
    assert!(high.stiffness.low < mean[0] && mean[0] < high.stiffness.high, "{high:?} {mean:?}");
    assert!(high.settled);
}

fn estimate_at_end(start: [f64; 2], run: &SteeringRun) -> estimator::Estimate<f64> {
    let mut settings = settings::<f64>(&rig().needle, &dynamics()).expect("a needle");
    settings.start = start;
    let mut tracker = OnlineTracker::new(settings).expect("fits");
    samples(run).for_each(|sample| {
        tracker.update(&sample).expect("taken");
    });
    tracker.finish().expect("rows")
}

/// Half the digits are enough.
#[test]
fn single_precision_agrees() {
    let run = run(&plan(4.0, 20.0, 30.0), ORDINARY, 3);
    let needle = rig().needle;
    let mut double =
        OnlineEstimator::new(settings::<f64>(&needle, &dynamics()).expect("a needle")).expect("fits");
    let mut single =
        OnlineEstimator::new(settings::<f32>(&needle, &dynamics()).expect("a needle")).expect("fits");
    let mut rows = 0;
    for sample in samples(&run) {
        let (Some(double), Some(single)) = (double.update(&sample), single.update(&sample)) else { continue };
        rows += 1;
        assert!((double.tip_m - single.tip_m).abs() < 0.1e-3, "{double:?} {single:?}");
        if let (Some(double), Some(single)) = (double.stiffness, single.stiffness) {
            assert!((single / double - 1.0).abs() < 0.1, "{single} {double}");
        }
    }
    assert!(rows > 60);
}

/// Guide 2 does not move sideways: nothing is identifiable, and nothing identified.
#[test]
fn straight_insertions_identify_nothing() {
    let run = run(&plan(4.0, 0.0, 0.0), ORDINARY, 4);
    let mut tracker =
        OnlineTracker::new(settings::<f64>(&rig().needle, &dynamics()).expect("a needle")).expect("fits");
    for sample in samples(&run) {
        if let Some(estimate) = tracker.update(&sample).expect("taken") {
            assert_ne!(estimate.stiffness.identifiability, Identifiability::Identified, "{estimate:?}");
            assert_eq!(estimate.damping.identifiability, Identifiability::NotIdentified, "{estimate:?}");
        }
    }
}

#[test]
fn bad_samples_are_refused_and_change_nothing() {
    let run = run(&plan(8.0, 20.0, 0.0), ORDINARY, 5);
    let (mut clean, mut disturbed) = (fresh_tracker(), fresh_tracker());
    for sample in samples(&run) {
        let expected = clean.update(&sample).expect("taken");
        assert_eq!(disturbed.update(&sample).expect("taken"), expected);
        let bad = [
            (Sample { force_n: f64::NAN, time_s: sample.time_s + 1e-3, ..sample }, SampleError::NotANumber),
            (
                Sample { tip_m: f64::INFINITY, time_s: sample.time_s + 1e-3, ..sample },
                SampleError::NotANumber,
            ),
            (sample, SampleError::TimeNotIncreasing),
            (Sample { depth_m: 0.5, time_s: sample.time_s + 1e-3, ..sample }, SampleError::TooDeep),
        ];
        for (bad, refused) in bad {
            assert_eq!(disturbed.update(&bad), Err(refused));
        }
    }
}

fn fresh_tracker() -> estimator::Tracker<f64, 5, 60, 18, 256> {
    OnlineTracker::new(settings::<f64>(&rig().needle, &dynamics()).expect("a needle")).expect("fits")
}

/// Drawn back a little, at rest, and with a tip sensor that has an offset: the same tissue.
#[test]
fn rests_and_offsets_are_taken() {
    let mut run = run(&plan(4.0, 20.0, 0.0), ORDINARY, 6);
    run.tip_y_m.iter_mut().for_each(|tip_m| *tip_m += 0.3e-3);
    run.base_force_y_n.iter_mut().for_each(|force_n| *force_n += 0.01);
    let rest_index = run.time_s.len() / 2;
    let pause_s = 3.0;
    let mut tracker =
        OnlineTracker::new(settings::<f64>(&rig().needle, &dynamics()).expect("a needle")).expect("fits");
    for (i, sample) in samples(&run).enumerate() {
        let shift_s = if i > rest_index { pause_s } else { 0.0 };
        tracker.update(&Sample { time_s: sample.time_s + shift_s, ..sample }).expect("taken");
        if i == rest_index {
            for j in 1..100 {
                let time_s = sample.time_s + pause_s * f64::from(j) / 100.0;
                tracker
                    .update(&Sample { time_s, depth_m: sample.depth_m - 0.2e-3, ..sample })
                    .expect("taken");
            }
        }
    }
    let estimate = tracker.finish().expect("rows");
    let mean = tissue().mean(estimate.depth_m);
    assert!(estimate.stiffness.low < mean[0] && mean[0] < estimate.stiffness.high, "{estimate:?} {mean:?}");
    assert!(estimate.stiffness.high / estimate.stiffness.low < 2.5, "{estimate:?}");
}

/// A session of one run with stated noise.
fn session(run: SteeringRun) -> formats::session::Session {
    let mut needle = rig().needle;
    needle.length_m = Some(0.13);
    formats::session::Session {
        dir: "s".into(),
        name: None,
        rig: Rig { needle, ..rig() },
        fixture_mass_kg: Some(0.3),
        noise: formats::session::Noise {
            force_n: Some(0.05),
            force_zero_n: None,
            displacement_m: Some(2e-5),
            shape_m: None,
            tip_m: Some(2e-4),
            tip_direction_rad: None,
        },
        tissue: Default::default(),
        lateral: Vec::new(),
        insertion: Vec::new(),
        indentation: Vec::new(),
        steering: vec![run],
    }
}

/// A wrong sign or unit is named, and no motion is advised that would not help.
#[test]
fn signs_and_units_are_diagnosed_before_tissue() {
    let good = run(&plan(8.0, 20.0, 0.0), ORDINARY, 7);
    let sound = warnings_of(&|_| {}, &super::Options::default(), &good);
    assert!(!sound.iter().any(|what| what.contains("sign") || what.contains("metres")), "{sound:?}");
    type Case<'a> = (&'a dyn Fn(&mut SteeringRun), &'a str);
    let cases: [Case<'_>; 3] = [
        (&|run| scale(&mut run.base_force_y_n, -1.0), "sign of"),
        (&|run| scale(&mut run.tip_y_m, 1e-3), "in metres"),
        (&|run| scale(&mut run.depth_m, 1e-3), "depth_mm: 0.08"),
    ];
    // A wrong run is tracked once more for every change in question: with the boundary known, which is a tenth of the work.
    let known_segments = super::Options { segment_m: Some(0.04), ..super::Options::default() };
    for (change, expected) in cases {
        let warnings = warnings_of(change, &known_segments, &good);
        assert!(warnings.first().is_some_and(|what| what.contains(expected)), "{expected}: {warnings:?}");
        assert!(!warnings.iter().any(|what| what.contains("move the base")), "{warnings:?}");
    }
}

fn scale(values: &mut [f64], factor: f64) {
    values.iter_mut().for_each(|value| *value *= factor)
}

fn warnings_of(
    change: &dyn Fn(&mut SteeringRun),
    options: &super::Options,
    good: &SteeringRun,
) -> Vec<String> {
    let mut run = good.clone();
    change(&mut run);
    super::track(&session(run), options).expect("tracked").runs[0].warnings.clone()
}

/// A boundary anywhere is found where it is, and segments are taken as they are stated.
#[test]
fn boundaries_are_found_and_stated_segments_are_taken() {
    for (boundary_mm, number) in [(18.0, 8), (47.0, 9)] {
        let mut tissue = tissue();
        let [first, second] = tissue.layers.as_mut_slice() else { panic!("two layers") };
        first.bottom_mm = boundary_mm;
        second.stiffness_n_per_m2 = 3.0 * first.stiffness_n_per_m2;
        tissue.inclusions.clear();
        let session = session(run_in(&tissue, &plan(8.0, 20.0, 0.0), ORDINARY, number));
        let tracked = super::track(&session, &super::Options::default()).expect("tracked");
        let layers = tracked.runs[0].layers.clone().expect("layers");
        assert!(layers.probability > 0.9, "layers that differ by a factor of three: {layers:?}");
        let [low, high] = layers.boundary_ci95_mm.expect("an interval");
        let at = layers.boundary_mm.expect("a boundary");
        // The information in such a run locates the boundary within 2 to 3 mm (standard deviation) at best.
        assert!((low - 1.0..=high + 1.0).contains(&boundary_mm), "{boundary_mm}: {layers:?}");
        assert!((at - boundary_mm).abs() < 8.0 && high - low < 30.0, "{boundary_mm}: {layers:?}");
        let ratio = layers.stiffness_ratio.expect("a ratio");
        assert!((1.7..5.3).contains(&ratio), "{layers:?}");
        let stated = super::Options { segment_m: Some(1e-3 * boundary_mm), ..super::Options::default() };
        let elsewhere = super::Options { segment_m: Some(0.033), ..super::Options::default() };
        assert_ne!(
            stiffness_field(&stated, &session),
            stiffness_field(&elsewhere, &session),
            "segments are as they are stated"
        );
    }
    let short = super::Options { segment_m: Some(2e-3), ..super::Options::default() };
    let why = super::track(&session(run(&plan(8.0, 20.0, 0.0), ORDINARY, 8)), &short).expect_err("refused");
    assert!(why.to_string().contains("segment_mm: 2, expected 4.0 or more"), "{why}");
}

fn stiffness_field(options: &super::Options, session: &formats::session::Session) -> Vec<Option<f64>> {
    let segments = super::track(session, options).expect("tracked");
    assert!(segments.warnings.is_empty(), "{:?}", segments.warnings);
    segments.runs[0].field.clone().expect("a field").stiffness_n_per_m2
}
