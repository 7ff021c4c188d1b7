//! A running device and its session, published to the clients.

use super::scene::Scene;
use device::igtl::Publisher;
use device::igtl::clock::ClockMapping;
use device::link::{Batch, Point};
use device::sweep::Sweep;
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

/// Updates per second of the device's clock unless another rate is requested: what a viewer shows smoothly.
pub const USUAL_RATE_HZ: f64 = 20.0;

/// Publishes what the device streams, and no more often than wanted.
#[derive(Debug)]
pub struct Live {
    publisher: Publisher,
    scene: Scene,
    every_s: f64,
    /// Device time of the last update.
    last_s: Option<f64>,
    stamps: ClockMapping,
}

impl Live {
    /// Stream before any value.
    pub fn new(publisher: Publisher, scene: Scene, rate_hz: f64) -> Self {
        Self { publisher, scene, every_s: 1.0 / rate_hz, last_s: None, stamps: ClockMapping::default() }
    }

    /// The server.
    pub fn publisher(&self) -> &Publisher {
        &self.publisher
    }

    /// Published scene.
    pub fn scene(&mut self) -> &mut Scene {
        &mut self.scene
    }

    /// Samples have just arrived.
    pub fn samples(&mut self, batch: &Batch) {
        if let Some(newest) = batch.points.last() {
            self.stamps.arrived(newest.time_s, Instant::now(), now());
        }
        for point in &batch.points {
            let Point { time_s, .. } = *point;
            let is_due = match self.last_s {
                // The device has started again.
                Some(last_s) if time_s < last_s => true,
                // Half a sample early is better than a whole one late.
                Some(last_s) => time_s - last_s > self.every_s - 0.5e-3,
                None => true,
            };
            if is_due {
                self.last_s = Some(time_s);
                let stamp = self.stamps.stamp(time_s);
                self.publisher.publish(&self.scene.live(batch, point, stamp));
            }
        }
    }

    /// A sweep has been taken.
    pub fn sweep(&mut self, sweep: &Sweep, time_s: f64) {
        let stamp = self.stamps.stamp(time_s);
        self.publisher.publish(&[Scene::measured(sweep.rows(time_s), stamp)]);
    }
}

/// Time since 1970.
pub fn now() -> Duration {
    SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default()
}
