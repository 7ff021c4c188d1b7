//! Position of the image plane when a frame is taken: from frame number, time, a field of the file or its
//! transforms.
//!
//! The session's frame: z along the needle from guide 1, x horizontal, y up. An image, oriented as [`crate::frame::Orientation`] states,
//! has x towards the probe's marker and its second axis away from the probe; the probe is above the needle where nothing else is stated.

use crate::frame::FrameFields;

/// Source of the image plane's position along the needle.
#[derive(Debug, Clone, PartialEq)]
pub enum Place {
    /// The same distance from frame to frame.
    Step {
        /// Position of the first frame, millimetres.
        start_mm: f64,
        /// From one frame to the next.
        step_mm: f64,
    },
    /// Constant speed, with the time stamps of the file.
    Speed {
        /// Position of the first frame, millimetres.
        start_mm: f64,
        /// Speed.
        mm_per_s: f64,
    },
    /// A number that the file has for each frame, millimetres.
    Field {
        /// Its name behind `Seq_Frame0000_`.
        name: String,
        /// Position of the first frame, millimetres.
        start_mm: f64,
        /// 1 where the number grows into the tissue, -1 otherwise.
        sign: f64,
    },
    /// A transform that the file has for each frame, from the probe to a tracker.
    Transform {
        /// Its name without `Transform`.
        name: String,
        /// From the image (millimetres, corner of the first pixel) to the probe.
        image_to_probe: Box<[f64; 16]>,
        /// From the tracker to the session's frame.
        tracker_to_guide: Box<[f64; 16]>,
    },
}

/// Why a frame has no place.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum PlaceError {
    /// No time stamps.
    #[error(
        "no time stamps in the file, expected them for a speed: give the distance of frames instead (--step-mm)"
    )]
    NoTime,
    /// A clock that is set back, or stands still.
    #[error(
        "frame {frame}: a time stamp of {time_s} s after {before_s} s, expected one that is later: were two recordings joined?"
    )]
    Clock {
        /// Number of the frame, from 1.
        frame: usize,
        /// Its stamp.
        time_s: f64,
        /// The latest stamp before it.
        before_s: f64,
    },
    /// A clock that shows too few digits.
    #[error(
        "{repeated} of {frames} frames have the time stamp of the frame before, expected stamps that tell frames apart: give the distance of \
         frames instead (--step-mm)"
    )]
    Coarse {
        /// Frames with the stamp of the one before.
        repeated: usize,
        /// Frames with a stamp.
        frames: usize,
    },
    /// A lag without times.
    #[error(
        "a lag between images and positions, but no time stamps that tell frames apart, expected none (--lag-s 0)"
    )]
    LagWithoutTime,
    /// A probe that does not move.
    #[error(
        "{name} is the same in all {frames} frames, expected the position of a probe that moves: did the tracker see it?"
    )]
    Still {
        /// The transform or field.
        name: String,
        /// Frames that have it.
        frames: usize,
    },
    /// No such field.
    #[error("no frame has the field {name}, expected one of: {known}")]
    NoField {
        /// Requested name.
        name: String,
        /// Names that exist.
        known: String,
    },
}

/// Orientation and motion of the image plane when a frame is taken.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Motion {
    /// Direction in which the beam leaves the probe, across the needle: from x towards y, radians.
    pub beam_rad: f64,
    /// Speed of the probe along the needle; 0 where the file has no times.
    pub mm_per_s: f64,
}

/// From an image in millimetres to the session's frame.
pub type Pose = [f64; 16];

/// Neither turned nor moved.
pub const IDENTITY: Pose = [1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0];

/// The last row of a homogeneous transform is 0, 0, 0, 1 but for rounding.
const ROUNDING: f64 = 1e-6;

/// A homogeneous transform that is given by rows or by columns, by rows: its last row decides. None where it has no such row.
pub fn by_rows(numbers: [f64; 16]) -> Option<Pose> {
    if numbers.iter().any(|number| !number.is_finite()) {
        return None;
    }
    let mut transposed = numbers;
    transposed.iter_mut().enumerate().for_each(|(at, value)| *value = numbers[4 * (at % 4) + at / 4]);
    [numbers, transposed]
        .into_iter()
        .find(|matrix| is_last_row([matrix[12], matrix[13], matrix[14], matrix[15]]))
}

fn is_last_row(row: [f64; 4]) -> bool {
    row.iter().zip([0.0, 0.0, 0.0, 1.0]).all(|(a, b)| (a - b).abs() < ROUNDING)
}

/// Readings before and after a frame over which the speed of the probe is taken.
const SPEED_READINGS: usize = 2;

/// An image across the needle at a position along it.
fn across(z_mm: f64) -> Pose {
    [1.0, 0.0, 0.0, 0.0, 0.0, -1.0, 0.0, 0.0, 0.0, 0.0, 1.0, z_mm, 0.0, 0.0, 0.0, 1.0]
}

/// Poses of frames over time.
#[derive(Debug, Clone)]
pub struct Poses {
    /// Pose with the frame's own reading; none where the file has none.
    own: Vec<Option<Pose>>,
    /// Readings in order of time, where there are times.
    series: Vec<(f64, Pose)>,
    times_s: Vec<Option<f64>>,
}

impl Poses {
    /// Motion of so many frames.
    ///
    /// # Errors
    /// [`PlaceError`] where the file does not have what the place is computed from.
    pub fn new(count: usize, fields: &[FrameFields], place: &Place) -> Result<Self, PlaceError> {
        let mut times_s: Vec<Option<f64>> =
            (0..count).map(|i| fields.get(i).and_then(|frame| frame.time_s)).collect();
        // If the frame number determines the position, no time is needed.
        match (place, clock(&times_s)) {
            (_, Ok(())) => {}
            // A position of its own needs a time for nothing but a lag.
            (Place::Step { .. }, Err(_))
            | (Place::Field { .. } | Place::Transform { .. }, Err(PlaceError::Coarse { .. })) => {
                times_s.fill(None)
            }
            (_, Err(error)) => return Err(error),
        }
        let frame_poses: Vec<Option<Pose>> = match place {
            Place::Step { start_mm, step_mm } => {
                (0..count).map(|i| Some(across(start_mm + step_mm * i as f64))).collect()
            }
            Place::Speed { start_mm, mm_per_s } => {
                let first_s = times_s.iter().flatten().next().copied().ok_or(PlaceError::NoTime)?;
                // A stamp once more is no place of its own.
                let mut previous_s = f64::NEG_INFINITY;
                let mut own = |time_s: f64| {
                    let is_new = time_s > previous_s;
                    previous_s = time_s;
                    is_new.then(|| across(start_mm + mm_per_s * (time_s - first_s)))
                };
                times_s.iter().map(|time_s| time_s.and_then(&mut own)).collect()
            }
            Place::Field { name, start_mm, sign } => {
                let value = |frame: &FrameFields| frame.numbers.get(name).copied();
                let Some(first) = fields.iter().find_map(value) else {
                    let known = names(fields.iter().flat_map(|frame| frame.numbers.keys()));
                    return Err(PlaceError::NoField { name: name.clone(), known });
                };
                still(name, fields.iter().filter_map(value))?;
                (0..count)
                    .map(|i| {
                        fields.get(i).and_then(value).map(|value| across(start_mm + sign * (value - first)))
                    })
                    .collect()
            }
            Place::Transform { name, image_to_probe, tracker_to_guide } => {
                let value = |frame: &FrameFields| frame.transforms.get(name).copied();
                if fields.iter().find_map(value).is_none() {
                    let known = names(fields.iter().flat_map(|frame| frame.transforms.keys()));
                    return Err(PlaceError::NoField { name: name.clone(), known });
                }
                still(name, fields.iter().filter_map(value))?;
                (0..count)
                    .map(|i| {
                        fields
                            .get(i)
                            .and_then(value)
                            .map(|probe| product(tracker_to_guide, &product(&probe, image_to_probe)))
                    })
                    .collect()
            }
        };
        let mut series: Vec<(f64, Pose)> = times_s
            .iter()
            .zip(&frame_poses)
            .filter_map(|(time_s, pose)| Some(((*time_s)?, (*pose)?)))
            .collect();
        series.sort_by(|a, b| a.0.total_cmp(&b.0));
        Ok(Self { own: frame_poses, series, times_s })
    }

    /// Whether a lag between images and readings can be taken into account.
    pub fn has_times(&self) -> bool {
        self.series.len() > 1
    }

    /// Places along the needle of the readings, in the order of their times, millimetres.
    pub fn along_mm(&self) -> impl Iterator<Item = f64> + '_ {
        self.series.iter().map(|(_, pose)| pose[11])
    }

    /// Time stamp of a frame.
    pub fn time_s(&self, frame: usize) -> Option<f64> {
        self.times_s.get(frame).copied().flatten()
    }

    /// Direction of the beam and speed of the probe at a frame, where readings lag behind images.
    pub fn motion(&self, frame: usize, lag_s: f64) -> Option<Motion> {
        let pose = self.of(frame, lag_s)?;
        let at_s = self.time_s(frame).map(|time_s| time_s + lag_s);
        let mm_per_s = at_s.and_then(|at_s| {
            let next_index = self.series.partition_point(|(reading_s, _)| *reading_s < at_s);
            let last = self.series.len().checked_sub(1)?;
            let (first, last) =
                (next_index.saturating_sub(SPEED_READINGS), (next_index + SPEED_READINGS).min(last));
            let (earlier, later) = (self.series.get(first)?, self.series.get(last)?);
            let span_s = later.0 - earlier.0;
            (span_s > 0.0).then(|| (later.1[11] - earlier.1[11]) / span_s)
        });
        Some(Motion { beam_rad: pose[5].atan2(pose[1]), mm_per_s: mm_per_s.unwrap_or(0.0) })
    }

    /// Pose of a frame where readings of the position lag behind images: those of a later time are interpolated linearly.
    pub fn of(&self, frame: usize, lag_s: f64) -> Option<Pose> {
        let frame_pose = self.own.get(frame).copied().flatten();
        let time_s = self.times_s.get(frame).copied().flatten();
        let (Some(time_s), true) = (time_s, lag_s != 0.0 && self.has_times()) else { return frame_pose };
        frame_pose?;
        let at_s = time_s + lag_s;
        let next_index = self.series.partition_point(|(reading_s, _)| *reading_s < at_s);
        let (earlier, later) = match next_index {
            0 => (self.series.first()?, self.series.first()?),
            next_index if next_index >= self.series.len() => (self.series.last()?, self.series.last()?),
            next_index => (self.series.get(next_index - 1)?, self.series.get(next_index)?),
        };
        let span_s = later.0 - earlier.0;
        let fraction = if span_s > 0.0 { (at_s - earlier.0) / span_s } else { 0.0 };
        let mut pose = earlier.1;
        pose.iter_mut().zip(later.1).for_each(|(value, later)| *value += fraction * (later - *value));
        Some(pose)
    }
}

/// Whether stamps never go back, do not all stand still, and tell frames apart. A stamp once more is that of a frame that was sent
/// twice; more of them than others, or any of whole seconds, are those of a clock that shows too few digits.
pub(crate) fn clock(times_s: &[Option<f64>]) -> Result<(), PlaceError> {
    let (mut previous, mut first_repeat, mut repeated, mut frames) = (None, None, 0, 0);
    for (frame, time_s) in times_s.iter().enumerate().filter_map(|(frame, time_s)| Some((frame, (*time_s)?)))
    {
        frames += 1;
        if let Some(previous_s) = previous.replace(time_s) {
            let error = PlaceError::Clock { frame: frame + 1, time_s, before_s: previous_s };
            match time_s.total_cmp(&previous_s) {
                std::cmp::Ordering::Less => return Err(error),
                std::cmp::Ordering::Equal => {
                    repeated += 1;
                    first_repeat.get_or_insert(error);
                }
                std::cmp::Ordering::Greater => {}
            }
        }
    }
    let is_whole = times_s.iter().flatten().all(|time_s| time_s.fract() == 0.0);
    match first_repeat {
        Some(error) if repeated + 1 == frames => Err(error),
        Some(_) if is_whole || 2 * repeated > frames => Err(PlaceError::Coarse { repeated, frames }),
        _ => Ok(()),
    }
}

/// Refuses readings of a probe that are all the same.
fn still<T: PartialEq>(name: &str, readings: impl Iterator<Item = T>) -> Result<(), PlaceError> {
    let readings: Vec<T> = readings.collect();
    let is_still = readings.len() > 1 && readings.windows(2).all(|pair| pair[0] == pair[1]);
    if is_still {
        return Err(PlaceError::Still { name: name.to_owned(), frames: readings.len() });
    }
    Ok(())
}

/// A point of the image in the session's frame, millimetres: x, y, z.
pub fn placed(pose: &Pose, image_mm: [f64; 2]) -> [f64; 3] {
    [0, 1, 2]
        .map(|row: usize| pose[4 * row] * image_mm[0] + pose[4 * row + 1] * image_mm[1] + pose[4 * row + 3])
}

/// Two transforms, the second one first.
pub(crate) fn product(a: &[f64; 16], b: &[f64; 16]) -> [f64; 16] {
    let mut product = [0.0; 16];
    for (place, value) in product.iter_mut().enumerate() {
        let (row, column) = (place / 4, place % 4);
        *value = (0..4).map(|k| a[4 * row + k] * b[4 * k + column]).sum();
    }
    product
}

/// The transform back; none where there is none.
pub(crate) fn inverse(pose: &Pose) -> Option<Pose> {
    let inverse = nalgebra::Matrix4::from_row_slice(pose).try_inverse()?;
    let mut inverted = [0.0; 16];
    inverted.iter_mut().enumerate().for_each(|(place, value)| *value = inverse[(place / 4, place % 4)]);
    Some(inverted)
}

fn names<'a>(names: impl Iterator<Item = &'a String>) -> String {
    let mut names: Vec<&str> = names.map(String::as_str).collect();
    names.sort_unstable();
    names.dedup();
    if names.is_empty() { "none".to_owned() } else { names.join(", ") }
}

#[cfg(test)]
mod tests;
