//! The search for the laws that explain the runs, with their probabilities.
//!
//! Around a fit every candidate is scored, and the best are fitted. The weight of each is its evidence times its prior times
//! the e-value of the held-out runs; in the prior, "a law is missing" and "none is" have equal probability, and all candidates
//! with one parameter are equally probable; every further parameter of a law halves its probability. While some law is
//! missing with the stated probability, the most probable law that held-out runs do not refuse is added. Then every law is removed
//! in turn and compared with its rivals, which gives its probability.

use super::basis::Basis;
use super::bench::{Bench, Law};
use super::fit::{Fitted, Start};
use super::judge::{Judgement, errors, judge};
use super::model::Error;
use super::regions::regions;
use super::score::{Score, scores};
use super::weights::{ln_e_value, stated_ln_odds};

/// Largest number of laws that are added: every further law takes the time of the whole search again.
const MAX_LAWS: usize = 8;
/// Largest number of exchanges of a law for a more probable rival. Each leads to a set that was not visited before, because preferences
/// by held-out runs may be cyclic.
const MAX_EXCHANGES: usize = 2 * MAX_LAWS;
/// Number of candidates of each of the two rankings that are fitted in a step.
const LEADERS: usize = 4;

/// Why a law was not added.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Refusal {
    /// Too improbable compared with the models without it.
    Unlikely,
    /// Held-out runs do not confirm it.
    NotConfirmed(Judgement),
}

/// A law that was fitted and not added.
#[derive(Clone)]
pub(crate) struct Refused {
    pub law: Law,
    pub ln_odds: f64,
    pub reason: Refusal,
}

/// Odds of a model over a smaller one.
pub(super) struct Standing {
    /// Logarithm of the odds by evidence, prior and e-value of the held-out runs.
    pub ln_odds: f64,
    pub judgement: Option<Judgement>,
}

impl Standing {
    /// Reason of the refusal, if it is refused.
    pub fn refusal(&self) -> Option<Refusal> {
        match self.judgement {
            Some(judgement) if !judgement.is_confirmed() => Some(Refusal::NotConfirmed(judgement)),
            _ => (self.ln_odds < stated_ln_odds()).then_some(Refusal::Unlikely),
        }
    }
}

/// A law of the final model.
pub(crate) struct Member {
    /// Logarithm of its odds over the same model without it.
    pub ln_odds: f64,
    /// Probability of the models with it, among those with it, with a rival, or with neither.
    pub probability: f64,
    /// Rivals in its place with their probabilities, most probable first.
    pub rivals: Vec<(Fitted, f64)>,
    /// Test on held-out runs: the model with it compared with the model without it.
    pub judgement: Option<Judgement>,
}

/// Result of a search.
pub(crate) struct Found {
    pub fitted: Fitted,
    /// One for each law.
    pub members: Vec<Member>,
    pub refused: Vec<Refused>,
}

impl Found {
    /// The same laws, and their rivals, with the values at which they predict best.
    ///
    /// # Errors
    /// Where the model fails for other reasons than its values.
    pub fn with_final_values(mut self, bench: &Bench<'_>, everyday: f64) -> Result<(Basis, Self), Error> {
        let (basis, fitted) = final_values(bench, &self.fitted, everyday)?;
        for (rival, _) in self.members.iter_mut().flat_map(|member| &mut member.rivals) {
            *rival = final_values(bench, rival, everyday)?.1;
        }
        self.fitted = fitted;
        Ok((basis, self))
    }
}

/// A model with the values at which it predicts best, and the discrepancy around it.
pub(crate) fn final_values(
    bench: &Bench<'_>,
    fitted: &Fitted,
    everyday: f64,
) -> Result<(Basis, Fitted), Error> {
    let basis = Basis::of_values(bench, fitted, everyday)?;
    let mut settled = Fitted::new(bench, &basis, &fitted.laws, &fitted.start())?;
    settled.covariance += basis.covariance_of_absorbed(&settled.sizes);
    Ok((basis, settled))
}

/// Inputs of a search.
pub(crate) struct Search<'a> {
    pub bench: &'a Bench<'a>,
    pub basis: &'a Basis,
    pub candidates: &'a [Law],
    pub on_step: &'a (dyn Fn(&str) + Sync),
}

impl Search<'_> {
    /// Logarithm of the weight of a model.
    pub(super) fn ln_weight(&self, fitted: &Fitted) -> f64 {
        // Every parameter beyond the first halves the prior probability of a law.
        let ln_choices = fitted.laws.iter().map(|law| {
            let more = law.len().saturating_sub(1) as f64;
            (self.candidates.len().max(1) as f64).ln() + more * std::f64::consts::LN_2
        });
        fitted.log_evidence - ln_choices.sum::<f64>()
    }

    /// Fits of a model with one further law each, or with a further pair each, the most probable first.
    pub(super) fn extensions(&self, base: &Fitted, with_pairs: bool) -> Result<Vec<Fitted>, Error> {
        let candidates = self.candidates.iter();
        let laws: Vec<Law> =
            candidates.filter(|law| !base.laws.iter().any(|own| own.is_like(law))).cloned().collect();
        let (scores, pairs) = scores(self.bench, self.basis, base, &laws)?;
        let chosen: Vec<Vec<&Score>> = if with_pairs {
            let leaders = leading(&pairs, |pair| pair.log_evidence);
            leaders.into_iter().map(|pair| pair.scores.iter().collect()).collect()
        } else {
            leading(&scores, |score| score.log_evidence).into_iter().map(|score| vec![score]).collect()
        };
        let fits: Vec<Option<Fitted>> = self.bench.each(chosen, |scores| self.extended(base, &scores))?;
        let mut simplest: Vec<Fitted> = Vec::with_capacity(fits.len());
        for fitted in fits.into_iter().flatten() {
            let Some(fitted) = self.in_simplest_laws(base, fitted)? else { continue };
            if !simplest.iter().any(|other| is_same_set(&other.laws, &fitted.laws)) {
                simplest.push(fitted);
            }
        }
        let mut fits = simplest;
        fits.sort_by(|a, b| self.ln_weight(b).total_cmp(&self.ln_weight(a)));
        Ok(fits)
    }

    /// Fit of a model with further laws, which starts at the amplitudes of their scores or, if the model has no prediction there, at
    /// amplitudes of zero; `None` if there is no fit.
    pub(super) fn extended(&self, base: &Fitted, scores: &[&Score]) -> Result<Option<Fitted>, Error> {
        let laws: Vec<Law> = base.laws.iter().chain(scores.iter().map(|score| &score.law)).cloned().collect();
        for factor in [1.0, 0.0] {
            let mut start = base.start();
            for score in scores {
                let amplitudes = score.law.form.amplitudes().len();
                let (scaled, shape) = score.numbers.split_at(amplitudes.min(score.numbers.len()));
                start.values.extend(scaled.iter().map(|number| factor * number).chain(shape.iter().copied()));
            }
            match Fitted::new(self.bench, self.basis, &laws, &start) {
                Ok(fitted) => return Ok(Some(fitted)),
                Err(error) if error.is_of_these_values() => {}
                Err(Error::Undetermined(_)) => return Ok(None),
                Err(error) => return Err(error),
            }
        }
        Ok(None)
    }

    /// A model without one of its laws.
    pub(super) fn without(&self, fitted: &Fitted, member: usize) -> Result<Fitted, Error> {
        let mut laws = fitted.laws.clone();
        let removed = laws.remove(member);
        let earlier_numbers: usize = laws.iter().take(member).map(Law::len).sum();
        let first = self.bench.model.parameters().len() + earlier_numbers;
        let mut start = fitted.start();
        start.values.drain(first..first + removed.len());
        Fitted::new(self.bench, self.basis, &laws, &start)
    }

    pub(super) fn judge(&self, without: &Fitted, with: &Fitted) -> Result<Option<Judgement>, Error> {
        let (smaller, larger) = (errors(self.bench, without)?, errors(self.bench, with)?);
        Ok(smaller.zip(larger).map(|(smaller, larger)| judge(&smaller, &larger)))
    }

    /// Searches, starting from a model.
    ///
    /// # Errors
    /// Where the model fails for other reasons than its values.
    pub fn run(&self, start: Fitted) -> Result<Found, Error> {
        let (mut current, mut refused) = self.grow(start)?;
        let mut earlier: Vec<Vec<Law>> = Vec::new();
        loop {
            while let Some((smaller, reason)) = self.shrink(&current)? {
                refused.push(reason);
                current = smaller;
            }
            if let Some(simpler) = self.without_sums(&current)? {
                current = simpler;
                continue;
            }
            let members = (0..current.laws.len()).map(|member| self.member(&current, member));
            let members = members.collect::<Result<Vec<Member>, Error>>()?;
            earlier.push(current.laws.clone());
            let rivals = members.iter().flat_map(|member| {
                member.rivals.iter().map(|(rival, probability)| (probability / member.probability, rival))
            });
            let likelier = rivals.filter(|(lead, rival)| {
                *lead > 1.0 && earlier.iter().all(|laws| !is_same_set(laws, &rival.laws))
            });
            match likelier.max_by(|a, b| a.0.total_cmp(&b.0)) {
                // A rival that is more probable than the law replaces it, and the rivals of all laws are compared again.
                Some((_, rival)) if earlier.len() <= MAX_EXCHANGES => current = rival.clone(),
                _ => return Ok(Found { fitted: current, members, refused }),
            }
        }
    }

    /// Adds laws while one is missing with the stated probability and held-out runs confirm it. If no single law can be added, pairs are
    /// tried, provided that a misfit remains or held-out runs have refused a law.
    fn grow(&self, mut current: Fitted) -> Result<(Fitted, Vec<Refused>), Error> {
        loop {
            if current.laws.len() >= MAX_LAWS {
                return Ok((current, Vec::new()));
            }
            let (number, count) = (current.laws.len() + 1, self.candidates.len());
            (self.on_step)(&format!("searching for law {number} among {count} candidates"));
            let mut refused = Vec::new();
            let singles = self.extensions(&current, false)?;
            let mut next = self.likeliest(&current, singles, &mut refused)?;
            let is_refused = refused.iter().any(|one| one.reason != Refusal::Unlikely);
            if next.is_none() && (is_refused || !self.is_explained(&current)) {
                (self.on_step)("searching for two laws at once");
                let pairs = self.extensions(&current, true)?;
                next = self.likeliest(&current, pairs, &mut Vec::new())?;
            }
            match next {
                Some(fitted) => current = fitted,
                None => return Ok((current, refused)),
            }
        }
    }

    /// Whether no region with significant residuals is left.
    fn is_explained(&self, fitted: &Fitted) -> bool {
        regions(self.bench, self.basis, fitted, &fitted.noises).is_some_and(|list| list.is_empty())
    }

    /// The best of those larger models that reach the stated probability and that held-out runs confirm; models that do not are added
    /// to `refused`.
    fn likeliest(
        &self,
        current: &Fitted,
        larger: Vec<Fitted>,
        refused: &mut Vec<Refused>,
    ) -> Result<Option<Fitted>, Error> {
        let mut best: Option<Fitted> = None;
        for fitted in larger {
            let standing = self.standing(current, &fitted)?;
            let Some(law) = fitted.laws.last().cloned() else { continue };
            match standing.refusal() {
                Some(reason) => refused.push(Refused { law, ln_odds: standing.ln_odds, reason }),
                None => {
                    let is_better = match &best {
                        Some(other) => self.ln_lead(&fitted, other)? > 0.0,
                        None => true,
                    };
                    if is_better {
                        best = Some(fitted);
                    }
                }
            }
        }
        Ok(best)
    }

    /// Compares a model with a smaller one.
    pub(super) fn standing(&self, smaller: &Fitted, larger: &Fitted) -> Result<Standing, Error> {
        let judgement = self.judge(smaller, larger)?;
        let of_judge = judgement.map_or(0.0, |one| ln_e_value(one.p));
        let ln_odds = self.ln_weight(larger) - self.ln_weight(smaller) + of_judge;
        Ok(Standing { ln_odds, judgement })
    }

    /// The model without the first law that is refused now, with the reason; `None` if there is no such law.
    fn shrink(&self, current: &Fitted) -> Result<Option<(Fitted, Refused)>, Error> {
        for member in 0..current.laws.len() {
            let smaller = self.without(current, member)?;
            let standing = self.standing(&smaller, current)?;
            if let Some(reason) = standing.refusal() {
                let law = current.laws[member].clone();
                return Ok(Some((smaller, Refused { law, ln_odds: standing.ln_odds, reason })));
            }
        }
        Ok(None)
    }
}

/// Whether two sets have the same kinds of laws, in any order.
fn is_same_set(one: &[Law], other: &[Law]) -> bool {
    one.len() == other.len() && one.iter().all(|law| other.iter().any(|second| law.is_like(second)))
}

/// Scores that lead one of the two rankings, each once.
fn leading<T>(scores: &[T], log_evidence: impl Fn(&T) -> [f64; 2]) -> Vec<&T> {
    let mut chosen: Vec<usize> = Vec::new();
    for ranking in 0..2 {
        let values: Vec<f64> = scores.iter().map(|score| log_evidence(score)[ranking]).collect();
        let mut order: Vec<usize> = (0..scores.len()).collect();
        order.sort_by(|a, b| values[*b].total_cmp(&values[*a]));
        chosen.extend(order.into_iter().take(LEADERS));
    }
    chosen.sort_unstable();
    chosen.dedup();
    chosen.into_iter().filter_map(|i| scores.get(i)).collect()
}

/// The plain model with the discrepancy around it: first around the prior means, then around the fit.
pub(crate) fn plain(bench: &Bench<'_>, everyday: f64) -> Result<(Basis, Fitted), Error> {
    let start: Vec<f64> = bench.coordinates(&[]).iter().map(|one| one.mean).collect();
    let basis = Basis::of_start(bench, &start, everyday)?;
    let first = Fitted::new(bench, &basis, &[], &Start::plain(bench, &basis))?;
    let basis = Basis::of_search(bench, &first, everyday)?;
    let plain = Fitted::new(bench, &basis, &[], &first.start())?;
    Ok((basis, plain))
}
