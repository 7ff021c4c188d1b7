//! Small imperfections that every rig, tissue and instrument has: what lies behind an effect in a session, or alone.
//!
//! None of them is an effect to be named. Some are of kinds that a laboratory expects and a diagnosis may allow for, others of kinds
//! that it has no reason to think of.

use super::MM;

/// A kind of small imperfection. Its size is in the unit of its name, relative where the name has none.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Imperfection {
    /// Modulus rippling over depth, over some millimetres: root mean square.
    ModulusOverDepth,
    /// Modulus of each run differing from that of the tissue: standard deviation.
    ModulusPerRun,
    /// Modulus lost from each run to the next.
    Softening,
    /// Smooth error of the shape, another one in each run: root mean square.
    ShapeWobble,
    /// Error of the shape that repeats in every sweep, with a period of some millimetres: root mean square.
    ShapePattern,
    /// Error of the shape in proportion to the deflection, slowly varying along the needle.
    ShapeProportional,
    /// Sine in the force reading: root mean square.
    ForceHum,
    /// Slow drift of the force reading within a run: root mean square.
    ForceDrift,
    /// Zero of the force reading, another one in each run: largest.
    ForceZero,
    /// Square and cubic parts of the force reading, as a share of the largest force.
    ForceNonlinearity,
    /// Play of the force reading, as a share of the largest force.
    ForceHysteresis,
    /// Motion of guide 2 in one plane that shows in the other.
    Axes,
    /// Surface of the tissue away from where it is stated.
    Entry,
    /// Bending stiffness of the needle away from the stated one.
    BendingStiffness,
    /// Gain of the force reading.
    ForceGain,
    /// Creep of the force reading: what a hold adds to it, as a share.
    ForceCreep,
    /// Displacement reading that drifts as the actuator warms up: at the end.
    DisplacementDrift,
    /// Periodic error of the displacement reading: amplitude.
    DisplacementPeriodic,
    /// Soft spot of a few millimetres: share of the modulus that is missing in its middle.
    SoftSpot,
    /// Surface of the tissue that differs from run to run: largest.
    EntryPerRun,
    /// Tracker tilted against the needle, degrees.
    TrackerTilt,
    /// Guide 2 away from the line of the clamp.
    GuideOffset,
    /// Modulus differing from insertion to insertion: standard deviation.
    InsertionModulus,
    /// Tip load differing from insertion to insertion: standard deviation.
    InsertionLoad,
    /// Surface away from where it is stated, another one in each insertion: largest.
    InsertionEntry,
    /// Slow drift of the tracked tip: root mean square.
    TipDrift,
}

/// Runs in which an imperfection shows.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Scope {
    Lateral,
    Insertion,
    Both,
}

use Imperfection as I;

/// Every kind with its name, its sizes in an ordinary laboratory, where it shows, and whether a laboratory expects it.
const KINDS: [(Imperfection, &str, [f64; 2], Scope, bool); 26] = [
    (I::ModulusOverDepth, "modulus_over_depth", [0.02, 0.06], Scope::Both, true),
    (I::ModulusPerRun, "modulus_per_run", [0.01, 0.02], Scope::Lateral, true),
    (I::Softening, "softening_per_run", [0.003, 0.008], Scope::Lateral, true),
    (I::ShapeWobble, "shape_wobble_mm", [0.01, 0.02], Scope::Lateral, true),
    (I::ShapePattern, "shape_pattern_mm", [0.006, 0.015], Scope::Lateral, true),
    (I::ShapeProportional, "shape_proportional", [0.01, 0.02], Scope::Lateral, true),
    (I::ForceHum, "force_hum_n", [0.003, 0.006], Scope::Lateral, true),
    (I::ForceDrift, "force_drift_n", [0.003, 0.006], Scope::Lateral, true),
    (I::ForceZero, "force_zero_n", [0.005, 0.02], Scope::Lateral, true),
    (I::ForceNonlinearity, "force_nonlinearity", [0.003, 0.005], Scope::Lateral, true),
    (I::ForceHysteresis, "force_hysteresis", [0.003, 0.005], Scope::Lateral, true),
    (I::Axes, "axes", [0.005, 0.01], Scope::Lateral, true),
    (I::Entry, "entry_mm", [0.2, 0.3], Scope::Lateral, true),
    (I::BendingStiffness, "bending_stiffness", [0.01, 0.02], Scope::Both, true),
    (I::ForceGain, "force_gain", [0.005, 0.01], Scope::Lateral, true),
    (I::ForceCreep, "force_creep", [0.003, 0.006], Scope::Lateral, false),
    (I::DisplacementDrift, "displacement_drift_mm", [0.003, 0.008], Scope::Lateral, false),
    (I::DisplacementPeriodic, "displacement_periodic_mm", [0.003, 0.008], Scope::Lateral, false),
    (I::SoftSpot, "soft_spot", [0.1, 0.2], Scope::Both, false),
    (I::EntryPerRun, "entry_per_run_mm", [0.1, 0.25], Scope::Lateral, false),
    (I::TrackerTilt, "tracker_tilt_degrees", [0.1, 0.3], Scope::Insertion, true),
    (I::GuideOffset, "guide_offset_mm", [0.02, 0.05], Scope::Insertion, true),
    (I::InsertionModulus, "insertion_modulus", [0.015, 0.03], Scope::Insertion, true),
    (I::InsertionLoad, "insertion_load", [0.02, 0.1], Scope::Insertion, true),
    (I::InsertionEntry, "insertion_entry_mm", [0.2, 0.5], Scope::Insertion, true),
    (I::TipDrift, "tip_drift_mm", [0.02, 0.05], Scope::Insertion, true),
];

impl Imperfection {
    /// Every kind.
    pub fn all() -> impl Iterator<Item = Self> {
        KINDS.iter().map(|(kind, ..)| *kind)
    }

    fn row(self) -> &'static (Self, &'static str, [f64; 2], Scope, bool) {
        &KINDS[self as usize]
    }

    /// Its name, with the unit of its size.
    pub fn name(self) -> &'static str {
        self.row().1
    }

    /// Sizes in an ordinary laboratory.
    pub fn sizes(self) -> [f64; 2] {
        self.row().2
    }

    /// Whether a laboratory expects it.
    pub fn is_expected(self) -> bool {
        self.row().4
    }

    /// Whether it shows in lateral runs and in insertions.
    pub fn shows_in(self) -> [bool; 2] {
        let scope = self.row().3;
        [scope != Scope::Insertion, scope != Scope::Lateral]
    }
}

/// Imperfections of a session with their sizes; their form in each run is drawn from the seed.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Background {
    /// Kinds with their sizes; none twice.
    pub parts: Vec<(Imperfection, f64)>,
    /// Seed of their signs, phases and positions.
    pub seed: u64,
}

impl Background {
    /// One kind of one size.
    pub fn of(kind: Imperfection, size: f64, seed: u64) -> Self {
        Self { parts: vec![(kind, size)], seed }
    }

    /// The same, so many times as large.
    pub fn times(&self, factor: f64) -> Self {
        let scaled_parts = self.parts.iter().map(|(kind, size)| (*kind, factor * size)).collect();
        Self { parts: scaled_parts, seed: self.seed }
    }

    /// Size of a kind; 0 where it is not there.
    pub fn size(&self, kind: Imperfection) -> f64 {
        self.parts.iter().find(|(other, _)| *other == kind).map_or(0.0, |(_, size)| *size)
    }
}

/// Millimetres or metres: the factor to SI of a kind's size.
pub(super) fn si(kind: Imperfection) -> f64 {
    match kind.name() {
        name if name.ends_with("_mm") => MM,
        name if name.ends_with("_degrees") => 1f64.to_radians(),
        _ => 1.0,
    }
}
