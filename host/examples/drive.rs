//! Connects to a device, prints its hello, runs the motion program `displace`, and counts the samples that arrive.
//!
//! `cargo xtask rig` starts a simulated rig and prints the port; `guide ports` lists the ports of this machine.
//!
//! ```sh
//! cargo run -p host --example drive -- PORT
//! ```

use anyhow::Context;
use device::link::{Client, LinkError, Program, RunOptions, Telemetry, run};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

fn main() -> anyhow::Result<()> {
    let port = std::env::args().nth(1).context("expected a port, such as /dev/ttyACM0")?;
    let program = Program::load("displace")?;

    let mut client = Client::connect(&port)?;
    let hello = client.hello();
    println!("device     {}, firmware {} ({})", hello.board, hello.firmware_version, hello.commit);
    println!("samples    one every {} us", hello.sample_period_us);

    // Ctrl-C stops the guide; what arrived until then is counted.
    let interrupted = Arc::new(AtomicBool::new(false));
    let flag = interrupted.clone();
    ctrlc::set_handler(move || flag.store(true, Ordering::Release))?;

    let (mut samples, mut lost, mut greatest_n) = (0, 0, 0.0_f64);
    let options = RunOptions { start_us: None, stream: true, interrupted: &interrupted };
    let outcome = run(&mut client, &program, options, |_, telemetry| {
        match telemetry {
            Telemetry::Samples(batch) => {
                samples += batch.points.len();
                lost += batch.lost_before;
                let forces_n = batch.points.iter().map(|point| point.force_n[1].abs());
                greatest_n = forces_n.fold(greatest_n, f64::max);
            }
            Telemetry::Event(event) => println!("event      {:?}", event.kind),
            Telemetry::Status(_) => {}
        }
        Ok::<(), LinkError>(())
    });
    println!("samples    {samples} arrived, {lost} lost; greatest vertical force {greatest_n:.3} N");
    outcome.with_context(|| format!("the program {} did not end as it should", program.name))
}
