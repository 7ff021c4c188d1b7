//! Errors that all points of a run's shape share: of their positions, and of the straight needle from which deflections are measured.

use super::LateralData;
use formats::session::SHARED_ERRORS;
use smallvec::SmallVec;

/// None of the errors that points share.
pub(super) const NO_ERRORS: [[f64; SHARED_ERRORS]; 2] = [[0.0; SHARED_ERRORS]; 2];

/// Expected values of the errors that all points of a run share, in their standard deviations: zero, but in data that
/// are drawn around a fit.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct SharedErrors {
    /// Error of the positions ([`super::ShapeDatum::z_shared_sd_m`]).
    pub z: f64,
    /// Errors of the deflections in each plane ([`super::ShapeDatum::shared_m`]).
    pub deflection: [[f64; SHARED_ERRORS]; 2],
}

impl LateralData {
    /// Whether its points share an error of their positions, which is a nuisance then.
    pub(super) fn shares_z(&self) -> bool {
        self.levels.iter().flat_map(|level| &level.shape).any(|point| point.z_shared_sd_m > 0.0)
    }

    /// The errors of the deflections that its points share, which are nuisances then: plane and number of each.
    pub(crate) fn shared_deflections(&self) -> SmallVec<[(usize, usize); 6]> {
        let points = || self.levels.iter().flat_map(|level| &level.shape);
        (0..self.planes)
            .flat_map(|plane| (0..SHARED_ERRORS).map(move |error| (plane, error)))
            .filter(|(plane, error)| {
                points().any(|point| {
                    point.shared_m.get(*plane).and_then(|of| of.get(*error)).is_some_and(|m| *m != 0.0)
                })
            })
            .collect()
    }

    /// Expected values of these errors.
    pub(super) fn expected(&self) -> impl Iterator<Item = f64> {
        let expected = self.shared.deflection;
        self.shared_deflections().into_iter().map(move |(plane, error)| expected[plane][error])
    }
}
