//! Differences of readings and model that another computation has made, followed along both axes.

use super::{AXES, Difference, FALSE_ALARMS_PER_HOUR, Parted, STEP_S};
use readings::holds::median;
use readings::sequential::{Departure, Detector, StepNoise};

/// Readings of a step of the tip at least: of five readings two may be far off without any effect on their median, as those of
/// trackers sometimes are.
const TIP_READINGS: usize = 5;
/// Standard deviation of a median of normal values over that of their mean: `(pi / 2)^(1/2)`, the limit for many; it is less for few.
const MEDIAN_OVER_MEAN: f64 = 1.2534;

/// Difference of a reading and what a model expects of it, along x and y.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ReadingDifference {
    /// Clock of the readings, seconds.
    pub time_s: f64,
    /// Displacement of guide 2, millimetres.
    pub displacement_mm: [f64; 2],
    /// Depth of the needle, millimetres.
    pub depth_mm: f64,
    /// Measured less modelled, newtons or millimetres.
    pub difference: [f64; 2],
    /// By how much the model may be off there, in the same unit.
    pub possible: [f64; 2],
    /// Standard deviation of the reading, in the same unit.
    pub noise: f64,
}

/// Follows the differences of one channel. Readings of [`STEP_S`], or as many as its channel needs, are one step: its difference is their
/// median.
#[derive(Debug)]
pub struct Comparer {
    /// Readings of a step at least.
    least: usize,
    /// Makes a mean a difference of the channel.
    difference: fn(f64) -> Difference,
    open: Vec<ReadingDifference>,
    steps: Vec<ReadingDifference>,
    detectors: [Detector; 2],
    parted: Vec<Parted>,
}

impl Comparer {
    /// For the force at guide 2: differences in newtons.
    pub fn of_force() -> Self {
        Self::new(1, |mean_n| Difference::Force { mean_n })
    }

    /// For the tip: differences in millimetres.
    pub fn of_tip() -> Self {
        Self::new(TIP_READINGS, |mean_mm| Difference::Tip { mean_mm })
    }

    fn new(least: usize, difference: fn(f64) -> Difference) -> Self {
        // Differences are counted in standard deviations of their own step, so that these may differ.
        let detectors =
            [(); 2].map(|()| Detector::new(StepNoise::independent(1.0), STEP_S, FALSE_ALARMS_PER_HOUR));
        Self { least, difference, open: Vec::new(), steps: Vec::new(), detectors, parted: Vec::new() }
    }

    /// Takes in a reading; what was found with it, each axis once.
    pub fn push(&mut self, compared: ReadingDifference) -> Vec<Parted> {
        self.open.push(compared);
        let ended_s = self.steps.last().map_or(f64::NEG_INFINITY, |step| step.time_s);
        // Half a millisecond early is better than a whole reading late.
        let lasts = compared.time_s - ended_s > STEP_S - 0.5e-3;
        if lasts && self.open.len() >= self.least { self.close() } else { Vec::new() }
    }

    /// Whether anything was compared.
    pub fn has_compared(&self) -> bool {
        !self.steps.is_empty() || !self.open.is_empty()
    }

    /// Axes that no longer follow the model so far.
    pub fn parted(&self) -> &[Parted] {
        &self.parted
    }

    /// Ends a step.
    fn close(&mut self) -> Vec<Parted> {
        let readings = std::mem::take(&mut self.open);
        let Some(last) = readings.last() else { return Vec::new() };
        let count = readings.len() as f64;
        let of_median = if readings.len() > 2 { MEDIAN_OVER_MEAN } else { 1.0 };
        let each =
            |value: &dyn Fn(&ReadingDifference) -> f64| readings.iter().map(value).collect::<Vec<f64>>();
        let step = ReadingDifference {
            difference: [0, 1].map(|axis: usize| median(each(&|one| one.difference[axis]))),
            possible: [0, 1]
                .map(|axis: usize| each(&|one| one.possible[axis]).into_iter().fold(0.0, f64::max)),
            noise: of_median * last.noise / count.sqrt(),
            ..*last
        };
        self.steps.push(step);
        let mut departures = Vec::new();
        for (number, detector) in self.detectors.iter_mut().enumerate() {
            let axis = AXES[number];
            let [difference, possible] =
                [step.difference[number], step.possible[number]].map(|value| value / step.noise);
            let departure = detector.step(difference, possible, 0.0);
            let is_new = self.parted.iter().all(|parted| parted.axis != axis);
            if let Some(Departure { since, sigma, .. }) = departure.filter(|_| is_new) {
                let from = usize::try_from(since).unwrap_or(usize::MAX).min(self.steps.len() - 1);
                let since_then = &self.steps[from..];
                let finite =
                    since_then.iter().map(|one| one.difference[number]).filter(|one| one.is_finite());
                let (sum, count) = finite.fold((0.0, 0.0), |(sum, count), one| (sum + one, count + 1.0));
                let began = since_then[0];
                departures.push(Parted {
                    axis,
                    since_s: began.time_s,
                    found_s: step.time_s,
                    displacement_mm: began.displacement_mm[number],
                    depth_mm: Some(began.depth_mm),
                    difference: (self.difference)(sum / count),
                    sigma,
                });
            }
        }
        self.parted.extend(&departures);
        departures
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::draws::Random;

    const NOISE: f64 = 0.02;

    /// Differences of a run of so many seconds at ten readings a second, with what is wrong added along y.
    fn followed(seed: u64, until_s: f64, fault: impl Fn(f64) -> f64) -> Vec<Parted> {
        let (mut comparer, mut random) = (Comparer::of_tip(), Random::new(seed, 0));
        let mut departures = Vec::new();
        for number in 0..(until_s / 0.1) as usize {
            let time_s = 0.1 * number as f64;
            let compared = ReadingDifference {
                time_s,
                displacement_mm: [0.0, 1.0],
                depth_mm: 4.0 * time_s,
                difference: [NOISE * random.normal(), NOISE * random.normal() + fault(time_s)],
                possible: [0.05; 2],
                noise: NOISE,
            };
            departures.extend(comparer.push(compared));
        }
        assert!(comparer.has_compared());
        assert_eq!(comparer.parted(), departures);
        departures
    }

    #[test]
    fn differences_within_noise_and_possible_error_are_no_departure() {
        assert_eq!(followed(1, 600.0, |_| 0.05), []);
    }

    #[test]
    fn a_difference_of_five_sigma_beyond_the_possible_error_is_found_within_a_second() {
        let departures = followed(2, 60.0, |time_s| if time_s >= 20.0 { 0.05 + 5.0 * NOISE } else { 0.0 });
        let [parted] = departures.as_slice() else { panic!("{departures:?}") };
        assert_eq!(parted.axis, "y");
        assert!(parted.found_s >= 20.0 && parted.found_s < 21.0, "{parted:?}");
        assert!((parted.since_s - 20.0).abs() < 0.5, "{parted:?}");
        let sentence = parted.sentence("20.0 s");
        assert!(sentence.starts_with("the tip along y no longer follows the model since "), "{sentence}");
        assert!(sentence.contains("mm depth: +0.1"), "{sentence}");
        let json = serde_json::to_value(parted).expect("a document");
        assert_eq!(json["channel"], "tip");
        assert!(json["mean_mm"].is_number() && json.get("mean_n").is_none(), "{json}");
    }

    /// Readings of fifty a second are gathered into steps, and readings that are missing are none.
    #[test]
    fn quick_readings_are_gathered_and_missing_ones_left_out() {
        let (mut comparer, mut random) = (Comparer::of_force(), Random::new(3, 0));
        for number in 0..20_000 {
            let difference = if number % 500 == 0 { f64::NAN } else { NOISE * random.normal() };
            let compared = ReadingDifference {
                time_s: 0.02 * f64::from(number),
                displacement_mm: [0.0; 2],
                depth_mm: 10.0,
                difference: [difference; 2],
                possible: [0.0; 2],
                noise: NOISE,
            };
            assert_eq!(comparer.push(compared), [], "reading {number}");
        }
        assert!(comparer.steps.len() < 8_000, "{} steps", comparer.steps.len());
    }
}
