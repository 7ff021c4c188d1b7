//! Calibration of posteriors: distribution functions of where the truth lies among draws.

use super::{FONT, FigureError, GREY, WIDTH, axes, failed};
use plotters::prelude::*;

const CURVE: RGBColor = RGBColor(30, 90, 180);
/// Panels beside each other, and the height of each, pixels.
const COLUMNS: usize = 2;
const PANEL_HEIGHT: u32 = 300;

/// Distribution function of one quantity.
#[derive(Debug, Clone, PartialEq)]
pub struct CalibrationPanel {
    /// Quantity and number of sessions.
    pub title: String,
    /// Places, 0 to 1.
    pub at: Vec<f64>,
    /// Share of sessions in which fewer draws than this lie below the truth.
    pub share: Vec<f64>,
    /// Lower end of the band that holds the whole function where the posterior is calibrated.
    pub low: Vec<f64>,
    /// Upper end.
    pub high: Vec<f64>,
}

/// Panels, one for each quantity: the distribution function less the diagonal, with its band.
///
/// # Errors
/// [`FigureError`] where the drawing fails.
pub fn calibration(panels: &[CalibrationPanel]) -> Result<String, FigureError> {
    let rows = panels.len().div_ceil(COLUMNS).max(1);
    let mut svg = String::new();
    {
        let area = SVGBackend::with_string(&mut svg, (WIDTH, PANEL_HEIGHT * rows as u32)).into_drawing_area();
        area.fill(&WHITE).map_err(failed)?;
        for (panel, part) in panels.iter().zip(area.split_evenly((rows, COLUMNS))) {
            let titled = part.titled(&panel.title, (FONT, 16)).map_err(failed)?;
            let above_diagonal = |shares: &[f64]| -> Vec<(f64, f64)> {
                panel.at.iter().zip(shares).map(|(at, share)| (*at, share - at)).collect()
            };
            let (low, high) = (above_diagonal(&panel.low), above_diagonal(&panel.high));
            let curve = above_diagonal(&panel.share);
            let most = low.iter().chain(&high).chain(&curve).map(|(_, by)| by.abs()).fold(0.05, f64::max);
            let names = ["share of sessions - place", "share of draws below the truth"];
            let mut chart = axes(&titled, 0.0..1.0, -1.1 * most..1.1 * most, names[0], names[1])?;
            let outline: Vec<(f64, f64)> = low.iter().copied().chain(high.iter().rev().copied()).collect();
            chart.draw_series([Polygon::new(outline, GREY.mix(0.25))]).map_err(failed)?;
            chart.draw_series(LineSeries::new([(0.0, 0.0), (1.0, 0.0)], GREY)).map_err(failed)?;
            let ends = [(0.0, 0.0)].into_iter().chain(curve).chain([(1.0, 0.0)]);
            chart.draw_series(LineSeries::new(ends, CURVE.stroke_width(2))).map_err(failed)?;
        }
        area.present().map_err(failed)?;
    }
    Ok(svg)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_quantity_has_its_panel() {
        let panel = |title: &str| CalibrationPanel {
            title: title.to_owned(),
            at: vec![0.25, 0.5, 0.75],
            share: vec![0.2, 0.5, 0.8],
            low: vec![0.1, 0.3, 0.6],
            high: vec![0.4, 0.7, 0.9],
        };
        let svg = calibration(&["K", "gap", "load"].map(panel)).expect("a figure");
        assert!(["K", "gap", "load"].iter().all(|title| svg.contains(&format!("\n{title}\n"))), "{svg}");
        assert_eq!(svg.matches("<polygon").count(), 3);
    }
}
