//! Unknowns of needle, tissue and rig, their order in vectors, and their priors.
//!
//! Every unknown is counted in standard deviations of its prior from the prior's mean, so that the prior's covariance is a matrix of
//! correlations. The first [`TISSUE`] unknowns change the needle's responses (modulus of five layers, skin, gap, rotation in guide 1); the path is linear in
//! all others.

use crate::known::{self, KnownEffect};
use crate::protocol::Statement;
use crate::tables::hats;
use mechanics::unknowns::{rig, sensors, tip, tissue};
use mechanics::{BeamProblem, Foundation, Layer, ModelError, Needle, Rig};
use nalgebra::DMatrix;

/// Lower faces of the layers whose moduli are unknown, m; the last layer goes on.
const FACES_M: [f64; 4] = [0.010, 0.025, 0.045, 0.070];
/// Number of layers.
pub(crate) const LAYERS: usize = FACES_M.len() + 1;
/// Place of the skin among the unknowns.
pub(crate) const SKIN: usize = LAYERS;
/// Place of the gap.
pub(crate) const GAP: usize = LAYERS + 1;
/// Place of the rotation in guide 1 among the unknowns.
pub(crate) const CLAMP: usize = LAYERS + 2;
/// Unknowns that change the responses.
pub(crate) const TISSUE: usize = LAYERS + 3;
/// Distance of knots of the tip's load and of the path's irregularity, m.
pub(crate) const KNOT_M: f64 = 0.010;

/// Law by which the tip cuts.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum CuttingLaw {
    /// It takes a load and goes where that bends the needle.
    Load,
    /// It goes along the needle's direction, at an angle.
    Angle,
}

/// Unknowns of one law.
#[derive(Debug, Clone)]
pub(crate) struct Unknowns {
    pub law: CuttingLaw,
    /// Needle, guides and tissue at the prior's mean.
    pub problem: BeamProblem,
    /// Modulus at the prior's mean, Pa.
    modulus_pa: f64,
    /// Knots along the path.
    pub knots: usize,
    /// Standard deviations of the priors, SI.
    pub sd: Vec<f64>,
    /// Means of the priors, SI: 0 but for the tip's load and the backlash.
    pub mean: Vec<f64>,
    /// Correlations of the prior, inverted.
    pub precision: DMatrix<f64>,
    /// Logarithm of its determinant.
    pub ln_determinant: f64,
}

impl Unknowns {
    pub fn new(
        stated: &Statement,
        known: &[KnownEffect],
        law: CuttingLaw,
        target_m: f64,
    ) -> Result<Self, ModelError> {
        let prior = stated.prior.as_ref();
        let reference = Needle::gauge_18().bending_stiffness_n_m2();
        let diameter_m = stated.needle.outer_diameter_mm.map_or(1.27e-3, |mm| 1e-3 * mm);
        // Without a stiffness that of a needle of the same shape: the path determines K/(E I) alone.
        let stiffness = stated.needle.ei_n_m2.unwrap_or(reference * (diameter_m / 1.27e-3).powi(4));
        let guide2_m = 1e-3 * stated.rig.guide1_to_guide2_mm.unwrap_or(60.0);
        let entry_m = guide2_m + 1e-3 * stated.rig.guide2_to_surface_mm;
        let stated_rig = Rig::two_guides(Needle::gauge_18(), guide2_m, entry_m);
        let (factor, modulus_sd) =
            center_and_spread(prior.and_then(|prior| prior.foundation_range), tissue::STATED_MODULUS.sd());
        let modulus_pa = 1e3
            * factor
            * prior
                .and_then(|prior| prior.foundation_kpa)
                .filter(|k| *k > 0.0)
                .unwrap_or(1e-3 * tissue::STATED_MODULUS.mean());
        let unknown_stiffness =
            if stated.needle.ei_n_m2.is_some() { 0.0 } else { rig::UNSTATED_STIFFNESS.sd() };
        let modulus_sd = f64::hypot(modulus_sd, unknown_stiffness);
        let mut problem = BeamProblem {
            bending_stiffness_n_m2: stiffness,
            skin_n_per_m: tissue::SKIN.mean(),
            ..BeamProblem::new(&stated_rig, Foundation::uniform(modulus_pa)?, target_m)
        };
        known::apply(known, stated.needle.ei_n_m2.is_some(), &mut problem)?;
        let clamp_sd = known::clamp_sd(known).unwrap_or(rig::CLAMP_COMPLIANCE.sd());
        if problem.clamp_compliance_rad_per_n_m <= 0.0 {
            problem.clamp_compliance_rad_per_n_m = rig::CLAMP_COMPLIANCE.mean();
        }
        let load = prior.and_then(|prior| prior.tip_load_n);
        let (load_factor, load_sd) = match prior.and_then(|prior| prior.tip_load_range) {
            Some([low, high]) if high > low => (0.5 * (low + high), (high - low) / 12f64.sqrt()),
            _ => (tip::STATED_LOAD.mean(), tip::STATED_LOAD.sd()),
        };
        let load_n = load.unwrap_or(tip::TYPICAL_LOAD.mean());
        let slope =
            prior.and_then(|prior| prior.slope_mrad).map_or(tip::STAGE_ANGLE.sd(), |mrad| 1e-3 * mrad);
        let error_m = 1e-3 * stated.guide_error_mm;
        let [play_m, play_sd_m] = known::play_m(known).unwrap_or([rig::STAGE_BACKLASH.sd() * error_m; 2]);

        let knots = (target_m / KNOT_M).ceil() as usize + 1;
        let mut model = Self {
            law,
            problem,
            modulus_pa,
            knots,
            sd: Vec::new(),
            mean: Vec::new(),
            precision: DMatrix::zeros(0, 0),
            ln_determinant: 0.0,
        };
        let count = model.count();
        (model.sd, model.mean) = (vec![0.0; count], vec![0.0; count]);
        let mut correlation = DMatrix::identity(count, count);

        model.sd[..LAYERS].fill(modulus_sd.hypot(tissue::LAYER_MODULUS.sd()));
        (model.sd[SKIN], model.sd[GAP], model.sd[CLAMP]) =
            (tissue::SKIN.sd(), tissue::GAP_OF_STAGE.sd(), clamp_sd);
        for i in 0..LAYERS {
            for j in 0..LAYERS {
                let alike =
                    (-(layer_middle_m(i) - layer_middle_m(j)).abs() / tissue::LAYER_LENGTH.mean()).exp();
                correlation[(i, j)] =
                    (modulus_sd.powi(2) + tissue::LAYER_MODULUS.sd().powi(2) * alike) / model.sd[i].powi(2);
            }
        }
        for (start, sd, mean) in [
            (model.slope(), slope.max(1e-4), 0.0),
            (model.offset(), sensors::STEERED_TIP_ZERO.sd(), 0.0),
            (model.guide_offset(), (rig::STAGE_ERROR.sd() * error_m).max(1e-6), 0.0),
            (model.backlash(), play_sd_m.max(1e-6), play_m),
            (model.beside(), tip::CUT_ANGLE_BESIDE_LOAD.sd(), 0.0),
        ] {
            model.sd[start..start + 2].fill(sd);
            model.mean[start..start + 2].fill(mean);
        }
        // The common part of the load or angle and what varies about it.
        let [along_sd, across_sd] = match law {
            CuttingLaw::Load => [
                [load_sd * load_factor.max(0.3) * load_n, tip::STEERED_PROCESS_NOISE.sd() * load_n],
                [tip::LOAD_ACROSS.sd() * load_n, tip::PROCESS_NOISE_ACROSS.sd() * load_n],
            ],
            CuttingLaw::Angle => [
                [tip::CUT_ANGLE.sd(), tip::CUT_ANGLE_NOISE.sd()],
                [tip::CUT_ANGLE_ACROSS.sd(), tip::CUT_ANGLE_NOISE.sd()],
            ],
        };
        for (direction, [common, varying]) in [along_sd, across_sd].into_iter().enumerate() {
            let start = model.tip(direction, 0);
            let sd = common.hypot(varying).max(1e-9);
            let mean = if law == CuttingLaw::Load && direction == 0 { load_factor * load_n } else { 0.0 };
            model.fill_knots(&mut correlation, start, sd, mean, |apart_m: f64| {
                (common * common + varying * varying * (-apart_m / tip::STEERED_LOAD_MEMORY.mean()).exp())
                    / (sd * sd)
            });
        }
        for plane in 0..2 {
            let start = model.irregularity(plane, 0);
            model.fill_knots(&mut correlation, start, tip::STEERED_IRREGULARITY.sd(), 0.0, |apart_m: f64| {
                (-(apart_m / tip::IRREGULARITY_LENGTH.mean()).powi(2)).exp()
            });
        }
        for i in 0..count {
            correlation[(i, i)] += 1e-6;
        }
        let cholesky = correlation.cholesky().ok_or(ModelError::Singular)?;
        model.ln_determinant = -2.0 * cholesky.l_dirty().diagonal().iter().map(|d| d.ln()).sum::<f64>();
        model.precision = cholesky.inverse();
        Ok(model)
    }

    fn fill_knots(
        &mut self,
        correlation: &mut DMatrix<f64>,
        start: usize,
        sd: f64,
        mean: f64,
        correlated: impl Fn(f64) -> f64,
    ) {
        for i in 0..self.knots {
            self.sd[start + i] = sd;
            self.mean[start + i] = mean;
            for j in 0..self.knots {
                correlation[(start + i, start + j)] = correlated(KNOT_M * i.abs_diff(j) as f64);
            }
        }
    }

    /// All of them.
    pub fn count(&self) -> usize {
        self.irregularity(1, self.knots)
    }

    /// Angle between needle and axis, two planes.
    pub fn slope(&self) -> usize {
        TISSUE
    }

    /// Tip beside the axis at the surface, two planes.
    pub fn offset(&self) -> usize {
        TISSUE + 2
    }

    /// Constant error of the guide, two planes.
    pub fn guide_offset(&self) -> usize {
        TISSUE + 4
    }

    /// Backlash of the guide (half of it), two planes.
    pub fn backlash(&self) -> usize {
        TISSUE + 6
    }

    /// Cut angle beside a load, along and across the bevel.
    pub fn beside(&self) -> usize {
        TISSUE + 8
    }

    /// Load or angle of the tip, along and across the bevel, per knot.
    pub fn tip(&self, direction: usize, knot: usize) -> usize {
        TISSUE + 10 + direction * self.knots + knot
    }

    /// Irregularity of the path per plane and knot.
    pub fn irregularity(&self, plane: usize, knot: usize) -> usize {
        TISSUE + 10 + (2 + plane) * self.knots + knot
    }

    /// Derivatives of the tip in a plane at a depth with respect to the unknowns that carry the needle and its path along, in
    /// standard deviations, into `row`; the others are left as they are.
    pub fn carry(&self, depth_m: f64, plane: usize, row: &mut [f64]) {
        let mut set = |place: usize, value: f64| row[place] = self.sd[place] * value;
        set(self.slope() + plane, depth_m);
        set(self.offset() + plane, 1.0);
        for (knot, weight) in hats(depth_m, self.knots) {
            if weight > 0.0 {
                set(self.irregularity(plane, knot), weight);
            }
        }
    }

    /// An unknown in SI.
    pub fn value(&self, unknowns: &[f64], place: usize) -> f64 {
        self.mean[place] + self.sd[place] * unknowns[place]
    }

    /// Needle and tissue of these unknowns.
    pub fn problem(&self, unknowns: &[f64]) -> Result<BeamProblem, ModelError> {
        let layers = FACES_M
            .iter()
            .enumerate()
            .map(|(i, bottom_m)| Layer {
                bottom_m: *bottom_m,
                modulus_pa: self.modulus_pa * self.factor_of(i, unknowns),
            })
            .collect();
        let foundation = Foundation::layered(layers, self.modulus_pa * self.factor_of(LAYERS - 1, unknowns))?;
        let gap_m = self.problem.entry_m - self.problem.guide2_m;
        let entry_m = self.problem.guide2_m + (gap_m + self.value(unknowns, GAP)).max(0.2 * gap_m);
        let skin_n_per_m = tissue::SKIN.mean() * self.factor_of(SKIN, unknowns);
        let clamp_compliance_rad_per_n_m =
            self.problem.clamp_compliance_rad_per_n_m * self.factor_of(CLAMP, unknowns);
        let problem = self.problem.clone();
        Ok(BeamProblem { foundation, skin_n_per_m, entry_m, clamp_compliance_rad_per_n_m, ..problem })
    }

    /// Further from the prior than this no tissue is; the search may step there.
    fn factor_of(&self, place: usize, unknowns: &[f64]) -> f64 {
        (self.sd[place] * unknowns[place].clamp(-6.0, 6.0)).exp()
    }
}

fn layer_middle_m(layer: usize) -> f64 {
    let top_m = layer.checked_sub(1).map_or(0.0, |above| FACES_M[above]);
    0.5 * (top_m + FACES_M.get(layer).copied().unwrap_or(0.1))
}

fn center_and_spread(range: Option<[f64; 2]>, default: f64) -> (f64, f64) {
    match range {
        Some([low, high]) if low > 0.0 && high > low => {
            ((low * high).sqrt(), (high / low).ln() / 12f64.sqrt())
        }
        _ => (1.0, default),
    }
}
