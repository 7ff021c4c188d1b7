//! Imperfections of an ordinary laboratory: several together, so small that a plain rig measured with them passes unnoticed.

use super::background::{Background, Imperfection};
use super::gap::misfit;
use super::{Design, Truth};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Number of kinds that come together.
const TOGETHER: [usize; 2] = [4, 7];
/// Excess of chi-square per reading, the modulus adapted, that passes unnoticed.
const UNNOTICED: f64 = 0.07;
/// Draws before a set that would be noticed is made smaller.
const DRAWS: usize = 20;
const SMALLER: f64 = 0.85;

impl Background {
    /// Several kinds at once, of ordinary sizes. Those of lateral runs are so small together that `design` measures a plain rig with
    /// a chi-square per reading of at most 1.07; those of insertions come in addition where the design has insertions.
    pub fn drawn(truth: &Truth, design: &Design, seed: u64) -> Self {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let plain = Truth { effects: Vec::new(), foreign: None, ..truth.clone() };
        let lateral_only = Design { insertion: Vec::new(), ..design.clone() };
        let mut lateral = Self { parts: Vec::new(), seed };
        if !design.lateral.is_empty() {
            for _ in 0..DRAWS {
                lateral.parts = chosen(&mut random, 0);
                if lateral.excess(&plain, &lateral_only) <= UNNOTICED {
                    break;
                }
            }
            while lateral.excess(&plain, &lateral_only) > UNNOTICED {
                lateral = lateral.times(SMALLER);
            }
        }
        if !design.insertion.is_empty() {
            let more = chosen(&mut random, 1);
            let more: Vec<_> = more
                .into_iter()
                .filter(|(kind, _)| lateral.parts.iter().all(|(other, _)| other != kind))
                .collect();
            lateral.parts.extend(more);
        }
        lateral
    }

    /// Increase of the chi-square per reading of a session after the modulus has adapted.
    pub fn excess(&self, truth: &Truth, design: &Design) -> f64 {
        let misfit = misfit(truth, self, truth, design);
        misfit.per_reading
    }
}

/// Some kinds of lateral runs (0) or of insertions (1), with sizes.
fn chosen(random: &mut ChaCha8Rng, scope: usize) -> Vec<(Imperfection, f64)> {
    let mut remaining: Vec<Imperfection> =
        Imperfection::all().filter(|kind| kind.shows_in()[scope]).collect();
    let count = random.random_range(TOGETHER[0]..=TOGETHER[1]);
    let mut imperfections = Vec::new();
    while imperfections.len() < count && !remaining.is_empty() {
        let kind = remaining.swap_remove(random.random_range(0..remaining.len()));
        let [low, high] = kind.sizes();
        imperfections.push((kind, low + (high - low) * random.random::<f64>()));
    }
    imperfections
}
