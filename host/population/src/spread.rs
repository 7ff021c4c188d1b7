//! Distribution of an effect over sessions: absent, the same in all, varying around a common mean, or in single
//! sessions only (theory, eq. 74).
//!
//! After what groups share is taken off. Varying: `t_i ~ N(m, s^2)` with s integrated over a grid; a session's likelihood with t_i
//! integrated is `b' = (I + s^2 G)^-1 b`, `G' = (I + s^2 G)^-1 G`. Single: every session has the effect with a small probability,
//! integrated over a grid, independent of the others.

use crate::patterns::MIN_SESSIONS;
use crate::results::{EffectSpread, SpreadKind};
use crate::search::{FALSE_ALARMS, LEAST_SIZE, ln_mean_exp};
use crate::sharing::{Hypothesis, Likelihood, Likelihoods, Matrix, Sum, Vector};
use crate::summary::Summary;
use rayon::prelude::*;
use std::collections::BTreeMap;

/// Standard deviations between sessions, in units of the prior; from the least size that matters.
const SPREADS: [f64; 7] = [0.06, 0.12, 0.25, 0.5, 1.0, 2.0, 4.0];
/// Shares of the sessions that have an effect by themselves, in sessions.
const SINGLE: [f64; 4] = [1.0, 2.0, 4.0, 8.0];
/// Log evidence that is needed against an absent effect and against a simpler hypothesis.
const MIN_EVIDENCE: f64 = 5.0;
/// Information on a parameter, in units of its prior, from which a session counts.
const MIN_INFORMATION: f64 = 0.05;

/// The spread of every effect over all sessions; the place with the most evidence of those with places.
pub(crate) fn spread(data: &Likelihoods, summaries: &[Names]) -> Vec<EffectSpread> {
    let mut of_effects: BTreeMap<&str, EffectSpread> = BTreeMap::new();
    let spreads: Vec<Option<EffectSpread>> =
        data.hypotheses.par_iter().map(|hypothesis| of_hypothesis(data, hypothesis, summaries)).collect();
    for (hypothesis, one) in data.hypotheses.iter().zip(spreads) {
        let Some(result) = one else { continue };
        match of_effects.get_mut(hypothesis.effect.as_str()) {
            Some(known) if largest_evidence(known) >= largest_evidence(&result) => {}
            Some(known) => *known = result,
            None => {
                of_effects.insert(&hypothesis.effect, result);
            }
        }
    }
    of_effects.into_values().collect()
}

fn largest_evidence(spread: &EffectSpread) -> f64 {
    spread.log_evidence_shared.max(spread.log_evidence_varying).max(spread.log_evidence_single)
}

/// Effects that a session names.
#[derive(Debug, Clone, Default)]
pub(crate) struct Names(pub Vec<String>);

impl Names {
    pub fn of(summary: &Summary) -> Self {
        Self(
            summary
                .result
                .iter()
                .flat_map(|result| result.named.iter().map(|named| named.id.clone()))
                .collect(),
        )
    }
}

fn of_hypothesis(data: &Likelihoods, hypothesis: &Hypothesis, names: &[Names]) -> Option<EffectSpread> {
    let usable: Vec<&Likelihood> = data.sessions.iter().flatten().filter(|one| one.is_explained).collect();
    let blocks: Vec<(Vector, Matrix)> = usable.iter().map(|one| one.block(hypothesis)).collect();
    let blocks: Vec<&(Vector, Matrix)> =
        blocks.iter().filter(|(_, g)| g.diagonal().max() > MIN_INFORMATION).collect();
    if blocks.len() < MIN_SESSIONS {
        return None;
    }
    let whole = Sum::of(blocks.iter().map(|block| **block));
    let (_, _, p) = whole.heterogeneity();
    // Sessions that agree as well as their errors let them do not differ, however likely a wide prior makes that.
    let tests = data.hypotheses.len() as f64;
    let (shared, size) = whole.evidence(hypothesis);
    let varying = SPREADS.map(|spread| {
        let mut information = 0.0;
        let reduced = Sum::of(blocks.iter().filter_map(|(b, g)| {
            let factor = (Matrix::identity() + g * (spread * spread)).cholesky()?;
            let less = factor.solve(b);
            information += 0.5 * spread * spread * b.dot(&less) - factor.l().diagonal().map(f64::ln).sum();
            Some((less, factor.solve(g)))
        }));
        // Around zero, or around a common mean.
        information + ln_mean_exp([0.0, reduced.evidence(hypothesis).0].into_iter())
    });
    let count = blocks.len() as f64;
    let alone: Vec<f64> = blocks.iter().map(|block| Sum::of([**block]).evidence(hypothesis).0).collect();
    let single = SINGLE.map(|sessions| {
        let start_fraction = (sessions / count).min(0.5);
        alone.iter().map(|log| mixed(*log, start_fraction)).sum::<f64>()
    });
    let (varying, single) = (ln_mean_exp(varying.into_iter()), ln_mean_exp(single.into_iter()));
    let kind = [(SpreadKind::Shared, shared), (SpreadKind::Single, single), (SpreadKind::Varying, varying)]
        .into_iter()
        .filter(|(kind, _)| match kind {
            SpreadKind::Shared => size.is_some_and(|size| size > LEAST_SIZE),
            SpreadKind::Varying => size.is_some() && p * tests < FALSE_ALARMS,
            _ => true,
        })
        .fold((SpreadKind::Absent, 0.0), |best, one| if one.1 > best.1 + MIN_EVIDENCE { one } else { best });
    Some(EffectSpread {
        effect: hypothesis.effect.clone(),
        at: hypothesis.at.clone(),
        kind: kind.0,
        sessions: blocks.len(),
        named_by_sessions: names.iter().filter(|names| names.0.contains(&hypothesis.effect)).count(),
        log_evidence_shared: shared,
        log_evidence_varying: varying,
        log_evidence_single: single,
        heterogeneity_p: p,
    })
}

/// `ln (1 - share + share exp log)`.
fn mixed(log: f64, share: f64) -> f64 {
    if log > 30.0 { share.ln() + log } else { (share * log.exp_m1()).ln_1p() }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Records;
    use crate::summary::{Amplitude, SessionResult, Summary};

    /// The kind of spread of an effect that cannot be negative and that every session measures at this size, in prior standard deviations.
    fn kind(size: f64) -> Option<SpreadKind> {
        let amplitude = |information: f64| Amplitude {
            effect: "rig.backlash".to_owned(),
            parameter: "clearance_mm".to_owned(),
            at: None,
            scale: "linear".to_owned(),
            neutral: 0.0,
            two_sided: false,
            prior_sd: 0.1,
            score: 0.1 * size * information,
            information,
            ln_k_slope: 0.0,
        };
        let result = |number: u32| SessionResult {
            verdict: "adequate".to_owned(),
            foundation: "springs".to_owned(),
            k_kpa: 12.0,
            k_ci95_kpa: [11.0, 13.0],
            ln_k_kpa: 12f64.ln(),
            ln_k_sd: 0.04,
            ln_modulus_without_effects: [12f64.ln(), 0.04],
            youngs_modulus_kpa: None,
            tip_load_n: None,
            tip_load_ci95_n: None,
            discrepancy: BTreeMap::new(),
            noise: BTreeMap::new(),
            named: Vec::new(),
            log_evidence: BTreeMap::new(),
            amplitudes: vec![amplitude(1e5 + 1e3 * f64::from(number))],
            correlation_per_mille: Vec::new(),
        };
        let (_, data) = Records::from(
            (0..15)
                .map(|number| Summary { result: Some(result(number)), ..Summary::empty(number.to_string()) })
                .collect::<Vec<_>>(),
        )
        .likelihoods();
        spread(&data, &vec![Names::default(); 15]).first().map(|one| one.kind)
    }

    #[test]
    fn an_effect_is_the_same_in_all_only_where_it_is_possible_and_large_enough_to_matter() {
        assert_eq!(kind(0.5), Some(SpreadKind::Shared));
        assert_eq!(kind(-0.5), Some(SpreadKind::Absent));
        assert_eq!(kind(0.02), Some(SpreadKind::Absent));
    }

    #[test]
    fn a_mixture_is_a_mean_of_its_parts_however_large_they_are() {
        assert!((mixed(2.0, 0.25) - (0.75 + 0.25 * 2f64.exp()).ln()).abs() < 1e-12);
        assert!((mixed(900.0, 0.25) - (900.0 + 0.25f64.ln())).abs() < 1e-9);
        assert!((mixed(f64::NEG_INFINITY, 0.25) - 0.75f64.ln()).abs() < 1e-12);
    }
}
