//! Scores of effects and laws around the models of a search.
//!
//! The directions around a fit need an evaluation of the model for every amplitude at every place. As effects change them
//! little, those around the start show which sites and regressors matter around another fit, and only these are evaluated
//! there.

use super::super::discover;
use super::super::posterior::Fitted;
use super::super::score::{Columns, Directions, Score, Scores};
use super::Search;
use super::leaders::{MAX_LEADERS, Pair};
use mechanics::effects::Effect;
use mechanics::terms::Law;
use readings::FitError;
use std::sync::OnceLock;

/// Largest number of pairs of site and regressor whose laws are evaluated around a fit: more than are fitted, because the directions of the
/// start put the scores in a different order.
const MAX_EVALUATED: usize = 2 * MAX_LEADERS;

/// Directions around the start.
#[derive(Default)]
pub(super) struct AroundStart {
    names: OnceLock<Columns>,
    laws: OnceLock<Laws>,
}

/// Laws around the start.
struct Laws {
    all: Vec<&'static Law>,
    /// Their directions, by site and regressor.
    columns: Vec<Columns>,
}

impl Search<'_> {
    fn names(&self) -> &Columns {
        self.around_start.names.get_or_init(|| {
            let directions = Directions::of(&self.catalogue.names(), self.start, self.runs);
            Columns::new(directions, self.patterns)
        })
    }

    fn laws(&self) -> &Laws {
        self.around_start.laws.get_or_init(|| {
            let all = if self.catalogue.laws {
                discover::shown(self.start, self.catalogue.left_out)
            } else {
                Vec::new()
            };
            Laws { columns: discover::columns(&all, self.start, self.runs, self.patterns), all }
        })
    }

    /// Scores of names beside a fit, and of laws if these are tried, best first, with the directions of the start.
    ///
    /// # Errors
    /// Where a size of the discrepancy makes no sense.
    pub(super) fn foreseen(&self, base: &Fitted) -> Result<[Vec<Score>; 2], FitError> {
        let names = std::slice::from_ref(self.names());
        let laws = if self.may_have_laws(base) { self.laws().columns.as_slice() } else { &[] };
        Ok([discover::ranked(names, base, self.patterns)?, discover::ranked(laws, base, self.patterns)?])
    }

    /// Scores of names beside a fit, best first.
    ///
    /// # Errors
    /// Where a size of the discrepancy makes no sense.
    pub(super) fn scored_names(&self, base: &Fitted) -> Result<Vec<Score>, FitError> {
        if self.is_start(base) {
            return discover::ranked(std::slice::from_ref(self.names()), base, self.patterns);
        }
        Ok(Scores::of(&self.catalogue.names(), base, self.runs, self.patterns)?.ranked())
    }

    /// Scores of laws beside a fit, best first.
    ///
    /// # Errors
    /// Where a size of the discrepancy makes no sense.
    pub(super) fn scored_laws(&self, base: &Fitted) -> Result<Vec<Score>, FitError> {
        let Laws { all, columns } = self.laws();
        let mut scores = discover::ranked(columns, base, self.patterns)?;
        if self.is_start(base) {
            return Ok(scores);
        }
        let mut pairs: Vec<Pair> = Vec::new();
        for score in scores.iter().filter(|score| score.is_identifiable) {
            let Some(pair) = Pair::of(score.effect) else { continue };
            if !pairs.contains(&pair) {
                pairs.push(pair);
            }
        }
        pairs.truncate(MAX_EVALUATED);
        let is_evaluated = |effect: &dyn Effect| Pair::of(effect).is_some_and(|pair| pairs.contains(&pair));
        let evaluated: Vec<&'static Law> = all.iter().copied().filter(|law| is_evaluated(*law)).collect();
        let columns = discover::columns(&evaluated, base, self.runs, self.patterns);
        scores.retain(|score| !is_evaluated(score.effect));
        scores.extend(discover::ranked(&columns, base, self.patterns)?);
        scores.sort_by(|a, b| b.log_evidence.total_cmp(&a.log_evidence));
        Ok(scores)
    }

    /// Whether a fit has no more effects than the start.
    fn is_start(&self, base: &Fitted) -> bool {
        base.layout.has_effects_of(&self.start.layout)
    }
}
