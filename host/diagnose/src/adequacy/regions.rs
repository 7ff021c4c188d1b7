//! Regions in which measured and predicted values differ.

use super::super::data::{Channel, Datum, Kind};
use super::super::evidence::{Group, Patterns, Products};
use super::super::layout::{NORMAL_975, Prepared};
use super::super::posterior::Fitted;
use super::super::score::stacked;
use super::{all_data, by_run, is_tested, whitened};
use ::discrepancy::regions::{best_interval, bin_of, edges};
use nalgebra::DVector;
use readings::FitError;
use statrs::distribution::{ContinuousCDF, Normal};
use std::cmp::Reverse;

/// Largest numbers of bins of a coordinate, and of reported regions.
const BINS: usize = 8;
const MAX_REGIONS: usize = 5;

/// A region where measured and predicted values differ.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(in super::super) struct Region {
    pub channel: Channel,
    pub coordinate: &'static str,
    pub from: f64,
    pub to: f64,
    /// Mean residual, measured less predicted, SI. If `is_odd`, it is the residual in the direction of the displacement of guide 2.
    pub mean: f64,
    pub is_odd: bool,
    pub sigma: f64,
}

/// Name of a coordinate, and its value for a datum.
type Coordinate = (&'static str, fn(&Prepared, &Datum) -> Option<f64>);

const COORDINATES: [Coordinate; 5] = [
    ("depth_below_entry_mm", |run, d| {
        let is_spatial = matches!(d.channel, Channel::ShapeY | Channel::ShapeX);
        (run.run.kind == Kind::Lateral && is_spatial).then_some(1e3 * d.place.depth_m)
    }),
    ("insertion_depth_mm", |run, d| {
        let depth_m = if run.run.kind == Kind::Lateral { run.run.depth_m } else { d.place.depth_m };
        Some(1e3 * depth_m)
    }),
    ("level_mm", |run, d| (run.run.kind == Kind::Lateral).then_some(1e3 * d.place.level_m)),
    ("direction", |run, d| (run.run.kind == Kind::Lateral).then_some(d.place.direction)),
    ("time_in_hold_s", |_, d| d.place.hold_s),
];

/// Names of the coordinates along which regions are found, as in [`RegionResult`](crate::RegionResult).
pub fn region_coordinates() -> [&'static str; COORDINATES.len()] {
    COORDINATES.map(|(name, _)| name)
}

/// Bins of one coordinate in one channel, and the number of their first column.
struct Scan {
    channel: Channel,
    coordinate: &'static str,
    is_odd: bool,
    edges: Vec<[f64; 2]>,
    first: usize,
}

/// Regions in which a fit and the data differ by more than noise and usual imperfections, most significant first, at most one
/// region per channel and coordinate.
///
/// # Errors
/// Where the discrepancy's covariance has no factor.
pub(in super::super) fn regions(
    fitted: &Fitted,
    runs: &[Prepared],
    patterns: &Patterns,
) -> Result<Vec<Region>, FitError> {
    Scanned::new(fitted, runs, patterns).regions(fitted, patterns, &patterns.everyday())
}

/// Whether regions remain that no imperfection explains: with the fitted sizes of the discrepancy, limited to between the everyday size and
/// the 95 % limit of its prior, and also if any single size is at that limit. The second condition is needed because the evidence does not
/// increase a size for the sake of one region among the many that are scanned.
///
/// # Errors
/// Where the discrepancy's covariance has no factor.
pub(in super::super) fn has_regions_beyond_prior(
    fitted: &Fitted,
    runs: &[Prepared],
    patterns: &Patterns,
) -> Result<bool, FitError> {
    let scanned = Scanned::new(fitted, runs, patterns);
    let sizes = allowed_sizes(fitted, patterns);
    if scanned.regions(fitted, patterns, &sizes)?.is_empty() {
        return Ok(false);
    }
    for (index, group) in patterns.groups.iter().enumerate() {
        let mut with_largest = sizes.clone();
        with_largest[index] = largest(group);
        if with_largest[index] > sizes[index] && scanned.regions(fitted, patterns, &with_largest)?.is_empty()
        {
            return Ok(false);
        }
    }
    Ok(true)
}

/// The 95 % limit of the prior of a size above the everyday one.
fn largest(group: &Group) -> f64 {
    group.everyday * (1.0 + NORMAL_975 * group.tail.unwrap_or(0.0))
}

/// The fitted sizes, limited to between the everyday size and the 95 % limit of the prior.
pub(in super::super) fn allowed_sizes(fitted: &Fitted, patterns: &Patterns) -> Vec<f64> {
    let sizes = patterns.groups.iter().zip(&fitted.sizes);
    sizes.map(|(group, size)| size.clamp(group.everyday, largest(group))).collect()
}

/// Scans, and the scalar products of their columns and the residuals, with the sensitivities to the parameters of the fit.
struct Scanned {
    scans: Vec<Scan>,
    products: Products,
    /// Number of the column of the residuals.
    residuals: usize,
}

impl Scanned {
    fn new(fitted: &Fitted, runs: &[Prepared], patterns: &Patterns) -> Self {
        let (scans, mut columns) = scans(runs);
        columns.push(stacked(&fitted.residuals));
        let products = fitted.products_beside_parameters(patterns, &by_run(runs, &columns));
        Self { scans, products, residuals: columns.len() - 1 }
    }

    fn regions(&self, fitted: &Fitted, patterns: &Patterns, sizes: &[f64]) -> Result<Vec<Region>, FitError> {
        let edges = self.scans.iter().map(|scan| scan.edges.len());
        let tried_intervals: usize = edges.map(|count| count * (count + 1) / 2).sum();
        let (eliminated, _) =
            fitted.eliminated(patterns, sizes, &self.products).ok_or(FitError::Undetermined)?;
        let threshold = Normal::standard().inverse_cdf(1.0 - 0.5 * 0.01 / tried_intervals.max(1) as f64);
        let mut regions_found: Vec<Region> = self
            .scans
            .iter()
            .filter_map(|scan| {
                let (bins, sigma, mean) =
                    best_interval(&eliminated, scan.first, scan.edges.len(), self.residuals)?;
                let (start, end) = (scan.edges[bins.start][0], scan.edges[bins.end - 1][1]);
                let Scan { channel, coordinate, is_odd, .. } = *scan;
                Some(Region { channel, coordinate, from: start, to: end, mean, is_odd, sigma })
            })
            .collect();
        regions_found.retain(|region| region.sigma.abs() > threshold);
        // Regions of the same readings along two coordinates differ only by rounding: the sort by rounded significance keeps the order of
        // the coordinates.
        regions_found.sort_by_key(|region| Reverse((1e4 * region.sigma.abs().ln()).round() as i64));
        let mut regions_kept: Vec<Region> = Vec::new();
        for region in regions_found {
            let is_same_region = regions_kept
                .iter()
                .any(|other| other.channel == region.channel && other.coordinate == region.coordinate);
            if !is_same_region && regions_kept.len() < MAX_REGIONS {
                regions_kept.push(region);
            }
        }
        Ok(regions_kept)
    }
}

/// Side of zero on which guide 2 is: 1, -1, or 0 at zero.
fn side(datum: &Datum) -> f64 {
    if datum.place.level_m.abs() < 1e-5 { 0.0 } else { datum.place.level_m.signum() }
}

/// All bins of all coordinates, and their whitened columns.
fn scans(runs: &[Prepared]) -> (Vec<Scan>, Vec<DVector<f64>>) {
    let (mut scans, mut columns) = (Vec::new(), Vec::new());
    for channel in Channel::ALL {
        for (coordinate, value_of) in COORDINATES {
            let values: Vec<Option<f64>> = all_data(runs)
                .map(|(run, d)| (d.channel == channel && is_tested(run)).then(|| value_of(run, d)).flatten())
                .collect();
            let edges = edges(&values, BINS);
            if edges.len() < 2 {
                continue;
            }
            for is_odd in [false, true] {
                scans.push(Scan { channel, coordinate, is_odd, edges: edges.clone(), first: columns.len() });
                columns.extend((0..edges.len()).map(|bin| {
                    let column: Vec<f64> = all_data(runs)
                        .zip(&values)
                        .map(|((_, d), value)| match value {
                            Some(value) if bin_of(&edges, *value) == bin => {
                                if is_odd {
                                    side(d)
                                } else {
                                    1.0
                                }
                            }
                            _ => 0.0,
                        })
                        .collect();
                    whitened(runs, &column)
                }));
            }
        }
    }
    (scans, columns)
}
