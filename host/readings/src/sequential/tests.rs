use super::*;
use crate::draws::Random;

/// Steps a second, hours a day, and the alarms that are promised.
const STEP_S: f64 = 0.1;
const DAY: usize = 864_000;
const PER_HOUR: f64 = 1e-3;

/// Noise whose neighbours are alike.
struct Noise {
    random: Random,
    correlation: f64,
    value: f64,
}

impl Noise {
    fn new(seed: u64, correlation: f64) -> Self {
        let mut random = Random::new(seed, 0);
        let value = random.normal();
        Self { random, correlation, value }
    }

    fn next(&mut self) -> f64 {
        let innovation = (1.0 - self.correlation.powi(2)).sqrt() * self.random.normal();
        self.value = self.correlation * self.value + innovation;
        self.value
    }
}

/// Half a minute of rest, from which the noise is learned.
fn learned(noise: &mut Noise) -> StepNoise {
    let history: Vec<f64> = (0..300).map(|_| noise.next()).collect();
    StepNoise::of_rest(&history).expect("noise")
}

#[test]
fn no_false_alarm_in_a_day_of_noise_friction_and_a_modulus_that_is_off() {
    for (seed, correlation) in [(1, 0.0), (2, 0.5), (3, 0.9)] {
        let mut noise = Noise::new(seed, correlation);
        let mut detector = Detector::new(learned(&mut noise), STEP_S, PER_HOUR);
        for step in 0..DAY {
            // Guide 2 goes up and down; friction is against the motion, and the modulus is off by less than it may be.
            let phase = (step % 400) as f64 / 400.0;
            let (load, direction) =
                if phase < 0.5 { (20.0 * phase, 1.0) } else { (20.0 * (1.0 - phase), -1.0) };
            let model_error = 3.0 * direction + 0.25 * load;
            let turns = if step % 200 == 0 { 6.0 } else { 0.0 };
            let departure =
                detector.step(noise.next() + model_error, 3.0 + 0.3 * load, turns + 0.3 * 20.0 / 400.0);
            assert_eq!(departure, None, "correlation {correlation}, step {step}");
        }
    }
}

/// At a rate at which there are some: no more of them than promised.
#[test]
fn false_alarms_are_no_more_frequent_than_promised() {
    let noise = StepNoise { sd: 1.0, correlation: 0.5 };
    let per_hour = 30.0;
    let mut steps = Noise::new(7, 0.5);
    let mut detector = Detector::new(noise, STEP_S, per_hour);
    let mut alarms = 0.0;
    for _ in 0..DAY {
        if detector.step(steps.next(), 0.0, 0.0).is_some() {
            alarms += 1.0;
            detector.reset();
        }
    }
    let promised = per_hour * 24.0;
    // Far enough from none for the bound to be one, and below it.
    assert!(alarms > 0.02 * promised && alarms < promised, "{alarms} of at most {promised}");
}

/// A step, and a drift that comes to it: 5 standard deviations of a step beyond what is allowed, in noise of any correlation.
#[test]
fn a_fault_of_five_sigma_is_found_within_two_seconds_and_its_beginning_is_named() {
    let mut slowest: u64 = 0;
    for seed in 0..200 {
        for correlation in [0.0, 0.3, 0.6] {
            let mut noise = Noise::new(seed, correlation);
            let mut detector = Detector::new(learned(&mut noise), STEP_S, PER_HOUR);
            let sign = if seed % 2 == 0 { 1.0 } else { -1.0 };
            let (tolerance, fault_at) = (1.0, 500);
            let first_departure = (0..fault_at + 20).find_map(|step| {
                let fault = if step < fault_at { 0.0 } else { sign * (tolerance + 5.0) };
                detector.step(noise.next() + fault, tolerance, 0.0).map(|found| (step, found))
            });
            let (step, departure) =
                first_departure.unwrap_or_else(|| panic!("seed {seed}, {correlation}: not found in 2 s"));
            assert!(step >= fault_at, "seed {seed}: a false alarm");
            slowest = slowest.max(step - fault_at + 1);
            assert!(departure.since.abs_diff(fault_at) <= 3, "{departure:?}");
            assert!(departure.sigma * sign > 5.0 && departure.mean * sign > 2.0, "{departure:?}");
        }
    }
    assert!(slowest as f64 * STEP_S <= 2.0, "{slowest} steps");
}

#[test]
fn a_drift_is_found_before_it_is_large() {
    let mut noise = Noise::new(5, 0.5);
    let mut detector = Detector::new(learned(&mut noise), STEP_S, PER_HOUR);
    // 1 standard deviation a minute.
    let first_departure = (0..3600).find_map(|step| {
        let drift = step as f64 / 600.0;
        detector.step(noise.next() + drift, 0.0, 0.0).map(|found| (drift, found))
    });
    let (drift, departure) = first_departure.expect("found in six minutes");
    assert!(drift < 4.0, "{drift}");
    assert!(departure.mean > 0.0 && departure.sigma > 4.0);
}

#[test]
fn what_is_not_measured_says_nothing() {
    let noise = StepNoise { sd: 1.0, correlation: 0.5 };
    let mut detector = Detector::new(noise, STEP_S, PER_HOUR);
    for value in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
        assert_eq!(detector.step(value, 0.0, 0.0), None);
    }
    // One reading that is far off is not enough.
    assert_eq!(detector.step(1e12, 0.0, 0.0), None);
    assert_eq!(StepNoise::of_rest(&[1.0, 2.0]), None);
    assert_eq!(StepNoise::of_rest(&[1.0; 100]), None);
}
