//! Figures of identifications, diagnoses, predictions, plans, tracked runs, populations and blocks of tissue, as SVG text: what `--plots`, the report and the
//! page in the browser show.
//!
//! # Example
//!
//! The measured shape of a simulated run, with the fitted beam:
//!
//! ```
//! use inference::identify::{Options, identify};
//! # let truth = worlds::Truth { k_kpa: 12.0, tip_load_n: 0.2, effects: Vec::new(), foreign: None };
//! # let session = worlds::session(&truth, &worlds::Design::four_runs(), 3);
//! let found = identify(&session, &Options::default())?;
//! let svg = figures::shape(&found.runs[0])?;
//! assert!(svg.starts_with("<svg") && svg.contains("needle shape at"));
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
#![forbid(unsafe_code)]
#![deny(missing_docs)]

mod calibration;
mod cubes;
mod diagnosis;
mod displacement;
mod insertion;
mod lateral;
mod populations;
mod predictive;
mod steered;
mod steering;

pub use calibration::{CalibrationPanel, calibration};
pub use cubes::cubes;
pub use diagnosis::{gap, ranking, residuals};
pub use displacement::{Displacement, displacement};
pub use insertion::insertion;
pub use lateral::{force, run_residuals};
pub use populations::population;
pub use predictive::predictive;
pub use steered::{Steered, steered_path, steered_target};
pub use steering::{field, steering};

use inference::identify::{Pooled, RunResult, ShapeResult};
use inference::plan::{Choice, Plan};
use plotters::coord::Shift;
use plotters::prelude::*;
use std::ops::Range;

const FONT: &str = "sans-serif";
const WIDTH: u32 = 900;
/// Height of a line of a legend, pixels.
const LEGEND_LINE: f64 = 20.0;
const GREY: RGBColor = RGBColor(110, 110, 110);

/// Why a figure could not be drawn.
#[derive(Debug, thiserror::Error)]
#[error("cannot draw the figure: {0}")]
pub struct FigureError(String);

fn failed(error: impl std::fmt::Display) -> FigureError {
    FigureError(error.to_string())
}

/// Shape as measured (dots) and as fitted (lines), hold by hold, and below it the residuals.
///
/// # Errors
/// [`FigureError`] where the drawing fails.
pub fn shape(run: &RunResult) -> Result<String, FigureError> {
    let mut svg = String::new();
    {
        let area = SVGBackend::with_string(&mut svg, (WIDTH, 760)).into_drawing_area();
        area.fill(&WHITE).map_err(failed)?;
        let title = format!("{}: needle shape at {:.1} mm", run.id, run.depth_mm);
        let area = area.titled(&title, (FONT, 22)).map_err(failed)?;
        let (upper_area, lower_area) = area.split_vertically(430);
        let z_mm = range(run.shape.iter().flat_map(|shape| &shape.z_mm).copied());
        let deflections = run.shape.iter().flat_map(|shape| shape.measured_mm.iter().chain(&shape.fitted_mm));
        let deflections = headroom(range(deflections.copied()), run.shape.len(), 370);
        let mut chart = axes(&upper_area, z_mm.clone(), deflections, "deflection, mm", "")?;
        for (index, shape) in run.shape.iter().enumerate() {
            let colour = Palette99::pick(index).to_rgba();
            chart
                .draw_series(
                    pairs(shape, |s, i| s.measured_mm.get(i).copied())
                        .map(|at| Circle::new(at, 3, colour.filled())),
                )
                .map_err(failed)?
                .label(format!("hold {}, {}", shape.hold + 1, shape.plane))
                .legend(move |(x, y)| Circle::new((x + 8, y), 4, colour.filled()));
            let mut line: Vec<(f64, f64)> = pairs(shape, |s, i| s.fitted_mm.get(i).copied()).collect();
            line.sort_by(|a, b| a.0.total_cmp(&b.0));
            chart.draw_series(LineSeries::new(line, colour.stroke_width(2))).map_err(failed)?;
        }
        legend(&mut chart)?;
        let residuals = run.shape.iter().flat_map(|shape| pairs(shape, residual_mm).map(|(_, rest)| rest));
        let mut chart = axes(
            &lower_area,
            z_mm,
            range(residuals),
            "measured - fitted, mm",
            "position along the needle, mm",
        )?;
        for (index, shape) in run.shape.iter().enumerate() {
            let colour = Palette99::pick(index).to_rgba();
            chart
                .draw_series(pairs(shape, residual_mm).map(|at| Circle::new(at, 3, colour.filled())))
                .map_err(failed)?;
        }
        area.present().map_err(failed)?;
    }
    Ok(svg)
}

fn residual_mm(shape: &ShapeResult, i: usize) -> Option<f64> {
    Some(shape.measured_mm.get(i)? - shape.fitted_mm.get(i)?)
}

/// A range with room above the data for a legend of so many lines in so many pixels; at most as much again.
fn headroom(range: Range<f64>, lines: usize, pixels: u32) -> Range<f64> {
    let legend_fraction = (LEGEND_LINE * lines as f64 + 8.0) / f64::from(pixels);
    let limited = legend_fraction.min(0.5);
    range.start..range.end + (range.end - range.start) * limited / (1.0 - limited)
}

/// Rise of chi-square over K; nothing where the profile was not requested.
///
/// # Errors
/// [`FigureError`] where the drawing fails.
pub fn likelihood(pooled: &Pooled) -> Result<Option<String>, FigureError> {
    let Some(profile) = &pooled.profile else { return Ok(None) };
    let mut svg = String::new();
    {
        let area = SVGBackend::with_string(&mut svg, (WIDTH, 480)).into_drawing_area();
        area.fill(&WHITE).map_err(failed)?;
        let area = area.titled("profile likelihood of K", (FONT, 22)).map_err(failed)?;
        let k_kpa = range(profile.k_kpa.iter().copied());
        let top = profile.delta_chi_square.iter().copied().fold(4.0, f64::max);
        let mut chart = axes(&area, k_kpa.clone(), 0.0..top, "rise of chi-square", "K, kPa")?;
        let curve = profile.k_kpa.iter().copied().zip(profile.delta_chi_square.iter().copied());
        chart.draw_series(LineSeries::new(curve, BLUE.stroke_width(2))).map_err(failed)?;
        let level = [(k_kpa.start, 3.84), (k_kpa.end, 3.84)];
        chart.draw_series(LineSeries::new(level, GREY)).map_err(failed)?;
        for end in profile.ci95_kpa.into_iter().flatten() {
            chart.draw_series(LineSeries::new([(end, 0.0), (end, 3.84)], GREY)).map_err(failed)?;
        }
        chart
            .draw_series(LineSeries::new([(pooled.k_kpa, 0.0), (pooled.k_kpa, top)], RED))
            .map_err(failed)?;
        area.present().map_err(failed)?;
    }
    Ok(Some(svg))
}

/// Half-width of the interval of K over insertion depth, one line per guide position and displacement; open circles break a limit.
///
/// # Errors
/// [`FigureError`] where the drawing fails.
pub fn plan(plan: &Plan) -> Result<String, FigureError> {
    let mut lines: Vec<(String, Vec<&Choice>)> = Vec::new();
    for choice in &plan.choices {
        let name = format!("guide 2 at {} mm, {} mm", choice.guide2_mm, choice.displacement_mm);
        match lines.iter_mut().find(|(known, _)| *known == name) {
            Some((_, line)) => line.push(choice),
            None => lines.push((name, vec![choice])),
        }
    }
    let mut svg = String::new();
    {
        let area = SVGBackend::with_string(&mut svg, (WIDTH, 560)).into_drawing_area();
        area.fill(&WHITE).map_err(failed)?;
        let area = area.titled("half-width of the 95 % interval of K", (FONT, 22)).map_err(failed)?;
        let depths = range(plan.choices.iter().map(|choice| choice.depth_mm));
        let widths = headroom(range(plan.choices.iter().map(decades)), lines.len(), 460);
        let mut chart = ChartBuilder::on(&area)
            .margin(12)
            .x_label_area_size(46)
            .y_label_area_size(70)
            .build_cartesian_2d(depths, widths)
            .map_err(failed)?;
        chart
            .configure_mesh()
            .light_line_style(TRANSPARENT)
            .label_style((FONT, 14))
            .axis_desc_style((FONT, 16))
            .x_desc("insertion depth, mm")
            .y_desc("half-width, %")
            .y_label_formatter(&|decade| {
                format!("{:.3}", 10f64.powf(*decade)).trim_end_matches('0').trim_end_matches('.').to_owned()
            })
            .draw()
            .map_err(failed)?;
        for (index, (name, line)) in lines.into_iter().enumerate() {
            let colour = Palette99::pick(index).to_rgba();
            let points: Vec<(f64, f64)> =
                line.iter().map(|choice| (choice.depth_mm, decades(choice))).collect();
            chart
                .draw_series(LineSeries::new(points, colour.stroke_width(2)))
                .map_err(failed)?
                .label(name)
                .legend(move |(x, y)| PathElement::new(vec![(x, y), (x + 16, y)], colour.stroke_width(2)));
            let dots = line.into_iter().map(|choice| {
                let style = if choice.within_limits { colour.filled() } else { colour.stroke_width(1) };
                Circle::new((choice.depth_mm, decades(choice)), 4, style)
            });
            chart.draw_series(dots).map_err(failed)?;
        }
        chart
            .configure_series_labels()
            .position(SeriesLabelPosition::UpperRight)
            .background_style(WHITE.mix(0.8))
            .border_style(GREY)
            .label_font((FONT, 14))
            .draw()
            .map_err(failed)?;
        area.present().map_err(failed)?;
    }
    Ok(svg)
}

/// Widths span decades: powers of ten on the axis.
fn decades(choice: &Choice) -> f64 {
    choice.half_width_percent.clamp(1e-3, 1e3).log10()
}

type Area<'s> = DrawingArea<SVGBackend<'s>, Shift>;
type Chart<'a, 's> = ChartContext<
    'a,
    SVGBackend<'s>,
    Cartesian2d<plotters::coord::types::RangedCoordf64, plotters::coord::types::RangedCoordf64>,
>;

fn axes<'a, 's>(
    area: &'a Area<'s>,
    x: Range<f64>,
    y: Range<f64>,
    y_name: &str,
    x_name: &str,
) -> Result<Chart<'a, 's>, FigureError> {
    let mut chart = ChartBuilder::on(area)
        .margin(12)
        .x_label_area_size(if x_name.is_empty() { 28 } else { 46 })
        .y_label_area_size(70)
        .build_cartesian_2d(x, y)
        .map_err(failed)?;
    chart
        .configure_mesh()
        .light_line_style(TRANSPARENT)
        .label_style((FONT, 14))
        .axis_desc_style((FONT, 16))
        .x_desc(x_name)
        .y_desc(y_name)
        .x_label_formatter(&tick)
        .y_label_formatter(&tick)
        .draw()
        .map_err(failed)?;
    Ok(chart)
}

/// A number beside an axis, without what rounding leaves of a zero.
fn tick(at: &f64) -> String {
    // Adding nothing makes a zero of a negative one.
    format!("{}", (at * 1e9).round() / 1e9 + 0.0)
}

fn legend<'a, 's: 'a>(chart: &mut Chart<'a, 's>) -> Result<(), FigureError> {
    chart
        .configure_series_labels()
        .position(SeriesLabelPosition::UpperLeft)
        .background_style(WHITE.mix(0.8))
        .border_style(GREY)
        .label_font((FONT, 14))
        .draw()
        .map_err(failed)
}

/// Points of a shape that have both coordinates.
fn pairs(
    shape: &ShapeResult,
    value: impl Fn(&ShapeResult, usize) -> Option<f64>,
) -> impl Iterator<Item = (f64, f64)> {
    let points = shape.z_mm.iter().enumerate().filter_map(move |(i, z_mm)| Some((*z_mm, value(shape, i)?)));
    points.filter(|(z_mm, value)| z_mm.is_finite() && value.is_finite())
}

/// The area between two lines.
fn band(depths: &[f64], low: &[f64], high: &[f64], colour: RGBColor) -> Polygon<(f64, f64)> {
    let outward = depths.iter().copied().zip(low.iter().copied());
    let backward = depths.iter().copied().zip(high.iter().copied()).rev();
    Polygon::new(outward.chain(backward).collect::<Vec<_>>(), colour.mix(0.15).filled())
}

/// From the least to the greatest finite value and a little more; never empty.
fn range(values: impl Iterator<Item = f64>) -> Range<f64> {
    let (least, most) = values
        .filter(|value| value.is_finite())
        .fold((f64::INFINITY, f64::NEG_INFINITY), |(least, most), value| (least.min(value), most.max(value)));
    if least > most {
        return 0.0..1.0;
    }
    let margin = (0.05 * (most - least)).max(1e-3);
    least - margin..most + margin
}

#[cfg(test)]
mod tests;
