//! Plan, target and next action over OpenIGTLink, so that 3D Slicer and others show them.
//!
//! Coordinates are those of the plant: z along the needle's axis, the origin where the axis meets the surface.

use crate::follow::{Parted, sentence_of_plant};
use device::igtl::message::Point;
use device::igtl::{Content, Message, Publisher};
use std::time::{Duration, SystemTime, UNIX_EPOCH};
use steering::{Cue, Decision};

/// Group that all points belong to.
const GROUP: &str = "steering";

/// Values of a run that are published to all clients and to those who come later.
pub struct Published {
    publisher: Option<Publisher>,
}

impl Published {
    /// To the clients of a server, or to nobody.
    pub fn new(publisher: Option<Publisher>, target_mm: [f64; 3]) -> Self {
        let published = Self { publisher };
        published.keep(&[target(target_mm, now())]);
        published
    }

    /// The plan of a decision.
    pub fn decision(&self, decision: &Decision) {
        self.keep(&[path(decision, now())]);
    }

    /// Next action.
    pub fn cue(&self, cue: &Cue) {
        self.keep(&[message("NextAction", Content::Text(cue.to_string()), now())]);
    }

    /// Readings no longer follow the model.
    pub fn parted(&self, parted: &Parted) {
        self.keep(&[message("Agreement", Content::Text(sentence_of_plant(parted)), now())]);
    }

    fn keep(&self, messages: &[Message]) {
        if let Some(publisher) = &self.publisher {
            publisher.keep(messages);
        }
    }
}

fn now() -> Duration {
    SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default()
}

fn message(device: &str, content: Content, stamp: Duration) -> Message {
    Message { device: device.to_owned(), stamp, content }
}

fn point(name: String, at_mm: [f64; 3], diameter_mm: f64) -> Point {
    let position_mm = at_mm.map(|mm| mm as f32);
    Point { name, group: GROUP.to_owned(), position_mm, diameter_mm: diameter_mm as f32 }
}

fn target(at_mm: [f64; 3], stamp: Duration) -> Message {
    message("SteerTarget", Content::Points(vec![point("target".to_owned(), at_mm, 1.0)]), stamp)
}

/// The planned path; the diameter of a point is the width of its 95 % band.
fn path(decision: &Decision, stamp: Duration) -> Message {
    let points = decision.path.iter().map(|at| {
        let [x, y] = at.tip_mm;
        point(format!("{:.1} mm", at.depth_mm), [x, y, at.depth_mm], 2.0 * 1.96 * at.sd_mm)
    });
    message("PlannedPath", Content::Points(points.collect()), stamp)
}

#[cfg(test)]
mod tests {
    use super::*;
    use device::igtl::Source;
    use device::igtl::source::ConnectionEvent;
    use std::collections::BTreeMap;
    use std::time::Instant;
    use steering::PathPoint;

    fn decision() -> Decision {
        Decision {
            t_s: 12.0,
            depth_mm: 40.0,
            guide_from_mm: [0.0; 2],
            guide_to_mm: [0.5, 0.2],
            bevel_deg: 0.0,
            plan_depth_mm: vec![40.0],
            plan_guide_mm: vec![[0.5, 0.2]],
            expected_tip_mm: [3.0, -2.0],
            covariance_mm2: [0.04, 0.0, 0.04],
            within: Vec::new(),
            path: vec![point_at(40.0, 1.0, 0.05), point_at(100.0, 3.0, 0.2)],
            unsteered_miss_mm: 2.0,
            modulus_kpa: Vec::new(),
            modulus_sd_ln: Vec::new(),
            tip_load_n: 0.2,
            cut_angle_probability: 0.1,
            misfit: 1.0,
            limited_by: None,
            limits: None,
            rotations: Vec::new(),
        }
    }

    fn point_at(depth_mm: f64, x_mm: f64, sd_mm: f64) -> PathPoint {
        PathPoint { depth_mm, tip_mm: [x_mm, -1.0], sd_mm }
    }

    #[test]
    fn a_client_that_comes_later_receives_target_planned_path_with_its_band_and_next_action() {
        let publisher = Publisher::bind("127.0.0.1:0".parse().expect("an address"), 1).expect("binds");
        let address = publisher.address().to_string();
        let published = Published::new(Some(publisher), [3.0, -2.0, 100.0]);
        published.decision(&decision());
        published.cue(&Cue {
            depth_mm: 40.0,
            turn_by_deg: None,
            bevel_deg: 0.0,
            push_to_mm: 45.0,
            limits: None,
        });
        published.parted(&Parted {
            axis: "y",
            since_s: 12.3,
            found_s: 13.0,
            displacement_mm: 0.5,
            depth_mm: Some(40.0),
            difference: crate::follow::Difference::Force { mean_n: -0.3 },
            sigma: -9.0,
        });
        let source = Source::connect(&address).expect("connects");
        let mut received = BTreeMap::new();
        let deadline = Instant::now() + Duration::from_secs(20);
        while received.len() < 4 {
            assert!(Instant::now() < deadline, "{received:?}");
            for event in source.news() {
                if let ConnectionEvent::Message(message, _) = event {
                    received.insert(message.device, message.content);
                }
            }
            std::thread::sleep(Duration::from_millis(5));
        }
        assert_eq!(points_of("SteerTarget", &received)[0].position_mm, [3.0, -2.0, 100.0]);
        let path = points_of("PlannedPath", &received);
        assert_eq!(path.len(), 2);
        assert_eq!(path[1].position_mm, [3.0, -1.0, 100.0]);
        assert!((path[1].diameter_mm - 0.784).abs() < 1e-4);
        assert_eq!(
            received.get("NextAction"),
            Some(&Content::Text("at 40.0 mm: push to 45.0 mm".to_owned()))
        );
        let parted = "the force along y no longer follows the model since 12.3 s of the plant's clock, at 40.0 mm depth: -0.300 N, 9 sigma";
        assert_eq!(received.get("Agreement"), Some(&Content::Text(parted.to_owned())));
    }

    fn points_of(device: &str, received: &BTreeMap<String, Content>) -> Vec<Point> {
        match received.get(device) {
            Some(Content::Points(points)) => points.clone(),
            other => panic!("{device}: {other:?}"),
        }
    }
}
