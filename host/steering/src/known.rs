//! Parameters of the rig from its runs in air, in the controller's model.
//!
//! Compliances and the needle's stiffness become part of the forward model; the play between guide 2 and its sensor is a prior with
//! its own spread, in place of the share of the stated guide error that stands for it otherwise.

use mechanics::Drive;
use mechanics::effects::{Effect, effect};
use mechanics::{BeamProblem, ModelError, Plane};
use serde::{Deserialize, Serialize};

/// Effects that say how stiff the needle is, relative to what is stated of it.
const OF_STATED_STIFFNESS: &str = "needle.stiffness";

/// Rotation of the needle in guide 1.
const OF_CLAMP: &str = "rig.clamp_compliance";

/// An effect of the rig that its runs in air have determined.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct KnownEffect {
    /// Its id in the catalogue ([`mechanics::effects`]).
    pub id: String,
    /// Values of its parameters, in their order and in the units of their names.
    pub values: Vec<f64>,
    /// Standard deviations of the values.
    pub sds: Vec<f64>,
}

impl KnownEffect {
    fn effect(&self) -> Option<&'static dyn Effect> {
        effect(&self.id).filter(|effect| effect.parameters().len() == self.values.len())
    }

    /// Clearance with these values, m.
    fn loose_m(&self, values: &[f64]) -> f64 {
        let mut drive = Drive::default();
        if let Some(effect) = self.effect() {
            effect.drive(values, &mut drive);
        }
        drive.play_m + drive.clearance_m
    }
}

/// Puts what is known into the problem; `is_stiffness_stated`: the plant states the stiffness that a known one is relative to.
///
/// # Errors
/// [`ModelError::OutOfRange`] where a value is impossible.
pub(crate) fn apply(
    known: &[KnownEffect],
    is_stiffness_stated: bool,
    problem: &mut BeamProblem,
) -> Result<(), ModelError> {
    for one in known.iter().filter(|one| is_stiffness_stated || one.id != OF_STATED_STIFFNESS) {
        if let Some(effect) = one.effect() {
            effect.beam(&one.values, Plane::Y, problem)?;
        }
    }
    Ok(())
}

/// Spread of the logarithm of the rotation in guide 1 per moment; nothing where none is known.
pub(crate) fn clamp_sd(known: &[KnownEffect]) -> Option<f64> {
    let clamp_effect = known.iter().find(|one| one.id == OF_CLAMP)?;
    let (value, sd) = (clamp_effect.values.first()?, clamp_effect.sds.first()?);
    (*value > 0.0).then(|| (sd / value).max(1e-3))
}

/// Half of the play of guide 2 and its standard deviation, m; nothing where none is known.
pub(crate) fn play_m(known: &[KnownEffect]) -> Option<[f64; 2]> {
    let clearances_m = known.iter().filter_map(|one| {
        let mean_m = one.loose_m(&one.values);
        let upper_values: Vec<f64> = one.values.iter().zip(&one.sds).map(|(value, sd)| value + sd).collect();
        let sd_m = one.loose_m(&upper_values) - mean_m;
        (sd_m > 0.0).then_some([mean_m, sd_m])
    });
    clearances_m.reduce(|[mean_m, sd_m], [more_m, more_sd_m]| [mean_m + more_m, sd_m.hypot(more_sd_m)])
}

#[cfg(test)]
mod tests {
    use super::*;
    use mechanics::{Foundation, Needle, Rig};

    fn known(id: &str, value: f64, sd: f64) -> KnownEffect {
        KnownEffect { id: id.to_owned(), values: vec![value], sds: vec![sd] }
    }

    #[test]
    fn what_gives_way_is_in_the_problem_and_what_is_loose_is_a_prior() {
        let all_known = [
            known("rig.frame_compliance", 0.06, 0.01),
            known("rig.clamp_compliance", 0.3, 0.1),
            known("needle.stiffness", 0.05, 0.01),
            known("rig.play", 0.12, 0.01),
            known("rig.backlash", 0.03, 0.02),
            known("sensor.crosstalk", 0.02, 0.001),
        ];
        let rig = Rig::two_guides(Needle::gauge_18(), 0.06, 0.07);
        let tissue = Foundation::uniform(1e4).expect("a tissue");
        let plain = BeamProblem::new(&rig, tissue, 0.1);
        let mut problem = plain.clone();
        apply(&all_known, true, &mut problem).expect("possible");
        assert!((problem.guide2_compliance_m_per_n - 6e-5).abs() < 1e-12);
        assert!((problem.clamp_compliance_rad_per_n_m - 0.3).abs() < 1e-12);
        assert!((problem.bending_stiffness_n_m2 / plain.bending_stiffness_n_m2 - 1.05).abs() < 1e-12);
        let mut unstated = plain.clone();
        apply(&all_known, false, &mut unstated).expect("possible");
        assert_eq!(unstated.bending_stiffness_n_m2, plain.bending_stiffness_n_m2);
        let [mean_m, sd_m] = play_m(&all_known).expect("loose");
        assert!((mean_m - 0.15e-3).abs() < 1e-12 && (sd_m - 1e-5_f64.hypot(2e-5)).abs() < 1e-12);
        assert_eq!(play_m(&all_known[..3]), None);
        assert!((clamp_sd(&all_known).expect("known") - 0.1 / 0.3).abs() < 1e-12);
        assert_eq!(clamp_sd(&all_known[2..]), None);
    }
}
