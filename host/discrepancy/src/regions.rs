//! Regions where measured and predicted values differ: intervals of a coordinate whose mean residual is significant.

use super::basis::Basis;
use super::bench::Bench;
use super::data::TIME;
use super::fit::{Fitted, whitened};
use super::noise::Noise;
use nalgebra::DMatrix;
use serde::Serialize;
use statrs::distribution::{ContinuousCDF, Normal};
use std::ops::Range;

/// Largest number of bins of a coordinate.
const BINS: usize = 12;
/// Upper bound of the probability that noise and typical discrepancy cause any region (Bonferroni).
const LEVEL: f64 = 0.01;

/// An interval of a coordinate with a significant mean residual.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Region {
    /// Channel.
    pub channel: String,
    /// Its unit.
    pub unit: String,
    /// Column of the data.
    pub coordinate: String,
    /// Smallest coordinate.
    pub from: f64,
    /// Largest coordinate.
    pub to: f64,
    /// Mean residual, measured less predicted.
    pub mean: f64,
    /// The mean in standard deviations of noise and typical discrepancy.
    pub sigma: f64,
}

/// Bins of one coordinate in one channel, and the number of their first column.
struct Scan {
    channel: usize,
    coordinate: String,
    edges: Vec<[f64; 2]>,
    first: usize,
}

/// Regions of a fit in the runs that were fitted, most significant first, at most one per channel and coordinate, for noise with these
/// parameters.
pub(crate) fn regions(
    bench: &Bench<'_>,
    basis: &Basis,
    fitted: &Fitted,
    noises: &[Noise],
) -> Option<Vec<Region>> {
    let coordinates = bench.coordinates(&fitted.laws);
    let count = coordinates.len();
    let mut columns: Vec<DMatrix<f64>> = fitted.jacobian.clone();
    for matrix in &mut columns {
        for (mut column, coordinate) in matrix.column_iter_mut().zip(&coordinates) {
            column *= coordinate.sd;
        }
    }
    let scans = scans(bench, count, &mut columns);
    for (matrix, residuals) in columns.iter_mut().zip(&fitted.residuals) {
        let last = matrix.ncols();
        *matrix = std::mem::replace(matrix, DMatrix::zeros(0, 0)).insert_column(last, 0.0);
        matrix.set_column(last, residuals);
    }
    let (patterns, products, _) = whitened(bench, basis, noises, &columns);
    let metric = patterns.in_metric(&basis.everyday(), &products)?;
    let remaining_count = metric.nrows() - count;
    let parameter_block = metric.view((0, 0), (count, count)) + DMatrix::identity(count, count);
    let cross_block = metric.view((0, count), (count, remaining_count)).into_owned();
    let mut reduced = metric.view((count, count), (remaining_count, remaining_count)).into_owned();
    reduced.gemm_tr(-1.0, &cross_block, &parameter_block.cholesky()?.solve(&cross_block), 1.0);
    let interval_count: usize = scans.iter().map(|scan| scan.edges.len() * (scan.edges.len() + 1) / 2).sum();
    let threshold = Normal::standard().inverse_cdf(1.0 - 0.5 * LEVEL / interval_count.max(1) as f64);
    let regions = scans.iter().filter_map(|scan| {
        let (bins, sigma, mean) =
            best_interval(&reduced, scan.first - count, scan.edges.len(), remaining_count - 1)?;
        let channel = bench.data.channels().get(scan.channel)?;
        let region = Region {
            channel: channel.name.clone(),
            unit: channel.unit.clone(),
            coordinate: scan.coordinate.clone(),
            from: scan.edges.get(bins.start)?[0],
            to: scan.edges.get(bins.end - 1)?[1],
            mean: mean * bench.scales.get(scan.channel)?,
            sigma,
        };
        (sigma.abs() > threshold).then_some(region)
    });
    let mut regions: Vec<Region> = regions.collect();
    regions.sort_by(|a, b| b.sigma.abs().total_cmp(&a.sigma.abs()));
    Some(regions)
}

/// Adds a column per bin of every coordinate of every channel.
fn scans(bench: &Bench<'_>, first: usize, columns: &mut [DMatrix<f64>]) -> Vec<Scan> {
    let known_columns = bench.data.runs().first().map_or(&[][..], |run| run.columns.as_slice());
    let names = std::iter::once(TIME).chain(known_columns.iter().map(|column| column.name.as_str()));
    let (mut scans, mut next) = (Vec::new(), first);
    for name in names {
        let values: Vec<Vec<f64>> = bench.training.iter().filter_map(|run| run.column(name)).collect();
        for channel in 0..bench.scales.len() {
            let of_channel = bench.training.iter().zip(&values).flat_map(|(run, values)| {
                let rows = run.rows_of(channel);
                values.get(rows).unwrap_or(&[]).iter().map(|value| Some(*value))
            });
            let edges = edges(&of_channel.collect::<Vec<_>>(), BINS);
            if edges.len() < 2 {
                continue;
            }
            for ((run, values), matrix) in bench.training.iter().zip(&values).zip(columns.iter_mut()) {
                let grown = std::mem::replace(matrix, DMatrix::zeros(0, 0));
                *matrix = grown.resize_horizontally(next + edges.len(), 0.0);
                for row in run.rows_of(channel) {
                    if let Some(value) = values.get(row) {
                        matrix[(row, next + bin_of(&edges, *value))] = 1.0;
                    }
                }
            }
            let count = edges.len();
            scans.push(Scan { channel, coordinate: name.to_owned(), edges, first: next });
            next += count;
        }
    }
    scans
}

/// Smallest and largest value of each bin of a coordinate: one bin per distinct value if there are at most `bins` of them, else bins of
/// about equal counts. A value that repeats across a quantile has one bin, so that there may be fewer.
pub fn edges(values: &[Option<f64>], bins: usize) -> Vec<[f64; 2]> {
    let mut sorted: Vec<f64> = values.iter().flatten().copied().collect();
    sorted.sort_by(f64::total_cmp);
    let (Some(first), Some(last)) = (sorted.first(), sorted.last()) else { return Vec::new() };
    let close = 1e-3 * (last - first);
    let mut distinct: Vec<[f64; 2]> = Vec::new();
    for value in &sorted {
        match distinct.last_mut() {
            Some([start, end]) if value - *start <= close => *end = *value,
            _ => distinct.push([*value, *value]),
        }
    }
    if distinct.len() <= bins {
        return distinct;
    }
    let mut starts: Vec<f64> = (0..bins).map(|i| sorted[i * sorted.len() / bins]).collect();
    starts.dedup();
    let first_indices = starts.iter().map(|start| sorted.partition_point(|value| value < start));
    let ends = first_indices.skip(1).map(|next| sorted[next - 1]).chain([*last]);
    starts.iter().zip(ends).map(|(start, end)| [*start, end]).collect()
}

/// The bin of a value.
pub fn bin_of(edges: &[[f64; 2]], value: f64) -> usize {
    edges.iter().rposition(|[from, _]| *from <= value).unwrap_or(0)
}

/// The most significant interval of bins: its bins, its mean residual in standard deviations, and the mean residual. `products`
/// has the scalar products of columns: those of the bins from column `first` on, and that of the residuals.
pub fn best_interval(
    products: &DMatrix<f64>,
    first: usize,
    bins: usize,
    residuals: usize,
) -> Option<(Range<usize>, f64, f64)> {
    let mut best: Option<(Range<usize>, f64, f64)> = None;
    for from in 0..bins {
        for to in from..bins {
            let (start, count) = (first + from, to - from + 1);
            let sum = products.view((start, residuals), (count, 1)).sum();
            let square = products.view((start, start), (count, count)).sum();
            if square > 1e-9 {
                let sigma = sum / square.sqrt();
                if best.as_ref().is_none_or(|(_, other, _)| sigma.abs() > other.abs()) {
                    best = Some((from..to + 1, sigma, sum / square));
                }
            }
        }
    }
    best
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Every bin's ends are its smallest and its largest value, also where a value repeats across a quantile.
    #[test]
    fn the_ends_of_a_bin_are_values_in_it() {
        let uniform: Vec<f64> = (0..100).map(f64::from).collect();
        // Neighbours are nearer than two readings of one level may be.
        let dense: Vec<f64> = (0..5000).map(f64::from).collect();
        let repeated: Vec<f64> = (0..100).map(|i| if i < 60 { 0.0 } else { f64::from(i) }).collect();
        for values in [uniform, dense, repeated] {
            let readings: Vec<Option<f64>> = values.iter().copied().map(Some).collect();
            let edges = edges(&readings, BINS);
            assert!((2..=BINS).contains(&edges.len()), "{edges:?}");
            for (bin, ends) in edges.iter().enumerate() {
                let in_bin: Vec<f64> =
                    values.iter().copied().filter(|value| bin_of(&edges, *value) == bin).collect();
                let [least, most] =
                    [in_bin.iter().copied().reduce(f64::min), in_bin.iter().copied().reduce(f64::max)];
                assert_eq!(least.zip(most), Some((ends[0], ends[1])), "{bin} of {edges:?}");
            }
        }
    }
}
