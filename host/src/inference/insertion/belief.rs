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

/// One candidate's normal distribution of the unknowns, as standard normal numbers were before.
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
}

/// Belief about one insertion.
#[derive(Debug, Clone)]
pub struct Belief<'c> {
    candidates: &'c Candidates,
    /// Which recording's plan is followed.
    path: usize,
    /// Possible sizes of the unknowns, with the map from standard normal numbers to unknowns.
    scales: Vec<(Scales, DMatrix<f64>)>,
    parts: Vec<Part>,
}

impl<'c> Belief<'c> {
    /// Before anything of recording `path` is seen.
    pub fn new(candidates: &'c Candidates, path: usize, learned: &Learned) -> Self {
        let scales = learned.scales.iter().map(|scales| (*scales, scales.map(&candidates.layout))).collect();
        Self { candidates, path, scales, parts: learned.parts.clone() }
    }

    /// Takes in the tip at one depth.
    pub fn update(&mut self, bin: &Bin) {
        for Part { candidate, scales, ln_weight, normal } in &mut self.parts {
            let basis = &self.candidates.bases[*candidate][self.path];
            let (scales, map) = &self.scales[*scales];
            let variance = scales.variance_m2(bin.rows, bin.moving);
            for (row, measured) in rows(basis, bin, self.candidates.layout.planes) {
                *ln_weight += normal.update(&map.tr_mul(&row), &measured, variance);
            }
        }
    }

    /// Takes in a whole recording.
    pub fn update_all(&mut self, path: &TipPath) {
        path.bins.iter().for_each(|bin| self.update(bin));
    }

    /// Tip position at a depth, per plane; the scatter of single depths about a smooth path is part of it, the noise of a reading
    /// is not. m.
    pub fn tip_m(&self, depth_m: f64) -> Vec<Moments> {
        let planes = self.candidates.layout.planes;
        self.moments(planes, |basis, scales, plane| {
            let block = plane.min(basis.blocks() - 1);
            (
                basis.row(block, depth_m, false),
                basis.guide2_m(plane, depth_m, false),
                scales.irregularity_m.powi(2),
            )
        })
    }

    /// Tip load at a depth in the needle's own frame, per plane, N.
    pub fn load_n(&self, depth_m: f64) -> Vec<Moments> {
        let rows = self.candidates.layout.load_rows(depth_m);
        self.moments(self.candidates.layout.planes, |_, _, plane| {
            (rows[plane.min(rows.len() - 1)].clone(), 0.0, 0.0)
        })
    }

    /// Angle of entry per plane, rad.
    pub fn entry_angle_rad(&self) -> Vec<Moments> {
        let layout = &self.candidates.layout;
        self.moments(layout.planes, |_, _, plane| {
            let mut row = DVector::zeros(layout.unknowns());
            row[1 + if layout.coupled { plane * layout.of_plane() } else { 0 }] = 1.0;
            (row, 0.0, 0.0)
        })
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
        self.mixed(|part| size(&self.scales[part.scales].0).ln()).mean.exp()
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
        let most = self.parts.iter().map(|part| part.ln_weight).fold(f64::NEG_INFINITY, f64::max);
        let mut shares: Vec<_> =
            self.parts.iter().enumerate().map(|(i, part)| (i, (part.ln_weight - most).exp())).collect();
        let total: f64 = shares.iter().map(|(_, share)| share).sum();
        shares.retain(|(_, share)| *share > LEAST_WEIGHT * total);
        let total: f64 = shares.iter().map(|(_, share)| share).sum();
        shares.iter_mut().for_each(|(_, share)| *share /= total);
        shares
    }

    /// Moments of a linear function of the unknowns over all candidates, per plane: row, constant, variance beside.
    fn moments(
        &self,
        planes: usize,
        function: impl Fn(&Basis, &Scales, usize) -> (DVector<f64>, f64, f64),
    ) -> Vec<Moments> {
        let shares = self.shares();
        let of_plane = |plane: usize| {
            let (mut mean, mut square) = (0.0, 0.0);
            for (part, share) in &shares {
                let Part { candidate, scales, normal, .. } = &self.parts[*part];
                let (scales, map) = &self.scales[*scales];
                let basis = &self.candidates.bases[*candidate][self.path];
                let (row, constant, beside) = function(basis, scales, plane);
                let row = map.tr_mul(&row);
                let side = if self.candidates.layout.coupled { 0 } else { plane };
                let value = row.dot(&normal.mean.column(side)) + constant;
                let variance = row.dot(&(&normal.covariance * &row)) + beside;
                mean += share * value;
                square += share * (value * value + variance);
            }
            Moments { mean, sd: (square - mean * mean).max(0.0).sqrt() }
        };
        (0..planes).map(of_plane).collect()
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
    settled: Belief<'c>,
    /// The bin that readings still go to, and the belief with it.
    open: Option<(Vec<[f64; 3]>, Belief<'c>)>,
}

impl<'c> Live<'c> {
    /// Follows an insertion.
    pub fn new(belief: Belief<'c>) -> Self {
        Self { settled: belief, open: None }
    }

    /// Takes in one reading: depth, vertical and horizontal tip position, m.
    pub fn push(&mut self, depth_m: f64, tip_m: [f64; 2]) {
        let same =
            |readings: &[[f64; 3]]| readings.first().is_some_and(|first| (first[0] - depth_m).abs() < 0.5e-3);
        let mut readings = match self.open.take() {
            Some((readings, _)) if same(&readings) => readings,
            Some((_, belief)) => {
                self.settled = belief;
                Vec::new()
            }
            None => Vec::new(),
        };
        readings.push([depth_m, tip_m[0], tip_m[1]]);
        let column = |i: usize| readings.iter().map(|reading| reading[i]).collect::<Vec<_>>();
        let mean_m = column(0).iter().sum::<f64>() / readings.len() as f64;
        let bin = Bin {
            depth_m: mean_m,
            tip_m: [super::path::median(column(1)), super::path::median(column(2))],
            rows: readings.len() as f64,
            moving: false,
            leaving: false,
        };
        let mut belief = self.settled.clone();
        belief.update(&bin);
        self.open = Some((readings, belief));
    }

    /// What is believed now.
    pub fn belief(&self) -> &Belief<'c> {
        self.open.as_ref().map_or(&self.settled, |(_, belief)| belief)
    }
}
