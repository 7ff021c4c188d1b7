//! Noise of the readings of a run, and standard errors of the means of its levels.

use super::stated_displacement_m;
use formats::session::{LateralRun, Session};
use mechanics::unknowns::sensors::{DISPLACEMENT_NOISE, FORCE_NOISE};
use readings::holds::{Hold, Mean, scatter_and_systematic};
use readings::{HoldData, Measured, ShapeDatum};

/// Standard deviations of single readings, from which those of a level's mean follow.
pub(super) struct Deviations {
    pub force_n: f64,
    pub displacement_m: f64,
    force_systematic_n: f64,
    displacement_systematic_m: f64,
}

impl Deviations {
    pub fn of(session: &Session, run: &LateralRun, used: &[&Hold]) -> Self {
        let force = pooled_scatter(&|level| [Some(level.force_y_n), level.force_x_n], used);
        let displacement =
            pooled_scatter(&|level| [Some(level.displacement_y_m), level.displacement_x_m], used);
        let (force_n, force_systematic_n) = scatter_and_systematic(
            force,
            session.noise.force_n,
            FORCE_NOISE.least().max(rounding_sd(&run.force.force_y_n)),
        );
        let (displacement_m, displacement_systematic_m) = scatter_and_systematic(
            displacement,
            stated_displacement_m(session, run),
            DISPLACEMENT_NOISE.least().max(rounding_sd(&run.force.displacement_y_m)),
        );
        Self { force_n, displacement_m, force_systematic_n, displacement_systematic_m }
    }

    pub fn force(&self, mean: &Mean) -> Measured {
        Measured { value: mean.value, sd: mean.standard_error(self.force_n).hypot(self.force_systematic_n) }
    }

    fn displacement(&self, mean: &Mean) -> Measured {
        let error_m = mean.standard_error(self.displacement_m);
        Measured { value: mean.value, sd: error_m.hypot(self.displacement_systematic_m) }
    }

    pub fn level(&self, level: &Hold, planes: usize, shape: Vec<ShapeDatum>) -> HoldData {
        let displacement = [Some(level.displacement_y_m), level.displacement_x_m];
        let force = [Some(level.force_y_n), level.force_x_n];
        HoldData {
            displacement_m: displacement
                .iter()
                .flatten()
                .take(planes)
                .map(|mean| self.displacement(mean))
                .collect(),
            force_n: force.iter().flatten().take(planes).map(|mean| self.force(mean)).collect(),
            shape,
        }
    }
}

fn pooled_scatter(means: &dyn Fn(&Hold) -> [Option<Mean>; 2], used: &[&Hold]) -> f64 {
    let scatter = used.iter().flat_map(|level| means(level)).flatten().filter(|mean| mean.samples > 1);
    let (sum, count) = scatter.fold((0.0, 0.0), |(sum, count), mean| {
        let freedom = mean.samples as f64 - 1.0;
        (sum + freedom * mean.scatter.powi(2), count + freedom)
    });
    if count > 0.0 { (sum / count).sqrt() } else { 0.0 }
}

/// Standard deviation of rounding, where the values look rounded: few distinct ones. Rounded values that toggle average
/// out, so this is for values that do not.
fn rounding_sd(values: &[f64]) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    sorted.dedup();
    let step = sorted
        .windows(2)
        .map(|pair| pair[1] - pair[0])
        .filter(|step| *step > 1e-9)
        .fold(f64::INFINITY, f64::min);
    if sorted.len() * 4 < values.len() && step.is_finite() { step / 12f64.sqrt() } else { 0.0 }
}
