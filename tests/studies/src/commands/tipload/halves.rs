//! Whether the first and the second half of a session agree on tip load and modulus.

use super::{NORMAL_975, draw::World};
use anyhow::Result;
use formats::session::Session;
use inference::predict::{Options, predict};
use std::ops::Range;

/// Sessions of fewer insertions are not split: a half learns from at least one other insertion.
const MIN_INSERTIONS: usize = 4;

/// An estimate from one half: logarithm and its standard deviation.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Estimate {
    ln: f64,
    sd: f64,
}

/// Agreement of two halves.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Agreement {
    /// Whether the 95 % intervals overlap: tip load, modulus.
    pub overlap: [bool; 2],
    /// Difference over its standard deviation.
    pub difference: [f64; 2],
}

/// Compares the halves of a session; `None` where there are too few insertions.
///
/// # Errors
/// Where a half cannot be predicted.
pub fn agreement(world: &World, options: &Options) -> Result<Option<Agreement>> {
    let count = world.session.insertion.len();
    if count < MIN_INSERTIONS {
        return Ok(None);
    }
    let halves = [0..count / 2, count / 2..count];
    let [first, second] = halves.map(|numbers| half(&world.session, numbers, options));
    let (Some(first), Some(second)) = (first?, second?) else { return Ok(None) };
    let mut agreement = Agreement { overlap: [false; 2], difference: [0.0; 2] };
    for (i, (a, b)) in first.into_iter().zip(second).enumerate() {
        let ln_distance = (a.ln - b.ln).abs();
        agreement.overlap[i] = ln_distance <= NORMAL_975 * (a.sd + b.sd);
        agreement.difference[i] = ln_distance / a.sd.hypot(b.sd);
    }
    Ok(Some(agreement))
}

/// Tip load and modulus of some insertions of a session, as these alone give them. Most unknown parameters are common
/// to them: the standard deviation is that of one, not of a mean of independent ones.
fn half(session: &Session, numbers: Range<usize>, options: &Options) -> Result<Option<[Estimate; 2]>> {
    let insertion = session.insertion.get(numbers).unwrap_or_default().to_vec();
    let prediction = predict(&Session { insertion, ..session.clone() }, options)?;
    let estimates: Vec<[Estimate; 2]> = prediction
        .insertions
        .iter()
        .filter_map(|one| {
            let learned = one.learned.as_ref()?;
            let (y_n, x_n) = (one.tip_force_n?, one.tip_force_x_n?);
            let load_n = y_n.hypot(x_n);
            let sd_n = (y_n * one.tip_force_sd_n?).hypot(x_n * one.tip_force_x_sd_n?) / load_n;
            let [low_kpa, high_kpa] = learned.k_ci95_kpa;
            let modulus =
                Estimate { ln: learned.k_kpa.ln(), sd: (high_kpa / low_kpa).ln() / (2.0 * NORMAL_975) };
            Some([Estimate { ln: load_n.ln(), sd: sd_n / load_n }, modulus])
        })
        .collect();
    let count = estimates.len() as f64;
    Ok((!estimates.is_empty())
        .then(|| [mean_estimate(0, &estimates, count), mean_estimate(1, &estimates, count)]))
}

fn mean_estimate(i: usize, estimates: &[[Estimate; 2]], count: f64) -> Estimate {
    Estimate {
        ln: estimates.iter().map(|one| one[i].ln).sum::<f64>() / count,
        sd: (estimates.iter().map(|one| one[i].sd.powi(2)).sum::<f64>() / count).sqrt(),
    }
}
