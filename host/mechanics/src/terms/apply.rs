//! Effect of terms inside the forward model.

use super::acting::{ActingLaw, MIN_SHARE};
use super::{Conditions, Form, Law, Regressor, Site};
use crate::effects::{Effect, EffectInfo, MotionContext, ObservationContext, series_at};
use crate::insertion::TipLaw;
use crate::predict::Plane;
use crate::{BeamProblem, Channels, ModelError, Profile, Series, ShapePoint};

/// Depths over which a load on the tip is given.
const KNOT_M: f64 = 2e-3;
const DEEPEST_M: f64 = 0.3;

impl Law {
    /// The function in SI at a value of the regressor in SI.
    pub(super) fn at(&self, values: &[f64], x: f64) -> f64 {
        let x = self.regressor.per_si() * x;
        let value = match self.own {
            Some(own) => (own.value)(values, x),
            None => self.form.value(values, self.regressor, x),
        };
        self.site.si() * value
    }

    /// The function in SI at a value of the regressor in SI after what came before, and its state there, in the unit of the regressor.
    pub(super) fn at_after(&self, values: &[f64], x: f64, state: f64) -> (f64, f64) {
        if !matches!(self.form, Form::Play | Form::Bristle) {
            return (self.at(values, x), state);
        }
        let x = self.regressor.per_si() * x;
        let (value, state) = self.form.value_after(values, self.regressor, x, state);
        (self.site.si() * value, state)
    }

    /// The function along a series of the regressor, one value after the other.
    fn along(&self, values: &[f64], series: impl Iterator<Item = f64>) -> Vec<f64> {
        let mut state = 0.0;
        series
            .map(|x| {
                let (value, after) = self.at_after(values, x, state);
                state = after;
                value
            })
            .collect()
    }

    /// The function where the regressor is the same for a whole run; nothing where it is not.
    fn of_run(&self, values: &[f64], conditions: &Conditions) -> Option<f64> {
        match self.regressor {
            Regressor::Constant => Some(self.at(values, 0.0)),
            Regressor::Depth => Some(self.at(values, conditions.depth_m)),
            Regressor::Run => Some(self.at(values, conditions.order)),
            _ => None,
        }
    }

    /// The function at every force reading of a plane.
    fn along_force(
        &self,
        values: &[f64],
        context: &ObservationContext<'_>,
        plane: usize,
        force_n: &[f64],
    ) -> Vec<f64> {
        let count = force_n.len();
        let commanded_m = context.commanded_m[plane];
        let each = |of: &dyn Fn(usize) -> f64| self.along(values, (0..count).map(of));
        match self.regressor {
            Regressor::Force => each(&|i| force_n[i]),
            Regressor::Displacement => each(&|i| commanded_m.get(i).copied().unwrap_or_default()),
            Regressor::Across => {
                let across_m = context.commanded_m[1 - plane];
                each(&|i| across_m.get(i).copied().unwrap_or_default())
            }
            Regressor::Time => {
                let start_s = context.time_s.first().copied().unwrap_or_default();
                each(&|i| context.time_s.get(i).map_or(0.0, |time_s| time_s - start_s))
            }
            Regressor::Direction => {
                let directions = context.directions(plane);
                each(&|i| directions.get(i).copied().unwrap_or_default())
            }
            Regressor::Speed => {
                let speeds = context.speeds_m_per_s(plane);
                each(&|i| speeds.get(i).copied().unwrap_or_default())
            }
            _ => vec![self.of_run(values, &context.conditions).unwrap_or_default(); count],
        }
    }

    /// The function at every sample of a motion of guide 2 in a plane.
    pub(super) fn along_motion(&self, values: &[f64], context: &MotionContext<'_>, plane: usize) -> Vec<f64> {
        let commanded_m = context.commanded_m[plane];
        let start_s = context.time_s.first().copied().unwrap_or_default();
        match self.regressor {
            Regressor::Displacement => self.along(values, commanded_m.iter().copied()),
            Regressor::Across => self.along(values, context.commanded_m[1 - plane].iter().copied()),
            Regressor::Time => context.time_s.iter().map(|s| self.at(values, s - start_s)).collect(),
            Regressor::Direction => {
                context.directions(plane).iter().map(|way| self.at(values, *way)).collect()
            }
            Regressor::Use => {
                let mut most_m = 0.0_f64;
                let so_far = commanded_m.iter().map(|m| {
                    most_m = most_m.max(m.abs());
                    self.at(values, most_m)
                });
                so_far.collect()
            }
            _ => vec![self.of_run(values, &context.conditions).unwrap_or_default(); commanded_m.len()],
        }
    }

    /// The function at every point of the shape, of a plane.
    fn along_shape(
        &self,
        values: &[f64],
        context: &ObservationContext<'_>,
        plane: usize,
        (deflection_m, across_m, force_n): (&[f64], &[f64], &[f64]),
    ) -> Vec<f64> {
        let (shape, times_s) = (context.shape, context.time_s);
        let each = |of: &dyn Fn(usize, &ShapePoint) -> f64| {
            shape.iter().enumerate().map(|(i, point)| self.at(values, of(i, point))).collect()
        };
        match self.regressor {
            Regressor::Place => each(&|_, point| (point.z_m - context.entry_m).max(0.0)),
            Regressor::Share => {
                let whole_m = context.conditions.depth_m.max(f64::MIN_POSITIVE);
                each(&|_, point| (point.z_m - context.entry_m).max(0.0) / whole_m)
            }
            Regressor::Across => each(&|i, _| across_m.get(i).copied().unwrap_or_default()),
            Regressor::Deflection => each(&|i, _| deflection_m.get(i).copied().unwrap_or_default()),
            Regressor::Displacement => {
                each(&|_, point| series_at(times_s, context.commanded_m[plane], point.time_s))
            }
            Regressor::Force => each(&|_, point| series_at(times_s, force_n, point.time_s)),
            Regressor::Time => {
                let start_s = times_s.first().copied().unwrap_or_default();
                each(&|_, point| point.time_s - start_s)
            }
            _ => vec![self.of_run(values, &context.conditions).unwrap_or_default(); shape.len()],
        }
    }

    /// The function at every depth of an insertion.
    fn along_path(&self, values: &[f64], context: &ObservationContext<'_>) -> Vec<f64> {
        match self.regressor {
            Regressor::Place => context.tip_depth_m.iter().map(|depth_m| self.at(values, *depth_m)).collect(),
            _ => {
                let same = self.of_run(values, &context.conditions).unwrap_or_default();
                vec![same; context.tip_depth_m.len()]
            }
        }
    }

    /// Adds the function to the readings of a series, or makes them larger by this share.
    fn apply(&self, series: &mut Series, is_gain: bool, along: impl Fn(usize, &[f64]) -> Vec<f64>) {
        let planes = [Some(&mut series.y), series.x.as_mut()];
        for (plane, readings) in planes.into_iter().enumerate() {
            let Some(readings) = readings.filter(|_| self.scope.has(plane)) else { continue };
            let more = along(plane, readings);
            for (reading, more) in readings.iter_mut().zip(more) {
                *reading += if is_gain { more * *reading } else { more };
            }
        }
    }
}

impl Effect for Law {
    fn info(&self) -> &'static EffectInfo {
        self.info
    }

    fn needs_places(&self) -> bool {
        matches!(self.site, Site::Shape | Site::ShapeGain)
    }

    fn as_law(&self) -> Option<&Law> {
        Some(self)
    }

    fn tissue(
        &self,
        values: &[f64],
        conditions: &Conditions,
        _plane: Plane,
        problem: &mut BeamProblem,
    ) -> Result<(), ModelError> {
        let acting = || ActingLaw::new(self, values);
        match self.site {
            Site::Reaction => problem.reaction.push(acting()),
            Site::Stiffness => problem.stiffness.push(acting()),
            Site::Clamp => {
                let more = self.of_run(values, conditions).unwrap_or_default();
                problem.clamp_compliance_rad_per_n_m = (problem.clamp_compliance_rad_per_n_m + more).max(0.0);
            }
            Site::GuideTurn => {
                let more = self.of_run(values, conditions).unwrap_or_default();
                problem.guide2_turn_n_m_per_rad = (problem.guide2_turn_n_m_per_rad + more).max(0.0);
            }
            Site::TipSupport => {
                let more = self.of_run(values, conditions).unwrap_or_default();
                problem.tip_support_n_per_m = (problem.tip_support_n_per_m + more).max(0.0);
            }
            _ => {}
        }
        if self.site != Site::Modulus {
            return Ok(());
        }
        problem.foundation = match self.of_run(values, conditions) {
            Some(f) => problem.foundation.scaled(positive_factor(f))?,
            None if self.varies_modulus() => return Ok(()),
            None => problem
                .foundation
                .shaped(problem.depth_m, |depth_m| positive_factor(self.at(values, depth_m)))?,
        };
        Ok(())
    }

    fn varies_modulus(&self) -> bool {
        use Regressor::{Direction, Displacement, Time, Use};
        self.site == Site::Modulus && matches!(self.regressor, Time | Displacement | Direction | Use)
    }

    fn modulus(&self, values: &[f64], context: &MotionContext<'_>, plane: usize, factors: &mut [f64]) {
        for (factor, f) in factors.iter_mut().zip(self.along_motion(values, context, plane)) {
            *factor *= (1.0 + f).max(MIN_SHARE);
        }
    }

    fn guide2(&self, values: &[f64], context: &MotionContext<'_>, plane: usize, reached_m: &mut [f64]) {
        if self.site != Site::Guide || !self.scope.has(plane) {
            return;
        }
        let more_m = self.along_motion(values, context, plane);
        reached_m.iter_mut().zip(more_m).for_each(|(reached_m, more_m)| *reached_m += more_m);
    }

    fn map_position(&self, values: &[f64], entry_m: f64, conditions: &Conditions, point: &mut ShapePoint) {
        if self.site == Site::ShapePosition {
            point.z_m += self
                .of_run(values, conditions)
                .unwrap_or_else(|| self.at(values, (point.z_m - entry_m).max(0.0)));
        }
    }

    fn observe(&self, values: &[f64], context: &ObservationContext<'_>, channels: &mut Channels) {
        let is_gain =
            matches!(self.site, Site::ForceGain | Site::ShapeGain | Site::TipGain | Site::TipDirectionGain);
        match self.site {
            Site::Force | Site::ForceGain => {
                self.apply(&mut channels.force_n, is_gain, |plane, force_n| {
                    self.along_force(values, context, plane, force_n)
                });
            }
            Site::Shape | Site::ShapeGain => {
                let Channels { force_n, shape_m, .. } = channels;
                let is_across = self.regressor == Regressor::Across;
                let before = if is_across { shape_m.clone() } else { Series::default() };
                self.apply(shape_m, is_gain, |plane, deflection_m| {
                    let force_n = if plane == 0 { Some(&force_n.y) } else { force_n.x.as_ref() };
                    let force_n = force_n.map(Vec::as_slice).unwrap_or_default();
                    let across_m = if plane == 0 { before.x.as_ref() } else { Some(&before.y) };
                    let across_m = across_m.map(Vec::as_slice).unwrap_or_default();
                    self.along_shape(values, context, plane, (deflection_m, across_m, force_n))
                });
            }
            Site::Tip | Site::TipGain => {
                self.apply(&mut channels.tip_m, is_gain, |_, _| self.along_path(values, context));
            }
            Site::TipDirection | Site::TipDirectionGain => {
                self.apply(&mut channels.tip_direction_rad, is_gain, |_, _| self.along_path(values, context));
            }
            Site::ShapePosition
            | Site::Guide
            | Site::Modulus
            | Site::TipLoad
            | Site::Tissue
            | Site::Reaction
            | Site::Stiffness
            | Site::Clamp
            | Site::GuideTurn
            | Site::TipSupport
            | Site::TipPush => {}
        }
    }

    fn tip_push(&self, values: &[f64], conditions: &Conditions, tip_n: &mut [f64; 2]) {
        if self.site != Site::TipPush {
            return;
        }
        let more_n = self.of_run(values, conditions).unwrap_or_default();
        (0..2).filter(|plane| self.scope.has(*plane)).for_each(|plane| tip_n[plane] += more_n);
    }

    fn tip(&self, values: &[f64], conditions: &Conditions, law: &mut TipLaw) {
        if self.site != Site::TipLoad {
            return;
        }
        let count = (DEEPEST_M / KNOT_M) as usize;
        let along = |number: usize| {
            let depth_m = KNOT_M * number as f64;
            [depth_m, self.of_run(values, conditions).unwrap_or_else(|| self.at(values, depth_m))]
        };
        // Depths increase, and what is not finite has been refused with the values.
        if let Ok(profile) = Profile::new((0..=count).map(along).collect()) {
            law.along_bevel.laws.push(profile);
        }
    }
}

/// No tissue pushes.
fn positive_factor(f: f64) -> f64 {
    (1.0 + f).max(MIN_SHARE)
}
