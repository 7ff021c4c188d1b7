//! Expected diagnosis of a session under a known truth: whether an effect can be distinguished from competing ones, without random
//! noise. The noise-free predictions of the truth replace the readings. The fits of all effects to them give the
//! expected gain of chi-square and the expected log evidence over the nearest competing effect.

use super::layout::Layout;
use super::noise::Noise;
use super::posterior::{self, Fitted, MAX_ROUNDS};
use super::predicted::differences;
use super::score::Scores;
use super::search::{Catalogue, Search};
use super::weights::ModelPrior;
use super::{Multiples, Noises, Start, fit_start, runs_of, split};
use formats::session::Session;
use mechanics::effects::effect;
use mechanics::predict;

/// A hypothetical truth: the plain model with one effect.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Truth<'a> {
    /// Id of the effect.
    pub effect: &'a str,
    /// Its parameters, SI; trailing ones that are missing are neutral.
    pub values: &'a [f64],
    /// Foundation modulus.
    pub modulus_pa: f64,
    /// Lateral load on the bevel of the tip.
    pub tip_load_n: f64,
}

/// Expected result of the diagnosis.
#[derive(Debug, Clone, PartialEq)]
pub struct Expected {
    /// Chi-square of the plain model with the rig's stated tolerances, that is, the expected gain of the true effect.
    pub gain: f64,
    /// Log evidence of the true effect over the nearest competitor, which may be the model without an effect.
    pub apart: f64,
    /// The nearest competing effect.
    pub competitor: Option<String>,
}

/// Expected result for a session with these runs, if this were the truth; `None` if no run can be fitted or the effect does not
/// exist.
pub fn expected(session: &Session, truth: &Truth<'_>) -> Option<Expected> {
    let hidden = effect(truth.effect)?;
    let (runs, _) = runs_of(session).ok()?;
    let (training, held_out) = split(runs);
    let noise = Noise::of(&training.runs, &session.stated_noise());
    let layout = Layout::new(&session.rig, &training.runs, Vec::new());
    let Start { runs: mut prepared, patterns, fitted: start } = fit_start(
        &layout,
        &training.runs,
        &Noises { session: noise, reference: noise },
        &[],
        &Multiples::new(),
    )
    .ok()?;
    let mut true_values = layout.first_values();
    true_values[0] = truth.modulus_pa.ln();
    if let Some(load) = layout.load() {
        true_values[load] = truth.tip_load_n;
    }
    for run in &mut prepared {
        let mut model = layout.model(&true_values, run.run.kind).ok()?;
        let mut full: Vec<f64> = hidden.parameters().iter().map(|info| info.neutral).collect();
        full.iter_mut().zip(truth.values).for_each(|(to, from)| *to = *from);
        model.effects.push((hidden, full));
        let expected_difference = differences(&run.run, &predict(&model, &run.run.experiment).ok()?);
        run.run
            .data
            .iter_mut()
            .zip(expected_difference)
            .for_each(|(datum, expected_difference)| datum.measured -= expected_difference);
    }
    let plain = Fitted::new(&layout, &prepared, &patterns, start.values(), &start.sizes, MAX_ROUNDS).ok()?;
    // An effect that a rig's stated tolerances allow is not expected to be named.
    let tolerances = patterns.of_known_size();
    let everyday = tolerances.everyday();
    let beside_tolerances =
        Fitted::new(&layout, &prepared, &tolerances, start.values(), &everyday, MAX_ROUNDS).ok()?;
    let misfit = posterior::misfit(&tolerances, &everyday, &beside_tolerances.residuals)?;
    let scores = Scores::new(&plain, &prepared, &patterns).ok()?;
    let plain_start = Start { runs: prepared, patterns, fitted: plain };
    let Start { runs: prepared, patterns, fitted: plain } = &plain_start;
    let judge = held_out.judge(&plain_start, &noise, &Multiples::new()).ok()?;
    let search = Search::new(plain, prepared, patterns, &judge, Catalogue::WHOLE);
    let ranked = scores.ranked();
    let prior = ModelPrior::new(ranked.len(), 1);
    let candidates = search.weigh(plain, ranked, &prior);
    // An effect whose score is too small for a fit has the evidence of its score.
    let gains = candidates.iter().map(|candidate| {
        let gain = candidate.refit.as_ref().map_or(candidate.score.log_evidence, |(_, gain)| *gain);
        (gain, candidate.id())
    });
    let (of_hidden, of_others): (Vec<_>, Vec<_>) =
        gains.filter(|(gain, _)| gain.is_finite()).partition(|(_, id)| *id == truth.effect);
    let [own, competitor] =
        [of_hidden, of_others].map(|gains| gains.into_iter().max_by(|a, b| a.0.total_cmp(&b.0)));
    // Runs that an effect does not change are equally probable with and without it.
    let own_gain = own.map_or(0.0, |(gain, _)| gain);
    // The model without an effect is a competitor too.
    let nearest = competitor.map_or(0.0, |(gain, _)| gain).max(0.0);
    Some(Expected {
        gain: misfit,
        apart: own_gain - nearest,
        competitor: competitor.map(|(_, id)| id.to_owned()),
    })
}

#[cfg(test)]
mod tests {
    use super::super::tests::truth;
    use super::*;
    use worlds::{Design, session};

    /// Data on which an effect has no influence are equally probable with and without it; the normal prior that stands for one with heavy
    /// tails errs by a quarter of a nat.
    #[test]
    fn an_effect_that_no_run_can_show_has_the_evidence_of_the_model_without_it() {
        let lateral_session = session(&truth(Vec::new()), &Design::four_runs(), 3);
        let hidden = Truth { effect: "tip.load_slope", values: &[0.001], modulus_pa: 12e3, tip_load_n: 0.2 };
        let expected = expected(&lateral_session, &hidden).expect("an expected result");
        assert!(expected.apart.abs() < 0.25, "{expected:?}");
    }
}
