//! From ultrasound frames to K: what is identified from pictures of a shape is what is identified from the shape.

use super::{add_lateral_run, failure, folder, guide, json, path, text, writer};
use formats::session::{ForceRow, FrameSweep, Session};
use mechanics::{Beam, Foundation};
use simulation::rig::scanner::{Scan, ScannerConfig};
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
    let count = 60;
    let bent: Vec<f64> = (0..count).map(|i| interpolated(entry_m + 0.5e-3 * f64::from(i), &points)).collect();
    let [hold, zero] = ["hold.mha", "zero.mha"].map(|name| folder.path().join(name));
    write_frames(&hold, &bent);
    write_frames(&zero, &vec![0.0; bent.len()]);
    let (force, rig) = (native.join("d30-1.force.csv"), native.join("session.toml"));
    let (output_dir, pictures) = (folder.path().join("imported"), folder.path().join("pictures"));
    let import = [
        "import",
        "ultrasound",
        path(&hold),
        "--out",
        path(&output_dir),
        "--rig",
        path(&rig),
        "--step-mm",
        "0.5",
    ];
    let common_options = [
        "--straight",
        path(&zero),
        "--force",
        path(&force),
        "--depth-mm",
        "30",
        "--overlay",
        path(&pictures),
    ];
    let import_json = json(&[&import[..], &common_options, &["--json"]].concat());
    assert_eq!(import_json["schema"], "guide.import/2");
    assert!(
        import_json["sweeps"][0]["states"]["used"].as_u64().expect("a count") >= 55,
        "{}",
        import_json["sweeps"][0]["states"]
    );
    assert_eq!(fs::read_dir(&pictures).expect("a folder").count(), 60);
    assert!(output_dir.join("hold.frames.json").exists());
    let written = Session::read(&output_dir).expect("reads").lateral[0].shape.clone();
    assert!(written.y_sd_m.is_some_and(|sd_m| sd_m.iter().all(|sd_m| (1e-8..1e-4).contains(sd_m))));
    let (native, imported) = (pooled(&native), pooled(&output_dir));
    let k_kpa = native["k_kpa"].as_f64().expect("a modulus");
    assert!((bound(0, &imported)..bound(1, &imported)).contains(&k_kpa), "{imported} and {native}");
    // A missing statement is named.
    assert!(failure(&import).contains("the straight needle: missing, expected --straight"));
    let nowhere = ["import", "ultrasound", path(&hold), "--out", path(&output_dir)];
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

fn bound(i: usize, imported: &serde_json::Value) -> f64 {
    imported["ci95_kpa"][i].as_f64().expect("a bound")
}

fn pooled(dir: &Path) -> serde_json::Value {
    json(&["identify", path(dir), "--json"])["pooled"].clone()
}

fn interpolated(z_m: f64, points: &[(f64, f64)]) -> f64 {
    let next_index = points.partition_point(|(at_m, _)| *at_m < z_m).clamp(1, points.len() - 1);
    let ((a, u), (b, v)) = (points[next_index - 1], points[next_index]);
    1e3 * (u + (v - u) * (z_m - a) / (b - a))
}

/// A lateral run at 12 kPa whose shape is not measured yet, and two scans of its needle: before it is moved, and displaced.
fn run_with_frames(session: &Path) {
    let beam =
        Beam::solve(&super::rig(), &Foundation::uniform(12e3).expect("a modulus"), 0.03).expect("solves");
    let scans = [(0.0, "zero"), (1.2e-3, "hold")].map(|(pushed_m, name)| {
        let axis_mm = (0..=116)
            .map(|i| {
                let z_mm = 70.5 + 0.25 * f64::from(i);
                [z_mm, 0.0, if pushed_m > 0.0 { 1e3 * beam.deflection_m(pushed_m, 1e-3 * z_mm) } else { 0.0 }]
            })
            .collect();
        let scan = Scan { scanner: ScannerConfig::default(), seed: 5, needle_mm: 1.27, axis_mm };
        let file = session.join(format!("{name}.igs.mha"));
        assert!(scan.write(&file).expect("written") > 100);
        file
    });
    let mut session = writer(session);
    let mut run = session.lateral("d30-1", 0.03).expect("a run");
    for row in 0..400 {
        let time_s = 0.02 * f64::from(row);
        let y_m = 1.2e-3 * ((time_s - 3.0) / 1.0).clamp(0.0, 1.0);
        let wobble = (2.3 * f64::from(row)).sin();
        let force_y_n = beam.force_n(y_m) + 5e-3 * wobble;
        let displacement_y_m = y_m + 2e-6 * wobble;
        run.force(&ForceRow { time_s, displacement_y_m, force_y_n, ..ForceRow::default() }).expect("a row");
    }
    for (time_s, frames) in [1.0, 6.0].into_iter().zip(scans) {
        run.frames(FrameSweep { time_s, frames }).expect("listed");
    }
    run.finish().expect("written");
}

#[test]
fn frames_of_a_run_become_its_shape() {
    let folder = folder();
    let session = folder.path();
    fs::create_dir_all(session).expect("a folder");
    run_with_frames(session);
    let import =
        ["import", "ultrasound", "--run", "d30-1", "--out", path(session), "--z-field", "ProbePosition"];
    let frame_options = ["--sweep-start-mm", "70.5", "--sweep-start-sd-mm", "0.02", "--json"];
    let import_json = json(&[&import[..], &frame_options].concat());
    let sweep = &import_json["sweeps"][0];
    assert!(import_json["straight"]["path"].as_str().expect("a path").ends_with("zero.igs.mha"));
    let used_count = sweep["states"]["used"].as_u64().expect("a count");
    assert!(used_count >= 100 && used_count < sweep["frames"].as_u64().expect("a count"), "{sweep}");
    // The scanner's frames are 0.1 s late.
    let [lag_s, sd_s] = ["lag_s", "lag_sd_s"].map(|name| sweep[name].as_f64().expect("a lag"));
    assert!((lag_s - 0.1).abs() < 4.0 * sd_s && sd_s < 0.02, "{lag_s} (sd {sd_s})");
    let shape = Session::read(session).expect("reads").lateral[0].shape.clone();
    assert!(shape.time_s.is_some_and(|times_s| times_s.iter().all(|time_s| *time_s == 6.0)));
    assert!(shape.z_shared_sd_m.is_some_and(|sd_m| sd_m.iter().all(|sd_m| (1.9e-5..1e-4).contains(sd_m))));
    let images = shape.images.expect("the columns of the images");
    assert!(images.iter().all(|image| (image.beam_rad.to_degrees() + 90.0).abs() < 1e-6));
    assert!(images.iter().any(|image| image.probe_m_per_s > 8e-3));
    assert!(images.iter().any(|image| image.probe_m_per_s < -8e-3));
    let pooled = json(&["identify", path(session), "--json"])["pooled"].clone();
    let bound = |i: usize| pooled["ci95_kpa"][i].as_f64().expect("a bound");
    assert!((bound(0)..bound(1)).contains(&12.0), "{pooled}");
    // Once more, as after another choice of options.
    json(&[&import[..], &frame_options].concat());
    assert!(
        failure(&[&import[..2], &["--run", "d31", "--out", path(session), "--step-mm", "1"]].concat())
            .contains("no lateral run of")
    );
}
