//! What is believed of one insertion's unknowns: a normal distribution per candidate of modulus and gap, updated by each tip
//! position (a Kalman filter over unknowns that do not change, which makes it a smoother of the tip load).

use super::basis::{Basis, Candidates};
use super::learn::{Learned, Part};
use super::path::{Bin, TipPath};
use super::scales::Scales;
use nalgebra::{DMatrix, DVector};

/// Candidates below this share of the weight are left out of a prediction.
const LEAST_WEIGHT: f64 = 1e-4;

/// Mean and standard deviation.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Moments {
    /// Mean.
    pub mean: f64,
    /// Standard deviation.
    pub sd: f64,
}

/// A normal distribution.
#[derive(Debug, Clone)]
pub(super) struct Normal {
    /// One column per right-hand side.
    pub mean: DMatrix<f64>,
    /// The same for all of them.
    pub covariance: DMatrix<f64>,
}

impl Normal {
    /// Takes in one measured combination of the unknowns; returns its log likelihood.
    fn update(&mut self, row: &DVector<f64>, measured: &[f64], variance: f64) -> f64 {
        let spread = &self.covariance * row;
        let total = row.dot(&spread) + variance;
        let mut ln_likelihood = 0.0;
        for (mut mean, value) in self.mean.column_iter_mut().zip(measured) {
            let error = value - row.dot(&mean);
            mean.axpy(error / total, &spread, 1.0);
            ln_likelihood -= 0.5 * (error * error / total + total.ln());
        }
        self.covariance.ger(-1.0 / total, &spread, &spread, 1.0);
        ln_likelihood
    }

    /// The distribution of `map` times what this is the distribution of.
    pub fn mapped(&self, map: &DMatrix<f64>) -> Self {
        Self { mean: map * &self.mean, covariance: map * &self.covariance * map.transpose() }
    }
}

/// Belief about one insertion.
#[derive(Debug, Clone)]
pub struct Belief<'c> {
    candidates: &'c Candidates,
    /// Which recording's plan is followed.
    path: usize,
    /// Possible sizes of the unknowns.
    scales: Vec<Scales>,
    parts: Vec<Part>,
}

impl<'c> Belief<'c> {
    /// Before anything of recording `path` is seen.
    pub fn new(candidates: &'c Candidates, path: usize, learned: &Learned) -> Self {
        Self { candidates, path, scales: learned.scales.clone(), parts: learned.parts.clone() }
    }

    /// Takes in the tip at one depth.
    pub fn update(&mut self, bin: &Bin) {
        for Part { candidate, scales, ln_weight, normal } in &mut self.parts {
            let basis = &self.candidates.bases[*candidate][self.path];
            let variance = self.scales[*scales].variance_m2(bin.rows, bin.moving);
            for (row, measured) in rows(basis, bin, self.candidates.layout.planes) {
                *ln_weight += normal.update(&row, &measured, variance);
            }
        }
    }

    /// Takes in a whole recording.
    pub fn update_all(&mut self, path: &TipPath) {
        path.bins.iter().for_each(|bin| self.update(bin));
    }

    /// Believes what `other` does, which began as this one did; nothing is allocated.
    fn believe(&mut self, other: &Self) {
        for (part, other) in self.parts.iter_mut().zip(&other.parts) {
            part.ln_weight = other.ln_weight;
            part.normal.mean.copy_from(&other.normal.mean);
            part.normal.covariance.copy_from(&other.normal.covariance);
        }
    }

    /// Whether any part explains what was taken in with a likelihood that is a number.
    pub fn is_sound(&self) -> bool {
        self.parts.iter().any(|part| part.ln_weight.is_finite())
    }

    /// Tip position at each depth, per plane; the scatter of single depths about a smooth path is part of it, the noise of a reading
    /// is not. m.
    pub fn tip_m(&self, depths_m: &[f64]) -> Vec<Vec<Moments>> {
        let rows = |basis: &Basis, block: usize| {
            let rows: Vec<_> =
                depths_m.iter().map(|depth_m| basis.row(block, *depth_m, false).transpose()).collect();
            DMatrix::from_rows(&rows)
        };
        let by_guide2 = |basis: &Basis, plane: usize| {
            DVector::from_iterator(
                depths_m.len(),
                depths_m.iter().map(|depth_m| basis.guide2_m(plane, *depth_m, false)),
            )
        };
        self.moments(depths_m.len(), rows, by_guide2, |scales| scales.irregularity_m.powi(2))
    }

    /// Tip load at each depth in the needle's own frame, per plane, N.
    pub fn load_n(&self, depths_m: &[f64]) -> Vec<Vec<Moments>> {
        let rows = |block: usize| {
            let at = |depth_m: &f64| self.candidates.layout.load_rows(*depth_m)[block].transpose();
            DMatrix::from_rows(&depths_m.iter().map(at).collect::<Vec<_>>())
        };
        let rows: Vec<_> = (0..self.blocks()).map(rows).collect();
        self.of_unknowns(depths_m.len(), |block| rows[block].clone())
    }

    /// Angle of entry per plane, rad.
    pub fn entry_angle_rad(&self) -> Vec<Moments> {
        let layout = &self.candidates.layout;
        let angle = |block: usize| {
            let mut row = DMatrix::zeros(1, layout.unknowns());
            row[(0, 1 + block * layout.of_plane())] = 1.0;
            row
        };
        self.of_unknowns(1, angle).swap_remove(0)
    }

    /// Factor on the modulus, and gap in m: means and standard deviations of their logarithms.
    pub fn ln_modulus_factor_and_gap(&self) -> [Moments; 2] {
        let Candidates { list, steps_ln: [modulus_step, gap_step], .. } = self.candidates;
        // A candidate stands for all values nearer to it than to its neighbours.
        let wide =
            |moments: Moments, step: f64| Moments { sd: moments.sd.hypot(step / 12f64.sqrt()), ..moments };
        let factor = self.mixed(|part| list[part.candidate].modulus_factor.ln());
        let gap = self.mixed(|part| list[part.candidate].gap_m.ln());
        [wide(factor, *modulus_step), wide(gap, *gap_step)]
    }

    /// Whether modulus and gap lie at an end of what was considered.
    pub fn at_end(&self) -> [bool; 2] {
        let Candidates { list, steps_ln, .. } = self.candidates;
        let of = |value: &dyn Fn(usize) -> f64, step: f64| {
            let most = (0..list.len()).map(value).fold(0.0, |most: f64, ln| most.max(ln.abs()));
            step > 0.0 && self.mixed(|part| value(part.candidate)).mean.abs() > most - 0.5 * step
        };
        let middle_ln = list.iter().map(|candidate| candidate.gap_m.ln()).sum::<f64>() / list.len() as f64;
        [
            of(&|i| list[i].modulus_factor.ln(), steps_ln[0]),
            of(&|i| list[i].gap_m.ln() - middle_ln, steps_ln[1]),
        ]
    }

    /// Mean of the logarithm of a size.
    pub fn typical(&self, size: impl Fn(&Scales) -> f64) -> f64 {
        self.mixed(|part| size(&self.scales[part.scales]).ln()).mean.exp()
    }

    /// Moments over the parts of what is certain in each.
    fn mixed(&self, value: impl Fn(&Part) -> f64) -> Moments {
        let (mut mean, mut square) = (0.0, 0.0);
        for (part, share) in self.shares() {
            let value = value(&self.parts[part]);
            mean += share * value;
            square += share * value * value;
        }
        Moments { mean, sd: (square - mean * mean).max(0.0).sqrt() }
    }

    /// Number and weight of the parts that count; the weights sum to 1.
    fn shares(&self) -> Vec<(usize, f64)> {
        let finite = self.parts.iter().enumerate().filter(|(_, part)| part.ln_weight.is_finite());
        let most = finite.clone().map(|(_, part)| part.ln_weight).fold(f64::NEG_INFINITY, f64::max);
        let mut shares: Vec<_> = finite.map(|(i, part)| (i, (part.ln_weight - most).exp())).collect();
        let total: f64 = shares.iter().map(|(_, share)| share).sum();
        shares.retain(|(_, share)| *share > LEAST_WEIGHT * total);
        let total: f64 = shares.iter().map(|(_, share)| share).sum();
        shares.iter_mut().for_each(|(_, share)| *share /= total);
        shares
    }

    /// Blocks of rows: one for both planes, or one per plane where they are coupled.
    fn blocks(&self) -> usize {
        if self.candidates.layout.coupled { 2 } else { 1 }
    }

    /// Linear functions of the unknowns that are the same for all candidates.
    fn of_unknowns(&self, count: usize, rows: impl Fn(usize) -> DMatrix<f64>) -> Vec<Vec<Moments>> {
        self.moments(count, |_, block| rows(block), |_, _| DVector::zeros(count), |_| 0.0)
    }

    /// Linear functions of the unknowns over the parts that count: `count` of them per block, with what `beside` adds to each of a
    /// plane and the variance that is added to all. Moments per function and plane.
    ///
    /// Parts of one candidate have the same functions, so that the sum of their variances is the variance under the sum of their
    /// covariances, each by its share: the costly product is done once for each candidate.
    fn moments(
        &self,
        count: usize,
        rows: impl Fn(&Basis, usize) -> DMatrix<f64>,
        beside: impl Fn(&Basis, usize) -> DVector<f64>,
        variance: impl Fn(&Scales) -> f64,
    ) -> Vec<Vec<Moments>> {
        let layout = &self.candidates.layout;
        let mut shares = self.shares();
        shares.sort_by_key(|(part, _)| self.parts[*part].candidate);
        // Mean and mean square, per plane.
        let mut sums = vec![[DVector::zeros(count), DVector::zeros(count)]; layout.planes];
        let mut value = DVector::zeros(count);
        let mut covariance = DMatrix::zeros(layout.unknowns(), layout.unknowns());
        for same in shares.chunk_by(|(a, _), (b, _)| self.parts[*a].candidate == self.parts[*b].candidate) {
            let candidate = same.first().map_or(0, |(part, _)| self.parts[*part].candidate);
            let basis = &self.candidates.bases[candidate][self.path];
            let rows: Vec<_> = (0..self.blocks()).map(|block| rows(basis, block)).collect();
            let beside: Vec<_> = (0..layout.planes).map(|plane| beside(basis, plane)).collect();
            covariance.fill(0.0);
            let mut own = 0.0;
            for (part, share) in same {
                let Part { scales, normal, .. } = &self.parts[*part];
                covariance.zip_apply(&normal.covariance, |sum, covariance| *sum += share * covariance);
                own += share * variance(&self.scales[*scales]);
                for (plane, [mean, square]) in sums.iter_mut().enumerate() {
                    value.copy_from(&beside[plane]);
                    let rows = &rows[plane.min(rows.len() - 1)];
                    let side = if layout.coupled { 0 } else { plane };
                    value.gemv(1.0, rows, &normal.mean.column(side), 1.0);
                    mean.axpy(*share, &value, 1.0);
                    square.zip_apply(&value, |square, value| *square += share * value * value);
                }
            }
            let variances: Vec<_> =
                rows.iter().map(|rows| (rows * &covariance).component_mul(rows).column_sum()).collect();
            for (plane, [_, square]) in sums.iter_mut().enumerate() {
                let variances = &variances[plane.min(variances.len() - 1)];
                square.zip_apply(variances, |square, variance| *square += variance + own);
            }
        }
        let of = |i: usize, [mean, square]: &[DVector<f64>; 2]| {
            let (mean, square) = (mean[i], square[i]);
            Moments { mean, sd: (square - mean * mean).max(0.0).sqrt() }
        };
        (0..count).map(|i| sums.iter().map(|sums| of(i, sums)).collect()).collect()
    }
}

/// Rows of the design for a bin, each with its right-hand sides; what guide 2 does is taken off.
pub(super) fn rows(basis: &Basis, bin: &Bin, planes: usize) -> Vec<(DVector<f64>, Vec<f64>)> {
    let rest = |plane: usize| bin.tip_m[plane] - basis.guide2_m(plane, bin.depth_m, bin.leaving);
    let row = |block: usize| basis.row(block, bin.depth_m, bin.leaving);
    match basis.blocks() {
        1 => vec![(row(0), (0..planes).map(rest).collect())],
        _ => (0..planes).map(|plane| (row(plane), vec![rest(plane)])).collect(),
    }
}

/// Belief that follows a needle while it moves: readings come one by one, predictions may be asked for at any time.
///
/// Readings at one depth are gathered to one bin, as they are in a recording.
#[derive(Debug, Clone)]
pub struct Live<'c> {
    /// Without the bin that readings still go to.
    settled: Belief<'c>,
    /// With it.
    now: Belief<'c>,
    /// Depth, vertical and horizontal tip position of each of its readings, m.
    open: Vec<[f64; 3]>,
}

impl<'c> Live<'c> {
    /// Follows an insertion.
    pub fn new(belief: Belief<'c>) -> Self {
        Self { settled: belief.clone(), now: belief, open: Vec::new() }
    }

    /// Takes in one reading: depth, vertical and horizontal tip position, m.
    pub fn push(&mut self, depth_m: f64, tip_m: [f64; 2]) {
        if self.open.first().is_some_and(|first| (first[0] - depth_m).abs() < 0.5e-3) {
            self.now.believe(&self.settled);
        } else {
            self.settled.believe(&self.now);
            self.open.clear();
        }
        self.open.push([depth_m, tip_m[0], tip_m[1]]);
        let column = |i: usize| self.open.iter().map(|reading| reading[i]).collect::<Vec<_>>();
        let mean_m = column(0).iter().sum::<f64>() / self.open.len() as f64;
        self.now.update(&Bin {
            depth_m: mean_m,
            tip_m: [super::path::median(column(1)), super::path::median(column(2))],
            direction_rad: [None; 2],
            rows: self.open.len() as f64,
            moving: false,
            leaving: false,
        });
    }

    /// What is believed now.
    pub fn belief(&self) -> &Belief<'c> {
        &self.now
    }
}
