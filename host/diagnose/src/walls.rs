//! Effect of the tissue's walls on every E of a diagnosis; K does not depend on them.

use super::results::Diagnosis;
use mechanics::Support;
use modulus::walls::WallsResult;

impl Diagnosis {
    /// Widens the intervals of Young's moduli by the possible effect of the tissue's walls, and adds a note about it.
    pub(super) fn with_walls(mut self, walls: WallsResult) -> Self {
        let walls =
            walls.beside(self.effects.iter().chain(&self.given_effects).map(|found| found.id.as_str()));
        let foundation = &mut self.foundation;
        let of_half_space =
            foundation.youngs_modulus_kpa.or(foundation.youngs_modulus_of_plain_body_kpa).map(|e| e.ci95);
        if of_half_space.is_some() {
            self.warnings.extend(walls.note(of_half_space));
        }
        // On springs the mean modulus and the modulus of the reference are K, which does not depend on the walls.
        let is_body = foundation.used == Support::half_space(0.5).name();
        let mean = self.mean_modulus.as_mut().filter(|_| is_body).map(|mean| &mut mean.modulus_kpa);
        let reference = self.reference.as_mut().filter(|_| is_body).map(|one| &mut one.modulus_kpa);
        let youngs =
            [foundation.youngs_modulus_kpa.as_mut(), foundation.youngs_modulus_of_plain_body_kpa.as_mut()];
        for estimate in youngs.into_iter().chain([mean, reference]).flatten() {
            estimate.ci95 = walls.widened(estimate.value, estimate.ci95);
        }
        self.walls = Some(walls).filter(|_| of_half_space.is_some());
        self
    }
}
