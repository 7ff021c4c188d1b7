//! Identification of the rig's mechanics from runs in air: the needle is a known beam, and the remaining response is that of the rig
//! (theory, eq. 62, without tissue, with the discrepancy of force sensor and guides only).
//!
//! All effects of guides, frame, actuators and force sensor are fitted together, by the same forward model as
//! everything else. In air, force and displacement alone determine one compliance, the sum of all compliances; the shape of the
//! needle separates the frame from the needle and its clamp, and known loads separate the force sensor's gain from the needle's
//! stiffness. A parameter that the runs do not separate is reported as not identifiable, with a run that would identify it.

mod play;

use super::data::{Datum, Source};
use super::discrepancy::{columns, group_of};
use super::evidence::{Patterns, RunPatterns};
use super::known::KnownParameter;
use super::layout::{Layout, Prepared, Scale, prior};
use super::noise::Noise;
use super::posterior::{Fitted, MAX_ROUNDS};
use super::whiten::Whitener;
use super::{DiagnoseError, runs_in};
use formats::NORMAL_975;
use formats::model_file::{LearnedEffect, ModelFile};
use formats::session::{LateralRun, Session};
use mechanics::Model;
use mechanics::effects::effect;
use mechanics::unknowns::{rig, sensors};
use play::over_plays;
use serde::Serialize;
use std::path::PathBuf;

/// Fitted effects. Offsets are among them so that they are not mistaken for a compliance.
const EFFECTS: [&str; 12] = [
    "needle.stiffness",
    "rig.clamp_compliance",
    "rig.rear_rotation",
    "rig.frame_compliance",
    "rig.backlash",
    "rig.play",
    "rig.friction",
    "sensor.force_gain",
    "sensor.force_drift",
    "sensor.crosstalk",
    "sensor.delay",
    "sensor.shape_offset",
];
/// Effects whose parameters differ from session to session.
const OF_ONE_SESSION: [&str; 2] = ["sensor.force_drift", "sensor.shape_offset"];
/// A parameter is identified if the runs reduce its standard deviation below this fraction of that of its prior.
const IDENTIFIED: f64 = 0.5;
/// If the friction is larger than this many of its standard deviations, the delay has an additional error of the rows' spacing: the force
/// jumps when guide 2 reverses, and the model interpolates between rows.
const FRICTION_SDS: f64 = 2.0;
/// Time constants with which the zero settles after a tare, seconds.
const SETTLING_S: [f64; 2] = [5.0, 20.0];

/// Choices of the user.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct CharacterizeOptions {
    /// Relative standard deviation of the force sensor's gain, from a calibration with known loads.
    pub force_gain_sd: Option<f64>,
    /// Relative standard deviation of the stated bending stiffness.
    pub stiffness_sd: Option<f64>,
}

/// Source of the information about a parameter.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Standing {
    /// The runs.
    Identified,
    /// A statement; the runs add little.
    Stated,
    /// There is none.
    NotIdentifiable,
}

/// A parameter of the rig.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct CharacterizedParameter {
    /// Id of the effect.
    pub effect: &'static str,
    /// Name of the parameter, with its unit.
    pub parameter: &'static str,
    /// Its value.
    pub value: f64,
    /// Standard deviation.
    pub sd: f64,
    /// 95 % interval, within the range of the parameter.
    pub ci95: [f64; 2],
    /// Source of the information about it.
    pub standing: Standing,
    /// The run that would identify it, if it is not identifiable.
    pub settled_by: Option<&'static str>,
}

impl CharacterizedParameter {
    /// Whether the runs determine it.
    pub fn is_identified(&self) -> bool {
        self.standing == Standing::Identified
    }
}

/// A rig as characterized by its runs in air.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Characterisation {
    /// The runs that were used.
    pub runs: Vec<String>,
    /// Its parameters.
    pub parameters: Vec<CharacterizedParameter>,
    /// Scatter of the force's zero from run to run, newtons; `None` with fewer than two runs.
    pub tare_scatter_n: Option<f64>,
    /// Reduced chi-square: above 2 the runs contain an effect that the model of the rig lacks.
    pub chi_square_per_reading: f64,
    /// Skipped parts, and remarks on possible errors.
    pub warnings: Vec<String>,
}

impl Characterisation {
    /// The characterized rig for a file: the parameters that are the same in all sessions, as determined by the runs or stated.
    pub fn model(&self, learned_from: Option<String>) -> ModelFile {
        let characterized = EFFECTS.iter().filter(|id| !OF_ONE_SESSION.contains(id));
        let effects = characterized.filter_map(|id| {
            let effect = effect(id)?;
            let of_effect: Vec<_> = self.parameters.iter().filter(|one| one.effect == *id).collect();
            let is_characterized = !of_effect.is_empty()
                && !of_effect.iter().any(|one| one.standing == Standing::NotIdentifiable);
            // The interval is not clipped to the range of the parameter, because it is read as that of a normal distribution.
            is_characterized.then(|| LearnedEffect {
                effect,
                values: of_effect.iter().map(|one| one.value).collect(),
                ci95: of_effect
                    .iter()
                    .map(|one| Some([one.value - NORMAL_975 * one.sd, one.value + NORMAL_975 * one.sd]))
                    .collect(),
                log_evidence_gain: None,
            })
        });
        ModelFile { learned_from, effects: effects.collect(), ..ModelFile::default() }
    }
}

/// Why a rig cannot be characterised.
#[derive(Debug, thiserror::Error)]
pub enum CharacterizeError {
    /// No run is in air.
    #[error(
        "{}: lateral: no run in air, expected at least one [[lateral]] with depth_mm = 0: the needle in both guides and in nothing else",
        path.display()
    )]
    NoAir {
        /// The session file.
        path: PathBuf,
    },
    /// The needle's stiffness is not stated.
    #[error(
        "{}: needle: no bending stiffness, expected its modulus and diameters: in air the needle is the reference spring of the rig",
        path.display()
    )]
    NeedleUnknown {
        /// The session file.
        path: PathBuf,
    },
    /// The runs cannot be read or fitted.
    #[error(transparent)]
    Diagnose(#[from] DiagnoseError),
}

impl From<readings::FitError> for CharacterizeError {
    fn from(error: readings::FitError) -> Self {
        Self::Diagnose(error.into())
    }
}

impl From<mechanics::ModelError> for CharacterizeError {
    fn from(error: mechanics::ModelError) -> Self {
        Self::Diagnose(error.into())
    }
}

/// Characterises a rig from the runs in air of a session.
///
/// # Errors
/// [`CharacterizeError`] where nothing can be characterised.
pub fn characterize(
    session: &Session,
    options: &CharacterizeOptions,
) -> Result<Characterisation, CharacterizeError> {
    let path = session.dir.join("session.toml");
    if !session.rig.needle.stiffness_known {
        return Err(CharacterizeError::NeedleUnknown { path });
    }
    if !session.lateral.iter().any(LateralRun::is_in_air) {
        return Err(CharacterizeError::NoAir { path });
    }
    let (runs, mut warnings) = runs_in(session, true)?;
    let (noise, disagreements) = Noise::with_disagreements(&runs, &session.stated_noise());
    warnings.extend(disagreements);
    let has_shape = session.lateral.iter().any(|run| run.is_in_air() && !run.shape.z_m.is_empty());
    let effects: Vec<_> = EFFECTS
        .iter()
        .filter_map(|id| effect(id))
        .filter(|effect| {
            effect.applies_to(&session.rig) && (has_shape || effect.id() != "sensor.shape_offset")
        })
        .collect();
    let mut layout = Layout::new(&session.rig, &runs, effects);
    layout.known = stated(options).into();

    // In air the modulus of the tissue has no effect.
    let beam = Model::uniform(session.rig.clone(), 1e3)?.beam(0.0)?;
    let stiffness_n_per_m = beam.lateral_stiffness_n_per_m();
    // Whitening depends on the predictions; the second fit is whitened around the values of the first.
    let mut values = layout.first_values();
    let mut last = None;
    for _ in 0..2 {
        let mut prepared = Vec::with_capacity(runs.len());
        for run in &runs {
            let model = layout.model_of(&values, run.kind, false)?;
            prepared.push(Prepared { run: run.clone(), whitener: Whitener::new(run, &noise, &model)? });
        }
        let patterns = sensor_patterns(&prepared, stiffness_n_per_m);
        let everyday = patterns.everyday();
        let fit = Fitted::new(&layout, &prepared, &patterns, &values, &everyday, MAX_ROUNDS)?;
        values = fit.values().to_vec();
        last = Some((fit, prepared, patterns));
    }
    let (mut fitted, prepared, patterns) = last.ok_or(readings::FitError::Undetermined)?;
    if !has_shape {
        fitted = over_plays(&layout, &prepared, &patterns, fitted)?;
    }
    Ok(Characterisation {
        runs: runs.iter().map(|run| run.id.clone()).collect(),
        parameters: parameters(&layout, &fitted, options, row_s(session)),
        tare_scatter_n: fitted.sizes.first().copied().filter(|_| runs.len() > 1),
        chi_square_per_reading: chi_square_per_reading(&fitted, &patterns),
        warnings,
    })
}

/// Spacing of the rows of the runs in air, seconds: the median.
fn row_s(session: &Session) -> f64 {
    let times = session.lateral.iter().filter(|run| run.is_in_air()).map(|run| &run.force.time_s);
    let steps = times.flat_map(|times_s| times_s.iter().zip(times_s.iter().skip(1)).map(|(a, b)| b - a));
    let mut steps: Vec<f64> = steps.collect();
    steps.sort_by(f64::total_cmp);
    steps.get(steps.len() / 2).copied().unwrap_or(0.0)
}

/// Known parameters that the options state.
fn stated(options: &CharacterizeOptions) -> Vec<KnownParameter> {
    let statements = [
        ("sensor.force_gain", "gain", options.force_gain_sd),
        ("needle.stiffness", "relative", options.stiffness_sd),
    ];
    let known_parameters = statements.into_iter().filter_map(|(effect, parameter, sd)| {
        let (effect, parameter) = (effect.to_owned(), parameter.to_owned());
        Some(KnownParameter { effect, parameter, value: 0.0, sd: sd? })
    });
    known_parameters.collect()
}

/// Basis functions of the discrepancy of force sensor and guides. The sizes of three groups are estimated: zeros of runs and planes, their
/// settling after the tare, and forces that are constant within a hold (an error of the displacement, times the needle's stiffness, is
/// such a force too). The error of the mean position of guide 2 in a hold depends on the direction from which it came; its size is
/// stated, because the runs do not determine it.
fn sensor_patterns(prepared: &[Prepared], stiffness_n_per_m: f64) -> Patterns {
    let groups = vec![
        group_of(&sensors::FORCE_ZERO),
        group_of(&sensors::FORCE_ZERO_SETTLING),
        group_of(&sensors::FORCE_OF_ONE_HOLD_IN_AIR),
        group_of(&rig::GUIDE2_CREEP),
    ];
    let of_runs = prepared.iter().map(|prepared| {
        let data = &prepared.run.data;
        let mut patterns: Vec<(usize, Vec<f64>)> = Vec::new();
        for plane in 0..2 {
            let in_plane: Vec<f64> = data.iter().map(|datum| f64::from(is_force(datum, plane))).collect();
            patterns.push((0, in_plane.clone()));
            for time_s in SETTLING_S {
                let settling = data.iter().zip(&in_plane);
                let settling = settling.map(|(datum, force)| force * (-datum.place.time_s / time_s).exp());
                patterns.push((1, settling.collect()));
            }
            for hold in 0..prepared.run.parts() {
                let of_hold = data.iter().zip(&in_plane);
                let of_hold = of_hold.map(|(datum, force)| if datum.part == hold { *force } else { 0.0 });
                patterns.push((2, of_hold.collect()));
            }
        }
        patterns.retain(|(_, pattern)| pattern.iter().any(|value| *value != 0.0));
        // All runs share two patterns: the direction of the last motion, and the side of zero (half of a clearance).
        let forces_per_m =
            data.iter().map(|datum| if is_force(datum, prepared.run.axis) { stiffness_n_per_m } else { 0.0 });
        let forces_per_m = data.iter().zip(forces_per_m);
        let direction = forces_per_m.clone().map(|(datum, n_per_m)| n_per_m * datum.place.direction);
        let side = forces_per_m.map(|(datum, n_per_m)| 0.5 * n_per_m * sign(datum.place.level_m));
        let shared = vec![direction.collect(), side.collect()];
        let (of_groups, run_patterns): (Vec<usize>, Vec<Vec<f64>>) = patterns.into_iter().unzip();
        RunPatterns::new(of_groups, columns(prepared, run_patterns), columns(prepared, shared))
    });
    Patterns::new(groups, vec![3; 2], of_runs.collect())
}

/// The sign of a level; zero belongs to no side.
fn sign(level_m: f64) -> f64 {
    if level_m == 0.0 { 0.0 } else { level_m.signum() }
}

fn is_force(datum: &Datum, plane: usize) -> bool {
    matches!(datum.source, Source::Force(_)) && datum.channel.plane() == plane
}

fn parameters(
    layout: &Layout,
    fitted: &Fitted,
    options: &CharacterizeOptions,
    row_s: f64,
) -> Vec<CharacterizedParameter> {
    let stated = stated(options);
    let mut parameters_found: Vec<CharacterizedParameter> = Vec::new();
    for (number, effect) in layout.effects.iter().enumerate() {
        for (index, info) in effect.parameters().iter().enumerate() {
            let (value, mut ci95) = fitted.estimate(number, index);
            let scale = Scale::of(info);
            let stated = stated.iter().find(|known| known.is_of(effect.id(), info.name));
            let prior_sd = stated.map_or_else(|| prior(info), |known| known.prior(scale)).sd;
            let mut inside_sd = fitted.sd(layout.first_of(number) + index);
            if effect.id() == "sensor.delay" {
                let rubs = parameters_found
                    .iter()
                    .any(|one| one.effect == "rig.friction" && one.value > FRICTION_SDS * one.sd);
                let row_sd_s = if rubs { row_s / 12f64.sqrt() } else { 0.0 };
                inside_sd = inside_sd.hypot(row_sd_s).hypot(sensors::CLOCK.sd());
                let half = NORMAL_975 * inside_sd;
                ci95 = [value - half, value + half].map(|end| end.clamp(info.range[0], info.range[1]));
            }
            let standing = match (inside_sd < IDENTIFIED * prior_sd, stated) {
                (true, _) => Standing::Identified,
                (false, Some(_)) => Standing::Stated,
                (false, None) => Standing::NotIdentifiable,
            };
            parameters_found.push(CharacterizedParameter {
                effect: effect.id(),
                parameter: info.name,
                value,
                sd: if scale == Scale::Log { value * inside_sd } else { inside_sd },
                ci95,
                standing,
                settled_by: (standing == Standing::NotIdentifiable).then(|| settled_by(effect.id())),
            });
        }
    }
    parameters_found
}

/// The run, or the statement, that determines an effect's parameters.
fn settled_by(effect: &str) -> &'static str {
    match effect {
        "needle.stiffness" | "sensor.force_gain" => {
            "known loads (guide calibrate force, then --force-gain-sd), or a measured stiffness of the needle (--stiffness-sd): in air a \
             gain of the force and a stiffer needle are the same"
        }
        "rig.clamp_compliance" | "rig.rear_rotation" => {
            "runs with sweeps of the shape, between the guides and beyond, at forces of 0.5 N or more"
        }
        "rig.frame_compliance" => "runs with sweeps of the shape near guide 2, at forces of 0.5 N or more",
        "rig.backlash" => "holds within 0.3 mm on both sides of zero",
        "rig.play" | "rig.friction" => {
            "holds at the same levels, reached from both sides, with sweeps of the shape: a play moves the needle, a friction does not"
        }
        "sensor.force_drift" => "a run of a minute or more",
        "sensor.crosstalk" => "runs in both axes, with both forces recorded",
        "sensor.delay" => "a run with moves at 2 mm/s or faster between the holds",
        _ => "runs with sweeps of the shape at zero displacement",
    }
}

/// Chi-square in the metric of noise and discrepancy, per degree of freedom.
fn chi_square_per_reading(fitted: &Fitted, patterns: &Patterns) -> f64 {
    let count = fitted.residuals.iter().map(Vec::len).sum::<usize>().saturating_sub(fitted.values().len());
    let without_patterns = patterns.less_patterns(&fitted.sizes, &fitted.residuals).unwrap_or_default();
    let products = fitted.residuals.iter().zip(&without_patterns).map(|(all, without_patterns)| {
        all.iter()
            .zip(without_patterns.iter())
            .map(|(all, without_patterns)| all * without_patterns)
            .sum::<f64>()
    });
    products.sum::<f64>() / count.max(1) as f64
}

#[cfg(test)]
#[path = "characterize_tests.rs"]
mod tests;
