//! Calibration of posteriors: where the truth lies among draws, and whether it lies there as chance has it.
//!
//! The share of draws below the truth (probability integral transform, PIT) is uniform over sessions where a posterior is calibrated. Its
//! empirical distribution function is compared with a band that holds all of it in 95 % of calibrated posteriors, simultaneously at every
//! place: Säilynoja, Bürkner and Vehtari, "Graphical test for discrete uniformity and its applications in goodness-of-fit evaluation and
//! multiple sample comparison" (2022), by simulation. Talts and others, "Validating Bayesian inference algorithms with simulation-based calibration" (2018).

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use statrs::distribution::{Binomial, DiscreteCDF};

/// Places at which a distribution function is compared with its band: a hundredth apart nothing is missed that a figure shows.
const PLACES: usize = 100;
/// Simulated samples behind a band: the coverage of the band is exact to half a per cent (one standard deviation).
const SAMPLES: usize = 2000;
/// Coverage of the band, all places together.
const COVERAGE: f64 = 0.95;

/// Share of draws below a value. Draws equal to it count as a random part of them, so that the result is uniform where value and draws
/// are of one distribution; `uniform` is a number from 0 to 1.
pub fn pit(draws: &[f64], value: f64, uniform: f64) -> f64 {
    let smaller = draws.iter().filter(|draw| **draw < value).count() as f64;
    let equal = draws.iter().filter(|draw| **draw == value).count() as f64;
    (smaller + uniform * (equal + 1.0)) / (draws.len() as f64 + 1.0)
}

/// A band about the diagonal for the distribution function of uniform values.
#[derive(Debug, Clone, PartialEq)]
pub struct Band {
    /// Places, 0 to 1.
    pub at: Vec<f64>,
    /// Lowest share of values below each place.
    pub low: Vec<f64>,
    /// Highest share.
    pub high: Vec<f64>,
}

/// A place where a distribution function leaves its band.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BandExit {
    /// Place, 0 to 1.
    pub at: f64,
    /// Share of values below it, less the place.
    pub by: f64,
}

impl Band {
    /// The band for so many values.
    pub fn new(count: usize, seed: u64) -> Self {
        let quantiles: Vec<f64> = (1..PLACES).map(|place| place as f64 / PLACES as f64).collect();
        let binomials: Vec<Binomial> =
            quantiles.iter().filter_map(|place| Binomial::new(*place, count as u64).ok()).collect();
        // Two-sided tail probability of every possible number of values below every place.
        let tails: Vec<Vec<f64>> = binomials.iter().map(|binomial| tails(binomial, count)).collect();
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let mut least: Vec<f64> = (0..SAMPLES)
            .map(|_| {
                let values: Vec<f64> = (0..count).map(|_| random.random()).collect();
                let counts = counts_below(&values, &quantiles);
                let of_places = counts.iter().zip(&tails).filter_map(|(count, tails)| tails.get(*count));
                of_places.copied().fold(1.0, f64::min)
            })
            .collect();
        least.sort_by(f64::total_cmp);
        let level = least.get(((1.0 - COVERAGE) * SAMPLES as f64) as usize).copied().unwrap_or(0.0);
        let (low, high) = tails.iter().map(|tails| ends_at(level, tails, count)).unzip();
        Self { at: quantiles, low, high }
    }

    /// The place where values leave the band by most; nothing where they stay inside.
    pub fn departure(&self, values: &[f64]) -> Option<BandExit> {
        let fractions = shares_below(values, &self.at);
        let rounding = 1e-9;
        let exits = fractions.iter().zip(&self.at).zip(self.low.iter().zip(&self.high)).filter_map(
            |((share, at), (low, high))| {
                let distance = (low - share).max(share - high);
                (distance > rounding).then_some((distance, BandExit { at: *at, by: share - at }))
            },
        );
        exits.max_by(|a, b| a.0.total_cmp(&b.0)).map(|(_, departure)| departure)
    }
}

/// Least and largest fraction of values below a place whose tail probability is at least this level.
fn ends_at(level: f64, tails: &[f64], count: usize) -> (f64, f64) {
    let first = tails.iter().position(|tail| *tail >= level).unwrap_or(0);
    let last = tails.iter().rposition(|tail| *tail >= level).unwrap_or(count);
    let count = count.max(1) as f64;
    (first as f64 / count, last as f64 / count)
}

/// Probability, for every number of values below a place, of a number as unlikely on this side, twice.
fn tails(binomial: &Binomial, count: usize) -> Vec<f64> {
    (0..=count as u64)
        .map(|number| {
            let lower = binomial.cdf(number);
            let upper = number.checked_sub(1).map_or(1.0, |below| binomial.sf(below));
            (2.0 * lower.min(upper)).min(1.0)
        })
        .collect()
}

fn counts_below(values: &[f64], at: &[f64]) -> Vec<usize> {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    at.iter().map(|place| sorted.partition_point(|value| value <= place)).collect()
}

/// Share of values at or below each place.
pub fn shares_below(values: &[f64], at: &[f64]) -> Vec<f64> {
    let count = values.len().max(1) as f64;
    counts_below(values, at).into_iter().map(|number| number as f64 / count).collect()
}

/// Share of values in the middle interval of this probability.
pub fn inside(values: &[f64], probability: f64) -> f64 {
    let tail = 0.5 * (1.0 - probability);
    let inside_count = values.iter().filter(|value| (tail..=1.0 - tail).contains(*value)).count();
    inside_count as f64 / values.len().max(1) as f64
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand_distr::{Distribution, StandardNormal};

    fn uniform(count: usize, seed: u64) -> Vec<f64> {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        (0..count).map(|_| random.random()).collect()
    }

    #[test]
    fn the_band_holds_as_many_uniform_samples_as_it_states() {
        for count in [40, 200] {
            let band = Band::new(count, 1);
            let exit_count =
                (0..1000).filter(|seed| band.departure(&uniform(count, 10 + seed)).is_some()).count();
            // 5 % of 1000, give or take four standard deviations of this number and of the band's own level.
            assert!((15..=85).contains(&exit_count), "{exit_count} of 1000 samples of {count} left the band");
        }
    }

    #[test]
    fn posteriors_that_are_too_narrow_or_biased_leave_the_band() {
        let mut random = ChaCha8Rng::seed_from_u64(3);
        let band = Band::new(200, 1);
        let mut normal = || -> f64 { StandardNormal.sample(&mut random) };
        let draws: Vec<f64> = (0..1000).map(|_| normal()).collect();
        for (scale, shift, is_calibrated) in [(1.0, 0.0, true), (2.0, 0.0, false), (1.0, 0.7, false)] {
            let values: Vec<f64> = (0..200).map(|_| pit(&draws, scale * normal() + shift, 0.5)).collect();
            assert_eq!(band.departure(&values).is_none(), is_calibrated, "{scale} {shift}");
        }
    }

    #[test]
    fn draws_that_equal_the_truth_are_a_random_part_of_those_below() {
        assert_eq!(pit(&[1.0, 2.0, 2.0, 3.0], 2.0, 0.0), 0.2);
        assert_eq!(pit(&[1.0, 2.0, 2.0, 3.0], 2.0, 1.0), 0.8);
        assert!((inside(&[0.01, 0.3, 0.5, 0.99], 0.95) - 0.5).abs() < 1e-12);
    }
}
