//! Random numbers of the generators, and of studies that use them.

use rand::{Rng, RngExt};
use rand_distr::{Distribution, StandardNormal};

/// Standard normal.
pub fn normal(random: &mut impl Rng) -> f64 {
    StandardNormal.sample(random)
}

/// Uniform from `low` on to below `high`.
pub fn uniform(low: f64, high: f64, random: &mut impl Rng) -> f64 {
    low + (high - low) * random.random::<f64>()
}
