//! Laws that no catalogue holds: every triple of site, regressor and form, weighed as an effect is
//! (theory, eq. 83).
//!
//! The grammar ([`mechanics::terms`]) has a few hundred triples. Around the current fit each is scored as an effect of the catalogue is,
//! a place, a length or a period averaged over a grid, so that no local maximum hides one; the leaders are fitted, and weighed beside the names
//! ([`super::weights`]).
//!
//! Against rivals: Brunton et al., "Discovering governing equations from data by sparse identification" (2016); Schmidt and Lipson,
//! "Distilling free-form natural laws from experimental data" (2009). Here the law sits inside the forward model, not in its residuals, so that
//! it holds at depths that were never measured.

use super::evidence::Patterns;
use super::layout::Prepared;
use super::posterior::Fitted;
use super::score::{Score, Scores};
use mechanics::effects::Effect;
use mechanics::terms::{Law, grammar};
use rayon::prelude::*;
use readings::FitError;

/// The terms that the runs of a fit may show, where these names are left out of the catalogue.
pub(super) fn shown(base: &Fitted, left_out: &[&str]) -> Vec<&'static Law> {
    let [lateral, insertion] = base.layout.kinds;
    grammar(left_out)
        .into_iter()
        .filter(|law| {
            let kinds = law.info().observable_in;
            (lateral && kinds.lateral) || (insertion && kinds.insertion)
        })
        .collect()
}

/// Scores of all terms beside a fit, best first.
///
/// # Errors
/// Where the model cannot be evaluated.
pub(super) fn ranked(
    base: &Fitted,
    left_out: &[&str],
    runs: &[Prepared],
    patterns: &Patterns,
) -> Result<Vec<Score>, FitError> {
    let laws = shown(base, left_out);
    // Terms of one site and regressor together: what they share with each other is small, and a product of all with all would be most of
    // the work.
    let scored = |of_pair: &[&'static Law]| {
        let effects: Vec<&'static dyn Effect> =
            of_pair.iter().map(|law| *law as &'static dyn Effect).collect();
        Ok(Scores::of(&effects, base, runs, patterns)?.ranked())
    };
    let pairs: Vec<&[&'static Law]> =
        laws.chunk_by(|a, b| (a.site, a.scope, a.regressor) == (b.site, b.scope, b.regressor)).collect();
    let scores: Vec<Vec<Score>> = pairs.into_par_iter().map(scored).collect::<Result<_, FitError>>()?;
    let mut scores: Vec<Score> = scores.into_iter().flatten().collect();
    scores.sort_by(|a, b| b.log_evidence.total_cmp(&a.log_evidence));
    Ok(scores)
}
