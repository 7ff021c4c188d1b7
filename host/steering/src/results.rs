//! Results of a run: its decisions and its outcome.

use crate::protocol::{Answer, Command, End, Statement};
use serde::Serialize;

/// Probability of a miss below a radius.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Probability {
    /// Radius, mm.
    pub radius_mm: f64,
    /// Probability that the tip ends within it.
    pub probability: f64,
}

/// A limit that may keep the needle from its target.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct LimitRisk {
    /// As [`Decision::limited_by`].
    pub limit: &'static str,
    /// The same in words.
    pub words: String,
    /// Probability that the tip ends further than 0.25 mm from the target because of it, were everything else known.
    pub probability: f64,
}

/// A point of the tip's expected way.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct PathPoint {
    /// Depth, mm.
    pub depth_mm: f64,
    /// Expected tip, x and y, mm.
    pub tip_mm: [f64; 2],
    /// Its standard deviation per axis, mm: of the likeliest law; on the way without what is uncertain of guide moves to come.
    pub sd_mm: f64,
}

/// A rotation of the needle that is planned.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct PlannedRotation {
    /// Depth at which the needle is turned, mm.
    pub depth_mm: f64,
    /// By which angle, from +x towards +y, degrees.
    pub by_deg: f64,
    /// Direction of the tip's load after it, degrees.
    pub bevel_deg: f64,
}

/// Decision at a rest, and its posterior.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Decision {
    /// Time of the plant, s.
    pub t_s: f64,
    /// Depth, mm.
    pub depth_mm: f64,
    /// Position of guide 2, x and y, mm.
    pub guide_from_mm: [f64; 2],
    /// Target position of guide 2, mm.
    pub guide_to_mm: [f64; 2],
    /// Direction of the tip's load from here on, degrees.
    pub bevel_deg: f64,
    /// Depths of the rests to come, this one first, mm.
    pub plan_depth_mm: Vec<f64>,
    /// Position of guide 2 from each of them on, mm.
    pub plan_guide_mm: Vec<[f64; 2]>,
    /// Expected tip at the target's depth, by the plan, mm.
    pub expected_tip_mm: [f64; 2],
    /// Its covariance: xx, xy, yy, mm^2.
    pub covariance_mm2: [f64; 3],
    /// Probability of ending within some radii of the target.
    pub within: Vec<Probability>,
    /// The tip's way from here to the target's depth, by the plan.
    pub path: Vec<PathPoint>,
    /// Distance from the target at which the needle would end had guide 2 never been moved, mm.
    pub unsteered_miss_mm: f64,
    /// Foundation modulus of the layers, kPa.
    pub modulus_kpa: Vec<f64>,
    /// Its relative standard deviation (of the logarithm).
    pub modulus_sd_ln: Vec<f64>,
    /// Load of the tip along the bevel, N, at this depth.
    pub tip_load_n: f64,
    /// Probability that the tip cuts at an angle along the needle rather than under a load.
    pub cut_angle_probability: f64,
    /// Squared residuals of the tip readings over what noise and model error explain.
    pub misfit: f64,
    /// Limit that affects the plan most, if there is one: `strain`, `force`, `compression`, `travel` or
    /// `largest_move`.
    pub limited_by: Option<&'static str>,
    /// All that limits the plan, in words, with the miss that is expected for it.
    pub limits: Option<String>,
    /// Rotations from here on, as planned; the first is made now where its depth is this one.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub rotations: Vec<PlannedRotation>,
}

impl Decision {
    /// The rotation that is made now.
    pub fn turn(&self) -> Option<PlannedRotation> {
        self.rotations.first().filter(|rotation| (rotation.depth_mm - self.depth_mm).abs() < 1e-3).copied()
    }

    /// Next action of an operator: turn, then push to the next stop, or to the target's depth.
    pub fn cue(&self, target_depth_mm: f64) -> Cue {
        let turn = self.turn();
        Cue {
            depth_mm: self.depth_mm,
            turn_by_deg: turn.map(|turn| turn.by_deg),
            bevel_deg: turn.map_or(self.bevel_deg, |turn| turn.bevel_deg),
            push_to_mm: self.plan_depth_mm.get(1).copied().unwrap_or(target_depth_mm),
            limits: self.limits.clone(),
        }
    }
}

/// Next action of an operator who holds the needle.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Cue {
    /// Depth of the needle, mm.
    pub depth_mm: f64,
    /// First turn it by this angle, from +x towards +y, degrees.
    pub turn_by_deg: Option<f64>,
    /// Direction of the tip's load after that, degrees.
    pub bevel_deg: f64,
    /// Then push it to this depth, mm.
    pub push_to_mm: f64,
    /// Limits that keep the needle from its target, in words: [`Decision::limits`].
    #[serde(skip_serializing_if = "Option::is_none")]
    pub limits: Option<String>,
}

impl std::fmt::Display for Cue {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "at {:.1} mm: ", self.depth_mm)?;
        if let Some(rotation_deg) = self.turn_by_deg {
            write!(f, "turn by {rotation_deg:+.0} degrees (bevel at {:.0} degrees), then ", self.bevel_deg)?;
        }
        write!(f, "push to {:.1} mm", self.push_to_mm)?;
        self.limits.as_ref().map_or(Ok(()), |limits| write!(f, " ({limits})"))
    }
}

/// Channel of a [`Comparison`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum ComparedChannel {
    /// Force of guide 2 on the needle; differences in N.
    Force,
    /// The same force, expected from what was measured at the last stop; differences in N.
    ForceFromStop,
    /// Tip; differences in mm.
    Tip,
}

/// A reading against what the posterior of those before the last stop expects of it, along x and y.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Comparison {
    /// Time of the reading, s of the plant.
    pub t_s: f64,
    /// Depth of the needle then, mm.
    pub depth_mm: f64,
    /// Displacement of guide 2, mm.
    pub guide_mm: [f64; 2],
    /// The channel.
    pub channel: ComparedChannel,
    /// Measured less expected.
    pub difference: [f64; 2],
    /// By how much the expectation may be off: 5.2 of its standard deviations.
    pub possible: [f64; 2],
    /// Standard deviation of the reading.
    pub noise: f64,
}

/// Event of a run, in order.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Event<'a> {
    /// The plant's statement.
    Statement(&'a Statement),
    /// A command.
    Command(&'a Command),
    /// Its answer.
    Answer(&'a Answer),
    /// Forecast before the first push.
    Forecast {
        /// Corners of what can be reached at the target's depth, x and y, mm; empty where guide 2 is not moved.
        reachable_mm: Vec<[f64; 2]>,
        /// Probability of ending within some radii; empty where none is stated.
        within: Vec<Probability>,
        /// Limits that may keep the needle from its target.
        limits: Vec<LimitRisk>,
    },
    /// A decision.
    Decision(&'a Decision),
    /// A reading and what was expected of it.
    Compared(&'a Comparison),
    /// The plant's last line.
    End(&'a End),
    /// A fault.
    Fault {
        /// Its name.
        name: &'static str,
        /// Its cause.
        cause: String,
    },
}

/// Outcome of a run.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[serde(tag = "kind", rename_all = "snake_case")]
pub enum Outcome {
    /// At the target's depth.
    Arrived,
    /// The supervisor stopped before it.
    Stopped {
        /// Name of the cause.
        name: &'static str,
        /// The cause in words.
        cause: String,
    },
    /// Before the first step: the target cannot be reached.
    Refused {
        /// The nearest point at the target's depth that can be, x and y, mm.
        nearest_mm: [f64; 2],
        /// Distance from the target, mm.
        distance_mm: f64,
        /// Limit of the guide, in words.
        limited_by: Option<String>,
        /// The cause in words.
        cause: String,
    },
}

/// By what a quantity is uncertain: standard deviation per axis, mm, in all and by each cause alone.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Spread {
    /// In all.
    pub all: f64,
    /// The needle's angle to the axis, and where its tip is at the surface.
    pub slope: f64,
    /// Load or cutting angle of the tip.
    pub tip: f64,
    /// Modulus of the layers, skin, gap.
    pub tissue: f64,
    /// Offset and play of guide 2.
    pub guide: f64,
    /// Part of the path that no model describes.
    pub irregularity: f64,
}

impl Spread {
    /// The causes by name, the largest first.
    pub fn causes(&self) -> Vec<(&'static str, f64)> {
        let mut causes = vec![
            ("needle's angle", self.slope),
            ("tip load or cutting angle", self.tip),
            ("tissue", self.tissue),
            ("guide 2", self.guide),
            ("irregularity of the path", self.irregularity),
        ];
        causes.sort_by(|a, b| b.1.total_cmp(&a.1));
        causes
    }
}

/// Plan before any motion ([`plan_path`](crate::plan_path)).
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct PathPlan {
    /// Target: x, y, depth, mm.
    pub target_mm: [f64; 3],
    /// Whether the target can be reached, by what is known beforehand: [`steer`](crate::steer) refuses it otherwise.
    pub is_reachable: bool,
    /// Nearest point if it cannot: the nearest point at its depth that can be.
    pub nearest_mm: Option<[f64; 2]>,
    /// Distance from the target, mm.
    pub beyond_reach_mm: Option<f64>,
    /// Corners of what can be reached at the target's depth, x and y, mm; empty where guide 2 is not moved.
    pub reachable_mm: Vec<[f64; 2]>,
    /// Limit of the guide there, in words.
    pub limited_by: Option<String>,
    /// Probability of ending within some radii, with readings on the way; empty where none is stated.
    pub within: Vec<Probability>,
    /// Limits that may keep the needle from its target.
    pub limits: Vec<LimitRisk>,
    /// Tip at the target's depth if nothing is moved, mm.
    pub unsteered_tip_mm: [f64; 2],
    /// By what that is uncertain.
    pub spread_mm: Spread,
    /// Guide positions or rotations and path, as planned without any reading.
    pub plan: Decision,
}

/// A whole run.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Run {
    /// Outcome of the run.
    pub outcome: Outcome,
    /// Target: x, y, depth, mm.
    pub target_mm: [f64; 3],
    /// Depth reached, mm.
    pub depth_mm: f64,
    /// Distance of the tip from the target across the needle, mm; from the plant's truth or from the last readings.
    pub miss_mm: Option<f64>,
    /// Whether the miss is that of tip readings, as the plant has no truth.
    pub miss_is_measured: bool,
    /// Position of the tip, x and y, mm, by all readings.
    pub estimated_tip_mm: [f64; 2],
    /// Covariance of that: xx, xy, yy, mm^2.
    pub covariance_mm2: [f64; 3],
    /// Corners of what could be reached at the target's depth, x and y, mm, by the prior's means, before the first push; empty
    /// where
    /// guide 2 is not moved.
    pub reachable_mm: Vec<[f64; 2]>,
    /// Probability of ending within some radii, as stated before the first push.
    pub within_before: Vec<Probability>,
    /// Limits that may keep the needle from its target, as forecast before the first push.
    pub limits_before: Vec<LimitRisk>,
    /// The probabilities on arrival.
    pub within_after: Vec<Probability>,
    /// Distance from the target at which the needle would have ended had guide 2 never been moved, mm: estimated from all
    /// readings.
    pub unsteered_miss_mm: f64,
    /// Tip readings that arrived, and how many were rejected.
    pub readings: usize,
    /// See `readings`.
    pub readings_rejected: usize,
    /// Largest lateral force at guide 2 that was measured, N.
    pub peak_force_n: Option<f64>,
    /// Rotations of the needle.
    pub rotations: usize,
    /// Time of the plant, s.
    pub duration_s: f64,
    /// Slowest replan, s of the processor's clock; not part of what a replay compares.
    #[serde(skip)]
    pub slowest_replan_s: f64,
    /// Median replan, s of the same clock.
    #[serde(skip)]
    pub median_replan_s: f64,
    /// The plant's last line.
    pub end: Option<End>,
    /// All decisions.
    pub decisions: Vec<Decision>,
}
