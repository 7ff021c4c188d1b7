//! Random numbers of draws.

use nalgebra::{DMatrix, DVector};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal, StudentT};

/// A covariance that rounding has made indefinite is regular with so much more of each variance; ten times as much is tried up to the last.
const JITTERS: [f64; 4] = [0.0, 1e-12, 1e-9, 1e-6];

/// A stream of random numbers: the same for a seed on every machine.
pub struct Random(ChaCha8Rng);

impl Random {
    /// One of the independent streams of a seed.
    pub fn new(seed: u64, stream: u64) -> Self {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        random.set_stream(stream);
        Self(random)
    }

    /// From the normal distribution of mean 0 and standard deviation 1.
    pub fn normal(&mut self) -> f64 {
        StandardNormal.sample(&mut self.0)
    }

    /// From Student's t with so many degrees of freedom; without, from the normal distribution.
    pub fn student(&mut self, freedom: Option<f64>) -> f64 {
        match freedom.and_then(|freedom| StudentT::new(freedom).ok()) {
            Some(student) => student.sample(&mut self.0),
            None => self.normal(),
        }
    }

    /// Numbers of the members of a list with these weights, as many as requested. A list without weight has its first member only.
    pub fn choices(&mut self, weights: &[f64], count: usize) -> Vec<usize> {
        let total: f64 = weights.iter().map(|weight| weight.max(0.0)).sum();
        let mut choice = || {
            let mut remaining_weight = self.0.random::<f64>() * total;
            weights
                .iter()
                .position(|weight| {
                    remaining_weight -= weight.max(0.0);
                    remaining_weight < 0.0
                })
                .unwrap_or_default()
        };
        (0..count).map(|_| choice()).collect()
    }

    /// So many standard normal numbers.
    pub fn normals(&mut self, count: usize) -> DVector<f64> {
        DVector::from_fn(count, |_, _| self.normal())
    }

    /// Lower triangular root of a covariance whose entries may be of very different sizes; where rounding has made it indefinite that of
    /// its diagonal.
    pub fn root(covariance: &DMatrix<f64>) -> DMatrix<f64> {
        let sds = covariance.diagonal().map(|variance| variance.max(0.0).sqrt());
        let count = sds.len();
        let unit = DMatrix::from_fn(count, count, |i: usize, j: usize| {
            let scale = sds[i] * sds[j];
            if i == j {
                1.0
            } else if scale > 0.0 {
                covariance[(i, j)] / scale
            } else {
                0.0
            }
        });
        let factor = JITTERS.iter().find_map(|jitter| {
            let wider = &unit + DMatrix::identity(count, count) * *jitter;
            wider.cholesky().map(|factor| factor.unpack())
        });
        let mut root = factor.unwrap_or_else(|| DMatrix::identity(count, count));
        for (mut row, sd) in root.row_iter_mut().zip(sds.iter()) {
            row *= *sd;
        }
        root
    }
}

/// A positive quantity whose logarithm has the quantiles of a standard variate, stretched on each side so that its own quantile of 97.5 %,
/// `quantile`, falls on the end of an interval: how an interval that was printed becomes a distribution.
pub fn two_piece(value: f64, [low, high]: [f64; 2], standard: f64, quantile: f64) -> f64 {
    let reach = if standard < 0.0 { (value / low).ln() } else { (high / value).ln() };
    value * (standard / quantile * reach.max(0.0)).exp()
}
