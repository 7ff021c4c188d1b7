//! Speed of a recorded insertion, and steps of guide 2 in it.

use super::*;

/// Depths in mm and times in s; guide 2 in mm.
fn recorded(rows: &[[f64; 3]]) -> InsertionRun {
    let column = |i: usize, unit: f64| rows.iter().map(|row| unit * row[i]).collect::<Vec<_>>();
    InsertionRun {
        tip_direction_y_rad: None,
        tip_direction_x_rad: None,
        id: "i".to_owned(),
        path: "i.csv".into(),
        depth_m: column(0, 1e-3),
        tip_y_m: column(2, 0.5e-3),
        tip_x_m: None,
        time_s: Some(column(1, 1.0)),
        rotation_rad: None,
        guide2_y_m: Some(column(2, 1e-3)),
        guide2_x_m: None,
        base_force_y_n: None,
    }
}

/// An insertion of 60 mm at 5 mm/s in rows of 0.1 s, with a rest of `rest_s` seconds after every `every` rows.
fn pushed(rest_s: f64, every: usize) -> InsertionRun {
    let mut rows = Vec::new();
    let mut time_s = 0.0;
    for step in 0..=120_usize {
        rows.push([0.5 * step as f64, time_s, 0.0]);
        if step % every == every - 1 {
            for _ in 0..(rest_s / 0.1).round() as usize {
                time_s += 0.1;
                rows.push([0.5 * step as f64, time_s, 0.0]);
            }
        }
        time_s += 0.1;
    }
    recorded(&rows)
}

#[test]
fn rests_between_pushes_do_not_slow_an_insertion_down() {
    for (rest_s, every) in [(0.0, 10), (2.0, 10), (30.0, 10), (1.0, 2)] {
        let mean_speed = speed(&pushed(rest_s, every)).expect("a speed");
        assert!((mean_speed / 5e-3 - 1.0).abs() < 1e-6, "{mean_speed} m/s with rests of {rest_s} s");
    }
    assert_eq!(speed(&InsertionRun { time_s: None, ..pushed(0.0, 10) }), None);
}

#[test]
fn a_guide_step_is_part_of_the_model() {
    for at_rest in [true, false] {
        let mut rows: Vec<[f64; 3]> = (0..=30).map(|mm| [f64::from(mm), f64::from(mm), 0.0]).collect();
        if at_rest {
            rows.push([30.0, 31.0, 1.5]);
        }
        rows.extend((31..=60).map(|mm| [f64::from(mm), f64::from(mm + 2), 1.5]));
        let run = Run::insertion(&recorded(&rows)).expect("an insertion");
        let stepped: Vec<bool> = (0..3).map(|part| run.turns_in(part)).collect();
        assert_eq!(stepped, [false, true, false], "at rest: {at_rest}");
    }
}
