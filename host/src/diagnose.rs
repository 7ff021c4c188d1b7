//! The discrepancy workflow: where model and measurement disagree, which effect is missing, and what adding it is worth.
//!
//! | step | file |
//! |---|---|
//! | runs as numbers with their places | `data` |
//! | split: what is learned from, what judges | `split` |
//! | noise, and residuals made independent | `noise`, `whiten` |
//! | fit: the forward model with what is unknown | `believed` |
//! | where it disagrees, and whether at all | `adequacy` |
//! | score every effect, margin by bootstrap | `score` |
//! | refit, accept, add, repeat; rivals | `search` |
//! | what would tell rivals apart | `next` |
//! | before and after on what was held out | `split` |
//!
//! Related: Kennedy and O'Hagan's model discrepancy, nested-model comparison by evidence, efficient score tests, scan statistics,
//! optimal discriminating designs. What is added is the loop, with names, abstention and a proof on runs that nothing has seen.

mod adequacy;
mod believed;
pub mod blind;
mod data;
mod next;
mod noise;
mod results;
mod score;
mod search;
mod split;
pub mod study;
mod whiten;

pub use data::Channel;
pub use results::{
    AdequacyResult, Diagnosis, Estimate, FoundEffect, Gap, GapSide, NextMeasurement, Ranked, RegionResult,
    ResidualPoint, Verdict,
};

use crate::inference::FitError;
use crate::model::effects::{Effect, effect};
use crate::model::{Channels, ModelError, predict};
use crate::model_file::{LearnedEffect, ModelFile};
use crate::session::Session;
use adequacy::{Adequacy, Region, regions};
use believed::{Fitted, Layout, Prepared, Scale};
use data::{Kind, Run};
use noise::Noise;
use search::{Found, Member, search};
use split::{HeldOut, Training, split};
use std::collections::BTreeMap;
use std::path::PathBuf;
use whiten::Whitener;

/// What the user may choose.
#[derive(Debug, Clone)]
pub struct Options {
    /// Effects of the model to start from, with first values of their parameters.
    pub given: Vec<(&'static dyn Effect, Vec<f64>)>,
    /// Seed of the bootstraps.
    pub seed: u64,
}

impl Default for Options {
    fn default() -> Self {
        Self { given: Vec::new(), seed: 1 }
    }
}

/// Why a session cannot be diagnosed.
#[derive(Debug, thiserror::Error)]
pub enum DiagnoseError {
    /// It has nothing to diagnose.
    #[error("{}: lateral, insertion: missing, expected at least one [[lateral]] or [[insertion]]", path.display())]
    NoRuns {
        /// The session file.
        path: PathBuf,
    },
    /// None of its runs can be used.
    #[error("no run can be used: {}", reasons.join("; "))]
    AllFailed {
        /// Reason of each run.
        reasons: Vec<String>,
    },
    /// The model cannot be evaluated.
    #[error(transparent)]
    Model(#[from] ModelError),
    /// The starting model does not fit in any way.
    #[error("the model cannot be fitted: {0}")]
    Fit(#[from] FitError),
}

/// Beside others an effect with more rivals than this is no name.
const MOST_IN_CLASS: usize = 3;

/// Diagnoses a session; `tell` hears what goes on.
///
/// # Errors
/// [`DiagnoseError`] where nothing can be said at all.
pub fn diagnose(
    session: &Session,
    options: &Options,
    mut tell: impl FnMut(&str),
) -> Result<Diagnosis, DiagnoseError> {
    let (runs, warnings) = runs_of(session)?;
    let all: Vec<Run> = runs.clone();
    let (Training { runs, rule }, held_out) = split(runs);
    tell(&rule);
    let noise = Noise::of(&runs, &session.noise);
    let layout = Layout {
        rig: session.rig.clone(),
        kinds: [Kind::Lateral, Kind::Insertion].map(|kind| runs.iter().any(|run| run.kind == kind)),
        effects: options.given.iter().map(|(effect, _)| *effect).collect(),
        cache: Default::default(),
    };
    let (prepared, start) = fit_start(&layout, &runs, &noise, &options.given)?;
    let before = Adequacy::of(&start, &prepared)?;
    let where_before = regions(&start, &prepared)?;
    tell(&format!("{} effects are scored", crate::model::effects::EFFECTS.len() - layout.effects.len()));
    let found = search(&start, &prepared, options.seed, &mut tell)?;
    let after = Adequacy::of(&found.fitted, &prepared)?;

    let thin = held_out.is_empty();
    let verdict = verdict(&found, &before, &after, thin);
    let is_named = matches!(verdict, Verdict::Named | Verdict::Ambiguous);
    let final_fit = if is_named { &found.fitted } else { &start };
    tell("the runs that were held out are looked at");
    let gap = held_out.gap(&start, final_fit, &noise, options.seed)?;
    let story =
        Story { session, options, all: &all, start: &start, found: &found, noise: &noise, rule, thin };
    let adequacy = [&before, &after];
    Ok(story.told(verdict, final_fit, &where_before, adequacy, gap, &held_out, warnings))
}

/// All runs that can be used, and why others cannot.
fn runs_of(session: &Session) -> Result<(Vec<Run>, Vec<String>), DiagnoseError> {
    if session.lateral.is_empty() && session.insertion.is_empty() {
        return Err(DiagnoseError::NoRuns { path: session.dir.join("session.toml") });
    }
    let lateral = session.lateral.iter().map(|run| (&run.id, Run::lateral(run, &session.rig)));
    let insertion = session.insertion.iter().map(|run| (&run.id, Run::insertion(run)));
    let (mut runs, mut warnings) = (Vec::new(), Vec::new());
    for (id, run) in lateral.chain(insertion) {
        match run {
            Ok(run) => runs.push(run),
            Err(why) => warnings.push(format!("run {id} is left out: {why}")),
        }
    }
    if runs.is_empty() { Err(DiagnoseError::AllFailed { reasons: warnings }) } else { Ok((runs, warnings)) }
}

/// Fits the starting model: twice, because what makes residuals independent needs to know about what to expect.
fn fit_start(
    layout: &Layout,
    runs: &[Run],
    noise: &Noise,
    given: &[(&'static dyn Effect, Vec<f64>)],
) -> Result<(Vec<Prepared>, Fitted), DiagnoseError> {
    let mut values = layout.first_values();
    let infos = given.iter().flat_map(|(effect, values)| effect.parameters().iter().zip(values));
    for (value, (info, given)) in values[layout.own()..].iter_mut().zip(infos) {
        *value = Scale::of(info).inside(*given);
    }
    let mut prepared = Vec::new();
    for _ in 0..2 {
        let of_run = |run: &Run| -> Result<Prepared, ModelError> {
            let model = layout.model(&values, run.kind)?;
            let expected: Channels = predict(&model, &run.experiment)?;
            Ok(Prepared { run: run.clone(), whitener: Whitener::new(run, noise, &model, &expected)? })
        };
        prepared = runs.iter().map(of_run).collect::<Result<_, _>>()?;
        values = Fitted::new(layout, &prepared, &values)?.values().to_vec();
    }
    let start = Fitted::new(layout, &prepared, &values)?;
    Ok((prepared, start))
}

fn verdict(found: &Found, before: &Adequacy, after: &Adequacy, thin: bool) -> Verdict {
    match found.members.is_empty() {
        true if before.is_adequate() => Verdict::Adequate,
        true => Verdict::Unexplained,
        // Without anything to prove it on nothing is named.
        false if thin || !after.is_adequate() || absorbs(found) => Verdict::Unexplained,
        false if found.members.iter().all(|member| member.class.len() == 1) => Verdict::Named,
        false => Verdict::Ambiguous,
    }
}

/// Whether effects were added that could be any of many: they soak up what another thing has left, and are no names. A single effect
/// of many possible ones is another matter: that is a weak one, and its class says so.
fn absorbs(found: &Found) -> bool {
    found.members.len() > 1 && found.members.iter().any(|member| member.class.len() > MOST_IN_CLASS)
}

/// What the result is made of.
struct Story<'a> {
    session: &'a Session,
    options: &'a Options,
    all: &'a [Run],
    start: &'a Fitted,
    found: &'a Found,
    noise: &'a Noise,
    rule: String,
    thin: bool,
}

impl Story<'_> {
    #[allow(clippy::too_many_arguments)]
    fn told(
        &self,
        verdict: Verdict,
        final_fit: &Fitted,
        where_before: &[Region],
        adequacy: [&Adequacy; 2],
        gap: Option<Gap>,
        held_out: &HeldOut,
        warnings: Vec<String>,
    ) -> Diagnosis {
        let members = &self.found.members;
        let is_named = matches!(verdict, Verdict::Named | Verdict::Ambiguous);
        let classes = members.iter().filter(|member| member.class.len() > 1);
        let next_measurement = classes
            .filter_map(|member| next::next_measurement(&member.class, self.all, self.noise))
            .max_by(|a, b| a.expected_divergence.total_cmp(&b.expected_divergence));
        let (k_pa, k_ci95_pa) = final_fit.modulus_pa();
        let tip = final_fit.tip_load_n();
        let discrepancy =
            if verdict == Verdict::Unexplained { adequacy[0].discrepancy.as_slice() } else { &[] };
        let first = &self.found.first;
        Diagnosis {
            schema: results::SCHEMA,
            session: self.session.name.clone(),
            verdict,
            effects: if is_named { members.iter().map(|m| self.effect(m)).collect() } else { Vec::new() },
            regions: where_before.iter().map(region).collect(),
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
            k_kpa: 1e-3 * k_pa,
            k_ci95_kpa: k_ci95_pa.map(|end| 1e-3 * end),
            tip_load_n: tip.map(|(value, _)| value),
            tip_load_ci95_n: tip.map(|(_, ends)| ends),
            given: self.options.given.iter().map(|(effect, _)| effect.id().to_owned()).collect(),
            given_effects: self.given_effects(final_fit),
            partial: if is_named {
                Vec::new()
            } else {
                members.iter().map(|member| member.effect.id().to_owned()).collect()
            },
            adequacy: adequacy.map(adequacy_result),
            discrepancy: discrepancy
                .iter()
                .map(|(channel, sd)| {
                    (format!("{}_{}", channel.name(), channel.unit().to_lowercase()), channel.per_si() * sd)
                })
                .collect(),
            margin: self.found.margin,
            split: self.rule.clone(),
            noise: self.noise_result(),
            not_told: first
                .iter()
                .filter(|candidate| !candidate.score.is_told)
                .map(|candidate| candidate.id().to_owned())
                .collect(),
            limits: self.limits(held_out),
            warnings,
        }
    }

    fn effect(&self, member: &Member) -> FoundEffect {
        let fitted = &self.found.fitted;
        let index = fitted.layout.effects.iter().position(|e| e.id() == member.effect.id()).unwrap_or(0);
        let parameters = member.effect.parameters().iter().enumerate().map(|(number, info)| {
            let (value, ci95) = fitted.estimate(index, number);
            (info.name.to_owned(), Estimate { value, ci95 })
        });
        FoundEffect {
            id: member.effect.id().to_owned(),
            parameters: parameters.collect(),
            log_evidence_gain: member.gain,
            class: member.class.iter().map(|(effect, _)| effect.id().to_owned()).collect(),
        }
    }

    /// The effects of the starting model as the final fit has them.
    fn given_effects(&self, final_fit: &Fitted) -> Vec<FoundEffect> {
        let of = |(index, (effect, _)): (usize, &(&'static dyn Effect, Vec<f64>))| {
            let parameters = effect.parameters().iter().enumerate().map(|(number, info)| {
                let (value, ci95) = final_fit.estimate(index, number);
                (info.name.to_owned(), Estimate { value, ci95 })
            });
            FoundEffect {
                id: effect.id().to_owned(),
                parameters: parameters.collect(),
                log_evidence_gain: f64::NAN,
                class: vec![effect.id().to_owned()],
            }
        };
        self.options.given.iter().enumerate().map(of).collect()
    }

    fn noise_result(&self) -> BTreeMap<String, f64> {
        let [lateral, insertion] = self.start.layout.kinds;
        let noise = self.noise;
        let mut sds = BTreeMap::new();
        if lateral {
            sds.insert("force_n".to_owned(), noise.force.sd());
            sds.insert("displacement_mm".to_owned(), 1e3 * noise.displacement.sd());
            sds.insert("shape_mm".to_owned(), 1e3 * noise.shape.sd());
        }
        if insertion {
            sds.insert("tip_mm".to_owned(), 1e3 * noise.tip.sd());
        }
        sds
    }

    /// What this session could not do, and what would.
    fn limits(&self, held_out: &HeldOut) -> Vec<String> {
        let lateral: Vec<&Run> = self.all.iter().filter(|run| run.kind == Kind::Lateral).collect();
        let mut limits = Vec::new();
        if self.thin {
            limits.push(
                "nothing could be held out, so nothing is named: repeat the run, or take a staircase with several holds".to_owned(),
            );
        } else if lateral.len() == 1 && held_out.ids().len() == 1 {
            limits.push(
                "there is one lateral run: holds of it were held out; a repeat would be a better proof"
                    .to_owned(),
            );
        }
        if !lateral.is_empty() {
            let depths = |m: &Run| (m.depth_m / 1e-3).round() as i64;
            if lateral.iter().all(|run| depths(run) == depths(lateral[0])) {
                limits.push("all lateral runs are at one depth: what varies with depth is hard to tell; take two more depths".to_owned());
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

impl Diagnosis {
    /// The model with what was added, as a file has it.
    pub fn model(&self) -> ModelFile {
        let pa = |kpa: f64| 1e3 * kpa;
        let effects = self.given_effects.iter().chain(&self.effects);
        ModelFile {
            learned_from: self.session.clone(),
            modulus_pa: Some(pa(self.k_kpa)),
            modulus_ci95_pa: Some(self.k_ci95_kpa.map(pa)),
            tip_load_n: self.tip_load_n,
            tip_load_ci95_n: self.tip_load_ci95_n,
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

fn region(region: &Region) -> RegionResult {
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
        chi_square: adequacy.chi_square,
        functions: adequacy.functions,
        p: adequacy.p,
        channels: channels.map(|(channel, sum, n)| (channel.name().to_owned(), sum / *n as f64)).collect(),
    }
}

#[cfg(test)]
mod tests;
