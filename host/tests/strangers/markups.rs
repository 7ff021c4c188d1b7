//! Shapes: curves of 3D Slicer, fibres.

use super::{Answer, assert_right_or_rejected, columns, import, with_file};
use std::fmt::Write as _;

/// Deflection at a place along the needle from its base, millimetres.
fn deflection_mm(along_mm: f64) -> f64 {
    2e-4 * along_mm * along_mm
}

/// Points of the shape are those of the curve, with z from the base plus this much.
fn assert_curve(answer: &Answer, offset_mm: f64, least: usize) {
    let rows = columns(answer, ".shape.csv", ["z_mm", "deflection_y_mm", "deflection_x_mm"]);
    assert!(rows.len() >= least, "{} points:\n{}", rows.len(), answer.printed);
    for [z_mm, y_mm, x_mm] in rows {
        let expected_mm = deflection_mm(z_mm - offset_mm);
        assert!((y_mm - expected_mm).abs() < 2e-3, "{y_mm} for {expected_mm} at {z_mm}:\n{}", answer.printed);
        assert!(x_mm.abs() < 2e-3, "x is {x_mm} at {z_mm}:\n{}", answer.printed);
    }
}

/// Places along the needle, millimetres.
fn places() -> impl DoubleEndedIterator<Item = f64> {
    (0..=100).map(f64::from)
}

fn fibre(content: &str) -> Answer {
    let options = ["fbg", "needle.csv", "--origin-z-mm", "0", "--depth-mm", "30"];
    import(with_file("needle.csv", content), &options)
}

#[test]
fn arc_length_before_the_coordinates() {
    let content = places().fold("s,x,y,z\n".to_owned(), |text, z| {
        text + &format!("{:.3},0.0,{:.6},{z}\n", 1.001 * z, deflection_mm(z))
    });
    assert_right_or_rejected(&fibre(&content), &["s", "column"], |answer| assert_curve(answer, 0.0, 100));
}

#[test]
fn micrometres_of_a_fibre() {
    let content = places().fold("x [um],y [um],z [um]\n".to_owned(), |text, z| {
        text + &format!("0.0,{:.3},{}\n", 1e3 * deflection_mm(z), 1e3 * z)
    });
    assert_right_or_rejected(&fibre(&content), &["um", "unit", "--units"], |answer| {
        assert_curve(answer, 0.0, 100)
    });
}

#[test]
fn a_fibre_from_tip_to_base() {
    let content = places()
        .rev()
        .fold("x,y,z\n".to_owned(), |text, z| text + &format!("0.0,{:.6},{z}\n", deflection_mm(z)));
    assert_right_or_rejected(&fibre(&content), &["order", "tip", "z"], |answer| {
        assert_curve(answer, 0.0, 100)
    });
}

#[test]
fn a_quaternion_with_its_scalar_first() {
    let content = places().fold("x,y,z,qw,qx,qy,qz\n".to_owned(), |text, z| {
        let half = 0.5 * (4e-4 * z).atan();
        text + &format!("0.0,{:.6},{z},{:.6},{:.6},0.0,0.0\n", deflection_mm(z), half.cos(), -half.sin())
    });
    assert_right_or_rejected(&fibre(&content), &["q"], |answer| assert_curve(answer, 0.0, 100));
}

#[test]
fn a_fibre_in_the_coordinates_of_a_tracker() {
    let content = places()
        .fold("x,y,z\n".to_owned(), |text, z| text + &format!("12.5,{:.6},{z}\n", 104.2 + deflection_mm(z)));
    let answer = fibre(&content);
    assert!(
        answer.printed.contains("are these coordinates of a tracker? (--origin-mm"),
        "{}",
        answer.printed
    );
    let options =
        ["fbg", "needle.csv", "--origin-z-mm", "0", "--depth-mm", "30", "--origin-mm", "12.5,104.2,0"];
    let answer = import(with_file("needle.csv", &content), &options);
    assert!(!answer.printed.contains("tracker"), "{}", answer.printed);
    assert_curve(&answer, 0.0, 100);
}

/// A point of the needle in the room: right, anterior, superior. The needle goes along superior, deflections are anterior.
fn in_room(along_mm: f64) -> [f64; 3] {
    [12.0, -40.0 + deflection_mm(along_mm), 5.0 + along_mm]
}

fn slicer(name: &str, content: &str) -> Answer {
    let frame_options =
        ["--origin-mm", "12,-40,5", "--axis", "0,0,1", "--up", "0,1,0", "--origin-z-mm", "70"];
    import(with_file(name, content), &[&["slicer", name, "--depth-mm", "30"][..], &frame_options].concat())
}

fn right(answer: &Answer) {
    assert_curve(answer, 70.0, 13);
}

/// Control points of the first 30 mm, every 2.5 mm, in LPS times a factor.
fn control_points(factor: f64) -> Vec<String> {
    let distances_mm = (0..13).map(|index| 2.5 * f64::from(index));
    distances_mm
        .map(|distances_mm| {
            let [x, y, z] = in_room(distances_mm).map(|value| factor * value);
            format!("{{\"position\": [{}, {}, {z}], \"positionStatus\": \"defined\"}}", -x, -y)
        })
        .collect()
}

fn markups(units: &str, lists: &[(&str, Vec<String>)]) -> String {
    let written = lists.iter().map(|(kind, points)| {
        let points = points.join(",\n");
        format!("{{\"type\": \"{kind}\", \"coordinateSystem\": \"LPS\", \"coordinateUnits\": {units}, \"controlPoints\": [{points}]}}")
    });
    format!("{{\"markups\": [{}]}}", written.collect::<Vec<_>>().join(",\n"))
}

#[test]
fn control_points_that_were_not_placed() {
    let mut points = control_points(1.0);
    points.insert(6, "{\"position\": [0.0, 0.0, 0.0], \"positionStatus\": \"undefined\"}".to_owned());
    points.push("{\"position\": [0.0, 0.0, 0.0], \"positionStatus\": \"missing\"}".to_owned());
    let content = markups("\"mm\"", &[("Curve", points)]);
    assert_right_or_rejected(&slicer("hold.mrk.json", &content), &["undefined", "status"], right);
}

#[test]
fn points_of_slicer_before_markups() {
    let mut content = "# Markups fiducial file version = 4.11\n# CoordinateSystem = LPS\n\
        # columns = id,x,y,z,ow,ox,oy,oz,vis,sel,lock,label,desc,associatedNodeID\n"
        .to_owned();
    for index in 0..13 {
        let [x, y, z] = in_room(2.5 * f64::from(index));
        let _ = writeln!(content, "{index},{},{},{z},0,0,0,1,1,1,0,F-{index},,", -x, -y);
    }
    let answer = slicer("hold.fcsv", &content);
    assert!(answer.succeeded, "{}", answer.printed);
    right(&answer);
}

#[test]
fn a_list_of_landmarks_beside_the_curve() {
    let landmarks = vec![
        "{\"position\": [30.0, 80.0, -20.0]}".to_owned(),
        "{\"position\": [-9.0, 75.0, 40.0]}".to_owned(),
    ];
    for first in [true, false] {
        let mut lists = vec![("Curve", control_points(1.0)), ("Fiducial", landmarks.clone())];
        if first {
            lists.reverse();
        }
        let content = markups("\"mm\"", &lists);
        assert_right_or_rejected(&slicer("hold.mrk.json", &content), &["markups", "two", "2 "], right);
    }
}

#[test]
fn metres_of_a_curve() {
    for units in ["\"m\"", "[\"m\", \"m\", \"m\"]"] {
        let content = markups(units, &[("Curve", control_points(1e-3))]);
        assert_right_or_rejected(&slicer("hold.mrk.json", &content), &["unit"], right);
    }
}

#[test]
fn an_angle_is_no_needle() {
    let points = control_points(1.0).into_iter().step_by(6).collect();
    let content = markups("\"mm\"", &[("Angle", points)]);
    assert_right_or_rejected(&slicer("hold.mrk.json", &content), &["Angle"], |answer| {
        assert_curve(answer, 70.0, 3)
    });
}
