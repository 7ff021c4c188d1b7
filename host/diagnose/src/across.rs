//! Alternatives to an effect on the other foundation.
//!
//! If the modulus varies with depth, each foundation imitates the other one, so that one effect may be missing on springs and
//! another one in a body. A class over the chosen foundation alone would omit the second explanation.

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
    /// None: the other foundation alone explains the data.
    Nothing,
}

/// Adds the alternatives on the other foundation to the class of every effect. A model counts with its odds over the chosen one, unless it
/// was refused, or predicts the held-out data significantly worse than the chosen one.
pub(super) fn with_other_foundation(
    members: &mut [Member],
    chosen: &Fitted,
    beside: &[Beside],
    judge: &Judge,
) {
    let Some(losses) = judge.losses(chosen) else { return };
    let plausible_models: Vec<&Beside> = beside
        .iter()
        .filter(|other| {
            other.is_possible
                && judge
                    .losses(&other.fitted)
                    .is_some_and(|worse| !is_refuted(&worse.of_density, &losses.of_density))
        })
        .collect();
    if plausible_models.is_empty() {
        return;
    }
    members.iter_mut().for_each(|member| add_alternatives(member, chosen, &plausible_models));
}

/// Adds the alternatives in these models to the class of an effect.
fn add_alternatives(member: &mut Member, chosen: &Fitted, plausible_models: &[&Beside]) {
    let baseline_count = chosen.layout.given;
    let chosen_ids: Vec<&str> = chosen.layout.effects.iter().map(|effect| effect.id()).collect();
    let Some(effect) = chosen.layout.effects.get(member.index).copied() else { return };
    // Odds over the chosen model become odds over the chosen model without the effect.
    let Some(named_ln_odds) =
        member.class.iter().find(|one| one.effect.id() == effect.id()).map(|one| one.ln_odds)
    else {
        return;
    };
    let (mut ln_odds_without, mut ln_odds_with) = (vec![0.0], vec![member.ln_odds]);
    for other in plausible_models {
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
    let mut weights: Vec<f64> = member.class.iter().map(|one| one.ln_odds).collect();
    member.ln_odds = ln_sum(ln_odds_with.into_iter()) - ln_without;
    // The remaining probability belongs to less likely explanations, which are not in the class.
    let share_of_class = (ln_sum(weights.iter().copied()) - member.ln_odds).exp();
    weights.push(member.ln_odds + (1.0 - share_of_class).max(0.0).ln());
    member.is_needless_elsewhere = member.ln_odds < stated_ln_odds();
    // The named effect stays in its class even if it is not in the smallest set.
    let count = smallest_set(&weights).min(member.class.len());
    let position = member.class.iter().position(|one| one.effect.id() == effect.id());
    member.class.truncate(count.max(position.map_or(0, |index| index + 1)));
}

fn in_place(effect: &dyn Effect, other: &Fitted, baseline_count: usize, chosen_ids: &[&str]) -> InPlace {
    let mut added = other.layout.effects.iter().skip(baseline_count);
    if added.clone().any(|one| one.id() == effect.id()) {
        return InPlace::Same;
    }
    added.find(|one| !chosen_ids.contains(&one.id())).map_or(InPlace::Nothing, |one| InPlace::Other(*one))
}

/// Adds the odds of a model to those of its effect in a class.
fn add(class: &mut Vec<Explanation>, effect: &'static dyn Effect, fitted: &Fitted, ln_odds: f64) {
    match class.iter_mut().find(|one| one.effect.id() == effect.id()) {
        Some(known) => known.ln_odds = ln_sum([known.ln_odds, ln_odds].into_iter()),
        None => class.push(Explanation { effect, fitted: fitted.clone(), ln_odds }),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::report::probability;
    use crate::tests::truth;
    use crate::weights::STATED_PROBABILITY;
    use crate::{choice::Beside, found_in};
    use worlds::Design;

    /// A member after a model on the other foundation was taken into account.
    fn with_model(member: &Member, chosen: &Fitted, fitted: &Fitted, ln_odds: f64) -> Member {
        let model = Beside { fitted: fitted.clone(), ln_odds, is_possible: true };
        let mut changed = member.clone();
        add_alternatives(&mut changed, chosen, &[&model]);
        changed
    }

    #[test]
    fn a_model_on_the_other_foundation_counts_with_its_odds() {
        let session = worlds::session(&truth(vec![("tissue.skin", vec![0.25])]), &Design::four_runs(), 3);
        let (start, found) = found_in(&session);
        let member = found.members.first().expect("an effect");
        let named = found.fitted.layout.effects[member.index].id();
        // A model without the effect that is as likely as the chosen one: the effect is missing with a probability of one half.
        let equal = with_model(member, &found.fitted, &start.fitted, 0.0);
        assert!((probability(equal.ln_odds) - 0.5).abs() < 0.06, "{}", equal.ln_odds);
        assert!(equal.is_needless_elsewhere && !equal.is_the_only_explanation());
        // A model far behind the chosen one bounds the odds and changes no name.
        let unlikely = with_model(member, &found.fitted, &start.fitted, -20.0);
        assert!(
            unlikely.ln_odds > 15.0 && unlikely.ln_odds < 20.1 && !unlikely.is_needless_elsewhere,
            "{}",
            unlikely.ln_odds
        );
        assert_eq!(unlikely.class.len(), member.class.len());
        // A model with another effect: the effect joins the class, and the probability that some effect is missing does not fall.
        let others = found.first.iter().filter_map(|candidate| candidate.refit.as_ref().map(|(fit, _)| fit));
        let other = others
            .into_iter()
            .find(|fit| fit.layout.effects.last().is_some_and(|effect| effect.id() != named))
            .expect("another effect");
        let alternative = with_model(member, &found.fitted, other, -0.5);
        let id = other.layout.effects.last().expect("an effect").id();
        assert!(alternative.class.iter().any(|one| one.effect.id() == id), "{id}");
        assert!(alternative.class.iter().any(|one| one.effect.id() == named), "{named}");
        assert!(probability(alternative.ln_odds) > STATED_PROBABILITY && !alternative.is_needless_elsewhere);
        // A model with the same effect confirms it.
        let confirming = with_model(member, &found.fitted, &found.fitted, 0.0);
        assert!(confirming.ln_odds > member.ln_odds && confirming.class.len() == member.class.len());
    }
}
