//! Learning from earlier insertions of the same rig and tissue: empirical Bayes.
//!
//! How large the unknowns' parts are ([`Scales`]) and which modulus and gap are how likely follows from the evidence of the earlier
//! insertions. The evidence has one top, or several: each is climbed (Gauss and Newton for modulus and gap, a quasi-Newton method for the
//! scales), and around each a grid in the principal axes of its curvature covers whatever weighs anything. Draws of scales and grid
//! points, weighted by their posterior, then stand for it: what is predicted integrates over all of it.

use super::basis::Basis;
use super::belief::Normal;
use super::candidates::{Candidate, Candidates, Fineness, Responses};
use super::evidence::{Evidence, System};
use super::path::TipPath;
use super::place::Place;
use super::scales::{COUNT, DIRECTION, Known, MOVING, ReadingNoise, Scales};
use super::search;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use std::collections::HashMap;
use std::sync::Arc;

/// What earlier insertions say about the next.
#[derive(Debug, Clone)]
pub struct Learned {
    /// Possible sizes of the unknowns.
    pub scales: Vec<Scales>,
    /// Possible combinations of candidate and sizes.
    pub(super) parts: Vec<Part>,
    /// The candidates of the parts, with the responses of the next insertion.
    pub(super) nodes: Vec<Node>,
}

impl Learned {
    /// How many combinations there are, and how many different candidates are among them: what a prediction costs.
    pub fn counts(&self) -> [usize; 2] {
        [self.parts.len(), self.nodes.len()]
    }
}

/// A candidate with the responses of the next insertion.
#[derive(Debug, Clone)]
pub(super) struct Node {
    pub candidate: Candidate,
    pub gap_m: f64,
    pub basis: Arc<Basis>,
}

/// One candidate with one set of sizes, and what then is known of the next insertion.
#[derive(Debug, Clone)]
pub(super) struct Part {
    /// Number among the nodes.
    pub node: usize,
    /// Number among the scales.
    pub scales: usize,
    /// Logarithm of its weight, up to a constant.
    pub ln_weight: f64,
    /// Per vector of unknowns of an insertion.
    pub normals: Vec<Normal>,
}

/// Where the search for a posterior begins, found once for all folds of a session.
#[derive(Debug, Clone)]
pub struct Start {
    candidates: Vec<Candidate>,
    likeliest: Vec<f64>,
}

/// Learns from the recordings `earlier` (numbers among `paths`).
///
/// Where there are none, the sizes of the unknowns are searched near those that suit what is known of the insertion itself,
/// `next`; nothing else is taken from it. `paths` are those the candidates were made for, each as far as it may be used.
pub fn learn(
    candidates: &Candidates,
    paths: &[TipPath],
    earlier: &[usize],
    next: usize,
    noise: ReadingNoise,
) -> Learned {
    learn_from(candidates, paths, earlier, next, noise, None)
}

/// The same, with the search beginning where [`start`] ended for recordings of the same session.
pub fn learn_from(
    candidates: &Candidates,
    paths: &[TipPath],
    earlier: &[usize],
    next: usize,
    noise: ReadingNoise,
    start: Option<&Start>,
) -> Learned {
    let alone = earlier.is_empty();
    let training: &[usize] = if alone { &[next] } else { earlier };
    let (fold, start) = Fold::new(candidates, paths, training, noise, start);
    let tops = fold.tops(&start);
    let Some(best) = tops.first() else {
        return Learned { scales: Vec::new(), parts: Vec::new(), nodes: Vec::new() };
    };
    let grid = fold.grid(&tops);
    if grid.is_empty() {
        return Learned { scales: Vec::new(), parts: Vec::new(), nodes: Vec::new() };
    }
    let mut learned = Learned { scales: Vec::new(), parts: Vec::new(), nodes: Vec::new() };
    let shares = cumulative_shares(&grid);
    let mut number_of: HashMap<usize, usize> = HashMap::new();
    for (number, (draw, ln_drawn)) in fold.draws(best).into_iter().enumerate() {
        let ln_scales = -0.5 * draw.iter().map(|x| x * x).sum::<f64>();
        // Candidates in proportion to their share, evenly among the draws: multiples of the golden ratio.
        let place = (number as f64 * GOLDEN_RATIO).fract();
        let drawn = shares.partition_point(|(end, _)| *end <= place).min(shares.len() - 1);
        let GridPoint { solved, ln_area, .. } = &grid[drawn];
        let scales = fold.scales(&draw, solved);
        let used: Vec<&[System]> =
            if alone { Vec::new() } else { solved.systems.iter().map(Vec::as_slice).collect() };
        let Some(evidence) = Evidence::new(&candidates.layout, &used, &scales, false) else { continue };
        let ln_weight = solved.ln_prior + ln_area + ln_scales + evidence.ln - ln_drawn - shares[drawn].1;
        let node = *number_of.entry(drawn).or_insert_with(|| {
            learned.nodes.push(solved.node(candidates, next));
            learned.nodes.len() - 1
        });
        let normals = evidence.next(&candidates.layout, &scales);
        learned.parts.push(Part { node, scales: learned.scales.len(), ln_weight, normals });
        learned.scales.push(scales);
    }
    // What a part weighs before the insertion begins says little where it was drawn to suit the insertion itself.
    if !alone {
        let most = learned.parts.iter().map(|part| part.ln_weight).fold(f64::NEG_INFINITY, f64::max);
        learned.parts.retain(|part| part.ln_weight > most - LEAST_LN_WEIGHT);
    }
    learned
}

/// Where the search begins for every fold of a session: from what is known of all its recordings up to the depth from which they are
/// predicted, so that nothing beyond it plays a part.
pub fn start(candidates: &Candidates, seen: &[TipPath], noise: ReadingNoise) -> Option<Start> {
    let training: Vec<usize> = (0..seen.len()).collect();
    let (fold, start) = Fold::new(candidates, seen, &training, noise, None);
    let tops = fold.tops(&start);
    let likeliest = tops.first()?.likeliest.clone();
    let candidates = tops.iter().map(|top| top.solved.candidate).collect();
    Some(Start { candidates, likeliest })
}

/// Parts further behind than this (natural logarithm) before an insertion begins are given up.
const LEAST_LN_WEIGHT: f64 = 7.0;
/// Grid points further behind the best one than this are not used, and so many standard deviations apart are two of them.
const LEAST_LN_POINT: f64 = 7.0;
const GRID_SDS: f64 = 1.25;
const MOST_POINTS: usize = 160;
/// Tops further behind the best one than this are given up.
const LEAST_LN_TOP: f64 = 7.0;
/// Spacing of the first scan, of the logarithms, and tops that are climbed from it.
const SCAN_LN: f64 = 0.5;
const MOST_TOPS: usize = 3;
/// Steps of a climb, and how often a step that leads down is halved.
const MOST_STEPS: usize = 8;
const MOST_HALVINGS: usize = 4;
/// A rear is solved anew where the mean of its share is further away than this.
const SMALL_REAR_STEP: f64 = 0.05;
/// Steps of it, and how far one goes at most.
const MOST_REAR_STEPS: usize = 3;
const MOST_REAR_STEP: f64 = 0.3;
/// Steps below this part of a standard deviation end a climb.
const SMALL_STEP: f64 = 0.1;
/// Rounds of climbs, of candidate and scales in turn.
const MOST_ROUNDS: usize = 3;
/// Draws of scales and candidate, in pairs on both sides of the likeliest scales; their spread against the posterior's.
const PAIRS: usize = 40;
const SPREAD: f64 = 1.1;
/// Grid points are drawn with this power of their weight: scales that differ from the likeliest make the posterior wider.
const FLATTENED: f64 = 0.6;
/// The draws are always the same.
const SEED: u64 = 20;
const GOLDEN_RATIO: f64 = 0.618_033_988_749_894_8;

/// The recordings that are learned from.
struct Fold<'a> {
    candidates: &'a Candidates,
    paths: &'a [TipPath],
    training: &'a [usize],
    /// Where the bins of these recordings lie.
    places: Vec<Vec<Place>>,
    noise: ReadingNoise,
}

/// A candidate with what every recording's values say of it.
struct Solved {
    candidate: Candidate,
    ln_prior: f64,
    responses: Responses,
    /// Mean of the loads that suit the recordings, per plane, N.
    load_n: [f64; 2],
    systems: Vec<Vec<System>>,
}

impl Solved {
    fn recordings(&self) -> Vec<&[System]> {
        self.systems.iter().map(Vec::as_slice).collect()
    }

    fn node(&self, candidates: &Candidates, next: usize) -> Node {
        let basis = Basis::new(candidates, &self.responses, self.candidate, next, self.load_n);
        Node { candidate: self.candidate, gap_m: candidates.gap_m(self.candidate), basis: Arc::new(basis) }
    }
}

/// A top of the posterior.
struct Top {
    solved: Arc<Solved>,
    likeliest: Vec<f64>,
    ln: f64,
    /// Covariance of the logarithms of modulus and gap.
    covariance: [[f64; 2]; 2],
}

/// A point of a grid about a top.
struct GridPoint {
    solved: Arc<Solved>,
    ln: f64,
    /// Logarithm of the area that it stands for.
    ln_area: f64,
}

impl<'a> Fold<'a> {
    /// With where its search begins: as given, or from a scan.
    fn new(
        candidates: &'a Candidates,
        paths: &'a [TipPath],
        training: &'a [usize],
        noise: ReadingNoise,
        start: Option<&Start>,
    ) -> (Self, Start) {
        let places = training.iter().map(|path| candidates.places(*path, &paths[*path])).collect();
        let fold = Self { candidates, paths, training, places, noise };
        let start = start.cloned().unwrap_or_else(|| {
            let likeliest = vec![0.0; COUNT];
            Start { candidates: fold.scan(&likeliest), likeliest }
        });
        (fold, start)
    }

    /// Every recording at a candidate; nothing out of range or where the model has no answer.
    fn solve(&self, candidate: Candidate, fineness: Fineness) -> Option<Solved> {
        let ln_prior = self.candidates.ln_prior(candidate)?;
        let responses = self.candidates.responses(candidate, fineness).ok()?;
        let gap_m = self.candidates.gap_m(candidate);
        let mut load_n = [0.0; 2];
        let systems = self.training.iter().zip(&self.places).map(|(path, places)| {
            let mut basis = Basis::without_own(self.candidates, &responses, candidate, *path);
            let own_n = basis.fitted_load_n(&self.paths[*path], places);
            load_n.iter_mut().zip(own_n).for_each(|(sum, own_n)| *sum += own_n / self.training.len() as f64);
            basis.set_load(gap_m, own_n);
            System::of(&basis, &self.paths[*path], places, &self.candidates.layout)
        });
        let systems = systems.collect();
        Some(Solved { candidate, ln_prior, responses, load_n, systems })
    }

    /// The same with a rear that is not known solved where its posterior has its mean.
    fn solve_about_rear(&self, mut candidate: Candidate, likeliest: &[f64]) -> Option<Solved> {
        let mut solved = self.solve(candidate, Fineness::Fine)?;
        for _ in 0..MOST_REAR_STEPS {
            let scales = self.scales(likeliest, &solved);
            let found = self.evidence(&solved, &scales, false);
            let Some(found) = found else { break };
            let Some(rear_share) = found.rear_share(&self.candidates.layout, &scales) else { break };
            let mut furthest = 0.0_f64;
            for (at, to) in candidate.rear_share.iter_mut().zip(rear_share) {
                let step = (to - *at).clamp(-MOST_REAR_STEP, MOST_REAR_STEP);
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

    /// Sizes at a candidate: those of the tip load are shares of the load that the paths ask for there.
    fn scales(&self, x: &[f64], solved: &Solved) -> Scales {
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

    fn evidence(&self, solved: &Solved, scales: &Scales, searching: bool) -> Option<Evidence> {
        Evidence::new(&self.candidates.layout, &solved.recordings(), scales, searching)
    }

    fn ln_posterior(&self, solved: &Solved, x: &[f64]) -> f64 {
        self.evidence(solved, &self.scales(x, solved), false)
            .map_or(f64::NEG_INFINITY, |found| solved.ln_prior + found.ln)
    }

    /// Tops of the posterior, the highest first.
    fn tops(&self, start: &Start) -> Vec<Top> {
        let mut tops: Vec<Top> = Vec::new();
        for candidate in start.candidates.iter().copied().take(MOST_TOPS) {
            // The scales that suit the first top suit the others well enough to compare them.
            let from = tops.first().map_or(&start.likeliest, |top| &top.likeliest);
            let Some(top) = self.climb(candidate, from, tops.is_empty()) else { continue };
            let is_known = |known: &Top| {
                let [a, b] = [known, &top].map(|top| top.solved.candidate);
                let apart = [a.modulus_ln - b.modulus_ln, a.gap_ln - b.gap_ln];
                (0..2).all(|i| apart[i].abs() < 3.0 * known.covariance[i][i].sqrt() + 1e-6)
            };
            if !tops.iter().any(is_known) {
                tops.push(top);
            }
        }
        tops.sort_by(|a, b| b.ln.total_cmp(&a.ln));
        let most = tops.first().map_or(0.0, |top| top.ln);
        tops.retain(|top| top.ln > most - LEAST_LN_TOP);
        tops
    }

    /// Candidates of a coarse grid that no neighbour beats, the best first.
    fn scan(&self, likeliest: &[f64]) -> Vec<Candidate> {
        let [modulus, gap] = self.candidates.prior_sds().map(|sd| (2.5 * sd / SCAN_LN).ceil() as i32);
        let mut found: HashMap<[i32; 2], f64> = HashMap::new();
        for k in -modulus..=modulus {
            for g in -gap..=gap {
                let at = |i: i32| SCAN_LN * f64::from(i);
                let candidate = self.candidates.clamped(Candidate {
                    modulus_ln: at(k),
                    gap_ln: at(g),
                    ..Candidate::default()
                });
                if let Some(solved) = self.solve(candidate, Fineness::Coarse) {
                    found.insert([k, g], self.ln_posterior(&solved, likeliest));
                }
            }
        }
        let is_top = |[k, g]: [i32; 2], ln: f64| {
            let around = (-1..=1).flat_map(|i| (-1..=1).map(move |j| [k + i, g + j]));
            around.filter_map(|at| found.get(&at)).all(|other| *other <= ln)
        };
        let mut tops: Vec<_> = found.iter().filter(|(at, ln)| ln.is_finite() && is_top(**at, **ln)).collect();
        tops.sort_by(|a, b| b.1.total_cmp(a.1).then(a.0.cmp(b.0)));
        let candidate = |[k, g]: &[i32; 2]| {
            let at = |i: &i32| SCAN_LN * f64::from(*i);
            self.candidates.clamped(Candidate { modulus_ln: at(k), gap_ln: at(g), ..Candidate::default() })
        };
        tops.into_iter().map(|(at, _)| candidate(at)).collect()
    }

    /// Climbs from a candidate, in modulus and gap and, where asked, in the scales.
    fn climb(&self, candidate: Candidate, likeliest: &[f64], scales_too: bool) -> Option<Top> {
        let mut likeliest = likeliest.to_vec();
        let mut solved = self.solve_about_rear(candidate, &likeliest)?;
        let mut covariance = [[0.0; 2]; 2];
        let rounds = if scales_too { MOST_ROUNDS } else { 1 };
        for _ in 0..rounds {
            let from = solved.candidate;
            (solved, covariance) = self.climb_candidate(solved, &likeliest)?;
            let moved =
                [solved.candidate.modulus_ln - from.modulus_ln, solved.candidate.gap_ln - from.gap_ln];
            if scales_too {
                let before = likeliest.clone();
                likeliest = search::likeliest(&self.cost(&solved), &likeliest, &self.active());
                let change = likeliest.iter().zip(&before).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
                if change < 0.2 && (0..2).all(|i| moved[i].abs() < 0.3 * covariance[i][i].sqrt() + 1e-6) {
                    break;
                }
            }
        }
        let ln = self.ln_posterior(&solved, &likeliest);
        ln.is_finite().then(|| Top { solved: Arc::new(solved), likeliest, ln, covariance })
    }

    /// Gauss and Newton for modulus and gap: the best candidate and the covariance there.
    fn climb_candidate(&self, mut solved: Solved, likeliest: &[f64]) -> Option<(Solved, [[f64; 2]; 2])> {
        let sds = self.candidates.prior_sds();
        let mut ln = self.ln_posterior(&solved, likeliest);
        for _ in 0..MOST_STEPS {
            let (pull, information) = self.step(&solved, likeliest)?;
            let at = [solved.candidate.modulus_ln, solved.candidate.gap_ln];
            let (step, covariance) = newton(pull, information, at, sds);
            let scaled = |i: usize| step[i].abs() > SMALL_STEP * covariance[i][i].sqrt();
            let mut share = 1.0;
            let mut better = None;
            while better.is_none() && share > 0.5f64.powi(MOST_HALVINGS as i32) && (scaled(0) || scaled(1)) {
                let to = self.candidates.clamped(Candidate {
                    modulus_ln: at[0] + share * step[0],
                    gap_ln: at[1] + share * step[1],
                    rear_share: solved.candidate.rear_share,
                });
                let moved = self
                    .solve_about_rear(to, likeliest)
                    .map(|moved| (self.ln_posterior(&moved, likeliest), moved));
                better = moved.filter(|(moved, _)| *moved > ln);
                share *= 0.5;
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

    /// Where the evidence about a candidate has its top.
    fn step(&self, solved: &Solved, likeliest: &[f64]) -> Option<([f64; 2], [[f64; 2]; 2])> {
        let scales = self.scales(likeliest, solved);
        Some(self.evidence(solved, &scales, true)?.step(&self.candidates.layout, &scales))
    }

    /// Which scales the recordings can say anything of.
    fn active(&self) -> Vec<usize> {
        let moving = self.training.iter().any(|path| self.paths[*path].bins.iter().any(|bin| bin.moving));
        let says = |scale: &usize| match scale {
            &MOVING => moving,
            scale => self.candidates.layout.direction || !DIRECTION.contains(scale),
        };
        (0..COUNT).filter(says).collect()
    }

    /// Minus the log posterior of the scales at a candidate.
    fn cost<'s>(&'s self, solved: &'s Solved) -> impl Fn(&[f64]) -> f64 + 's {
        move |x: &[f64]| {
            let prior = 0.5 * x.iter().map(|x| x * x).sum::<f64>();
            let cost = prior - self.ln_posterior(solved, x);
            if cost.is_finite() { cost } else { f64::MAX }
        }
    }

    /// Points about the tops, in the principal axes of each, as far as any of them weighs anything.
    fn grid(&self, tops: &[Top]) -> Vec<GridPoint> {
        let mut grid: Vec<GridPoint> = Vec::new();
        let mut most = f64::NEG_INFINITY;
        for top in tops {
            let [[a, b], [_, d]] = top.covariance;
            // Lower triangular root of the covariance.
            let first = a.max(0.0).sqrt();
            let across = if first > 0.0 { b / first } else { 0.0 };
            let second = (d - across * across).max(0.0).sqrt();
            let middle = top.solved.candidate;
            let ln_area = [first, second].iter().filter(|sd| **sd > 0.0).map(|sd| (GRID_SDS * sd).ln()).sum();
            let mut open = vec![([0_i32; 2], middle.rear_share)];
            let mut known: Vec<[i32; 2]> = vec![[0; 2]];
            while let Some((at, rear_share)) = open.pop() {
                let [i, j] = at.map(|i| GRID_SDS * f64::from(i));
                let candidate = Candidate {
                    modulus_ln: middle.modulus_ln + first * i,
                    gap_ln: middle.gap_ln + across * i + second * j,
                    rear_share,
                };
                let Some(solved) = self.solve_about_rear(candidate, &top.likeliest) else { continue };
                let ln = self.ln_posterior(&solved, &top.likeliest);
                if ln < most - LEAST_LN_POINT || !ln.is_finite() {
                    continue;
                }
                most = most.max(ln);
                let rear_share = solved.candidate.rear_share;
                grid.push(GridPoint { solved: Arc::new(solved), ln, ln_area });
                for (di, dj) in [(1, 0), (-1, 0), (0, 1), (0, -1)] {
                    let next = [at[0] + di, at[1] + dj];
                    let is_flat = (di != 0 && first == 0.0) || (dj != 0 && second == 0.0);
                    if !is_flat && !known.contains(&next) && known.len() < MOST_POINTS {
                        known.push(next);
                        // The nearest first, so that whatever is left out is far.
                        open.insert(0, (next, rear_share));
                    }
                }
            }
        }
        grid.retain(|point| point.ln > most - LEAST_LN_POINT);
        grid
    }

    /// Draws about the likeliest scales from a normal distribution a little wider than the posterior along each scale, with the
    /// logarithm of its density: points of an integration over the scales by importance sampling.
    fn draws(&self, top: &Top) -> Vec<(Vec<f64>, f64)> {
        let active = self.active();
        let sds = search::widths(&self.cost(&top.solved), &top.likeliest, &active);
        let mut rng = ChaCha8Rng::seed_from_u64(SEED);
        let mut draws = Vec::with_capacity(2 * PAIRS);
        for _ in 0..PAIRS {
            let mut z: Vec<f64> = sds.iter().map(|_| StandardNormal.sample(&mut rng)).collect();
            // What the recordings say nothing of stays where it is.
            z.iter_mut().enumerate().filter(|(i, _)| !active.contains(i)).for_each(|(_, z)| *z = 0.0);
            let ln = -0.5 * z.iter().map(|z: &f64| z * z).sum::<f64>();
            for sign in [-1.0, 1.0] {
                let moved = top.likeliest.iter().zip(&sds).zip(&z);
                draws.push((moved.map(|((x, sd), z)| x + sign * SPREAD * sd * z).collect(), ln));
            }
        }
        draws
    }
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
            // What the path says may not make it less certain than the prior.
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

/// For each point, the sum of the flattened shares up to and including it, and the logarithm of its own.
fn cumulative_shares(grid: &[GridPoint]) -> Vec<(f64, f64)> {
    let flattened = |point: &GridPoint| FLATTENED * (point.ln + point.ln_area);
    let most = grid.iter().map(flattened).fold(f64::NEG_INFINITY, f64::max);
    let total: f64 = grid.iter().map(|point| (flattened(point) - most).exp()).sum();
    let mut end = 0.0;
    let share = |point: &GridPoint| {
        let ln = flattened(point) - most - total.ln();
        end += ln.exp();
        (end, ln)
    };
    grid.iter().map(share).collect()
}
