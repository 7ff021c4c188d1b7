//! A tracker as the ultrasound of a recording: its points and tips become sweeps, at times of the device's clock.

use super::clock::Clocks;
use super::message::{Content, Message};
use super::source::{ConnectionEvent, Source};
use super::tracked::{Clock, Tracked, problem};
use super::{IgtlError, Pose};
use crate::link::Batch;
use crate::sweep::Sweep;
use formats::session::ShapeRow;
use formats::session::import::Frame;
use std::collections::BTreeSet;
use std::time::Instant;

/// The usual name of the tip's TRANSFORM.
pub const TIP_DEVICE_NAME: &str = "NeedleTipToReference";
/// Range of [`Settings::delay_s`].
pub const DELAY_RANGE_S: [f64; 2] = [0.0, 10.0];
/// Most different remarks: their words come from the peer.
const MAX_NOTES: usize = 32;

/// Settings of a tracker, and the needle's position for it.
#[derive(Debug, Clone, PartialEq)]
pub struct Settings {
    /// Device name of the POINT messages that are the needle's shape; any where none is given.
    pub shape: Option<String>,
    /// Device name of the TRANSFORM or POSITION messages that are the needle's tip.
    pub tip: String,
    /// Time from the measurement to the stamp of its message.
    pub delay_s: f64,
    /// The session's frame in the tracker's.
    pub frame: Frame,
}

/// Data that the tracker has sent.
#[derive(Debug, Clone, PartialEq)]
pub enum Observation {
    /// Shape of the needle at the times of its samples.
    Shape(Sweep),
    /// A remark for the user; each is reported once.
    Note(String),
}

/// A tracker whose messages are received.
#[derive(Debug)]
pub struct Channel {
    source: Source,
    settings: Settings,
    clocks: Clocks,
    tracked: Tracked,
    noted: BTreeSet<String>,
    reported_dropped: u64,
}

impl Channel {
    /// Connects to `HOST[:PORT]`.
    ///
    /// # Errors
    /// [`IgtlError`].
    pub fn connect(address: &str, settings: Settings) -> Result<Self, IgtlError> {
        let source = Source::connect(address)?;
        let clocks = Clocks::new(Instant::now());
        let tracked = Tracked::default();
        Ok(Self { source, settings, clocks, tracked, noted: BTreeSet::new(), reported_dropped: 0 })
    }

    /// Samples of the device have just arrived: they have the time of its clock.
    pub fn samples(&mut self, batch: &Batch) {
        self.clocks.samples(batch, Instant::now());
    }

    /// Observations since the last poll, in the order of arrival. Never waits. There is no shape before the first
    /// sample.
    pub fn poll(&mut self) -> Vec<Observation> {
        let news: Vec<ConnectionEvent> = self.source.news().collect();
        let mut observed = Vec::new();
        for news in news {
            let note = match news {
                ConnectionEvent::Message(message, at) => {
                    let mut note = None;
                    match self.shape(&message, at, &mut note) {
                        Ok(shape) => observed.extend(shape.map(Observation::Shape)),
                        Err(why) => note = Some(why),
                    }
                    note
                }
                ConnectionEvent::Unreadable(why) => Some(format!("a message is skipped: {why}")),
                ConnectionEvent::Skipped(kind, device) => Some(format!("{kind} `{device}` is not used")),
                ConnectionEvent::Invalid(kind, device, stated) => {
                    let is_used = self.is_used(&kind, &device);
                    if is_used {
                        self.tracked.count(&device);
                    }
                    is_used
                        .then(|| format!("{kind} `{device}` is not used while it is not tracked: {stated}"))
                }
                ConnectionEvent::Lost(why) => {
                    Some(format!("the connection is lost: {why}; it is tried again"))
                }
                ConnectionEvent::Back => Some("the connection is there again".to_owned()),
            };
            observed.extend(note.and_then(|note| self.note(note)));
        }
        let dropped = self.source.dropped();
        if dropped > self.reported_dropped {
            self.reported_dropped = dropped;
            observed.extend(
                self.note("messages come more quickly than they are taken: some are skipped".to_owned()),
            );
        }
        observed
    }

    /// A remark, where it is new.
    fn note(&mut self, note: String) -> Option<Observation> {
        if self.noted.len() >= MAX_NOTES || !self.noted.insert(note.clone()) {
            return None;
        }
        let address = self.source.address();
        let last = if self.noted.len() == MAX_NOTES { " (further remarks are omitted)" } else { "" };
        Some(Observation::Note(format!("OpenIGTLink at {address}: {note}{last}")))
    }

    /// Whether messages of this type and name are taken as the needle.
    fn is_used(&self, kind: &str, device: &str) -> bool {
        match kind {
            "POINT" => self.settings.shape.as_ref().is_none_or(|name| name == device),
            "TRANSFORM" | "POSITION" | "QTRANS" => self.settings.tip == device,
            _ => false,
        }
    }

    /// Numbers of messages that were not used though they were of the needle, by name: a remark for the end of a
    /// recording.
    pub fn unused(&self) -> Vec<String> {
        self.tracked
            .unused()
            .map(|(device, count)| {
                format!("OpenIGTLink: {count} messages of `{device}` are no measurement and are not used")
            })
            .collect()
    }

    /// The needle's points in a message; `None` where it was before the first sample; an error where it cannot be used.
    fn shape(
        &mut self,
        message: &Message,
        at: Instant,
        note: &mut Option<String>,
    ) -> Result<Option<Sweep>, String> {
        let Message { device, stamp, content } = message;
        let kind = content.kind();
        if let Content::Status { code, words } = content {
            self.tracked.status(device, *code, words);
            return match self.tracked.bad_status(device) {
                Some(status) => Err(format!("`{device}`: {status}")),
                None => Ok(None),
            };
        }
        if self.is_used(kind, device) {
            let stated = self.tracked.bad_status(device).map(str::to_owned);
            if let Some(problem) = stated.as_deref().or(problem(content)) {
                self.tracked.count(device);
                return Err(format!("{kind} `{device}` is not used: {problem}"));
            }
            match self.tracked.clock(device, *stamp) {
                Clock::On => {}
                Clock::Same => {
                    self.tracked.count(device);
                    return Err(format!("{kind} `{device}` is not used while its time stamp stays the same"));
                }
                Clock::Back => {
                    *note = Some(format!(
                        "the time stamps of `{device}` step back: its clock is taken to have been set"
                    ));
                    self.clocks.sender_was_set();
                }
            }
        }
        let Settings { delay_s, frame, .. } = &self.settings;
        let points_mm: Vec<[f32; 3]> = match content {
            Content::Points(points) if self.is_used(kind, device) => {
                points.iter().map(|point| point.position_mm).collect()
            }
            Content::Transform(Pose { position_mm, .. }) | Content::Position(Pose { position_mm, .. })
                if self.is_used(kind, device) =>
            {
                vec![*position_mm]
            }
            _ => return Err(format!("{kind} `{device}` is not used")),
        };
        let Some(time_s) = self.clocks.device_s(*stamp, at).map(|time_s| time_s - delay_s) else {
            return Ok(None);
        };
        let mut rows = Vec::new();
        for (number, point_mm) in (1..).zip(points_mm) {
            let point = frame.point(point_mm.map(|mm| 1e-3 * f64::from(mm)));
            let [z_m, deflection_y_m, deflection_x_m] = point;
            if !Frame::is_near(point) {
                return Err(format!(
                    "{} `{device}`: point {number} is {:.1} mm off the straight needle, {:.1} mm from guide 1, expected at most 200 mm \
                     off and 2000 mm from it: do origin and axis fit?",
                    content.kind(),
                    1e3 * deflection_y_m.hypot(deflection_x_m),
                    1e3 * z_m
                ));
            }
            // Points behind guide 1 are not used.
            if z_m >= 0.0 {
                rows.push(ShapeRow { time_s, z_m, deflection_y_m, deflection_x_m, image: None });
            }
        }
        Ok((!rows.is_empty() && time_s >= 0.0).then(|| Sweep::at_own_times(rows)))
    }
}
