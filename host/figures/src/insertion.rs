//! Figure of a predicted insertion, after figure 10 of Paper A (Lehmann et al.): path above, tip load below.

use super::{Area, FONT, FigureError, GREY, WIDTH, axes, band, failed, legend, range};
use inference::predict::{InsertionResult, PlaneResult};
use plotters::prelude::*;

/// Quantities of one plane.
struct Plane<'a> {
    name: &'static str,
    colour: RGBColor,
    tip_mm: &'a [f64],
    low_mm: &'a [f64],
    high_mm: &'a [f64],
    measured_mm: &'a [Option<f64>],
    load: &'a PlaneResult,
}

/// Tip path measured (dots) and predicted (line, 95 % band), and below it the tip load; a vertical line where the prediction begins.
///
/// # Errors
/// [`FigureError`] where the drawing fails.
pub fn insertion(one: &InsertionResult) -> Result<String, FigureError> {
    let mut planes = vec![Plane {
        name: "vertical",
        colour: BLUE,
        tip_mm: &one.tip_y_mm,
        low_mm: &one.lo95_y_mm,
        high_mm: &one.hi95_y_mm,
        measured_mm: &one.measured_y_mm,
        load: &one.load_y,
    }];
    if let (Some(tip_mm), Some(low_mm), Some(high_mm), Some(measured_mm), Some(load)) =
        (&one.tip_x_mm, &one.lo95_x_mm, &one.hi95_x_mm, &one.measured_x_mm, &one.load_x)
    {
        planes.push(Plane { name: "horizontal", colour: RED, tip_mm, low_mm, high_mm, measured_mm, load });
    }
    let mut svg = String::new();
    {
        let area = SVGBackend::with_string(&mut svg, (WIDTH, 760)).into_drawing_area();
        area.fill(&WHITE).map_err(failed)?;
        let title = format!("{}: tip predicted from {:.0} mm", one.id, one.identified_until_mm);
        let area = area.titled(&title, (FONT, 22)).map_err(failed)?;
        let (upper_area, lower_area) = area.split_vertically(480);
        path(&upper_area, one, &planes)?;
        load(&lower_area, one, &planes)?;
        area.present().map_err(failed)?;
    }
    Ok(svg)
}

fn path(area: &Area<'_>, one: &InsertionResult, planes: &[Plane<'_>]) -> Result<(), FigureError> {
    let depths = range(one.depth_mm.iter().copied());
    let ends = planes.iter().flat_map(|plane| plane.low_mm.iter().chain(plane.high_mm).copied());
    let measured = planes.iter().flat_map(|plane| plane.measured_mm.iter().flatten().copied());
    let tips = range(ends.chain(measured));
    let mut chart = axes(area, depths, tips.clone(), "tip position, mm", "")?;
    let identified_line = [(one.identified_until_mm, tips.start), (one.identified_until_mm, tips.end)];
    chart.draw_series(LineSeries::new(identified_line, GREY)).map_err(failed)?;
    for plane in planes {
        let colour = plane.colour;
        chart
            .draw_series(std::iter::once(band(&one.depth_mm, plane.low_mm, plane.high_mm, colour)))
            .map_err(failed)?;
        let line = one.depth_mm.iter().copied().zip(plane.tip_mm.iter().copied());
        chart
            .draw_series(LineSeries::new(line, colour.stroke_width(2)))
            .map_err(failed)?
            .label(format!("{}, predicted with 95 % band", plane.name))
            .legend(move |(x, y)| PathElement::new(vec![(x, y), (x + 16, y)], colour.stroke_width(2)));
        let dots =
            one.depth_mm.iter().zip(plane.measured_mm).filter_map(|(depth, tip)| Some((*depth, (*tip)?)));
        chart
            .draw_series(dots.map(|at| Circle::new(at, 2, colour.stroke_width(1))))
            .map_err(failed)?
            .label(format!("{}, measured", plane.name))
            .legend(move |(x, y)| Circle::new((x + 8, y), 3, colour.stroke_width(1)));
    }
    legend(&mut chart)
}

fn load(area: &Area<'_>, one: &InsertionResult, planes: &[Plane<'_>]) -> Result<(), FigureError> {
    let depths = range(one.depth_mm.iter().copied());
    let bands: Vec<[Vec<f64>; 2]> =
        planes.iter().map(|plane| [load_bound(plane, -1.0), load_bound(plane, 1.0)]).collect();
    let loads = range(bands.iter().flatten().flatten().copied());
    let mut chart = axes(area, depths, loads.clone(), "tip load, N", "insertion depth, mm")?;
    let identified_line = [(one.identified_until_mm, loads.start), (one.identified_until_mm, loads.end)];
    chart.draw_series(LineSeries::new(identified_line, GREY)).map_err(failed)?;
    for (plane, [low, high]) in planes.iter().zip(&bands) {
        chart.draw_series(std::iter::once(band(&one.depth_mm, low, high, plane.colour))).map_err(failed)?;
        let line = one.depth_mm.iter().copied().zip(plane.load.force_n.iter().copied());
        chart.draw_series(LineSeries::new(line, plane.colour.stroke_width(2))).map_err(failed)?;
    }
    Ok(())
}

fn load_bound(plane: &Plane<'_>, sign: f64) -> Vec<f64> {
    plane.load.force_n.iter().zip(&plane.load.sd_n).map(|(force, sd)| force + sign * 1.96 * sd).collect()
}
