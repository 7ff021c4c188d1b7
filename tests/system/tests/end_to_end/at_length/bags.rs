//! Bags of ROS 2 and files of MATLAB by other people's writers, made when the test runs: what `guide import table` takes out of them is what
//! was put in.

use formats::session::Session;
use std::io::Write;
use std::process::Command;
use system::images::build_guide;
use system::peers;

/// Writers of bags for Python, and of files of MATLAB.
const PACKAGES: [&str; 3] = ["rosbags==0.11.9", "mcap-ros2-support==0.6.0", "scipy==1.17.1"];

/// Displacement of the push at a time, metres.
fn pushed_m(time_s: f64) -> f64 {
    1.2e-3 * (time_s - 1.0).clamp(0.0, 1.0)
}

#[test]
#[ignore = "installs packages for Python: cargo xtask test --all runs it"]
fn bags_and_arrays_of_other_writers_become_sessions_with_their_values() {
    let python = match peers::environment("bags", &PACKAGES) {
        Ok(python) => python,
        // Past the test harness, which shows nothing of tests that pass.
        Err(why) => {
            let _ = writeln!(std::io::stderr(), "skipped: {why}");
            return;
        }
    };
    let guide = build_guide().unwrap();
    let folder = tempfile::tempdir().unwrap();
    let script =
        Command::new(python).arg(peers::scripts().join("bags.py")).arg(folder.path()).output().unwrap();
    assert!(script.status.success(), "{}", String::from_utf8_lossy(&script.stderr));
    // Joint states begin half a period later, and are interpolated at the forces.
    for (name, maps, rows, first_s) in [
        ("rosbags.mcap", of_bag("point"), 59, 0.05),
        ("mcap-none.mcap", of_bag("position"), 59, 0.05),
        ("mcap-lz4.mcap", of_bag("position"), 59, 0.05),
        ("mcap-zstd.mcap", of_bag("position"), 59, 0.05),
        ("plain.mat", of_arrays(), 60, 0.0),
        ("packed.mat", of_arrays(), 60, 0.0),
    ] {
        let session_path = folder.path().join(format!("session-{name}"));
        let mut import = Command::new(&guide);
        import.current_dir(folder.path()).args([
            "import",
            "table",
            name,
            "--depth-mm",
            "30",
            "--yes",
            "--out",
        ]);
        import.arg(&session_path).args(maps.iter().flat_map(|map| ["--map", map.as_str()]));
        if rows == 59 {
            import.args(["--z-from", "guide1"]);
        }
        let output = import.output().unwrap();
        let echo = String::from_utf8_lossy(&output.stderr);
        assert!(output.status.success(), "{name}: {echo}");
        // Images beside the readings are named, and not taken.
        assert_eq!(name.starts_with("mcap"), echo.contains("/camera/image_raw"), "{name}: {echo}");
        let run = Session::read(&session_path).unwrap().lateral.remove(0);
        assert_eq!(run.force.time_s.len(), rows, "{name}");
        for ((t, y_m), f) in
            run.force.time_s.iter().zip(&run.force.displacement_y_m).zip(&run.force.force_y_n)
        {
            let truth_m = pushed_m(t + first_s);
            // Between two readings of the corner of the ramp the displacement is a chord.
            assert!(
                (f - 250.0 * truth_m).abs() < 1e-8 && (y_m - truth_m).abs() < 3.1e-5,
                "{name} {t}: {f} {y_m}"
            );
        }
        if rows == 59 {
            assert_eq!(run.shape.z_m, [0.03; 3], "{name}");
            let times_s = run.shape.time_s.as_ref().unwrap();
            for (time_s, y_m) in times_s.iter().zip(&run.shape.y_m) {
                assert!((y_m - 0.5 * pushed_m(time_s + first_s)).abs() < 1e-9, "{name} {time_s}: {y_m}");
            }
        }
    }
    // Frames in a bag are for another program to play.
    let mut frames = Command::new(&guide);
    frames.current_dir(folder.path()).args([
        "import",
        "ultrasound",
        "mcap-none.mcap",
        "--straight",
        "mcap-none.mcap",
    ]);
    let output = frames.args(["--step-mm", "1", "--out", "none"]).output().unwrap();
    let printed = String::from_utf8_lossy(&output.stderr);
    assert!(
        !output.status.success() && printed.contains("a bag of ROS") && printed.contains("image_saver"),
        "{printed}"
    );
}

fn of_bag(tip: &str) -> Vec<String> {
    ["/ft:force.y=force_y_n", "/joint_states:guide.position=displacement_y_mm:m"]
        .map(str::to_owned)
        .into_iter()
        .chain([format!("/tip:{tip}.z=z_mm"), format!("/tip:{tip}.y=deflection_y_mm")])
        .collect()
}

fn of_arrays() -> Vec<String> {
    ["t=time_s:s", "x=displacement_y_mm:m", "f=force_y_n:N"].map(str::to_owned).to_vec()
}
