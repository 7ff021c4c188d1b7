//! `guide monitor` where it cannot work: one line, and no screen.

use super::{failure, folder, path};

#[test]
fn without_a_terminal_there_is_no_screen() {
    let line = failure(&["monitor", "--port", "/dev/no-such-port"]);
    assert_eq!(line, "error: needs a terminal; for machines use `guide status --json` or `guide record`");
}

#[test]
fn rejects_a_port_without_a_device() {
    for form in ["--once", "--json"] {
        let line = failure(&["monitor", "--port", "/dev/no-such-port", form]);
        assert!(line.starts_with("error: /dev/no-such-port: no such port"), "{line}");
    }
}

#[test]
fn a_model_that_cannot_be_followed_is_refused_before_the_device_is_touched() {
    let folder = folder();
    let (model, rig) = (folder.path().join("model.toml"), folder.path().join("rig.toml"));
    std::fs::write(&model, "[model]\nformat = 1\n").expect("written");
    let text = "[needle]\nyoungs_modulus_gpa = 200.0\nouter_diameter_mm = 1.27\ninner_diameter_mm = 1.0\nlength_mm = 130.0\n\
                [rig]\nguide2_mm = 60.0\nentry_mm = 70.0\n";
    std::fs::write(&rig, text).expect("written");
    let port = ["--port", "/dev/no-such-port"];
    let [model, rig] = [&model, &rig].map(|file| path(file));
    let follow = ["--json", "--follow", model, "--rig", rig, "--depth-mm", "30"];
    let line = failure(&[&["monitor"], &port[..], &follow[..]].concat());
    let expected = "model.toml: cannot be followed: [tissue]: no modulus, expected that of a model file of `guide diagnose --out`";
    assert!(line.ends_with(expected), "{line}");
    let line = failure(&[&["web"], &port[..], &follow[1..]].concat());
    assert!(line.ends_with(expected), "{line}");
    let output_path = folder.path().join("phantom");
    let record = [
        "record",
        "--out",
        path(&output_path),
        "--rig",
        rig,
        "--depth-mm",
        "0",
        "--follow",
        model,
        port[0],
        port[1],
    ];
    assert!(failure(&record).contains("--follow: in air no model has a force"));
}
