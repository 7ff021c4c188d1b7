//! A cart that is moved to and fro, with a hidden friction.

use crate::common::{channel, coloured, column, mass_and_viscous_friction, name_of, parameter};
use discrepancy::*;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

/// A cart that is moved to and fro, of 2.4 kg and 3 N s/m, with a hidden friction and coloured noise of the force.
fn cart(seed: u64, judges: bool, friction: &dyn Fn(f64, f64) -> f64) -> Run {
    let mut rng = ChaCha8Rng::seed_from_u64(1000 * seed + u64::from(judges));
    let hz = if judges { 0.31 } else { 0.2 };
    let count = 1500;
    let noise = coloured(&mut rng, count, 0.10, 0.15, 0.97);
    let phase = f64::from(u32::try_from(seed % 7).expect("small"));
    let (mut position, mut speed) = (0.0, 0.0);
    let [mut times, mut positions, mut speeds, mut accelerations, mut forces] = [(); 5].map(|()| Vec::new());
    for (i, noise) in noise.iter().enumerate() {
        let now = 0.02 * i as f64;
        let turn = std::f64::consts::TAU * hz;
        let rate =
            1.5 * (turn * now + phase).cos() + 0.9 * (2.7 * turn * now).cos() - 0.8 * position - 0.3 * speed;
        times.push(now);
        positions.push(position);
        speeds.push(speed);
        accelerations.push(rate);
        forces.push(2.4 * rate + 3.0 * speed + friction(speed, position) + noise);
        for _ in 0..40 {
            speed += rate * 0.02 / 40.0;
            position += speed * 0.02 / 40.0;
        }
    }
    Run {
        name: name_of(judges),
        time_s: times,
        channels: vec![channel("force", "N", forces)],
        columns: vec![
            column("position", "m", positions),
            column("speed", "m/s", speeds),
            column("acceleration", "m/s^2", accelerations),
        ],
        judges,
    }
}

/// The result of a run that is fitted and one that judges.
pub fn diagnosed(seed: u64, friction: &dyn Fn(f64, f64) -> f64) -> Report {
    let data = Data::new(vec![cart(seed, false, friction), cart(seed, true, friction)]).expect("data");
    let model =
        mass_and_viscous_friction(parameter("mass", "kg", 3.0, 1.0), parameter("viscous", "N s/m", 2.0, 2.0));
    diagnose(&model, &data, &Options::default(), &|_| ()).expect("a result")
}
