//! Rows of a recording that no result uses, with the reason: every run, hold, sweep and shape point is either used or
//! in this list.

use super::{Hold, HoldCriteria, sweeps::UnassignedPoints};
use formats::session::{LateralRun, Session};
use mechanics::Rig;
use serde::Serialize;
use std::fmt;

/// Shape points this far beyond the tip are taken as on it.
pub const BEYOND_TIP_M: f64 = 0.5e-3;

/// A part of a lateral run that is not used.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct UnusedPart {
    /// The run.
    pub run: String,
    /// `run`, `hold`, `sweep`, or `points` of a sweep.
    pub part: &'static str,
    /// First and last time; nothing for a whole run and for points without times.
    pub time_s: Option<[f64; 2]>,
    /// Number of shape points, or of samples of a hold.
    pub count: usize,
    /// Why it is not used.
    pub reason: String,
}

impl fmt::Display for UnusedPart {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { part, time_s, count, reason, .. } = self;
        write!(f, "{part} ")?;
        match time_s {
            Some([from_s, to_s]) if to_s - from_s < 0.005 => write!(f, "at {from_s:.2} s ")?,
            Some([from_s, to_s]) => write!(f, "from {from_s:.2} to {to_s:.2} s ")?,
            None => {}
        }
        let samples_or_points = if *part == "hold" { "samples" } else { "points" };
        write!(f, "({count} {samples_or_points}) not used: {reason}")
    }
}

impl UnusedPart {
    /// A whole run.
    pub fn run(run: &LateralRun, reason: String) -> Self {
        Self { run: run.id.clone(), part: "run", time_s: None, count: run.shape.z_m.len(), reason }
    }
}

/// Rows of a run that are not used: holds with lost samples, sweeps and points of sweeps that belong to no hold or lie
/// off the needle.
pub fn unused(run: &LateralRun, rig: &Rig, criteria: &HoldCriteria) -> Vec<UnusedPart> {
    let (levels, strays) = super::survey(run, criteria);
    let of_holds = levels.iter().enumerate().filter(|(_, level)| level.lost_samples > 0);
    let mut parts_found: Vec<UnusedPart> = of_holds
        .map(|(number, level)| UnusedPart {
            run: run.id.clone(),
            part: "hold",
            time_s: Some(level.time_s),
            count: level.displacement_y_m.samples,
            reason: format!(
                "hold {} lost {} samples: the link was too slow or damaged, record it again",
                number + 1,
                level.lost_samples
            ),
        })
        .collect();
    parts_found.extend(strays.into_iter().map(|UnassignedPoints { time_s, points, is_part, reason }| {
        UnusedPart {
            run: run.id.clone(),
            part: if is_part { "points" } else { "sweep" },
            time_s: Some(time_s),
            count: points,
            reason: reason.to_owned(),
        }
    }));
    parts_found.extend(levels.iter().filter_map(|level| off_needle(run, rig, level)));
    parts_found
}

/// Rows of all lateral runs of a session that are not used.
pub fn unused_of_session(session: &Session, criteria: &HoldCriteria) -> Vec<UnusedPart> {
    session.lateral.iter().flat_map(|run| unused(run, &session.rig, criteria)).collect()
}

/// Unused rows of one run as text: one line for every part and reason, however many there are.
pub fn summary(unused: &[UnusedPart]) -> Vec<String> {
    let mut lines = Vec::new();
    let mut reported: Vec<(&str, &str)> = Vec::new();
    for first in unused {
        let key = (first.part, first.reason.as_str());
        if reported.contains(&key) {
            continue;
        }
        reported.push(key);
        if alike(key, unused).count() == 1 {
            lines.push(first.to_string());
            continue;
        }
        let count: usize = alike(key, unused).map(|other| other.count).sum();
        let plural = if first.part == "points" { "points of sweeps" } else { &format!("{}s", first.part) };
        lines.push(format!(
            "{} {plural} ({count} points, the first at {:.2} s) not used: {}",
            alike(key, unused).count(),
            first.time_s.map_or(0.0, |time_s| time_s[0]),
            first.reason
        ));
    }
    lines
}

/// Unused parts with the same name and reason.
fn alike<'a>(key: (&str, &str), unused: &'a [UnusedPart]) -> impl Iterator<Item = &'a UnusedPart> {
    unused.iter().filter(move |other| (other.part, other.reason.as_str()) == key)
}

/// Points of a hold that lie behind guide 1 or beyond the tip.
fn off_needle(run: &LateralRun, rig: &Rig, level: &Hold) -> Option<UnusedPart> {
    let tip_m = rig.entry_m + run.depth_m;
    let off_points: Vec<usize> = level
        .shape
        .iter()
        .filter(|index| {
            run.shape.z_m.get(**index).is_some_and(|z_m| !(0.0..=tip_m + BEYOND_TIP_M).contains(z_m))
        })
        .copied()
        .collect();
    let times_s = off_points.iter().filter_map(|index| run.shape.time_s.as_ref()?.get(*index)).copied();
    let time_s = times_s.clone().next().map(|first_s| [first_s, times_s.last().unwrap_or(first_s)]);
    (!off_points.is_empty()).then(|| UnusedPart {
        run: run.id.clone(),
        part: "points",
        time_s,
        count: off_points.len(),
        reason: format!("not on the needle, which ends {:.1} mm from guide 1", 1e3 * tip_m),
    })
}
