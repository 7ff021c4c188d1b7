//! Guide 2 (and a fixed mark) followed through the frames of a camera: how many pixels it has moved since the first usable frame, with a
//! covariance that comes from the texture of the template and the noise that is left.
//!
//! 1. Normalised correlation finds the template to the nearest pixel: near where it was last, and in the whole frame
//!    where it is not there.
//! 2. Gauss-Newton steps find the translation to hundredths of a pixel ([`refine`]): the brightness of the template
//!    may have changed by a factor and an offset, nothing else of it.
//! 3. If the template has no texture in a direction, motion along it is not identifiable, and none is reported
//!    ([`texture`]).

mod correlate;
mod refine;
mod spline;
mod texture;

pub use refine::Translation;
pub use texture::Directions;

use crate::error::ImagingError;
use crate::frame::{Frame, Region};
use crate::read::Sequence;
use correlate::{Match, Template};
use refine::{Patch, RefineError};
use std::hash::{DefaultHasher, Hash, Hasher};

/// Least side of a template, pixels.
pub const MIN_SIDE: usize = 8;
/// Most pixels of a template.
pub const MAX_TEMPLATE: usize = 1 << 18;
/// Correlation below which the template is not in the frame.
pub const LOST_SCORE: f64 = 0.5;
/// Correlation below which what is found may be something else.
pub const LOW_SCORE: f64 = 0.8;
/// Largest standard deviation of a translation, pixels: a direction that is less certain has no texture.
pub const MAX_SD_PX: f64 = 0.1;

/// Object that is followed.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Settings {
    /// Part of the first frame that shows guide 2.
    pub template: Region,
    /// Part of the first frame that shows a mark that does not move, against camera shake.
    pub mark: Option<Region>,
}

/// Why a clip is not measured.
#[derive(Debug, thiserror::Error)]
pub enum CameraError {
    /// A file.
    #[error(transparent)]
    File(#[from] ImagingError),
    /// A template outside the frame, or of no size.
    #[error("{option} {},{},{},{}: is not inside the frames of {width} x {height} pixels, expected a part of them of {MIN_SIDE} x {MIN_SIDE} to \
             {MAX_TEMPLATE} pixels", region.x, region.y, region.width, region.height)]
    Outside {
        /// Option that gave it.
        option: &'static str,
        /// The part.
        region: Region,
        /// Pixels of a row.
        width: usize,
        /// Rows.
        height: usize,
    },
    /// A template in which motion is not identifiable.
    #[error(
        "{option}: has no texture along {direction}, so that motion along it is not identifiable (standard deviation {}), expected a part \
         of the image with edges in both directions, such as a corner or a printed pattern", sd_text(*sd_px)
    )]
    NoTexture {
        /// Option that gave it.
        option: &'static str,
        /// The direction in words.
        direction: String,
        /// Standard deviation that the translation along it would have.
        sd_px: f64,
    },
    /// Frames without content.
    #[error(
        "no frame can be used as the template: {black} of {count} frames are black, {saturated} saturated, {invalid} marked as unusable"
    )]
    NoTemplate {
        /// Frames in all.
        count: usize,
        /// Number of black ones.
        black: usize,
        /// Number of saturated ones.
        saturated: usize,
        /// Number of unusable ones.
        invalid: usize,
    },
    /// One frame has no motion.
    #[error(
        "{found} of {count} frames can be used, expected 2 or more: displacement is measured from the first"
    )]
    TooFew {
        /// Frames that can be used.
        found: usize,
        /// Frames in all.
        count: usize,
    },
}

fn sd_text(sd_px: f64) -> String {
    if sd_px.is_finite() {
        format!("{sd_px:.2} pixels, at most {MAX_SD_PX} is accepted")
    } else {
        "unlimited".to_owned()
    }
}

/// Result of a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum State {
    /// Its displacement is measured.
    Used,
    /// The template is not in it, or only a part of it.
    Lost,
    /// The best match differs too much to be the template with certainty: correlation below [`LOW_SCORE`].
    LowScore,
    /// The steps do not converge near what correlation found, or leave more than [`MAX_SD_PX`].
    NotConverged,
    /// The mark is lost or uncertain.
    MarkLost,
    /// A quarter of its pixels or more have the greatest brightness.
    Saturated,
    /// The same as the frame before, pixel by pixel: a camera's noise never repeats.
    Repeated,
    /// All pixels are dark.
    Black,
    /// The file marks it as unusable.
    Invalid,
    /// It has another size than the first one.
    OtherSize,
}

impl State {
    /// All of them.
    pub const ALL: [Self; 10] = [
        Self::Used,
        Self::Lost,
        Self::LowScore,
        Self::NotConverged,
        Self::MarkLost,
        Self::Saturated,
        Self::Repeated,
        Self::Black,
        Self::Invalid,
        Self::OtherSize,
    ];

    /// Name in documents.
    pub fn name(self) -> &'static str {
        match self {
            Self::Used => "used",
            Self::Lost => "lost",
            Self::LowScore => "low_score",
            Self::NotConverged => "not_converged",
            Self::MarkLost => "mark_lost",
            Self::Saturated => "saturated",
            Self::Repeated => "repeated",
            Self::Black => "black",
            Self::Invalid => "invalid",
            Self::OtherSize => "other_size",
        }
    }
}

/// One frame of a clip.
#[derive(Debug, Clone, PartialEq)]
pub struct FrameResult {
    /// Result of the frame.
    pub state: State,
    /// Time stamp.
    pub time_s: Option<f64>,
    /// Translation of the template since the template's frame, where it was found.
    pub template: Option<Translation>,
    /// Translation of the mark.
    pub mark: Option<Translation>,
}

/// A measured clip.
#[derive(Debug, Clone)]
pub struct Clip {
    /// Its frames, in order.
    pub frames: Vec<FrameResult>,
    /// Number of the frame that the templates are from.
    pub template_frame: usize,
    /// Directions in which motion of the template against the mark is identifiable.
    pub directions: Directions,
    /// Another place of the template's frame that looks like the template: pixels from it, and the correlation.
    pub alike: Option<([i64; 2], f64)>,
}

impl Clip {
    /// Number of frames in a state.
    pub fn count(&self, state: State) -> usize {
        self.frames.iter().filter(|frame| frame.state == state).count()
    }
}

/// A frame is dark below this brightness.
const DARK: u8 = 8;
/// Share of pixels of greatest brightness from which a frame is saturated.
const SATURATED: f64 = 0.25;
/// Correlation of another place from which it looks like the template.
const ALIKE_SCORE: f64 = 0.9;

/// Follows guide 2 through a clip. `on_frame` is called with the number of every frame that has been read.
///
/// # Errors
/// [`CameraError`].
pub fn measure(
    sequence: &mut Sequence,
    settings: &Settings,
    mut on_frame: impl FnMut(usize),
) -> Result<Clip, CameraError> {
    let header = sequence.header().clone();
    let size = [header.width, header.height];
    check(settings.template, "--template", size)?;
    settings.mark.map_or(Ok(()), |mark| check(mark, "--mark", size))?;
    let mut follower: Option<Follower> = None;
    let mut frames: Vec<FrameResult> = Vec::new();
    let mut previous_hash = None;
    for number in 0.. {
        let Some(frame) = sequence.next_frame()? else { break };
        let fields = header.frames.get(number);
        let time_s = fields.and_then(|fields| fields.time_s);
        let mut result = FrameResult {
            state: content(&frame, size, &mut previous_hash),
            time_s,
            template: None,
            mark: None,
        };
        if fields.is_some_and(|fields| fields.is_invalid) {
            result.state = State::Invalid;
        }
        if result.state == State::Used {
            match &mut follower {
                Some(follower) => follower.follow(&frame, &mut result),
                None => {
                    let started = Follower::start(&frame, settings, number)?;
                    result.template = Some(started.template.own());
                    result.mark = started.mark.as_ref().map(Followed::own);
                    follower = Some(started);
                }
            }
        }
        frames.push(result);
        on_frame(number);
    }
    let Some(follower) = follower else {
        let (black, saturated, invalid) = (
            count_in_state(State::Black, &frames),
            count_in_state(State::Saturated, &frames),
            count_in_state(State::Invalid, &frames),
        );
        return Err(CameraError::NoTemplate { count: frames.len(), black, saturated, invalid });
    };
    follower.template.check_noise("--template", frames.iter().filter_map(|frame| frame.template))?;
    if let Some(mark) = &follower.mark {
        mark.check_noise("--mark", frames.iter().filter_map(|frame| frame.mark))?;
    }
    if count_in_state(State::Used, &frames) < 2 {
        return Err(CameraError::TooFew { found: count_in_state(State::Used, &frames), count: frames.len() });
    }
    let Follower { number, template, mark, alike } = follower;
    let texture = template.patch.directions;
    let directions = mark.and_then(|mark| texture.both(mark.patch.directions)).unwrap_or(texture);
    Ok(Clip { frames, template_frame: number, directions, alike })
}

fn count_in_state(state: State, frames: &[FrameResult]) -> usize {
    frames.iter().filter(|frame| frame.state == state).count()
}

/// Whether a part lies in the frames and is large enough.
fn check(region: Region, option: &'static str, [width, height]: [usize; 2]) -> Result<(), CameraError> {
    let is_inside =
        fits_within(region.x, region.width, width) && fits_within(region.y, region.height, height);
    let is_sized = region.width >= MIN_SIDE
        && region.height >= MIN_SIDE
        && region.width.checked_mul(region.height).is_some_and(|pixels| pixels <= MAX_TEMPLATE);
    if is_inside && is_sized { Ok(()) } else { Err(CameraError::Outside { option, region, width, height }) }
}

fn fits_within(from: usize, size: usize, all: usize) -> bool {
    from.checked_add(size).is_some_and(|end| end <= all)
}

/// State of a frame before any search in it.
fn content(frame: &Frame, size: [usize; 2], before: &mut Option<u64>) -> State {
    if [frame.width, frame.height] != size || frame.pixels.len() != size[0] * size[1] {
        return State::OtherSize;
    }
    let mut hasher = DefaultHasher::new();
    frame.pixels.hash(&mut hasher);
    let hash = hasher.finish();
    let is_repeated = *before == Some(hash);
    *before = Some(hash);
    let full = frame.pixels.iter().filter(|pixel| **pixel == u8::MAX).count();
    if frame.pixels.iter().all(|pixel| *pixel < DARK) {
        State::Black
    } else if full as f64 >= SATURATED * frame.pixels.len() as f64 {
        State::Saturated
    } else if is_repeated {
        State::Repeated
    } else {
        State::Used
    }
}

/// A part of the first frame that is followed, and where it was last.
struct Followed {
    template: Template,
    patch: Patch,
    at: [i64; 2],
}

impl Followed {
    fn new(frame: &Frame, region: Region, option: &'static str) -> Result<Self, CameraError> {
        let patch = Patch::new(frame, region, option)?;
        Ok(Self { template: Template::new(frame, region), patch, at: [0, 0] })
    }

    /// The template in its own frame.
    fn own(&self) -> Translation {
        self.patch.own()
    }

    /// Translation in a frame, or what became of it.
    fn find(&mut self, frame: &Frame) -> (State, Option<Translation>) {
        let free = self.patch.directions.free();
        let nearby_match = self.template.near(frame, self.at, free);
        let best_match = match nearby_match {
            Some(found) if found.score >= LOW_SCORE && !found.is_at_edge => Some(found),
            nearby_match => {
                let anywhere = self.template.anywhere(frame, free);
                [nearby_match, anywhere].into_iter().flatten().max_by(|a, b| a.score.total_cmp(&b.score))
            }
        };
        let Some(Match { shift, score, .. }) = best_match.filter(|best_match| best_match.score >= LOST_SCORE)
        else {
            return (State::Lost, None);
        };
        match self.patch.refine(frame, shift) {
            Ok(translation) if translation.score < LOW_SCORE => (State::LowScore, Some(translation)),
            Ok(translation) => {
                self.at = shift;
                (State::Used, Some(translation))
            }
            Err(RefineError::Outside) => (State::Lost, None),
            Err(RefineError::NotConverged) if score < LOW_SCORE => (State::LowScore, None),
            Err(RefineError::NotConverged) => (State::NotConverged, None),
        }
    }

    /// Refuses a template whose texture is no more than its noise, which shows in the frames only.
    fn check_noise(
        &self,
        option: &'static str,
        found: impl Iterator<Item = Translation>,
    ) -> Result<(), CameraError> {
        let residuals: Vec<f64> =
            found.map(|found| found.residual).filter(|residual| *residual > 0.0).collect();
        self.patch.check_noise(option, &residuals)
    }
}

/// Template and mark.
struct Follower {
    number: usize,
    template: Followed,
    mark: Option<Followed>,
    alike: Option<([i64; 2], f64)>,
}

impl Follower {
    fn start(frame: &Frame, settings: &Settings, number: usize) -> Result<Self, CameraError> {
        let template = Followed::new(frame, settings.template, "--template")?;
        let mark = settings.mark.map(|mark| Followed::new(frame, mark, "--mark")).transpose()?;
        if let Some(mark) = &mark {
            template.patch.directions.both(mark.patch.directions).ok_or_else(|| CameraError::NoTexture {
                option: "--mark",
                direction: "the direction in which the template has it".to_owned(),
                sd_px: f64::INFINITY,
            })?;
        }
        let alike = template.template.elsewhere(frame).filter(|found| found.score >= ALIKE_SCORE);
        Ok(Self { number, template, mark, alike: alike.map(|found| (found.shift, found.score)) })
    }

    fn follow(&mut self, frame: &Frame, result: &mut FrameResult) {
        (result.state, result.template) = self.template.find(frame);
        if let Some(mark) = &mut self.mark {
            let (state, translation) = mark.find(frame);
            result.mark = translation;
            if state != State::Used && result.state == State::Used {
                result.state = State::MarkLost;
            }
        }
    }
}

#[cfg(test)]
mod tests;
