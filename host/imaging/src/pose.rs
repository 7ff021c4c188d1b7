//! Where the image plane is when a frame is taken: from frame number, time, a field of the file or its transforms.
//!
//! The session's frame: z along the needle from guide 1, x horizontal, y up. An image, oriented as [`crate::frame::Orientation`] states,
//! has x towards the probe's marker and its second axis away from the probe; the probe is above the needle where nothing else is stated.

use crate::frame::FrameFields;

/// What gives the position of the image plane along the needle.
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
    /// No such field.
    #[error("no frame has the field {name}, expected one of: {known}")]
    NoField {
        /// What was requested.
        name: String,
        /// What there is.
        known: String,
    },
}

/// How the image plane looks and moves when a frame is taken.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Motion {
    /// Direction in which the beam leaves the probe, across the needle: from x towards y, radians.
    pub beam_rad: f64,
    /// Speed of the probe along the needle; 0 where the file has no times.
    pub mm_per_s: f64,
}

/// From an image in millimetres to the session's frame.
pub type Pose = [f64; 16];

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
    /// Of so many frames.
    ///
    /// # Errors
    /// [`PlaceError`] where the file does not have what the place is computed from.
    pub fn new(count: usize, fields: &[FrameFields], place: &Place) -> Result<Self, PlaceError> {
        let times_s: Vec<Option<f64>> =
            (0..count).map(|i| fields.get(i).and_then(|frame| frame.time_s)).collect();
        let own: Vec<Option<Pose>> = match place {
            Place::Step { start_mm, step_mm } => {
                (0..count).map(|i| Some(across(start_mm + step_mm * i as f64))).collect()
            }
            Place::Speed { start_mm, mm_per_s } => {
                let first_s = times_s.iter().flatten().next().copied().ok_or(PlaceError::NoTime)?;
                times_s
                    .iter()
                    .map(|time_s| time_s.map(|time_s| across(start_mm + mm_per_s * (time_s - first_s))))
                    .collect()
            }
            Place::Field { name, start_mm, sign } => {
                let value = |frame: &FrameFields| frame.numbers.get(name).copied();
                let Some(first) = fields.iter().find_map(value) else {
                    let known = names(fields.iter().flat_map(|frame| frame.numbers.keys()));
                    return Err(PlaceError::NoField { name: name.clone(), known });
                };
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
                let chain = |probe: Pose| product(tracker_to_guide, &product(&probe, image_to_probe));
                (0..count).map(|i| fields.get(i).and_then(value).map(chain)).collect()
            }
        };
        let mut series: Vec<(f64, Pose)> =
            times_s.iter().zip(&own).filter_map(|(time_s, pose)| Some(((*time_s)?, (*pose)?))).collect();
        series.sort_by(|a, b| a.0.total_cmp(&b.0));
        Ok(Self { own, series, times_s })
    }

    /// Whether a lag between images and readings can be taken into account.
    pub fn has_times(&self) -> bool {
        self.series.len() > 1
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
            let behind = self.series.partition_point(|(reading_s, _)| *reading_s < at_s);
            let last = self.series.len().checked_sub(1)?;
            let (first, last) = (behind.saturating_sub(SPEED_READINGS), (behind + SPEED_READINGS).min(last));
            let (before, after) = (self.series.get(first)?, self.series.get(last)?);
            let span_s = after.0 - before.0;
            (span_s > 0.0).then(|| (after.1[11] - before.1[11]) / span_s)
        });
        Some(Motion { beam_rad: pose[5].atan2(pose[1]), mm_per_s: mm_per_s.unwrap_or(0.0) })
    }

    /// Pose of a frame where readings of the position lag behind images: those of a later time are interpolated linearly.
    pub fn of(&self, frame: usize, lag_s: f64) -> Option<Pose> {
        let own = self.own.get(frame).copied().flatten();
        let time_s = self.times_s.get(frame).copied().flatten();
        let (Some(time_s), true) = (time_s, lag_s != 0.0 && self.has_times()) else { return own };
        own?;
        let at_s = time_s + lag_s;
        let behind = self.series.partition_point(|(reading_s, _)| *reading_s < at_s);
        let (before, after) = match behind {
            0 => (self.series.first()?, self.series.first()?),
            behind if behind >= self.series.len() => (self.series.last()?, self.series.last()?),
            behind => (self.series.get(behind - 1)?, self.series.get(behind)?),
        };
        let span_s = after.0 - before.0;
        let share = if span_s > 0.0 { (at_s - before.0) / span_s } else { 0.0 };
        let mut pose = before.1;
        pose.iter_mut().zip(after.1).for_each(|(value, after)| *value += share * (after - *value));
        Some(pose)
    }
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
    let mut back = [0.0; 16];
    back.iter_mut().enumerate().for_each(|(place, value)| *value = inverse[(place / 4, place % 4)]);
    Some(back)
}

fn names<'a>(names: impl Iterator<Item = &'a String>) -> String {
    let mut names: Vec<&str> = names.map(String::as_str).collect();
    names.sort_unstable();
    names.dedup();
    if names.is_empty() { "none".to_owned() } else { names.join(", ") }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn frame(time_s: f64, position: f64) -> FrameFields {
        FrameFields {
            time_s: Some(time_s),
            numbers: [("Probe".to_owned(), position)].into(),
            ..FrameFields::default()
        }
    }

    #[test]
    fn positions_that_lag_are_read_later() {
        let fields: Vec<FrameFields> = (0..5).map(|i| frame(f64::from(i), 10.0 * f64::from(i))).collect();
        let place = Place::Field { name: "Probe".to_owned(), start_mm: 70.0, sign: 1.0 };
        let poses = Poses::new(5, &fields, &place).expect("the field is there");
        let z_mm = |frame, lag_s| placed(&poses.of(frame, lag_s).expect("a pose"), [1.0, 2.0]);
        assert_eq!(z_mm(3, 0.0), [1.0, -2.0, 100.0]);
        assert!((z_mm(3, 0.25)[2] - 102.5).abs() < 1e-9);
        assert_eq!(z_mm(4, 0.25)[2], 110.0);
        // The probe is above the needle.
        let Motion { beam_rad, mm_per_s } = poses.motion(3, 0.25).expect("a pose");
        assert!((beam_rad.to_degrees() + 90.0).abs() < 1e-9 && (mm_per_s - 10.0).abs() < 1e-9);
    }

    #[test]
    fn names_the_fields_there_are() {
        let place = Place::Field { name: "Stage".to_owned(), start_mm: 0.0, sign: 1.0 };
        let error = Poses::new(1, &[frame(0.0, 1.0)], &place).expect_err("no such field");
        assert!(error.to_string().contains("expected one of: Probe"), "{error}");
    }

    #[test]
    fn transforms_are_chained_from_image_to_guide() {
        let mut turned = across(5.0);
        turned[3] = 2.0;
        let fields = FrameFields {
            transforms: [("ProbeToTracker".to_owned(), turned)].into(),
            ..FrameFields::default()
        };
        let mut shift = across(0.0);
        shift[11] = 100.0;
        let place = Place::Transform {
            name: "ProbeToTracker".to_owned(),
            image_to_probe: Box::new(across(0.0)),
            tracker_to_guide: Box::new(shift),
        };
        let poses = Poses::new(1, &[fields], &place).expect("the transform is there");
        assert_eq!(placed(&poses.of(0, 0.0).expect("a pose"), [1.0, 3.0]), [3.0, -3.0, 105.0]);
    }
}
