//! Gauss-Legendre quadrature with ten points per panel.

/// Nodes and weights on (-1, 1); each node stands for itself and its negative.
const NODES: [(f64, f64); 5] = [
    (0.148_874_338_981_631_2, 0.295_524_224_714_752_87),
    (0.433_395_394_129_247_2, 0.269_266_719_309_996_35),
    (0.679_409_568_299_024_4, 0.219_086_362_515_982_04),
    (0.865_063_366_688_984_5, 0.149_451_349_150_580_6),
    (0.973_906_528_517_171_7, 0.066_671_344_308_688_14),
];

/// Points and weights for an integral over one panel.
pub fn points(from: f64, to: f64) -> impl Iterator<Item = (f64, f64)> {
    let (mid, half) = (0.5 * (from + to), 0.5 * (to - from));
    NODES
        .into_iter()
        .flat_map(move |(x, weight)| [(mid - x * half, weight * half), (mid + x * half, weight * half)])
}

/// Integral in panels no longer than `panel`.
pub fn integrate(from: f64, to: f64, panel: f64, of: impl Fn(f64) -> f64) -> f64 {
    let count = ((to - from) / panel).ceil().max(1.0);
    let length = (to - from) / count;
    (0..count as usize)
        .map(|i| from + i as f64 * length)
        .flat_map(|start| points(start, start + length))
        .map(|(at, weight)| weight * of(at))
        .sum()
}
