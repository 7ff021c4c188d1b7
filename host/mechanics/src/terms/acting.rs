//! Laws with values inside a beam problem: what they do to the reaction of the tissue and to the stiffness of the needle, and what they
//! move when guide 2 pushes.

use super::{Law, Regressor, Site};
use crate::Model;
use crate::effects::{Effect, MotionContext};

/// Share of the modulus, the reaction or the stiffness of the needle below which none falls.
pub(super) const MIN_SHARE: f64 = 0.02;
/// Step over which slopes are taken: far above rounding, far below what any deflection is measured to.
const SLOPE_M: f64 = 1e-6;

/// A law with the values of its parameters.
#[derive(Debug, Clone)]
pub struct ActingLaw {
    law: Law,
    values: Vec<f64>,
}

impl PartialEq for ActingLaw {
    fn eq(&self, other: &Self) -> bool {
        self.law.id() == other.law.id() && self.values == other.values
    }
}

impl ActingLaw {
    /// A law with these values, in the units of its parameters.
    pub(super) fn new(law: &Law, values: &[f64]) -> Self {
        Self { law: *law, values: values.to_vec() }
    }

    fn at(&self, x: f64) -> f64 {
        self.law.at(&self.values, x)
    }

    /// Its value after what came before, and its state there.
    fn at_after(&self, x: f64, state: f64) -> (f64, f64) {
        self.law.at_after(&self.values, x, state)
    }

    /// Whether it does the same to either side.
    pub(crate) fn is_even(&self) -> bool {
        self.law.form.is_even()
    }

    /// By how much several laws multiply the reaction of the tissue at a stretch, and the slope of that, 1/m.
    pub(crate) fn reaction(laws: &[Self], stretch_m: f64) -> [f64; 2] {
        let here = factor(stretch_m, laws);
        if here <= MIN_SHARE {
            return [MIN_SHARE, 0.0];
        }
        [here, (factor(stretch_m + SLOPE_M, laws) - factor(stretch_m - SLOPE_M, laws)) / (2.0 * SLOPE_M)]
    }

    /// By how much several laws multiply the bending stiffness of a needle of this length, at a place along it.
    pub(crate) fn stiffness(laws: &[Self], z_m: f64, length_m: f64) -> f64 {
        (1.0 + laws
            .iter()
            .map(|law| law.at(if law.law.regressor == Regressor::ToTip { length_m - z_m } else { z_m }))
            .sum::<f64>())
        .max(MIN_SHARE)
    }
}

/// Factor by which laws multiply a stiffness.
fn factor(stretch_m: f64, laws: &[ActingLaw]) -> f64 {
    1.0 + laws.iter().map(|law| law.at(stretch_m)).sum::<f64>()
}

/// Motions that laws add in a plane while guide 2 pushes: those of the tissue, and those of guide 2 under its own force.
#[derive(Debug)]
pub(crate) struct Shifts {
    /// Motion of the tissue at every sample, as far as it does not depend on the force, m.
    tissue_m: Vec<f64>,
    tissue_by_force: Vec<ActingLaw>,
    guide_by_force: Vec<ActingLaw>,
}

impl Shifts {
    /// Whether a model has a law that moves the tissue.
    pub fn move_tissue(model: &Model) -> bool {
        model.effects.iter().any(|(effect, _)| effect.as_law().is_some_and(|law| law.site == Site::Tissue))
    }

    /// In a plane during a motion; nothing where no law moves anything.
    pub fn of(model: &Model, motion: &MotionContext<'_>, plane: usize) -> Option<Self> {
        let mut shifts = Self {
            tissue_m: vec![0.0; motion.time_s.len()],
            tissue_by_force: Vec::new(),
            guide_by_force: Vec::new(),
        };
        let mut has_any = false;
        for (effect, values) in &model.effects {
            let Some(law) = effect.as_law().filter(|law| law.scope.has(plane)) else { continue };
            match (law.site, law.regressor) {
                (Site::Tissue, Regressor::Force) => shifts.tissue_by_force.push(ActingLaw::new(law, values)),
                (Site::Guide, Regressor::Force) => shifts.guide_by_force.push(ActingLaw::new(law, values)),
                (Site::Tissue, _) => {
                    let moved_m = law.along_motion(values, motion, plane);
                    shifts.tissue_m.iter_mut().zip(moved_m).for_each(|(sum, more)| *sum += more);
                }
                _ => continue,
            }
            has_any = true;
        }
        has_any.then_some(shifts)
    }

    /// Whether the force of guide 2 moves anything.
    pub fn depend_on_force(&self) -> bool {
        !self.tissue_by_force.is_empty() || !self.guide_by_force.is_empty()
    }

    /// Before the first sample.
    pub fn rest(&self) -> ShiftState {
        ShiftState {
            tissue: vec![0.0; self.tissue_by_force.len()],
            guide: vec![0.0; self.guide_by_force.len()],
        }
    }

    /// Position of the tissue at a sample under a force, after what came before, m.
    pub fn tissue_m(&self, sample: usize, force_n: f64, before: &ShiftState) -> f64 {
        let by_force = sum_after(&self.tissue_by_force, force_n, &before.tissue);
        self.tissue_m.get(sample).copied().unwrap_or_default() + by_force
    }

    /// Motion that guide 2 adds under a force, after what came before, m.
    pub fn guide_m(&self, force_n: f64, before: &ShiftState) -> f64 {
        sum_after(&self.guide_by_force, force_n, &before.guide)
    }

    /// Goes on to a force.
    pub fn advance(&self, state: &mut ShiftState, force_n: f64) {
        let tissue = self.tissue_by_force.iter().zip(&mut state.tissue);
        let guide = self.guide_by_force.iter().zip(&mut state.guide);
        tissue.chain(guide).for_each(|(law, state)| (_, *state) = law.at_after(force_n, *state));
    }
}

/// Memory of the laws that depend on the force: the play of each.
#[derive(Debug, Clone)]
pub(crate) struct ShiftState {
    tissue: Vec<f64>,
    guide: Vec<f64>,
}

fn sum_after(laws: &[ActingLaw], force_n: f64, states: &[f64]) -> f64 {
    laws.iter().zip(states).map(|(law, state)| law.at_after(force_n, *state).0).sum()
}
