//! Defines an effect that the catalogue does not have, puts it into a model, and prints how the predicted force changes.
//!
//! The effect is a force sensor that is not linear: it reads `F (1 + c |F|)`. To have `guide identify`, `guide diagnose` and the
//! simulator use an effect as well, put it into the file of its family in `host/mechanics/src/effects` and into the list `EFFECTS`.
//!
//! ```sh
//! cargo run -p host --example add_effect
//! ```

use mechanics::effects::{Effect, EffectInfo, ObservationContext, ParameterInfo, RunKinds};
use mechanics::{Channels, DriveSample, Experiment, Lateral, Model, Needle, Rig, predict};

/// `sensor.force_nonlinearity`.
#[derive(Debug)]
struct ForceNonlinearity;

impl Effect for ForceNonlinearity {
    fn info(&self) -> &'static EffectInfo {
        const {
            &EffectInfo {
                id: "sensor.force_nonlinearity",
                physics: "the force sensor is not linear: it reads F (1 + c |F|)",
                signature: "a gain of the force that grows with the force; no change of the shape",
                observable_in: RunKinds::LATERAL,
                is_costly: false,
                parameters: &[ParameterInfo::amplitude("per_n", 0.0, [-0.5, 0.5], [-0.05, 0.05], 0.01)],
            }
        }
    }

    fn observe(&self, values: &[f64], _context: &ObservationContext<'_>, channels: &mut Channels) {
        let [deflection_per_n] = values else { return };
        let force_n = &mut channels.force_n;
        for reading_n in force_n.y.iter_mut().chain(force_n.x.iter_mut().flatten()) {
            *reading_n *= 1.0 + deflection_per_n * reading_n.abs();
        }
    }
}

fn main() -> anyhow::Result<()> {
    // Guide 2 is 60 mm and the tissue 70 mm from guide 1; K is 12 kPa, and the needle 30 mm deep.
    let plain = Model::uniform(Rig::two_guides(Needle::gauge_18(), 0.060, 0.070), 12e3)?;
    let with_effect = Model { effects: vec![(&ForceNonlinearity, vec![0.04])], ..plain.clone() };

    // Guide 2 goes up by 0.4 mm at a time, one second each.
    let drive: Vec<DriveSample> = (0..=4)
        .map(|step| DriveSample { time_s: f64::from(step), y_m: 0.4e-3 * f64::from(step), x_m: 0.0 })
        .collect();
    let experiment = Experiment::Lateral(Lateral {
        depth_m: 0.030,
        drive,
        shape: Vec::new(),
        reversal_m: [0.0; 2],
        order: 0.0,
    });
    let linear = predict(&plain, &experiment)?;
    let nonlinear = predict(&with_effect, &experiment)?;

    println!("displacement_y_mm  force_y_n  with {} = 0.04 1/N", ForceNonlinearity.id());
    let forces_n = linear.force_n.y.iter().zip(&nonlinear.force_n.y);
    for (displacement_m, (linear_n, nonlinear_n)) in linear.displacement_m.y.iter().zip(forces_n) {
        println!("{:17.1}  {linear_n:9.3}  {nonlinear_n:9.3}", 1e3 * displacement_m);
    }
    Ok(())
}
