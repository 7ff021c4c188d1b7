//! A cart that is moved to and fro, with a hidden friction.

use crate::common::{coloured, column, parameter, regressor};
use discrepancy::*;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

/// Force of a cart by acceleration and speed.
struct Cart {
    parameters: Vec<Parameter>,
    sites: Vec<Site>,
}

impl Cart {
    fn new() -> Self {
        let friction = Site {
            name: "friction".to_owned(),
            unit: "N".to_owned(),
            adds_to: Some("force".to_owned()),
            regressors: vec![regressor("speed", "m/s"), regressor("position", "m")],
            forms: Vec::new(),
        };
        Self {
            parameters: vec![parameter("mass", "kg", 3.0, 1.0), parameter("viscous", "N s/m", 2.0, 2.0)],
            sites: vec![friction],
        }
    }
}

impl ForwardModel for Cart {
    fn parameters(&self) -> &[Parameter] {
        &self.parameters
    }

    fn sites(&self) -> &[Site] {
        &self.sites
    }

    fn predict(&self, run: &Run, parameters: &[f64], _: &Terms<'_>) -> Result<Vec<Vec<f64>>, ModelFailure> {
        let column = |name| run.column(name).ok_or_else(|| ModelFailure::Failed(format!("no column {name}")));
        let pairs = column("acceleration")?.iter().zip(column("speed")?);
        Ok(vec![pairs.map(|(a, v)| parameters[0] * a + parameters[1] * v).collect()])
    }
}

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
        let acceleration = |t: f64| {
            let turn = std::f64::consts::TAU * hz;
            1.5 * (turn * t + phase).cos() + 0.9 * (2.7 * turn * t).cos() - 0.8 * position - 0.3 * speed
        };
        let now = 0.02 * i as f64;
        let rate = acceleration(now);
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
        name: if judges { "judge".to_owned() } else { "train".to_owned() },
        time_s: times,
        channels: vec![Channel { name: "force".to_owned(), unit: "N".to_owned(), values: forces, sds: None }],
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
    diagnose(&Cart::new(), &data, &Options::default(), &|_| ()).expect("a result")
}
