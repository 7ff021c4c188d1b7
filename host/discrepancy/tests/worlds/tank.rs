//! A tank that drains, with a hidden overflow inside the equations of a simulation.

use crate::common::{channel, coloured, column, integrated, name_of, parameter, regressor, site};
use discrepancy::*;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

/// The level of a tank that drains; the model integrates with its terms inside, in steps of half a second.
fn draining_tank() -> impl ForwardModel {
    let parameters =
        vec![parameter("outflow", "cm^0.5/s", 0.3, 0.15), parameter("pump", "cm/(V s)", 0.5, 0.25)];
    let balance = site("balance", "cm/s", None, vec![regressor("level", "cm")]);
    FunctionModel::new(parameters, vec![balance], |run: &Run, parameters: &[f64], terms: &Terms<'_>| {
        let levels = integrated(run.needed("pump")?, [4.0], (2, 0.5, 0.0), |[level], pump| {
            let outflow = parameters[0] * level.max(0.0).sqrt();
            [parameters[1] * pump - outflow + terms.value("balance", &[("level", level)])]
        });
        Ok(vec![levels.concat()])
    })
}

fn tank(seed: u64, judges: bool, loss: f64) -> Run {
    let mut rng = ChaCha8Rng::seed_from_u64(77 + 1000 * seed + u64::from(judges));
    let noise = coloured(&mut rng, 600, 0.03, 0.03, 0.9);
    let mut level: f64 = 4.0;
    let (mut levels, mut pumps) = (Vec::new(), Vec::new());
    for (i, noise) in noise.iter().enumerate() {
        let phase = i as f64 / if judges { 37.0 } else { 29.0 };
        let pump = 1.6 + 0.9 * phase.sin() + 0.5 * (2.3 * phase + seed as f64).sin();
        levels.push(level + noise);
        pumps.push(pump);
        for _ in 0..200 {
            let overflow = loss * (level - 9.0_f64).max(0.0);
            level += 0.005 * (0.55 * pump - 0.32 * level.max(0.0).sqrt() - overflow);
        }
    }
    Run {
        name: name_of(judges),
        time_s: (0..levels.len()).map(|i| i as f64).collect(),
        channels: vec![channel("level", "cm", levels)],
        columns: vec![column("pump", "V", pumps)],
        judges,
    }
}

/// The result of a run that is fitted and one that judges.
pub fn diagnosed(seed: u64, loss: f64) -> Report {
    let data = Data::new(vec![tank(seed, false, loss), tank(seed, true, loss)]).expect("data");
    diagnose(&draining_tank(), &data, &Options::default(), &|_| ()).expect("a result")
}
