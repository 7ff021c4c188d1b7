use crate::cli::call::call;
use formats::session::Session;
use serde_json::Value;
use std::ffi::OsString;
use std::fmt::Write as _;
use std::fs;
use std::path::{Path, PathBuf};

/// A clip of a vibrating beam that others recorded, 15 frames over 0.47 s.
fn beam() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("imaging/tests/data/camera/beam.mha")
}

fn import(options: &str, clip: &Path, to: &Path) -> Result<Value, String> {
    let clip = [OsString::from("import"), "camera".into(), clip.into(), "--out".into(), to.into()];
    let options = options.split_whitespace().map(OsString::from);
    let called = call(clip.into_iter().chain(options), |_| {}).map_err(|error| error.message)?;
    Ok(serde_json::from_str(&called.document).expect("JSON"))
}

const CLIP: &str = "--template 70,5,46,30 --mm-per-px 0.05";

/// A force series of a force sensor alone, every 10 ms from 10 s on.
fn force(folder: &Path) -> PathBuf {
    let mut text = "time_s,force_y_n\n".to_owned();
    for row in 0..100 {
        let _ = writeln!(text, "{:.2},{}", 10.0 + 0.01 * f64::from(row), 0.5 + 0.001 * f64::from(row));
    }
    let path = folder.join("load.csv");
    fs::write(&path, text).expect("a file");
    path
}

#[test]
fn a_clip_becomes_the_displacement_of_a_run_with_its_deviation() {
    let folder = tempfile::tempdir().expect("a folder");
    let (session_dir, load) = (folder.path().join("session"), force(folder.path()));
    let pictures = folder.path().join("pictures");
    let options = format!(
        "{CLIP} --force {} --depth-mm 40 --start-s 10.1 --overlay {}",
        load.display(),
        pictures.display()
    );
    let document = import(&options, &beam(), &session_dir).expect("imported");
    assert_eq!(document["camera"]["states"]["used"], 15, "{document}");
    assert_eq!(document["camera"]["files"][0]["sha256"].as_str().map(str::len), Some(64));
    let run = &Session::read(&session_dir).expect("a session").lateral[0];
    let sd_m = run.force.displacement_y_sd_m.as_ref().expect("deviations");
    // Rows from the first frame at 10.1 s to the last 0.467 s later; the force has no horizontal part.
    assert_eq!(run.force.time_s.first(), Some(&10.1));
    assert!(
        (run.force.time_s.last().expect("rows") - 10.56).abs() < 1e-9 && sd_m.len() == 47,
        "{:?}",
        run.force.time_s
    );
    assert!(sd_m.iter().all(|sd_m| (1e-8..2e-6).contains(sd_m)), "{sd_m:?}");
    assert_eq!(document["lateral"]["rows_without_displacement"], 53);
    assert!(run.force.displacement_x_m.is_none() && run.shape.z_m.is_empty());
    assert!(
        Session::read(&session_dir)
            .expect("a session")
            .stated_noise()
            .displacement_m
            .is_some_and(|sd_m| sd_m < 2e-6)
    );
    assert_eq!(fs::read_dir(&pictures).expect("pictures").count(), 15);
    let sheet = fs::read(session_dir.join("beam.frames.png")).expect("a sheet");
    assert!(sheet.starts_with(b"\x89PNG"));
    let csv = fs::read_to_string(session_dir.join("beam.camera.csv")).expect("a file");
    assert_eq!(csv.lines().count(), 16);
    let rotated_import =
        import(&format!("{CLIP} --up-px 0,1"), &beam(), &folder.path().join("turned")).expect("imported");
    assert!(
        (largest_y_mm(&document) + largest_y_mm(&rotated_import)).abs() < 1e-9,
        "{document} {rotated_import}"
    );
}

/// Up in the image is up; turned by 180 degrees it is down.
fn largest_y_mm(document: &Value) -> f64 {
    document["camera"]["largest_y_mm"].as_f64().expect("a number")
}

#[test]
fn a_ruler_gives_the_scale_and_how_well_it_is_known() {
    let folder = tempfile::tempdir().expect("a folder");
    let options = "--template 70,5,46,30 --ruler 0,10,100,10,5";
    let document = import(options, &beam(), &folder.path().join("ruler")).expect("imported");
    let camera = &document["camera"];
    assert!((camera["mm_per_px"].as_f64().expect("a scale") - 0.05).abs() < 1e-12);
    assert!(
        (camera["mm_per_px_sd"].as_f64().expect("a deviation") - 0.05 * 2f64.sqrt() * 0.5 / 100.0).abs()
            < 1e-12
    );
    assert!(document["lateral"].is_null());
}

/// One line each that states what is expected; nothing is written.
#[test]
fn wrong_clips_and_options_are_refused_with_one_line() {
    let folder = tempfile::tempdir().expect("a folder");
    let load = force(folder.path());
    let late = format!("{CLIP} --depth-mm 40 --start-s 99 --force {}", load.display());
    let without_depth = format!("{CLIP} --force {}", load.display());
    let image = Path::new(env!("CARGO_MANIFEST_DIR")).join("imaging/tests/data/others/src-00.png");
    for (options, clip, expected) in [
        ("--mm-per-px 0.05", beam(), "--template: missing"),
        ("--template 70,5,46,30", beam(), "--mm-per-px"),
        ("--template 100,5,46,30 --mm-per-px 0.05", beam(), "is not inside the frames of 120 x 40"),
        ("--template 70,5,46,30 --mm-per-px 0", beam(), "0.0001 to 10"),
        ("--template 70,5,46,30 --ruler 1,1,2,2,5", beam(), "10 pixels apart"),
        ("--template 2,2,8,8 --mm-per-px 0.05 --fps 30", image.clone(), "--template"),
        (&format!("{CLIP} --step-mm 1"), beam(), "expected them with ultrasound only"),
        (&format!("{CLIP} --axis 0,0,1"), beam(), "points in space"),
        (&without_depth, beam(), "--depth-mm"),
        (&late, beam(), "--start-s"),
        (CLIP, PathBuf::from("no-such.avi"), "no-such.avi"),
    ] {
        let output_path = folder.path().join("nothing");
        let error = import(options, &clip, &output_path).expect_err(options);
        assert!(error.contains(expected) && !error.contains('\n'), "{options}: {error}");
        assert!(!output_path.exists(), "{options}");
    }
    let frames = [&image, &image].map(|path| path.display().to_string()).join(" ");
    let error = import(
        &format!("{frames} --template 20,20,20,20 --mm-per-px 0.05"),
        &image,
        &folder.path().join("x"),
    );
    assert!(error.is_err_and(|error| error.contains("--fps") || error.contains("--template")));
}
