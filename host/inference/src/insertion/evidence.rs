//! Log evidence of a set of recordings at one candidate, and what they determine about the next insertion
//! (theory, eq. 43).
//!
//! The unknowns of an insertion are what all insertions share plus its own part, both normal. Per recording its own part is integrated
//! out, which leaves a message about the shared part; messages add up, so that leaving one recording out costs nothing.

use super::basis::{Basis, Measured};
use super::layout::{GAP, Layout, MODULUS};
use super::learned::Normal;
use super::path::TipPath;
use super::place::Place;
use super::scales::{Map, Scales};
use nalgebra::{DMatrix, DVector};
use pulp::Arch;

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
        for (j, column) in rows.column_iter().enumerate() {
            for (i, other) in rows.column_iter().enumerate().take(j + 1) {
                let product = column.dot(&other);
                self.squares[(i, j)] += product;
                if i != j {
                    self.squares[(j, i)] += product;
                }
            }
            self.pull[j] += column.dot(values);
        }
        self.count += values.len();
        self.total += values.norm_squared();
    }
}

impl System {
    /// One per vector of unknowns.
    pub fn of(basis: &Basis, path: &TipPath, places: &[Place], layout: &Layout) -> Vec<Self> {
        let kind = |i: usize| (path.bins[i].rows, path.bins[i].moving);
        let mut order: Vec<usize> = (0..path.bins.len()).collect();
        order.sort_by(|a, b| kind(*a).0.total_cmp(&kind(*b).0).then(kind(*a).1.cmp(&kind(*b).1)));
        let system = |system: usize| {
            let of = |measured: Measured| {
                let rows = |plane: usize| (plane, basis.rows(plane, measured, places));
                let planes: Vec<_> = layout.planes_of(system).map(rows).collect();
                let groups = order.chunk_by(|a, b| kind(*a) == kind(*b)).filter_map(move |bins| {
                    let (readings, moving) = kind(*bins.first()?);
                    let mut group = Group::new(measured, readings, moving, layout.unknowns());
                    for (plane, (rows, beside)) in &planes {
                        let value = |i: &usize| Some((*i, measured.of(&path.bins[*i], *plane)? - beside[*i]));
                        let (used, values): (Vec<usize>, Vec<f64>) = bins.iter().filter_map(value).unzip();
                        group.add(&rows.select_rows(&used), &DVector::from_vec(values));
                    }
                    Some(group)
                });
                groups.collect::<Vec<_>>()
            };
            Self { groups: basis.measured().flat_map(of).collect() }
        };
        (0..layout.systems()).map(system).collect()
    }

    /// With the own part integrated out; `None` where that fails in floating point.
    fn message(&self, layout: &Layout, scales: &Scales, map: &Map) -> Option<Message> {
        let unknowns = layout.unknowns();
        let mut squares = vec![0.0; unknowns * unknowns];
        let mut pull = vec![0.0; unknowns];
        let (mut measured, mut ln) = (0.0, 0.0);
        for group in &self.groups {
            let weight = 1.0 / scales.variance(group.measured, group.readings, group.moving);
            squares.iter_mut().zip(&group.squares).for_each(|(sum, square)| *sum += weight * square);
            pull.iter_mut().zip(&group.pull).for_each(|(sum, pull)| *sum += weight * pull);
            measured += weight * group.total;
            ln += 0.5 * group.count as f64 * weight.ln();
        }
        // In standard normal numbers the own part has unit variance.
        let length = layout.of_plane();
        pull_back_both(&mut squares, unknowns, map, length);
        map.pull_back(&mut pull, length);
        squares.iter_mut().step_by(unknowns + 1).for_each(|diagonal| *diagonal += 1.0);
        let ln_determinant = invert(&mut squares, unknowns)?;
        let own: Vec<f64> = squares
            .chunks_exact(unknowns)
            .map(|row| row.iter().zip(&pull).map(|(a, b)| a * b).sum())
            .collect();
        let explained: f64 = own.iter().zip(&pull).map(|(a, b)| a * b).sum();
        ln -= 0.5 * (ln_determinant + measured - explained);
        // (A^-1 + I)^-1 = I - (I + A)^-1 is left of the information A.
        squares.iter_mut().for_each(|value| *value = -*value);
        squares.iter_mut().step_by(unknowns + 1).for_each(|diagonal| *diagonal += 1.0);
        Some(Message { ln, information: squares, pull: own })
    }
}

/// What one recording determines of the shared part, in standard normal numbers of an own part.
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
    /// Of the systems of several recordings; `None` where it is no number.
    pub fn new(layout: &Layout, recordings: &[&[System]], scales: &Scales, searching: bool) -> Option<Self> {
        let map = scales.map(layout, searching);
        let (unknowns, length) = (layout.unknowns(), layout.of_plane());
        let mut evidence = Self { ln: 0.0, shared: Vec::new() };
        let ratios: Vec<f64> = (0..unknowns).map(|i| map.ratio(i, length)).collect();
        for number in 0..layout.systems() {
            let mut information = vec![0.0; unknowns * unknowns];
            let mut pull = vec![0.0; unknowns];
            for system in recordings.iter().filter_map(|systems| systems.get(number)) {
                let message = system.message(layout, scales, &map)?;
                evidence.ln += message.ln;
                information.iter_mut().zip(&message.information).for_each(|(sum, value)| *sum += value);
                pull.iter_mut().zip(&message.pull).for_each(|(sum, value)| *sum += value);
            }
            for (row, ratio) in information.chunks_exact_mut(unknowns).zip(&ratios) {
                row.iter_mut().zip(&ratios).for_each(|(value, other)| *value *= ratio * other);
            }
            pull.iter_mut().zip(&ratios).for_each(|(value, ratio)| *value *= ratio);
            information.iter_mut().step_by(unknowns + 1).for_each(|diagonal| *diagonal += 1.0);
            let ln_determinant = invert(&mut information, unknowns)?;
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

    /// Unknowns of the next insertion: shared part and an own one.
    pub fn next(&self, layout: &Layout, scales: &Scales) -> Vec<Normal> {
        let map = scales.map(layout, false);
        let (unknowns, length) = (layout.unknowns(), layout.of_plane());
        let normal = |(mean, covariance): &(Vec<f64>, Vec<f64>)| {
            let ratio = |i: usize| map.ratio(i, length);
            let mut mean: Vec<f64> = mean.iter().enumerate().map(|(i, value)| ratio(i) * value).collect();
            let mut covariance = covariance.clone();
            for (i, row) in covariance.chunks_exact_mut(unknowns).enumerate() {
                row.iter_mut().enumerate().for_each(|(j, value)| *value *= ratio(i) * ratio(j));
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
        };
        self.shared.iter().map(normal).collect()
    }

    /// Where the evidence of a search has its top, as a step of the logarithms of modulus and gap, and how sharp that is: mean, weighted
    /// by the information, and information.
    pub fn step(&self, layout: &Layout, scales: &Scales) -> ([f64; 2], [[f64; 2]; 2]) {
        let map = scales.map(layout, true);
        let (unknowns, length) = (layout.unknowns(), layout.of_plane());
        let (mut pull, mut information) = ([0.0; 2], [[0.0; 2]; 2]);
        for plane in 0..layout.planes {
            let (system, at) = layout.place(plane);
            let (mean, covariance) = &self.shared[system];
            let places = [at + MODULUS, at + GAP];
            let sd = |i: usize| map.sds[[MODULUS, GAP][i]] * map.ratio(places[i], length);
            let step = [0, 1].map(|i| sd(i) * mean[places[i]]);
            let c = |i: usize, j: usize| sd(i) * sd(j) * covariance[places[i] * unknowns + places[j]];
            let determinant = c(0, 0) * c(1, 1) - c(0, 1) * c(1, 0);
            let inverse = [
                [c(1, 1) / determinant, -c(0, 1) / determinant],
                [-c(1, 0) / determinant, c(0, 0) / determinant],
            ];
            for i in 0..2 {
                for j in 0..2 {
                    pull[i] += inverse[i][j] * step[j];
                    // How far a search may go at once is no knowledge.
                    let trust = if i == j { 1.0 / Scales::trust_variance() } else { 0.0 };
                    information[i][j] += inverse[i][j] - trust;
                }
            }
        }
        (pull, information)
    }

    /// Mean of the share of the rear that all insertions have in common, per plane; `None` where it is known.
    pub fn rear_share(&self, layout: &Layout, scales: &Scales) -> Option<[f64; 2]> {
        let place = layout.rear()?;
        let map = scales.map(layout, false);
        let mut means = [0.0; 2];
        for (plane, mean) in means.iter_mut().enumerate().take(layout.planes) {
            let (system, at) = layout.place(plane);
            let shared = self.shared.get(system).and_then(|(means, _)| means.get(at + place)).copied();
            *mean = shared.unwrap_or_default() * map.sds[place] * map.ratios[place];
        }
        Some(means)
    }
}

/// `D^T S D`.
fn pull_back_both(squares: &mut [f64], unknowns: usize, map: &Map, length: usize) {
    for _ in 0..2 {
        squares.chunks_exact_mut(unknowns).for_each(|row| map.pull_back(row, length));
        transpose(squares, unknowns);
    }
}

fn transpose(square: &mut [f64], size: usize) {
    for i in 0..size {
        for j in 0..i {
            square.swap(i * size + j, j * size + i);
        }
    }
}

/// Replaces a symmetric, positive definite matrix by its inverse (Gauss and Jordan, without pivots) and returns the logarithm of its
/// determinant; `None` where it is not positive definite in floating point.
fn invert(square: &mut [f64], size: usize) -> Option<f64> {
    Arch::new().dispatch(|| invert_here(square, size))
}

/// The same, compiled for the registers that the machine has.
#[inline(always)]
fn invert_here(square: &mut [f64], size: usize) -> Option<f64> {
    let mut ln_determinant = 0.0;
    let mut pivot_row = vec![0.0; size];
    for k in 0..size {
        let pivot = square[k * size + k];
        if !(pivot > 0.0 && pivot.is_finite()) {
            return None;
        }
        ln_determinant += pivot.ln();
        let row = &mut square[k * size..(k + 1) * size];
        row[k] = 1.0;
        row.iter_mut().for_each(|value| *value /= pivot);
        pivot_row.copy_from_slice(row);
        for (i, row) in square.chunks_exact_mut(size).enumerate() {
            if i != k {
                let factor = std::mem::take(&mut row[k]);
                row.iter_mut().zip(&pivot_row).for_each(|(value, pivot)| *value -= factor * pivot);
            }
        }
    }
    Some(ln_determinant)
}

#[cfg(test)]
#[path = "evidence_tests.rs"]
mod tests;
