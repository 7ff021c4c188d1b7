//! The Python module on the firmware: what a fake device cannot show.

use crate::in_minutes::library::eventually;
use device::link::Client;
use protocol::{Fault, State};
use simulation::rig::config::RigConfig;
use std::io::{BufRead, BufReader};
use std::process::{Command, Stdio};
use system::bench::Bench;
use system::images::target_dir;
use system::module::installed;
use system::qemu::HANGS;

/// Moves guide 2 and prints a line when it has begun.
const MOVING: &str = "import sys\n\
                      from needle_guide import Device\n\
                      device = Device.open(sys.argv[1])\n\
                      device.run('staircase', progress=lambda block: print('moving', flush=True))\n";

/// In mid-move, with every sample sent: the device stops by itself within its limit of a silent host and names the cause.
#[test]
#[ignore = "needs QEMU: cargo xtask test --all runs it"]
fn a_guide_whose_interpreter_is_killed_stops_and_names_the_cause() {
    let python = match installed(&target_dir().join("debug")).unwrap() {
        Ok(installed) => installed.python,
        Err(reason) => return println!("not tested: {reason}"),
    };
    let bench = Bench::start(RigConfig::default(), 26, 4.0, HANGS).unwrap();
    let mut child = Command::new(python)
        .args(["-c", MOVING, &bench.port()])
        .stdin(Stdio::null())
        .stdout(Stdio::piped())
        .spawn()
        .unwrap();
    let mut lines = BufReader::new(child.stdout.take().unwrap()).lines();
    assert_eq!(lines.next().unwrap().unwrap(), "moving");
    eventually("it moves", || bench.rig().bridges_driven());
    // SIGKILL: nothing of the interpreter can send a stop.
    child.kill().unwrap();
    child.wait().unwrap();
    bench.rig().host_may_be_silent(true);
    let killed_ms = bench.rig().steps();
    let limit_ms = 2_000;
    eventually("its limit is over", || bench.rig().steps() > killed_ms + limit_ms + 1_000);
    assert!(bench.rig().released_since().is_some(), "a bridge still drives");
    let final_m = bench.rig().rig(|rig| rig.position_m());
    let mut client = Client::connect(&bench.port()).unwrap();
    let status = client.status().unwrap();
    assert_eq!((status.state, status.fault), (State::Faulted, Some(Fault::HostSilent)));
    let now_ms = bench.rig().steps();
    eventually("time passes", || bench.rig().steps() > now_ms + 1_000);
    let moved_m = bench.rig().rig(|rig| rig.position_m());
    assert_eq!(moved_m, final_m, "it moves on");
    bench.stop().unwrap();
}
