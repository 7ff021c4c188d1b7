//! K/E over the size of a block.

use super::{FONT, FigureError, GREY, WIDTH, axes, failed, legend, range};
use inference::walls::Cubes;
use plotters::prelude::*;

const HELD: RGBColor = RGBColor(30, 90, 180);
const FREE: RGBColor = RGBColor(200, 80, 40);

/// K/E in cubes of tissue over their edge, with sides that are held and that are free, and that of a half space.
///
/// # Errors
/// [`FigureError`] where the drawing fails.
pub fn cubes(cubes: &Cubes) -> Result<String, FigureError> {
    let mut svg = String::new();
    {
        let area = SVGBackend::with_string(&mut svg, (WIDTH, 460)).into_drawing_area();
        area.fill(&WHITE).map_err(failed)?;
        let title = format!(
            "K/E of a needle {:.0} mm deep in the middle of a cube (Poisson's ratio {})",
            cubes.depth_mm, cubes.poisson
        );
        let area = area.titled(&title, (FONT, 22)).map_err(failed)?;
        let edges = range(cubes.edge_mm.iter().copied());
        let ratios = cubes.held.iter().chain(&cubes.free).chain([&cubes.half_space]).copied();
        let most = range(ratios).end;
        // Room for the legend above the lines.
        let mut chart = axes(&area, edges.clone(), 0.0..1.35 * most, "K/E", "edge of the cube, mm")?;
        for (name, ratios, colour) in
            [("sides held in a box", &cubes.held, HELD), ("sides free, far side held", &cubes.free, FREE)]
        {
            let points = || cubes.edge_mm.iter().copied().zip(ratios.iter().copied());
            chart
                .draw_series(LineSeries::new(points(), colour.stroke_width(2)))
                .map_err(failed)?
                .label(name)
                .legend(move |(x, y)| PathElement::new(vec![(x, y), (x + 16, y)], colour.stroke_width(2)));
            chart.draw_series(points().map(|at| Circle::new(at, 3, colour.filled()))).map_err(failed)?;
        }
        let level = [(edges.start, cubes.half_space), (edges.end, cubes.half_space)];
        chart
            .draw_series(LineSeries::new(level, GREY))
            .map_err(failed)?
            .label("elastic half space: no wall near")
            .legend(|(x, y)| PathElement::new(vec![(x, y), (x + 16, y)], GREY));
        legend(&mut chart)?;
        area.present().map_err(failed)?;
    }
    Ok(svg)
}
