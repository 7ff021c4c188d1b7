//! Displacement of guide 2 as a camera measured it.

use super::{FONT, FigureError, GREY, WIDTH, axes, failed, headroom, legend, range};
use plotters::prelude::*;

/// Quantities of the figure: times in seconds, displacements in millimetres.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Displacement {
    /// Vertical displacement.
    pub y: Vec<(f64, f64)>,
    /// Horizontal displacement; empty where it is not identifiable.
    pub x: Vec<(f64, f64)>,
    /// Times of frames that are not used.
    pub rejected_s: Vec<f64>,
}

/// Displacement over time, and where frames were rejected.
///
/// # Errors
/// [`FigureError`] where the drawing fails.
pub fn displacement(id: &str, of: &Displacement) -> Result<String, FigureError> {
    let mut svg = String::new();
    {
        let area = SVGBackend::with_string(&mut svg, (WIDTH, 480)).into_drawing_area();
        area.fill(&WHITE).map_err(failed)?;
        let title = format!("{id}: displacement of guide 2 from the camera");
        let area = area.titled(&title, (FONT, 22)).map_err(failed)?;
        let times_s = of.y.iter().map(|at| at.0).chain(of.rejected_s.iter().copied());
        let x = range(times_s);
        let y = headroom(range(of.y.iter().chain(&of.x).map(|at| at.1)), 3, 400);
        let baseline = y.start;
        let mut chart = axes(&area, x, y, "displacement, mm", "time, s")?;
        for (name, colour, points) in [("vertical", BLUE, &of.y), ("horizontal", RED, &of.x)] {
            if points.is_empty() {
                continue;
            }
            chart
                .draw_series(LineSeries::new(points.iter().copied(), colour.stroke_width(1)))
                .map_err(failed)?
                .label(name)
                .legend(move |(x, y)| PathElement::new(vec![(x, y), (x + 16, y)], colour.stroke_width(2)));
        }
        if !of.rejected_s.is_empty() {
            let rejected =
                of.rejected_s.iter().map(|time_s| Cross::new((*time_s, baseline), 4, GREY.filled()));
            chart
                .draw_series(rejected)
                .map_err(failed)?
                .label("frames that are not used")
                .legend(|(x, y)| Cross::new((x + 8, y), 4, GREY.filled()));
        }
        legend(&mut chart)?;
        area.present().map_err(failed)?;
    }
    Ok(svg)
}
