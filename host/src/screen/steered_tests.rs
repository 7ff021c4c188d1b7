//! The screen of a run as it is drawn: texts that must be there, places of marks, and sizes that must not matter.

use super::*;
use steering::{Answer, PlannedRotation};

fn decision(guide_to_mm: [f64; 2]) -> Decision {
    let path = [(20.0, 0.4), (60.0, 2.0), (100.0, 3.0)];
    Decision {
        t_s: 5.0,
        depth_mm: 20.0,
        guide_from_mm: [0.0, 0.0],
        guide_to_mm,
        bevel_deg: 0.0,
        plan_depth_mm: vec![20.0, 25.0, 30.0],
        plan_guide_mm: vec![guide_to_mm; 3],
        expected_tip_mm: [3.01, -2.0],
        covariance_mm2: [0.04, 0.0, 0.04],
        within: vec![Probability { radius_mm: 0.5, probability: 0.87 }],
        path: path
            .iter()
            .map(|(depth_mm, x)| PathPoint { depth_mm: *depth_mm, tip_mm: [*x, -0.5 * x], sd_mm: 0.3 })
            .collect(),
        unsteered_miss_mm: 3.61,
        modulus_kpa: vec![12.0; 5],
        modulus_sd_ln: vec![0.2; 5],
        tip_load_n: 0.2,
        cut_angle_probability: 0.1,
        misfit: 1.0,
        limited_by: Some("force"),
        limits: None,
        rotations: Vec::new(),
    }
}

fn answer(seq: i64, depth_mm: f64, tip_x_mm: f64, valid: bool) -> Answer {
    let text = format!(
        r#"{{"t_s":1.0,"depth_mm":{depth_mm},"guide_x_mm":-1.25,"guide_y_mm":0.5,"bevel_deg":0,"force_x_n":3.0,"force_y_n":4.0,
        "tip_seq":{seq},"tip_x_mm":{tip_x_mm},"tip_y_mm":0.1,"tip_t_s":null,"valid":{valid}}}"#
    );
    serde_json::from_str(&text).expect("an answer")
}

fn running() -> SteerView {
    let mut view = SteerView::new([3.0, -2.0, 100.0]);
    let reachable_mm = vec![[-6.0, -5.0], [6.0, -5.0], [6.0, 5.0], [-6.0, 5.0]];
    view.take(&Event::Forecast { reachable_mm, within: Vec::new(), limits: Vec::new() });
    for i in 0..20 {
        view.take(&Event::Answer(&answer(i, f64::from(i as u8), 0.02 * i as f64, true)));
    }
    view.take(&Event::Decision(&decision([-1.3, 0.5])));
    view
}

fn has(screen: &str, texts: &[&str]) {
    for text in texts {
        assert!(screen.contains(text), "no {text:?} in\n{screen}");
    }
}

#[test]
fn all_that_matters_is_on_the_smallest_usual_terminal() {
    let view = running();
    for (width, height) in [(80, 24), (120, 40)] {
        let screen = SteerScreen(&view).to_text(width, height);
        has(
            &screen,
            &["guide steer", "target +3.00, -2.00 mm at 100.0 mm", "tip x, mm", "tip y, mm", "at the target"],
        );
        has(&screen, &["depth        19.0 mm   guide 2 -1.25, +0.50 mm   force 5.00 N"]);
        has(
            &screen,
            &[
                "87 % within 0.5 mm",
                "expected     +3.01, -2.00 mm, sd 0.20 mm; 3.61 mm from the target unsteered",
            ],
        );
        has(
            &screen,
            &[
                "readings     20 of the tip; the move is limited by force",
                "next         move guide 2 to -1.30, +0.50 mm, then push to 25.0 mm",
            ],
        );
        assert!(screen.chars().any(|c| ('\u{2801}'..='\u{28ff}').contains(&c)), "no curve\n{screen}");
        assert_eq!(screen.matches('•').count(), 3, "the target is marked in each plot\n{screen}");
    }
}

#[test]
fn the_next_action_is_a_turn_where_one_is_due_and_then_how_the_run_ended() {
    let mut view = running();
    let turn = PlannedRotation { depth_mm: 20.0, by_deg: 124.0, bevel_deg: 124.0 };
    view.take(&Event::Decision(&Decision { rotations: vec![turn], ..decision([0.0, 0.0]) }));
    let screen = SteerScreen(&view).to_text(100, 30);
    has(&screen, &["next         turn by +124 degrees (bevel at 124 degrees), then push to 25.0 mm"]);
    assert!(!screen.contains("move guide 2"));
    view.end("arrived, 0.12 mm from the target".to_owned());
    has(&SteerScreen(&view).to_text(100, 30), &["next         arrived, 0.12 mm from the target"]);
}

#[test]
fn what_no_longer_follows_the_model_is_on_the_screen_in_full() {
    let mut view = running();
    let sentence = "the force along y no longer follows the model since 12.3 s of the plant's clock, at 40.0 mm depth: -0.300 N, 9 sigma";
    view.parted(sentence.to_owned());
    let screen = SteerScreen(&view).to_text(80, 24);
    let words: Vec<&str> = screen.split_whitespace().collect();
    let warning: Vec<&str> = sentence.split_whitespace().collect();
    assert!(words.windows(warning.len()).any(|part| part == warning), "{screen}");
    has(&screen, &["next         move guide 2 to -1.30, +0.50 mm, then push to 25.0 mm"]);
}

#[test]
fn a_reading_that_repeats_or_is_bad_is_not_shown_as_another() {
    let mut view = running();
    view.take(&Event::Answer(&answer(19, 19.0, 0.38, true)));
    view.take(&Event::Answer(&answer(20, 19.0, 9.0, false)));
    has(&SteerScreen(&view).to_text(80, 24), &["readings     20 of the tip"]);
    view.take(&Event::Answer(&answer(21, 19.0, 0.4, true)));
    has(&SteerScreen(&view).to_text(80, 24), &["readings     21 of the tip"]);
}

#[test]
fn the_target_is_right_of_the_path_and_above_it_where_it_lies_there() {
    let screen = SteerScreen(&running()).to_text(100, 40);
    // Column and row of the mark in the upper plot, that of x over depth.
    let marks: Vec<(usize, usize)> = screen
        .lines()
        .enumerate()
        .flat_map(|(row, line)| {
            line.chars().enumerate().filter(|(_, c)| *c == '•').map(move |(column, _)| (column, row))
        })
        .collect();
    let (column, row) =
        *marks.iter().filter(|(column, _)| *column < 60).min_by_key(|(_, row)| *row).expect("a mark");
    assert!(column > 52, "the target is at the end of the depths\n{screen}");
    assert!(row < 8, "3 mm is the largest x\n{screen}");
}

#[test]
fn no_size_is_too_small_and_none_too_large() {
    let views = [SteerView::new([0.0, 0.0, 50.0]), running()];
    let sizes = (0..70).step_by(3).flat_map(|width| (0..26).map(move |height| (width, height)));
    for (width, height) in sizes.chain([(1, 200), (500, 1), (80, 24), (300, 120)]) {
        for view in &views {
            SteerScreen(view).to_text(width, height);
        }
    }
}
