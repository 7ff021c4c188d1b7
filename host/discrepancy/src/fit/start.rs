//! Where a fit begins, and what is known of its noise beforehand.

use crate::basis::Basis;
use crate::bench::Bench;
use crate::noise::Noise;

/// Shortest memory of a correlated noise, in distances of readings, and longest, as a fraction of a run: neither shorter nor longer ones
/// differ from white noise and from an offset of the run.
const SHORTEST_MEMORY: f64 = 1.0;
const LONGEST_MEMORY: f64 = 0.25;

/// Start of a fit.
#[derive(Clone)]
pub(crate) struct Start {
    pub values: Vec<f64>,
    pub noises: Vec<Noise>,
    pub sizes: Vec<f64>,
}

impl Start {
    /// At the prior means, with noise of the size of the residuals.
    pub fn plain(bench: &Bench<'_>, basis: &Basis) -> Self {
        let values = bench.coordinates(&[]).iter().map(|coordinate| coordinate.mean).collect();
        let noises = memories(bench).into_iter().map(|[shortest_s, longest_s]| Noise {
            sd: 0.3,
            correlated: 0.5,
            memory_s: (shortest_s * longest_s).sqrt(),
        });
        Self { values, noises: noises.collect(), sizes: basis.everyday() }
    }
}

fn duration(times: &[f64]) -> f64 {
    times.last().zip(times.first()).map_or(0.0, |(last, first)| last - first)
}

/// The range of memories of each channel's noise.
pub(super) fn memories(bench: &Bench<'_>) -> Vec<[f64; 2]> {
    (0..bench.scales.len())
        .map(|channel| {
            let (mut longest, mut shortest_step) = (0.0, f64::INFINITY);
            let segments = bench.training.iter().flat_map(|run| &run.segments);
            for segment in segments.filter(|segment| segment.channel == channel) {
                let duration_s = duration(&segment.time_s);
                let steps = segment.time_s.len().saturating_sub(1).max(1);
                longest = f64::max(longest, duration_s);
                shortest_step = f64::min(shortest_step, duration_s / steps as f64);
            }
            let shortest = SHORTEST_MEMORY * shortest_step.clamp(1e-12, 1e12);
            [shortest, (LONGEST_MEMORY * longest).max(2.0 * shortest)]
        })
        .collect()
}
