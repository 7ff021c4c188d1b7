//! A needle in the tissue at a depth, ready to be moved sideways: what no motion of guide 2 changes is solved once.
//!
//! Identification needs many motions of one needle, as true displacements are unknowns; [`predict`](super::predict) needs one.

use super::cache::Cache;
use super::carried::{Carried, Held};
use super::effects::{MotionContext, ObservationContext, first_after};
use super::lateral::{Drive, Response, Samples};
use super::predict::Plane;
use super::prestress::Prestress;
use super::terms::{Conditions, Shifts};
use super::varied::Varied;
use super::{BeamProblem, Channels, DriveSample, Model, ModelError, Series, ShapeImage, ShapePoint};
use std::borrow::Cow;
use std::ops::Range;
use std::sync::Arc;

/// A model's needle at a depth, with the places at which its shape is measured.
#[derive(Debug, Clone)]
pub struct PreparedNeedle<'a> {
    model: Cow<'a, Model>,
    drive: Drive,
    prestress: Prestress,
    places: Places,
    /// Image of every point; empty if no effect depends on it.
    images: Vec<Option<ShapeImage>>,
    needles: Needles,
    /// Whether the horizontal plane is predicted too.
    both: bool,
    /// Motion back by less is noise of the displacement.
    reversal_m: [f64; 2],
    /// Depth of the needle and number of the run.
    conditions: Conditions,
    /// Every point of the shape; empty where no effect depends on its place.
    shape: Vec<ShapePoint>,
    /// Needles that were solved recently.
    cache: Option<&'a Cache>,
}

/// Planned motion and measurements of a prepared needle.
#[derive(Debug, Clone, Copy)]
pub struct ObservationPlan<'a> {
    /// When and where its shape is measured.
    pub shape: &'a [ShapePoint],
    /// Largest displacement of guide 2 in each plane.
    pub most_m: [f64; 2],
    /// Planes that are measured: 1, the vertical one, or 2.
    pub planes: usize,
    /// Motion back by this or less is noise of the displacement in each plane; 0 where the motion is exact.
    pub reversal_m: [f64; 2],
    /// Number of the run in its session, 0 for the first.
    pub order: f64,
}

impl<'a> PreparedNeedle<'a> {
    /// The needle of `model` at a depth, moved and measured as planned; the cache may hold it.
    ///
    /// # Errors
    /// As [`BeamProblem::solve`].
    pub fn new(
        model: Cow<'a, Model>,
        depth_m: f64,
        ObservationPlan { shape, most_m, planes, reversal_m, order }: ObservationPlan<'_>,
        cache: Option<&'a Cache>,
    ) -> Result<Self, ModelError> {
        let mut drive = Drive::default();
        model.effects.iter().for_each(|(effect, values)| effect.drive(values, &mut drive));
        let conditions = Conditions { depth_m, order };
        let problems = Problems::of(&model, &conditions)?;
        let shape_places = Places::of(&model, &conditions, shape);
        let is_needed = model.effects.iter().any(|(effect, _)| effect.needs_images());
        let images = shape.iter().filter(|_| is_needed).map(|point| point.image).collect();
        let has_places = model.effects.iter().any(|(effect, _)| effect.needs_places());
        let shape = if has_places { shape.to_vec() } else { Vec::new() };
        let needles = Needles::new(&problems, Shifts::move_tissue(&model), most_m, &shape_places.z_m, cache)?;
        // An effect may bring what happens in one plane into the other.
        let is_biplanar = planes > 1 || !model.effects.is_empty();
        Ok(Self {
            prestress: Prestress::of(&model, [&problems.y, problems.x()], &conditions)?,
            needles,
            drive,
            conditions,
            shape,
            cache,
            places: shape_places,
            images,
            both: is_biplanar,
            reversal_m,
            model,
        })
    }

    /// Expected readings of the sensors under this commanded motion of guide 2, in increasing time.
    ///
    /// # Errors
    /// [`ModelError::NoDrive`] where there are shape points but no drive sample; as [`BeamProblem::solve`] where tissue stiffens and
    /// guide 2 goes further than planned.
    pub fn moved(&self, drive: &[DriveSample]) -> Result<Channels, ModelError> {
        let further;
        let needles = if self.needles.reach(most_m(drive)) {
            &self.needles
        } else {
            let problems = Problems::of(&self.model, &self.conditions)?;
            let moves_tissue = Shifts::move_tissue(&self.model);
            further = Needles::new(&problems, moves_tissue, most_m(drive), &self.places.z_m, None)?;
            &further
        };
        let times_s: Samples = drive.iter().map(|sample| sample.time_s).collect();
        let y_m: Samples = drive.iter().map(|sample| sample.y_m).collect();
        let x_m: Samples = drive.iter().map(|sample| sample.x_m).collect();
        let motion = MotionContext {
            time_s: &times_s,
            commanded_m: [&y_m, &x_m],
            reversal_m: self.reversal_m,
            conditions: self.conditions,
        };
        let reached_m = |plane: usize| {
            let mut reached_m = Samples::from_slice(motion.commanded_m[plane]);
            let effects = self.model.effects.iter();
            effects.for_each(|(effect, values)| effect.guide2(values, &motion, plane, &mut reached_m));
            reached_m
        };
        let in_plane = |plane: usize| self.in_plane(plane, needles, &motion, &reached_m(plane));
        let (force_y_n, shape_y_m) = in_plane(0)?;
        let mut channels = Channels {
            displacement_m: Series { y: y_m.to_vec(), x: None },
            force_n: Series { y: force_y_n, x: None },
            shape_m: Series { y: shape_y_m, x: None },
            ..Channels::default()
        };
        if self.both {
            let (force_x_n, shape_x_m) = in_plane(1)?;
            channels.displacement_m.x = Some(x_m.to_vec());
            channels.force_n.x = Some(force_x_n);
            channels.shape_m.x = Some(shape_x_m);
            channels.tip_m.x = Some(Vec::new());
        }
        let context = ObservationContext {
            time_s: &times_s,
            commanded_m: [&y_m, &x_m],
            reversal_m: self.reversal_m,
            images: &self.images,
            conditions: self.conditions,
            entry_m: self.model.rig.entry_m,
            shape: &self.shape,
            tip_depth_m: &[],
        };
        self.model.observe(&context, &mut channels);
        Ok(channels)
    }

    /// Force of guide 2 at every sample of its motion in a plane, and the deflection at every point of the shape.
    fn in_plane(
        &self,
        plane: usize,
        needles: &Needles,
        context: &MotionContext<'_>,
        commanded_m: &[f64],
    ) -> Result<(Vec<f64>, Vec<f64>), ModelError> {
        let (times_s, reversal_m) = (context.time_s, self.reversal_m[plane]);
        let needle = needles.of_plane(plane);
        let varied = self.varied(plane, context)?;
        let compliance_m_per_n = self.drive.frame_compliance_m_per_n;
        let respond = |commanded_m: &[f64]| match &varied {
            Some((varied, factors)) => {
                let pressed_m = self.drive.reaching_m(commanded_m, reversal_m);
                varied.moved(&pressed_m, factors, compliance_m_per_n)
            }
            None => needle.response.moved(times_s, commanded_m, reversal_m, self.drive),
        };
        let mut weights = match &varied {
            Some((varied, _)) => Cow::Owned(varied.shape_at(&self.places.z_m)),
            None => Cow::Borrowed(needle.weights.as_slice()),
        };
        let mut motion = match Shifts::of(&self.model, context, plane) {
            None => respond(commanded_m),
            Some(shifts) => {
                let held_force = Held {
                    stiffness_n_per_m: needle.response.stiffness_n_per_m(),
                    compliance_m_per_n,
                    carried: needle.carried.as_ref(),
                    is_linear: varied.is_none() && needle.response.is_linear() && self.drive.is_linear(),
                };
                let (mut motion, tissue_m) = shifts.moved(commanded_m, &held_force, respond);
                if let Some(carried) = &needle.carried {
                    motion.coefficients.extend(tissue_m);
                    weights.to_mut().extend(&carried.weights);
                }
                motion
            }
        };
        let Places { z_m, frames } = &self.places;
        let mut shape_m = Vec::with_capacity(frames.iter().map(|frame| frame.places.len()).sum());
        for ShapeFrame { time_s, places } in frames {
            let (interval, fraction) = place_in(times_s, *time_s)?;
            let first = shape_m.len();
            self.prestress.add_deflections_m(plane, &z_m[places.clone()], &mut shape_m);
            for (coefficient, weights) in
                motion.between(interval, fraction).zip(weights.chunks_exact(z_m.len()))
            {
                let moved_m = shape_m[first..].iter_mut().zip(&weights[places.clone()]);
                moved_m.for_each(|(at_m, weight)| *at_m += coefficient * weight);
            }
        }
        let prestress_n = self.prestress.force_n(plane);
        motion.force_n.iter_mut().for_each(|force_n| *force_n += prestress_n);
        Ok((motion.force_n, shape_m))
    }
}

impl PreparedNeedle<'_> {
    /// The needle in a plane where its modulus changes with the motion, and by which factors.
    fn varied(
        &self,
        plane: usize,
        context: &MotionContext<'_>,
    ) -> Result<Option<(Varied, Vec<f64>)>, ModelError> {
        let effects = || self.model.effects.iter().filter(|(effect, _)| effect.varies_modulus());
        if effects().next().is_none() {
            return Ok(None);
        }
        let mut factors = vec![1.0; context.time_s.len()];
        effects().for_each(|(effect, values)| effect.modulus(values, context, plane, &mut factors));
        let in_plane = if plane == 0 { Plane::Y } else { Plane::X };
        let problem = self.model.problem_under(in_plane, &self.conditions)?;
        Ok(Varied::new(&problem, &factors, self.cache)?.map(|varied| (varied, factors)))
    }
}

/// The needle in each plane, as it is to be solved.
struct Problems {
    y: BeamProblem,
    /// Second problem, if the planes differ.
    x: Option<BeamProblem>,
}

impl Problems {
    fn of(model: &Model, conditions: &Conditions) -> Result<Self, ModelError> {
        let y = model.problem_under(Plane::Y, conditions)?;
        let block_differs = model.support.block().is_some_and(|block| block != block.turned());
        let planes_agree = model.effects.is_empty() && !model.rig.has_one_guide() && !block_differs;
        let x = if planes_agree { None } else { Some(model.problem_under(Plane::X, conditions)?) };
        Ok(Self { x: x.filter(|x| *x != y), y })
    }

    fn x(&self) -> &BeamProblem {
        self.x.as_ref().unwrap_or(&self.y)
    }
}

/// Largest commanded displacement in each plane.
pub(super) fn most_m(drive: &[DriveSample]) -> [f64; 2] {
    drive.iter().fold([0.0; 2], |[y_m, x_m], sample| [sample.y_m.abs().max(y_m), sample.x_m.abs().max(x_m)])
}

/// Positions at which a shape is measured, frame by frame.
#[derive(Debug, Clone, Default)]
struct Places {
    /// The same places are here once as long as frame after frame shows them.
    z_m: Vec<f64>,
    frames: Vec<ShapeFrame>,
}

/// Measurements of the needle at one time.
#[derive(Debug, Clone)]
struct ShapeFrame {
    time_s: f64,
    /// Its places, in the order of its points.
    places: Range<usize>,
}

impl Places {
    fn of(model: &Model, conditions: &Conditions, shape: &[ShapePoint]) -> Self {
        let entry_m = model.rig.entry_m;
        let mut shape_places = Self { z_m: Vec::with_capacity(shape.len()), frames: Vec::new() };
        for frame in shape.chunk_by(|a, b| a.time_s == b.time_s) {
            let first = shape_places.z_m.len();
            shape_places.z_m.extend(frame.iter().map(|point| point.z_m));
            if !model.effects.is_empty() {
                for (point, z_m) in frame.iter().zip(&mut shape_places.z_m[first..]) {
                    let mut measured = *point;
                    model.effects.iter().for_each(|(effect, values)| {
                        effect.map_position(values, entry_m, conditions, &mut measured);
                    });
                    *z_m = measured.z_m;
                }
            }
            let mut frame_places = first..shape_places.z_m.len();
            let previous_places = shape_places.frames.last().map(|before| before.places.clone());
            if let Some(same_places) = previous_places.filter(|previous_places| {
                shape_places.z_m[previous_places.clone()] == shape_places.z_m[first..]
            }) {
                shape_places.z_m.truncate(first);
                frame_places = same_places;
            }
            shape_places
                .frames
                .extend(frame.first().map(|point| ShapeFrame { time_s: point.time_s, places: frame_places }));
        }
        shape_places
    }
}

/// The needle as it answers up to a displacement.
#[derive(Debug, Clone)]
struct Needles {
    y: Needle,
    /// Second needle, if the planes differ.
    x: Option<Needle>,
    /// Largest displacement for which these are valid in each plane; `None` if no displacement
    /// changes them.
    most_m: Option<[f64; 2]>,
}

/// The needle in a plane.
#[derive(Debug, Clone)]
struct Needle {
    response: Arc<Response>,
    /// Weights of a motion's coefficients at every position, coefficient by coefficient.
    weights: Vec<f64>,
    /// Its answer to a motion of the tissue; nothing if no law moves it.
    carried: Option<Carried>,
}

impl Needles {
    fn new(
        problems: &Problems,
        moves_tissue: bool,
        [y_m, x_m]: [f64; 2],
        z_m: &[f64],
        cache: Option<&Cache>,
    ) -> Result<Self, ModelError> {
        let most_m = if problems.x.is_some() { [y_m, x_m] } else { [y_m.max(x_m); 2] };
        let y = solved(&problems.y, most_m[0], cache, moves_tissue, z_m)?;
        let x = problems.x.as_ref().map(|x| solved(x, most_m[1], cache, moves_tissue, z_m)).transpose()?;
        let stiffens = [&problems.y, problems.x()].into_iter().any(|p| p.is_nonlinear());
        Ok(Self { y, x, most_m: stiffens.then_some(most_m) })
    }

    fn reach(&self, [y_m, x_m]: [f64; 2]) -> bool {
        self.most_m.is_none_or(|[most_y_m, most_x_m]| y_m <= most_y_m && x_m <= most_x_m)
    }

    fn of_plane(&self, plane: usize) -> &Needle {
        self.x.as_ref().filter(|_| plane == 1).unwrap_or(&self.y)
    }
}

/// Response of a needle, with what it carries along where tissue moves.
fn solved(
    problem: &BeamProblem,
    most_m: f64,
    cache: Option<&Cache>,
    moves_tissue: bool,
    z_m: &[f64],
) -> Result<Needle, ModelError> {
    let response = match cache {
        Some(cache) => cache.response(problem, most_m)?,
        None => Arc::new(Response::new(problem, most_m)?),
    };
    let carried = if moves_tissue { Some(Carried::new(problem, z_m)?) } else { None };
    Ok::<_, ModelError>(Needle { weights: response.shape_at(z_m), response, carried })
}

/// The drive samples around a time and the share of the way between them; the first or last one beyond the ends.
fn place_in(times_s: &[f64], time_s: f64) -> Result<([usize; 2], f64), ModelError> {
    let next = first_after(times_s, time_s);
    match (next.checked_sub(1), times_s.get(next)) {
        (Some(a), Some(b_s)) => Ok(([a, next], (time_s - times_s[a]) / (b_s - times_s[a]))),
        (Some(last), None) => Ok(([last, last], 0.0)),
        (None, Some(_)) => Ok(([0, 0], 0.0)),
        (None, None) => Err(ModelError::NoDrive),
    }
}

#[cfg(test)]
mod tests;
