//! Needles that were solved recently: runs at one depth share their needle, and so do models that differ in what sensors do. Threads
//! share them too; what is solved depends on nothing but the request, so that it does not matter which of them did it.

use super::growth::{GrowingBeam, Guide2Grip};
use super::lateral::Response;
use super::{BeamProblem, ModelError};
use std::collections::VecDeque;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// How many of each kind are kept.
const KEPT: usize = 48;

/// Needles that were solved recently, by what was solved.
#[derive(Debug, Default)]
pub struct Cache {
    responses: Mutex<VecDeque<(BeamProblem, f64, Arc<Response>)>>,
    growths: Mutex<VecDeque<CachedBeam>>,
}

/// A needle that grew, by what was solved.
#[derive(Debug)]
struct CachedBeam {
    problem: BeamProblem,
    depths_m: Vec<f64>,
    grip: Guide2Grip,
    slopes: bool,
    growth: Arc<GrowingBeam>,
}

impl Cache {
    pub(super) fn response(&self, problem: &BeamProblem, most_m: f64) -> Result<Arc<Response>, ModelError> {
        // How far the needle is moved matters only where the tissue is not linear.
        let most_m = if problem.law.is_nonlinear() { most_m } else { 0.0 };
        // The frame is in series with the needle; what the needle does under a force is the same.
        let key = BeamProblem { guide2_compliance_m_per_n: 0.0, ..problem.clone() };
        let is_it = |(p, m, _): &&(BeamProblem, f64, Arc<Response>)| *m == most_m && *p == key;
        if let Some((.., response)) = locked(&self.responses).iter().find(is_it) {
            return Ok(response.clone());
        }
        let response = Arc::new(Response::new(&key, most_m)?);
        let mut known = locked(&self.responses);
        known.truncate(KEPT - 1);
        known.push_front((key, most_m, response.clone()));
        Ok(response)
    }

    pub(super) fn growth(
        &self,
        problem: &BeamProblem,
        depths_m: &[f64],
        grip: Guide2Grip,
        slopes: bool,
    ) -> Result<Arc<GrowingBeam>, ModelError> {
        // A needle that grows does not care how deep it was meant to go in the end, nor how the tissue would relax; what yields is not
        // solved here.
        let mut key = problem.clone();
        (key.depth_m, key.law) = (0.0, Default::default());
        let is_it = |grown: &&CachedBeam| {
            grown.grip == grip && grown.slopes == slopes && grown.problem == key && grown.depths_m == depths_m
        };
        if let Some(grown) = locked(&self.growths).iter().find(is_it) {
            return Ok(grown.growth.clone());
        }
        let solve = if slopes { GrowingBeam::new } else { GrowingBeam::without_slopes };
        let growth = Arc::new(solve(problem, depths_m.to_vec(), grip)?);
        let mut known = locked(&self.growths);
        known.truncate(KEPT - 1);
        let depths_m = depths_m.to_vec();
        known.push_front(CachedBeam { problem: key, depths_m, grip, slopes, growth: growth.clone() });
        Ok(growth)
    }
}

/// Nothing is solved under a lock, so that nothing that panics leaves it half done.
fn locked<T>(kept: &Mutex<T>) -> MutexGuard<'_, T> {
    kept.lock().unwrap_or_else(PoisonError::into_inner)
}
