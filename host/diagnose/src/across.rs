//! What may be in the place of an effect on the foundation that was not chosen.
//!
//! Each foundation imitates the other one where the modulus varies with depth, and what is missing may have one name on springs and another
//! one in a body. A class that knew the chosen foundation alone would state a name as the only one that is possible.

use super::choice::Beside;
use super::found::{Explanation, Member};
use super::posterior::Fitted;
use super::split::Judge;
use super::weights::{is_refuted, ln_sum, smallest_set, stated_ln_odds};
use mechanics::effects::Effect;

/// What a model on the other foundation has in the place of an effect.
enum InPlace {
    /// The same effect.
    Same,
    /// Another one.
    Other(&'static dyn Effect),
    /// Nothing: the foundation alone explains what the effect does.
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
    let others: Vec<&Beside> = beside.iter().filter(is_in_question).collect();
    if others.is_empty() {
        return;
    }
    let given = chosen.layout.given;
    let chosen_ids: Vec<&str> = chosen.layout.effects.iter().map(|effect| effect.id()).collect();
    for member in members {
        let Some(effect) = chosen.layout.effects.get(member.index).copied() else { continue };
        // Odds over the chosen model become odds over the same without the effect.
        let Some(own) = member.class.iter().find(|one| one.effect.id() == effect.id()).map(|one| one.ln_odds)
        else {
            continue;
        };
        let (mut without, mut present) = (vec![0.0], vec![member.ln_odds]);
        for other in &others {
            let ln_odds = own + other.ln_odds;
            let explanation = match in_place(effect, &other.fitted, given, &chosen_ids) {
                InPlace::Nothing => {
                    without.push(ln_odds);
                    continue;
                }
                InPlace::Same => effect,
                InPlace::Other(another) => another,
            };
            present.push(ln_odds);
            add(&mut member.class, explanation, &other.fitted, ln_odds);
        }
        let without = ln_sum(without.into_iter());
        member.class.iter_mut().for_each(|one| one.ln_odds -= without);
        member.class.sort_by(|a, b| b.ln_odds.total_cmp(&a.ln_odds));
        let weights: Vec<f64> = member.class.iter().map(|one| one.ln_odds).collect();
        member.ln_odds = ln_sum(present.into_iter()) - without;
        member.is_needless_elsewhere = member.ln_odds < stated_ln_odds();
        // What was named stays in its class.
        let count = smallest_set(&weights);
        let place = member.class.iter().position(|one| one.effect.id() == effect.id());
        member.class.truncate(count.max(place.map_or(0, |place| place + 1)));
    }
}

fn in_place(effect: &dyn Effect, other: &Fitted, given: usize, chosen_ids: &[&str]) -> InPlace {
    let added = || other.layout.effects.iter().skip(given);
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
