//! Whether what a tracker sends of a needle is a measurement: trackers go on sending poses that are none, and state it in several ways.
//!
//! * The metadata of header version 2: PLUS and SlicerOpenIGTLink put `TransformStatus` (`OK`, `MISSING`, `OUT_OF_VIEW` ...) or
//!   `TransformValid` there, for images `ImageStatus`.
//! * A STATUS message with the name of the pose, or without a name, whose code is not 1; it holds until the next one.
//! * A position of exactly 0, 0, 0, which real readings never have.
//! * A stamp that is not later than the one before: the tracker sends its last reading again, or its clock was set back.

use super::message::{Content, Pose, STATUS_OK};
use std::collections::BTreeMap;
use std::time::Duration;

/// Most names for which stamps and statuses are kept: they come from the peer.
const MAX_NAMES: usize = 64;
/// Letters of a device's name in a header.
const DEVICE_LETTERS: usize = 20;
/// Axes of a frame are unit vectors at right angles, as far as a sender rounds them.
const ROUNDING: f32 = 1e-2;

/// Statement about validity in the metadata of a message: the field and its value, where it is not
/// valid.
pub(super) fn stated_invalid(device: &str, metadata: &[(String, String)]) -> Option<String> {
    let bad = metadata.iter().find(|(key, value)| {
        let key = bare(key).to_lowercase();
        let is_of = |ending: &str| key.strip_suffix(ending).is_some_and(|name| is_about(name, device));
        let value = bare(value);
        let is_yes = ["true", "1", "yes", "ok"].iter().any(|yes| value.eq_ignore_ascii_case(yes));
        is_of("status") && !value.eq_ignore_ascii_case("OK") || is_of("valid") && !is_yes
    });
    bad.map(|(key, value)| format!("{} = {}", short(key), short(value)))
}

/// Whether a field with this name in small letters before its last word is about a device, or about the message as a whole.
fn is_about(name: &str, device: &str) -> bool {
    if ["", "transform", "image", "position", "point", "pose", "tool", "tracking"].contains(&name) {
        return true;
    }
    let (device, name) = (device.to_lowercase(), name.strip_suffix("transform").unwrap_or(name));
    // A header has room for so many letters of a name, its metadata for all of them.
    name == device || device.len() == DEVICE_LETTERS && name.starts_with(&device)
}

/// A text without blanks and zeros around it.
fn bare(text: &str) -> &str {
    text.trim_matches(|letter: char| letter.is_whitespace() || letter == '\0')
}

fn short(text: &str) -> String {
    bare(text).chars().take(40).collect()
}

/// Relation of consecutive stamps of one name.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Clock {
    /// Later than before, or not stated.
    On,
    /// The same as before.
    Same,
    /// Earlier than before: from here on it is another clock.
    Back,
}

/// State of the poses that a tracker sends.
#[derive(Debug, Default)]
pub(super) struct Tracked {
    stamps: BTreeMap<String, Duration>,
    /// Names whose last STATUS was not OK, with what it stated.
    statuses: BTreeMap<String, String>,
    /// Messages that were not used, by name.
    unused: BTreeMap<String, u64>,
}

impl Tracked {
    /// A STATUS message has arrived.
    pub fn status(&mut self, device: &str, code: u16, words: &str) {
        if code == STATUS_OK {
            self.statuses.remove(device);
        } else if self.statuses.len() < MAX_NAMES {
            self.statuses.insert(device.to_owned(), format!("STATUS {code} {}", short(words)));
        }
    }

    /// Message of the last STATUS of this name, or of the whole tracker, if it is not OK.
    pub fn bad_status(&self, device: &str) -> Option<&str> {
        self.statuses.get(device).or_else(|| self.statuses.get("")).map(String::as_str)
    }

    /// Relation of a stamp to the previous one of its name.
    pub fn clock(&mut self, device: &str, stamp: Duration) -> Clock {
        if stamp.is_zero() || self.stamps.len() >= MAX_NAMES && !self.stamps.contains_key(device) {
            return Clock::On;
        }
        let previous = self.stamps.insert(device.to_owned(), stamp);
        match previous.map(|previous| stamp.cmp(&previous)) {
            Some(std::cmp::Ordering::Equal) => Clock::Same,
            Some(std::cmp::Ordering::Less) => Clock::Back,
            _ => Clock::On,
        }
    }

    /// Counts a message that is not used.
    pub fn count(&mut self, device: &str) {
        if self.unused.len() < MAX_NAMES || self.unused.contains_key(device) {
            *self.unused.entry(device.to_owned()).or_default() += 1;
        }
    }

    /// Messages that were not used, by name.
    pub fn unused(&self) -> impl Iterator<Item = (&str, u64)> {
        self.unused.iter().map(|(name, count)| (name.as_str(), *count))
    }
}

/// Why a content is no measurement, as far as it shows that itself.
pub(super) fn problem(content: &Content) -> Option<&'static str> {
    fn is_zero(position_mm: [f32; 3]) -> bool {
        position_mm == [0.0; 3]
    }
    match content {
        Content::Transform(pose) | Content::Position(pose) if is_zero(pose.position_mm) => {
            Some("its position is 0, 0, 0: the tracker does not see it")
        }
        Content::Transform(pose) if !is_rotation(pose) => {
            Some("its axes are no rotation, expected three unit vectors column by column, then the position")
        }
        Content::Points(points) if !points.is_empty() && points.iter().all(|p| is_zero(p.position_mm)) => {
            Some("all of its points are 0, 0, 0: the tracker does not see it")
        }
        _ => None,
    }
}

/// Whether the axes of a pose are those of a rotation.
fn is_rotation(pose: &Pose) -> bool {
    let axes = nalgebra::Matrix3::from_columns(&pose.axes.map(Into::into));
    let deviation = axes.transpose() * axes - nalgebra::Matrix3::identity();
    deviation.amax() < ROUNDING && axes.determinant() > 0.0
}
