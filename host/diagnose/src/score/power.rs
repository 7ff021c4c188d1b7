//! Smallest size of an effect that data show (theory, eq. 88).
//!
//! An effect of amplitude `a` in direction i adds `a G_i` to the projections of the residuals on all directions, and noise and discrepancy
//! add a normal vector of covariance `G`; the elements of `G` are the scalar products of the directions in the metric of noise and
//! discrepancy. So the distribution of the evidence by [`Scores::log_evidence`] is known before a search, from the same matrix, prior and
//! average over places.

use super::{PreparedHypothesis, Scores, mean_of_exponentials};
use crate::layout::Scale;
use crate::weights::indistinct;
use mechanics::effects::Effect;
use nalgebra::{DMatrix, DVector};
use readings::draws::Random;

/// Draws of the noise: 0.9 is met within 0.015, the size within 2 %.
const DRAWS: usize = 400;
const BISECTIONS: usize = 24;
const SEED: u64 = 1;

/// The size of an effect from which on it would have a name.
#[derive(Debug, Clone)]
pub(crate) struct NamedFrom {
    pub effect: &'static dyn Effect,
    /// Number of the parameter, and its value at that size; `None` if no size within its range would be named.
    pub parameter: usize,
    pub value: Option<f64>,
    /// Number and value of the parameter that is a place or a time, at the most sensitive one.
    pub place: Option<(usize, f64)>,
    /// Effects that cannot be distinguished from it at that size.
    pub alike: Vec<&'static str>,
}

impl Scores {
    /// For every effect the smallest size that reaches a log evidence with a probability.
    pub fn named_from(&self, needed: f64, probability: f64) -> Vec<NamedFrom> {
        let numbers: Vec<Option<(usize, f64)>> =
            (0..self.hypotheses.len()).map(|effect| self.smallest(effect, needed, probability)).collect();
        let amplitudes = self.amplitudes();
        numbers
            .iter()
            .enumerate()
            .filter_map(|(number, found)| {
                let (effect, hypotheses) = &self.hypotheses[number];
                let best = found.map(|(column, _)| column).or_else(|| self.best_column(number));
                let one = amplitudes.iter().find(|one| Some(one.column) == best)?;
                let info = effect.parameters().get(one.parameter)?;
                let scale = Scale::of(info);
                let value = found.map(|(_, by)| scale.outside(scale.inside(info.neutral) + by * one.step));
                let alike = found.map(|found| self.alike(number, found)).unwrap_or_default();
                let place = one.place.filter(|_| hypotheses.len() > 1);
                Some(NamedFrom { effect: *effect, parameter: one.parameter, value, place, alike })
            })
            .collect()
    }

    /// Direction of an effect that these data show best for its prior.
    fn best_column(&self, effect: usize) -> Option<usize> {
        let (_, hypotheses) = self.hypotheses.get(effect)?;
        let columns = hypotheses.iter().flat_map(|one| one.columns.iter().zip(&one.precisions));
        let best = columns
            .map(|(column, precision)| (self.gram[(*column, *column)] / precision, *column))
            .max_by(|a, b| a.0.total_cmp(&b.0))?;
        (best.0 > 0.0).then_some(best.1)
    }

    /// The direction and the amplitude from which on an effect is named with this probability; `None` if no amplitude in its range is.
    fn smallest(&self, effect: usize, needed: f64, probability: f64) -> Option<(usize, f64)> {
        let column = self.best_column(effect)?;
        let (tried_effect, hypotheses) = self.hypotheses.get(effect)?;
        let columns: Vec<usize> = hypotheses.iter().flat_map(|one| one.columns.iter().copied()).collect();
        let count = columns.len();
        let gram = DMatrix::from_fn(count, count, |i, j| self.gram[(columns[i], columns[j])]);
        let root = Random::root(&gram);
        let mut random = Random::new(SEED, effect as u64);
        let noises: Vec<DVector<f64>> = (0..DRAWS).map(|_| &root * random.normals(count)).collect();
        let prepared: Vec<Option<PreparedHypothesis>> =
            hypotheses.iter().map(|hypothesis| self.prepared(hypothesis)).collect();
        let is_named = |amplitude: f64, noise: &DVector<f64>| {
            let mut projections = DVector::zeros(self.gram.nrows());
            for (value, place) in noise.iter().zip(&columns) {
                projections[*place] = value + amplitude * self.gram[(*place, column)];
            }
            let alternatives = hypotheses.iter().zip(&prepared);
            let evidences =
                alternatives.map(|(one, prepared)| Self::log_evidence(one, prepared.as_ref(), &projections));
            mean_of_exponentials(evidences) >= needed
        };
        let power = |amplitude: f64| {
            noises.iter().filter(|noise| is_named(amplitude, noise)).count() as f64 / DRAWS as f64
        };
        let one = self.amplitudes().into_iter().find(|one| one.column == column)?;
        let info = tried_effect.parameters().get(one.parameter)?;
        let scale = Scale::of(info);
        let [_, most] = info.range.map(|end| scale.inside(end));
        let (mut low, mut high) = (0.0, (most - scale.inside(info.neutral)) / one.step);
        if !(high.is_finite() && high > 0.0) || power(high) < probability {
            return None;
        }
        for _ in 0..BISECTIONS {
            let middle = 0.5 * (low + high);
            if power(middle) < probability { low = middle } else { high = middle }
        }
        Some((column, high))
    }

    /// Other effects that these runs cannot distinguish from an effect of this amplitude.
    fn alike(&self, effect: usize, (column, amplitude): (usize, f64)) -> Vec<&'static str> {
        let square = self.gram[(column, column)];
        let is_alike = |other: usize| {
            let (_, hypotheses) = &self.hypotheses[other];
            hypotheses.iter().flat_map(|one| &one.columns).any(|other| {
                let (theirs, common) = (self.gram[(*other, *other)], self.gram[(column, *other)]);
                // Part of it that the other one cannot produce.
                theirs > 0.0 && amplitude * amplitude * (square - common * common / theirs) < indistinct()
            })
        };
        let similar = (0..self.hypotheses.len()).filter(|other| *other != effect && is_alike(*other));
        similar.map(|other| self.hypotheses[other].0.id()).collect()
    }
}
