//! Discrepancy between real rigs and tissues and any model: its basis functions (patterns) and their typical sizes.
//!
//! A pattern is the change of the predicted data per unit of a small imperfection. The amplitudes of a [`Group`] share one standard
//! deviation, its size, which maximizes the evidence separately for every hypothesis ([`Patterns`]): the plain model needs a
//! large discrepancy, the right effect a small one. Patterns are computed once per session, around the fit of the plain model,
//! and once more around the final model, for its intervals.
//!
//! | patterns of | file |
//! |---|---|
//! | lateral runs | `discrepancy/lateral` |
//! | insertions | `discrepancy/insertion` |

mod insertion;
mod lateral;

use super::Multiples;
use super::data::{Datum, Kind, Run};
use super::evidence::{Group, Patterns, RunPatterns};
use super::layout::{Layout, Prepared};
use mechanics::unknowns::{Family, SMALLER_SIZE_SD_LN, Unknown};
use mechanics::{Cache, Experiment, Model, ModelError, predict_with};
use nalgebra::DMatrix;

/// Scope of a group of patterns.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Scope {
    /// All runs share the amplitudes of its patterns.
    Shared,
    /// Every run has amplitudes of its own.
    Own,
}

/// Cause of a group's imperfections.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Cause {
    /// Imperfections of tissue, needle and sensors like those of the effects in the catalogue.
    Physics,
    /// Mounting of needle and tissue in a session.
    Mounting,
    /// Differences between runs, which no model predicts for a new run.
    Run,
    /// Errors of the instruments alone: zeros, drift, axes, angles, offsets of a run.
    Instrument {
        /// Whether that changes when needle or tissue are remounted.
        mounted: bool,
    },
}

impl Cause {
    const INSTRUMENT: Self = Self::Instrument { mounted: false };

    /// Whether it is new whenever needle or tissue are remounted.
    fn is_mounted(self) -> bool {
        matches!(self, Self::Mounting | Self::Instrument { mounted: true })
    }
}

/// Group of an entry of the table of unknowns. If the entry is a size, the size of the group is estimated; otherwise it is known.
pub(super) fn group_of(unknown: &Unknown) -> Group {
    let tail = (unknown.prior.family == Family::Size).then_some(unknown.sd());
    let (name, everyday) = (unknown.name, unknown.typical_sd());
    Group { name, everyday, tail, smaller_sd_ln: SMALLER_SIZE_SD_LN, multiple: 1.0 }
}

/// A group with its patterns, in SI and in the order of the data of each run; empty for a run that it does not affect.
struct GroupPatterns {
    group: Group,
    scope: Scope,
    /// Values of each pattern in each run: run, pattern, datum.
    of_runs: Vec<Vec<Vec<f64>>>,
    cause: Cause,
}

/// Patterns of one run.
type Made = Result<Vec<Vec<f64>>, ModelError>;

/// Groups of patterns for one kind of run; runs of the other kind have no patterns of these groups.
struct Groups<'a> {
    runs: &'a [Around<'a>],
    kind: Kind,
    list: Vec<GroupPatterns>,
}

impl<'a> Groups<'a> {
    fn new(runs: &'a [Around<'a>], kind: Kind) -> Self {
        Self { runs, kind, list: Vec::new() }
    }

    /// The runs that have the patterns.
    fn around(&self) -> impl Iterator<Item = &'a Around<'a>> + use<'a> {
        let kind = self.kind;
        self.runs.iter().filter(move |around| around.run.kind == kind)
    }

    /// Adds a group from the patterns of each run.
    fn add(
        &mut self,
        unknown: &Unknown,
        scope: Scope,
        cause: Cause,
        mut made: impl FnMut(&Around<'_>) -> Made,
    ) -> Result<(), ModelError> {
        let mut of_runs = Vec::with_capacity(self.runs.len());
        for around in self.runs {
            of_runs.push(if around.run.kind == self.kind { made(around)? } else { Vec::new() });
        }
        self.list.push(GroupPatterns { group: group_of(unknown), scope, of_runs, cause });
        Ok(())
    }

    /// The groups that affect any run.
    fn shown(self) -> Vec<GroupPatterns> {
        let mut list = self.list;
        list.retain(|group| group.of_runs.iter().flatten().any(|pattern| shows(pattern)));
        list
    }
}

/// Whether a pattern changes any datum.
fn shows(pattern: &[f64]) -> bool {
    pattern.iter().any(|value| *value != 0.0)
}

/// A run around which patterns are made.
struct Around<'a> {
    run: &'a Run,
    model: Model,
    /// Predictions of the plain model, in the order of the data.
    predicted: Vec<f64>,
    cache: &'a Cache,
}

impl Around<'_> {
    /// Derivative of the prediction, by a difference: `change` moves the model, or the experiment, by `step`.
    fn slope(
        &self,
        step: f64,
        change: impl FnOnce(&mut Model, &mut Experiment) -> Result<(), ModelError>,
    ) -> Result<Vec<f64>, ModelError> {
        let (mut model, mut experiment) = (self.model.clone(), self.run.experiment.clone());
        change(&mut model, &mut experiment)?;
        let moved = super::predicted::predicted(self.run, &predict_with(&model, &experiment, self.cache)?);
        Ok(moved.iter().zip(&self.predicted).map(|(to, from)| (to - from) / step).collect())
    }

    /// A value for each datum.
    fn each(&self, value: impl Fn(usize, &Datum) -> f64) -> Vec<f64> {
        self.run.data.iter().enumerate().map(|(i, datum)| value(i, datum)).collect()
    }
}

/// The patterns of all runs around a model, whitened as the runs are.
///
/// # Errors
/// Where the model cannot be evaluated.
pub(super) fn patterns(
    layout: &Layout,
    values: &[f64],
    runs: &[Prepared],
    multiples: &Multiples,
) -> Result<Patterns, ModelError> {
    let mut groups = sized(groups(layout, values, runs)?, multiples);
    if layout.reference.is_some() {
        groups.extend(remounted(&groups, runs));
    }
    Ok(whitened(groups, runs))
}

/// Multiplies the typical sizes of the groups that other sessions have shown to be larger than usual.
fn sized(mut groups: Vec<GroupPatterns>, multiples: &Multiples) -> Vec<GroupPatterns> {
    for GroupPatterns { group, .. } in groups.iter_mut().filter(|of| of.group.tail.is_some()) {
        group.multiple = multiples.get(group.name).copied().unwrap_or(1.0).max(1.0);
        group.everyday *= group.multiple;
    }
    groups
}

/// Groups for changes between the reference and the session by remounting: copies of the affected patterns that act in the session
/// alone.
fn remounted(groups: &[GroupPatterns], runs: &[Prepared]) -> Vec<GroupPatterns> {
    let mounted = groups.iter().filter(|group| group.cause.is_mounted());
    let remounted = mounted.map(|group| {
        let of_runs = group.of_runs.iter().zip(runs);
        let of_runs = of_runs.map(
            |(patterns, prepared)| {
                if prepared.run.is_reference { Vec::new() } else { patterns.clone() }
            },
        );
        let everyday = std::f64::consts::SQRT_2 * group.group.everyday;
        GroupPatterns {
            group: Group { everyday, ..group.group.clone() },
            of_runs: of_runs.collect(),
            ..*group
        }
    });
    remounted.collect()
}

/// Patterns of the instruments and of differences between runs, which are the nuisances in the misfit of held-out runs. `multiples` as for
/// [`patterns`].
///
/// # Errors
/// Where the model cannot be evaluated.
pub(super) fn of_held_out(
    layout: &Layout,
    values: &[f64],
    runs: &[Prepared],
    multiples: &Multiples,
) -> Result<Patterns, ModelError> {
    let mut groups = sized(groups(layout, values, runs)?, multiples);
    groups.retain(|group| matches!(group.cause, Cause::Instrument { .. } | Cause::Run));
    Ok(whitened(groups, runs))
}

fn groups(layout: &Layout, values: &[f64], runs: &[Prepared]) -> Result<Vec<GroupPatterns>, ModelError> {
    let mut around_runs = Vec::with_capacity(runs.len());
    for Prepared { run, .. } in runs {
        let model = layout.model_of(values, run.kind, run.is_reference)?;
        let predicted =
            super::predicted::predicted(run, &predict_with(&model, &run.experiment, &layout.cache)?);
        around_runs.push(Around { run, model, predicted, cache: &layout.cache });
    }
    let mut groups = Vec::new();
    if around_runs.iter().any(|around| around.run.kind == Kind::Lateral) {
        groups.extend(lateral::groups(&around_runs)?);
    }
    if around_runs.iter().any(|around| around.run.kind == Kind::Insertion) {
        groups.extend(insertion::groups(&around_runs)?);
    }
    Ok(groups)
}

/// Whitens the patterns and sorts them into shared ones and those of each run.
fn whitened(groups: Vec<GroupPatterns>, runs: &[Prepared]) -> Patterns {
    // Only patterns that affect some run are kept: others, such as those of a plane that was not measured, have no identifiable
    // amplitude.
    let groups_shown: Vec<Vec<usize>> = groups
        .iter()
        .map(|group| {
            let count = group.of_runs.iter().map(Vec::len).max().unwrap_or(0);
            (0..count)
                .filter(|j| {
                    group.of_runs.iter().filter_map(|patterns| patterns.get(*j)).any(|one| shows(one))
                })
                .collect()
        })
        .collect();
    let mut shared_groups = Vec::new();
    let shared = groups.iter().zip(&groups_shown).enumerate();
    for (number, (_, shown)) in shared.filter(|(_, (group, _))| group.scope == Scope::Shared) {
        shared_groups.extend(std::iter::repeat_n(number, shown.len()));
    }
    let of_runs = runs.iter().enumerate().map(|(index, prepared)| {
        let rows = prepared.run.data.len();
        let (mut own_groups, mut own_columns, mut shared) = (Vec::new(), Vec::new(), Vec::new());
        for (number, (group, shown)) in groups.iter().zip(&groups_shown).enumerate() {
            let patterns = group.of_runs.get(index).map(Vec::as_slice).unwrap_or_default();
            match group.scope {
                Scope::Own => {
                    own_columns.extend(patterns.iter().filter(|pattern| shows(pattern)).cloned());
                    own_groups.resize(own_columns.len(), number);
                }
                Scope::Shared => {
                    let patterns = shown.iter().map(|j| patterns.get(*j).cloned());
                    shared.extend(patterns.map(|pattern| pattern.unwrap_or_else(|| vec![0.0; rows])));
                }
            }
        }
        RunPatterns::new(own_groups, columns(prepared, own_columns), columns(prepared, shared))
    });
    let of_runs = of_runs.collect();
    Patterns::new(groups.into_iter().map(|group| group.group).collect(), shared_groups, of_runs)
}

/// Whitened patterns of a run as a matrix.
pub(super) fn columns(prepared: &Prepared, patterns: Vec<Vec<f64>>) -> DMatrix<f64> {
    let mut matrix = DMatrix::zeros(prepared.run.data.len(), patterns.len());
    for (mut column, mut pattern) in matrix.column_iter_mut().zip(patterns) {
        if shows(&pattern) {
            prepared.whitener.apply(&mut pattern);
            column.copy_from_slice(&pattern);
        }
    }
    matrix
}
