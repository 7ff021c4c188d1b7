//! Figures of a tracked steering run, after figures 5 to 8 of the spring-beam-damper paper: tip simulated and measured, error,
//! and the parameters against depth.

use super::{Area, FONT, FigureError, GREY, WIDTH, axes, band, failed, legend, range};
use inference::track::results::{FieldResult, TrackResult};
use plotters::prelude::*;

/// Tip above, its error below it, then stiffness and damping with their 95 % intervals.
///
/// # Errors
/// [`FigureError`] where the drawing fails.
pub fn steering(one: &TrackResult) -> Result<String, FigureError> {
    let mut svg = String::new();
    {
        let area = SVGBackend::with_string(&mut svg, (WIDTH, 1180)).into_drawing_area();
        area.fill(&WHITE).map_err(failed)?;
        let area = area
            .titled(&format!("{}: tip, stiffness and damping online", one.id), (FONT, 22))
            .map_err(failed)?;
        let (tip_area, lower_rows) = area.split_vertically(380);
        let (error_area, remaining_rows) = lower_rows.split_vertically(210);
        let (stiffness_area, damping_area) = remaining_rows.split_vertically(280);
        tip(&tip_area, one)?;
        error(&error_area, one)?;
        let stiffness = Parameter {
            name: "mean stiffness, kN/m²",
            values: &one.stiffness_n_per_m2,
            low: &one.stiffness_lo95_n_per_m2,
            high: &one.stiffness_hi95_n_per_m2,
        };
        parameter(&stiffness_area, &one.depth_mm, &stiffness, "")?;
        let damping = Parameter {
            name: "mean damping, kN s/m²",
            values: &one.damping_n_s_per_m2,
            low: &one.damping_lo95_n_s_per_m2,
            high: &one.damping_hi95_n_s_per_m2,
        };
        parameter(&damping_area, &one.depth_mm, &damping, "insertion depth, mm")?;
        area.present().map_err(failed)?;
    }
    Ok(svg)
}

/// Stiffness of the tissue over depth, as known at the end of the run named `id`, with its 95 % interval.
///
/// # Errors
/// [`FigureError`] where the drawing fails.
pub fn field(id: &str, field: &FieldResult) -> Result<String, FigureError> {
    let mut svg = String::new();
    {
        let area = SVGBackend::with_string(&mut svg, (WIDTH, 380)).into_drawing_area();
        area.fill(&WHITE).map_err(failed)?;
        let area = area.titled(&format!("{id}: stiffness over depth"), (FONT, 22)).map_err(failed)?;
        let stiffness = Parameter {
            name: "stiffness, kN/m²",
            values: &field.stiffness_n_per_m2,
            low: &field.lo95_n_per_m2,
            high: &field.hi95_n_per_m2,
        };
        parameter(&area, &field.depth_mm, &stiffness, "depth, mm")?;
        area.present().map_err(failed)?;
    }
    Ok(svg)
}

fn tip(area: &Area<'_>, one: &TrackResult) -> Result<(), FigureError> {
    let depths = range(one.depth_mm.iter().copied());
    let tips = range(one.tip_y_mm.iter().chain(&one.measured_tip_y_mm).copied());
    let mut chart = axes(area, depths, tips, "tip position, mm", "")?;
    let line = one.depth_mm.iter().copied().zip(one.tip_y_mm.iter().copied());
    chart
        .draw_series(LineSeries::new(line, BLUE.stroke_width(2)))
        .map_err(failed)?
        .label("simulated with the estimate at that depth")
        .legend(|(x, y)| PathElement::new(vec![(x, y), (x + 16, y)], BLUE.stroke_width(2)));
    let dots = one.depth_mm.iter().copied().zip(one.measured_tip_y_mm.iter().copied());
    chart
        .draw_series(dots.map(|at| Circle::new(at, 3, RED.stroke_width(1))))
        .map_err(failed)?
        .label("measured, mean over a row")
        .legend(|(x, y)| Circle::new((x + 8, y), 3, RED.stroke_width(1)));
    legend(&mut chart)
}

fn error(area: &Area<'_>, one: &TrackResult) -> Result<(), FigureError> {
    let depths = range(one.depth_mm.iter().copied());
    let offs: Vec<f64> =
        one.tip_y_mm.iter().zip(&one.measured_tip_y_mm).map(|(tip, measured)| tip - measured).collect();
    let mut chart = axes(area, depths.clone(), range(offs.iter().copied().chain([0.0])), "error, mm", "")?;
    chart.draw_series(LineSeries::new([(depths.start, 0.0), (depths.end, 0.0)], GREY)).map_err(failed)?;
    let line = one.depth_mm.iter().copied().zip(offs);
    chart.draw_series(LineSeries::new(line, BLUE.stroke_width(2))).map_err(failed)?;
    Ok(())
}

/// Values in N/m^2 or N s/m^2, with ends of their intervals.
struct Parameter<'a> {
    name: &'static str,
    values: &'a [Option<f64>],
    low: &'a [f64],
    high: &'a [f64],
}

/// Line where a value is identified; its interval everywhere, cut at three times the largest value (before it is
/// identified it spans decades).
fn parameter(
    area: &Area<'_>,
    depths_mm: &[f64],
    of: &Parameter<'_>,
    x_name: &str,
) -> Result<(), FigureError> {
    let largest = of.values.iter().flatten().copied().fold(0.0, f64::max);
    let last = of.high.last().copied().unwrap_or(1.0);
    let top = 1e-3 * if largest > 0.0 { 3.0 * largest } else { 2.0 * last };
    let mut chart = axes(area, range(depths_mm.iter().copied()), 0.0..top.max(1e-3), of.name, x_name)?;
    chart
        .draw_series(std::iter::once(band(depths_mm, &clipped(of.low, top), &clipped(of.high, top), BLUE)))
        .map_err(failed)?;
    let identified =
        depths_mm.iter().zip(of.values).filter_map(|(depth, value)| Some((*depth, 1e-3 * (*value)?)));
    chart.draw_series(identified.map(|at| Circle::new(at, 2, BLUE.filled()))).map_err(failed)?;
    Ok(())
}

fn clipped(values: &[f64], top: f64) -> Vec<f64> {
    values.iter().map(|value| (1e-3 * value).clamp(0.0, top)).collect::<Vec<_>>()
}
