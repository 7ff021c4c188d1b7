//! Sensitivity of a session, before its diagnosis: the smallest size of every effect that would be named.
//!
//! Noise, split, starting model and discrepancy are those of [`diagnose`](super::diagnose), and so is the evidence, except that priors of
//! sizes are normal instead of heavy-tailed. There is no search, and the confirmation by held-out runs is not taken into account.

use super::known::Released;
use super::results::Estimate;
use super::score::{NamedFrom, Scores};
use super::weights::{ModelPrior, STATED_PROBABILITY};
use super::{
    DiagnoseError, FOUNDATION_MARGIN, FoundationChoice, Layout, Noise, Noises, Options, Session, Training,
    discover, fit_start, known, runs_of, split,
};
use mechanics::Support;
use mechanics::effects::{Effect, all};
use serde::Serialize;

/// Probability with which an effect of the size in the table would be named.
pub const NAMED_PROBABILITY: f64 = 0.9;

/// Sensitivity of a session.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Check {
    /// Name and version of this document.
    pub schema: &'static str,
    /// Name of the session.
    pub session: Option<String>,
    /// Division of the runs into training and held-out runs.
    pub split: String,
    /// Number of runs with held-out parts; without any, no effect is ever named.
    pub held_out: usize,
    /// Foundation of the tissue.
    pub foundation: &'static str,
    /// Modulus of the starting model: K of springs, E of a body.
    pub modulus_kpa: Estimate,
    /// Smallest log evidence of an effect that is named.
    pub needed: f64,
    /// Probability with which an effect of the size below is named.
    pub probability: f64,
    /// The effects that these runs can show, in ascending order of their size relative to the size that a careful laboratory
    /// overlooks.
    pub effects: Vec<Showable>,
    /// Effects that would not be named at any size within their range.
    pub not_shown: Vec<&'static str>,
    /// Runs that cannot be used, with the reasons.
    pub warnings: Vec<String>,
}

/// An effect and its smallest size that would be named.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Showable {
    /// Id of the effect.
    pub effect: &'static str,
    /// The parameter, with its unit.
    pub parameter: &'static str,
    /// Its value at that size.
    pub value: f64,
    /// Its value without the effect.
    pub neutral: f64,
    /// Size at that value, as a multiple of the size that a careful laboratory overlooks.
    pub over_usual: f64,
    /// The place or time at which the session is most sensitive to it, for an effect that has one.
    pub place: Option<(&'static str, f64)>,
    /// Effects that this session cannot distinguish from it.
    pub alike: Vec<&'static str>,
}

/// Sensitivity of a session; `on_progress` receives a line for each step.
///
/// # Errors
/// [`DiagnoseError`] where nothing can be diagnosed.
pub fn check(
    session: &Session,
    options: &Options,
    mut on_progress: impl FnMut(&str),
) -> Result<Check, DiagnoseError> {
    let (runs, warnings) = runs_of(session)?;
    let (Training { runs, rule }, held_out) = split(runs);
    on_progress(&rule);
    let noise = Noise::of(&runs, &session.stated_noise());
    let given_effects = options.given.iter().map(|(effect, _)| *effect).collect();
    let mut layout = Layout::new(&session.rig, &runs, given_effects);
    layout.known = options.known.clone().into();
    let noises = Noises { session: noise, reference: noise };
    let Released { start, .. } = known::released(&mut layout, |layout| {
        fit_start(layout, &runs, &noises, &options.given, &options.discrepancy)
    })?;
    let support = Support::Body { poisson: options.poisson, block: session.tissue.block() };
    let start = match options.foundation {
        FoundationChoice::Springs => start,
        FoundationChoice::Body => start.on(support)?,
        FoundationChoice::Auto => match start.on(support) {
            Ok(body) if body.fitted.log_evidence - start.fitted.log_evidence > FOUNDATION_MARGIN => body,
            _ => start,
        },
    };
    on_progress("effects are scored");
    let names: Vec<&'static dyn Effect> =
        all().into_iter().filter(|effect| !options.left_out.contains(&effect.id())).collect();
    let scores = Scores::of(&names, &start.fitted, &start.runs, &start.patterns)?;
    let shown = scores.ranked().iter().filter(|score| score.is_identifiable).count();
    let prior = ModelPrior::new(shown, discover::shown(&start.fitted, &options.left_out).len());
    let needed = prior.needed();
    let nameable = scores.named_from(needed, NAMED_PROBABILITY);
    let mut effects: Vec<Showable> = nameable.iter().filter_map(showable).collect();
    effects.sort_by(|a, b| a.over_usual.total_cmp(&b.over_usual));
    let ids = names.iter().map(|effect| effect.id());
    let not_shown = ids.filter(|id| effects.iter().all(|shown| shown.effect != *id)).collect();
    let (modulus_pa, ends_pa) = start.fitted.clone().over_sizes(&start.patterns).modulus_pa();
    Ok(Check {
        schema: "guide.diagnose_check/1",
        session: session.name.clone(),
        split: rule,
        held_out: held_out.ids().len(),
        foundation: start.fitted.layout.support.name(),
        modulus_kpa: Estimate { value: 1e-3 * modulus_pa, ci95: ends_pa.map(|end| 1e-3 * end) },
        needed,
        probability: NAMED_PROBABILITY,
        not_shown,
        effects,
        warnings,
    })
}

fn showable(found: &NamedFrom) -> Option<Showable> {
    let infos = found.effect.parameters();
    let info = infos.get(found.parameter)?;
    let value = found.value?;
    Some(Showable {
        effect: found.effect.id(),
        parameter: info.name,
        value,
        neutral: info.neutral,
        over_usual: (value - info.neutral).abs() / info.prior_sd,
        place: found.place.and_then(|(number, place)| Some((infos.get(number)?.name, place))),
        alike: found.alike.clone(),
    })
}

impl Check {
    /// Meaning of a named effect, in words.
    pub fn of_names(&self) -> String {
        format!(
            "needs log evidence {:+.1}, that is, a probability of {:.0} % among {} effects that these runs can show",
            self.needed,
            100.0 * STATED_PROBABILITY,
            self.effects.len()
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tests::truth;
    use crate::{Verdict, diagnose};
    use worlds::Design;

    fn checked(design: &Design, seed: u64) -> Check {
        let session = worlds::session(&truth(Vec::new()), design, seed);
        check(&session, &Options::default(), |_| {}).expect("a check")
    }

    fn value(check: &Check, id: &str) -> f64 {
        check.effects.iter().find(|one| one.effect == id).map_or(f64::INFINITY, |one| one.value)
    }

    /// In sessions of another generator an effect somewhat larger than the stated size is named in most, one of 0.4 times this size in few.
    #[test]
    #[ignore = "eight diagnoses; cargo xtask test --all runs it"]
    fn an_effect_of_the_stated_size_is_named_and_a_smaller_one_is_not() {
        let design = Design::four_runs();
        let size = value(&checked(&design, 1), "rig.backlash");
        let [named, named_of_smaller] = [1.3 * size, 0.4 * size].map(|size| {
            let named = (0..4u64).filter(|seed| {
                let session = worlds::session(&truth(vec![("rig.backlash", vec![size])]), &design, 10 + seed);
                let diagnosis = diagnose(&session, &Options::default(), |_| {}).expect("a diagnosis");
                let has_name =
                    diagnosis.effects.iter().any(|one| one.class.contains(&"rig.backlash".to_owned()));
                has_name && matches!(diagnosis.verdict, Verdict::Named | Verdict::Ambiguous)
            });
            named.count()
        });
        assert!(named >= 3 && named_of_smaller <= 1, "{named} and {named_of_smaller}, of size {size} mm");
    }

    #[test]
    fn more_data_show_smaller_effects_and_what_no_run_shows_is_not_promised() {
        let more = checked(&Design::four_runs(), 1);
        assert!(more.effects.len() > 10 && more.held_out > 0);
        assert!(more.effects.iter().all(|one| one.value.is_finite() && one.over_usual > 0.0));
        // Lateral runs alone do not depend on the tip.
        let session = worlds::session(&truth(Vec::new()), &Design::four_runs(), 1);
        let lateral = Session { insertion: Vec::new(), ..session.clone() };
        let less = check(&lateral, &Options::default(), |_| {}).expect("a check");
        assert!(less.not_shown.contains(&"tip.load_slope"), "{:?}", less.not_shown);
        assert_eq!(value(&less, "tip.load_slope"), f64::INFINITY);
        // One of two repeats shows less of a skin than both.
        let first = Session { lateral: lateral.lateral[..2].to_vec(), ..lateral.clone() };
        let fewer = check(&first, &Options::default(), |_| {}).expect("a check");
        assert!(value(&fewer, "tissue.skin") > 0.99 * value(&less, "tissue.skin"));
        // Lateral runs cannot distinguish a gain of the force from a stiffer needle.
        let gain = less.effects.iter().find(|one| one.effect == "sensor.force_gain");
        assert!(gain.is_none_or(|gain| gain.alike.contains(&"needle.stiffness")), "{gain:?}");
    }
}
