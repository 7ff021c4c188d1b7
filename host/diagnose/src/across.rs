//! Alternatives to an effect on the foundation that was not chosen.
//!
//! Each foundation imitates the other one where the modulus varies with depth, and what is missing may have one name on springs and another
//! one in a body. A class that knew the chosen foundation alone would state a name as the only one that is possible.

use super::choice::Beside;
use super::found::{Explanation, Member};
use super::posterior::Fitted;
use super::split::Judge;
use super::weights::{is_refuted, ln_sum, smallest_set, stated_ln_odds};
use mechanics::effects::Effect;

/// The part of a model on the other foundation that replaces an effect.
enum InPlace {
    /// The same effect.
    Same,
    /// Another one.
    Other(&'static dyn Effect),
    /// None: the foundation alone explains what the effect does.
    Nothing,
}

/// Adds to the class of every effect what models on the other foundation have in its place. A model counts with its odds over the chosen one,
/// but not where it was refused, or predicts what was held out worse than the chosen one beyond chance.
pub(super) fn with_other_foundation(
    members: &mut [Member],
    chosen: &Fitted,
    beside: &[Beside],
    judge: &Judge,
) {
    let Some(losses) = judge.losses(chosen) else { return };
    let is_in_question = |other: &&Beside| {
        other.is_possible && judge.losses(&other.fitted).is_some_and(|worse| !is_refuted(&worse, &losses))
    };
    let plausible_models: Vec<&Beside> = beside.iter().filter(is_in_question).collect();
    if plausible_models.is_empty() {
        return;
    }
    let baseline_count = chosen.layout.given;
    let chosen_ids: Vec<&str> = chosen.layout.effects.iter().map(|effect| effect.id()).collect();
    for member in members {
        let Some(effect) = chosen.layout.effects.get(member.index).copied() else { continue };
        // Odds over the chosen model become odds over the same without the effect.
        let Some(named_ln_odds) =
            member.class.iter().find(|one| one.effect.id() == effect.id()).map(|one| one.ln_odds)
        else {
            continue;
        };
        let (mut ln_odds_without, mut ln_odds_with) = (vec![0.0], vec![member.ln_odds]);
        for other in &plausible_models {
            let ln_odds = named_ln_odds + other.ln_odds;
            let explanation = match in_place(effect, &other.fitted, baseline_count, &chosen_ids) {
                InPlace::Nothing => {
                    ln_odds_without.push(ln_odds);
                    continue;
                }
                InPlace::Same => effect,
                InPlace::Other(another) => another,
            };
            ln_odds_with.push(ln_odds);
            add(&mut member.class, explanation, &other.fitted, ln_odds);
        }
        let ln_without = ln_sum(ln_odds_without.into_iter());
        member.class.iter_mut().for_each(|one| one.ln_odds -= ln_without);
        member.class.sort_by(|a, b| b.ln_odds.total_cmp(&a.ln_odds));
        let weights: Vec<f64> = member.class.iter().map(|one| one.ln_odds).collect();
        member.ln_odds = ln_sum(ln_odds_with.into_iter()) - ln_without;
        member.is_needless_elsewhere = member.ln_odds < stated_ln_odds();
        // The effect that was named stays in its class.
        let count = smallest_set(&weights);
        let position = member.class.iter().position(|one| one.effect.id() == effect.id());
        member.class.truncate(count.max(position.map_or(0, |index| index + 1)));
    }
}

fn in_place(effect: &dyn Effect, other: &Fitted, baseline_count: usize, chosen_ids: &[&str]) -> InPlace {
    let added = || other.layout.effects.iter().skip(baseline_count);
    if added().any(|one| one.id() == effect.id()) {
        return InPlace::Same;
    }
    added().find(|one| !chosen_ids.contains(&one.id())).map_or(InPlace::Nothing, |one| InPlace::Other(*one))
}

/// Adds the weight of a model to what its effect has in a class.
fn add(class: &mut Vec<Explanation>, effect: &'static dyn Effect, fitted: &Fitted, ln_odds: f64) {
    match class.iter_mut().find(|one| one.effect.id() == effect.id()) {
        Some(known) => known.ln_odds = ln_sum([known.ln_odds, ln_odds].into_iter()),
        None => class.push(Explanation { effect, fitted: fitted.clone(), ln_odds }),
    }
}
