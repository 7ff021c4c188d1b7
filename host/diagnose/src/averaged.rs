//! Intervals averaged over all plausible models: the final model, the members of its classes, the models without one of its
//! effects, and those with one effect more (theory, eq. 66).
//!
//! Every such model is fitted, and its posterior has the weight evidence times prior of the search (Bayesian model averaging,
//! Hoeting et al. 1999, Statistical Science 14:382). So no interval jumps when an effect passes the threshold of a name. The
//! reported value is that of the final model, whose effects are in the model file; the interval is that of the mixture, extended
//! if necessary to include that value.

use super::choice::Beside;
use super::evidence::Patterns;
use super::found::{Candidate, Found, Standing};
use super::foundation::VARIED;
use super::layout::NORMAL_975;
use super::on_springs::OnSprings;
use super::posterior::Fitted;
use super::weights::{NO_WEIGHT, limit_refused};
use formats::model_file::Alternative;
use mechanics::effects::Effect;
use mechanics::unknowns::tissue;
use rayon::prelude::*;
use readings::FitError;
use statrs::distribution::{ContinuousCDF, Normal};

/// Logarithm of the relative weight above which the intervals of a model are integrated over the sizes of the discrepancy.
const HEAVY: f64 = -5.0;
/// Number of bisections: enough for the precision of the numbers.
const BISECTIONS: usize = 80;

/// Smallest probability of a model in a model file, and largest number of such models: every one of them costs a prediction.
const MIN_PROBABILITY: f64 = 0.02;
const MAX_ALTERNATIVES: usize = 4;

/// Fits that the data leave in question, with their weights.
pub(super) struct Averaged {
    fits: Vec<(f64, Fitted)>,
    /// The final fit.
    own: Fitted,
    /// Greatest depth of tissue that the runs have reached, m.
    touched_m: f64,
}

impl Averaged {
    /// The final fit, integrated over the sizes of its discrepancy, and all other plausible fits of the search. The final fit
    /// is that with the named effects, or the start if none is named.
    pub fn over<'a>(
        own: &Fitted,
        found: &'a Found,
        is_named: bool,
        patterns: &Patterns,
        touched_m: f64,
    ) -> Self {
        let prior = &found.prior;
        let most = prior.ln_weight(own);
        let mut weighted_fits: Vec<(f64, &'a Fitted)> = Vec::new();
        let members = if is_named { found.members.as_slice() } else { &[] };
        let class = members.iter().flat_map(|member| {
            let named = found.fitted.layout.effects.get(member.index).map(|effect| effect.id());
            // Odds within the class also depend on the held-out data.
            let own_odds = member.class.iter().find(|one| Some(one.effect.id()) == named);
            let own_odds = own_odds.map(|one| one.ln_odds);
            let class_members = member
                .class
                .iter()
                .filter(move |one| Some(one.effect.id()) != named)
                // The modulus of the other foundation is another quantity.
                .filter(|one| one.fitted.layout.support.is_body() == own.layout.support.is_body());
            class_members.map(move |one| (own_odds.map(|own| one.ln_odds - own), &one.fitted))
        });
        weighted_fits.extend(class.map(|(over_own, fit)| {
            (over_own.map_or_else(|| prior.ln_weight(fit), |over_own| most + over_own), fit)
        }));
        weighted_fits
            .extend(members.iter().map(|member| (prior.ln_weight(&member.without), &member.without)));
        // If two or more effects were added, models with a single effect are far behind.
        let first = if members.len() > 1 { &[] } else { found.first.as_slice() };
        let last = if is_named { found.last.as_slice() } else { &[] };
        let unused = first.iter().chain(last).filter_map(|candidate: &'a Candidate| {
            let (fit, _) = candidate.refit.as_ref()?;
            let is_in_range = !fit.at_bound.contains(&true);
            let seen_fits = weighted_fits.iter().map(|(_, known)| *known).chain([own]);
            let is_new = !seen_fits.into_iter().any(|seen| seen.layout.has_effects_of(&fit.layout));
            // The held-out data may have lowered its odds.
            let lost = candidate.gain() + prior.ln_odds(candidate.score.effect) - candidate.ln_odds;
            (is_in_range && is_new).then(|| (prior.ln_weight(fit) - lost.max(0.0), fit, candidate.standing))
        });
        let mut unused: Vec<_> = unused.collect();
        for standing in [Standing::Refused, Standing::Refuted] {
            let of_standing = unused.iter_mut().filter(|(_, _, of)| *of == standing);
            limit_refused(of_standing.map(|(ln, _, _)| ln), most + standing.most_ln_odds());
        }
        weighted_fits.extend(unused.into_iter().map(|(ln, fit, _)| (ln, fit)));
        // A law that describes the misfit only in part is refused as a name, and has even odds like all refused models.
        weighted_fits.extend(found.described.iter().map(|fit| (most, fit)));
        let largest = weighted_fits.iter().map(|(ln, _)| *ln).fold(most, f64::max);
        weighted_fits.retain(|(ln, _)| *ln > largest + NO_WEIGHT);
        let mut fits: Vec<_> = weighted_fits
            .into_par_iter()
            .map(|(ln, fit)| {
                let is_heavy = ln > largest + HEAVY;
                let fit = if is_heavy { fit.clone().over_sizes(patterns) } else { fit.clone() };
                ((ln - largest).exp(), fit)
            })
            .collect();
        if most > largest + NO_WEIGHT {
            fits.insert(0, ((most - largest).exp(), own.clone()));
        }
        Self { fits, own: own.clone(), touched_m }
    }

    /// The same models, fitted to other runs of the session.
    ///
    /// # Errors
    /// Where one of them does not fit these.
    pub fn refitted(
        &self,
        own: &Fitted,
        patterns: &Patterns,
        refit: impl Fn(&Fitted) -> Result<Fitted, FitError> + Sync,
    ) -> Result<Self, FitError> {
        let largest = self.fits.iter().map(|(weight, _)| *weight).fold(f64::MIN_POSITIVE, f64::max);
        let again = |(weight, fit): &(f64, Fitted)| {
            if fit.values() == self.own.values() {
                return Ok((*weight, own.clone()));
            }
            let fit = refit(fit)?;
            let is_heavy = (weight / largest).ln() > HEAVY;
            Ok((*weight, if is_heavy { fit.over_sizes(patterns) } else { fit }))
        };
        let fits = self.fits.par_iter().map(again).collect::<Result<_, FitError>>()?;
        Ok(Self { fits, own: own.clone(), touched_m: self.touched_m })
    }

    /// The fits with their weights.
    pub fn fits(&self) -> &[(f64, Fitted)] {
        &self.fits
    }

    /// The final fit.
    pub fn own(&self) -> &Fitted {
        &self.own
    }

    /// Greatest depth of tissue that the runs have reached, m.
    pub fn touched_m(&self) -> f64 {
        self.touched_m
    }

    /// The most probable models other than the final one, each once, with their probabilities, for a model file.
    pub fn alternatives(&self) -> Vec<Alternative> {
        let total: f64 = self.fits.iter().map(|(weight, _)| weight).sum();
        let mut other_fits: Vec<(f64, &Fitted)> = Vec::new();
        for (weight, fit) in &self.fits {
            let fraction = weight / total;
            match other_fits.iter_mut().find(|(_, known)| known.layout.has_effects_of(&fit.layout)) {
                Some((known, _)) => *known += fraction,
                None => other_fits.push((fraction, fit)),
            }
        }
        other_fits
            .retain(|(share, fit)| *share > MIN_PROBABILITY && !fit.layout.has_effects_of(&self.own.layout));
        other_fits.sort_by(|a, b| b.0.total_cmp(&a.0));
        other_fits.truncate(MAX_ALTERNATIVES);
        other_fits
            .into_iter()
            .map(|(probability, fit)| Alternative { probability, model: fit.model() })
            .collect()
    }

    /// [`Self::interval`], extended to include the value of the final fit.
    fn holding_own(&self, of: impl Fn(&Fitted) -> Option<(f64, f64)>) -> Option<[f64; 2]> {
        let value = of(&self.own).map(|(value, _)| value);
        let ends = self.interval(of)?;
        Some(value.map_or(ends, |value| holding(ends, value)))
    }

    /// 95 % interval of a quantity. `of` returns its value and standard deviation in a fit, or `None`.
    fn interval(&self, of: impl Fn(&Fitted) -> Option<(f64, f64)>) -> Option<[f64; 2]> {
        let weighted_moments: Vec<(f64, f64, f64)> = self
            .fits
            .iter()
            .filter_map(|(weight, fit)| of(fit).map(|(value, sd)| (*weight, value, sd)))
            .collect();
        interval(&weighted_moments)
    }

    /// Interval of the modulus, Pa.
    pub fn modulus_pa(&self) -> Option<[f64; 2]> {
        let ends = self.interval(|fit| self.ln_modulus(fit))?;
        Some(modulus_interval_pa(ends, self.own.modulus_pa().0))
    }

    /// Logarithm of the modulus of a fit, Pa, and its standard deviation. If the final model has a uniform modulus, a modulus that
    /// varies with depth is represented by its mean over the tissue that was reached, because its value at the surface is a
    /// different quantity.
    pub fn ln_modulus(&self, fit: &Fitted) -> Option<(f64, f64)> {
        if self.counts_with_mean(fit) {
            fit.ln_mean_modulus(self.touched_m)
        } else {
            Some((*fit.values().first()?, fit.sd(0)))
        }
    }

    /// Whether a fit is represented by its mean modulus: its modulus varies with depth, and that of the final model does not.
    pub fn counts_with_mean(&self, fit: &Fitted) -> bool {
        varies(fit) && !varies(&self.own)
    }

    /// The modulus K of springs, Pa, and its interval, which includes models on the other foundation.
    pub fn k_pa(&self, on_springs: &OnSprings, beside: &[Beside]) -> (f64, Option<[f64; 2]>) {
        let chosen_fits = self.fits.iter().map(|(weight, fit)| (*weight, fit));
        let total: f64 = self.fits.iter().map(|(weight, _)| weight).sum();
        let other_fits = beside.iter().map(|other| (total * other.ln_odds.exp(), &other.fitted));
        let weighted_moments: Vec<(f64, f64, f64)> = chosen_fits
            .chain(other_fits)
            .filter_map(|(weight, fit)| {
                let (ln, sd) = self.ln_modulus(on_springs.stating_k_of(fit))?;
                Some((weight, ln, sd))
            })
            .collect();
        let (value_pa, _) = on_springs.stating_k_of(&self.own).modulus_pa();
        let ends = interval(&weighted_moments);
        (value_pa, ends.map(|ends| modulus_interval_pa(ends, value_pa)))
    }

    /// Interval of the mean modulus down to the greatest depth that was reached, Pa.
    pub fn mean_modulus_pa(&self) -> Option<[f64; 2]> {
        self.holding_own(|fit| fit.ln_mean_modulus(self.touched_m)).map(|ends| ends.map(in_range_pa))
    }

    /// Interval of the tip load, N.
    pub fn tip_load_n(&self) -> Option<[f64; 2]> {
        self.holding_own(|fit| fit.layout.tip_load_n(fit.values(), &fit.covariance))
    }

    /// Interval of the ratio of the modulus to that of the reference.
    pub fn ratio(&self) -> Option<[f64; 2]> {
        let ends = self.holding_own(|fit| {
            let ratio_parameter = fit.layout.ratio()?;
            Some((*fit.values().get(ratio_parameter)?, fit.sd(ratio_parameter)))
        });
        ends.map(|ends| ends.map(f64::exp))
    }

    /// Interval of a parameter of an effect, in its own unit, over all fits with the effect; `None` if no fit has it.
    pub fn parameter(&self, effect: &dyn Effect, number: usize) -> Option<[f64; 2]> {
        let mut having = self.fits.iter().filter_map(|(_, fit)| Some((fit, fit.layout.index_of(effect)?)));
        let (first, first_parameter) = having.next()?;
        if having.next().is_none() {
            return Some(first.estimate(first_parameter, number).1);
        }
        self.holding_own(|fit| {
            let (value, [low, high]) = fit.estimate(fit.layout.index_of(effect)?, number);
            Some((value, (high - low) / (2.0 * NORMAL_975)))
        })
    }
}

/// Whether the modulus of a model varies with depth.
fn varies(fit: &Fitted) -> bool {
    fit.layout.effects.iter().any(|effect| VARIED.contains(&effect.id()))
}

/// A modulus from its logarithm, clipped to the range in the table of unknowns.
fn in_range_pa(ln: f64) -> f64 {
    let [least_pa, most_pa] = tissue::MODULUS.range;
    ln.exp().clamp(least_pa, most_pa)
}

/// Interval of a modulus, Pa, from the ends of its logarithm: they are clipped to the range in the table of unknowns, outside which no fit
/// looks for a modulus, and extended to include the reported value.
pub fn modulus_interval_pa(ln_ends: [f64; 2], value_pa: f64) -> [f64; 2] {
    holding(ln_ends.map(in_range_pa), value_pa)
}

/// An interval extended to include the reported value, which it may miss because other models together can have more weight than the
/// reported one.
fn holding([low, high]: [f64; 2], value: f64) -> [f64; 2] {
    [low.min(value), high.max(value)]
}

/// 95 % interval of a mixture of normal distributions, each given by weight, mean and standard deviation; `None` for an empty mixture,
/// or if a standard deviation is invalid.
pub fn interval(parts: &[(f64, f64, f64)]) -> Option<[f64; 2]> {
    if let [(_, value, sd)] = parts {
        return Some([value - NORMAL_975 * sd, value + NORMAL_975 * sd]);
    }
    let total: f64 = parts.iter().map(|(weight, ..)| weight).sum();
    let normals: Option<Vec<(f64, Normal)>> = parts
        .iter()
        .map(|(weight, value, sd)| Some((weight / total, Normal::new(*value, *sd).ok()?)))
        .collect();
    let normals = normals.filter(|normals| !normals.is_empty())?;
    // The quantile of a mixture lies between those of its parts.
    Some([0.025, 0.975].map(|p| {
        let ends = normals.iter().map(|(_, normal)| normal.inverse_cdf(p));
        let (mut low, mut high) =
            ends.fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), q| (l.min(q), h.max(q)));
        for _ in 0..BISECTIONS {
            let middle = 0.5 * (low + high);
            let mass_below: f64 = normals.iter().map(|(weight, normal)| weight * normal.cdf(middle)).sum();
            if mass_below < p { low = middle } else { high = middle }
        }
        0.5 * (low + high)
    }))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::found::{Explanation, Found, Member};
    use crate::weights::ModelPrior;
    use crate::{found_in, tests::truth};
    use worlds::Design;

    /// Two results of the same session: the best effect is named in one and not in the other.
    #[test]
    fn no_interval_jumps_where_an_effect_gets_its_name() {
        let session = worlds::session(&truth(vec![("tissue.skin", vec![0.25])]), &Design::four_runs(), 3);
        let (start, search_result) = found_in(&session);
        let best = search_result
            .first
            .iter()
            .find(|candidate| candidate.standing == Standing::Possible)
            .expect("a candidate");
        let (fitted, gain) = best.refit.clone().expect("a fit");
        // The number of names is such that the models with and without the effect are equally likely.
        let count = gain.exp().round() as usize;
        let prior = ModelPrior::new(count, count);
        let class =
            vec![Explanation { effect: best.score.effect, fitted: fitted.clone(), ln_odds: best.ln_odds }];
        let member = Member {
            index: 0,
            gain,
            ln_odds: best.ln_odds,
            without: start.fitted.clone(),
            class,
            is_needless_elsewhere: false,
        };
        let below_threshold =
            Found { fitted: start.fitted.clone(), members: Vec::new(), prior, ..search_result.clone() };
        let above_threshold =
            Found { fitted: fitted.clone(), members: vec![member], ..below_threshold.clone() };
        let [below_interval, above_interval] =
            [(below_threshold, false), (above_threshold, true)].map(|(search_result, is_named)| {
                let own_fit = search_result.fitted.clone().over_sizes(&start.patterns);
                let averaged = Averaged::over(&own_fit, &search_result, is_named, &start.patterns, 0.03);
                let alternatives = averaged.alternatives();
                let opposite = alternatives.iter().find(|other| other.model.effects.is_empty() == is_named);
                let expected_fraction = opposite.expect("the model without the name, or with it").probability;
                let own_share = 1.0 - alternatives.iter().map(|opposite| opposite.probability).sum::<f64>();
                assert!(
                    (expected_fraction / own_share - 1.0).abs() < 0.2,
                    "{expected_fraction} beside {own_share}"
                );
                averaged.modulus_pa().expect("an interval")
            });
        for (below_interval, above_interval) in below_interval.iter().zip(above_interval) {
            assert!(
                (below_interval / above_interval - 1.0).abs() < 1e-3,
                "{below_interval} {above_interval}"
            );
        }
        // Both models are in it.
        for fit in [&start.fitted, &fitted] {
            let (value_pa, _) = fit.modulus_pa();
            assert!(
                (below_interval[0]..=below_interval[1]).contains(&value_pa),
                "{value_pa} in {below_interval:?}"
            );
        }
    }

    #[test]
    fn the_interval_of_a_mixture_holds_as_much_as_it_states() {
        let alone = interval(&[(0.3, 2.0, 0.5)]).expect("an interval");
        assert_eq!(alone, [2.0 - 0.5 * NORMAL_975, 2.0 + 0.5 * NORMAL_975]);
        // Two parts that agree are one.
        let [low, high] = interval(&[(1.0, 2.0, 0.5), (3.0, 2.0, 0.5)]).expect("an interval");
        assert!((low - alone[0]).abs() < 1e-9 && (high - alone[1]).abs() < 1e-9, "{low} {high}");
        // If two parts of equal weight are far apart, each end leaves 5 % of its own part outside.
        let [low, high] = interval(&[(1.0, -10.0, 1.0), (1.0, 10.0, 1.0)]).expect("an interval");
        let one_in_twenty = 1.644_853_626_951;
        assert!((low + 10.0 + one_in_twenty).abs() < 1e-6 && (high - 10.0 - one_in_twenty).abs() < 1e-6);
        // A part of negligible weight changes nothing.
        let [low, high] = interval(&[(1.0, 2.0, 0.5), (1e-9, 90.0, 0.5)]).expect("an interval");
        assert!((low - alone[0]).abs() < 1e-6 && (high - alone[1]).abs() < 1e-6, "{low} {high}");
    }
}
