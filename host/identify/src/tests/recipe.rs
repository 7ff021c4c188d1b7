//! Sessions made from the forward model.

use formats::session::{ForceSeries, LateralRun, Noise as StatedNoise, Session, ShapeSeries, Tissue, Walls};
use mechanics::{BeamProblem, Foundation, Layer, Needle, Rig};
use noise::Noise;

const RATE_HZ: f64 = 50.0;
const HOLD_S: f64 = 3.0;
/// Modulus of the tissue that recipes have unless they state otherwise.
pub const K_KPA: f64 = 16.0;

/// Parameters of a synthetic run; millimetres, newtons, kilopascals.
#[derive(Clone)]
pub struct Recipe {
    pub k_kpa: f64,
    pub depth_mm: f64,
    /// Displacement of each hold along the plane's direction.
    pub levels_mm: Vec<f64>,
    /// Direction of the displacement, `[y, x]`; one plane where x is 0.
    pub direction: [f64; 2],
    pub force_sd_n: f64,
    pub displacement_sd_mm: f64,
    pub shape_sd_mm: f64,
    /// Offset of the force sensor.
    pub offset_n: f64,
    /// Compliance of the clamp, offset of the shape, shift of its samples.
    pub clamp_rad_per_n_m: f64,
    pub shape_offset_mm: f64,
    pub shape_shift_mm: f64,
    /// Boundary of a second layer below the surface, and its modulus.
    pub second_layer: Option<(f64, f64)>,
}

impl Default for Recipe {
    fn default() -> Self {
        Self {
            k_kpa: K_KPA,
            depth_mm: 30.0,
            levels_mm: vec![0.0, 1.2, 0.0],
            direction: [1.0, 0.0],
            force_sd_n: 0.05,
            displacement_sd_mm: 0.02,
            shape_sd_mm: 0.03,
            offset_n: 0.2,
            clamp_rad_per_n_m: 0.0,
            shape_offset_mm: 0.0,
            shape_shift_mm: 0.0,
            second_layer: None,
        }
    }
}

fn rig() -> Rig {
    Rig::two_guides(Needle::gauge_18(), 0.06, 0.07)
}

impl Recipe {
    /// Holds at the levels with quick ramps between, and a sweep in the middle of every hold.
    pub fn run(&self, id: &str, noise: &mut Noise) -> LateralRun {
        let depth_m = 1e-3 * self.depth_mm;
        let modulus_pa = 1e3 * self.k_kpa;
        let foundation = match self.second_layer {
            Some((boundary_mm, k_kpa)) => {
                let upper = Layer { bottom_m: 1e-3 * boundary_mm, modulus_pa };
                Foundation::layered(vec![upper], 1e3 * k_kpa).expect("layers")
            }
            None => Foundation::uniform(modulus_pa).expect("a modulus"),
        };
        let mut problem = BeamProblem::new(&rig(), foundation, depth_m);
        problem.clamp_compliance_rad_per_n_m = self.clamp_rad_per_n_m;
        let beam = problem.solve().expect("solves");
        let two_planes = self.direction[1] != 0.0;
        let (mut force, mut shape) = (ForceSeries::default(), ShapeSeries::default());
        let (mut time_s, mut position_mm) = (0.0, 0.0);
        let (mut force_x, mut displacement_x, mut shape_x, mut shape_t) = (vec![], vec![], vec![], vec![]);
        let mut sample = |time_s: f64, position_mm: f64, noise: &mut Noise| {
            let mut measured = |part: f64| {
                let displacement_m = 1e-3 * position_mm * part;
                let measured_m = displacement_m + 1e-3 * self.displacement_sd_mm * noise.normal();
                (measured_m, beam.force_n(displacement_m) + self.offset_n + self.force_sd_n * noise.normal())
            };
            let (y_m, y_n) = measured(self.direction[0]);
            let (x_m, x_n) = measured(self.direction[1]);
            force.time_s.push(time_s);
            force.displacement_y_m.push(y_m);
            force.force_y_n.push(y_n);
            displacement_x.push(x_m);
            force_x.push(x_n);
        };
        for level_mm in &self.levels_mm {
            while (level_mm - position_mm).abs() > 1e-9 {
                position_mm += (level_mm - position_mm).clamp(-2.0 / RATE_HZ, 2.0 / RATE_HZ);
                sample(time_s, position_mm, noise);
                time_s += 1.0 / RATE_HZ;
            }
            for _ in 0..(HOLD_S * RATE_HZ) as usize {
                sample(time_s, position_mm, noise);
                time_s += 1.0 / RATE_HZ;
            }
            for point in 0..self.depth_mm as usize {
                let z_m = 0.07 + 1e-3 * (point as f64 + 0.5);
                let mut measured = |part: f64| {
                    let really_m = z_m + 1e-3 * self.shape_shift_mm;
                    let noise_mm = self.shape_offset_mm + self.shape_sd_mm * noise.normal();
                    beam.deflection_m(1e-3 * position_mm * part, really_m) + 1e-3 * noise_mm
                };
                shape_t.push(time_s - 0.5 * HOLD_S);
                shape.z_m.push(z_m);
                shape.y_m.push(measured(self.direction[0]));
                shape_x.push(measured(self.direction[1]));
            }
        }
        shape.time_s = Some(shape_t);
        if two_planes {
            (force.displacement_x_m, force.force_x_n) = (Some(displacement_x), Some(force_x));
            shape.x_m = Some(shape_x);
        }
        let (force_path, shape_path) = (format!("{id}.force.csv").into(), format!("{id}.shape.csv").into());
        LateralRun {
            id: id.to_owned(),
            depth_m,
            force_path,
            shape_path,
            provenance: Default::default(),
            force,
            shape,
        }
    }

    /// The noise as a session states it.
    pub fn stated(&self) -> StatedNoise {
        StatedNoise {
            force_n: Some(self.force_sd_n),
            force_zero_n: None,
            displacement_m: Some(1e-3 * self.displacement_sd_mm),
            shape_m: Some(1e-3 * self.shape_sd_mm),
            tip_m: None,
            tip_direction_rad: None,
        }
    }
}

/// A session of these runs, without stated noise.
pub fn session(lateral: Vec<LateralRun>) -> Session {
    Session {
        dir: "phantom".into(),
        name: Some("phantom".to_owned()),
        rig: rig(),
        fixture_mass_kg: None,
        noise: StatedNoise::default(),
        tissue: Tissue { walls: Some(Walls::Far), ..Tissue::default() },
        lateral,
        insertion: Vec::new(),
        indentation: Vec::new(),
        steering: Vec::new(),
    }
}
