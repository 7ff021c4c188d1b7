//! Effects: what may be wrong with the plain model, each a part of the one forward model.
//!
//! An effect has an id, its physics in one line, parameters that do nothing at their neutral values, and the place where it
//! acts: on the beam problem, on what lies between actuator and needle, on the stress-free shape of the needle, on where the sensors measure, on what
//! they read there, or on the tip. A [`Model`](super::Model) is a rig, a tissue and a list of effects with values;
//! everything that calls [`predict`](super::predict) honours them. A new effect is one struct in the file of its family and one
//! line in [`EFFECTS`].
//!
//! Order of application: beam, drive, stress-free curvature, solve, map position, observe; within each in the order of the model's list.

mod imaging;
mod needle;
mod rig;
mod sensor;
mod tip;
mod tissue;

use super::course::{directions, speeds_m_per_s};
use super::insertion::TipLaw;
use super::lateral::Drive;
use super::predict::Plane;
use super::terms::{Conditions, Law, term};
use super::{BeamProblem, Channels, ModelError, Rig, ShapeImage, ShapePoint};
use std::fmt::Debug;

const MM: f64 = 1e-3;

/// A parameter of an effect; values are in the unit of its name.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ParameterInfo {
    /// Name with unit.
    pub name: &'static str,
    /// Value at which the effect does nothing (for a place or a time: where the search starts).
    pub neutral: f64,
    /// Physically possible values.
    pub range: [f64; 2],
    /// Values to be expected in a rig that is not broken: the range of the prior where effects are weighed against each other.
    pub likely: [f64; 2],
    /// Standard deviation about the neutral value in an ordinary rig: the prior of a nuisance.
    pub prior_sd: f64,
    /// For a place or a time, which does nothing by itself: start values of the search.
    pub nodes: &'static [f64],
}

impl ParameterInfo {
    /// The size of an effect, in the unit of its name: at its neutral value the effect changes nothing.
    pub const fn amplitude(
        name: &'static str,
        neutral: f64,
        range: [f64; 2],
        likely: [f64; 2],
        prior_sd: f64,
    ) -> Self {
        Self { name, neutral, range, likely, prior_sd, nodes: &[] }
    }

    /// The depth or the time at which an effect acts, in the unit of its name, with start values of the search.
    pub const fn location(
        name: &'static str,
        start: f64,
        range: [f64; 2],
        likely: [f64; 2],
        prior_sd: f64,
        nodes: &'static [f64],
    ) -> Self {
        Self { name, neutral: start, range, likely, prior_sd, nodes }
    }

    /// Whether it may lie on either side of its neutral value.
    pub fn is_two_sided(&self) -> bool {
        self.likely[0] < self.neutral && self.likely[1] > self.neutral
    }
}

/// Kinds of runs in whose data an effect can appear.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct RunKinds {
    /// In lateral runs.
    pub lateral: bool,
    /// In insertions.
    pub insertion: bool,
}

impl RunKinds {
    /// Lateral runs and insertions.
    pub const BOTH: Self = Self { lateral: true, insertion: true };
    /// Lateral runs only.
    pub const LATERAL: Self = Self { lateral: true, insertion: false };
    /// Insertions only.
    pub const INSERTION: Self = Self { lateral: false, insertion: true };
}

/// Description of an effect: name, physics, observable signature, parameters.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct EffectInfo {
    /// Name, as in files and options.
    pub id: &'static str,
    /// Its physics, in one line.
    pub physics: &'static str,
    /// Change of the data with it, in one line.
    pub signature: &'static str,
    /// Kinds of runs in whose data it can appear.
    pub observable_in: RunKinds,
    /// Whether every evaluation of an insertion with it is an iteration at every depth.
    pub is_costly: bool,
    /// Its parameters, in the order of their values.
    pub parameters: &'static [ParameterInfo],
}

/// Input of the sensors' maps beside the values: the commanded motion of guide 2, and how the shape was imaged.
#[derive(Debug, Clone, Copy, Default)]
pub struct ObservationContext<'a> {
    /// Times of the force samples.
    pub time_s: &'a [f64],
    /// Commanded displacement of guide 2, vertical and horizontal; empty in insertions and steering runs.
    pub commanded_m: [&'a [f64]; 2],
    /// Motion back by this or less is noise of the displacement, vertical and horizontal: guide 2 has not turned round.
    pub reversal_m: [f64; 2],
    /// Image of every point of the shape; empty if none is known.
    pub images: &'a [Option<ShapeImage>],
    /// Depth of the needle and number of the run.
    pub conditions: Conditions,
    /// Position of the tissue surface.
    pub entry_m: f64,
    /// Every point of the shape; empty where no effect depends on it ([`Effect::needs_places`]).
    pub shape: &'a [ShapePoint],
    /// Depths of an insertion at which the tip is measured.
    pub tip_depth_m: &'a [f64],
}

impl ObservationContext<'_> {
    /// Sign of the last motion of guide 2 in a plane at every force sample.
    pub(super) fn directions(&self, plane: usize) -> Vec<f64> {
        directions(self.commanded_m[plane], self.reversal_m[plane])
    }

    /// Speed of guide 2 in a plane at every force sample, with the sign of its last motion.
    pub(super) fn speeds_m_per_s(&self, plane: usize) -> Vec<f64> {
        speeds_m_per_s(self.time_s, self.commanded_m[plane], self.reversal_m[plane])
    }
}

/// A motion of guide 2 in a lateral run.
#[derive(Debug, Clone, Copy)]
pub struct MotionContext<'a> {
    /// Times of its samples.
    pub time_s: &'a [f64],
    /// Commanded displacement, vertical and horizontal.
    pub commanded_m: [&'a [f64]; 2],
    /// Motion back by this or less is noise of the displacement, vertical and horizontal.
    pub reversal_m: [f64; 2],
    /// Depth of the needle and number of the run.
    pub conditions: Conditions,
}

impl MotionContext<'_> {
    /// Sign of the last motion in a plane at every sample.
    pub(super) fn directions(&self, plane: usize) -> Vec<f64> {
        directions(self.commanded_m[plane], self.reversal_m[plane])
    }
}

/// A way in which rig, tissue or sensors differ from the plain model.
pub trait Effect: Debug + Sync {
    /// Name, physics, signature and parameters.
    fn info(&self) -> &'static EffectInfo;

    /// Name, as in files and options.
    fn id(&self) -> &'static str {
        self.info().id
    }

    /// Its parameters.
    fn parameters(&self) -> &'static [ParameterInfo] {
        self.info().parameters
    }

    /// Whether a rig can have it at all.
    fn applies_to(&self, _rig: &Rig) -> bool {
        true
    }

    /// Whether it does something only to points of a shape whose image is known ([`ShapePoint::image`]).
    fn needs_images(&self) -> bool {
        false
    }

    /// Whether what it does to a shape depends on the places of its points.
    fn needs_places(&self) -> bool {
        false
    }

    /// Whether it is one of the grammar's laws, which nobody has given a name.
    fn is_unnamed(&self) -> bool {
        self.as_law().is_some_and(|law| law.own().is_none())
    }

    /// The triple that it is, where it is a term and no effect of the catalogue.
    fn as_law(&self) -> Option<&Law> {
        None
    }

    /// Changes the tissue of a plane under conditions of the run.
    ///
    /// # Errors
    /// [`ModelError::OutOfRange`] where the values are impossible.
    fn tissue(
        &self,
        _values: &[f64],
        _conditions: &Conditions,
        _plane: Plane,
        _problem: &mut BeamProblem,
    ) -> Result<(), ModelError> {
        Ok(())
    }

    /// Changes what reaches the needle of the displacement of guide 2 in a plane, sample by sample, in lateral runs.
    fn guide2(&self, _values: &[f64], _context: &MotionContext<'_>, _plane: usize, _reached_m: &mut [f64]) {}

    /// Whether the modulus changes while guide 2 moves.
    fn varies_modulus(&self) -> bool {
        false
    }

    /// Changes the factors of the modulus at every sample of a motion, in lateral runs.
    fn modulus(&self, _values: &[f64], _context: &MotionContext<'_>, _plane: usize, _factors: &mut [f64]) {}

    /// Changes the beam problem of a plane.
    ///
    /// # Errors
    /// [`ModelError::OutOfRange`] where the values are impossible.
    fn beam(&self, _values: &[f64], _plane: Plane, _problem: &mut BeamProblem) -> Result<(), ModelError> {
        Ok(())
    }

    /// Changes what lies between actuator and needle: in lateral runs all of it, in insertions the clearance (what the frame gives is
    /// part of their beam problem).
    fn drive(&self, _values: &[f64], _drive: &mut Drive) {}

    /// Changes the stress-free curvature of the needle, vertical and horizontal before it is turned, 1/m.
    fn stress_free_curvature(&self, _values: &[f64], _curvature_per_m: &mut [f64; 2]) {}

    /// Adds a lateral force on the tip, vertical and horizontal, in lateral runs.
    fn tip_push(&self, _values: &[f64], _conditions: &Conditions, _tip_n: &mut [f64; 2]) {}

    /// Changes where the needle is really measured, in tissue that begins at `entry_m`.
    fn map_position(
        &self,
        _values: &[f64],
        _entry_m: f64,
        _conditions: &Conditions,
        _point: &mut ShapePoint,
    ) {
    }

    /// Changes what the sensors read.
    fn observe(&self, _values: &[f64], _context: &ObservationContext<'_>, _channels: &mut Channels) {}

    /// Changes what acts on the tip in an insertion.
    fn tip(&self, _values: &[f64], _conditions: &Conditions, _law: &mut TipLaw) {}
}

/// Every effect there is.
pub static EFFECTS: [&dyn Effect; 38] = [
    &tissue::Layers,
    &tissue::Gradient,
    &tissue::Stiffening,
    &tissue::Relaxation,
    &tissue::Shear,
    &tissue::EntryGap,
    &tissue::Skin,
    &tissue::Anisotropy,
    &tissue::Yield,
    &tissue::FiniteBody,
    &rig::Guide2Position,
    &rig::SurfacePosition,
    &rig::ClampCompliance,
    &rig::FrameCompliance,
    &rig::Backlash,
    &rig::Play,
    &rig::Friction,
    &rig::RearRotation,
    &sensor::ForceBias,
    &sensor::ForceGain,
    &sensor::ForceDrift,
    &sensor::Crosstalk,
    &sensor::Delay,
    &sensor::ShapeOffset,
    &sensor::ShapeScale,
    &sensor::DepthShift,
    &imaging::SoundSpeed,
    &imaging::Lag,
    &imaging::EchoOffset,
    &needle::Stiffness,
    &needle::Prebend,
    &needle::AxialLoad,
    &tip::LoadSlope,
    &tip::LoadStep,
    &tip::EntryAngle,
    &tip::BevelRoll,
    &tip::Rate,
    &tip::CutAngle,
];

/// Place of an effect in the order in which effects act on the way from the rig to the readings: that of the catalogue, what is in none
/// last.
pub fn place_of(id: &str) -> usize {
    EFFECTS.iter().position(|effect| effect.id() == id).unwrap_or(EFFECTS.len())
}

/// All effects by name: those of the catalogue, and those that persons have written.
pub fn all() -> Vec<&'static dyn Effect> {
    let own_laws = super::terms::own().into_iter().map(|law| law as &'static dyn Effect);
    EFFECTS.into_iter().chain(own_laws).collect()
}

/// The effect of an id: of the catalogue, or a [term](super::terms).
pub fn effect(id: &str) -> Option<&'static dyn Effect> {
    let named = EFFECTS.into_iter().find(|effect| effect.id() == id);
    named.or_else(|| term(id).map(|law| law as &'static dyn Effect))
}

/// A series at a time: linear between its samples, constant beyond its ends.
pub(super) fn series_at(times_s: &[f64], values: &[f64], time_s: f64) -> f64 {
    let next = first_after(times_s, time_s);
    let earlier = next.checked_sub(1).and_then(|i| Some((times_s.get(i)?, values.get(i)?)));
    match (earlier, times_s.get(next).zip(values.get(next))) {
        (Some((a_s, a)), Some((b_s, b))) => a + (b - a) * (time_s - a_s) / (b_s - a_s),
        (Some((_, only)), None) | (None, Some((_, only))) => *only,
        (None, None) => f64::NAN,
    }
}

/// Number of the first of increasing times that is later than a time; their number where none is. Most records have a constant rate, which says
/// where it is.
pub(crate) fn first_after(times_s: &[f64], time_s: f64) -> usize {
    if let (Some(first_s), Some(last_s)) = (times_s.first(), times_s.last()) {
        let share = ((time_s - first_s) / (last_s - first_s)).clamp(0.0, 1.0);
        let at_rate = (share * (times_s.len() - 1) as f64) as usize;
        for next in [at_rate + 1, at_rate] {
            let is_before = next.checked_sub(1).and_then(|i| times_s.get(i)).is_some_and(|s| *s <= time_s);
            if is_before && times_s.get(next).is_some_and(|s| *s > time_s) {
                return next;
            }
        }
    }
    times_s.partition_point(|sample_s| *sample_s <= time_s)
}

/// Values at which an effect does nothing.
pub fn neutral(effect: &dyn Effect) -> Vec<f64> {
    effect.parameters().iter().map(|parameter| parameter.neutral).collect()
}

/// The first value; 0 where there is none.
fn first(values: &[f64]) -> f64 {
    values.first().copied().unwrap_or_default()
}

#[cfg(test)]
mod tests;
