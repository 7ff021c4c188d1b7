//! Residuals of a fit, channel by channel.

use super::super::Fit;
use super::LateralData;

/// One deflection as measured and as fitted.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ShapeFit {
    /// Index of its level.
    pub level: usize,
    /// 0 for the vertical plane, 1 for the horizontal one.
    pub plane: usize,
    /// Position along the needle.
    pub z_m: f64,
    /// As measured.
    pub measured_m: f64,
    /// As fitted.
    pub fitted_m: f64,
}

/// Every deflection of block `block` of a fit.
pub fn shape_fits(data: &LateralData, fit: &Fit, block: usize) -> Vec<ShapeFit> {
    let residuals = fit.residuals.get(block).map(Vec::as_slice).unwrap_or_default();
    let points =
        || data.levels.iter().enumerate().flat_map(|(level, of)| of.shape.iter().map(move |p| (level, p)));
    let scalars = data.levels.len() * if data.uses_force { 2 } else { 1 };
    let per_plane = scalars + points().count();
    (0..data.planes)
        .flat_map(|plane| {
            let residuals = residuals.iter().skip(plane * per_plane + scalars);
            points().zip(residuals).map(move |((level, point), residual)| {
                let measured_m = point.deflection_m.get(plane).copied().unwrap_or(f64::NAN);
                let ratio = point.sd_ratio.get(plane).copied().unwrap_or(1.0);
                let fitted_m = measured_m - residual * data.shape_sd_m * ratio;
                ShapeFit { level, plane, z_m: point.z_m, measured_m, fitted_m }
            })
        })
        .collect()
}

/// Fit of one channel of a run.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ChannelFit {
    /// Sum of squared residuals.
    pub chi_square: f64,
    /// Number of values.
    pub count: usize,
}

/// Chi-square of displacement, force and shape of block `block` of a fit.
pub fn channel_fits(data: &LateralData, fit: &Fit, block: usize) -> [ChannelFit; 3] {
    let levels = data.levels.len();
    let points = data.points();
    let mut channels = [ChannelFit { chi_square: 0.0, count: 0 }; 3];
    let mut residuals = fit.residuals.get(block).into_iter().flatten();
    for _ in 0..data.planes {
        let forces = if data.uses_force { levels } else { 0 };
        for (channel, count) in channels.iter_mut().zip([levels, forces, points]) {
            channel.chi_square += residuals.by_ref().take(count).map(|r| r * r).sum::<f64>();
            channel.count += count;
        }
    }
    channels
}
