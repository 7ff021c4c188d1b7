//! The needle in one plane under a guide 2 that moves: from its commanded position to force and shape.
//!
//! On the way from the actuator to the needle lie the compliance of the frame and the clearance of the guide ([`Drive`]). The
//! needle's answer is a sum of a few shapes with coefficients that vary in time ([`Motion`]):
//!
//! * linear tissue: one shape per newton, the coefficient is the force;
//! * a standard linear solid, `K(t) = K_inf + (K_0 - K_inf) e^(-t/tau)`: the shapes of the exact beam at four moduli between the
//!   instantaneous and the relaxed one span what the needle does on its way between them (rational Krylov space). In this basis
//!   the stiffnesses are known from the forces alone: `A + k_j M` applied to shape j is its force, so that
//!   `M_ij = (F_j - F_i) / (k_j - k_i)`. The modes of the memory decay exactly over each sample;
//! * what departs from both ([`departure`](super::departure)): tissue that stiffens or yields, laws on its reaction or on the needle's
//!   stiffness.

use super::course::course_m;
use super::departure::Departure;
use super::quadrature::integrate;
use super::{Beam, BeamProblem, ModelError};
use nalgebra::{DMatrix, DVector};
use smallvec::SmallVec;

/// Between the actuator and the needle, in both planes.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Drive {
    /// Lag of guide 2 per force on it.
    pub frame_compliance_m_per_n: f64,
    /// Clearance of guide 2 on either side of the needle.
    pub clearance_m: f64,
    /// Half of the play between the measured displacement and guide 2, which has memory.
    pub play_m: f64,
}

impl Drive {
    /// Whether the needle follows guide 2 at once.
    pub(super) fn is_linear(&self) -> bool {
        self.clearance_m == 0.0 && self.play_m == 0.0
    }

    /// Displacement that reaches the needle if the frame does not give, of where guide 2 is.
    pub fn beyond_clearance_m(&self, guide2_m: f64) -> f64 {
        let pressed_m = (guide2_m.abs() - self.clearance_m).max(0.0);
        pressed_m.copysign(guide2_m)
    }

    /// Position of guide 2, from its previous position and the present reading of the displacement sensor
    /// (the play operator).
    pub fn beyond_play_m(&self, guide2_m: f64, measured_m: f64) -> f64 {
        let play_m = self.play_m.max(0.0);
        guide2_m.clamp(measured_m - play_m, measured_m + play_m)
    }

    /// Displacements that reach the needle, if the frame does not give, of those that are measured one after the other; the first
    /// finds guide 2 in the middle of its play. Play follows the motion and not the noise of its sensor, of which it would take off so
    /// much that a little play would be found in every recording.
    pub(super) fn reaching_m(&self, measured_m: &[f64], reversal_m: f64) -> Samples {
        if self.play_m <= 0.0 {
            return measured_m.iter().map(|m| self.beyond_clearance_m(*m)).collect();
        }
        let course_m = course_m(measured_m, reversal_m);
        let mut guide2_m = course_m.first().copied().unwrap_or_default();
        let followed = measured_m.iter().zip(&course_m).map(|(m, course_m)| {
            guide2_m = self.beyond_play_m(guide2_m, *course_m);
            self.beyond_clearance_m(m + (guide2_m - course_m))
        });
        followed.collect()
    }
}

/// Shares of the modulus whose shapes span the relaxing needle.
const SHARES: [f64; 4] = [1.0, 0.55, 0.25, 0.08];
/// Directions of the memory that are smaller than this beside the largest are none.
const MIN_DIRECTION: f64 = 1e-8;
/// Panels of ten Gauss points over which the tissue's energy is integrated.
const PANEL_M: f64 = 20e-3;

/// Response of a needle in one plane.
#[derive(Debug)]
pub(super) struct Response {
    beam: Beam,
    relaxing: Option<Relaxing>,
    departure: Option<Departure>,
}

/// A number for every drive sample; the few of a run that is known by its holds are kept in place.
pub(super) type Samples = SmallVec<[f64; 8]>;

/// Force and coefficients of the shapes at every drive sample.
#[derive(Debug)]
pub(super) struct Motion {
    pub force_n: Vec<f64>,
    /// Coefficient by coefficient.
    pub coefficients: Samples,
}

impl Response {
    /// Response of a needle that is moved by up to `most_m` to either side.
    ///
    /// # Errors
    /// As [`BeamProblem::solve`].
    pub fn new(problem: &BeamProblem, most_m: f64) -> Result<Self, ModelError> {
        let relaxes = problem.law.relaxing_share > 0.0;
        Ok(Self {
            beam: problem.solve()?,
            relaxing: if relaxes { Some(Relaxing::new(problem)?) } else { None },
            departure: Departure::new(problem, most_m)?,
        })
    }

    /// Force per displacement of guide 2 in linear tissue.
    pub fn stiffness_n_per_m(&self) -> f64 {
        self.beam.lateral_stiffness_n_per_m()
    }

    /// Whether the needle is the exact linear one.
    pub fn is_linear(&self) -> bool {
        self.relaxing.is_none() && self.departure.is_none()
    }

    /// Moves guide 2; where it comes back by less than `reversal_m`, that is noise of its sensor.
    pub fn moved(&self, times_s: &[f64], commanded_m: &[f64], reversal_m: f64, drive: Drive) -> Motion {
        let pressed_m = drive.reaching_m(commanded_m, reversal_m);
        let mut motion = match &self.relaxing {
            Some(relaxing) => relaxing.moved(times_s, &pressed_m, drive.frame_compliance_m_per_n),
            None => {
                let compliance = 1.0 / self.beam.lateral_stiffness_n_per_m() + drive.frame_compliance_m_per_n;
                let force_n: Vec<f64> = pressed_m.iter().map(|m| m / compliance).collect();
                Motion { coefficients: Samples::from_slice(&force_n), force_n }
            }
        };
        if let Some(departure) = &self.departure {
            // The first coefficient is a force, or a displacement where the tissue relaxes.
            let stiffness = self.beam.lateral_stiffness_n_per_m();
            let per_metre = if self.relaxing.is_some() { 1.0 } else { stiffness };
            departure.add(&mut motion, &pressed_m, [stiffness, per_metre], drive.frame_compliance_m_per_n);
        }
        motion
    }

    /// Weight of every coefficient in the deflection at each of these places, coefficient by coefficient.
    pub fn shape_at(&self, z_m: &[f64]) -> Vec<f64> {
        let mut weights = match &self.relaxing {
            Some(relaxing) => relaxing.beams.iter().flat_map(|beam| beam.deflections_m(1.0, z_m)).collect(),
            None => self.beam.guide2_force().deflections_m(z_m),
        };
        if let Some(departure) = &self.departure {
            weights.extend(departure.shape_at(z_m));
        }
        weights
    }
}

impl Motion {
    /// Coefficients at a share of the way between two drive samples.
    pub fn between(&self, [from, to]: [usize; 2], share: f64) -> impl Iterator<Item = f64> {
        self.coefficients.chunks_exact(self.force_n.len().max(1)).map(move |values| {
            let (a, b) = (values[from], values[to]);
            if from == to { a } else { a + share * (b - a) }
        })
    }
}

/// A needle in relaxing tissue: the shape at the whole modulus, and modes that leave guide 2 where it is.
#[derive(Debug)]
struct Relaxing {
    /// Shapes at shares of the modulus.
    beams: Vec<Beam>,
    /// From the basis (first shape, modes) to these shapes.
    basis: DMatrix<f64>,
    /// Springs of the tissue in the basis.
    tissue: DMatrix<f64>,
    /// Springs of everything, which are diagonal in the basis.
    all: DVector<f64>,
    relaxing_share: f64,
    relaxation_s: f64,
}

impl Relaxing {
    fn new(problem: &BeamProblem) -> Result<Self, ModelError> {
        let beams: Vec<Beam> = SHARES
            .iter()
            .map(|share| {
                let foundation = problem.foundation.scaled(*share)?;
                BeamProblem { foundation, ..problem.clone() }.solve()
            })
            .collect::<Result<_, _>>()?;
        let force_n: Vec<f64> = beams.iter().map(Beam::lateral_stiffness_n_per_m).collect();
        let stored = |beam: &Beam, share: f64| -> f64 {
            if problem.support.is_body() {
                return beam.body_n_per_m() / share;
            }
            let mut top_m = 0.0;
            let mut stored = 0.0;
            for (thickness_m, modulus_pa) in problem.foundation.parts(problem.depth_m) {
                let square = |s_m: f64| beam.deflection_m(1.0, problem.entry_m + s_m).powi(2);
                stored += modulus_pa * integrate(top_m, top_m + thickness_m, PANEL_M, square);
                top_m += thickness_m;
            }
            stored
        };
        let count = SHARES.len();
        let tissue = DMatrix::from_fn(count, count, |i, j| {
            if i == j {
                stored(&beams[i], SHARES[i])
            } else {
                (force_n[j] - force_n[i]) / (SHARES[j] - SHARES[i])
            }
        });
        let needle = DMatrix::from_fn(count, count, |i, j| {
            0.5 * (cross_force(i, j, &force_n, &tissue) + cross_force(j, i, &force_n, &tissue))
        });
        // Differences to the first shape leave guide 2 at rest; they are nearly dependent, so only directions that matter stay.
        let differences = DMatrix::from_fn(count, count - 1, |i, j| match i {
            0 => -1.0,
            i if i == j + 1 => 1.0,
            _ => 0.0,
        });
        let eigen = (differences.transpose() * &tissue * &differences).symmetric_eigen();
        let least = MIN_DIRECTION * eigen.eigenvalues.max();
        let kept_vectors: Vec<DVector<f64>> = eigen
            .eigenvalues
            .iter()
            .zip(eigen.eigenvectors.column_iter())
            .filter(|(value, _)| **value > least)
            .map(|(value, vector)| &differences * vector / value.sqrt())
            .collect();
        let mut basis = DMatrix::zeros(count, 1);
        basis[(0, 0)] = 1.0;
        let mut mode_forces = vec![force_n[0]];
        if !kept_vectors.is_empty() {
            let kept_matrix = DMatrix::from_columns(&kept_vectors);
            let modes = (kept_matrix.transpose() * &needle * &kept_matrix).symmetric_eigen();
            let modes_basis = kept_matrix * &modes.eigenvectors;
            mode_forces.extend(modes.eigenvalues.iter().map(|value| value + 1.0));
            basis = DMatrix::from_fn(count, mode_forces.len(), |i, j| match j {
                0 => basis[(i, 0)],
                _ => modes_basis[(i, j - 1)],
            });
        }
        let law = problem.law;
        Ok(Self {
            beams,
            tissue: basis.transpose() * tissue * &basis,
            basis,
            all: DVector::from_vec(mode_forces),
            relaxing_share: law.relaxing_share,
            relaxation_s: law.relaxation_s,
        })
    }

    /// Tissue: `K_0 u - f K_0 v`, `v' = (u - v) / tau`. With c and d the coefficients of u and v, g the displacement of guide 2 in
    /// every basis vector: `S^-1 c = f M d + F g`, `g^T c + C F = w`; `M = R R^T`, `e = R^T d`.
    fn moved(&self, times_s: &[f64], pressed_m: &[f64], compliance_m_per_n: f64) -> Motion {
        let f = self.relaxing_share;
        let count = self.all.len();
        let inverse = DMatrix::from_diagonal(&self.all.map(|value| 1.0 / value));
        let q = inverse.column(0).into_owned();
        let total = q[0] + compliance_m_per_n;
        let eigen = self.tissue.clone().symmetric_eigen();
        let roots = eigen.eigenvalues.map(|value| value.max(0.0).sqrt());
        let root = &eigen.eigenvectors * DMatrix::from_diagonal(&roots);
        let memory = (inverse - &q * q.transpose() / total) * f;
        let modes = (root.transpose() * &memory * &root).symmetric_eigen();
        let mode_shapes = &root * &modes.eigenvectors;
        let by_memory = &self.basis * &memory * &mode_shapes;
        let force_by_memory = (mode_shapes.transpose() * &q) * (f / total);
        let fed = mode_shapes.transpose() * &q / (total * self.relaxation_s);
        let direct = &self.basis * &q / total;

        let rates: Vec<f64> =
            modes.eigenvalues.iter().map(|t| (1.0 - t).max(0.0) / self.relaxation_s).collect();
        let mut state = vec![0.0; count];
        let samples = pressed_m.len();
        let mut motion = Motion {
            force_n: Vec::with_capacity(samples),
            coefficients: SmallVec::from_elem(0.0, self.beams.len() * samples),
        };
        let mut previous: Option<(f64, f64)> = None;
        let mut step = Step::default();
        for (i, (time_s, pressed)) in times_s.iter().zip(pressed_m).enumerate() {
            if let Some((previous_s, previous_m)) = previous {
                step.prepare(time_s - previous_s, &rates);
                for (k, y) in state.iter_mut().enumerate() {
                    *y = step.decay[k] * *y + fed[k] * (step.first[k] * previous_m + step.last[k] * pressed);
                }
            }
            previous = Some((*time_s, *pressed));
            motion.force_n.push(pressed / total - remembered(&|k| force_by_memory[k], &state));
            for (j, values) in motion.coefficients.chunks_exact_mut(samples).enumerate() {
                values[i] = direct[j] * pressed + remembered(&|k| by_memory[(j, k)], &state);
            }
        }
        motion
    }
}

/// Sum over what the springs remember.
fn remembered(row: &dyn Fn(usize) -> f64, state: &[f64]) -> f64 {
    state.iter().enumerate().map(|(k, y)| row(k) * y).sum::<f64>()
}

/// Force at one node as another one moves, before both are averaged.
fn cross_force(i: usize, j: usize, force_n: &[f64], tissue: &DMatrix<f64>) -> f64 {
    force_n[j] - SHARES[j] * tissue[(i, j)]
}

/// One step of `y' = -r y + w(t)` with w linear: `y = decay y + first w_0 + last w_1`; kept while the step stays the same.
#[derive(Default)]
struct Step {
    step_s: f64,
    decay: Vec<f64>,
    first: Vec<f64>,
    last: Vec<f64>,
}

impl Step {
    fn prepare(&mut self, step_s: f64, rates: &[f64]) {
        if (step_s - self.step_s).abs() <= 1e-12 && !self.decay.is_empty() {
            return;
        }
        self.step_s = step_s;
        self.decay = rates.iter().map(|rate| decay(rate, step_s)).collect();
        self.last = rates.iter().map(|rate| last(rate, step_s)).collect();
        self.first = rates.iter().map(|rate| mean(rate, step_s) - last(rate, step_s)).collect();
    }
}

/// Weight of the displacement at the end of a step that ramps.
fn last(rate: &f64, step_s: f64) -> f64 {
    let x = rate * step_s;
    if x < 1e-3 { step_s * (0.5 - x / 6.0 + x * x / 24.0) } else { (step_s - mean(rate, step_s)) / x }
}

/// int_0^h e^(-r (h - t)) (1 - t/h) dt and the same of t/h, by series where r h is small.
fn mean(rate: &f64, step_s: f64) -> f64 {
    let x = rate * step_s;
    if x < 1e-4 { step_s * (1.0 - 0.5 * x) } else { (1.0 - decay(rate, step_s)) / rate }
}

/// Share of a memory that is left after a step.
fn decay(rate: &f64, step_s: f64) -> f64 {
    (-rate * step_s).exp()
}

#[cfg(test)]
#[path = "lateral_tests.rs"]
mod tests;
