//! The needle where the tissue itself moves: a block that slides or gives as a whole, an organ that breathes (theory, eq. 85).
//!
//! The tissue reacts to the deflection from where it has moved to, `K (u - w)`, the same w at every depth. In linear
//! tissue what the needle does is the sum of what it does under guide 2 and of what it does while guide 2 holds still
//! and the tissue moves. If w or guide 2 depends on the force, `F = k (g + y(F) - C q w(F)) / (1 + C k) + q w(F)` with
//! g the displacement of guide 2, k the stiffness of the needle there, C the compliance of th

use super::elements::{Deformed, Elements, Guide2};
use super::lateral::Motion;
use super::terms::Shifts;
use super::{BeamProblem, ModelError};

/// Elements for the needle that the tissue carries.
const ELEMENT_M: f64 = 2e-3;
/// Rounds in which tissue with memory or a law of its own is pushed by what has been shifted; the linear needle takes one.
const ROUNDS: usize = 4;
/// Newton's steps for the force at a sample, and the slope below which none is taken: there the force is no function of the displacement.
const STEPS: usize = 30;
const MIN_SLOPE: f64 = 0.1;
/// A force this near is the same: far below what any cell reads.
const SAME_N: f64 = 1e-9;
/// Step over which slopes are taken.
const SLOPE_N: f64 = 1e-4;

/// The needle's answer to a metre of motion of the tissue while guide 2 holds still.
#[derive(Debug, Clone)]
pub(super) struct Carried {
    /// Force of guide 2 on the needle.
    pub force_n_per_m: f64,
    /// Deflection at every place of the shape.
    pub weights: Vec<f64>,
}

impl Carried {
    /// At these places.
    ///
    /// # Errors
    /// [`ModelError::NotOnBody`] for a body of tissue; as [`Elements::solve`].
    pub fn new(problem: &BeamProblem, z_m: &[f64]) -> Result<Self, ModelError> {
        problem.support.needs_springs("tissue that moves")?;
        let elements = Elements::new(problem, ELEMENT_M)?;
        let moved: Deformed = elements.solve(&problem.foundation, |_| 1.0, Guide2::Held(0.0), 0.0)?;
        let weights = z_m.iter().map(|z_m| moved.deflection_m(*z_m)).collect();
        Ok(Self { force_n_per_m: moved.guide2_force_n, weights })
    }
}

/// The needle as guide 2 and the tissue feel it.
pub(super) struct Held<'a> {
    /// Force per displacement of guide 2.
    pub stiffness_n_per_m: f64,
    /// Compliance of the frame.
    pub compliance_m_per_n: f64,
    /// `None` if the tissue does not move.
    pub carried: Option<&'a Carried>,
    /// Whether `stiffness_n_per_m` is all that the needle is to guide 2.
    pub is_linear: bool,
}

impl Shifts {
    /// The motion of a needle by what guide 2 does, `respond`, and by what is shifted besides: the last coefficient is the motion of the tissue.
    pub(super) fn moved(
        &self,
        reached_m: &[f64],
        needle: &Held<'_>,
        respond: impl Fn(&[f64]) -> Motion,
    ) -> (Motion, Vec<f64>) {
        let Held { stiffness_n_per_m, compliance_m_per_n, carried, is_linear } = needle;
        let by_tissue = carried.map_or(0.0, |carried| carried.force_n_per_m);
        let by_guide = stiffness_n_per_m / (1.0 + compliance_m_per_n * stiffness_n_per_m);
        let mut motion = respond(reached_m);
        let mut shifted_m = vec![0.0; reached_m.len()];
        let mut tissue_m = vec![0.0; reached_m.len()];
        for _ in 0..if *is_linear { 1 } else { ROUNDS } {
            let mut state = self.rest();
            // The force that the law adds changes little from sample to sample.
            let mut added_n = 0.0;
            for (i, (shift_m, tissue_m)) in shifted_m.iter_mut().zip(&mut tissue_m).enumerate() {
                // Without what is shifted.
                let plain_n = motion.force_n.get(i).copied().unwrap_or_default() - by_guide * *shift_m;
                let force_n = solved(plain_n, plain_n + added_n, self.depend_on_force(), |force_n| {
                    let tissue_m = self.tissue_m(i, force_n, &state);
                    by_guide
                        * further_m(self.guide_m(force_n, &state), tissue_m, compliance_m_per_n, by_tissue)
                        + by_tissue * tissue_m
                });
                added_n = force_n - plain_n;
                *tissue_m = self.tissue_m(i, force_n, &state);
                *shift_m = further_m(self.guide_m(force_n, &state), *tissue_m, compliance_m_per_n, by_tissue);
                self.advance(&mut state, force_n);
            }
            let pressed_m: Vec<f64> =
                reached_m.iter().zip(&shifted_m).map(|(reached, shift)| reached + shift).collect();
            motion = respond(&pressed_m);
        }
        let forces = motion.force_n.iter_mut().zip(&tissue_m);
        forces.for_each(|(force_n, tissue_m)| *force_n += by_tissue * tissue_m);
        (motion, tissue_m)
    }
}

/// Guide 2 acts as if it were this much further; the force has a part of that and a part of the tissue's motion.
fn further_m(guide_m: f64, tissue_m: f64, compliance_m_per_n: &f64, by_tissue: f64) -> f64 {
    guide_m - compliance_m_per_n * by_tissue * tissue_m
}

/// The force that is `plain` and what it causes itself, sought from `start` on.
fn solved(plain_n: f64, start_n: f64, depends: bool, more_n: impl Fn(f64) -> f64) -> f64 {
    if !depends {
        return plain_n + more_n(plain_n);
    }
    let mut force_n = start_n;
    for _ in 0..STEPS {
        let here_n = more_n(force_n);
        let residual_n = force_n - plain_n - here_n;
        if residual_n.abs() < MIN_SLOPE * SAME_N {
            break;
        }
        let slope = 1.0 - (more_n(force_n + SLOPE_N) - here_n) / SLOPE_N;
        let step_n = residual_n / slope.max(MIN_SLOPE);
        force_n -= step_n;
        if step_n.abs() < SAME_N {
            break;
        }
    }
    force_n
}

#[cfg(test)]
mod tests {
    use super::super::effects::effect;
    use super::super::{
        Beam, DriveSample, Experiment, Foundation, Lateral, Model, Needle, Rig, ShapePoint, predict,
    };
    use super::*;

    fn rig() -> Rig {
        Rig::two_guides(Needle::gauge_18(), 0.06, 0.07)
    }

    fn moved(effects: &[(&str, &[f64])], displacement_m: f64) -> (f64, Vec<f64>) {
        let mut model = Model::uniform(rig(), 16e3).expect("valid");
        model.effects =
            effects.iter().map(|(id, values)| (effect(id).expect("an effect"), values.to_vec())).collect();
        let shape = [0.075, 0.09].map(|z_m| ShapePoint::new(1.0, z_m)).to_vec();
        let drive = vec![
            DriveSample { time_s: 0.0, y_m: 0.0, x_m: 0.0 },
            DriveSample { time_s: 1.0, y_m: displacement_m, x_m: 0.0 },
        ];
        let lateral = Lateral { depth_m: 0.03, drive, shape, reversal_m: [0.0; 2], order: 0.0 };
        let channels = predict(&model, &Experiment::Lateral(lateral)).expect("predicts");
        (channels.force_n.y[1], channels.shape_m.y)
    }

    /// By reciprocity the force per motion of the tissue is the reaction of the tissue per motion of guide 2, which the exact beam has.
    #[test]
    fn the_tissue_pushes_guide_2_as_guide_2_pushes_the_tissue() {
        let problem = BeamProblem::new(&rig(), Foundation::uniform(16e3).expect("a modulus"), 0.03);
        let carried = Carried::new(&problem, &[0.085]).expect("solves");
        let beam = Beam::solve(&rig(), &problem.foundation, 0.03).expect("solves");
        let steps = 3000;
        let step_m = 0.03 / f64::from(steps);
        let reaction_n: f64 =
            (0..steps).map(|i| 16e3 * beam.deflection_m(1.0, cell_middle_m(i, step_m)) * step_m).sum();
        assert!((carried.force_n_per_m / -reaction_n - 1.0).abs() < 1e-4, "{}", carried.force_n_per_m);
        // Tissue as stiff as bone takes the needle along.
        let bone = BeamProblem { foundation: Foundation::uniform(1e9).expect("a modulus"), ..problem };
        let carried = Carried::new(&bone, &[0.085]).expect("solves");
        assert!((carried.weights[0] - 1.0).abs() < 1e-2);
    }

    fn cell_middle_m(i: i32, step_m: f64) -> f64 {
        0.07 + step_m * (f64::from(i) + 0.5)
    }

    /// Tissue that goes with guide 2 by a share of its displacement, and one that gives under the force, are pushed by less; what they read is
    /// the sum of both motions.
    #[test]
    fn motions_of_guide_2_and_tissue_add_up() {
        let problem = BeamProblem::new(&rig(), Foundation::uniform(16e3).expect("a modulus"), 0.03);
        let carried = Carried::new(&problem, &[0.075, 0.09]).expect("solves");
        let (plain_n, plain_m) = moved(&[], 1e-3);
        let (force_n, shape_m) = moved(&[("law.tissue.displacement.linear", &[0.2])], 1e-3);
        assert!((force_n - plain_n - 0.2e-3 * carried.force_n_per_m).abs() < 1e-9);
        for (i, weight) in carried.weights.iter().enumerate() {
            assert!((shape_m[i] - plain_m[i] - 0.2e-3 * weight).abs() < 1e-12);
        }
        // By 0.1 mm/N, 1 mm: F = k d + q 1e-4 F.
        let (force_n, shape_m) = moved(&[("law.tissue.force.linear", &[0.1])], 1e-3);
        let expected_n = plain_n / (1.0 - 1e-4 * carried.force_n_per_m);
        assert!((force_n / expected_n - 1.0).abs() < 1e-8, "{force_n} {expected_n}");
        assert!((shape_m[1] - plain_m[1] - 1e-4 * force_n * carried.weights[1]).abs() < 1e-10);
    }

    /// Tissue that yields beyond 0.3 mm of displacement keeps what it has yielded, and so does a guide beyond a force: on the way back they push
    /// less than on the way there.
    #[test]
    fn tissue_and_guide_that_yield_keep_it_on_the_way_back() {
        let problem = BeamProblem::new(&rig(), Foundation::uniform(16e3).expect("a modulus"), 0.03);
        let carried = Carried::new(&problem, &[]).expect("solves");
        let plain_n = forces_n(&[]);
        let yielding_n = forces_n(&[("law.tissue.displacement.play", &[0.5, 0.3])]);
        for ((yielding_n, plain_n), yielded_mm) in
            yielding_n.iter().zip(&plain_n).zip([0.0, 0.1, 0.7, 0.7, 0.3])
        {
            let expected_n = plain_n + 0.5e-3 * yielded_mm * carried.force_n_per_m;
            assert!((yielding_n - expected_n).abs() < 1e-9, "{yielding_n} {expected_n}");
        }
        // Back by 0.1 mm for every newton that the force has been above 0.4 N: F = k (g - c P(F)).
        let stiffness_n_per_m = plain_n[2] / 1e-3;
        let slipping_n = forces_n(&[("law.guide.force.play", &[-0.1, 0.4])]);
        let most_n = (plain_n[2] + 0.4 * 0.1e-3 * stiffness_n_per_m) / (1.0 + 0.1e-3 * stiffness_n_per_m);
        assert!((slipping_n[2] / most_n - 1.0).abs() < 1e-6, "{} {most_n}", slipping_n[2]);
        let slipped_m = 0.1e-3 * (most_n - 0.4);
        assert!((slipping_n[3] - (plain_n[3] - stiffness_n_per_m * slipped_m)).abs() < 1e-6);
    }

    fn forces_n(effects: &[(&str, &[f64])]) -> Vec<f64> {
        let mut model = Model::uniform(rig(), 16e3).expect("valid");
        model.effects =
            effects.iter().map(|(id, values)| (effect(id).expect("an effect"), values.to_vec())).collect();
        let places_mm = [0.0, 0.4, 1.0, 0.6, 0.0];
        let drive = (0..5).zip(places_mm).map(|(time, y_mm)| DriveSample {
            time_s: f64::from(time),
            y_m: 1e-3 * y_mm,
            x_m: 0.0,
        });
        let lateral = Lateral {
            depth_m: 0.03,
            drive: drive.collect(),
            shape: Vec::new(),
            reversal_m: [0.0; 2],
            order: 0.0,
        };
        predict(&model, &Experiment::Lateral(lateral)).expect("predicts").force_n.y
    }

    /// A guide that follows by so much per force, backwards, is a frame that gives; also beside one.
    #[test]
    fn a_guide_that_gives_in_proportion_is_a_compliant_frame() {
        let frame = moved(&[("rig.frame_compliance", &[0.13])], 1e-3);
        for other in [
            moved(&[("law.guide.force.linear", &[-0.13])], 1e-3),
            moved(&[("rig.frame_compliance", &[0.05]), ("law.guide.force.linear", &[-0.08])], 1e-3),
        ] {
            assert!((frame.0 / other.0 - 1.0).abs() < 1e-9);
            assert!(frame.1.iter().zip(&other.1).all(|(a, b)| (a / b - 1.0).abs() < 1e-9));
        }
    }
}
