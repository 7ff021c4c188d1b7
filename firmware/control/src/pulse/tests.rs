use super::*;

const PULSE: Pulse = Pulse { axis: 0, duty_permille: 350, periods: 50 };

/// Runs a pulse on motors of this dead band and speed; `sense` converts the true positions to readings. Returns the report and
/// the largest true distance from the start.
fn run(pulse: Pulse, unit: (f32, f32), sense: impl Fn([f32; 2]) -> Sample) -> (PulseReport, f32) {
    let mut pulser = Pulser::new([0; 2]);
    pulser.begin(pulse, [0.0; 2], 10_000.0, [false; 2]).expect("within the limits");
    let (dead_band, full_um_s) = unit;
    let (mut position_um, mut speed, mut furthest) = ([0.0_f32; 2], [0.0_f32; 2], 0.0_f32);
    for _ in 0..400 {
        let duty = match pulser.step(&sense(position_um)).expect("under way") {
            PulseProgress::Ended(report) => return (report, furthest),
            PulseProgress::Off => [0.0; 2],
            PulseProgress::Drive(duty) => duty,
        };
        for axis in 0..2 {
            let drive_fraction = ((duty[axis].abs() - dead_band) / (1.0 - dead_band)).max(0.0);
            speed[axis] += (drive_fraction.copysign(duty[axis]) * full_um_s - speed[axis]) / 12.0;
            position_um[axis] += speed[axis] * 1e-3;
            furthest = furthest.max(position_um[axis].abs());
        }
    }
    panic!("it does not end");
}

fn wired_correctly(at: [f32; 2]) -> Sample {
    Sample {
        position_counts: at.map(|um| um as i32),
        force_counts: at.map(|um| (0.4 * um) as i32),
        repeats_force: false,
    }
}

#[test]
fn moves_every_unit_enough_and_none_too_far() {
    for (unit, swap) in [
        ((0.12, 22_000.0), false),
        ((0.18, 20_000.0), false),
        ((0.24, 18_000.0), false),
        ((0.12, 22_000.0), true),
    ] {
        for duty_permille in [350, -350] {
            let (report, furthest_um) = run(Pulse { duty_permille, ..PULSE }, unit, |at: [f32; 2]| {
                if swap { wired_correctly([at[1], at[0]]) } else { wired_correctly(at) }
            });
            assert!((80.0..=220.0).contains(&furthest_um), "{furthest_um} um by {unit:?}");
            let moved = report.moved_counts[usize::from(swap)];
            assert!((moved.unsigned_abs() as f32 - furthest_um).abs() < 5.0, "{report:?}");
            assert_eq!(moved.signum(), i32::from(duty_permille.signum()));
        }
    }
}

#[test]
fn stays_within_the_bound_without_any_feedback() {
    let (report, furthest_um) = run(PULSE, (0.12, 22_000.0), |_| Sample::default());
    assert!(furthest_um <= PULSE_BOUND_UM as f32, "{furthest_um}");
    assert_eq!((report.outcome, report.driven_ms), (PulseOutcome::Completed, PULSE_LIMIT_MS));
}

#[test]
fn names_the_bound_that_ended_it() {
    let unit = (0.12, 22_000.0);
    let outcome = |sense: fn([f32; 2]) -> Sample| run(PULSE, unit, sense).0.outcome;
    assert_eq!(outcome(wired_correctly), PulseOutcome::Reached);
    assert_eq!(outcome(|at| wired_correctly([at[1], at[0]])), PulseOutcome::OtherAxis);
    assert_eq!(outcome(|at| wired_correctly([-at[0], 0.0])), PulseOutcome::Reached);
    let (report, furthest_um) = run(PULSE, unit, |at: [f32; 2]| Sample {
        force_counts: [0, (at[0] * 200.0) as i32],
        ..Sample::default()
    });
    assert_eq!(report.outcome, PulseOutcome::Force);
    assert!(report.driven_ms < 30 && furthest_um < 200.0, "{report:?} {furthest_um}");
}

#[test]
fn changes_no_force_by_more_than_a_newton_up_to_the_stated_stiffness() {
    for unit in [(0.12, 22_000.0), (0.18, 20_000.0)] {
        for stiffness_n_per_mm in 1..=protocol::PULSE_STIFFNESS_N_PER_MM {
            // 50 uN a count: 20 counts per micrometre are 1 N/mm.
            let (report, furthest_um) = run(PULSE, unit, |at: [f32; 2]| Sample {
                force_counts: at.map(|um| (um * 20.0 * stiffness_n_per_mm as f32) as i32),
                ..wired_correctly(at)
            });
            let most_n = furthest_um * 1e-3 * stiffness_n_per_mm as f32;
            assert!(most_n < 1.0, "{most_n} N on {stiffness_n_per_mm} N/mm: {report:?}");
        }
    }
}

#[test]
fn refuses_what_is_beyond_its_limits_and_what_adds_up() {
    let refusal =
        |pulse| Pulser::new([0; 2]).begin(pulse, [0.0; 2], 10_000.0, [false; 2]).expect_err("refused");
    for pulse in [
        Pulse { duty_permille: 351, ..PULSE },
        Pulse { duty_permille: -351, ..PULSE },
        Pulse { duty_permille: i16::MIN, ..PULSE },
        Pulse { duty_permille: 0, ..PULSE },
        Pulse { periods: 51, ..PULSE },
        Pulse { periods: 0, ..PULSE },
        Pulse { axis: 2, ..PULSE },
    ] {
        assert_eq!(refusal(pulse), Refusal::OutOfRange, "{pulse:?}");
    }
    let at_end = |um, proven| Pulser::new([0; 2]).begin(PULSE, [um, 0.0], 10_000.0, proven);
    assert_eq!(at_end(9_800.0, [true; 2]), Err(Refusal::OutOfTravel));
    assert_eq!(at_end(-9_990.0, [false; 2]), Ok(()));
    let mut pulser = Pulser::new([0; 2]);
    let mut pulsed = |duty_permille, proven| {
        let pulse = Pulse { duty_permille, ..PULSE };
        let begun = pulser.begin(pulse, [0.0; 2], 10_000.0, [proven; 2]);
        while pulser.step(&Sample::default()).is_some() {}
        begun
    };
    assert_eq!(pulsed(350, false), Ok(()));
    assert_eq!(pulsed(350, false), Err(Refusal::OutOfTravel));
    assert_eq!(pulsed(350, true), Ok(()));
    assert_eq!([pulsed(-350, false), pulsed(-350, false), pulsed(-350, false)], [Ok(()); 3]);
    assert_eq!(pulsed(-350, false), Err(Refusal::OutOfTravel));
    // A pulse that a restart cuts short counts in full.
    let mut pulser = Pulser::new([0; 2]);
    pulser.begin(PULSE, [0.0; 2], 10_000.0, [false; 2]).expect("begins");
    let mut restarted = Pulser::new(pulser.net());
    assert_eq!(restarted.begin(PULSE, [0.0; 2], 10_000.0, [false; 2]), Err(Refusal::OutOfTravel));
    let backward = Pulse { duty_permille: -350, ..PULSE };
    assert_eq!(restarted.begin(backward, [0.0; 2], 10_000.0, [false; 2]), Ok(()));
}

#[test]
fn a_stop_ends_a_pulse_under_way() {
    let mut pulser = Pulser::new([0; 2]);
    pulser.begin(PULSE, [0.0; 2], 10_000.0, [false; 2]).expect("begins");
    assert_eq!(pulser.begin(PULSE, [0.0; 2], 10_000.0, [false; 2]), Err(Refusal::Busy));
    for _ in 0..30 {
        pulser.step(&Sample::default());
    }
    let report = pulser.abort().expect("was under way");
    assert_eq!((report.outcome, report.driven_ms, pulser.net()), (PulseOutcome::Stopped, 11, [11, 0]));
    assert_eq!((pulser.is_active(), pulser.step(&Sample::default())), (false, None));
}
