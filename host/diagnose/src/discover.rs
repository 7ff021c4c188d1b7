//! Laws outside the catalogue: every triple of site, regressor and form, weighted like an effect (theory, eq. 83).
//!
//! The grammar ([`mechanics::terms`]) has a few hundred triples. Around the current fit each triple is scored like an effect of
//! the catalogue. A place, a length or a period is averaged over a grid, so that no local maximum hides a law. The best laws
//! are fitted, and weighted together with the named effects ([`super::weights`]).
//!
//! Related methods: Brunton et al., "Discovering governing equations from data by sparse identification" (2016); Schmidt and
//! Lipson, "Distilling free-form natural laws from experimental data" (2009). Here the law is part of the forward model and not
//! of its residuals, so that it extrapolates to depths that were never measured.

use super::evidence::Patterns;
use super::layout::Prepared;
use super::posterior::Fitted;
use super::score::{Around, Columns, Directions, Score};
use mechanics::effects::Effect;
use mechanics::terms::{Law, grammar};
use rayon::prelude::*;
use readings::FitError;

/// The laws that the runs of a fit may show; `left_out` are the effects that are excluded from the catalogue.
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

/// Directions of laws around a fit, grouped by site and regressor: scalar products between groups are not needed, and would be most of the
/// work.
pub(super) fn columns(
    laws: &[&'static Law],
    base: &Fitted,
    runs: &[Prepared],
    patterns: &Patterns,
) -> Vec<Columns> {
    let of_pair = |of_pair: &[&'static Law]| {
        let effects: Vec<&'static dyn Effect> =
            of_pair.iter().map(|law| *law as &'static dyn Effect).collect();
        Columns::new(Directions::of(&effects, base, runs), patterns)
    };
    let pairs: Vec<&[&'static Law]> =
        laws.chunk_by(|a, b| (a.site, a.scope, a.regressor) == (b.site, b.scope, b.regressor)).collect();
    pairs.into_par_iter().map(of_pair).collect()
}

/// Scores of these columns around a fit, best first, without the effects of its model.
///
/// # Errors
/// If a size of the discrepancy is invalid.
pub(super) fn ranked(
    columns: &[Columns],
    base: &Fitted,
    patterns: &Patterns,
) -> Result<Vec<Score>, FitError> {
    let around = Around::new(base, patterns)?;
    let is_own = |effect: &dyn Effect| base.layout.effects.iter().any(|own| own.id() == effect.id());
    let scores = columns.par_iter().map(|columns| around.scores(columns).ranked());
    let mut scores: Vec<Score> = scores.flatten_iter().filter(|score| !is_own(score.effect)).collect();
    scores.sort_by(|a, b| b.log_evidence.total_cmp(&a.log_evidence));
    Ok(scores)
}
