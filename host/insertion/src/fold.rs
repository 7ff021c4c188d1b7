//! The posterior of modulus and gap from a set of recordings: where it has its tops.

use super::basis::Basis;
use super::candidates::{Candidate, Candidates, Fineness, Responses};
use super::evidence::{Evidence, System};
use super::learned::{Node, Start};
use super::path::TipPath;
use super::place::Place;
use super::scales::{COUNT, DIRECTION, Known, MOVING, ReadingNoise, Scales};
use super::search;
use std::collections::HashMap;
use std::sync::Arc;

/// Tops further behind the best one than this are given up.
const MIN_LN_TOP: f64 = 7.0;
/// Spacing of the first scan, of the logarithms, and tops that are climbed from it.
const SCAN_LN: f64 = 0.5;
const MAX_TOPS: usize = 3;
/// Steps of a climb, and how often a step that leads down is halved.
const MAX_STEPS: usize = 8;
const MAX_HALVINGS: usize = 4;
/// A rear is solved again where the mean of its share is further away than this.
const SMALL_REAR_STEP: f64 = 0.05;
/// Steps of it, and how far one goes at most.
const MAX_REAR_STEPS: usize = 3;
const MAX_REAR_STEP: f64 = 0.3;
/// Steps below this part of a standard deviation end a climb.
const SMALL_STEP: f64 = 0.1;
/// Rounds of climbs, of candidate and scales in turn.
const MAX_ROUNDS: usize = 3;

/// The recordings that are learned from.
pub(super) struct Fold<'a> {
    pub candidates: &'a Candidates,
    pub paths: &'a [TipPath],
    pub training: &'a [usize],
    /// Locations of the bins of these recordings.
    pub places: Vec<Vec<Place>>,
    pub noise: ReadingNoise,
}

/// A candidate with every recording's values at it.
pub(super) struct Solved {
    pub candidate: Candidate,
    pub ln_prior: f64,
    pub responses: Responses,
    /// Mean of the loads that suit the recordings, per plane, N.
    pub load_n: [f64; 2],
    pub systems: Vec<Vec<System>>,
}

impl Solved {
    fn recordings(&self) -> Vec<&[System]> {
        self.systems.iter().map(Vec::as_slice).collect()
    }

    pub fn node(&self, candidates: &Candidates, next: usize) -> Node {
        let basis = Basis::new(candidates, &self.responses, self.candidate, next, self.load_n);
        Node { candidate: self.candidate, gap_m: candidates.gap_m(self.candidate), basis: Arc::new(basis) }
    }
}

/// A top of the posterior.
pub(super) struct Top {
    pub solved: Arc<Solved>,
    pub likeliest: Vec<f64>,
    pub ln: f64,
    /// Covariance of the logarithms of modulus and gap.
    pub covariance: [[f64; 2]; 2],
}

impl<'a> Fold<'a> {
    /// With where its search begins: as given, or from a scan.
    pub(super) fn new(
        candidates: &'a Candidates,
        paths: &'a [TipPath],
        training: &'a [usize],
        noise: ReadingNoise,
        start: Option<&Start>,
    ) -> (Self, Start) {
        let locations = training.iter().map(|path| candidates.places(*path, &paths[*path])).collect();
        let fold = Self { candidates, paths, training, places: locations, noise };
        let start = start.cloned().unwrap_or_else(|| {
            let likeliest = vec![0.0; COUNT];
            Start { candidates: fold.scan(&likeliest), likeliest }
        });
        (fold, start)
    }

    /// Every recording at a candidate; nothing out of range or where the model has no answer.
    pub(super) fn solve(&self, candidate: Candidate, fineness: Fineness) -> Option<Solved> {
        let ln_prior = self.candidates.ln_prior(candidate)?;
        let responses = self.candidates.responses(candidate, fineness).ok()?;
        let gap_m = self.candidates.gap_m(candidate);
        let mut load_n = [0.0; 2];
        let systems = self.training.iter().zip(&self.places).map(|(path, places)| {
            let mut basis = Basis::without_own(self.candidates, &responses, candidate, *path);
            let fitted_n = basis.fitted_load_n(&self.paths[*path], places);
            load_n
                .iter_mut()
                .zip(fitted_n)
                .for_each(|(sum, fitted_n)| *sum += fitted_n / self.training.len() as f64);
            basis.set_load(gap_m, fitted_n);
            System::of(&basis, &self.paths[*path], places, &self.candidates.layout)
        });
        let systems = systems.collect();
        Some(Solved { candidate, ln_prior, responses, load_n, systems })
    }

    /// The same with a rear that is not known solved where its posterior has its mean.
    pub(super) fn solve_about_rear(&self, mut candidate: Candidate, likeliest: &[f64]) -> Option<Solved> {
        let mut solved = self.solve(candidate, Fineness::Fine)?;
        for _ in 0..MAX_REAR_STEPS {
            let scales = self.scales(likeliest, &solved);
            let evidence = self.evidence(&solved, &scales, false);
            let Some(evidence_now) = evidence else { break };
            let Some(rear_share) = evidence_now.rear_share(&self.candidates.layout, &scales) else { break };
            let mut furthest = 0.0_f64;
            for (at, to) in candidate.rear_share.iter_mut().zip(rear_share) {
                let step = (to - *at).clamp(-MAX_REAR_STEP, MAX_REAR_STEP);
                furthest = furthest.max(step.abs());
                *at += step;
            }
            if furthest < SMALL_REAR_STEP {
                break;
            }
            candidate = self.candidates.clamped(candidate);
            match self.solve(candidate, Fineness::Fine) {
                Some(there) => solved = there,
                None => break,
            }
        }
        Some(solved)
    }

    /// Sizes at a candidate: those of the tip load are shares of the load that the paths require there.
    pub(super) fn scales(&self, x: &[f64], solved: &Solved) -> Scales {
        let load_n = solved.load_n[0].hypot(solved.load_n[1]);
        Scales::from_logarithms(
            x,
            Known {
                noise: self.noise,
                rear_share: self.candidates.rear().map_or(0.0, |rear| rear.sd),
                load_n,
            },
        )
    }

    pub(super) fn evidence(&self, solved: &Solved, scales: &Scales, searching: bool) -> Option<Evidence> {
        Evidence::new(&self.candidates.layout, &solved.recordings(), scales, searching)
    }

    pub(super) fn ln_posterior(&self, solved: &Solved, x: &[f64]) -> f64 {
        self.evidence(solved, &self.scales(x, solved), false)
            .map_or(f64::NEG_INFINITY, |found| solved.ln_prior + found.ln)
    }

    /// Tops of the posterior, the highest first.
    pub(super) fn tops(&self, start: &Start) -> Vec<Top> {
        let mut tops: Vec<Top> = Vec::new();
        for candidate in start.candidates.iter().copied().take(MAX_TOPS) {
            // The scales that suit the first top suit the others well enough to compare them.
            let start_point = tops.first().map_or(&start.likeliest, |top| &top.likeliest);
            let Some(top) = self.climb(candidate, start_point, tops.is_empty()) else { continue };
            if !tops.iter().any(|known| {
                let [a, b] = [known, &top].map(|top| top.solved.candidate);
                let distances = [a.modulus_ln - b.modulus_ln, a.gap_ln - b.gap_ln];
                (0..2).all(|i| distances[i].abs() < 3.0 * known.covariance[i][i].sqrt() + 1e-6)
            }) {
                tops.push(top);
            }
        }
        tops.sort_by(|a, b| b.ln.total_cmp(&a.ln));
        let most = tops.first().map_or(0.0, |top| top.ln);
        tops.retain(|top| top.ln > most - MIN_LN_TOP);
        tops
    }

    /// Candidates of a coarse grid that no neighbour beats, the best first.
    pub(super) fn scan(&self, likeliest: &[f64]) -> Vec<Candidate> {
        let [modulus, gap] = self.candidates.prior_sds().map(|sd| (2.5 * sd / SCAN_LN).ceil() as i32);
        let mut scanned: HashMap<[i32; 2], f64> = HashMap::new();
        for k in -modulus..=modulus {
            for g in -gap..=gap {
                let scan_ln = |i: i32| SCAN_LN * f64::from(i);
                let candidate = self.candidates.clamped(Candidate {
                    modulus_ln: scan_ln(k),
                    gap_ln: scan_ln(g),
                    ..Candidate::default()
                });
                if let Some(solved) = self.solve(candidate, Fineness::Coarse) {
                    scanned.insert([k, g], self.ln_posterior(&solved, likeliest));
                }
            }
        }
        let mut tops: Vec<_> =
            scanned.iter().filter(|(at, ln)| ln.is_finite() && is_top(**at, **ln, &scanned)).collect();
        tops.sort_by(|a, b| b.1.total_cmp(a.1).then(a.0.cmp(b.0)));
        let candidate = |[k, g]: &[i32; 2]| {
            let scan_ln = |i: &i32| SCAN_LN * f64::from(*i);
            self.candidates.clamped(Candidate {
                modulus_ln: scan_ln(k),
                gap_ln: scan_ln(g),
                ..Candidate::default()
            })
        };
        tops.into_iter().map(|(at, _)| candidate(at)).collect()
    }

    /// Climbs from a candidate, in modulus and gap and, where requested, in the scales.
    pub(super) fn climb(&self, candidate: Candidate, likeliest: &[f64], scales_too: bool) -> Option<Top> {
        let mut likeliest = likeliest.to_vec();
        let mut solved = self.solve_about_rear(candidate, &likeliest)?;
        let mut covariance = [[0.0; 2]; 2];
        let rounds = if scales_too { MAX_ROUNDS } else { 1 };
        for _ in 0..rounds {
            let start_candidate = solved.candidate;
            (solved, covariance) = self.climb_candidate(solved, &likeliest)?;
            let moved = [
                solved.candidate.modulus_ln - start_candidate.modulus_ln,
                solved.candidate.gap_ln - start_candidate.gap_ln,
            ];
            if scales_too {
                let previous = likeliest.clone();
                likeliest = search::likeliest(&self.cost(&solved), &likeliest, &self.active());
                let change = likeliest.iter().zip(&previous).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
                if change < 0.2 && (0..2).all(|i| moved[i].abs() < 0.3 * covariance[i][i].sqrt() + 1e-6) {
                    break;
                }
            }
        }
        let ln = self.ln_posterior(&solved, &likeliest);
        ln.is_finite().then(|| Top { solved: Arc::new(solved), likeliest, ln, covariance })
    }

    /// Gauss and Newton for modulus and gap: the best candidate and the covariance there.
    pub(super) fn climb_candidate(
        &self,
        mut solved: Solved,
        likeliest: &[f64],
    ) -> Option<(Solved, [[f64; 2]; 2])> {
        let sds = self.candidates.prior_sds();
        let mut ln = self.ln_posterior(&solved, likeliest);
        for _ in 0..MAX_STEPS {
            let (pull, information) = self.step(&solved, likeliest)?;
            let position = [solved.candidate.modulus_ln, solved.candidate.gap_ln];
            let (step, covariance) = newton(pull, information, position, sds);
            let mut step_fraction = 1.0;
            let mut better = None;
            while better.is_none()
                && step_fraction > 0.5f64.powi(MAX_HALVINGS as i32)
                && (is_large_step(0, step, covariance) || is_large_step(1, step, covariance))
            {
                let clamped = self.candidates.clamped(Candidate {
                    modulus_ln: position[0] + step_fraction * step[0],
                    gap_ln: position[1] + step_fraction * step[1],
                    rear_share: solved.candidate.rear_share,
                });
                let moved = self
                    .solve_about_rear(clamped, likeliest)
                    .map(|moved| (self.ln_posterior(&moved, likeliest), moved));
                better = moved.filter(|(moved, _)| *moved > ln);
                step_fraction *= 0.5;
            }
            match better {
                Some((higher, moved)) => (ln, solved) = (higher, moved),
                None => return Some((solved, covariance)),
            }
        }
        let (pull, information) = self.step(&solved, likeliest)?;
        let covariance = newton(pull, information, [0.0; 2], sds).1;
        Some((solved, covariance))
    }

    /// Step to the maximum of the evidence about a candidate.
    pub(super) fn step(&self, solved: &Solved, likeliest: &[f64]) -> Option<([f64; 2], [[f64; 2]; 2])> {
        let scales = self.scales(likeliest, solved);
        Some(self.evidence(solved, &scales, true)?.step(&self.candidates.layout, &scales))
    }

    /// Scales that the recordings can determine.
    pub(super) fn active(&self) -> Vec<usize> {
        let moving = self.training.iter().any(|path| self.paths[*path].bins.iter().any(|bin| bin.moving));
        (0..COUNT)
            .filter(|scale| match scale {
                &MOVING => moving,
                scale => self.candidates.layout.direction || !DIRECTION.contains(scale),
            })
            .collect()
    }

    /// Minus the log posterior of the scales at a candidate.
    pub(super) fn cost<'s>(&'s self, solved: &'s Solved) -> impl Fn(&[f64]) -> f64 + 's {
        move |x: &[f64]| {
            let prior = 0.5 * x.iter().map(|x| x * x).sum::<f64>();
            let cost = prior - self.ln_posterior(solved, x);
            if cost.is_finite() { cost } else { f64::MAX }
        }
    }
}

/// Whether a step is not small beside the standard deviation.
fn is_large_step(i: usize, step: [f64; 2], covariance: [[f64; 2]; 2]) -> bool {
    step[i].abs() > SMALL_STEP * covariance[i][i].sqrt()
}

/// A candidate is a top of the scan where no neighbour is likelier.
fn is_top([k, g]: [i32; 2], ln: f64, scanned: &HashMap<[i32; 2], f64>) -> bool {
    let neighbours = (-1..=1).flat_map(|i| (-1..=1).map(move |j| [k + i, g + j]));
    neighbours.filter_map(|at| scanned.get(&at)).all(|other| *other <= ln)
}

/// Step and covariance of a quadratic top with a normal prior; no step where the prior leaves no freedom.
fn newton(
    pull: [f64; 2],
    mut information: [[f64; 2]; 2],
    at: [f64; 2],
    sds: [f64; 2],
) -> ([f64; 2], [[f64; 2]; 2]) {
    let mut right = pull;
    for i in 0..2 {
        if sds[i] > 0.0 {
            let precision = sds[i].powi(-2);
            right[i] -= precision * at[i];
            // The path may not make it less certain than the prior.
            information[i][i] = information[i][i].max(0.0) + precision;
        }
    }
    let free: Vec<usize> = (0..2).filter(|i| sds[*i] > 0.0).collect();
    let mut covariance = [[0.0; 2]; 2];
    match free.as_slice() {
        [0, 1] => {
            let [[a, b], [_, d]] = information;
            let determinant = (a * d - b * b).max(1e-9 * a * d);
            covariance = [[d / determinant, -b / determinant], [-b / determinant, a / determinant]];
        }
        [i] => covariance[*i][*i] = 1.0 / information[*i][*i],
        _ => {}
    }
    let step = [0, 1].map(|i| covariance[i][0] * right[0] + covariance[i][1] * right[1]);
    (step, covariance)
}
