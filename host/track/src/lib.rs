//! Tracking: stiffness and damping of the tissue online, while the needle goes in and its base moves sideways.
//!
//! [`track`] runs the estimator that the firmware has too ([`online`]) over the steering runs of a session, as it would have run while
//! they were recorded: every value is made of what had been measured until then. [`published`] and [`kalman`] are what others
//! would do; `cargo xtask study steering` compares them where the truth is known.
#![forbid(unsafe_code)]
#![deny(missing_docs)]

pub mod kalman;
pub mod layers;
pub mod method;
mod mixture;
pub mod online;
mod places;
pub mod published;
pub mod results;
mod units;

use estimator::{Estimate, SampleError, Settings};
use formats::session::{Session, SteeringRun};
use kalman::{FilterConfig, Kalman, Kind};
use layers::LayeredTracker;
use mechanics::{Dynamics, ModelError};
use method::{Method, Report, samples};
use online::{MODES, OnlineTracker};
use published::{Published, PublishedSettings};
use results::{CompareResult, FieldResult, LayersResult, TrackResult, Tracking, errors};

/// Why a session cannot be tracked.
#[derive(Debug, thiserror::Error)]
pub enum TrackError {
    /// The forward model refuses it.
    #[error("the needle cannot be modelled: {0}")]
    Model(#[from] ModelError),
    /// The estimator's sizes do not fit each other.
    #[error("the estimator's layout does not fit its number of parameters")]
    Layout,
    /// There is nothing to track.
    #[error("session.toml: steering: missing, expected at least one run")]
    NoRuns,
    /// A segment in which nothing can vary.
    #[error(
        "segment_mm: {segment_mm}, expected {least_mm:.1} or more: two cells of the estimator, which has {} for the depth of the runs",
        online::CELLS
    )]
    ShortSegment {
        /// Length of the segment.
        segment_mm: f64,
        /// Least length.
        least_mm: f64,
    },
    /// The model needs the needle's length.
    #[error(
        "session.toml: [needle] length_mm: missing, expected the length from the fixture to the tip (or --length-mm)"
    )]
    NoLength,
}

/// Segments of the estimator: its memory is fixed, on the host as in the firmware.
const SEGMENTS: usize = 2;
/// Fewest cells of a segment.
const MIN_CELLS: f64 = 2.0;

/// Options of the run.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Options {
    /// Length of the needle from the fixture to the tip, instead of what the session states.
    pub length_m: Option<f64>,
    /// Mass of the fixture, instead of what the session states.
    pub fixture_mass_kg: Option<f64>,
    /// Start of the search: stiffness, N/m^2, and damping, N s/m^2.
    pub start: Option<[f64; 2]>,
    /// Depth at which stiffness and damping may jump, as from one layer to the next; without it the depth is an unknown.
    pub segment_m: Option<f64>,
    /// Run the other estimators too.
    pub compare: bool,
}

/// Needle and fixture of a session.
///
/// # Errors
/// [`TrackError::NoLength`].
pub fn dynamics(session: &Session, options: &Options) -> Result<Dynamics, TrackError> {
    let needle = &session.rig.needle;
    let length_m = options.length_m.or(needle.length_m).ok_or(TrackError::NoLength)?;
    let fixture_mass_kg = options.fixture_mass_kg.or(session.fixture_mass_kg).unwrap_or(0.0);
    Ok(Dynamics::steel(needle, length_m, fixture_mass_kg))
}

/// The estimator for a session.
///
/// # Errors
/// [`TrackError`] where the session does not state enough or makes no sense.
pub fn tracker(session: &Session, options: &Options) -> Result<OnlineTracker<f64>, TrackError> {
    OnlineTracker::new(settings(session, options)?).ok_or(TrackError::Layout)
}

fn settings(session: &Session, options: &Options) -> Result<Settings<f64, MODES>, TrackError> {
    let dynamics = dynamics(session, options)?;
    let mut settings = online::settings::<f64>(&session.rig.needle, &dynamics)?;
    settings.layout.segments = SEGMENTS;
    // Deeper runs than the cells were made for: longer ones. The last segment reaches to the deepest point.
    let deepest_m = session.steering.iter().flat_map(|run| &run.depth_m).copied().fold(0.0, f64::max);
    settings.cell_m = settings.cell_m.max(1.001 * deepest_m / online::CELLS as f64);
    settings.reach_m = deepest_m;
    settings.segment_m = options.segment_m.unwrap_or(settings.segment_m);
    settings.start = options.start.unwrap_or(settings.start);
    settings.force_sd_n = session.noise.force_n.unwrap_or(0.0);
    settings.tip_sd_m = session.noise.tip_m.unwrap_or(0.0);
    settings.base_sd_m = session.noise.displacement_m.unwrap_or(0.0);
    if settings.segment_m < MIN_CELLS * settings.cell_m {
        let least_mm = 1e3 * MIN_CELLS * settings.cell_m;
        return Err(TrackError::ShortSegment { segment_mm: 1e3 * settings.segment_m, least_mm });
    }
    Ok(settings)
}

/// Tracks every steering run of a session.
///
/// # Errors
/// [`TrackError`] where the session has no steering run or does not state how long the needle is.
pub fn track(session: &Session, options: &Options) -> Result<Tracking, TrackError> {
    if session.steering.is_empty() {
        return Err(TrackError::NoRuns);
    }
    let mut warnings = Vec::new();
    if options.fixture_mass_kg.or(session.fixture_mass_kg).is_none() {
        warnings.push("[rig] fixture_mass_kg is not given: its inertia is neglected".to_owned());
    }
    let runs: Result<Vec<_>, _> = session.steering.iter().map(|run| one(session, options, run)).collect();
    Ok(Tracking { schema: results::SCHEMA, session: session.name.clone(), runs: runs?, warnings })
}

/// A run that has gone through the estimator.
struct Through {
    estimates: Vec<Estimate<f64>>,
    /// Rows that the estimator refused.
    refused: Vec<(usize, SampleError)>,
    last: Option<Estimate<f64>>,
    field: Option<FieldResult>,
    layers: Option<LayersResult>,
}

fn run_through(session: &Session, options: &Options, run: &SteeringRun) -> Result<Through, TrackError> {
    let settings = settings(session, options)?;
    let mut estimates: Vec<Estimate<f64>> = Vec::new();
    let mut refused: Vec<(usize, SampleError)> = Vec::new();
    let mut take = |row: usize, taken: Result<Option<Estimate<f64>>, SampleError>| match taken {
        Ok(estimate) => estimates.extend(estimate),
        Err(why) => refused.push((row, why)),
    };
    if options.segment_m.is_some() {
        let mut tracker = OnlineTracker::new(settings).ok_or(TrackError::Layout)?;
        samples(run).enumerate().for_each(|(row, sample)| take(row, tracker.update(&sample)));
        let last = tracker.finish();
        let field = last.map(|last| FieldResult::of_tracker(&tracker, last.depth_m));
        return Ok(Through { estimates, refused, last, field, layers: None });
    }
    let mut tracker = LayeredTracker::new(settings).ok_or(TrackError::Layout)?;
    samples(run).enumerate().for_each(|(row, sample)| take(row, tracker.update(&sample)));
    let last = tracker.finish();
    let field = last.as_ref().map(|last| FieldResult::new(&last.field, last.cell_m));
    let layers = last.as_ref().map(LayersResult::new);
    Ok(Through { estimates, refused, last: last.map(|last| last.estimate), field, layers })
}

fn one(session: &Session, options: &Options, run: &SteeringRun) -> Result<TrackResult, TrackError> {
    let Through { estimates, refused, last, field, layers } = run_through(session, options, run)?;
    // Units and signs before tissue and motion: what is wrong with them explains the rest.
    let units = units::explain(session, options, run, last.map(|last| last.misfit))?;
    let mut result = TrackResult::new(&run.id, &estimates, last, units.is_none());
    result.warnings.splice(0..0, units);
    (result.field, result.layers) = (field, layers);
    if let Some((row, why)) = refused.first() {
        result.warnings.push(results::skipped(refused.len(), *row, *why, run));
    }
    if options.compare {
        result.compare = compare(session, options, run)?;
    }
    Ok(result)
}

/// Estimates of the other methods from the same run.
fn compare(
    session: &Session,
    options: &Options,
    run: &SteeringRun,
) -> Result<Vec<CompareResult>, TrackError> {
    let needle = &session.rig.needle;
    let dynamics = dynamics(session, options)?;
    let usual = PublishedSettings::default();
    let printed = PublishedSettings { segment_m: options.segment_m.unwrap_or(usual.segment_m), ..usual };
    let start = options.start.unwrap_or([printed.start[1], printed.start[0]]);
    let printed = PublishedSettings { start: [start[1], start[0]], ..printed };
    let config = FilterConfig {
        start,
        base_sd_m: session.noise.displacement_m.unwrap_or(2e-5),
        force_sd_n: session.noise.force_n.unwrap_or(0.05),
        tip_sd_m: session.noise.tip_m.unwrap_or(2e-4),
    };
    let methods: [(&'static str, Box<dyn Method>); 3] = [
        ("published", Box::new(Published::new(needle, &dynamics, printed)?)),
        ("EKF", Box::new(Kalman::new(Kind::Extended, needle, &dynamics, config)?)),
        ("UKF", Box::new(Kalman::new(Kind::Unscented, needle, &dynamics, config)?)),
    ];
    Ok(methods
        .into_iter()
        .map(|(name, mut method)| {
            let reports: Vec<(Report, f64)> = samples(run)
                .filter_map(|sample| method.update(&sample).map(|report| (report, sample.tip_m)))
                .collect();
            let offs: Vec<[f64; 2]> =
                reports.iter().map(|(report, tip_m)| [report.depth_m, report.tip_m - tip_m]).collect();
            let last = reports.last().map(|(report, _)| *report);
            CompareResult {
                method: name,
                errors: errors(&results::smoothed(&offs)),
                stiffness_n_per_m2: last.and_then(|last| last.stiffness).filter(|value| value.is_finite()),
                damping_n_s_per_m2: last.and_then(|last| last.damping).filter(|value| value.is_finite()),
            }
        })
        .collect())
}

#[cfg(test)]
mod tests;
