//! Sessions in subjects: how often the intervals of the mean, of the spread of subjects and sessions, of the intraclass correlation and of a
//! new subject hold the truth, over designs.
//!
//! Values of sessions are drawn with stated errors from half to one and a half of a size; some are far off, which is not stated.

use population::{Observations, RandomEffects, random_effects};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use worlds::random::normal;

/// A design, and the truth.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Design {
    /// Subjects.
    pub subjects: usize,
    /// Sessions of each, or on average where they differ.
    pub sessions: usize,
    /// Whether every subject has as many.
    pub is_balanced: bool,
    /// Standard deviation of ln K between subjects.
    pub subject_sd: f64,
    /// Between sessions of a subject.
    pub session_sd: f64,
    /// Stated errors are from half to one and a half of this.
    pub error_sd: f64,
    /// Share of sessions that are off by twelve standard deviations of a session.
    pub far: f64,
}

/// The designs of the table.
pub const DESIGNS: [Design; 16] = {
    const fn design(subjects: usize, sessions: usize, is_balanced: bool, sds: [f64; 3], far: f64) -> Design {
        let [subject_sd, session_sd, error_sd] = sds;
        Design { subjects, sessions, is_balanced, subject_sd, session_sd, error_sd, far }
    }
    const USUAL: [f64; 3] = [0.15, 0.05, 0.04];
    [
        design(3, 1, true, [0.15, 0.0, 0.04], 0.0),
        design(10, 1, true, [0.15, 0.0, 0.04], 0.0),
        design(60, 1, true, [0.15, 0.0, 0.04], 0.0),
        design(3, 20, true, USUAL, 0.0),
        design(4, 2, false, USUAL, 0.0),
        design(6, 10, true, USUAL, 0.0),
        design(6, 10, false, USUAL, 0.0),
        design(20, 3, false, [0.1, 0.05, 0.06], 0.0),
        design(30, 4, false, [0.03, 0.05, 0.04], 0.0),
        design(60, 20, false, USUAL, 0.0),
        design(10, 1, true, [0.15, 0.0, 0.04], 1.0 / 30.0),
        design(20, 3, false, [0.1, 0.05, 0.06], 1.0 / 30.0),
        design(3, 20, false, USUAL, 1.0 / 30.0),
        design(6, 10, true, USUAL, 1.0 / 30.0),
        design(30, 4, false, USUAL, 1.0 / 30.0),
        design(60, 20, false, USUAL, 1.0 / 30.0),
    ]
};
/// True mean of ln K.
const MEAN: f64 = 2.5;

impl Design {
    fn sessions_of(&self, subject: usize) -> usize {
        if self.is_balanced { self.sessions } else { 1 + (7 * subject + 3) % (2 * self.sessions) }
    }

    fn draw(&self, random: &mut ChaCha8Rng) -> Observations {
        let mut data = Observations { levels: vec![Vec::new()], ..Observations::default() };
        for subject in 0..self.subjects {
            let shared = MEAN + self.subject_sd * normal(random);
            for session in 0..self.sessions_of(subject) {
                let sd = self.error_sd * (0.5 + ((5 * session + 3 * subject) % 7) as f64 / 6.0);
                let mut value = shared + self.session_sd * normal(random) + sd * normal(random);
                if random.random::<f64>() < self.far {
                    value += 12.0 * self.session_sd.hypot(self.error_sd) * normal(random).signum();
                }
                data.y.push(value);
                data.v.push(sd * sd);
                data.levels[0].push(subject);
            }
        }
        data
    }
}

/// Shares of populations whose intervals hold the truth, and what goes with them. `None` where nothing is stated.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Outcome {
    /// Mean, spread of subjects, spread of sessions, intraclass correlation, a new subject.
    pub covered: [Option<f64>; 5],
    /// Median of the mean's degrees of freedom.
    pub freedom: f64,
    /// Populations with a session that is listed as far from the others.
    pub with_listed: f64,
}

/// Draws and analyses populations.
pub fn study(design: &Design, repeats: usize, seed: u64) -> Outcome {
    let outcomes: Vec<_> = (0..repeats)
        .into_par_iter()
        .filter_map(|number| {
            let mut random =
                ChaCha8Rng::seed_from_u64(seed.wrapping_mul(1_000_003).wrapping_add(number as u64));
            let data = design.draw(&mut random);
            let next = MEAN + design.subject_sd * normal(&mut random);
            random_effects(&data)
                .map(|found| (of_one(design, &found, next), found.degrees_of_freedom, found.listed() > 0))
        })
        .collect();
    let coverage_of = |outcome_of: &dyn Fn(usize) -> Option<bool>| {
        let stated: Vec<bool> = (0..outcomes.len()).filter_map(outcome_of).collect();
        (!stated.is_empty()).then(|| stated.iter().filter(|held| **held).count() as f64 / stated.len() as f64)
    };
    let mut freedom: Vec<f64> = outcomes.iter().map(|(_, freedom, _)| *freedom).collect();
    freedom.sort_by(f64::total_cmp);
    Outcome {
        covered: std::array::from_fn(|what| coverage_of(&|number| outcomes[number].0[what])),
        freedom: freedom.get(freedom.len() / 2).copied().unwrap_or(f64::NAN),
        with_listed: coverage_of(&|number| Some(outcomes[number].2)).unwrap_or(0.0),
    }
}

fn of_one(design: &Design, found: &RandomEffects, next: f64) -> [Option<bool>; 5] {
    let (subjects, sessions) = (found.levels.first(), found.levels.last());
    let variance = design.subject_sd.powi(2);
    let icc = variance / (variance + design.session_sd.powi(2) + found.typical_variance);
    [
        is_inside(Some(found.mean.ci95), MEAN),
        is_inside(subjects.and_then(|level| level.ci95), design.subject_sd),
        is_inside(sessions.and_then(|level| level.ci95), design.session_sd),
        is_inside(subjects.and_then(|level| level.icc).map(|(_, ends)| ends), icc),
        is_inside(found.new_subject95, next),
    ]
}

fn is_inside(ends: Option<[f64; 2]>, value: f64) -> Option<bool> {
    ends.map(|[low, high]| (low..=high).contains(&value))
}
