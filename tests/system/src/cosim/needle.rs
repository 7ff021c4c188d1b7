//! Guide 2 of the rig on a socket: a program that pushes a needle gets where guide 2 truly is and reports with which force the needle
//! loads it.
//!
//! One JSON object a line. The program: `{"at_m": [x, y], "force_n": [x, y], "stiffness_n_per_m"}`, or `null` where the needle does not
//! load the guide yet. The rig: `[x, y]`, where guide 2 is, metres. The load stays until the next one, also when the program has ended:
//! a needle that nobody pushes any more stays where it is.

use super::{State, lock};
use anyhow::{Context, Result};
use serde::{Deserialize, Serialize};
use simulation::rig::NeedleLoad;
use std::io::{BufRead, BufReader, Write};
use std::os::unix::net::{UnixListener, UnixStream};
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::thread;

/// A load as a line.
#[derive(Debug, Clone, Copy, Serialize, Deserialize)]
struct Line {
    at_m: [f64; 2],
    force_n: [f64; 2],
    stiffness_n_per_m: f64,
}

pub(super) fn serve(path: &Path, state: Arc<Mutex<State>>, stop: Arc<AtomicBool>) -> Result<()> {
    let listener = UnixListener::bind(path)
        .with_context(|| format!("cannot serve the position of guide 2 at {}", path.display()))?;
    thread::Builder::new().name("needle".into()).spawn(move || {
        for stream in listener.incoming() {
            if stop.load(Ordering::Acquire) {
                return;
            }
            if let Ok(stream) = stream {
                // A program that breaks off leaves its needle where it is.
                let _ = join(&stream, &state);
            }
        }
    })?;
    Ok(())
}

fn join(stream: &UnixStream, state: &Mutex<State>) -> Result<()> {
    let mut answers = stream.try_clone()?;
    for line in BufReader::new(stream).lines() {
        let load: Option<Line> = serde_json::from_str(&line?)?;
        let position_m = {
            let rig = &mut lock(state).rig;
            rig.set_load(load.map(|Line { at_m, force_n, stiffness_n_per_m }| NeedleLoad {
                at_m,
                force_n,
                stiffness_n_per_m,
            }));
            rig.position_m()
        };
        writeln!(answers, "{}", serde_json::to_string(&position_m)?)?;
    }
    Ok(())
}

/// Guide 2 of a rig, as a program that pushes a needle has it.
#[derive(Debug)]
pub struct GuideSocket {
    lines: BufReader<UnixStream>,
}

impl GuideSocket {
    /// Connects to a running rig.
    ///
    /// # Errors
    /// Where there is none.
    pub fn connect(socket: &Path) -> Result<Self> {
        let stream = UnixStream::connect(socket)
            .with_context(|| format!("no simulated guide at {}", socket.display()))?;
        Ok(Self { lines: BufReader::new(stream) })
    }

    /// Loads guide 2; where it is, metres.
    ///
    /// # Errors
    /// Where the rig has ended.
    pub fn load(&mut self, load: Option<NeedleLoad>) -> Result<[f64; 2]> {
        let line = load.map(|NeedleLoad { at_m, force_n, stiffness_n_per_m }| Line {
            at_m,
            force_n,
            stiffness_n_per_m,
        });
        writeln!(self.lines.get_mut(), "{}", serde_json::to_string(&line)?)?;
        let mut answer = String::new();
        self.lines.read_line(&mut answer)?;
        serde_json::from_str(&answer).context("the rig has ended")
    }
}
