//! From a run's recording to data for the fit: levels, noise, checks.

mod balances;
mod deviations;

use super::belong::check_shape_sign;
use super::{HoldResult, NoiseResult, Options, RunError};
use balances::balances;
use deviations::Deviations;
use formats::session::{LateralRun, Session};
use mechanics::Support;
use mechanics::effects::{Effect, effect};
use mechanics::unknowns::sensors::{FORCE_ZERO, SHAPE_NOISE, UNTARED_FORCE_ZERO};
use modulus::energy::{Balance, MIN_POINTS};
use readings::holds::{BEYOND_TIP_M, Hold, HoldCriteria, Mean, Path, holds, reversal_m, summary, unused};
use readings::{DisplacementHistory, Fixed, ForceZero, LateralData, ShapeDatum, SharedErrors};
use std::ops::Range;

/// Rotation of the needle in an only guide.
const REAR_ROTATION: &str = "rig.rear_rotation";
/// Least time between rows of a run's course.
const COURSE_STEP_S: f64 = 0.05;

/// A run ready for every method.
pub(super) struct Prepared {
    pub data: LateralData,
    /// Displaced levels with shape, for the energy balance.
    pub balances: Vec<Balance>,
    pub holds: Vec<HoldResult>,
    pub noise: NoiseResult,
    /// Whether all standard deviations are stated.
    pub known_noise: bool,
    /// Whether that of the shape is.
    pub known_shape_noise: bool,
    pub warnings: Vec<String>,
}

pub(super) fn prepare(session: &Session, run: &LateralRun, options: &Options) -> Result<Prepared, RunError> {
    if run.is_in_air() {
        return Err(RunError::InAir);
    }
    let criteria = &options.criteria;
    let detected_holds = holds(run, criteria);
    let mut warnings: Vec<String> = summary(&unused(run, &session.rig, criteria));
    let used_holds: Vec<&Hold> = detected_holds.iter().filter(|level| level.lost_samples == 0).collect();
    let displaced: Vec<&Hold> = used_holds.iter().copied().filter(|level| level.path != Path::Zero).collect();
    check_levels(run, criteria, &detected_holds, &used_holds, &displaced)?;
    warnings.extend(spikes(&used_holds));

    let planes = planes(run, &used_holds, criteria, &mut warnings);
    let noise = Deviations::of(session, run, &used_holds);
    let shape_of = |level: &Hold| shape_points(session, run, level);
    let inside_count =
        displaced.iter().flat_map(|level| shape_of(level)).filter(|p| p.z_m >= session.rig.entry_m).count();
    if inside_count < MIN_POINTS {
        return Err(RunError::TooFewPoints { path: run.shape_path.clone(), found: inside_count });
    }

    let force_zero = force_zero(session, run, used_holds.len() > displaced.len(), &mut warnings);
    let stated_shape_m = run.shape.typical_sd_m().or(session.noise.shape_m);
    let shape_sd_m = stated_shape_m.unwrap_or(SHAPE_NOISE.mean());
    let data = LateralData {
        rig: session.rig.clone(),
        support: Support::Springs,
        depth_m: run.depth_m,
        planes,
        levels: used_holds.iter().map(|level| noise.level(level, planes, shape_of(level))).collect(),
        shape_sd_m,
        force_zero,
        shared: SharedErrors::default(),
        // A force determines the stiffness of needle and tissue together, and nothing where neither is known.
        uses_force: session.rig.needle.stiffness_known,
        effects: nuisances(session, options),
        fixed: (!options.fixed.is_empty()).then(|| Fixed {
            effects: options.fixed.clone(),
            course: course(session, run, &used_holds),
            first_plane: 0,
            order: session.order_of(&run.id),
        }),
    };
    let mut balances = balances(&used_holds, &noise, planes, shape_of);
    check_sign(run, &balances)?;
    check_shape_sign(run, &data)?;
    if !session.rig.needle.stiffness_known {
        balances.clear();
    }
    let holds = detected_holds.iter().map(|level| hold_result(level, &noise)).collect();
    let stated = session.noise;
    let stated_m = stated_displacement_m(session, run);
    Ok(Prepared {
        data,
        balances,
        holds,
        noise: NoiseResult {
            force_n: noise.force_n,
            force_source: source(stated.force_n),
            displacement_mm: 1e3 * noise.displacement_m,
            displacement_source: source(stated_m),
            shape_mm: 1e3 * shape_sd_m,
            shape_source: source(stated_shape_m),
        },
        known_shape_noise: stated_shape_m.is_some(),
        known_noise: stated.force_n.is_some() && stated_m.is_some() && stated_shape_m.is_some(),
        warnings,
    })
}

fn source(stated: Option<f64>) -> &'static str {
    if stated.is_some() { "stated" } else { "estimated" }
}

/// Stated standard deviation of a reading of the displacement: of the run's own rows, or of all runs.
fn stated_displacement_m(session: &Session, run: &LateralRun) -> Option<f64> {
    run.force.typical_displacement_sd_m().or(session.noise.displacement_m)
}

/// Knowledge of the force's zero: from a hold at zero displacement, or else assumed as well as the session states it,
/// with a warning.
fn force_zero(session: &Session, run: &LateralRun, measured: bool, warnings: &mut Vec<String>) -> ForceZero {
    if measured {
        return ForceZero::Measured;
    }
    let (sd_n, because) = match (session.noise.force_zero_n, run.provenance.tared) {
        (Some(sd_n), _) => (sd_n, "as `force_zero_n` states"),
        (None, Some(true)) => (FORCE_ZERO.typical_sd(), "the usual drift after a tare"),
        (None, Some(false)) => {
            (UNTARED_FORCE_ZERO.sd(), "as the force was not tared: record a hold at zero displacement")
        }
        (None, None) => (
            UNTARED_FORCE_ZERO.sd(),
            "as the session does not state `tared = true` of the run, or `force_zero_n` of the rig",
        ),
    };
    warnings.push(format!(
        "no hold at zero displacement: the force's zero is assumed, with a standard deviation of {sd_n} N, {because}"
    ));
    ForceZero::assumed(sd_n)
}

/// Requested nuisances, and the needle's rotation in an only guide if it is not known.
fn nuisances(session: &Session, options: &Options) -> Vec<&'static dyn Effect> {
    let mut effects = options.nuisances.clone();
    let unknown = session.rig.rear_is_unknown();
    let is_there = effects
        .iter()
        .chain(options.fixed.iter().map(|(effect, _)| effect))
        .any(|effect| effect.id() == REAR_ROTATION);
    if unknown && !is_there {
        effects.extend(effect(REAR_ROTATION));
    }
    effects
}

fn check_levels(
    run: &LateralRun,
    criteria: &HoldCriteria,
    found: &[Hold],
    used: &[&Hold],
    displaced: &[&Hold],
) -> Result<(), RunError> {
    let path = run.force_path.clone();
    if found.is_empty() {
        let times_s = &run.force.time_s;
        let duration_s = times_s.last().zip(times_s.first()).map_or(0.0, |(last, first)| last - first);
        Err(RunError::NoHold { path, duration_s, least_s: criteria.min_duration_s })
    } else if used.is_empty() {
        Err(RunError::AllLost { path, holds: found.len() })
    } else if displaced.is_empty() {
        let largest_mm = 1e3 * used.iter().map(|level| level.distance_m()).fold(0.0, f64::max);
        Err(RunError::NoDisplacement { path, largest_mm })
    } else {
        Ok(())
    }
}

/// Readings that are excluded from the holds' means.
fn spikes(used: &[&Hold]) -> Option<String> {
    let force = spike_count(&|level| [Some(level.force_y_n), level.force_x_n], used);
    let displacement = spike_count(&|level| [Some(level.displacement_y_m), level.displacement_x_m], used);
    let channels = [(force, "force"), (displacement, "displacement")];
    let counts: Vec<String> = channels
        .iter()
        .filter(|(count, _)| *count > 0)
        .map(|(count, channel)| format!("{count} in the {channel}"))
        .collect();
    (!counts.is_empty()).then(|| {
        format!(
            "spikes (single readings far from their neighbours) are excluded from the means of holds: {}",
            counts.join(", ")
        )
    })
}

fn spike_count(means: &dyn Fn(&Hold) -> [Option<Mean>; 2], used: &[&Hold]) -> usize {
    used.iter().flat_map(|level| means(level)).flatten().map(|mean| mean.spikes).sum()
}

/// The horizontal plane counts where it was moved in and its shape was measured.
fn planes(run: &LateralRun, used: &[&Hold], criteria: &HoldCriteria, warnings: &mut Vec<String>) -> usize {
    let moved = used.iter().any(|level| level.displacement_m()[1].abs() > criteria.zero_m);
    if moved && run.shape.x_m.is_none() {
        warnings.push(
            "guide 2 moved horizontally but the shape has no deflection_x_mm: vertical plane only".to_owned(),
        );
    }
    if moved && run.shape.x_m.is_some() { 2 } else { 1 }
}

/// Shape points of a level that lie on the needle.
fn shape_points(session: &Session, run: &LateralRun, level: &Hold) -> Vec<ShapeDatum> {
    level.shape.iter().filter_map(|index| shape_point(session, run, *index)).collect()
}

/// A shape point, where it lies on the needle.
fn shape_point(session: &Session, run: &LateralRun, index: usize) -> Option<ShapeDatum> {
    let tip_m = session.rig.entry_m + run.depth_m;
    let (z_m, y_m) = (value_at(&run.shape.z_m, index)?, value_at(&run.shape.y_m, index)?);
    let x_m = run.shape.x_m.as_deref().and_then(|values| value_at(values, index)).unwrap_or(0.0);
    let on_needle = (0.0..=tip_m + BEYOND_TIP_M).contains(&z_m);
    let typical_m = run.shape.typical_sd_m();
    let sd_ratio =
        [sd_ratio(&run.shape.y_sd_m, typical_m, index), sd_ratio(&run.shape.x_sd_m, typical_m, index)];
    on_needle.then_some(ShapeDatum {
        z_m: z_m.min(tip_m),
        deflection_m: [y_m, x_m],
        sd_ratio,
        image: run.shape.image(index),
        z_shared_sd_m: run.shape.shared_sd_m(index),
        shared_m: run.shape.shared_errors_m(index),
    })
}

fn sd_ratio(sd_m: &Option<Vec<f64>>, typical_m: Option<f64>, index: usize) -> f64 {
    let point_sd_m = sd_m.as_deref().and_then(|values| value_at(values, index));
    point_sd_m.zip(typical_m).map_or(1.0, |(point_sd_m, typical_m)| point_sd_m / typical_m)
}

fn value_at(values: &[f64], index: usize) -> Option<f64> {
    values.get(index).copied()
}

/// The run's course, for effects that depend on it: rows closer than [`COURSE_STEP_S`] are thinned, since nothing that is modelled
/// is quicker. A shape without times was measured in the middle of its hold.
fn course(session: &Session, run: &LateralRun, used: &[&Hold]) -> DisplacementHistory {
    let mut last_s = f64::NEG_INFINITY;
    let mut kept_rows = Vec::new();
    for (row, time_s) in run.force.time_s.iter().enumerate() {
        if time_s - last_s >= COURSE_STEP_S * (1.0 - 1e-6) {
            kept_rows.push(row);
            last_s = *time_s;
        }
    }
    let time_s = thinned(&run.force.time_s, &kept_rows);
    let displacement_x_m = run
        .force
        .displacement_x_m
        .as_deref()
        .map_or_else(|| vec![0.0; time_s.len()], |column| thinned(column, &kept_rows));
    let displacement_m = [thinned(&run.force.displacement_y_m, &kept_rows), displacement_x_m];
    let holds: Vec<Range<usize>> = used
        .iter()
        .map(|level| {
            let [start_s, end_s] = level.time_s;
            time_s.partition_point(|at_s| *at_s < start_s)..time_s.partition_point(|at_s| *at_s <= end_s)
        })
        .collect();
    DisplacementHistory {
        reversal_m: displacement_m.each_ref().map(|readings_m| reversal_m(readings_m, &holds)),
        displacement_m,
        holds,
        shape_time_s: used
            .iter()
            .flat_map(|level| -> Vec<f64> {
                let indices = level.shape.iter().filter(|index| shape_point(session, run, **index).is_some());
                indices.map(|index| measured_s(level, *index, &run.shape.time_s)).collect()
            })
            .collect(),
        time_s,
    }
}

fn measured_s(level: &Hold, index: usize, time_s: &Option<Vec<f64>>) -> f64 {
    let point_time_s = time_s.as_deref().and_then(|times_s| times_s.get(index)).copied();
    point_time_s.map_or(0.5 * (level.time_s[0] + level.time_s[1]), |stamp_s| level.observed_s(stamp_s))
}

fn thinned(column: &[f64], kept_rows: &[usize]) -> Vec<f64> {
    kept_rows.iter().filter_map(|row| column.get(*row)).copied().collect()
}

/// At the largest displacement the guide must push, not be pulled.
fn check_sign(run: &LateralRun, balances: &[Balance]) -> Result<(), RunError> {
    let largest = balances.iter().max_by(|a, b| a.displacement_m.value.total_cmp(&b.displacement_m.value));
    match largest {
        Some(level) if level.force_n.value <= 0.0 => Err(RunError::ForceSign {
            path: run.force_path.clone(),
            force_n: level.force_n.value,
            displacement_mm: 1e3 * level.displacement_m.value,
        }),
        _ => Ok(()),
    }
}

fn hold_result(level: &Hold, noise: &Deviations) -> HoldResult {
    HoldResult {
        from_s: level.time_s[0],
        to_s: level.time_s[1],
        path: match level.path {
            Path::Zero => "zero",
            Path::Loading => "loading",
            Path::Unloading => "unloading",
        },
        displacement_y_mm: 1e3 * level.displacement_y_m.value,
        force_y_n: level.force_y_n.value,
        displacement_x_mm: level.displacement_x_m.map(|mean| 1e3 * mean.value),
        force_x_n: level.force_x_n.map(|mean| mean.value),
        force_y_se_n: Some(noise.force(&level.force_y_n).sd),
        samples: level.displacement_y_m.samples,
        shape_points: level.shape.len(),
        used: level.lost_samples == 0,
    }
}
