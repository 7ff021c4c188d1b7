//! Programs are read as they are meant, and mistakes named with their place.

use super::*;

#[test]
fn the_built_in_programs_are_valid() {
    for (name, _) in BUILT_IN {
        let program = Program::load(name).unwrap();
        assert!(program.steps.iter().any(|step| step.sweep), "{name} takes no sweep");
        // Holds at the end are holds at rest.
        let mut steps = program.steps.iter().rev().map(|planned| planned.step);
        let last = steps.find(|step| matches!(step, Step::Move { .. }));
        assert!(matches!(last, Some(Step::Move { x_um: 0, y_um: 0, .. })), "{name}");
    }
}

#[test]
fn a_move_names_its_axes_and_speed() {
    let program = Program::parse("p", "name = 'p'\n[[step]]\nmove_x_mm = -0.5\nspeed_mm_s = 2").unwrap();
    assert_eq!(program.device_steps(), [Step::Move { x_um: -500, y_um: 0, speed_um_s: 2_000 }]);
}

#[test]
fn mistakes_name_the_step_or_the_line() {
    fn message(text: &str) -> String {
        Program::parse("p.toml", text).unwrap_err().to_string()
    }
    let two_actions = "name = 'p'\n[[step]]\nhold_s = 1\n[[step]]\nhold_s = 1\ntare_s = 1\n";
    assert_eq!(
        message(two_actions),
        "p.toml:4:1: step 2: expected exactly one of `move_x_mm`/`move_y_mm`, `ramp_x_mm`/`ramp_y_mm`, \
         `staircase_x_mm`/`staircase_y_mm`, `hold_s`, `tare_s`"
    );
    assert_eq!(message("name = 'p'"), "p.toml:1:1: 0 steps, expected 1 to 64");
    assert!(
        message("name = 'p'\n[[step]]\nhold_ms = 1")
            .contains("p.toml:3:1: step.hold_ms: \"hold_ms\" is not known")
    );
    let sweep = "name = 'p'\n[[step]]\nmove_y_mm = 1\nsweep = true\n";
    assert!(message(sweep).contains("belongs to a hold"));
    assert!(
        message("name = 'p'\n[[step]]\nhold_s = nan")
            .contains("p.toml:3:10: step.hold_s: not a finite number, expected a number from 0.001 to 86400")
    );
    assert!(
        message("name = 'p'\n[[step]]\nmove_y_mm = inf").contains(
            "p.toml:3:13: step.move_y_mm: not a finite number, expected a number from -1000 to 1000"
        )
    );
    assert!(
        Program::load("no-such").unwrap_err().to_string().contains("displace, staircase, quick-staircase")
    );
}

#[test]
fn ramps_and_staircases() {
    let text = "name = 'p'\n[[step]]\nramp_x_mm = 0.4\nduration_s = 2.5\n[[step]]\nstaircase_y_mm = 0.9\nlevels = 3\n\
                hold_s = 1\nspeed_mm_s = 2\nsweep = true\n[[step]]\nstaircase_x_mm = -1\nlevels = 1\nhold_s = 0.5\n";
    let program = Program::parse("p", text).unwrap();
    fn move_to(x_um: i32, y_um: i32, speed_um_s: u32) -> Step {
        Step::Move { x_um, y_um, speed_um_s }
    }
    let (long, short) = (Step::Hold { duration_ms: 1_000 }, Step::Hold { duration_ms: 500 });
    assert_eq!(
        program.device_steps(),
        [
            Step::Ramp { x_um: 400, y_um: 0, duration_ms: 2_500 },
            move_to(267, 300, 2_000),
            long,
            move_to(133, 600, 2_000),
            long,
            move_to(0, 900, 2_000),
            long,
            move_to(-1_000, 0, 1_000),
            short,
        ]
    );
    let sweeps: Vec<usize> =
        (0..).zip(&program.steps).filter(|(_, s)| s.sweep).map(|(index, _)| index).collect();
    assert_eq!(sweeps, [2, 4, 6]);
}

#[test]
fn mistakes_in_ramps_and_staircases_are_named() {
    for (step, expected) in [
        ("ramp_y_mm = 1", "step 1: a ramp needs `duration_s`"),
        ("ramp_y_mm = 1\nduration_s = 0", "step.duration_s: 0 is out of range, expected a number from 0.001"),
        ("ramp_y_mm = 1\nduration_s = 1\nspeed_mm_s = 1", "`speed_mm_s` belongs to a move or a staircase"),
        (
            "ramp_y_mm = nan\nduration_s = 1",
            "p:3:13: step.ramp_y_mm: not a finite number, expected a number from -1000 to 1000",
        ),
        ("hold_s = 1\nduration_s = 1", "`duration_s` belongs to a ramp"),
        ("hold_s = 1\nlevels = 1", "`levels` belongs to a staircase"),
        ("move_y_mm = 1\nramp_y_mm = 1\nduration_s = 1", "expected exactly one of"),
        ("staircase_y_mm = 1\nlevels = 2", "a staircase needs `hold_s`"),
        ("staircase_y_mm = 1\nhold_s = 2", "a staircase needs `levels`"),
        (
            "staircase_y_mm = 1\nhold_s = 2\nlevels = 0",
            "p:5:10: step.levels: 0 is out of range, expected a number from 1 to 32",
        ),
        (
            "staircase_y_mm = 1\nhold_s = 2\nlevels = 1.5",
            "step.levels: 1.5 is not a whole number, expected a whole number from 1 to 32",
        ),
        ("staircase_y_mm = 1\nhold_s = 2\nlevels = -1", "p:5:10: step.levels: -1 is out of range"),
        ("staircase_y_mm = 0\nhold_s = 2\nlevels = 2", "must lead to another place"),
    ] {
        let message = Program::parse("p", &format!("name = 'p'\n[[step]]\n{step}")).unwrap_err().to_string();
        assert!(message.contains(expected), "{message}");
    }
    let stairs = "[[step]]\nstaircase_y_mm = 1\nlevels = 32\nhold_s = 1\n";
    assert_eq!(Program::parse("p", &format!("name = 'p'\n{stairs}")).unwrap().steps.len(), 64);
    let message = Program::parse("p", &format!("name = 'p'\n{stairs}[[step]]\nhold_s = 1\n")).unwrap_err();
    assert_eq!(
        message.to_string(),
        "p:6:1: 65 steps on the device (2 in the file; each level of a staircase is a move and a hold), expected 1 to 64"
    );
}
