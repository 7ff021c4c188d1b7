//! Unknowns of an insertion.
//!
//! In one plane: offset of the tip sensor (m), angle of entry (rad; a tilt of the tracker has the same effect), displacement of guide 2
//! from its zero (m), this insertion's modulus against that of all (difference of logarithms), the place of its tissue surface (m beyond
//! where the depth counts from), a step of the logarithm of the gap (used to find the gap, 0 otherwise), slow drift of the tracker (m),
//! tip load (N), and the process noise of the tip load at knots of depth (N). A needle that is turned carries its load with it, which
//! couples the two planes.
//!
//! If the rotation stiffness of an only guide is not known, its share is an unknown of each plane. If the
//! tip's direction is measured, a tilt of the sensor on the needle and its slow change with depth (rad) are
//! unknowns.

use super::path::{ROTATION_STILL_RAD, TipPath};
use nalgebra::DVector;
use std::f64::consts::PI;
use std::ops::Range;

/// Distance of the knots between which the tip load changes linearly, m; the needle smooths what is shorter.
pub(super) const STRETCH_M: f64 = 15e-3;
/// Places of the unknowns of one plane.
pub(super) const OFFSET: usize = 0;
pub(super) const ANGLE: usize = 1;
pub(super) const GUIDE2: usize = 2;
pub(super) const MODULUS: usize = 3;
pub(super) const ENTRY: usize = 4;
pub(super) const GAP: usize = 5;
pub(super) const DRIFT: usize = 6;
pub(super) const LOAD: usize = DRIFT + DRIFTS;
pub(super) const PROCESS_NOISE: usize = LOAD + 1;
/// Cosines of depth that make up a slow drift of the tracker: half a wave over the whole depth, a whole one, and so on.
pub(super) const DRIFTS: usize = 4;
/// Cosines of depth that make up a slow change of the tilt of the direction sensor.
pub(super) const BENDS: usize = 3;
/// A turn whose sine is below this mirrors the load and does not bring it into the other plane.
const IN_PLANE: f64 = 1e-3;

/// Layout of the unknowns.
#[derive(Debug, Clone, PartialEq)]
pub struct Layout {
    /// Knots of the tip load.
    pub knots_m: Vec<f64>,
    /// Measured planes.
    pub planes: usize,
    /// Whether a turned needle couples both planes: then the unknowns of both stand in one vector.
    pub coupled: bool,
    /// Whether the needle's rear is an unknown.
    pub rear: bool,
    /// Whether the direction of the tip is measured.
    pub direction: bool,
}

impl Layout {
    /// For a set of recordings of the same rig, down to `last_m`; `rear`: whether the rotation stiffness of the needle's rear is not known.
    pub fn new(paths: &[TipPath], last_m: f64, rear: bool) -> Self {
        let count = (last_m / STRETCH_M).ceil().max(1.0) as usize;
        let planes = paths.iter().map(|path| path.planes).min().unwrap_or(1);
        let first = paths.first().map_or(0.0, |path| path.done.rotation_rad.before(0.0));
        let knots_m = (0..=count).map(|i| STRETCH_M * i as f64).collect();
        let direction = paths
            .iter()
            .any(|path| path.bins.iter().any(|bin| bin.direction_rad.iter().any(Option::is_some)));
        Self {
            knots_m,
            planes,
            coupled: planes == 2
                && paths.iter().any(|path| {
                    let knots = path.done.rotation_rad.values();
                    knots.chain([first]).any(|rad| {
                        rad.sin().abs() > IN_PLANE
                            && ((rad - first).abs() > ROTATION_STILL_RAD || path.is_turned())
                    })
                }),
            rear,
            direction,
        }
    }

    /// Unknowns of one plane.
    pub(super) fn of_plane(&self) -> usize {
        let tilts = if self.direction { 1 + BENDS } else { 0 };
        self.process_noise().end + usize::from(self.rear) + tilts
    }

    /// Places of a plane's knots of the tip load.
    pub(super) fn process_noise(&self) -> Range<usize> {
        PROCESS_NOISE..PROCESS_NOISE + self.knots_m.len()
    }

    /// Place of the share of the rear.
    pub(super) fn rear(&self) -> Option<usize> {
        self.rear.then_some(self.process_noise().end)
    }

    /// Place of the tilt of the direction sensor, which its slow change follows.
    pub(super) fn tilt(&self) -> Option<usize> {
        self.direction.then_some(self.process_noise().end + usize::from(self.rear))
    }

    /// Length of a vector of unknowns.
    pub fn unknowns(&self) -> usize {
        if self.coupled { 2 * self.of_plane() } else { self.of_plane() }
    }

    /// Vectors of unknowns: one for both planes where they are coupled, else one for each.
    pub(super) fn systems(&self) -> usize {
        if self.coupled { 1 } else { self.planes }
    }

    /// Planes whose unknowns stand in a vector.
    pub(super) fn planes_of(&self, system: usize) -> Range<usize> {
        if self.coupled { 0..2 } else { system..system + 1 }
    }

    /// The vector of a plane and where its unknowns begin there.
    pub(super) fn place(&self, plane: usize) -> (usize, usize) {
        if self.coupled { (0, plane * self.of_plane()) } else { (plane, 0) }
    }

    /// The combination of a plane's vector that is its tip load at a depth, in the needle's own frame.
    pub(super) fn load_row(&self, plane: usize, depth_m: f64) -> DVector<f64> {
        let (_, first_column) = self.place(plane);
        let mut row = DVector::zeros(self.unknowns());
        row[first_column + LOAD] = 1.0;
        for knot in 0..self.knots_m.len() {
            row[first_column + PROCESS_NOISE + knot] = self.hat(knot, depth_m);
        }
        row
    }

    /// Reading of the numbered part of the drift at a depth.
    pub(super) fn drift(&self, number: usize, depth_m: f64) -> f64 {
        let last_m = self.knots_m.last().copied().unwrap_or(STRETCH_M);
        (PI * (number + 1) as f64 * depth_m / last_m).cos()
    }

    /// Share of the process noise at a knot in the load at a depth: linear between knots.
    pub(super) fn hat(&self, knot: usize, depth_m: f64) -> f64 {
        let last = self.knots_m.len() - 1;
        let fraction = depth_m / STRETCH_M - knot as f64;
        match (fraction < 0.0, knot == last) {
            (false, true) => 1.0,
            _ => (1.0 - fraction.abs()).max(0.0),
        }
    }
}
