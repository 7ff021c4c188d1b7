//! Needle shapes of others, imported: what is identified from them is what is identified from the session they were made of.

use super::{add_lateral_run, failure, folder, guide, json, path, text, writer};
use formats::session::Session;
use std::fmt::Write as _;
use std::fs;
use std::path::Path;

/// Axes of the needle in the room (right, anterior, superior): sideways, up, along; turned about two of them.
fn axes() -> [[f64; 3]; 3] {
    let ((sa, ca), (sb, cb)) = (0.4_f64.sin_cos(), (-0.9_f64).sin_cos());
    [[ca, sa, 0.0], [-sa * cb, ca * cb, sb], [sa * sb, -ca * sb, cb]]
}

/// The session's shape as points in the room, millimetres.
fn in_room(session: &Session, origin: [f64; 3]) -> Vec<[f64; 3]> {
    let run = &session.lateral[0];
    let [x, y, z] = axes();
    let x_m = run.shape.x_m.clone().expect("x");
    let points = run.shape.z_m.iter().zip(&run.shape.y_m).zip(x_m);
    points
        .map(|((z_m, y_m), x_m)| {
            let distance_mm = 1e3 * (z_m - session.rig.entry_m);
            [0, 1, 2].map(|i| origin[i] + distance_mm * z[i] + 1e3 * y_m * y[i] + 1e3 * x_m * x[i])
        })
        .collect()
}

fn modulus(dir: &Path) -> f64 {
    json(&["identify", path(dir), "--json"])["pooled"]["k_kpa"].as_f64().expect("a modulus")
}

fn list(vector: [f64; 3]) -> String {
    vector.map(|value| value.to_string()).join(",")
}

#[test]
fn a_curve_of_slicer_gives_the_same_modulus() {
    let folder = folder();
    let native = folder.path().join("native");
    add_lateral_run(&mut writer(&native));
    let session = Session::read(&native).expect("reads");
    let origin = [12.0, -40.0, -85.5];
    let mut curve =
        "{\"markups\": [{\"type\": \"Curve\", \"coordinateSystem\": \"LPS\", \"controlPoints\": [".to_owned();
    for (index, [x, y, z]) in in_room(&session, origin).into_iter().enumerate() {
        let comma = if index == 0 { "" } else { "," };
        let _ = write!(curve, "{comma}\n{{\"position\": [{}, {}, {z}]}}", -x, -y);
    }
    let file = folder.path().join("hold.mrk.json");
    fs::write(&file, curve + "]}]}").expect("written");
    let (force, rig) = (native.join("d30-1.force.csv"), native.join("session.toml"));
    let [_, up_axis, needle_axis] = axes();
    let (origin, up_axis, needle_axis) = (list(origin), list(up_axis), list(needle_axis));
    let output_path = folder.path().join("imported");
    let import = ["import", "slicer", path(&file), "--out", path(&output_path), "--rig", path(&rig)];
    let frame_options =
        ["--origin-mm", &origin, "--axis", &needle_axis, "--up", &up_axis, "--depth-mm", "30"];
    let with_force = ["--force", path(&force), "--json"];
    let import_json = json(&[&import[..], &frame_options, &with_force].concat());
    assert_eq!(
        (&import_json["schema"], &import_json["lateral"]["id"]),
        (&"guide.import/2".into(), &"hold".into())
    );
    assert_eq!(import_json["lateral"]["points"], 30);
    let (native_kpa, imported_kpa) = (modulus(&native), modulus(&output_path));
    assert!((imported_kpa / native_kpa - 1.0).abs() < 1e-6, "{imported_kpa} and {native_kpa}");
    assert!(failure(&[&import[..], &frame_options, &with_force].concat()).contains("\"hold\" is taken"));
    // Without force the run is there, and waits for it; the rig is that of the session.
    let again = ["import", "slicer", path(&file), "--out", path(&output_path), "--id", "bare"];
    let output = guide(&[&again[..], &frame_options].concat());
    assert!(output.status.success(), "{}", text(&output.stderr));
    assert!(text(&output.stderr).contains("bare.force.csv: has a header only"));
    assert_eq!(Session::read(&output_path).expect("reads").lateral.len(), 2);
    // Without a statement, the first part is straight.
    let drawn = ["import", "slicer", path(&file), "--out", path(&output_path), "--id", "drawn"];
    let output = guide(&drawn);
    assert!(text(&output.stderr).contains("is fitted to the first part of"), "{}", text(&output.stderr));
}

#[test]
fn poses_of_a_fibre_give_the_same_modulus() {
    let folder = folder();
    let native = folder.path().join("native");
    add_lateral_run(&mut writer(&native));
    let session = Session::read(&native).expect("reads");
    let shape = &session.lateral[0].shape;
    // In the frame of the needle's base, in metres; before the push it is straight.
    let poses = |bent: f64| -> String {
        let points = shape.z_m.iter().zip(&shape.y_m);
        points.map(|(z_m, y_m)| format!("0 {} {} 0 0 0 1\n", bent * y_m, z_m - session.rig.entry_m)).collect()
    };
    let [straight, bent] = [("straight.txt", 0.0), ("bent.txt", 1.0)].map(|(name, bent)| {
        fs::write(folder.path().join(name), poses(bent)).expect("written");
        folder.path().join(name)
    });
    let (force, rig) = (native.join("d30-1.force.csv"), native.join("session.toml"));
    let output_path = folder.path().join("imported");
    let common =
        ["--out", path(&output_path), "--rig", path(&rig), "--force", path(&force), "--depth-mm", "30"];
    let import_json = json(&[&["import", "fbg", path(&bent), "--json"], &common[..]].concat());
    assert!(
        import_json["notes"][0].as_str().expect("a note").contains("taken as metres"),
        "{}",
        import_json["notes"]
    );
    let (native_kpa, imported_kpa) = (modulus(&native), modulus(&output_path));
    assert!((imported_kpa / native_kpa - 1.0).abs() < 1e-6, "{imported_kpa} and {native_kpa}");

    // A sweep for each of its two holds; for three there is no hold.
    let two = ["import", "fbg", path(&straight), path(&bent), "--id", "two", "--json"];
    let import_json = json(&[&two[..], &common].concat());
    assert_eq!(
        (&import_json["lateral"]["sweeps"], &import_json["lateral"]["points"]),
        (&2.into(), &60.into())
    );
    let times = import_json["lateral"]["time_s"].as_array().expect("times");
    assert!(times[0].as_f64() < Some(3.0) && times[1].as_f64() > Some(4.0), "{times:?}");
    let three = ["import", "fbg", path(&bent), path(&bent), path(&bent), "--id", "three"];
    let printed = failure(&[&three[..], &common].concat());
    assert!(printed.contains("2 holds, 1 of them displaced, expected one for each of 3 files"), "{printed}");
    let timed = ["--time-s", "5,6,7", "--units", "m"];
    assert!(guide(&[&three[..], &timed, &common].concat()).status.success());

    for (wrong, expected) in [
        (&["--time-s", "5"][..], "--time-s: 1 times, expected 2"),
        (&["--axis", "0,0,0"], "axis: [0.0, 0.0, 0.0], expected a direction"),
        (&["--up", "0,0,2"], "is along the needle"),
        (&["--units", "mm"], "is the unit right?"),
        (&["--id", "a/b"], "cannot be part of a file name"),
    ] {
        let printed = failure(&[&["import", "fbg", path(&straight), path(&bent)], wrong, &common].concat());
        assert!(printed.contains(expected), "{printed}");
    }
    let mixed = ["import", "trajcontrol", path(&bent), "--out", path(&output_path), "--up", "0,1,0"];
    assert!(failure(&mixed).contains("options that are for shapes"));
    for wrong in [["--axis", "0,1"], ["--origin-mm", "a,b,c"], ["--depth-mm", "-3"], ["--units", "ft"]] {
        let output = guide(&[&["import", "fbg", path(&bent)][..], &wrong, &common[..6]].concat());
        assert_eq!(output.status.code(), Some(2), "{wrong:?}");
    }
}
