use super::*;
use crate::draws::Random;
use formats::model_file::ModelFile;
use mechanics::{Model, Needle, Rig, Support};

const DEPTH_M: f64 = 0.03;
const K_PA: f64 = 12e3;
const NOISE_N: f64 = 0.02;
const READINGS_S: f64 = 0.02;

fn rig() -> Rig {
    Rig::two_guides(Needle::gauge_18(), 0.06, 0.07)
}

/// A model that was learned: a modulus known to 5 %.
fn model() -> ModelFile {
    ModelFile {
        modulus_pa: Some(K_PA),
        modulus_ci95_pa: Some([0.95 * K_PA, 1.05 * K_PA]),
        ..ModelFile::default()
    }
}

/// A rig at work: four seconds of rest, then up and down to 1 mm and rests between.
struct Work {
    random: Random,
    stiffness_n_per_m: f64,
    friction_n: f64,
    time_s: f64,
    at_m: f64,
}

impl Work {
    fn new(seed: u64) -> Self {
        let beam =
            Model::on(rig(), Support::Springs, 1.03 * K_PA).expect("a model").beam(DEPTH_M).expect("a beam");
        Self {
            random: Random::new(seed, 0),
            stiffness_n_per_m: beam.force_n(1e-3) / 1e-3,
            friction_n: 0.03,
            time_s: 0.0,
            at_m: 0.0,
        }
    }

    /// The next reading, with what is wrong in newtons as a function of time and displacement.
    fn next(&mut self, fault: &dyn Fn(f64, f64) -> f64) -> GuideReading {
        let phase = (self.time_s - 4.0).max(0.0) % 8.0;
        let target_m = if self.time_s < 4.0 || phase >= 6.0 {
            0.0
        } else if phase < 1.0 {
            1e-3 * phase
        } else if phase < 5.0 {
            1e-3
        } else {
            1e-3 * (6.0 - phase)
        };
        let shift_m = target_m - self.at_m;
        self.at_m = target_m;
        let rubs = if shift_m == 0.0 { 0.0 } else { self.friction_n * shift_m.signum() };
        let force_n = self.stiffness_n_per_m * target_m
            + rubs
            + fault(self.time_s, target_m)
            + NOISE_N * self.random.normal();
        let point = GuideReading {
            time_s: self.time_s,
            displacement_m: [0.0, target_m],
            force_n: [NOISE_N * self.random.normal(), force_n],
            repeats_force: false,
        };
        self.time_s += READINGS_S;
        point
    }
}

/// Departures that are detected within a time, with that time.
fn followed(seed: u64, until_s: f64, fault: &dyn Fn(f64, f64) -> f64) -> Vec<Parted> {
    let mut follower = Follower::new(&model(), &rig(), DEPTH_M).expect("a model to follow");
    let mut work = Work::new(seed);
    let mut departures = Vec::new();
    while work.time_s < until_s {
        departures.extend(follower.push(&[work.next(fault)]));
    }
    assert!(follower.is_following());
    assert_eq!(follower.parted(), departures);
    departures
}

#[test]
fn a_rig_that_follows_its_model_gives_no_alarm() {
    for seed in 0..3 {
        assert_eq!(followed(seed, 300.0, &|_, _| 0.0), []);
    }
}

/// A needle that slips, a cell that drifts, a clamp that comes loose: each is found, with its axis and about when it began.
#[test]
fn faults_are_found_while_they_begin() {
    let began_s = 61.0;
    let stiffness_n_per_m = Work::new(1).stiffness_n_per_m;
    let after = |time_s: f64| time_s >= began_s;
    let slips = |time_s: f64, at_m: f64| if after(time_s) { -0.5 * stiffness_n_per_m * at_m } else { 0.0 };
    let drifts = |time_s: f64, _: f64| if after(time_s) { 0.05 * (time_s - began_s) } else { 0.0 };
    let jumps = |time_s: f64, _: f64| if after(time_s) { 0.4 } else { 0.0 };
    for (name, fault, within_s) in [
        ("slips", &slips as &dyn Fn(f64, f64) -> f64, 2.0),
        ("jumps", &jumps, 2.0),
        ("drifts", &drifts, 12.0),
    ] {
        let departures = followed(1, 90.0, fault);
        let [parted] = departures.as_slice() else { panic!("{name}: {departures:?}") };
        assert_eq!(parted.axis, "y", "{name}");
        assert!(parted.found_s >= began_s && parted.found_s < began_s + within_s, "{name}: {parted:?}");
        assert!(parted.since_s >= began_s - 1.0 && parted.since_s <= parted.found_s, "{name}: {parted:?}");
        assert!(parted.sigma.abs() > 4.0, "{name}: {parted:?}");
        let sentence = parted.sentence("12:03:11 UTC");
        assert!(sentence.contains("no longer follows the model since 12:03:11 UTC, at "), "{sentence}");
    }
}

#[test]
fn a_model_without_a_modulus_is_not_followed() {
    let error = Follower::new(&ModelFile::default(), &rig(), DEPTH_M).expect_err("no modulus");
    assert!(error.to_string().contains("[tissue]: no modulus"), "{error}");
}

/// A device that starts again, readings that are lost, and readings that are none.
#[test]
fn interruptions_are_no_departures() {
    let mut follower = Follower::new(&model(), &rig(), DEPTH_M).expect("a model to follow");
    let mut work = Work::new(2);
    for reading in 0..6_000 {
        let mut point = work.next(&|_, _| 0.0);
        point.repeats_force = reading % 50 == 0;
        if (2_000..2_500).contains(&reading) {
            continue;
        }
        if reading >= 4_000 {
            point.time_s -= 80.0;
        }
        assert_eq!(follower.push(&[point]), [], "reading {reading}");
    }
}
