//! `guide track --live`: base and force from the device, depth and tip from a tracker, estimates as they come.
//!
//! The device streams displacement and force of the actuated fixture; a tracker's program prints where the tip is, one line per
//! reading. Each line is joined with the mean of what the device has sent since the line before.

use super::output::Output;
use super::rig_args::{FaultNotes, interrupted};
use anyhow::{Context, bail};
use device::link::{Client, Program, RunOptions, Telemetry};
use estimator::{Estimate, Identifiability, Sample, SampleError, Value};
use formats::session::Session;
use inference::track::online::OnlineTracker;
use inference::track::{Options, tracker};
use protocol::Request;
use serde::Serialize;
use std::fmt::{self, Display};
use std::fs::File;
use std::io::{BufRead, BufReader, Read};
use std::sync::atomic::Ordering;
use std::sync::mpsc::{Receiver, TryRecvError, channel};
use std::thread;

/// Live tracking.
#[derive(clap::Args)]
pub struct LiveArgs {
    /// Track live data: base and force from --port, depth and tip from --tip
    #[arg(long, requires = "port", requires = "tip")]
    pub live: bool,
    /// Port of the device, as `guide ports` lists it, a socket, or tcp:HOST:PORT
    #[arg(long, value_name = "PORT", requires = "live")]
    port: Option<String>,
    /// File in which a tracker writes `depth_mm,tip_y_mm` line by line: a file, a pipe, or - for standard input;
    /// tracking stops at its end
    #[arg(long, value_name = "FILE", requires = "live")]
    tip: Option<String>,
    /// Motion program that the device runs meanwhile: a TOML file; tracking stops at its end
    #[arg(long, value_name = "FILE", requires = "live")]
    program: Option<String>,
}

/// One estimate, as a line of text or of JSON.
#[derive(Debug, Clone, Copy, Serialize)]
struct Line {
    time_s: f64,
    depth_mm: f64,
    stiffness_n_per_m2: Option<f64>,
    stiffness_ci95_n_per_m2: [f64; 2],
    damping_n_s_per_m2: Option<f64>,
    damping_ci95_n_s_per_m2: [f64; 2],
    tip_y_mm: f64,
    measured_tip_y_mm: f64,
    settled: bool,
}

impl Line {
    fn new(time_s: f64, estimate: &Estimate<f64>) -> Self {
        Self {
            time_s,
            depth_mm: 1e3 * estimate.depth_m,
            stiffness_n_per_m2: identified(estimate.stiffness),
            stiffness_ci95_n_per_m2: [estimate.stiffness.low, estimate.stiffness.high],
            damping_n_s_per_m2: identified(estimate.damping),
            damping_ci95_n_s_per_m2: [estimate.damping.low, estimate.damping.high],
            tip_y_mm: 1e3 * estimate.tip_m,
            measured_tip_y_mm: 1e3 * estimate.measured_tip_m,
            settled: estimate.settled,
        }
    }
}

fn identified(value: Value<f64>) -> Option<f64> {
    (value.identifiability == Identifiability::Identified).then_some(value.value)
}

impl Display for Line {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(
            f,
            "{:8.2} s  {:5.1} mm  stiffness {:<22} kN/m^2  damping {:<20} kN s/m^2  tip {:+.2} mm, simulated {:+.2} mm",
            self.time_s,
            self.depth_mm,
            value_text(self.stiffness_n_per_m2, self.stiffness_ci95_n_per_m2, 1),
            value_text(self.damping_n_s_per_m2, self.damping_ci95_n_s_per_m2, 2),
            self.measured_tip_y_mm,
            self.tip_y_mm
        )
    }
}

fn value_text(value: Option<f64>, [low, high]: [f64; 2], digits: usize) -> String {
    match value {
        Some(value) => {
            format!("{:.digits$} ({:.digits$} to {:.digits$})", 1e-3 * value, 1e-3 * low, 1e-3 * high)
        }
        None => "not identifiable".to_owned(),
    }
}

/// Mean of the device's samples since the last line of the tracker.
#[derive(Debug, Clone, Copy, Default)]
struct Mean {
    time_s: f64,
    base_m: f64,
    force_n: f64,
    count: f64,
}

/// Joins the two streams.
struct Joined {
    tracker: OnlineTracker<f64>,
    lines: Receiver<anyhow::Result<[f64; 2]>>,
    mean: Mean,
    /// Device time of the last sample.
    last_s: f64,
    refused: usize,
    ended: bool,
}

impl Joined {
    /// Takes what the device has sent; prints an estimate where there is a new one.
    fn take(&mut self, telemetry: &Telemetry, out: &mut Output) -> anyhow::Result<()> {
        let Telemetry::Samples(batch) = telemetry else { return Ok(()) };
        for point in &batch.points {
            self.mean.time_s += point.time_s;
            self.mean.base_m += point.displacement_m[1];
            self.mean.force_n += point.force_n[1];
            self.mean.count += 1.0;
        }
        if self.mean.count == 0.0 {
            return Ok(());
        }
        let [depth_m, tip_m] = match self.lines.try_recv() {
            Ok(line) => line?,
            Err(TryRecvError::Empty) => return Ok(()),
            Err(TryRecvError::Disconnected) => {
                self.ended = true;
                return Ok(());
            }
        };
        let Mean { time_s, base_m, force_n, count } = std::mem::take(&mut self.mean);
        let [time_s, base_m, force_n] = [time_s, base_m, force_n].map(|sum| sum / count);
        self.last_s = time_s;
        match self.tracker.update(&Sample { time_s, depth_m, base_m, force_n, tip_m }) {
            Ok(Some(estimate)) => {
                let line = Line::new(time_s, &estimate);
                out.line(&line, line)?;
            }
            Ok(None) => {}
            Err(why) => {
                self.refused += 1;
                if self.refused == 1 {
                    out.note(format_args!(
                        "a reading at {:.1} mm is rejected: {}",
                        1e3 * depth_m,
                        reason(why)
                    ));
                }
            }
        }
        Ok(())
    }
}

/// Runs until the tracker's lines or the program end, or the user interrupts.
pub fn run(args: &LiveArgs, session: &Session, options: &Options, out: &mut Output) -> anyhow::Result<()> {
    let (Some(port), Some(tip)) = (&args.port, &args.tip) else { bail!("--live needs --port and --tip") };
    let program = args.program.as_deref().map(Program::load).transpose()?;
    let mut joined = Joined {
        tracker: tracker(session, options)?,
        lines: tip_lines(tip)?,
        mean: Mean::default(),
        last_s: 0.0,
        refused: 0,
        ended: false,
    };
    let mut client = Client::connect(port)?;
    let interrupted = interrupted()?;
    if let Some(program) = program {
        let options = RunOptions { start_us: None, stream: true, interrupted };
        device::link::run(&mut client, &program, options, |_, telemetry| joined.take(telemetry, out))?;
    } else {
        let mut faults = FaultNotes::default();
        client.request(Request::Stream { enable: true })?;
        while !interrupted.load(Ordering::Acquire) && !joined.ended {
            match client.next(device::link::SILENCE_LIMIT)? {
                Some(telemetry) => {
                    faults.see(&telemetry, "tracking continues", out);
                    joined.take(&telemetry, out)?;
                }
                None => bail!(device::link::LinkError::Silent { port: port.clone() }),
            }
        }
        client.request(Request::Stream { enable: false })?;
    }
    if joined.refused > 0 {
        out.note(format_args!("{} readings were rejected", joined.refused));
    }
    match joined.tracker.finish() {
        Some(estimate) => {
            let line = Line::new(joined.last_s, &estimate);
            out.note(format_args!("at the end   {}", line.to_string().trim()));
        }
        None => out.note("too short for an estimate"),
    }
    Ok(())
}

fn reason(refused: SampleError) -> &'static str {
    match refused {
        SampleError::NotANumber => "it has a value that no rig can have",
        SampleError::TimeNotIncreasing => "the device's clock has not advanced",
        SampleError::TooDeep => "it is deeper than the needle or the estimator reaches",
    }
}

/// Depth and tip in m, line by line, read beside the link.
fn tip_lines(path: &str) -> anyhow::Result<Receiver<anyhow::Result<[f64; 2]>>> {
    let source: Box<dyn Read + Send> = if path == "-" {
        Box::new(std::io::stdin())
    } else {
        Box::new(File::open(path).with_context(|| format!("{path}: cannot read"))?)
    };
    let name = if path == "-" { "standard input".to_owned() } else { path.to_owned() };
    let (sender, receiver) = channel();
    thread::Builder::new().name("tip".to_owned()).spawn(move || {
        for (number, line) in BufReader::new(source).lines().enumerate() {
            let parsed = line.with_context(|| format!("{name}: cannot read")).and_then(|line| {
                parse(&line).with_context(|| format!("{name}, line {}: {line:?}", number + 1))
            });
            let Some(parsed) = parsed.transpose() else { continue };
            let end = parsed.is_err();
            if sender.send(parsed).is_err() || end {
                break;
            }
        }
    })?;
    Ok(receiver)
}

/// `None` if the line is empty, a comment or the header.
fn parse(line: &str) -> anyhow::Result<Option<[f64; 2]>> {
    let line = line.trim();
    if line.is_empty() || line.starts_with('#') || line.starts_with("depth_mm") {
        return Ok(None);
    }
    let numbers: Vec<Option<f64>> = line.split(',').map(|part| part.trim().parse().ok()).collect();
    match numbers.as_slice() {
        [Some(depth_mm), Some(tip_mm)] => Ok(Some([1e-3 * depth_mm, 1e-3 * tip_mm])),
        _ => bail!("expected depth_mm,tip_y_mm"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_of_a_tracker() {
        assert_eq!(parse("12.5, -3").expect("good"), Some([0.0125, -0.003]));
        for nothing in ["", "  ", "# a comment", "depth_mm,tip_y_mm"] {
            assert_eq!(parse(nothing).expect("good"), None);
        }
        for bad in ["12.5", "1,2,3", "a,b", "1;2"] {
            assert!(parse(bad).expect_err("bad").to_string().contains("expected depth_mm,tip_y_mm"));
        }
    }
}
