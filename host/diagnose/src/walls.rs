//! Walls of the tissue in every E that a diagnosis states; K does not depend on them.

use super::results::{Diagnosis, Estimate};
use mechanics::Support;
use modulus::walls::WallsResult;

impl Diagnosis {
    /// With what the walls of the tissue may do to its Young's moduli, and the note that says so.
    pub(super) fn with_walls(mut self, walls: WallsResult) -> Self {
        let walls =
            walls.beside(self.effects.iter().chain(&self.given_effects).map(|found| found.id.as_str()));
        let widen = |estimate: &mut Estimate| estimate.ci95 = walls.widened(estimate.value, estimate.ci95);
        let foundation = &mut self.foundation;
        let of_half_space =
            foundation.youngs_modulus_kpa.or(foundation.youngs_modulus_of_plain_body_kpa).map(|e| e.ci95);
        if of_half_space.is_some() {
            self.warnings.extend(walls.note(of_half_space));
        }
        let youngs = [&mut foundation.youngs_modulus_kpa, &mut foundation.youngs_modulus_of_plain_body_kpa];
        youngs.into_iter().flatten().for_each(widen);
        // On springs these are K.
        if foundation.used == Support::half_space(0.5).name() {
            self.mean_modulus.iter_mut().for_each(|mean| widen(&mut mean.modulus_kpa));
            self.reference.iter_mut().for_each(|reference| widen(&mut reference.modulus_kpa));
        }
        self.walls = Some(walls).filter(|_| of_half_space.is_some());
        self
    }
}
