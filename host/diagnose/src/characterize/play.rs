//! Play and friction of a rig without a measured shape.
//!
//! In the force, a play and a friction of opposite sign differ only after a reversal: friction reverses at once, play only after twice
//! its half width. Their difference grows with the play. The likelihood is therefore far from that of a linear model: it is flat
//! over many values of the play and may have several maxima. So all other parameters are fitted at every value of the play on a
//! grid, and intervals are those of the profile likelihood at 95 %.

use crate::evidence::Patterns;
use crate::known::KnownParameter;
use crate::layout::{Layout, NORMAL_975, Prepared, prior};
use crate::posterior::{Fitted, MAX_ROUNDS};
use nalgebra::{DMatrix, DVector};
use readings::FitError;

const EFFECT: &str = "rig.play";
/// First half widths of the play at which the other parameters are fitted, mm, and the standard deviation of the prior that fixes it.
const FIRST_MM: [f64; 9] = [0.0, 0.01, 0.02, 0.04, 0.07, 0.12, 0.2, 0.3, 0.45];
const GIVEN_SD_MM: f64 = 1e-4;
/// Further half widths around that of the free fit, in its standard deviations, and distance below which two are the same.
const AROUND_SD: [f64; 3] = [-2.0, 0.0, 2.0];
const SAME_MM: f64 = 1e-3;
/// The grid is refined between two neighbours if the log density of one of them is within [`LIKELY`] of the largest, and their distance is
/// above this fraction of the standard deviation or their log densities differ by more than [`DIFFERENT`].
const LIKELY: f64 = 6.0;
const SHARE_OF_SD: f64 = 0.7;
const DIFFERENT: f64 = 1.5;
/// Largest number of values of the play.
const MAX_PLAYS: usize = 48;

/// A value of the play, the logarithm of its posterior density, and the fit of the other parameters.
struct Node {
    play_mm: f64,
    ln_density: f64,
    fit: Fitted,
}

/// The fit with values, standard deviations and correlations over all values of the play; unchanged if the play is not among its effects.
///
/// # Errors
/// [`FitError`] where there is no fit.
pub(super) fn over_plays(
    layout: &Layout,
    runs: &[Prepared],
    patterns: &Patterns,
    fitted: Fitted,
) -> Result<Fitted, FitError> {
    let Some(index) = layout.effects.iter().position(|effect| effect.id() == EFFECT) else {
        return Ok(fitted);
    };
    let Some(info) = layout.effects[index].parameters().first() else { return Ok(fitted) };
    let prior_before = prior(info);
    let node_at = |play_mm: f64| -> Result<Node, FitError> {
        let mut values = fitted.values().to_vec();
        values[layout.first_of(index)] = play_mm;
        let fixed_play = KnownParameter {
            effect: EFFECT.to_owned(),
            parameter: info.name.to_owned(),
            value: play_mm,
            sd: GIVEN_SD_MM,
        };
        let other_known = layout.known.iter().filter(|known| !known.is_of(EFFECT, info.name)).cloned();
        let layout = Layout { known: other_known.chain([fixed_play]).collect(), ..layout.clone() };
        let fit = Fitted::new(&layout, runs, patterns, &values, &fitted.sizes, MAX_ROUNDS)?;
        let ln_density = fit.log_evidence - 0.5 * ((play_mm - prior_before.mean) / prior_before.sd).powi(2);
        Ok(Node { play_mm, ln_density, fit })
    };
    // Values around the free fit are added, because it may have found a larger play.
    let (own_play_mm, sd_mm) = (fitted.values()[layout.first_of(index)], fitted.sd(layout.first_of(index)));
    let nearby_mm = AROUND_SD.map(|sds| (own_play_mm + sds * sd_mm).clamp(info.range[0], info.range[1]));
    let mut first_mm: Vec<f64> = FIRST_MM.into_iter().chain(nearby_mm).collect();
    first_mm.sort_by(f64::total_cmp);
    first_mm.dedup_by(|a, b| (*a - *b).abs() < SAME_MM);
    let mut nodes = first_mm.into_iter().map(&node_at).collect::<Result<Vec<_>, _>>()?;
    loop {
        let refinements_mm = to_refine(&nodes);
        if refinements_mm.is_empty() || nodes.len() + refinements_mm.len() > MAX_PLAYS {
            break;
        }
        for play_mm in refinements_mm {
            nodes.push(node_at(play_mm)?);
        }
        nodes.sort_by(|a, b| a.play_mm.total_cmp(&b.play_mm));
    }
    let (values, sds) = profile(&nodes, layout.first_of(index));
    // The correlations are those of the posterior over all values of the play.
    let covariance = moments(&nodes);
    let scales: Vec<f64> =
        (0..sds.len()).map(|i| sds[i] / covariance[(i, i)].sqrt().max(f64::MIN_POSITIVE)).collect();
    let scaled = DMatrix::from_fn(sds.len(), sds.len(), |i, j| covariance[(i, j)] * scales[i] * scales[j]);
    Ok(fitted.with_moments(values, scaled))
}

/// Middle of the profile interval of every parameter, and the standard deviation of the normal distribution with this interval. `own` is
/// the index of the play.
fn profile(nodes: &[Node], own: usize) -> (Vec<f64>, Vec<f64>) {
    let most = nodes.iter().map(|node| node.ln_density).fold(f64::NEG_INFINITY, f64::max);
    // The square of 1.96 less twice the decrease of the log density at each node.
    let remainders: Vec<f64> =
        nodes.iter().map(|node| NORMAL_975 * NORMAL_975 - 2.0 * (most - node.ln_density)).collect();
    let count = nodes.first().map_or(0, |node| node.fit.values().len());
    let mut intervals = vec![[f64::INFINITY, f64::NEG_INFINITY]; count];
    for (node, remainder) in nodes.iter().zip(&remainders).filter(|(_, remainder)| **remainder >= 0.0) {
        for (i, [low, high]) in intervals.iter_mut().enumerate() {
            let (value, half) = (node.fit.values()[i], remainder.sqrt() * node.fit.sd(i));
            (*low, *high) = (low.min(value - half), high.max(value + half));
        }
    }
    // The ends of the interval of the play are interpolated between nodes.
    if let Some([low, high]) = intervals.get_mut(own) {
        for (pair, remainders) in nodes.windows(2).zip(remainders.windows(2)) {
            let ([a, b], [start_remainder, end_remainder]) = (pair, remainders) else { continue };
            if start_remainder * end_remainder < 0.0 {
                let end_mm =
                    a.play_mm + (b.play_mm - a.play_mm) * start_remainder / (start_remainder - end_remainder);
                (*low, *high) = (low.min(end_mm), high.max(end_mm));
            }
        }
    }
    intervals.into_iter().map(|[low, high]| (0.5 * (low + high), 0.5 * (high - low) / NORMAL_975)).unzip()
}

/// Further values of the play, between neighbours where the grid is too coarse.
fn to_refine(nodes: &[Node]) -> Vec<f64> {
    let most = nodes.iter().map(|node| node.ln_density).fold(f64::NEG_INFINITY, f64::max);
    let weights = weights(nodes);
    let mean_mm: f64 = nodes.iter().zip(&weights).map(|(node, weight)| weight * node.play_mm).sum();
    let deviation_mm =
        nodes.iter().zip(&weights).map(|(node, weight)| weight * (node.play_mm - mean_mm).powi(2));
    let sd_mm = deviation_mm.sum::<f64>().sqrt();
    let pairs = nodes.iter().zip(nodes.iter().skip(1));
    let coarse = pairs.filter(|(a, b)| {
        let is_likely = a.ln_density.max(b.ln_density) > most - LIKELY;
        let differs = (a.ln_density - b.ln_density).abs() > DIFFERENT;
        is_likely && (differs || b.play_mm - a.play_mm > SHARE_OF_SD * sd_mm)
    });
    coarse.map(|(a, b)| 0.5 * (a.play_mm + b.play_mm)).collect()
}

/// Probability of every node: its density times the width of its cell.
fn weights(nodes: &[Node]) -> Vec<f64> {
    let most = nodes.iter().map(|node| node.ln_density).fold(f64::NEG_INFINITY, f64::max);
    let weights: Vec<f64> = nodes
        .iter()
        .enumerate()
        .map(|(i, node)| {
            let earlier = i.checked_sub(1).and_then(|i| nodes.get(i)).unwrap_or(node);
            let later = nodes.get(i + 1).unwrap_or(node);
            (node.ln_density - most).exp() * (later.play_mm - earlier.play_mm)
        })
        .collect();
    let sum: f64 = weights.iter().sum();
    weights.into_iter().map(|weight| weight / sum).collect()
}

/// Covariance of the parameters over all values of the play.
fn moments(nodes: &[Node]) -> DMatrix<f64> {
    let weights = weights(nodes);
    let count = nodes.first().map_or(0, |node| node.fit.values().len());
    let mut mean = DVector::zeros(count);
    for (node, weight) in nodes.iter().zip(&weights) {
        mean.axpy(*weight, &DVector::from_column_slice(node.fit.values()), 1.0);
    }
    let mut covariance = DMatrix::zeros(count, count);
    for (node, weight) in nodes.iter().zip(&weights) {
        let deviation = DVector::from_column_slice(node.fit.values()) - &mean;
        covariance += *weight * (&node.fit.covariance + &deviation * deviation.transpose());
    }
    covariance
}
