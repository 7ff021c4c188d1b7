//! A tank that drains, with a hidden overflow inside the equations of a simulation.

use crate::common::{coloured, column, parameter, regressor};
use discrepancy::*;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

/// The level of a tank that drains; the model integrates with its terms inside.
struct Tank {
    parameters: Vec<Parameter>,
    sites: Vec<Site>,
}

impl Tank {
    fn new() -> Self {
        let balance = Site {
            name: "balance".to_owned(),
            unit: "cm/s".to_owned(),
            adds_to: None,
            regressors: vec![regressor("level", "cm")],
            forms: Vec::new(),
        };
        Self {
            parameters: vec![
                parameter("outflow", "cm^0.5/s", 0.3, 0.15),
                parameter("pump", "cm/(V s)", 0.5, 0.25),
            ],
            sites: vec![balance],
        }
    }
}

impl ForwardModel for Tank {
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
        let pump = run.column("pump").ok_or_else(|| ModelFailure::Failed("no column pump".to_owned()))?;
        let rate = |level: f64, pump: f64| {
            parameters[1] * pump - parameters[0] * level.max(0.0).sqrt()
                + terms.value("balance", &[("level", level)])
        };
        let mut level = 4.0;
        let mut levels = Vec::new();
        for u in pump {
            levels.push(level);
            for _ in 0..2 {
                // Heun's method in steps of half a second.
                let first = rate(level, *u);
                level += 0.25 * (first + rate(level + 0.5 * first, *u));
                level = level.max(0.0);
            }
        }
        Ok(vec![levels])
    }
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
        name: if judges { "judge".to_owned() } else { "train".to_owned() },
        time_s: (0..levels.len()).map(|i| i as f64).collect(),
        channels: vec![Channel {
            name: "level".to_owned(),
            unit: "cm".to_owned(),
            values: levels,
            sds: None,
        }],
        columns: vec![column("pump", "V", pumps)],
        judges,
    }
}

/// The result of a run that is fitted and one that judges.
pub fn diagnosed(seed: u64, loss: f64) -> Report {
    let data = Data::new(vec![tank(seed, false, loss), tank(seed, true, loss)]).expect("data");
    diagnose(&Tank::new(), &data, &Options::default(), &|_| ()).expect("a result")
}
