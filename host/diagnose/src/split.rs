//! Division into training and held-out data.
//!
//! Held-out data are in [`HeldOut`], whose only use is to make a [`Judge`], which compares models on them. No other code has access,
//! so that no fit, noise estimate or threshold of the search depends on them.

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

/// Runs, or parts of runs, to which models are fitted.
#[derive(Debug)]
pub(super) struct Training {
    pub runs: Vec<Run>,
    /// Text of the rule of the division.
    pub rule: String,
}

/// Runs, or parts of runs, that no fit of the search uses.
#[derive(Debug)]
pub(super) struct HeldOut {
    runs: Vec<Run>,
}

/// Without repeats one in this number of parts, or of insertions, is held out.
const EVERY: usize = 4;
/// Depths and speeds closer than this are repeats of each other.
const SAME_DEPTH_M: f64 = 0.5e-3;
const SAME_SPEED_M_PER_S: f64 = 0.2e-3;
/// A held-out misfit exceeds chance if it is more than this number of standard deviations above its expectation for noise.
const CHANCE: f64 = 4.0;
/// Draws of the bootstrap over held-out parts.
const DRAWS: usize = 1000;

/// Divides the runs of a session. The last run of every group of repeats is held out. Without repeats one in four insertions is held out, if
/// there are at least four; otherwise every run of the kind is divided by holds or by intervals of depth. Lateral runs along each axis are a
/// kind of their own, because an effect in one plane can be confirmed only by held-out data of that plane.
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
    // Insertions follow the lateral runs; runs of a kind keep their order, which is that of time.
    let [training, held_out] = [training, held_out].map(|mut runs| {
        runs.sort_by_key(|(number, run)| (run.kind == Kind::Insertion, *number));
        runs.into_iter().map(|(_, run)| run).collect()
    });
    (Training { runs: training, rule: rules.join("; ") }, HeldOut { runs: held_out })
}

/// Divided runs with their numbers in the session, and the rules of the division.
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
            // Insertions are so similar that whole ones can be held out.
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
        let [part_kind, parts_kind] = match kind {
            Kind::Lateral => ["hold", "holds"],
            Kind::Insertion => ["interval of depth", "intervals of depth"],
        };
        let held_before = self.held_out.len();
        for (place, (number, run)) in runs.iter().enumerate() {
            // The index of the run shifts the pattern, so that not the same level is held out in every run.
            let held_run = run.with_parts(|part| (part + place) % EVERY == EVERY / 2);
            // The held-out parts are excluded from training even if they contain no shape.
            self.training.push((*number, run.with_parts(|part| (part + place) % EVERY != EVERY / 2)));
            if !held_run.data.is_empty() {
                self.held_out.push((*number, held_run));
            }
        }
        self.rules.push(if self.held_out.len() > held_before {
            format!("{name} have no repeats: one {part_kind} in {EVERY} is held out")
        } else {
            format!("{name} have no repeats, and too few {parts_kind} for one in {EVERY} to be held out")
        });
    }
}

/// Numbers of the held-out insertions, one in [`EVERY`]. If at least two speeds occur more than once, runs next to the fastest and next to
/// the slowest are chosen in turn: a model without an effect of the speed predicts the mean of the others, so that a run of mean speed
/// could neither confirm nor refute such an effect. (By hand all speeds differ, and every fourth run is held out.) The fast runs are chosen
/// among those in which the needle was turned, if possible, and the slow ones among the others: without a turn a rolled bevel, which turns
/// with the needle, and a tilted tracker, which does not, have the same effect.
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
        let Some((_, run_of_speed)) = candidate.and_then(|candidate| by_speed.get(candidate)) else {
            continue;
        };
        let mut candidates = by_speed.iter().filter(|(number, run)| {
            speed_number(run) == speed_number(run_of_speed) && !taken_indices.contains(number)
        });
        let chosen =
            candidates.clone().find(|(_, run)| (run.turned() > 0.0) == is_fast).or_else(|| candidates.next());
        taken_indices.extend(chosen.map(|(number, _)| *number));
    }
    taken_indices
}

/// Speed in units of [`SAME_SPEED_M_PER_S`], rounded: speeds with the same number count as the same.
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

    /// Judge of models on the held-out data. `start` was fitted to the training runs; `multiples` are those of the discrepancy.
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

/// Judges models by the held-out data.
///
/// The reported misfit has zeros, drift, axes and differences between runs as nuisances, because a zero would otherwise dominate all sums. A
/// model is refuted by its predictive density of the held-out data given the training runs, whose residuals inform about imperfections that
/// all runs share (theory, below eq. 65).
#[derive(Debug)]
pub(super) struct Judge {
    runs: Vec<Prepared>,
    /// Patterns of the instruments and of differences between runs, in the held-out data.
    patterns: Patterns,
    /// Inverse of the covariance of these patterns and the noise.
    instruments: Inverse,
    /// All patterns, in the training runs followed by the held-out ones.
    imperfections: Patterns,
    of_training: Patterns,
    /// Names of the groups whose sizes a fit has.
    fitted_groups: Vec<&'static str>,
}

/// Losses of a model in every part of the held-out data.
#[derive(Debug, Clone)]
pub(super) struct Losses {
    /// For each part, minus twice the log predictive density given the training runs, with noise and discrepancy of the fitted
    /// sizes.
    pub of_density: Vec<f64>,
    /// For each part, the misfit with the instruments' errors and differences between runs as the only nuisances.
    pub beside_instruments: Vec<f64>,
}

impl Judge {
    /// Number of runs with held-out parts.
    pub fn runs(&self) -> usize {
        self.runs.len()
    }

    /// Misfit of a fit on the held-out data of runs of these kinds, in the metric of noise, instrument errors and differences between
    /// runs; `None` without such data. No pattern acts on runs of both kinds, so that the residuals of the others are set to zero.
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

    /// The same for runs of these kinds alone. An effect that acts only in insertions also changes the common modulus by a fraction of its
    /// interval, which changes the misfit of lateral runs by chance; and these have far more readings.
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

    /// Sizes of a fit for the groups of all imperfections; a group that the training runs do not show has its everyday size.
    fn sizes_of(&self, fitted: &Fitted) -> Vec<f64> {
        let mut sizes = self.imperfections.everyday();
        let mut fitted_sizes: Vec<(&str, f64)> =
            self.fitted_groups.iter().copied().zip(fitted.sizes.iter().copied()).collect();
        for (size, group) in sizes.iter_mut().zip(&self.imperfections.groups) {
            // With a reference, two groups can have the same name; they are in the same order in both lists.
            if let Some(index) = fitted_sizes.iter().position(|(name, _)| *name == group.name) {
                *size = fitted_sizes.remove(index).1;
            }
        }
        sizes
    }

    /// Predictive density of every held-out part given the training runs and the parts before it, with discrepancy of these sizes.
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
    /// Misfit of the held-out runs under a model, with the patterns of `self.patterns` as nuisances.
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

/// Fraction of the removable misfit in a list of parts, which may repeat, that the second model removes; `None` if the misfit under the first
/// does not exceed chance.
fn removed([before, after]: &[Tally; 2], parts: impl IntoIterator<Item = usize>) -> Option<f64> {
    let (mut b, mut a, mut n) = (0.0, 0.0, 0.0);
    for part in parts {
        b += before.parts[part].0;
        a += after.parts[part].0;
        n += before.parts[part].1 as f64;
    }
    // Only a misfit above chance can be removed.
    (b > by_chance(n)).then(|| ((b - a) / (b - n)).min(1.0))
}

/// Misfit of `count` readings that chance does not exceed.
fn by_chance(count: f64) -> f64 {
    count + CHANCE * (2.0 * count).sqrt()
}

/// Residuals under both models with their abscissae.
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
    /// Squares in the metric of noise and nuisances, and number of readings, part by part.
    parts: Vec<(f64, usize)>,
    /// Sum of the squares of `plain`, and number of readings, of every channel.
    channels: Vec<(Channel, f64, usize)>,
    /// Residuals of all runs less the estimated nuisances, SI.
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
