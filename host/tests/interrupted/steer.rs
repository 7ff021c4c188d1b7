//! `guide steer` interrupted at its terminal, and plants that do not start.

use super::{failure, files, guide};
use std::ffi::OsStr;
use std::fs;
use std::os::unix::process::CommandExt;
use std::process::Command;
use std::time::{Duration, Instant};

/// Longest wait for a run to begin.
const LIMIT: Duration = Duration::from_secs(600);
const STATEMENT: &str = r#"{"plant":"needle/1","needle":{},"rig":{"guide2_to_surface_mm":20,"move_while_pushing":false,"can_rotate":false},"limits":{"guide_travel_mm":6,"guide_speed_mm_s":4,"push_speed_mm_s":5,"rotation_speed_deg_s":0},"max_depth_mm":120,"depth_step_mm":1,"tip_noise_mm":0.1,"tip_delay_s":0.2,"tip_rate_hz":10,"guide_error_mm":0.1,"bevel_deg":0}"#;

/// A plant that answers once a second, whose command line `guide` gets.
fn slow_plant(folder: &std::path::Path) -> String {
    let script = format!(
        "echo '{STATEMENT}'\nwhile read line; do sleep 1; \
         echo \"${{line%?}},\\\"tip_seq\\\":0,\\\"tip_x_mm\\\":0,\\\"tip_y_mm\\\":0,\\\"valid\\\":false}}\"; done\n"
    );
    fs::write(folder.join("plant.sh"), script).expect("written");
    "sh plant.sh".to_owned()
}

/// The terminal's interrupt goes to every process of the foreground.
#[test]
fn an_interrupt_at_the_terminal_ends_a_steered_run_by_its_name_and_the_record_replays() {
    let folder = tempfile::tempdir().expect("a folder");
    let plant = slow_plant(folder.path());
    let arguments = ["steer", "made", "--plant", &plant, "--target-mm=1,0,50"];
    let mut command = guide(folder.path(), None, &arguments.map(OsStr::new));
    let child = command.process_group(0).spawn().expect("guide starts");
    let record = folder.path().join("made/steer.jsonl");
    let began = Instant::now();
    while !fs::read_to_string(&record).is_ok_and(|text| text.contains("{\"command\":")) {
        assert!(began.elapsed() < LIMIT, "the run does not begin");
        std::thread::sleep(Duration::from_millis(10));
    }
    let sent = Command::new("sh").args(["-c", &format!("kill -INT -{}", child.id())]).status();
    assert!(sent.expect("sh starts").success());
    let output = child.wait_with_output().expect("ended");
    let line = failure(&output, "steer");
    assert!(line.starts_with("error: interrupted: the run was interrupted"), "{line}");
    let text = fs::read_to_string(&record).expect("a record");
    assert!(text.ends_with("}\n") && text.contains("{\"fault\":{\"name\":\"interrupted\""), "{text}");
    let again = ["steer", "--replay", "made/steer.jsonl"].map(OsStr::new);
    let output = guide(folder.path(), None, &again).output().expect("guide starts");
    assert_eq!(failure(&output, "replay"), line);
}

#[test]
fn a_plant_that_does_not_start_is_reported_with_what_to_do() {
    let folder = tempfile::tempdir().expect("a folder");
    for (plant, parts) in [
        ("./no-such-program", &["plant_not_started", "is the program installed"][..]),
        (
            "sh no-such-script",
            &["plant_ended", "the program has ended (exit status", "Run the command by itself"],
        ),
    ] {
        let arguments = ["steer", "made", "--plant", plant, "--target-mm=1,0,50"].map(OsStr::new);
        let output = guide(folder.path(), None, &arguments).output().expect("guide starts");
        let line = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(1), "{line}");
        parts.iter().for_each(|part| assert!(line.contains(part), "{line}: expected {part}"));
    }
}

/// A plant whose needle goes straight; its readings scatter, or they would count as repeated.
const STRAIGHT: &str = "n=0\nwhile read line; do n=$((n+1)); case $line in *done*) break;; esac; \
    echo \"${line%?},\\\"tip_seq\\\":$n,\\\"tip_x_mm\\\":0.0$((n*7%10)),\\\"tip_y_mm\\\":0.0$((n*3%10)),\\\"valid\\\":true}\"; done\n\
    echo '{\"depth_mm\":20}'\n";

#[test]
fn figures_of_a_run_that_a_full_disk_does_not_take_are_reported_in_one_line() {
    let folder = tempfile::tempdir().expect("a folder");
    fs::write(folder.path().join("plant.sh"), format!("echo '{STATEMENT}'\n{STRAIGHT}")).expect("written");
    let run = ["steer", "made", "--plant", "sh plant.sh", "--target-mm=0,0,20", "--plots", "whole"];
    let output = guide(folder.path(), None, &run.map(OsStr::new)).output().expect("guide starts");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let whole = files(&folder.path().join("whole"));
    assert!(whole.len() >= 2, "figures of the path and of the target's plane");
    let replayed = |into: &str, limit_bytes| {
        let arguments = ["steer", "--replay", "made/steer.jsonl", "--plots", into].map(OsStr::new);
        guide(folder.path(), limit_bytes, &arguments).output().expect("guide starts")
    };
    for bytes in [0, 1_000] {
        let line = failure(&replayed("part", Some(bytes)), "replay");
        assert!(line.contains("part/steer."), "{line}");
        let remaining_files = files(&folder.path().join("part"));
        assert!(remaining_files.is_empty(), "{:?}", remaining_files.keys());
    }
    assert!(replayed("part", None).status.success());
    let content =
        |figures: &std::collections::BTreeMap<_, Vec<u8>>| figures.values().cloned().collect::<Vec<_>>();
    assert_eq!(content(&files(&folder.path().join("part"))), content(&whole));
}
