//! Calibration of the image plane against the probe from a sequence over a phantom of N-shaped wires (Lasso and others, IEEE Transactions on
//! Biomedical Engineering 61:2527, 2014; the phantoms are those of PLUS).
//!
//! 1. In every frame the cross-sections of the wires are found, and assigned: two parallel wires and the slanted one between them lie on a
//!    line of the image, and the outer wires of all patterns are an affine image of the phantom's cross-section ([`pattern`]).
//! 2. The place of the slanted wire between the other two determines where along the phantom it is cut: a first calibration is a linear fit of these
//!    points.
//! 3. The distances of all wires from where the plane cuts them are minimised over the plane's pose and the size of a pixel, with the weights
//!    of Tukey's biweight, and over the lag between images and tracker ([`solve`]).
//!
//! Frames are divided: every other one is not used for the calibration, and states how well it holds.

pub mod pattern;
pub mod phantom;
pub mod solve;

use crate::detect::Detector;
use crate::error::ImagingError;
use crate::frame::{Frame, Orientation, Region, Statement, Unclear};
use crate::pose::{self, IDENTITY, PlaceError, Pose, inverse, product};
use crate::read::Sequence;
use pattern::Cut;
use phantom::Phantom;
use solve::Solution;

/// Settings beside sequence and phantom.
#[derive(Debug, Clone, PartialEq)]
pub struct Settings {
    /// Size of a pixel to about a tenth: of the file, given, or of the phantom's file.
    pub about_mm_per_px: Option<f64>,
    /// Orientation of the image on the probe, if the file does not state it.
    pub orientation: Option<Orientation>,
    /// Part of the oriented frame in which the wires are.
    pub region: Option<Region>,
    /// Transform of the file from the probe to the tracker.
    pub probe: String,
    /// Transform of the file from the phantom's reference to the tracker; none where the tracker's own frame is the reference.
    pub reference: Option<String>,
    /// Most bright part of an echo across the beam, millimetres.
    pub echo_mm: f64,
}

/// Why an image plane is not calibrated.
#[derive(Debug, thiserror::Error)]
pub enum CalibrateError {
    /// A file.
    #[error(transparent)]
    File(#[from] ImagingError),
    /// No size of a pixel to start from.
    #[error("size of a pixel to about a tenth: missing in both files, expected --spacing-mm X,Y")]
    NoSpacing,
    /// No such transform.
    #[error("no frame has the transform {name}, expected one of: {known}")]
    NoTransform {
        /// Requested name.
        name: String,
        /// Names that exist.
        known: String,
    },
    /// No place of the phantom.
    #[error(
        "the phantom's file has no transform from the phantom to {reference}, expected its registration there (Transform From=\"Phantom\")"
    )]
    NoRegistration {
        /// The reference.
        reference: String,
    },
    /// A field that cannot be followed, without an option in its place.
    #[error(transparent)]
    Unclear(#[from] Unclear),
    /// A clock that is set back.
    #[error(transparent)]
    Place(#[from] PlaceError),
    /// Too few frames.
    #[error(
        "{found} of {frames} frames show all {patterns} patterns of the phantom, expected {least} or more: does --spacing-mm fit, and is the \
         region right?"
    )]
    TooFew {
        /// Frames with all patterns.
        found: usize,
        /// Frames in all.
        frames: usize,
        /// Patterns of the phantom.
        patterns: usize,
        /// Fewest.
        least: usize,
    },
    /// The frames do not determine the plane.
    #[error(
        "the frames do not determine the image plane: all of them cut the wires at about the same place, expected a sequence in which the \
         probe is moved along the wires and turned"
    )]
    Degenerate,
}

/// Result of a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum State {
    /// It is a part of the calibration.
    Used,
    /// It is compared with the calibration.
    Validation,
    /// Not all patterns are found.
    NoPattern,
    /// Its wires are too far from where the plane would cut them.
    Outlier,
    /// It has no valid transforms.
    Invalid,
}

impl State {
    /// All of them.
    pub const ALL: [Self; 5] = [Self::Used, Self::Validation, Self::NoPattern, Self::Outlier, Self::Invalid];

    /// Name in documents.
    pub fn name(self) -> &'static str {
        match self {
            Self::Used => "used",
            Self::Validation => "validation",
            Self::NoPattern => "no_pattern",
            Self::Outlier => "outlier",
            Self::Invalid => "invalid",
        }
    }
}

/// Wires of a frame, and where the reference is from the probe.
#[derive(Debug, Clone)]
pub struct Observation {
    /// Number of the frame.
    pub frame: usize,
    /// Time stamp.
    pub time_s: Option<f64>,
    /// Cross-sections of the wires, pattern by pattern.
    pub cut: Cut,
    /// From the phantom to the probe.
    pub phantom_to_probe: Pose,
}

/// A calibrated image plane.
#[derive(Debug, Clone)]
pub struct Calibration {
    /// State of every frame.
    pub states: Vec<State>,
    /// Wires that were found, of every frame with all patterns.
    pub observations: Vec<Observation>,
    /// The plane.
    pub solution: Solution,
    /// Errors on the frames that were used, and on the others.
    pub errors: [solve::Errors; 2],
}

/// Fewest frames.
const MIN_FRAMES: usize = 10;

/// Calibrates an image plane. `on_frame` is called with the number of every frame that has been read.
///
/// # Errors
/// [`CalibrateError`].
pub fn calibrate(
    sequence: &mut Sequence,
    phantom: &Phantom,
    settings: &Settings,
    mut on_frame: impl FnMut(usize),
) -> Result<Calibration, CalibrateError> {
    let header = sequence.header().clone();
    let of_file = header.spacing_mm.map(|[x, y]| 0.5 * (x + y));
    let approximate_mm_per_px =
        settings.about_mm_per_px.or(of_file).or(phantom.about_mm_per_px).ok_or(CalibrateError::NoSpacing)?;
    let times_s: Vec<Option<f64>> = header.frames.iter().map(|frame| frame.time_s).collect();
    pose::clock(&times_s)?;
    let reference = settings
        .reference
        .as_deref()
        .map_or("Tracker", |name| name.strip_suffix("ToTracker").unwrap_or(name));
    let registration = phantom
        .registration(reference)
        .ok_or_else(|| CalibrateError::NoRegistration { reference: reference.to_owned() })?;
    for name in [Some(&settings.probe), settings.reference.as_ref()].into_iter().flatten() {
        if !header.frames.iter().any(|frame| frame.transforms.contains_key(name)) {
            let mut names: Vec<&str> =
                header.frames.iter().flat_map(|frame| frame.transforms.keys()).map(String::as_str).collect();
            names.sort_unstable();
            names.dedup();
            let name_list = if names.is_empty() { "none".to_owned() } else { names.join(", ") };
            return Err(CalibrateError::NoTransform { name: name.clone(), known: name_list });
        }
    }
    let stated = header.unclear(Statement::Orientation).filter(|_| settings.orientation.is_none());
    stated.cloned().map_or(Ok(()), Err)?;
    let orientation = settings.orientation.or(header.orientation).unwrap_or_default();
    let detector = Detector::new(settings.echo_mm, [approximate_mm_per_px; 2], settings.region);
    let mut states = Vec::new();
    let mut observations: Vec<Observation> = Vec::new();
    let mut series: Vec<(f64, Pose)> = Vec::new();
    for number in 0.. {
        let Some(frame) = sequence.next_frame()? else { break };
        let fields = header.frames.get(number);
        let pose = fields.filter(|fields| !fields.is_invalid && !fields.is_other_depth).and_then(|fields| {
            let probe = fields.transforms.get(&settings.probe)?;
            let reference = match &settings.reference {
                Some(name) => *fields.transforms.get(name)?,
                None => IDENTITY,
            };
            Some(product(&inverse(probe)?, &product(&reference, &registration)))
        });
        if let Some((time_s, pose)) = fields.and_then(|fields| fields.time_s).zip(pose) {
            series.push((time_s, pose));
        }
        let state = match pose {
            None => State::Invalid,
            Some(phantom_to_probe) => {
                match wires(&detector, frame, orientation, phantom, approximate_mm_per_px) {
                    None => State::NoPattern,
                    Some(cut) => {
                        let time_s = fields.and_then(|fields| fields.time_s);
                        observations.push(Observation { frame: number, time_s, cut, phantom_to_probe });
                        State::Used
                    }
                }
            }
        };
        states.push(state);
        on_frame(number);
    }
    if observations.len() < MIN_FRAMES {
        let (observation_count, frames, patterns) =
            (observations.len(), states.len(), phantom.patterns.len());
        return Err(CalibrateError::TooFew { found: observation_count, frames, patterns, least: MIN_FRAMES });
    }
    series.sort_by(|a, b| a.0.total_cmp(&b.0));
    let (fitted_echoes, checked_echoes): (Vec<(usize, &Observation)>, Vec<_>) =
        observations.iter().enumerate().partition(|(number, _)| number % 2 == 0);
    let (fitted_frames, checked_frames) = (observations_of(&fitted_echoes), observations_of(&checked_echoes));
    let solution = solve::solve(&fitted_frames, &series, phantom, approximate_mm_per_px)
        .ok_or(CalibrateError::Degenerate)?;
    let at_lag = |part: Vec<Observation>| match solution.lag_s {
        Some(lag_s) => solve::delayed(&part, &series, lag_s),
        None => part,
    };
    let (fitted_poses, checked_poses) = (at_lag(fitted_frames), at_lag(checked_frames));
    for (observation, state) in fitted_poses
        .iter()
        .map(|one| (one, State::Used))
        .chain(checked_poses.iter().map(|one| (one, State::Validation)))
    {
        let is_outlier = solution.is_outlier(observation, phantom);
        if let Some(slot) = states.get_mut(observation.frame) {
            *slot = if is_outlier { State::Outlier } else { state };
        }
    }
    let errors = [&fitted_poses, &checked_poses].map(|part| solution.errors(part, phantom));
    Ok(Calibration { states, observations, solution, errors })
}

fn observations_of(part: &[(usize, &Observation)]) -> Vec<Observation> {
    part.iter().map(|(_, observation)| (*observation).clone()).collect()
}

/// The wires of a frame; none where not all patterns are there.
fn wires(
    detector: &Detector,
    frame: Frame,
    orientation: Orientation,
    phantom: &Phantom,
    about_mm: f64,
) -> Option<Cut> {
    let candidates = detector.candidates(&frame.oriented(orientation));
    let echoes_px: Vec<[f64; 2]> =
        candidates.iter().map(|candidate| [candidate.centre.x_px, candidate.centre.y_px]).collect();
    pattern::assign(&echoes_px, phantom, about_mm)
}

#[cfg(test)]
mod tests;
