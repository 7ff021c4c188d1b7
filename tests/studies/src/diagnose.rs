//! The blind study: how often the workflow is right on sessions of a generator that shares nothing with the forward model.
//!
//! Effects at three strengths, sessions that lack nothing, pairs, and effects outside the catalogue. Identifiability is
//! computed, not judged by the outcome: the truth's predictions without noise take the place of the readings, and the
//! fits of all competing effects to them give the expected gain of chi-square and the expected log evidence over the
//! nearest competitor.

use formats::session::Session;
use inference::diagnose::{Diagnosis, Expected, Options, Truth as Hypothetical, Verdict, diagnose, expected};
use mechanics::effects::effect;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde::Serialize;
use std::time::Instant;
use worlds::random::uniform;
use worlds::{self as blind, Design, Foreign, Truth, strengths};

/// Hidden effects of a session.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub enum Hidden {
    /// No effect.
    Nothing,
    /// An effect at a strength, 0 to 2.
    One(&'static str, usize),
    /// Two effects of middle strength.
    Pair(&'static str, &'static str),
    /// Something the catalogue has no name for.
    Foreign(&'static str),
    /// No effect, in a session that states how the shape was imaged.
    NothingImaged,
}

/// Result of a diagnosed session.
#[derive(Debug, Clone, Serialize)]
pub struct Outcome {
    /// Hidden effects.
    pub hidden: Hidden,
    /// Seed of the session.
    pub seed: u64,
    /// The verdict.
    pub verdict: Verdict,
    /// Named effects, with their class.
    pub named: Vec<(String, Vec<String>)>,
    /// For every parameter of what was hidden and found: its id and whether the interval holds the truth.
    pub covered: Vec<(String, bool)>,
    /// Estimated parameters: parameters with their intervals.
    pub found: Vec<(String, f64, [f64; 2])>,
    /// Share of the gap removed on held-out runs, and reduced chi-square after.
    pub removed: Option<f64>,
    /// Reduced chi-square on held-out runs under the final model.
    pub chi2_after: Option<f64>,
    /// Gain of chi-square that was to be expected; of single effects.
    pub expected_gain: Option<f64>,
    /// Expected log evidence over the nearest competitor.
    pub expected_apart: Option<f64>,
    /// The nearest competitor.
    pub competitor: Option<String>,
    /// Probability of the smooth structure left, before and after.
    pub p: [f64; 2],
    /// Effects that improved the fit without explaining it.
    pub partial: Vec<String>,
    /// Log evidence of the first effect named and what the search needed.
    pub gain: Option<f64>,
    /// Margin that the search needed.
    pub margin: f64,
    /// Time on one core.
    pub seconds: f64,
}

/// Number of sessions of each kind.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Size {
    /// Sessions that lack nothing.
    pub nothing: usize,
    /// Number of sessions of every effect at every strength.
    pub one: usize,
    /// Pairs.
    pub pairs: usize,
    /// Number of sessions of every effect outside the catalogue.
    pub foreign: usize,
}

/// Sessions of a study of some size.
pub fn cases(size: Size, seed: u64) -> Vec<(Hidden, u64)> {
    let mut cases = Vec::new();
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    cases.extend((0..size.nothing).map(|_| Hidden::Nothing));
    let ids: Vec<&'static str> = blind::ids().collect();
    for id in &ids {
        for strength in 0..3 {
            cases.extend((0..size.one).map(|_| Hidden::One(id, strength)));
        }
    }
    while cases.iter().filter(|hidden| matches!(hidden, Hidden::Pair(..))).count() < size.pairs {
        let [a, b] = [0, 1].map(|_| ids[random.random_range(0..ids.len())]);
        if a < b && !is_tip(a) && !is_tip(b) {
            cases.push(Hidden::Pair(a, b));
        }
    }
    for foreign in Foreign::ALL {
        cases.extend((0..size.foreign).map(|_| Hidden::Foreign(foreign.name())));
    }
    cases.extend((0..size.nothing / 4).map(|_| Hidden::NothingImaged));
    for id in blind::imaging_ids() {
        for strength in 0..3 {
            cases.extend((0..size.one).map(|_| Hidden::One(id, strength)));
        }
    }
    cases.into_iter().map(|hidden| (hidden, random.random())).collect()
}

fn is_tip(id: &str) -> bool {
    id.starts_with("tip.")
}

/// Makes and diagnoses the sessions of a study on all cores, in order.
pub fn run(cases: &[(Hidden, u64)], on_progress: impl Fn(usize) + Sync) -> Vec<Outcome> {
    let outcomes = blind::on_all_cores(cases.len(), |number| {
        let (hidden, seed) = &cases[number];
        let outcome = outcome(hidden, *seed);
        on_progress(number);
        outcome
    });
    outcomes.into_iter().flatten().collect()
}

/// The session that hides something, and its truth.
pub fn make(hidden: &Hidden, seed: u64) -> (Session, Truth) {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let effects = match hidden {
        Hidden::Nothing | Hidden::NothingImaged | Hidden::Foreign(_) => Vec::new(),
        Hidden::One(id, strength) => vec![effect_of(id, *strength)],
        Hidden::Pair(a, b) => vec![effect_of(a, 1), effect_of(b, 1)],
    };
    let foreign = match hidden {
        Hidden::Foreign(name) => Foreign::ALL.into_iter().find(|foreign| foreign.name() == *name),
        _ => None,
    };
    let needs_insertions = effects.iter().any(|(id, _)| id.starts_with("tip."));
    let has_image_noise = matches!(hidden, Hidden::Nothing) && uniform(0.0, 1.0, &mut random) < 0.3;
    let is_imaged = matches!(hidden, Hidden::NothingImaged)
        || effects.iter().any(|(id, _)| blind::imaging_ids().any(|imaging| imaging == *id));
    let design = match (needs_insertions || has_image_noise, is_imaged) {
        (true, _) => Design::insertions(),
        (false, true) => Design::imaged(),
        (false, false) => Design::nine_runs(),
    };
    let truth = Truth {
        k_kpa: uniform(8.0, 20.0, &mut random),
        tip_load_n: uniform(0.12, 0.25, &mut random),
        effects,
        foreign,
    };
    (blind::session(&truth, &design, seed), truth)
}

fn effect_of(id: &'static str, strength: usize) -> (&'static str, Vec<f64>) {
    (id, strengths(id).map(|all| all[strength].clone()).unwrap_or_default())
}

fn outcome(hidden: &Hidden, seed: u64) -> Option<Outcome> {
    let (session, truth) = make(hidden, seed);
    let started = Instant::now();
    let diagnosis = diagnose(&session, &Options { seed, ..Options::default() }, |_| {}).ok()?;
    let seconds = started.elapsed().as_secs_f64();
    let expected: Option<Expected> = match hidden {
        Hidden::One(..) => expected_of(&session, &truth),
        _ => None,
    };
    Some(Outcome {
        hidden: hidden.clone(),
        seed,
        verdict: diagnosis.verdict,
        named: diagnosis.effects.iter().map(|effect| (effect.id.clone(), effect.class.clone())).collect(),
        covered: covered(&diagnosis, &truth),
        found: diagnosis
            .effects
            .iter()
            .flat_map(|effect| {
                let parameter_truths = effect.parameters.iter();
                parameter_truths.map(|(name, diagnosis)| {
                    (format!("{} {name}", effect.id), diagnosis.value, diagnosis.ci95)
                })
            })
            .collect(),
        removed: diagnosis.gap.as_ref().and_then(|gap| gap.removed),
        chi2_after: diagnosis.gap.as_ref().map(|gap| gap.after.chi2_reduced),
        expected_gain: expected.as_ref().map(|expected| expected.gain),
        expected_apart: expected.as_ref().map(|expected| expected.apart),
        competitor: expected.and_then(|expected| expected.competitor),
        p: [diagnosis.adequacy[0].p, diagnosis.adequacy[1].p],
        partial: diagnosis.partial,
        gain: diagnosis.effects.first().map(|effect| effect.log_evidence_gain),
        margin: diagnosis.margin,
        seconds,
    })
}

/// Whether the intervals of what was found hold the truth.
fn covered(found: &Diagnosis, truth: &Truth) -> Vec<(String, bool)> {
    let mut covered = Vec::new();
    for (id, values) in &truth.effects {
        let (Some(named_effect), Some(effect)) =
            (found.effects.iter().find(|effect| effect.id == *id), effect(id))
        else {
            continue;
        };
        for (info, value) in effect.parameters().iter().zip(values) {
            if let Some(estimate) = named_effect.parameters.get(info.name) {
                let [low, high] = estimate.ci95;
                covered.push((format!("{id} {}", info.name), (low..=high).contains(value)));
            }
        }
    }
    covered
}

/// Expected result of a session that hides one effect.
fn expected_of(session: &Session, truth: &Truth) -> Option<Expected> {
    let (id, values) = truth.effects.first()?;
    let truth =
        Hypothetical { effect: id, values, modulus_pa: 1e3 * truth.k_kpa, tip_load_n: truth.tip_load_n };
    expected(session, &truth)
}
