//! Log evidence of a set of recordings at one candidate, and what they determine about the next insertion
//! (theory, eq. 43).
//!
//! The unknowns of an insertion are what all insertions share plus its own part, both normal. Per recording its own part is integrated
//! out, which leaves a message about the shared part; messages add up, so that leaving one recording out costs nothing.

use super::basis::{Basis, Measured};
use super::inverse::Inverter;
use super::layout::{GAP, Layout, MODULUS};
use super::learned::Normal;
use super::path::TipPath;
use super::place::Place;
use super::scales::{Map, Scales};
use nalgebra::{DMatrix, DVector};
use pulp::{Arch, Simd, WithSimd};

/// Measured values of one vector of unknowns as a linear function of them, summed up: rows with as many readings have the same variance,
/// and only their sum of squares is used.
#[derive(Debug, Clone)]
pub(super) struct System {
    groups: Vec<Group>,
}

/// Rows of one kind with the same number of readings, at rest or not.
#[derive(Debug, Clone)]
struct Group {
    measured: Measured,
    readings: f64,
    moving: bool,
    count: usize,
    /// `B^T B`, `B^T y` and `y^T y` of the rows.
    squares: DMatrix<f64>,
    pull: DVector<f64>,
    total: f64,
}

impl Group {
    fn new(measured: Measured, readings: f64, moving: bool, unknowns: usize) -> Self {
        let (squares, pull) = (DMatrix::zeros(unknowns, unknowns), DVector::zeros(unknowns));
        Self { measured, readings, moving, count: 0, squares, pull, total: 0.0 }
    }

    /// Takes in rows with their measured values. Columns are long and few, so that products of pairs are the fastest.
    fn add(&mut self, rows: &DMatrix<f64>, values: &DVector<f64>) {
        Arch::new().dispatch(Sums { group: self, rows: rows.as_slice(), values: values.as_slice() });
        self.count += values.len();
        self.total += values.norm_squared();
    }
}

/// Argument of [`Group::add`]: rows, column by column, and values.
struct Sums<'a> {
    group: &'a mut Group,
    rows: &'a [f64],
    values: &'a [f64],
}

impl WithSimd for Sums<'_> {
    type Output = ();

    // Into the function that is compiled for wide registers, as is everything that it calls.
    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        let Self { group, rows, values } = self;
        let columns = || rows.chunks_exact(values.len().max(1));
        for (j, column) in columns().enumerate() {
            for (i, other) in columns().enumerate().take(j + 1) {
                let product = dot(column, other);
                group.squares[(i, j)] += product;
                if i != j {
                    group.squares[(j, i)] += product;
                }
            }
            group.pull[j] += dot(column, values);
        }
    }
}

/// The scalar product, in sums of eight so that none waits for the one before.
#[inline(always)]
fn dot(left: &[f64], right: &[f64]) -> f64 {
    let ((left_chunks, left_rest), (right, right_rest)) = (left.as_chunks::<8>(), right.as_chunks::<8>());
    let mut sums = [0.0; 8];
    for (left_chunks, right) in left_chunks.iter().zip(right) {
        for lane in 0..8 {
            sums[lane] += left_chunks[lane] * right[lane];
        }
    }
    let [first, second] = [0, 4].map(|from| [sums[from], sums[from + 1], sums[from + 2], sums[from + 3]]);
    let of_eight = first.iter().zip(second).fold(0.0, |sum, (first, second)| sum + (first + second));
    left_rest.iter().zip(right_rest).fold(of_eight, |sum, (left_chunks, right)| sum + left_chunks * right)
}

impl System {
    /// One per vector of unknowns.
    pub fn of(basis: &Basis, path: &TipPath, places: &[Place], layout: &Layout) -> Vec<Self> {
        let mut order: Vec<usize> = (0..path.bins.len()).collect();
        order.sort_by(|a, b| {
            kind(*a, &path.bins)
                .0
                .total_cmp(&kind(*b, &path.bins).0)
                .then(kind(*a, &path.bins).1.cmp(&kind(*b, &path.bins).1))
        });
        (0..layout.systems())
            .map(|system| {
                Self {
                    groups: basis
                        .measured()
                        .flat_map(|measured| {
                            let planes: Vec<_> = layout
                                .planes_of(system)
                                .map(|plane| (plane, basis.rows(plane, measured, places)))
                                .collect();
                            let groups = order
                                .chunk_by(|a, b| kind(*a, &path.bins) == kind(*b, &path.bins))
                                .filter_map(move |bins| {
                                    let (readings, moving) = kind(*bins.first()?, &path.bins);
                                    let mut group = Group::new(measured, readings, moving, layout.unknowns());
                                    for (plane, (rows, beside)) in &planes {
                                        let (used_bins, values): (Vec<usize>, Vec<f64>) = bins
                                            .iter()
                                            .filter_map(|i| {
                                                Some((*i, measured.of(&path.bins[*i], *plane)? - beside[*i]))
                                            })
                                            .unzip();
                                        let values = DVector::from_vec(values);
                                        // Bins of one kind, each with a value, are all rows as they are.
                                        if used_bins.iter().copied().eq(0..rows.nrows()) {
                                            group.add(rows, &values);
                                        } else {
                                            group.add(&rows.select_rows(&used_bins), &values);
                                        }
                                    }
                                    Some(group)
                                });
                            groups.collect::<Vec<_>>()
                        })
                        .collect(),
                }
            })
            .collect()
    }

    /// With the own part integrated out; `None` where that fails in floating point.
    #[inline(always)]
    fn message<S: Simd>(
        &self,
        simd: S,
        layout: &Layout,
        scales: &Scales,
        map: &Map,
        inverter: &mut Inverter,
    ) -> Option<Message> {
        let unknowns = layout.unknowns();
        let mut squares = vec![0.0; unknowns * unknowns];
        let mut pull = vec![0.0; unknowns];
        let (mut measured, mut ln) = (0.0, 0.0);
        for group in &self.groups {
            let weight = 1.0 / scales.variance(group.measured, group.readings, group.moving);
            let sums = squares.iter_mut().zip(group.squares.as_slice());
            sums.for_each(|(sum, square)| *sum += weight * square);
            pull.iter_mut().zip(group.pull.as_slice()).for_each(|(sum, pull)| *sum += weight * pull);
            measured += weight * group.total;
            ln += 0.5 * group.count as f64 * weight.ln();
        }
        // In standard normal numbers the own part has unit variance.
        let length = layout.of_plane();
        map.pull_back_rows(&mut squares, unknowns, length);
        transpose(&mut squares, unknowns);
        map.pull_back_rows(&mut squares, unknowns, length);
        map.pull_back_rows(&mut pull, 1, length);
        squares.iter_mut().step_by(unknowns + 1).for_each(|diagonal| *diagonal += 1.0);
        let ln_determinant = inverter.invert(simd, &mut squares)?;
        let information: Vec<f64> = squares
            .chunks_exact(unknowns)
            .map(|row| row.iter().zip(&pull).map(|(a, b)| a * b).sum())
            .collect();
        let explained: f64 = information.iter().zip(&pull).map(|(a, b)| a * b).sum();
        ln -= 0.5 * (ln_determinant + measured - explained);
        // (A^-1 + I)^-1 = I - (I + A)^-1 is left of the information A.
        squares.iter_mut().for_each(|value| *value = -*value);
        squares.iter_mut().step_by(unknowns + 1).for_each(|diagonal| *diagonal += 1.0);
        Some(Message { ln, information: squares, pull: information })
    }
}

/// Rows and motion by which bins are grouped.
fn kind(i: usize, bins: &[crate::Bin]) -> (f64, bool) {
    (bins[i].rows, bins[i].moving)
}

/// Information of one recording about the shared part, in standard normal numbers of an own part.
struct Message {
    ln: f64,
    information: Vec<f64>,
    pull: Vec<f64>,
}

/// Log evidence of a set of recordings.
pub(super) struct Evidence {
    pub ln: f64,
    /// Per vector of unknowns, the shared part in standard normal numbers of its own prior: mean and covariance.
    shared: Vec<(Vec<f64>, Vec<f64>)>,
}

impl Evidence {
    /// Evidence of the systems of several recordings; `None` if it is no number.
    pub fn new(layout: &Layout, recordings: &[&[System]], scales: &Scales, searching: bool) -> Option<Self> {
        Arch::new().dispatch(Recordings { layout, recordings, scales, searching })
    }

    /// Unknowns of the next insertion: shared part and an own one.
    pub fn next(&self, layout: &Layout, scales: &Scales) -> Vec<Normal> {
        let map = scales.map(layout, false);
        let (unknowns, length) = (layout.unknowns(), layout.of_plane());
        self.shared
            .iter()
            .map(|(mean, covariance)| {
                let mut mean: Vec<f64> =
                    mean.iter().enumerate().map(|(i, value)| ratio(i, &map, length) * value).collect();
                let mut covariance = covariance.clone();
                for (i, row) in covariance.chunks_exact_mut(unknowns).enumerate() {
                    row.iter_mut()
                        .enumerate()
                        .for_each(|(j, value)| *value *= ratio(i, &map, length) * ratio(j, &map, length));
                    row[i] += 1.0;
                }
                map.push_forward(&mut mean, length);
                for _ in 0..2 {
                    covariance.chunks_exact_mut(unknowns).for_each(|row| map.push_forward(row, length));
                    transpose(&mut covariance, unknowns);
                }
                Normal {
                    mean: DVector::from_vec(mean),
                    covariance: DMatrix::from_row_slice(unknowns, unknowns, &covariance),
                }
            })
            .collect()
    }

    /// Step to the maximum of a search's evidence, in the logarithms of modulus and gap, and its curvature: mean,
    /// weighted by the information, and information.
    pub fn step(&self, layout: &Layout, scales: &Scales) -> ([f64; 2], [[f64; 2]; 2]) {
        let map = scales.map(layout, true);
        let (unknowns, length) = (layout.unknowns(), layout.of_plane());
        let (mut pull, mut information) = ([0.0; 2], [[0.0; 2]; 2]);
        for plane in 0..layout.planes {
            let (system, first_column) = layout.place(plane);
            let (mean, covariance) = &self.shared[system];
            let columns = [first_column + MODULUS, first_column + GAP];
            let step = [0, 1].map(|i| prior_sd(i, &map, columns, length) * mean[columns[i]]);
            let determinant = scaled_covariance(0, 0, columns, unknowns, covariance, &map, length)
                * scaled_covariance(1, 1, columns, unknowns, covariance, &map, length)
                - scaled_covariance(0, 1, columns, unknowns, covariance, &map, length)
                    * scaled_covariance(1, 0, columns, unknowns, covariance, &map, length);
            let inverse = [
                [
                    scaled_covariance(1, 1, columns, unknowns, covariance, &map, length) / determinant,
                    -scaled_covariance(0, 1, columns, unknowns, covariance, &map, length) / determinant,
                ],
                [
                    -scaled_covariance(1, 0, columns, unknowns, covariance, &map, length) / determinant,
                    scaled_covariance(0, 0, columns, unknowns, covariance, &map, length) / determinant,
                ],
            ];
            for i in 0..2 {
                for j in 0..2 {
                    pull[i] += inverse[i][j] * step[j];
                    // The trust region of a search is not information.
                    let trust = if i == j { 1.0 / Scales::trust_variance() } else { 0.0 };
                    information[i][j] += inverse[i][j] - trust;
                }
            }
        }
        (pull, information)
    }

    /// Mean of the share of the rear that all insertions have in common, per plane; `None` where it is known.
    pub fn rear_share(&self, layout: &Layout, scales: &Scales) -> Option<[f64; 2]> {
        let rear_column = layout.rear()?;
        let map = scales.map(layout, false);
        let mut means = [0.0; 2];
        for (plane, mean) in means.iter_mut().enumerate().take(layout.planes) {
            let (system, first_column) = layout.place(plane);
            let shared =
                self.shared.get(system).and_then(|(means, _)| means.get(first_column + rear_column)).copied();
            *mean = shared.unwrap_or_default() * map.sds[rear_column] * map.ratios[rear_column];
        }
        Some(means)
    }
}

/// Covariance of the modulus and the gap.
fn scaled_covariance(
    i: usize,
    j: usize,
    columns: [usize; 2],
    unknowns: usize,
    covariance: &[f64],
    map: &Map,
    length: usize,
) -> f64 {
    prior_sd(i, map, columns, length)
        * prior_sd(j, map, columns, length)
        * covariance[columns[i] * unknowns + columns[j]]
}

/// Standard deviation of the modulus or of the gap.
fn prior_sd(i: usize, map: &Map, columns: [usize; 2], length: usize) -> f64 {
    map.sds[[MODULUS, GAP][i]] * map.ratio(columns[i], length)
}

fn ratio(i: usize, map: &Map, length: usize) -> f64 {
    map.ratio(i, length)
}

/// Arguments of [`Evidence::new`].
struct Recordings<'a> {
    layout: &'a Layout,
    recordings: &'a [&'a [System]],
    scales: &'a Scales,
    searching: bool,
}

impl WithSimd for Recordings<'_> {
    type Output = Option<Evidence>;

    // Into the function that is compiled for wide registers, as is everything that it calls.
    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> Option<Evidence> {
        let Self { layout, recordings, scales, searching } = self;
        let map = scales.map(layout, searching);
        let (unknowns, length) = (layout.unknowns(), layout.of_plane());
        let mut evidence = Evidence { ln: 0.0, shared: Vec::new() };
        let mut inverter = Inverter::new(simd, unknowns);
        let ratios: Vec<f64> = (0..unknowns).map(|i| map.ratio(i, length)).collect();
        for number in 0..layout.systems() {
            let mut information = vec![0.0; unknowns * unknowns];
            let mut pull = vec![0.0; unknowns];
            for system in recordings.iter().filter_map(|systems| systems.get(number)) {
                let message = system.message(simd, layout, scales, &map, &mut inverter)?;
                evidence.ln += message.ln;
                information.iter_mut().zip(&message.information).for_each(|(sum, value)| *sum += value);
                pull.iter_mut().zip(&message.pull).for_each(|(sum, value)| *sum += value);
            }
            for (row, ratio) in information.chunks_exact_mut(unknowns).zip(&ratios) {
                row.iter_mut().zip(&ratios).for_each(|(value, other)| *value *= ratio * other);
            }
            pull.iter_mut().zip(&ratios).for_each(|(value, ratio)| *value *= ratio);
            information.iter_mut().step_by(unknowns + 1).for_each(|diagonal| *diagonal += 1.0);
            let ln_determinant = inverter.invert(simd, &mut information)?;
            let mean: Vec<f64> = information
                .chunks_exact(unknowns)
                .map(|row| row.iter().zip(&pull).map(|(a, b)| a * b).sum())
                .collect();
            let explained: f64 = mean.iter().zip(&pull).map(|(a, b)| a * b).sum();
            evidence.ln += 0.5 * (explained - ln_determinant);
            evidence.shared.push((mean, information));
        }
        evidence.ln.is_finite().then_some(evidence)
    }
}

#[inline(always)]
fn transpose(square: &mut [f64], size: usize) {
    for i in 0..size {
        for j in 0..i {
            square.swap(i * size + j, j * size + i);
        }
    }
}

#[cfg(test)]
#[path = "evidence_tests.rs"]
mod tests;
