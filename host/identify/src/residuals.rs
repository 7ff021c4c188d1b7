//! Residuals of the fit of one run, in standard deviations: for figures.

use readings::{Fit, LateralData};

/// One residual of the likelihood, measured less fitted over its standard deviation.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ResidualResult {
    /// `displacement`, `force` or `shape`.
    pub channel: &'static str,
    /// `y` or `x`.
    pub plane: &'static str,
    /// Number of the hold among those used, from 0.
    pub hold: usize,
    /// Position along the needle, of a shape point.
    pub z_mm: Option<f64>,
    /// Measured less fitted, in standard deviations.
    pub sigma: f64,
}

/// The residuals of a fit of one run; in the order in which [`LateralData`] gives them.
pub(super) fn gather(data: &LateralData, fit: &Fit) -> Vec<ResidualResult> {
    let mut sigmas = fit.residuals.first().into_iter().flatten().copied();
    let mut residual_results = Vec::new();
    for plane in ["y", "x"].into_iter().take(data.planes) {
        for channel in ["displacement", "force"].into_iter().take(if data.uses_force { 2 } else { 1 }) {
            let of_holds = (0..data.levels.len()).zip(sigmas.by_ref());
            residual_results.extend(of_holds.map(|(hold, sigma)| ResidualResult {
                channel,
                plane,
                hold,
                z_mm: None,
                sigma,
            }));
        }
        let points = data.levels.iter().enumerate();
        let points =
            points.flat_map(|(hold, level)| level.shape.iter().map(move |point| (hold, 1e3 * point.z_m)));
        residual_results.extend(points.zip(sigmas.by_ref()).map(|((hold, z_mm), sigma)| ResidualResult {
            channel: "shape",
            plane,
            hold,
            z_mm: Some(z_mm),
            sigma,
        }));
    }
    residual_results
}
