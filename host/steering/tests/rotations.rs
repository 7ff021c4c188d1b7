//! A needle held by hand: rotations against a plant that shares no computation with the forward model.

use std::collections::BTreeSet;
use std::io::Write;
use std::sync::{Arc, Mutex};
use steering::{Decision, Event, Options, Outcome, Record, Recorded, ReplayPlant, SteerError, steer};
use worlds::steering::{Kind, SimulatedPlant, target_by_rotations, world};

const SEED: u64 = 4711;
const DEPTH_MM: f64 = 100.0;

/// A needle without actuators, and a target that it reaches by two rotations.
fn drawn(number: u64) -> (SimulatedPlant, Options) {
    let mut plant = world(Kind::Plain, SEED, number);
    plant.stated.limits.guide_travel_mm = 0.0;
    let target = target_by_rotations(&plant, DEPTH_MM, SEED, number).expect("a target");
    (plant, Options { rotations: 2, ..Options::new(target) })
}

#[derive(Clone, Default)]
struct Kept(Arc<Mutex<Vec<u8>>>);

impl Write for Kept {
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
        self.0.lock().expect("not poisoned").extend_from_slice(bytes);
        Ok(bytes.len())
    }

    fn flush(&mut self) -> std::io::Result<()> {
        Ok(())
    }
}

#[test]
fn at_most_two_rotations_bring_needles_nearer_than_none_within_limits() {
    let (mut rotated_mm, mut still_mm) = (0.0, 0.0);
    for number in 0..4 {
        let (plant, options) = drawn(number);
        let still = Options { steered: false, ..options.clone() };
        still_mm += steer(&mut plant.clone(), &still, &mut |_| {}).unwrap().miss_mm.unwrap();
        let run = steer(&mut plant.clone(), &options, &mut |_| {}).unwrap();
        assert_eq!(run.outcome, Outcome::Arrived);
        rotated_mm += run.miss_mm.unwrap();
        let turn_count = run.decisions.iter().filter_map(Decision::turn).count();
        assert!(turn_count == run.rotations && turn_count <= 2, "{turn_count}");
        assert_eq!(run.end.unwrap().limits_broken.unwrap().total(), 0);
        assert!(run.decisions.iter().all(|one| one.guide_to_mm == [0.0; 2]));
        assert!(run.within_before.is_empty());
    }
    assert!(rotated_mm < 0.4 * still_mm, "{rotated_mm} mm with rotations, {still_mm} mm without");
}

#[test]
fn cues_lead_from_stop_to_stop_to_the_target_and_the_record_replays() {
    let (plant, options) = drawn(1);
    let written = Kept::default();
    let record = Record::new(written.clone());
    record.note("options", &options);
    let (mut cues, mut bevels) = (Vec::new(), BTreeSet::new());
    let mut recorded = Recorded { plant, record: record.clone() };
    let run = steer(&mut recorded, &options, &mut |event| match event {
        Event::Decision(decision) => {
            record.note("decision", decision);
            cues.push(decision.cue(DEPTH_MM));
        }
        Event::Command(command) => {
            bevels.insert((1e6 * command.bevel_deg).round() as i64);
        }
        _ => {}
    })
    .unwrap();
    for pair in cues.windows(2) {
        assert!((pair[0].push_to_mm - pair[1].depth_mm).abs() < 1e-6, "{} {}", pair[0], pair[1]);
    }
    assert_eq!(cues.last().unwrap().push_to_mm, DEPTH_MM);
    for cue in cues.iter().filter(|cue| cue.turn_by_deg.is_some()) {
        assert!(cue.to_string().contains("turn by "), "{cue}");
        assert!(bevels.contains(&((1e6 * cue.bevel_deg).round() as i64)), "{cue} was not commanded");
    }
    let text = String::from_utf8(written.0.lock().unwrap().clone()).unwrap();
    let mut replay = ReplayPlant::new(&text).unwrap();
    let again = steer(&mut replay, &options, &mut |_| {}).unwrap();
    assert_eq!((again.decisions, again.miss_mm), (run.decisions, run.miss_mm));
}

#[test]
fn a_needle_that_cannot_be_turned_is_reported_before_anything_moves() {
    let (mut plant, options) = drawn(0);
    plant.stated.rig.can_rotate = false;
    let mut commands = 0;
    let ended = steer(&mut plant, &options, &mut |event| {
        commands += usize::from(matches!(event, Event::Command(_)));
    });
    assert!(matches!(&ended, Err(error @ SteerError::CannotRotate) if error.name() == "cannot_rotate"));
    assert_eq!(commands, 0);
}
