//! Posterior of one insertion's unknowns: a normal distribution per candidate of modulus and gap and sizes, updated by
//! each tip position (a Kalman filter over unknowns that do not change, which makes it a smoother of the tip load).

mod online;

pub use online::OnlinePosterior;

use super::basis::Measured;
use super::candidates::{Candidate, Candidates};
use super::layout::{ANGLE, ENTRY, Layout, MODULUS};
use super::learned::{Learned, Node, Normal, Part};
use super::path::{Bin, TipPath};
use super::rear::Rear;
use super::scales::Scales;
use super::weights::tempering;
use nalgebra::{DMatrix, DVector};

/// Parts below this share of the weight are omitted from a prediction.
const MIN_WEIGHT: f64 = 1e-4;
/// An estimate is at an end of its range where its mean is so many standard deviations of the prior from the prior's middle, or its
/// interval reaches further.
const END: f64 = 2.5;
const END_OF_INTERVAL: f64 = 3.2;
/// A posterior at least this wide, against the prior, adds no information.
const UNINFORMED: f64 = 0.8;

/// Mean and standard deviation.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Moments {
    /// Mean.
    pub mean: f64,
    /// Standard deviation.
    pub sd: f64,
}

/// Whether the data determine a quantity.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Identifiability {
    /// The data determine it: the interval is that of the data.
    Identified,
    /// The posterior reaches the upper end of the range: the lower end of the interval is a lower bound.
    LowerBound,
    /// The posterior reaches the lower end of the range: the upper end of the interval is an upper bound.
    UpperBound,
    /// The interval is that of what was assumed beforehand.
    NotIdentified,
}

impl Identifiability {
    /// As results have it.
    pub fn name(self) -> &'static str {
        match self {
            Self::Identified => "identified",
            Self::LowerBound => "lower_bound",
            Self::UpperBound => "upper_bound",
            Self::NotIdentified => "not_identified",
        }
    }
}

/// Posterior of one insertion.
#[derive(Debug, Clone)]
pub struct Posterior<'c> {
    pub(super) candidates: &'c Candidates,
    /// Possible sizes of the unknowns.
    pub(super) scales: Vec<Scales>,
    pub(super) nodes: Vec<Node>,
    pub(super) parts: Vec<Part>,
}

impl<'c> Posterior<'c> {
    /// Before the insertion that was learned for begins.
    pub fn new(candidates: &'c Candidates, learned: &Learned) -> Self {
        let Learned { scales, parts, nodes } = learned.clone();
        Self { candidates, scales, nodes, parts }
    }

    /// Takes in the tip at one depth: where it is and, where that was measured, its direction.
    pub fn update(&mut self, bin: &Bin) {
        let layout = &self.candidates.layout;
        for measured in [Measured::Position, Measured::Direction] {
            for plane in 0..layout.planes {
                let Some(value) = measured.of(bin, plane) else { continue };
                let rows: Vec<_> = self
                    .nodes
                    .iter()
                    .map(|node| node.basis.row(plane, measured, bin.depth_m, bin.leaving))
                    .collect();
                let (system, _) = layout.place(plane);
                for Part { node, scales, ln_weight, normals } in &mut self.parts {
                    let variance = self.scales[*scales].variance(measured, bin.rows, bin.moving);
                    let (row, offset) = &rows[*node];
                    *ln_weight += normals[system].update(row, value - offset, variance);
                }
            }
        }
    }

    /// Takes in a whole recording. If it is far from the prediction of every part, weights are tempered so that more
    /// than a single part remains.
    pub fn update_all(&mut self, path: &TipPath) {
        path.bins.iter().for_each(|bin| self.update(bin));
        let ln_weights: Vec<f64> = self.parts.iter().map(|part| part.ln_weight).collect();
        let power = tempering(&ln_weights);
        self.parts.iter_mut().for_each(|part| part.ln_weight *= power);
    }

    /// Copies the state of `other`, which began as this one did; nothing is allocated.
    fn copy_from(&mut self, other: &Self) {
        for (part, other) in self.parts.iter_mut().zip(&other.parts) {
            part.ln_weight = other.ln_weight;
            for (normal, other) in part.normals.iter_mut().zip(&other.normals) {
                normal.mean.copy_from(&other.mean);
                normal.covariance.copy_from(&other.covariance);
            }
        }
    }

    /// Whether any part explains what was taken in with a likelihood that is a number.
    pub fn is_sound(&self) -> bool {
        self.parts.iter().any(|part| part.ln_weight.is_finite())
    }

    /// Tip position at each depth, per plane; the scatter of single depths about a smooth path is part of it, the noise of a reading
    /// is not. m.
    pub fn tip_m(&self, depths_m: &[f64]) -> Vec<Vec<Moments>> {
        let depths = || depths_m.iter().map(|depth_m| (*depth_m, false));
        self.moments(
            depths_m.len(),
            |node, plane| node.basis.rows(plane, Measured::Position, &node.basis.places(depths())),
            |scales| scales.irregularity_m.powi(2),
        )
    }

    /// Displacement of the tip from one location of the path to another, per plane, m; a location is a depth, on
    /// arriving (`false`) or on leaving (`true`), after the changes at rest there. The scatter of single depths is part
    /// of it where the depths differ.
    pub fn tip_change_m(&self, from: (f64, bool), to: (f64, bool)) -> Vec<Moments> {
        let scatter = if from.0 == to.0 { 0.0 } else { 2.0 };
        self.change(Measured::Position, from, to, |scales| scatter * scales.irregularity_m.powi(2))
    }

    /// The same of the needle's slope at the tip, rad; nothing where no direction was measured.
    pub fn direction_change_rad(&self, from: (f64, bool), to: (f64, bool)) -> Option<Vec<Moments>> {
        self.candidates.layout.direction.then(|| self.change(Measured::Direction, from, to, |_| 0.0))
    }

    fn change(
        &self,
        measured: Measured,
        from: (f64, bool),
        to: (f64, bool),
        variance: impl Fn(&Scales) -> f64,
    ) -> Vec<Moments> {
        self.moments(
            1,
            |node: &Node, plane: usize| {
                let (rows, offsets) = node.basis.rows(plane, measured, &node.basis.places([from, to]));
                let change = rows.row(1) - rows.row(0);
                (DMatrix::from_rows(&[change]), vec![offsets[1] - offsets[0]])
            },
            variance,
        )
        .swap_remove(0)
    }

    /// Tip load at each depth in the needle's own frame, per plane, N.
    pub fn load_n(&self, depths_m: &[f64]) -> Vec<Vec<Moments>> {
        let layout = &self.candidates.layout;
        let of_plane: Vec<_> = (0..layout.planes)
            .map(|plane| {
                let rows: Vec<_> =
                    depths_m.iter().map(|depth_m| layout.load_row(plane, *depth_m).transpose()).collect();
                (DMatrix::from_rows(&rows), vec![0.0; depths_m.len()])
            })
            .collect();
        self.moments(depths_m.len(), |_, plane| of_plane[plane].clone(), |_| 0.0)
    }

    /// Angle of entry per plane, rad; a tilt of the tracker against the rig is part of it.
    pub fn entry_angle_rad(&self) -> Vec<Moments> {
        let layout = &self.candidates.layout;
        let row = |plane: usize| {
            let mut row = DMatrix::zeros(1, layout.unknowns());
            row[(0, layout.place(plane).1 + ANGLE)] = 1.0;
            (row, vec![0.0])
        };
        self.moments(1, |_, plane| row(plane), |_| 0.0).swap_remove(0)
    }

    /// Factor on the modulus of this insertion, and its gap in m: means and standard deviations of their logarithms.
    pub fn ln_modulus_factor_and_gap(&self) -> [Moments; 2] {
        let layout = &self.candidates.layout;
        let modulus = self.mixed(|part, node, scales| {
            let own_modulus = own(part, layout, MODULUS, scales.modulus_ln);
            Moments { mean: node.candidate.modulus_ln + own_modulus.mean, sd: own_modulus.sd }
        });
        let gap = self.mixed(|part, node, scales| {
            let own_entry = own(part, layout, ENTRY, scales.shared_and_own_entry_m());
            // The surface lies before guide 2 nowhere.
            let gap_m = (node.gap_m + own_entry.mean).max(0.1 * node.gap_m);
            Moments { mean: gap_m.ln(), sd: own_entry.sd / gap_m }
        });
        [modulus, gap]
    }

    /// Share of this insertion's rear less the middle of what is known beforehand, per plane, and whether the data determine it; nothing
    /// where it is stated.
    pub fn rear_share(&self) -> Option<[Option<(Moments, Identifiability)>; 2]> {
        let layout = &self.candidates.layout;
        let (rear, rear_column) = (self.candidates.rear()?, layout.rear()?);
        let of_plane = |plane: usize| {
            if !rear.unknown[plane] || plane >= layout.planes {
                return None;
            }
            let (system, first_column) = layout.place(plane);
            let moments = self.mixed(|part, _, _| {
                let normal = &part.normals[system];
                let variance =
                    normal.covariance[(first_column + rear_column, first_column + rear_column)].max(0.0);
                Moments { mean: normal.mean[first_column + rear_column], sd: variance.sqrt() }
            });
            Some((moments, is_share_determined(moments, rear)))
        };
        Some([of_plane(0), of_plane(1)])
    }

    /// Whether the data determine modulus and gap.
    pub fn determined(&self) -> [Identifiability; 2] {
        let [modulus_sd, gap_sd] = self.candidates.prior_sds();
        [
            self.determined_value(&|node| node.candidate.modulus_ln, modulus_sd),
            self.determined_value(&|node| node.candidate.gap_ln, gap_sd),
        ]
    }

    fn determined_value(&self, value: &dyn Fn(&Node) -> f64, sd: f64) -> Identifiability {
        determined(self.mixed(|_, node, _| Moments { mean: value(node), sd: 0.0 }), sd)
    }

    /// Ends of the range of the modulus, as factors, and of the gap, m.
    pub fn range(&self) -> [[f64; 2]; 2] {
        let low = self.corner(f64::NEG_INFINITY, f64::NEG_INFINITY);
        let high = self.corner(f64::INFINITY, f64::INFINITY);
        [[low, high].map(|end| end.modulus_ln.exp()), [low, high].map(|end| self.candidates.gap_m(end))]
    }

    /// Candidate with these logarithms, within the range of the lattice.
    fn corner(&self, modulus_ln: f64, gap_ln: f64) -> Candidate {
        self.candidates.clamped(Candidate { modulus_ln, gap_ln, ..Candidate::default() })
    }

    /// Mean of the logarithm of a size.
    pub fn typical(&self, size: impl Fn(&Scales) -> f64) -> f64 {
        self.mixed(|_, _, scales| Moments { mean: size(scales).ln(), sd: 0.0 }).mean.exp()
    }

    /// Moments over the parts.
    fn mixed(&self, of: impl Fn(&Part, &Node, &Scales) -> Moments) -> Moments {
        let (mut mean, mut square) = (0.0, 0.0);
        for (part, share) in self.shares() {
            let mixture_part = &self.parts[part];
            let value = of(mixture_part, &self.nodes[mixture_part.node], &self.scales[mixture_part.scales]);
            mean += share * value.mean;
            square += share * (value.mean * value.mean + value.sd * value.sd);
        }
        Moments { mean, sd: (square - mean * mean).max(0.0).sqrt() }
    }

    /// Number and weight of the parts that count; the weights sum to 1.
    pub(super) fn shares(&self) -> Vec<(usize, f64)> {
        let finite = self.parts.iter().enumerate().filter(|(_, part)| part.ln_weight.is_finite());
        let most = finite.clone().map(|(_, part)| part.ln_weight).fold(f64::NEG_INFINITY, f64::max);
        let mut weights: Vec<_> = finite.map(|(i, part)| (i, (part.ln_weight - most).exp())).collect();
        let total: f64 = weights.iter().map(|(_, share)| share).sum();
        weights.retain(|(_, share)| *share > MIN_WEIGHT * total);
        let total: f64 = weights.iter().map(|(_, share)| share).sum();
        weights.iter_mut().for_each(|(_, share)| *share /= total);
        weights
    }

    /// Linear functions of the unknowns over the parts that count: `count` of them per plane, as rows with what is added to each, and
    /// the variance that is added to all. Moments per function and plane.
    ///
    /// Parts of one candidate have the same functions, so that the sum of their variances is the variance under the sum of their
    /// covariances, each by its share: the costly product is done once for each candidate.
    fn moments(
        &self,
        count: usize,
        rows: impl Fn(&Node, usize) -> (DMatrix<f64>, Vec<f64>),
        variance: impl Fn(&Scales) -> f64,
    ) -> Vec<Vec<Moments>> {
        let layout = &self.candidates.layout;
        let mut weights = self.shares();
        weights.sort_by_key(|(part, _)| self.parts[*part].node);
        // Mean and mean square, per plane. Squares are taken about the first part's values: digits count.
        let mut sums =
            vec![[DVector::zeros(count), DVector::zeros(count), DVector::zeros(count)]; layout.planes];
        let mut covariance = DMatrix::zeros(layout.unknowns(), layout.unknowns());
        for (number, same) in
            weights.chunk_by(|(a, _), (b, _)| self.parts[*a].node == self.parts[*b].node).enumerate()
        {
            let node = &self.nodes[same.first().map_or(0, |(part, _)| self.parts[*part].node)];
            for (plane, [about, mean, square]) in sums.iter_mut().enumerate() {
                let (rows, offsets) = rows(node, plane);
                let offset_vector = DVector::from_vec(offsets);
                let (system, _) = layout.place(plane);
                covariance.fill(0.0);
                let mut own_variance = 0.0;
                for (i, (part, share)) in same.iter().enumerate() {
                    let Part { scales, normals, .. } = &self.parts[*part];
                    let Normal { mean: unknowns, covariance: part_covariance } = &normals[system];
                    covariance.zip_apply(part_covariance, |sum, value| *sum += share * value);
                    own_variance += share * variance(&self.scales[*scales]);
                    let value = &rows * unknowns + &offset_vector;
                    if number == 0 && i == 0 {
                        about.copy_from(&value);
                    }
                    let value = value - &*about;
                    mean.axpy(*share, &value, 1.0);
                    square.zip_apply(&value, |square, value| *square += share * value * value);
                }
                let variances = (&rows * &covariance).component_mul(&rows).column_sum();
                square.zip_apply(&variances, |square, variance| *square += variance + own_variance);
            }
        }
        (0..count).map(|i| sums.iter().map(|sums| total_variance(i, sums)).collect()).collect()
    }
}

/// Law of total variance for one quantity.
fn total_variance(i: usize, [about, mean, square]: &[DVector<f64>; 3]) -> Moments {
    let (mean, square) = (mean[i], square[i]);
    Moments { mean: about[i] + mean, sd: (square - mean * mean).max(0.0).sqrt() }
}

/// Whether a posterior determines a logarithm better than its prior, of mean 0 and standard deviation `sd`.
fn determined(Moments { mean, sd: found }: Moments, sd: f64) -> Identifiability {
    // The data need not determine a quantity that is given beforehand to a few per cent.
    let is_given = sd <= GIVEN_LN;
    if is_given {
        Identifiability::Identified
    } else if mean > END * sd || mean + 2.0 * found > END_OF_INTERVAL * sd {
        Identifiability::LowerBound
    } else if mean < -END * sd || mean - 2.0 * found < -END_OF_INTERVAL * sd {
        Identifiability::UpperBound
    } else if found > UNINFORMED * sd {
        Identifiability::NotIdentified
    } else {
        Identifiability::Identified
    }
}

/// The same of a rear: its stiffness is a bound where the share may be that of a clamp or of a hinge.
fn is_share_determined(Moments { mean, sd }: Moments, rear: &Rear) -> Identifiability {
    if sd > UNINFORMED * rear.sd {
        Identifiability::NotIdentified
    } else if rear_at(-2.0, mean, sd, rear.middle) < SHARE_OF_CLAMP {
        Identifiability::LowerBound
    } else if rear_at(2.0, mean, sd, rear.middle) > 1.0 - SHARE_OF_CLAMP {
        Identifiability::UpperBound
    } else {
        Identifiability::Identified
    }
}

/// Share of the rear guide at a number of standard deviations from its mean.
fn rear_at(sds: f64, mean: f64, sd: f64, middle: f64) -> f64 {
    middle + mean + sds * sd
}

/// A smaller share of a rear is that of a clamp.
const SHARE_OF_CLAMP: f64 = 0.02;
/// A prior of the logarithm not wider than this was given.
const GIVEN_LN: f64 = 0.3;

/// An unknown that both planes have: the value of each, with the prior counted once.
pub(super) fn own(part: &Part, layout: &Layout, unknown: usize, prior_sd: f64) -> Moments {
    let (mut precision, mut pull) = (0.0, 0.0);
    for plane in 0..layout.planes {
        let (system, first_column) = layout.place(plane);
        let normal = &part.normals[system];
        let variance = normal.covariance[(first_column + unknown, first_column + unknown)].max(1e-30);
        pull += normal.mean[first_column + unknown] / variance;
        precision += 1.0 / variance;
    }
    let prior = prior_sd.powi(-2);
    precision = (precision - (layout.planes as f64 - 1.0) * prior).max(prior);
    Moments { mean: pull / precision, sd: precision.sqrt().recip() }
}
