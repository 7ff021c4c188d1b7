//! Effects: what may be wrong with the plain model, each a part of the one forward model.
//!
//! An effect has an id, its physics in one line, parameters that do nothing at their neutral values, and the place where it
//! acts: on the beam problem, on where the sensors look, or on what they make of what they see. A [`Model`](super::Model) is a
//! rig, a tissue and a list of effects with values; everything that calls [`predict`](super::predict) honours them. A new
//! effect is one struct and one line in [`EFFECTS`].
//!
//! Order of application: beam, solve, look, observe.

use super::{BeamProblem, Channels, Foundation, Layer, ModelError, ShapePoint};
use std::fmt::Debug;

/// A parameter of an effect; values are in the unit of its name.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ParameterInfo {
    /// Name with unit.
    pub name: &'static str,
    /// Value at which the effect does nothing.
    pub neutral: f64,
    /// Physically possible values.
    pub range: [f64; 2],
    /// Standard deviation about the neutral value in an ordinary rig: the prior of a nuisance.
    pub prior_sd: f64,
}

/// A way in which rig, tissue or sensors differ from the plain model.
pub trait Effect: Debug + Sync {
    /// Name, as in files and options.
    fn id(&self) -> &'static str;

    /// What it is, in one line.
    fn physics(&self) -> &'static str;

    /// Its parameters.
    fn parameters(&self) -> &'static [ParameterInfo];

    /// Changes the beam problem.
    ///
    /// # Errors
    /// [`ModelError::OutOfRange`] where the values are impossible.
    fn beam(&self, _values: &[f64], _problem: &mut BeamProblem) -> Result<(), ModelError> {
        Ok(())
    }

    /// Changes where the needle is really looked at.
    fn look(&self, _values: &[f64], _point: &mut ShapePoint) {}

    /// Changes what the sensors read.
    fn observe(&self, _values: &[f64], _channels: &mut Channels) {}
}

/// Every effect there is.
pub static EFFECTS: [&dyn Effect; 5] =
    [&TissueLayers, &TissueGradient, &ClampCompliance, &ShapeOffset, &DepthShift];

/// The effect of an id.
pub fn effect(id: &str) -> Option<&'static dyn Effect> {
    EFFECTS.into_iter().find(|effect| effect.id() == id)
}

const MM: f64 = 1e-3;

/// `tissue.layers`.
#[derive(Debug)]
struct TissueLayers;

impl Effect for TissueLayers {
    fn id(&self) -> &'static str {
        "tissue.layers"
    }

    fn physics(&self) -> &'static str {
        "the modulus changes at a depth: K above the boundary, K times a ratio below it"
    }

    fn parameters(&self) -> &'static [ParameterInfo] {
        &[
            ParameterInfo { name: "k_ratio", neutral: 1.0, range: [0.02, 50.0], prior_sd: 1.0 },
            ParameterInfo { name: "boundary_mm", neutral: 15.0, range: [1.0, 200.0], prior_sd: 10.0 },
        ]
    }

    fn beam(&self, values: &[f64], problem: &mut BeamProblem) -> Result<(), ModelError> {
        let &[ratio, boundary_mm] = values else { return Ok(()) };
        if ratio == 1.0 {
            return Ok(());
        }
        let bottom_m = boundary_mm * MM;
        let mut layers = problem.foundation.layers_above(bottom_m);
        let above_pa = problem.foundation.layer_pa(bottom_m * (1.0 - 1e-12));
        layers.push(Layer { bottom_m, modulus_pa: above_pa });
        let below_pa = ratio * problem.foundation.layer_pa(bottom_m);
        let gradient_per_m = problem.foundation.gradient_per_m();
        problem.foundation = Foundation::layered(layers, below_pa)?.graded(gradient_per_m)?;
        Ok(())
    }
}

/// `tissue.gradient`.
#[derive(Debug)]
struct TissueGradient;

impl Effect for TissueGradient {
    fn id(&self) -> &'static str {
        "tissue.gradient"
    }

    fn physics(&self) -> &'static str {
        "the modulus grows in proportion to depth: K(s) = K (1 + gradient s)"
    }

    fn parameters(&self) -> &'static [ParameterInfo] {
        &[ParameterInfo { name: "gradient_per_mm", neutral: 0.0, range: [-0.1, 1.0], prior_sd: 0.01 }]
    }

    fn beam(&self, values: &[f64], problem: &mut BeamProblem) -> Result<(), ModelError> {
        let more_per_m = values.first().copied().unwrap_or_default() / MM;
        let gradient_per_m = problem.foundation.gradient_per_m() + more_per_m;
        problem.foundation = problem.foundation.clone().graded(gradient_per_m)?;
        Ok(())
    }
}

/// `rig.clamp_compliance`.
#[derive(Debug)]
struct ClampCompliance;

impl Effect for ClampCompliance {
    fn id(&self) -> &'static str {
        "rig.clamp_compliance"
    }

    fn physics(&self) -> &'static str {
        "the needle turns in guide 1 in proportion to the moment there"
    }

    fn parameters(&self) -> &'static [ParameterInfo] {
        &[ParameterInfo { name: "compliance_rad_per_n_m", neutral: 0.0, range: [0.0, 5.0], prior_sd: 0.1 }]
    }

    fn beam(&self, values: &[f64], problem: &mut BeamProblem) -> Result<(), ModelError> {
        problem.clamp_compliance_rad_per_n_m += values.first().copied().unwrap_or_default();
        Ok(())
    }
}

/// `sensor.shape_offset`.
#[derive(Debug)]
struct ShapeOffset;

impl Effect for ShapeOffset {
    fn id(&self) -> &'static str {
        "sensor.shape_offset"
    }

    fn physics(&self) -> &'static str {
        "the shape is seen displaced by a constant, in each plane"
    }

    fn parameters(&self) -> &'static [ParameterInfo] {
        &[
            ParameterInfo { name: "offset_mm", neutral: 0.0, range: [-20.0, 20.0], prior_sd: 0.5 },
            ParameterInfo { name: "offset_x_mm", neutral: 0.0, range: [-20.0, 20.0], prior_sd: 0.5 },
        ]
    }

    fn observe(&self, values: &[f64], channels: &mut Channels) {
        let &[y_mm, x_mm] = values else { return };
        channels.shape_m.y.iter_mut().for_each(|u_m| *u_m += y_mm * MM);
        channels.shape_m.x.iter_mut().flatten().for_each(|u_m| *u_m += x_mm * MM);
    }
}

/// `sensor.depth_shift`.
#[derive(Debug)]
struct DepthShift;

impl Effect for DepthShift {
    fn id(&self) -> &'static str {
        "sensor.depth_shift"
    }

    fn physics(&self) -> &'static str {
        "the shape is seen further along the needle than stated, by a constant"
    }

    fn parameters(&self) -> &'static [ParameterInfo] {
        &[ParameterInfo { name: "shift_mm", neutral: 0.0, range: [-20.0, 20.0], prior_sd: 0.5 }]
    }

    fn look(&self, values: &[f64], point: &mut ShapePoint) {
        point.z_m += values.first().copied().unwrap_or_default() * MM;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::{DriveSample, Experiment, Lateral, Model, Needle, Rig, predict};

    fn experiment() -> Experiment {
        Experiment::Lateral(Lateral {
            depth_m: 0.03,
            drive: vec![DriveSample { time_s: 0.0, y_m: 1.2e-3, x_m: -0.4e-3 }],
            shape: [0.075, 0.085, 0.099].map(|z_m| ShapePoint { time_s: 0.0, z_m }).to_vec(),
        })
    }

    fn plain() -> Model {
        let rig = Rig { needle: Needle::gauge_18(), guide2_m: 0.06, entry_m: 0.07 };
        Model::uniform(rig, 16e3).expect("valid")
    }

    fn with(id: &str, values: &[f64]) -> Channels {
        let mut model = plain();
        model.effects.push((effect(id).expect("an effect"), values.to_vec()));
        predict(&model, &experiment()).expect("predicts")
    }

    /// Over the whole catalogue: neutral values change no bit, others change something.
    #[test]
    fn neutral_effects_do_nothing_and_others_do_something() {
        let plain = predict(&plain(), &experiment()).expect("predicts");
        for effect in EFFECTS {
            let neutral: Vec<f64> = effect.parameters().iter().map(|p| p.neutral).collect();
            assert_eq!(with(effect.id(), &neutral), plain, "{}", effect.id());
            let shifted: Vec<f64> = effect.parameters().iter().map(|p| p.neutral + p.prior_sd).collect();
            assert_ne!(with(effect.id(), &shifted), plain, "{}", effect.id());
            for parameter in effect.parameters() {
                let [least, most] = parameter.range;
                assert!((least..=most).contains(&parameter.neutral) && parameter.prior_sd > 0.0);
            }
        }
    }

    #[test]
    fn ids_are_unique_and_found() {
        for (index, a) in EFFECTS.iter().enumerate() {
            assert_eq!(effect(a.id()).expect("found").id(), a.id());
            assert!(EFFECTS.iter().skip(index + 1).all(|b| a.id() != b.id()));
        }
        assert!(effect("nothing").is_none());
    }

    #[test]
    fn effects_act_where_they_should() {
        let plain = predict(&plain(), &experiment()).expect("predicts");
        // A clamp of 0.35 rad/(N m): 1 mm takes 1.0152508e-3 m/N against 0.916319e-3.
        let soft = with("rig.clamp_compliance", &[0.35]);
        assert!((soft.force_n.y[0] / (1.2e-3 / 0.0010152508803166775) - 1.0).abs() < 1e-10);
        let offset = with("sensor.shape_offset", &[0.1, -0.2]);
        assert!((offset.shape_m.y[1] - plain.shape_m.y[1] - 1e-4).abs() < 1e-15);
        assert!((offset.shape_m.x.expect("x")[1] - plain.shape_m.x.expect("x")[1] + 2e-4).abs() < 1e-15);
        assert_eq!(offset.force_n, plain.force_n);
        // A boundary below the tip is none.
        assert_eq!(with("tissue.layers", &[3.0, 40.0]).force_n, plain.force_n);
        assert!(with("tissue.layers", &[3.0, 10.0]).force_n.y[0] > 1.02 * plain.force_n.y[0]);
        assert!(with("tissue.gradient", &[0.02]).force_n.y[0] > 1.02 * plain.force_n.y[0]);
    }
}
