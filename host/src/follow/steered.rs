//! A steered insertion against the controller's own posterior: force at guide 2 and tip.

use inference::follow::{Comparer, Parted, ReadingDifference};
use serde::Serialize;
use std::fmt::{self, Display};
use steering::{ComparedChannel, Comparison};

/// Follows what a run compares.
#[derive(Debug)]
pub struct SteeredFollower {
    force: Comparer,
    force_from_stop: Comparer,
    tip: Comparer,
    parted: Vec<Parted>,
}

impl Default for SteeredFollower {
    fn default() -> Self {
        Self {
            force: Comparer::of_force(),
            force_from_stop: Comparer::of_force(),
            tip: Comparer::of_tip(),
            parted: Vec::new(),
        }
    }
}

impl SteeredFollower {
    /// Takes in a comparison; what was found with it, each axis of a channel once.
    pub fn take(&mut self, comparison: &Comparison) -> Vec<Parted> {
        let Comparison { t_s, depth_mm, guide_mm, channel, difference, possible, noise } = *comparison;
        let comparer = match channel {
            ComparedChannel::Force => &mut self.force,
            ComparedChannel::ForceFromStop => &mut self.force_from_stop,
            ComparedChannel::Tip => &mut self.tip,
        };
        let departures = comparer.push(ReadingDifference {
            time_s: t_s,
            displacement_mm: guide_mm,
            depth_mm,
            difference,
            possible,
            noise,
        });
        // The force is compared in two ways; what both find is one thing.
        let is_known = |parted: &Parted| {
            self.parted
                .iter()
                .any(|known| known.axis == parted.axis && known.difference.is_as(parted.difference))
        };
        let new: Vec<Parted> = departures.into_iter().filter(|parted| !is_known(parted)).collect();
        self.parted.extend(&new);
        new
    }

    /// ModelAgreement so far.
    pub fn agreement(&self) -> ModelAgreement {
        ModelAgreement {
            force_compared: self.force.has_compared(),
            tip_compared: self.tip.has_compared(),
            parted: self.parted.clone(),
        }
    }
}

/// Since when a departure began, on the clock of what is steered.
pub fn sentence_of_plant(parted: &Parted) -> String {
    parted.sentence(format_args!("{:.1} s of the plant's clock", parted.since_s))
}

/// ModelAgreement of a steered run with what its controller expected.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ModelAgreement {
    /// Whether forces were compared: without, none came, or their noise is not known.
    pub force_compared: bool,
    /// Whether readings of the tip were compared.
    pub tip_compared: bool,
    /// Where a channel no longer agreed.
    pub parted: Vec<Parted>,
}

impl Display for ModelAgreement {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { force_compared, tip_compared, parted } = self;
        if parted.is_empty() {
            return match (force_compared, tip_compared) {
                (true, true) => writeln!(f, "model        force and tip follow it"),
                (true, false) => writeln!(f, "model        the force follows it"),
                (false, true) => writeln!(f, "model        the tip follows it"),
                (false, false) => Ok(()),
            };
        }
        parted.iter().try_for_each(|parted| writeln!(f, "warning      {}", sentence_of_plant(parted)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use steering::{Answer, Command, End, Event, Options, Plant, PlantError, Statement, steer};
    use worlds::steering::{Kind, SimulatedPlant, reachable_target, world};

    const SEED: u64 = 2_718;
    const DEPTH_MM: f64 = 80.0;

    /// A plant with something wrong, by a function of what it answers.
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

    fn followed(number: u64, fault: impl FnMut(&mut Answer)) -> ModelAgreement {
        let plant = world(Kind::Plain, SEED, number);
        let target = reachable_target(&plant, DEPTH_MM, SEED, number).expect("a target");
        let mut follower = SteeredFollower::default();
        let mut plant = Faulty { plant, fault };
        let run = steer(&mut plant, &Options::new(target), &mut |event| {
            if let Event::Compared(comparison) = event {
                follower.take(comparison);
            }
        });
        run.expect("a run");
        follower.agreement()
    }

    #[test]
    fn sound_plants_follow_their_model() {
        for number in 0..4 {
            let agreement = followed(number, |_| {});
            assert_eq!(agreement.parted, [], "{number}");
            assert_eq!(agreement.to_string(), "model        force and tip follow it\n");
        }
    }

    /// A force that jumps, a needle that slips in its guide, a tracker that is pushed: each is found within two seconds, by channel and axis.
    #[test]
    fn faults_are_found_within_two_seconds() {
        let from_mm = 42.0;
        let (mut jumped_s, mut pushed_s) = (f64::NAN, f64::NAN);
        let force = followed(1, |answer| {
            if answer.depth_mm > from_mm {
                jumped_s = jumped_s.min(answer.t_s);
                answer.force_y_n = answer.force_y_n.map(|n| n + 1.0);
            }
        });
        let tip = followed(1, |answer| {
            if answer.depth_mm > from_mm {
                pushed_s = pushed_s.min(answer.t_s);
                answer.tip_x_mm += 1.6;
            }
        });
        for (agreement, channel, axis, began_s) in
            [(force, "the force along y", "y", jumped_s), (tip, "the tip along x", "x", pushed_s)]
        {
            let first = agreement.parted.first().unwrap_or_else(|| panic!("{channel}: nothing found"));
            assert_eq!(first.axis, axis, "{agreement}");
            // A tip reading counts when it was taken, which is before it arrives.
            assert!(first.found_s > began_s - 0.5 && first.found_s < began_s + 2.0, "{began_s}: {first:?}");
            assert!(agreement.to_string().contains(channel), "{agreement}");
        }
    }
}
