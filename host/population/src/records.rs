//! Records as they are kept in memory: what describes a parameter once, and not in every record.

use crate::sharing::{Likelihood, Likelihoods};
use crate::summary::{Amplitude, SessionResult, Summary};
use std::collections::{BTreeMap, HashMap};
use std::sync::Arc;

/// Records of sessions for [`analyse`](crate::analyse): of a hundred thousand of them a few kilobytes each.
#[derive(Debug, Clone, Default)]
pub struct Records {
    kept: Vec<Kept>,
    /// Description of a parameter, without the numbers of a session.
    kinds: Vec<Amplitude>,
    known: HashMap<Key, usize>,
    /// Sizes of the discrepancy by name, of all records that have them.
    sizes: BTreeMap<String, Vec<f64>>,
}

/// A record without what its likelihood has, and without what is kept of all together.
#[derive(Debug, Clone)]
struct Kept {
    summary: Summary,
    /// `None` without a result.
    likelihood: Option<Likelihood>,
    /// Numbers of its parameters' kinds: of most records those of the one before.
    kinds: Arc<[usize]>,
}

/// Everything that describes a parameter.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
struct Key {
    names: [String; 3],
    at: Option<(String, u64)>,
    numbers: [u64; 2],
    two_sided: bool,
}

/// A record, its parameters apart from it. `S` are the names of parameters.
#[derive(Debug)]
pub(crate) struct Parts<S> {
    summary: Summary,
    likelihood: Option<Likelihood>,
    parameters: Vec<Amplitude<S>>,
    discrepancy: BTreeMap<S, f64>,
}

impl<S> From<Summary<S>> for Parts<S> {
    fn from(summary: Summary<S>) -> Self {
        let Summary { session, name, date, site, subject, rig, needle, tissue, .. } = summary;
        let Summary { covariates, error, mut result, .. } = summary;
        let likelihood = result.as_mut().map(Likelihood::of);
        let (result, parameters, discrepancy) = match result.map(SessionResult::apart) {
            Some((result, parameters, discrepancy)) => (Some(result), parameters, discrepancy),
            None => (None, Vec::new(), BTreeMap::new()),
        };
        // Alike in all records.
        let (schema, program) = (String::new(), String::new());
        let labels = Summary { schema, program, ..Summary::empty(session) };
        let labels = Summary { name, date, site, subject, rig, needle, tissue, ..labels };
        Self { summary: Summary { covariates, error, result, ..labels }, likelihood, parameters, discrepancy }
    }
}

impl<S> Parts<S> {
    /// Name of the session.
    pub fn session(&self) -> &str {
        &self.summary.session
    }
}

impl Records {
    /// Adds a record.
    pub fn push(&mut self, summary: Summary) {
        self.push_parts(summary.into());
    }

    /// Adds a record whose parameters are apart.
    pub(crate) fn push_parts<S: AsRef<str>>(&mut self, parts: Parts<S>) {
        let Parts { summary, likelihood, parameters, discrepancy } = parts;
        let previous_kinds = self.kept.last().map(|kept| kept.kinds.clone());
        let earlier_kinds = previous_kinds.as_deref().unwrap_or_default();
        let mut kinds = Vec::with_capacity(parameters.len());
        for (place, one) in parameters.iter().enumerate() {
            // As in the record before it, mostly.
            let number = earlier_kinds.get(place).copied();
            let same_kind =
                number.filter(|number| self.kinds.get(*number).is_some_and(|kind| is_alike(kind, one)));
            kinds.push(same_kind.unwrap_or_else(|| self.kind(one)));
        }
        for (name, multiple) in discrepancy {
            match self.sizes.get_mut(name.as_ref()) {
                Some(sizes) => sizes.push(multiple),
                None => {
                    self.sizes.insert(name.as_ref().to_owned(), vec![multiple]);
                }
            }
        }
        let as_before = self.kept.last().filter(|kept| *kept.kinds == *kinds).map(|kept| kept.kinds.clone());
        let kinds = as_before.unwrap_or_else(|| kinds.into());
        self.kept.push(Kept { summary, likelihood, kinds });
    }

    /// The same in the order of the sessions' names.
    pub(crate) fn by_session(mut self) -> Self {
        self.kept.sort_by(|a, b| a.summary.session.cmp(&b.summary.session));
        self
    }

    /// Median over the records of every size of the discrepancy.
    pub(crate) fn median_sizes(&self) -> BTreeMap<String, f64> {
        let medians = self.sizes.iter().filter_map(|(name, values)| {
            let mut values = values.clone();
            values.sort_by(f64::total_cmp);
            Some((name.clone(), *values.get(values.len() / 2)?))
        });
        medians.collect()
    }

    /// Remaining summaries of the records, and their likelihoods.
    pub(crate) fn likelihoods(self) -> (Vec<Summary>, Likelihoods) {
        let mut data = Likelihoods::default();
        let summaries = self
            .kept
            .into_iter()
            .map(|Kept { summary, likelihood, kinds }| {
                data.push(&summary, likelihood, &kinds, &self.kinds);
                summary
            })
            .collect();
        (summaries, data)
    }

    /// Number of the kind of a parameter.
    fn kind<S: AsRef<str>>(&mut self, one: &Amplitude<S>) -> usize {
        let kind = Amplitude {
            effect: one.effect.as_ref().to_owned(),
            parameter: one.parameter.as_ref().to_owned(),
            at: one.at.as_ref().map(|(name, value)| (name.as_ref().to_owned(), *value)),
            scale: one.scale.as_ref().to_owned(),
            neutral: one.neutral,
            two_sided: one.two_sided,
            prior_sd: one.prior_sd,
            score: 0.0,
            information: 0.0,
            ln_k_slope: 0.0,
        };
        let key = Key {
            names: [kind.effect.clone(), kind.parameter.clone(), kind.scale.clone()],
            at: kind.at.as_ref().map(|(name, value)| (name.clone(), value.to_bits())),
            numbers: [kind.neutral.to_bits(), kind.prior_sd.to_bits()],
            two_sided: kind.two_sided,
        };
        *self.known.entry(key).or_insert_with(|| {
            self.kinds.push(kind);
            self.kinds.len() - 1
        })
    }
}

fn is_alike<S: AsRef<str>>(one: &Amplitude, other: &Amplitude<S>) -> bool {
    let other_at = other.at.as_ref().map(|(name, value)| (name.as_ref(), *value));
    one.effect == other.effect.as_ref()
        && one.parameter == other.parameter.as_ref()
        && one.at.as_ref().map(|(name, value)| (name.as_str(), *value)) == other_at
        && one.scale == other.scale.as_ref()
        && one.neutral == other.neutral
        && one.two_sided == other.two_sided
        && one.prior_sd == other.prior_sd
}

impl From<Vec<Summary>> for Records {
    fn from(summaries: Vec<Summary>) -> Self {
        let mut records = Self::default();
        summaries.into_iter().for_each(|summary| records.push(summary));
        records
    }
}
