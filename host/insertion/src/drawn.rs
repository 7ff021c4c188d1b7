//! Draws from the posterior of an insertion: a part by its weight, then its unknowns from their normal distribution.

use super::basis::Measured;
use super::layout::{ANGLE, ENTRY, MODULUS};
use super::learned::Part;
use super::posterior::Posterior;
use nalgebra::{DMatrix, DVector};
use readings::draws::Random;

/// One draw of an insertion's path.
#[derive(Debug, Clone, PartialEq)]
pub struct PathDraw {
    /// Factor on the modulus of this insertion: its logarithm.
    pub modulus_ln: f64,
    /// Logarithm of its gap in m.
    pub gap_ln: f64,
    /// Angle of entry per plane, rad.
    pub entry_angle_rad: Vec<f64>,
    /// Tip position at every depth, per plane, on a smooth path, m.
    pub tip_m: Vec<Vec<f64>>,
    /// Standard deviation of the tip about the smooth path, m.
    pub irregularity_m: f64,
    /// Tip load at every depth in the needle's own frame, per plane, N.
    pub load_n: Vec<Vec<f64>>,
}

impl Posterior<'_> {
    /// So many draws, with the tip and the tip load at these depths.
    pub fn draws(
        &self,
        count: usize,
        random: &mut Random,
        tips_at_m: &[f64],
        loads_at_m: &[f64],
    ) -> Vec<PathDraw> {
        let draw_weights = self.shares();
        let weights: Vec<f64> = draw_weights.iter().map(|(_, share)| *share).collect();
        let picks = random.choices(&weights, count);
        let mut draws: Vec<Option<PathDraw>> = vec![None; count];
        // Roots and responses are computed once for each part that was chosen.
        for (number, (part, _)) in draw_weights.iter().enumerate() {
            let chosen: Vec<usize> = (0..count).filter(|draw| picks.get(*draw) == Some(&number)).collect();
            if !chosen.is_empty() {
                let sampler = Sampler::new(self, &self.parts[*part], tips_at_m, loads_at_m);
                for draw in chosen {
                    draws[draw] = Some(sampler.draw(random));
                }
            }
        }
        draws.into_iter().flatten().collect()
    }
}

/// One part with what its draws need.
struct Sampler<'a> {
    posterior: &'a Posterior<'a>,
    part: &'a Part,
    /// Per vector of unknowns.
    roots: Vec<DMatrix<f64>>,
    /// Per plane, with what is added to each.
    tips: Vec<(DMatrix<f64>, DVector<f64>)>,
    loads: Vec<DMatrix<f64>>,
}

impl<'a> Sampler<'a> {
    fn new(posterior: &'a Posterior<'a>, part: &'a Part, tips_at_m: &[f64], loads_at_m: &[f64]) -> Self {
        let layout = &posterior.candidates.layout;
        let basis = &posterior.nodes[part.node].basis;
        let locations = basis.places(tips_at_m.iter().map(|depth_m| (*depth_m, false)));
        let tips = (0..layout.planes).map(|plane| {
            let (rows, offsets) = basis.rows(plane, Measured::Position, &locations);
            (rows, DVector::from_vec(offsets))
        });
        let loads = (0..layout.planes).map(|plane| {
            let rows: Vec<_> =
                loads_at_m.iter().map(|depth_m| layout.load_row(plane, *depth_m).transpose()).collect();
            if rows.is_empty() { DMatrix::zeros(0, layout.unknowns()) } else { DMatrix::from_rows(&rows) }
        });
        Self {
            posterior,
            part,
            roots: part.normals.iter().map(|normal| Random::root(&normal.covariance)).collect(),
            tips: tips.collect(),
            loads: loads.collect(),
        }
    }

    fn draw(&self, random: &mut Random) -> PathDraw {
        let layout = &self.posterior.candidates.layout;
        let node = &self.posterior.nodes[self.part.node];
        let scales = &self.posterior.scales[self.part.scales];
        let unknowns: Vec<DVector<f64>> = self
            .part
            .normals
            .iter()
            .zip(&self.roots)
            .map(|(normal, root)| &normal.mean + root * random.normals(root.ncols()))
            .collect();
        let modulus = super::posterior::own(self.part, layout, MODULUS, scales.modulus_ln);
        let entry = super::posterior::own(self.part, layout, ENTRY, scales.shared_and_own_entry_m());
        let gap_m = (node.gap_m + entry.mean).max(0.1 * node.gap_m);
        let planes = || 0..layout.planes;
        PathDraw {
            modulus_ln: node.candidate.modulus_ln
                + modulus.mean
                + modulus.sd * self.standard_draw(MODULUS, &unknowns),
            gap_ln: gap_m.ln() + entry.sd / gap_m * self.standard_draw(ENTRY, &unknowns),
            entry_angle_rad: planes()
                .map(|plane| plane_unknowns(plane, &unknowns, layout)[layout.place(plane).1 + ANGLE])
                .collect(),
            tip_m: planes()
                .zip(&self.tips)
                .map(|(plane, (rows, beside))| {
                    (rows * plane_unknowns(plane, &unknowns, layout) + beside).iter().copied().collect()
                })
                .collect(),
            irregularity_m: scales.irregularity_m,
            load_n: planes()
                .zip(&self.loads)
                .map(|(plane, rows)| {
                    (rows * plane_unknowns(plane, &unknowns, layout)).iter().copied().collect()
                })
                .collect(),
        }
    }

    fn standard_draw(&self, unknown: usize, unknowns: &[DVector<f64>]) -> f64 {
        self.standard(unknowns, unknown)
    }

    /// An unknown that both planes have: how far the draw is from its mean, in standard deviations, over the planes as they are combined.
    fn standard(&self, unknowns: &[DVector<f64>], unknown: usize) -> f64 {
        let layout = &self.posterior.candidates.layout;
        let (mut pull, mut precision) = (0.0, 0.0);
        for plane in 0..layout.planes {
            let (system, first) = layout.place(plane);
            let normal = &self.part.normals[system];
            let variance = normal.covariance[(first + unknown, first + unknown)].max(1e-30);
            pull += (unknowns[system][first + unknown] - normal.mean[first + unknown]) / variance;
            precision += 1.0 / variance;
        }
        pull / precision.sqrt()
    }
}

/// Unknowns of the system that a plane belongs to.
fn plane_unknowns<'a>(
    plane: usize,
    unknowns: &'a [DVector<f64>],
    layout: &crate::Layout,
) -> &'a DVector<f64> {
    &unknowns[layout.place(plane).0]
}
