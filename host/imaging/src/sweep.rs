//! A sweep of transverse frames: where the needle is in each, with a standard deviation and the frame's state.

mod lag;
mod points;
mod shared;

pub use lag::Lag;
pub use points::{Deflection, Line, Point, deflections};
pub use shared::share_noise;

use crate::detect::{Candidate, Detector};
use crate::error::ImagingError;
use crate::frame::{Frame, Header, Orientation, Region, Statement, Unclear};
use crate::pose::{Motion, Place, PlaceError, Poses, placed};
use crate::read::Sequence;
use crate::track::{Decision, Echo, Track, TrackError, follow};
use std::collections::HashSet;
use std::hash::{DefaultHasher, Hash, Hasher};

/// Settings of a sweep beside its frames.
#[derive(Debug, Clone, PartialEq)]
pub struct Settings {
    /// Outer diameter of the needle, millimetres.
    pub needle_mm: f64,
    /// Size of a pixel, in place of what the file states.
    pub spacing_mm: Option<[f64; 2]>,
    /// Orientation of the image on the probe, in place of the file's statement.
    pub orientation: Option<Orientation>,
    /// Part of the oriented frame in which the needle is, in place of what the file states.
    pub region: Option<Region>,
    /// Source of the image plane's position.
    pub place: Place,
    /// Delay of position readings after images with the same time stamp; if it is none, it is estimated as far as the
    /// motion determines it.
    pub lag_s: Option<f64>,
}

/// Why a sweep is not measured.
#[derive(Debug, thiserror::Error)]
pub enum SweepError {
    /// A file.
    #[error(transparent)]
    File(#[from] ImagingError),
    /// No size of a pixel.
    #[error(
        "the file states no size of a pixel (or 1 mm, which is what programs write that do not have it), expected --spacing-mm X,Y"
    )]
    NoSpacing,
    /// A field that cannot be followed, without an option in its place.
    #[error(transparent)]
    Unclear(#[from] Unclear),
    /// No place.
    #[error(transparent)]
    Place(#[from] PlaceError),
    /// No needle.
    #[error(transparent)]
    Track(#[from] TrackError),
}

/// Result of a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum State {
    /// It is a part of the shape.
    Used,
    /// No echo of a needle's size.
    NoEcho,
    /// Two echoes near the sequence are about as bright.
    Ambiguous,
    /// Its echoes are too far from the sequence.
    Outlier,
    /// A quarter of its pixels or more have the greatest brightness.
    Saturated,
    /// It is the same as an earlier frame, pixel by pixel.
    Repeated,
    /// All pixels are dark.
    Black,
    /// The file marks it as unusable, or has no position for it.
    Invalid,
    /// It has another size, or pixels of another size, than the first one: depth or zoom were changed.
    OtherDepth,
}

impl State {
    /// All of them.
    pub const ALL: [Self; 9] = [
        Self::Used,
        Self::NoEcho,
        Self::Ambiguous,
        Self::Outlier,
        Self::Saturated,
        Self::Repeated,
        Self::Black,
        Self::Invalid,
        Self::OtherDepth,
    ];

    /// Name in documents.
    pub fn name(self) -> &'static str {
        match self {
            Self::Used => "used",
            Self::NoEcho => "no_echo",
            Self::Ambiguous => "ambiguous",
            Self::Outlier => "outlier",
            Self::Saturated => "saturated",
            Self::Repeated => "repeated",
            Self::Black => "black",
            Self::Invalid => "invalid",
            Self::OtherDepth => "other_depth",
        }
    }
}

/// One frame of a sweep.
#[derive(Debug, Clone, PartialEq)]
pub struct FrameResult {
    /// Result of the frame.
    pub state: State,
    /// Time stamp.
    pub time_s: Option<f64>,
    /// The used candidate, or the best one.
    pub candidate: Option<Candidate>,
    /// Its place, millimetres: x, y, z.
    pub place_mm: Option<[f64; 3]>,
    /// Standard deviation of its place in x and y, millimetres, scaled to the residuals of the sequence.
    pub sd_mm: Option<[f64; 2]>,
    /// Distance from the sequence in x and y, millimetres.
    pub off_mm: Option<[f64; 2]>,
    /// Direction of the beam and speed of the probe; none where the frame has no position.
    pub motion: Option<Motion>,
}

/// A measured sweep.
#[derive(Debug, Clone)]
pub struct Sweep {
    /// Its frames, in order.
    pub frames: Vec<FrameResult>,
    /// Smooth curves through them, noise and correlation.
    pub track: Track,
    /// Lag between images and positions, where the motion determines one.
    pub lag: Option<Lag>,
    /// Lag that is taken into account.
    pub lag_s: f64,
}

impl Sweep {
    /// Number of frames in a state.
    pub fn count(&self, state: State) -> usize {
        self.frames.iter().filter(|frame| frame.state == state).count()
    }
}

/// A frame is dark below this brightness.
const DARK: u8 = 8;
/// Share of pixels of greatest brightness from which a frame is saturated.
const SATURATED: f64 = 0.25;
/// Frames with different content from which the screen's overlay is found by what never changes.
const MIN_DISTINCT: usize = 8;

/// Measures a sweep. `on_frame` is called with the number of every frame that has been read.
///
/// # Errors
/// [`SweepError`].
pub fn measure(
    sequence: &mut Sequence,
    settings: &Settings,
    mut on_frame: impl FnMut(usize),
) -> Result<Sweep, SweepError> {
    let header = sequence.header().clone();
    let mut measurement = Measurement::new(&Geometry::new(&header, settings)?, settings.needle_mm);
    let poses = Poses::new(header.count, &header.frames, &settings.place)?;
    for number in 0.. {
        let Some(frame) = sequence.next_frame()? else { break };
        let fields = header.frames.get(number);
        let is_invalid = fields.is_some_and(|fields| fields.is_invalid);
        if fields.is_some_and(|fields| fields.is_other_depth) {
            measurement.reject(State::OtherDepth);
        } else if is_invalid || poses.of(number, 0.0).is_none() {
            measurement.reject(State::Invalid);
        } else {
            measurement.push(frame);
        }
        on_frame(number);
    }
    measurement.finish(&poses, settings.lag_s)
}

/// Geometry of a sequence's pixels in its image plane.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Geometry {
    /// Size of a pixel, millimetres.
    pub spacing_mm: [f64; 2],
    /// Orientation of the axes on the probe.
    pub orientation: Orientation,
    /// Part of the oriented frame in which the needle is.
    pub region: Option<Region>,
}

impl Geometry {
    /// As given, and as a file states it where nothing is given.
    ///
    /// # Errors
    /// [`SweepError`] where neither has it.
    pub fn new(header: &Header, settings: &Settings) -> Result<Self, SweepError> {
        let orientation = match settings.orientation {
            Some(given) => given,
            None => {
                check_stated(Statement::Orientation, header)?;
                header.orientation.unwrap_or_default()
            }
        };
        let spacing_mm = match settings.spacing_mm {
            Some(given) => given,
            None => {
                check_stated(Statement::Spacing, header)?;
                header.spacing_mm.ok_or(SweepError::NoSpacing)?
            }
        };
        // A region of the file is one of its pixels, before they are oriented.
        let region = settings.region.or_else(|| {
            header.region.map(|region| region.oriented(orientation, [header.width, header.height]))
        });
        Ok(Self { spacing_mm, orientation, region })
    }
}

fn check_stated(statement: Statement, header: &Header) -> Result<(), Unclear> {
    header.unclear(statement).cloned().map_or(Ok(()), Err)
}

/// A sweep that is being measured, frame by frame: frames of files and of a scanner that sends them take the same way.
pub struct Measurement {
    detector: Detector,
    geometry: Geometry,
    raw: Vec<(State, Vec<Candidate>)>,
    known: HashSet<u64>,
    fixed: Fixed,
}

impl Measurement {
    /// Model of a needle of this outer diameter.
    pub fn new(geometry: &Geometry, needle_mm: f64) -> Self {
        Self {
            detector: Detector::new(needle_mm, geometry.spacing_mm, geometry.region),
            geometry: *geometry,
            raw: Vec::new(),
            known: HashSet::new(),
            fixed: Fixed::default(),
        }
    }

    /// Finds the candidates of the next frame.
    pub fn push(&mut self, frame: Frame) {
        let frame = frame.oriented(self.geometry.orientation);
        let state =
            if self.fixed.fits(&frame) { content_state(&frame, &mut self.known) } else { State::OtherDepth };
        let mut candidates = Vec::new();
        if state == State::Used {
            self.fixed.add(&frame);
            candidates = self.detector.candidates(&frame);
        }
        self.raw.push((state, candidates));
    }

    /// Counts a frame that is not used, for this reason.
    pub fn reject(&mut self, state: State) {
        self.raw.push((state, Vec::new()));
    }

    /// Frames so far.
    pub fn frames(&self) -> usize {
        self.raw.len()
    }

    /// Decides which candidates are the needle, with the poses of all frames.
    ///
    /// # Errors
    /// [`TrackError`] as [`SweepError::Track`].
    pub fn finish(self, poses: &Poses, lag_s: Option<f64>) -> Result<Sweep, SweepError> {
        let Self { geometry: Geometry { spacing_mm, .. }, mut raw, fixed, .. } = self;
        if lag_s.is_some_and(|lag_s| lag_s != 0.0) && !poses.has_times() {
            return Err(PlaceError::LagWithoutTime.into());
        }
        for (_, candidates) in &mut raw {
            candidates.retain(|candidate| !fixed.is_overlay(candidate));
        }
        let echoes = |lag_s: f64| -> Vec<Vec<Echo>> {
            raw.iter()
                .enumerate()
                .map(|(number, (_, candidates))| {
                    let Some(pose) = poses.of(number, lag_s) else { return Vec::new() };
                    candidates.iter().map(|candidate| echo(candidate, &pose, spacing_mm)).collect()
                })
                .collect()
        };
        let first_lag_s = lag_s;
        let mut lag_s = first_lag_s.unwrap_or(0.0);
        let mut track = follow(&echoes(lag_s), 0)?;
        let lag = lag::estimate(&track, poses, &echoes);
        if let (None, Some(lag)) = (first_lag_s, &lag) {
            lag_s = lag.lag_s;
            track = follow(&echoes(lag_s), 0)?;
        }
        let placed_echoes = echoes(lag_s);
        let frames = raw.into_iter().enumerate().map(|(number, (state, candidates))| {
            let decision = track.decisions.get(number).copied().unwrap_or(Decision::NoEcho);
            let echoes = placed_echoes.get(number).map(Vec::as_slice).unwrap_or_default();
            let result = result(state, decision, &candidates, echoes, &track);
            FrameResult { time_s: poses.time_s(number), motion: poses.motion(number, lag_s), ..result }
        });
        Ok(Sweep { frames: frames.collect(), lag, lag_s, track })
    }
}

/// State of a frame before any search for an echo.
fn content_state(frame: &Frame, known: &mut HashSet<u64>) -> State {
    if frame.pixels.iter().all(|pixel| *pixel < DARK) {
        return State::Black;
    }
    let full = frame.pixels.iter().filter(|pixel| **pixel == u8::MAX).count();
    if full as f64 >= SATURATED * frame.pixels.len() as f64 {
        return State::Saturated;
    }
    let mut hasher = DefaultHasher::new();
    frame.pixels.hash(&mut hasher);
    if known.insert(hasher.finish()) { State::Used } else { State::Repeated }
}

/// A candidate in space.
fn echo(candidate: &Candidate, pose: &[f64; 16], spacing_mm: [f64; 2]) -> Echo {
    let centre = &candidate.centre;
    // The transforms of PLUS are from the corner of the first pixel; a shift of half a pixel is a shift of everything.
    let [x, y, z_mm] = placed(pose, [centre.x_px * spacing_mm[0], centre.y_px * spacing_mm[1]]);
    let sd_image = [centre.sd_x_px * spacing_mm[0], centre.sd_y_px * spacing_mm[1]];
    Echo {
        across_mm: [x, y],
        z_mm,
        sd_mm: [axis_sd_mm(0, sd_image, pose), axis_sd_mm(1, sd_image, pose)],
        score: candidate.score,
    }
}

fn axis_sd_mm(row: usize, sd_image: [f64; 2], pose: &[f64; 16]) -> f64 {
    (pose[4 * row] * sd_image[0]).hypot(pose[4 * row + 1] * sd_image[1]).max(1e-4)
}

fn result(
    state: State,
    decision: Decision,
    candidates: &[Candidate],
    echoes: &[Echo],
    track: &Track,
) -> FrameResult {
    let (state, number) = match (state, decision) {
        (State::Used, Decision::Used { echo }) => (State::Used, echo),
        (State::Used, Decision::NoEcho) => (State::NoEcho, 0),
        (State::Used, Decision::Ambiguous) => (State::Ambiguous, 0),
        (State::Used, Decision::Outlier { .. }) => (State::Outlier, 0),
        (rejected, _) => (rejected, 0),
    };
    let echo = echoes.get(number);
    FrameResult {
        state,
        time_s: None,
        motion: None,
        candidate: candidates.get(number).copied(),
        place_mm: echo.map(|echo| [echo.across_mm[0], echo.across_mm[1], echo.z_mm]),
        sd_mm: echo.map(|echo| [0, 1].map(|axis: usize| echo.sd_mm[axis] * track.noise[axis].scale)),
        off_mm: echo
            .map(|echo| [0, 1].map(|axis: usize| echo.across_mm[axis] - track.curves[axis].at(echo.z_mm))),
    }
}

/// Least and greatest brightness of every pixel over a sequence: text and marks of the screen never change.
#[derive(Default)]
struct Fixed {
    width: usize,
    least: Vec<u8>,
    most: Vec<u8>,
    frames: usize,
}

impl Fixed {
    /// Whether a frame has as many pixels as those before.
    fn fits(&self, frame: &Frame) -> bool {
        self.frames == 0 || (frame.width == self.width && frame.pixels.len() == self.most.len())
    }

    fn add(&mut self, frame: &Frame) {
        self.frames += 1;
        if self.frames == 1 {
            (self.width, self.least, self.most) = (frame.width, frame.pixels.clone(), frame.pixels.clone());
            return;
        }
        for ((least, most), pixel) in self.least.iter_mut().zip(&mut self.most).zip(&frame.pixels) {
            *least = (*least).min(*pixel);
            *most = (*most).max(*pixel);
        }
    }

    /// Whether the bright pixels of a candidate are the same in all frames.
    fn is_overlay(&self, candidate: &Candidate) -> bool {
        if self.frames < MIN_DISTINCT {
            return false;
        }
        let centre = &candidate.centre;
        let (mut bright, mut unchanged) = (0usize, 0usize);
        for y in pixel_range(centre.y_px, centre.height_px) {
            for x in pixel_range(centre.x_px, centre.width_px).filter(|x| *x < self.width) {
                let pixel_index = y * self.width + x;
                let (Some(least), Some(most)) = (self.least.get(pixel_index), self.most.get(pixel_index))
                else {
                    continue;
                };
                bright += usize::from(*most > 2 * DARK);
                unchanged += usize::from(*most > 2 * DARK && most - least <= 1);
            }
        }
        2 * unchanged > bright
    }
}

fn pixel_range(at: f64, size: f64) -> std::ops::RangeInclusive<usize> {
    (at - size).max(0.0) as usize..=(at + size).max(0.0) as usize
}

#[cfg(test)]
mod tests;
