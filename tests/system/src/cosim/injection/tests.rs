//! An injected fault reaches the readings as it is stated.

use super::*;

const CODES: Codes = Codes { potentiometer: [2_000, 2_100], bridge: [1_000, -1_000] };
const DRIVEN: [u16; 4] = [FULL_SCALE, 0, FULL_SCALE, FULL_SCALE];
const BRAKED: [u16; 4] = [FULL_SCALE; 4];
const RELEASED: [u16; 4] = [0; 4];

fn sound(codes_per_n: f64) -> Electronics {
    Electronics::new(codes_per_n, Wiring::new(Vec::new(), 0, codes_per_n, 0.0))
}

fn request(compare: [u16; 4]) -> PlantRequest {
    PlantRequest { compare, ..PlantRequest::default() }
}

/// Runs periods from the first number on; returns the last inputs and reply.
fn run(electronics: &mut Electronics, first: u64, commands: &[[u16; 4]]) -> (BridgeInputs, PlantReply) {
    let mut last = (BridgeInputs::default(), PlantReply::default());
    for (period, compare) in (first..).zip(commands) {
        let inputs = electronics.command(period, &request(*compare), [0.0; 2]);
        last = (inputs, electronics.sense(period as u32, CODES, false));
    }
    last
}

/// The inputs and the reply of the first period with an injection.
fn with(injection: Injection) -> (BridgeInputs, PlantReply) {
    let mut electronics = sound(100.0);
    electronics.inject_when(Trigger::Now, injection);
    run(&mut electronics, 0, &[DRIVEN])
}

#[test]
fn nothing_is_injected_by_default() {
    let (inputs, reply) = with(Injection::default());
    assert_eq!(inputs, [[1.0, 0.0], [1.0, 1.0]]);
    let expected = PlantReply {
        potentiometer_codes: CODES.potentiometer,
        force_codes: CODES.bridge,
        line_bytes: 46,
        force_ready: true,
        ..PlantReply::default()
    };
    assert_eq!(reply, expected);
}

#[test]
fn force_injections_change_the_codes() {
    let spike = with(Injection { force_spike_n: Some([0.5, -1.0]), ..Injection::default() }).1;
    assert_eq!(spike.force_codes, [1_050, -1_100]);
    let saturated = with(Injection { force_saturated: Some(1), ..Injection::default() }).1;
    assert_eq!(saturated.force_codes, [1_000, FORCE_CODE_MAX]);
    assert!(!with(Injection { force_silent: true, ..Injection::default() }).1.force_ready);
    let mut once = sound(1.0);
    let saturated_once = Injection { force_saturated_once: Some(0), ..Injection::default() };
    once.inject_when(Trigger::Now, saturated_once);
    let first = run(&mut once, 0, &[RELEASED]).1;
    assert_eq!((first.force_codes[0], first.force_ready), (FORCE_CODE_MAX, true));
    assert!(!run(&mut once, 1, &[RELEASED, RELEASED]).1.force_ready);
    let mut electronics = sound(1.0);
    electronics.inject_when(Trigger::Now, Injection { force_stuck: true, ..Injection::default() });
    run(&mut electronics, 0, &[RELEASED]);
    electronics.command(1, &request(RELEASED), [0.0; 2]);
    let other_codes = Codes { bridge: [7, 7], ..CODES };
    assert_eq!(electronics.sense(1, other_codes, false).force_codes, [0; 2]);
}

#[test]
fn potentiometer_injections_stay_within_the_converter() {
    let injection = Injection {
        potentiometer_jump_codes: [-3_000, 50],
        conversion_us: 30,
        line_baud: Some(35_000),
        ..Injection::default()
    };
    let reply = with(injection).1;
    assert_eq!(reply.potentiometer_codes, [0, 2_150]);
    assert_eq!((reply.potentiometer_conversion_us, reply.line_bytes), (30, 3));
    let open =
        Injection { potentiometer_open: Some(0), potentiometer_short: Some(1), ..Injection::default() };
    assert_eq!(with(open).1.potentiometer_codes, [POTENTIOMETER_CODE_MAX, 0]);
}

#[test]
fn motors_get_what_the_injection_leaves_them() {
    let base = Injection::default();
    assert_eq!(inputs_with(Injection { jammed: Some(0), ..base }), [[0.0; 2], [1.0; 2]]);
    assert_eq!(inputs_with(Injection { weak: Some((0, 0.25)), ..base }), [[0.25, 0.0], [1.0; 2]]);
    assert_eq!(inputs_with(Injection { runaway: Some((1, -0.75)), ..base }), [[1.0, 0.0], [0.25, 1.0]]);
}

fn inputs_with(injection: Injection) -> [[f64; 2]; 2] {
    with(injection).0
}

#[test]
fn resets_happen_once() {
    let mut electronics = sound(1.0);
    let injection = Injection { force_reset: true, brown_out: true, ..Injection::default() };
    electronics.inject_when(Trigger::Now, injection);
    let first = run(&mut electronics, 0, &[RELEASED]).1;
    assert!(first.reset_force_converter && first.brown_out);
    let second = run(&mut electronics, 1, &[RELEASED]).1;
    assert!(!second.reset_force_converter && !second.brown_out);
}

#[test]
fn triggers_wait_for_their_condition() {
    let stop = Injection { emergency_stop: true, ..Injection::default() };
    let mut electronics = sound(1.0);
    electronics.inject_when(Trigger::Driving { for_periods: 2 }, stop);
    assert!(!run(&mut electronics, 0, &[DRIVEN, BRAKED, DRIVEN]).1.emergency_stop);
    assert!(run(&mut electronics, 3, &[DRIVEN]).1.emergency_stop);
    let mut electronics = sound(1.0);
    electronics.inject_when(Trigger::AtStep(2), stop);
    assert!(!run(&mut electronics, 0, &[RELEASED; 2]).1.emergency_stop);
    assert!(run(&mut electronics, 2, &[RELEASED]).1.emergency_stop);
    let mut electronics = sound(1.0);
    electronics.inject_when(Trigger::Beyond { axis: 1, position_mm: -2.0 }, stop);
    for (y_m, expected) in [(2.5e-3, false), (-1.9e-3, false), (-2.1e-3, true)] {
        electronics.command(0, &request(RELEASED), [0.0, y_m]);
        assert_eq!(electronics.sense(0, CODES, false).emergency_stop, expected, "{y_m}");
    }
}

#[test]
fn an_injection_with_an_end_is_over_by_itself_and_leaves_its_reaction() {
    let stop = Injection { emergency_stop: true, for_periods: Some(3), ..Injection::default() };
    let mut electronics = sound(1.0);
    electronics.inject_when(Trigger::AtStep(1), stop);
    let pressed: Vec<bool> =
        (0..6).map(|period| run(&mut electronics, period, &[RELEASED]).1.emergency_stop).collect();
    assert_eq!(pressed, [false, true, true, true, false, false]);
    assert_eq!(electronics.reaction().unwrap().injected_at_step, 1);
}

#[test]
fn a_reaction_lasts_until_the_release_that_stays() {
    let stop = Injection { emergency_stop: true, ..Injection::default() };
    let mut electronics = sound(1.0);
    electronics.inject_when(Trigger::AtStep(10), stop);
    run(&mut electronics, 9, &[DRIVEN]);
    assert_eq!(electronics.reaction(), None);
    run(&mut electronics, 10, &[DRIVEN, DRIVEN, BRAKED]);
    let reaction = electronics.reaction().unwrap();
    assert_eq!((reaction.injected_at_step, reaction.periods()), (10, None), "a brake is no release");
    run(&mut electronics, 13, &[RELEASED, RELEASED]);
    let reaction = electronics.reaction().unwrap();
    assert_eq!((reaction.periods(), reaction.driven_after_release), (Some(3), 0));
    run(&mut electronics, 15, &[DRIVEN, BRAKED, RELEASED]);
    let reaction = electronics.reaction().unwrap();
    assert_eq!((reaction.periods(), reaction.driven_after_release), (Some(7), 2));
}

#[test]
fn the_next_request_is_one_period_and_the_end_of_an_injection_keeps_it() {
    let stop = Injection { emergency_stop: true, ..Injection::default() };
    let mut electronics = sound(1.0);
    electronics.inject_when(Trigger::Now, stop);
    run(&mut electronics, 4, &[DRIVEN, RELEASED]);
    electronics.inject_when(Trigger::Now, Injection::default());
    assert!(!run(&mut electronics, 6, &[RELEASED]).1.emergency_stop);
    assert_eq!(electronics.reaction().unwrap().periods(), Some(1));
}
