//! Sessions whose tissue is an elastic body instead of springs: points of it are coupled, surface and tip differ from the middle.
//!
//! A solver of its own: nothing here uses the forward model's tables, operators or solvers. The body is linear, so one
//! solution per depth and course of the modulus is enough; the needle is a beam of its own, tied to the wall with its slope.
//!
//! | file | has |
//! |---|---|
//! | `mesh` | lines of the meridian plane |
//! | `wall` | the body's stiffness against the needle's deflection and slope |
//! | `beam` | the needle |
//! | `block` | both in a block of tissue, whose stiffness is computed elsewhere |

mod beam;
mod block;
mod mesh;
mod wall;

use super::chain::{STEP_M, node_at};
use super::flaws::Flaws;
use super::lateral::{Motion, prestress};
use super::sensors::{self, LateralPart};
use super::world::World;
use super::{Background, Design, MM, NoisePlan, Truth};
use beam::{Bent, Holding};
pub use block::{BlockStiffness, DEGREES};
use formats::session::{LateralRun, Noise, Session};
use mechanics::{Needle, Rig};
pub use mesh::Fineness;
use mesh::Mesh;
use std::collections::HashMap;
use std::sync::{Arc, Mutex, PoisonError};
use wall::Wall;

/// True body.
#[derive(Debug, Clone, PartialEq)]
pub struct Body {
    /// Young's modulus; with layers or a gradient that at the surface.
    pub youngs_kpa: f64,
    /// Poisson's ratio, up to one half.
    pub poisson: f64,
    /// Effects by id with their values; of the tissue `tissue.layers`, `tissue.gradient`, `tissue.entry_gap`, `tissue.skin` and
    /// `tissue.anisotropy`, each a change of Young's modulus.
    pub effects: Vec<(&'static str, Vec<f64>)>,
}

/// Effects that a linear body with static loads cannot have, beside those of the tip.
const IMPOSSIBLE: [&str; 3] = ["tissue.stiffening", "tissue.relaxation", "tissue.shear"];
/// Modulus of a gap, as a share.
const GAP: f64 = 1e-6;
/// Bodies that are kept, some fifty kilobytes each.
const MAX_KEPT: usize = 256;
/// Below the deepest tip of all runs by this much the tissue stays as it is.
const GOES_ON_M: f64 = 10e-3;

/// Why there is no session.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum BodyError {
    /// Its equations have no solution.
    #[error("the body's equations cannot be solved")]
    Singular,
    /// Its stiffness is known at no depth.
    #[error("the body's stiffness is known at no depth, expected one or more")]
    NoDepth,
    /// Insertions are simulated in springs only.
    #[error("insertion: the design has insertions, expected lateral runs only")]
    Insertion,
    /// Something that a linear body does not do.
    #[error(
        "effect {0}: not possible in a linear body, expected one of a rig, a sensor, the needle, or layers, gradient, entry gap, skin and anisotropy"
    )]
    Effect(&'static str),
}

/// Solves bodies and keeps some of them: homogeneous ones are those of many sessions, others of many models of one.
#[derive(Debug, Default)]
pub struct Bodies {
    kept: Mutex<HashMap<Vec<u64>, Arc<Wall>>>,
    fineness: Option<Fineness>,
}

impl Bodies {
    /// With meshes of this fineness.
    pub fn new(fineness: Fineness) -> Self {
        Self { fineness: Some(fineness), ..Self::default() }
    }

    /// The body around a needle of this radius and length.
    fn wall(
        &self,
        world: &World,
        radius_m: f64,
        length_m: f64,
        goes_on_m: f64,
        poisson: f64,
    ) -> Result<Arc<Wall>, BodyError> {
        let fineness = self.fineness.unwrap_or(Fineness::FINE);
        let modulus = |depth_m: f64| relative_modulus(world, depth_m.min(goes_on_m));
        // A boundary without contrast is none: such a body is the homogeneous one.
        let boundary_m = if world.layer_ratio == 1.0 { 0.0 } else { world.layer_boundary_m };
        let mut key = vec![
            radius_m,
            length_m,
            poisson,
            world.layer_ratio,
            boundary_m,
            world.gradient_per_m,
            world.gap_m,
        ];
        let tissue = &world.tissue;
        let is_level = world.gradient_per_m == 0.0 && tissue.waves.is_empty() && tissue.soft_spot[0] == 0.0;
        key.push(if is_level { 0.0 } else { goes_on_m });
        key.extend(tissue.soft_spot);
        key.extend(tissue.waves.iter().flat_map(|wave| [wave.amplitude, wave.per_length, wave.phase]));
        let key: Vec<u64> = key.into_iter().map(f64::to_bits).collect();
        if let Some(wall) = self.kept_walls().get(&key) {
            return Ok(Arc::clone(wall));
        }
        let mesh = Mesh::new(radius_m, length_m, &[world.gap_m, boundary_m], fineness);
        let wall = Arc::new(wall::solve(&mesh, poisson, &modulus)?);
        let mut kept_unknowns = self.kept_walls();
        if kept_unknowns.len() >= MAX_KEPT {
            kept_unknowns.clear();
        }
        kept_unknowns.insert(key, Arc::clone(&wall));
        Ok(wall)
    }

    fn kept_walls(&self) -> std::sync::MutexGuard<'_, HashMap<Vec<u64>, Arc<Wall>>> {
        self.kept.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Session that a laboratory would record with this body; lateral runs only.
    ///
    /// # Errors
    /// [`BodyError`].
    ///
    /// # Panics
    /// As [`session`](super::session).
    pub fn session(
        &self,
        body: &Body,
        background: &Background,
        design: &Design,
        seed: u64,
    ) -> Result<Session, BodyError> {
        if !design.insertion.is_empty() {
            return Err(BodyError::Insertion);
        }
        if let Some(id) = body
            .effects
            .iter()
            .map(|(id, _)| *id)
            .find(|id| IMPOSSIBLE.contains(id) || id.starts_with("tip."))
        {
            return Err(BodyError::Effect(id));
        }
        let rig = Rig::two_guides(Needle::gauge_18(), 0.06, 0.07);
        let truth =
            Truth { k_kpa: body.youngs_kpa, tip_load_n: 0.0, effects: body.effects.clone(), foreign: None };
        let world = World::new(&truth, &rig);
        let noise: &NoisePlan = &design.noise;
        let deepest_mm = design.lateral.iter().map(|plan| plan.depth_mm).fold(0.0, f64::max);
        let mut lateral = Vec::new();
        for (run, plan) in (0..).zip(&design.lateral) {
            let flaws = Flaws::new(background, run);
            let world = flaws.world(&world, 0);
            let depth_m = STEP_M * node_at(MM * plan.depth_mm) as f64;
            let length_m = depth_m - world.tissue.surface_m;
            let goes_on_m = MM * deepest_mm + GOES_ON_M;
            let radius_m = 0.5 * rig.needle.outer_diameter_m;
            let wall = self.wall(&world, radius_m, length_m, goes_on_m, body.poisson)?;
            let bent = [0, 1].map(|plane| Bent::new(&holding(&world, plane), &wall));
            let [y, x] = bent;
            let bent = [y?, x?];
            let images = design.images.as_ref();
            let lateral_part = LateralPart { world: &world, flaws: &flaws, plan, noise, images, seed, run };
            let march = |plane: usize, commanded_m: &[f64], keep: &[usize]| {
                march(&world, plane, &bent[plane], depth_m, commanded_m, keep)
            };
            lateral.push(sensors::lateral_run(&lateral_part, &march));
        }
        Ok(recorded(rig, noise, lateral))
    }
}

/// The session of these runs, in tissue without walls near.
fn recorded(rig: Rig, noise: &NoisePlan, lateral: Vec<LateralRun>) -> Session {
    Session {
        dir: "blind".into(),
        name: Some("blind".to_owned()),
        fixture_mass_kg: None,
        noise: if noise.stated { noise.statement() } else { Noise::default() },
        tissue: formats::session::Tissue {
            walls: Some(formats::session::Walls::Far),
            ..formats::session::Tissue::default()
        },
        lateral,
        insertion: Vec::new(),
        indentation: Vec::new(),
        steering: Vec::new(),
        rig,
    }
}

/// Young's modulus at a depth below the real surface, relative to the body's own.
fn relative_modulus(world: &World, depth_m: f64) -> f64 {
    if depth_m < world.gap_m {
        return GAP;
    }
    let layer = if depth_m < world.layer_boundary_m { 1.0 } else { world.layer_ratio };
    let factor = world.tissue.at(depth_m) / world.tissue.factor;
    layer * world.growth(depth_m) * factor
}

fn holding(world: &World, plane: usize) -> Holding {
    let ratio = if plane == 0 { 1.0 } else { world.anisotropy };
    Holding {
        bending_n_m2: world.bending_n_m2,
        guide2_m: world.guide2_m.unwrap_or(world.entry_m),
        entry_m: world.entry_m + world.tissue.surface_m,
        clamp_rad_per_n_m: world.clamp_rad_per_n_m,
        skin_n_per_m: world.skin_n_per_m,
        axial_n: world.axial_n,
        youngs_pa: ratio * world.tissue.factor * world.k_pa,
    }
}

/// Guide 2 goes through its motion, with play; the answer of a linear body has no memory.
fn march(
    world: &World,
    plane: usize,
    bent: &Bent,
    depth_m: f64,
    commanded_m: &[f64],
    keep: &[usize],
) -> Motion {
    let (prestress_n, prestress_shape_m) = prestress(world, plane);
    let count = node_at(world.entry_m) + node_at(depth_m) + 1;
    let positions_m: Vec<f64> = (0..count).map(|node| node as f64 * STEP_M).collect();
    let shape_per_m: Vec<f64> = positions_m.iter().map(|z_m| bent.at(*z_m)).collect();
    let mut motion = Motion { force_n: Vec::with_capacity(commanded_m.len()), shape_m: Vec::new() };
    // Frame and needle share what guide 2 is moved by; the frame gives way to the force that is there at rest, too.
    let frame = 1.0 + world.frame_m_per_n * bent.stiffness_n_per_m;
    let mut guide_m = 0.0_f64;
    for (sample, measured_m) in commanded_m.iter().enumerate() {
        guide_m = guide_m.clamp(measured_m - world.play_m, measured_m + world.play_m);
        let pushed_m = (guide_m.abs() - world.clearance_m).max(0.0) * guide_m.signum();
        let touches = pushed_m != 0.0 || world.clearance_m <= 0.0;
        let yielded_m = if touches { world.frame_m_per_n * prestress_n } else { 0.0 };
        let moved_m = (pushed_m - yielded_m) / frame;
        let pushed_n = if touches { bent.stiffness_n_per_m * moved_m } else { 0.0 };
        motion.force_n.push(prestress_n + pushed_n);
        for _ in keep.iter().filter(|kept| **kept == sample) {
            let shape = shape_per_m
                .iter()
                .zip(&positions_m)
                .map(|(shape_per_m, z_m)| moved_m * shape_per_m + prestress_shape_m(*z_m));
            motion.shape_m.push(shape.collect());
        }
    }
    motion
}

#[cfg(test)]
mod tests;
