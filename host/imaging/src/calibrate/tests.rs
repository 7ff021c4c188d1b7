use super::*;
use nalgebra::{Matrix4, Rotation3, Vector3, Vector4};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};

fn data(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data").join(name)
}

fn phantom() -> Phantom {
    Phantom::read(&data("plus-fcal.xml")).expect("a phantom")
}

fn settings() -> Settings {
    Settings {
        about_mm_per_px: None,
        orientation: None,
        region: None,
        probe: "ProbeToTracker".to_owned(),
        reference: Some("ReferenceToTracker".to_owned()),
        echo_mm: 1.5,
    }
}

/// Every eighth frame of the sequence that PLUS tests its own calibration with: of all of them its error is 0.54 mm.
#[test]
fn a_real_sequence_over_n_wires_calibrates_as_well_as_in_plus() {
    let mut sequence = Sequence::open(&data("plus-nwire.igs.mha")).expect("frames");
    let plane = calibrate(&mut sequence, &phantom(), &settings(), |_| {}).expect("a plane");
    let [fit_errors, validation] = plane.errors;
    assert!(plane.observations.len() >= 22 && validation.frames >= 9, "{:?}", plane.states);
    assert!(validation.slanted_mean_mm < 0.65 && fit_errors.slanted_mean_mm < 0.65, "{:?}", plane.errors);
    let [x, y] = plane.solution.spacing_mm;
    // As fCal's own calibration of the probe has it, 0.0796 and 0.0745 mm.
    assert!((x - 0.0796).abs() < 0.0016 && (y - 0.0745).abs() < 0.0015, "{x} {y}");
}

/// A pose from angles in radians and a place.
fn pose(angles: [f64; 3], place: [f64; 3]) -> Matrix4<f64> {
    let mut pose = Rotation3::from_euler_angles(angles[0], angles[1], angles[2]).to_homogeneous();
    pose.fixed_view_mut::<3, 1>(0, 3).copy_from(&Vector3::from(place));
    pose
}

/// A probe whose plane is known moves along the wires and turns; every wire is a spot where the plane cuts it.
#[test]
fn a_simulated_plane_is_found_where_it_is() {
    const SIZE: [usize; 2] = [500, 360];
    const SPACING: [f64; 2] = [0.1, 0.09];
    let phantom = phantom();
    let mut random = ChaCha8Rng::seed_from_u64(11);
    // The image's second axis goes down, to wires of smaller z.
    let image_to_probe = pose([0.03, -0.02, 0.05], [-25.0, 8.0, 3.0]);
    let to_reference = Matrix4::from_row_slice(&phantom.registration("Reference").expect("a registration"));
    let (mut header, mut pixels) = (String::new(), Vec::new());
    const FRAMES: usize = 24;
    let _ = write!(
        header,
        "DimSize = {} {} {FRAMES}\nElementSpacing = 1 1\nElementType = MET_UCHAR\nUltrasoundImageOrientation = MF\n",
        SIZE[0], SIZE[1]
    );
    for frame in 0..FRAMES {
        // Image axes in the phantom: x along x, second axis along -z, normal along y.
        let base = Matrix4::from_row_slice(&[
            1.,
            0.,
            0.,
            22.,
            0.,
            0.,
            1.,
            6. + 1.2 * frame as f64,
            0.,
            -1.,
            0.,
            26.,
            0.,
            0.,
            0.,
            1.,
        ]);
        let image_to_phantom = base
            * pose(
                [
                    random_turn(0.12, &mut random),
                    random_turn(0.12, &mut random),
                    random_turn(0.06, &mut random),
                ],
                [random_turn(1.0, &mut random), random_turn(1.0, &mut random), 0.0],
            );
        let phantom_to_image = image_to_phantom.try_inverse().expect("rigid");
        let mut spots = Vec::new();
        for wire in phantom.patterns.iter().flatten() {
            let [a, b] =
                [wire.front, wire.back].map(|p| phantom_to_image * Vector4::new(p[0], p[1], p[2], 1.0));
            let cut = a + (b - a) * (-a.z / (b.z - a.z));
            spots.push([cut.x / SPACING[0], cut.y / SPACING[1]]);
        }
        for i in 0..SIZE[0] * SIZE[1] {
            let (x, y) = ((i % SIZE[0]) as f64, (i / SIZE[0]) as f64);
            let spot_distances =
                spots.iter().map(|[sx, sy]| ((x - sx) / 6.0).powi(2) + ((y - sy) / 3.0).powi(2));
            let least = spot_distances.fold(f64::INFINITY, f64::min);
            pixels.push((10.0 + 200.0 * (-0.5 * least).exp()) as u8);
        }
        let probe_to_reference =
            to_reference * image_to_phantom * image_to_probe.try_inverse().expect("rigid");
        let _ = write!(
            header,
            "Seq_Frame{frame:04}_ProbeToTrackerTransform = {}\nSeq_Frame{frame:04}_ReferenceToTrackerTransform = {}\n",
            matrix_text(&probe_to_reference),
            matrix_text(&Matrix4::identity())
        );
    }
    header.push_str("ElementDataFile = LOCAL\n");
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("nwire.mha");
    std::fs::write(&path, [header.into_bytes(), pixels].concat()).expect("a file");
    let approximate_settings = Settings { about_mm_per_px: Some(0.1), ..settings() };
    let plane =
        calibrate(&mut Sequence::open(&path).expect("frames"), &phantom, &approximate_settings, |_| {})
            .expect("a plane");
    let solution = &plane.solution;
    assert!(plane.observations.len() >= 20, "{:?}", plane.states);
    for (spacing, truth) in solution.spacing_mm.iter().zip(SPACING) {
        assert!((spacing / truth - 1.0).abs() < 2e-3, "{solution:?}");
    }
    for i in 0..12 {
        let truth = image_to_probe[(i / 4, i % 4)];
        let tolerance = if i % 4 == 3 { 0.1 } else { 0.005 };
        assert!((solution.image_to_probe[i] - truth).abs() < tolerance, "{i}: {solution:?}, {truth}");
    }
    assert!(plane.errors[1].slanted_mean_mm < 0.1, "{:?}", plane.errors);
}

fn matrix_text(of: &Matrix4<f64>) -> String {
    (0..16).map(|i| format!("{:.9}", of[(i / 4, i % 4)])).collect::<Vec<_>>().join(" ")
}

fn random_turn(most: f64, random: &mut ChaCha8Rng) -> f64 {
    random.random_range(-most..most)
}

#[test]
fn phantoms_that_are_none_are_refused_with_one_line() {
    let text = std::fs::read_to_string(data("plus-fcal.xml")).expect("a file");
    let path = Path::new("phantom.xml");
    for (from, to, expected) in [
        ("EndPointBack=\"30.0 40.0 20.0\"", "EndPointBack=\"30.0 40.0\"", "three coordinates"),
        ("EndPointBack=\"30.0 40.0 20.0\"", "EndPointBack=\"44.0 40.0 20.0\"", "parallel"),
        (
            "EndPointFront=\"55.0 0.0 20.0\" EndPointBack=\"35.0 40.0 20.0\"",
            "EndPointFront=\"55 0 20\" EndPointBack=\"55 40 20\"",
            "slanted",
        ),
        ("15.6642", "nan", "16 numbers"),
        ("Type=\"NWire\"", "Type=\"CIRS\"", "two or more"),
        ("</PlusConfiguration>", "</Plus>", "XML"),
    ] {
        let changed = if to == "Type=\"CIRS\"" { text.replace(from, to) } else { text.replacen(from, to, 1) };
        let error = Phantom::parse(path, &changed).expect_err(to).to_string();
        assert!(error.starts_with("phantom.xml: ") && error.contains(expected), "{error}");
        assert!(!error.contains('\n'), "{error}");
    }
    assert!(Phantom::parse(path, "").is_err() && Phantom::parse(path, "<a").is_err());
}

#[test]
fn sequences_without_wires_or_transforms_are_refused() {
    let mut sequence = Sequence::open(&data("plus-wire5.igs.mha")).expect("frames");
    let error = calibrate(&mut sequence, &phantom(), &settings(), |_| {}).expect_err("one wire").to_string();
    assert!(error.contains("ProbeToTracker"), "{error}");
    let mut sequence = Sequence::open(&data("plus-nwire.igs.mha")).expect("frames");
    let wrong = Settings { about_mm_per_px: Some(0.3), ..settings() };
    let phantom = phantom();
    let error = calibrate(&mut sequence, &phantom, &wrong, |_| {}).expect_err("wrong size").to_string();
    assert!(error.contains("0 of 24 frames show all 3 patterns"), "{error}");
}
