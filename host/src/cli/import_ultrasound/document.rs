//! Report of `guide import ultrasound`, which is kept beside the shape.

use super::remarks;
use anyhow::Context;
use imaging::sweep::{Deflection, FrameResult, Line, State, Sweep};
use serde::Serialize;
use sha2::{Digest, Sha256};
use std::collections::BTreeMap;
use std::fmt::{self, Display};
use std::fs::File;
use std::io;
use std::path::{Path, PathBuf};

/// The sweep along the straight needle, and the line through it.
pub type Straight = (PathBuf, Sweep, Line);

/// Result of the frames.
#[derive(Serialize)]
pub struct Imported {
    schema: &'static str,
    session: PathBuf,
    lateral: Lateral,
    straight: Option<SweepResult>,
    /// Displacement of guide 2 while it was imaged, `[x, y]`, where the run has it.
    pub straight_displacement_mm: Option<[f64; 2]>,
    sweeps: Vec<SweepResult>,
    notes: Vec<String>,
}

#[derive(Serialize)]
struct Lateral {
    id: String,
    depth_mm: f64,
    sweeps: usize,
    points: usize,
    /// Times of the sweeps; none where the shape belongs to the last hold.
    time_s: Option<Vec<f64>>,
    has_force: bool,
}

#[derive(Serialize)]
struct SweepResult {
    path: PathBuf,
    /// Checksum of a single file.
    sha256: Option<String>,
    frames: usize,
    /// Frames in each state.
    states: BTreeMap<&'static str, usize>,
    points: usize,
    /// Median standard deviation of a point, without what all points share with the straight needle.
    sd_x_mm: f64,
    sd_y_mm: f64,
    lag_s: f64,
    /// Standard deviation of the estimate; `None` if the lag was given or is not identifiable.
    lag_sd_s: Option<f64>,
    /// Factor of the deviations from images with which they explain the residuals.
    noise_scale_x: f64,
    noise_scale_y: f64,
    correlated_frames: f64,
    per_frame: Vec<FrameEntry>,
}

#[derive(Serialize)]
struct FrameEntry {
    state: &'static str,
    time_s: Option<f64>,
    x_px: Option<f64>,
    y_px: Option<f64>,
    x_mm: Option<f64>,
    y_mm: Option<f64>,
    z_mm: Option<f64>,
    sd_x_mm: Option<f64>,
    sd_y_mm: Option<f64>,
    off_x_mm: Option<f64>,
    off_y_mm: Option<f64>,
}

impl Imported {
    pub fn new(
        session: &Path,
        id: &str,
        depth_mm: f64,
        time_s: Option<Vec<f64>>,
        has_force: bool,
        measured: &[(PathBuf, Sweep, Vec<Deflection>)],
        straight: Option<&Straight>,
    ) -> anyhow::Result<Self> {
        let lateral = Lateral {
            id: id.to_owned(),
            depth_mm,
            sweeps: measured.len(),
            points: measured.iter().map(|(_, _, points)| points.len()).sum(),
            time_s,
            has_force,
        };
        let straight_result = straight.map(|(path, sweep, _)| {
            let points: Vec<[f64; 2]> = sweep.points().iter().map(|point| point.sd_mm).collect();
            SweepResult::new(path, sweep, &points)
        });
        let sweeps = measured.iter().map(|(path, sweep, points)| {
            let points: Vec<[f64; 2]> = points.iter().map(|point| point.sd_mm).collect();
            SweepResult::new(path, sweep, &points)
        });
        let of_straight = straight.map(|(path, sweep, _)| remarks(path, sweep));
        let of_sweeps = measured.iter().flat_map(|(path, sweep, _)| remarks(path, sweep));
        Ok(Self {
            schema: "guide.import/2",
            session: session.to_owned(),
            lateral,
            straight: straight_result.transpose()?,
            straight_displacement_mm: None,
            sweeps: sweeps.collect::<anyhow::Result<_>>()?,
            notes: of_straight.into_iter().flatten().chain(of_sweeps).collect(),
        })
    }
}

impl SweepResult {
    fn new(path: &Path, sweep: &Sweep, sd_mm: &[[f64; 2]]) -> anyhow::Result<Self> {
        let states = State::ALL.into_iter().map(|state| (state.name(), sweep.count(state)));
        let [noise_scale_x, noise_scale_y] = sweep.track.noise.map(|noise| noise.scale);
        Ok(Self {
            path: path.to_owned(),
            sha256: path.is_file().then(|| checksum(path)).transpose()?,
            frames: sweep.frames.len(),
            states: states.filter(|(_, count)| *count > 0).collect(),
            points: sd_mm.len(),
            sd_x_mm: median(0, sd_mm),
            sd_y_mm: median(1, sd_mm),
            lag_s: sweep.lag_s,
            lag_sd_s: sweep.lag.map(|lag| lag.sd_s),
            noise_scale_x,
            noise_scale_y,
            correlated_frames: sweep.track.correlated_frames(),
            per_frame: sweep.frames.iter().map(FrameEntry::new).collect(),
        })
    }
}

fn median(axis: usize, sd_mm: &[[f64; 2]]) -> f64 {
    let mut sorted: Vec<f64> = sd_mm.iter().map(|sd_mm| sd_mm[axis]).collect();
    sorted.sort_by(f64::total_cmp);
    sorted.get(sorted.len() / 2).copied().unwrap_or(f64::NAN)
}

impl FrameEntry {
    fn new(frame: &FrameResult) -> Self {
        Self {
            state: frame.state.name(),
            time_s: frame.time_s,
            x_px: frame.candidate.map(|candidate| candidate.centre.x_px),
            y_px: frame.candidate.map(|candidate| candidate.centre.y_px),
            x_mm: place_of(0, frame.place_mm),
            y_mm: place_of(1, frame.place_mm),
            z_mm: place_of(2, frame.place_mm),
            sd_x_mm: frame.sd_mm.map(|sd| sd[0]),
            sd_y_mm: frame.sd_mm.map(|sd| sd[1]),
            off_x_mm: frame.off_mm.map(|off| off[0]),
            off_y_mm: frame.off_mm.map(|off| off[1]),
        }
    }
}

fn place_of(axis: usize, place_mm: Option<[f64; 3]>) -> Option<f64> {
    place_mm.map(|place| place[axis])
}

/// SHA-256 of a file in hexadecimal.
pub fn checksum(path: &Path) -> anyhow::Result<String> {
    let mut file = File::open(path).with_context(|| format!("{}: cannot read", path.display()))?;
    let mut hasher = Sha256::new();
    let mut buffer = vec![0; 1 << 16];
    loop {
        let count = io::Read::read(&mut file, &mut buffer)
            .with_context(|| format!("{}: cannot read", path.display()))?;
        let Some(bytes) = buffer.get(..count).filter(|bytes| !bytes.is_empty()) else { break };
        hasher.update(bytes);
    }
    Ok(hasher.finalize().iter().map(|byte| format!("{byte:02x}")).collect())
}

impl Display for Imported {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Lateral { id, depth_mm, sweeps, points, has_force, .. } = &self.lateral;
        let plural = if *sweeps == 1 { "" } else { "s" };
        let force = if *has_force { "with force" } else { "without force" };
        writeln!(
            f,
            "lateral run  {id}: {sweeps} sweep{plural} of {points} points in all, {depth_mm:.1} mm deep, {force}"
        )?;
        for (label, sweep) in self
            .straight
            .iter()
            .map(|sweep| ("straight", sweep))
            .chain(self.sweeps.iter().map(|sweep| ("sweep", sweep)))
        {
            let states: Vec<String> =
                sweep.states.iter().map(|(state, count)| format!("{count} {state}")).collect();
            writeln!(
                f,
                "{label:<12} {}: {} frames: {}",
                sweep.path.display(),
                sweep.frames,
                states.join(", ")
            )?;
            let lag = sweep
                .lag_sd_s
                .map_or_else(String::new, |sd_s| format!(", lag {:.3} s (sd {sd_s:.3})", sweep.lag_s));
            writeln!(
                f,
                "             {} points, sd x {:.3} y {:.3} mm{lag}",
                sweep.points, sweep.sd_x_mm, sweep.sd_y_mm
            )?;
        }
        if let Some([x_mm, y_mm]) = self.straight_displacement_mm {
            writeln!(
                f,
                "straight at  guide 2 x {x_mm:.4} y {y_mm:.4} mm: its part is added to every deflection"
            )?;
        }
        for note in &self.notes {
            writeln!(f, "note         {note}")?;
        }
        writeln!(f, "session      {}", self.session.display())
    }
}
