//! A chain of thermal masses, with a hidden loss inside a simulation of two channels.

use crate::common::{channel, coloured, column, integrated, name_of, parameter, regressor, site};
use discrepancy::*;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

/// Temperatures above the room of a heated mass and of one that it heats, which loses heat to the room.
fn thermal_chain() -> impl ForwardModel {
    let parameters = vec![
        parameter("heating", "K/s", 1.0, 0.5),
        parameter("conduction", "1/s", 0.02, 0.01),
        parameter("loss", "1/s", 0.02, 0.01),
    ];
    let sites = vec![
        site("heated", "K/s", None, vec![regressor("heated_temperature", "K")]),
        site("outer", "K/s", None, vec![regressor("outer_temperature", "K")]),
    ];
    FunctionModel::new(parameters, sites, |run: &Run, parameters: &[f64], terms: &Terms<'_>| {
        let rates = |[heated, outer]: [f64; 2], power: f64| {
            let flow = parameters[1] * (heated - outer);
            let of_heated = terms.value("heated", &[("heated_temperature", heated)]);
            let of_outer = terms.value("outer", &[("outer_temperature", outer)]);
            [parameters[0] * power - flow + of_heated, flow - parameters[2] * outer + of_outer]
        };
        let states = integrated(run.needed("power")?, [0.0; 2], (4, 0.5, f64::NEG_INFINITY), rates);
        Ok([0, 1].map(|mass| states.iter().map(|state| state[mass]).collect()).to_vec())
    })
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
    Run {
        name: name_of(judges),
        time_s: times,
        channels: vec![channel("heated", "K", heated_series), channel("outer", "K", outer_series)],
        columns: vec![column("power", "", powers)],
        judges,
    }
}

/// The result of a run that is fitted and one that judges.
pub fn diagnosed(seed: u64, loss: &dyn Fn(f64) -> f64) -> Report {
    let runs = [false, true].map(|judges| chain(seed, judges, loss));
    let data = Data::new(runs.to_vec()).expect("data");
    diagnose(&thermal_chain(), &data, &Options::default(), &|_| ()).expect("a result")
}
