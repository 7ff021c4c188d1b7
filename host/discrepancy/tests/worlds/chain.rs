//! A chain of thermal masses, with a hidden loss inside a simulation of two channels.

use crate::common::{coloured, column, parameter, regressor};
use discrepancy::*;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

/// Temperatures above the room of a heated mass and of one that it heats, which loses heat to the room.
struct Chain {
    parameters: [Parameter; 3],
    sites: [Site; 2],
}

/// Steps of the model between readings.
const STEPS: usize = 4;

impl Chain {
    fn new() -> Self {
        let site = |name: &str, temperature: &str| Site {
            name: name.to_owned(),
            unit: "K/s".to_owned(),
            adds_to: None,
            regressors: vec![regressor(temperature, "K")],
            forms: Vec::new(),
        };
        Self {
            parameters: [
                parameter("heating", "K/s", 1.0, 0.5),
                parameter("conduction", "1/s", 0.02, 0.01),
                parameter("loss", "1/s", 0.02, 0.01),
            ],
            sites: [site("heated", "heated_temperature"), site("outer", "outer_temperature")],
        }
    }
}

impl ForwardModel for Chain {
    fn parameters(&self) -> &[Parameter] {
        &self.parameters
    }

    fn sites(&self) -> &[Site] {
        &self.sites
    }

    fn predict(
        &self,
        run: &Run,
        parameters: &[f64],
        terms: &Terms<'_>,
    ) -> Result<Vec<Vec<f64>>, ModelFailure> {
        let power = run.column("power").ok_or_else(|| ModelFailure::Failed("no column power".to_owned()))?;
        let rates = |heated: f64, outer: f64, power: f64| {
            let flow = parameters[1] * (heated - outer);
            let of_heated =
                parameters[0] * power - flow + terms.value("heated", &[("heated_temperature", heated)]);
            let of_outer =
                flow - parameters[2] * outer + terms.value("outer", &[("outer_temperature", outer)]);
            (of_heated, of_outer)
        };
        let (mut heated, mut outer) = (0.0, 0.0);
        let mut series = [Vec::new(), Vec::new()];
        let step = 2.0 / STEPS as f64;
        for power in power {
            series[0].push(heated);
            series[1].push(outer);
            for _ in 0..STEPS {
                let (first, second) = rates(heated, outer, *power);
                let (a, b) = rates(heated + 0.5 * step * first, outer + 0.5 * step * second, *power);
                (heated, outer) = (heated + step * a, outer + step * b);
            }
        }
        Ok(series.to_vec())
    }
}

/// A chain whose outer mass has a hidden loss; readings every 2 s.
fn chain(seed: u64, judges: bool, loss: &dyn Fn(f64) -> f64) -> Run {
    let mut rng = ChaCha8Rng::seed_from_u64(57 + 1000 * seed + u64::from(judges));
    let noises = [(); 2].map(|()| coloured(&mut rng, 600, 0.1, 0.1, 0.9));
    let (mut heated, mut outer) = (0.0, 0.0);
    let [mut times, mut powers, mut heated_series, mut outer_series] = [(); 4].map(|()| Vec::new());
    for (i, (of_heated, of_outer)) in noises[0].iter().zip(&noises[1]).enumerate() {
        let phase = i as f64 / if judges { 41.0 } else { 53.0 };
        let power = (0.6 + 0.5 * phase.sin() + 0.4 * (2.3 * phase + seed as f64).sin()).max(0.0);
        times.push(2.0 * i as f64);
        powers.push(power);
        heated_series.push(heated + of_heated);
        outer_series.push(outer + of_outer);
        for _ in 0..200 {
            let flow = 0.025 * (heated - outer);
            heated += 0.01 * (1.2 * power - flow);
            outer += 0.01 * (flow - 0.015 * outer - loss(outer));
        }
    }
    let channel =
        |name: &str, values| Channel { name: name.to_owned(), unit: "K".to_owned(), values, sds: None };
    Run {
        name: if judges { "judge".to_owned() } else { "train".to_owned() },
        time_s: times,
        channels: vec![channel("heated", heated_series), channel("outer", outer_series)],
        columns: vec![column("power", "", powers)],
        judges,
    }
}

/// The result of a run that is fitted and one that judges.
pub fn diagnosed(seed: u64, loss: &dyn Fn(f64) -> f64) -> Report {
    let runs = [false, true].map(|judges| chain(seed, judges, loss));
    let data = Data::new(runs.to_vec()).expect("data");
    diagnose(&Chain::new(), &data, &Options::default(), &|_| ()).expect("a result")
}
