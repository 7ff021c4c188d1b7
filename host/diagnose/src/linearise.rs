//! Log likelihood of a session as a function of every effect, to second order around the model without effects. Statistics over many
//! sessions add these up (theory, eq. 63 and 73).
//!
//! With `t` the parameters of effects in the scale of the fits, relative to their neutral values, the session's likelihood is
//! `ln p(data | t) - ln p(data | 0) = b^T t - t^T G t / 2`: the metric includes noise and discrepancy, and the modulus and the
//! other parameters of the model are eliminated. `b` and `G` of independent sessions add up. The fitted logarithm of the
//! modulus changes by `m^T t`.

use super::layout::Scale;
use super::posterior::Fitted;
use super::score::{Amplitude, Scores};
use super::{DiagnoseError, Start};
use mechanics::effects::Effect;

/// Smallest information of an amplitude that is kept, in units of its prior precision: with less it is not identifiable from a hundred
/// sessions either.
const MIN_INFORMATION: f64 = 0.01;
/// Correlations are kept as thousandths.
const PER_MILLE: f64 = 1000.0;

/// Scale of a parameter inside the fits.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ScaleKind {
    /// Linear.
    Linear,
    /// Logarithmic.
    Log,
}

/// One amplitude of an effect: a parameter, at a place or time where the effect has one.
#[derive(Debug, Clone)]
pub struct EffectAmplitude {
    /// The effect.
    pub effect: &'static dyn Effect,
    /// Number of its parameter.
    pub parameter: usize,
    /// Number and value of the parameter that is a place or a time.
    pub place: Option<(usize, f64)>,
    /// Scale of the parameter.
    pub scale: ScaleKind,
    /// Standard deviation of its prior around the neutral value.
    pub prior_sd: f64,
    /// Derivative of the log likelihood at the neutral value: `b`.
    pub score: f64,
    /// Information, with the modulus and the other parameters of the model eliminated: the diagonal of `G`.
    pub information: f64,
    /// Change of the fitted logarithm of the modulus per unit: `m`.
    pub ln_modulus_slope: f64,
}

/// A session's likelihood of every identifiable effect.
#[derive(Debug, Clone)]
pub struct Linearisation {
    /// Logarithm of the modulus, Pa, of the model without effects (K of springs, E of a body) and its standard deviation, noise and
    /// discrepancy together.
    pub ln_modulus_pa: (f64, f64),
    /// The amplitudes that are identifiable from the session or from many like it.
    pub amplitudes: Vec<EffectAmplitude>,
    /// Correlations `G_ij / sqrt(G_ii G_jj)` in thousandths, row by row below the diagonal.
    pub correlation_per_mille: Vec<i16>,
    /// Log evidence of every effect over the model without it, from its score.
    pub log_evidence: Vec<(&'static str, f64)>,
    /// Size of the discrepancy's groups, as multiples of those of an ordinary rig.
    pub discrepancy: Vec<(&'static str, f64)>,
}

impl Linearisation {
    /// Result for the starting model of a diagnosis.
    pub(super) fn of(start: &Start) -> Result<Self, DiagnoseError> {
        let Start { runs, patterns, fitted } = start;
        let scores = Scores::new(fitted, runs, patterns)?;
        let (gram, projections, ln_modulus) = scores.products();
        let amplitudes: Vec<(usize, EffectAmplitude)> = scores
            .amplitudes()
            .into_iter()
            .filter_map(|one| {
                let (column, step) = (one.column, one.step);
                let information = gram.get((column, column))? / (step * step);
                let is_informative = information * one.prior_sd * one.prior_sd > MIN_INFORMATION;
                let score = projections.get(column)? / step;
                let slope = ln_modulus.get(column)? / step;
                (is_informative && score.is_finite() && information.is_finite() && slope.is_finite())
                    .then(|| (column, amplitude(&one, score, information, slope)))
            })
            .collect();
        let mut correlation_per_mille = Vec::new();
        for (row, (i, _)) in amplitudes.iter().enumerate() {
            correlation_per_mille.extend(amplitudes[..row].iter().map(|(j, _)| {
                let sds = (gram[(*i, *i)] * gram[(*j, *j)]).sqrt();
                (PER_MILLE * gram[(*i, *j)] / sds).round().clamp(-PER_MILLE, PER_MILLE) as i16
            }));
        }
        Ok(Self {
            ln_modulus_pa: ln_modulus_pa(fitted),
            correlation_per_mille,
            amplitudes: amplitudes.iter().map(|(_, one)| one.clone()).collect(),
            log_evidence: scores
                .ranked()
                .iter()
                .map(|score| (score.effect.id(), score.log_evidence))
                .filter(|(_, gain)| gain.is_finite())
                .collect(),
            discrepancy: patterns
                .groups
                .iter()
                .zip(&fitted.sizes)
                .filter(|(group, _)| group.everyday > 0.0)
                .map(|(group, size)| (group.name, group.multiple * size / group.everyday))
                .collect(),
        })
    }
}

fn ln_modulus_pa(fitted: &Fitted) -> (f64, f64) {
    (fitted.modulus_pa().0.ln(), fitted.sd(0))
}

fn amplitude(one: &Amplitude, score: f64, information: f64, ln_modulus_slope: f64) -> EffectAmplitude {
    let scale = one.effect.parameters().get(one.parameter).map_or(Scale::Linear, Scale::of);
    EffectAmplitude {
        effect: one.effect,
        parameter: one.parameter,
        place: one.place,
        scale: if scale == Scale::Log { ScaleKind::Log } else { ScaleKind::Linear },
        prior_sd: one.prior_sd,
        score,
        information,
        ln_modulus_slope,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Layout, Multiples, Noise, Noises, fit_start, runs_of};
    use worlds::{Design, NoisePlan, Truth};

    fn linearised(effects: Vec<(&'static str, Vec<f64>)>, seed: u64) -> Linearisation {
        let truth = Truth { k_kpa: 12.0, tip_load_n: 0.2, effects, foreign: None };
        linearised_of(&truth, &Design::four_runs(), seed)
    }

    fn linearised_of(truth: &Truth, design: &Design, seed: u64) -> Linearisation {
        let session = worlds::session(truth, design, seed);
        let (runs, _) = runs_of(&session).expect("runs");
        let noise = Noise::of(&runs, &session.noise);
        let layout = Layout::new(&session.rig, &runs, Vec::new());
        let noises = Noises { session: noise, reference: noise };
        let start = fit_start(&layout, &runs, &noises, &[], &Multiples::new()).expect("fitted");
        Linearisation::of(&start).expect("linearised")
    }

    fn gain(linearisation: &Linearisation) -> &EffectAmplitude {
        linearisation
            .amplitudes
            .iter()
            .find(|one| one.effect.id() == "sensor.force_gain")
            .expect("identifiable")
    }

    #[test]
    fn the_score_estimates_an_effect_of_an_independent_generator_and_its_bias_of_the_modulus() {
        let (plain, biased) =
            (linearised(Vec::new(), 5), linearised(vec![("sensor.force_gain", vec![0.03])], 5));
        let amplitude = gain(&biased);
        let (value, sd) = (amplitude.score / amplitude.information, amplitude.information.sqrt().recip());
        assert!((value - 1.03f64.ln()).abs() < 3.0 * sd, "{value} +- {sd}");
        // The bending stiffness, which scales the forces likewise, is known to 3 %.
        assert!(sd < 0.035, "sd {sd}");
        // Both sessions have the same noise: the gain changes the fitted modulus as the slope predicts.
        let moved = biased.ln_modulus_pa.0 - plain.ln_modulus_pa.0;
        let expected = amplitude.ln_modulus_slope * 1.03f64.ln();
        assert!((moved - expected).abs() < 0.3 * expected.abs(), "moved {moved}, expected {expected}");
        let count = biased.amplitudes.len();
        assert_eq!(biased.correlation_per_mille.len(), count * (count - 1) / 2);
    }
    /// The readings of the displacement have errors. If the model followed them exactly, white noise of 0.05 mm would cause an apparent
    /// delay of 11 ms, in ten sessions together 14 standard deviations from zero.
    #[test]
    fn noise_of_the_displacement_is_no_delay() {
        let (mut score, mut information) = (0.0, 0.0);
        for (number, displacement_mm) in [0.02, 0.05, 0.1].into_iter().cycle().take(9).enumerate() {
            let truth = Truth { k_kpa: 12.0, tip_load_n: 0.2, effects: Vec::new(), foreign: None };
            let noise = NoisePlan { displacement_mm, ..NoisePlan::default() };
            let linearisation =
                linearised_of(&truth, &Design { noise, ..Design::four_runs() }, number as u64);
            let delay = linearisation.amplitudes.iter().find(|one| one.effect.id() == "sensor.delay");
            let delay = delay.expect("identifiable");
            score += delay.score;
            information += delay.information;
        }
        let (delay_s, sd_s) = (score / information, information.sqrt().recip());
        assert!(delay_s.abs() < 3.0 * sd_s && sd_s < 1.5e-3, "{delay_s} +- {sd_s}");
    }
}
