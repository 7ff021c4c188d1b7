//! One truth in SI units, and what its tissue is like at every depth.

use super::{Foreign, MM, Truth, strengths};
use mechanics::Rig;

/// Faces of the inclusion below the surface, and how much stiffer it is.
const INCLUSION_M: [f64; 2] = [8e-3, 14e-3];
const INCLUSION_FACTOR: f64 = 4.0;

/// A sine over a length or a time.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Wave {
    pub amplitude: f64,
    pub per_length: f64,
    pub phase: f64,
}

impl Wave {
    pub fn at(&self, at: f64) -> f64 {
        self.amplitude * (self.per_length * at + self.phase).sin()
    }
}

/// A gradient leaves at least this share of the modulus at the surface.
const SOFTEST: f64 = 0.1;

/// Small deviation of a run's tissue from its nominal value.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Inhomogeneity {
    /// Factor of the whole.
    pub factor: f64,
    /// Ripples of the modulus over depth, as shares.
    pub waves: Vec<Wave>,
    /// Share that is missing in the middle of a soft spot, its depth and its width.
    pub soft_spot: [f64; 3],
    /// Depth of the real surface below the stated one.
    pub surface_m: f64,
}

impl Default for Inhomogeneity {
    fn default() -> Self {
        Self { factor: 1.0, waves: Vec::new(), soft_spot: [0.0, 0.0, 1.0], surface_m: 0.0 }
    }
}

impl Inhomogeneity {
    /// Factor of the modulus at a depth below the real surface.
    pub fn at(&self, depth_m: f64) -> f64 {
        let [missing, middle_m, width_m] = self.soft_spot;
        let spot = if missing == 0.0 {
            0.0
        } else {
            missing.min(0.95) * (-0.5 * ((depth_m - middle_m) / width_m).powi(2)).exp()
        };
        let waves: f64 = self.waves.iter().map(|wave| wave.at(depth_m)).sum();
        self.factor * (1.0 + waves).max(0.05) * (1.0 - spot)
    }
}

/// The truth, SI; pairs are of the planes y and x.
#[derive(Debug, Clone)]
pub(super) struct World {
    pub entry_m: f64,
    /// None where no guide holds the needle.
    pub guide2_m: Option<f64>,
    pub bending_n_m2: f64,
    pub k_pa: f64,
    pub tip_load_n: f64,
    pub foreign: Option<Foreign>,
    pub layer_ratio: f64,
    pub layer_boundary_m: f64,
    pub gradient_per_m: f64,
    pub inverse_u0_per_m: f64,
    pub relaxing_fraction: f64,
    pub tau_s: f64,
    pub shear_n: f64,
    pub gap_m: f64,
    pub skin_n_per_m: f64,
    pub anisotropy: f64,
    pub clamp_rad_per_n_m: f64,
    pub frame_m_per_n: f64,
    pub clearance_m: f64,
    /// Half of the play between the displacement sensor and the guide.
    pub play_m: f64,
    pub friction_n: f64,
    pub bias_n: [f64; 2],
    pub gain: f64,
    pub drift_n_per_s: [f64; 2],
    pub crosstalk: f64,
    pub delay_s: f64,
    pub shape_offset_m: [f64; 2],
    pub shape_scale: f64,
    pub depth_shift_m: f64,
    /// Relative error of the scanner's lengths along the beam; delay of frames; error of echoes.
    pub sound_scale: f64,
    pub image_lag_s: f64,
    pub echo_offset_m: f64,
    pub prebend_per_m: [f64; 2],
    pub axial_n: f64,
    pub load_slope_n_per_m: f64,
    pub load_step_n: f64,
    pub load_step_m: f64,
    pub entry_angle_rad: [f64; 2],
    pub bevel_roll_rad: f64,
    pub rate_n_s_per_m: f64,
    /// Imperfections: of the tissue, and guide 2 away from the line of the clamp.
    pub tissue: Inhomogeneity,
    pub guide_offset_m: [f64; 2],
}

impl World {
    /// # Panics
    /// For an unknown id and for a number of values that its effect cannot have.
    pub fn new(truth: &Truth, rig: &Rig) -> Self {
        for (id, values) in &truth.effects {
            let most = strengths(id).map_or(0, |[weak, ..]| weak.len());
            let is_valid = (1..=most).contains(&values.len());
            assert!(is_valid, "effect {id} with {} values, expected 1 to {most}", values.len());
        }
        let one = |id: &str| value_of(id, 0, 0.0, &truth.effects);
        let pair = |id: &str, unit: f64| {
            [unit * value_of(id, 0, 0.0, &truth.effects), unit * value_of(id, 1, 0.0, &truth.effects)]
        };
        Self {
            entry_m: rig.entry_m,
            guide2_m: Some(rig.guide2_m),
            bending_n_m2: rig.needle.bending_stiffness_n_m2() * (1.0 + one("needle.stiffness")),
            k_pa: 1e3 * truth.k_kpa,
            tip_load_n: truth.tip_load_n,
            foreign: truth.foreign,
            layer_ratio: value_of("tissue.layers", 0, 1.0, &truth.effects),
            layer_boundary_m: MM * value_of("tissue.layers", 1, 15.0, &truth.effects),
            gradient_per_m: one("tissue.gradient") / MM,
            inverse_u0_per_m: one("tissue.stiffening") / MM,
            relaxing_fraction: one("tissue.relaxation"),
            tau_s: value_of("tissue.relaxation", 1, 2.0, &truth.effects),
            shear_n: one("tissue.shear"),
            gap_m: MM * one("tissue.entry_gap"),
            skin_n_per_m: one("tissue.skin") / MM,
            anisotropy: value_of("tissue.anisotropy", 0, 1.0, &truth.effects),
            clamp_rad_per_n_m: one("rig.clamp_compliance"),
            frame_m_per_n: MM * one("rig.frame_compliance"),
            clearance_m: MM * one("rig.backlash"),
            play_m: MM * one("rig.play"),
            friction_n: one("rig.friction"),
            bias_n: pair("sensor.force_bias", 1.0),
            gain: one("sensor.force_gain"),
            drift_n_per_s: pair("sensor.force_drift", 1.0),
            crosstalk: one("sensor.crosstalk"),
            delay_s: one("sensor.delay"),
            shape_offset_m: pair("sensor.shape_offset", MM),
            shape_scale: one("sensor.shape_scale"),
            depth_shift_m: MM * one("sensor.depth_shift"),
            sound_scale: one("imaging.sound_speed"),
            image_lag_s: one("imaging.lag"),
            echo_offset_m: MM * one("imaging.echo_offset"),
            prebend_per_m: pair("needle.prebend", 1.0),
            axial_n: one("needle.axial_load"),
            load_slope_n_per_m: one("tip.load_slope") / MM,
            load_step_n: one("tip.load_step"),
            load_step_m: MM * value_of("tip.load_step", 1, 0.0, &truth.effects),
            entry_angle_rad: pair("tip.entry_angle", 1.0),
            bevel_roll_rad: one("tip.bevel_roll"),
            rate_n_s_per_m: one("tip.rate") / MM,
            tissue: Inhomogeneity::default(),
            guide_offset_m: [0.0; 2],
        }
    }

    /// Whether this foreign effect is there.
    pub fn has(&self, foreign: Foreign) -> bool {
        self.foreign == Some(foreign)
    }

    /// Stiffness of the tissue between two depths below the stated surface, for deflections in a plane, N/m: the integral of K.
    /// The depths may lie outside the tissue, where there is none.
    pub fn springs_n_per_m(&self, plane: usize, from_m: f64, to_m: f64) -> f64 {
        let [local_from_m, local_to_m] = [from_m, to_m].map(|depth_m| depth_m - self.tissue.surface_m);
        let mut faces_m: Vec<f64> = [0.0, self.gap_m, self.layer_boundary_m]
            .into_iter()
            .chain(INCLUSION_M)
            .filter(|face_m| *face_m > local_from_m && *face_m < local_to_m)
            .chain([local_from_m, local_to_m])
            .collect();
        faces_m.sort_by(f64::total_cmp);
        // K is linear in every piece, or smooth over much more than its length: its middle gives the integral.
        let pieces = faces_m.windows(2).map(|piece| {
            let [top_m, bottom_m] = [piece[0], piece[1]];
            self.modulus_pa(0.5 * (top_m + bottom_m)) * (bottom_m - top_m)
        });
        let ratio = if plane == 0 { 1.0 } else { self.anisotropy };
        ratio * pieces.sum::<f64>()
    }

    /// Factor of the modulus at a depth by a gradient: tissue that gets softer still is tissue.
    pub(super) fn growth(&self, depth_m: f64) -> f64 {
        (1.0 + self.gradient_per_m * depth_m).max(SOFTEST)
    }

    /// K of the plane y inside a layer.
    fn modulus_pa(&self, depth_m: f64) -> f64 {
        if depth_m < self.gap_m.max(0.0) {
            return 0.0;
        }
        let inclusion =
            self.has(Foreign::StiffInclusion) && (INCLUSION_M[0]..INCLUSION_M[1]).contains(&depth_m);
        let layer = if depth_m < self.layer_boundary_m { 1.0 } else { self.layer_ratio };
        let factor = layer * self.growth(depth_m);
        self.k_pa * factor * self.tissue.at(depth_m) * if inclusion { INCLUSION_FACTOR } else { 1.0 }
    }
}

fn value_of(id: &str, number: usize, neutral: f64, effects: &[(&'static str, Vec<f64>)]) -> f64 {
    let named_effect = effects.iter().find(|(name, _)| *name == id);
    named_effect.and_then(|(_, values)| values.get(number)).copied().unwrap_or(neutral)
}
