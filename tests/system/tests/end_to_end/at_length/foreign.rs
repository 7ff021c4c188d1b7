//! A client in Python that is made of the protocol's schema alone: it agrees with every test vector, and drives the rig.

use simulation::rig::config::RigConfig;
use std::path::Path;
use std::process::{Command, Output};
use system::bench::Bench;
use system::images::root;
use system::qemu::HANGS;

/// Runs the client; `None` where this computer has no Python.
fn client(arguments: &[&str]) -> Option<Output> {
    let client = root().join("tests/peers/guide_protocol.py");
    let spec = root().join("protocol/spec");
    let output = Command::new("python3").args([client.as_path(), Path::new(&spec)]).args(arguments).output();
    match output {
        Ok(output) => Some(output),
        Err(error) => {
            println!("no python3 here: {error}");
            None
        }
    }
}

fn succeeds(output: &Output) {
    let (printed, errors) =
        (String::from_utf8_lossy(&output.stdout), String::from_utf8_lossy(&output.stderr));
    assert!(output.status.success(), "{printed}{errors}");
    println!("{printed}");
}

#[test]
fn a_client_made_of_the_schema_agrees_with_every_vector() {
    if let Some(output) = client(&["vectors"]) {
        succeeds(&output);
    }
}

#[test]
#[ignore = "needs QEMU: cargo xtask test --all runs it"]
fn a_client_made_of_the_schema_drives_the_rig() {
    let bench = Bench::at_terminal(RigConfig::default(), 51, 4.0, HANGS).unwrap();
    if let Some(output) = client(&["port", &bench.port()]) {
        succeeds(&output);
    }
    bench.stop().unwrap();
}
