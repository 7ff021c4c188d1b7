//! Division into training and held-out data.
//!
//! Held-out data are in [`HeldOut`], which has one use: the comparison of two models on them. No other code has access, so that
//! no fit, noise estimate, threshold or selection depends on it.

use super::Multiples;
use super::data::{Channel, Kind, Run, Source};
use super::discrepancy;
use super::evidence::{Ahead, FurtherRun, Inverse, Patterns};
use super::layout::Prepared;
use super::noise::Noise;
use super::posterior::{self, Fitted};
use super::predicted::differences;
use super::results::{HeldOutMisfit, Misfit, ResidualPoint};
use super::start::Start;
use mechanics::effects::RunKinds;
use mechanics::{ModelError, predict};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::collections::BTreeMap;

/// Runs, or parts of runs, to learn from.
#[derive(Debug)]
pub(super) struct Training {
    pub runs: Vec<Run>,
    /// Division of the session, for people.
    pub rule: String,
}

/// Runs that no fit uses.
#[derive(Debug)]
pub(super) struct HeldOut {
    runs: Vec<Run>,
}

/// One part in so many is held out where there are no repeats.
const EVERY: usize = 4;
/// Depths and speeds closer than this are repeats of each other.
const SAME_DEPTH_M: f64 = 0.5e-3;
const SAME_SPEED_M_PER_S: f64 = 0.2e-3;
/// A misfit of what was held out is more than chance where it is so many standard deviations above that of noise.
const CHANCE: f64 = 4.0;
/// Draws of the bootstrap over held-out parts.
const DRAWS: usize = 1000;

/// Divides the runs of a session: of every group of repeats the last one is held out; a kind of run without repeats is divided by
/// holds, or by intervals of depth. Lateral runs along each axis are a kind of their own: what acts in one plane alone can be confirmed only
/// by what was held out in that plane.
pub(super) fn split(runs: Vec<Run>) -> (Training, HeldOut) {
    let numbered: Vec<(usize, Run)> = runs.into_iter().enumerate().collect();
    let (lateral, insertions): (Vec<&(usize, Run)>, Vec<_>) =
        numbered.iter().partition(|(_, run)| run.kind == Kind::Lateral);
    let (along_y, along_x): (Vec<&(usize, Run)>, Vec<_>) =
        lateral.into_iter().partition(|(_, run)| run.axis == 0);
    let [name_y, name_x] = if along_y.is_empty() || along_x.is_empty() {
        ["lateral runs"; 2]
    } else {
        ["lateral runs along y", "lateral runs along x"]
    };
    let mut divided = Divided::default();
    divided.add(&along_y, Kind::Lateral, name_y);
    divided.add(&along_x, Kind::Lateral, name_x);
    divided.add(&insertions, Kind::Insertion, "insertions");
    let Divided { training, held_out, rules } = divided;
    // Insertions after all lateral runs; those of a kind in their order, which is that of time.
    let [training, held_out] = [training, held_out].map(|mut runs| {
        runs.sort_by_key(|(number, run)| (run.kind == Kind::Insertion, *number));
        runs.into_iter().map(|(_, run)| run).collect()
    });
    (Training { runs: training, rule: rules.join("; ") }, HeldOut { runs: held_out })
}

/// Runs as they are divided, with their numbers in the session, and how.
#[derive(Default)]
struct Divided {
    training: Vec<(usize, Run)>,
    held_out: Vec<(usize, Run)>,
    rules: Vec<String>,
}

impl Divided {
    /// Divides runs that are of one kind.
    fn add(&mut self, runs: &[&(usize, Run)], kind: Kind, name: &str) {
        if runs.is_empty() {
            return;
        }
        let mut whole = last_of_repeats(runs);
        let mut rule = ("of repeated", "the last");
        if whole.is_empty() && kind == Kind::Insertion && runs.len() >= EVERY {
            // Insertions are alike enough that whole ones can be spared.
            whole = one_in_four(runs);
            rule = ("of the", "one in four");
        }
        if whole.is_empty() {
            self.add_parts(runs, kind, name);
            return;
        }
        let (held_out, training): (Vec<&(usize, Run)>, Vec<_>) =
            runs.iter().copied().partition(|(number, _)| whole.contains(number));
        let ids: Vec<&str> = held_out.iter().map(|(_, run)| run.id.as_str()).collect();
        let (division, count) = rule;
        self.rules.push(format!("{division} {name} {count} is held out: {}", ids.join(", ")));
        self.held_out.extend(held_out.into_iter().cloned());
        self.training.extend(training.into_iter().cloned());
    }

    /// Divides every run of one kind.
    fn add_parts(&mut self, runs: &[&(usize, Run)], kind: Kind, name: &str) {
        let part_kind = match kind {
            Kind::Lateral => "hold",
            Kind::Insertion => "interval of depth",
        };
        for (place, (number, run)) in runs.iter().enumerate() {
            // Not the same level in every run.
            let held_run = run.with_parts(|part| (part + place) % EVERY == EVERY / 2);
            // A part without shape determines little of what the rest of the run does; but it is never learned from.
            self.training.push((*number, run.with_parts(|part| (part + place) % EVERY != EVERY / 2)));
            if !held_run.data.is_empty() {
                self.held_out.push((*number, held_run));
            }
        }
        self.rules.push(format!("{name} have no repeats: one {part_kind} in {EVERY} is held out"));
    }
}

/// Numbers of one run in [`EVERY`]. If speeds were varied, each taken more than once, they are those next to the
/// fastest and to the slowest: a model without an effect of the speed predicts the mean of the others, so that a run of
/// mean speed can neither confirm nor refute such an effect. Speeds of a hand are all different. The needle was turned
/// in the first of the runs at one speed, and in every other: what turns with it (a rolled bevel) and what stays with
/// the room (a tilted tracker) do the same where it was not.
fn one_in_four(runs: &[&(usize, Run)]) -> Vec<usize> {
    let mut by_speed = runs.to_vec();
    by_speed.sort_by_key(|(_, run)| speed_number(run));
    let same_speed = by_speed.chunk_by(|(_, a), (_, b)| speed_number(a) == speed_number(b));
    let regular = runs.iter().skip(EVERY / 2).step_by(EVERY);
    if same_speed.filter(|runs| runs.len() > 1).count() < 2 {
        return regular.map(|(number, _)| *number).collect();
    }
    let mut taken_indices: Vec<usize> = Vec::new();
    for place in 0..regular.count() {
        let inward = 1 + EVERY * (place / 2);
        let is_fast = place.is_multiple_of(2);
        let candidate = if is_fast { by_speed.len().checked_sub(1 + inward) } else { Some(inward) };
        let Some((_, candidate_index)) = candidate.and_then(|candidate| by_speed.get(candidate)) else {
            continue;
        };
        let mut candidates = by_speed.iter().filter(|(number, run)| {
            speed_number(run) == speed_number(candidate_index) && !taken_indices.contains(number)
        });
        let chosen =
            candidates.clone().find(|(_, run)| (run.turned() > 0.0) == is_fast).or_else(|| candidates.next());
        taken_indices.extend(chosen.map(|(number, _)| *number));
    }
    taken_indices
}

/// Speeds with the same number are the same.
fn speed_number(run: &Run) -> i64 {
    (run.speed_m_per_s / SAME_SPEED_M_PER_S).round() as i64
}

/// Numbers of the last runs of all groups of repeats.
fn last_of_repeats(runs: &[&(usize, Run)]) -> Vec<usize> {
    let mut groups: BTreeMap<(i64, i64, bool), Vec<usize>> = BTreeMap::new();
    for (number, run) in runs {
        let depth = (run.depth_m / SAME_DEPTH_M).round() as i64;
        groups.entry((depth, speed_number(run), run.turned() > 0.0)).or_default().push(*number);
    }
    groups.values().filter(|group| group.len() > 1).filter_map(|group| group.last().copied()).collect()
}

impl HeldOut {
    /// Names of the runs with held-out parts.
    pub fn ids(&self) -> Vec<String> {
        self.runs.iter().map(|run| run.id.clone()).collect()
    }

    /// Judge of models that are compared with a start, which was fitted to the training runs; `multiples` are those of the
    /// discrepancy.
    ///
    /// # Errors
    /// Where the model cannot be evaluated.
    pub fn judge(self, start: &Start, noise: &Noise, multiples: &Multiples) -> Result<Judge, ModelError> {
        let Start { runs: training, patterns: of_fits, fitted: start } = start;
        let runs: Vec<Prepared> = self
            .runs
            .into_iter()
            .map(|run| {
                let model = start.layout.model_of(start.values(), run.kind, run.is_reference)?;
                Ok(Prepared { whitener: super::whiten::Whitener::new(&run, noise, &model)?, run })
            })
            .collect::<Result<_, ModelError>>()?;
        let patterns = discrepancy::of_held_out(&start.layout, start.values(), &runs, multiples)?;
        let instruments = patterns.inverse(&patterns.everyday()).ok_or(ModelError::Singular)?;
        let all = [training.as_slice(), &runs].concat();
        let imperfections = discrepancy::patterns(&start.layout, start.values(), &all, multiples)?;
        let of_training = imperfections.of_first(training.len());
        let fitted_groups = of_fits.groups.iter().map(|group| group.name).collect();
        Ok(Judge { runs, patterns, instruments, imperfections, of_training, fitted_groups })
    }
}

/// Judges models by what was held out.
///
/// The misfit that is stated is that of the physics: zeros, drift, axes and offsets of single runs are the instruments' own, and beside the
/// noise of a mean a zero would rule all sums. What refutes a model is that it predicts worse: the density that it gives what was held out *after*
/// the training runs, whose misfit tells of imperfections that all runs share (theory, below eq. 65).
#[derive(Debug)]
pub(super) struct Judge {
    runs: Vec<Prepared>,
    /// Patterns of the instruments, in what was held out.
    patterns: Patterns,
    /// The inverse of their covariance with the noise.
    instruments: Inverse,
    /// All patterns, in the training runs and in what was held out behind them.
    imperfections: Patterns,
    of_training: Patterns,
    /// Names of the groups whose sizes a fit has.
    fitted_groups: Vec<&'static str>,
}

/// Losses of a model in every part of what was held out.
#[derive(Debug, Clone)]
pub(super) struct Losses {
    /// For each part, minus twice the log predictive density given the training runs, with noise and discrepancy of the fitted
    /// sizes.
    pub of_density: Vec<f64>,
    /// For each part, the misfit with instrument errors alone, so that only the model itself explains the data.
    pub beside_instruments: Vec<f64>,
}

impl Judge {
    /// Number of runs with held-out parts.
    pub fn runs(&self) -> usize {
        self.runs.len()
    }

    /// Misfit of the held-out data in runs of these kinds under the physics of a fit, with noise and instrument errors; `None`
    /// without held-out data. No pattern acts on runs of both kinds.
    pub fn held_out_misfit_in(&self, fitted: &Fitted, kinds: RunKinds) -> Option<f64> {
        let counted: Vec<bool> = self
            .runs
            .iter()
            .map(|run| if run.run.kind == Kind::Lateral { kinds.lateral } else { kinds.insertion })
            .collect();
        if !counted.contains(&true) {
            return None;
        }
        let mut residuals = posterior::residuals(&fitted.layout, &self.runs, fitted.values()).ok()?;
        let other_residuals = residuals.iter_mut().zip(&counted).filter(|(_, is_counted)| !**is_counted);
        other_residuals.for_each(|(residuals, _)| residuals.fill(0.0));
        posterior::misfit(&self.patterns, &self.patterns.everyday(), &residuals)
    }

    /// Whether the misfit of the held-out data is smaller under the second model; false without held-out data.
    pub fn held_out_shrinks(&self, before: &Fitted, after: &Fitted) -> bool {
        self.held_out_shrinks_in(before, after, RunKinds::BOTH)
    }

    /// The same for runs of these kinds alone. An effect that acts only in insertions changes the common modulus by a fraction
    /// of its interval. In lateral runs, which have far more readings, that changes the misfit by chance.
    pub fn held_out_shrinks_in(&self, before: &Fitted, after: &Fitted, kinds: RunKinds) -> bool {
        let misfits = self.held_out_misfit_in(before, kinds).zip(self.held_out_misfit_in(after, kinds));
        misfits.is_some_and(|(before, after)| after < before)
    }

    /// Losses of a model on the held-out data; `None` if the model cannot be evaluated.
    pub fn losses(&self, fitted: &Fitted) -> Option<Losses> {
        let parts = self.after_training(fitted, &self.sizes_of(fitted))?;
        let beside_instruments = self.tally(fitted).ok()?.parts;
        Some(Losses {
            of_density: parts.into_iter().map(|part| part.square + part.ln_determinant).collect(),
            beside_instruments: beside_instruments.into_iter().map(|(loss, _)| loss).collect(),
        })
    }

    /// Whether the held-out misfit under a model, with the imperfections of an ordinary rig, is consistent with chance; true
    /// without held-out data.
    pub fn is_chance(&self, fitted: &Fitted) -> bool {
        let Some(parts) = self.after_training(fitted, &self.imperfections.everyday()) else { return false };
        let misfit_sum: f64 = parts.iter().map(|part| part.square).sum();
        let count: usize = parts.iter().map(|part| part.readings).sum();
        misfit_sum <= by_chance(count as f64)
    }

    /// Sizes of a fit, for the groups of all imperfections; a group that the training runs alone do not show has its everyday one.
    fn sizes_of(&self, fitted: &Fitted) -> Vec<f64> {
        let mut sizes = self.imperfections.everyday();
        let mut fitted_sizes: Vec<(&str, f64)> =
            self.fitted_groups.iter().copied().zip(fitted.sizes.iter().copied()).collect();
        for (size, group) in sizes.iter_mut().zip(&self.imperfections.groups) {
            // Beside a reference two groups have one name, in the same order.
            if let Some(index) = fitted_sizes.iter().position(|(name, _)| *name == group.name) {
                *size = fitted_sizes.remove(index).1;
            }
        }
        sizes
    }

    /// Every part of what was held out after the training runs and the parts before it, with discrepancy of these sizes.
    fn after_training(&self, fitted: &Fitted, sizes: &[f64]) -> Option<Vec<Ahead>> {
        let shared = self
            .of_training
            .shared_after(sizes, &fitted.with_spread(&fitted.residuals, &fitted.jacobian)?)?;
        let residuals = posterior::residuals(&fitted.layout, &self.runs, fitted.values()).ok()?;
        let jacobian = fitted.jacobian_of(&self.runs, &residuals).ok()?;
        let columns = fitted.with_spread(&residuals, &jacobian)?;
        let further = self.runs.iter().zip(columns).zip(fitted.residuals.len()..);
        let further_runs = further.map(|((prepared, columns), run)| FurtherRun {
            run,
            columns,
            parts: prepared.run.readings_of_parts(),
        });
        self.imperfections.ahead(sizes, &shared, &further_runs.collect::<Vec<_>>())
    }

    /// Misfits of two models on the held-out data, and the fraction of the removable misfit that the second one removes. `None`
    /// without held-out data.
    ///
    /// # Errors
    /// Where a model cannot be evaluated.
    pub fn gap(
        &self,
        before: &Fitted,
        after: &Fitted,
        seed: u64,
    ) -> Result<Option<HeldOutMisfit>, ModelError> {
        if self.runs.is_empty() {
            return Ok(None);
        }
        let sides = [self.tally(before)?, self.tally(after)?];
        let points = points(&self.runs, &sides);
        let count = sides[0].parts.len();
        let removed_fraction = removed(&sides, 0..count);
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let mut draws: Vec<f64> = (0..DRAWS)
            .filter_map(|_| {
                let drawn: Vec<usize> = (0..count).map(|_| random.random_range(0..count)).collect();
                removed(&sides, drawn)
            })
            .collect();
        draws.sort_by(f64::total_cmp);
        let [low, high] =
            [0.025, 0.975].map(|p| draws.get(((draws.len() as f64 - 1.0) * p).round() as usize).copied());
        let interval = removed_fraction.and(low.zip(high)).map(|(low, high)| [low, high]);
        let [misfit_before, misfit_after] = sides;
        Ok(Some(HeldOutMisfit {
            heldout_runs: self.runs.iter().map(|run| run.run.id.clone()).collect(),
            before: misfit_before.side(),
            after: misfit_after.side(),
            removed: removed_fraction,
            removed_ci95: interval,
            points,
        }))
    }
}

impl Judge {
    /// Misfit of the held-out runs under a model, without the instruments' part.
    fn tally(&self, fitted: &Fitted) -> Result<Tally, ModelError> {
        let mut plain = Vec::with_capacity(self.runs.len());
        let mut white = Vec::with_capacity(self.runs.len());
        for prepared in &self.runs {
            let run = &prepared.run;
            let model = fitted.layout.model_of(fitted.values(), run.kind, run.is_reference)?;
            let residuals = differences(run, &predict(&model, &run.experiment)?);
            let mut independent = residuals.clone();
            prepared.whitener.apply(&mut independent);
            plain.push(residuals);
            white.push(independent);
        }
        let whitened = self.instruments.of_column(&white);
        let mut tally = Tally::default();
        for ((prepared, white), whitened) in self.runs.iter().zip(&white).zip(whitened) {
            let mut plain = whitened.data.as_vec().clone();
            prepared.whitener.undo(&mut plain);
            let squares = white.iter().zip(whitened.iter()).map(|(white, whitened)| white * whitened);
            tally.add(prepared, plain, squares);
        }
        Ok(tally)
    }
}

/// Fraction of the removable misfit in some parts, each as often as it is named, that the second side removes.
fn removed([before, after]: &[Tally; 2], parts: impl IntoIterator<Item = usize>) -> Option<f64> {
    let (mut b, mut a, mut n) = (0.0, 0.0, 0.0);
    for part in parts {
        b += before.parts[part].0;
        a += after.parts[part].0;
        n += before.parts[part].1 as f64;
    }
    // Only a gap that is more than chance can be removed.
    (b > by_chance(n)).then(|| ((b - a) / (b - n)).min(1.0))
}

/// Misfit of so many readings that chance does not exceed.
fn by_chance(count: f64) -> f64 {
    count + CHANCE * (2.0 * count).sqrt()
}

/// Residuals under both models with their places.
fn points(runs: &[Prepared], sides: &[Tally; 2]) -> Vec<ResidualPoint> {
    let data = runs.iter().flat_map(|run| &run.run.data);
    let point_pairs = sides[0].plain.iter().zip(&sides[1].plain);
    data.zip(point_pairs)
        .map(|(datum, (before, after))| {
            let unit = datum.channel.per_si();
            let is_force = matches!(datum.source, Source::Force(_));
            let coordinate_m = if is_force { datum.place.level_m } else { datum.place.depth_m };
            ResidualPoint {
                channel: datum.channel,
                at_mm: 1e3 * coordinate_m,
                before: unit * before,
                after: unit * after,
            }
        })
        .collect()
}

/// Squares of one model's residuals.
#[derive(Default)]
struct Tally {
    /// Squares in the metric of noise and instruments and number, part by part.
    parts: Vec<(f64, usize)>,
    /// Plain squares and number of every channel.
    channels: Vec<(Channel, f64, usize)>,
    /// Residuals of all runs less what the instruments' patterns have of them, SI.
    plain: Vec<f64>,
}

impl Tally {
    fn add(&mut self, prepared: &Prepared, plain: Vec<f64>, squares: impl Iterator<Item = f64>) {
        let run = &prepared.run;
        let mut part_sums = vec![(0.0, 0); run.parts()];
        for ((datum, plain), square) in run.data.iter().zip(&plain).zip(squares) {
            part_sums[datum.part].0 += square;
            part_sums[datum.part].1 += 1;
            let known_channel = self.channels.iter().position(|(channel, ..)| *channel == datum.channel);
            let channel_index = known_channel.unwrap_or_else(|| {
                self.channels.push((datum.channel, 0.0, 0));
                self.channels.len() - 1
            });
            self.channels[channel_index].1 += plain * plain;
            self.channels[channel_index].2 += 1;
        }
        self.plain.extend(plain);
        self.parts.extend(part_sums.into_iter().filter(|(_, count)| *count > 0));
    }

    fn side(&self) -> Misfit {
        let (sum, count) =
            self.parts.iter().fold((0.0, 0), |(s, n), (square, count)| (s + square, n + count));
        let rmse = self.channels.iter().map(|(channel, square, count)| {
            let name = format!("{}_{}", channel.name(), channel.unit().to_lowercase());
            (name, channel.per_si() * (square / *count as f64).sqrt())
        });
        Misfit { chi2_reduced: sum / count as f64, rmse: rmse.collect() }
    }
}

#[cfg(test)]
#[path = "split_tests.rs"]
mod tests;
