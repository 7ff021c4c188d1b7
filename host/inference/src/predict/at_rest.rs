//! Insertions through one guide that rests, of a needle whose rear is not known.
//!
//! No load of known size then acts on the needle: any modulus explains a path with another load and another rear, and
//! what a likelihood prefers among them is the form of the load that a model assumes (one that is constant but for its
//! process noise), not a measurement. Modulus and gap are those assumed beforehand, and the load is that over the
//! moduli assumed beforehand.

use super::Options;
use insertion::{
    Candidates, Learned, Moments, PathError, Posterior, ReadingNoise, TipPath, Tissue, learn_from,
};
use mechanics::ModelError;
use readings::draws::Random;
use statrs::distribution::{ContinuousCDF, Normal};

/// Points and weights of a Gauss-Hermite quadrature over a normal distribution: exact for polynomials of degree five.
const POINTS: [(f64, f64); 3] =
    [(-1.732_050_807_568_877_2, 1.0 / 6.0), (0.0, 2.0 / 3.0), (1.732_050_807_568_877_2, 1.0 / 6.0)];
/// Standard deviation of the logarithm of a modulus that is held at a point.
const HELD_LN: f64 = 0.02;
/// A prior of the logarithm of the modulus that is not wider states it.
const STATED_LN: f64 = 0.3;

/// Candidates of a few moduli that stand for what is assumed beforehand, with their weights.
pub(super) struct AtRest {
    of_moduli: Vec<(f64, Candidates)>,
}

/// For every insertion whether its modulus could be identified from nothing but the form of paths: the rear is not known, and guide 2
/// rests in all that is learned from and in its own observed part.
pub(super) fn resting(tissue: &Tissue, paths: &[TipPath], options: &Options) -> Vec<bool> {
    let is_open = tissue.rear.is_some() && tissue.modulus_sd_ln > STATED_LN;
    (0..paths.len())
        .map(|number| {
            is_open
                && !(0..paths.len())
                    .any(|other| moves_guide2(number, other, paths, options.until_m, options.learn))
        })
        .collect()
}

fn moves_guide2(number: usize, other: usize, paths: &[TipPath], until_m: f64, learn: bool) -> bool {
    match other == number {
        true => paths[other].moves_guide2(until_m),
        false => learn && paths[other].moves_guide2(f64::INFINITY),
    }
}

impl AtRest {
    /// For recordings of one rig, down to `last_m`.
    ///
    /// # Errors
    /// As [`Candidates::new`].
    pub fn new(tissue: &Tissue, paths: &[TipPath], last_m: f64) -> Result<Self, ModelError> {
        Ok(Self {
            of_moduli: POINTS
                .into_iter()
                .map(|(sds, weight)| {
                    let mut fixed_tissue = tissue.clone();
                    fixed_tissue.model.foundation =
                        fixed_tissue.model.foundation.scaled((sds * tissue.modulus_sd_ln).exp())?;
                    fixed_tissue.modulus_sd_ln = HELD_LN;
                    Ok((weight, Candidates::new(&fixed_tissue, paths, last_m)?))
                })
                .collect::<Result<_, ModelError>>()?,
        })
    }

    /// Posterior of one insertion under each modulus, with its weight.
    ///
    /// # Errors
    /// [`PathError::Unexplained`] where a modulus explains it with no likelihood.
    pub fn posteriors(
        &self,
        known: &[TipPath],
        earlier: &[usize],
        number: usize,
        noise: ReadingNoise,
    ) -> Result<OfModuli<'_>, PathError> {
        let mut candidate_posteriors = Vec::new();
        for (weight, candidates) in &self.of_moduli {
            let learned: Learned = learn_from(candidates, known, earlier, number, noise, None);
            let mut posterior = Posterior::new(candidates, &learned);
            known.get(number).into_iter().for_each(|observed| posterior.update_all(observed));
            if !posterior.is_sound() {
                return Err(PathError::Unexplained);
            }
            candidate_posteriors.push((*weight, posterior));
        }
        Ok(candidate_posteriors)
    }
}

/// Posteriors of an insertion under each of a few moduli, from the softest to the stiffest, with their weights.
pub(super) type OfModuli<'a> = Vec<(f64, Posterior<'a>)>;

/// Tip load of one insertion at each depth, per plane, over the moduli assumed beforehand.
pub(super) fn load_n(of_moduli: &OfModuli<'_>, depths_m: &[f64]) -> Vec<Vec<Moments>> {
    let mut sums: Vec<Vec<Moments>> = Vec::new();
    for (weight, posterior) in of_moduli {
        let mean_load = posterior.load_n(depths_m);
        if sums.is_empty() {
            sums = mean_load.iter().map(|planes| vec![Moments::default(); planes.len()]).collect();
        }
        // Until all are there: mean and mean square.
        for (sum, one) in sums.iter_mut().flatten().zip(mean_load.iter().flatten()) {
            sum.mean += weight * one.mean;
            sum.sd += weight * (one.mean * one.mean + one.sd * one.sd);
        }
    }
    for moments in sums.iter_mut().flatten() {
        moments.sd = (moments.sd - moments.mean * moments.mean).max(0.0).sqrt();
    }
    sums
}

/// Draws of the tip load at each depth, per plane: each under the modulus that stands for the one drawn, of which `standard` has the
/// logarithm as a standard variate.
pub(super) fn draw_loads(
    of_moduli: &OfModuli<'_>,
    standard: &[f64],
    random: &mut Random,
    depths_m: &[f64],
) -> Vec<Vec<Vec<f64>>> {
    let normal = Normal::standard();
    let moduli: Vec<usize> = standard
        .iter()
        .map(|standard| {
            let mut remaining_probability = normal.cdf(*standard);
            of_moduli
                .iter()
                .position(|(weight, _)| {
                    remaining_probability -= weight;
                    remaining_probability < 0.0
                })
                .unwrap_or(of_moduli.len().saturating_sub(1))
        })
        .collect();
    let mut of_each: Vec<_> = of_moduli
        .iter()
        .enumerate()
        .map(|(modulus, (_, posterior))| {
            let count = moduli.iter().filter(|chosen| **chosen == modulus).count();
            posterior.draws(count, random, &[], depths_m).into_iter()
        })
        .collect();
    moduli.iter().filter_map(|modulus| of_each.get_mut(*modulus)?.next().map(|path| path.load_n)).collect()
}
