//! Assembly of the result of a diagnosis from the results of its steps.

use super::Multiples;
use super::adequacy::{Adequacy, Region};
use super::averaged::Averaged;
use super::choice::Beside;
use super::data::{Channel, Kind, Run};
use super::draws::Sources;
use super::evidence::Patterns;
use super::found::{Candidate, Found, Member, Standing};
use super::layout::Prepared;
use super::noise::Noise;
use super::on_springs::OnSprings;
use super::posterior::Fitted;
use super::prospects::{Known, Prospects};
use super::results::{
    AdequacyResult, Diagnosis, Estimate, FoundEffect, FoundationResult, HeldOutMisfit, MeanModulus,
    ModulusStatus, Ranked, ReferenceResult, RegionResult, RemainingResult, SCHEMA, Verdict,
};
use super::weights::{ln_sum, stated_ln_odds};
use super::{Options, next};
use formats::model_file::{LearnedEffect, ModelFile};
use formats::session::Session;
use mechanics::effects::effect;
use mechanics::{Experiment, Profile, Support};
use readings::FitError;
use std::collections::{BTreeMap, BTreeSet};

/// Largest number of unnamed effects that are reported.
const PARTIAL: usize = 3;

/// Parts of the result.
pub(super) struct DiagnosisReport<'a> {
    pub session: &'a Session,
    pub options: &'a Options,
    pub all: &'a [Run],
    pub start: &'a Fitted,
    pub found: &'a Found,
    pub final_fit: &'a Fitted,
    /// All plausible fits.
    pub averaged: Averaged,
    /// Models on the other foundation, most probable first.
    pub other_foundation: Vec<Beside>,
    /// K of the models of a body.
    pub on_springs: OnSprings,
    /// Noise of the runs from which values are reported; the adequacy is that of the training runs, with their own noise.
    pub noise: &'a Noise,
    pub adequacy: [&'a Adequacy; 2],
    /// Adequacy of the model with the known values of the rig, if the rig has changed.
    pub disagreement: Option<&'a Adequacy>,
    pub verdict: Verdict,
    pub foundation: FoundationResult,
    pub split: String,
    /// Sizes of the discrepancy relative to an ordinary rig, where they are larger.
    pub multiples: Multiples,
    /// Number of runs with held-out parts.
    pub held_out: usize,
}

impl DiagnosisReport<'_> {
    /// The result.
    pub fn diagnosis(
        &self,
        regions: Vec<RegionResult>,
        gap: Option<HeldOutMisfit>,
        remaining: RemainingResult,
        warnings: Vec<String>,
    ) -> Diagnosis {
        let Self { verdict, final_fit, adequacy, averaged, .. } = self;
        let verdict = *verdict;
        let members = &self.found.members;
        let is_named = matches!(verdict, Verdict::Named | Verdict::Ambiguous);
        let classes = members.iter().filter(|member| member.class.len() > 1);
        let next_measurement = classes
            .filter_map(|member| next::next_measurement(&member.class, self.all, self.noise))
            .max_by(|a, b| a.expected_divergence.total_cmp(&b.expected_divergence));
        let (_, own_ci95_pa) = final_fit.modulus_pa();
        let modulus_ci95_kpa = averaged.modulus_pa().unwrap_or(own_ci95_pa).map(|end| 1e-3 * end);
        let mut foundation = self.foundation.clone();
        if let Some(youngs) = &mut foundation.youngs_modulus_kpa {
            youngs.ci95 = modulus_ci95_kpa;
        }
        let (k_pa, k_ci95_pa) = averaged.k_pa(&self.on_springs, &self.other_foundation);
        let k_kpa = 1e-3 * k_pa;
        let k_ci95_kpa = k_ci95_pa.map_or(modulus_ci95_kpa, |ends| ends.map(|end| 1e-3 * end));
        let near_margin = self.near_margin();
        let tip = final_fit.tip_load_n();
        let touched_m = averaged.touched_m();
        let mean = final_fit.ln_mean_modulus(touched_m).zip(averaged.mean_modulus_pa());
        let discrepancy =
            if verdict == Verdict::Unexplained { adequacy[0].discrepancy.as_slice() } else { &[] };
        // The ranking is that of the catalogue, without laws.
        let first: Vec<&Candidate> =
            self.found.first.iter().filter(|candidate| !candidate.score.effect.is_unnamed()).collect();
        Diagnosis {
            draws: None,
            prospects: None,
            schema: SCHEMA,
            session: self.session.name.clone(),
            verdict,
            effects: if is_named {
                members.iter().map(|m| self.effect(m, averaged)).collect()
            } else {
                Vec::new()
            },
            regions,
            left: Vec::new(),
            next_measurement,
            gap,
            ranking: first
                .iter()
                .map(|candidate| Ranked {
                    id: candidate.id().to_owned(),
                    score_chi2: candidate.score.chi_square,
                    log_evidence_gain: candidate
                        .refit
                        .as_ref()
                        .map_or(candidate.score.log_evidence, |(_, gain)| *gain),
                    refitted: candidate.refit.is_some(),
                })
                .collect(),
            model_file: None,
            foundation,
            walls: None,
            reference: self.reference(averaged),
            k_kpa,
            k_ci95_kpa,
            k_status: self.modulus_status(),
            mean_modulus: mean.map(|((ln_pa, _), ends_pa)| MeanModulus {
                to_depth_mm: 1e3 * touched_m,
                modulus_kpa: Estimate { value: 1e-3 * ln_pa.exp(), ci95: ends_pa.map(|end| 1e-3 * end) },
            }),
            tip_load_n: tip.map(|(value, _)| value),
            tip_load_ci95_n: averaged.tip_load_n().or(tip.map(|(_, ends)| ends)),
            given: self.options.given.iter().map(|(effect, _)| effect.id().to_owned()).collect(),
            given_effects: self.given_effects(final_fit),
            moved_since: Vec::new(),
            partial: self.partial(is_named),
            remaining,
            multiples: self.multiples.clone(),
            alternatives: averaged.alternatives(),
            adequacy: [self.disagreement.unwrap_or(adequacy[0]), adequacy[1]].map(adequacy_result),
            discrepancy: discrepancy
                .iter()
                .map(|(channel, sd)| {
                    (format!("{}_{}", channel.name(), channel.unit().to_lowercase()), channel.per_si() * sd)
                })
                .collect(),
            margin: self.found.prior.needed(),
            split: self.split.clone(),
            noise: self.noise_result(),
            near_margin: near_margin.iter().map(|candidate| candidate.id().to_owned()).collect(),
            not_identifiable: first
                .iter()
                .filter(|candidate| !candidate.score.is_identifiable)
                .map(|candidate| candidate.id().to_owned())
                .collect(),
            limits: self.limits(&near_margin),
            warnings,
        }
    }

    /// Sources of the draws.
    pub fn sources<'a>(&'a self, runs: &'a [Prepared], patterns: &'a Patterns) -> Sources<'a> {
        let Self { averaged, on_springs, .. } = self;
        Sources { averaged, beside: &self.other_foundation, on_springs, runs, patterns }
    }

    /// Expected information of the planned runs of the options.
    ///
    /// # Errors
    /// Where the model cannot be evaluated.
    pub fn foreseen(&self, runs: &[Prepared], patterns: &Patterns) -> Result<Prospects, FitError> {
        let (averaged, noise, multiples) = (&self.averaged, self.noise, &self.multiples);
        Known { averaged, runs, patterns, noise, multiples }.prospects(&self.options.plans)
    }

    /// Difference of the session from its reference.
    fn reference(&self, averaged: &Averaged) -> Option<ReferenceResult> {
        let reference = self.options.reference.as_ref()?;
        let [(ratio, ratio_ci95), (pa, pa_ci95)] = self.final_fit.beside_reference()?;
        Some(ReferenceResult {
            session: reference.name.clone(),
            modulus_kpa: Estimate { value: 1e-3 * pa, ci95: pa_ci95.map(|end| 1e-3 * end) },
            modulus_ratio: Estimate { value: ratio, ci95: averaged.ratio().unwrap_or(ratio_ci95) },
        })
    }

    fn effect(&self, member: &Member, averaged: &Averaged) -> FoundEffect {
        let fitted = self.final_fit;
        let effect = fitted.layout.effects[member.index];
        let parameters = effect.parameters().iter().enumerate().map(|(number, info)| {
            let (value, own_ci95) = fitted.estimate(member.index, number);
            let ci95 = averaged.parameter(effect, number).unwrap_or(own_ci95);
            (info.name.to_owned(), Estimate { value, ci95 })
        });
        FoundEffect {
            id: effect.id().to_owned(),
            parameters: parameters.collect(),
            log_evidence_gain: member.gain,
            probability: probability(member.ln_odds),
            class: member.class.iter().map(|one| one.effect.id().to_owned()).collect(),
            class_probability: member
                .class
                .iter()
                .map(|one| (one.ln_odds - ln_sum([0.0, member.ln_odds].into_iter())).exp())
                .collect(),
            formula: effect.as_law().map(|law| {
                let values =
                    (0..effect.parameters().len()).map(|number| fitted.estimate(member.index, number).0);
                law.formula(&values.collect::<Vec<_>>())
            }),
        }
    }

    /// Effects that improve the fit without explaining the misfit: laws that describe a part of it; if there are none and nothing is named,
    /// the effects that the search added, or else its leaders.
    fn partial(&self, is_named: bool) -> Vec<String> {
        let described: Vec<String> = self.found.descriptions().map(|effect| effect.id().to_owned()).collect();
        if is_named || !described.is_empty() {
            return described;
        }
        let members = &self.found.members;
        if !members.is_empty() {
            let effects = &self.found.fitted.layout.effects;
            return members.iter().map(|member| effects[member.index].id().to_owned()).collect();
        }
        let strong = self.found.first.iter().filter(|candidate| candidate.ln_odds > stated_ln_odds());
        strong.take(PARTIAL).map(|candidate| candidate.id().to_owned()).collect()
    }

    /// The effects of the starting model as the final fit has them.
    fn given_effects(&self, final_fit: &Fitted) -> Vec<FoundEffect> {
        let given_effects = self.options.given.iter().enumerate().map(|(index, (effect, _))| {
            let parameters = effect.parameters().iter().enumerate().map(|(number, info)| {
                let (value, ci95) = final_fit.estimate(index, number);
                (info.name.to_owned(), Estimate { value, ci95 })
            });
            FoundEffect {
                id: effect.id().to_owned(),
                parameters: parameters.collect(),
                log_evidence_gain: f64::NAN,
                probability: 1.0,
                class: vec![effect.id().to_owned()],
                class_probability: vec![1.0],
                formula: None,
            }
        });
        given_effects.collect()
    }

    fn noise_result(&self) -> BTreeMap<String, f64> {
        let [lateral, insertion] = self.start.layout.kinds;
        let noise = self.noise;
        let mut sds = BTreeMap::new();
        if lateral {
            sds.insert("force_n".to_owned(), noise.force.reading_sd());
            sds.insert("displacement_mm".to_owned(), 1e3 * noise.displacement.reading_sd());
            sds.insert("shape_mm".to_owned(), 1e3 * noise.shape.sd());
        }
        if insertion {
            sds.insert("tip_mm".to_owned(), 1e3 * noise.tip.sd());
            let directions = [Channel::TipDirectionY, Channel::TipDirectionX];
            if self.all.iter().flat_map(|run| &run.data).any(|datum| directions.contains(&datum.channel)) {
                sds.insert("tip_direction_mrad".to_owned(), 1e3 * noise.direction.sd());
            }
        }
        sds
    }

    /// Effects with a probability between 5 and 95 %, best first.
    fn near_margin(&self) -> Vec<&Candidate> {
        let candidates = match self.verdict {
            Verdict::Adequate | Verdict::Unexplained => &self.found.first,
            Verdict::Named | Verdict::Ambiguous => &self.found.last,
        };
        // A candidate with a probability below 5 % is not reported.
        let near_margin = candidates.iter().filter(|candidate| {
            candidate.standing == Standing::Possible && candidate.ln_odds.abs() <= stated_ln_odds()
        });
        near_margin.take(PARTIAL).collect()
    }

    /// Text of a model on the other foundation that explains the runs about as well.
    fn on_other_foundation(&self) -> Option<String> {
        let other_foundation =
            self.other_foundation.first().filter(|other| other.ln_odds > -stated_ln_odds())?;
        let layout = &other_foundation.fitted.layout;
        let added: Vec<&str> = layout.effects.iter().skip(layout.given).map(|effect| effect.id()).collect();
        let effects_text =
            if added.is_empty() { String::new() } else { format!(" with {}", added.join(", ")) };
        let (chosen_name, other_name) = if layout.support.is_body() {
            ("an elastic body", "springs")
        } else {
            ("springs", "an elastic body")
        };
        Some(format!(
            "{chosen_name}{effects_text} in place of {other_name}: this would explain these runs too (log odds {:+.2}); the interval of K includes both; runs at other \
             depths would decide",
            other_foundation.ln_odds
        ))
    }

    /// Whether the runs identify the modulus: a load or displacement of known size acts on the needle, and the modulus is not at an end of
    /// its range.
    fn modulus_status(&self) -> ModulusStatus {
        if self.has_unknown_size() || self.is_modulus_at_bound() {
            ModulusStatus::NotIdentified
        } else {
            ModulusStatus::Identified
        }
    }

    /// Whether no load or displacement of known size acts on the needle.
    fn has_unknown_size(&self) -> bool {
        self.session.rig.rear_is_unknown() && self.all.iter().all(guide2_rests)
    }

    /// Whether the modulus of the fit is at an end of its range, so that the runs do not show the tissue's stiffness.
    fn is_modulus_at_bound(&self) -> bool {
        self.final_fit.at_bound.first() == Some(&true)
    }

    /// Limits of this session, and measurements that would remove them.
    fn limits(&self, near_margin: &[&Candidate]) -> Vec<String> {
        let lateral: Vec<&Run> = self.all.iter().filter(|run| run.kind == Kind::Lateral).collect();
        let mut limits = Vec::new();
        for candidate in near_margin {
            limits.push(format!(
                "{}: log evidence {:+.2}, probability {:.2}: not named, but the intervals of K and of the tip load include the model with it; \
                 another run of each kind would decide",
                candidate.id(),
                candidate.gain(),
                // Rounded down, so that a probability just below the threshold of a name is not printed as the threshold.
                (100.0 * probability(candidate.ln_odds)).floor() / 100.0
            ));
        }
        limits.extend(self.on_other_foundation());
        if self.held_out == 0 {
            limits.push(
                "nothing could be held out, so nothing is named: repeat the run, or take a staircase with several holds".to_owned(),
            );
        } else if lateral.len() == 1 && self.held_out == 1 {
            limits.push(
                "there is one lateral run: holds of it were held out; a repeat would be a better proof"
                    .to_owned(),
            );
        }
        if self.is_modulus_at_bound() {
            limits.push(
                "the modulus that fits best is at an end of its range: the model lacks an effect that the runs show, and without it K \
                 and E are not identifiable"
                    .to_owned(),
            );
        }
        if self.has_unknown_size() {
            limits.push(
                "guide 2 rests in all insertions and the stiffness of the needle's rear is not known: K and E are not identifiable, their \
                 intervals depend on what was assumed beforehand; move guide 2 on the way"
                    .to_owned(),
            );
        }
        if !lateral.is_empty() {
            let depths_mm = lateral.iter().map(|run| (run.depth_m / 1e-3).round() as i64);
            if depths_mm.collect::<BTreeSet<i64>>().len() == 1 {
                limits.push("all lateral runs are at one depth: what varies with depth is hard to identify; take two more depths".to_owned());
            }
            if lateral.iter().all(|run| run.axis == lateral[0].axis) {
                limits.push("all lateral runs are along one axis: anisotropy and crosstalk need a run along the other".to_owned());
            }
            let levels = lateral.iter().flat_map(|run| &run.data).filter(|d| d.place.hold_s.is_some());
            let mut levels: Vec<i64> =
                levels.map(|d| (d.place.level_m / 0.1e-3).round() as i64).filter(|l| *l != 0).collect();
            levels.sort_unstable();
            levels.dedup();
            if levels.len() < 2 {
                limits.push("there is one level: stiffening, backlash and offsets need several, on both sides of zero".to_owned());
            }
        }
        limits
    }
}

/// Probability from log odds.
pub(super) fn probability(ln_odds: f64) -> f64 {
    (1.0 + (-ln_odds).exp()).recip()
}

/// Whether a run is an insertion in which guide 2 does not move.
fn guide2_rests(run: &Run) -> bool {
    match &run.experiment {
        Experiment::Insertion(done) => done.guide2_m.iter().flatten().all(Profile::is_constant),
        _ => false,
    }
}

impl Diagnosis {
    /// The model with the added effects, for a file.
    pub fn model(&self) -> ModelFile {
        let effects = self.given_effects.iter().chain(&self.effects);
        // A modulus that is not identified is not part of the model.
        let is_identified = self.k_status == ModulusStatus::Identified;
        let youngs = self.foundation.youngs_modulus_kpa.filter(|_| is_identified);
        ModelFile {
            learned_from: self.session.clone(),
            modulus_pa: is_identified.then_some(1e3 * self.k_kpa),
            modulus_ci95_pa: is_identified.then_some(self.k_ci95_kpa.map(|kpa| 1e3 * kpa)),
            support: self.foundation.poisson.filter(|_| is_identified).map(Support::half_space),
            youngs_pa: youngs.map(|found| 1e3 * found.value),
            youngs_ci95_pa: youngs.map(|found| found.ci95.map(|kpa| 1e3 * kpa)),
            tip_load_n: self.tip_load_n,
            tip_load_ci95_n: self.tip_load_ci95_n,
            discrepancy: self.multiples.clone(),
            alternatives: self.alternatives.clone(),
            effects: effects
                .filter_map(|found| {
                    let effect = effect(&found.id)?;
                    let estimates: Vec<&Estimate> = effect
                        .parameters()
                        .iter()
                        .filter_map(|info| found.parameters.get(info.name))
                        .collect();
                    Some(LearnedEffect {
                        effect,
                        values: estimates.iter().map(|estimate| estimate.value).collect(),
                        ci95: estimates.iter().map(|estimate| Some(estimate.ci95)).collect(),
                        log_evidence_gain: Some(found.log_evidence_gain).filter(|gain| gain.is_finite()),
                    })
                })
                .collect(),
        }
    }
}

pub(super) fn region(region: &Region) -> RegionResult {
    RegionResult {
        channel: region.channel.name().to_owned(),
        coordinate: region.coordinate.to_owned(),
        from: region.from,
        to: region.to,
        mean_residual: region.channel.per_si() * region.mean,
        changes_sign_with_level: region.is_odd,
        unit: region.channel.unit().to_owned(),
        sigma: region.sigma.abs(),
    }
}

fn adequacy_result(adequacy: &Adequacy) -> AdequacyResult {
    let channels = adequacy.channels.iter();
    AdequacyResult {
        chi_square: adequacy.noise.chi_square,
        functions: adequacy.noise.functions,
        p: adequacy.noise.p,
        p_beside_everyday_discrepancy: adequacy.everyday.p,
        channels: channels.map(|(channel, sum, n)| (channel.name().to_owned(), sum / *n as f64)).collect(),
    }
}
