//! Shapes and insertions that are given by positions, turned round, or go on behind what was meant.

use super::grid::Grid;
use super::*;
use std::fmt::Write as _;
use std::path::Path;

/// Displacement at a time, millimetres: rest, 1.2 mm from second 2 to 6, rest.
fn displaced_mm(t: f64) -> f64 {
    1.2 * ((t - 2.0).clamp(0.0, 1.0) - (t - 6.0).clamp(0.0, 1.0))
}

fn parsed(name: &str, text: &str) -> RawTable {
    Grid::parse(Path::new(name), text.as_bytes()).and_then(RawTable::new).expect("a table")
}

/// A run of a push and this table of a shape, by the columns z, y and t.
fn with_shape(rows: &[(f64, f64, f64)], y_unit: &str, zero: Zero) -> Result<Taken, TableError> {
    let mut push = "Time [s],Position [mm],Force [N]\n".to_owned();
    for i in 0..450 {
        let t = 0.02 * f64::from(i);
        let x = displaced_mm(t);
        let noise = 1e-3 * (2.3 * f64::from(i)).sin();
        let _ = writeln!(push, "{t:.2},{:.5},{:.5}", x + noise, 0.9 * x + noise);
    }
    let mut shape = "Time [s],z [mm],y [mm]\n".to_owned();
    for (t, z, y) in rows {
        let _ = writeln!(shape, "{t},{z},{y}");
    }
    let maps = ["z [mm]=z_mm".to_owned(), format!("y [mm]=deflection_y_mm:{y_unit}")];
    let mut choices: Vec<Choice> = maps.iter().map(|map| Choice::parse(map).expect("a map")).collect();
    choices.push(Choice::parse("Time [s]=time_s").expect("a map"));
    let options = Options {
        z_from: Some(ZOrigin::Surface),
        merge_on: Some("Time [s]".to_owned()),
        entry_m: 0.07,
        guide2_m: 0.06,
        zero,
        ..Options::default()
    };
    take(&[parsed("push.csv", &push), parsed("shape.csv", &shape)], &Mapping { choices }, &options)
}

/// Deflections of a needle that is displaced so.
fn bent_mm(z_mm: f64, displaced_mm: f64) -> f64 {
    displaced_mm * (-z_mm / 25.0).exp()
}

/// A sweep at a time, its deflections from where the needle is when it is straight.
fn sweep(t: f64, straight: impl Fn(f64) -> f64) -> Vec<(f64, f64, f64)> {
    [2.0, 8.0, 14.0, 20.0, 26.0]
        .map(|z_mm| (t, z_mm, straight(z_mm) + bent_mm(z_mm, displaced_mm(t))))
        .to_vec()
}

#[test]
fn a_shape_of_positions_is_counted_from_its_sweep_at_rest_or_refused() {
    // In the frame of a tracker, in which the needle is not quite along z.
    fn straight(z_mm: f64) -> f64 {
        112.4 - 0.02 * z_mm
    }
    let one = sweep(4.0, straight);
    let error = with_shape(&one, "mm", Zero::Auto).expect_err("positions").to_string();
    assert!(error.contains("these are positions") && error.contains("--zero written"), "{error}");
    let two = [sweep(1.0, straight), one.clone()].concat();
    let run = with_shape(&two, "mm", Zero::Auto).unwrap_or_else(|error| panic!("{error}"));
    let shape = run.shape.expect("a shape");
    assert_eq!(shape.z_m.len(), 5);
    for (z_m, y_m) in shape.z_m.iter().zip(&shape.y_m) {
        assert!((1e3 * y_m - bent_mm(1e3 * z_m - 70.0, 1.2)).abs() < 1e-9, "{z_m} {y_m}");
    }
    assert!(
        run.notes.iter().any(|note| note.contains("5 points of the shape before guide 2 moves")),
        "{:?}",
        run.notes
    );
    let written = with_shape(&two, "mm", Zero::Written).expect("as written");
    assert_eq!(written.shape.map(|shape| shape.z_m.len()), Some(10));
    // The straight needle is not known where it was not measured.
    let elsewhere = [sweep(1.0, straight), vec![(4.0, 40.0, 112.0)]].concat();
    let error = with_shape(&elsewhere, "mm", Zero::Auto).expect_err("beyond the sweep").to_string();
    assert!(error.contains("the straight needle at all places"), "{error}");
    // Deflections are taken as they are, and by --zero first from the sweep at rest.
    let deflections = [sweep(1.0, |_| 0.01), sweep(4.0, |_| 0.01)].concat();
    let taken = |zero| with_shape(&deflections, "mm", zero).expect("a run").shape.expect("a shape");
    assert_eq!(taken(Zero::Auto).z_m.len(), 10);
    let counted = taken(Zero::First);
    assert!(counted.z_m.len() == 5 && (1e3 * counted.y_m[0] - bent_mm(2.0, 1.2)).abs() < 1e-9);
}

#[test]
fn a_shape_that_is_bent_against_the_displacement_is_noted() {
    let noted = |unit: &str| {
        let run = with_shape(&sweep(4.0, |_| 0.0), unit, Zero::Auto).expect("a run");
        run.notes.iter().any(|note| note.contains("bent against the displacement"))
    };
    assert!(noted("-mm") && !noted("mm"));
}

#[test]
fn half_of_a_shape_and_a_file_of_which_nothing_is_taken_are_errors() {
    let push = parsed("push.csv", "Time [s],Position [mm],Force [N]\n0,0,0\n1,1,1\n2,1,1\n");
    let shape = parsed("shape.csv", "Distance from tip [mm],Deflection [mm]\n5,1.2\n10,1.1\n15,1.0\n");
    let refused = |maps: &[&str]| {
        let choices = maps.iter().map(|map| Choice::parse(map).expect("a map")).collect();
        let options = Options { z_from: Some(ZOrigin::Surface), ..Options::default() };
        let mapping = Mapping { choices };
        take(&[push.clone(), shape.clone()], &mapping, &options).expect_err("refused").to_string()
    };
    let half = refused(&["Deflection [mm]=deflection_y_mm"]);
    assert!(half.contains("deflection_y_mm: without z_mm"), "{half}");
    let half = refused(&["Distance from tip [mm]=z_mm"]);
    assert!(half.contains("z_mm: without deflection_y_mm"), "{half}");
    // A deflection that is guessed, and its place is not known.
    let wide = parsed(
        "push.csv",
        &(0..60).fold("Time [s],Position [mm],Force [N]\n".to_owned(), |text, i| {
            let t = 0.1 * f64::from(i);
            format!("{text}{t:.1},{0:.4},{0:.4}\n", displaced_mm(t))
        }),
    );
    let error = take(&[wide, shape.clone()], &Mapping::default(), &Options::default());
    let error = error.expect_err("a file without use").to_string();
    assert!(error.contains("shape.csv: none of its columns is used: \"Distance from tip [mm]\""), "{error}");
}

/// An insertion by its columns of depth and tip.
fn insertion(rows: &[(f64, f64)], depth_unit: &str, zero: Zero) -> Result<Taken, TableError> {
    let text =
        rows.iter().fold("Stage [mm],Tip y [mm]\n".to_owned(), |text, (z, y)| format!("{text}{z},{y}\n"));
    let maps = [format!("Stage [mm]=depth_mm:{depth_unit}"), "Tip y [mm]=tip_y_mm".to_owned()];
    let choices = maps.iter().map(|map| Choice::parse(map).expect("a map")).collect();
    take(&[parsed("i.csv", &text)], &Mapping { choices }, &Options { zero, ..Options::default() })
}

/// Depth and tip of an insertion to 60 mm, the depth on a stage with this origin and direction.
fn stage(origin_mm: f64, sign: f64) -> Vec<(f64, f64)> {
    (0..=120)
        .map(|i| 0.5 * f64::from(i))
        .map(|depth| (origin_mm + sign * depth, 8e-4 * depth * depth))
        .collect()
}

#[test]
fn a_depth_that_only_falls_or_never_reaches_the_tissue_is_refused() {
    let error = insertion(&stage(210.0, -1.0), "mm", Zero::Auto).expect_err("falls").to_string();
    assert!(error.contains("goes from 210.000 to 150.000 mm and never deeper"), "{error}");
    assert!(error.contains("--map 'Stage [mm]=depth_mm:-mm'"), "{error}");
    let error = insertion(&stage(0.0, -1.0), "mm", Zero::Auto).expect_err("falls").to_string();
    assert!(error.contains("goes from 0.000 to -60.000 mm"), "{error}");
    let error = insertion(&stage(210.0, -1.0), "-mm", Zero::Auto).expect_err("no tissue").to_string();
    assert!(error.contains("-150.000 mm at most, and the tissue begins at 0"), "{error}");
    for (origin_mm, sign, unit, zero) in
        [(210.0, -1.0, "-mm", Zero::First), (110.0, 1.0, "mm", Zero::First), (0.0, -1.0, "-mm", Zero::Auto)]
    {
        let run = insertion(&stage(origin_mm, sign), unit, zero).unwrap_or_else(|error| panic!("{error}"));
        let run = run.insertion.expect("an insertion");
        let is_right =
            run.depth_m.len() == 121 && run.depth_m[0] == 0.0 && (run.depth_m[120] - 0.06).abs() < 1e-9;
        assert!(
            is_right && (run.tip_y_m[120] - 2.88e-3).abs() < 1e-9,
            "{origin_mm} {sign}: {:?}",
            run.depth_m
        );
    }
}

#[test]
fn a_depth_that_begins_in_the_tissue_is_noted() {
    let noted = |origin_mm: f64| {
        let run = insertion(&stage(origin_mm, 1.0), "mm", Zero::Auto).expect("a run");
        run.notes.iter().any(|note| note.contains("depth_mm begins at"))
    };
    assert!(noted(110.0) && noted(20.0) && !noted(0.0) && !noted(-5.0));
}

#[test]
fn a_withdrawal_and_jumps_of_a_table_are_left_out_with_their_lines() {
    let mut rows = stage(0.0, 1.0);
    rows[60].1 += 25.0;
    rows.extend(stage(60.0, -1.0).into_iter().map(|(depth, _)| (depth, 8e-4 * depth * depth + 0.1)));
    let run = insertion(&rows, "mm", Zero::Auto).expect("a run");
    let notes = run.notes.join("\n");
    assert!(notes.contains("line 62") && notes.contains("are skipped (1 in all): jump"), "{notes}");
    assert!(notes.contains("withdrawn: the needle was drawn out at the end"), "{notes}");
    let run = run.insertion.expect("an insertion");
    assert!(
        run.tip_y_m.iter().all(|m| *m < 3.1e-3) && (120..130).contains(&run.depth_m.len()),
        "{}",
        run.depth_m.len()
    );
    // A tip that stays the same while the needle goes in.
    let mut held = stage(0.0, 1.0);
    (80..100).for_each(|row| held[row].1 = 1.28);
    let notes = insertion(&held, "mm", Zero::Auto).expect("a run").notes.join("\n");
    assert!(notes.contains("\"Tip y [mm]\" is exactly 1.28 in 20 consecutive readings"), "{notes}");
}
