//! Sessions: what is written reads back, what is wrong is named, nothing panics.

use super::*;
use mechanics::Needle;
use proptest::prelude::*;
use std::fs;
use std::path::Path;
use tempfile::{TempDir, tempdir};

const TOML: &str = r#"# free comment
[session]
format = 1
name = "phantom A"
[needle]
youngs_modulus_gpa = 200
outer_diameter_mm = 1.27
inner_diameter_mm = 1.0
[rig]
guide2_mm = 60.0
entry_mm = 70.0
[noise]
force_n = 0.05
[[lateral]]
id = "a"
depth_mm = 20.0
force = "a.force.csv"
shape = "a.shape.csv"
"#;
const FORCE: &str = "time_s,displacement_y_mm,force_y_n\n0,0,0\n0.1,1.2,1\n";
const SHAPE: &str = "z_mm,deflection_y_mm\n80,1.5\n";

fn folder(toml: &str, force: &str, shape: &str) -> TempDir {
    let dir = tempdir().expect("a folder");
    for (name, text) in [("session.toml", toml), ("a.force.csv", force), ("a.shape.csv", shape)] {
        fs::write(dir.path().join(name), text).expect("a file");
    }
    dir
}

fn message(dir: &TempDir) -> String {
    let error = Session::read(dir.path()).expect_err("refused").to_string();
    error.replace(&format!("{}{}", dir.path().display(), std::path::MAIN_SEPARATOR), "")
}

fn setup() -> Setup {
    let rig = Rig::two_guides(Needle::gauge_18(), 0.06, 0.07);
    Setup {
        name: "a \"quoted\" name".to_owned(),
        rig,
        fixture_mass_kg: None,
        noise: Noise::default(),
        tissue: Default::default(),
    }
}

#[test]
fn plain_session_is_read_in_si() {
    let session = Session::read(folder(TOML, FORCE, SHAPE).path()).expect("reads");
    assert_eq!(session.name.as_deref(), Some("phantom A"));
    assert!((session.rig.needle.bending_stiffness_n_m2() - 0.015722163364917968).abs() < 1e-15);
    assert_eq!((session.rig.guide2_m, session.rig.entry_m), (0.06, 0.07));
    assert_eq!((session.noise.force_n, session.noise.shape_m), (Some(0.05), None));
    let run = &session.lateral[0];
    assert_eq!((run.id.as_str(), run.depth_m), ("a", 0.02));
    assert_eq!(run.force.displacement_y_m, [0.0, 1.2e-3]);
    assert_eq!((run.shape.time_s.clone(), run.shape.z_m[0]), (None, 0.08));
}

#[test]
fn how_points_were_imaged_is_stated_by_two_columns_or_none() {
    let shape = "z_mm,deflection_y_mm,beam_deg,probe_mm_per_s\n80,1.5,-90,5\n81,1.4,-90,-2.5\n";
    let session = Session::read(folder(TOML, FORCE, shape).path()).expect("reads");
    let image = session.lateral[0].shape.image(1).expect("an image");
    assert!((image.beam_rad + std::f64::consts::FRAC_PI_2).abs() < 1e-12);
    assert!((image.probe_m_per_s + 2.5e-3).abs() < 1e-12);
    let alone = folder(TOML, FORCE, "z_mm,deflection_y_mm,probe_mm_per_s\n80,1.5,5\n");
    assert_eq!(
        message(&alone),
        "a.shape.csv:1:1: beam_deg: missing, expected both columns or none, as there is probe_mm_per_s"
    );
}

#[test]
fn byte_order_mark_and_windows_lines_are_tolerated() {
    fn windows(text: &str) -> String {
        format!("\u{feff}{}", text.replace('\n', "\r\n"))
    }
    let theirs =
        Session::read(folder(&windows(TOML), &windows(FORCE), &windows(SHAPE)).path()).expect("reads");
    let ours = Session::read(folder(TOML, FORCE, SHAPE).path()).expect("reads");
    assert_eq!(theirs.lateral[0].force, ours.lateral[0].force);
    assert_eq!(theirs.rig, ours.rig);
}

#[test]
fn faults_in_the_session_file_name_their_place() {
    for (from, to, expected) in [
        (
            "depth_mm = 20.0",
            "depth_mm = 20000.0",
            "session.toml:16:12: lateral.depth_mm: 20000 is out of range, expected 0 (in air) or a number from 0.5 to 500",
        ),
        (
            "depth_mm = 20.0",
            "depth_mm = -20.0",
            "session.toml:16:12: lateral.depth_mm: -20 is out of range, expected 0 (in air) or a number from 0.5 to 500",
        ),
        (
            "depth_mm = 20.0",
            "depth_mm = nan",
            "session.toml:16:12: lateral.depth_mm: not a finite number, expected 0 (in air) or a number from 0.5 to 500",
        ),
        (
            "depth_mm = 20.0",
            "depth_mm = \"20\"",
            "session.toml:16:12: lateral.depth_mm: this is a string, expected 0 (in air) or a number from 0.5 to 500",
        ),
        (
            "depth_mm = 20.0",
            "",
            "session.toml:14:1: lateral.depth_mm: missing, expected 0 (in air) or a number from 0.5 to 500",
        ),
        (
            "format = 1",
            "format = 2",
            "session.toml:3:10: session.format: 2 is not known, expected 1, the format that this version of guide supports",
        ),
        ("[rig]", "[gir]", "session.toml:1:1: rig: missing, expected a table [rig]"),
        (
            "entry_mm = 70.0",
            "entry_mm = 50",
            "session.toml:11:12: rig.entry_mm: 50 is out of range, expected at least guide2_mm, 60",
        ),
        ("id = \"a\"", "id = \"\"", "session.toml:15:6: lateral.id: empty, expected a string"),
        (
            "[noise]",
            "[[lateral]]\nid = \"a\"\ndepth_mm = 1\nforce = \"a.force.csv\"\nshape = \"a.shape.csv\"\n[noise]",
            "session.toml:20:6: lateral.id: \"a\" appears twice, expected one run per id",
        ),
    ] {
        assert_eq!(message(&folder(&TOML.replace(from, to), FORCE, SHAPE)), expected);
    }
    assert!(message(&folder("[session", FORCE, SHAPE)).starts_with("session.toml:1:9: syntax: "));
}

#[test]
fn faults_in_the_data_name_their_place() {
    let force = FORCE.replace("0.1,1.2,1", "0.1,,1");
    assert_eq!(
        message(&folder(TOML, &force, SHAPE)),
        "a.force.csv:3:5: displacement_y_mm: empty, expected a number from -50 to 50"
    );
    let force = FORCE.replace("force_y_n", "force_y_n,force_x_n").replace("\n0,0,0\n0.1,1.2,1", "\n0,0,0,0");
    assert_eq!(
        message(&folder(TOML, &force, SHAPE)),
        "a.force.csv:1:1: displacement_x_mm: missing, expected both columns or none, as there is force_x_n"
    );
    assert!(
        message(&folder(&TOML.replace("a.shape", "b.shape"), FORCE, SHAPE))
            .contains(": lateral.shape: cannot read b.shape.csv: ")
    );
    let dir = folder(TOML, FORCE, SHAPE);
    fs::write(dir.path().join("a.shape.csv"), b"z_mm,deflection_y_mm\n80,\xff\n").expect("a file");
    assert_eq!(message(&dir), "a.shape.csv:2:4: text: a byte that is not UTF-8, expected UTF-8 text");
}

#[test]
fn every_kind_of_run_is_read() {
    let toml = format!(
        "{TOML}\n[[insertion]]\nid = \"i\"\npath = \"i.csv\"\n[[indentation]]\nid = \"r\"\nindenter_radius_mm = 2.1\n\
         poisson = 0.5\ndata = \"r.csv\"\n[[steering]]\nid = \"s\"\ndata = \"s.csv\"\n"
    );
    let dir = folder(&toml, FORCE, SHAPE);
    for (name, text) in [
        ("i.csv", "depth_mm,tip_y_mm,rotation_deg\n0,0,0\n5,0.1,180\n"),
        ("r.csv", "force_n,depth_mm\n0.3,3.5\n"),
        ("s.csv", "time_s,depth_mm,base_y_mm,base_force_y_n,tip_y_mm\n0,0,0,0,0\n"),
    ] {
        fs::write(dir.path().join(name), text).expect("a file");
    }
    let session = Session::read(dir.path()).expect("reads");
    assert_eq!(session.insertion[0].rotation_rad.as_ref().expect("rotation")[1], std::f64::consts::PI);
    assert!((session.indentation[0].indenter_radius_m - 0.0021).abs() < 1e-15);
    assert_eq!(session.indentation[0].depth_m, [0.0035]);
    assert_eq!(session.steering[0].time_s, [0.0]);
}

#[test]
fn runs_are_added_and_nothing_else_is_touched() {
    let dir = folder(TOML, FORCE, SHAPE);
    let mut writer = SessionWriter::open(dir.path(), &setup()).expect("opens");
    assert_eq!(writer.lateral_ids(), ["a"]);
    let mut run = writer.lateral("b", 0.03).expect("starts");
    run.force(&ForceRow { force_y_n: 0.5, ..ForceRow::default() }).expect("writes");
    run.shape(&ShapeRow { z_m: 0.08, ..ShapeRow::default() }).expect("writes");
    run.finish().expect("finishes");
    assert!(fs::read_to_string(dir.path().join("session.toml")).expect("text").starts_with(TOML));
    assert_eq!(Session::read(dir.path()).expect("reads").lateral[1].depth_m, 0.03);

    for id in ["a", "b", "", "../c", "c/d", ".c"] {
        assert!(matches!(writer.lateral(id, 0.02), Err(SessionError::Id { .. })), "{id}");
    }
    let mut run = writer.lateral("c", 0.02).expect("starts");
    let nan = ForceRow { force_y_n: f64::NAN, ..ForceRow::default() };
    assert!(matches!(run.force(&nan), Err(SessionError::NotFinite { field: "force_y_n", .. })));

    drop(writer);
    let mut other_setup = setup();
    other_setup.rig.entry_m = 0.075;
    let error = SessionWriter::open(dir.path(), &other_setup).expect_err("refused");
    assert!(matches!(error, SessionError::OtherRig { field: "entry_mm", .. }), "{error}");
}

#[test]
fn four_writers_of_one_session_lose_nothing() {
    four_writers(8);
}

#[test]
#[ignore = "takes 17 s: cargo xtask test --all runs it"]
fn four_writers_of_one_session_lose_nothing_in_a_hundred_rounds() {
    four_writers(100);
}

/// Each of four adds a run at the same time, into a session that none of them has made yet.
fn four_writers(rounds: u32) {
    for round in 0..rounds {
        let dir = tempdir().expect("a folder");
        let path = dir.path().join("new");
        std::thread::scope(|scope| {
            for number in 0..4 {
                let path = &path;
                scope.spawn(move || {
                    let run = SteeringRun {
                        id: format!("s{number}"),
                        path: PathBuf::new(),
                        time_s: vec![0.0, 0.1],
                        depth_m: vec![0.0, 0.001],
                        base_y_m: vec![0.0; 2],
                        base_force_y_n: vec![0.0; 2],
                        tip_y_m: vec![0.0; 2],
                    };
                    let mut writer = SessionWriter::open(path, &setup()).expect("its turn comes");
                    writer.steering(&run).expect("written");
                });
            }
        });
        let session = Session::read(&path).expect("reads");
        let mut ids: Vec<_> = session.steering.into_iter().map(|run| run.id).collect();
        ids.sort();
        assert_eq!(ids, ["s0", "s1", "s2", "s3"], "round {round}");
    }
}

#[test]
fn a_writer_that_has_the_session_is_named_to_the_next_one() {
    let dir = folder(TOML, FORCE, SHAPE);
    let writer = SessionWriter::open(dir.path(), &setup()).expect("opens");
    let error = SessionWriter::open(dir.path(), &setup()).expect_err("held");
    assert!(matches!(error, SessionError::Locked { .. }), "{error}");
    assert!(error.to_string().contains(&format!("process {}", std::process::id())), "{error}");
    drop(writer);
    SessionWriter::open(dir.path(), &setup()).expect("free again");
}

#[test]
fn what_runs_were_recorded_with_is_kept() {
    let dir = folder(TOML, FORCE, SHAPE);
    fn provenance(crc: u32) -> Provenance {
        Provenance {
            calibration_id: Some("unit \"7\"".to_owned()),
            calibration_crc: Some(crc),
            device: Some("B-L475E-IOT01A".to_owned()),
            firmware: Some("0.1.0 (1a2b3c4d-dirty)".to_owned()),
            tared: Some(true),
        }
    }
    for (id, crc) in [("b", 0x001a_2b3c), ("c", 0x1a2b_3c4d), ("d", 0x001a_2b3c)] {
        let mut writer = SessionWriter::open(dir.path(), &setup()).expect("opens");
        let mut run = writer.lateral(id, 0.03).expect("starts");
        run.made_with(provenance(crc));
        run.force(&ForceRow::default()).expect("writes");
        run.finish().expect("finishes");
    }
    let session = Session::read(dir.path()).expect("reads");
    assert_eq!(session.lateral[0].provenance, Provenance::default());
    assert_eq!(session.lateral[1].provenance, provenance(0x001a_2b3c));
    assert_eq!(session.calibrations(), [(0x001a_2b3c, vec!["b", "d"]), (0x1a2b_3c4d, vec!["c"])]);
    let text = fs::read_to_string(dir.path().join("session.toml")).expect("text");
    assert!(text.contains("calibration_crc = \"001a2b3c\""), "{text}");

    let wrong = TOML.replace("depth_mm = 20.0", "depth_mm = 20.0\ncalibration_crc = \"1a2b3c4\"");
    assert_eq!(
        message(&folder(&wrong, FORCE, SHAPE)),
        "session.toml:17:19: lateral.calibration_crc: \"1a2b3c4\", expected eight hexadecimal digits"
    );
}

#[test]
fn marks_are_read_where_there_are_any() {
    fn marks(header: &str, rows: [&str; 2]) -> Option<Vec<Mark>> {
        let force =
            format!("time_s,displacement_y_mm,force_y_n{header}\n0,0,0{}\n1,0,0{}\n", rows[0], rows[1]);
        Session::read(folder(TOML, &force, SHAPE).path()).expect("reads").lateral[0].force.marks.clone()
    }
    assert_eq!(marks("", ["", ""]), None);
    assert_eq!(marks(",step", [",", ","]), None, "a recording without a program");
    fn mark(step: Option<u32>, moving: Option<bool>) -> Mark {
        Mark { step, moving }
    }
    assert_eq!(marks(",step", [",", ",3"]), Some(vec![mark(None, None), mark(Some(3), None)]));
    assert_eq!(
        marks(",moving,step", [",1,0", ",0,1"]),
        Some(vec![mark(Some(0), Some(true)), mark(Some(1), Some(false))])
    );
}

fn read_back(rows: &[ForceRow], shape: &[ShapeRow], setup: &Setup, depth_m: f64) -> Session {
    let dir = tempdir().expect("a folder");
    let path = dir.path().join("new");
    let mut writer = SessionWriter::open(&path, setup).expect("opens");
    let mut run = writer.lateral("run-1", depth_m).expect("starts");
    rows.iter().for_each(|row| run.force(row).expect("writes"));
    shape.iter().for_each(|row| run.shape(row).expect("writes"));
    run.finish().expect("finishes");
    Session::read(&path).expect("reads")
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn written_sessions_read_back(
        name in "\\PC{1,20}x", depth in 1e-3..0.4f64, guide2 in 0.01..0.2f64, noise in proptest::option::of(1e-4..1.0f64),
        values in proptest::collection::vec((-0.01..0.01f64, -5.0..5.0f64, proptest::option::of(0..100u32), 0..10u64), 1..20),
    ) {
        let mut setup = setup();
        setup.name = name;
        (setup.rig.guide2_m, setup.rig.entry_m) = (guide2, guide2 + 0.01);
        setup.noise.force_n = noise;
        let rows: Vec<_> = values.iter().enumerate().map(|(i, (u, f, step, lost))| ForceRow {
            time_s: i as f64 * 0.05, displacement_y_m: *u, force_y_n: *f, displacement_x_m: -u, force_x_n: 0.5 * f,
            step: *step, moving: step.map(|step| step % 2 == 0), lost_before: *lost,
        }).collect();
        let shape: Vec<_> = values.iter().map(|(u, _, _, _)| ShapeRow {
            time_s: 1.0, z_m: 0.08, deflection_y_m: *u, deflection_x_m: 2.0 * u, image: None,
        }).collect();
        let session = read_back(&rows, &shape, &setup, depth);
        prop_assert_eq!(session.name.as_deref(), Some(setup.name.as_str()));
        fn close(a: f64, b: f64) -> bool {
            (a - b).abs() < 1e-9
        }
        prop_assert!(close(session.rig.guide2_m, guide2) && close(session.lateral[0].depth_m, depth));
        prop_assert_eq!(session.noise.force_n.is_some(), noise.is_some());
        let force = &session.lateral[0].force;
        for (i, row) in rows.iter().enumerate() {
            prop_assert!(close(force.time_s[i], row.time_s) && close(force.displacement_y_m[i], row.displacement_y_m));
            prop_assert!(close(force.force_x_n.as_ref().expect("x")[i], row.force_x_n));
            let mark = force.marks.as_ref().map_or(Mark::default(), |marks| marks[i]);
            prop_assert_eq!((mark.step, mark.moving), (row.step, row.moving));
            prop_assert_eq!(force.lost_before.as_ref().expect("lost")[i], row.lost_before as f64);
        }
        prop_assert!(close(session.lateral[0].shape.x_m.as_ref().expect("x")[0], shape[0].deflection_x_m));
    }

    #[test]
    fn arbitrary_bytes_never_panic(
        toml in prop_oneof![proptest::collection::vec(any::<u8>(), 0..200), Just(TOML.as_bytes().to_vec())],
        csv in proptest::collection::vec(any::<u8>(), 0..200), cut in any::<prop::sample::Index>(), byte in any::<u8>(),
    ) {
        let dir = folder(TOML, FORCE, SHAPE);
        let mut toml = toml;
        if !toml.is_empty() {
            let cut_index = cut.index(toml.len());
            toml[cut_index] = byte;
        }
        let write = |name: &str, bytes: &[u8]| fs::write(Path::join(dir.path(), name), bytes).expect("a file");
        write("session.toml", &toml);
        let _ = Session::read(dir.path());
        write("session.toml", TOML.as_bytes());
        write("a.force.csv", &csv);
        let _ = Session::read(dir.path());
        let mut force = FORCE.as_bytes().to_vec();
        let cut_index = cut.index(force.len());
        force[cut_index] = byte;
        write("a.force.csv", &force);
        let _ = Session::read(dir.path());
    }
}

/// Force and shape on the clock of a computer are those of a run that begins at 0, to the last bit.
#[test]
fn adding_a_constant_to_all_times_changes_nothing() {
    let read = |origin: u64| {
        let time = |hundredths: u64| format!("{}.{:02}", origin + hundredths / 100, hundredths % 100);
        let force: String = (0..900).map(|i| format!("{},0.{i:03},0.{i:03}\n", time(5 * i + 12))).collect();
        let shape: String = (0..20).map(|i| format!("{},{},0.5\n", time(4000 + i), 70 + i)).collect();
        let dir = folder(
            TOML,
            &format!("time_s,displacement_y_mm,force_y_n\n{force}"),
            &format!("time_s,z_mm,deflection_y_mm\n{shape}"),
        );
        let run = Session::read(dir.path()).expect("reads").lateral.remove(0);
        let origin_s = ForceSeries::clock_origin_s(&run.force_path).expect("reads");
        (run.force, run.shape, origin_s)
    };
    let (force, shape, origin_s) = read(0);
    assert_eq!((force.time_s[1], origin_s), (0.17, 0.0));
    for origin in [1_000_000, 1 << 30, 1_764_000_000] {
        assert_eq!(read(origin), (force.clone(), shape.clone(), origin as f64));
    }
    // The clock of a device that was started hours ago is its own.
    assert_eq!(read(90_000).2, 0.0);
}
