//! From ultrasound frames to K: what is identified from pictures of a shape is what is identified from the shape.

use super::{add_lateral_run, failure, folder, guide, json, path, text, writer};
use formats::session::Session;
use std::fs;
use std::path::Path;

const SIZE: usize = 96;
const PX_MM: f64 = 0.05;

/// A number between 0 and 1 that looks random, another one for each `count` (the finaliser of SplitMix64).
fn uniform(count: u64) -> f64 {
    let mut bits = (count + 1).wrapping_mul(0x9E37_79B9_7F4A_7C15);
    bits = (bits ^ (bits >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    bits = (bits ^ (bits >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
    ((bits ^ (bits >> 31)) >> 11) as f64 / (1u64 << 53) as f64 + 1e-16
}

/// Frames half a millimetre apart with an echo at each of the deflections (millimetres, up), in speckle (Rayleigh), brightness as a scanner's logarithm shows it.
fn write_frames(file: &Path, deflections_mm: &[f64]) {
    let mut bytes = format!(
        "DimSize = {SIZE} {SIZE} {}\nElementSpacing = {PX_MM} {PX_MM}\nElementType = MET_UCHAR\nElementDataFile = LOCAL\n",
        deflections_mm.len()
    )
    .into_bytes();
    for (number, deflection_mm) in deflections_mm.iter().enumerate() {
        let (x, y) = (48.2, 44.6 - deflection_mm / PX_MM);
        bytes.extend((0..SIZE * SIZE).map(|at| {
            let (dx, dy) = ((at % SIZE) as f64 - x, (at / SIZE) as f64 - y);
            let speckle = 0.01 * (-2.0 * uniform((number * SIZE * SIZE + at) as u64).ln()).sqrt();
            let envelope = speckle + (-0.5 * ((dx / 7.0).powi(2) + (dy / 3.0).powi(2))).exp();
            (255.0 * (1.0 + 20.0 * (envelope / 1.1).log10() / 50.0)).clamp(0.0, 255.0) as u8
        }));
    }
    fs::write(file, bytes).expect("written");
}

#[test]
fn frames_of_a_shape_give_its_modulus() {
    let folder = folder();
    let native = folder.path().join("native");
    add_lateral_run(&mut writer(&native));
    let session = Session::read(&native).expect("reads");
    let shape = &session.lateral[0].shape;
    let entry_m = session.rig.entry_m;
    // The native shape between its points, every half a millimetre from the surface.
    let mut points: Vec<(f64, f64)> = shape.z_m.iter().copied().zip(shape.y_m.iter().copied()).collect();
    points.sort_by(|a, b| a.0.total_cmp(&b.0));
    let at = |z_m: f64| {
        let after = points.partition_point(|(at_m, _)| *at_m < z_m).clamp(1, points.len() - 1);
        let ((a, u), (b, v)) = (points[after - 1], points[after]);
        1e3 * (u + (v - u) * (z_m - a) / (b - a))
    };
    let count = 60;
    let bent: Vec<f64> = (0..count).map(|i| at(entry_m + 0.5e-3 * f64::from(i))).collect();
    let [hold, zero] = ["hold.mha", "zero.mha"].map(|name| folder.path().join(name));
    write_frames(&hold, &bent);
    write_frames(&zero, &vec![0.0; bent.len()]);
    let (force, rig) = (native.join("d30-1.force.csv"), native.join("session.toml"));
    let (out, pictures) = (folder.path().join("imported"), folder.path().join("pictures"));
    let import =
        ["import", "ultrasound", path(&hold), "--out", path(&out), "--rig", path(&rig), "--step-mm", "0.5"];
    let rest = [
        "--straight",
        path(&zero),
        "--force",
        path(&force),
        "--depth-mm",
        "30",
        "--overlay",
        path(&pictures),
    ];
    let done = json(&[&import[..], &rest, &["--json"]].concat());
    assert_eq!(done["schema"], "guide.import/2");
    assert!(
        done["sweeps"][0]["states"]["used"].as_u64().expect("a count") >= 55,
        "{}",
        done["sweeps"][0]["states"]
    );
    assert_eq!(fs::read_dir(&pictures).expect("a folder").count(), 60);
    assert!(out.join("hold.frames.json").exists());
    let written = Session::read(&out).expect("reads").lateral[0].shape.clone();
    assert!(written.y_sd_m.is_some_and(|sd_m| sd_m.iter().all(|sd_m| (1e-8..1e-4).contains(sd_m))));
    let pooled = |dir: &Path| json(&["identify", path(dir), "--json"])["pooled"].clone();
    let (native, imported) = (pooled(&native), pooled(&out));
    let k_kpa = native["k_kpa"].as_f64().expect("a modulus");
    let bound = |i: usize| imported["ci95_kpa"][i].as_f64().expect("a bound");
    assert!((bound(0)..bound(1)).contains(&k_kpa), "{imported} and {native}");
    // What is missing is named.
    assert!(failure(&import).contains("the straight needle: missing, expected --straight"));
    let nowhere = ["import", "ultrasound", path(&hold), "--out", path(&out)];
    assert!(
        failure(&nowhere)
            .contains("expected --step-mm, --speed-mm-per-s, --z-field, --transform or --calibration")
    );
    let points = guide(&[&import[..], &["--axis", "0,0,1"]].concat());
    assert!(
        text(&points.stderr).contains("options that are for points in space"),
        "{}",
        text(&points.stderr)
    );
}
