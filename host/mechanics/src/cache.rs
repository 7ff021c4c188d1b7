//! Needles that were solved recently: runs at one depth share their needle, and so do models that differ in what sensors do. Threads
//! share them too; what is solved depends on nothing but the request, so that it does not matter which of them did it.

use super::growth::{GrowingBeam, Guide2Grip, NodeLoads};
use super::lateral::Response;
use super::yielding::{self, YieldingPath};
use super::{BeamProblem, ModelError, TissueLaw};
use std::collections::VecDeque;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// Number of entries of each kind that are kept.
const KEPT: usize = 48;

/// Needles that were solved recently, by what was solved.
#[derive(Debug, Default)]
pub struct Cache {
    responses: Mutex<VecDeque<(BeamProblem, f64, Arc<Response>)>>,
    growths: Mutex<VecDeque<CachedBeam>>,
    yielding: Mutex<VecDeque<CachedPath>>,
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

/// A path in tissue that yields, by what was solved: it is no multiple of anything, so that it is one of these loads alone.
#[derive(Debug)]
struct CachedPath {
    problem: BeamProblem,
    depths_m: Vec<f64>,
    grip: Guide2Grip,
    acting: Vec<NodeLoads>,
    curvature_per_m: Vec<[f64; 2]>,
    path: Arc<YieldingPath>,
}

impl Cache {
    pub(super) fn response(&self, problem: &BeamProblem, most_m: f64) -> Result<Arc<Response>, ModelError> {
        // The needle's displacement matters only if the tissue is not linear.
        let most_m = if problem.is_nonlinear() { most_m } else { 0.0 };
        // The frame is in series with the needle; what the needle does under a force is the same.
        let key = BeamProblem { guide2_compliance_m_per_n: 0.0, ..problem.clone() };
        if let Some((.., response)) =
            locked(&self.responses).iter().find(|(p, m, _)| *m == most_m && *p == key)
        {
            return Ok(response.clone());
        }
        let response = Arc::new(Response::new(&key, most_m)?);
        let mut responses = locked(&self.responses);
        responses.truncate(KEPT - 1);
        responses.push_front((key, most_m, response.clone()));
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
        if let Some(grown) = locked(&self.growths).iter().find(|grown| {
            grown.grip == grip && grown.slopes == slopes && grown.problem == key && grown.depths_m == depths_m
        }) {
            return Ok(grown.growth.clone());
        }
        let solve = if slopes { GrowingBeam::new } else { GrowingBeam::without_slopes };
        let growth = Arc::new(solve(problem, depths_m.to_vec(), grip)?);
        let mut growths = locked(&self.growths);
        growths.truncate(KEPT - 1);
        let depths_m = depths_m.to_vec();
        growths.push_front(CachedBeam { problem: key, depths_m, grip, slopes, growth: growth.clone() });
        Ok(growth)
    }

    /// Insertions at other speeds, or with other errors of their sensors, take the same path, and each takes as long as hundreds of
    /// linear ones.
    pub(super) fn yielding(
        &self,
        problem: &BeamProblem,
        depths_m: &[f64],
        grip: Guide2Grip,
        acting: Vec<NodeLoads>,
        curvature_per_m: Vec<[f64; 2]>,
    ) -> Result<Arc<YieldingPath>, ModelError> {
        let TissueLaw { inverse_yield_m_per_n, yield_depth_m, .. } = problem.law;
        let mut key = problem.clone();
        (key.depth_m, key.law) =
            (0.0, TissueLaw { inverse_yield_m_per_n, yield_depth_m, ..Default::default() });
        if let Some(cached) = locked(&self.yielding).iter().find(|known| {
            known.grip == grip
                && known.acting == acting
                && known.curvature_per_m == curvature_per_m
                && known.depths_m == depths_m
                && known.problem == key
        }) {
            return Ok(cached.path.clone());
        }
        let path = Arc::new(yielding::under_load(
            problem,
            depths_m,
            grip,
            |node| acting.get(node).copied().unwrap_or_default(),
            |node| curvature_per_m.get(node).copied().unwrap_or_default(),
        )?);
        let mut cached_paths = locked(&self.yielding);
        cached_paths.truncate(KEPT - 1);
        let (depths_m, path_of) = (depths_m.to_vec(), path.clone());
        cached_paths.push_front(CachedPath {
            problem: key,
            depths_m,
            grip,
            acting,
            curvature_per_m,
            path: path_of,
        });
        Ok(path)
    }
}

/// No solution is computed under a lock, so that a panic leaves it valid.
fn locked<T>(kept: &Mutex<T>) -> MutexGuard<'_, T> {
    kept.lock().unwrap_or_else(PoisonError::into_inner)
}

#[cfg(test)]
mod tests {
    use super::super::{Foundation, Needle, Rig};
    use super::*;

    /// A path that differs in no quantity it depends on comes from the cache; other loads and other tissue do not.
    #[test]
    fn a_path_in_yielding_tissue_is_solved_once() {
        let rig = Rig::two_guides(Needle::gauge_18(), 0.06, 0.07);
        let depths_m = [0.0, 1e-3, 2e-3];
        let cache = Cache::default();
        let first = cached_path(&yielding_problem(0.05, 60.0, &rig), 0.2, depths_m, &cache);
        let mut relaxing = yielding_problem(0.06, 60.0, &rig);
        relaxing.law.relaxing_share = 0.1;
        assert!(Arc::ptr_eq(&first, &cached_path(&relaxing, 0.2, depths_m, &cache)));
        let harder = cached_path(&yielding_problem(0.05, 60.0, &rig), 0.4, depths_m, &cache);
        assert!(harder.0[2].tip_m[0] > first.0[2].tip_m[0]);
        let softer = cached_path(&yielding_problem(0.05, 30.0, &rig), 0.2, depths_m, &cache);
        assert!(softer.0[2].tip_m[0] != first.0[2].tip_m[0]);
    }

    fn cached_path(
        problem: &BeamProblem,
        load_n: f64,
        depths_m: [f64; 3],
        cache: &Cache,
    ) -> Arc<(Vec<crate::growth::TipState>, Vec<[f64; 2]>)> {
        let acting = vec![NodeLoads { load_n: [load_n; 2], ..NodeLoads::default() }; depths_m.len()];
        let bent = vec![[0.0; 2]; depths_m.len()];
        cache.yielding(problem, &depths_m, Guide2Grip::Holding, acting, bent).expect("solves")
    }

    fn yielding_problem(depth_m: f64, yield_n_per_m: f64, rig: &Rig) -> BeamProblem {
        let mut problem = BeamProblem::new(rig, Foundation::uniform(60e3).expect("a modulus"), depth_m);
        problem.law.inverse_yield_m_per_n = 1.0 / yield_n_per_m;
        problem.law.yield_depth_m = 0.01;
        problem
    }
}
