//! Levels of a run for the energy balance.

use super::deviations::Deviations;
use mechanics::unknowns::sensors::SHAPE_NOISE;
use modulus::energy::Balance;
use readings::holds::{Hold, Path};
use readings::{HoldData, Measured, ShapeDatum};

/// The displaced levels in the plane of their displacement, relative to the mean of the zero levels.
pub(super) fn balances(
    used: &[&Hold],
    noise: &Deviations,
    planes: usize,
    shape_of: impl Fn(&Hold) -> Vec<ShapeDatum>,
) -> Vec<Balance> {
    let data = |level: &Hold| noise.level(level, planes, shape_of(level));
    let (zeros, displaced): (Vec<&Hold>, Vec<&Hold>) =
        used.iter().partition(|level| level.path == Path::Zero);
    let zeros: Vec<HoldData> = zeros.into_iter().map(data).collect();
    let mut balances = Vec::new();
    for level in displaced.into_iter().map(data) {
        let displacement_m = relative_to_zero(&level, |level| &level.displacement_m, &zeros);
        let force_n = relative_to_zero(&level, |level| &level.force_n, &zeros);
        let distance_m = displacement_m.iter().map(|d| d.value.powi(2)).sum::<f64>().sqrt();
        if distance_m > 0.0 {
            let normalized: Vec<f64> = displacement_m.iter().map(|d| d.value / distance_m).collect();
            balances.push(Balance {
                displacement_m: projected(&displacement_m, &normalized),
                force_n: projected(&force_n, &normalized),
                shape_m: level
                    .shape
                    .iter()
                    .map(|point| (point.z_m, projected_deflection(point, &normalized)))
                    .collect(),
                shape_sd_m: SHAPE_NOISE.mean(),
            });
        }
    }
    balances
}

fn projected_deflection(p: &ShapeDatum, normalized: &[f64]) -> f64 {
    p.deflection_m.iter().zip(normalized).map(|(u, a)| u * a).sum()
}

fn projected(measured: &[Measured], normalized: &[f64]) -> Measured {
    Measured {
        value: measured.iter().zip(normalized).map(|(m, a)| m.value * a).sum(),
        sd: measured.iter().zip(normalized).map(|(m, a)| (m.sd * a).powi(2)).sum::<f64>().sqrt(),
    }
}

fn relative_to_zero(
    level: &HoldData,
    of: fn(&HoldData) -> &Vec<Measured>,
    zeros: &[HoldData],
) -> Vec<Measured> {
    let planes = of(level).iter().enumerate();
    planes
        .map(|(plane, measured)| {
            let zero = mean_zero(plane, of, zeros);
            Measured { value: measured.value - zero.value, sd: measured.sd.hypot(zero.sd) }
        })
        .collect()
}

fn mean_zero(plane: usize, of: fn(&HoldData) -> &Vec<Measured>, zeros: &[HoldData]) -> Measured {
    let values: Vec<Measured> = zeros.iter().filter_map(|level| of(level).get(plane).copied()).collect();
    let n = values.len().max(1) as f64;
    let variance = values.iter().map(|v| v.sd.powi(2)).sum::<f64>() / (n * n);
    Measured { value: values.iter().map(|v| v.value).sum::<f64>() / n, sd: variance.sqrt() }
}
