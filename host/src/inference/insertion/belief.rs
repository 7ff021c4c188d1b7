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

    /// Whether any part explains what was taken in with a likelihood that is a number.
    pub fn is_sound(&self) -> bool {
        self.parts.iter().any(|part| part.ln_weight.is_finite())
    }

    /// Tip position at each depth, per plane; the scatter of single depths about a smooth path is part of it, the noise of a reading
    /// is not. m.
    pub fn tip_m(&self, depths_m: &[f64]) -> Vec<Vec<Moments>> {
        self.moments(depths_m.len(), |basis, block| {
            let rows: Vec<_> =
                depths_m.iter().map(|depth_m| basis.row(block, *depth_m, false).transpose()).collect();
            DMatrix::from_rows(&rows)
        })
        .of_tips(depths_m)
    }

    /// Tip load at each depth in the needle's own frame, per plane, N.
    pub fn load_n(&self, depths_m: &[f64]) -> Vec<Vec<Moments>> {
        let rows = |block: usize| {
            let at = |depth_m: &f64| self.candidates.layout.load_rows(*depth_m)[block].transpose();
            DMatrix::from_rows(&depths_m.iter().map(at).collect::<Vec<_>>())
        };
        let rows: Vec<_> = (0..self.blocks()).map(rows).collect();
        self.moments(depths_m.len(), |_, block| rows[block].clone()).of_unknowns()
    }

    /// Angle of entry per plane, rad.
    pub fn entry_angle_rad(&self) -> Vec<Moments> {
        let layout = &self.candidates.layout;
        let angle = |block: usize| {
            let mut row = DMatrix::zeros(1, layout.unknowns());
            row[(0, 1 + block * layout.of_plane())] = 1.0;
            row
        };
        self.moments(1, |_, block| angle(block)).of_unknowns().swap_remove(0)
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

    /// Linear functions of the unknowns, `count` of them per block, in every part that counts.
    fn moments(&self, count: usize, rows: impl Fn(&Basis, usize) -> DMatrix<f64>) -> Spread<'_, '_> {
        let layout = &self.candidates.layout;
        // Parts with the same candidate have the same rows.
        let mut of_candidate: Vec<Vec<DMatrix<f64>>> = vec![Vec::new(); self.candidates.list.len()];
        let parts = self.shares().into_iter().map(|(part, share)| {
            let Part { candidate, scales, normal, .. } = &self.parts[part];
            let known = &mut of_candidate[*candidate];
            if known.is_empty() {
                let basis = &self.candidates.bases[*candidate][self.path];
                known.extend((0..self.blocks()).map(|block| rows(basis, block)));
            }
            let of_block = |rows: &DMatrix<f64>| {
                let rows = rows * &self.scales[*scales].1;
                let spread = &rows * &normal.covariance;
                let variances = (0..count).map(|i| rows.row(i).dot(&spread.row(i))).collect::<Vec<f64>>();
                (&rows * &normal.mean, variances)
            };
            let blocks: Vec<_> = known.iter().map(of_block).collect();
            let planes = (0..layout.planes).map(|plane| {
                let (means, variances) = &blocks[plane.min(blocks.len() - 1)];
                let side = if layout.coupled { 0 } else { plane };
                (0..count).map(|i| (means[(i, side)], variances[i])).collect()
            });
            OfPart { part, share, planes: planes.collect() }
        });
        Spread { belief: self, count, parts: parts.collect() }
    }
}

/// Values and variances in every part that counts.
struct Spread<'b, 'c> {
    belief: &'b Belief<'c>,
    count: usize,
    parts: Vec<OfPart>,
}

/// Value and variance of every function in one part.
struct OfPart {
    /// Number among the parts of the belief.
    part: usize,
    share: f64,
    /// Per plane, per function.
    planes: Vec<Vec<(f64, f64)>>,
}

impl Spread<'_, '_> {
    /// Moments over the parts, per function and plane; `beside` adds to value and variance.
    fn mixed(&self, beside: impl Fn(&Part, usize, usize) -> (f64, f64)) -> Vec<Vec<Moments>> {
        let of = |i: usize, plane: usize| {
            let (mut mean, mut square) = (0.0, 0.0);
            for OfPart { part, share, planes } in &self.parts {
                let (value, variance) = planes[plane][i];
                let (more, more_variance) = beside(&self.belief.parts[*part], plane, i);
                mean += share * (value + more);
                square += share * ((value + more).powi(2) + variance + more_variance);
            }
            Moments { mean, sd: (square - mean * mean).max(0.0).sqrt() }
        };
        let planes = self.belief.candidates.layout.planes;
        (0..self.count).map(|i| (0..planes).map(|plane| of(i, plane)).collect()).collect()
    }

    /// Of unknowns.
    fn of_unknowns(&self) -> Vec<Vec<Moments>> {
        self.mixed(|_, _, _| (0.0, 0.0))
    }

    /// Of tips: what guide 2 does is added, and the irregularity.
    fn of_tips(&self, depths_m: &[f64]) -> Vec<Vec<Moments>> {
        let Belief { candidates, scales, path, .. } = self.belief;
        self.mixed(|part, plane, i| {
            let basis = &candidates.bases[part.candidate][*path];
            let irregularity_m = scales[part.scales].0.irregularity_m;
            (basis.guide2_m(plane, depths_m[i], false), irregularity_m.powi(2))
        })
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
