//! Simulated shapes, turned into the coordinates of others and read back.

use super::{Axis, Frame, FrameError, LengthUnit, NeedlePoints, Straight, id_of, poses, slicer};
use crate::session::SessionError;
use crate::session::is_file_name;
use nalgebra::{Rotation3, Vector3};
use std::fmt::Write as _;
use std::fs;
use std::path::Path;
use tempfile::tempdir;

const UP: [[f64; 3]; 2] = [[0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];

/// Position along the needle, deflections y and x, millimetres: straight for 10 mm, then bent.
fn simulated() -> Vec<[f64; 3]> {
    (0..120)
        .map(|step| {
            let s = 0.5 * f64::from(step);
            let bent = (s - 10.0).max(0.0);
            [70.0 + s, 2e-3 * bent * bent, -1e-3 * bent * bent]
        })
        .collect()
}

/// Some rotation and place of the needle in a room: points along it, and the frame's axes.
fn in_room(shape: &[[f64; 3]]) -> (Vec<Vector3<f64>>, Rotation3<f64>, Vector3<f64>) {
    let turn = Rotation3::from_euler_angles(0.3, -0.7, 1.9);
    let origin = Vector3::new(12.0, -40.0, -85.5);
    (shape.iter().map(|[z, y, x]| origin + turn * Vector3::new(*x, *y, z - 70.0)).collect(), turn, origin)
}

fn markups(system: &str, points: &[Vector3<f64>]) -> String {
    let mut text = format!(
        "{{\"@schema\": \"markups-schema\",\n\"markups\": [{{\"type\": \"Curve\", \"coordinateSystem\": {system},\n\"coordinateUnits\": \"mm\", \
         \"controlPoints\": ["
    );
    for (index, point) in points.iter().enumerate() {
        let comma = if index == 0 { "" } else { "," };
        let [x, y, z] = (*point).into();
        let _ = write!(
            text,
            "{comma}\n{{\"id\": \"{index}\", \"position\": [{x}, {y}, {z}], \"positionStatus\": \"defined\"}}"
        );
    }
    text + "]}]}\n"
}

fn written<T>(name: &str, text: &str, read: impl FnOnce(&Path) -> T) -> T {
    let folder = tempdir().expect("a folder");
    let path = folder.path().join(name);
    fs::write(&path, text).expect("written");
    read(&path)
}

fn same(frame: &Frame, needle: &NeedlePoints, shape: &[[f64; 3]], within_mm: f64) {
    let (read, points_behind) = frame.shape(needle).expect("a shape");
    assert_eq!((points_behind, read.z_m.len()), (0, shape.len()));
    let x_m = read.x_m.expect("x");
    for (index, [z, y, x]) in shape.iter().enumerate() {
        for (read_m, mm) in [(read.z_m[index], z), (read.y_m[index], y), (x_m[index], x)] {
            assert!((1e3 * read_m - mm).abs() < within_mm, "point {index}: {} and {mm}", 1e3 * read_m);
        }
    }
}

fn given(turn: &Rotation3<f64>, origin: Vector3<f64>) -> Straight {
    let up_direction = (turn * Vector3::y()).into();
    Straight {
        origin_m: Some((1e-3 * origin).into()),
        origin_z_m: 0.07,
        axis: Axis::Given((3.0 * (turn * Vector3::z())).into()),
        up: [up_direction, up_direction],
    }
}

#[test]
fn curves_of_slicer_come_back_from_either_system() {
    let shape = simulated();
    let (points, turn, origin) = in_room(&shape);
    let lps: Vec<Vector3<f64>> = points.iter().map(|p| Vector3::new(-p.x, -p.y, p.z)).collect();
    for (system, points) in
        [("\"RAS\"", &points), ("\"LPS\"", &lps), ("0", &points), ("1", &lps), ("\"0\"", &points)]
    {
        let needle =
            written("n.mrk.json", &markups(system, points), slicer).unwrap_or_else(|e| panic!("{e}"));
        same(&Frame::new(&given(&turn, origin), &needle).expect("a frame"), &needle, &shape, 1e-9);
        // From the straight part alone; up as it would be given.
        let fitted = Straight { origin_m: None, axis: Axis::Fitted(0.01), ..given(&turn, origin) };
        same(&Frame::new(&fitted, &needle).expect("a frame"), &needle, &shape, 1e-6);
    }
}

#[test]
fn points_that_are_not_placed_are_skipped() {
    let text = markups("\"RAS\"", &in_room(&simulated()).0)
        .replacen("defined", "undefined", 1)
        .replace("\"Curve\"", "\"ClosedCurve\"");
    let needle = written("n.mrk.json", &text, slicer).expect("reads");
    assert_eq!((needle.points_m.len(), needle.notes.len()), (119, 2));
    assert!(needle.notes[0].ends_with("1 control points are not placed: skipped"));
}

#[test]
fn points_that_are_not_selected_are_skipped_where_others_are() {
    let text = markups("\"RAS\"", &in_room(&simulated()).0);
    fn selected(is_selected: bool) -> String {
        format!("\"selected\": {is_selected}, \"positionStatus\"")
    }
    let partly_selected = text.replacen("\"positionStatus\"", &selected(false), 7);
    let needle = written("n.mrk.json", &partly_selected, slicer).expect("reads");
    assert_eq!(needle.points_m.len(), 113);
    assert!(needle.notes[0].ends_with("7 control points are not selected: skipped"), "{:?}", needle.notes);
    for is_selected in [true, false] {
        let uniform = text.replace("\"positionStatus\"", &selected(is_selected));
        let needle = written("n.mrk.json", &uniform, slicer).expect("reads");
        assert_eq!((needle.points_m.len(), needle.notes.len()), (120, 0));
    }
}

#[test]
fn lists_of_older_versions_hold_the_same_points() {
    fn list(
        system: &str,
        columns: &str,
        line: &dyn Fn(usize, f64, f64, f64) -> String,
    ) -> Result<NeedlePoints, SessionError> {
        let rows: String =
            (0..9).map(|at| line(at, f64::from(at as u8), 2.0, 10.0 * at as f64) + "\n").collect();
        let text = format!(
            "# Markups fiducial file version = 4.11\n# CoordinateSystem = {system}\n# columns = {columns}\n{rows}"
        );
        written("F.fcsv", &text, slicer)
    }
    let usual = "id,x,y,z,ow,ox,oy,oz,vis,sel,lock,label,desc,associatedNodeID";
    fn plain(at: usize, x: f64, y: f64, z: f64) -> String {
        format!("{at},{x},{y},{z},0,0,0,1,1,1,0,F-{at},,")
    }
    for (system, sign) in [("LPS", -1e-3), ("1", -1e-3), ("RAS", 1e-3), ("0", 1e-3)] {
        let needle = list(system, usual, &plain).expect(system);
        assert!(needle.points_m.len() == 9 && needle.notes.is_empty(), "{system}: {:?}", needle.notes);
        for (at, point) in needle.points_m.iter().enumerate() {
            let right = [sign * at as f64, sign * 2.0, 1e-2 * at as f64];
            assert!(point.iter().zip(right).all(|(a, b)| (a - b).abs() < 1e-12), "{system} {at}: {point:?}");
        }
    }
    // Columns in another order, and points that are not selected beside others.
    let reordered =
        list("RAS", "label,sel,z,y,x", &|at, x, y, z| format!("F,{},{z},{y},{x}", u8::from(at > 1)));
    let needle = reordered.expect("reads");
    assert!(needle.points_m.len() == 7 && needle.points_m[0] == [2e-3, 2e-3, 2e-2], "{:?}", needle.points_m);
    assert!(needle.notes[0].ends_with("2 control points are not selected: skipped"), "{:?}", needle.notes);
    for (refused, words) in [
        (
            list("IJK", usual, &plain),
            "F.fcsv:2:1: CoordinateSystem: \"IJK\" is not known, expected LPS or RAS",
        ),
        (list("RAS", "id,x,y", &plain), "F.fcsv:4:1: columns: missing, expected columns with x, y and z"),
        (
            list("RAS", usual, &|at, x, y, _| format!("{at},{x},{y},inf,0,0,0,1,1,1,0,F,,")),
            "F.fcsv:4:4: z: \"inf\" is not a number",
        ),
    ] {
        let error = refused.expect_err(words).to_string();
        assert!(error.contains(words), "{error}");
    }
    let unstated =
        written("F.fcsv", "# Markups fiducial file version = 4.11\n# columns = id,x,y,z\n1,0,0,0\n", slicer);
    assert!(unstated.expect_err("no system").to_string().contains("CoordinateSystem: missing"));
}

#[test]
fn faults_of_markups_name_their_place() {
    let good = markups("\"LPS\"", &in_room(&simulated()[..3]).0);
    for (from, to, line, expected) in [
        (
            "\"LPS\"",
            "\"IJK\"",
            2,
            "invalid value: string \"IJK\", expected coordinateSystem \"LPS\" or \"RAS\"",
        ),
        ("\"LPS\"", "2", 2, "invalid value: integer `2`"),
        ("\"coordinateSystem\"", "\"cs\"", 6, "missing field `coordinateSystem`"),
        ("\"mm\"", "\"inch\"", 3, "coordinateUnits \"inch\", expected \"mm\""),
        ("[12, ", "[9000, ", 4, "position 9000, expected millimetres"),
        ("[12, ", "[\"12\", ", 4, "invalid type: string \"12\""),
        ("[12, ", "[", 4, "invalid length 2"),
        ("\"Curve\"", "\"Plane\"", 2, "type \"Plane\", expected Curve, ClosedCurve, Line, Fiducial"),
        ("]}]}", "]}]", 7, "the file ends in"),
    ] {
        assert!(good.contains(from), "{from} is not in {good}");
        let message =
            written("n.mrk.json", &good.replacen(from, to, 1), slicer).expect_err("refused").to_string();
        assert!(message.contains(&format!("n.mrk.json:{line}:")) && message.contains(expected), "{message}");
    }
    let refusal = written("n.mrk.json", "{\"markups\": []}", slicer).expect_err("refused").to_string();
    assert!(refusal.contains("markups: a list of 0, expected one curve per file"), "{refusal}");
}

/// The frame of the needle's base: along z, y up.
fn base() -> Straight {
    Straight { origin_m: Some([0.0; 3]), origin_z_m: 0.07, axis: Axis::Given([0.0, 0.0, 1.0]), up: UP }
}

#[test]
fn poses_come_back_from_every_layout() {
    let shape = simulated();
    // In the frame of the needle's base x, y, z are a left-handed session's x, y, z turned by nothing.
    let lines = |line: &dyn Fn(f64, f64, f64) -> String| -> String {
        shape.iter().map(|[z, y, x]| line(*x, *y, z - 70.0) + "\n").collect()
    };
    fn metres(value: f64) -> f64 {
        1e-3 * value
    }
    for (name, text) in [
        ("spaces", lines(&|x, y, z| format!("{x} {y}\t {z}"))),
        ("quaternion, commas", lines(&|x, y, z| format!("{x}, {y}, {z}, 0, 0, 0, 1"))),
        ("by rows", lines(&|x, y, z| format!("1 0 0 {x} 0 1 0 {y} 0 0 1 {z} 0 0 0 1"))),
        ("three rows", lines(&|x, y, z| format!("1 0 0 {x} 0 1 0 {y} 0 0 1 {z}"))),
        ("by columns", lines(&|x, y, z| format!("1;0;0;0;0;1;0;0;0;0;1;0;{x};{y};{z};1"))),
        ("metres", lines(&|x, y, z| format!("{} {} {}", metres(x), metres(y), metres(z)))),
        (
            "header",
            "# simulated\nz_mm,t,y_mm,x_mm\n".to_owned() + &lines(&|x, y, z| format!("{z},now,{y},{x}")),
        ),
        (
            "of a robot",
            "stamp,pose.position.x,pose.position.y,pose.position.z,pose.orientation.x\n".to_owned()
                + &lines(&|x, y, z| format!("1,{},{},{},0", metres(x), metres(y), metres(z))),
        ),
    ] {
        let needle =
            written("n.csv", &text, |path| poses(path, None)).unwrap_or_else(|e| panic!("{name}: {e}"));
        assert_eq!(needle.notes.is_empty(), name == "header", "{name}: {:?}", needle.notes);
        same(&Frame::new(&base(), &needle).expect("a frame"), &needle, &shape, 1e-9);
    }
    // Without a rotation of its own, a matrix by columns is told from one by rows by what is a rotation.
    for (name, text) in [
        ("12 by columns", lines(&|x, y, z| format!("1 0 0 0 1 0 0 0 1 {x} {y} {z}"))),
        ("12 turned, by columns", lines(&|x, y, z| format!("0 1 0 -1 0 0 0 0 1 {x} {y} {z}"))),
        ("12 turned, by rows", lines(&|x, y, z| format!("0 -1 0 {x} 1 0 0 {y} 0 0 1 {z}"))),
        ("decimal commas, semicolons", lines(&|x, y, z| format!("{x};{y};{z}").replace('.', ","))),
        ("decimal commas, blanks", lines(&|x, y, z| format!("{x:.9} {y:.9} {z:.9}").replace('.', ","))),
        (
            "decimal commas, quoted",
            lines(&|x, y, z| format!("\"{x:.9}\",\"{y:.9}\",\"{z:.9}\"").replace('.', ",")),
        ),
        (
            "quoted header and cells",
            "\"x_mm\",\"y_mm\",\"z_mm\"\n".to_owned() + &lines(&|x, y, z| format!("\"{x}\",\"{y}\",\"{z}\"")),
        ),
    ] {
        let needle =
            written("n.csv", &text, |path| poses(path, None)).unwrap_or_else(|e| panic!("{name}: {e}"));
        same(&Frame::new(&base(), &needle).expect("a frame"), &needle, &shape, 2e-9);
    }
    let lost = lines(&|x, y, z| if z == 20.0 { "nan nan nan".to_owned() } else { format!("{x} {y} {z}") });
    let needle = written("n.csv", &lost, |path| poses(path, None)).expect("reads");
    assert_eq!(needle.points_m.len(), shape.len() - 1);
    assert!(needle.notes[0].contains("1 rows without numbers"), "{:?}", needle.notes);
    let in_metres = lines(&|x, y, z| format!("{} {} {}", metres(x), metres(y), metres(z)));
    let message = written("n.csv", &in_metres, |path| poses(path, Some(LengthUnit::Millimetres)));
    assert!(message.expect_err("refused").to_string().contains("a needle 0.06"));
}

#[test]
fn faults_of_poses_name_their_place() {
    fn refused(text: &str) -> String {
        let fault: SessionError = written("n.csv", text, |path| poses(path, None)).expect_err("refused");
        fault.to_string()
    }
    for (text, expected) in [
        ("0 0 0\n0 0 x\n", "n.csv:2:5: pose: \"x\" is not a number, expected a number"),
        ("0,0,0\n0,,1\n", "n.csv:2:3: pose: empty"),
        ("0 0 0\n0 0 inf\n", "n.csv:2:5: pose: not a finite number"),
        ("0 0 0\n\n0 0 1 2\n", "n.csv:3:1: pose: 4 numbers, expected 3 on every line as before"),
        ("0 0 0 0\n", "n.csv:1:1: pose: 4 numbers, expected 3 (x y z), 7"),
        ("0 0 0 1 1 0 0\n", "n.csv:1:1: pose: a quaternion of length 1.414"),
        ("1 2 3 4 5 6 7 8 9 1 2 3 4 5 6 7\n", "n.csv:1:1: pose: no matrix of a pose"),
        ("a,b,c\n0,0,1\n", "n.csv:1:1: header: no columns of a position"),
        ("# nothing\n", "pose: none in the file, expected two poses or more"),
        (
            "0 0 0\n0 0 1\n0 0 2\n0 0 3\n0 0 90\n",
            "n.csv:5:1: pose: 87.00 mm from the pose before, expected about 1.00 mm",
        ),
        ("0 0 0\n0 0 1e4\n", "expected a needle 5 to 2000 mm long: is the unit right?"),
        ("0 0 0\n0 0 0.0001\n", "a needle 0.100 mm long"),
    ] {
        let message = refused(text);
        assert!(message.contains(expected), "{message}, expected {expected}");
    }
}

#[test]
fn frames_that_are_none_are_refused() {
    fn needle(points_m: &[[f64; 3]]) -> NeedlePoints {
        NeedlePoints { path: "n.csv".into(), points_m: points_m.to_vec(), notes: Vec::new() }
    }
    let two = needle(&[[0.0; 3], [0.0, 0.0, 0.01]]);
    let zero = Straight { axis: Axis::Given([0.0; 3]), ..base() };
    assert!(matches!(Frame::new(&zero, &two), Err(FrameError::Zero { .. })));
    let parallel = Straight { up: [[0.0, 0.0, 1.0]; 2], ..base() };
    assert!(matches!(Frame::new(&parallel, &two), Err(FrameError::UpAlongAxis { .. })));
    let fitted = Straight { axis: Axis::Fitted(0.01), ..base() };
    for points in [&[][..], &[[0.0; 3]], &[[1.0; 3], [1.0; 3], [1.0; 3]]] {
        assert!(matches!(Frame::new(&fitted, &needle(points)), Err(FrameError::NoDirection { .. })));
    }
    let frame = Frame::new(&base(), &two).expect("a frame");
    assert!(matches!(frame.shape(&two), Err(FrameError::TooFew { found: 2, .. })));
    let distant = needle(&[[0.0; 3], [0.3, 0.0, 0.0], [0.0; 3]]);
    let message = frame.shape(&distant).expect_err("refused").to_string();
    assert!(
        message.contains("n.csv: point 2 is 300.0 mm off the straight needle, 70.0 mm from guide 1"),
        "{message}"
    );
    // Behind guide 1 there is no needle to be measured.
    let behind_needle = needle(&[[0.0, 0.0, -0.08], [0.0; 3], [0.0, 0.0, 0.01], [0.0, 0.0, 0.02]]);
    assert_eq!(frame.shape(&behind_needle).expect("a shape").1, 1);
    // Anterior is up, and superior where the needle goes that way.
    let [_, _, up_axis] = frame.parts();
    assert_eq!(up_axis, [0.0, 1.0, 0.0]);
    let upright = Straight { axis: Axis::Given([0.0, -1.0, 0.0]), ..base() };
    let [_, _, up_axis] = Frame::new(&upright, &two).expect("a frame").parts();
    assert_eq!(up_axis, [0.0, 0.0, 1.0]);
}

#[test]
fn an_id_is_made_of_any_file_name() {
    for (name, id) in [
        ("my needle 1.csv", "my-needle-1"),
        ("Nadel-Führung.csv", "Nadel-Fuehrung"),
        ("needle curve.mrk.json", "needle-curve"),
        ("my_data-no control.csv", "my_data-no-control"),
        ("d40-1.force.csv", "d40-1.force"),
        ("针 #3 (1).csv", "3-1"),
        ("針.csv", "run"),
        (".hidden", "hidden"),
        ("é à.txt", "run"),
        ("Con.csv", "run-Con"),
        ("com1.csv", "run-com1"),
        ("com.csv", "com"),
        ("nul1.csv", "nul1"),
    ] {
        assert_eq!(id_of(Path::new(name)), id, "{name}");
        assert!(is_file_name(&id_of(Path::new(name))), "{name}");
    }
    assert!(is_file_name(&id_of(Path::new(&"x".repeat(300)))));
    for device in ["con", "NUL", "aux.1", "Com9", "lpt1"] {
        assert!(!is_file_name(device), "{device}: a session with it could not be copied to Windows");
    }
}

#[test]
fn positions_in_other_units_and_encodings_are_the_same_points() {
    let points: Vec<Vector3<f64>> =
        (0..20).map(|step| Vector3::new(0.0, 0.01 * f64::from(step * step), 2.0 * f64::from(step))).collect();
    let right = written("a.mrk.json", &markups("\"RAS\"", &points), slicer).expect("millimetres").points_m;
    for (units, per_mm) in [
        ("\"cm\"", 0.1),
        ("\"m\"", 1e-3),
        ("[\"mm\",\"UCUM\",\"millimeter\"]", 1.0),
        ("[\"cm\",\"cm\",\"cm\"]", 0.1),
    ] {
        let scaled: Vec<Vector3<f64>> = points.iter().map(|point| per_mm * point).collect();
        let text = markups("\"RAS\"", &scaled)
            .replace("\"coordinateUnits\": \"mm\"", &format!("\"coordinateUnits\": {units}"));
        let read =
            written("b.mrk.json", &text, slicer).unwrap_or_else(|error| panic!("{units}: {error}")).points_m;
        let largest = read
            .iter()
            .zip(&right)
            .flat_map(|(a, b)| [0, 1, 2].map(|i| (a[i] - b[i]).abs()))
            .fold(0.0, f64::max);
        assert!(read.len() == right.len() && largest < 1e-12, "{units}: {largest}");
    }
    let rows = |separator: &str, per_mm: f64| -> String {
        points
            .iter()
            .map(|point| {
                let [x, y, z]: [f64; 3] = (*point * per_mm).into();
                format!("{x}{separator}{y}{separator}{z}\n")
            })
            .collect()
    };
    for text in [
        format!("x,y,z\nmm,mm,mm\n{}", rows(",", 1.0)),
        format!("x;y;z\n[cm];[cm];[cm]\n{}", rows(";", 0.1)),
        format!("x (m)\ty (m)\tz (m)\n{}", rows("\t", 1e-3)),
    ] {
        let utf16: Vec<u8> =
            [0xfe, 0xff].into_iter().chain(text.encode_utf16().flat_map(u16::to_be_bytes)).collect();
        for bytes in [text.as_bytes(), utf16.as_slice()] {
            let folder = tempdir().expect("a folder");
            let path = folder.path().join("f.csv");
            fs::write(&path, bytes).expect("written");
            let read = poses(&path, None).unwrap_or_else(|error| panic!("{text}: {error}")).points_m;
            let largest = read
                .iter()
                .zip(&right)
                .flat_map(|(a, b)| [0, 1, 2].map(|i| (a[i] - b[i]).abs()))
                .fold(0.0, f64::max);
            assert!(read.len() == right.len() && largest < 1e-12, "{text}: {largest}");
        }
    }
}
