//! A drive of two masses, with backlash or a periodic error of its gear.

use crate::common::{channel, coloured, column, name_of, parameter, regressor, site};
use discrepancy::*;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

/// Position of a load by that of its motor, through a rigid gear.
fn rigid_gear() -> impl ForwardModel {
    let regressors = vec![regressor("position", "mm"), regressor("speed", "mm/s")];
    let gear = site("gear", "mm", Some("load"), regressors);
    let mut origin = parameter("origin", "mm", 0.0, 1.0);
    origin.range = None;
    let parameters = vec![parameter("ratio", "", 1.0, 0.1), origin];
    FunctionModel::new(parameters, vec![gear], |run: &Run, parameters: &[f64], _: &Terms<'_>| {
        let motor = run.needed("position")?;
        Ok(vec![motor.iter().map(|x| parameters[0] * x + parameters[1]).collect()])
    })
}

/// A motor moves a load with dry friction through a stiff contact with half a gap to both sides.
fn drive(seed: u64, judges: bool, half_gap_mm: f64, cogging_mm: f64) -> Run {
    let mut rng = ChaCha8Rng::seed_from_u64(31 + 1000 * seed + u64::from(judges));
    let count = 1200_u32;
    let noise = coloured(&mut rng, 1200, 0.01, 0.01, 0.95);
    let phase = 0.7 * (seed % 9) as f64;
    let turn = if judges { 1.3 } else { 0.9 };
    let motor = |t: f64| 8.0 * (turn * t + phase).sin() + 3.0 * (2.7 * turn * t).sin();
    let (mut load, mut load_speed) = (motor(0.0), 0.0);
    let [mut times, mut positions, mut speeds, mut loads] = [(); 4].map(|()| Vec::new());
    for (i, noise) in (0..count).zip(&noise) {
        let now = 0.02 * f64::from(i);
        let position = motor(now);
        times.push(now);
        positions.push(position);
        speeds.push((motor(now + 1e-4) - motor(now - 1e-4)) / 2e-4);
        // The gear's eccentricity repeats every 5 mm.
        let cogging = cogging_mm * (std::f64::consts::TAU * position / 5.0 + 0.4).sin();
        loads.push(0.97 * load + 0.2 + cogging + noise);
        for step in 0..200 {
            let at = now + 1e-4 * f64::from(step);
            let (twist, motor_speed) = (motor(at) - load, (motor(at + 1e-4) - motor(at)) / 1e-4);
            let pressed = twist - twist.clamp(-half_gap_mm, half_gap_mm);
            let damping = if pressed == 0.0 { 0.0 } else { 1000.0 * (motor_speed - load_speed) };
            let friction = 300.0 * (load_speed / 0.05_f64).tanh();
            load_speed += 1e-4 * (1e6 * pressed + damping - friction);
            load += 1e-4 * load_speed;
        }
    }
    Run {
        name: name_of(judges),
        time_s: times,
        channels: vec![channel("load", "mm", loads)],
        columns: vec![column("position", "mm", positions), column("speed", "mm/s", speeds)],
        judges,
    }
}

/// The result of a run that is fitted and one that judges.
pub fn diagnosed(seed: u64, half_gap_mm: f64, cogging_mm: f64) -> Report {
    let runs = [false, true].map(|judges| drive(seed, judges, half_gap_mm, cogging_mm));
    let data = Data::new(runs.to_vec()).expect("data");
    diagnose(&rigid_gear(), &data, &Options::default(), &|_| ()).expect("a result")
}
