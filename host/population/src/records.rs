//! Records as they are kept in memory: what describes a parameter once, and not in every record.

use crate::sharing::{Likelihood, Likelihoods};
use crate::summary::{Amplitude, Summary};
use std::collections::HashMap;

/// Records of sessions for [`analyse`](crate::analyse): of a hundred thousand of them a few kilobytes each.
#[derive(Debug, Clone, Default)]
pub struct Records {
    kept: Vec<Kept>,
    /// What describes a parameter, without the numbers of a session.
    kinds: Vec<Amplitude>,
    known: HashMap<Key, usize>,
}

/// A record without what its likelihood has.
#[derive(Debug, Clone)]
struct Kept {
    summary: Summary,
    /// `None` without a result.
    likelihood: Option<Likelihood>,
    /// Numbers of its parameters' kinds.
    kinds: Vec<usize>,
}

/// Everything that describes a parameter.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
struct Key {
    names: [String; 3],
    at: Option<(String, u64)>,
    numbers: [u64; 2],
    two_sided: bool,
}

impl Records {
    /// Adds a record.
    pub fn push(&mut self, mut summary: Summary) {
        let (mut likelihood, mut kinds) = (None, Vec::new());
        if let Some(result) = &mut summary.result {
            let before = self.kept.last().map_or(&[][..], |kept| kept.kinds.as_slice());
            let before: Vec<Option<usize>> = (0..result.amplitudes.len())
                .map(|place| {
                    // As in the record before it, mostly.
                    let number = *before.get(place)?;
                    let kind = self.kinds.get(number)?;
                    is_alike(kind, result.amplitudes.get(place)?).then_some(number)
                })
                .collect();
            likelihood = Some(Likelihood::of(result));
            for (one, number) in std::mem::take(&mut result.amplitudes).into_iter().zip(before) {
                kinds.push(number.unwrap_or_else(|| self.kind(one)));
            }
            // Nothing here is computed from these.
            result.log_evidence.clear();
            result.noise.clear();
        }
        (summary.schema, summary.program) = (String::new(), String::new());
        self.kept.push(Kept { summary, likelihood, kinds });
    }

    /// The same in the order of the sessions' names.
    pub(crate) fn by_session(mut self) -> Self {
        self.kept.sort_by(|a, b| a.summary.session.cmp(&b.summary.session));
        self
    }

    /// What is left of the records, and their likelihoods.
    pub(crate) fn likelihoods(self) -> (Vec<Summary>, Likelihoods) {
        let mut data = Likelihoods::default();
        let of_one = |Kept { summary, likelihood, kinds }| {
            data.push(&summary, likelihood, &kinds, &self.kinds);
            summary
        };
        let summaries = self.kept.into_iter().map(of_one).collect();
        (summaries, data)
    }

    /// Number of the kind of a parameter.
    fn kind(&mut self, one: Amplitude) -> usize {
        let key = Key {
            names: [one.effect.clone(), one.parameter.clone(), one.scale.clone()],
            at: one.at.as_ref().map(|(name, value)| (name.clone(), value.to_bits())),
            numbers: [one.neutral.to_bits(), one.prior_sd.to_bits()],
            two_sided: one.two_sided,
        };
        *self.known.entry(key).or_insert_with(|| {
            self.kinds.push(Amplitude { score: 0.0, information: 0.0, ln_k_slope: 0.0, ..one });
            self.kinds.len() - 1
        })
    }
}

fn is_alike(one: &Amplitude, other: &Amplitude) -> bool {
    one.effect == other.effect
        && one.parameter == other.parameter
        && one.at == other.at
        && one.scale == other.scale
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
