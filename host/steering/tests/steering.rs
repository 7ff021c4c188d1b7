//! Runs against a plant that shares no computation with the forward model.

use std::io::Write;
use std::sync::{Arc, Mutex};
use steering::{
    Answer, Command, End, Event, Options, Outcome, Plant, PlantError, Record, Recorded, ReplayPlant, Run,
    Statement, SteerError, steer,
};
use worlds::steering::{Kind, SimulatedPlant, reachable_target, world};

const SEED: u64 = 4711;
const DEPTH_MM: f64 = 60.0;

fn drawn(number: u64) -> (SimulatedPlant, Options) {
    let plant = world(Kind::Plain, SEED, number);
    let target = reachable_target(&plant, DEPTH_MM, SEED, number).expect("a target");
    (plant, Options::new(target))
}

fn carried_out(plant: &mut dyn Plant, options: &Options) -> Result<Run, SteerError> {
    steer(plant, options, &mut |_| {})
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

/// A plant whose answers something else changes, from a depth on.
struct Changed<F> {
    plant: SimulatedPlant,
    change: F,
    commands: Vec<Command>,
}

impl<F: FnMut(&mut Answer)> Plant for Changed<F> {
    fn start(&mut self) -> Result<Statement, PlantError> {
        self.plant.start()
    }

    fn step(&mut self, command: &Command) -> Result<Answer, PlantError> {
        self.commands.push(*command);
        let mut answer = self.plant.step(command)?;
        (self.change)(&mut answer);
        Ok(answer)
    }

    fn end(&mut self) -> Result<End, PlantError> {
        self.plant.end()
    }
}

#[test]
fn the_needle_arrives_nearer_than_without_steering_and_within_limits() {
    let (mut steered_mm, mut unsteered_mm) = (0.0, 0.0);
    for number in 0..3 {
        let (plant, options) = drawn(number);
        let run = carried_out(&mut plant.clone(), &options).expect("a run");
        assert_eq!(run.outcome, Outcome::Arrived);
        let broken = run.end.as_ref().and_then(|end| end.limits_broken).expect("counted");
        assert_eq!(broken.total(), 0, "{broken:?}");
        let still = Options { steered: false, ..options };
        steered_mm += run.miss_mm.expect("a miss");
        unsteered_mm += carried_out(&mut plant.clone(), &still).expect("a run").miss_mm.expect("a miss");
    }
    assert!(steered_mm < 0.4 * unsteered_mm, "{steered_mm} mm, without steering {unsteered_mm} mm");
}

#[test]
fn a_replay_repeats_every_command_and_decision() {
    let (plant, options) = drawn(4);
    let written = Kept::default();
    let record = Record::new(written.clone());
    record.note("options", &options);
    let options: Options =
        serde_json::from_str(&serde_json::to_string(&options).expect("text")).expect("the same");
    let mut recorded = Recorded { plant, record: record.clone() };
    let run = steer(&mut recorded, &options, &mut |event| {
        if let Event::Decision(decision) = event {
            record.note("decision", decision);
        }
    })
    .expect("a run");
    let text = String::from_utf8(written.0.lock().expect("not poisoned").clone()).expect("text");
    let mut replayed = ReplayPlant::new(&text).expect("a record");
    let options = replayed.options().clone();
    let again = carried_out(&mut replayed, &options).expect("the same run");
    assert_eq!(serde_json::to_string(&again).expect("text"), serde_json::to_string(&run).expect("text"));
    assert_eq!(replayed.decisions().len(), run.decisions.len());
    // A record that was changed is found out.
    let changed = text.replace("\"tip_x_mm\":0.", "\"tip_x_mm\":0.9");
    let error = carried_out(&mut ReplayPlant::new(&changed).expect("a record"), &options);
    assert!(matches!(error, Err(SteerError::Plant(PlantError::Differs { .. }))), "{error:?}");
}

/// A sensor that fails while the needle is pushed holds the needle, and then ends the run.
#[test]
fn a_tip_sensor_that_fails_holds_the_needle_and_is_named() {
    type Fails = fn(&mut Answer, &Answer);
    let failures: [(Fails, &str); 5] = [
        (silent, "tip_silent"),
        (frozen, "tip_frozen"),
        (invalid, "tip_silent"),
        (jump_far, "tip_outside_band"),
        (late, "tip_late"),
    ];
    for (fails, name) in failures {
        let (plant, options) = drawn(1);
        let mut last: Option<Answer> = None;
        let change = |answer: &mut Answer| match &last {
            Some(last) if answer.depth_mm > 22.0 => fails(answer, last),
            _ => last = Some(answer.clone()),
        };
        let mut plant = Changed { plant, change, commands: Vec::new() };
        let error = carried_out(&mut plant, &options).expect_err("a fault");
        assert_eq!(error.name(), name, "{error}");
        let deepest_mm = plant.commands.last().expect("commands").depth_mm;
        let held_commands = plant.commands.iter().rev().take_while(|command| command.depth_mm == deepest_mm);
        let held_duration_s = held_commands
            .last()
            .map_or(0.0, |first| plant.commands[plant.commands.len() - 1].t_s - first.t_s);
        assert!((1.8..4.5).contains(&held_duration_s), "{name}: held for {held_duration_s} s");
        // Pushed for about two seconds at most: 2 s times 4 mm/s beyond 22 mm, rests not counted.
        assert!(deepest_mm < 22.0 + 12.0, "{name}: stopped at {deepest_mm} mm");
    }
}

fn late(answer: &mut Answer, _: &Answer) {
    answer.tip_t_s = Some(answer.t_s - 3.0)
}

fn jump_far(answer: &mut Answer, _: &Answer) {
    answer.tip_x_mm += 25.0
}

fn invalid(answer: &mut Answer, _: &Answer) {
    answer.valid = false
}

fn frozen(answer: &mut Answer, last: &Answer) {
    (answer.tip_x_mm, answer.tip_y_mm) = (last.tip_x_mm, last.tip_y_mm)
}

fn silent(answer: &mut Answer, last: &Answer) {
    (answer.tip_seq, answer.tip_x_mm, answer.tip_y_mm, answer.tip_t_s) =
        (last.tip_seq, last.tip_x_mm, last.tip_y_mm, last.tip_t_s);
}

/// A needle that slips back out of the tissue ends the run at once.
#[test]
fn a_needle_that_was_let_go_ends_the_run() {
    let (plant, options) = drawn(1);
    let change = |answer: &mut Answer| {
        if answer.depth_mm > 22.0 {
            answer.depth_mm -= 4.0;
        }
    };
    let mut plant = Changed { plant, change, commands: Vec::new() };
    let error = carried_out(&mut plant, &options).expect_err("a fault");
    assert_eq!(error.name(), "needle_off_depth", "{error}");
    assert!(plant.commands.last().is_some_and(|command| command.depth_mm < 24.0));
}

/// A rig that makes each guide move to its end gets one command for it.
#[test]
fn guide_moves_are_one_step_where_the_rig_states_it() {
    let (mut plant, options) = drawn(0);
    let (steps, decided) = moves(&plant, &options);
    assert!(steps > decided, "{steps} steps for {decided} moves");
    plant.stated.rig.guide_moves_in_one_step = true;
    let (steps, decided) = moves(&plant, &options);
    assert!(steps > 3 && steps <= decided, "{steps} steps for {decided} moves");
}

fn moves(plant: &SimulatedPlant, options: &Options) -> (usize, usize) {
    let mut plant = Changed { plant: plant.clone(), change: |_: &mut Answer| {}, commands: Vec::new() };
    let run = carried_out(&mut plant, options).expect("a run");
    let steps = plant.commands.windows(2).filter(|pair| guide_of(&pair[0]) != guide_of(&pair[1])).count();
    (steps, run.decisions.iter().filter(|one| one.guide_from_mm != one.guide_to_mm).count())
}

fn guide_of(command: &Command) -> (f64, f64) {
    (command.guide_x_mm, command.guide_y_mm)
}

/// A sensor that comes back in time does not end the run.
#[test]
fn a_short_silence_is_waited_for() {
    let (plant, options) = drawn(2);
    let change = |answer: &mut Answer| {
        if answer.t_s > 8.0 && answer.t_s < 11.0 {
            answer.valid = false;
        }
    };
    let mut plant = Changed { plant, change, commands: Vec::new() };
    let run = carried_out(&mut plant, &options).expect("a run");
    assert_eq!(run.outcome, Outcome::Arrived);
}

#[test]
fn a_target_out_of_reach_is_refused_before_the_first_step() {
    let (plant, options) = drawn(3);
    let options = Options { target_mm: [60.0, 0.0, DEPTH_MM], ..options };
    let mut plant = Changed { plant, change: |_: &mut Answer| {}, commands: Vec::new() };
    let run = carried_out(&mut plant, &options).expect("a run");
    let Outcome::Refused { nearest_mm: [x, _], distance_mm, limited_by: Some(limit), cause } = run.outcome
    else {
        panic!("{:?}", run.outcome)
    };
    assert!(cause.contains(&limit) && cause.contains("nearest point"), "{cause}");
    assert!(plant.commands.is_empty());
    assert!(x > 0.0 && (x + distance_mm - 60.0).abs() < 5.0, "{x} mm, {distance_mm} mm away");
}

#[test]
fn a_target_beyond_the_plants_depth_is_an_error() {
    let (mut plant, options) = drawn(3);
    for depth_mm in [500.0, -3.0, f64::NAN] {
        let options = Options { target_mm: [0.0, 0.0, depth_mm], ..options.clone() };
        let error = carried_out(&mut plant, &options).expect_err("an error");
        assert_eq!(error.name(), "target", "{error}");
    }
}
