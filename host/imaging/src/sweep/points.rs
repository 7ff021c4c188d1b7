//! Points of a shape from the frames of a sweep, and their distance from the straight needle.

use super::{State, Sweep};
use crate::pose::Motion;

/// A point of a shape: successive frames that share their speckle are one.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Point {
    /// Position along the needle, millimetres.
    pub z_mm: f64,
    /// Position across it, `[x, y]`.
    pub across_mm: [f64; 2],
    /// Standard deviations; points are independent.
    pub sd_mm: [f64; 2],
    /// Frames in it.
    pub frames: usize,
    /// Direction of the beam and mean speed of the probe.
    pub motion: Motion,
}

/// A used frame: its place, standard deviations across the needle, and motion.
type Used = ([f64; 3], [f64; 2], Motion);

/// A probe below this share of its median speed stands still or turns round.
const STILL: f64 = 0.25;

/// Widest point along the needle, millimetres: over it a needle is straight to a micrometre.
const MAX_WIDTH_MM: f64 = 2.0;

impl Sweep {
    /// Points of the shape, along the needle. Frames of one point were taken on the same way: a lag moves those forth and those back apart.
    pub fn points(&self) -> Vec<Point> {
        let group_size = self.track.correlated_frames().ceil() as usize;
        let mut used_frames: Vec<Used> = self
            .frames
            .iter()
            .filter(|frame| frame.state == State::Used)
            .filter_map(|frame| Some((frame.place_mm?, frame.sd_mm?, frame.motion.unwrap_or_default())))
            .collect();
        let mut speeds: Vec<f64> = used_frames.iter().map(|(.., motion)| motion.mm_per_s.abs()).collect();
        speeds.sort_by(f64::total_cmp);
        let still = STILL * speeds.get(speeds.len() / 2).copied().unwrap_or(0.0);
        used_frames.sort_by(|a, b| {
            direction_of(a, still).cmp(&direction_of(b, still)).then(a.0[2].total_cmp(&b.0[2]))
        });
        let mut points = Vec::new();
        for mut rest in used_frames.chunk_by(|a, b| direction_of(a, still) == direction_of(b, still)) {
            while let Some(first) = rest.first() {
                let near_count = rest
                    .iter()
                    .take_while(|frame| frame.0[2] - first.0[2] <= MAX_WIDTH_MM)
                    .take(group_size)
                    .count();
                let (group, later_frames) = rest.split_at(near_count.max(1));
                rest = later_frames;
                points.extend(mean(group, self.track.noise.map(|noise| noise.correlated_frames)));
            }
        }
        points.sort_by(|a, b| a.z_mm.total_cmp(&b.z_mm));
        points
    }
}

fn direction_of((.., motion): &Used, still: f64) -> i8 {
    if motion.mm_per_s.abs() <= still { 0 } else { motion.mm_per_s.signum() as i8 }
}

/// Weighted mean of frames that share their error as far as they are neighbours.
fn mean(group: &[Used], correlated: [f64; 2]) -> Option<Point> {
    let count = group.len() as f64;
    let weights = |axis: usize| group.iter().map(move |(_, sd_mm, _)| sd_mm[axis].powi(-2));
    let mean_mm = [0, 1].map(|axis: usize| {
        let sum: f64 =
            group.iter().zip(weights(axis)).map(|((place, ..), weight)| weight * place[axis]).sum();
        sum / weights(axis).sum::<f64>()
    });
    let sd_mm = [0, 1].map(|axis: usize| (correlated[axis].max(1.0) / weights(axis).sum::<f64>()).sqrt());
    let z_mm = group.iter().map(|(place, ..)| place[2]).sum::<f64>() / count;
    let motion = Motion {
        beam_rad: mean_beam(f64::sin, group).atan2(mean_beam(f64::cos, group)),
        mm_per_s: group.iter().map(|(.., motion)| motion.mm_per_s).sum::<f64>() / count,
    };
    (count > 0.0).then_some(Point { z_mm, across_mm: mean_mm, sd_mm, frames: group.len(), motion })
}

fn mean_beam(part: fn(f64) -> f64, group: &[([f64; 3], [f64; 2], Motion)]) -> f64 {
    group.iter().map(|(.., motion)| part(motion.beam_rad)).sum::<f64>()
}

/// The straight needle: a line for each axis.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Line {
    middle_mm: f64,
    at_middle_mm: [f64; 2],
    slope: [f64; 2],
    /// Variances at the middle and of the slope; not correlated.
    variance: [[f64; 2]; 2],
}

impl Line {
    /// A needle along z at a place, without uncertainty.
    pub fn along(across_mm: [f64; 2]) -> Self {
        Self { middle_mm: 0.0, at_middle_mm: across_mm, slope: [0.0; 2], variance: [[0.0; 2]; 2] }
    }

    /// Through the points of a sweep along the needle that nobody displaces; nothing for fewer than three points.
    pub fn through(points: &[Point]) -> Option<Self> {
        let (first, last) = (points.first()?, points.last()?);
        if points.len() < 3 || last.z_mm <= first.z_mm {
            return None;
        }
        let count = points.len() as f64;
        let middle_mm = points.iter().map(|point| point.z_mm).sum::<f64>() / count;
        let mut line = Self::along([0.0; 2]);
        line.middle_mm = middle_mm;
        for axis in 0..2 {
            let sums = points.iter().fold([0.0; 5], |sums, point| {
                let (w, z, u) = (point_weight(point, axis), point.z_mm - middle_mm, point.across_mm[axis]);
                [sums[0] + w, sums[1] + w * z, sums[2] + w * z * z, sums[3] + w * u, sums[4] + w * z * u]
            });
            let [w, z, zz, u, zu] = sums;
            let slope = (zu - z * u / w) / (zz - z * z / w);
            line.slope[axis] = slope;
            line.at_middle_mm[axis] = (u - slope * z) / w;
            line.variance[axis] = [1.0 / w, 1.0 / (zz - z * z / w)];
        }
        Some(line)
    }

    /// Its place, millimetres.
    pub fn at(&self, z_mm: f64) -> [f64; 2] {
        [0, 1].map(|axis: usize| self.at_middle_mm[axis] + self.slope[axis] * (z_mm - self.middle_mm))
    }

    /// Errors of its place, independent of each other: one standard deviation of its offset, and what one of its slope does here.
    pub fn errors(&self, z_mm: f64) -> [[f64; 2]; 2] {
        self.variance.map(|[middle, slope]| [middle.sqrt(), slope.sqrt() * (z_mm - self.middle_mm)])
    }

    /// Its slope, `[x, y]`.
    pub fn slope(&self) -> [f64; 2] {
        self.slope
    }
}

fn point_weight(point: &Point, axis: usize) -> f64 {
    point.sd_mm[axis].powi(-2)
}

/// A point's distance from the straight needle.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Deflection {
    /// Position along the needle, millimetres.
    pub z_mm: f64,
    /// Deflection, `[x, y]`.
    pub across_mm: [f64; 2],
    /// Its standard deviation, without what all points share.
    pub sd_mm: [f64; 2],
    /// Errors that all points share, independent of each other, `[x, y]`: what one standard deviation of each does here. The offset of the
    /// straight needle, its slope, and one that is free.
    pub shared_mm: [[f64; 3]; 2],
    /// Frames in it.
    pub frames: usize,
    /// Direction of the beam and mean speed of the probe.
    pub motion: Motion,
}

/// Distances of points from the straight needle, whose error they share.
pub fn deflections(points: &[Point], straight: &Line) -> Vec<Deflection> {
    points
        .iter()
        .map(|point| {
            let straight_mm = straight.at(point.z_mm);
            Deflection {
                z_mm: point.z_mm,
                across_mm: [0, 1].map(|axis: usize| point.across_mm[axis] - straight_mm[axis]),
                sd_mm: point.sd_mm,
                shared_mm: straight.errors(point.z_mm).map(|[offset, slope]| [offset, slope, 0.0]),
                frames: point.frames,
                motion: point.motion,
            }
        })
        .collect()
}
