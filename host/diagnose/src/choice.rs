//! Choice of the foundation, springs or an elastic body, and the plausible models on the other one.
//!
//! Each foundation imitates the other one if the modulus varies with depth: a homogeneous body looks like springs that become
//! softer with depth, and springs of one modulus like a body that becomes stiffer. So an adequate model on one foundation does
//! not end the diagnosis: the other foundation is searched too if a modulus that varies with depth may explain the runs better
//! there. Models are compared by their weights (theory, eq. 64), as in the intervals ([`super::averaged`]).

use super::across::with_other_foundation;
use super::adequacy::Adequacy;
use super::found::{Found, Standing};
use super::foundation::{FOUNDATION_MARGIN, varied};
use super::posterior::Fitted;
use super::results::FoundationResult;
use super::search::{Catalogue, Search, leading};
use super::split::Judge;
use super::start::Start;
use super::weights::{NO_WEIGHT, limit_refused};
use super::{DiagnoseError, FoundationChoice, Options};
use formats::session::Tissue;
use mechanics::Support;
use modulus::walls::FINITE_BODY;

/// The second foundation is not searched if its log evidence with a modulus that varies with depth is further behind the model found on the
/// first than this. The margin allows for a second effect and for the linearisation of the score.
const IN_QUESTION: f64 = 8.0;

/// Result on the foundation that explains the runs best.
pub(super) struct Choice {
    pub foundation: FoundationResult,
    pub start: Start,
    pub found: Found,
    /// Models on the other foundation, most probable first.
    pub beside: Vec<Beside>,
}

/// A model on the other foundation.
#[derive(Debug, Clone)]
pub(super) struct Beside {
    pub fitted: Fitted,
    /// Logarithm of its odds over the chosen model. Models that are not possible have even odds together at most.
    pub ln_odds: f64,
    /// Whether it is possible: its search has not refused it, and it does not outweigh the chosen model.
    pub is_possible: bool,
}

/// Searches on the foundation with the larger evidence, where a body needs a margin because springs are the simpler model, and on the
/// other one if it may explain the runs as well; chooses the better result.
pub(super) fn choose(
    springs: Start,
    judge: &Judge,
    options: &Options,
    tissue: &Tissue,
    mut report: impl FnMut(&str),
) -> Result<Choice, DiagnoseError> {
    // If the walls are stated, their effect is left out of the catalogue: the model contains them, or they are far away.
    let walls = tissue.walls.map(|_| FINITE_BODY);
    let left_out: Vec<&'static str> = options.left_out.iter().copied().chain(walls).collect();
    let catalogue = Catalogue { laws: options.discovery, left_out: &left_out };
    let body = match options.foundation {
        FoundationChoice::Springs => None,
        FoundationChoice::Body | FoundationChoice::Auto => {
            springs.on(Support::Body { poisson: options.poisson, block: tissue.block() }).ok()
        }
    };
    let Some(body) = body else {
        let outcome = on(&springs, judge, catalogue).run(&mut report)?;
        let foundation = FoundationResult::springs(None, &springs.fitted);
        return Ok(Choice { foundation, start: springs, found: outcome, beside: Vec::new() });
    };
    let gain = body.fitted.log_evidence - springs.fitted.log_evidence;
    let comparison = Some((gain, body.fitted.clone()));
    let only_body = options.foundation == FoundationChoice::Body;
    let (first, second) =
        if only_body || gain > FOUNDATION_MARGIN { (body, springs) } else { (springs, body) };
    report(&format!(
        "tissue as {}: log evidence of a body over springs {gain:+.1}",
        first.fitted.layout.support.name()
    ));
    let found = on(&first, judge, catalogue).run(&mut report)?;
    let other_search = on(&second, judge, catalogue);
    let is_searched = !only_body
        && (is_in_question(&first, &second, &found)?
            || has_likely_name(&found, &other_search)?
            || promises_more(&found, &on(&first, judge, catalogue), &other_search)?);
    let other_outcome = if is_searched { other_search.run(&mut report).ok() } else { None };
    // If no effect was added on the first foundation, effects on the other one also have to reduce the held-out misfit.
    let is_better = other_outcome.as_ref().is_some_and(|other| {
        let explains_held_out = !found.members.is_empty()
            || other.members.is_empty()
            || judge.held_out_shrinks(&found.fitted, &other.fitted);
        other.prior.ln_weight(&other.fitted) > found.prior.ln_weight(&found.fitted) && explains_held_out
    });
    let (start, found, other_start, unused) = match other_outcome {
        Some(other) if is_better => (second, other, first, Some(found)),
        other => (first, found, second, other),
    };
    let springs = if start.fitted.layout.support.is_body() { &other_start.fitted } else { &start.fitted };
    let foundation = FoundationResult::of(&found.fitted, springs, comparison);
    let unchosen = unused.map_or_else(Vec::new, |unused| beside(&other_start, &unused, &found));
    let mut found = found;
    with_other_foundation(&mut found.members, &found.fitted, &unchosen, judge);
    Ok(Choice { foundation, start, found, beside: unchosen })
}

/// The search for missing effects on a foundation.
fn on<'a>(start: &'a Start, judge: &'a Judge, catalogue: Catalogue<'a>) -> Search<'a> {
    let Start { runs, patterns, fitted } = start;
    Search::new(fitted, runs, patterns, judge, catalogue)
}

/// Whether effects were found on the first foundation, and a name on the second one explains the runs about as well: effects that exist on
/// one foundation only have another name on the other.
fn has_likely_name(found: &Found, second: &Search<'_>) -> Result<bool, DiagnoseError> {
    let needed = found.prior.ln_weight(&found.fitted) + NO_WEIGHT;
    Ok(!found.members.is_empty() && second.ln_weight_of_names()? > needed)
}

/// Whether a law was found on the first foundation, and the score of an effect on the second foundation is high enough that this effect may
/// replace the law: some laws exist on springs only.
fn promises_more(found: &Found, first: &Search<'_>, second: &Search<'_>) -> Result<bool, DiagnoseError> {
    let effects = &found.fitted.layout.effects;
    let mut added = found.members.iter().filter_map(|member| effects.get(member.index));
    if !added.any(|effect| effect.is_unnamed()) {
        return Ok(false);
    }
    let [[start, best], [other_start, other_best]] = [first.promise()?, second.promise()?];
    Ok(other_start + other_best > start + leading(best))
}

/// Whether the second foundation may explain the runs as well as the model that was found on the first.
fn is_in_question(first: &Start, second: &Start, found: &Found) -> Result<bool, DiagnoseError> {
    let is_adequate =
        found.members.is_empty() && Adequacy::of(&first.fitted, &first.runs, &first.patterns)?.is_adequate();
    // Effects that imitate the other foundation are needed on one foundation only. A misfit without a name on one foundation may have a
    // name on the other, which has effects of its own.
    if !is_adequate && !second.is_far_behind(found, &first.fitted)? {
        return Ok(true);
    }
    let needed_gain = found.fitted.log_evidence - second.fitted.log_evidence - IN_QUESTION;
    let gain = varied(second, needed_gain.max(0.0)).unwrap_or(0.0);
    Ok(gain > needed_gain && gain > 0.0)
}

/// The plausible models on the foundation that was not chosen, most probable first.
fn beside(start: &Start, unused: &Found, chosen: &Found) -> Vec<Beside> {
    let most = chosen.prior.ln_weight(&chosen.fitted);
    let candidates = unused.first.iter().filter_map(|candidate| {
        let (fitted, _) = candidate.refit.as_ref()?;
        Some((fitted, candidate.standing == Standing::Possible))
    });
    let fits = [(&start.fitted, true), (&unused.fitted, true)].into_iter().chain(candidates);
    let mut models: Vec<Beside> = Vec::new();
    for (fitted, is_possible) in fits {
        let ln_odds = unused.prior.ln_weight(fitted) - most;
        let is_new = !models.iter().any(|known| known.fitted.layout.has_effects_of(&fitted.layout));
        if ln_odds > NO_WEIGHT && is_new && !fitted.at_bound.contains(&true) {
            models.push(Beside {
                fitted: fitted.clone().over_sizes(&start.patterns),
                ln_odds,
                is_possible: is_possible && ln_odds <= 0.0,
            });
        }
    }
    let refused = models.iter_mut().filter(|other| !other.is_possible);
    limit_refused(refused.map(|other| &mut other.ln_odds), 0.0);
    models.sort_by(|a, b| b.ln_odds.total_cmp(&a.ln_odds));
    models
}

#[cfg(test)]
mod tests {
    use super::super::tests::truth;
    use super::super::{Options, Verdict, diagnose};
    use worlds::{Design, Truth};

    /// Springs that become softer with depth are not reported as a homogeneous body alone, although such a body explains the runs: the
    /// alternative is a limit, and if the gradient is named, K is that of the surface.
    #[test]
    fn a_modulus_that_falls_with_depth_is_not_taken_for_a_homogeneous_body() {
        let falling = Truth { k_kpa: 9.0, ..truth(vec![("tissue.gradient", vec![-0.012])]) };
        for seed in [4, 5, 6] {
            let session = worlds::session(&falling, &Design::four_runs(), seed);
            let result = diagnose(&session, &Options::default(), |_| {}).expect("a diagnosis");
            if result.verdict == Verdict::Adequate {
                let mut limits = result.limits.iter();
                let is_stated = limits.any(|limit| limit.contains("springs with tissue."));
                assert!(is_stated, "{seed} {:?}", result.limits);
            } else {
                let class = &result.effects[0].class;
                assert!(class.iter().any(|id| id.starts_with("tissue.")), "{seed} {:?}", result.effects);
                let [low, high] = result.k_ci95_kpa;
                assert!((low..=high).contains(&9.0), "{seed} K {:.2} ({low:.2} to {high:.2})", result.k_kpa);
            }
        }
    }
}
