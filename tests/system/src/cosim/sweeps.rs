//! The rig's ultrasound probe on a socket: one sweep per connection, as text that `guide acquire` takes.

use super::{State, lock};
use anyhow::{Context, Result};
use simulation::rig::SimulatedRig;
use std::io::{Read, Write};
use std::os::unix::net::{UnixListener, UnixStream};
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::thread;
use std::time::Duration;

pub(super) fn serve(path: &Path, state: Arc<Mutex<State>>, stop: Arc<AtomicBool>) -> Result<()> {
    let listener = UnixListener::bind(path)
        .with_context(|| format!("cannot serve ultrasound sweeps at {}", path.display()))?;
    thread::Builder::new().name("ultrasound".into()).spawn(move || {
        for stream in listener.incoming() {
            if stop.load(Ordering::Acquire) {
                return;
            }
            if let Ok(mut stream) = stream {
                let text = sweep_csv(&mut lock(&state).rig);
                // A client that has gone away takes no sweep; the next one will.
                let _ = stream.write_all(text.as_bytes());
            }
        }
    })?;
    Ok(())
}

fn sweep_csv(rig: &mut SimulatedRig) -> String {
    let mut text = String::from("z_mm,deflection_x_mm,deflection_y_mm\n");
    for sample in rig.sweep() {
        let [x, y] = sample.deflection_m.map(|metres| metres * 1e3);
        text += &format!("{:.3},{x:.4},{y:.4}\n", sample.z_m * 1e3);
    }
    text
}

/// Takes one sweep from a rig that serves them: what `xtask sweep` prints.
///
/// # Errors
/// Where nobody serves there.
pub fn take_sweep(socket: &Path) -> Result<String> {
    let mut stream = UnixStream::connect(socket)
        .with_context(|| format!("no simulated ultrasound at {}", socket.display()))?;
    stream.set_read_timeout(Some(Duration::from_secs(5)))?;
    let mut text = String::new();
    stream.read_to_string(&mut text).context("the simulated ultrasound broke off")?;
    Ok(text)
}
