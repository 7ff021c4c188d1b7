//! Needles that were solved lately: runs at one depth share their needle, and so do models that differ in what sensors do.

use super::growth::{Growth, Guide2Grip};
use super::lateral::Response;
use super::{BeamProblem, ModelError};
use std::cell::RefCell;
use std::collections::VecDeque;
use std::rc::Rc;

/// How many of each kind are kept.
const KEPT: usize = 48;

/// Needles that were solved lately, by what was solved.
#[derive(Debug, Default)]
pub struct Cache {
    responses: RefCell<VecDeque<(BeamProblem, f64, Rc<Response>)>>,
    growths: RefCell<VecDeque<Grown>>,
}

/// A needle that grew, by what was solved.
#[derive(Debug)]
struct Grown {
    problem: BeamProblem,
    depths_m: Vec<f64>,
    grip: Guide2Grip,
    slopes: bool,
    growth: Rc<Growth>,
}

impl Cache {
    pub(super) fn response(&self, problem: &BeamProblem, most_m: f64) -> Result<Rc<Response>, ModelError> {
        // How far the needle is moved matters only where the tissue stiffens.
        let most_m = if problem.law.inverse_u0_per_m == 0.0 { 0.0 } else { most_m };
        let mut known = self.responses.borrow_mut();
        if let Some((.., response)) = known.iter().find(|(p, m, _)| *m == most_m && p == problem) {
            return Ok(response.clone());
        }
        let response = Rc::new(Response::new(problem, most_m)?);
        known.truncate(KEPT - 1);
        known.push_front((problem.clone(), most_m, response.clone()));
        Ok(response)
    }

    pub(super) fn growth(
        &self,
        problem: &BeamProblem,
        depths_m: &[f64],
        grip: Guide2Grip,
        slopes: bool,
    ) -> Result<Rc<Growth>, ModelError> {
        // A needle that grows does not care how deep it was meant to go in the end, nor how the tissue would relax.
        let mut key = problem.clone();
        (key.depth_m, key.law) = (0.0, Default::default());
        let mut known = self.growths.borrow_mut();
        let is_it = |grown: &&Grown| {
            grown.grip == grip && grown.slopes == slopes && grown.problem == key && grown.depths_m == depths_m
        };
        if let Some(grown) = known.iter().find(is_it) {
            return Ok(grown.growth.clone());
        }
        let solve = if slopes { Growth::new } else { Growth::without_slopes };
        let growth = Rc::new(solve(problem, depths_m.to_vec(), grip)?);
        known.truncate(KEPT - 1);
        let depths_m = depths_m.to_vec();
        known.push_front(Grown { problem: key, depths_m, grip, slopes, growth: growth.clone() });
        Ok(growth)
    }
}
