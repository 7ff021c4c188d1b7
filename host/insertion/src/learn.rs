//! Learning from earlier insertions of the same rig and tissue: empirical Bayes (theory, eq. 44).
//!
//! The scales of the unknowns' parts ([`Scales`](super::scales::Scales)) and the probabilities of modulus and gap
//! follow from the evidence of the earlier insertions. The evidence has one top, or several: each is climbed (Gauss and
//! Newton for modulus and gap, a quasi-Newton method for the scales), and around each a grid in the principal axes of
//! its curvature covers whatever weighs anything. Draws of scales and grid points, weighted by their posterior, then
//! stand for it: what is predicted integrates over all of it.

use super::candidates::Candidates;
use super::evidence::{Evidence, System};
use super::fold::Fold;
use super::learned::{Learned, Part, Start};
use super::path::TipPath;
use super::quadrature::{GridPoint, cumulative_shares};
use super::scales::ReadingNoise;
use super::weights::tempering;
use std::collections::HashMap;

/// Learns from the recordings `earlier` (numbers among `paths`).
///
/// If there are none, the scales of the unknowns are searched near those that suit the readings of the insertion
/// itself, `next`; no other information is taken from it. `paths` are those the candidates were made for, each as far
/// as it may be used.
pub fn learn(
    candidates: &Candidates,
    paths: &[TipPath],
    earlier: &[usize],
    next: usize,
    noise: ReadingNoise,
) -> Learned {
    learn_from(candidates, paths, earlier, next, noise, None)
}

/// The same, with the search beginning where [`start`] ended for recordings of the same session.
pub fn learn_from(
    candidates: &Candidates,
    paths: &[TipPath],
    earlier: &[usize],
    next: usize,
    noise: ReadingNoise,
    start: Option<&Start>,
) -> Learned {
    let alone = earlier.is_empty();
    let training: &[usize] = if alone { &[next] } else { earlier };
    let (fold, start) = Fold::new(candidates, paths, training, noise, start);
    let tops = fold.tops(&start);
    let Some(best) = tops.first() else {
        return Learned { scales: Vec::new(), parts: Vec::new(), nodes: Vec::new() };
    };
    let grid = fold.grid(&tops);
    if grid.is_empty() {
        return Learned { scales: Vec::new(), parts: Vec::new(), nodes: Vec::new() };
    }
    let mut learned = Learned { scales: Vec::new(), parts: Vec::new(), nodes: Vec::new() };
    let cumulative_weights = cumulative_shares(&grid);
    let mut number_of: HashMap<usize, usize> = HashMap::new();
    for (number, (draw, ln_drawn)) in fold.draws(best).into_iter().enumerate() {
        let ln_scales = -0.5 * draw.iter().map(|x| x * x).sum::<f64>();
        // Candidates in proportion to their share, evenly among the draws: multiples of the golden ratio.
        let draw_position = (number as f64 * GOLDEN_RATIO).fract();
        let drawn = cumulative_weights
            .partition_point(|(end, _)| *end <= draw_position)
            .min(cumulative_weights.len() - 1);
        let GridPoint { solved, ln_area, .. } = &grid[drawn];
        let scales = fold.scales(&draw, solved);
        let used_systems: Vec<&[System]> =
            if alone { Vec::new() } else { solved.systems.iter().map(Vec::as_slice).collect() };
        let Some(evidence) = Evidence::new(&candidates.layout, &used_systems, &scales, false) else {
            continue;
        };
        let ln_weight =
            solved.ln_prior + ln_area + ln_scales + evidence.ln - ln_drawn - cumulative_weights[drawn].1;
        let node = *number_of.entry(drawn).or_insert_with(|| {
            learned.nodes.push(solved.node(candidates, next));
            learned.nodes.len() - 1
        });
        let normals = evidence.next(&candidates.layout, &scales);
        learned.parts.push(Part { node, scales: learned.scales.len(), ln_weight, normals });
        learned.scales.push(scales);
    }
    let ln_weights: Vec<f64> = learned.parts.iter().map(|part| part.ln_weight).collect();
    let power = tempering(&ln_weights);
    learned.parts.iter_mut().for_each(|part| part.ln_weight *= power);
    // The weight of a part before the insertion begins has little meaning if it was drawn to suit the insertion
    // itself.
    if !alone {
        let most = learned.parts.iter().map(|part| part.ln_weight).fold(f64::NEG_INFINITY, f64::max);
        learned.parts.retain(|part| part.ln_weight > most - MIN_LN_WEIGHT);
    }
    learned
}

/// Start of the search for every fold of a session: from what is known of all its recordings up to the depth from which
/// they are predicted, so that nothing beyond it plays a part.
pub fn start(candidates: &Candidates, observed: &[TipPath], noise: ReadingNoise) -> Option<Start> {
    let training: Vec<usize> = (0..observed.len()).collect();
    let (fold, start) = Fold::new(candidates, observed, &training, noise, None);
    let tops = fold.tops(&start);
    let likeliest = tops.first()?.likeliest.clone();
    let candidates = tops.iter().map(|top| top.solved.candidate).collect();
    Some(Start { candidates, likeliest })
}

/// Parts further behind than this (natural logarithm) before an insertion begins are given up.
const MIN_LN_WEIGHT: f64 = 7.0;
/// Evenly spread draws are multiples of it.
const GOLDEN_RATIO: f64 = 0.618_033_988_749_894_8;
