//! Readings against what the controller expects of them, on a plant that shares no computation with the forward model.

use steering::{
    Answer, Command, ComparedChannel, Comparison, End, Event, Options, Plant, PlantError, Statement, steer,
};
use worlds::steering::{Kind, SimulatedPlant, reachable_target, world};

const SEED: u64 = 815;
const DEPTH_MM: f64 = 60.0;

/// A plant with something wrong from a depth on.
struct Faulty<F> {
    plant: SimulatedPlant,
    fault: F,
}

impl<F: FnMut(&mut Answer)> Plant for Faulty<F> {
    fn start(&mut self) -> Result<Statement, PlantError> {
        self.plant.start()
    }

    fn step(&mut self, command: &Command) -> Result<Answer, PlantError> {
        let mut answer = self.plant.step(command)?;
        (self.fault)(&mut answer);
        Ok(answer)
    }

    fn end(&mut self) -> Result<End, PlantError> {
        self.plant.end()
    }
}

fn compared(number: u64, fault: impl FnMut(&mut Answer)) -> Vec<Comparison> {
    let plant = world(Kind::Plain, SEED, number);
    let target = reachable_target(&plant, DEPTH_MM, SEED, number).expect("a target");
    let mut comparisons = Vec::new();
    let mut plant = Faulty { plant, fault };
    steer(&mut plant, &Options::new(target), &mut |event| {
        if let Event::Compared(comparison) = event {
            comparisons.push(**comparison);
        }
    })
    .expect("a run");
    comparisons
}

/// Standard deviations of the reading beyond what the expectation may be off, the larger of both axes.
fn beyond(comparison: &Comparison) -> f64 {
    let Comparison { difference, possible, noise, .. } = comparison;
    (0..2).map(|axis| (difference[axis].abs() - possible[axis]) / noise).fold(f64::NEG_INFINITY, f64::max)
}

#[test]
fn force_and_tip_of_a_sound_plant_are_within_what_is_expected_of_them() {
    for number in 0..6 {
        let comparisons = compared(number, |_| {});
        for channel in [ComparedChannel::Force, ComparedChannel::ForceFromStop, ComparedChannel::Tip] {
            let values: Vec<f64> =
                comparisons.iter().filter(|one| one.channel == channel).map(beyond).collect();
            assert!(values.len() > 100, "{number} {channel:?}: {} comparisons", values.len());
            // Of the tip some readings are bad; of the force none is, and its noise is seldom above four standard deviations.
            let most = values.iter().copied().fold(f64::NEG_INFINITY, f64::max);
            let far = values.iter().filter(|value| **value > 2.0).count();
            let is_good = if channel == ComparedChannel::Tip { far <= values.len() / 25 } else { most < 4.0 };
            assert!(is_good, "{number} {channel:?}: {far} of {} are far, {most}", values.len());
        }
    }
}

#[test]
fn a_force_that_jumps_and_a_tip_that_leaps_are_beyond_what_is_expected() {
    let from_mm = 31.0;
    let force = compared(1, |answer| {
        if answer.depth_mm > from_mm {
            answer.force_x_n = answer.force_x_n.map(|n| n + 1.5);
        }
    });
    let tip = compared(1, |answer| {
        if answer.depth_mm > from_mm {
            answer.tip_y_mm += 2.0;
        }
    });
    for (comparisons, channel) in [
        (force.clone(), ComparedChannel::Force),
        (force, ComparedChannel::ForceFromStop),
        (tip, ComparedChannel::Tip),
    ] {
        let of_channel = || comparisons.iter().filter(|one| one.channel == channel);
        let after = of_channel().filter(|one| one.depth_mm > from_mm + 0.5).take(10);
        let after: Vec<f64> = after.map(beyond).collect();
        assert!(after.iter().filter(|value| **value > 3.0).count() >= 8, "{channel:?}: {after:?}");
    }
}
