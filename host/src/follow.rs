//! Measurement against model while readings come, in commands: [`inference::follow`] with readings of the link, and the time of day.

mod steered;

pub use inference::follow::{Difference, FollowError, Follower, Parted};
pub use steered::{ModelAgreement, SteeredFollower, sentence_of_plant};

use device::link::Point;
use inference::follow::GuideReading;
use time::{Duration, OffsetDateTime};

/// Takes readings of the device into a comparison; what was found with them, each axis once.
pub fn push(follower: &mut Follower, points: &[Point]) -> Vec<Parted> {
    let readings = points.iter().map(|point| GuideReading {
        time_s: point.time_s,
        displacement_m: point.displacement_m,
        force_n: point.force_n,
        repeats_force: point.repeats_force,
    });
    follower.push(&readings.collect::<Vec<_>>())
}

/// In words with the time of day, by this machine's clock, of what has just been found.
pub fn sentence_now(parted: &Parted) -> String {
    let lasted = Duration::seconds_f64((parted.found_s - parted.since_s).clamp(0.0, 1e6));
    let began = OffsetDateTime::now_utc() - lasted;
    parted.sentence(format_args!("{:02}:{:02}:{:02} UTC", began.hour(), began.minute(), began.second()))
}
