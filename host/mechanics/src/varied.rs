//! A needle in tissue whose modulus changes as guide 2 moves: with time, with the displacement, with use.
//!
//! Quasi-static: at every sample the needle is that of the modulus of that moment. Stiffness and shape per displacement are smooth in the
//! logarithm of the modulus; both are solved on a grid of it, the same for all factors so that a cache serves them, and interpolated by
//! cubics between four neighbours. Beside relaxation, stiffening or yielding the modulus does not change with motion: what of the tissue's
//! reaction is instantaneous would be a matter of definition.

use super::cache::Cache;
use super::lateral::{Motion, Response, Samples};
use super::{BeamProblem, ModelError};
use std::sync::Arc;

/// Spacing of the grid, in the logarithm of the modulus: cubics are within 2e-5 of the stiffness, and of shapes within 1e-4 of the displacement.
const SPACING_LN: f64 = 0.25;
/// Factors beyond these ends are taken as the ends.
const RANGE_LN: f64 = 2.0;

/// The needle on the part of the grid that a motion needs.
pub(super) struct Varied {
    first: i32,
    needles: Vec<Arc<Response>>,
}

impl Varied {
    /// For factors of the modulus; nothing where the tissue has memory or a law of its own.
    ///
    /// # Errors
    /// As [`BeamProblem::solve`].
    pub fn new(
        problem: &BeamProblem,
        factors: &[f64],
        cache: Option<&Cache>,
    ) -> Result<Option<Self>, ModelError> {
        if problem.is_nonlinear() || problem.law.relaxing_share > 0.0 {
            return Ok(None);
        }
        let node_numbers = factors.iter().map(|factor| place(*factor).floor() as i32);
        let (least, most) =
            node_numbers.fold((i32::MAX, i32::MIN), |(l, m), place| (l.min(place), m.max(place)));
        if least > most {
            return Ok(None);
        }
        let first = least - 1;
        let needles = (first..=most + 2)
            .map(|number| {
                let foundation = problem.foundation.scaled((SPACING_LN * f64::from(number)).exp())?;
                let problem = BeamProblem { foundation, ..problem.clone() };
                match cache {
                    Some(cache) => cache.response(&problem, 0.0),
                    None => Ok(Arc::new(Response::new(&problem, 0.0)?)),
                }
            })
            .collect::<Result<_, ModelError>>()?;
        Ok(Some(Self { first, needles }))
    }

    /// Force and coefficients of a motion that reaches the needle, in series with a frame that gives.
    pub fn moved(&self, pressed_m: &[f64], factors: &[f64], frame_compliance_m_per_n: f64) -> Motion {
        let count = pressed_m.len();
        let mut force_n = Vec::with_capacity(count);
        let mut coefficients = Samples::from_elem(0.0, count * self.needles.len());
        // The shapes are those of unit forces.
        let stiffness_n_per_m: Vec<f64> = self.needles.iter().map(|n| n.stiffness_n_per_m()).collect();
        // First of the four needles around a factor, and the force of each per displacement; most samples have the factor of the one before.
        let mut interpolation = (f64::NAN, 0, [0.0; 4]);
        for (i, (pressed_m, factor)) in pressed_m.iter().zip(factors).enumerate() {
            if interpolation.0 != *factor {
                let node_position = place(*factor) - f64::from(self.first);
                let first_node = (node_position.floor() - 1.0).max(0.0);
                let mut node_weights = cubic(node_position - first_node - 1.0);
                let needles = stiffness_n_per_m.iter().skip(first_node as usize);
                node_weights.iter_mut().zip(needles).for_each(|(share, stiffness)| *share *= stiffness);
                interpolation = (*factor, first_node as usize, node_weights);
            }
            let (_, first, weights) = interpolation;
            let stiffness: f64 = weights.iter().sum();
            let at_needle_m = pressed_m / (1.0 + frame_compliance_m_per_n * stiffness);
            force_n.push(stiffness * at_needle_m);
            let of_needles = coefficients.chunks_exact_mut(count).skip(first);
            of_needles.zip(weights).for_each(|(of_needle, share)| of_needle[i] = share * at_needle_m);
        }
        Motion { force_n, coefficients }
    }

    /// Weight of every coefficient in the deflection at each of these places, coefficient by coefficient.
    pub fn shape_at(&self, z_m: &[f64]) -> Vec<f64> {
        self.needles.iter().flat_map(|needle| needle.shape_at(z_m)).collect()
    }
}

/// Place of a factor on the grid.
fn place(factor: f64) -> f64 {
    factor.max(f64::MIN_POSITIVE).ln().clamp(-RANGE_LN, RANGE_LN) / SPACING_LN
}

/// Lagrange's cubic between the second and the third of four neighbours: their weights at a share of the way.
pub(super) fn cubic(t: f64) -> [f64; 4] {
    let (from_left, from_right, from_far_right) = (t + 1.0, t - 1.0, t - 2.0);
    [
        -t * from_right * from_far_right / 6.0,
        from_left * from_right * from_far_right / 2.0,
        -from_left * t * from_far_right / 2.0,
        from_left * t * from_right / 6.0,
    ]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Foundation, Needle, Rig};

    /// If the factor stays the same the needle is that of a modulus as much larger.
    #[test]
    fn a_constant_factor_is_another_modulus() {
        let rig = Rig::two_guides(Needle::gauge_18(), 0.06, 0.07);
        for factor in [0.31, 0.9, 1.0, 1.7, 5.0] {
            let pressed_m = [0.0, 1e-3, -0.4e-3];
            let varied =
                Varied::new(&problem(16e3, &rig), &[factor; 3], None).expect("solves").expect("linear");
            let motion = varied.moved(&pressed_m, &[factor; 3], 2e-5);
            let beam = problem(16e3 * factor, &rig).solve().expect("solves");
            let stiffness = beam.lateral_stiffness_n_per_m();
            for (i, pressed_m) in pressed_m.iter().enumerate() {
                let at_needle_m = pressed_m / (1.0 + 2e-5 * stiffness);
                let difference_n = motion.force_n[i] - stiffness * at_needle_m;
                assert!(
                    difference_n.abs() < 2e-5 * (stiffness * at_needle_m).abs() + 1e-12,
                    "{factor} {difference_n}"
                );
                let weights = varied.shape_at(&[0.085]);
                let shape_m: f64 = motion.between([i, i], 0.0).zip(&weights).map(|(c, w)| c * w).sum();
                let expected_m = beam.deflection_m(at_needle_m, 0.085);
                assert!((shape_m - expected_m).abs() < 1e-4 * at_needle_m.abs() + 1e-15, "{factor}");
            }
        }
    }

    fn problem(modulus_pa: f64, rig: &Rig) -> BeamProblem {
        BeamProblem::new(rig, Foundation::uniform(modulus_pa).expect("a modulus"), 0.03)
    }
}
