//! The model for values of the parameters.

use super::{Layout, Places, Scale};
use crate::data::Kind;
use mechanics::effects::{Effect, place_of};
use mechanics::{Guides, Model, ModelError, TipLaw};

impl Layout {
    /// Values of the effects' parameters in their own units.
    pub fn effect_values(&self, values: &[f64]) -> Vec<(&'static dyn Effect, Vec<f64>)> {
        let mut first_value = self.own();
        let effects = self.effects.iter().map(|effect| {
            let infos = effect.parameters();
            let outside_values = infos
                .iter()
                .zip(&values[first_value..])
                .map(|(info, v)| Scale::of(info).outside(*v))
                .collect();
            first_value += infos.len();
            (*effect, outside_values)
        });
        effects.collect()
    }

    /// The model with these values for a kind of run.
    ///
    /// # Errors
    /// [`ModelError::OutOfRange`] where a value is impossible.
    pub fn model(&self, values: &[f64], kind: Kind) -> Result<Model, ModelError> {
        self.model_of(values, kind, false)
    }

    /// The model with these values for a run, which may belong to the reference.
    ///
    /// # Errors
    /// [`ModelError::OutOfRange`] where a value is impossible.
    pub fn model_of(&self, values: &[f64], kind: Kind, is_reference: bool) -> Result<Model, ModelError> {
        let Places { load, across, apart, rear, gap, ratio, guide2, entry } = self.places();
        let mut ln_modulus = values[0];
        if kind == Kind::Insertion {
            ln_modulus += value_at(values, apart).unwrap_or_default();
        }
        let mut rig = match &self.reference {
            Some(rig) if is_reference => {
                ln_modulus -= value_at(values, ratio).unwrap_or_default();
                rig.clone()
            }
            _ => self.rig.clone(),
        };
        if let Some(ln_gap) = value_at(values, gap[usize::from(is_reference)]) {
            rig.entry_m = rig.guide2_m + (rig.entry_m - rig.guide2_m) * ln_gap.exp();
        }
        rig.guide2_m += value_at(values, guide2).unwrap_or_default();
        // In insertions the surface has a place of its own.
        if kind == Kind::Lateral {
            rig.entry_m += value_at(values, entry).unwrap_or_default();
        }
        rig.entry_m = rig.entry_m.max(rig.guide2_m);
        if let Guides::One { rear_rotation_n_m_per_rad } = &mut rig.guides {
            for (stiffness, place) in rear_rotation_n_m_per_rad.iter_mut().zip(rear) {
                *stiffness =
                    stiffness.or(value_at(values, place).map(|ln_compliance| (-ln_compliance).exp()));
            }
        }
        let mut model = Model::on(rig, self.support, ln_modulus.exp())?;
        if let Some(load_n) = value_at(values, load) {
            model.tip = TipLaw::load([load_n, value_at(values, across).unwrap_or_default()]);
        }
        model.effects = self.effect_values(values);
        if is_reference {
            model.effects.truncate(self.given);
        }
        // The order of the catalogue is that of the physics: what the needle does comes before what sensors make of it.
        model.effects.sort_by_key(|(effect, _)| place_of(effect.id()));
        Ok(model)
    }
}

/// Value of a parameter that a session may not have.
fn value_at(values: &[f64], place: Option<usize>) -> Option<f64> {
    values.get(place?).copied()
}
