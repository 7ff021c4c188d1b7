//! The needle steered at its base while it goes in: springs and dampers of the tissue, inertia, the remembered cut path
//! (theory, eq. 48; the model of the spring-beam-damper paper with any number of modes).
//!
//! `M x'' + C x' + (K + Pi_1) x = b_u F_y + H`, `x = [alpha, q..]` of `w = alpha + sum phi_i q_i`, with the unconstrained
//! modes `phi_i` of the needle on its moving fixture; `K = int k p p^T` and `C = int c_d p p^T` over the inserted part, `H = int k
//! y_1 p`, `p = [1, phi..]`, `y_1` the path that the tip has cut. Stiffness and damping may change with depth in any way.
//! Integrated by average acceleration, which is stable at any step.

pub mod history;
pub mod modes;

use super::{Foundation, ModelError, Needle, check};
use history::{CutPathForce, ShapeFunctions, SupportMatrix};
use modes::{Clamped, FreeMode, free_modes};
use nalgebra::{DMatrix, DVector};

/// Density of steel, of which needles are made.
pub const STEEL_KG_PER_M3: f64 = 7850.0;

/// Parameters of the moving needle beyond rig and foundation.
#[derive(Debug, Clone, PartialEq)]
pub struct Dynamics {
    /// Length of the needle from the fixture that holds it to its tip.
    pub length_m: f64,
    /// Mass of the needle per length.
    pub density_kg_per_m: f64,
    /// Mass of the fixture that moves sideways with the needle's base.
    pub fixture_mass_kg: f64,
    /// Damping of the tissue against depth: lateral force per needle length and lateral velocity, Pa s in the place of Pa.
    pub damping: Foundation,
    /// The damper resists the needle's motion at a point of the tissue, `w_t - v_x w_x`, and not at a point of the needle, `w_t`.
    pub convective: bool,
    /// Number of modes.
    pub modes: usize,
    /// Longest step of the integration.
    pub step_s: f64,
}

impl Dynamics {
    /// A steel needle of this length on a fixture of this mass, in tissue without damping; five modes.
    pub fn steel(needle: &Needle, length_m: f64, fixture_mass_kg: f64) -> Self {
        let area_m2 =
            std::f64::consts::FRAC_PI_4 * (needle.outer_diameter_m.powi(2) - needle.inner_diameter_m.powi(2));
        Self {
            length_m,
            density_kg_per_m: STEEL_KG_PER_M3 * area_m2,
            fixture_mass_kg,
            damping: Foundation::none(),
            convective: false,
            modes: 5,
            step_s: 1e-3,
        }
    }

    /// Mass of needle and fixture.
    pub fn moving_mass_kg(&self) -> f64 {
        self.fixture_mass_kg + self.density_kg_per_m * self.length_m
    }

    /// Needle and fixture, for the modes.
    pub fn clamped(&self, needle: &Needle) -> Clamped {
        Clamped {
            length_m: self.length_m,
            bending_stiffness_n_m2: needle.bending_stiffness_n_m2(),
            density_kg_per_m: self.density_kg_per_m,
            fixture_mass_kg: self.fixture_mass_kg,
        }
    }
}

/// Drive of the base.
#[derive(Debug, Clone, PartialEq)]
pub enum BaseDrive {
    /// A lateral force at each time, linear between, N.
    Force(Vec<f64>),
    /// A stage that follows these positions, linear between, m: a position loop of [`STAGE_RAD_S`], critically damped, with the
    /// velocity fed forward.
    Position(Vec<f64>),
}

/// Natural frequency of the stage that moves the base.
pub const STAGE_RAD_S: f64 = 120.0;

/// A steering run: what was done, without any measured answer.
#[derive(Debug, Clone, PartialEq)]
pub struct Steering {
    /// Increasing time.
    pub time_s: Vec<f64>,
    /// Insertion depth at each time, not decreasing; linear between.
    pub depth_m: Vec<f64>,
    /// Drive of the base.
    pub drive: BaseDrive,
}

/// Readings of the sensors of a steering run at each time.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct SteeringChannels {
    /// Lateral position of the base.
    pub base_m: Vec<f64>,
    /// Lateral force at the base.
    pub base_force_n: Vec<f64>,
    /// Lateral position of the tip.
    pub tip_m: Vec<f64>,
}

/// The state of the moving needle, stepped through time.
#[derive(Debug, Clone)]
pub struct MovingNeedle {
    stiffness: Foundation,
    damping: Foundation,
    convective: bool,
    mass: DMatrix<f64>,
    elastic: DMatrix<f64>,
    factors: DMatrix<f64>,
    /// Factors times the derivatives of the functions.
    slopes: DMatrix<f64>,
    base: DVector<f64>,
    tip: DVector<f64>,
    springs: SupportMatrix,
    dampers: SupportMatrix,
    pull: CutPathForce,
    depth_m: f64,
    position: DVector<f64>,
    velocity: DVector<f64>,
    acceleration: DVector<f64>,
}

impl MovingNeedle {
    /// At rest and straight, inserted to `depth_m` along its own line.
    ///
    /// # Errors
    /// [`ModelError::OutOfRange`] for a needle that is none or a depth beyond its length.
    pub fn new(
        needle: &Needle,
        stiffness: &Foundation,
        dynamics: &Dynamics,
        depth_m: f64,
    ) -> Result<Self, ModelError> {
        let clamped = dynamics.clamped(needle);
        let modes: Vec<FreeMode> = free_modes(&clamped, dynamics.modes)?;
        let functions = ShapeFunctions::of(&modes, dynamics.length_m);
        let factors = functions.factors(&modes);
        let total_kg = dynamics.moving_mass_kg();
        let count = 1 + modes.len();
        let mut moving = Self {
            stiffness: stiffness.clone(),
            damping: dynamics.damping.clone(),
            convective: dynamics.convective,
            mass: diagonal(total_kg, |_| 1.0, &modes),
            elastic: diagonal(0.0, |mode| mode.frequency_rad_s.powi(2), &modes),
            base: &factors * functions.at(0.0),
            tip: &factors * functions.at(dynamics.length_m),
            slopes: &factors * functions.derivative(),
            factors,
            springs: SupportMatrix::new(&functions),
            dampers: SupportMatrix::new(&functions),
            pull: CutPathForce::new(&functions),
            depth_m: 0.0,
            position: DVector::zeros(count),
            velocity: DVector::zeros(count),
            acceleration: DVector::zeros(count),
        };
        check(
            "depth_m",
            depth_m,
            "0 up to the needle's length",
            (0.0..=dynamics.length_m).contains(&depth_m),
        )?;
        moving.insert(depth_m);
        Ok(moving)
    }

    /// Carries springs and dampers to a greater depth.
    fn insert(&mut self, depth_m: f64) {
        let old_depth_m = self.depth_m;
        self.springs.advance(old_depth_m, depth_m, self.stiffness.parts_between(old_depth_m, depth_m));
        self.dampers.advance(old_depth_m, depth_m, self.damping.parts_between(old_depth_m, depth_m));
        self.depth_m = depth_m;
    }

    /// One step of average acceleration to `depth_m` under `push`; stiffness and damping of the tissue times `strength`, all over
    /// what is inserted.
    ///
    /// # Errors
    /// [`ModelError::Singular`].
    pub fn step(
        &mut self,
        step_s: f64,
        depth_m: f64,
        push: BaseForce,
        strength: [f64; 2],
    ) -> Result<(), ModelError> {
        let advance_m = depth_m - self.depth_m;
        let [springs, dampers] = strength;
        let modulus_pa = self.stiffness.modulus_pa(self.depth_m + 0.5 * advance_m);
        self.pull.advance(advance_m, modulus_pa, self.tip_m());
        let end = self.pull.end(advance_m, modulus_pa);
        self.insert(depth_m);
        let transposed = self.factors.transpose();
        let mut stiffness = &self.factors * self.springs.matrix() * &transposed * springs + &self.elastic;
        stiffness.ger(-springs, &(&self.factors * &end), &self.tip, 1.0);
        let mut damping = &self.factors * self.dampers.matrix() * &transposed * dampers;
        if self.convective {
            let speed_m_s = advance_m / step_s;
            stiffness -=
                &self.factors * self.dampers.matrix() * self.slopes.transpose() * (speed_m_s * dampers);
        }
        let mut load = &self.factors * self.pull.sum() * springs;
        load.axpy(push.force_n, &self.base, 1.0);
        stiffness.ger(push.stiffness_n_per_m, &self.base, &self.base, 1.0);
        damping.ger(push.damping_n_s_per_m, &self.base, &self.base, 1.0);
        let quarter = 0.25 * step_s * step_s;
        let position = &self.position + &self.velocity * step_s + &self.acceleration * quarter;
        let velocity = &self.velocity + &self.acceleration * (0.5 * step_s);
        let matrix = &self.mass + &damping * (0.5 * step_s) + &stiffness * quarter;
        let right = load - &damping * &velocity - &stiffness * &position;
        self.acceleration = matrix.lu().solve(&right).ok_or(ModelError::Singular)?;
        self.position = position + &self.acceleration * quarter;
        self.velocity = velocity + &self.acceleration * (0.5 * step_s);
        self.pull.close(&end, self.tip_m());
        Ok(())
    }

    /// Insertion depth.
    pub fn depth_m(&self) -> f64 {
        self.depth_m
    }

    /// Displacement of the base from its start.
    pub fn base_m(&self) -> f64 {
        self.base.dot(&self.position)
    }

    /// Displacement of the tip from its start.
    pub fn tip_m(&self) -> f64 {
        self.tip.dot(&self.position)
    }

    /// Generalised coordinates: the centre of mass and the modes' amplitudes.
    pub fn position(&self) -> &DVector<f64> {
        &self.position
    }

    /// Their velocities.
    pub fn velocity(&self) -> &DVector<f64> {
        &self.velocity
    }
}

/// Diagonal matrix of the fixture's value and of those of all modes.
fn diagonal(first: f64, others: fn(&FreeMode) -> f64, modes: &[FreeMode]) -> DMatrix<f64> {
    let all_modes = std::iter::once(first).chain(modes.iter().map(others));
    DMatrix::from_diagonal(&DVector::from_iterator(1 + modes.len(), all_modes))
}

/// Force at the base: `force - stiffness base - damping base'`.
#[derive(Debug, Clone, Copy, Default)]
pub struct BaseForce {
    force_n: f64,
    stiffness_n_per_m: f64,
    damping_n_s_per_m: f64,
}

impl BaseForce {
    /// A given force.
    pub fn force(force_n: f64) -> Self {
        Self { force_n, ..Self::default() }
    }

    /// The stage that moves the base: towards a position, from where it started, with a velocity fed forward.
    pub fn stage(total_kg: f64, base_m: f64, speed_m_s: f64) -> Self {
        let stiffness_n_per_m = total_kg * STAGE_RAD_S * STAGE_RAD_S;
        let damping_n_s_per_m = 2.0 * total_kg * STAGE_RAD_S;
        let force_n = stiffness_n_per_m * base_m + damping_n_s_per_m * speed_m_s;
        Self { force_n, stiffness_n_per_m, damping_n_s_per_m }
    }
}

/// Readings of the sensors of a steering run.
///
/// # Errors
/// [`ModelError::OutOfRange`] where series differ in length, time or depth goes back, or the needle is too short;
/// [`ModelError::Singular`].
pub fn simulate(
    needle: &Needle,
    stiffness: &Foundation,
    dynamics: &Dynamics,
    run: &Steering,
) -> Result<SteeringChannels, ModelError> {
    let (values, start) = match &run.drive {
        BaseDrive::Force(force_n) => (force_n, 0.0),
        BaseDrive::Position(base_m) => (base_m, base_m.first().copied().unwrap_or(0.0)),
    };
    let count = run.time_s.len();
    let lengths_agree = run.depth_m.len() == count && values.len() == count && count > 0;
    check(
        "samples of the drive",
        values.len() as f64,
        "as many as times and depths, at least one",
        lengths_agree,
    )?;
    check("step_s", dynamics.step_s, "more than 0", dynamics.step_s > 0.0)?;
    let mut moving =
        MovingNeedle::new(needle, stiffness, dynamics, run.depth_m.first().copied().unwrap_or(0.0))?;
    let mut channels = SteeringChannels::default();
    let mut push_n = match &run.drive {
        BaseDrive::Force(force_n) => force_n.first().copied().unwrap_or(0.0),
        BaseDrive::Position(_) => 0.0,
    };
    // From rest: only the base force accelerates.
    moving.acceleration =
        moving.mass.clone().lu().solve(&(&moving.base * push_n)).ok_or(ModelError::Singular)?;
    for i in 0..count {
        if i > 0 {
            let (start_s, end_s) = (run.time_s[i - 1], run.time_s[i]);
            let (start_m, end_m) = (run.depth_m[i - 1], run.depth_m[i]);
            check("time_s", end_s, "later than the sample before", end_s > start_s)?;
            check(
                "depth_m",
                end_m,
                "not less than before, up to the needle's length",
                end_m >= start_m && end_m <= dynamics.length_m,
            )?;
            let steps = ((end_s - start_s) / dynamics.step_s).ceil().max(1.0);
            let step_s = (end_s - start_s) / steps;
            for j in 1..=steps as usize {
                let fraction = j as f64 / steps;
                let value = interpolated(values[i - 1], values[i], j, steps, fraction);
                let push = match run.drive {
                    BaseDrive::Force(_) => BaseForce::force(value),
                    BaseDrive::Position(_) => {
                        let speed_m_s = (values[i] - values[i - 1]) / (end_s - start_s);
                        BaseForce::stage(dynamics.moving_mass_kg(), value - start, speed_m_s)
                    }
                };
                moving.step(step_s, interpolated(start_m, end_m, j, steps, fraction), push, [1.0; 2])?;
                push_n = push.force_n
                    - push.stiffness_n_per_m * moving.base_m()
                    - push.damping_n_s_per_m * moving.base.dot(&moving.velocity);
            }
        }
        channels.base_m.push(start + moving.base_m());
        channels.base_force_n.push(push_n);
        channels.tip_m.push(start + moving.tip_m());
    }
    Ok(channels)
}

/// Value in a step between two samples; at its end exactly the second one.
fn interpolated(from: f64, to: f64, j: usize, steps: f64, fraction: f64) -> f64 {
    if j as f64 == steps { to } else { from + fraction * (to - from) }
}

#[cfg(test)]
#[path = "steering/tests.rs"]
mod tests;
