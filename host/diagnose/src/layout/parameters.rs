//! Parameters of a fit: their ranges, priors and steps, and the values from which first fits start.

use super::{HeavyTailedParameter, Layout, Places, Scale, prior};
use mechanics::unknowns::{Family, Unknown, rig, tip, tissue};
use readings::{Parameter, Prior};

/// Moduli from which fits of insertions by hand start.
const BY_HAND_PA: [f64; 4] = [5e3, 25e3, 100e3, 400e3];
/// Largest distance of guide 2 and the surface from their stated positions.
const OFFSET_M: f64 = 10e-3;
/// Step of the differences along them: a thirtieth of the tolerance of guide 2, far above rounding.
const OFFSET_STEP_M: f64 = 1e-5;

impl Layout {
    /// Parameters of a fit that starts from these values.
    pub fn parameters(&self, starts: &[f64]) -> Vec<Parameter> {
        let mut parameters = vec![assumed(&tissue::MODULUS, 1e-4)];
        let Places { load, across, apart, rear, gap, ratio, .. } = self.places();
        let loads = [load, across].into_iter().flatten();
        parameters.extend(loads.map(|_| assumed(&tip::LOAD, 1e-4)));
        if apart.is_some() {
            parameters.push(assumed(&tissue::INSERTION_MODULUS, 1e-4));
        }
        let rears = rear.iter().flatten();
        parameters.extend(rears.map(|_| assumed(&rig::REAR_COMPLIANCE, 0.01)));
        let gaps = gap.iter().flatten();
        parameters.extend(gaps.map(|_| assumed(&tissue::GAP, 1e-3)));
        if ratio.is_some() {
            parameters.push(assumed(&tissue::REFERENCE_RATIO, 1e-4));
        }
        let stated_places = self.stated().map(|place| {
            bounded([-OFFSET_M, OFFSET_M], Prior { mean: 0.0, sd: place.scale_m }, OFFSET_STEP_M)
        });
        parameters.extend(stated_places);
        let infos =
            self.effects.iter().flat_map(|effect| effect.parameters().iter().map(|info| (effect.id(), info)));
        for (effect, info) in infos {
            let scale = Scale::of(info);
            let range = info.range.map(|end| scale.inside(end));
            let known_parameter = self.known.iter().find(|known| known.is_of(effect, info.name));
            let prior =
                known_parameter.map_or_else(|| prior(info), |known_parameter| known_parameter.prior(scale));
            let step = match (scale, info.nodes.is_empty()) {
                (Scale::Log, false) => 0.03,
                (Scale::Log, true) => 1e-3,
                (Scale::Linear, _) => 3e-3 * info.prior_sd,
            };
            parameters.push(bounded(range, prior, step));
        }
        for HeavyTailedParameter { parameter, center, prior } in self.heavy_tailed() {
            let value = starts.get(parameter).copied().unwrap_or(center);
            let stand_in = Prior { mean: center, sd: prior.sd_at(value - center) };
            parameters[parameter].prior = Some(stand_in);
        }
        for (parameter, start) in parameters.iter_mut().zip(starts) {
            // Off a bound, so that both differences of the derivative exist.
            let room = parameter.step.min(0.25 * (parameter.most - parameter.least));
            parameter.start = start.clamp(parameter.least + room, parameter.most - room);
        }
        parameters
    }

    /// Start values of a first fit.
    pub fn first_values(&self) -> Vec<f64> {
        let mut values = vec![0.0; self.own()];
        let Places { load, rear, .. } = self.places();
        values[0] = tissue::MODULUS.scale.ln();
        load.into_iter().for_each(|place| values[place] = tip::LOAD.scale);
        rear.into_iter().flatten().for_each(|place| values[place] = rig::REAR_COMPLIANCE.scale.ln());
        let infos = self.effects.iter().flat_map(|effect| effect.parameters());
        values.extend(infos.map(|info| Scale::of(info).inside(info.neutral)));
        values
    }

    /// Start values of the first fits. The modulus from insertions by hand depends on the clamping of the rear and the distance
    /// of the surface, so that the objective has several local optima.
    pub fn starts(&self, first: &[f64]) -> Vec<Vec<f64>> {
        if !(self.kinds[1] && self.rig.has_one_guide()) {
            return vec![first.to_vec()];
        }
        BY_HAND_PA
            .iter()
            .map(|modulus_pa| {
                let mut values = first.to_vec();
                values[0] = modulus_pa.ln();
                values
            })
            .collect()
    }
}

/// A parameter with a range and a prior.
fn bounded([least, most]: [f64; 2], prior: Prior, step: f64) -> Parameter {
    Parameter { start: 0.0, step, least, most, prior: Some(prior) }
}

/// The parameter of an entry of the table of unknowns; its logarithm where the prior is log-normal.
fn assumed(unknown: &Unknown, step: f64) -> Parameter {
    let [least, most] = unknown.range;
    let ends = [least, most, unknown.mean()];
    let is_logarithmic = unknown.prior.family == Family::LogNormal;
    let [least, most, mean] = ends.map(|value| if is_logarithmic { value.ln() } else { value });
    bounded([least, most], Prior { mean, sd: unknown.sd() }, step)
}
