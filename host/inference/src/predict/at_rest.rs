//! Insertions through a single guide at rest, of a needle with an unknown rotation stiffness at its rear.
//!
//! No load of known size then acts on the needle, so that any modulus explains a path, with another load and another rear. A
//! likelihood would prefer one of them only because of the assumed form of the load (constant but for process noise). Therefore
//! modulus and gap keep their priors, and the load is averaged over the prior of the modulus.

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
/// Standard deviation of the logarithm of a modulus that is fixed at a point.
const HELD_LN: f64 = 0.02;
/// Widest prior of the logarithm of the modulus that counts as a statement of the modulus.
const STATED_LN: f64 = 0.3;

/// Candidates at a few moduli that represent the prior, with their weights.
pub(super) struct AtRest {
    of_moduli: Vec<(f64, Candidates)>,
}

/// For every insertion, whether only the form of paths could identify its modulus: the rear is unknown, and guide 2 rests in
/// all training data and in its own observed part.
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

/// Tip load of one insertion at each depth, per plane, averaged over the prior of the modulus.
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

/// Draws of the tip load at each depth, per plane. Each is conditional on the quadrature point nearest to a drawn modulus,
/// whose logarithm is a standard variate in `standard`.
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
